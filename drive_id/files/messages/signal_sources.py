"""Where the signals of a drive are in a log: topics and fields of a bag, or columns of another file.

``docs/logs.md`` lists every field; ``tools/signals_schema.py`` derives the JSON schema from these classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drive_id.common.quantity import counted
from drive_id.common.settings import Checked, setting
from drive_id.core import frames
from drive_id.errors import ConfigurationError
from drive_id.files.messages.block_codec import LONGEST_PERIOD
from drive_id.files.messages.field_path import parse_field_path
from drive_id.types import SCALARS, FloatArray

STAMP_UNITS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "min": 6e10, "h": 3.6e12}
ANGLE_UNITS = {"rad": 1.0, "deg": 0.017453292519943295, "rev": 6.283185307179586}
SPEED_UNITS = {"rad/s": 1.0, "deg/s": 0.017453292519943295, "rev/s": 6.283185307179586, "rpm": 0.10471975511965977}
TYPESTORES = ("humble", "iron", "jazzy", "kilted", "latest")
FRAMES = ("abc", "line_to_line", "alpha_beta", "dq")
SECTIONS = ("currents", "voltages", "resolver", "reference")
VOLTAGE_SCALE = "voltage_scale"
"""Section of a scale of the voltages that is a signal of its own."""
ROTOR_SPEED = "speed"
"""Section of a speed that is recorded apart from the angle."""
NAMED_STAMPS = ("header", "log_time", "index")
BY_DC_LINK = "dc_link_voltage"
"""Optional signal that scales the voltages under its own name."""
_ROOT = 0.8660254037844386
_FROM_ALPHA_BETA = np.array([[1.0, 0.0], [-0.5, _ROOT], [-0.5, -_ROOT]])
_FROM_LINES = np.array([[1.0, 0.0, -1.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]]) / 3
"""Phase voltages of u_ab, u_bc, u_ca."""
_THIRD_LINE = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])


@dataclass(frozen=True)
class Combination:
    """A linear combination of fields: ``{i_u: 1, i_w: -1}`` in a signals file."""

    terms: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        return " ".join(f"{factor:+g}*{path}" for path, factor in self.terms)


Field = str | Combination


def _terms(entry: Field) -> tuple[tuple[str, float], ...]:
    """Return the paths of a field with their factors."""
    return entry.terms if isinstance(entry, Combination) else ((entry, 1.0),)


def _paths(entries: Sequence[Field]) -> tuple[str, ...]:
    """Return the paths of all fields, each once."""
    return tuple(dict.fromkeys(path for entry in entries for path, _ in _terms(entry)))


def _combination(entries: Sequence[Field], factors: Sequence[float]) -> FloatArray:
    """Return the matrix (F, P) from the values at the paths to the scaled fields."""
    paths = _paths(entries)
    combine = np.zeros((len(entries), len(paths)))
    for row, (entry, factor) in enumerate(zip(entries, factors, strict=True)):
        for path, share in _terms(entry):
            combine[row, paths.index(path)] = factor * share
    return combine


@dataclass(frozen=True)
class TimeSource(Checked):
    """Where the time of the samples of a signal comes from; part of every section."""

    topic: str = setting("", "Bags: name of the topic; without a leading slash it is searched for in all namespaces")
    group: str = setting("", "Other logs: channel group, table or struct that holds the columns")
    stamp: str = setting(
        "header",
        "'header' (the time of the message, or of the columns' container), 'log_time', 'index' (the number of the "
        "sample times sample_period), or the field that holds the time",
    )
    stamp_unit: str = setting("ns", "Unit of a stamp that is a plain number", choices=tuple(STAMP_UNITS))
    stamp_scale: float | None = setting(
        None, "Duration of one tick of a stamp that counts ticks, instead of stamp_unit", unit="s", minimum=1e-12
    )
    stamp_bits: int | None = setting(
        None, "Width of a stamp that counts ticks and starts again at zero, such as 32", minimum=8, maximum=63
    )
    stamp_offset: float = setting(0.0, "Added to every stamp", unit="s", minimum=-3e9, maximum=3e9)
    sample_period: float | str | None = setting(
        None, "Time between samples in s, or the field that holds it; measured when missing"
    )
    first_sample: str = setting("", "Field of the running count of a message's first sample, to notice losses")
    equally_spaced: bool = setting(
        False,
        "The samples were taken at equal intervals and the stamps only jitter: the time is the number of the sample "
        "(first_sample, or counted) times the period (sample_period, or total time over count)",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stamp_bits is not None and self.stamp in NAMED_STAMPS:
            raise ConfigurationError("stamp_bits is given without a field that counts ticks: name it by stamp.")
        if self.stamp not in NAMED_STAMPS:
            self.check_path(self.stamp, "stamp")
        if self.stamp == "index" and self.sample_period is None:
            raise ConfigurationError("stamp is 'index' without a sample_period: give the time between samples in s.")
        if isinstance(self.sample_period, str):
            self.check_path(self.sample_period, "sample_period")
        elif self.sample_period is not None and not 0 < self.sample_period < LONGEST_PERIOD:
            raise ConfigurationError(
                f"sample_period is {self.sample_period} s: it must be positive and below 10 000 s."
            )
        if self.first_sample:
            self.check_path(self.first_sample, "first_sample")

    def check_path(self, path: str, where: str) -> None:
        """Refuse a field path that is none; columns may have any name."""
        if self.topic:
            parse_field_path(path, where)

    @property
    def paths(self) -> tuple[str, ...]:
        """Fields of the values."""
        raise NotImplementedError

    def in_si_units(self, columns: list[FloatArray]) -> FloatArray:
        """Return the values (N, K) of these columns, each (N,), by ``paths``, in SI units and electrical radians.

        Phase quantities are (N, 3), or d and q (N, 2) in the frame of the resolver; the rotor has angle and speed.
        """
        raise NotImplementedError

    @property
    def tick(self) -> float:
        """Factor from a stamp that is a plain number to ns."""
        return STAMP_UNITS[self.stamp_unit] if self.stamp_scale is None else self.stamp_scale * 1e9


@dataclass(frozen=True)
class ScalarSource(TimeSource):
    """Where an optional signal, the speed or the scale of the voltages comes from."""

    field: str = setting("", "Field of the value")
    scale: float = setting(1.0, "Factor to V, degrees Celsius or Nm; may be negative")
    offset: float = setting(0.0, "Added after scaling, in V, degrees Celsius or Nm")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.field:
            raise ConfigurationError("field is missing: give the path of the value.")
        self.check_path(self.field, "field")
        if self.scale == 0.0:
            raise ConfigurationError("scale is 0: give a factor that is not zero.")

    @property
    def paths(self) -> tuple[str, ...]:
        """Field of the value."""
        return (self.field,)

    def in_si_units(self, columns: list[FloatArray]) -> FloatArray:
        """Return the scaled value (N, 1)."""
        return np.column_stack(columns) * self.scale + self.offset


@dataclass(frozen=True)
class PhaseSource(TimeSource):
    """Where currents or voltages come from."""

    fields: tuple[Field, ...] = setting(
        (),
        "Fields of phases a, b, c (with two of them, c is minus their sum), of the voltages ab, bc, ca, of alpha and "
        "beta, or of d and q, see frame; each a field, or a linear combination {field: factor, ...}",
    )
    frame: str = setting(
        "abc",
        "What the fields are: phase quantities, line-to-line voltages ab, bc, ca (or the first two), components "
        "alpha, beta, or components d, q",
        choices=FRAMES,
    )
    angle: str = setting(
        "",
        "frame dq: field of the angle of the d axis against phase a, electrical, in the same message; the angle of "
        "the resolver when missing",
    )
    angle_unit: str = setting("rad", "Unit of this angle", choices=tuple(ANGLE_UNITS))
    angle_advance: float = setting(
        0.0,
        "frame dq: sample periods by which the angle of the inverse transformation is ahead of the angle, times speed",
        minimum=-5.0,
        maximum=5.0,
    )
    scale: float | tuple[float, ...] | str | ScalarSource = setting(  # noqa: RUF009  # a field, not a shared value
        1.0,
        "Factor to SI units, of all fields or of each, may be negative; for voltages that are duty cycles, "
        "dc_link_voltage (the optional signal), or {topic: ..., field: ...}, interpolated",
    )
    offset: float | tuple[float, ...] = setting(0.0, "Added after scaling, to all fields or to each, in A or V")
    decimation: int = setting(
        1,
        "Voltages: the log holds every n-th sample of the control; the voltages between them are interpolated in the "
        "rotor frame",
        minimum=1,
        maximum=1000,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = {"abc": (2, 3), "line_to_line": (2, 3), "alpha_beta": (2,), "dq": (2,)}[self.frame]
        if len(self.fields) not in counts:
            wanted = "two" if counts == (2,) else "two or three"
            kind = "phases" if self.frame == "abc" else f"components of frame {self.frame}"
            raise ConfigurationError(f"fields names {len(self.fields)} {kind}: give the paths of {wanted}.")
        if len(set(self.fields)) != len(self.fields):
            raise ConfigurationError("fields names the same path twice: give one path per phase.")
        for path in _paths(self.fields):
            self.check_path(path, "fields")
        if self.angle:
            self.check_path(self.angle, "angle")
        if self.frame != "dq" and (self.angle or self.angle_advance):
            raise ConfigurationError(f"angle belongs to frame dq, not {self.frame}: set frame: dq, or remove it.")
        if isinstance(self.scale, str) and self.scale != BY_DC_LINK:
            raise ConfigurationError(
                f"scale is '{self.scale}': give numbers, or {BY_DC_LINK} or {{topic: ..., field: ...}} for duty cycles."
            )
        if 0.0 in self.factors or len(self.factors) != len(self.fields):
            raise ConfigurationError(
                f"scale is {self.scale}: give one factor, or one per phase, and none of them zero."
            )
        if isinstance(self.offset, tuple) and len(self.offset) != len(self.fields):
            raise ConfigurationError(f"offset is {self.offset}: give one, or one per field.")

    @property
    def scaled_by(self) -> str:
        """Section of the signal that scales these; empty for none."""
        if isinstance(self.scale, ScalarSource):
            return VOLTAGE_SCALE
        return BY_DC_LINK if self.scale == BY_DC_LINK else ""

    @property
    def factors(self) -> tuple[float, ...]:
        """Factor of each entry of ``fields``, besides the signal that scales them."""
        if isinstance(self.scale, (str, ScalarSource)):
            return (1.0,) * len(self.fields)
        return self.scale if isinstance(self.scale, tuple) else (self.scale,) * len(self.fields)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Offset of each entry of ``fields``."""
        return self.offset if isinstance(self.offset, tuple) else (self.offset,) * len(self.fields)

    @property
    def paths(self) -> tuple[str, ...]:
        """Fields of the values, each once; the last is the angle of components d and q, if they have their own."""
        return (*_paths(self.fields), self.angle) if self.angle else _paths(self.fields)

    @property
    def by_rotor(self) -> bool:
        """Whether these are d and q components of the resolver's angle: only then known in phases once joined."""
        return self.frame == "dq" and not self.angle

    def in_si_units(self, columns: list[FloatArray]) -> FloatArray:
        """Return phase quantities (N, 3); components d and q (N, 2) if these are of the resolver's angle."""
        if self.frame == "abc" and all(isinstance(entry, str) for entry in self.fields):
            pairs = zip(columns, self.factors, self.offsets, strict=True)
            phases = [column * factor + offset if offset else column * factor for column, factor, offset in pairs]
            return np.column_stack(phases if len(phases) == 3 else [*phases, -phases[0] - phases[1]])
        values = columns[:-1] if self.angle else columns
        matrix = np.asarray(self._to_phases @ _combination(self.fields, self.factors))
        found = np.column_stack(values) @ matrix.T + self._to_phases @ np.array(self.offsets)
        if not self.angle:
            return np.asarray(found)
        return frames.to_abc(found, columns[-1] * ANGLE_UNITS[self.angle_unit])

    @property
    def _to_phases(self) -> FloatArray:
        """From the scaled fields to phases, or to d and q."""
        count = len(self.fields)
        if self.frame == "dq":
            return np.eye(2)
        if self.frame == "alpha_beta":
            return _FROM_ALPHA_BETA
        whole = np.eye(3) if count == 3 else _THIRD_LINE
        return np.asarray(_FROM_LINES @ whole) if self.frame == "line_to_line" else whole


