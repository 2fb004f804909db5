"""Words that have one meaning: the table in docs/conventions.md names each class that holds one of them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ROWS = re.findall(
    r"^\| (\w+) \| [^|]+ \| ((?:`\w+`(?:, )?)+) \|$",
    (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)
CLASSES = {
    name
    for path in (ROOT / "drive_id").rglob("*.py")
    for name in re.findall(r"^ *class (\w+)[(:]", path.read_text(encoding="utf-8"), re.MULTILINE)
}


@pytest.mark.parametrize(("word", "named"), ROWS, ids=[word for word, _ in ROWS])
def test_a_word_in_the_name_of_a_class_has_its_one_meaning(word, named):
    """A new class with the word either means it so, and is added to the table, or has another name."""
    holding = {name for name in CLASSES if word.capitalize() in re.findall(r"[A-Z][a-z]*", name)}
    assert holding == set(re.findall(r"\w+", named))


def test_the_table_has_the_words():
    assert {word for word, _ in ROWS} == {"evidence", "information", "solution", "fit", "result"}
