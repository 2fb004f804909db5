"""The baseline of the benchmarks: read a bag with rosbags, fit the paper's regression, print R and u_e.

Usage: python benchmarks/plain_script.py BAG

What an engineer would write first: all rows in one dense matrix, then ``lstsq``. It shares no code with the package.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from scipy.interpolate import BSpline

TOPICS = {"/phase_currents": ("a", "b", "c"), "/phase_voltages": ("a", "b", "c"), "/resolver": ("angle", "speed")}
SHIFTS = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])
COUNT = 8


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


def to_dq(x_abc: Any, angle: Any) -> Any:
    """Transform phase quantities to d and q."""
    axes = angle[:, None] - SHIFTS
    return 2 / 3 * np.stack([(np.cos(axes) * x_abc).sum(1), -(np.sin(axes) * x_abc).sum(1)], axis=1)


def basis(i_dq: Any) -> Any:
    """Return all tensor-product cubic B-splines at all samples, dense."""
    factors = []
    for x in i_dq.T:
        width = (x.max() - x.min()) / (COUNT - 3)
        knots = x.min() + width * np.arange(-3, COUNT + 1)
        factors.append(BSpline.design_matrix(np.clip(x, knots[3], knots[-4]), knots, 3).toarray())
    return (factors[0][:, :, None] * factors[1][:, None, :]).reshape(len(i_dq), -1)


def fit(stamp: Any, i_abc: Any, u_abc: Any, angle: Any, speed: Any) -> tuple[float, float, Any]:
    """Return R, u_e and gamma of method ``joint``."""
    period = (stamp[-1] - stamp[0]) * 1e-9 / (len(stamp) - 1)
    i_dq = to_dq(i_abc, angle)
    b = basis(i_dq)
    phi, omega = angle[:-1], speed[:-1]
    middle = phi + omega * period / 2
    sinc = np.sinc(omega * period / 2 / np.pi)[:, None]
    v = period * sinc * to_dq(u_abc[:-1], middle)
    nodes, gauss = np.polynomial.legendre.leggauss(4)
    q1 = np.zeros_like(v)
    for node, weight in zip(nodes, gauss, strict=True):
        s = (node + 1) / 2
        q1 += weight / 2 * period * to_dq(i_abc[:-1] + s * np.diff(i_abc, axis=0), phi + omega * s * period)
    drop = to_dq(np.tanh(i_abc), angle)
    q4 = period / 2 * (drop[1:] + drop[:-1])
    total = (omega * period / 2)[:, None] * (b[1:] + b[:-1])
    change = b[1:] - b[:-1]
    rows = np.concatenate(
        [np.hstack([q1[:, :1], q4[:, :1], change, -total]), np.hstack([q1[:, 1:], q4[:, 1:], total, change])]
    )
    x = np.linalg.lstsq(rows, v.T.ravel(), rcond=None)[0]
    return float(x[0]), float(x[1]), x[2:]


def main() -> None:
    """Read and fit."""
    signals = read(Path(sys.argv[1]))
    (stamp, i_abc), (_, u_abc), (_, rotor) = (signals[topic] for topic in TOPICS)
    resistance, voltage_error, _ = fit(stamp, i_abc, u_abc, np.unwrap(rotor[:, 0]), rotor[:, 1])
    print(f"R = {resistance * 1e3:.4f} mΩ, u_e = {voltage_error:.4f} V")


if __name__ == "__main__":
    main()
