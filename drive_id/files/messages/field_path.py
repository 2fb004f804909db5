"""Field paths of a signals file: ``state.current[0]``, ``samples[:].a``, ``data[0::3]``."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_INDEX = re.compile(r"\[(-?\d+)\]")
_SLICE = re.compile(r"\[(-?\d*):(-?\d*)(?::(\d+))?\]")


class FieldPathError(ValueError):
    """A message has no such field; the text names those it has."""


@dataclass
class FieldPath:
    """A parsed path: field names, indices and slices, applied from left to right; after a slice, to each element."""

    text: str
    steps: tuple[str | int | slice, ...]
    _kind: type | None = field(default=None, compare=False, repr=False)
    """Type of the messages that ``_take`` reads fast: all messages of a type have the same fields."""
    _take: Callable[[Any], Any] | None = field(default=None, compare=False, repr=False)

    def values(self, message: object) -> FloatArray:
        """Return the numbers at the path as (n,) float.

        Raises FieldPathError when the message has no such field, or no numbers there.
        """
        found = self.find(message)
        if type(found) is float or type(found) is int:
            return np.array((found,), np.float64)
        if type(found) is np.ndarray and found.ndim == 1 and found.dtype.kind in "iuf":
            return found.astype(np.float64)
        if isinstance(found, (str, bytes, dict)) or dataclasses.is_dataclass(found):
            raise FieldPathError(f"'{self.text}' is not a number")
        try:
            array = np.atleast_1d(np.asarray(found, dtype=np.float64))
        except (TypeError, ValueError):
            raise FieldPathError(f"'{self.text}' is not a number or an array of numbers") from None
        if array.ndim != 1:
            raise FieldPathError(f"'{self.text}' has more than one dimension")
        return array

    def find(self, message: object) -> Any:
        """Return the value at the path; FieldPathError when there is none."""
        if self._take is not None and type(message) is self._kind:
            try:
                return self._take(message)
            except IndexError:  # the array is shorter; reported below
                self._take = None
        found = _follow(message, self.steps, self.text)
        if self._kind is not type(message) and dataclasses.is_dataclass(message):
            self._kind, self._take = type(message), _getter(message, self.steps)
        return found


def parse_field_path(text: str, where: str) -> FieldPath:
    """Parse a path; raises ConfigurationError naming ``where`` the text was found."""
    steps: list[str | int | slice] = []
    position, name_may_follow = 0, True
    while position < len(text):
        rest = text[position:]
        if name_may_follow and (match := _NAME.match(rest)):
            steps.append(match.group())
        elif steps and (match := _INDEX.match(rest)):
            steps.append(int(match.group(1)))
        elif steps and (match := _SLICE.match(rest)):
            low, high, step = (int(part) if part else None for part in match.groups())
            if step == 0:
                break
            steps.append(slice(low, high, step))
        else:
            break
        position += match.end()
        name_may_follow = text[position : position + 1] == "."
        position += name_may_follow
    if not steps or position < len(text) or name_may_follow:
        raise ConfigurationError(f"{where} is '{text}': write a field path like state.current[0] or data[0::3].")
    return FieldPath(text, tuple(steps))


def _getter(message: Any, steps: Sequence[str | int | slice]) -> Callable[[Any], Any] | None:
    """Return a fast getter for steps to a value in a message; None if they slice arrays or enter mappings."""
    getters: list[Callable[[Any], Any]] = []
    value = message
    for step in steps:
        if isinstance(step, slice) or isinstance(value, dict):
            return None
        name = step
        if isinstance(name, str) and not hasattr(value, name):
            name = f"{name}_"
        getters.append(attrgetter(name) if isinstance(name, str) else itemgetter(name))
        value = getters[-1](value)
    if len(getters) == 1:
        return getters[0]

    def take(message: Any) -> Any:
        for getter in getters:
            message = getter(message)
        return message

    return take


def _follow(value: Any, steps: Sequence[str | int | slice], text: str) -> Any:
    for number, step in enumerate(steps):
        if isinstance(step, str):
            if isinstance(value, dict) and step in value:  # decoded JSON
                value = value[step]
                continue
            names = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
            names += [str(name) for name in value] if isinstance(value, dict) else []
            if step not in names and f"{step}_" not in names:  # rosbags renames Python's keywords
                has = f"it has {', '.join(names)}" if names else "there are no fields there"
                raise FieldPathError(f"'{text}' asks for the field '{step}', but {has}")
            value = getattr(value, step if step in names else f"{step}_")
            continue
        if not isinstance(value, (np.ndarray, list, tuple)):
            raise FieldPathError(f"'{text}' takes an element of a field that is not an array")
        if isinstance(step, int):
            if not -len(value) <= step < len(value):
                raise FieldPathError(f"'{text}' asks for element {step} of an array of {len(value)}")
            value = value[step]
            continue
        value = value[step]
        rest = steps[number + 1 :]
        return [_follow(entry, rest, text) for entry in value] if rest else value
    return value
