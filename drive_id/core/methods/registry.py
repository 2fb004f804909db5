"""The methods by name."""

from __future__ import annotations

from drive_id.core.methods.method import Method
from drive_id.core.methods.paper import PAPER_METHODS
from drive_id.errors import ConfigurationError
from drive_id.origins import FULL, ORIGINS


def method_named(name: str) -> Method:
    """Return a method by one of the names that :class:`~drive_id.core.fit_settings.FitSettings` accepts.

    Raises
    ------
    KeyError
        When there is no such method.
    ConfigurationError
        For ``static``, which sums nothing over samples.
    """
    if not ORIGINS[name].live:
        raise ConfigurationError(
            "Method static fits operating points of whole logs, not accumulated or live samples: use drive-id fit LOG "
            "--method static, or drive_id.fit."
        )
    if name == FULL.name:
        from drive_id.core.methods.full import FullMethod  # noqa: PLC0415  # takes 0.1 s

        return FullMethod()
    return PAPER_METHODS[name]
