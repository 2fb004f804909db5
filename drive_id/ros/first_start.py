"""First start of a drive without load machine: its angle, the acceleration of its shaft, and the files that say so."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import yaml

from drive_id.core.experiment.encoder import Encoder
from drive_id.core.experiment.first_start import FirstStart, NoSwingError, first_start, shaft_acceleration
from drive_id.core.experiment.free_shaft import FASTEST_SWING, swing_frequency
from drive_id.core.experiment.settings import FIRST_START, FREE_SHAFT, ExperimentSettings, make_trajectory
from drive_id.errors import ExperimentError
from drive_id.fitting.sources import read_bag
from drive_id.ros.bench import Bench
from drive_id.ros.conductor import Conductor

SIGNALS = "signals.yaml"
PARAMETERS = "trajectory_publisher.yaml"
DRIVE = "drive.yaml"
_SHAKE_FREQUENCY = 25.0
"""Hz: slow enough for the current controllers, so fast that the shaft turns by a part of a revolution only."""
_SHAKE_TIME = 1.0  # s
_GENTLE = 0.2
"""Amplitude of the first shake by i_max, which tells how far the next one may go; twice as much where it moves nothing:
the inverter's drop can keep a slow controller from driving the current, and friction the shaft from swinging."""
_STRONG = 0.8
"""Largest amplitude, which leaves room for the overshoot of a controller that does not know the machine."""
_SLEW_MARGIN = 1.05
"""Slew rate of the publisher by the steepest slope of the trajectory, which it must not cut."""
_NOTABLE = 0.9
"""Amplitude relative to i_max below which a result says so."""
_SALIENT = 2.0
"""Largest torque relative to that at the frequency of i_q from which on reluctance prevails."""
_SALIENT_SWING = 10.0
"""Fastest swing then, Hz: 8 % of the bandwidth of a usual current controller. Faster ones have exceeded 1.2 i_max."""
_LARGEST_REST = math.radians(3.0)
"""Offset that may be left when the drive has taken what was found: more than two first starts ever differ by."""
_LARGEST_TURN = math.radians(10.0)
"""Offset up to which turned references suffice: a controller that decouples in axes further off has exceeded 1.2 i_max
with interior-magnet machines."""


@dataclass(frozen=True)
class Commissioned:
    """A drive that is ready for trajectory ``free_shaft``."""

    start: FirstStart
    acceleration: float  # electrical, by the largest current, T_max p / J, rad/s^2
    amplitude: float  # of the swing, relative to i_max: less than wanted where the rotor is too light for its torque
    signals: Path  # signals file for its recordings
    parameters: Path  # of the publisher
    encoder: Encoder | None = None  # what was written into the drive; start is what is left since

    def sentence(self) -> str:
        """Return the result as one sentence."""
        written = "" if self.encoder is None else f"The drive took {self.encoder.sentence()}. "
        reduced = ""
        if self.amplitude < _NOTABLE:
            reduced = (
                f" The rotor is too light for its torque, so the swing takes {100 * self.amplitude:.0f} % of i_max: "
                "add inertia, which makes it slower, to map more."
            )
        return written + self._found() + reduced

    def _found(self) -> str:
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
    bench: Bench | Conductor, folder: Path, name: str, say: Callable[[str, str], None], *, angle_known: bool = False
) -> Commissioned:
    """Run the first start, configure the publisher by its result, and write the files of the result.

    Parameters
    ----------
    bench : Bench or Conductor
        Ready; ``shaft_speed_max`` of its publisher is set.
    folder : Path
        For the files; exists.
    name : str
        Of the recordings, to which ``_first_start``, ``_shake_1``, ``_shake_2`` and so on are added.
    say : callable
        Called with a word, Turning or Shaking, and a sentence on what is done.
    angle_known : bool
        The publisher's ``angle_offset`` is right already: only shake.

    Raises
    ------
    ExperimentError
        When the result is not clear, or the drive has to be set up differently.

    Notes
    -----
    Where the bench knows the node of the drive, the angle is entered there, and a second first start verifies it.
    """
    limit = bench.publisher_value("shaft_speed_max")
    if not limit > 0:
        raise ExperimentError(
            "trajectory_publisher has no shaft_speed_max: set the highest electrical speed of the free shaft, rad/s."
        )
    kept = {key: bench.publisher_value(key) for key in ("duration", "mean_speed", "amplitude", "swing_frequency")}
    i_max = bench.publisher_value("i_max")
    if angle_known:
        start = FirstStart((0.0,) * 3, 1, 1, bench.publisher_value("angle_offset"), math.nan, math.nan)
    else:
        say("Turning", "The current vector turns slowly, forwards and backwards.")
        start = _turned(bench, f"{name}_first_start")
    encoder = None
    if bench.drive:
        encoder, start = _entered(bench, start, name, say, angle_known=angle_known)
    _require_plain(start)
    acceleration, by_magnets = _shaken(bench, start, name, i_max, limit, say)
    if math.isnan(kept["swing_frequency"]):
        fastest = _SALIENT_SWING if acceleration > _SALIENT * by_magnets else FASTEST_SWING
        wanted = swing_frequency(kept["amplitude"] * acceleration, limit, kept["mean_speed"])
        kept["amplitude"] *= min(1.0, fastest / wanted)
    found = {"angle_offset": start.angle_offset, "shaft_acceleration": acceleration, "shaft_speed_max": limit}
    swing_up(bench, **kept, **found)
    found["amplitude"] = kept["amplitude"]
    _write(folder / PARAMETERS, {"/**": {"ros__parameters": {"trajectory": FREE_SHAFT, "i_max": i_max, **found}}})
    _write(folder / SIGNALS, signals_of(start))
    if encoder is not None:
        _write(folder / DRIVE, {"/**": {"ros__parameters": asdict(encoder)}})
    return Commissioned(start, acceleration, kept["amplitude"], folder / SIGNALS, folder / PARAMETERS, encoder)


