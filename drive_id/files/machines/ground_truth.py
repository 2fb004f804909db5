"""Ground truth of a simulation: an ``.npz`` attached to the recording or beside it, never in a topic."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from drive_id.errors import BagError, ConfigurationError, OutputError
from drive_id.files.inputs.archive import DAMAGED, npz_bytes, read_arrays
from drive_id.types import GroundTruth

_ARRAYS = ("i_d", "i_q", "psi_d", "psi_q", "inverter_current", "inverter_voltage")
_NUMBERS = ("resistance", "i_max", "pole_pairs")
_LARGEST = 1 << 27  # bytes of arrays, a hundred times those of a simulation
_ERRORS = (ConfigurationError, *DAMAGED)


def encode_truth(truth: GroundTruth) -> bytes:
    """Return the ground truth as the content of an ``.npz`` file."""
    arrays = {name: np.asarray(getattr(truth, name), float) for name in _ARRAYS}
    numbers = {name: np.asarray(getattr(truth, name)) for name in _NUMBERS}
    details = np.asarray(json.dumps(truth.details, sort_keys=True))
    texts = {"machine": np.asarray(truth.machine), "details": details}
    return npz_bytes(arrays | numbers | texts)


def decode_truth(data: bytes, where: str) -> GroundTruth:
    """Read the content of such a file.

    Raises BagError when ``data``, from the recording ``where``, were not written by :func:`encode_truth`.
    """
    try:
        file = read_arrays(data, (*_ARRAYS, *_NUMBERS, "machine", "details"), largest=_LARGEST)
        arrays = {name: np.asarray(file[name], float) for name in _ARRAYS}
        details = json.loads(str(file["details"]))
        if not isinstance(details, dict):
            raise TypeError
        return GroundTruth(
            machine=str(file["machine"]),
            resistance=float(file["resistance"]),
            i_max=float(file["i_max"]),
            pole_pairs=int(file["pole_pairs"]),
            details=details,
            **arrays,
        )
    except _ERRORS as error:
        raise BagError(
            f"The ground truth attached to {where} cannot be read: simulate again, or remove the attachment."
        ) from error


def write_truth(path: Path, truth: GroundTruth) -> None:
    """Write the ground truth to a file, all of it or nothing; an existing file is replaced.

    Raises OutputError when the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_bytes(encode_truth(truth))
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OutputError(f"The truth cannot be written to {path}: {error.strerror or error}.") from error
