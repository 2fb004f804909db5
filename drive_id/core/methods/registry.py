"""The methods by name."""

from __future__ import annotations

from drive_id.core.methods.method import Method
from drive_id.core.methods.paper import PAPER_METHODS
from drive_id.origins import FULL


def method_named(name: str) -> Method:
    """Return the method of accumulated samples; raises KeyError when there is none of this name."""
    if name == FULL.name:
        from drive_id.core.methods.full import FullMethod  # noqa: PLC0415  # takes 0.1 s

        return FullMethod()
    return PAPER_METHODS[name]
