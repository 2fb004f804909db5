"""The command line ``drive-id``."""
