"""Recordings without checksums: a statement, or a warning once a sample stands out; no flipped bit is silent."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

import drive_id
from drive_id.files.messages.messages import PHASE_CURRENTS, schema_text
from drive_id.files.storage.bag import open_bag
from drive_id.fitting.fit import accumulate_bags
from drive_id.fitting.sources import Sources


def copied(bag: Path, target: Path, *, crcs: bool, flipped: int | None = None) -> Path:
    """Copy the messages of a bag; flip the sign of one current in one of its messages."""
    with open_bag(bag) as opened, target.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE, enable_crcs=crcs)
        writer.start("ros2")
        keys = {}
        for name, topic in opened.topics.items():
            schema = writer.register_schema(topic.type_name, "ros2msg", schema_text(topic.type_name).encode())
            keys[name] = writer.register_channel(name, "cdr", schema)
        count = 0
        for message in opened.messages(frozenset(keys)):
            data = bytearray(message.data)
            if opened.topics[message.topic].type_name == PHASE_CURRENTS:
                if count == flipped:
                    largest = max(range(len(data) - 200, len(data), 4), key=lambda at: abs(value(data, at)))
                    data[largest + 3] ^= 0x80
                count += 1
            writer.add_message(keys[message.topic], message.log_time, bytes(data), message.log_time)
        writer.finish()
    return target


def value(data: bytearray, at: int) -> float:
    return float(struct.unpack_from("<f", data, at)[0])


def told(texts: tuple[str, ...]) -> list[str]:
    return [text for text in texts if "no checksums" in text]


@pytest.mark.parametrize("method", ["psm", "joint"])
def test_what_is_said(bag, tmp_path, method):
    with_checksums = drive_id.fit(copied(bag, tmp_path / "crc.mcap", crcs=True), method=method)
    assert told(with_checksums.warnings) == told(with_checksums.drive.statements) == []
    path = copied(bag, tmp_path / "bare.mcap", crcs=False)
    bare = drive_id.fit(path, method=method)
    assert told(bare.warnings) == []
    (statement,) = told(bare.drive.statements)
    assert statement.startswith(f"{path} has no checksums, so flipped bits are noticed only as outliers: ")
    assert bare.warnings == with_checksums.warnings  # a healthy recording does not look broken

    flipped = drive_id.fit(copied(bag, tmp_path / "flipped.mcap", crcs=False, flipped=70), method=method)
    assert told(flipped.drive.statements) == []
    assert len(told(flipped.warnings)) == 1
    assert any("of the currents, in phase" in text for text in flipped.warnings)


def test_information_files_remember_it(bag, tmp_path):
    paths = [copied(bag, tmp_path / "bare.mcap", crcs=False), bag]
    accumulate_bags(Sources([paths[0]]), tmp_path / "x.info", drive_id.FitSettings("joint", i_max=300.0))
    (statement,) = told(drive_id.fit(tmp_path / "x.info").drive.statements)
    assert statement.startswith(f"{paths[0]} has no checksums")
