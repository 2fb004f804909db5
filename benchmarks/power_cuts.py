"""Power cuts during and after a recording: tests what can be read from many possible disk states."""

from __future__ import annotations

import random
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
from forgetful_disk import DiskLog, LoggedFile, logged
from fuzz import Ran, run
from rosbags.rosbag2 import Reader

import drive_id
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.files.messages.messages import CURRENT_REFERENCE, PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.files.read.several import read_recording
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.recover import recover_bag
from drive_id.files.write.writer import write_recording
from drive_id.live.recording.recording_session import RecordedTopic, RecordingSession
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.types import Samples

FLUSH = 0.2
"""``flush_period`` of the recordings, s."""
ALLOWANCE = 0.15
"""Time that threads may wait for a busy processor, s, beside twice the longest time that the disk took to sync."""
TOPICS = {
    "/phase_currents": PHASE_CURRENTS,
    "/phase_voltages": PHASE_VOLTAGES,
    "/resolver": RESOLVER,
    "/current_reference": CURRENT_REFERENCE,
}
OUTCOMES = ("crash", "hang", "traceback", "not one sentence", "wrong sample", "excess loss")
_BLOCK = 100
_START = 1_700_000_000_000_000_000
Message = tuple[str, int, bytes]


@dataclass
class Recorded:
    """A finished recording on a disk whose operations were logged.

    Parameters
    ----------
    log : DiskLog
    messages : list of tuple
        Topic and data of each message, and when it was given to the writer, s of the steady clock.
    live : bool
        Written live: all messages older than the flush period must be there. Otherwise: all or nothing.
    complete : int
        Operations until the writer had reported completion: from then on, nothing may be missing.
    """

    log: DiskLog
    messages: list[tuple[str, bytes, float]] = field(default_factory=list)
    live: bool = True
    complete: int = 0


@dataclass
class Tally:
    """Outcomes of the states of one kind of recording."""

    states: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    longest: float = 0.0
    findings: list[str] = field(default_factory=list)

    def add(self, outcome: str, said: str) -> None:
        """Count a finding."""
        self.outcomes[outcome] += 1
        self.findings.append(f"{outcome}: {said}")


def simulated(seconds: float) -> Samples:
    """Return samples of a drive on a trajectory that a short recording covers."""
    trajectory = Lissajous(frequency_d=7.3, frequency_q=2.3)
    return drive_id.simulate("ipm", seconds, seed=5, noise=1e-3, trajectory=trajectory)


def _messages(samples: Samples) -> list[Message]:
    """Return topic, log time and data of the messages of a recording, in order."""
    with tempfile.TemporaryDirectory() as folder:
        write_recording(Path(folder) / "bag", samples, start_stamp=_START, block_size=_BLOCK)
        with open_bag(Path(folder) / "bag") as bag:
            return [(each.topic, each.log_time, bytes(each.data)) for each in bag.messages(frozenset(TOPICS))]


# -- recordings --------------------------------------------------------------------------------------------------------


def live(log: DiskLog, samples: Samples, settings: RecordingSettings, room: int | None = None) -> Recorded:
    """Record in real time; with ``room``, on a disk that fills up."""
    recorded = Recorded(log)
    opener = partial(LoggedFile, log, mode="x", room=room)
    topics = [RecordedTopic(name, type_name) for name, type_name in TOPICS.items()]
    session = RecordingSession(log.root / "bag", topics, settings, opener=opener)
    begin = time.monotonic()
    for topic, log_time, data in _messages(samples):
        time.sleep(max(0.0, begin + (log_time - _START) * 1e-9 - time.monotonic()))
        recorded.messages.append((topic, data, time.monotonic()))
        session.receive(topic, data, log_time)
    session.stop()
    recorded.complete = len(log.operations)
    if room:
        assert session.report().error
        with Reader(log.root / "bag") as reader:  # what stop() has said to be in the bag
            kept = {(each.topic, bytes(data)) for each, _, data in reader.messages()}
        recorded.messages = [each for each in recorded.messages if each[:2] in kept]
    return recorded


def whole(log: DiskLog, samples: Samples) -> Recorded:
    """Write a recording at once, as simulations and conversions do."""
    write_recording(log.root / "bag", samples, start_stamp=_START, block_size=_BLOCK)
    return Recorded(log, [(topic, data, 0.0) for topic, _, data in _messages(samples)], False, len(log.operations))


def repaired(log: DiskLog, samples: Samples) -> Recorded:
    """Recover a recording that breaks off."""
    with tempfile.TemporaryDirectory() as folder:
        session = RecordingSession(
            Path(folder) / "bag", [RecordedTopic(*each) for each in TOPICS.items()], RecordingSettings()
        )
        messages = _messages(samples)
        for topic, log_time, data in messages:
            session.receive(topic, data, log_time)
        session.stop()
        file = Path(folder) / "bag" / "bag_0.mcap"
        file.write_bytes(file.read_bytes()[:-2000])
        recover_bag(Path(folder) / "bag", log.root / "bag")
    return Recorded(log, [(topic, data, 0.0) for topic, _, data in messages], False, len(log.operations))


Make = Callable[[DiskLog, Samples], Recorded]


def _live(room: int | None = None, **settings: float | str) -> Make:
    chosen = RecordingSettings(flush_period=FLUSH, **settings)  # type: ignore[arg-type]  # fields of several types
    return lambda log, samples: live(log, samples, chosen, room)


