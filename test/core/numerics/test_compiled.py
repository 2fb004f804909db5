"""How kernels are compiled: for one signature each, once, and not silently."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from drive_id.core import frames
from drive_id.core.numerics import scans
from drive_id.core.numerics.compiled import KERNELS
from drive_id.fitting import kernels

ROTATE = "import numpy as np; from drive_id.core import frames; frames.to_dq(np.ones((1, 3)), np.zeros(1))"


def told(code, folder, **variables):
    """Run Python with a cache of its own and return the lines it writes to stderr."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), **variables}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return ran.stderr.splitlines()


def test_each_kernel_is_compiled_for_one_signature_and_no_other():
    ours = [kernel for kernel in KERNELS if kernel.__module__.startswith("drive_id.")]
    assert {kernel.__module__ for kernel in ours if kernel.signature is None} <= {
        "drive_id.bench.kernels", "drive_id.bench.real_drive",
    }  # fmt: skip
    known = [kernel for kernel in ours if kernel.signature is not None]
    assert len(known) > 25
    for kernel in known:
        assert len(kernel.dispatcher().signatures) == 1, kernel.__name__
    with pytest.raises(TypeError, match="No matching definition"):
        frames._rotate(np.ones((3, 3), np.float32), np.ones(3), np.ones(3), np.ones((3, 2)))


def test_constant_arrays_may_be_read_only():
    stamp = np.arange(3)
    stamp.flags.writeable = False
    assert scans.rising(stamp)
    with pytest.raises(TypeError, match="No matching definition"):
        scans.mark_rests(np.ones((3, 2)), 1.0, 1.0, 1.0, 0, stamp.view(np.bool_)[:3])


@pytest.mark.process
def test_the_first_compilation_is_told_once(tmp_path):
    first = told(f"{ROTATE}; from drive_id.core.numerics.scans import rising; rising(np.arange(3))", tmp_path)
    assert len(first) == 1
    assert "compiling" in first[0]
    assert "once" in first[0]
    assert told(ROTATE, tmp_path) == []


def test_kernels_of_others_are_compiled_silently(tmp_path):
    assert told("import numba, drive_id.core.numerics.compilation; numba.njit(lambda x: x)(1)", tmp_path) == []


INTERRUPT = """
import signal
from numba.core import event
from drive_id.core import frames


class Interrupt(event.Listener):
    def on_start(self, _):
        signal.raise_signal(signal.SIGINT)

    def on_end(self, _):
        pass


event.register("numba:compile", Interrupt())
try:
    {call}
except KeyboardInterrupt:
    assert len({kernel}.dispatcher().signatures) == 1, "interrupted in the compiler"
else:
    raise SystemExit("lost")
"""


@pytest.mark.cases
@pytest.mark.parametrize(
    ("kernel", "call"),
    [
        ("frames._rotate", "import numpy as np; frames.to_dq(np.ones((1, 3)), np.zeros(1))"),
        ("kernels._weights", "from drive_id.bench import kernels; kernels._weights(0.5)"),
    ],
)
def test_an_interrupt_waits_for_the_compiler(kernel, call, tmp_path):
    told(INTERRUPT.replace("{call}", call).replace("{kernel}", kernel), tmp_path)


def test_without_a_folder_for_machine_code_a_fit_still_runs(tmp_path):
    nowhere = "from numba.core import caching; caching.CacheImpl._locator_classes = []"
    (line,) = told(f"{nowhere}; {ROTATE}", tmp_path)
    assert "at each start" in line
    assert "NUMBA_CACHE_DIR" in line


def test_both_halves_are_all_that_fits_need():
    parts = [
        {
            kernel.__name__
            for kernel in KERNELS
            if kernel.signature and kernel.__module__.startswith(kernels._FIRST) == half
        }
        for half in (True, False)
    ]
    assert {"add_rows", "add_end", "locate"} <= parts[0]
    assert {"_simulate", "_rotate"} <= parts[1]
