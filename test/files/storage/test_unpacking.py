"""Files that unpack to far more than they are: refused before they take the memory."""

from __future__ import annotations

import sqlite3
import struct
import tracemalloc
from pathlib import Path

import pytest
import zstandard
from bag_samples import make_samples
from drive_bags import TOPICS
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from drive_id.errors import BagError, MessageTypeError, NotABagError, TruncatedBagError
from drive_id.files.messages.messages import PHASE_CURRENTS, schema_text
from drive_id.files.read.info import bag_info
from drive_id.files.read.several import read_recording
from drive_id.files.storage import container
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.recover import recover_bag
from drive_id.files.write.writer import write_recording

MAGIC = b"\x89MCAP0\r\n"


def zeros(size: int, head: bytes = b"") -> bytes:
    packer = zstandard.ZstdCompressor().compressobj()
    parts = [packer.compress(head)] + [packer.compress(bytes(1 << 22)) for _ in range(size >> 22)]
    return b"".join(parts) + packer.flush()


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def of_chunks(packed: bytes, size: int, count: int = 1) -> bytes:
    chunk = struct.pack("<QQQII", 0, 1, size, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    parts = [MAGIC, record(1, bytes(8)), record(6, chunk) * count, record(15, bytes(4)), record(2, bytes(20)), MAGIC]
    return b"".join(parts)


def of_messages(path: Path, kinds: dict[str, str], data: bytes, text: str = "", count: int = 1, **options) -> Path:
    """Write an MCAP file of topics of these types, ours or defined by the text, each with one message many times."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start("ros2")
        for topic, kind in kinds.items():
            schema = writer.register_schema(kind, "ros2msg", (text or schema_text(kind)).encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for time in range(count):
                writer.add_message(channel, time, data, time)
        writer.finish()
    return path


def peak(action, path: Path, kind: type[BagError], said: str) -> float:
    """Return the memory that a refusal takes, bytes."""
    tracemalloc.start()
    try:
        with pytest.raises(kind, match=said):
            action(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("action", [read_recording, recover_bag])
def test_a_chunk_of_a_gigabyte(tmp_path, action):
    path = tmp_path / "x.mcap"
    path.write_bytes(of_chunks(zeros(1 << 24), 1 << 30))
    kind, said = (TruncatedBagError, "it unpacks to more than") if action is read_recording else (BagError, "unpacks")
    assert peak(action, path, kind, said) < 5e7
    assert not (tmp_path / "x_recovered").exists()


def test_many_chunks_of_allowed_size(tmp_path, monkeypatch):
    monkeypatch.setattr(container, "_UNPACKED", 1 << 23)
    path = tmp_path / "x.mcap"
    unknown = record(0x80, bytes((1 << 22) - 9))
    path.write_bytes(of_chunks(zstandard.compress(unknown), len(unknown), 50))
    with pytest.raises(TruncatedBagError, match=r"it unpacks to more than .* MB, too much for its size"):
        read_recording(path)


def test_zeros_are_no_records(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(of_chunks(zeros(1 << 22), 1 << 22))
    with pytest.raises(TruncatedBagError, match="ends within a record"):
        read_recording(path)


def test_the_same_channel_many_times_is_read_once(tmp_path):
    channel = record(4, struct.pack("<HHI", 1, 0, 1) + b"x" + struct.pack("<I", 3) + b"cdr" + bytes(4))
    path = tmp_path / "x.mcap"
    path.write_bytes(of_chunks(zstandard.compress(channel * 1000), 1000 * len(channel)))
    with open_bag(path) as bag:
        assert list(bag.topics) == ["x"]


@pytest.mark.parametrize("ending", [".mcap.zstd", ".db3.zstd"])
def test_a_file_packed_as_a_whole(tmp_path, monkeypatch, ending):
    monkeypatch.setattr(container, "_UNPACKED", 1 << 23)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = tmp_path / f"x{ending}"
    path.write_bytes(zeros(1 << 26, MAGIC if "mcap" in ending else b"SQLite format 3\0"))
    with pytest.raises(TruncatedBagError, match="it unpacks to more than"):
        bag_info(path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_message_packed_by_itself(tmp_path, monkeypatch):
    monkeypatch.setattr(container, "LARGEST_CHUNK", 1 << 22)
    path = of_messages(tmp_path / "x.mcap", TOPICS, zeros(1 << 24))
    with pytest.raises(TruncatedBagError, match="cannot be decompressed"):
        read_recording(path)


def of_sqlite(path, table, *values):
    """Make a file of one topic, whose messages are in a table with these columns, and one message."""
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)")
        database.execute(f"CREATE TABLE messages({table})")
        database.execute("INSERT INTO topics VALUES(1, '/x', 'a/msg/B', 'cdr')")
        database.execute(f"INSERT INTO messages VALUES({', '.join(values)})")
    database.close()
    return path


def test_a_table_that_is_computed(tmp_path):
    path = of_sqlite(tmp_path / "x.db3", "id, topic_id, timestamp, data AS (zeroblob(900000000))", "1", "1", "1")
    with pytest.raises(TruncatedBagError, match="its table messages is computed, not recorded"):
        bag_info(path)


def test_a_message_that_is_too_large(tmp_path, monkeypatch):
    monkeypatch.setattr("drive_id.files.storage.sqlite.LARGEST_CHUNK", 1000)
    table = "id INTEGER PRIMARY KEY, topic_id, timestamp, data"
    path = of_sqlite(tmp_path / "x.db3", table, "1", "1", "1", "zeroblob(1001)")
    with pytest.raises(TruncatedBagError, match="it holds a message of 1 kB"):
        bag_info(path)


@pytest.mark.parametrize(
    "text", ["# a comment\n" * 300_000, "".join(f"float64 field_{k}\n" for k in range(20_000)), "\n" * 200_000]
)
def test_definitions_that_are_too_long(tmp_path, text):
    kinds = dict.fromkeys(TOPICS, "odd_msgs/msg/Odd")
    path = of_messages(tmp_path / "x.mcap", kinds, bytes(64), text, compression=CompressionType.NONE)
    with pytest.raises(MessageTypeError, match="it is too long"):
        read_recording(path)


# -- checksums ---------------------------------------------------------------------------------------------------------


def checked(path: Path) -> bool:
    with open_bag(path) as bag:
        for _ in bag.messages(frozenset(bag.topics)):
            pass
        return bag.checked


@pytest.mark.parametrize(
    ("compression", "crcs", "data_crcs", "chunks", "expected"),
    [
        (CompressionType.NONE, True, False, True, True),
        (CompressionType.ZSTD, False, False, True, False),
        (CompressionType.NONE, False, False, True, False),
        (CompressionType.NONE, False, True, False, True),
        (CompressionType.NONE, True, False, False, False),
        (CompressionType.LZ4, False, False, True, False),
    ],
)
def test_which_files_have_checksums(tmp_path, compression, crcs, data_crcs, chunks, expected):
    options = {"enable_crcs": crcs, "enable_data_crcs": data_crcs, "use_chunking": chunks, "compression": compression}
    path = of_messages(tmp_path / "x.mcap", {"/x": PHASE_CURRENTS}, bytes(1000), count=100, **options)
    assert checked(path) == expected


def test_a_checksum_around_all_of_a_file(tmp_path):
    write_recording(tmp_path / "bag", make_samples())
    (file,) = (tmp_path / "bag").glob("*.mcap")
    assert checked(tmp_path / "bag")
    plain = {"enable_crcs": False, "compression": CompressionType.NONE}
    bare = of_messages(tmp_path / "bare.mcap", {"/x": "a/msg/B"}, bytes(12), "float64 x", **plain)
    for sealed in (False, True):
        target = tmp_path / f"{sealed}.mcap.zstd"
        target.write_bytes(zstandard.ZstdCompressor(write_checksum=sealed).compress(bare.read_bytes()))
        assert checked(target) == sealed
    assert file.exists()


def test_a_file_that_can_no_longer_be_opened_is_told(tmp_path, monkeypatch):
    path = tmp_path / "x.mcap.zst"
    path.write_bytes(zstandard.compress(MAGIC))

    def refuse(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(container, "open_input", refuse)
    with pytest.raises(NotABagError, match=r"cannot be read \(Permission denied\): check the path and its permissions"):
        container.unpack_file(path, tmp_path)
