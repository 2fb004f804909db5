"""Logs of a stranger: named columns, written with other libraries' writers as bags or as files of columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bag_samples import write_foreign
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROW = "std_msgs/Header header\nuint64 counter\nuint32 ticks\nfloat64[] data\n"
TYPE = "bench_msgs/msg/Row"
TICK = 10
"""Of the 32-bit timer, ns."""


def write_rows(
    path: Path,
    topics: dict[str, np.ndarray],
    stamps: dict[str, np.ndarray],
    *,
    arrival: dict[str, np.ndarray] | None = None,
    counts: dict[str, np.ndarray] | None = None,
) -> Path:
    """Write a bag with one row of ``data`` per message and topic; stamps and log times in ns."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(ROW, TYPE))
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    row = store.types[TYPE]
    messages = {}
    for topic, values in topics.items():
        stamp = stamps[topic]
        logged = stamp if arrival is None else arrival[topic]
        count = np.arange(len(stamp)) if counts is None else counts[topic]
        messages[topic] = (
            TYPE,
            [
                (int(log), row(header(time(*divmod(int(t), 10**9)), ""), int(k), int(t // TICK) % 2**32, values[n]))
                for n, (t, log, k) in enumerate(zip(stamp, logged, count, strict=True))
            ],
        )
    return write_foreign(path, store, messages)
