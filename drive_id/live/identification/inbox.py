"""Live messages on their way to the accumulation: taken at once, or kept waiting while the node is behind."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from drive_id.common.messages import Message

MOST_MESSAGES = 5000
"""Messages that may wait."""
MOST_BYTES = 16_000_000
"""Bytes that may wait: some seconds of accumulation."""
_LATE = 0.3  # s without a look after which the node is behind
_SLICE = 0.02  # s of accumulation between two looks at everything else

Handle = Callable[[bytes], None]


class Inbox:
    """Hands messages on at once while the node keeps up, and in slices of some milliseconds otherwise.

    An executor serves messages, requests and timers in order of arrival. If each message were accumulated as it is
    served, a stream faster than the accumulation would put ever more messages before a request. Here, messages of a
    node that is behind wait in memory, which takes microseconds. If too many wait, all of them are dropped: one long
    gap leaves longer runs than many short ones. Not for several threads at once.

    Parameters
    ----------
    call : callable
        Has the thread of this object make a call, after the events that have arrived.
    clock : callable
        Returns the time, s.
    """

    def __init__(self, call: Callable[[Callable[[], None]], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._call = call
        self._clock = clock
        self._waiting: deque[tuple[Handle, bytes]] = deque()
        self._bytes = 0
        self._called = False
        self._behind_from = clock() + _LATE
        self.dropped = 0
        """Messages that were dropped."""

    def look(self) -> None:
        """Note that the node has time for its timers; call it ten times a second."""
        self._behind_from = self._clock() + _LATE

    def take(self, handle: Handle, data: bytes) -> None:
        """Hand a message on, now or later, in the order of arrival."""
        if not self._waiting and self._clock() < self._behind_from:
            handle(data)
            return
        if len(self._waiting) >= MOST_MESSAGES or self._bytes + len(data) > MOST_BYTES:
            self.dropped += len(self._waiting)
            self.discard()
        self._waiting.append((handle, data))
        self._bytes += len(data)
        self._go_on()

    def empty(self) -> None:
        """Hand on all messages that wait."""
        while self._waiting:
            self._hand_on()

    def discard(self) -> None:
        """Forget the messages that wait."""
        self._waiting.clear()
        self._bytes = 0

    def warnings(self) -> list[Message]:
        """Return what was dropped."""
        return [Message("messages_dropped", messages=self.dropped)] if self.dropped else []

    def reset(self) -> None:
        """Forget all messages, and how many were dropped."""
        self.discard()
        self.dropped = 0

    def _go_on(self) -> None:
        if not self._called:
            self._called = True
            self._call(self._slice)

    def _slice(self) -> None:
        self._called = False
        end = self._clock() + _SLICE
        while self._waiting and self._clock() < end:
            self._hand_on()
        if self._waiting:
            self._go_on()

    def _hand_on(self) -> None:
        handle, data = self._waiting.popleft()
        self._bytes -= len(data)
        handle(data)
