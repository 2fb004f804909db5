"""Simulated time for drives under test: at most as fast as real time, and as slow as the slowest process needs it.

So nothing depends on the speed of the machine: a bench that is behind, or a publisher whose references run out, holds
up the clock of them all.
"""

from __future__ import annotations

import time
from functools import partial

import numpy as np

SECOND = 1_000_000_000
LAG = SECOND // 10
"""That a bench may be behind, and that references must be ahead, ns."""
_STEP = SECOND // 50
_PAUSE = SECOND // 500  # of real time, between two messages
_PATIENCE = 2 * SECOND
"""Of real time, after which the clock makes a step though it waits for a drive: a timer that missed the jump at which
the clock came to stand would never be called, so that each would wait for the other."""


class SimulatedTime:
    """Publishes /clock while the test waits for something."""

    def __init__(self, ros):
        from rosgraph_msgs.msg import Clock

        self.ros, self.kind = ros, Clock
        self.publisher = ros.node.create_publisher(Clock, "/clock", 10)
        self.now = 1_700_000_000 * SECOND
        self.stands = False
        self._last = self._moved = time.monotonic_ns()
        self._followed = []
        ros.meanwhile.append(self._tick)

    def start(self, attempt, know_the_time):
        """Start a trajectory while the time stands, because its publisher is held up by nobody before it has begun.

        Parameters
        ----------
        attempt : callable
            Asks for a start and waits for its first references; returns nothing if it was refused.
        know_the_time : callable
            Told the time, ns, whether all processes know it.
        """
        while True:
            self.stands = True
            self.ros.wait(lambda: know_the_time(self.now), "processes that know the time")
            reply = attempt()
            self.stands = False
            if reply is not None:
                return reply
            now = self.now
            self.ros.wait(lambda now=now: self.now - now > LAG, "another attempt")

    def follow(self, samples, references, bench, publisher):
        """Wait for this drive, as long as its processes are alive.

        Parameters
        ----------
        samples, references : callable
            Return the last message of a bench, and of a publisher of references; None so far.
        bench, publisher : callable
            Return the nodes.
        """
        self._followed.append((samples, references, bench, publisher))

    def follow_topics(self, bench, publisher):
        """Wait for the drive in the namespace of the test's own node; return its last messages by topic."""
        from drive_id_msgs.msg import CurrentReference, Resolver

        last = {}
        for kind, name in ((Resolver, "resolver"), (CurrentReference, "current_reference")):
            self.ros.node.create_subscription(kind, name, partial(last.__setitem__, name), 1000)
        self.follow(partial(last.get, "resolver"), partial(last.get, "current_reference"), bench, publisher)
        return last

    def _tick(self):
        now = time.monotonic_ns()
        if now - self._last < _PAUSE:
            return
        ready = now - self._moved > _PATIENCE or all(self._is_ready(*drive) for drive in self._followed)
        if not self.stands and ready:
            self.now += min(now - self._last, _STEP)
            self._moved = now
        self._last = now
        message = self.kind()
        message.clock.sec, message.clock.nanosec = divmod(self.now, SECOND)
        self.publisher.publish(message)

    def _is_ready(self, samples, references, bench, publisher):
        last = samples()
        if last is not None and bench().alive and self.now - end_of(last, last.angle) >= LAG:
            return False
        last = references()
        if last is None or not publisher().alive or not np.any([last.d, last.q]):
            return True
        return end_of(last, last.d) - self.now > LAG


def stamp_of(message):
    """Return the time in a message's header, ns."""
    return message.header.stamp.sec * SECOND + message.header.stamp.nanosec


def end_of(message, values):
    """Return when a block ends, ns."""
    return stamp_of(message) + round(len(values) * message.sample_period * SECOND)
