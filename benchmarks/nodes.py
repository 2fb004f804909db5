"""The nodes as processes: time until each is ready, and its memory at rest, against a bare rclpy node."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from measuring import Cost
from node_processes import NodeProcess
from reporting import Row, Section, seconds, size

CONFIG = Path(__file__).parent.parent / "config"
NODES = {"trajectory_publisher": 90, "recorder": 90, "identification": 250}
"""With their goals, MB."""
READY = 3.0
_REST, _LOOK = 2.0, 0.005
"""Time after which the memory is looked at, and between two looks at the log, s."""
_BARE = """
import rclpy
rclpy.init()
node = rclpy.create_node("bare")
node.get_logger().info("Ready")
try:
    rclpy.spin(node)
except KeyboardInterrupt:
    pass
"""


def section(repeats: int) -> Section:
    """Start every node several times; the best counts."""
    commands = {"bare": [sys.executable, "-c", _BARE]}
    for name in NODES:
        arguments = ["--ros-args", "--params-file", str(CONFIG / f"{name}.yaml")]
        commands[name] = [sys.executable, "-m", f"drive_id.nodes.{name}", *arguments]
    best: dict[str, Cost] = {}
    for number in range(-1, repeats):  # the first start compiles what is not in the cache yet
        for name, command in commands.items():
            cost = start(command)
            if number >= 0:
                best[name] = best[name].best(cost) if name in best else cost
    bare = best["bare"]
    rows = [
        Row(
            f"`{name}`",
            f"{seconds(bare.elapsed)}, {size(bare.memory)}",
            f"{seconds(best[name].elapsed)}, {size(best[name].memory)}",
            f"{best[name].elapsed / bare.elapsed:.1f} ×, {best[name].memory / bare.memory:.1f} × memory",
            f"{best[name].cpu / bare.cpu:.1f} ×",
            f"≤ {READY:g} s, ≤ {most} MB",
        )
        for name, most in NODES.items()
    ]
    text = (
        f"Time until `Ready` is logged, and memory {_REST:g} s later; baseline: a node of rclpy that does nothing. "
        "With live fits,\n`identification` takes more: [Memory](../nodes.md#memory)."
    )
    return Section("Nodes", text, tuple(rows))


def start(command: list[str]) -> Cost:
    """Start a node, wait until it is ready, and stop it."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        process = NodeProcess(command, Path(folder) / "log")
        while "Ready" not in process.text:
            if not process.alive:
                raise SystemExit(f"{' '.join(command)} ended:\n{process.text}")
            time.sleep(_LOOK)
        elapsed = time.perf_counter() - begun
        fields = Path(f"/proc/{process.popen.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        cpu = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        time.sleep(_REST)
        memory = round(1e6 * process.memory)
        process.end(signal.SIGINT)
    return Cost(elapsed, cpu, memory)
