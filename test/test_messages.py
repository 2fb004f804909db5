"""The messages keep their contract, and rclpy carries them from one process to another."""

import array
import contextlib
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
from ros_bench import require_ros

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError

DEFINITIONS = Path(__file__).parent.parent / "msg_defs"

BLOCK = "std_msgs/Header header; uint64 first_sample; float64 sample_period; "

# What outsiders rely on: every field, in order. "---" parts a service's request from its reply.
CONTRACT = {
    "msg/PhaseCurrents": BLOCK + "float32[] a; float32[] b; float32[] c",
    "msg/PhaseVoltages": BLOCK + "float32[] a; float32[] b; float32[] c",
    "msg/Resolver": BLOCK + "float32[] angle; float32[] speed",
    "msg/CurrentReference": BLOCK
    + "float32[] d; float32[] q; uint64 session; uint64 count; bool safe; bool stator_frame",
    "msg/DriveStatus": (
        "std_msgs/Header header; uint64 count; bool enabled; string fault; uint64 session; uint64 applied; "
        "float32 i_d; float32 i_q; float32 speed; float32 dc_link_voltage; float32 winding_temperature; "
        "float32 magnet_temperature; float32 current_limit; float32 speed_limit; float32 dc_link_voltage_limit; "
        "float32 winding_temperature_limit"
    ),
    "msg/PublisherState": (
        "std_msgs/Header header; string state; string reason; bool dry_run; uint64 session; float64 elapsed; "
        "float64 duration; float64 i_d; float64 i_q; float64 coverage; "
        "float64 mean_speed; float64 mean_speed_reference; float64 bias; bool completed"
    ),
    "msg/ScalarSamples": BLOCK + "float32[] value",
    "msg/FluxMap": (
        "std_msgs/Header header; string method; string machine; float64[] i_d; float64[] i_q; "
        "float64[] psi_d; float64[] psi_q; float64[] sigma_d; float64[] sigma_q; bool[] inside; "
        "float64 resistance; float64 sigma_resistance; float64 voltage_error; float64 sigma_voltage_error; "
        "float64[] inverter_current; float64[] inverter_voltage; float64 i_max; float64 coverage; string[] warnings; "
        "string[] warning_codes; string[] warning_values; "
        "uint32[] harmonic_orders; float64[] harmonic_psi_d_cos; float64[] harmonic_psi_d_sin; "
        "float64[] harmonic_psi_q_cos; float64[] harmonic_psi_q_sin; string[] calibration_names; "
        "float64[] calibration_values; float64[] calibration_sigmas; string[] calibration_units; "
        "bool[] calibration_applied; bool provisional; "
        "string serial; string[] recordings; uint64 session; string folder"
    ),
    "msg/OperatingPoint": "std_msgs/Header header; float64 i_d; float64 i_q; float64 speed",
    "msg/FitReport": (
        "uint64 samples_read; uint64 samples_used; uint64 rows; uint32 gaps; uint32 parameters; uint32 rank; "
        "float64 condition; float64 residual_rms; float64 mad_d; float64 mad_q; float64 coverage; string[] warnings; "
        "string[] warning_codes; string[] warning_values; "
        "float64 inertia; float64 sigma_inertia; float64 friction; float64 sigma_friction; float64 viscous_friction; "
        "float64 sigma_viscous_friction; float64 load; float64 sigma_load; uint32[] cogging_orders; "
        "float64[] cogging_amplitudes; float64[] cogging_sigmas; float64 cogging_visible; "
        "float64 torque_gain; float64 sigma_torque_gain; "
        "string[] calibration_names; float64[] calibration_values; float64[] calibration_sigmas; "
        "string[] calibration_units; bool[] calibration_applied; builtin_interfaces/Time stamp; string folder"
    ),
    "srv/Command": "---; bool success; string code; string message",
    "srv/StartExperiment": (
        "bool dry_run; bool require_lease; string trajectory; float64 i_max; float64 duration; uint32 repeat; ---; "
        "bool success; string code; string message; uint64 session"
    ),
    "srv/Identify": (
        "string[] bags; string part; string method; string signals; string machine; string serial; string bench; "
        "string operator_name; string notes; float64 i_max; float64[] temperatures; float64[] u_dc; uint64 session; "
        "---; bool success; string code; string message; "
        "FluxMap flux_map; FitReport report; string output"
    ),
    "action/Identify": (
        "string[] bags; string part; string method; string signals; string machine; string serial; string bench; "
        "string operator_name; string notes; float64 i_max; float64[] temperatures; float64[] u_dc; uint64 session; "
        "---; bool success; string code; string message; "
        "FluxMap flux_map; FitReport report; string output; ---; string stage; float64 progress; string message"
    ),
    "srv/FirstStart": (
        "string name; bool angle_known; ---; bool success; string code; string message; float64 angle_offset; "
        "float64 sigma_angle_offset; float64 load_angle; float64[3] current_offset; float64 shaft_acceleration; "
        "string signals; string parameters"
    ),
    "action/FirstStart": (
        "string name; bool angle_known; ---; bool success; string code; string message; float64 angle_offset; "
        "float64 sigma_angle_offset; float64 load_angle; float64[3] current_offset; float64 shaft_acceleration; "
        "string signals; string parameters; ---; string stage; float64 progress; string message"
    ),
    "action/Experiment": (
        "string name; string trajectory; float64 i_max; float64 duration; uint32 repeat; float64[] speeds; string"
        " method; string signals; string machine; string serial; string bench; string operator_name; string "
        "notes; float64[] temperatures; float64[] u_dc; float64 lease_time; ---; bool success; string code; "
        "string message; string[] bags; uint64 samples; uint64 dropped; float64 duration; uint64 session; string "
        "output; FluxMap flux_map; FitReport report; ---; string phase; float64 share; float64 elapsed; float64 "
        "duration; float64 coverage; float64 resistance; float64 sigma_resistance; string waits_for"
    ),
    "msg/RecorderState": (
        "std_msgs/Header header; string state; string uri; uint64 bytes; float64 duration; uint64 samples; uint64"
        " dropped; uint32 restarts; uint64 free_space; string error"
    ),
    "msg/RecordingInfo": (
        "string name; string uri; builtin_interfaces/Time begin; float64 duration; uint64 bytes; uint64 messages;"
        " string error"
    ),
    "msg/ResultInfo": (
        "string folder; string date; string method; string machine; string serial; string bench; string "
        "operator_name; string notes; string[] recordings; uint64 session; float64 resistance; float64 "
        "sigma_resistance; float64 i_max; float64 coverage"
    ),
    "srv/GetResult": (
        "string folder; string machine; string serial; ---; bool success; string code; string message; FluxMap "
        "flux_map; FitReport report; string output"
    ),
    "srv/ListRecordings": (
        "string name; uint32 most; ---; bool success; string code; string message; RecordingInfo[] recordings; "
        "uint32 total"
    ),
    "srv/ListResults": (
        "string machine; string serial; uint32 most; ---; bool success; string code; string message; ResultInfo[]"
        " results; uint32 total"
    ),
    "srv/StartRecording": "string name; ---; bool success; string code; string message; string uri",
    "srv/StopRecording": (
        "---; bool success; string code; string message; string uri; uint64 samples; uint64 dropped; float64 duration"
    ),
}

