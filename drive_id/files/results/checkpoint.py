"""A small file from which reading long bags goes on after an interrupt: the evidence so far, and of how many pieces.

An ``.npz`` without pickled objects. ``header`` is a JSON text: format, version, what is being read with which settings
(as one digest), ranges and radius; ``evidence/...`` are the sums. One that does not fit is none.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.running_sums import below, prefixed
from drive_id.errors import DriveIdError
from drive_id.files.inputs.archive import DAMAGED, LARGEST, read_arrays
from drive_id.files.inputs.input_file import open_input
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.storage.bag import storage_files
from drive_id.version import VERSION

FORMAT = "drive_id/checkpoint"
FORMAT_VERSION = 4
INTERVAL = 5.0
"""Time between two checkpoints, s; what is read sooner leaves none."""
_DAMAGE = (DriveIdError, *DAMAGED)


@dataclass(frozen=True, eq=False)
class Progressed:
    """Where an earlier call was.

    Parameters
    ----------
    evidence : Evidence
    pieces : int
        Pieces of samples that are in it.
    """

    evidence: Evidence
    pieces: int


class Checkpoint:
    """Keeps the state of a long accumulation beside its output.

    Parameters
    ----------
    path : Path
    bags : sequence of Path
    settings : FitSettings
    signals : SignalMap
    namespace : str
    """

    def __init__(
        self,
        path: Path,
        bags: Sequence[Path],
        settings: FitSettings,
        signals: SignalMap,
        namespace: str,
    ) -> None:
        self.path = path
        self._settings = settings
        self._last = time.monotonic()
        self._usable = True
        self._task = _task(bags, settings, signals, namespace)

    @property
    def saved(self) -> bool:
        """Whether there is one, of this task or of another."""
        return self.path.is_file()

    def load(self) -> Progressed | None:
        """Return where an earlier call with the same bags and settings was, if it left a checkpoint."""
        try:
            with open_input(self.path, LARGEST) as stream:
                state = read_arrays(stream)
            header = json.loads(str(state["header"]))
            if header["format"] != FORMAT:
                self._usable = False  # somebody else's
                return None
            if header["format_version"] != FORMAT_VERSION or header["task"] != self._task:
                return None
            d, q = (Axis(*axis) for axis in header["axes"])
            evidence = Evidence(self._settings, d, q, header["i_max"])
            evidence.restore(below("evidence", state))
            return Progressed(evidence, int(header["pieces"]))
        except _DAMAGE:  # or there is none
            return None

    def save(self, evidence: Evidence, pieces: int) -> None:
        """Write a checkpoint when it is time for one; without room for it, go on without."""
        if not self._usable or time.monotonic() - self._last < INTERVAL:
            return
        header = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "task": self._task,
            "axes": [(axis.low, axis.high, axis.count) for axis in (evidence.d, evidence.q)],
            "i_max": evidence.i_max,
            "pieces": pieces,
        }
        arrays = {"header": np.asarray(json.dumps(header)), **prefixed("evidence", evidence.state())}
        staged = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        try:
            with staged.open("wb") as stream:  # not by way of memory: the sums are large
                np.savez(stream, **arrays)  # type: ignore[arg-type]  # numpy types them as bool
            staged.replace(self.path)
        except OSError:
            self._usable = False
        finally:
            with suppress(OSError):
                staged.unlink(missing_ok=True)
        self._last = time.monotonic()

    def remove(self) -> None:
        """Forget it: the work is done."""
        if self._usable:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)


def _task(bags: Sequence[Path], settings: FitSettings, signals: SignalMap, namespace: str) -> str:
    """Return a digest of what is read, by names, sizes and times of the files, and how."""
    files = []
    with suppress(DriveIdError, OSError):  # the reader says what is wrong
        for file in (file for bag in bags for file in storage_files(bag)[0]):
            state = file.stat()
            files.append((str(file.absolute()), state.st_size, state.st_mtime_ns))
    told = json.dumps([VERSION, files, asdict(settings), repr(signals), namespace])
    return hashlib.sha256(told.encode()).hexdigest()
