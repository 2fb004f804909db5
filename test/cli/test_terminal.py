"""Results in a terminal: whatever its width, every number is there, whole."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from rich.console import Console

from drive_id.cli import console
from drive_id.core.fit_settings import FitSettings
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.sources import Sources

SCRIPT = Path(sys.executable).with_name("drive-id")


def in_terminal(columns, *arguments):
    """Return exit code and output of a command in a terminal of so many columns."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"}
    command = [SCRIPT, *map(str, arguments)]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as process:
        os.close(theirs)
        text = b""
        while piece := _read(ours):
            text += piece
    os.close(ours)
    return process.returncode, re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.decode())


def _read(descriptor):
    try:
        return os.read(descriptor, 65536)
    except OSError:  # the other end is closed: Linux says EIO instead of an end of file
        return b""


def said(sentence, **options):
    """Return the lines of a sentence."""
    text = io.StringIO()
    terminal = Console(file=text, color_system=None, _environ={}, **options)
    console.say(sentence, to=lambda: terminal)
    return text.getvalue().splitlines()


def test_a_sentence_breaks_between_words_only():
    sentence = "The answer is in a/folder/whose/name/is/longer/than/any/line and not somewhere else."
    lines = said(sentence, width=30, force_terminal=True)
    assert " ".join(line.strip() for line in lines) == sentence
    assert [line for line in lines if len(line.rstrip()) > 30] == ["a/folder/whose/name/is/longer/than/any/line"]
    assert said(sentence, width=30, force_terminal=False) == [sentence]


@pytest.mark.process
@pytest.mark.essential
def test_no_number_hangs_on_the_width_of_the_terminal(bag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fit_bags(Sources([bag]), Path("result"), FitSettings(method="joint"))
    for command in (("info", bag), ("info", "result"), ("compare", "result", "result")):
        texts = {}
        for columns in (50, 200):
            code, texts[columns] = in_terminal(columns, *command)
            assert code == 0, texts[columns]
            assert "…" not in texts[columns].replace(str(tmp_path), "")
        numbers = set(re.findall(r"\d+\.\d+", texts[200].replace(str(tmp_path), "")))
        assert numbers
        assert {number for number in numbers if number not in texts[50]} == set()
