"""Results in a browser: the archive of a folder, and the live page."""
