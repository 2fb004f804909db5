"""How the benchmarks measure: interleaved runs, best of n, and processes of their own with their peak memory.

The machine may be busy with other work. Both sides of a ratio therefore run in turns, each n times, and the best
counts; the processor time, which waiting does not lengthen, stands beside the elapsed time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Cost:
    """Cost of one run: elapsed and processor time, s, and peak memory, bytes (0: not measured)."""

    elapsed: float
    cpu: float
    memory: int = 0

    def best(self, other: Cost) -> Cost:
        """Return the smaller of each."""
        return Cost(min(self.elapsed, other.elapsed), min(self.cpu, other.cpu), min(self.memory, other.memory))


def in_turns(actions: dict[str, Callable[[], Any]], repeats: int) -> dict[str, Cost]:
    """Run each action ``repeats`` times, in turns, after one run that does not count."""
    return best_of({name: partial(timed, action) for name, action in actions.items()}, repeats, warm_up=True)


def best_of(measured: dict[str, Callable[[], Cost]], repeats: int, warm_up: bool = False) -> dict[str, Cost]:
    """Return the best of the costs that each action reports, called in turns."""
    best: dict[str, Cost] = {}
    for number in range(-1 if warm_up else 0, repeats):
        for name, action in measured.items():
            cost = action()
            if number >= 0:
                best[name] = best[name].best(cost) if name in best else cost
    return best


def timed(action: Callable[[], Any]) -> Cost:
    """Run an action in this process."""
    start, cpu = time.perf_counter(), time.process_time()
    action()
    return Cost(time.perf_counter() - start, time.process_time() - cpu)


def process(command: Sequence[str | Path]) -> Cost:
    """Run a command as a process of its own; its output must not matter.

    A small process starts it, because a process inherits the peak memory of the one that starts it. Compiled Python is
    written, as on users' computers: without, each start compiled drive_id for 0.2 s.
    """
    words = [sys.executable, "-S", str(Path(__file__)), *map(str, command)]
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    ran = subprocess.run(words, capture_output=True, text=True, check=False, env=kept)
    if ran.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{ran.stderr}")
    return Cost(**json.loads(ran.stdout.splitlines()[-1]))


def _launch(command: list[str]) -> None:
    """Run the command and print its cost."""
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as child:
        _, status, usage = os.wait4(child.pid, 0)
        elapsed = time.perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
    cost = {"elapsed": elapsed, "cpu": usage.ru_utime + usage.ru_stime, "memory": usage.ru_maxrss * 1024}
    print(json.dumps(cost))
    raise SystemExit(child.returncode)


if __name__ == "__main__":
    _launch(sys.argv[1:])