RECORDINGS: dict[str, Make] = {
    "recorder, zstd": _live(),
    "recorder, lz4": _live(compression="lz4"),
    "recorder, uncompressed": _live(compression="none"),
    "recorder, chunks of 4 kB": _live(chunk_size=4096),
    "recorder, a file every 0.3 s": _live(max_file_duration=0.3, chunk_size=16384),
    "recorder, disk full": _live(room=400_000),
    "simulate, convert": whole,
    "recover": repaired,
}


# -- disk states -------------------------------------------------------------------------------------------------------


def states(name: str, count: int, seed: int, folder: Path, seconds: float = 2.0) -> Tally:
    """Record once, and test a number of disk states after a power cut.

    Parameters
    ----------
    name : str
        Key of :data:`RECORDINGS`.
    count : int
    seed : int
        Of moments and of what the disk loses.
    folder : Path
        Scratch space.
    seconds : float
        Length of the recording.

    Raises
    ------
    SystemExit
        When an operation escaped the log, so that the states would prove nothing.
    """
    samples = simulated(seconds)
    tally, disk = Tally(), folder / "disk"
    disk.mkdir(parents=True)
    with logged(disk) as log:
        recorded = RECORDINGS[name](log, samples)
    log.final_state(folder / "replayed")
    if _tree(folder / "replayed") != _tree(disk):
        raise SystemExit(f"{name}: the log of the disk is not complete; its replay differs from {disk}.")
    with patch("drive_id.pictures.plots.result_pictures", return_value={}):  # drawing takes longer than all else
        drive_id.fit(samples, method="joint")  # loads in this process what its forks need
        for number in range(count):
            rng = random.Random(f"{name}:{seed}:{number}")
            target = folder / "state"
            target.mkdir()
            try_state(recorded, samples, rng, target, tally, f"{name}, state {number} of seed {seed}")
            shutil.rmtree(target)
    return tally


def try_state(recorded: Recorded, samples: Samples, rng: random.Random, folder: Path, tally: Tally, title: str) -> None:
    """Build one state, run ``fit`` or ``info`` and ``recover``, and check the results."""
    log = recorded.log
    last = len(log.operations)
    count = last if rng.random() < 0.15 else rng.randint(1, last)
    said = f"{title}: {log.crash_state(count, rng, folder / 'disk')}"
    tally.states += 1
    complete = count >= recorded.complete
    moment = log.times[count] if count < last else log.times[-1]
    bag = folder / "disk" / "bag"
    arguments = ("fit", str(bag), "--output", "fit", "--method", "joint")
    fit = run(arguments if complete or rng.random() < 0.3 else ("info", str(bag)), folder)
    recovery = run(("recover", str(bag), "--output", "recovered"), folder)
    for ran in (fit, recovery):
        if outcome := _bad_end(ran):
            tally.add(outcome, f"{said}: {ran.err[-400:]}")
            return
    whole_bag = bag.exists() and not recovery.code and (bag / "metadata.yaml").exists()
    found = _found(folder / "recovered") if not recovery.code else Counter[tuple[str, bytes]]()
    given = Counter((topic, data) for topic, data, _ in recorded.messages)
    if found - given:
        tally.add("wrong sample", f"{said}: {len(found - given)} messages that were never recorded")
    if (folder / "fit").exists() and not _agrees(bag, samples):
        tally.add("wrong sample", f"{said}: a fit reads other samples than were recorded")
    missing = [moment - when for topic, data, when in recorded.messages if (topic, data) not in found]
    if complete and (missing or fit.code or "was not completed" in fit.err + fit.out):
        tally.add("excess loss", f"{said}: {len(missing)} messages after the end; {fit.err[-400:]}")
    elif recorded.live:
        loss = max((age for age in missing if age >= 0), default=0.0)
        tally.longest = max(tally.longest, loss)
        if loss > FLUSH + 2 * log.longest_sync + ALLOWANCE:
            tally.add("excess loss", f"{said}: {loss:.2f} s")
    elif bag.exists() and (missing or not whole_bag):
        tally.add("excess loss", f"{said}: an incomplete recording under its final name")


def _bad_end(ran: Ran) -> str:
    """Return the kind of failure of a command, or an empty string."""
    lines = ran.err.strip().splitlines()
    if ran.hung:
        return "hang"
    if "Traceback" in ran.err:
        return "traceback"
    if ran.code not in (0, 1):
        return "crash"
    if ran.code == 1 and not (len(lines) == 1 and lines[0].startswith("drive-id: ") and lines[0].endswith(".")):
        return "not one sentence"
    return ""


def _found(path: Path) -> Counter[tuple[str, bytes]]:
    """Return the messages that rosbags, an independent reader, finds in a recording."""
    with Reader(path) as reader:
        return Counter((each.topic, bytes(data)) for each, _, data in reader.messages())


def _agrees(bag: Path, samples: Samples) -> bool:
    """Return whether all samples that a fit reads from a bag are those that were recorded."""
    found = read_recording(bag).samples
    place = np.round((found.stamp - _START) * 1e-9 / samples.sample_period).astype(int)
    return all(
        np.array_equal(getattr(found, name), getattr(samples, name)[place].astype(np.float32))
        for name in ("i_abc", "u_abc")
    )


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}
