"""Field paths of a signals file: ``state.current[0]``, ``samples[:].a``, ``data[0::3]``."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray

_STEP = re.compile(r"(\.?)([A-Za-z][A-Za-z0-9_]*)|\[(-?\d+)\]|\[(-?\d*):(-?\d*)(?::(\d+))?\]")
"""A name, behind a dot unless it is the first step, an index, or a slice."""


class FieldPathError(ValueError):
    """A message has no such field; the text names those it has."""


@dataclass(frozen=True)
class FieldPath:
    """A parsed path: field names, indices and slices, applied from left to right; after a slice, to each element."""

    text: str
    steps: tuple[str | int | slice, ...]

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
        return _follow(message, self.steps, self.text)


def parse_field_path(text: str, where: str) -> FieldPath:
    """Parse a path; raises ConfigurationError naming ``where`` the text was found."""
    steps: list[str | int | slice] = []
    position = 0
    while match := _STEP.match(text, position):
        dot, name, index, *bounds = match.groups()
        if bool(steps) != bool(dot or name is None):
            break
        low, high, stride = (int(part) if part else None for part in bounds)
        if stride == 0:
            break
        steps.append(name or (slice(low, high, stride) if index is None else int(index)))
        position = match.end()
    if not steps or position < len(text):
        raise ConfigurationError(f"{where} is '{text}': write a field path like state.current[0] or data[0::3].")
    return FieldPath(text, tuple(steps))


def _follow(value: Any, steps: Sequence[str | int | slice], text: str) -> Any:
    for number, step in enumerate(steps):
        if isinstance(step, str):
            value = _member(value, step, text)
        elif not isinstance(value, (np.ndarray, list, tuple)):
            raise FieldPathError(f"'{text}' takes an element of a field that is not an array")
        elif isinstance(step, int):
            try:
                value = value[step]
            except IndexError:
                raise FieldPathError(f"'{text}' asks for element {step} of an array of {len(value)}") from None
        else:
            rest = steps[number + 1 :]
            return [_follow(entry, rest, text) for entry in value[step]] if rest else value[step]
    return value


def _member(value: Any, name: str, text: str) -> Any:
    """Return a field of a message, or of decoded JSON; rosbags renames those that are keywords of Python."""
    fields = getattr(value, "__dataclass_fields__", ())
    if name in fields:
        return getattr(value, name)
    if f"{name}_" in fields:
        return getattr(value, f"{name}_")
    names = [str(known) for known in value] if isinstance(value, dict) else fields
    if name in names:
        return value[name]
    has = f"it has {', '.join(names)}" if names else "there are no fields there"
    raise FieldPathError(f"'{text}' asks for the field '{name}', but {has}")
