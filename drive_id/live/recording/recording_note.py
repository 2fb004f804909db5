"""A note of the recording under way, by which a recorder that is started again knows that the one before it died."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from drive_id.errors import OutputError
from drive_id.files.inputs.input_file import read_json_input
from drive_id.files.results.folder import replace_file

_LONGEST = 10_000  # bytes


class RecordingNote:
    """The note of one recorder, by its full name, beside its recordings in the data directory."""

    def __init__(self, directory: str, node: str) -> None:
        self._file = Path(directory).expanduser().absolute() / f".recording{node.replace('/', '.')}.json"
        self.left = self._read()
        """A sentence on a recording that was never ended; empty if there is none."""

    def begin(self, path: Path) -> None:
        """Note that a recording runs; whether the disk takes the note says nothing about the recording."""
        self.left = ""
        with suppress(OutputError):
            replace_file(self._file, json.dumps({"recording": str(path)}).encode())

    def end(self) -> None:
        """Remove the note."""
        with suppress(OSError):
            self._file.unlink(missing_ok=True)

    def _read(self) -> str:
        path = read_json_input(self._file, _LONGEST).get("recording")
        if not isinstance(path, str) or not path.isprintable():
            return ""
        return (
            f"The recorder died while it recorded {path}, which breaks off there: complete it with 'drive-id recover', "
            "and start a new recording."
        )
