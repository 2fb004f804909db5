"""The sample messages of ``drive_id_msgs`` without ROS: definitions, type hashes and a typestore.

The texts are those of ``msg_defs/msg/*.msg`` (a test compares them token by token), so that bags can be read and
written after ``pip install`` alone; the hashes are those that ROS 2 computes from the same definitions.
"""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

PHASE_CURRENTS = "drive_id_msgs/msg/PhaseCurrents"
PHASE_VOLTAGES = "drive_id_msgs/msg/PhaseVoltages"
RESOLVER = "drive_id_msgs/msg/Resolver"
CURRENT_REFERENCE = "drive_id_msgs/msg/CurrentReference"
SCALAR_SAMPLES = "drive_id_msgs/msg/ScalarSamples"

_HEAD = """\
# A block of equally spaced samples: sample k belongs to header.stamp + k * sample_period.
std_msgs/Header header
uint64 first_sample     # running count of the first sample, so that a loss shows
float64 sample_period   # s
"""

_BODIES = {
    PHASE_CURRENTS: "# Measured phase currents, A.\nfloat32[] a\nfloat32[] b\nfloat32[] c\n",
    PHASE_VOLTAGES: "# Commanded phase voltages, held for one period, V.\nfloat32[] a\nfloat32[] b\nfloat32[] c\n",
    RESOLVER: "# Electrical angle, rad, in [-pi, pi), and speed, rad/s.\nfloat32[] angle\nfloat32[] speed\n",
    CURRENT_REFERENCE: (
        "# Current set-points, A, the first due at the stamp; safe: zero current on receipt.\n"
        "float32[] d\nfloat32[] q\nuint64 session\nuint64 count\nbool safe\nbool stator_frame\n"
    ),
    SCALAR_SAMPLES: "# One optional signal, V, degrees Celsius or Nm, as its topic says.\nfloat32[] value\n",
}

BLOCK_FIELDS: dict[str, tuple[str, ...]] = {
    name: tuple(re.findall(r"^float32\[\] (\w+)$", body, re.MULTILINE)) for name, body in _BODIES.items()
}
"""The ``float32[]`` fields of each message, in order of definition."""

DEFINITIONS: dict[str, str] = {name: _HEAD + body for name, body in _BODIES.items()}
"""The text of each ``.msg`` file."""

_SEPARATOR = "=" * 80
_DEPENDENCIES = f"""\
{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def schema_text(type_name: str) -> str:
    """Return the complete ``ros2msg`` schema of one of our messages, its dependencies included."""
    return DEFINITIONS[type_name] + _DEPENDENCIES


@cache
def message_typestore() -> Typestore:
    """Return a typestore of our messages and their dependencies."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415  # not needed for bags of our own messages

    store = get_typestore(Stores.EMPTY)
    for name in DEFINITIONS:
        store.register(get_types_from_msg(schema_text(name), name))
    return store


@cache
def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of one of our messages."""
    return message_typestore().hash_rihs01(type_name)
