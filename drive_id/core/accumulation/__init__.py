"""Sufficient statistics of recordings: accumulated, merged, with excerpts for pictures and MAD."""
