"""Inspect a log before a fit: contents, findings, and a proposed signals file."""
