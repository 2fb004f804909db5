"""The rules of the suite itself: what is made once, what an unmarked test may take, and that long tests say why."""

from __future__ import annotations

import ast
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import store
from processor_time import LONG

ROOT = Path(__file__).parents[1]
MADE = []


def make(number, *, name="a"):
    MADE.append((number, name))
    return {"squares": np.arange(number) ** 2, "name": name}


def test_what_is_stored_is_made_once(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "folder", tmp_path)
    MADE.clear()
    first, again = store.stored(make, 4), store.stored(make, 4)
    np.testing.assert_array_equal(first["squares"], again["squares"])
    assert again["squares"] is not first["squares"]
    assert MADE == [(4, "a")]
    assert store.stored(make, 5)["squares"].size == 5
    assert store.stored(make, 4, name="b")["name"] == "b"
    assert MADE == [(4, "a"), (5, "a"), (4, "b")]


def test_a_changed_source_is_another_entry(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "folder", tmp_path)
    MADE.clear()
    store.stored(make, 3)
    monkeypatch.setattr(store, "_sources", lambda _module: b"changed")
    store.stored(make, 3)
    assert len(MADE) == 2


def test_sources_are_followed_through_the_package():
    files = set(store.imported_files(Path(__file__).with_name("conftest.py")))
    for name in ("fitting/fit.py", "core/full/windows.py", "core/numerics/bspline.py", "bench/drive.py"):
        assert ROOT / "drive_id" / name in files
    assert ROOT / "test" / "support" / "drive_bags.py" in files
    assert not any("nodes" in file.parts for file in files)


def test_two_workers_make_it_once(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "folder", tmp_path)
    MADE.clear()
    workers = [threading.Thread(target=store.stored, args=(make, 100_000)) for _ in range(8)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(MADE) == 1


def test_an_unmarked_test_that_takes_long_fails(tmp_path):
    (tmp_path / "conftest.py").write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT / 'test' / 'support')!r})\nimport processor_time\n"
        "processor_time.LIMIT, processor_time._PACE, processor_time._CROWDED = 0.02, 1e9, 1e9\n"
        "def pytest_configure(config):\n    config.pluginmanager.register(processor_time.ProcessorTime())\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    (tmp_path / "test_it.py").write_text(
        "import pytest\n"
        "def work():\n    return sum(range(30_000_000))\n"
        "@pytest.fixture(scope='module')\ndef shared():\n    return work()\n"
        "def test_long():\n    work()\n"
        "def test_short(shared):\n    pass\n"
        "@pytest.mark.slow\ndef test_marked():\n    work()\n"
    )
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", str(tmp_path)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=60)
    assert ran.returncode == 1
    assert "test_it.py::test_long took" in ran.stdout
    assert "3 passed, 1 error" in ran.stdout
    assert "processor time: " in ran.stdout


def test_a_slow_test_says_why():
    """The other marks say it themselves."""
    mute = []
    for file in sorted((ROOT / "test").rglob("test_*.py")):
        lines = file.read_text(encoding="utf-8").splitlines()
        mute += [
            f"{file.relative_to(ROOT)}:{number}"
            for number, line in enumerate(lines, 1)
            if line.strip().startswith("@pytest.mark.slow") and "#" not in line
        ]
    assert mute == []


def test_marks_are_those_of_the_makefile():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert f"LONG := {' or '.join(LONG)}\n" in makefile
    used = {
        node.attr
        for file in (ROOT / "test").rglob("test_*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "mark"
    }
    assert used <= {*LONG, "cases", "essential", "parametrize", "skipif", "usefixtures", "filterwarnings", "timeout"}
