"""Containers: MCAP and sqlite3 files, folders of them, ``metadata.yaml``."""
