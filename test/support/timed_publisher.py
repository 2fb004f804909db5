"""The node ``trajectory_publisher``; at its end a line per callback: name, calls, median and longest CPU time, ms."""

from __future__ import annotations

import functools
import sys
import time
from collections import defaultdict

from drive_id.nodes.support.runtime import run
from drive_id.nodes.trajectory_publisher import TrajectoryPublisher

SPENT = defaultdict(list)


def timed(callback):
    """Note what each call costs its thread: waiting for a busy machine does not count."""

    @functools.wraps(callback)
    def call(*args):
        begin = time.thread_time()
        try:
            return callback(*args)
        finally:
            SPENT[getattr(callback, "__qualname__", "parameters")].append(time.thread_time() - begin)

    return call


class TimedPublisher(TrajectoryPublisher):
    """Times every callback that the node gives to the executor."""

    def create_timer(self, period, callback, **options):
        return super().create_timer(period, timed(callback), **options)

    def create_subscription(self, kind, topic, callback, qos, **options):
        return super().create_subscription(kind, topic, timed(callback), qos, **options)

    def create_service(self, kind, name, callback, **options):
        return super().create_service(kind, name, timed(callback), **options)

    def close(self):
        super().close()
        for name, spent in SPENT.items():
            usual = sorted(spent)[len(spent) // 2]
            sys.stdout.write(f"spent: {name} {len(spent)} {1e3 * usual:.3f} {1e3 * max(spent):.3f}\n")


if __name__ == "__main__":
    run(TimedPublisher)
