"""Hours of streaming in minutes, through recorder and identification: over DDS, or in one process without it.

Recordings are divided into files, which are read, counted and removed while the recording goes on.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from drive_id_msgs import msg
from drive_id_msgs.srv import Identify, StartRecording, StopRecording
from node_processes import PATIENCE, Graph, NodeProcess, resident, slope
from recordings import RATE, moved

import drive_id
from drive_id.core.fit_settings import FitSettings
from drive_id.files.messages.block_codec import read_head
from drive_id.files.messages.messages import CURRENT_REFERENCE, PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.writer import write_recording
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.identification.refits import Refit
from drive_id.live.recording.recording_session import RecordedTopic, RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.live.worker import Worker
from drive_id.nodes.support.qos import STREAM

TYPES = {
    "/phase_currents": PHASE_CURRENTS,
    "/phase_voltages": PHASE_VOLTAGES,
    "/resolver": RESOLVER,
    "/current_reference": CURRENT_REFERENCE,
}
SECTIONS = {"/phase_currents": 0, "/phase_voltages": 1, "/resolver": 2}
PART = 20.0
"""Seconds that are simulated and repeated, with a break of one message in between."""
BLOCK = 1000
FILE = 32.0
"""File size at which the recording continues in a new file, MB."""
I_MAX = 320.0
_SWITCH_INTERVAL = 5e-4
"""Of the interpreter, as in the node, s: with the usual 5 ms, threads wait for each other most of the time."""
_LOOK = 2.0
"""Time between two checks of memory and files, s."""
_LATE = 1.2
"""Multiple of the given time after which the stream ends, complete or not."""
_MOST_WAITING = 16e6
"""Bytes that may wait for the disk before the stream in one process pauses: it has no clock to keep."""


@dataclass
class Soak:
    """Results of a stream; samples are counted over all topics."""

    hours: float = 0.0
    wall: float = 0.0
    published: int = 0
    written: int = 0
    lost: int = 0
    replies: int = 0
    asked: int = 0
    slowest: float = 0.0
    """Longest time until a reply, s."""
    read: int = 0
    """Samples of a topic in the last live fit, after the stream."""
    times: list[float] = field(default_factory=list)
    memory: dict[str, list[float]] = field(default_factory=dict)
    findings: list[str] = field(default_factory=list)

    def look(self, hours: float, **memory: float) -> None:
        """Note the memory of each process."""
        self.times.append(hours)
        for name, value in memory.items():
            self.memory.setdefault(name, []).append(value)

    def growth(self, name: str) -> float:
        """Return by how much the memory grew in the later two thirds, MB: along a line, for fits come and go."""
        span = self.times[-1] - self.times[len(self.times) // 3]
        return span * slope(self.times, self.memory[name])


class Files:
    """Reads the files of a recording as they are completed, counts their samples, and removes them."""

    def __init__(self, bag: Path) -> None:
        self._bag = bag
        self._next: dict[str, int] = {}
        self.samples = 0
        self.gaps: list[str] = []

    def read(self, *, all_of_them: bool = False) -> None:
        """Read what is complete: by default all but the last file."""
        files = sorted(self._bag.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))
        for file in files if all_of_them else files[:-1]:
            with open_bag(file) as bag:
                for message in bag.messages(frozenset(TYPES)):
                    head = read_head(message.data)
                    expected = self._next.get(message.topic, head.first_sample)
                    if head.first_sample != expected:
                        self.gaps.append(f"{message.topic}: {head.first_sample} follows {expected}")
                    self._next[message.topic] = head.first_sample + head.samples
                    self.samples += head.samples
            file.unlink()


def stream(folder: Path) -> Iterator[tuple[str, bytes, int]]:
    """Yield topic, data and stamp, ns, of the messages of a drive at 10 kHz, without end."""
    path = folder / "part"
    if not path.exists():
        samples = drive_id.simulate("ipm", PART, seed=3, noise=1e-3)
        write_recording(path, samples, start_stamp=1_700_000_000_000_000_000, block_size=BLOCK)
    with open_bag(path) as bag:
        messages = [(each.topic, each.log_time, bytes(each.data)) for each in bag.messages(frozenset(TYPES))]
    messages.sort(key=lambda message: read_head(message[2]).first_sample)
    samples_of_part = round(PART * RATE) + BLOCK
    number = 0
    while True:
        shift = number * samples_of_part * (1_000_000_000 // RATE)
        for topic, log_time, data in messages:
            # Counts go on without a gap, so that every gap in a recording is a loss; stamps jump by one message.
            yield topic, moved(data, shift, number * (samples_of_part - BLOCK)), log_time + shift
        number += 1


# -- over DDS ----------------------------------------------------------------------------------------------------------


def publish(folder: Path, hours: float, factor: float) -> None:
    """Publish the stream, as a process of its own; print the number of samples at the end."""
    with Graph(folder, alone=False) as graph:
        kinds = {name: getattr(msg, kind.rpartition("/")[2]) for name, kind in TYPES.items()}
        publishers = {name: graph.node.create_publisher(kind, name, STREAM) for name, kind in kinds.items()}
        source = stream(folder)
        listeners = {name: 2 if name in SECTIONS else 1 for name in TYPES}
        graph.wait(lambda: all(publishers[name].get_subscription_count() >= listeners[name] for name in TYPES))
        sys.stdin.readline()
        begin, count = time.monotonic(), 0
        latest = begin + _LATE * hours * 3600 / factor
        while count < hours * 3600 * RATE * len(TYPES) and time.monotonic() < latest:
            topic, data, _ = next(source)
            left = begin + count / (RATE * len(TYPES) * factor) - time.monotonic()
            if left > 0.002:
                time.sleep(left)
            publishers[topic].publish(data)
            count += BLOCK
        print(f"published {count}", flush=True)
        sys.stdin.readline()


def over_dds(hours: float, minutes: float, folder: Path, method: str) -> Soak:
    """Stream through the nodes ``recorder`` and ``identification``.

    Parameters
    ----------
    hours : float
        Of stream, at 10 kHz on four topics.
    minutes : float
        In which they are to pass.
    folder : Path
        Scratch space.
    method : str
        Of the identification.
    """
    soak, factor = Soak(), 60 * hours / minutes
    next(stream(folder))  # simulates before the clock runs
    with Graph(folder) as graph:
        data = folder / "data"
        recorder = graph.start("recorder", {"data_directory": data, "max_file_size": FILE})
        settings = {"data_directory": data, "output_directory": folder / "results", "results_count": 5}
        node = graph.start("identification", settings | {"i_max": I_MAX, "method": method})
        command = [sys.executable, __file__, str(folder), str(hours), str(factor)]
        publisher = graph.run(command, "publisher")
        started = graph.call(StartRecording, "/recorder/start", name="soak")
        files = Files(Path(started.uri))
        graph.spin(3.0)
        _go_on(publisher)
        begin = looked = asked = time.monotonic()
        while "published" not in publisher.text and all(each.alive for each in (publisher, recorder, node)):
            graph.spin(0.2)
            now = time.monotonic()
            if now - looked > _LOOK:
                looked = now
                files.read()
                streamed = files.samples / (RATE * len(TYPES)) / 3600
                soak.look(streamed, recorder=recorder.memory, identification=node.memory)
            if now - asked > 30.0:
                asked = now
                _identify(graph, soak)
        soak.wall = time.monotonic() - begin
        if "published" not in publisher.text:
            raise SystemExit("\n".join(each.text[-2000:] for each in (publisher, recorder, node)))
        graph.spin(2.0)
        reply = graph.call(StopRecording, "/recorder/stop")
        _go_on(publisher)
        files.read(all_of_them=True)
        soak.published = int(publisher.text.split()[-1])
        soak.lost = reply.dropped
        soak.read = _identify(graph, soak)
        soak.findings += graph.troubles()
    return _judged(soak, files)


def _identify(graph: Graph, soak: Soak) -> int:
    """Ask for a fit of the live samples, and return how many they are."""
    begin = time.monotonic()
    reply = graph.call(Identify, "/identification/identify", bags=[], method="")
    soak.asked += 1
    soak.slowest = max(soak.slowest, time.monotonic() - begin)
    if reply is None or not reply.success:
        soak.findings.append(f"identify: {'no answer' if reply is None else reply.message}")
        return 0
    soak.replies += 1
    return int(reply.report.samples_read)


def _go_on(publisher: NodeProcess) -> None:
    assert publisher.popen.stdin is not None
    publisher.popen.stdin.write(b"\n")
    publisher.popen.stdin.flush()


# -- in one process ----------------------------------------------------------------------------------------------------


def in_process(hours: float, minutes: float, folder: Path, method: str) -> Soak:
    """Stream through the classes of recorder and identification, not faster than asked for; see :func:`over_dds`."""
    soak, factor = Soak(), 60 * hours / minutes
    sys.setswitchinterval(_SWITCH_INTERVAL)
    next(stream(folder))
    topics = [RecordedTopic(name, kind) for name, kind in TYPES.items()]
    session = RecordingSession(folder / "soak", topics, RecordingSettings(max_file_size=FILE))
    identifier = Identifier(IdentificationSettings(), FitSettings(method=method, i_max=I_MAX))
    files, found = Files(folder / "soak"), list[Refit | None]()
    worker: Worker[Refit | None] = Worker()
    begin = looked = time.monotonic()
    for number, (topic, data, stamp) in enumerate(stream(folder)):
        late = time.monotonic() - begin > _LATE * minutes * 60
        if late or soak.published >= hours * 3600 * RATE * len(TYPES):
            break
        while session.report().waiting > _MOST_WAITING:
            time.sleep(0.01)
        session.receive(topic, data, stamp)
        if topic in SECTIONS:
            identifier.receive(SECTIONS[topic], data)
        soak.published += BLOCK
        if number % 40 == 0:
            done = soak.published / (RATE * len(TYPES))
            time.sleep(max(0.0, begin + done / factor - time.monotonic()))
            while found:
                if refit := found.pop(0):
                    identifier.take(refit)
            if not worker.busy and (job := identifier.refit()):
                worker.start(job, found.append)
        if time.monotonic() - looked > _LOOK:
            looked = time.monotonic()
            soak.look(soak.published / (RATE * len(TYPES)) / 3600, process=resident())
            files.read()
    soak.wall = time.monotonic() - begin
    worker.stop(PATIENCE)
    session.stop()
    files.read(all_of_them=True)
    soak.lost = session.report().dropped
    identifier.live.advance()
    soak.read = identifier.live.join.samples
    return _judged(soak, files)


def _judged(soak: Soak, files: Files) -> Soak:
    soak.hours = soak.published / (RATE * len(TYPES)) / 3600
    soak.written = files.samples
    soak.findings += files.gaps[:5]
    if soak.written + soak.lost != soak.published or soak.lost:
        soak.findings.append(f"{soak.published} published, {soak.written} written, {soak.lost} lost")
    return soak


if __name__ == "__main__":
    publish(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))
