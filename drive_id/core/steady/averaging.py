"""Average fast samples of phase quantities to slow telemetry in d and q."""

from __future__ import annotations

import numpy as np

from drive_id.core import frames
from drive_id.core.steady.operating_data import OperatingData
from drive_id.errors import SamplePeriodError
from drive_id.types import FloatArray, Samples

AVERAGED = 0.1  # time over which samples are averaged, s
_LARGEST_TURN = 0.5  # turn per sample, rad, up to which phase quantities and an angle give d and q components


def averaged(samples: Samples) -> OperatingData:
    """Return d and q components averaged over 0.1 s, within gap-free runs; the remainder of a run is left out.

    The voltages are means over each sample, during which they are held in the stator frame.

    Raises SamplePeriodError when the rotor turns too far per sample, or no run is long enough.
    """
    period = samples.sample_period
    turn = float(np.median(np.abs(samples.speed))) * period
    if turn > _LARGEST_TURN:
        raise SamplePeriodError(
            f"The rotor turns {np.rad2deg(turn):.0f} degrees electrical per sample, so phase quantities and their "
            "angle give no d and q components: log currents and voltages in d and q."
        )
    size = max(round(AVERAGED / period), 1)
    whole = [slice(k, k + size) for run in samples.runs() for k in range(run.start, run.stop - size + 1, size)]
    if not whole:
        raise SamplePeriodError(f"No {AVERAGED} s of the recording are without a gap: record longer.")
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    u_dq = frames.integrate_held(samples.u_abc, samples.angle, samples.speed, period) / period
    time = (samples.stamp - samples.stamp[0]) * 1e-9
    temperature = samples.winding_temperature

    def means(values: FloatArray) -> FloatArray:
        return np.array([values[at].mean(axis=0) for at in whole])

    return OperatingData(
        i_dq=means(i_dq),
        u_dq=means(u_dq),
        speed=means(samples.speed),
        time=means(time),
        winding_temperature=None if temperature is None or not np.isfinite(temperature).all() else means(temperature),
    )
