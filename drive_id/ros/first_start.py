"""First start of a drive without load machine: its angle, the acceleration of its shaft, and the files that say so."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from drive_id.core.experiment.first_start import FirstStart, first_start, shaft_acceleration
from drive_id.core.experiment.settings import FIRST_START, FREE_SHAFT, ExperimentSettings, make_trajectory
from drive_id.errors import ExperimentError
from drive_id.fitting.sources import read_bag
from drive_id.ros.bench import Bench

SIGNALS, PARAMETERS = "signals.yaml", "trajectory_publisher.yaml"
_SHAKE_FREQUENCY = 40.0
"""Hz: slow enough for the current controllers, so fast that the shaft hardly moves."""
_SHAKE_TIME = 1.0  # s
_SHAKES = (0.2, 0.95)
"""Amplitudes of the shakes by i_max, the smaller one first: it tells how far the other one may go."""
_SLEW_MARGIN = 1.05


@dataclass(frozen=True)
class Commissioned:
    """A drive that is ready for trajectory ``free_shaft``.

    Parameters
    ----------
    start : FirstStart
    acceleration : float
        Electrical, by the largest current, T_max p / J, rad/s^2.
    signals, parameters : Path
        Signals file for its recordings, and parameters of the publisher.
    """

    start: FirstStart
    acceleration: float
    signals: Path
    parameters: Path

    def sentence(self) -> str:
        """Return the result as one sentence."""
        start = self.start
        if math.isnan(start.angle_sigma):
            return (
                f"The largest torque accelerates the rotor by {self.acceleration:.4g} rad/s^2 (electrical); its angle, "
                f"{math.degrees(start.angle_offset):.2f} degrees ahead of the magnet axis, was known."
            )
        return (
            f"The angle is {math.degrees(start.angle_offset):.2f} ± {math.degrees(start.angle_sigma):.2f} degrees "
            f"ahead of the magnet axis; friction holds the rotor back by {math.degrees(start.load_angle):.1f} degrees; "
            f"the largest torque accelerates it by {self.acceleration:.4g} rad/s^2 (electrical)."
        )


def commission(
    bench: Bench, folder: Path, name: str, say: Callable[[str, str], None], *, angle_known: bool = False
) -> Commissioned:
    """Run the first start, configure the publisher by its result, and write the files of the result.

    Parameters
    ----------
    bench : Bench
        Ready; ``shaft_speed_max`` of its publisher is set.
    folder : Path
        For the files; exists.
    name : str
        Of the recordings, to which ``_first_start``, ``_shake_1`` and ``_shake_2`` are added.
    say : callable
        Called with a word, Turning or Shaking, and a sentence on what is done.
    angle_known : bool
        The publisher's ``angle_offset`` is right already: only shake.

    Raises
    ------
    ExperimentError
        When the result is not clear, or the drive has to be set up differently.
    """
    limit = bench.publisher_value("shaft_speed_max")
    if not limit > 0:
        raise ExperimentError(
            "trajectory_publisher has no shaft_speed_max: set the highest electrical speed of the free shaft, rad/s."
        )
    kept = {key: bench.publisher_value(key) for key in ("duration", "i_max", "mean_speed")}
    if angle_known:
        start = FirstStart((0.0,) * 3, 1, 1, bench.publisher_value("angle_offset"), math.nan, math.nan)
    else:
        say("Turning", "The current vector turns slowly, forwards and backwards.")
        bench.configure_publisher(trajectory=FIRST_START, repeat=1, angle_offset=0.0)
        start = first_start(read_bag(bench.run_experiment(f"{name}_first_start").uri))
        _require_plain(start)
    acceleration = _shaken(bench, start, name, kept["i_max"], limit, say)
    found = {"angle_offset": start.angle_offset, "shaft_acceleration": acceleration, "shaft_speed_max": limit}
    swing_up(bench, duration=kept["duration"], mean_speed=kept["mean_speed"], **found)
    _write(
        folder / PARAMETERS, {"/**": {"ros__parameters": {"trajectory": FREE_SHAFT, "i_max": kept["i_max"], **found}}}
    )
    _write(folder / SIGNALS, signals_of(start))
    return Commissioned(start, acceleration, folder / SIGNALS, folder / PARAMETERS)


def swing_up(bench: Bench, **changes: Any) -> None:
    """Set the publisher to trajectory ``free_shaft``, with the slew rate that it needs."""
    names = ("i_max", "shaft_acceleration", "shaft_speed_max", "mean_speed", "swing_frequency", "amplitude", "duration")
    values = {key: bench.publisher_value(key) for key in names}
    values |= {"swing_frequency": math.nan, "amplitude": _SHAKES[-1]} if "shaft_acceleration" in changes else {}
    values |= changes
    known = {key: None if math.isnan(value) else value for key, value in values.items()}
    wanted: dict[str, Any] = {**known, "trajectory": FREE_SHAFT, "slew_rate": 1e9}
    slope = make_trajectory(ExperimentSettings(**wanted)).slope
    slew_rate = max(bench.publisher_value("slew_rate"), _SLEW_MARGIN * slope)
    bench.configure_publisher(**values, trajectory=FREE_SHAFT, repeat=1, slew_rate=slew_rate)


def _shaken(
    bench: Bench, start: FirstStart, name: str, i_max: float, limit: float, say: Callable[[str, str], None]
) -> float:
    """Shake the shaft, gently first; return its electrical acceleration by the full current, rad/s^2."""
    acceleration, allowed = 0.0, 1.0
    for number, amplitude in enumerate(_SHAKES, 1):
        share = min(amplitude, allowed)
        say("Shaking", f"The shaft is shaken at {_SHAKE_FREQUENCY:g} Hz with {100 * share:.0f} % of i_max.")
        swing_up(
            bench,
            angle_offset=start.angle_offset,
            shaft_acceleration=math.nan,
            mean_speed=0.0,
            swing_frequency=_SHAKE_FREQUENCY,
            amplitude=share,
            duration=_SHAKE_TIME,
        )
        samples = read_bag(bench.run_experiment(f"{name}_shake_{number}").uri)
        acceleration = i_max * shaft_acceleration(samples, _SHAKE_FREQUENCY, start.angle_offset)
        # Where the torque rises with the square of the current, the swing does as well.
        allowed = share * math.sqrt(limit * 2 * math.pi * _SHAKE_FREQUENCY / (share * acceleration))
    return acceleration


def _require_plain(start: FirstStart) -> None:
    """Refuse what the references cannot make up for: the drive itself must know its pole pairs and its phases."""
    if start.turns_per_angle != 1:
        raise ExperimentError(
            f"The drive's electrical angle turns once in {start.turns_per_angle} electrical turns: set "
            f"{start.turns_per_angle} times as many pole pairs in the drive, and start again."
        )
    if start.direction < 0:
        raise ExperimentError(
            "The drive's angle falls where its phases turn forwards: exchange two phases, or reverse the angle in the "
            "drive, and start again."
        )


def signals_of(start: FirstStart) -> dict[str, Any]:
    """Return the signals file for recordings of a drive with this angle: angle and references are turned."""
    c, s = math.cos(start.angle_offset), math.sin(start.angle_offset)
    block = {"sample_period": "sample_period", "first_sample": "first_sample"}
    return {
        "currents": {"topic": "phase_currents", "fields": ["a", "b", "c"], **block},
        "voltages": {"topic": "phase_voltages", "fields": ["a", "b", "c"], **block},
        "resolver": {
            "topic": "resolver", "angle": "angle", "speed": "speed", "angle_offset": -start.angle_offset, **block,
        },
        "reference": {"topic": "current_reference", "fields": [{"d": c, "q": -s}, {"d": s, "q": c}], **block},
    }  # fmt: skip


def _write(path: Path, content: dict[str, Any]) -> None:
    try:
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise ExperimentError(
            f"{path} cannot be written ({error.strerror or error}): give another --output."
        ) from error
