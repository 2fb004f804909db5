"""Signals files: which topics and fields of a bag hold the currents, voltages, rotor position and optional signals.

The defaults describe the messages of ``drive_id_msgs``. ``config/signals_example_stranger.yaml`` shows every field.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import yaml

from drive_id.errors import ConfigurationError
from drive_id.files.inputs.input_file import read_text_input, reason
from drive_id.files.inputs.yaml_tree import check_node, check_text
from drive_id.files.messages.field_path import parse_field_path
from drive_id.settings import check, from_mapping, setting
from drive_id.types import SCALARS

Source = TypeVar("Source")

STAMP_UNITS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
ANGLE_UNITS = {"rad": 1.0, "deg": 0.017453292519943295, "rev": 6.283185307179586}
SPEED_UNITS = {"rad/s": 1.0, "deg/s": 0.017453292519943295, "rev/s": 6.283185307179586, "rpm": 0.10471975511965977}
TYPESTORES = ("humble", "iron", "jazzy", "kilted", "latest")
_LARGEST_FILE, _MOST_ENTRIES = 1 << 20, 10_000
_SECTIONS = ("currents", "voltages", "resolver", "reference")
_BY_DC_LINK = "dc_link_voltage"


@dataclass(frozen=True)
class TimeSource:
    """Where the time of the samples of a topic comes from; part of every section."""

    topic: str = setting("", "Name of the topic; without a leading slash it is searched for in all namespaces")
    stamp: str = setting("header", "'header', 'log_time', or the path of a field that holds the time")
    stamp_unit: str = setting("ns", "Unit of a stamp that is a plain number", choices=tuple(STAMP_UNITS))
    stamp_offset: float = setting(0.0, "Added to every stamp", unit="s", minimum=-3e9, maximum=3e9)
    sample_period: float | str | None = setting(
        None, "Time between samples in s, or the path of a field that holds it; measured when missing"
    )
    first_sample: str = setting("", "Path of the running count of a message's first sample, to notice losses")

    def __post_init__(self) -> None:
        check(self)
        if not self.topic:
            raise ConfigurationError("topic is missing: name the topic of the signal.")
        if self.stamp not in ("header", "log_time"):
            parse_field_path(self.stamp, "stamp")
        if isinstance(self.sample_period, str):
            parse_field_path(self.sample_period, "sample_period")
        elif self.sample_period is not None and not 0 < self.sample_period < 1e4:
            raise ConfigurationError(f"sample_period is {self.sample_period} s: it must be positive.")
        if self.first_sample:
            parse_field_path(self.first_sample, "first_sample")


@dataclass(frozen=True)
class PhaseSource(TimeSource):
    """Where three phase quantities come from."""

    fields: tuple[str, ...] = setting((), "Paths of phases a, b, c; with two of them, c is minus their sum")
    scale: float | tuple[float, ...] | str = setting(
        1.0,
        "Factor to SI units, of all phases or of each, may be negative; dc_link_voltage, for voltages that are duty "
        "cycles, multiplies them by this optional signal",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.fields) not in (2, 3):
            raise ConfigurationError(f"fields names {len(self.fields)} phases: give the paths of two or three.")
        if len(set(self.fields)) != len(self.fields):
            raise ConfigurationError("fields names the same path twice: give one path per phase.")
        for path in self.fields:
            parse_field_path(path, "fields")
        if isinstance(self.scale, str) and not self.duty_cycles:
            raise ConfigurationError(f"scale is '{self.scale}': give numbers, or {_BY_DC_LINK} for duty cycles.")
        if 0.0 in self.factors or len(self.factors) != len(self.fields):
            raise ConfigurationError(
                f"scale is {self.scale}: give one factor, or one per phase, and none of them zero."
            )

    @property
    def duty_cycles(self) -> bool:
        """Whether these are fractions of the DC-link voltage."""
        return self.scale == _BY_DC_LINK

    @property
    def factors(self) -> tuple[float, ...]:
        """Factor of each phase in ``fields``, besides the DC-link voltage for duty cycles."""
        if isinstance(self.scale, str):
            return (1.0,) * len(self.fields)
        return self.scale if isinstance(self.scale, tuple) else (self.scale,) * len(self.fields)


@dataclass(frozen=True)
class RotorSource(TimeSource):
    """Where rotor angle and speed come from."""

    angle: str = setting("", "Path of the angle")
    angle_unit: str = setting("rad", "Unit of the angle", choices=tuple(ANGLE_UNITS))
    angle_scale: float = setting(1.0, "Factor to the unit, for instance -1 or 2*pi/65536")
    angle_offset: float = setting(
        0.0, "Electrical angle to add, so that zero is the magnet axis on phase a", unit="rad"
    )
    speed: str = setting("", "Path of the speed; derived from the angle when missing")
    speed_unit: str = setting("rad/s", "Unit of the speed", choices=tuple(SPEED_UNITS))
    speed_scale: float = setting(1.0, "Factor to the unit; may be negative")
    mechanical: bool = setting(False, "Angle and speed are those of the shaft, and pole_pairs turns them electrical")
    pole_pairs: int | None = setting(None, "Needed for a mechanical angle", minimum=1, maximum=1000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.angle:
            raise ConfigurationError("angle is missing: give the path of the rotor angle.")
        parse_field_path(self.angle, "angle")
        if self.speed:
            parse_field_path(self.speed, "speed")
        if self.mechanical and self.pole_pairs is None:
            raise ConfigurationError("pole_pairs is missing: a mechanical angle needs it.")
        if not self.mechanical and self.pole_pairs is not None:
            raise ConfigurationError("pole_pairs is given for an electrical angle: set mechanical: true or remove it.")
        if 0.0 in (self.angle_scale, self.speed_scale):
            raise ConfigurationError("angle_scale or speed_scale is 0: give a factor that is not zero.")

    @property
    def angle_factor(self) -> float:
        """Factor from the field to electrical radians."""
        return self.angle_scale * ANGLE_UNITS[self.angle_unit] * (self.pole_pairs or 1)

    @property
    def speed_factor(self) -> float:
        """Factor from the field to electrical rad/s."""
        return self.speed_scale * SPEED_UNITS[self.speed_unit] * (self.pole_pairs or 1)


@dataclass(frozen=True)
class ReferenceSource(TimeSource):
    """Where the current references in the rotor frame come from."""

    fields: tuple[str, ...] = setting(("d", "q"), "Paths of the d and the q current")
    scale: float = setting(1.0, "Factor to A")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.fields) != 2:
            raise ConfigurationError(f"fields names {len(self.fields)} currents: give the paths of d and q.")
        for path in self.fields:
            parse_field_path(path, "fields")


@dataclass(frozen=True)
class ScalarSource(TimeSource):
    """Where an optional signal comes from."""

    field: str = setting("", "Path of the value")
    scale: float = setting(1.0, "Factor to V, degrees Celsius or Nm; may be negative")
    offset: float = setting(0.0, "Added after scaling, in V, degrees Celsius or Nm")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.field:
            raise ConfigurationError("field is missing: give the path of the value.")
        parse_field_path(self.field, "field")
        if self.scale == 0.0:
            raise ConfigurationError("scale is 0: give a factor that is not zero.")


def our_scalar(name: str) -> ScalarSource:
    """Return where our own messages hold an optional signal."""
    return ScalarSource(name, sample_period="sample_period", first_sample="first_sample", field="value")


def _our_phases(topic: str) -> PhaseSource:
    return PhaseSource(topic, sample_period="sample_period", first_sample="first_sample", fields=("a", "b", "c"))


@dataclass(frozen=True)
class SignalMap:
    """The signals of one drive in a bag.

    Parameters
    ----------
    currents, voltages : PhaseSource
        Measured phase currents, A, and commanded phase voltages, V.
    resolver : RotorSource
    reference : ReferenceSource or None
        Optional in the bag even when it is given here.
    optional : dict of str to ScalarSource
        DC-link voltage, winding and magnet temperature and shaft torque, by their names in
        :class:`~drive_id.types.Samples`; each may be missing in the bag.
    typestore : str
        ROS distribution whose message definitions are used for bags that carry none.
    definitions : dict of str to str
        More message definitions, type name to ``.msg`` text, for bags that carry none.
    """

    currents: PhaseSource = field(default_factory=lambda: _our_phases("phase_currents"))
    voltages: PhaseSource = field(default_factory=lambda: _our_phases("phase_voltages"))
    resolver: RotorSource = field(
        default_factory=lambda: RotorSource(
            "resolver", sample_period="sample_period", first_sample="first_sample", angle="angle", speed="speed"
        )
    )
    reference: ReferenceSource | None = field(
        default_factory=lambda: ReferenceSource(
            "current_reference", sample_period="sample_period", first_sample="first_sample"
        )
    )
    optional: dict[str, ScalarSource] = field(default_factory=lambda: {name: our_scalar(name) for name in SCALARS})
    typestore: str = "jazzy"
    definitions: dict[str, str] = field(default_factory=dict)

    def sources(self) -> dict[str, TimeSource]:
        """Return the sources by name of their section, or of the optional signal."""
        found: dict[str, TimeSource | None] = {name: getattr(self, name) for name in _SECTIONS}
        return {name: source for name, source in found.items() if source is not None} | self.optional


def read_signals(path: Path) -> SignalMap:
    """Read a signals file.

    Raises
    ------
    ConfigurationError
        Naming file, section, line and field of what is wrong.
    """
    try:
        text = read_text_input(path, _LARGEST_FILE)
    except OSError as error:
        raise ConfigurationError(f"Signals file {path} cannot be read ({reason(error)}): check the path.") from error
    except ValueError as error:
        raise ConfigurationError(f"Signals file {path} is not a text file: give a YAML file.") from error
    return parse_signals(text, str(path))


def parse_signals(text: str, where: str) -> SignalMap:
    """Parse the text of a signals file; see :func:`read_signals`."""
    tree, lines = _parsed_yaml(text, where)
    known = tuple(item.name for item in fields(SignalMap))
    for name in tree:
        if name not in known:
            raise ConfigurationError(f"{where} has a section '{name}': the sections are {', '.join(known)}.")
    values: dict[str, Any] = {}
    kinds = {"currents": PhaseSource, "voltages": PhaseSource, "resolver": RotorSource, "reference": ReferenceSource}
    for name, kind in kinds.items():
        if name not in tree:
            if name != "reference":
                raise ConfigurationError(f"{where} has no section '{name}': add it, with at least a topic.")
            values[name] = None
            continue
        values[name] = _source(kind, tree[name], f"{where}, line {lines[name]}, section '{name}'")
    values["optional"] = _optional(
        tree.get("optional", {}), f"{where}, line {lines.get('optional')}, section 'optional'"
    )
    _check_scales(values, where)
    values["typestore"] = tree.get("typestore", "jazzy")
    if values["typestore"] not in TYPESTORES:
        raise ConfigurationError(
            f"typestore in {where} is '{values['typestore']}': it must be one of {', '.join(TYPESTORES)}."
        )
    values["definitions"] = _definitions(tree.get("definitions", {}), where)
    return SignalMap(**values)


def _source(kind: type[Source], tree: Any, section: str) -> Source:
    if not isinstance(tree, dict):
        raise ConfigurationError(f"{section} is not a mapping: write 'topic: ...' and so on below it.")
    return from_mapping(kind, tree, section)


def _optional(tree: Any, section: str) -> dict[str, ScalarSource]:
    if not isinstance(tree, dict):
        raise ConfigurationError(f"{section} is not a mapping: write the name of a signal and so on below it.")
    unknown = [name for name in tree if name not in SCALARS]
    if unknown:
        raise ConfigurationError(f"{section} has a signal '{unknown[0]}': the signals are {', '.join(SCALARS)}.")
    return {name: _source(ScalarSource, entry, f"{section}, signal '{name}'") for name, entry in tree.items()}


def _check_scales(values: dict[str, Any], where: str) -> None:
    """Check that only voltages are duty cycles, and that the DC-link voltage is there for them."""
    if values["currents"].duty_cycles:
        raise ConfigurationError(f"scale in section 'currents' of {where} is {_BY_DC_LINK}: give the factor to A.")
    if values["voltages"].duty_cycles and _BY_DC_LINK not in values["optional"]:
        raise ConfigurationError(
            f"The voltages in {where} are scaled by {_BY_DC_LINK}, which is not there: add it in section 'optional'."
        )


def _definitions(tree: Any, where: str) -> dict[str, str]:
    valid = isinstance(tree, dict) and all(
        isinstance(key, str) and isinstance(value, str) and re.fullmatch(r"\w+/msg/\w+", key)
        for key, value in tree.items()
    )
    if not valid:
        raise ConfigurationError(f"definitions in {where} must map types like my_msgs/msg/State to the text of a .msg.")
    return dict(tree)


class _Loader(yaml.SafeLoader):
    """YAML with floats as everyone writes them: ``1e-4`` is a number."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+|[-+]?(?:\d+\.\d*|\.\d+)|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
    ),
    list("-+0123456789."),
)


