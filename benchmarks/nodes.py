"""The nodes as processes: time until each is ready, and its memory at rest, against a bare rclpy node."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from measuring import Cost
from reporting import Row, Section, seconds, size

CONFIG = Path(__file__).parent.parent / "config"
NODES = {"trajectory_publisher": 90, "recorder": 90, "identification": 250}
"""With their goals, MB."""
READY = 3.0
_REST = 2.0
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
    begun = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        output: list[str] = []
        for line in process.stdout:
            output.append(line)
            if "Ready" in line:
                break
        else:
            raise SystemExit(f"{' '.join(command)} ended:\n{''.join(output)}")
        elapsed = time.perf_counter() - begun
        fields = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        cpu = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        time.sleep(_REST)
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
        memory = 1024 * int(re.findall(r"VmRSS:\s+(\d+) kB", status)[0])
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    return Cost(elapsed, cpu, memory)
