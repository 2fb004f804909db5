"""A minimal drive: what a drive does with references, and what it publishes. Nothing of drive_id but its messages.

    python examples/minimal_drive.py

Take it as a pattern for the node in front of a real inverter: replace Machine by the inverter's interface. The numbers
in comments are those of the rules in docs/safety.md.
"""

from __future__ import annotations

import array
import cmath
import math
import signal
import threading
from collections import deque
from typing import Any

import rclpy
from drive_id_msgs.msg import CurrentReference, DriveStatus, PhaseCurrents, PhaseVoltages, Resolver
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time

PERIOD, BLOCK = 1e-4, 100  # control period, s; samples per message
I_MAX, SLEW = 60.0, 10000.0  # A; A/s to zero current
QUIET = 1.0  # s at rest without a message after which the drive is free for another publisher
NS = 1_000_000_000


class Machine:
    """In place of the inverter: a surface-magnet machine whose current follows the reference within 1 ms."""

    resistance, inductance, flux, pole_pairs = 0.1, 1e-3, 0.05, 4
    speed = 500 * 2 * math.pi / 60 * pole_pairs  # electrical, rad/s
    i, angle = 0j, 0.0

    def step(self, reference: complex) -> tuple[float, ...]:
        """Sample currents and angle, and apply a voltage for one period; return i_abc, u_abc, angle and speed."""
        before, angle = self.i, self.angle
        self.i += (reference - self.i) * -math.expm1(-PERIOD / 1e-3)
        self.angle = (angle + self.speed * PERIOD + math.pi) % (2 * math.pi) - math.pi
        mean, rate = 0.5 * (before + self.i), (self.i - before) / PERIOD
        voltage = self.resistance * mean + self.inductance * rate
        voltage += 1j * self.speed * (self.inductance * mean + self.flux)
        return (*phases(before, angle), *phases(voltage, angle + 0.5 * self.speed * PERIOD), angle, self.speed)


def phases(vector: complex, angle: float) -> list[float]:
    """Return the phase quantities of a vector in the rotor frame."""
    return [(vector * cmath.exp(1j * (angle - shift * 2 * math.pi / 3))).real for shift in (0, 1, 2)]


