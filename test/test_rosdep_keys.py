"""The table of keys that the build farm cannot install is that of the index."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parent.parent / "tools" / "rosdep_keys.py"
DISTRIBUTION = """
release_platforms: {debian: [bookworm], rhel: ['9'], ubuntu: [noble]}
repositories:
  one: {release: {packages: [action_msgs, std_msgs], version: 1.0.0-1}}
  rclpy: {release: {version: 7.1.4-1}}
  launch: {release: {}}
"""
RULES = """
python3-numpy: {debian: [python3-numpy], ubuntu: {'*': [python3-numpy], focal: null}, rhel: {'*': [a], '9': null}}
python3-rich: {debian: {bookworm: {pip: {packages: [rich]}}}, ubuntu: {apt: {packages: [b]}}, rhel: {'8': [b]}}
"""


@pytest.fixture
def index(tmp_path):
    for folder in ("jazzy", "kilted", "rosdep"):
        (tmp_path / folder).mkdir()
    for distro in ("jazzy", "kilted"):
        (tmp_path / distro / "distribution.yaml").write_text(DISTRIBUTION)
    (tmp_path / "rosdep" / "base.yaml").write_text("{}")
    (tmp_path / "rosdep" / "python.yaml").write_text(RULES)
    return tmp_path


@pytest.mark.parametrize(
    ("key", "bookworm", "rhel", "noble"),
    [
        ("std_msgs", "package", "package", "package"),
        ("rclpy", "package", "package", "package"),
        ("launch", "nothing", "nothing", "nothing"),
        ("python3-numpy", "package", "nothing", "package"),
        ("python3-rich", "pip", "nothing", "package"),
        ("python3-plotly", "nothing", "nothing", "nothing"),
    ],
)
def test_what_installs_a_key(index, key, bookworm, rhel, noble):
    found = runpy.run_path(str(TOOL))["findings"](index, "jazzy", [key])
    assert found == {key: {"debian bookworm": bookworm, "rhel 9": rhel, "ubuntu noble": noble}}


def test_the_page_names_keys_of_the_package(index, monkeypatch, capsys):
    names = runpy.run_path(str(TOOL))["keys"]()
    assert {"rclpy", "ament_cmake", "python3-numpy"} <= set(names)
    assert "drive_id_msgs" not in names
    page = (TOOL.parent.parent / "docs" / "engineering" / "release.md").read_text(encoding="utf-8")
    rows = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert set(rows) < set(names)
    assert f"Of the {len(names)} keys in both `package.xml` files, {len(names) - len(rows)} are packages" in page
    monkeypatch.setattr(sys, "argv", ["rosdep_keys.py", str(index)])
    runpy.run_path(str(TOOL), run_name="__main__")
    said = capsys.readouterr().out
    assert "| `python3-numpy` | package | nothing | package |" in said
    assert "| `rclpy` |" not in said


def test_a_folder_without_an_index_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["rosdep_keys.py", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"has no jazzy/distribution\.yaml: give a checkout of rosdistro"):
        runpy.run_path(str(TOOL), run_name="__main__")
