"""Messages and live samples: reading, accumulation at 100 kHz, and the reply to a request after ten minutes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from measuring import in_turns
from plain_script import read as rosbags_read
from recordings import experiment, recording
from reporting import Row, Section, faster, seconds

from drive_id.core.fit_settings import FitSettings
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.messages import PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.block_stream import BlockStream
from drive_id.files.read.reader import bag_pieces
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.identification.live_evidence import LiveEvidence
from drive_id.live.identification.refits import Refit, of_snapshot
from drive_id.live.worker import Worker
from drive_id.types import Samples

TYPES = (PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER)
_FAST = 100_000.0  # Hz
_FAST_BLOCK = 1000
_I_MAX = 320.0
_PLAYED = 40.0  # s
_PATIENCE = 60.0

Message = tuple[int, bytes]


def section(folder: Path, repeats: int, minutes: float) -> Section:
    """Measure."""
    rows = [_reading(folder, repeats)]
    for method in ("joint", "full"):
        settings = FitSettings(method=method, i_max=_I_MAX)
        rows += [_accumulation(settings), _in_real_time(settings), *_reply(settings, repeats, minutes)]
    return Section("Messages and live samples", "Live: in process, without the transport of ROS.", tuple(rows))


def _reading(folder: Path, repeats: int) -> Row:
    bag = recording(folder, 60.0)
    actions = {"rosbags": lambda: rosbags_read(bag), "ours": lambda: deque(bag_pieces(bag, SignalMap()), maxlen=0)}
    costs = in_turns(actions, min(repeats, 3))
    return faster("a bag of 60 s into joined arrays, against rosbags' deserialization", costs["rosbags"], costs["ours"])


def _messages(samples: Samples, block: int, times: int = 1) -> Iterator[Message]:
    """Yield section and data of the messages of a recording, repeated with a break of one message in between."""
    angle = (samples.angle + np.pi) % (2 * np.pi) - np.pi
    values = [samples.i_abc, samples.u_abc, np.column_stack([angle, samples.speed])]
    arrays = [array.astype(np.float32) for array in values]
    period = samples.sample_period
    for number in range(times):
        count = number * (len(samples) + block)
        for start in range(0, len(samples), block):
            stamp = round((count + start) * period * 1e9)
            for place, array in enumerate(arrays):
                columns = list(array[start : start + block].T)
                yield place, encode_block(stamp, count + start, period, columns, "drive")


def _streams() -> list[BlockStream]:
    return [BlockStream(f"/{name}", kind) for name, kind in zip("abc", TYPES, strict=True)]


def _feed(live: LiveEvidence, messages: Iterator[Message], streams: list[BlockStream] | None = None) -> float:
    """Take messages as the node does, and return the processor time that took, s."""
    streams = streams or _streams()
    spent = 0.0
    for place, data in messages:
        begin = time.thread_time()
        live.add(place, streams[place].decode(data))
        spent += time.thread_time() - begin
    return spent


def _accumulation(settings: FitSettings) -> Row:
    samples = experiment(4.0, _FAST)
    half = replace(samples, **{name: getattr(samples, name)[: len(samples) // 8] for name in _ARRAYS})
    _feed(LiveEvidence(settings), _messages(half, _FAST_BLOCK))  # compiles, fills caches
    spent = min(_feed(LiveEvidence(settings), _messages(samples, _FAST_BLOCK)) for _ in range(3))
    duration = len(samples) / _FAST
    return Row(
        f"`{settings.method}`: accumulating 100 kHz live, blocks of 1000",
        f"{duration:.0f} s of samples", f"{seconds(spent)} of CPU",
        f"{100 * spent / duration:.1f} % of a core", f"{100 * spent / duration:.1f} %", "≤ 30 %",
    )  # fmt: skip


_ARRAYS = ("stamp", "i_abc", "u_abc", "angle", "speed", "i_dq_reference")


def _in_real_time(settings: FitSettings) -> Row:
    """Play 100 kHz as a drive does, with fits in the background as the node makes them.

    On a busy machine it takes longer than the samples: receiving is related to their time, the fits to the elapsed one.
    """
    messages = list(_messages(experiment(4.0, _FAST), _FAST_BLOCK, round(_PLAYED / 4.0)))
    identifier = Identifier(IdentificationSettings(), settings)
    worker: Worker[Refit | None] = Worker()
    found: list[Refit | None] = []
    begin, cpu, receiving = time.monotonic(), time.process_time(), 0.0
    for number, (place, data) in enumerate(messages):
        time.sleep(max(0.0, begin + number * _FAST_BLOCK / _FAST / len(TYPES) - time.monotonic()))
        start = time.thread_time()
        identifier.receive(place, data)
        receiving += time.thread_time() - start
        if number % 30 == 0 and not worker.busy:
            while found:
                if refit := found.pop(0):
                    identifier.take(refit)
            if job := identifier.refit():
                worker.start(job, found.append)
    duration, spent = time.monotonic() - begin, time.process_time() - cpu
    worker.stop(_PATIENCE)
    alone = 100 * receiving / _PLAYED
    share = alone + 100 * (spent - receiving) / duration
    return Row(
        f"`{settings.method}`: receiving 100 kHz in real time, fits in the background included",
        f"{alone:.1f} % of a core without the fits", f"{duration:.0f} s",
        f"{share:.1f} % of a core", f"{share:.1f} %", "≤ 30 %",
    )  # fmt: skip


def _reply(settings: FitSettings, repeats: int, minutes: float) -> tuple[Row, ...]:
    """Measure replies without a fit in the background, and with one of all samples but the last 10 %."""
    samples = experiment(60.0)
    live = LiveEvidence(settings)
    messages = list(_messages(samples, 100, round(minutes)))
    most = round(0.9 * len(messages))
    streams = _streams()
    spent = _feed(live, iter(messages[:most]), streams)
    known = of_snapshot(live.snapshot(), None).conclusion
    spent += _feed(live, iter(messages[most:]), streams)
    actions = {
        "without a fit in the background": lambda: live.snapshot().conclude().drive,
        "after a fit of the first 90 %": lambda: live.snapshot().conclude(known),
    }
    costs = in_turns(actions, repeats)
    return tuple(
        Row(
            f"`{settings.method}`: identify after {minutes:g} minutes at 10 kHz, {name}",
            f"{100 * spent / (60 * minutes):.1f} % of a core till then",
            seconds(cost.elapsed), "", seconds(cost.cpu), "≤ 0.3 s" if "after" in name else "",
        )
        for name, cost in costs.items()
    )  # fmt: skip
