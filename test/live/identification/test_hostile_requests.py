"""Recordings that would block for ever: each request is answered, and the next one, too."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path

import pytest

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.worker import Worker


def fifo_metadata(folder: Path) -> None:
    os.mkfifo(folder / "metadata.yaml")


def device_metadata(folder: Path) -> None:
    (folder / "metadata.yaml").symlink_to("/dev/zero")


def fifo_file(folder: Path) -> None:
    os.mkfifo(folder / "x_0.mcap")


def fifo_journal(folder: Path) -> None:
    (folder / "x_0.db3").write_bytes(b"SQLite format 3\0" + bytes(1000))
    os.mkfifo(folder / "x_0.db3-wal")


@pytest.mark.cases
@pytest.mark.parametrize("make", [fifo_metadata, device_metadata, fifo_file, fifo_journal])
def test_a_request_for_what_blocks_is_answered_and_so_is_the_next(tmp_path, bag, make):
    data = tmp_path / "data"
    (data / "odd").mkdir(parents=True)
    make(data / "odd")
    shutil.copytree(bag, data / "good")
    settings = IdentificationSettings(
        data_directory=str(data), output_directory=str(tmp_path / "out"), picture=False
    )  # fmt: skip
    identifier, worker = Identifier(settings, FitSettings("joint")), Worker()
    replies = []
    for name in ("odd", "good"):
        done = threading.Event()
        try:
            job = identifier.job([name], "joint")
        except DriveIdError as error:
            replies.append(error.code)
            continue
        worker.start(job, lambda reply, done=done: (replies.append(reply.code), done.set()))
        assert done.wait(60.0), name
    assert replies[0] in ("not_a_bag", "truncated_bag", "configuration")
    assert replies[1:] == ["ok"]
