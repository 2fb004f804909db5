"""A stranger's inverter: single samples at 5 kHz in standard messages, translated live by a signals file."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.errors import ConfigurationError

COUNT = 3000
SIGNALS = """
defaults: {sample_period: 2.0e-4}
currents: {topic: joint, fields: ["effort[0]", "effort[1]", "effort[2]"]}
resolver: {topic: joint, angle: "position[0]", speed: "velocity[0]", mechanical: true, pole_pairs: 4}
voltages:
  topic: duty
  fields: ["data[0]", "data[1]", "data[2]"]
  scale: 400.0
  stamp: index
  first_sample: "data[3]"
"""


def test_a_stranger_is_translated_and_nothing_is_lost(ros):
    from drive_id_msgs.msg import PhaseCurrents, PhaseVoltages, Resolver
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float32MultiArray

    file = ros.folder / "signals.yaml"
    file.write_text(SIGNALS)
    ros.host("drive_id.nodes.signal_bridge", parameters={"signals": str(file)})
    settings = {"signals": str(file), "i_max": 10.0, "method": "joint", "data_directory": str(ros.folder)}
    ros.host("drive_id.nodes.identification", parameters=settings | {"output_directory": str(ros.folder / "out")})
    random = np.random.default_rng(1)
    i_abc = random.normal(size=(COUNT, 3))
    i_abc -= i_abc.mean(axis=1, keepdims=True)
    duty = random.uniform(-1, 1, (COUNT, 3)).astype(np.float32)
    angle = np.cumsum(np.full(COUNT, 0.002))
    received = {PhaseCurrents: [], PhaseVoltages: [], Resolver: []}
    values = {}
    deep = QoSProfile(depth=10_000)
    for kind, name in ((PhaseCurrents, "phase_currents"), (PhaseVoltages, "phase_voltages"), (Resolver, "resolver")):
        ros.node.create_subscription(kind, name, received[kind].append, deep)

    values = ros.diagnostics()
    joint = ros.node.create_publisher(JointState, "joint", deep)
    floats = ros.node.create_publisher(Float32MultiArray, "duty", deep)
    listening = {joint: 2, floats: 2}
    ros.wait(
        lambda: (
            all(one.get_subscription_count() == count for one, count in listening.items())
            and ros.node.count_publishers("phase_currents") == 1
        ),
        "the bridge and the identification node listening",
    )
    for k in range(COUNT):
        message = JointState(position=[angle[k]], velocity=[10.0], effort=i_abc[k].tolist())
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(k * 200_000, 10**9)
        joint.publish(message)
        floats.publish(Float32MultiArray(data=[*duty[k].tolist(), float(k)]))
        for _ in range(4):  # both nodes take both messages
            ros.executor.spin_once(timeout_sec=0)

    fields = {PhaseCurrents: "a", PhaseVoltages: "a", Resolver: "angle"}

    def arrived():
        counts = [sum(len(getattr(m, field)) for m in received[kind]) for kind, field in fields.items()]
        return min(counts) == max(counts) >= COUNT - 5

    ros.wait(arrived, f"{COUNT} samples translated")
    found = np.concatenate([np.stack([m.a, m.b, m.c], axis=-1) for m in received[PhaseCurrents]])
    np.testing.assert_allclose(found, i_abc[: len(found)], rtol=1e-5, atol=1e-6)
    volts = np.concatenate([np.stack([m.a, m.b, m.c], axis=-1) for m in received[PhaseVoltages]])
    np.testing.assert_allclose(volts, 400.0 * duty[: len(volts)], rtol=1e-5)
    turned = np.concatenate([m.angle for m in received[Resolver]])
    np.testing.assert_allclose(np.exp(1j * turned), np.exp(4j * angle[: len(turned)]), atol=1e-5)
    first = [m.first_sample for m in received[PhaseCurrents]]
    assert first == list(np.cumsum([0, *(len(m.a) for m in received[PhaseCurrents][:-1])]))

    def both():
        bridge, identification = (values.get(f"/{name}", {}) for name in ("signal_bridge", "identification"))
        return int(bridge.get("samples", 0)) >= COUNT - 5 and int(identification.get("samples", 0)) >= COUNT - 1005

    ros.wait(both, "the diagnostics of both")
    assert values["/signal_bridge"]["unreadable messages"] == values["/signal_bridge"]["dropped messages"] == "0"

    joint.publish(JointState())  # without a current

    def told(node):
        return any("joint cannot be read as" in text for text in values.get(f"/{node}", {}).values())

    ros.wait(lambda: told("signal_bridge") and told("identification"), "a word on the unreadable message")


def test_a_bridge_without_a_signals_file_says_so(ros):
    with pytest.raises(ConfigurationError, match="The parameter signals is empty: name a signals file"):
        ros.host("drive_id.nodes.signal_bridge")
