"""Signals files: which topics and fields of a bag, or columns of another log, hold the signals of a drive.

The defaults describe the messages of ``drive_id_msgs``. ``docs/logs.md`` lists every field.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import yaml

from drive_id.common.arguments import path_of
from drive_id.common.settings import from_mapping
from drive_id.errors import ConfigurationError
from drive_id.files.inputs.input_file import read_text_input, reason
from drive_id.files.inputs.yaml_tree import line_of, load_yaml
from drive_id.files.messages.signal_sources import (
    BY_DC_LINK,
    TYPESTORES,
    Combination,
    PhaseSource,
    ReferenceSource,
    RotorSource,
    ScalarSource,
    SignalMap,
    TimeSource,
    our_scalar,
)
from drive_id.types import SCALARS

__all__ = ["SignalMap", "our_scalar", "parse_signals", "read_signals"]

Source = TypeVar("Source", bound=TimeSource)

_LARGEST_FILE = 1 << 20  # bytes: a file with embedded definitions has some kB
_MOST_ENTRIES = 10_000  # aliases followed
DEFAULTS = "defaults"
"""Section with what all others share: topic or group, stamps and sample period."""
_TIME = tuple(item.name for item in fields(TimeSource))
_GUESS = re.compile(r"\s*([^#\s].*?)\s*#\s*EDIT\b")
"""A setting, with the mark by which a draft says that it is a guess."""
_NESTED: dict[type, tuple[str, ...]] = {
    PhaseSource: ("scale",),
    RotorSource: ("speed",),
    ReferenceSource: (),
    ScalarSource: (),
}
"""Fields of a section that may name a signal of their own."""


def signals_of(given: str | os.PathLike[str] | SignalMap | None) -> SignalMap | None:
    """Return the signals that a user passes, the path of a signals file or what was read from one; None for none.

    Raises ConfigurationError for anything else, and where the file is wrong.
    """
    if given is None or isinstance(given, SignalMap):
        return given
    return read_signals(path_of(given, "signals", "give the path of a signals file"))


def read_signals(path: Path) -> SignalMap:
    """Read a signals file; raises ConfigurationError naming file, section, line and field of what is wrong."""
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
    known = (*(item.name for item in fields(SignalMap) if item.name != "guessed"), DEFAULTS)
    for name in tree:
        if name not in known:
            raise ConfigurationError(
                f"{where} has a section '{name:.200}': the sections are {', '.join(known)}{_nearest(name, known)}."
            )
    common = _common(tree, f"{where}, line {lines.get(DEFAULTS)}, section '{DEFAULTS}'")
    values: dict[str, Any] = {}
    kinds = {"currents": PhaseSource, "voltages": PhaseSource, "resolver": RotorSource, "reference": ReferenceSource}
    by_topic = any(isinstance(tree.get(name), dict) and "topic" in {**common, **tree[name]} for name in kinds)
    for name, kind in kinds.items():
        if name not in tree:
            if name != "reference":
                raise ConfigurationError(f"{where} has no section '{name}': add it, with at least a topic.")
            values[name] = None
            continue
        section = f"{where}, line {lines[name]}, section '{name}'"
        values[name] = _source(kind, tree[name], section, common, by_topic=by_topic)
    section = f"{where}, line {lines.get('optional')}, section 'optional'"
    values["optional"] = _optional(tree.get("optional", {}), section, common, by_topic=by_topic)
    _check_scales(values, where)
    values["typestore"] = tree.get("typestore", "jazzy")
    if values["typestore"] not in TYPESTORES:
        raise ConfigurationError(
            f"typestore in {where} is '{values['typestore']}': it must be one of {', '.join(TYPESTORES)}."
        )
    values["definitions"] = _definitions(tree.get("definitions", {}), where)
    values["guessed"] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if marked := _GUESS.match(line):
            values["guessed"].setdefault(marked[1], []).append(number)
    return SignalMap(**values)


def _common(tree: dict[str, Any], section: str) -> dict[str, Any]:
    """Return what the section ``defaults`` says for all others: topic, time and period."""
    found = tree.get(DEFAULTS, {})
    if not isinstance(found, dict):
        raise ConfigurationError(f"{section} is not a mapping: write 'stamp: ...' and so on below it.")
    from_mapping(TimeSource, found, section)
    return found


def _source(kind: type[Source], tree: Any, section: str, common: dict[str, Any], *, by_topic: bool) -> Source:
    if not isinstance(tree, dict):
        raise ConfigurationError(f"{section} is not a mapping: write 'topic: ...' and so on below it.")
    values: dict[Any, Any] = common | tree
    odd = next((name for name in values if not isinstance(name, str)), None)
    if odd is not None:
        raise ConfigurationError(f"{section} sets '{odd!r:.60}', which is no name: write 'topic: ...' and so on.")
    for name in _NESTED[kind]:
        if isinstance(values.get(name), dict):
            inherited = {} if {"topic", "group"} & set(values[name]) else values
            time = {key: inherited[key] for key in _TIME if key in inherited}
            values[name] = _source(ScalarSource, values[name], f"{name} in {section}", common | time, by_topic=by_topic)
    if kind is not ScalarSource and isinstance(values.get("fields"), list):
        values["fields"] = [_combined(entry, section) for entry in values["fields"]]
    source = from_mapping(kind, values, section)
    if by_topic and not source.topic:
        raise ConfigurationError(f"In {section}: topic is missing: name the topic of the signal.")
    return source


def _combined(entry: Any, section: str) -> Any:
    """Return a linear combination for a mapping of fields to factors, and anything else as it is."""
    if not isinstance(entry, dict):
        return entry
    try:
        terms = tuple((path, float(factor)) for path, factor in entry.items() if not isinstance(factor, bool))
    except (TypeError, ValueError, OverflowError):
        terms = ()
    good = all(isinstance(path, str) and math.isfinite(factor) and factor for path, factor in terms)
    if not good or not terms or len(terms) < len(entry):
        raise ConfigurationError(
            f"fields in {section} holds {entry!s:.80}: a linear combination is {{field: factor, ...}} with factors "
            "other than zero."
        )
    return Combination(terms)


def _nearest(name: str, known: Sequence[str]) -> str:
    """Return a clause that names the known name most like another; empty if none is."""
    near = difflib.get_close_matches(str(name), known, 1, 0.5)
    return f" (did you mean '{near[0]}'?)" if near else ""


def _optional(tree: Any, section: str, common: dict[str, Any], *, by_topic: bool) -> dict[str, ScalarSource]:
    if not isinstance(tree, dict):
        raise ConfigurationError(f"{section} is not a mapping: write the name of a signal and so on below it.")
    unknown = [name for name in tree if name not in SCALARS]
    if unknown:
        raise ConfigurationError(
            f"{section} has a signal '{unknown[0]:.200}': the signals are {', '.join(SCALARS)}"
            f"{_nearest(unknown[0], SCALARS)}."
        )
    return {
        name: _source(ScalarSource, entry, f"{section}, signal '{name}'", common, by_topic=by_topic)
        for name, entry in tree.items()
    }


def _check_scales(values: dict[str, Any], where: str) -> None:
    """Check that only voltages are duty cycles or decimated, and that the DC-link voltage is there for them."""
    currents, voltages = values["currents"], values["voltages"]
    if currents.scaled_by:
        said = BY_DC_LINK if currents.scaled_by == BY_DC_LINK else "another signal"
        raise ConfigurationError(f"scale in section 'currents' of {where} is {said}: give the factor to A.")
    if currents.decimation != 1:
        raise ConfigurationError(f"decimation in section 'currents' of {where} belongs to the voltages: move it there.")
    if currents.frame == "line_to_line":
        raise ConfigurationError(f"frame in section 'currents' of {where} is line_to_line: only voltages are.")
    if voltages.scaled_by == BY_DC_LINK and BY_DC_LINK not in values["optional"]:
        raise ConfigurationError(
            f"The voltages in {where} are scaled by {BY_DC_LINK}, which is not there: add it in section 'optional'."
        )


def _definitions(tree: Any, where: str) -> dict[str, str]:
    valid = isinstance(tree, dict) and all(
        isinstance(key, str) and isinstance(value, str) and re.fullmatch(r"\w+/msg/\w+", key)
        for key, value in tree.items()
    )
    if not valid:
        raise ConfigurationError(f"definitions in {where} must map types like my_msgs/msg/State to the text of a .msg.")
    return dict(tree)


def _parsed_yaml(text: str, where: str) -> tuple[dict[str, Any], dict[str, int]]:
    """Return the top-level mapping and the line of each of its sections; refuses keys that are given twice."""
    lines: dict[str, int] = {}

    def look(node: yaml.Node) -> None:
        if isinstance(node, yaml.MappingNode):
            lines.update((str(key.value), key.start_mark.line + 1) for key, _ in node.value)
            _refuse_duplicates(node, where)

    try:
        tree = load_yaml(text, _MOST_ENTRIES, look)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, ValueError) and not isinstance(error, UnicodeError):
            raise ConfigurationError(f"{where} cannot be read as YAML ({error}): correct it.") from error
        line = f" in line {number}" if (number := line_of(error)) else ""
        raise ConfigurationError(f"{where} is not YAML{line}: correct its indentation and punctuation.") from error
    tree = {} if tree is None else tree
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
