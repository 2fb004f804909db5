"""Two simulated benches on one computer, each with all nodes in a namespace and with a clock of its own.

``ros2 launch drive_id two_benches.launch.py``; then ``ros2 run drive_id characterize --ros-args -r __ns:=/drive_2``.
Two real drives take the same without ``bench_simulator`` and the clock, which only simulated drives publish.
"""

from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch_ros.actions import Node

CONFIG = Path(__file__).resolve().parent.parent / "config"
DRIVES = {"drive_1": ("ipm", 300.0), "drive_2": ("spm", 20.0)}
"""Namespaces, machines, and radii of the current disc, A."""
TIME_SCALE = 2.0
"""Of both simulations: each publishes its own time, which the nodes of its namespace follow."""


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    return LaunchDescription([node for name, drive in DRIVES.items() for node in _bench(name, *drive)])


def _bench(name: str, machine: str, i_max: float) -> list[Node]:
    """Describe the nodes of one bench."""
    data = {"data_directory": f"{name}/recordings"}
    parameters: dict[str, dict[str, Any]] = {
        "bench_simulator": {"machine": machine, "time_scale": TIME_SCALE},
        "trajectory_publisher": {"i_max": i_max, "use_sim_time": True},
        "recorder": data | {"use_sim_time": True},
        "identification": data | {"output_directory": f"{name}/identifications", "i_max": i_max, "use_sim_time": True},
        "experiment": {"use_sim_time": True},
    }
    return [
        Node(
            package="drive_id",
            executable=node,
            namespace=name,
            parameters=[str(CONFIG / f"{node}.yaml"), own],
            remappings=[("/clock", f"/{name}/clock")],
            output="screen",
        )
        for node, own in parameters.items()
    ]
