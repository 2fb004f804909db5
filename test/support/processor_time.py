"""The processor time of each test: one without a mark that says why it is long may take three seconds.

Processor time, not wall time, as other work may share the machine. Processes that a test started and waited for count.
What a fixture of a wider scope than a test takes counts for nobody: it is made once for many.
"""

from __future__ import annotations

import os
import time
from collections import Counter

import pytest

LONG = ("accuracy", "browser", "process", "slow")
"""The marks, with their reasons in ``pyproject.toml``."""
LIMIT = 3.0
"""Processor seconds of an unmarked test on two 2.1 GHz cores of 2023: of some 4600 tests, 150 take more."""
_SLACK = 2.0
"""Factor of it beyond which the test fails: on busy cores, the same test takes up to twice as much."""
_PACE = 0.05
"""Processor seconds of :func:`_work` on that machine."""
_CROWDED = 3.0
"""Processes that wait for each core beyond which no test fails for its time: whoever waits for another asks more often.
Measured at 6, a wait for a node took 20 s of processor time instead of 2."""
_LISTED = 10

_BEGUN, _SHARED = pytest.StashKey[float](), pytest.StashKey[float]()


def spent() -> float:
    """Return the processor time, s, of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def _work() -> float:
    before = time.process_time()
    sum(number * number for number in range(700_000))
    return time.process_time() - before


class ProcessorTime:
    """Measures each test where it runs, and lists the longest ones where the session ends."""

    def __init__(self):
        self.shared = 0.0  # s, for fixtures of a wider scope, ever
        self.depth = 0  # of such fixtures under way: one may ask for another
        self.taken = {}  # s, of each test
        self.by_mark = Counter()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        if fixturedef.scope == "function" or self.depth:
            return (yield)
        before = spent()
        self.depth += 1
        try:
            return (yield)
        finally:
            self.depth -= 1
            self.shared += spent() - before

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item):
        item.stash[_BEGUN], item.stash[_SHARED] = spent(), self.shared
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        report = yield
        if call.when == "teardown":
            shared = self.shared - item.stash[_SHARED]
            own = spent() - item.stash[_BEGUN] - shared
            mark = next((name for name in LONG if item.get_closest_marker(name)), "unmarked")
            report.user_properties += [("processor time", (mark, own, shared))]
            if report.passed and mark == "unmarked" and own > _SLACK * LIMIT:
                limit = _SLACK * LIMIT * max(1.0, _work() / _PACE)
                crowded = os.getloadavg()[0] > _CROWDED * (os.cpu_count() or 1)
                if own > limit and not crowded:
                    report.outcome = "failed"
                    report.longrepr = (
                        f"{item.nodeid} took {own:.1f} s of processor time, {limit:.1f} s are for one without a mark: "
                        f"make it shorter, or mark it ({', '.join(LONG)}: pyproject.toml)."
                    )
        return report

    def pytest_runtest_logreport(self, report):
        for mark, own, shared in (value for name, value in report.user_properties if name == "processor time"):
            if report.when == "teardown":
                self.taken[report.nodeid] = (own, mark)
                self.by_mark += Counter({mark: own, "shared fixtures": shared})

    def pytest_terminal_summary(self, terminalreporter):
        if not self.taken:
            return
        sums = ", ".join(f"{mark} {seconds:.0f} s" for mark, seconds in self.by_mark.most_common())
        terminalreporter.section(f"processor time: {sums}")
        for name, (own, mark) in sorted(self.taken.items(), key=lambda item: -item[1][0])[:_LISTED]:
            terminalreporter.line(f"{own:6.1f} s  {mark:9} {name}")
