"""The nodes that identify a drive, real or simulated: trajectory publisher, recorder, identification.

``ros2 launch drive_id identification.launch.py namespace:=drive_1``. Each node has its own parameter file; topics are
remapped for all of them with ``ros2 launch ... phase_currents:=/inverter/currents``.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).resolve().parent.parent / "config"
NODES = ("trajectory_publisher", "recorder", "identification")
TOPICS = (
    "current_reference", "phase_currents", "phase_voltages", "resolver", "dc_link_voltage", "winding_temperature",
    "magnet_temperature", "shaft_torque",
)  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the drive."),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Take the time from /clock."),
    ]
    arguments += [
        DeclareLaunchArgument(
            f"{node}_parameters",
            default_value=str(CONFIG / f"{node}.yaml"),
            description=f"Parameter file of the {node.replace('_', ' ')}.",
        )
        for node in NODES
    ]
    arguments += [
        DeclareLaunchArgument(topic, default_value=topic, description="Topic name to use instead.") for topic in TOPICS
    ]
    use_sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    nodes = [
        Node(
            package="drive_id",
            executable=node,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration(f"{node}_parameters"), {"use_sim_time": use_sim_time}],
            remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
            output="screen",
        )
        for node in NODES
    ]
    return LaunchDescription([*arguments, *nodes])
