"""The nodes that identify a drive, real or simulated: trajectory publisher, recorder, identification.

``ros2 launch drive_id identification.launch.py namespace:=drive_1 i_max:=200.0``. ``i_max`` holds for all nodes that
have it and takes precedence over their parameter files. Topics are remapped for all nodes with
``ros2 launch ... phase_currents:=/inverter/currents``. With ``respawn:=true``, recorder and identification are started
again if they die; the trajectory publisher never is, because whoever starts a trajectory must have seen why it ended.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).resolve().parent.parent / "config"
NODES = ("trajectory_publisher", "recorder", "identification")
WITH_RADIUS = ("trajectory_publisher", "identification")
RESPAWN_DELAY = 2.0  # s
TOPICS = (
    "current_reference", "phase_currents", "phase_voltages", "resolver", "dc_link_voltage", "winding_temperature",
    "magnet_temperature", "shaft_torque", "flux_map", "flux_map_points", "operating_point",
)  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the drive."),
        DeclareLaunchArgument(
            "i_max", default_value="", description="Radius of the current disc, A; empty: as in the parameter files."
        ),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Take the time from /clock."),
        DeclareLaunchArgument(
            "respawn", default_value="false", description="Start recorder and identification again if they die."
        ),
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
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    """Describe the nodes, the arguments being known."""
    i_max = LaunchConfiguration("i_max").perform(context)
    respawn = LaunchConfiguration("respawn").perform(context).lower() == "true"
    use_sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    nodes = []
    for node in NODES:
        own = {"use_sim_time": use_sim_time}
        if i_max and node in WITH_RADIUS:
            own["i_max"] = float(i_max)
        nodes.append(
            Node(
                package="drive_id",
                executable=node,
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration(f"{node}_parameters"), own],
                remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
                output="screen",
                respawn=respawn and node != "trajectory_publisher",
                respawn_delay=RESPAWN_DELAY,
            )
        )
    return nodes
