"""Further kinds of input for ``fuzz.py``: good ones on a machine that runs out of something, or is interrupted."""

from __future__ import annotations

import random
import struct
from pathlib import Path

from fuzz_inputs import LARGE, Kind, Limit

_COMMANDS = (
    ("fit", "{corpus}/ours", "--output", "out", "--method", "joint"),
    ("fit", "{corpus}/ours", "--output", "out", "--method", "joint", "--report"),
    ("fit", "{corpus}/nocrc.mcap", "--output", "out", "--method", "psm"),
    ("fit", "{corpus}/log.csv", "--signals", "{corpus}/log.csv.yaml", "--output", "out", "--method", "joint"),
    ("fit", "{corpus}/slow.csv", "--signals", "{corpus}/slow.csv.yaml", "--output", "out", "--method", "static"),
    ("convert", "{corpus}/log.h5", "out", "--signals", "{corpus}/log.h5.yaml"),
    ("check", "{corpus}/log.mat", "--draft", "out"),
    ("accumulate", "{corpus}/ours", "--output", "out"),
    ("simulate", "--machine", "ipm", "--output", "out", "--seconds", "0.5"),
    ("recover", "{corpus}/plain", "--output", "out"),
    ("import", "{corpus}/map.csv", "--output", "out", "--pole-pairs", "3", "--resistance", "0.45"),
    ("report", "{corpus}/result", "--output", "out"),
    ("analyze", "{corpus}/result", "--output", "out"),
    ("export", "{corpus}/result", "--format", "csv", "--output", "out"),
    ("compare", "{corpus}/result", "{corpus}/result"),
    ("info", "{corpus}/ours"),
)
_RECORDS = {2: "footer", 7: "message index", 8: "chunk index", 11: "statistics", 14: "summary offset"}


def _limited(name: str, least: float, most: float) -> Kind:
    def make(corpus: Path, _: Path, rng: random.Random) -> tuple[str, tuple[str, ...], str, Limit]:
        value = least * (most / least) ** rng.random()
        arguments = tuple(part.format(corpus=corpus) for part in rng.choice(_COMMANDS))
        return f"{name} {value:.3g}", arguments, "", Limit(name, value)

    return make


def _index(corpus: Path, folder: Path, rng: random.Random) -> tuple[str, tuple[str, ...], str]:
    """Damage the indices of an MCAP file without checksums, of which the messages stay whole."""
    data = bytearray((corpus / "nocrc.mcap").read_bytes())
    found, at = [], 8
    while at + 9 <= len(data) - 8:
        code, length = struct.unpack_from("<BQ", data, at)
        if code in _RECORDS:
            found.append((code, at + 9, length))
        at += 9 + length
    said = []
    for _ in range(rng.choice((1, 1, 3, 20))):
        wanted = rng.choice(sorted({code for code, _, _ in found}))
        code, start, length = rng.choice([entry for entry in found if entry[0] == wanted])
        large = rng.choice((*LARGE, rng.randbytes(8), struct.pack("<Q", rng.randrange(len(data)))))
        where = start - rng.choice((0, 0, 0, 8)) + rng.randrange(max(length, 1))
        data[where : where + 8] = large
        said.append(f"{large.hex()} at {where} ({_RECORDS[code]})")
    (folder / "nocrc.mcap").write_bytes(bytes(data))
    arguments = rng.choice((("info", "nocrc.mcap"), ("fit", "nocrc.mcap", "--output", "out", "--method", "joint")))
    return ", ".join(said), arguments, "nocrc.mcap joint" if arguments[0] == "fit" else ""


LIMIT_KINDS: dict[str, Kind] = {
    "mcap_index": _index,
    "interrupt": _limited("interrupt", 0.01, 3.0),
    "file_size": _limited("file_size", 3000, 3e6),
    "open_files": _limited("open_files", 1, 20),
    "memory": _limited("memory", 1e6, 1e9),
    "full_output": _limited("full_output", 1, 2),
}
"""Seconds until SIGINT, bytes of the largest file, further open files, further bytes, and output to a full disk."""