class MinimalDrive(Node):
    """Follows one session of references at a time, and is at zero current otherwise."""

    def __init__(self) -> None:
        super().__init__("minimal_drive")
        self.kept = {
            kind: self.create_publisher(kind, topic, 1000)
            for kind, topic in (
                (PhaseCurrents, "phase_currents"),
                (PhaseVoltages, "phase_voltages"),
                (Resolver, "resolver"),
                (DriveStatus, "drive_status"),
            )
        }
        self.create_subscription(CurrentReference, "current_reference", self.on_reference, 1000)
        self.machine, self.samples, self.statuses = Machine(), 0, 0
        self.queue: deque[tuple[int, complex, int, int]] = deque()  # due, value, count, end of its validity
        self.session, self.owner, self.expected, self.applied, self.quiet = 0, 0, 0, 0, 0.0
        self.reference, self.stator_frame, self.fault = 0j, False, ""
        self.next = 0  # time of the next sample; with use_sim_time, it is not known yet
        self.encoder = {"encoder_offset": 0.0, "encoder_direction": 1, "encoder_pole_pairs": 1}
        self.add_on_set_parameters_callback(self.on_encoder)
        self.declare_parameters("", list(self.encoder.items()))
        self.create_timer(BLOCK * PERIOD, self.on_timer)

    def on_encoder(self, changes: list[Any]) -> SetParametersResult:
        """Take what a first start found of the angle: never while current flows."""
        if self.session or self.reference:
            return SetParametersResult(successful=False, reason="A session is followed: stop it first.")
        self.encoder |= {change.name: change.value for change in changes if change.name in self.encoder}
        return SetParametersResult(successful=True)

    def electrical(self, raw: float) -> float:
        """Return the angle for control and resolver."""
        offset, direction, pole_pairs = self.encoder.values()
        return math.remainder(direction * pole_pairs * raw - offset, 2 * math.pi)

    def on_reference(self, message: CurrentReference) -> None:
        """Take up, ignore or refuse a block."""
        self.quiet = 0.0
        values = [complex(d, q) for d, q in zip(message.d, message.q, strict=False)]
        if message.safe:  # 1: on receipt, whatever its stamp, session and count
            self.end()
        elif self.fault or len(message.d) != len(message.q) or not message.sample_period > 0.0 or not values:
            return
        elif self.owner and message.session >> 16 != self.owner >> 16:
            self.end("Two publishers send references.")  # 4
        elif message.count < self.expected if message.session == self.session else message.count != 0:
            return  # 3: a straggler; 2: its beginning was not received, or it has ended
        elif message.session != self.session and message.session <= self.owner:
            return  # 2: it has ended
        elif not all(abs(value) <= I_MAX * (1 + 1e-6) for value in values):  # 6, and NaN
            self.end(f"Set-points exceed the limit of {I_MAX:g} A.")
        else:
            self.follow(message, values)

    def follow(self, message: CurrentReference, values: list[complex]) -> None:
        """Queue set-points; they replace those that are due at or after their stamp."""
        self.session = self.owner = message.session
        self.expected, self.stator_frame = message.count + len(values), message.stator_frame
        stamp, period = Time.from_msg(message.header.stamp).nanoseconds, message.sample_period * NS
        while self.queue and self.queue[-1][0] >= stamp:
            self.queue.pop()
        for k, value in enumerate(values):
            self.queue.append((stamp + round(k * period), value, message.count + k, stamp + round((k + 1.5) * period)))

    def end(self, fault: str = "") -> None:
        """End the session: zero current."""
        self.queue.clear()
        self.session, self.quiet, self.fault = 0, 0.0, fault or self.fault

    def take(self, now: int) -> complex:
        """Return the reference of the sample at this time."""
        while len(self.queue) > 1 and self.queue[1][0] <= now:
            self.queue.popleft()
        if self.queue and self.queue[0][0] <= now:
            _, value, count, end = self.queue[0]
            if now <= end:
                self.reference, self.applied = value, count
                return value
            self.end()  # 5: they have run out; what follows a gap is not taken up again
        if not self.queue and self.reference:
            self.reference *= max(0.0, 1.0 - SLEW * PERIOD / abs(self.reference))
        return self.reference

    def on_timer(self) -> None:
        """Run the samples that are due, and publish them."""
        self.next = self.next or self.get_clock().now().nanoseconds
        while self.next + round(BLOCK * PERIOD * NS) <= self.get_clock().now().nanoseconds:
            begin, rows = self.next, []
            for _ in range(BLOCK):
                angle = self.electrical(self.machine.angle)
                turn = cmath.exp(1j * ((0.0 if self.stator_frame else angle) - self.machine.angle))  # 7: the frame
                row = self.machine.step(self.take(self.next) * turn)
                _, direction, pole_pairs = self.encoder.values()
                rows.append((*row[:6], angle, direction * pole_pairs * row[7]))
                self.next += round(PERIOD * NS)
            columns = [array.array("f", column) for column in zip(*rows, strict=True)]
            head = {"first_sample": self.samples, "sample_period": PERIOD}
            self.publish(begin, PhaseCurrents(**head, **dict(zip("abc", columns[:3], strict=True))))
            self.publish(begin, PhaseVoltages(**head, **dict(zip("abc", columns[3:6], strict=True))))
            self.publish(begin, Resolver(**head, angle=columns[6], speed=columns[7]))
            self.samples += BLOCK
            self.quiet += BLOCK * PERIOD
        if not self.session and self.quiet > QUIET:
            self.fault, self.owner = "", 0  # 4: free again
        status = DriveStatus(count=self.statuses, enabled=True, fault=self.fault, session=self.session)
        status.applied, status.speed = self.applied, self.machine.speed
        status.i_d, status.i_q = self.reference.real, self.reference.imag
        status.current_limit, status.speed_limit = I_MAX, 2 * self.machine.speed
        for unknown in ("dc_link_voltage", "winding_temperature", "magnet_temperature"):
            setattr(status, unknown, math.nan)
        status.dc_link_voltage_limit = status.winding_temperature_limit = math.nan
        self.publish(self.next, status)
        self.statuses += 1

    def publish(self, stamp: int, message: Any) -> None:
        """Stamp and publish a message."""
        message.header.stamp, message.header.frame_id = Time(nanoseconds=stamp).to_msg(), "drive"
        self.kept[type(message)].publish(message)


if __name__ == "__main__":
    interrupted = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: interrupted.set())  # an exception may strike in the midst of a message
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    executor.add_node(MinimalDrive())
    while not interrupted.is_set():
        executor.spin_once(timeout_sec=0.1)
