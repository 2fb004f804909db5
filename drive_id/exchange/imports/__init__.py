"""Flux maps of other tools as results of drive_id."""