@dataclass(frozen=True)
class RotorSource(TimeSource):
    """Where rotor angle and speed come from."""

    angle: str = setting("", "Field of the angle; method static needs only the speed")
    angle_unit: str = setting("rad", "Unit of the angle", choices=(*ANGLE_UNITS, "counts"))
    counts_per_turn: float | None = setting(
        None, "angle_unit counts: counts of the encoder per revolution, all edges included", minimum=1.0
    )
    angle_modulus: float | None = setting(
        None,
        "Value of the field at which it starts again, such as 65536, unless that is a whole number of revolutions",
        minimum=1e-9,
    )
    angle_scale: float = setting(1.0, "Factor to the unit, for instance -1 or 2*pi/65536")
    angle_offset: float = setting(
        0.0, "Electrical angle to add, so that zero is the magnet axis on phase a", unit="rad"
    )
    direction: int = setting(1, "-1 if angle and speed count against the order of the phases", minimum=-1, maximum=1)
    speed: str | ScalarSource = setting(  # noqa: RUF009  # a field, not a shared value
        "", "Field of the speed, or {topic: ..., field: ...} elsewhere; derived from the angle when missing"
    )
    speed_unit: str = setting("rad/s", "Unit of the speed", choices=tuple(SPEED_UNITS))
    speed_scale: float = setting(1.0, "Factor to the unit; may be negative")
    mechanical: bool = setting(False, "Angle and speed are those of the shaft, and pole_pairs turns them electrical")
    pole_pairs: int | None = setting(None, "Needed for a mechanical angle", minimum=1, maximum=1000)
    smoothing: float | None = setting(
        None,
        "Duration over which the angle is smoothed, and the speed derived from it, for encoders of few counts: short "
        "against changes of the speed",
        unit="s",
        minimum=1e-6,
        maximum=1.0,
    )
    interpolate: bool = setting(
        False, "The angle is sampled at another rate than the currents: interpolate it by its own motion"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.angle or self.own_speed):
            raise ConfigurationError("angle is missing: give the path of the rotor angle.")
        if self.angle:
            self.check_path(self.angle, "angle")
        elif self.angle_modulus is not None or self.interpolate:
            raise ConfigurationError("angle_modulus or interpolate is given without an angle: name it, or remove them.")
        if isinstance(self.speed, str) and self.speed:
            self.check_path(self.speed, "speed")
        if self.mechanical and self.pole_pairs is None:
            raise ConfigurationError("pole_pairs is missing: a mechanical angle needs it.")
        if not self.mechanical and self.pole_pairs is not None:
            raise ConfigurationError("pole_pairs is given for an electrical angle: set mechanical: true or remove it.")
        if 0.0 in (self.angle_scale, self.speed_scale):
            raise ConfigurationError("angle_scale or speed_scale is 0: give a factor that is not zero.")
        if self.direction == 0:
            raise ConfigurationError("direction is 0: give 1 or -1.")
        if (self.angle_unit == "counts") != (self.counts_per_turn is not None):
            raise ConfigurationError("angle_unit: counts and counts_per_turn belong together: give both or neither.")

    @property
    def own_speed(self) -> str:
        """Field of the speed beside the angle; empty for none."""
        return self.speed if isinstance(self.speed, str) else ""

    @property
    def paths(self) -> tuple[str, ...]:
        """Fields of the angle and of the speed beside it, those that are there."""
        return tuple(filter(None, (self.angle, self.own_speed)))

    def in_si_units(self, columns: list[FloatArray]) -> FloatArray:
        """Return angle, rad, and speed, rad/s, both electrical (N, 2); one of them (N, 1) if the other is missing."""
        if not self.angle:
            return columns[0][:, None] * self.speed_factor
        scaled = [columns[0] * self.angle_factor + self.angle_offset]
        return np.column_stack([*scaled, *(column * self.speed_factor for column in columns[1:])])

    @property
    def angle_factor(self) -> float:
        """Factor from the field to electrical radians."""
        unit = ANGLE_UNITS["rev"] / self.counts_per_turn if self.counts_per_turn else ANGLE_UNITS[self.angle_unit]
        return self.direction * self.angle_scale * unit * (self.pole_pairs or 1)

    @property
    def speed_factor(self) -> float:
        """Factor from the field to electrical rad/s."""
        return self.direction * self.speed_scale * SPEED_UNITS[self.speed_unit] * (self.pole_pairs or 1)


