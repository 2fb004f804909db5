"""The file to import, and how to read it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.conventions import Conventions


@dataclass(frozen=True)
class Source:
    """A file and how to read it; raises ConfigurationError when there is no such file."""

    path: Path
    format: str | None = None  # None: by the name and content of the file
    axis: str | None = None  # see :class:`~.conventions.Conventions`; None: as the file says, else ``pm``
    conventions: Conventions = field(default_factory=Conventions)  # all others
    machine: str = ""  # its name; empty: that of the file
    columns: Mapping[str, str] = field(default_factory=dict)
    """Our names (``i_d``, ``psi_q``, ``torque``, ``theta``, ``sigma_d``, ...) to headings of a text file, or numbers
    of its columns from 1."""
    psi_q_file: Path | None = None  # the second of two text files with one matrix each
    angle: str = "electrical"  # of rotor positions, or "mechanical"
    angle_offset: float = 0.0  # electrical, of the d axis from phase a at the file's position zero, degrees
    scalars: Mapping[str, Any] = field(default_factory=dict)
    """Given ``resistance``, ``pole_pairs``, ``i_max`` and ``u_dc``: they take precedence over the file's."""

    def __post_init__(self) -> None:
        for path in (self.path, self.psi_q_file):
            if path is not None and path.is_dir():
                raise ConfigurationError(f"'{path}' is a folder: name a file in it, as flux_map.npz of a result.")
            if path is not None and not path.is_file():
                raise ConfigurationError(f"There is no file '{path}' to import: check the path.")
        if self.angle not in ("electrical", "mechanical"):
            raise ConfigurationError(f"--angle is '{self.angle}': it must be electrical or mechanical.")
        if not math.isfinite(self.angle_offset):
            raise ConfigurationError(f"--angle-offset is {self.angle_offset}: give electrical degrees.")

    def electrical(self, degrees_or_radians: Any) -> Any:
        """Return rotor positions as electrical angles.

        Raises ConfigurationError when they are mechanical and the pole pairs were not given.
        """
        if self.angle == "electrical":
            return degrees_or_radians
        if "pole_pairs" not in self.scalars:
            raise ConfigurationError("Mechanical rotor positions need the number of pole pairs: give --pole-pairs.")
        return degrees_or_radians * self.scalars["pole_pairs"]
