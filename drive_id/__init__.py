"""Identify flux maps, resistance and inverter voltage error of electric drives from recordings."""

__version__ = "0.1.0"
