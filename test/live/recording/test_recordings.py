"""The list of recordings: the newest first, with what their metadata tell, or why they cannot be read."""

from __future__ import annotations

import os
import shutil

import pytest

from drive_id.errors import OutputError
from drive_id.files.read.several import read_recording
from drive_id.live.recording.recordings import find_recordings


def test_the_newest_come_first_with_their_figures(bag, tmp_path):
    for age, name in enumerate(("first", "second", "third")):
        shutil.copytree(bag, tmp_path / name)
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    (tmp_path / "third" / "metadata.yaml").unlink()
    os.utime(tmp_path / "third", (1e9 + 2, 1e9 + 2))
    (tmp_path / "notes").mkdir()
    (tmp_path / "link").symlink_to(bag)
    found, total = find_recordings(tmp_path, "", 2)
    assert ([each.path.name for each in found], total) == (["third", "second"], 3)
    assert "has no metadata.yaml" in found[0].error
    samples = read_recording(bag).samples
    assert found[1].duration == pytest.approx(samples.stamp[-1] - samples.stamp[0], rel=0.02)
    assert abs(found[1].begin - samples.stamp[0]) < 10**9
    assert found[1].messages > 100
    assert found[1].size == sum(file.stat().st_size for file in (tmp_path / "second").iterdir())
    assert [each.path.name for each in find_recordings(tmp_path, "fir", 5)[0]] == ["first"]


def test_a_directory_that_is_not_there_yet_is_empty_and_a_file_is_none(tmp_path):
    assert find_recordings(tmp_path / "none", "", 5) == ([], 0)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be read"):
        find_recordings(tmp_path / "file", "", 5)