@dataclass(frozen=True)
class ReferenceSource(TimeSource):
    """Where the current references in the rotor frame come from."""

    fields: tuple[Field, ...] = setting(
        ("d", "q"), "Fields of the d and the q current, or linear combinations {field: factor, ...}"
    )
    scale: float = setting(1.0, "Factor to A")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.fields) != 2:
            raise ConfigurationError(f"fields names {counted(len(self.fields), 'current')}: give the paths of d and q.")
        for path in self.paths:
            self.check_path(path, "fields")

    @property
    def paths(self) -> tuple[str, ...]:
        """Fields of the values, each once."""
        return _paths(self.fields)

    def in_si_units(self, columns: list[FloatArray]) -> FloatArray:
        """Return the currents in d and q (N, 2), A."""
        if len(columns) == 2 and all(isinstance(entry, str) for entry in self.fields):
            return np.column_stack(columns) * self.scale
        return np.asarray(np.column_stack(columns) @ _combination(self.fields, (self.scale,) * 2).T)


_OURS: dict[str, Any] = {"sample_period": "sample_period", "first_sample": "first_sample"}
"""Where all our own messages hold their time."""


def our_scalar(name: str) -> ScalarSource:
    """Return where our own messages hold an optional signal."""
    return ScalarSource(name, **_OURS, field="value")


