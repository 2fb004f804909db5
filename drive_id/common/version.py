"""The version of this package; ``setup.py`` reads it from this line."""

VERSION = "0.1.0"