def _entered(
    bench: Bench | Conductor, start: FirstStart, name: str, say: Callable[[str, str], None], *, angle_known: bool
) -> tuple[Encoder, FirstStart]:
    """Enter the angle in the drive and verify it; return what the drive took, and what is left of the offset."""
    before = bench.encoder()
    encoder = before.corrected_by(start)
    bench.set_encoder(encoder)
    bench.configure_publisher(angle_offset=0.0)  # a second run shall not enter it again
    if angle_known:
        return encoder, replace(start, angle_offset=0.0)
    say("Turning", f"The drive took {encoder.sentence()}; the vector turns again, to verify it.")
    left = _turned(bench, f"{name}_verified")
    if left.direction != 1 or left.turns_per_angle != 1 or abs(left.angle_offset) > _LARGEST_REST:
        bench.set_encoder(before)
        raise ExperimentError(
            f"{bench.drive} took {encoder.sentence()}, but its angle is still {math.degrees(left.angle_offset):.1f} "
            "degrees off, or turns otherwise: it must subtract the offset after direction and pole pairs, for its "
            "control and for resolver; its former parameters are back."
        )
    return encoder, left


def _turned(bench: Bench | Conductor, name: str) -> FirstStart:
    """Turn the current vector, and return what it tells of the angle."""
    bench.configure_publisher(trajectory=FIRST_START, repeat=1, angle_offset=0.0)
    return first_start(read_bag(bench.run_experiment(name).uri))


def swing_up(bench: Bench | Conductor, **changes: Any) -> None:
    """Set the publisher to trajectory ``free_shaft``, with the slew rate that it needs."""
    names = ("i_max", "shaft_acceleration", "shaft_speed_max", "mean_speed", "swing_frequency", "amplitude", "duration")
    values = {key: bench.publisher_value(key) for key in names}
    values |= changes
    known = {key: None if math.isnan(value) else value for key, value in values.items()}
    wanted: dict[str, Any] = {**known, "trajectory": FREE_SHAFT, "slew_rate": 1e9}
    slope = make_trajectory(ExperimentSettings(**wanted)).slope
    slew_rate = max(bench.publisher_value("slew_rate"), _SLEW_MARGIN * slope)
    bench.configure_publisher(**values, trajectory=FREE_SHAFT, repeat=1, slew_rate=slew_rate)


def _shaken(
    bench: Bench | Conductor, start: FirstStart, name: str, i_max: float, limit: float, say: Callable[[str, str], None]
) -> tuple[float, float]:
    """Shake the shaft, gently first; return its acceleration by i_max and that without reluctance torque, rad/s^2."""
    share, swung = _GENTLE, False
    for number in count(1):
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
        try:
            acceleration, by_magnets = (
                i_max * each for each in shaft_acceleration(samples, _SHAKE_FREQUENCY, start.angle_offset)
            )
        except NoSwingError:
            if swung or share >= _STRONG:
                raise
            share = min(2 * share, _STRONG)
            continue
        if swung:
            break
        swung = True
        # Where the torque rises with the square of the current, the swing does as well.
        share = min(_STRONG, share * math.sqrt(limit * 2 * math.pi * _SHAKE_FREQUENCY / (share * acceleration)))
    return acceleration, by_magnets


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
    if abs(start.angle_offset) > _LARGEST_TURN:
        raise ExperimentError(
            f"The drive's angle is {start.angle_offset:.4f} rad ahead of the magnet axis, and its current controller "
            f"works in axes {math.degrees(start.angle_offset):.1f} degrees off: subtract this in the drive, set "
            "angle_offset of trajectory_publisher to 0, and start again with --angle-known; or name the node of the "
            "drive, if it takes it by parameters (--drive)."
        )


def signals_of(start: FirstStart) -> dict[str, Any]:
    """Return the signals file for recordings of a drive with this angle: angle and references are turned."""
    c, s = math.cos(start.angle_offset), math.sin(start.angle_offset)
    fields = [{"d": c, "q": -s}, {"d": s, "q": c}] if s else ["d", "q"]
    block = {"sample_period": "sample_period", "first_sample": "first_sample"}
    return {
        "currents": {"topic": "phase_currents", "fields": ["a", "b", "c"], **block},
        "voltages": {"topic": "phase_voltages", "fields": ["a", "b", "c"], **block},
        "resolver": {
            "topic": "resolver", "angle": "angle", "speed": "speed", "angle_offset": -start.angle_offset, **block,
        },
        "reference": {"topic": "current_reference", "fields": fields, **block},
    }  # fmt: skip


def _write(path: Path, content: dict[str, Any]) -> None:
    try:
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise ExperimentError(
            f"{path} cannot be written ({error.strerror or error}): give another --output."
        ) from error
