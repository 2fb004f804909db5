"""Measure the recorder over DDS: what it loses and costs at full rate, and what a kill leaves behind.

Usage: python benchmarks/recorder.py [--seconds S] [--loads blocks_of_100,blocks_of_10,singles,flood] [--kills N]

Recorder and publisher are processes of their own. Each load ends with the check that written and lost samples add up to
those that were published, to the sample. Each kill (-9, at a random moment) is followed by a fit of what is left and by
a recovery that rosbags and mcap then read. The soak of ten minutes: --loads blocks_of_10 --seconds 600 --kills 0.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))

import rclpy
from drive_id_msgs.srv import StartRecording, StopRecording
from mcap.reader import make_reader
from node_processes import TOPICS, resident
from rich.console import Console
from rich.table import Table
from rosbags.rosbag2 import Reader

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.fit_settings import FitSettings
from drive_id.files.read.several import read_recording
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.recover import recover_bag
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.simulated import run_experiment
from drive_id.fitting.sources import Sources
from drive_id.nodes.support.qos import STREAM

START = 1_700_000_000_000_000_000
PATIENCE = 60.0
console = Console(width=130)


@dataclass(frozen=True)
class Load:
    """What is published: sample rate (Hz), samples per message, and on how many of the topics."""

    rate: float
    block: int
    topics: int


LOADS = {
    "blocks_of_100": Load(10_000, 100, 4),
    "blocks_of_10": Load(10_000, 10, 4),
    "singles": Load(5_000, 1, 3),
    "flood": Load(20_000, 1, 3),  # more than can be published: to see losses counted
}


# -- the publisher, a process of its own ---------------------------------------------------------------------------


def publish(bag: Path, rate: float, seconds: float) -> None:
    """Publish the messages of a bag in real time, again and again, with counts that go on."""
    rclpy.init()
    node = rclpy.create_node("benchmark")
    with open_bag(bag) as opened:
        messages: dict[str, list[bytes]] = {name: [] for name in TOPICS if name in opened.topics}
        for message in opened.messages(frozenset(messages)):
            messages[message.topic].append(bytes(message.data))
    publishers = [
        (node.create_publisher(TOPICS[name], name, STREAM), _endless(found)) for name, found in messages.items()
    ]
    _wait(lambda: all(publisher.get_subscription_count() for publisher, _ in publishers))
    print("matched", flush=True)
    sys.stdin.readline()
    block = _samples(next(iter(messages.values()))[0])
    begin, late, number = time.monotonic(), 0.0, 0
    while number * block < rate * seconds:
        _wait_until(begin + number * block / rate)
        late = max(late, time.monotonic() - begin - number * block / rate)
        for publisher, source in publishers:
            publisher.publish(next(source))
        number += 1
    time.sleep(1.0)
    for publisher, source in publishers:
        publisher.publish(next(source))  # shows losses at the end
    print((number + 1) * block, late, flush=True)
    sys.stdin.readline()
    rclpy.shutdown()


def _endless(messages: list[bytes]) -> Iterator[bytes]:
    """Repeat the messages with running counts; the frame of all is 'drive', so the count lies at byte 28."""
    block, first = _samples(messages[0]), 0
    while True:
        for data in messages:
            yield data[:28] + first.to_bytes(8, "little") + data[36:]
            first += block


def _samples(data: bytes) -> int:
    return int.from_bytes(data[44:48], "little")


def _wait_until(due: float) -> None:
    left = due - time.monotonic()
    if left > 0:
        time.sleep(left)


def _wait(condition: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("The other side has not appeared.")
        time.sleep(0.01)


# -- the recorder and its client -----------------------------------------------------------------------------------


class Bench:
    """A recorder, a publisher, and a client that calls services."""

    def __init__(self, folder: Path, bag: Path, rate: float, seconds: float) -> None:
        self.node = rclpy.create_node("client")
        self.data = folder
        command = [sys.executable, "-m", "drive_id.nodes.recorder", "--ros-args", "-p", f"data_directory:={folder}"]
        self.recorder = subprocess.Popen([*command, "--log-level", "error"])
        arguments = [sys.executable, __file__, "--publish", str(bag), str(rate), str(seconds)]
        self.publisher = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def call(self, kind: Any, name: str, /, **fields: Any) -> Any:
        """Call a service of the recorder."""
        client = self.node.create_client(kind, f"/recorder/{name}")
        if not client.wait_for_service(PATIENCE):
            raise SystemExit("The recorder has not appeared.")
        future = client.call_async(kind.Request(**fields))
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=PATIENCE)
        self.node.destroy_client(client)
        return future.result()

    def hear(self) -> list[str]:
        """Read a line of the publisher."""
        assert self.publisher.stdout is not None
        return self.publisher.stdout.readline().split()

    def tell(self) -> None:
        """Let the publisher go on."""
        assert self.publisher.stdin is not None
        self.publisher.stdin.write("\n")
        self.publisher.stdin.flush()

    def cpu(self) -> float:
        """Return the processor time of the recorder, s."""
        fields = Path(f"/proc/{self.recorder.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory(self) -> float:
        """Return what the recorder holds in memory, MB."""
        return resident(self.recorder.pid)

    def close(self) -> None:
        """End both processes."""
        for process in (self.publisher, self.recorder):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.node.destroy_node()


@contextmanager
def running(bag: Path, rate: float, seconds: float) -> Iterator[Bench]:
    """Run recorder and publisher, connected, until the end of the body."""
    with tempfile.TemporaryDirectory(prefix="drive_id_benchmark_") as folder:
        bench = Bench(Path(folder), bag, rate, seconds)
        try:
            bench.hear()
            yield bench
        finally:
            bench.close()


# -- measurements --------------------------------------------------------------------------------------------------


def measure(name: str, load: Load, bag: Path, seconds: float) -> list[str]:
    """Record one load and return a row of the table."""
    with running(bag, load.rate, seconds) as bench:
        started = bench.call(StartRecording, "start", name="bag")
        before, first_memory, begin = bench.cpu(), bench.memory(), time.monotonic()
        bench.tell()
        memory = []
        middle = begin + seconds / 2
        _wait_until(middle)
        memory.append(bench.memory())
        sent, late = bench.hear()
        memory.append(bench.memory())
        share = (bench.cpu() - before) / (time.monotonic() - begin)
        time.sleep(0.5)
        reply = bench.call(StopRecording, "stop")
        bench.tell()
        with Reader(started.uri) as reader:
            counts = {c.topic: c.msgcount * load.block for c in reader.connections if c.msgcount}
            read = sum(1 for _ in reader.messages()) * load.block
    published = int(sent) * load.topics
    written = sum(counts.values())
    exact = written + reply.dropped == published and read == written and reply.success
    return [
        name,
        f"{load.rate / load.block * load.topics:.0f}",
        f"{published}",
        f"{written}",
        f"{reply.dropped}",
        "yes" if exact else f"NO, {published - written - reply.dropped} unaccounted",
        f"{100 * share:.0f} %",
        " / ".join(f"{value:.0f}" for value in (first_memory, *memory)),
        f"{float(late) * 1e3:.0f} ms",
    ]


def loads_table(names: list[str], seconds: float, folder: Path) -> Table:
    """Measure all loads."""
    table = Table(title=f"Recorder, {seconds:g} s per load", title_justify="left")
    for column in (
        "Load", "Messages/s", "Samples published", "written", "lost", "exact", "CPU", "MB at begin / middle / end",
        "Publisher late by",
    ):  # fmt: skip
        table.add_column(column)
    for name in names:
        load = LOADS[name]
        table.add_row(*measure(name, load, recorded_bag(folder / name, load), seconds))
    return table


def recorded_bag(path: Path, load: Load, seconds: float = 2.0) -> Path:
    """Simulate an experiment and cut it into messages of the load."""
    settings = SimulationSettings(sample_period=1.0 / load.rate, current_noise=1e-3)
    samples = run_experiment(machine_map("ipm"), settings, Lissajous(3.7, 1.1), seconds).samples
    if load.topics == 3:
        samples = replace(samples, i_dq_reference=None)
    write_recording(path, samples, start_stamp=START, block_size=load.block)
    return path


def kills_table(count: int, folder: Path, seed: int) -> Table:
    """Kill the recorder at random moments, and see what is left."""
    table = Table(title=f"Recorder killed {count} times", title_justify="left")
    for column in ("Killed after", "Read", "Missing", "Fit", "Recovered messages"):
        table.add_column(column)
    load = LOADS["blocks_of_100"]
    bag = recorded_bag(folder / "kills", load, 12.0)
    moments, missing = random.Random(seed), []
    for _ in range(count):
        moment = moments.uniform(3.0, 8.0)
        with running(bag, load.rate, 12.0) as bench:
            path = Path(bench.call(StartRecording, "start", name="bag").uri)
            bench.tell()
            time.sleep(moment)
            bench.recorder.kill()
            bench.recorder.wait()
            recording = read_recording(path)
            read = len(recording.samples) * recording.samples.sample_period
            fit = fit_bags(Sources([path]), bench.data / "fit", FitSettings(method="joint"))
            warned = any("was not completed" in warning for warning in fit.warnings)
            recovery = recover_bag(path)
            recovered = stock_count(recovery.output)
            assert recovered == sum(recovery.topics.values())
        missing.append(moment - read)
        resistance = f"{fit.drive.resistance * 1e3:.1f} mΩ, {'warned' if warned else 'NOT WARNED'}"
        table.add_row(f"{moment:.2f} s", f"{read:.2f} s", f"{missing[-1]:.2f} s", resistance, str(recovered))
    table.caption = f"Missing at most {max(missing):.2f} s."
    return table


def stock_count(path: Path) -> int:
    """Count the messages that rosbags finds, and mcap too."""
    with Reader(path) as reader:
        count = sum(1 for _ in reader.messages())
    other = 0
    for file in path.glob("*.mcap"):
        with file.open("rb") as stream:
            other += sum(1 for _ in make_reader(stream).iter_messages())
    assert other == count
    return count


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Measure the recorder over DDS.")
    parser.add_argument("--seconds", type=float, default=60.0, help="per load")
    parser.add_argument("--loads", default=",".join(LOADS))
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of the moments of the kills")
    parser.add_argument("--publish", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        bag, rate, seconds = options.publish
        with suppress(KeyboardInterrupt):  # how it is ended early
            publish(Path(bag), float(rate), float(seconds))
        return
    rclpy.init()
    with tempfile.TemporaryDirectory(prefix="drive_id_benchmark_") as folder:
        if options.loads:
            console.print(loads_table(options.loads.split(","), options.seconds, Path(folder)))
        if options.kills:
            console.print(kills_table(options.kills, Path(folder), options.seed))
    rclpy.shutdown()


if __name__ == "__main__":
    main()
