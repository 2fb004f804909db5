"""Damaged files of MATLAB end in one sentence, also those of which scipy's reader dies."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from scipy.io import savemat

from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.inputs.matlab import load_matlab
from drive_id.files.logs.open_log import open_log

_UNKNOWN = 99  # as a type of element; scipy 1.17 reads from address 0


@pytest.fixture
def deadly(tmp_path):
    """A file whose values are of an unknown type."""
    path = tmp_path / "log.mat"
    savemat(path, {"i_a": np.linspace(0.0, 1.0, 100)})
    content = path.read_bytes()
    values = struct.pack("<II", 9, 800)  # 100 float64
    assert content.count(values) == 1
    path.write_bytes(content.replace(values, struct.pack("<II", _UNKNOWN, 800)))
    return path


def test_a_good_file_is_read(tmp_path):
    savemat(tmp_path / "map.mat", {"psi": np.arange(6.0).reshape(2, 3), "name": "ipm"})
    content = load_matlab(tmp_path / "map.mat", "The map", ["psi"])
    assert content["psi"].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert "name" not in content


def test_a_file_that_ends_the_reader_is_refused(deadly):
    with pytest.raises(ConfigurationError, match=r"^The map is damaged or not a MATLAB file: export it again\.$"):
        load_matlab(deadly, "The map")
    with pytest.raises(DriveIdError, match="damaged"), open_log(deadly):
        pass
