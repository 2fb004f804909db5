"""Bags of one drive as joined samples: in memory, or as one stream that can be read more than once."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drive_id.common.messages import Message
from drive_id.core.signals.join import Piece
from drive_id.core.signals.pieces import SeveralRecordings, common_truth
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.drive_parts import DrivePart, drive_parts
from drive_id.files.read.extraction import DividedError
from drive_id.files.read.reader import BagFacts, bag_pieces
from drive_id.files.storage.bag import file_digest, storage_files
from drive_id.types import GroundTruth, Progress, Samples, silent

_LONG = 1 << 18
"""Number of samples after which the progress includes the reading rate."""
KEPT = 700_000
"""Most samples, of 88 bytes without optional signals, that are kept to be accumulated: 62 MB, 70 s at 10 kHz."""


@dataclass(frozen=True, eq=False)
class JoinedLog:
    """The content of one bag or of several."""

    samples: Samples  # joined; each bag begins a new run
    truth: GroundTruth | None  # of the simulation; None unless all bags have one
    digests: dict[str, str]  # storage file to its sha256
    warnings: tuple[Message, ...]


def read_recording(paths: Path | Sequence[Path], signals: SignalMap | None = None, *, namespace: str = "") -> JoinedLog:
    """Read one or several bags of one drive into memory, one behind the other.

    Parameters
    ----------
    paths : Path or sequence of Path
        Storage files or folders.
    signals : SignalMap, optional
        Default: our own messages.
    namespace : str
        Of the drive, when a bag holds several.

    Raises
    ------
    BagError
        When a bag, a topic or a message cannot be read.
    DataError
        When its samples cannot be joined.
    ConfigurationError
        When none is given, one is given twice, or one holds several drives and none was chosen.
    """
    bags = [paths] if isinstance(paths, Path) else paths
    if not bags:
        raise ConfigurationError("No bag is given: name at least one.")
    reading = SeveralBags(bags, signals or SignalMap(), namespace, silent, threads=False, whole=True)
    while True:
        try:
            parts = [piece.samples for piece, _ in reading.pieces("Reading")]
            break
        except DividedError:
            reading.divide()
    samples = parts[0] if len(parts) == 1 else Samples.joined(parts)
    return JoinedLog(samples, reading.truth, digests_of(bags), reading.warnings)


class SeveralBags:
    """Reads bags one after the other, ahead in other ``threads``, or each at once if ``whole``."""

    def __init__(
        self,
        bags: Sequence[Path],
        signals: SignalMap,
        namespace: str,
        tell: Progress,
        *,
        threads: bool = True,
        whole: bool = False,
    ) -> None:
        self.samples = 0
        """Samples read since :meth:`pieces` was called."""
        self._bags = bags
        self._signals = signals
        self._namespace = namespace
        self._tell = tell
        self.threads = threads
        self._whole: set[int] = set(range(len(bags))) if whole else set()
        self._number = 0
        self._part: DrivePart | None = None
        self._parts: dict[int, list[DrivePart]] = {}  # of bags in which the drive was restarted or exchanged
        self._facts: list[tuple[Path, BagFacts]] = []
        self._several = SeveralRecordings()
        self._start = 0.0
        self._share = 0.0  # of the bags that has been read; 0 if unknown
        self._kept: deque[tuple[Piece, bool]] | None = None

    @property
    def last_stamp(self) -> int:
        """Stamp of the last sample, ns."""
        return self._several.end or 0

    @property
    def truth(self) -> GroundTruth | None:
        """The ground truth; None unless all bags so far have it."""
        return common_truth([facts.truth for _, facts in self._facts], [path for path, _ in self._facts])

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Sentences about the recordings."""
        changes = [part.reason for parts in self._parts.values() for part in parts if part.reason is not None]
        if len(self._bags) == 1:
            return (*changes, *dict.fromkeys(warning for _, facts in self._facts for warning in facts.warnings))
        moved = [Message("overlap", recording=str(self._bags[k])) for k in self._several.moved if k < len(self._bags)]
        known = dict.fromkeys(message.of(path) for path, facts in self._facts for message in facts.warnings)
        return (*changes, *known, *moved)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """Paths of the bags without checksums."""
        return tuple(dict.fromkeys(str(path) for path, facts in self._facts if not facts.checked))

    def read_whole(self) -> None:
        """From now on, read the bag that raised UnusualError as a whole."""
        self._whole.add(self._number)

    def divide(self) -> None:
        """From now on, read the bag that raised DividedError by the parts in which the drive was the same."""
        self._parts[self._number] = drive_parts(self._bags[self._number], self._signals, self._namespace)

    @property
    def present(self) -> tuple[int, DrivePart | None]:
        """Number of the bag that is being read, and its part; None if the drive was the same in all of it."""
        return self._number, self._part

    @property
    def divided(self) -> bool:
        """Whether the drive was restarted or exchanged within a bag."""
        return bool(self._parts)

    def pieces(self, what: str, *, keep: bool = False) -> Iterator[tuple[Piece, bool]]:
        """Yield the samples of all bags piece by piece, each with whether it is the first of a bag or of a part of one.

        ``what`` is told with the progress; ``keep`` prepares :meth:`again`. Raises DataError once the bags turn out to
        be of different machines; for other errors, see :func:`~drive_id.files.read.reader.bag_pieces`.
        """
        self._facts, self._several = [], SeveralRecordings()
        self.samples, self._start = 0, time.monotonic()
        self._kept = deque() if keep else None
        for found in self._all(what):
            if self._kept is not None:
                self._kept.append(found)
            if self.samples > KEPT * (self._share or 1.0):  # or will be when all is read
                self._kept = None
            yield found

    def again(self, what: str) -> Iterator[tuple[Piece, bool]]:
        """Yield what :meth:`pieces` yielded once more: up to :data:`KEPT` samples from memory, more from the files."""
        kept, self._kept = self._kept, None
        if kept is None:
            yield from self.pieces(what)
            return
        count = len(kept)
        for number in range(count):
            self._tell(what, number / count)
            yield kept.popleft()
        self._tell(what, 1.0)

    def _all(self, what: str) -> Iterator[tuple[Piece, bool]]:
        for number, path in enumerate(self._bags):
            parts: Sequence[DrivePart | None] = self._parts.get(number, [None])
            for part in parts:
                self._number, self._part = number, part
                yield from self._of_part(what, path, part)

    def _of_part(self, what: str, path: Path, part: DrivePart | None) -> Iterator[tuple[Piece, bool]]:
        self._several.begin()
        tell = partial(self._tell_share, what)
        tell(0.0)
        pieces = bag_pieces(
            path,
            self._signals,
            self._namespace,
            whole=self._number in self._whole,
            threads=self.threads,
            tell=tell,
            end=lambda facts: self._facts.append((path, facts)),
            part=None if part is None else range(part.begin, part.end),
        )
        for count, piece in enumerate(pieces):
            self.samples += len(piece.samples) - piece.continues
            yield self._several.placed(piece), count == 0
        _ = self.truth  # raises before two machines in one would be told as a fault of the signals
        tell(1.0)

    def _tell_share(self, what: str, share: float) -> None:
        elapsed = time.monotonic() - self._start
        if self.samples >= _LONG and elapsed:
            what = f"{what}, {self.samples / elapsed * 1e-6:.2f} million samples/s"
        self._share = (self._number + share) / len(self._bags)
        self._tell(what, self._share)


def digests_of(bags: Sequence[Path]) -> dict[str, str]:
    """Return the digests of all files, file to its sha256, in order; a bag that cannot be read ends them.

    Raises ConfigurationError when two bags hold the same file.
    """
    found: dict[str, str] = {}
    for bag in bags:
        try:
            files, _ = storage_files(bag)
        except DriveIdError:  # the reader raises it, too, with the path
            return found
        own = {str(file): file_digest(file) for file in files}
        for file, digest in own.items():
            for other, known in found.items():
                if digest == known:
                    raise ConfigurationError(f"{file} and {other} are the same recording: give each bag once.")
        found |= own
    return found