DEADLINE = 60.0  # s; a round trip takes about one, the rest is for busy machines


SUFFIXES = {"msg": "msg", "srv": "srv", "action": "action"}


def definition(name):
    """Return the text of a definition."""
    return (DEFINITIONS / f"{name}.{SUFFIXES[name.partition('/')[0]]}").read_text(encoding="utf-8")


def read_definition(name):
    """Return the fields of a definition, without constants and comments."""
    lines = (re.sub(r"\s+", " ", line.partition("#")[0]).strip() for line in definition(name).splitlines())
    return "; ".join(line for line in lines if line and "=" not in line)


def constants(name, prefix):
    """Return the values of the string constants of a definition whose names begin so, by name."""
    found = re.findall(rf'^string ({prefix}\w+)="?(.*?)"?$', definition(name), re.MULTILINE)
    assert len(found) == len(dict(found)) or name.startswith("action")
    return dict(found)


@pytest.mark.parametrize("name", CONTRACT)
def test_definition_is_the_contract(name):
    assert read_definition(name) == CONTRACT[name]


@pytest.mark.parametrize("name", [name.partition("/")[2] for name in CONTRACT if name.startswith("msg/")])
def test_the_hash_that_is_built_follows_from_the_definition_alone(name):
    """So nodes of different distributions take each other's messages for the same."""
    require_ros()
    import drive_id_msgs
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store, kind = get_typestore(Stores.ROS2_HUMBLE), f"drive_id_msgs/msg/{name}"
    store.register(get_types_from_msg(definition(f"msg/{name}"), kind))
    places = (parent / "share" / "drive_id_msgs" / "msg" for parent in Path(drive_id_msgs.__file__).parents)
    (share,) = filter(Path.exists, places)
    built = json.loads((share / f"{name}.json").read_text("utf-8"))  # Humble has no hashes
    assert {each["type_name"]: each["hash_string"] for each in built["type_hashes"]}[kind] == store.hash_rihs01(kind)


def test_there_are_no_other_definitions_and_all_are_built():
    files = {f"{file.parent.name}/{file.name}" for file in DEFINITIONS.glob("*/*.*")}
    built = re.findall(
        r"^\s+((?:msg|srv|action)/\S+)$", (DEFINITIONS / "CMakeLists.txt").read_text("utf-8"), re.MULTILINE
    )
    assert files == {f"{name}.{SUFFIXES[name.partition('/')[0]]}" for name in CONTRACT}
    assert sorted(built) == sorted(files)


@pytest.mark.parametrize("name", CONTRACT)
def test_every_field_is_commented(name):
    """A field has a comment above it, or follows a field that has one."""
    above = ""
    for line in definition(name).splitlines():
        assert len(line) <= 120
        if line and not line.startswith(("#", "---")):
            assert above, f"{name}: {line!r} has no comment"
        above = line


