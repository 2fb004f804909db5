"""A trajectory publisher and a simulated bench, and what they say to each other."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
from simulated_time import stamp_of

from drive_id.core import frames

PUBLISHER = "drive_id.nodes.trajectory_publisher"
BENCH = "drive_id.nodes.bench_simulator"
SIGNALS = ("phase_currents", "phase_voltages", "resolver")
SETTINGS = {
    "i_max": 100.0, "frequency_d": 7.3, "frequency_q": 2.3, "duration": 1.0, "slew_rate": 2e4, "lead_time": 1.0,
    "watch_timeout": 30.0,
}  # fmt: skip
"""A short experiment, patient enough for a busy machine."""
LIGHT = {"sample_period": 2e-4, "inverter": "tanh", "inverter_current": 15.0}
"""A simulated drive for tests in real time that share its thread: with the nodes of a whole suite, it takes 0.35 of a
core. With dead time, whose corner at zero current asks for the finest steps, it takes 0.53, and at 10 kHz 0.8, which at
load 6 is more than there is: nothing else is served in time, or ever. Without any drop, 4 A are left at rest.
"""


class LiveDrive:
    """Both nodes in one namespace, everything that they publish, and their services.

    Their time is simulated while the test waits, by the ``clock`` given, or by the bench itself without any.
    """

    def __init__(self, ros, namespace="", publisher=None, bench=None, *, clock=None, simulator=BENCH, process=False):
        from diagnostic_msgs.msg import DiagnosticArray
        from drive_id_msgs.msg import CurrentReference, PhaseCurrents, PhaseVoltages, PublisherState, Resolver
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self.ros, self.clock = ros, clock
        self.namespace = namespace
        bench = {"use_sim_time": clock is not None} | (bench or {})
        publisher = SETTINGS | {"use_sim_time": True} | (publisher or {})
        make = ros.start if process else ros.host
        self.bench = make(simulator, parameters=bench, namespace=namespace)
        self.publisher = make(PUBLISHER, parameters=publisher, namespace=namespace)
        self.messages, self._before = {}, {}
        for kind, name in (
            (PhaseCurrents, "phase_currents"), (PhaseVoltages, "phase_voltages"), (Resolver, "resolver"),
            (CurrentReference, "current_reference"),
        ):  # fmt: skip
            self.messages[name] = []
            ros.node.create_subscription(kind, f"{namespace}/{name}", self.messages[name].append, 1000)
        if clock is not None:
            clock.follow(
                partial(self.last, "resolver"), partial(self.last, "current_reference"),
                lambda: self.bench, lambda: self.publisher,
            )  # fmt: skip
        self.states, self.statuses, self.times = [], {}, {}
        every = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.node.create_subscription(
            PublisherState, f"{namespace}/trajectory_publisher/state", self.states.append, every
        )
        ros.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_diagnostics(self, message):
        for status in message.status:
            self.statuses[status.name] = status
            self.times[status.name] = stamp_of(message)

    def status(self, node="trajectory_publisher"):
        return self.statuses.get(f"{self.namespace}/{node}")

    def state(self):
        return self.states[-1].state if self.states else None

    def wait_for_state(self, wanted):
        """Wait for a state of the publisher, however short it was, and return it; earlier ones are forgotten."""

        def passed():
            return [number for number, each in enumerate(self.states) if each.state == wanted]

        del self.states[: self.ros.wait(passed, f"{self.namespace} becomes {wanted}")[0]]
        return self.states[0]

    def trigger(self, what):
        from drive_id_msgs.srv import Command
        from std_srvs.srv import Trigger

        kind = Command if what == "clear_fault" else Trigger
        return self.ros.call(kind, f"{self.namespace}/trajectory_publisher/{what}")

    def ask(self, what, answered, description):
        """Call a service again and again until the answer is the wanted one; return it."""
        asked = [-1.0]

        def attempt():
            if time.monotonic() - asked[0] < 0.1:
                return None
            asked[0] = time.monotonic()
            reply = self.trigger(what)
            return reply if answered(reply) else None

        return self.ros.wait(attempt, description)

    def start(self):
        """Start as soon as the publisher has heard from the drive."""
        if self.clock is None:
            return self.ask("start", lambda reply: reply.success, "a start")

        def attempt():
            before, reply = self.last("current_reference"), self.trigger("start")
            if reply.success:
                self.ros.wait(lambda: self.last("current_reference") is not before, "references")
            return reply if reply.success else None

        return self.clock.start(attempt, lambda now: self.times.get(f"{self.namespace}/trajectory_publisher") == now)

    def refuses(self, reason):
        """Wait until a start is refused for this reason."""
        self.ask("start", lambda reply: not reply.success and reason in reply.message, f"a refusal: {reason}")

    def run_without_end(self, amplitude=20.0):
        """Start without an end, and wait until there is current."""
        assert self.set_parameters(repeat=0).successful
        self.start()
        self.ros.wait(lambda: self.is_driven(amplitude), "current")

    def clear(self):
        """Clear a fault as soon as its cause is gone."""
        self.ask("clear_fault", lambda reply: reply.success, "a cleared fault")
        self.ros.wait(lambda: self.state() == "idle", "rest")

    def rest(self):
        """Stop, and wait until nothing is running any more."""
        self.ask("stop", lambda reply: reply.message.startswith("Nothing is running."), "rest")
        self.ros.wait(self.is_at_zero, "zero current")

    def ended_at_zero(self):
        """Wait until the last references are zero, and return all as they hold: stamps (N,), ns, and (N, 2), A."""
        last = self.messages["current_reference"]
        self.ros.wait(lambda: np.all(np.concatenate([last[-1].d, last[-1].q]) == 0.0), "references of zero")
        self.ros.wait(self.is_at_zero, "zero current")
        return self.references()

    def wait_for_message(self, text):
        """Wait until the publisher's diagnostics say so."""
        self.ros.wait(lambda: (status := self.status()) and text in status.message, f"diagnostics: {text}")

    def last(self, name):
        """Return the last message of a topic, forgotten or not; None before the first one."""
        return self.messages[name][-1] if self.messages[name] else self._before.get(name)

    def forget(self):
        self._before = {name: self.last(name) for name in self.messages}
        for messages in self.messages.values():
            messages.clear()
        del self.states[:-1]

    def set_parameters(self, node="trajectory_publisher", **values):
        """Set parameters together and return what the node says to it."""
        return self.ros.set_parameters(f"{self.namespace}/{node}", **values)

    def references(self):
        """Return stamps (N,), ns, and references (N, 2), A, as they hold: later blocks take back what follows them."""
        due = {}
        for message in self.messages["current_reference"]:
            stamps, values = samples(message, "d", "q")
            due = {stamp: value for stamp, value in due.items() if stamp < stamps[0]}
            due |= dict(zip(stamps.tolist(), values, strict=True))
        return np.array(sorted(due)), np.array([due[stamp] for stamp in sorted(due)])

    def current(self):
        """Return stamps (N,), ns, and measured currents i_dq (N, 2), A."""
        currents = [samples(message, "a", "b", "c") for message in self.messages["phase_currents"]]
        resolver = [samples(message, "angle", "speed") for message in self.messages["resolver"]]
        stamp, i_abc = (np.concatenate(part) for part in zip(*currents, strict=True))
        stamp_angle, position = (np.concatenate(part) for part in zip(*resolver, strict=True))
        both, first, second = np.intersect1d(stamp, stamp_angle, return_indices=True)
        return both, frames.to_dq(i_abc[first], position[second, 0])

    def is_driven(self, amplitude=20.0):
        """Whether references have come, and the last block of currents is far from zero."""
        found = self.messages["phase_currents"]
        there = bool(self.messages["current_reference"] and found)
        return there and np.abs([found[-1].a, found[-1].b, found[-1].c]).max() > amplitude

    def is_at_zero(self):
        """Whether the last block of currents is zero but for the ripple of the inverter."""
        found = self.messages["phase_currents"]
        return bool(found) and np.abs([found[-1].a, found[-1].b, found[-1].c]).max() < 3.0


def samples(message, *fields):
    """Return stamps (N,), ns, and values (N, K) of a block."""
    first = stamp_of(message)
    values = np.stack([np.frombuffer(getattr(message, name), np.float32) for name in fields], axis=-1).astype(float)
    return first + np.round(np.arange(len(values)) * message.sample_period * 1e9).astype(np.int64), values


def assert_contiguous(messages, field):
    """Check that counts and stamps of blocks follow each other without a gap."""
    counts = np.array([message.first_sample for message in messages])
    lengths = np.array([len(getattr(message, field)) for message in messages])
    np.testing.assert_array_equal(np.diff(counts), lengths[:-1])
    stamps = np.array([stamp_of(message) for message in messages])
    np.testing.assert_allclose(np.diff(stamps), lengths[:-1] * messages[0].sample_period * 1e9, atol=1.0)
