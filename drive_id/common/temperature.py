"""The state of a drive in which its resistance and its maps are given."""

from __future__ import annotations

from typing import Final

REFERENCE_TEMPERATURE: Final = 20.0
"""Degrees Celsius at which resistance and flux map are given where temperatures are known: that of IEC 60028."""
COLDEST: Final = -100.0
HOTTEST: Final = 300.0
"""Degrees Celsius between which windings and magnets are: a temperature in kelvin is beyond."""
COPPER: Final = 3.93e-3
"""Temperature coefficient of the resistance of copper at the reference temperature, 1/K (IEC 60028)."""
