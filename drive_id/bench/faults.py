"""What goes wrong with drives, on demand: for tests of whoever supervises one."""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from drive_id.common.settings import Checked, setting

Message = TypeVar("Message")
_OVERTAKEN = 0.03  # delay of a message that others overtake, s: more than the time between two of them


@dataclass(frozen=True)
class FaultSettings(Checked):
    """Faults of the simulated drive; they begin and end while it runs."""

    clock_offset: float = setting(
        0.0, "What the clock of the drive is ahead; a change is a step", unit="s", minimum=-1e4, maximum=1e4
    )
    clock_drift: float = setting(
        0.0, "What the clock of the drive gains in every second; 0 synchronizes it again",
        unit="s", minimum=-0.9, maximum=10.0,
    )  # fmt: skip
    ignore_references: bool = setting(False, "Do not listen to references, not even to safe ones")
    restarts: int = setting(
        0, "Each change restarts the drive: counts begin with 0, the session ends", minimum=0, maximum=1_000_000
    )
    freeze: str = setting(
        "none", "Repeat the last stamps, or the last samples with new stamps", choices=("none", "stamps", "samples")
    )
    latency: float = setting(0.0, "Delay of all messages, both ways", unit="s", minimum=0.0, maximum=10.0)
    loss: float = setting(0.0, "Share of messages that are lost, both ways", minimum=0.0, maximum=1.0)
    disorder: float = setting(0.0, "Share of messages that others overtake, both ways", minimum=0.0, maximum=1.0)
    trip: bool = setting(False, "The drive reports a fault and switches off")


class Channel(Generic[Message]):
    """Passes messages on: late, out of order or not at all, as the settings say."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, Message]] = []
        self._number = 0

    def carry(self, messages: Iterable[Message], now: float, faults: FaultSettings) -> list[Message]:
        """Return the messages that arrive at ``now``, s of a monotonic clock; ``messages`` are sent now."""
        for message in messages:
            if self._random.random() < faults.loss:
                continue
            delay = faults.latency + (_OVERTAKEN if self._random.random() < faults.disorder else 0.0)
            self._number += 1
            heapq.heappush(self._waiting, (now + delay, self._number, message))
        arrived = []
        while self._waiting and self._waiting[0][0] <= now:
            arrived.append(heapq.heappop(self._waiting)[2])
        return arrived
