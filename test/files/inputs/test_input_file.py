"""The gate: regular files of bounded size, and nothing that blocks or has no end."""

from __future__ import annotations

import ast
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import drive_id
from drive_id.files.inputs.input_file import check_input, open_input, read_input, read_text_input, shown_size


def fifo(path: Path) -> None:
    os.mkfifo(path)


def bound_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as held:
        held.bind(path.name)


def folder(path: Path) -> None:
    path.mkdir()


def to_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def to_itself(path: Path) -> None:
    path.symlink_to(path.name)


def to_nowhere(path: Path) -> None:
    path.symlink_to("nowhere")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (fifo, "it is a FIFO"),
        (bound_socket, "it is a socket"),
        (folder, "Is a directory"),
        (to_device, "it is a device"),
        (to_itself, "symbolic links"),
        (to_nowhere, "No such file"),
    ],
)
@pytest.mark.parametrize("opened", [check_input, open_input, lambda path: read_input(path, 9)])
def test_what_is_no_file_is_not_opened(tmp_path, monkeypatch, make, said, opened):
    monkeypatch.chdir(tmp_path)
    make(tmp_path / "x")
    monkeypatch.setattr(os, "open", None)  # must not be reached
    with pytest.raises(OSError, match=said):
        opened(tmp_path / "x")


def test_a_fifo_that_comes_between_check_and_opening_does_not_block(tmp_path, monkeypatch):
    (tmp_path / "x").touch()
    real = os.open

    def swapped(path, flags):
        Path(path).unlink()
        os.mkfifo(path)
        return real(path, flags)

    monkeypatch.setattr(os, "open", swapped)
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(OSError, match="FIFO"):
        open_input(tmp_path / "x")
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_sizes(tmp_path):
    file = tmp_path / "x"
    file.write_bytes(b"123456789")
    assert check_input(file) == 9
    assert read_input(file, 9) == b"123456789"
    assert read_text_input(file, 9) == "123456789"
    with pytest.raises(OSError, match="it is too large, 9 bytes where 8 bytes is the most"):
        read_input(file, 8)
    with pytest.raises(OSError, match="too large"):
        open_input(file, 8)
    assert [shown_size(size) for size in (7, 1234, 5e6, 3.21e9, 2e13)] == [
        "7 bytes", "1.23 kB", "5 MB", "3.21 GB", "2e+04 GB"
    ]  # fmt: skip


def test_a_file_that_grows_while_it_is_read(tmp_path, monkeypatch):
    file = tmp_path / "x"
    file.write_bytes(b"1234")
    real = os.fdopen

    def grown(*args, **kwargs):
        with file.open("ab") as stream:
            stream.write(b"56789")
        return real(*args, **kwargs)

    monkeypatch.setattr(os, "fdopen", grown)
    with pytest.raises(OSError, match="too large"):
        read_input(file, 4)


@pytest.mark.parametrize("name", ["metadata.yaml", "x_0.mcap", "x_0.db3"])
def test_a_bag_of_fifos_ends_at_once(tmp_path, name):
    """In a process of its own, which a mistake would leave waiting for ever."""
    (tmp_path / "x").mkdir()
    os.mkfifo(tmp_path / "x" / name)
    script = "import sys; from pathlib import Path; from drive_id.files.read.info import bag_info as f; f(Path('x'))"
    command = [sys.executable, "-c", script]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=30, check=False)
    assert "NotABagError" in ran.stderr.splitlines()[-1]


PACKAGE = Path(drive_id.__file__).parent
ROOMS = ("files", "exchange/imports", "inspection", "fitting", "analysis", "live", "cli")
OF_THE_SYSTEM = {"files/inputs/input_file.py", "files/read/memory.py"}  # the gate itself, and /proc


def opened_by_themselves(source: str) -> list[int]:
    """Return the lines at which a file is opened for reading without the gate."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        modes = [mode.value for mode in node.args if isinstance(mode, ast.Constant) and isinstance(mode.value, str)]
        reads = name in ("read_bytes", "read_text") or (name == "open" and any("r" in mode for mode in modes))
        if reads:
            found.append(node.lineno)
    return found


def test_only_the_gate_opens_what_users_give():
    files = [file for room in ROOMS for file in (PACKAGE / room).rglob("*.py")]
    assert len(files) > 100
    found = {str(file.relative_to(PACKAGE)): opened_by_themselves(file.read_text("utf-8")) for file in files}
    assert {name: lines for name, lines in found.items() if lines and name not in OF_THE_SYSTEM} == {}
    assert opened_by_themselves("path.open('rb')\nPath(name).read_text()\nopen(name, 'r')") == [1, 2, 3]
