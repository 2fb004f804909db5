"""The largest number at which something is possible."""

from __future__ import annotations

from collections.abc import Callable

BISECTIONS = 50
"""By which the rounding of a double is reached."""


def largest_possible(possible: Callable[[float], bool], high: float, bisections: int = BISECTIONS) -> float:
    """Return the largest number from 0 to ``high`` up to which something is possible, by bisection."""
    low = 0.0
    for _ in range(bisections):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if possible(middle) else (low, middle)
    return low
