"""Samples and messages to recordings; recovery of damaged ones."""
