"""Ctrl-C at unlucky moments of the command line."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import threading
import weakref
from pathlib import Path

import pytest

from drive_id.cli import app, console
from drive_id.common import interrupts
from drive_id.errors import DriveIdError
from drive_id.files.results import folder
from drive_id.files.results.folder import replace_file, replace_folder
from drive_id.files.write import rosbag2_writer
from drive_id.files.write.rosbag2_writer import whole_or_nothing


def ctrl_c(*_):
    os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture
def run(monkeypatch, tmp_path, capsys):
    """Return what runs a function as the command, and gives exit code and standard error."""
    monkeypatch.chdir(tmp_path)

    def run(command):
        monkeypatch.setattr(app, "app", command)
        try:
            app.main()
            code = 0
        except SystemExit as end:
            code = end.code
        return code, capsys.readouterr().err

    return run


def bag(path):
    with whole_or_nothing(path) as folder:
        folder.mkdir()
        (folder / "a").write_text("a")
    ctrl_c()


WRITERS = {
    "file": lambda path: replace_file(path, b"x"),
    "folder": lambda path: replace_folder(path, {"a": b"x"}, marker="a", kind="k"),
    "replaced folder": lambda path: replace_folder(path, {"a": b"x"}, marker="a", kind="k", force=True),
    "bag": bag,
}
MOMENTS = ("make_folder", "write_synced", "sync_folder", "rename", "replace", "rmtree", "mkdtemp")
"""Functions that the writers call, directly or in temporary folders: Ctrl-C comes as each begins, and as it ends."""


def interrupting(function, after):
    def replaced(*arguments, **options):
        if not after:
            ctrl_c()
        result = function(*arguments, **options)
        if after:
            ctrl_c()
        return result

    return replaced


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("kind", WRITERS)
def test_what_is_said_of_an_output_is_true_at_any_moment(kind, moment, after, run, monkeypatch, tmp_path):
    output = Path("out")
    if kind == "replaced folder":
        output.mkdir()
        (output / "mine").write_text("mine")
    for place in (folder, rosbag2_writer, shutil, tempfile, Path):
        if hasattr(place, moment):
            monkeypatch.setattr(place, moment, interrupting(getattr(place, moment), after))

    def command():
        WRITERS[kind](output)
        ctrl_c()

    code, said = run(command)
    assert code == 130
    new = (output / "a").exists() if kind == "replaced folder" else output.exists()
    assert said == f"drive-id: interrupted; {'out is complete' if new else 'no output was left behind'}.\n"
    assert {path.name for path in tmp_path.iterdir()} <= {"out"}  # nothing under another name


def lost_at_first():
    """Let an interrupt come in a callback, and wait until it comes again."""

    class Object:
        pass

    kept = Object()
    callback = weakref.ref(kept, ctrl_c)
    del kept
    assert callback() is None
    signal.sigtimedwait([], 60)


def test_an_interrupt_in_a_callback_is_not_lost(run):
    """From where Python raises nothing, and prints a traceback."""
    assert run(lost_at_first) == (130, "drive-id: interrupted; no output was left behind.\n")


def test_an_interrupt_that_comes_again_while_it_is_found_lost_is_not_lost(run, monkeypatch):
    """On a busy machine, the thread that repeats it may be done before its start returns."""
    starts = []

    class Quick(threading.Timer):
        def start(self):
            super().start()
            starts.append(self)
            if len(starts) == 1:
                self.join()

    monkeypatch.setattr(interrupts.threading, "Timer", Quick)
    assert run(lost_at_first) == (130, "drive-id: interrupted; no output was left behind.\n")
    assert len(starts) == 2


def test_an_interrupt_that_became_another_error_is_one(run):
    class Named:
        def __set_name__(self, owner, name):
            ctrl_c()

    def command():
        type("Class", (), {"entry": Named()})

    assert run(command) == (130, "drive-id: interrupted; no output was left behind.\n")


def test_an_interrupt_while_an_error_is_told(run, monkeypatch):
    tell = console.say

    def interrupted(*_, **__):
        monkeypatch.setattr(console, "say", tell)
        ctrl_c()

    def command():
        monkeypatch.setattr(console, "say", interrupted)
        raise DriveIdError("It is wrong.")

    assert run(command) == (130, "drive-id: interrupted; no output was left behind.\n")


def test_a_second_interrupt_does_not_disturb_the_first(run, monkeypatch):
    tell = console.say

    def again(sentence, **how):
        ctrl_c()
        tell(sentence, **how)

    monkeypatch.setattr(console, "say", again)
    assert run(ctrl_c) == (130, "drive-id: interrupted; no output was left behind.\n")


def test_signals_of_other_programs_are_left_alone():
    """A node, or a program with rclpy, has its own handler."""
    handler, hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
    came = []
    signal.signal(signal.SIGINT, lambda *_: came.append(1))
    try:
        with interrupts.held():
            ctrl_c()
            assert came
        with interrupts.taken():
            pass
        ctrl_c()
        assert len(came) == 2
        assert sys.unraisablehook is hook
    finally:
        signal.signal(signal.SIGINT, handler)
