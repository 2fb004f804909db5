"""A minimal drive: what a drive does with references, and what it publishes. Nothing of drive_id but its messages.

    python examples/minimal_drive.py

Take it as a pattern for the node in front of a real inverter: replace Machine by the inverter's interface. The numbers
in comments are those of the rules in docs/safety.md.
"""

from __future__ import annotations

import array
import cmath
import contextlib
import math
from collections import deque
from collections.abc import Iterable
from typing import Any

import rclpy
from drive_id_msgs.msg import CurrentReference, DriveStatus, PhaseCurrents, PhaseVoltages, Resolver
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time

PERIOD = 1e-4  # s, control period
BLOCK = 100  # samples per message
I_MAX = 60.0  # A
SLEW = 10000.0  # A/s, to zero current
QUIET = 1.0  # s without references after which the fault "two publishers" is forgotten
NS = 1_000_000_000


class Machine:
    """In place of the inverter: a surface-magnet machine whose current follows the reference within 1 ms."""

    resistance, inductance, flux, pole_pairs = 0.1, 1e-3, 0.05, 4
    speed = 500 * 2 * math.pi / 60 * pole_pairs  # electrical, rad/s

    def __init__(self) -> None:
        self.i, self.angle = 0j, 0.0

    def step(self, reference: complex) -> tuple[list[float], list[float], float]:
        """Sample currents and angle, and apply a voltage for one period; return i_abc, u_abc and the angle."""
        before, angle = self.i, self.angle
        self.i += (reference - self.i) * -math.expm1(-PERIOD / 1e-3)
        self.angle = (angle + self.speed * PERIOD + math.pi) % (2 * math.pi) - math.pi
        mean = 0.5 * (before + self.i)
        rate = (self.i - before) / PERIOD
        voltage = self.resistance * mean + self.inductance * rate
        voltage += 1j * self.speed * (self.inductance * mean + self.flux)
        return phases(before, angle), phases(voltage, angle + 0.5 * self.speed * PERIOD), angle


def phases(vector: complex, angle: float) -> list[float]:
    """Return the phase quantities of a vector in the rotor frame."""
    return [(vector * cmath.exp(1j * (angle - shift * 2 * math.pi / 3))).real for shift in (0, 1, 2)]


def set_points(message: CurrentReference) -> list[complex]:
    """Return the set-points of a block, none if it is malformed."""
    if len(message.d) != len(message.q) or not message.sample_period > 0.0:
        return []
    values = [complex(d, q) for d, q in zip(message.d, message.q, strict=True)]
    return values if all(math.isfinite(abs(value)) for value in values) else []


