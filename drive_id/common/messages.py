"""What checks, fits and readers have to say: values for programs, and the sentence for people.

The sentences are templates in ``messages.yaml``, by kind and code; nothing else makes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from string import Formatter
from typing import Any

import yaml

from drive_id.common.quantity import counted, measured, plain

Value = float | int | str
"""Of a message: SI units; a text only where it names something."""
_SCALES = {"k": 1e-3, "m": 1e3, "u": 1e6, "deg": 180 / math.pi}
_MISSING = "\0"
"""Stands for a value that is not there, which only matters where a sentence keeps it."""
_WHOLE = 0.095
"""Share from which on it is written in whole percent."""
_MOST_PERCENT = 10.0
"""Share above which only that it is above is told: a model that diverged leaves 1e40 of the voltage."""


class Message(str):
    """A warning, a statement, a piece of advice or a finding of a check: as a string, its sentence.

    Parameters
    ----------
    key : str
        Code, and after a dot one of its wordings, as in ``messages.yaml``.
    kind : str
        ``error`` (refuses the recording), ``warning``, ``statement``, ``nothing`` (tells that nothing was found) or
        ``advice``. Default: that in ``messages.yaml``.
    **values : float or str
        By name; those that are None are left out.

    Attributes
    ----------
    code : str
        Stable name for programs; empty for sentences of results that were stored without codes.
    """

    code: str
    kind: str
    values: Mapping[str, Any]

    def __new__(cls, key: str, kind: str = "", /, **values: Value | None) -> Message:  # noqa: D102
        known = {name: _plain(value) for name, value in values.items() if value is not None}
        usual, template = _sentences()[key]
        sentence = _FORMATTER.vformat(template, (), known)
        if _MISSING in sentence:
            raise KeyError(f"{key} lacks a value")
        return cls.told(sentence, key.partition(".")[0], known, kind or usual)

    @classmethod
    def told(
        cls, sentence: str, code: str = "", values: Mapping[str, Any] | None = None, kind: str = "warning"
    ) -> Message:
        """Return a message with a sentence that is there already, as of a stored result."""
        message = str.__new__(cls, sentence)
        message.code, message.values, message.kind = code, dict(values or {}), kind
        return message

    @classmethod
    def stored(cls, entry: str | Mapping[str, Any]) -> Message:
        """Return a message again that :meth:`tree` stored; of earlier versions, a sentence alone."""
        return cls.told(entry) if isinstance(entry, str) else cls.told(**entry)

    def __reduce__(self) -> tuple[Any, ...]:
        return Message.told, (str(self), self.code, self.values, self.kind)

    def of(self, source: object) -> Message:
        """Return the message with the name of its source before it."""
        return Message.told(f"{source}: {self}", self.code, self.values, self.kind)

    def tree(self) -> dict[str, Any]:
        """Return plain values for JSON; numbers that are not finite are None."""
        return {"code": self.code, "kind": self.kind, "sentence": str(self), "values": plain(self.values)}


@cache
def _catalogue() -> dict[str, dict[str, str]]:
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    tree: dict[str, dict[str, str]] = yaml.load(
        files("drive_id.common").joinpath("messages.yaml").read_text("utf-8"), loader
    )
    return tree


@cache
def _sentences() -> dict[str, tuple[str, str]]:
    """Return kind and template by key."""
    parts = ("clause", "noun")
    return {key: (kind, text) for kind, own in _catalogue().items() if kind not in parts for key, text in own.items()}


def _plain(value: Value) -> Value:
    if isinstance(value, str):
        return value.replace(_MISSING, "")  # names in damaged files hold anything
    return value.item() if hasattr(value, "item") else value  # of numpy


class _Templates(Formatter):
    """Fills templates as ``str.format`` does, with six additions.

    - ``{clause}`` is replaced by the template of that name.
    - ``{x:.3g|m}`` is in thousandths; likewise ``k``, ``u``, ``deg`` (of rad), ``%``, and ``phase`` for a, b or c.
    - ``{x:|nouns}`` is a list of effects, by the nouns for them, the first ones if there are many.
    - ``{x:±{sigma} ohm}`` has a standard error, see :func:`~drive_id.common.quantity.measured`; shares in ``%``,
      rad in ``°``. ``{x:±{sigma} ohm of {resistance}}`` is in the unit for that size.
    - ``{x:# gap}`` is a number and what it counts, ``{x:#is//are}`` what agrees with it alone; a format may precede it.
    - ``{x:?yes//no}`` is one of two texts, whether the value is known and not False.
    """

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        name = str(key)
        if name in kwargs:
            return kwargs[name]
        clause = _catalogue()["clause"].get(name)
        return None if clause is None else self.vformat(clause, args, kwargs)

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec.startswith("?"):
            yes, _, no = format_spec[1:].partition("//")
            return no if value is None or value is False else yes
        if value is None:
            return _MISSING
        if format_spec.startswith("±"):
            return _with_error(value, *format_spec[1:].split(" ", 1))
        format_spec, counts, nouns = format_spec.partition("#")
        if counts:
            one, _, more = nouns.strip().partition("//")
            number, _, word = counted(self.format_field(value, format_spec), one, more).partition(" ")
            return f"{number} {word}" if nouns.startswith(" ") else word
        spec, _, unit = format_spec.partition("|")
        if unit in _SHOWN:
            return _SHOWN[unit](value, spec)
        return format(_SCALES[unit] * value if unit else value, spec)


def _with_error(value: float, sigma: str, unit: str) -> str:
    unit, _, size = unit.partition(" of ")
    if size == _MISSING:
        return _MISSING
    scale = {"%": 100.0, "°": _SCALES["deg"]}.get(unit, 1.0)
    return measured(scale * value, scale * float(sigma), unit, abs(float(size or "nan")))


def _percent(share: float, spec: str) -> str:
    if share > _MOST_PERCENT:
        return f"more than {100 * _MOST_PERCENT:.0f} %"
    return f"{format(100 * share, spec or ('.2g' if share < _WHOLE else '.0f'))} %"


def _nouns(names: str, _: str) -> str:
    parts = (name.partition(" ") for name in names.split(","))
    words = [_catalogue()["noun"][name].format(number) for name, _, number in parts]
    more = len(words) - _MOST_NOUNS
    first, last = (words[:_MOST_NOUNS], f"{more} others") if more > 1 else (words[:-1], words[-1])
    return " or ".join([", ".join(first), last] if first else [last])


_MOST_NOUNS = 3
"""Effects that are named of a list: of more, one reads none."""

_SHOWN: dict[str, Callable[[Any, str], str]] = {
    "%": _percent, "phase": lambda number, _: "abc"[int(number)], "nouns": _nouns,
}  # fmt: skip
_FORMATTER = _Templates()
