"""Maps in text files: one row for each point, or one matrix for each flux."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.npz import known_scalars, ordered, turning_points
from drive_id.exchange.imports.points import MapPoints, of_grid
from drive_id.exchange.imports.source import Source
from drive_id.files.inputs.input_file import read_input, reason
from drive_id.types import FloatArray

COLUMNS = ("i_d", "i_q", "psi_d", "psi_q", "torque", "theta", "sigma_d", "sigma_q", "inside")
_NEEDED = COLUMNS[:4]
_COMMENT = re.compile(r"#\s*(\w+)\s*[:=]\s*(.+)")
_MILLI = re.compile(r"\b(mWb|mVs|mA|mNm)\b")
_MOST_BYTES = 500_000_000  # of a file, which is read into memory whole


def read_csv(source: Source) -> MapPoints:
    """Read a text file with one row for each point, or two with one matrix each.

    Fields are separated by commas, semicolons, tabs or spaces. Lines that begin with ``#`` may tell ``name: value`` of
    the machine. ``theta`` is in degrees.
    """
    if source.psi_q_file is not None:
        return _matrices(source, source.psi_q_file)
    heading, rows, told = _table(source.path)
    places = _places(source, heading, rows.shape[1])
    milli = {place for place in places.values() if heading and _MILLI.search(heading[place])}
    values = {name: rows[:, place] * (1e-3 if place in milli else 1.0) for name, place in places.items()}
    scalars = known_scalars(told, source.scalars)
    machine = str(told.get("machine", ""))
    i_dq, psi_dq = (np.stack([values[a], values[b]], axis=-1) for a, b in (_NEEDED[:2], _NEEDED[2:]))
    if "inside" in values:
        psi_dq = np.where(values["inside"][:, None] > 0, psi_dq, np.nan)
    sigma = None
    if "sigma_d" in values and "sigma_q" in values:
        sigma = np.stack([values["sigma_d"], values["sigma_q"]], axis=-1)
    if len(i_dq) < 2:
        raise ConfigurationError(f"'{source.path}' has {counted(len(i_dq), 'row')} with data: a map needs more.")
    if "theta" in values:
        turning = np.radians(source.electrical(values["theta"]))
        return turning_points(source.path, i_dq, psi_dq, turning, values.get("torque"), scalars, machine)
    return MapPoints(i_dq, psi_dq[..., None], None, values.get("torque"), sigma, scalars, machine=machine).complete()


def _places(source: Source, heading: list[str] | None, count: int) -> dict[str, int]:
    unknown = [name for name in source.columns if name not in COLUMNS]
    if unknown:
        raise ConfigurationError(f"--columns names '{unknown[0]}': the quantities are {', '.join(COLUMNS)}.")
    places = {}
    for name in COLUMNS:
        own = name if heading and name in heading else None
        given = source.columns.get(name) if source.columns else own
        if given is None:
            continue
        if heading is not None and given in heading:
            places[name] = heading.index(given)
        elif given.isdigit() and 1 <= int(given) <= count:
            places[name] = int(given) - 1
        else:
            there = ", ".join(heading or [f"numbers 1 to {count}"])
            raise ConfigurationError(f"'{source.path}' has no column '{given}': it has {there}.")
    missing = [name for name in _NEEDED if name not in places]
    if missing:
        there = ", ".join(heading or [f"{counted(count, 'column')} without headings"])
        raise ConfigurationError(
            f"'{source.path}' has no column {missing[0]} (it has {there}): name them, for instance "
            "--columns i_d=Id,i_q=Iq,psi_d=Fd,psi_q=Fq, or by numbers, --columns i_d=1,i_q=2,psi_d=3,psi_q=4."
        )
    return places


def _matrices(source: Source, psi_q_file: Path) -> MapPoints:
    """Read two files, each with one axis in the first row and one in the first column; their corner is ignored."""
    found = []
    for path in (source.path, psi_q_file):
        lines, told = _lines(path)
        if len(lines) < 5:
            raise ConfigurationError(
                f"'{path}' has {counted(len(lines), 'row')}: a matrix needs axes of at least 4 currents."
            )
        axis, width = _split(lines[0]), len(_split(lines[1]))
        corner = ["0", *(axis if len(axis) == width - 1 else axis[1:])]
        rows = _numbers(path, [";".join(corner), *lines[1:]])
        if min(rows.shape) < 5:
            raise ConfigurationError(f"'{path}' has {rows.shape} numbers: a matrix needs axes of at least 4 currents.")
        first, second, values = rows[1:, 0], rows[0, 1:], rows[1:, 1:]
        i_d, i_q = (first, second) if source.conventions.order == "dq" else (second, first)
        found.append((i_d, i_q, ordered(source, values, path.name, len(i_d), len(i_q)), told))
    (i_d, i_q, psi_d, told), (other_d, other_q, psi_q, _) = found
    if not (np.array_equal(i_d, other_d) and np.array_equal(i_q, other_q)):
        raise ConfigurationError(f"'{source.path}' and '{psi_q_file}' have different axes: give two maps on one grid.")
    i_dq, psi_dq = of_grid(i_d, i_q, psi_d, psi_q)
    shape = (len(i_d), len(i_q))
    return MapPoints(i_dq, psi_dq, scalars=known_scalars(told, source.scalars), shape=shape).complete()


def _lines(path: Path) -> tuple[list[str], dict[str, Any]]:
    """Return the nonempty lines, and what comments state about the machine."""
    try:
        text = read_input(path, _MOST_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        said = reason(error) if isinstance(error, OSError) else "it is not in UTF-8"
        raise ConfigurationError(f"'{path}' cannot be read as text ({said}): check the file.") from error
    lines = [line for line in text.splitlines() if line.strip()]
    told: dict[str, Any] = {}
    for line in lines:
        comment = _COMMENT.match(line.strip())
        if comment:
            told[comment[1]] = _number(comment[2])
    return [line for line in lines if not line.lstrip().startswith("#")], told


def _number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _table(path: Path) -> tuple[list[str] | None, FloatArray, dict[str, Any]]:
    """Return the headings, if any, the numbers (N, C), and what comments state."""
    lines, told = _lines(path)
    if not lines:
        raise ConfigurationError(f"'{path}' is empty: give a file with one row for each point.")
    heading = None
    if not all(isinstance(_number(entry), float) for entry in _split(lines[0]) if entry):
        heading = [name.strip().strip('"') for name in _split(lines[0])]
        lines = lines[1:]
        if lines and not any(isinstance(_number(entry), float) for entry in _split(lines[0])):
            lines = lines[1:]  # units
    rows = _numbers(path, lines)
    if heading is not None and len(heading) != rows.shape[1]:
        raise ConfigurationError(
            f"'{path}' has {counted(len(heading), 'heading')} for {counted(rows.shape[1], 'column')}: make them match."
        )
    return heading, rows, told


def _split(line: str) -> list[str]:
    for separator in (";", "\t", ","):
        if separator in line:
            return [entry.strip() for entry in line.split(separator)]
    return line.split()


def _numbers(path: Path, lines: list[str]) -> FloatArray:
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        entries = _split(line)
        values = [_number(entry) if entry else np.nan for entry in entries]
        if not all(isinstance(value, float) for value in values):
            word = next(entry for entry, value in zip(entries, values, strict=True) if not isinstance(value, float))
            raise ConfigurationError(
                f"'{path}' holds '{word:.40}' in data row {number}: write numbers with a decimal point."
            )
        if rows and len(values) != len(rows[0]):
            raise ConfigurationError(
                f"'{path}' has {counted(len(values), 'column')} in data row {number} where the "
                f"first has {len(rows[0])}."
            )
        rows.append(values)
    if not rows:
        raise ConfigurationError(f"'{path}' holds no data rows: give a file with one row for each point.")
    return np.array(rows, np.float64)
