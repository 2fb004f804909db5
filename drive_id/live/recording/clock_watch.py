"""Recognizes a clock that stands still or is set back: simulated time is only as good as its publisher."""

from __future__ import annotations

from drive_id.common.health import Level, Observation
from drive_id.types import NANOSECONDS

_STANDSTILL = 2.0
"""Time without an advance after which a clock stands still, s; simulations advance it several times a second."""


class ClockWatch:
    """Compares the clock of the log times with a steady one; call :meth:`look` several times a second."""

    def __init__(self) -> None:
        self._time: int | None = None  # of the clock, ns
        self._advanced = self._looked = self._begun = 0.0  # of the steady clock, s
        self._past = 0.0  # s of standstills that are over
        self._set_back = 0.0  # s

    def begin(self, steady: float) -> None:
        """Forget what was before a recording; a standstill that goes on counts from now on."""
        self._begun = self._looked = steady
        self._past = self._set_back = 0.0

    def look(self, now: int, steady: float) -> None:
        """Take the time of the clock, ns, and that of the steady one, s."""
        if self._time is None or now != self._time:
            self._past += self.standing
            if self._time is not None and now < self._time:
                self._set_back = max(self._set_back, (self._time - now) / NANOSECONDS)
            self._time, self._advanced = now, steady
        self._looked = steady

    @property
    def standing(self) -> float:
        """Time for which the clock has been standing still, s; 0 while it runs."""
        gap = self._looked - max(self._advanced, self._begun)
        return gap if self._time is not None and gap > _STANDSTILL else 0.0

    def findings(self) -> list[Observation]:
        """Return that the clock stands still."""
        if not self.standing:
            return []
        sentence = (
            f"The clock has stood still for {self.standing:.1f} s, and so do the log times: start whatever publishes "
            "/clock, or set use_sim_time to false."
        )
        return [(Level.ERROR, sentence)]

    def remark(self) -> str:
        """Return a sentence on what is wrong with the log times since :meth:`begin`; empty if nothing is."""
        stood = self._past + self.standing
        if stood:
            return f"The clock stood still for {stood:.1f} s of the recording, so that log times repeat."
        if self._set_back:
            return f"The clock was set back by {self._set_back:.3f} s during the recording, and so are the log times."
        return ""
