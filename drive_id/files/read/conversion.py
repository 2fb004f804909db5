"""What the signals file asks for beyond units: frames, an angle of another rate, and decimated voltages."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.signals.decimated import mean_voltages
from drive_id.core.signals.join import ToPhases
from drive_id.core.signals.rotor_interpolation import interpolated_rotor
from drive_id.core.signals.rotor_smoothing import smoothed_rotor
from drive_id.core.signals.signal import Signal
from drive_id.files.messages.signal_sources import ROTOR_SPEED, SignalMap
from drive_id.types import FloatArray, Samples


def conversions(signals: SignalMap) -> tuple[ToPhases | None, ToPhases | None]:
    """Return for currents and voltages how d and q components become phase quantities; None where they need not."""
    currents, voltages = (
        partial(_to_phases, source.angle_advance) if source.by_rotor else None
        for source in (signals.currents, signals.voltages)
    )
    return currents, voltages


def _to_phases(advance: float, values: FloatArray, angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    return frames.to_abc(values, angle + advance * period * speed)


def rotor_at_currents(found: dict[str, Signal], signals: SignalMap) -> tuple[Signal, float, list[Message]]:
    """Return the resolver's signal, with a speed recorded apart, at the times of the currents if it is interpolated.

    Returns the root mean square error of an interpolated angle, rad, or 0, and warnings as well. Raises DataError when
    the angle cannot be interpolated.
    """
    rotor = found["resolver"]
    if ROTOR_SPEED in found:
        speed = found[ROTOR_SPEED]
        order = np.argsort(speed.stamp, kind="stable")
        values = np.interp(rotor.stamp, speed.stamp[order], speed.values[order, 0] * signals.resolver.speed_factor)
        rotor = replace(rotor, values=np.column_stack([rotor.values[:, 0], values]))
    remarks: list[Message] = []
    if signals.resolver.smoothing is not None:
        rotor, change = smoothed_rotor(rotor, signals.resolver.smoothing)
        time = signals.resolver.smoothing
        remarks.append(Message("angle_smoothed", topic=rotor.name, time=time, change=change))
    if not signals.resolver.interpolate:
        return rotor, 0.0, remarks
    moved = interpolated_rotor(rotor, np.sort(found["currents"].stamp))
    remarks.append(Message("angle_interpolated", topic=rotor.name, period=moved.period, error=moved.error))
    return moved.signal, moved.error, remarks


def undecimated(samples: Samples, signals: SignalMap) -> Samples:
    """Return samples whose voltages are the means over each sample, if the log is decimated."""
    every = signals.voltages.decimation
    if every == 1:
        return samples
    u_dq = frames.to_dq(samples.u_abc, samples.angle)
    mean = mean_voltages(u_dq, samples.angle, samples.speed, samples.sample_period, every, samples.run_starts)
    return replace(samples, u_abc=frames.phases(mean[:, 0] + 1j * mean[:, 1]))
