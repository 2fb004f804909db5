"""Recordings to samples: signals files, extraction, joined pieces."""
