"""Settings with a single source: a frozen dataclass whose fields carry description, unit and bounds.

The same fields feed YAML files, the command line and ROS parameters, so each default, bound and description is written
once. Fields are bool, int, float or str, one of them or ``None``, or tuples of them.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from drive_id.errors import ConfigurationError

Settings = TypeVar("Settings")

_WORDS = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("text", "texts"),
    types.NoneType: ("null", "null"),
}
_MAPPING = ("a mapping", "mappings")
_LONGEST_SHOWN = 60  # characters of a wrong value in a message: its sentence stays readable
_MOST_LISTED = 40  # names of settings in a message
_MOST_NEAR = 5
_ALIKE = 0.6  # share of common letters from which one name may be meant for another


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare one field of a settings dataclass; bounds are inclusive and hold for each entry of a tuple."""
    metadata = {"description": description, "unit": unit, "minimum": minimum, "maximum": maximum, "choices": choices}
    return dataclasses.field(default=default, metadata=metadata)


class Checked:
    """Base of settings dataclasses: finiteness, bounds and choices of all fields are checked when one is made.

    Raises ConfigurationError, which names the field, its value and what it may be.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # those derived from it are dataclasses
            value = getattr(self, field.name)
            if isinstance(field.default, tuple) and isinstance(value, (int, float, str)):
                said = f"{field.name} is {_shown(value)}: it must be a sequence, as ({_shown(value)},)."
                raise ConfigurationError(said)
            for entry in value if isinstance(value, (tuple, list)) else (value,):
                _check_entry(field, entry)


def _check_entry(field: dataclasses.Field[Any], value: Any) -> None:
    if value is None:
        return
    unit = f" {field.metadata['unit']}" if field.metadata.get("unit") else ""
    low, high, choices = (field.metadata.get(key) for key in ("minimum", "maximum", "choices"))
    if choices and value not in choices:
        raise ConfigurationError(f"{field.name} is '{value}': it must be one of {', '.join(choices)}.")
    if isinstance(value, str) and not choices and (low is not None or high is not None):
        raise ConfigurationError(f"{field.name} is '{value}': it must be a number.")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigurationError(f"{field.name} is {value}: it must be a finite number.")
    if (low is not None and value < low) or (high is not None and value > high):
        limits = (("at least", low), ("at most", high))
        bounds = " and ".join(f"{words} {limit}{unit}" for words, limit in limits if limit is not None)
        raise ConfigurationError(f"{field.name} is {_shown(value)}{unit}: it must be {bounds}.")


def from_mapping(cls: type[Settings], mapping: Mapping[str, Any], where: str) -> Settings:
    """Build a settings dataclass from parsed YAML, strictly: whole numbers do for floats, lists for tuples.

    Raises ConfigurationError for an unknown name, a value of the wrong type, or one out of bounds; it tells ``where``
    the mapping came from, a file or option.
    """
    hints = typing.get_type_hints(cls)
    names = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]  # any dataclass type
    unknown = [str(name) for name in mapping if name not in names]
    if unknown:
        near = difflib.get_close_matches(unknown[0], names, _MOST_NEAR, 0.0) if len(names) > _MOST_LISTED else names
        which = "the settings are" if near is names else f"of {len(names)} settings, the nearest are"
        meant = difflib.get_close_matches(unknown[0], names, 1, _ALIKE)
        hint = f"did you mean '{meant[0]}'?" if meant else f"{which} {', '.join(near)}."
        raise ConfigurationError(f"'{unknown[0]:.200}' in {where} does not exist: {hint}")
    values = {name: _convert(value, hints[name], f"'{name}' in {where}") for name, value in mapping.items()}
    try:
        return cls(**values)
    except ConfigurationError as error:
        raise ConfigurationError(f"In {where}: {error}") from error


def _convert(value: Any, hint: Any, where: str) -> Any:
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    for option in options:
        if option is type(None) and value is None:
            return None
        if typing.get_origin(option) is tuple and isinstance(value, (list, tuple)):
            entry_hints = typing.get_args(option)
            variadic = len(entry_hints) == 2 and entry_hints[1] is Ellipsis
            if variadic:
                entry_hints = (entry_hints[0],) * len(value)
            if len(entry_hints) == len(value):
                return tuple(_convert(v, h, where) for v, h in zip(value, entry_hints, strict=True))
        if option is float and isinstance(value, (int, float, str)) and not isinstance(value, bool):
            try:
                return float(value)  # also of a string: YAML 1.1 takes 1e-3 for one
            except (ValueError, OverflowError):
                continue
        if option in (bool, int, str) and type(value) is option:
            return value
        if isinstance(option, type) and dataclasses.is_dataclass(option) and isinstance(value, option):
            return value  # made before, from a mapping within the mapping
    wanted = " or ".join(_wanted(option) for option in options)
    raise ConfigurationError(f"{where} is {_shown(value)}: it must be {wanted}.")


def _wanted(option: Any) -> str:
    """Describe a type in plain words, for the author of a YAML file."""
    if typing.get_origin(option) is not tuple:
        return _WORDS.get(option, _MAPPING)[0]
    entries = typing.get_args(option)
    count = "" if entries[-1] is Ellipsis else f"{len(entries)} "
    kinds = typing.get_args(entries[0]) if isinstance(entries[0], types.UnionType) else (entries[0],)
    return f"a list of {count}{' or '.join(_WORDS.get(kind, _MAPPING)[1] for kind in kinds)}"


def _shown(value: Any) -> str:
    """Return a value as text of limited length."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write out whole numbers of thousands of digits
        text = "an enormous number"
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
