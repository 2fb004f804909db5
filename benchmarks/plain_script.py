"""The baseline as a whole process: read a bag with rosbags, fit it with the plain numpy script, print R and u_e.

Usage: python benchmarks/plain_script.py BAG
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from dense_script import fit
from rosbags.highlevel import AnyReader

TOPICS = {"/phase_currents": ("a", "b", "c"), "/phase_voltages": ("a", "b", "c"), "/resolver": ("angle", "speed")}


def read(path: Path) -> dict[str, Any]:
    """Return stamps, ns, and values of each topic."""
    stamps: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
    values: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
    with AnyReader([path]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in TOPICS]
        for connection, _, data in reader.messages(wanted):
            message: Any = reader.deserialize(data, connection.msgtype)
            columns = [getattr(message, name) for name in TOPICS[connection.topic]]
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            step = message.sample_period * 1e9
            stamps[connection.topic].append(stamp + np.rint(np.arange(len(columns[0])) * step).astype(np.int64))
            values[connection.topic].append(np.column_stack(columns))
    return {topic: (np.concatenate(stamps[topic]), np.concatenate(values[topic]).astype(float)) for topic in TOPICS}


def main() -> None:
    """Read and fit."""
    signals = read(Path(sys.argv[1]))
    (stamp, i_abc), (_, u_abc), (_, rotor) = (signals[topic] for topic in TOPICS)
    resistance, voltage_error, _ = fit(stamp, i_abc, u_abc, np.unwrap(rotor[:, 0]), rotor[:, 1])
    print(f"R = {resistance * 1e3:.4f} mΩ, u_e = {voltage_error:.4f} V")


if __name__ == "__main__":
    main()
