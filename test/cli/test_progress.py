"""The progress bar: a percentage only where the share is known."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from drive_id.cli import console


@pytest.fixture
def screen(monkeypatch):
    """What is drawn on a terminal."""
    text = io.StringIO()
    text.isatty = lambda: True
    terminal = Console(file=text, force_terminal=True, width=100, color_system=None, _environ={})
    monkeypatch.setattr(console, "err", lambda: terminal)
    return text


def drawn(screen, *told):
    """Return the bar as it stands at the end of these steps."""
    with console.working(silent=False) as tell:
        for step in told:
            tell(*step)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue()).replace("\r", "\n")
    return [line for line in plain.splitlines() if line.strip()][-1]


def test_a_share_is_a_percentage(screen):
    line = drawn(screen, ("Accumulating", 0.25))
    assert "Accumulating" in line
    assert "25%" in line


def test_a_step_of_unknown_length_has_none(screen):
    """The longest step stood at 100 %, left over from the one before."""
    line = drawn(screen, ("Accumulating", 1.0), ("Solving", None))
    assert "Solving" in line
    assert "Accumulating" not in line
    assert "%" not in line


def test_a_rate_beside_the_name_does_not_begin_another_step(screen):
    line = drawn(screen, ("Reading, 0.10 million samples/s", 0.25), ("Reading, 0.20 million samples/s", 0.5))
    assert "0.20 million" in line
    assert "50%" in line


def test_nothing_is_drawn_without_a_terminal(monkeypatch):
    text = io.StringIO()
    monkeypatch.setattr(console, "err", lambda: Console(file=text, force_terminal=False, _environ={}))
    with console.working(silent=False) as tell:
        tell("Solving", None)
    assert not text.getvalue()


def test_colour_without_a_terminal_shows_no_bar(monkeypatch):
    """A notebook sets FORCE_COLOR for the programs that it starts; a bar would leave hundreds of lines in it."""
    text = io.StringIO()
    monkeypatch.setattr(console, "err", lambda: Console(file=text, _environ={"FORCE_COLOR": "1"}))
    with console.working(silent=False) as tell:
        tell("Accumulating", 0.5)
    assert text.getvalue() == ""
