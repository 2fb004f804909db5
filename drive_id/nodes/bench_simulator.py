"""The node ``bench_simulator``: a simulated drive in place of the hardware."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from drive_id_msgs.msg import CurrentReference, DriveStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage

from drive_id.bench.bench import MessageBlock, Pace, SimulatedBench
from drive_id.bench.faults import Channel, FaultSettings
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.common.health import Health
from drive_id.common.quantity import counted
from drive_id.core.experiment import feedback
from drive_id.core.experiment.encoder import Encoder
from drive_id.errors import ConfigurationError
from drive_id.files.machines.ground_truth import write_truth
from drive_id.fitting.simulated import load_machine
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.diagnostics import publish_health
from drive_id.nodes.support.experiment_messages import stamp_of, status_message
from drive_id.nodes.support.parameters import declare_settings, on_change
from drive_id.nodes.support.qos import STREAM
from drive_id.nodes.support.runtime import run
from drive_id.nodes.support.signal_messages import SignalPublishers

_SHORTEST_TICK = 2e-3
"""Time between looks at which samples are due, s: shorter blocks are published several at once."""
_LONGEST_TICK = 2e-2
"""The same, s: references and faults are taken so often, however long a block is."""
_DISCOVERY = 10.0
"""s after the start, within which another clock is discovered; later, the other node is the second.

