"""Requested recordings: what is not a file or a folder is refused before anything opens it."""

from __future__ import annotations

import os
import socket
import time

import pytest

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, NotABagError
from drive_id.files.messages.messages import PHASE_CURRENTS
from drive_id.files.storage.metadata import WRITTEN
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter
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


def recorded(path):
    """A recording as the recorder completes it: with counts of each topic in its metadata."""
    writer = Rosbag2McapWriter(path)
    writer.add_topic("/phase_currents", PHASE_CURRENTS)
    writer.close({f"{WRITTEN}/phase_currents": "0"})
    return path


def test_what_the_recorder_returned_is_found_whatever_both_directories_are(tmp_path):
    theirs = recorded(tmp_path / "theirs" / "bag")
    assert existing_recording(tmp_path / "mine", str(theirs)) == theirs
    (theirs / "link").symlink_to("/etc/hostname")
    with pytest.raises(ConfigurationError, match="is not within the data directory"):
        existing_recording(tmp_path / "mine", str(theirs))


@pytest.mark.parametrize("name", ["theirs/bag", "../theirs/bag", "/etc", "/dev/zero"])
def test_what_is_elsewhere_and_not_of_the_recorder_is_refused(tmp_path, name):
    recorded(tmp_path / "theirs" / "bag")
    with pytest.raises((ConfigurationError, NotABagError)):
        existing_recording(tmp_path / "mine", name)


def test_a_bag_of_others_elsewhere_is_refused(tmp_path):
    theirs = recorded(tmp_path / "bag")
    text = (theirs / "metadata.yaml").read_text().replace(WRITTEN, "written:")
    (theirs / "metadata.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match="is not within the data directory"):
        existing_recording(tmp_path / "mine", str(theirs))