class MinimalDrive(Node):
    """Follows one session of references at a time, and is at zero current otherwise."""

    def __init__(self) -> None:
        super().__init__("minimal_drive")
        qos = QoSProfile(depth=1000)
        self.currents = self.create_publisher(PhaseCurrents, "phase_currents", qos)
        self.voltages = self.create_publisher(PhaseVoltages, "phase_voltages", qos)
        self.resolver = self.create_publisher(Resolver, "resolver", qos)
        self.status = self.create_publisher(DriveStatus, "drive_status", qos)
        self.create_subscription(CurrentReference, "current_reference", self.on_reference, qos)
        self.machine = Machine()
        self.queue: deque[tuple[int, complex, int, int]] = deque()  # due, value, count, end of its validity
        self.session, self.expected, self.applied = 0, 0, 0
        self.reference, self.stator_frame, self.fault, self.heard = 0j, False, "", 0
        self.next = self.get_clock().now().nanoseconds  # time of the next sample
        self.samples = self.statuses = 0
        self.create_timer(BLOCK * PERIOD, self.on_timer)

    def on_reference(self, message: CurrentReference) -> None:
        """Take up, ignore or refuse a block."""
        if message.safe:  # 1: on receipt, whatever its stamp, session and count
            self.end()
            return
        self.heard = self.next
        values = set_points(message)
        if self.fault or not values:
            return
        if message.session == self.session:
            if message.count < self.expected:  # 3: a straggler
                return
        elif self.session and (self.reference != 0 or any(value for _, value, _, _ in self.queue)):
            self.end("Two publishers send references at the same time.")  # 4
            return
        elif message.count != 0:  # 2: its beginning was not received, or it has ended
            return
        if any(abs(value) > I_MAX * (1 + 1e-6) for value in values):  # 6
            self.end(f"Set-points exceed the limit of {I_MAX:g} A.")
            return
        stamp = Time.from_msg(message.header.stamp).nanoseconds
        self.session, self.expected = message.session, message.count + len(values)
        self.stator_frame = message.stator_frame
        while self.queue and self.queue[-1][0] >= stamp:  # a block replaces what is due at or after its stamp
            self.queue.pop()
        for k, value in enumerate(values):
            due = stamp + round(k * message.sample_period * NS)
            self.queue.append((due, value, message.count + k, due + round(1.5 * message.sample_period * NS)))

    def end(self, fault: str = "") -> None:
        """End the session: zero current."""
        self.queue.clear()
        self.session = 0
        self.fault = fault or self.fault

    def take(self, now: int) -> complex:
        """Return the reference of the sample at this time."""
        while len(self.queue) > 1 and self.queue[1][0] <= now:
            self.queue.popleft()
        if self.queue and self.queue[0][0] <= now:
            _, value, count, end = self.queue[0]
            if now <= end:
                self.reference, self.applied = value, count
                return self.reference
            self.end()  # 5: they have run out; what follows a gap is not taken up again
        if not self.queue and self.reference:
            size = abs(self.reference)
            self.reference *= max(0.0, 1.0 - SLEW * PERIOD / size)
        return self.reference

    def on_timer(self) -> None:
        """Run the samples that are due, and publish them."""
        while self.next + round(BLOCK * PERIOD * NS) <= self.get_clock().now().nanoseconds:
            begin, rows = self.next, []
            for _ in range(BLOCK):
                turn = cmath.exp(-1j * self.machine.angle) if self.stator_frame else 1.0  # 7: into the rotor frame
                rows.append(self.machine.step(self.take(self.next) * turn))
                self.next += round(PERIOD * NS)
            head = {"first_sample": self.samples, "sample_period": PERIOD}
            currents, voltages, angles = zip(*rows, strict=True)
            i_abc, u_abc = (dict(zip("abc", zip(*phase, strict=True), strict=True)) for phase in (currents, voltages))
            self.publish(self.currents, PhaseCurrents(**head), begin, i_abc)
            self.publish(self.voltages, PhaseVoltages(**head), begin, u_abc)
            turning = {"angle": angles, "speed": [self.machine.speed] * BLOCK}
            self.publish(self.resolver, Resolver(**head), begin, turning)
            self.samples += BLOCK
        if self.fault and self.next - self.heard > QUIET * NS:
            self.fault = ""
        status = DriveStatus(count=self.statuses, enabled=True, fault=self.fault, session=self.session)
        status.applied, status.speed = self.applied, self.machine.speed
        status.i_d, status.i_q = self.reference.real, self.reference.imag
        status.current_limit, status.speed_limit = I_MAX, 2 * self.machine.speed
        status.dc_link_voltage = status.winding_temperature = status.magnet_temperature = math.nan
        status.dc_link_voltage_limit = status.winding_temperature_limit = math.nan
        self.publish(self.status, status, self.next, {})
        self.statuses += 1

    def publish(self, publisher: Any, message: Any, stamp: int, columns: dict[str, Iterable[float]]) -> None:
        """Stamp and publish a message."""
        message.header.stamp = Time(nanoseconds=stamp).to_msg()
        message.header.frame_id = "drive"
        for name, values in columns.items():
            setattr(message, name, array.array("f", values))
        publisher.publish(message)


def main() -> None:
    """Run the drive until Ctrl-C."""
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(MinimalDrive())


if __name__ == "__main__":
    main()
