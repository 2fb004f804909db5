"""Information files: what was accumulated from recordings, to be merged and fitted later, on any computer.

An ``.npz`` without pickled objects. ``header`` is a JSON text: format, versions, settings, ranges, warnings, the
digests of the bags, and a digest of all that the file holds; ``evidence/...`` are the sums,
``validation/<number>/...`` the first 2 s of each recording (for the MAD), and ``truth`` is the ground truth of a
simulation.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.settings import from_mapping
from drive_id.common.version import VERSION
from drive_id.core.accumulation.accumulated import VALIDATION_PIECES, Accumulated, bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.running_sums import SavedSums, below, prefixed
from drive_id.errors import DriveIdError, InformationError
from drive_id.files.inputs.archive import DAMAGED, LARGEST, npz_bytes, read_arrays, unpacked_limit
from drive_id.files.inputs.input_file import open_input, reason
from drive_id.files.machines.ground_truth import decode_truth, encode_truth
from drive_id.files.results.folder import check_absent, replace_file
from drive_id.types import SCALARS, Samples

FORMAT = "drive_id/information"
FORMAT_VERSION = 15
_SIGNALS = ("stamp", "i_abc", "u_abc", "angle", "speed", "run_starts")
_OPTIONAL = ("i_dq_reference", *SCALARS)
_DIGEST = "sha256"
_LONGEST_HEADER = 1 << 23  # bytes, with the findings of many bags
_MOST_SAMPLES = 1 << 53  # whole numbers that a float holds exactly
_COUNTS = ("samples", "gaps", "idle", "_differences", "information/rows", "information/outside")
_UNBOUNDED = ("information/filled",)
"""Infinite before a recording begins; all other sums are finite."""
_DAMAGE = (DriveIdError, *DAMAGED)


@dataclass(frozen=True, eq=False)
class StoredInformation:
    """Content of an information file."""

    accumulated: Accumulated
    software: str  # version of drive_id that wrote it


def check_information_output(path: Path) -> None:
    """Check, before the work is done, that an information file can be written to a path.

    Raises OutputError when something else is there, or the path cannot be written.
    """
    try:
        with open_input(path, LARGEST) as opened:
            if _header(read_arrays(opened, ("header",), largest=_LONGEST_HEADER))["format"] == FORMAT:
                return
    except _DAMAGE:
        pass  # not ours
    check_absent(path)


def write_information(path: Path, accumulated: Accumulated) -> None:
    """Write an information file completely or not at all; an earlier one is replaced.

    Only the first 2 s of at most 10 recordings are kept. Raises OutputError when something else has this name, or it
    cannot be written.
    """
    check_information_output(path)
    replace_file(path, encode_information(accumulated))


def read_information(path: Path) -> StoredInformation:
    """Read an information file.

    Raises InformationError when it cannot be read, is damaged, is another file, or was written by a newer version.
    """
    try:
        with open_input(path, LARGEST) as stream:
            return _decoded(stream, str(path))
    except OSError as error:
        raise InformationError(f"{path} cannot be read ({reason(error)}): check the name.") from error


def encode_information(accumulated: Accumulated) -> bytes:
    """Return the content of an information file."""
    evidence, validation = accumulated.evidence, bounded(accumulated.validation)
    header = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "software": VERSION,
        "settings": asdict(evidence.settings),
        "i_max": evidence.i_max,
        "ranges": [[axis.low, axis.high] for axis in (evidence.d, evidence.q)],
        "samples": accumulated.samples,
        "last_stamp": accumulated.last_stamp,
        "inputs": dict(accumulated.digests),
        "warnings": [message.tree() for message in accumulated.warnings],
        "unchecked": list(accumulated.unchecked),
        "validation_periods": [piece.sample_period for piece in validation],
    }
    arrays = prefixed("evidence", evidence.state())
    for number, piece in enumerate(validation):
        signals = {name: getattr(piece, name) for name in (*_SIGNALS, *_OPTIONAL)}
        arrays |= prefixed(f"validation/{number}", {name: x for name, x in signals.items() if x is not None})
    if accumulated.truth is not None:
        arrays["truth"] = np.frombuffer(encode_truth(accumulated.truth), np.uint8)
    header[_DIGEST] = _digest(header, arrays)
    arrays["header"] = np.array(json.dumps(header))
    content = npz_bytes(arrays)
    if sum(max(array.nbytes, 8 * array.size) for array in arrays.values()) > unpacked_limit(len(content)):
        return npz_bytes(arrays, compressed=False)  # sums of so many splines are nearly all zero: readers would refuse
    return content


def _decoded(stream: BinaryIO, where: str) -> StoredInformation:
    try:
        header = _header(read_arrays(stream, ("header",), largest=_LONGEST_HEADER))
        _check_version(header, where)
        arrays = read_arrays(stream)
        del arrays["header"]
        if header[_DIGEST] != _digest(header, arrays):
            raise ValueError("its content does not match its digest")
        _check_ranges(header, below("evidence", arrays))
        return StoredInformation(_accumulated(header, arrays, where), str(header["software"]))
    except InformationError:
        raise
    except _DAMAGE as error:
        said = f"{error}, so " if type(error) is ValueError and str(error).startswith("it") else ""
        raise InformationError(
            f"{where} is not an information file of drive_id, or it is damaged: {said}accumulate the bags again."
        ) from error


def information_tree(accumulated: Accumulated) -> dict[str, Any]:
    """Return a summary of an information file as plain values."""
    evidence = accumulated.evidence
    return {
        "samples": accumulated.samples,
        "duration": evidence.samples * evidence.sample_period,
        "gaps": evidence.gaps,
        "i_max": evidence.i_max,
        "coverage": evidence.coverage(),
        "machine": accumulated.truth.machine if accumulated.truth else "",
        "settings": asdict(evidence.settings),
        "inputs": [{"file": file, "sha256": digest} for file, digest in accumulated.digests.items()],
        "warnings": [message.tree() for message in accumulated.warnings],
    }


def _header(file: Mapping[str, Any]) -> dict[str, Any]:
    header = json.loads(str(file["header"]))
    if not isinstance(header, dict) or header["format"] != FORMAT:
        raise TypeError("no header of ours")
    return header


def _check_version(header: Mapping[str, Any], where: str) -> None:
    version = int(header["format_version"])
    if version < FORMAT_VERSION:
        raise InformationError(
            f"{where} was written by drive_id {header['software']} in version {version} of the format, which holds "
            "less than this one needs: accumulate its bags again."
        )
    if version > FORMAT_VERSION:
        raise InformationError(
            f"{where} was written by drive_id {header['software']} in version {version} of the "
            f"format, and this drive_id, {VERSION}, knows it up to version {FORMAT_VERSION}: update it."
        )


def _digest(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> str:
    """Return the sha256 of header and arrays, hexadecimal; a digest in the header does not count."""
    told = {name: value for name, value in header.items() if name != _DIGEST}
    digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"\n{name} {array.dtype.str} {np.shape(arrays[name])}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _check_ranges(header: Mapping[str, Any], evidence: SavedSums) -> None:
    """Raise ValueError for numbers that no recording gives."""
    periods, limits = header["validation_periods"], [limit for pair in header["ranges"] for limit in pair]
    for name, value in (("i_max", header["i_max"]), *(("sample period", period) for period in periods)):
        if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
            raise ValueError(f"its {name} is {value}")
    if len(limits) != 4 or not np.isfinite(limits).all() or limits[0] >= limits[1] or limits[2] >= limits[3]:
        raise ValueError("its map has no range")
    if len(periods) > VALIDATION_PIECES:
        raise ValueError("it holds too many excerpts")
    if type(header["samples"]) is not int or not 0 < header["samples"] <= _MOST_SAMPLES:
        raise ValueError(f"its number of samples is {header['samples']}")
    if type(header["last_stamp"]) is not int or abs(header["last_stamp"]) >= 1 << 63:
        raise ValueError("its last stamp is out of range")
    for name in _COUNTS:
        if not 0 <= int(evidence[name]) <= _MOST_SAMPLES:
            raise ValueError(f"its count '{name}' is {int(evidence[name])}")
    for name, array in evidence.items():
        if array.dtype.kind == "f" and name not in _UNBOUNDED and not np.isfinite(array).all():
            raise ValueError(f"its sums '{name}' are not finite")


def _accumulated(header: Mapping[str, Any], arrays: SavedSums, where: str) -> Accumulated:
    settings = from_mapping(FitSettings, header["settings"], where)
    counts = (settings.splines_d, settings.splines_q)
    d, q = (Axis(float(low), float(high), count) for (low, high), count in zip(header["ranges"], counts, strict=True))
    evidence = Evidence(settings, d, q, float(header["i_max"]), compared=True)
    evidence.restore(below("evidence", arrays))
    validation = tuple(
        _piece(below(f"validation/{number}", arrays), period)
        for number, period in enumerate(header["validation_periods"])
    )
    return Accumulated(
        evidence=evidence,
        validation=validation,
        warnings=tuple(map(Message.stored, header["warnings"])),
        digests={str(file): str(digest) for file, digest in header["inputs"].items()},
        truth=decode_truth(arrays["truth"].tobytes(), where) if "truth" in arrays else None,
        samples=int(header["samples"]),
        last_stamp=int(header["last_stamp"]),
        unchecked=tuple(map(str, header["unchecked"])),
    )


def _piece(arrays: SavedSums, period: float) -> Samples:
    signals: dict[str, Any] = {name: arrays[name] for name in _SIGNALS}
    if any(signals[name].dtype.kind != "i" for name in ("stamp", "run_starts")):
        raise ValueError("its stamps are no whole numbers")
    optional: dict[str, Any] = {name: arrays.get(name) for name in _OPTIONAL}
    return Samples(**signals, **optional, sample_period=float(period))
