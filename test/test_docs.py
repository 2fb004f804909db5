"""The pages: their Python runs, their links lead somewhere, the files that they name exist."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
OF_TODAY = [page for page in PAGES if page.parent.name != "adr" and page.name != "CHANGELOG.md"]
"""The others may name what is gone."""
PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
SOURCE = re.compile(r"`((?:drive_id|core|files|fitting|config|examples|benchmarks|test|tools|docs)/[\w./]+)`")


def test_the_python_of_the_page_runs(bag, tmp_path, monkeypatch):
    shutil.copytree(bag, tmp_path / "my_bag")
    shutil.copy(ROOT / "config" / "signals_default.yaml", tmp_path / "my_signals.yaml")
    monkeypatch.chdir(tmp_path)
    blocks = PYTHON.findall((ROOT / "docs" / "python.md").read_text(encoding="utf-8"))
    assert len(blocks) > 5
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), names)
    assert (tmp_path / "my_drive" / "identification.json").exists()
    assert (tmp_path / "flux.pdf").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    targets = [target for target in LINK.findall(text) if not target.startswith(("http:", "https:", "mailto:"))]
    assert [target for target in targets if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", OF_TODAY, ids=lambda page: str(page.relative_to(ROOT)))
def test_named_files_exist(page):
    named = SOURCE.findall(page.read_text(encoding="utf-8"))
    missing = [name for name in named if not any((ROOT / base / name).exists() for base in ("", "drive_id"))]
    assert missing == []


def test_named_tests_exist():
    named = {name for page in OF_TODAY for name in re.findall(r"`(test_\w+)`", page.read_text(encoding="utf-8"))}
    files = (ROOT / "test").rglob("test_*.py")
    defined = {
        name
        for file in files
        for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert named
    assert named <= defined


CATALOGUE = yaml.safe_load((ROOT / "drive_id" / "messages.yaml").read_text(encoding="utf-8"))
WARNINGS = [
    line.removeprefix("| ").split(" | ")[:2]
    for line in (ROOT / "docs" / "warnings.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| code")
]


def templates(codes):
    """Return the templates of codes, their clauses filled in; without codes, all."""
    found = [
        text for kind in CATALOGUE for key, text in CATALOGUE[kind].items() if not codes or key.split(".")[0] in codes
    ]
    return [re.sub(r"\{(\w+)\}", lambda name: CATALOGUE["clause"].get(name[1], name[0]), text) for text in found]


@pytest.mark.parametrize(("names", "title"), WARNINGS)
def test_explained_warnings_are_those_of_the_code(names, title):
    """Each piece of a sentence between placeholders is in a template of its codes."""
    strings = templates(re.findall(r"`(\w+)`", names))
    title = re.sub(r" \(`.*\)$", "", title)
    pieces = [piece.strip(" ,.%") for piece in re.split(r"\*\w\*|…|1 %|, or is |, or: |; (?=[A-Z*])", title)]
    assert [piece for piece in pieces if piece and not any(piece in string for string in strings)] == []


def test_each_warning_is_explained():
    known = {name for names, _ in WARNINGS for name in re.findall(r"`(\w+)`", names)}
    known |= set(re.findall(r"`(\w+)`", (ROOT / "docs" / "checks.md").read_text(encoding="utf-8")))
    assert {key.split(".")[0] for key in CATALOGUE["warning"]} <= known
