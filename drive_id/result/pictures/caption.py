"""What a result is of, in words: below a figure, and as its short form in Python."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drive_id.common.quantity import measured

_LONGEST_NAME = 50
"""Characters of a machine's name in a caption."""


@dataclass(frozen=True)
class Caption:
    """What stands below a figure; unknown entries are left out."""

    machine: str = ""
    origin: str = ""  # such as method joint
    date: str = ""  # of the recording
    resistance: float = math.nan  # ohm
    sigma_resistance: float = math.nan
    i_max: float = math.nan  # A
    speeds: tuple[float, float] | None = None  # lowest and highest electrical speed, rad/s
    pole_pairs: int | None = None  # with them, the speed is given in rpm

    def __str__(self) -> str:
        """Return one line without formulas and without the time of day."""
        resistance = f"R = {measured(self.resistance, unit='Ω')}" if math.isfinite(self.resistance) else ""
        said = (self.machine, self.origin, self.date[:10], resistance, self.speed(), f"i_max = {self.i_max:.4g} A")
        return ", ".join(filter(None, said))

    def text(self) -> str:
        """Return two lines, formulas as mathtext: what was identified, and how."""
        resistance = measured(self.resistance, self.sigma_resistance, "Ω", abs(self.resistance))
        what = (_plain(self.machine[:_LONGEST_NAME]), self.origin, self.date)
        how = (
            f"$R$ = {resistance}" if math.isfinite(self.resistance) else "",
            f"speed {self.speed()}" if self.speeds is not None else "",
            rf"$i_\mathrm{{max}}$ = {self.i_max:.4g} A" if math.isfinite(self.i_max) else "",
        )
        return "\n".join(filter(None, ("  ·  ".join(filter(None, entries)) for entries in (what, how))))

    def speed(self) -> str:
        """Return the speeds with their unit; empty when unknown."""
        if self.speeds is None:
            return ""
        factor, unit = (30 / math.pi / self.pole_pairs, "rpm") if self.pole_pairs else (1.0, "rad/s electrical")
        low, high = (factor * speed for speed in self.speeds)
        narrow = high - low <= 0.02 * max(abs(low), abs(high))
        return (f"{(low + high) / 2:.4g}" if narrow else f"{low:.4g} to {high:.4g}") + f" {unit}"


NO_CAPTION = Caption()


def _plain(text: str) -> str:
    """Return text that neither is taken for a formula nor lacks a glyph."""
    printable = "".join(character for character in text if character.isprintable())
    return printable.encode("latin-1", "replace").decode("latin-1").replace("$", r"\$")
