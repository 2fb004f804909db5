"""How pictures look: for a page or a screen, or for one column of an IEEE journal."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from drive_id.errors import ConfigurationError

Place = tuple[float, float, float, float]
"""Left, bottom, width and height, inches."""


@dataclass(frozen=True)
class Style:
    """Sizes and places of panels, inches, and settings of matplotlib."""

    size: tuple[float, float]  # of the flux maps
    maps: tuple[Place, ...]  # psi_d, psi_q
    diagnostics_size: tuple[float, float]
    diagnostics: tuple[Place, ...]  # standard error, inverter, along the axes, cross saturation, residual
    told: bool  # whether caption, key and trajectory are drawn; in a paper, its own caption says that
    settings: dict[Any, Any] = field(default_factory=dict)  # by the names of matplotlib


_SCREEN = Style(
    size=(7.2, 3.75),  # the two columns of a journal, or the text of a page
    maps=((0.65, 1.05, 2.3, 2.4), (4.17, 1.05, 2.3, 2.4)),
    diagnostics_size=(7.2, 8.5),
    diagnostics=(
        (0.65, 5.75, 2.4, 2.5), (4.4, 5.75, 2.6, 2.45), (0.65, 3.2, 2.6, 1.85), (4.4, 3.2, 2.6, 1.85),
        (0.65, 1.0, 6.35, 1.5),
    ),
    told=True,
)  # fmt: skip
_IEEE = Style(
    size=(3.5, 5.7),  # one column
    maps=((0.6, 3.25, 2.15, 2.15), (0.6, 0.4, 2.15, 2.15)),
    diagnostics_size=(3.5, 9.4),  # its text is 9.5 in high
    diagnostics=(
        (0.6, 7.3, 1.85, 1.85), (0.6, 5.55, 2.75, 1.1), (0.6, 3.83, 2.75, 1.1), (0.6, 2.11, 2.75, 1.1),
        (0.6, 0.39, 2.75, 1.1),
    ),
    told=False,
    settings={"font.family": "STIXGeneral", "mathtext.fontset": "stix"},  # as Times, and comes with matplotlib
)  # fmt: skip
_STYLES = {"screen": _SCREEN, "ieee": _IEEE}


def style_of(name: str) -> Style:
    """Return a style by its name; raises ConfigurationError for an unknown one."""
    if name not in _STYLES:
        raise ConfigurationError(f"style is '{name}': it must be one of {', '.join(_STYLES)}.")
    return _STYLES[name]
