"""The file below an MCAP writer: it writes wholly or not at all, so that a full disk leaves a readable recording."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode

from drive_id.files.storage.container import MCAP_MAGIC

FileOpener = Callable[[Path], BinaryIO]
_END_WITHOUT_SUMMARY = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0)


def open_unbuffered(path: Path) -> BinaryIO:
    """Create a file whose writes reach the operating system at once."""
    return path.open("xb", buffering=0)


class McapStream:
    """What ``mcap.writer.Writer`` writes to: each of its writes holds whole records.

    A write that fails is undone by :meth:`end_early`, which ends the file behind the records that were written.

    Parameters
    ----------
    path : Path
        To create.
    opener : callable
        Opens it; a test may give a disk that fills up.
    """

    def __init__(self, path: Path, opener: FileOpener = open_unbuffered) -> None:
        self._stream = opener(path)
        self.position = 0
        self._data_end: int | None = None

    def write(self, data: bytes) -> int:
        """Write all of ``data`` or raise OSError."""
        view = memoryview(data)
        while view:
            view = view[self._stream.write(view) :]
        self.position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the position behind what was written, bytes."""
        return self.position

    def flush(self) -> None:
        """Do nothing: every write has reached the operating system."""

    def sync(self) -> None:
        """Wait until everything written is on the disk and survives a power cut."""
        os.fsync(self._stream.fileno())

    def begin_end(self) -> None:
        """Remember that what follows is no data: the index and the end mark."""
        self._data_end = self.position

    def end_early(self) -> None:
        """Cut off what a failed write left and end the file without an index; OSError when not even that goes."""
        end = self.position if self._data_end is None else self._data_end
        self._stream.truncate(end)
        self._stream.seek(end)
        self.write(_END_WITHOUT_SUMMARY + MCAP_MAGIC)
        self.sync()

    def close(self) -> None:
        """Release the file."""
        self._stream.close()
