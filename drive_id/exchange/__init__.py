"""Flux maps from and for other tools: import, export, comparison."""
