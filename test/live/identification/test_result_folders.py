"""The folders of a node's results: which the quota removes, which it never does, and what the next start publishes."""

from __future__ import annotations

import json
import os
import shutil

import pytest

from drive_id.errors import ConfigurationError, ResultError
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.result_folders import ResultFolders, new_folder

NODE = "/left/identification"


@pytest.fixture
def template(fitted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("template") / "result"
    fitted.save(folder, draw=False)
    return folder


def folders(tmp_path, node=NODE, **quota):
    return ResultFolders(IdentificationSettings(output_directory=str(tmp_path), **quota), node)


def add(tmp_path, template, day, method="joint"):
    """A result of that day."""
    path = tmp_path / f"2026-01-{day:02}_12-00-00_{method}"
    shutil.copytree(template, path)
    os.utime(path, (1e9 + day, 1e9 + day))
    return path


def names(tmp_path):
    return sorted(path.name for path in tmp_path.iterdir() if not path.name.startswith("."))


def test_the_oldest_go_first_and_what_is_not_ours_stays(tmp_path, template):
    strangers = [tmp_path / "2026-01-01_00-00-00_full", tmp_path / "my_best_fit", tmp_path / "notes.txt"]
    strangers[0].mkdir()  # of that name, but not a result
    shutil.copytree(template, strangers[1])  # a result, but of another name
    strangers[2].write_text("mine")
    (tmp_path / "2026-01-02_00-00-00_full").symlink_to(template)
    for day in (9, 3, 7, 5):
        add(tmp_path, template, day)
    found = folders(tmp_path, results_count=2)
    found.note(add(tmp_path, template, 11), 5)
    assert found.findings() == []
    left = {*(path.name for path in strangers), "2026-01-02_00-00-00_full"}
    assert set(names(tmp_path)) - left == {"2026-01-09_12-00-00_joint", "2026-01-11_12-00-00_joint"}
    assert left <= set(names(tmp_path))


def test_the_size_counts_too(tmp_path, template):
    size = sum(file.stat().st_size for file in template.iterdir()) / 1e6
    for day in range(1, 6):
        add(tmp_path, template, day)
    folders(tmp_path, results_size=3.5 * size, results_count=0).note(add(tmp_path, template, 6), 5)
    assert names(tmp_path) == [f"2026-01-{day:02}_12-00-00_joint" for day in (4, 5, 6)]


def test_without_a_quota_all_stay(tmp_path, template):
    for day in range(1, 6):
        add(tmp_path, template, day)
    folders(tmp_path, results_size=0.0, results_count=0).note(tmp_path / names(tmp_path)[0], 5)
    assert len(names(tmp_path)) == 5


def test_the_last_map_of_no_node_goes(tmp_path, template):
    """Two drives share the folder; the left one has not fitted for long."""
    old = add(tmp_path, template, 1)
    folders(tmp_path).note(old, 17)
    right = folders(tmp_path, node="/right/identification", results_count=1)
    for day in (2, 3, 4):
        right.note(add(tmp_path, template, day), day)
    assert names(tmp_path) == [old.name, "2026-01-04_12-00-00_joint"]
    assert folders(tmp_path).last().folder == old
    assert folders(tmp_path).last().stamp == 17
    assert right.last().stamp == 4
    folders(tmp_path, results_size=1e-6).tidy()  # however small the quota
    assert len(names(tmp_path)) == 2


def test_the_last_map_is_that_of_this_node_or_none(tmp_path, template, fitted):
    assert folders(tmp_path / "missing").last() is None
    folders(tmp_path).note(add(tmp_path, template, 1), 17)
    assert folders(tmp_path, node="/right/identification").last() is None
    last = folders(tmp_path).last()
    assert last.result.resistance == pytest.approx(fitted.resistance)
    assert last.result.warnings == fitted.warnings


@pytest.mark.parametrize(
    "text",
    ["", "[]", "[" * 9000, json.dumps({"format": "drive_id/last_map", "node": NODE, "folder": "../../etc", "stamp": 1}),
     json.dumps({"format": "drive_id/last_map", "node": NODE, "folder": "2026-01-01_12-00-00_joint", "stamp": -1}),
     json.dumps({"format": "drive_id/last_map", "node": NODE, "folder": 7, "stamp": 1}), "\x00" * 20_000],
)  # fmt: skip
def test_a_note_that_is_damaged_is_no_note(tmp_path, template, text):
    folders(tmp_path).note(add(tmp_path, template, 1), 17)
    (note,) = tmp_path.glob(".last.*.json")
    note.write_text(text)
    assert folders(tmp_path).last() is None


def test_a_result_is_that_of_the_machine_and_serial_that_were_asked_for(tmp_path, template):
    """Also where its folder is named, whose name tells neither."""
    path = add(tmp_path, template, 1)
    marker = path / "identification.json"
    tree = json.loads(marker.read_text())
    marker.write_text(json.dumps(tree | {"machine": "ipm", "settings": tree["settings"] | {"serial": "0017"}}))
    found = folders(tmp_path)
    for asked in (("", ""), ("ipm", ""), ("", "0017"), ("ipm", "0017")):
        assert found.get(path.name, *asked).folder == path
    with pytest.raises(ResultError, match="is of serial '0017', and serial '0018' was asked for"):
        found.get(path.name, "ipm", "0018")
    with pytest.raises(ResultError, match="is of machine 'ipm', and machine 'spm' was asked for"):
        found.get(path.name, "spm", "")
    marker.write_text(json.dumps(tree | {"machine": ""}))
    with pytest.raises(ResultError, match="names no serial, and serial '0017' was asked for"):
        found.get(path.name, "", "0017")


def test_a_last_map_that_cannot_be_read_is_told(tmp_path, template):
    found = folders(tmp_path)
    path = add(tmp_path, template, 1)
    found.note(path, 17)
    (path / "flux_map.npz").write_bytes(b"damaged")
    assert found.last() is None
    ((_, said),) = found.findings()
    assert said.startswith("The last map is not published again: ")


def test_new_folders_have_names_that_the_quota_knows(tmp_path, template):
    settings = IdentificationSettings(output_directory=str(tmp_path), results_count=1)
    for _ in range(3):
        path = new_folder(settings, "full")
        shutil.copytree(template, path)
        ResultFolders(settings, NODE).note(path, 1)
    assert names(tmp_path) == [path.name]


def test_results_are_found_by_folder_and_name_the_newest_first(tmp_path, template):
    for day, serial in ((3, "a"), (5, "b"), (7, "a")):
        marker = add(tmp_path, template, day, "locked" if day == 7 else "joint") / "identification.json"
        tree = json.loads(marker.read_text())
        tree["settings"]["serial"] = serial
        marker.write_text(json.dumps(tree | {"machine": ""}))
    found = folders(tmp_path)
    listed, total = found.find("", "", 2)
    assert ([each.folder.name[8:10] for each in listed], total) == (["07", "05"], 3)
    assert [each.folder.name[8:10] for each in found.find("", "a", 9)[0]] == ["07", "03"]
    assert found.get("", "", "b").folder.name[8:10] == "05"
    assert found.get(listed[1].folder.name, "", "").folder == found.get(str(listed[1].folder), "", "").folder
    with pytest.raises(ResultError, match="There is no result of machine 'x', serial ''"):
        found.get("", "x", "")
    for folder in ("..", "/etc", str(template), "missing"):
        with pytest.raises(ConfigurationError, match="is not a result in"):
            found.get(folder, "", "")
    (listed[0].folder / "identification.json").write_text("{")
    assert [each.folder.name[8:10] for each in found.find("", "a", 9)[0]] == ["03"], "what is damaged is left out"
