"""Inputs for ``fuzz.py`` that are made to exhaust the reader: small files that unpack to GB, fifos, devices, links."""

from __future__ import annotations

import io
import os
import shutil
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zstandard
from fuzz_inputs import JOINT
from mcap.writer import Writer as McapWriter


def zeros(size: int, head: bytes = b"") -> bytes:
    """Return zstd of a text and ``size`` zeros."""
    packer = zstandard.ZstdCompressor().compressobj()
    parts = [packer.compress(head)] + [packer.compress(bytes(1 << 24)) for _ in range(size >> 24)]
    return b"".join(parts) + packer.flush()


def mcap_of_chunks(count: int, size: int, content: bytes = b"") -> bytes:
    """Return an MCAP file of chunks that unpack to zeros, or to ``content``."""

    def record(opcode: int, body: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(body)) + body

    packed = zstandard.ZstdCompressor().compress(content) if content else zeros(size)
    size = len(content) or size
    chunk = struct.pack("<QQQII", 0, 1, size, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    magic = b"\x89MCAP0\r\n"
    parts = [magic, record(1, struct.pack("<II", 0, 0)), record(6, chunk) * count, record(15, bytes(4))]
    return b"".join([*parts, record(2, bytes(20)), magic])


Bomb = Callable[[Path, Path], tuple[str, ...]]
"""Writes an input into a folder, from the corpus, and returns the arguments."""

_FIT = ("--output", "out", *JOINT)


def _odd(put: Callable[[Path], None], name: str, *words: str) -> Bomb:
    """Return what puts something odd at a name, in a bag or in a result if it lies in a folder ``bag`` or ``r``."""

    def make(corpus: Path, folder: Path) -> tuple[str, ...]:
        path = folder / name
        if path.parent.name == "r":
            shutil.copytree(corpus / "result", path.parent)
            path.unlink()
        elif path.parent.name == "bag":
            path.parent.mkdir()
            (path.parent / "bag_0.mcap").write_bytes(b"\x89MCAP0\r\n")
        put(path)
        return tuple(str(corpus / "ours") if word == "OURS" else word for word in words)

    return make


def _zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _dangling(path: Path) -> None:
    path.symlink_to("nowhere")
    (path.parent / "bag_0.mcap").unlink()
    (path.parent / "bag_0.mcap").symlink_to("nowhere")


def _journal(path: Path) -> None:
    os.mkfifo(path)
    path.with_name("x.db3").write_bytes(b"SQLite format 3\0" + bytes(1000))


def _sparse(head: bytes) -> Callable[[Path], None]:
    def put(path: Path) -> None:
        with path.open("wb") as stream:
            stream.write(head)
            stream.truncate(1 << 38)

    return put


def _chunk(_: Path, folder: Path) -> tuple[str, ...]:
    (folder / "bag.mcap").write_bytes(mcap_of_chunks(1, 1 << 30))
    return ("fit", "bag.mcap", *_FIT)


def _chunks(_: Path, folder: Path) -> tuple[str, ...]:
    (folder / "bag.mcap").write_bytes(mcap_of_chunks(200, 1 << 26))
    return ("fit", "bag.mcap", *_FIT)


def _chunk_of_channels(_: Path, folder: Path) -> tuple[str, ...]:
    record = struct.pack("<BQ", 3, 14) + struct.pack("<HI", 1, 0) + struct.pack("<II", 0, 0)
    (folder / "bag.mcap").write_bytes(mcap_of_chunks(1, 0, record * 4_000_000))
    return ("info", "bag.mcap")


def _packed_file(_: Path, folder: Path) -> tuple[str, ...]:
    (folder / "bag.mcap.zstd").write_bytes(zeros(2 << 30, head=b"\x89MCAP0\r\n"))
    return ("fit", "bag.mcap.zstd", *_FIT)


def _zipped(name: str, member: str, count: int) -> Bomb:
    def make(corpus: Path, folder: Path) -> tuple[str, ...]:
        source = {"x.info": "ours.info", "x.npz": "machine.npz"}[name]
        shutil.copy(corpus / source, folder / name)
        with (
            zipfile.ZipFile(folder / name, "a", zipfile.ZIP_DEFLATED) as archive,
            archive.open(f"{member}.npy", "w", force_zip64=True) as stream,
        ):
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (count,)})
            stream.write(header.getvalue())
            for _ in range(count // (1 << 20)):
                stream.write(bytes(8 << 20))
        if name == "x.info":
            return ("fit", name, *_FIT)
        return ("simulate", "--machine", name, "--output", "bag")

    return make


def _huge_machine(_: Path, folder: Path) -> tuple[str, ...]:
    n, k = 1000, 60
    with zipfile.ZipFile(folder / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        shapes = {"id": (n,), "iq": (n,), "psi_d": (n, n), "psi_q": (n, n), "R": (), "pole_pairs": ()}
        shapes |= {"theta_e_deg": (k,), "psi_d_theta": (n, n, k), "psi_q_theta": (n, n, k)}
        for name, shape in shapes.items():
            with archive.open(f"{name}.npy", "w") as stream:
                header = io.BytesIO()
                np.lib.format.write_array_header_1_0(header, {"descr": "|i1", "fortran_order": False, "shape": shape})
                stream.write(header.getvalue() + bytes(int(np.prod(shape))))
    return ("simulate", "--machine", "x.npz", "--output", "bag")


def _xz_machine(_: Path, folder: Path) -> tuple[str, ...]:
    with zipfile.ZipFile(folder / "x.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("id.npy", bytes(1 << 26))
    return ("simulate", "--machine", "x.npz", "--output", "bag")


def _matlab(_: Path, folder: Path) -> tuple[str, ...]:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    size = 1 << 30
    element = struct.pack("<II", 14, size) + struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 1, size)
    packer = zlib.compressobj()
    packed = packer.compress(element + struct.pack("<II", 1, 10) + b"motorModel".ljust(16, b"\0"))
    packed += packer.compress(struct.pack("<II", 9, size - 64))
    packed += b"".join(packer.compress(bytes(1 << 24)) for _ in range(size >> 24)) + packer.flush()
    (folder / "x.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    return ("simulate", "--machine", "x.mat", "--output", "bag")


def _definition(text: str) -> Bomb:
    def make(_: Path, folder: Path) -> tuple[str, ...]:
        with (folder / "bag.mcap").open("wb") as stream:
            writer = McapWriter(stream)
            writer.start("ros2")
            for topic in ("phase_currents", "phase_voltages", "resolver"):
                kind = writer.register_schema("odd_msgs/msg/Odd", "ros2msg", text.encode())
                writer.add_message(writer.register_channel(f"/{topic}", "cdr", kind), 1, b"\0\1\0\0" + bytes(64), 1)
            writer.finish()  # type: ignore[no-untyped-call]
        return ("fit", "bag.mcap", *_FIT)

    return make


def _metadata_text(text: str) -> Bomb:
    def make(corpus: Path, folder: Path) -> tuple[str, ...]:
        shutil.copytree(corpus / "ours", folder / "bag")
        (folder / "bag" / "metadata.yaml").write_text(text)
        return ("fit", "bag", *_FIT)

    return make


def _yaml_option(option: str, text: str) -> Bomb:
    def make(corpus: Path, folder: Path) -> tuple[str, ...]:
        (folder / "x.yaml").write_text(text)
        return ("fit", str(corpus / "ours"), option, "x.yaml", *_FIT)

    return make


def _marker(text: str) -> Bomb:
    def make(corpus: Path, folder: Path) -> tuple[str, ...]:
        shutil.copytree(corpus / "result", folder / "r")
        (folder / "r" / "identification.json").write_text(text)
        return ("info", "r")

    return make


def _blob(_: Path, folder: Path) -> tuple[str, ...]:
    with sqlite3.connect(folder / "x.db3") as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
            " data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL)"
        )
        topics = ("/phase_currents", "/phase_voltages", "/resolver")
        for key, name in enumerate(topics):
            database.execute("INSERT INTO topics VALUES(?, ?, 'a_msgs/msg/B', 'cdr')", (key, name))
            database.execute("INSERT INTO messages(topic_id, timestamp) VALUES(?, 1)", (key,))
    database.close()
    return ("fit", "x.db3", *_FIT)


_HEAD = "rosbag2_bagfile_information:\n  version: 9\n  topics_with_message_count: []\n  relative_file_paths:\n"
_LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
_LAUGHS += "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
_MERGES = "b0: &b0 {x: 1}\n" + "".join(f"b{k}: &b{k} {{<<: [*b{k - 1}, *b{k - 1}]}}\n" for k in range(1, 40))

BOMBS: dict[str, Bomb] = {
    "fifo as metadata.yaml": _odd(os.mkfifo, "bag/metadata.yaml", "info", "bag"),
    "fifo as a bag": _odd(os.mkfifo, "bag.mcap", "fit", "bag.mcap", *_FIT),
    "fifo as a journal of sqlite": _odd(_journal, "x.db3-wal", "fit", "x.db3", *_FIT),
    "fifo as an information file": _odd(os.mkfifo, "x.info", "fit", "x.info", *_FIT),
    "fifo as settings": _odd(os.mkfifo, "x.yaml", "fit", "OURS", "--config", "x.yaml", *_FIT),
    "fifo as a signals file": _odd(os.mkfifo, "x.yaml", "fit", "OURS", "--signals", "x.yaml", *_FIT),
    "fifo as a machine file": _odd(os.mkfifo, "x.npz", "simulate", "--machine", "x.npz", "--output", "bag"),
    "fifo as flux_map.npz": _odd(os.mkfifo, "r/flux_map.npz", "info", "r"),
    "fifo as identification.json": _odd(os.mkfifo, "r/identification.json", "info", "r"),
    "fifo as the output": _odd(os.mkfifo, "x.info", "accumulate", "OURS", "--output", "x.info"),
    "metadata.yaml is /dev/zero": _odd(_zero, "bag/metadata.yaml", "info", "bag"),
    "a signals file is /dev/zero": _odd(_zero, "x.yaml", "fit", "OURS", "--signals", "x.yaml", *_FIT),
    "a link to itself": _odd(lambda path: path.symlink_to(path.name), "bag.mcap", "fit", "bag.mcap", *_FIT),
    "dangling links": _odd(_dangling, "bag/metadata.yaml", "fit", "bag", *_FIT),
    "a sparse bag of 256 GB": _odd(
        _sparse(b"\x89MCAP0\r\n" + struct.pack("<BQ", 5, 1 << 36)), "bag.mcap", "fit", "bag.mcap", *_FIT
    ),
    "a sparse information file of 256 GB": _odd(_sparse(b"PK\3\4"), "x.info", "fit", "x.info", *_FIT),
    "a chunk of 1 GB of zeros": _chunk,
    "200 chunks of 64 MB of zeros": _chunks,
    "a chunk of 4 million channels": _chunk_of_channels,
    "an .mcap.zstd that unpacks to 2 GB": _packed_file,
    "an information file with a member of 3 GB": _zipped("x.info", "unknown", 400 << 20),
    "a machine file with a member of 3 GB": _zipped("x.npz", "psi_d_theta", 400 << 20),
    "a machine file of int8 that becomes 1 GB": _huge_machine,
    "a machine file packed by LZMA": _xz_machine,
    "a .mat that unpacks to 1 GB": _matlab,
    "a definition with 8 MB of comments": _definition("# a comment of some length\n" * 300_000 + "float64 x\n"),
    "a definition with 20 000 fields": _definition("".join(f"float64 field_{k}\n" for k in range(20_000))),
    "a definition of 200 000 empty lines": _definition("\n" * 200_000),
    "metadata.yaml with 100 000 names": _metadata_text(_HEAD + "".join(f"  - x_{k}.mcap\n" for k in range(100_000))),
    "metadata.yaml with a name of 300 characters": _metadata_text(_HEAD + f"  - {'x' * 300}.mcap\n"),
    "metadata.yaml nested 100 000 deep": _metadata_text("[" * 100_000),
    "metadata.yaml of aliases": _metadata_text(_LAUGHS + _HEAD + "  - *a11\n"),
    "metadata.yaml of merges": _metadata_text(_MERGES),
    "signals of aliases": _yaml_option("--signals", _LAUGHS + "typestore: *a11\n"),
    "settings of aliases": _yaml_option("--config", _LAUGHS + "method: *a11\n"),
    "settings with a long number": _yaml_option("--config", "i_max: 1" + ":1" * 400_000),
    "identification.json nested 1 million deep": _marker("[" * 1_000_000),
    "identification.json with a number of 8 million digits": _marker('{"format": ' + "9" * 8_000_000 + "}"),
    "a computed column of 900 MB in sqlite": _blob,
}
