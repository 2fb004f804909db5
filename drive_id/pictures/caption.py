"""What a result is of, in words: below a figure, and as its short form in Python."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drive_id.quantity import measured

_LONGEST_NAME = 50
"""Characters of a machine's name in a caption."""


@dataclass(frozen=True)
class Caption:
    """What stands below a figure; unknown entries are left out.

    Parameters
    ----------
    machine : str
        Or another name of what was identified.
    origin : str
        Such as ``method joint``.
    date : str
        Of the recording.
    resistance, sigma_resistance : float
        Ohm.
    i_max : float
        A.
    speeds : (float, float) or None
        Lowest and highest electrical speed, rad/s.
    pole_pairs : int or None
        With them, the speed is given in rpm.
    """

    machine: str = ""
    origin: str = ""
    date: str = ""
    resistance: float = math.nan
    sigma_resistance: float = math.nan
    i_max: float = math.nan
    speeds: tuple[float, float] | None = None
    pole_pairs: int | None = None

    def __str__(self) -> str:
        """Return one line without formulas and without the time of day."""
        resistance = f"R = {measured(self.resistance, unit='Ω')}" if math.isfinite(self.resistance) else ""
        said = (self.machine, self.origin, self.date[:10], resistance, self.speed(), f"i_max = {self.i_max:.4g} A")
        return ", ".join(filter(None, said))

    def text(self) -> str:
        """Return two lines, formulas as mathtext: what was identified, and how."""
        what = [_plain(self.machine[:_LONGEST_NAME]), self.origin, self.date]
        how = []
        if math.isfinite(self.resistance):
            how.append(f"$R$ = {measured(self.resistance, self.sigma_resistance, 'Ω')}")
        if self.speeds is not None:
            how.append(f"speed {self.speed()}")
        if math.isfinite(self.i_max):
            how.append(rf"$i_\mathrm{{max}}$ = {self.i_max:.4g} A")
        lines = ("  ·  ".join(entry for entry in entries if entry) for entries in (what, how))
        return "\n".join(line for line in lines if line)

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
