"""The picture drawn by a process of its own is the one drawn in this process; nothing is left running."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from drive_id.analysis import painting
from drive_id.analysis.painting import Painter, paint


@pytest.fixture
def request_of(fitted):
    identification = fitted.identification
    i_dq = np.random.default_rng(1).normal(0, 100, (50_000, 2))
    return identification.flux_map, identification.i_max, i_dq, "a title"


@pytest.fixture(autouse=True)
def two_processors(monkeypatch):
    monkeypatch.setattr(painting.os, "sched_getaffinity", lambda _: {0, 1})


def test_both_processes_draw_the_same(request_of):
    flux_map, i_max, i_dq, title = request_of
    with Painter() as painter:
        painter.begin(*request_of)
        drawn = painter.picture()
        assert painter._process.returncode == 0
    assert drawn.startswith(b"\x89PNG")
    assert drawn == paint(flux_map, i_max, i_dq[::2], title)


@pytest.mark.parametrize("program", ["raise SystemExit(3)", "import sys; sys.stdin.close(); raise SystemExit(3)"])
def test_where_the_other_process_fails_this_one_draws(request_of, monkeypatch, program):
    monkeypatch.setattr(painting, "_PROGRAM", program)
    with Painter() as painter:
        painter.begin(*request_of)
        assert painter.picture().startswith(b"\x89PNG")
        assert painter._process.returncode == 3


@pytest.mark.parametrize("executable", ["", "/nowhere/python"])
def test_where_no_process_can_be_started_this_one_draws(request_of, monkeypatch, executable):
    monkeypatch.setattr(sys, "executable", executable)
    with Painter() as painter:
        assert painter._process is None
        painter.begin(*request_of)
        assert painter.picture().startswith(b"\x89PNG")


def test_no_process_is_started_for_nothing(monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", None)
    with Painter(wanted=False):
        pass
    monkeypatch.setattr(painting.os, "sched_getaffinity", lambda _: {0})
    with Painter():
        pass


@pytest.mark.parametrize("begun", [False, True])
def test_an_error_leaves_no_process_behind(request_of, begun):
    painter = Painter()
    if begun:
        painter.begin(*request_of)
    with pytest.raises(ValueError, match="bad bag"), painter:
        raise ValueError("bad bag")
    assert painter._process.returncode is not None


def test_the_other_process_ends_when_this_one_does():
    """It reads the end of its input."""
    ended = subprocess.run([sys.executable, "-c", painting._PROGRAM], input=b"", capture_output=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"", b"")
