"""Hours of streaming in minutes, through the classes of recorder and identification, in one process without DDS.

The recording is divided into files, which are read, counted and removed while it goes on.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from node_processes import PATIENCE, resident, slope
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
    read: int = 0
    """Samples of a topic that are accumulated, after the stream."""
    times: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)

    @property
    def growth(self) -> float:
        """By how much the memory grew in the later two thirds, MB: along a line, for fits come and go."""
        span = self.times[-1] - self.times[len(self.times) // 3]
        return span * slope(self.times, self.memory)


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


def soak(hours: float, minutes: float, folder: Path, method: str) -> Soak:
    """Stream so many hours, at 10 kHz on four topics, in so many minutes or more."""
    found, factor = Soak(), 60 * hours / minutes
    wanted = hours * 3600 * RATE * len(TYPES)
    sys.setswitchinterval(_SWITCH_INTERVAL)
    next(stream(folder))  # simulates before the clock runs
    topics = [RecordedTopic(name, kind) for name, kind in TYPES.items()]
    session = RecordingSession(folder / "soak", topics, RecordingSettings(max_file_size=FILE))
    identifier = Identifier(IdentificationSettings(), FitSettings(method=method, i_max=I_MAX))
    files, refits = Files(folder / "soak"), list[Refit | None]()
    worker: Worker[Refit | None] = Worker()
    begin = looked = time.monotonic()
    for number, (topic, data, stamp) in enumerate(stream(folder)):
        if time.monotonic() - begin > _LATE * minutes * 60 or found.published >= wanted:
            break
        while session.report().waiting > _MOST_WAITING:
            time.sleep(0.01)
        session.receive(topic, data, stamp)
        if topic in SECTIONS:
            identifier.receive(SECTIONS[topic], data)
        found.published += BLOCK
        done = found.published / (RATE * len(TYPES))
        if number % 40 == 0:
            time.sleep(max(0.0, begin + done / factor - time.monotonic()))
            while refits:
                if refit := refits.pop(0):
                    identifier.take(refit)
            if not worker.busy and (job := identifier.refit()):
                worker.start(job, refits.append)
        if time.monotonic() - looked > _LOOK:
            looked = time.monotonic()
            found.times.append(done / 3600)
            found.memory.append(resident())
            files.read()
    found.hours, found.wall = found.published / (RATE * len(TYPES)) / 3600, time.monotonic() - begin
    worker.stop(PATIENCE)
    session.stop()
    files.read(all_of_them=True)
    identifier.live.advance()
    found.lost, found.read, found.written = session.report().dropped, identifier.live.join.samples, files.samples
    found.findings += files.gaps[:5]
    if found.written + found.lost != found.published or found.lost:
        found.findings.append(f"{found.published} published, {found.written} written, {found.lost} lost")
    return found
