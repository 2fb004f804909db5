"""One writer for each format, or family of formats."""
