"""Translate messages of a bench's own topics to blocks of our signals, by a signals file: settings and work."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.common.settings import Checked, setting
from drive_id.core.signals.join import SECTIONS, JoinReport, Piece, StreamJoin
from drive_id.core.signals.signal import Signal, block_stamps
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.messages.message_reader import DECODE_ERRORS, MessageSamples, Reader, message_reader
from drive_id.files.messages.signal_sources import SignalMap
from drive_id.files.read.conversion import conversions
from drive_id.files.read.extraction import INTERPOLATED, SignalBuilder
from drive_id.files.storage.container import RawMessage, TopicInfo
from drive_id.types import Samples

_BATCH = 100  # samples that are joined at once: 10 ms at 10 kHz
_CAPACITY = 50_000  # samples of a signal that wait for the others
_LONGEST_DELAY = 2.0  # s, between signals stamped by one clock
_MOST_WAITING = 200_000
"""Messages of a signal that wait for :meth:`Translator.advance`; earlier ones are dropped beyond."""


@dataclass(frozen=True)
class BridgeSettings(Checked):
    """Signals file and blocks of the bridge."""

    signals: str = setting("", "Signals file that names the bench's topics and fields; required")
    block_period: float = setting(
        0.01, "Time between blocks: shorter ones arrive earlier and cost more", unit="s", minimum=1e-3, maximum=1.0
    )
    queue_depth: int = setting(
        5000, "Messages of each topic that may wait while the node is busy", minimum=1, maximum=1_000_000
    )
    frame_id: str = setting("drive", "Name of the drive in the headers")


@dataclass(frozen=True, eq=False)
class SignalBlock:
    """Gap-free samples of a drive, as in our messages."""

    stamp: int  # of the first sample, ns
    first_sample: int  # running count of the first sample; it jumps by the samples lost, told by the time of each gap
    sample_period: float  # s
    currents: NDArray[np.float32]  # (N, 3), A
    voltages: NDArray[np.float32]  # (N, 3), V
    resolver: NDArray[np.float32]  # (N, 2), electrical angle, rad, in [-pi, pi), and electrical speed, rad/s
    scalars: Mapping[str, NDArray[np.float32]]  # optional signals (N,) by their names in Samples

    def signals(self) -> tuple[Signal, Signal, Signal]:
        """Return currents, voltages and resolver as signals."""
        stamp = block_stamps(self.stamp, len(self.currents), self.sample_period)
        start = np.zeros(1, np.int64)
        currents, voltages, resolver = (
            Signal(name, stamp, values.astype(np.float64), self.sample_period, start)
            for name, values in zip(SECTIONS, (self.currents, self.voltages, self.resolver), strict=True)
        )
        return currents, voltages, resolver


class Translator:
    """Translates a stream of messages.

    Parameters
    ----------
    signals : SignalMap
        Names the topics. Every section needs a declared ``sample_period``, the resolver a speed in the same message.
    sort : bool
        Wait behind a gap for messages that arrive late.

    Raises
    ------
    ConfigurationError
        When the signals file needs all of a recording at once.
    """

    def __init__(self, signals: SignalMap, *, sort: bool = False) -> None:
        self.signals = signals
        sources = signals.sources()
        if signals.of_columns:
            raise ConfigurationError("The signals file names columns: name the topic of each section to bridge it.")
        undeclared = [name for name in SECTIONS if name in sources and sources[name].sample_period is None]
        if undeclared:
            raise ConfigurationError(
                f"The signals file declares no sample_period for {' and '.join(undeclared)}, which live signals need."
            )
        if signals.at_once or not signals.resolver.own_speed:
            raise ConfigurationError(
                "The signals file needs a whole recording (no speed beside the angle, equally_spaced, interpolate, "
                "smoothing or decimation): live signals need a speed in the resolver's message and stamps as they are."
            )
        self._sources = {name: source for name, source in sources.items() if name != "reference"}
        self.topics = tuple(dict.fromkeys(source.topic for source in self._sources.values()))
        """Topics to subscribe to, as named in the signals file."""
        self._builders = {name: SignalBuilder(each.topic, name, each) for name, each in self._sources.items()}
        self._readers: dict[str, list[tuple[str, Reader]]] = {}
        self._waiting: dict[str, list[MessageSamples]] = defaultdict(list)
        scalars = {name: self._sources[name].topic for name in INTERPOLATED if name in self._sources}
        self._join = StreamJoin(
            (sources["currents"].topic, sources["voltages"].topic, sources["resolver"].topic),
            batch=_BATCH,
            capacity=_CAPACITY,
            scalars={name: topic for name, topic in scalars.items() if name == signals.voltages.scaled_by},
            scaled_by=signals.voltages.scaled_by,
            to_phases=conversions(signals),
            turned=signals.turned,
            sort=sort,
        )
        self._next = 0
        self._last_stamp: int | None = None
        self.unreadable = 0
        self.dropped = 0
        """Messages that waited too long."""
        self.last_error = ""
        self._newest: dict[str, int] = {}

    def found(self, given: str, topic: TopicInfo) -> None:
        """Set the type of a topic, named as in the signals file.

        Raises MessageTypeError when it holds no such fields.
        """
        own = [(name, source) for name, source in self._sources.items() if source.topic == given]
        self._readers[given] = [(name, message_reader(topic, source, self.signals)) for name, source in own]

    def receive(self, given: str, data: bytes, received: int) -> None:
        """Take a serialized message that was received at a time, ns."""
        message = RawMessage(given, received, memoryview(data))
        for section, read in self._readers.get(given, ()):
            try:
                samples = read(message)
            except (*DECODE_ERRORS, DriveIdError) as error:
                self.unreadable += 1
                said = (str(error) or type(error).__name__).split("\n")[0][:200]
                self.last_error = (
                    f"A message on {given} cannot be read as {section} ({said}): correct the signals file."
                )
                continue
            waiting = self._waiting[section]
            if len(waiting) >= _MOST_WAITING:
                self.dropped += 1
            elif len(samples.columns[0]):
                waiting.append(samples)

    def advance(self) -> list[SignalBlock]:
        """Join what has arrived and return it as blocks, one for each stretch without a gap."""
        waiting, self._waiting = self._waiting, defaultdict(list)
        joined: list[Piece] = []
        for section, pieces in waiting.items():
            try:
                signal = self._builders[section].build(pieces)
            except DriveIdError as error:
                self.unreadable += len(pieces)
                self.last_error = str(error)
                continue
            joined += self._add(section, signal)
        joined += self._join.advance()
        return [block for piece in joined for block in self._cut(piece)]

    def report(self) -> JoinReport:
        """Return what became of the signals."""
        return self._join.report()

    def clock_finding(self) -> str:
        """Return a sentence if the latest stamps of the signals are too far apart for one clock, else an empty one."""
        times = {section: 1e-9 * self._newest[section] for section in SECTIONS if section in self._newest}
        if len(times) < len(SECTIONS) or max(times.values()) - min(times.values()) < _LONGEST_DELAY:
            return ""
        shown = ", ".join(f"{name} ({self._sources[name].topic}) {time:.3f} s" for name, time in times.items())
        return f"The latest stamps are too far apart for one clock ({shown}): stamp all signals by the same clock."

    def _add(self, section: str, signal: Signal) -> list[Piece]:
        if len(signal.stamp):
            self._newest[section] = int(signal.stamp[-1])
        if section in SECTIONS:
            return self._join.add(SECTIONS.index(section), signal)
        self._join.add_scalar(section, signal)
        return []

    def _cut(self, piece: Piece) -> list[SignalBlock]:
        samples = piece.samples
        blocks = []
        for number, run in enumerate(samples.runs()):
            continues = piece.continues and number == 0
            start = run.start + continues
            if start < run.stop:
                blocks.append(self._block(samples.part(start, run.stop), continues=continues))
        return blocks

    def _block(self, samples: Samples, *, continues: bool) -> SignalBlock:
        """Return samples as a block; only a gap counts as lost time, for the true period is not quite the declared."""
        stamp, period = int(samples.stamp[0]), samples.sample_period
        lost = 0
        if not continues and self._last_stamp is not None:
            lost = max(0, round((stamp - self._last_stamp) * 1e-9 / period) - 1)
        first = self._next + lost
        self._next, self._last_stamp = first + len(samples), int(samples.stamp[-1])
        angle = np.mod(samples.angle + np.pi, 2 * np.pi) - np.pi
        return SignalBlock(
            stamp=stamp,
            first_sample=first,
            sample_period=period,
            currents=samples.i_abc.astype(np.float32),
            voltages=samples.u_abc.astype(np.float32),
            resolver=np.stack([angle, samples.speed], axis=-1).astype(np.float32),
            scalars={name: values.astype(np.float32) for name, values in samples.scalars().items()},
        )
