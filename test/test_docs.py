"""The pages: their Python and commands run, their links lead somewhere, the files that they name exist."""

from __future__ import annotations

import ast
import re
import runpy
import shutil
from pathlib import Path

import pytest
import yaml

import drive_id

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
OF_TODAY = [page for page in PAGES if page.parent.name != "adr" and page.name != "CHANGELOG.md"]
"""The others may name what is gone."""
PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
SOURCE = re.compile(r"`((?:drive_id|core|files|fitting|config|examples|benchmarks|test|tools|docs)/[\w./]+)`")


@pytest.fixture
def folder(bag, tmp_path, monkeypatch):
    """The working directory, with recordings of the names in the pages."""
    for name in ("my_bag", "my_log"):
        shutil.copytree(bag, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow  # pages simulate and fit
@pytest.mark.usefixtures("coarse_plans", "plain_reports")
@pytest.mark.parametrize("name", ["README.md", "docs/python.md", "docs/report.md"])
def test_the_python_of_a_page_runs(name, folder, fitted):
    shutil.copy(ROOT / "config" / "signals_default.yaml", folder / "my_signals.yaml")
    fitted.save(folder / "my_drive")
    blocks = PYTHON.findall((ROOT / name).read_text(encoding="utf-8"))
    assert blocks
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, name, "exec"), names)
    assert ("result" in names) or ("twin" in names)


@pytest.mark.parametrize("page", OF_TODAY, ids=lambda page: str(page.relative_to(ROOT)))
def test_all_python_is_python(page):
    for block in PYTHON.findall(page.read_text(encoding="utf-8")):  # cells are run when the site is built
        ast.parse(block)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("README.md", r"10\s+kHz take (\S+) s to fit and 10 minutes take (\S+) s"),
        ("docs/limits.md", r"10 s of data in (\S+) s, 10 minutes in (\S+) s"),
    ],
)
def test_the_times_of_a_page_are_those_of_make_bench(name, said):
    told = re.search(said, (ROOT / name).read_text("utf-8"))
    page = (ROOT / "docs" / "engineering" / "performance.md").read_text("utf-8")
    ten = re.search(r"^\| 10 s, `full`: time \| [^|]*\| ([\d.]+) s \|", page, re.MULTILINE)
    minutes = re.search(r"^\| `full`, 600 s at 10 kHz \| [^|]*\| ([\d.]+) s,", page, re.MULTILINE)
    assert [f"{float(x):.2g}" for x in told.groups()] == [f"{float(found[1]):.2g}" for found in (ten, minutes)]


def test_the_limits_are_those_of_the_population():
    page = (ROOT / "docs" / "engineering" / "population.md").read_text("utf-8")
    cells = re.search(r"^\| all \| (.*) \|$", page, re.MULTILINE)[1].split(" | ")
    number, _, half, _, _, most, _, worst, half_r, most_r, held, _ = cells
    limits = " ".join((ROOT / "docs" / "limits.md").read_text("utf-8").split())
    assert f"{number} whose effects can be identified" in limits
    assert f"flux error {half} % in the median, {most} % in 95 % of them, {worst} % at most" in limits
    assert f"R {half_r} % and {most_r} %" in limits
    assert f"{held} on random drives" in limits


def test_the_limits_are_those_of_the_robustness():
    page = (ROOT / "docs" / "engineering" / "robustness.md").read_text("utf-8")
    errors = re.findall(r"^\| [^|]+ \| ([\d.]+) / ([\d.]+) \|", page, re.MULTILINE)
    small, fair = (sum(max(float(d), float(q)) <= most for d, q in errors) for most in (0.05, 0.1))
    limits = " ".join((ROOT / "docs" / "limits.md").read_text("utf-8").split())
    assert f"at most 0.05 % in {small} of {len(errors)} cases, 0.1 % in {fair}" in limits