def _our_phases(topic: str) -> PhaseSource:
    return PhaseSource(topic, **_OURS, fields=("a", "b", "c"))


@dataclass(frozen=True)
class SignalMap:
    """The signals of one drive in a log; by default, those of our own messages."""

    currents: PhaseSource = field(default_factory=lambda: _our_phases("phase_currents"))  # measured, A
    voltages: PhaseSource = field(default_factory=lambda: _our_phases("phase_voltages"))  # commanded, V
    resolver: RotorSource = field(
        default_factory=lambda: RotorSource("resolver", **_OURS, angle="angle", speed="speed")
    )
    reference: ReferenceSource | None = field(default_factory=lambda: ReferenceSource("current_reference", **_OURS))
    """Optional in the log even when it is given here."""
    optional: dict[str, ScalarSource] = field(default_factory=lambda: {name: our_scalar(name) for name in SCALARS})
    """By their names in :class:`~drive_id.types.Samples`; each may be missing in the log."""
    typestore: str = "jazzy"
    """ROS distribution whose message definitions are used for bags that carry none."""
    definitions: dict[str, str] = field(default_factory=dict)
    """More message definitions, type name to ``.msg`` text, for bags that carry none."""
    guessed: dict[str, list[int]] = field(default_factory=dict)
    """Settings that a signals file still marks as guesses, ``sample_period: 0.0001  # EDIT``, with their lines."""

    def sources(self) -> dict[str, TimeSource]:
        """Return the sources by name of their section, or of the optional signal."""
        found: dict[str, TimeSource | None] = {name: getattr(self, name) for name in SECTIONS}
        if isinstance(self.voltages.scale, ScalarSource):
            found[VOLTAGE_SCALE] = self.voltages.scale
        if isinstance(self.resolver.speed, ScalarSource):
            found[ROTOR_SPEED] = self.resolver.speed
        return {name: source for name, source in found.items() if source is not None} | self.optional

    @property
    def needed(self) -> tuple[str, ...]:
        """Sections that a log must hold."""
        scale = self.voltages.scaled_by
        speed = (ROTOR_SPEED,) if isinstance(self.resolver.speed, ScalarSource) else ()
        return ("currents", "voltages", "resolver", *speed, *([scale] if scale else []))

    @property
    def of_columns(self) -> bool:
        """Whether the signals are columns, not fields of topics."""
        return not self.currents.topic

    @property
    def turned(self) -> frozenset[str] | None:
        """Which of currents and voltages are in d and q; None for our own topics, to which a bridge may turn them."""
        if (self.currents, self.voltages) == (_our_phases("phase_currents"), _our_phases("phase_voltages")):
            return None
        return frozenset(name for name in ("currents", "voltages") if getattr(self, name).frame == "dq")

    @property
    def at_once(self) -> bool:
        """Whether a log must be read as a whole, for its time, angle or voltages depend on all of it."""
        rotor = self.resolver
        spaced = any(source.equally_spaced for source in self.sources().values())
        moved = rotor.interpolate or rotor.smoothing is not None or not isinstance(rotor.speed, str)
        return spaced or moved or self.voltages.decimation > 1
