"""Work on further processes that is interrupted, or whose items are bad or deadly, amid results of 40 MB."""

from __future__ import annotations

import itertools
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from drive_id.common import interrupts
from drive_id.errors import WorkerError
from drive_id.fitting.processes import in_processes

KINDS = {"all good": 0, "bad item": 3, "process dies": 4, "Ctrl-C": 130, "Ctrl-C twice": 130}
"""What happens in a round, and the exit code that shall follow."""
BOUND = 60.0
"""Time from which on a round is said to hang, s; on a busy machine, a start alone takes several."""
_RESULT = 40_000_000  # bytes
_WORKERS = 2
_ITEMS = 6
_SHARED = Path("/dev/shm")
_NAMES = ("psm_*", "sem.mp-*")  # shared memory and semaphores of Python's multiprocessing


@dataclass
class Tally:
    """What the rounds have shown: how often each kind came, its longest time to the end, s, and findings."""

    rounds: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    longest: dict[str, float] = field(default_factory=lambda: dict.fromkeys(KINDS, 0.0))
    findings: list[str] = field(default_factory=list)


def rounds(count: int, seed: int) -> Tally:
    """Run rounds of all kinds in turn; for a round with Ctrl-C, the time is that from the first one to the end."""
    rng, tally = random.Random(seed), Tally()
    for number in range(count):
        kind = list(KINDS)[number % len(KINDS)]
        found = [f"round {number} of seed {seed}, {kind}: {text}" for text in _round(kind, rng, tally)]
        tally.rounds[kind] += 1
        tally.findings += found
    return tally


def _round(kind: str, rng: random.Random, tally: Tally) -> Iterator[str]:
    """Run one process that works on further ones, and yield what is wrong with its end."""
    shared = _shared()
    command = [sys.executable, __file__, kind, str(rng.random())]
    with subprocess.Popen(
        command, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as main:
        assert main.stdout is not None
        main.stdout.readline()  # it begins
        if "Ctrl-C" in kind:
            time.sleep(rng.uniform(0.0, 2.0))
        begun = time.monotonic()
        try:
            for again in range(kind.count("Ctrl-C") + kind.count("twice")):
                time.sleep(rng.uniform(0.0, 0.1) * again)
                os.killpg(main.pid, signal.SIGINT)
            _, said = main.communicate(timeout=BOUND)
        except subprocess.TimeoutExpired:
            yield "it hangs"
            os.killpg(main.pid, signal.SIGKILL)
            _, said = main.communicate()
        except ProcessLookupError:  # it was quicker than the second Ctrl-C
            _, said = main.communicate()
    tally.longest[kind] = max(tally.longest[kind], time.monotonic() - begun)
    late = "twice" in kind and main.returncode == -signal.SIGINT  # the second one met an interpreter that was ending
    if main.returncode != KINDS[kind] and not late:
        yield f"exit code {main.returncode}"
    if said:
        yield f"it says {said}"
    if left := _of_session(main.pid):
        yield f"processes are left: {left}"
    if further := _shared() - shared:
        yield f"shared memory is left: {sorted(further)}"


def _shared() -> set[str]:
    return {path.name for pattern in _NAMES for path in _SHARED.glob(pattern)}


def _of_session(session: int) -> list[int]:
    """Return the processes of a session; those that are just ending have half a second for it."""
    for _ in range(10):
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            except OSError:  # it has just ended
                continue
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(stat.parent.name))
        if not found:
            break
        time.sleep(0.05)
    return found


def item(what: tuple[str, float]) -> bytes:
    """Return a large result, raise an error, or die while the result is written."""
    kind, share = what
    if kind == "bad item":
        raise ValueError(kind)
    if kind == "process dies":
        threading.Timer(0.1 * share, os.kill, (os.getpid(), signal.SIGKILL)).start()
        return b"x" * (10 * _RESULT)
    time.sleep(0.05 * share)
    return b"x" * _RESULT


def main() -> None:
    """Be the process of a round."""
    kind, share = sys.argv[1], float(sys.argv[2])
    signal.alarm(int(3 * BOUND))  # where nobody waits for it any more
    rng = random.Random(share)
    numbers = itertools.count() if "Ctrl-C" in kind else range(_ITEMS)
    bad = rng.randrange(_ITEMS)
    items = ((kind if number == bad else "", rng.random()) for number in numbers)
    with interrupts.taken():  # as a command does
        try:
            print("begun", flush=True)
            with closing(in_processes(item, items, _WORKERS)) as results:
                for number, result in enumerate(results):
                    assert len(result) == _RESULT, number
        except (ValueError, WorkerError):
            raise SystemExit(KINDS[kind]) from None
        except KeyboardInterrupt:
            interrupts.last_word()
            raise SystemExit(KINDS[kind]) from None


if __name__ == "__main__":
    main()
