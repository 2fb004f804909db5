"""The changelogs that bloom reads say what CHANGELOG.md says, and catkin_pkg understands them."""

from __future__ import annotations

import re
import runpy
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MARKDOWN = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
TOOL = runpy.run_path(str(ROOT / "tools" / "changelog.py"))
FOLDERS = {"drive_id": ROOT, "drive_id_msgs": ROOT / "msg_defs"}
# catkin_pkg calls a function that docutils wants to replace.
pytestmark = pytest.mark.filterwarnings("ignore:nodes.Node.traverse:DeprecationWarning")


@pytest.fixture
def read():
    """Return catkin_pkg's reader, the one that bloom calls."""
    module = pytest.importorskip("catkin_pkg.changelog", reason="catkin_pkg is not installed: it comes with ROS 2")
    return module.get_changelog_from_path


def words(text):
    """Return the words without any markup: links and literals as what is read, escapes gone."""
    text = re.sub(r"\[([^]]+)\]\(([^)]+)\)", r"\1 (\2)", text)
    return text.replace("`", "").replace("\\", "").split()


@pytest.mark.parametrize("package", FOLDERS)
def test_the_committed_files_are_up_to_date(package, read, capfd):
    """Else: python tools/changelog.py."""
    file = FOLDERS[package] / "CHANGELOG.rst"
    assert file.read_text(encoding="utf-8") == TOOL["changelog"](package, TOOL["versions"](MARKDOWN))
    assert ET.parse(FOLDERS[package] / "package.xml").findtext("name") == package
    dated = re.findall(r"^## \[(.+)\] - ", MARKDOWN, re.MULTILINE)
    assert [version for version, _, _ in read(str(file), package).foreach_version(reverse=True)] == dated
    assert capfd.readouterr().err == ""


def test_a_release_of_all_that_is_unreleased_loses_nothing(read, tmp_path, capfd):
    dated = MARKDOWN.replace("## [Unreleased]", "## [Unreleased]\n\n## [0.2.0] - 2026-01-31")
    dated += "\n## [0.1.0] - 2025-12-01\n\n### Fixed\n\n- An *odd* entry_ | with `a_b` and [a page](docs/logs.md).\n"
    file = tmp_path / "CHANGELOG.rst"
    file.write_text(TOOL["changelog"]("drive_id", TOOL["versions"](dated)), encoding="utf-8")
    newest, oldest = read(str(file), "drive_id").foreach_version(reverse=True)
    assert (newest[0], str(newest[1].date())) == ("0.2.0", "2026-01-31")
    assert (oldest[0], str(oldest[1].date())) == ("0.1.0", "2025-12-01")
    (bullets,) = newest[2]
    wanted = re.split(r"^- ", MARKDOWN, flags=re.MULTILINE)[1:]
    wanted = [words(re.split(r"^#", entry, flags=re.MULTILINE)[0]) for entry in wanted]
    found = [words(str(bullet)) for bullet in bullets.bullets]
    assert len(wanted) > 50
    assert [entry[1:] for entry in found] == wanted
    assert {entry[0] for entry in found} >= {"Added:", "Changed:", "Fixed:"}
    (odd,) = oldest[2]
    assert words(str(odd.bullets[0])) == words("Fixed: An *odd* entry_ | with a_b and a page (docs/logs.md).")
    assert capfd.readouterr().err == "", "docutils complains about markup"


def test_the_messages_get_every_version(read, tmp_path):
    file = tmp_path / "CHANGELOG.rst"
    text = TOOL["changelog"](
        "drive_id_msgs", TOOL["versions"]("## [1.2.3] - 2026-01-31\n- One.\n## [1.2.2] - 2026-01-01")
    )
    file.write_text(text, encoding="utf-8")
    versions = [(version, len(content)) for version, _, content in read(str(file), "drive_id_msgs").foreach_version()]
    assert versions == [("1.2.2", 1), ("1.2.3", 1)]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("## 1.2.3\n", r"^CHANGELOG.md:1: write '## \[1.2.3\] - "),
        ("## [Unreleased] - 2026-01-31\n", r"^CHANGELOG.md:1: write"),
        ("## [1.2.3] - today\n", r"^CHANGELOG.md:1: write"),
        ("# Changelog\n\n## [Unreleased]\n\nLoose text.\n", r"^CHANGELOG.md:5: the line belongs to no entry"),
    ],
)
def test_a_mistake_is_named_with_its_line(text, error):
    with pytest.raises(ValueError, match=error):
        TOOL["versions"](text)
