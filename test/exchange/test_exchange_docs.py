"""The page and the help of the commands name every format."""

from __future__ import annotations

from pathlib import Path

from drive_id.exchange.exports.formats import EXPORTS
from drive_id.exchange.imports.conventions import CHOICES
from drive_id.exchange.imports.formats import IMPORTS

ROOT = Path(__file__).parent.parent.parent


def test_the_page_names_all_formats_and_conventions():
    page = (ROOT / "docs" / "control_tables.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if "|" in line]
    for name in (*EXPORTS, *IMPORTS):
        assert any(line.startswith(f"| `{name}` |") for line in rows), name
    for name, values in CHOICES.items():
        (row,) = [line for line in rows if f"`--{name.replace('_', '-')}`" in line.split("|")[1]]
        assert all(f"`{value}`" in row for value in values)


def test_the_commands_name_all_formats():
    text = (ROOT / "drive_id" / "cli" / "maps.py").read_text(encoding="utf-8")
    assert all(name in text for name in (*EXPORTS, *IMPORTS))
