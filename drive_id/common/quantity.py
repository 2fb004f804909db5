"""A measured quantity, how people read it (``9.997 ± 0.011 mΩ``), and how JSON has it."""

from __future__ import annotations

import html
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_PREFIXES = {9: "G", 6: "M", 3: "k", 0: "", -3: "m", -6: "µ", -9: "n"}
_PREFIXED = frozenset({"Ω", "Wb", "H", "V", "A", "Nm", "Nm/A", "s", "S", "Wb/K", "W"})
"""Units that take a prefix; others, such as samples and °, are left as they are."""
_PLAIN = frozenset({"V", "A", "Nm", "W"})
"""Of these, the units that are read without a prefix as long as the number is of a usual size."""
_USUAL = (1e-3, 1e4)
_SPELLED = {"ohm": "Ω", "1": "", "degC": "°C", "kg m^2": "kg m²"}
_DIGITS = 4
"""Significant digits of a value without a known standard error."""
_LEAST_SHARE = 1e-8
"""Of the value below which a standard error is not shown: only simulations without noise have it."""


@dataclass(frozen=True)
class Quantity:
    """A quantity with its standard error; its text is that of :func:`measured`."""

    name: str  # with the field's symbol, such as ``L_d at zero current``
    value: float  # in ``unit``
    sigma: float  # standard error; not finite where it is not known
    unit: str  # SI
    note: str = ""  # what it holds for, a sentence; empty where the name says all
    size: float = math.nan  # as of :func:`measured`

    def __str__(self) -> str:
        return measured(self.value, self.sigma, self.unit, self.size)


class Tabled(ABC):
    """What shows itself as a summary and a table below it: as text, and in a notebook."""

    @property
    @abstractmethod
    def summary(self) -> str:
        """What matters most, in words."""

    @abstractmethod
    def rows(self) -> list[tuple[str, ...]]:
        """Return the rows of the table as cells, all of one length."""

    def __repr__(self) -> str:
        rows = self.rows()
        widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
        lines = (
            "  ".join([name.ljust(widths[0]), *map(str.rjust, cells, widths[1:])]).rstrip() for name, *cells in rows
        )
        return "\n".join((self.summary, *lines))

    def _repr_html_(self) -> str:
        return html_table(self.rows(), self.summary)


def html_table(rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """Return cells as a table for notebooks, the first of each row its name."""
    lines = "".join(
        f"<tr><th>{html.escape(name)}</th>{''.join(f'<td>{html.escape(cell)}</td>' for cell in cells)}</tr>"
        for name, *cells in rows
    )
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}{lines}</table>"


def measured(value: float, sigma: float = math.nan, unit: str = "", size: float = math.nan) -> str:
    """Return a value and its standard error, rounded alike to two digits of the error, with an engineering prefix.

    The value alone, to four digits, where the error is unknown; ``unknown`` where the value is not finite. The size of
    all that is shown of its kind gives the prefix, in SI units: what belongs together is read in one unit. Default: the
    value's own.
    """
    if not math.isfinite(value):
        return "unknown"
    unit = spelled(unit)
    if unit == "rad":  # people read angles in one unit, whatever their size
        value, sigma, unit = math.degrees(value), math.degrees(sigma), "°"
    known = math.isfinite(sigma) and sigma > _LEAST_SHARE * abs(value)
    if math.isfinite(size):
        factor, unit = scaled_unit(size, unit)
    else:
        factor, unit = scaled_unit(max(abs(value), sigma if known else 0.0), unit, _DIGITS if not known else 12)
    value, sigma = value * factor, sigma * factor
    if known:
        digits = 1 - _order(sigma, 2)
        shown = (f"{round(number, digits) + 0.0:.{max(0, digits)}f}" for number in (value, sigma))
        text = " ± ".join(shown)
    else:
        text = rounded(value)
    return f"{text} {unit}".rstrip().replace("-", "\N{MINUS SIGN}")


def counted(number: object, noun: str, plural: str = "") -> str:
    """Return a number and what it counts, such as ``1 gap`` and ``2 gaps``."""
    return f"{number} {noun if str(number).lstrip('+-') == '1' else plural or noun + 's'}"


def rounded(value: float, digits: int = _DIGITS) -> str:
    """Return a number to some significant digits, without an exponent where it is of a usual size."""
    return f"{float(f'{value:.{digits}g}'):.10g}"


def scaled_unit(largest: float, unit: str, digits: int = _DIGITS) -> tuple[float, str]:
    """Return the factor from an SI unit to that in which values up to this size are read, and that unit."""
    if unit not in _PREFIXED or not largest > 0 or (unit in _PLAIN and _USUAL[0] <= largest < _USUAL[1]):
        return 1.0, unit
    exponent = min(max(3 * (_order(largest, digits) // 3), min(_PREFIXES)), max(_PREFIXES))
    return 10.0**-exponent, _PREFIXES[exponent] + unit


def plain(value: Any, digits: int = 0) -> Any:
    """Return a value for JSON: arrays as lists, numbers to some significant digits, null where they are not finite."""
    if isinstance(value, Mapping):
        return {name: plain(inner, digits) for name, inner in value.items()}
    value = value.tolist() if hasattr(value, "tolist") else value  # of numpy
    if isinstance(value, (list, tuple)):
        return [plain(inner, digits) for inner in value]
    if not isinstance(value, float):
        return value
    return (float(f"{value:.{digits}g}") if digits else value) if math.isfinite(value) else None


def spelled(unit: str) -> str:
    """Return a unit as people write it: ``ohm`` of a file or setting is Ω."""
    return _SPELLED.get(unit, unit)


def _order(value: float, digits: int) -> int:
    """Return the decimal exponent of a positive number once it is rounded to some significant digits."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])
