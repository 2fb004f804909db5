"""The speed of the shaft over time: pieces of constant speed joined by ramps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.bench.settings import SimulationSettings
from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Mean mechanical speed, piecewise linear in time and constant before and after."""

    time: FloatArray  # (P,), not decreasing, s
    speed: FloatArray  # (P,), mechanical, rpm

    @classmethod
    def from_settings(cls, settings: SimulationSettings, duration: float | None) -> SpeedProfile:
        """Lay out the speeds of the settings over the duration of the whole experiment, s; None when that is open.

        Raises ConfigurationError when several speeds have no durations, or a piece is shorter than its ramp.
        """
        if len(settings.speeds) == 1:
            return cls(np.zeros(1), np.array(settings.speeds))
        shares = settings.segment_durations
        if not shares:
            if duration is None:
                raise ConfigurationError(
                    f"There is no duration for {counted(len(settings.speeds), 'speed')}: set "
                    f"segment_durations for a drive that runs on."
                )
            shares = (duration / len(settings.speeds),) * len(settings.speeds)
        if min(shares[1:]) < settings.ramp_time:
            raise ConfigurationError(
                f"A speed lasts {min(shares[1:]):g} s, less than its ramp of {settings.ramp_time:g} s: "
                "shorten ramp_time or lengthen the experiment."
            )
        time, speed = [0.0], [settings.speeds[0]]
        start = 0.0
        for k, share in enumerate(shares[:-1]):
            start += share
            time += [start, start + settings.ramp_time]
            speed += [settings.speeds[k], settings.speeds[k + 1]]
        return cls(np.array(time), np.array(speed))

    def electrical(self, time: FloatArray, pole_pairs: int) -> FloatArray:
        """Return the mean electrical speed, rad/s, at ``time``, s."""
        return np.interp(time, self.time, self.speed) * (2 * np.pi / 60 * pole_pairs)
