"""A simulated bench: a drive that follows ``current_reference`` and publishes what a real one would measure.

``ros2 launch drive_id bench.launch.py machine:=spm namespace:=drive_1``
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).resolve().parent.parent / "config"
TOPICS = (
    "current_reference", "phase_currents", "phase_voltages", "resolver", "dc_link_voltage", "winding_temperature",
    "magnet_temperature", "shaft_torque",
)  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    namespace = LaunchConfiguration("namespace")
    machine = ParameterValue(LaunchConfiguration("machine"), value_type=str)
    truth_file = ParameterValue(LaunchConfiguration("truth_file"), value_type=str)
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of the drive."),
            DeclareLaunchArgument(
                "machine", default_value="ipm", description="Shipped machine (ipm, spm, pmsyrm) or machine file."
            ),
            DeclareLaunchArgument(
                "truth_file", default_value="", description="File for the ground truth; empty: none."
            ),
            DeclareLaunchArgument(
                "bench_parameters",
                default_value=str(CONFIG / "bench_simulator.yaml"),
                description="Parameter file of the bench.",
            ),
            *(
                DeclareLaunchArgument(topic, default_value=topic, description="Topic name to use instead.")
                for topic in TOPICS
            ),
            Node(
                package="drive_id",
                executable="bench_simulator",
                namespace=namespace,
                parameters=[
                    LaunchConfiguration("bench_parameters"),
                    {"machine": machine, "truth_file": truth_file},
                ],
                remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
                output="screen",
            ),
        ]
    )
