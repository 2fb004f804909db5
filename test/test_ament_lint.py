"""The linters of ROS 2 agree with ours, where they are installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
CHECKS = {
    "ament_flake8": [
        "--config",
        "setup.cfg",
        "drive_id",
        "launch",
        "examples",
        "benchmarks",
        "tools",
        "test",
        "setup.py",
    ],
    "ament_pep257": ["--convention", "numpy", "--add-ignore", "D105", "D401", "--", "drive_id", "launch"],
}


@pytest.mark.parametrize("linter", CHECKS)
def test_the_linter_finds_nothing(linter):
    pytest.importorskip(f"{linter}.main", reason=f"{linter} is not installed: it comes with a full ROS 2")
    call = f"import sys; from {linter}.main import main; sys.exit(main(sys.argv[1:]))"
    ran = subprocess.run(
        [sys.executable, "-c", call, *CHECKS[linter]],
        cwd=ROOT,
        env=os.environ,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
