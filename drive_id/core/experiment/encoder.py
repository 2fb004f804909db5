"""What a drive makes of the angle of its encoder: the parameters by which it takes the result of a first start."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drive_id.common.settings import Checked, setting
from drive_id.core.experiment.first_start import FirstStart
from drive_id.errors import ConfigurationError


@dataclass(frozen=True)
class Encoder(Checked):
    """The electrical angle, for the control and on ``resolver``: direction * pole pairs * raw angle - offset."""

    encoder_offset: float = setting(
        0.0, "Subtracted from the electrical angle", unit="rad", minimum=-math.pi, maximum=math.pi
    )
    encoder_direction: int = setting(1, "-1: the raw angle falls where the phases turn forwards", minimum=-1, maximum=1)
    encoder_pole_pairs: int = setting(1, "Electrical turns per turn of the raw angle", minimum=1, maximum=100)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoder_direction == 0:
            raise ConfigurationError("encoder_direction is 0: it must be 1 or -1.")

    @property
    def factor(self) -> int:
        """Electrical angle per raw angle."""
        return self.encoder_direction * self.encoder_pole_pairs

    def sentence(self) -> str:
        """Return the parameters as part of a sentence."""
        return (
            f"encoder_offset {self.encoder_offset:.4f} rad, encoder_direction {self.encoder_direction} and "
            f"encoder_pole_pairs {self.encoder_pole_pairs}"
        )

    def corrected_by(self, start: FirstStart) -> Encoder:
        """Return what makes the angle right that a first start found with the present values."""
        factor = start.direction * start.turns_per_angle
        offset = factor * self.encoder_offset + start.angle_offset
        return Encoder(
            math.remainder(offset, 2 * math.pi),
            self.encoder_direction * start.direction,
            self.encoder_pole_pairs * start.turns_per_angle,
        )