It takes 0.1 s, but on a busy machine first announcements get lost, and Fast DDS repeats them each 3 s.
"""


class BenchSimulator(Node):
    """Follows current references, and publishes what a real drive measures and says of itself, nothing else."""

    def __init__(self) -> None:
        # The log holds the ground truth, so it must not be published on /rosout.
        super().__init__("bench_simulator", enable_rosout=False)
        names = SimulationSettings.__dataclass_fields__
        self._drive = declare_settings(self, SimulationSettings, read_only=set(names) - {"speeds", "ramp_time"})
        self._settings = declare_settings(self, BenchSettings, read_only=BenchSettings.__dataclass_fields__)
        self._follows_clock = bool(self.get_parameter("use_sim_time").value)
        if self._follows_clock and self._settings.time_scale != 1.0:
            raise ConfigurationError("With time_scale this node publishes /clock: do not set use_sim_time for it, too.")
        faults = declare_settings(self, FaultSettings)
        self._encoder = declare_settings(self, Encoder)
        self._bench = SimulatedBench(load_machine(self._settings.machine), self._drive, self._settings, faults)
        self._bench.set_encoder(self._encoder)
        self._heard: Channel[CurrentReference] = Channel(self._drive.seed)
        self._said: Channel[MessageBlock | feedback.DriveStatus] = Channel(self._drive.seed + 1)
        self._pace: Pace | None = None
        self._started = time.monotonic()
        self._tell_truth()
        self._signals = SignalPublishers(self, self._settings.frame_id, self._drive.log_scalars)
        self._status_publisher = self.create_publisher(DriveStatus, "drive_status", STREAM)
        self._clock_publisher = (
            self.create_publisher(ClockMessage, "/clock", QoSProfile(depth=1))
            if self._settings.time_scale != 1.0
            else None
        )
        self.create_subscription(CurrentReference, "current_reference", lambda message: self._follow([message]), STREAM)
        on_change(self, SimulationSettings, self._check, self._on_settings)
        on_change(self, Encoder, self._check_encoder, self._on_encoder)
        on_change(self, FaultSettings, lambda _: None, self._on_faults)
        tick = self._settings.block_size * self._drive.sample_period / self._settings.time_scale
        self.create_timer(min(max(tick, _SHORTEST_TICK), _LONGEST_TICK), self._on_timer, clock=STEADY)
        publish_health(self, self._health)
        self.get_logger().info("Ready.")

    def _tell_truth(self) -> None:
        truth, where = self._bench.truth(), "is not kept"
        if self._settings.truth_file:
            path = Path(self._settings.truth_file).expanduser()
            write_truth(path, truth)
            where = f"is in {path}"
        self.get_logger().info(
            f"Simulating {truth.machine}: R {truth.resistance:.4g} ohm, i_max {truth.i_max:g} A, inverter "
            f"{self._drive.inverter}, {', '.join(f'{speed:g}' for speed in self._drive.speeds)} rpm; the truth {where}."
        )

    def _health(self) -> Health:
        """Add the number of subscribers: what is published before one is discovered never reaches it."""
        health = self._bench.health()
        listeners = {f"{topic}: listeners": str(count) for topic, count in self._signals.listeners().items()}
        return replace(health, values={**health.values, **listeners})

    def _now(self) -> int:
        if self._follows_clock:
            return int(self.get_clock().now().nanoseconds)
        if self._pace is None:
            start = int(self.get_clock().now().nanoseconds)
            self._pace = Pace(start, time.monotonic_ns(), self._settings.time_scale)
            return start
        return self._pace.now(time.monotonic_ns(), self._bench.latest)

    def _on_timer(self) -> None:
        self._refuse_second_clock()
        now = self._now()
        if now <= 0:
            return  # no /clock yet
        self._follow([])
        made: list[MessageBlock | feedback.DriveStatus] = [*self._bench.advance(now)]
        if made and (status := self._bench.status()) is not None:
            made.append(status)
        for item in self._said.carry(made, time.monotonic(), self._bench.faults):
            if isinstance(item, MessageBlock):
                self._publish(item)
            else:
                self._status_publisher.publish(status_message(item, self._settings.frame_id))
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=Time(nanoseconds=now).to_msg()))

    def _refuse_second_clock(self) -> None:
        """End, soon after the start, if another node publishes the clock: nodes that follow both go back and forth."""
        if self._clock_publisher is None or time.monotonic() > self._started + _DISCOVERY:
            return
        topic = self._clock_publisher.topic_name
        if self.count_publishers(topic) > 1:
            raise ConfigurationError(
                f"Another node publishes {topic} already, so time_scale must be 1.0 here; or give each drive, and all "
                "nodes that follow it, a clock of its own: -r /clock:=/drive_2/clock."
            )

    def _publish(self, block: MessageBlock) -> None:
        self._signals.publish("phase_currents", block, block.currents)
        self._signals.publish("phase_voltages", block, block.voltages)
        self._signals.publish("resolver", block, block.resolver)
        for name, scalar in block.scalars.items():
            self._signals.publish(name, scalar, scalar.values)

    def _follow(self, received: list[CurrentReference]) -> None:
        """Follow the references that have arrived."""
        for message in self._heard.carry(received, time.monotonic(), self._bench.faults):
            if self._bench.faults.ignore_references:
                continue
            d, q = (np.frombuffer(field, np.float32) for field in (message.d, message.q))
            rules = {name: getattr(message, name) for name in ("session", "count", "safe", "stator_frame")}
            self._bench.references.add(stamp_of(message), message.sample_period, d, q, **rules)

    def _check(self, settings: SimulationSettings) -> None:
        if settings.speeds != self._drive.speeds and len(settings.speeds) != 1:
            raise ConfigurationError(
                f"speeds has {counted(len(settings.speeds), 'entry', 'entries')}: give a running drive one new speed."
            )

    def _on_settings(self, settings: SimulationSettings) -> None:
        if settings.speeds != self._drive.speeds:
            self._bench.set_speeds(settings.speeds, settings.ramp_time)
        self._drive = settings

    def _check_encoder(self, encoder: Encoder) -> None:
        if encoder != self._encoder:
            self._bench.check_rest()

    def _on_encoder(self, encoder: Encoder) -> None:
        if encoder != self._encoder:
            self._bench.set_encoder(encoder)
            self._encoder = encoder
            self.get_logger().info(f"The encoder's parameters were changed: {encoder}.")

    def _on_faults(self, faults: FaultSettings) -> None:
        if faults.restarts != self._bench.faults.restarts:
            self._bench.restart()
        self._bench.faults = faults


def main() -> None:
    """Run the node ``bench_simulator``."""
    run(BenchSimulator, shared_memory=False)


if __name__ == "__main__":
    main()
