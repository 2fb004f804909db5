"""Requested recordings: what is not a file or a folder is refused before anything opens it."""

from __future__ import annotations

import os
import socket
import time

import pytest

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import NotABagError
from drive_id.live.data_directory import existing_recording
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier


@pytest.fixture
def data(tmp_path):
    (tmp_path / "fifo_inside").mkdir()
    os.mkfifo(tmp_path / "fifo_inside" / "metadata.yaml")
    (tmp_path / "socket_inside").mkdir()
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(tmp_path / "socket_inside" / "bag_0.mcap"))
    os.mkfifo(tmp_path / "fifo.mcap")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "said"),
    [("fifo.mcap", "There is no recording"), ("fifo_inside", "neither a file nor a folder"),
     ("socket_inside", "holds bag_0.mcap")],
)  # fmt: skip
def test_what_would_hang_is_refused(data, name, said):
    with pytest.raises(NotABagError, match=said):
        existing_recording(data, name)


def test_a_request_for_it_is_answered_at_once(data):
    settings = IdentificationSettings(data_directory=str(data), output_directory=str(data / "results"))
    identifier = Identifier(settings, FitSettings())
    start = time.monotonic()
    reply = identifier.job(["fifo_inside"], "")(lambda *_: None)
    assert reply.code == "not_a_bag"
    assert time.monotonic() - start < 5.0
