"""A drive inside the test's own node, with whatever is wrong with it as attributes, and a publisher."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np

from drive_id.bench.reference_buffer import ReferenceBuffer

PERIOD = 1e-3  # s
NANOSECONDS = 1_000_000_000
CONFIG = Path(__file__).parents[2] / "config"
PUBLISHER = "trajectory_publisher"
SPEED = 200.0
"""Electrical, rad/s."""
SOUND = {
    "enabled": True, "speed": SPEED, "speed_limit": 400.0, "current_limit": 60.0, "dc_link_voltage": 300.0,
    "dc_link_voltage_limit": 400.0, "winding_temperature": 60.0, "winding_temperature_limit": 120.0,
    "magnet_temperature": math.nan,
}  # fmt: skip
GIVEN = {"i_max": 50.0, "repeat": 0, "lead_time": 2.0, "watch_timeout": 5.0}
"""Shipped parameters but for these: the test's own process, which is the drive, may be held up."""


class OddDrive:
    """Follows references at once; a block every 20 ms while the test waits."""

    def __init__(self, ros, process=False, **parameters):
        from drive_id_msgs.msg import CurrentReference, DriveStatus, PhaseCurrents, PublisherState, Resolver
        from std_msgs.msg import Empty

        from drive_id.nodes.support.qos import LATCHED, STREAM

        self.ros = ros
        self.put_right()
        self._references = ReferenceBuffer(60.0, 1e4)
        self._count = self._statuses = 0
        self._next = ros.node.get_clock().now().nanoseconds
        self._kept = {
            kind: ros.node.create_publisher(kind, topic, STREAM)
            for kind, topic in (
                (PhaseCurrents, "/phase_currents"), (Resolver, "/resolver"), (DriveStatus, "/drive_status"),
            )
        }  # fmt: skip
        self.state, self.heartbeat, self.at_zero_since = PublisherState(), 0.0, time.monotonic()
        ros.node.create_subscription(CurrentReference, "/current_reference", self._follow, STREAM)
        ros.node.create_subscription(PublisherState, f"/{PUBLISHER}/state", self._on_state, LATCHED)
        ros.node.create_subscription(Empty, f"/{PUBLISHER}/heartbeat", self._on_heartbeat, 10)
        ros.node.create_timer(0.02, self._on_timer)
        files = (CONFIG / f"{PUBLISHER}.yaml",)
        self.publisher = (ros.start if process else ros.host)(
            f"drive_id.nodes.{PUBLISHER}", parameters=GIVEN | parameters, files=files
        )

    def is_driven(self):
        return bool(self._references.last.any())

    def put_right(self):
        self.status = dict(SOUND)

    def _on_state(self, message):
        self.state = message

    def _on_heartbeat(self, _):
        self.heartbeat = time.monotonic()

    def _follow(self, message):
        stamp = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
        d, q = (np.array(field, np.float32) for field in (message.d, message.q))
        rules = {name: getattr(message, name) for name in ("session", "count", "safe")}
        self._references.add(stamp, message.sample_period, d, q, **rules)

    def _on_timer(self):
        from drive_id_msgs.msg import DriveStatus, PhaseCurrents, Resolver

        number = int((self.ros.node.get_clock().now().nanoseconds - self._next) * 1e-9 / PERIOD)
        if number < 1:
            return
        stamps = self._next + np.arange(number) * round(PERIOD * NANOSECONDS)
        if self.is_driven():
            self.at_zero_since = time.monotonic()
        vector = self._references.take(stamps, PERIOD) @ (1, 1j)
        angle = (SPEED * PERIOD * (self._count + np.arange(number)) + math.pi) % (2 * math.pi) - math.pi
        turned = vector * np.exp(1j * angle)
        phases = [(turned * np.exp(-2j * math.pi * k / 3)).real.tolist() for k in range(3)]
        head = {"first_sample": self._count, "sample_period": PERIOD}
        self._publish(self._next, PhaseCurrents(**head, **dict(zip("abc", phases, strict=True))))
        self._publish(self._next, Resolver(**head, angle=angle.tolist(), speed=[SPEED] * number))
        self._count += number
        self._next += number * round(PERIOD * NANOSECONDS)
        session, applied = self._references.session or 0, self._references.applied
        self._publish(self._next, DriveStatus(count=self._statuses, session=session, applied=applied, **self.status))
        self._statuses += 1

    def _publish(self, stamp, message):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NANOSECONDS)
        self._kept[type(message)].publish(message)

    # The publisher

    def call(self, name):
        """Return the reply of ``start_experiment``, ``stop_experiment`` or ``clear_fault``."""
        from drive_id_msgs.srv import Command, StartExperiment

        return self.ros.call(StartExperiment if name == "start_experiment" else Command, f"/{PUBLISHER}/{name}")

    def asks(self, name, answered, what):
        """Call a service until the answer is the wanted one."""
        return self.ros.wait(lambda: (reply := self.call(name)) and answered(reply) and reply, what)

    def refuses(self, code, reason):
        """Ask for a start as soon as the publisher says that it would refuse one; what it says is in ``~/state``."""
        self.ros.wait(lambda: reason in self.state.reason, f"what forbids a start: {reason}")
        reply = self.call("start_experiment")
        assert (reply.success, reply.code) == (False, code), reply
        assert reason in reply.message

    def runs(self):
        """Start, again if it trips meanwhile: on a busy machine, this drive may be late."""

        def attempt():
            if self.state.state == "running":
                return True
            if self.call("start_experiment").code == "tripped":
                self.call("clear_fault")
            return False

        self.ros.wait(attempt, "a run")

    def trips(self, reason):
        self.ros.wait(lambda: self.state.state == "tripped" and reason in self.state.reason, f"a trip: {reason}")
        self.ros.wait(lambda: not self.is_driven(), "references of zero")

    def clear(self):
        self.asks("clear_fault", lambda reply: reply.success, "a cleared fault")
