"""Damage anywhere: an error of ours or the very same data, never anything else."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bag_samples import assert_equal_samples, make_samples, make_truth
from copied_bags import by_rosbags
from rosbags.rosbag2 import StoragePlugin

from drive_id.errors import DriveIdError
from drive_id.files.read.info import bag_info
from drive_id.files.read.several import read_recording
from drive_id.files.write.writer import write_recording

LARGE = [b"\xff" * 8, bytes(8), (1 << 40).to_bytes(8, "little"), (1 << 31).to_bytes(8, "little")]
SAMPLES = make_samples(80, reference=False)


def damaged(data: bytes, rng: random.Random, count: int) -> list[bytes]:
    """Cut, flip, overwrite, remove and insert at random."""
    copies = []
    for _ in range(count):
        at, length = rng.randrange(len(data)), rng.randrange(1, 400)
        copies += [
            data[:at],
            data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :],
            data[:at] + rng.choice(LARGE) + data[at + 8 :],
            data[:at] + data[at + length :],
            data[:at] + rng.randbytes(length) + data[at:],
        ]
    return copies


def outcome(action: Callable[[Path], Any], path: Path) -> Any:
    """Return what ``action`` does with a path; None for an error of ours, which must be one sentence."""
    try:
        return action(path)
    except DriveIdError as error:
        said = str(error)
    assert "\n" not in said
    assert said.endswith(".")
    return None


def try_to_read(path: Path, *, checked: bool) -> None:
    """Accept the same samples or an error of ours."""
    outcome(bag_info, path)
    recording = outcome(read_recording, path)
    if checked and recording is not None:
        assert_equal_samples(recording.samples, SAMPLES)


@pytest.mark.slow  # hundreds of damaged files
@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_damaged_mcap(tmp_path, compression):
    write_recording(tmp_path / "bag", SAMPLES, make_truth(), compression=compression, block_size=20, chunk_size=1000)
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    target = tmp_path / "damaged.mcap"
    for copy in damaged(data, random.Random(compression), 60):
        target.write_bytes(copy)
        try_to_read(target, checked=True)


def copied(tmp_path: Path, storage: StoragePlugin) -> Path:
    write_recording(tmp_path / "bag", SAMPLES, block_size=20)
    by_rosbags(tmp_path / "bag", tmp_path / "copy", storage)
    return next(path for path in (tmp_path / "copy").iterdir() if path.suffix in (".mcap", ".db3"))


@pytest.mark.slow  # hundreds of damaged files
@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_damaged_files_without_checksums(tmp_path, storage):
    """Without checksums nobody can tell a changed value; but nothing else than our errors may come out."""
    file = copied(tmp_path, storage)
    target = tmp_path / f"damaged{file.suffix}"
    for copy in damaged(file.read_bytes(), random.Random(1), 60):
        target.write_bytes(copy)
        try_to_read(target, checked=False)


def test_damaged_metadata(tmp_path):
    write_recording(tmp_path / "bag", SAMPLES, block_size=20)
    file = tmp_path / "bag" / "metadata.yaml"
    data = file.read_bytes()
    for copy in damaged(data, random.Random(2), 30):
        file.write_bytes(copy)
        try_to_read(tmp_path / "bag", checked=True)


@pytest.mark.parametrize(
    "magic", [b"", b"\x89MCAP0\r\n", b"SQLite format 3\0", b"\x28\xb5\x2f\xfd", b"\x04\x22\x4d\x18"]
)
def test_random_files(tmp_path, magic):
    rng = random.Random(magic)
    for k in range(30):
        path = tmp_path / f"{k}.mcap"
        path.write_bytes(magic + rng.randbytes(rng.randrange(2000)))
        with pytest.raises(DriveIdError):
            read_recording(path)
        try_to_read(path, checked=True)


def test_declared_sizes_allocate_nothing(tmp_path):
    """Within 1 GiB of address space on top of what is in use, every length in the file set to something huge."""
    resource = pytest.importorskip("resource")
    write_recording(tmp_path / "bag", SAMPLES, make_truth(), block_size=20)
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    target = tmp_path / "damaged.mcap"
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 1 << 20
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * 4096 + (1 << 30), before[1]))
    try:
        for at in range(0, len(data) - 8, 97):
            target.write_bytes(data[:at] + (1 << 33).to_bytes(8, "little") + data[at + 8 :])
            try_to_read(target, checked=True)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_temporary_files_are_removed(tmp_path, monkeypatch):
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    file = copied(tmp_path, StoragePlugin.SQLITE3)
    shutil.copy(file, tmp_path / "x.db3")
    read_recording(tmp_path / "x.db3")
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(DriveIdError):
        read_recording(file)
    assert list((tmp_path / "scratch").iterdir()) == []
