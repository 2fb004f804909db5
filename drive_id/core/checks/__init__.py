"""Checks before a fit: errors where a map would be wrong."""
