"""Exchange of flux maps with other tools: import, export, comparison."""
