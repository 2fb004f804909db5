"""The simulated bench in real time: produces the samples due by now and follows the received references."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drive_id.bench.drive import Drive, build_machine
from drive_id.bench.faults import FaultSettings
from drive_id.bench.profile import SpeedProfile
from drive_id.bench.reference_buffer import ReferenceBuffer
from drive_id.bench.scalars import scalar_strides
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.common.health import Health, Level
from drive_id.core.experiment.encoder import Encoder
from drive_id.core.experiment.feedback import DriveStatus, SampleBlock
from drive_id.errors import ConfigurationError
from drive_id.types import NANOSECONDS, FloatArray, GroundTruth, MachineMap

_SAMPLES_AT_ONCE = 5000  # most samples simulated in one call, so that references and services are served in between
_CLOCK_AHEAD = 0.02  # s
_LARGEST_LAG = 0.5  # s, above which the diagnostics warn
_STATUS_PERIOD = 0.02  # time between two messages of the status, s
_JUST_BELOW_PI = np.nextafter(np.float32(np.pi), np.float32(0))

Columns = tuple[NDArray[np.float32], ...]


@dataclass(frozen=True, eq=False)
class MessageBlock:
    """The samples of one message of each topic."""

    stamp: int  # of the first sample, ns
    first_sample: int  # running count
    sample_period: float  # s
    currents: Columns  # of three phases (N,), A
    voltages: Columns  # likewise, V
    resolver: Columns  # angle, rad, and speed, rad/s, (N,) each
    scalars: dict[str, SampleBlock]  # optional signals that have a sample in this block, by name


class SimulatedBench:
    """A simulated drive that runs with a clock; building it also loads or compiles its kernels.

    Its faults can be replaced at any time. Raises ConfigurationError when settings and machine do not fit.
    """

    def __init__(
        self,
        machine_map: MachineMap,
        drive: SimulationSettings,
        bench: BenchSettings,
        faults: FaultSettings | None = None,
    ) -> None:
        self.faults = faults or FaultSettings()
        self._settings = bench
        self._drive = Drive(build_machine(machine_map, drive), drive)
        self._every = drive.log_decimation
        self._period = self._every * drive.sample_period
        self._strides = scalar_strides(drive, self._period)
        self._start: int | None = None
        self._done = 0
        self._now = 0
        self._drifted = 0.0
        self._last: MessageBlock | None = None
        self._lag = 0.0
        self.restart()

    def restart(self) -> None:
        """Forget references and session, and count from 0, as a drive does whose power came back."""
        self.references = ReferenceBuffer(self._drive.machine.i_max, self._settings.zero_slew_rate)
        self._first = self._done
        self._statuses = 0
        self._status_due = 0.0
        self._reported = (0, 0, 0)

    def truth(self) -> GroundTruth:
        """Return the ground truth: for a file, never for a topic."""
        return self._drive.truth()

    @property
    def latest(self) -> int | None:
        """Latest time, ns, for a clock that waits for the simulation; None before the first sample."""
        ahead = max(2 * self._settings.block_size, round(_CLOCK_AHEAD / self._period))
        return None if self._start is None else self._stamp(self._done + ahead)

    def set_speeds(self, speeds: tuple[float, ...], ramp_time: float) -> None:
        """Ramp from the present speed to the first of ``speeds``, rpm, in ``ramp_time``, s, from the next sample on."""
        now, profile = self._drive.time, self._drive.profile
        present = float(np.interp(now, profile.time, profile.speed))
        self._drive.profile = SpeedProfile(np.array([now, now + ramp_time]), np.array([present, speeds[0]]))

    def set_encoder(self, encoder: Encoder) -> None:
        """Change what the drive makes of its raw angle, unless current flows or might flow: see :meth:`check_rest`."""
        self.check_rest()
        self._drive.set_encoder(encoder)

    def check_rest(self) -> None:
        """Raise ConfigurationError unless the drive is at zero current without a session."""
        if not self.references.dry or self.references.last.any():
            raise ConfigurationError("The drive follows a session: stop it before you change the encoder's parameters.")

    def advance(self, now: int) -> list[MessageBlock]:
        """Return the blocks that are complete by ``now``, ns; the oldest ones if there are too many.

        The first call starts the simulation.

        Raises ConfigurationError when the simulation breaks off.
        """
        if self._start is None:
            self._start = self._now = now
        drift = self.faults.clock_drift  # without one, the clock is synchronized again
        self._drifted = self._drifted + drift * (now - self._now) if drift else 0.0
        self._now = now
        size = self._settings.block_size
        exist = int((now - self._stamp(self._done)) // (self._period * NANOSECONDS))
        self._lag = max(0.0, (exist // size - 1) * size * self._period)
        blocks = min(exist // size, max(1, _SAMPLES_AT_ONCE // (size * self._every)))
        if blocks < 1:
            return []
        first, count = self._done, blocks * size
        grid = np.arange(first * self._every, (first + count) * self._every, dtype=np.int64)
        period = self._drive.settings.sample_period
        stamps = self._start + self._ahead + np.round(grid * (period * NANOSECONDS)).astype(np.int64)
        if self.faults.trip:
            self.references.fail("The parameter trip is set.")
        self._drive.stator_frame = self.references.stator_frame
        samples = self._drive.step_block(self.references.take(stamps, period)).samples
        late = samples.stamp - np.round(grid[:: self._every] * (period * NANOSECONDS)).astype(np.int64)
        scalars = samples.scalars()
        self._done += count
        angle = np.clip(samples.angle.astype(np.float32), -_JUST_BELOW_PI, _JUST_BELOW_PI)
        currents, voltages = samples.i_abc.astype(np.float32).T, samples.u_abc.astype(np.float32).T
        speed = samples.speed.astype(np.float32)
        if np.max(np.abs(speed)) > self._speed_limit:
            self.references.fail(f"The speed exceeds {self._settings.speed_limit:g} rpm.")
        made = [
            MessageBlock(
                self._stamp(first + k) + self._ahead + int(late[k]),
                first + k - self._first,
                self._period,
                tuple(column[k : k + size] for column in currents),
                tuple(column[k : k + size] for column in voltages),
                (angle[k : k + size], speed[k : k + size]),
                self._scalar_blocks(first + k, {name: values[k : k + size] for name, values in scalars.items()}),
            )
            for k in range(0, count, size)
        ]
        return [self._frozen(block) for block in made]

    def status(self) -> DriveStatus | None:
        """Return what the drive says of itself, if it is time for it."""
        if self._last is None or self._done * self._period < self._status_due:
            return None
        self._status_due = self._done * self._period + _STATUS_PERIOD
        self._statuses += 1
        last, references, machine = self._last, self.references, self._drive.machine
        tripped, scalars = self.faults.trip, {name: float(block.values[0][-1]) for name, block in last.scalars.items()}
        return DriveStatus(
            stamp=last.stamp + round(len(last.resolver[0]) * self._period * NANOSECONDS),
            count=self._statuses - 1,
            enabled=not tripped,
            fault=references.fault,
            session=references.session or 0,
            applied=references.applied,
            i_d=float(references.last[0]),
            i_q=float(references.last[1]),
            speed=float(last.resolver[1][-1]),
            dc_link_voltage=scalars.get("dc_link_voltage", machine.u_dc),
            winding_temperature=scalars.get("winding_temperature", math.nan),
            magnet_temperature=scalars.get("magnet_temperature", math.nan),
            current_limit=machine.i_max,
            speed_limit=self._speed_limit,
        )

    @property
    def _speed_limit(self) -> float:
        """Electrical, rad/s."""
        return self._settings.speed_limit * self._drive.machine.pole_pairs * math.pi / 30

    @property
    def _ahead(self) -> int:
        """What the clock of the drive is ahead, ns."""
        return round(self.faults.clock_offset * NANOSECONDS + self._drifted)

    def _frozen(self, block: MessageBlock) -> MessageBlock:
        """Return the block as it is published, with repeated stamps or samples if these are frozen."""
        last = self._last
        if last is not None and self.faults.freeze == "stamps":
            block = replace(block, stamp=last.stamp)
        elif last is not None and self.faults.freeze == "samples":
            block = replace(block, currents=last.currents, voltages=last.voltages, resolver=last.resolver)
        self._last = block
        return block

    def _scalar_blocks(self, first: int, scalars: dict[str, FloatArray]) -> dict[str, SampleBlock]:
        """Return every n-th sample of the optional signals of a block that begins with sample number ``first``."""
        found = {}
        for name, values in scalars.items():
            stride = self._strides[name]
            number = -(-first // stride)
            chosen = values[number * stride - first :: stride].astype(np.float32)
            if len(chosen):
                found[name] = SampleBlock(self._stamp(number * stride), number, stride * self._period, (chosen,))
        return found

    def health(self) -> Health:
        """Return whether the bench keeps up and follows; only what a real bench would know, too."""
        counts, references = self.references.counts, self.references
        now = (counts.late, counts.unusable, counts.foreign)
        late, unusable, foreign = (a - b for a, b in zip(now, self._reported, strict=True))
        self._reported = now
        values = {
            "samples": str(self._done),
            "lag [s]": f"{self._lag:.3f}",
            "references waiting": str(len(references)),
            "references late": str(counts.late),
            "references unusable": str(counts.unusable),
            "references beyond the limit": str(counts.beyond),
            "references of no session in force": str(counts.foreign),
        }
        if self._lag > _LARGEST_LAG:
            sentence = f"The simulation is {self._lag:.1f} s behind the clock: lower time_scale, or raise block_size."
        elif references.fault:
            sentence = f"Zero current: {references.fault}"
        elif unusable:
            sentence = f"{unusable} set-points were rejected: different lengths, no period, NaN, or far too many."
        elif foreign:
            sentence = f"{foreign} set-points belong to a session that has ended, or whose beginning was not received."
        elif late:
            sentence = f"{late} set-points arrived too late: raise the publisher's lead_time."
        else:
            return Health(Level.OK, "Zero current: no references." if references.dry else "Following.", values)
        return Health(Level.WARN, sentence, values)

    def _stamp(self, index: int) -> int:
        assert self._start is not None
        return self._start + round(index * self._period * NANOSECONDS)


class Pace:
    """Scales a steady clock, which is ``steady`` at the time ``start``, ns, to the time of the bench.

    ``scale`` is simulated time per real time. Other than 1, time waits for the simulation: all other nodes follow it.
    """

    def __init__(self, start: int, steady: int, scale: float) -> None:
        self._time = 0.0
        self._start, self._steady, self._scale = start, steady, scale

    def now(self, steady: int, latest: int | None) -> int:
        """Return the time, ns, at ``steady``, ns; scaled time does not pass ``latest``, ns."""
        self._time += (steady - self._steady) * self._scale
        self._steady = steady
        if self._scale != 1.0 and latest is not None:
            self._time = min(self._time, float(latest - self._start))
        return self._start + round(self._time)
