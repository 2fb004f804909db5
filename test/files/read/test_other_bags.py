"""ROS 1 bags, and JSON messages in MCAP files, by the same signals file."""

from __future__ import annotations

import numpy as np
import pytest
from bag_samples import assert_equal_samples, make_samples
from other_bags import SIGNALS, write_json, write_ros1

from drive_id.core.signals.join import joined
from drive_id.errors import TruncatedBagError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.info import bag_info
from drive_id.files.read.reader import bag_pieces
from drive_id.files.read.several import read_recording
from drive_id.inspection.contents import read_contents

N = 300


@pytest.fixture(scope="module")
def samples():
    return make_samples(N, reference=False)


@pytest.mark.parametrize(("name", "write"), [("log.bag", write_ros1), ("log.mcap", write_json)])
def test_the_numbers_are_those_of_the_recording(tmp_path, samples, name, write):
    path = write(tmp_path / name, samples)
    found = read_recording(path, parse_signals(SIGNALS, "test")).samples
    assert_equal_samples(found, samples)
    assert_equal_samples(joined(list(bag_pieces(path, parse_signals(SIGNALS, "test")))), found)
    (topic,) = bag_info(path).topics
    assert (topic.name, topic.count) == ("/log", N)
    (table,) = read_contents(path).tables
    assert set(table.columns) == {f"{x}[{k}]" for x in "iu" for k in range(3)} | {"rotor.angle", "rotor.speed"}
    np.testing.assert_array_equal(table.columns["u[1]"], samples.u_abc[:, 1])


def test_a_ros_1_bag_that_was_cut_off(tmp_path, samples):
    path = write_ros1(tmp_path / "log.bag", samples)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(TruncatedBagError, match="is no readable ROS 1 bag"):
        read_recording(path, parse_signals(SIGNALS, "test"))
