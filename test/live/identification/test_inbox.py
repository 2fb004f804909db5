"""The inbox, served by an executor that is simulated: events in order of arrival, each of which takes its time."""

from __future__ import annotations

import heapq
from collections import deque
from itertools import count, pairwise

import pytest

from drive_id.live.identification.inbox import MOST_BYTES, MOST_MESSAGES, Inbox

ACCUMULATION = 1e-3
RECEPTION = 2e-5
"""Times that a message takes, s."""


class Executor:
    """A queue of events and a clock; a stream of messages, a timer, and requests, at times given in advance."""

    def __init__(self, *, direct=False):
        self.now = 0.0
        self.queue = deque()
        self.coming = []
        self.order = count()
        self.inbox = Inbox(self.queue.append, lambda: self.now)
        self.handled = []
        self.direct = direct
        self.delays = []

    def at(self, when, event):
        heapq.heappush(self.coming, (when, next(self.order), event))

    def message(self, number):
        self.now += RECEPTION
        take = self.handle if self.direct else lambda data: self.inbox.take(self.handle, data)
        take(number.to_bytes(8, "big") + bytes(1000))

    def handle(self, data):
        self.now += ACCUMULATION
        self.handled.append(int.from_bytes(data[:8], "big"))

    def timer(self):
        self.inbox.look()
        self.at(self.now + 0.1, self.timer)

    def request(self, asked):
        self.inbox.empty()
        self.delays.append(self.now - asked)

    def run(self, until):
        while self.now < until:
            while self.coming and self.coming[0][0] <= self.now:
                self.queue.append(heapq.heappop(self.coming)[2])
            if self.queue:
                self.queue.popleft()()
            else:
                self.now = self.coming[0][0]


def streamed(rate, seconds, requests, **options):
    executor = Executor(**options)
    executor.at(0.1, executor.timer)
    messages = int(rate * seconds)
    for number in range(messages):
        executor.at(number / rate, lambda number=number: executor.message(number))
    for when in requests:
        executor.at(when, lambda when=when: executor.request(when))
    executor.run(seconds + 0.2)
    return executor, messages


def test_messages_of_a_node_that_keeps_up_are_handed_on_at_once():
    executor, sent = streamed(300, 3.0, [1.0, 2.0])
    assert executor.handled == list(range(sent))
    assert max(executor.delays) < 0.1
    assert not executor.inbox.warnings()


def test_a_pause_costs_no_message_and_no_order():
    executor = Executor()
    executor.at(0.1, executor.timer)
    for number in range(2000):
        executor.at(number / 300, lambda number=number: executor.message(number))
    executor.run(1.0)
    executor.now += 4.0
    executor.run(20.0)
    assert executor.handled == list(range(2000))
    assert not executor.inbox.dropped


@pytest.mark.parametrize("rate", [1200, 4000])
def test_requests_are_answered_however_fast_messages_arrive(rate):
    executor, sent = streamed(rate, 20.0, [4.0, 8.0, 12.0])
    assert len(executor.delays) == 3
    assert max(executor.delays) < MOST_MESSAGES * ACCUMULATION + 0.5
    assert executor.handled == sorted(set(executor.handled))
    assert 0.7 * executor.now / ACCUMULATION < len(executor.handled) < sent
    gaps = sum(after != before + 1 for before, after in pairwise(executor.handled))
    assert gaps <= 1 + executor.inbox.dropped / MOST_MESSAGES  # few long ones
    assert executor.inbox.dropped or rate == 1200


def test_without_the_inbox_requests_wait_behind_all_messages():
    executor, _ = streamed(4000, 20.0, [8.0], direct=True)
    assert not executor.delays


def test_what_does_not_fit_is_dropped_at_once_and_told():
    inbox = Inbox(lambda _: None, iter([0.0, *[10.0] * 100]).__next__)
    handled = []
    for _ in range(3):
        inbox.take(handled.append, bytes(MOST_BYTES // 3))
    inbox.take(handled.append, b"last")
    inbox.take(handled.append, bytes(MOST_BYTES // 3))
    inbox.empty()
    assert inbox.dropped == 3
    assert [len(data) for data in handled] == [4, MOST_BYTES // 3]
    assert [(told.code, told.values) for told in inbox.warnings()] == [("messages_dropped", {"messages": 3})]
    inbox.reset()
    assert not inbox.warnings()