def _parsed_yaml(text: str, where: str) -> tuple[dict[str, Any], dict[str, int]]:
    """Return the top-level mapping and the line of each of its sections; refuses keys that are given twice."""
    loader = None
    try:
        check_text(text, _MOST_ENTRIES)
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is not None:
            check_node(node, _MOST_ENTRIES)
        lines: dict[str, int] = {}
        if isinstance(node, yaml.MappingNode):
            lines = {str(key.value): key.start_mark.line + 1 for key, _ in node.value}
            _refuse_duplicates(node, where)
        tree = loader.construct_document(node) if node is not None else {}
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, ValueError) and not isinstance(error, UnicodeError):
            raise ConfigurationError(f"{where} cannot be read as YAML ({error}): correct it.") from error
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise ConfigurationError(f"{where} is not YAML{line}: correct its indentation and punctuation.") from error
    finally:
        if loader is not None:
            loader.dispose()
    if not isinstance(tree, dict):
        raise ConfigurationError(f"{where} is not a mapping: it needs the sections currents, voltages and resolver.")
    return {str(key): value for key, value in tree.items()}, lines


def _refuse_duplicates(node: yaml.MappingNode, where: str) -> None:
    seen: set[str] = set()
    for key, value in node.value:
        if str(key.value) in seen:
            raise ConfigurationError(f"{where}, line {key.start_mark.line + 1} gives '{key.value}' twice: remove one.")
        seen.add(str(key.value))
        if isinstance(value, yaml.MappingNode):
            _refuse_duplicates(value, where)
