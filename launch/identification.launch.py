"""The nodes that identify a drive, real or simulated: trajectory publisher, recorder, identification, experiment.

``ros2 launch drive_id identification.launch.py namespace:=drive_1 i_max:=200.0``. ``i_max`` and ``use_sim_time`` apply
to all nodes that have them and take precedence over the parameter files. Topics are remapped for all nodes with
``ros2 launch ... phase_currents:=/inverter/currents``. With ``respawn:=true``, all nodes but the
trajectory publisher are started again if they die: find out why that ended before you start another trajectory.
With ``bridge:=true signals:=FILE``, the signal bridge publishes a bench's own topics as ours; with ``signals`` alone,
the identification node reads them itself, and the recorder needs them in ``extra_topics``.
"""

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).resolve().parent.parent / "config"
NODES = ("trajectory_publisher", "recorder", "identification", "experiment", "signal_bridge")
MANAGED = tuple(node for node in NODES if node != "experiment")
RESPAWN_DELAY = 2.0  # s
SWITCH = {"true": True, "false": False, "True": True, "False": False}
SWITCHES = ("use_sim_time", "autostart", "activate", "require_status")
NUMBERS = ("i_max", "speed_max")
LEVELS = ("debug", "info", "warn", "error", "fatal")
OWN = {
    "i_max": (("trajectory_publisher", "identification"), "Radius of the current disc, A."),
    "speed_max": (("trajectory_publisher",), "Highest electrical speed allowed, rad/s."),
    "require_status": (("trajectory_publisher",), "Run only with a drive that publishes drive_status."),
    "data_directory": (("recorder", "identification"), "Folder of the recordings."),
    "output_directory": (("identification",), "Folder of the results."),
    "signals": (("identification", "signal_bridge"), "Signals file of a bench with topics of its own."),
    "use_sim_time": (NODES, "Use the time on /clock."),
    "autostart": (MANAGED, "Have the nodes configure themselves."),
    "activate": (MANAGED, "Have nodes that configure themselves activate themselves, too."),
}
"""Parameters as launch arguments, the nodes that have them, and a sentence."""
TOPICS = (
    "current_reference", "phase_currents", "phase_voltages", "resolver", "drive_status", "emergency_stop",
    "dc_link_voltage", "winding_temperature", "magnet_temperature", "shaft_torque", "flux_map", "flux_map_points",
    "fit_report", "operating_point",
)  # fmt: skip


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the drive."),
        *(
            DeclareLaunchArgument(
                name,
                default_value="",
                description=f"{text[:-1]}; empty: as in the parameter files.",
                **({"choices": ["", *SWITCH]} if name in SWITCHES else {}),
            )
            for name, (_, text) in OWN.items()
        ),
        DeclareLaunchArgument(
            "bridge", default_value="false", choices=list(SWITCH), description="Start the signal bridge, too."
        ),
        DeclareLaunchArgument(
            "respawn",
            default_value="false",
            choices=list(SWITCH),
            description="Start all nodes but the trajectory publisher again if they die.",
        ),
        DeclareLaunchArgument("log_level", default_value="info", choices=list(LEVELS), description="Of all nodes."),
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
    given = {name: LaunchConfiguration(name).perform(context) for name in (*OWN, "bridge", "respawn")}
    bridged = SWITCH[given["bridge"]]
    values = {name: _value(name, given[name]) for name in OWN if given[name]}
    nodes = []
    for node in NODES if bridged else NODES[:-1]:
        own = {name: value for name, value in values.items() if node in OWN[name][0]}
        if bridged and node == "identification":
            own.pop("signals", None)  # it listens to the bridge
        nodes.append(
            Node(
                package="drive_id",
                executable=node,
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration(f"{node}_parameters"), *([own] if own else [])],
                remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
                ros_arguments=["--log-level", LaunchConfiguration("log_level")],
                output="screen",
                respawn=SWITCH[given["respawn"]] and node != "trajectory_publisher",
                respawn_delay=RESPAWN_DELAY,
            )
        )
    return nodes


def _value(name: str, text: str) -> Any:
    """Return an argument as the value of a parameter."""
    if name in SWITCHES:
        return SWITCH[text]
    return _number(name, text) if name in NUMBERS else ParameterValue(text, value_type=str)


def _number(name: str, text: str) -> float:
    """Return an argument as a number."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}:={text} is not a number: write it as in {name}:=300.0") from None
