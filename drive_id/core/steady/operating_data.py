"""Slow telemetry of a drive in d and q, without an angle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drive_id.common.quantity import counted
from drive_id.errors import DataError, NonFiniteError
from drive_id.types import FloatArray

_OFF, _TURNING = 0.01, 0.1
"""Share of the largest current and voltage below which an inverter is off, and of the largest speed above which the
rotor turns."""


@dataclass(frozen=True, eq=False, repr=False)
class OperatingData:
    """Currents, commanded voltages and speed of a drive in d and q, at any rate below that of its control.

    Each sample is a mean, or an instantaneous value, over many control periods and often several electrical turns.

    Parameters
    ----------
    i_dq : (N, 2) float
        Measured currents, A, peak.
    u_dq : (N, 2) float
        Commanded voltages in the same frame, V, peak, phase to neutral.
    speed : (N,) float
        Electrical speed, rad/s.
    time : (N,) float, optional
        s, strictly increasing. None: each sample is an operating point already, such as a mean from a test plan.
    winding_temperature : (N,) float, optional
        Degrees Celsius; the resistance then holds at 20 degrees Celsius.

    Raises
    ------
    DataError
        When shapes disagree, there are no samples, or the time does not increase.
    NonFiniteError
        When a value is NaN or infinite.
    """

    i_dq: FloatArray
    u_dq: FloatArray
    speed: FloatArray
    time: FloatArray | None = None
    winding_temperature: FloatArray | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.speed) != 1:
            raise DataError(f"speed has shape {np.shape(self.speed)}: give a speed for each sample.")
        n = len(self.speed)
        shapes: dict[str, tuple[int, ...]] = {"i_dq": (n, 2), "u_dq": (n, 2), "speed": (n,)}
        shapes |= {name: (n,) for name in ("time", "winding_temperature") if getattr(self, name) is not None}
        for name, shape in shapes.items():
            try:
                values = np.ascontiguousarray(getattr(self, name), np.float64)
            except (TypeError, ValueError) as error:
                raise DataError(f"{name} is not an array of numbers: give one of shape {shape}.") from error
            if values.shape != shape:
                raise DataError(f"{name} has shape {values.shape} where {n} speeds need {shape}: check the arrays.")
            if not np.isfinite(values).all():
                k = int(np.argmin(np.isfinite(values).reshape(n, -1).all(axis=1)))
                raise NonFiniteError(f"{name} is NaN or infinite, first in sample {k}: repair or cut the log there.")
            object.__setattr__(self, name, values)
        if n == 0:
            raise DataError("There are no samples: check that currents, voltages and speed overlap in time.")
        if self.time is not None and np.any(np.diff(self.time) <= 0):
            raise DataError("The time of the samples does not increase strictly: sort them and drop repeated ones.")

    def __len__(self) -> int:
        return len(self.speed)

    def __repr__(self) -> str:
        if self.time is None or len(self) < 2:
            return f"<OperatingData: {counted(len(self), 'operating point')}>"
        return f"<OperatingData: {counted(len(self), 'sample')} at {1 / self.period:.4g} Hz>"

    @property
    def period(self) -> float:
        """Median time between samples, s; 0 without a time."""
        return 0.0 if self.time is None or len(self) < 2 else float(np.median(np.diff(self.time)))

    def without_coasting(self) -> tuple[OperatingData, int]:
        """Return the samples without those of an inverter that is switched off, and how many these are.

        Then neither current nor voltage is given while the rotor turns, which induces a voltage that nobody recorded.
        """
        current, voltage, speed = np.hypot(*self.i_dq.T), np.hypot(*self.u_dq.T), np.abs(self.speed)
        off = (current < _OFF * current.max()) & (voltage < _OFF * voltage.max()) & (speed > _TURNING * speed.max())
        if not off.any() or off.all():
            return self, 0
        kept: dict[str, Any] = {
            name: None if (values := getattr(self, name)) is None else values[~off]
            for name in ("i_dq", "u_dq", "speed", "time", "winding_temperature")
        }
        return replace(self, **kept), int(off.sum())

    @property
    def duration(self) -> float:
        """Of all samples, s; 0 without a time."""
        return len(self) * self.period
