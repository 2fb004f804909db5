"""The nodes that identify a drive, real or simulated: trajectory publisher, recorder, identification.

``ros2 launch drive_id identification.launch.py namespace:=drive_1 i_max:=200.0``. ``i_max`` and ``use_sim_time`` apply
to all nodes that have them and take precedence over the parameter files. Topics are remapped for all nodes with
``ros2 launch ... phase_currents:=/inverter/currents``. With ``respawn:=true``, recorder and identification are started
again if they die; the trajectory publisher never is: find out why it ended before you start another trajectory.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(__file__).resolve().parent.parent / "config"
NODES = ("trajectory_publisher", "recorder", "identification")
WITH_RADIUS = ("trajectory_publisher", "identification")
RESPAWN_DELAY = 2.0  # s
SWITCH = {"true": True, "false": False, "True": True, "False": False}
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
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="",
            choices=["", *SWITCH],
            description="Use the time on /clock; empty: as in the parameter files.",
        ),
        DeclareLaunchArgument(
            "respawn",
            default_value="false",
            choices=list(SWITCH),
            description="Start recorder and identification again if they die.",
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
    """Describe the nodes for given arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ("i_max", "use_sim_time", "respawn")}
    nodes = []
    for node in NODES:
        own: dict[str, bool | float] = {}
        if given["use_sim_time"]:
            own["use_sim_time"] = SWITCH[given["use_sim_time"]]
        if given["i_max"] and node in WITH_RADIUS:
            own["i_max"] = _number("i_max", given["i_max"])
        nodes.append(
            Node(
                package="drive_id",
                executable=node,
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration(f"{node}_parameters"), *([own] if own else [])],
                remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
                output="screen",
                respawn=SWITCH[given["respawn"]] and node != "trajectory_publisher",
                respawn_delay=RESPAWN_DELAY,
            )
        )
    return nodes


def _number(name: str, text: str) -> float:
    """Return an argument as a number."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}:={text} is not a number: write it as in {name}:=300.0") from None
