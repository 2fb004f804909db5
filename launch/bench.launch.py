"""A simulated bench: a drive that follows ``current_reference`` and publishes what a real one would measure.

``ros2 launch drive_id bench.launch.py machine:=spm namespace:=drive_1``. ``machine`` and ``truth_file`` take precedence
over the parameter file.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).resolve().parent.parent / "config"
TOPICS = (
    "current_reference", "phase_currents", "phase_voltages", "resolver", "drive_status", "dc_link_voltage",
    "winding_temperature", "magnet_temperature", "shaft_torque",
)  # fmt: skip


OWN = {
    "machine": "Shipped machine (ipm, spm, pmsyrm) or machine file; empty: as in the parameter file.",
    "truth_file": "File to which the ground truth is written; empty: as in the parameter file.",
}


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the drive."),
        *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in OWN.items()),
        DeclareLaunchArgument(
            "bench_parameters",
            default_value=str(CONFIG / "bench_simulator.yaml"),
            description="Parameter file of the bench.",
        ),
    ]
    arguments += [
        DeclareLaunchArgument(topic, default_value=topic, description="Topic name to use instead.") for topic in TOPICS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    """Describe the node for given arguments; empty ones must not override the parameter file."""
    given = {name: LaunchConfiguration(name) for name in OWN}
    own = {name: ParameterValue(text, value_type=str) for name, text in given.items() if text.perform(context)}
    return [
        Node(
            package="drive_id",
            executable="bench_simulator",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("bench_parameters"), *([own] if own else [])],
            remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
            output="screen",
        )
    ]