def test_the_reference_holds_all_public_names():
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert set(re.findall(r":: drive_id\.(\w+)$", text, re.MULTILINE)) == set(drive_id.__all__)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    targets = [target for target in LINK.findall(text) if not target.startswith(("http:", "https:", "mailto:"))]
    assert [target for target in targets if not (page.parent / target).exists()] == []


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda page: page.name
)
def test_no_sentence_has_more_than_35_words(page):
    """Of a page of the site; a cell of a table and an item of a list are sentences of their own."""
    left_out = r"(?ms)\A---.*?^---$|<!-- .*?<!-- End -->|```.*?```|^ {4}[^\n]*|!\[.*?\]"
    text = re.sub(left_out, "", page.read_text(encoding="utf-8"))
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "x", text)
    for part in re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) |\|", text):
        for sentence in re.split(r"(?<=[.!?])[*”)]*\s+", " ".join(part.split())):
            words = [word for word in sentence.split() if re.search(r"\w", word)]
            assert len(words) <= 35, sentence


def test_links_are_called_by_titles():
    pages = (page for page in OF_TODAY if page.is_relative_to(ROOT / "docs"))
    named = [(page.name, name) for page in pages for name in re.findall(r"\[(\w+\.md)\]", page.read_text("utf-8"))]
    assert named == []


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


CATALOGUE = yaml.safe_load((ROOT / "drive_id" / "common" / "messages.yaml").read_text(encoding="utf-8"))
ROWS = re.findall(
    r"^\| ([^|]+) \| [^|]+ \| (.*) \| .* \|$", (ROOT / "docs" / "findings.md").read_text("utf-8"), re.MULTILINE
)
WARNINGS = [(codes, "…".join(quoted)) for codes, said in ROWS if (quoted := re.findall("“(.*?)”", said))]


def templates(codes):
    """Return the templates of codes, their clauses filled in and words in the plural; without codes, all."""
    found = [
        text for kind in CATALOGUE for key, text in CATALOGUE[kind].items() if not codes or key.split(".")[0] in codes
    ]
    found = [re.sub(r"\{(\w+)\}", lambda name: CATALOGUE["clause"].get(name[1], name[0]), text) for text in found]
    word = re.compile(r"\{\w+:[^{}#]*#([^{}/]+)(?://([^{}]+))?\}")
    return [word.sub(lambda of: of[2] or f"{of[1]}s", text) for text in found]


@pytest.mark.parametrize(("names", "title"), WARNINGS)
def test_explained_warnings_are_those_of_the_code(names, title):
    """Each piece of a sentence between placeholders is in a template of its codes."""
    strings = templates(re.findall(r"`(\w+)`", names))
    pieces = [piece.strip(" ,.%") for piece in re.split(r"\*\w\*|…|1 %|, or is |, or: |; (?=[A-Z*])", title)]
    assert [piece for piece in pieces if piece and not any(piece in string for string in strings)] == []


def test_each_warning_is_explained():
    assert len(WARNINGS) > 50
    known = {code for codes, _ in ROWS for code in re.findall(r"`(\w+)`", codes)}
    assert {key.split(".")[0] for key in CATALOGUE["warning"]} <= known


def test_a_site_that_says_too_much_is_refused(tmp_path):
    excess = runpy.run_path(str(ROOT / "tools" / "check_site.py"))["excess"]
    (tmp_path / "_sources" / "engineering").mkdir(parents=True)
    (tmp_path / "_sources" / "engineering" / "archive.md.txt").write_text("word " * 40_000)
    for pages, words, faults in ((18, 30_000, 0), (19, 30_000, 1), (18, 30_001, 1), (0, 0, 2)):
        links = "".join(f'<a href="{page}.html">' for page in range(pages))
        (tmp_path / "index.html").write_text(f'<div class="sidebar-tree">{links}</div></aside><a href="more.html">')
        (tmp_path / "_sources" / "page.md.txt").write_text("word " * words)
        assert len(excess(tmp_path)) == faults