def subclasses(kind):
    return {kind, *(found for sub in kind.__subclasses__() for found in subclasses(sub))}


OURS = {"ok", "busy", "cancelled", "time_limit", "internal"}
"""Codes of replies that no error has."""


@pytest.mark.parametrize("name", ["srv/Identify", "action/Identify"])
def test_the_codes_and_methods_are_constants(name):
    """Every error that a request can lead to has a constant, which is named after it."""
    codes = constants(name, "CODE_")
    never = {"error", "worker", "experiment"}  # the base, and what no node uses
    assert set(codes.values()) == {error.code for error in subclasses(DriveIdError)} - never | OURS
    assert all(f"CODE_{code.upper()}" == found for found, code in codes.items())
    methods = FitSettings.__dataclass_fields__["method"].metadata["choices"]
    assert sorted(constants(name, "METHOD_").values()) == sorted(set(methods) - {"static"})  # of files, not of nodes
    assert constants("msg/FluxMap", "METHOD_") == constants(name, "METHOD_")


def test_the_action_answers_as_the_service_does():
    """Goal and result have the fields, comments and constants of request and response."""
    service, action = definition("srv/Identify"), definition("action/Identify")
    assert action.split("---\n")[1:2] == service.split("---\n")[1:]
    assert action.split("---\n")[0].partition("\n\n")[2] == service.split("---\n")[0].partition("\n\n")[2]


# ---------------------------------------------------------------------------------------------------------------------
# With ROS 2


@pytest.fixture
def ros():
    """Skip without ROS 2, unless the caller has promised that it is there."""
    require_ros()


def generated_fields(interface):
    """Return the fields of a generated class, written as in its definition."""
    fields = []
    for field, kind in interface.get_fields_and_field_types().items():
        written = re.sub(r"^sequence<(.*)>$", r"\1[]", kind).removeprefix("drive_id_msgs/")
        written = written.replace("boolean", "bool").replace("double", "float64")
        written = re.sub(r"^float\b", "float32", written)
        fields.append(f"{written} {field}")
    return fields


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize("name", CONTRACT)
def test_generated_class_is_the_contract(name):
    module, _, word = name.partition("/")
    interface = getattr(importlib.import_module(f"drive_id_msgs.{module}"), word)
    names = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}[module]
    parts = [getattr(interface, part) for part in names] or [interface]
    fields = [field for part in parts for field in [*generated_fields(part), "---"]][:-1]
    assert "; ".join(fields) == CONTRACT[name]


# The other process: sends back what it receives, until SIGINT.
ECHO = """
import signal
import sys
import rclpy
from drive_id_msgs.msg import PhaseCurrents
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile

signal.signal(signal.SIGINT, signal.default_int_handler)  # what a script starts in the background ignores SIGINT
rclpy.init()
node = rclpy.create_node("echo")
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
publisher = node.create_publisher(PhaseCurrents, sys.argv[1] + "/back", qos)
subscription = node.create_subscription(PhaseCurrents, sys.argv[1] + "/out", publisher.publish, qos)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
finally:
    node.destroy_node()
    rclpy.try_shutdown()
"""


@contextlib.contextmanager
def running(command, environment):
    """Run a process; at the end it must be alive, end on SIGINT with status 0, and have said nothing."""
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
        assert process.poll() is None, process.communicate()[0]
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=DEADLINE)
        assert (process.returncode, output) == (0, "")
    finally:
        process.kill()
        process.communicate()


@pytest.mark.usefixtures("ros")
def test_a_block_of_currents_goes_to_another_process_and_back(monkeypatch, tmp_path):
    from drive_id_msgs.msg import PhaseCurrents
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile

    from drive_id.nodes.support.middleware import fast_dds

    domain = 1 + os.getpid() % 101
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    topic = f"/test_{uuid.uuid4().hex}"  # nobody else's, even if somebody else has this domain

    sent = PhaseCurrents(first_sample=2**40 + 1, sample_period=1e-4)
    sent.header.frame_id = "drive"
    sent.header.stamp.sec, sent.header.stamp.nanosec = 1_700_000_000, 999_999_999
    sent.a = array.array("f", [0.5 * k for k in range(100)])
    sent.b = array.array("f", [-1.5 * k for k in range(100)])
    sent.c = array.array("f", [float(k) for k in range(100)])

    context = Context()
    with fast_dds(), contextlib.ExitStack() as ending:
        context.init(args=[], domain_id=domain)
        ending.callback(context.try_shutdown)
        node = Node("here", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        received = []
        # Transient local: whoever finds the other later still gets the block, so nobody has to wait before sending.
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(PhaseCurrents, f"{topic}/back", received.append, qos)
        publisher = node.create_publisher(PhaseCurrents, f"{topic}/out", qos)
        publisher.publish(sent)
        with running([sys.executable, "-c", ECHO, topic], dict(os.environ)) as other:
            end = time.monotonic() + DEADLINE
            while not received and other.poll() is None and time.monotonic() < end:
                executor.spin_once(timeout_sec=0.1)
            assert received == [sent]
        executor.shutdown()
        node.destroy_node()
