"""An experiment and the watch over its drive: what the trajectory publisher does, without ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.course import Experiment, ReferenceBlock, State
from drive_id.core.experiment.settings import ExperimentSettings, make_trajectory, total_duration
from drive_id.core.experiment.watch import Fault, Watch
from drive_id.health import Health, Level


class WatchedExperiment:
    """Starts only when the drive is in order, and stops when it no longer is.

    ``now`` is the clock of the stamps, ns; ``steady`` a clock that nobody sets, s, by which silence is measured.

    Parameters
    ----------
    settings : ExperimentSettings
    currents, resolver : str, optional
        Names of the watched topics, for messages.
    """

    def __init__(
        self, settings: ExperimentSettings, currents: str = "phase_currents", resolver: str = "resolver"
    ) -> None:
        self._experiment = Experiment(settings)
        self._watch = Watch(settings, currents, resolver)
        self._settings = settings

    @property
    def trip_reason(self) -> str:
        """Why the last experiment tripped; empty when it did not."""
        return self._experiment.trip_reason

    def plan(self) -> str:
        """Describe what a start would do."""
        settings = self._settings
        seconds = total_duration(settings, make_trajectory(settings))
        how_long = "until it is stopped" if math.isinf(seconds) else f"for {seconds:.4g} s"
        return f"{settings.trajectory} within {settings.i_max:g} A {how_long}"

    def start(self, now: int, steady: float, publishers: int = 1) -> tuple[bool, str]:
        """Begin the experiment, or return why not; ``publishers`` is how many there are of references."""
        if self._experiment.active:
            state = self._experiment.state(now).value
            return False, f"An experiment is under way ({state}): stop it, or wait for its end."
        if now <= 0:
            return False, "The clock stands at 0: use_sim_time is set, but nobody publishes /clock."
        if publishers > 1:
            return False, f"{publishers - 1} other nodes publish current_reference, too: a drive follows only one."
        fault = self._watch.fault(steady)
        if fault is not None:
            return False, f"{self._tripped()}Not started: {fault.reason}"
        self._experiment.start(now)
        return True, f"Started: {self.plan()}."

    def stop(self, now: int) -> tuple[bool, str]:
        """Ramp down; it is no error if there is nothing to stop."""
        if not self._experiment.active:
            return True, "Nothing is running."
        self._experiment.stop(now, "Stopped on request.")
        return True, "Stopping: the current ramps down to zero."

    def change(self, now: int, settings: ExperimentSettings) -> None:
        """Take other settings; an experiment under way is stopped first."""
        self._settings = settings
        self._experiment.stop(now, "Stopped, because parameters were changed.")
        self._take_settings()

    def currents(self, now: int, steady: float, first_sample: int, i_abc: Sequence[NDArray[np.float32]]) -> bool:
        """Look at a block of phase currents (three (N,) arrays, A); return whether it ends the experiment."""
        return self._judge(now, self._watch.currents(steady, first_sample, i_abc))

    def resolver(self, now: int, steady: float, first_sample: int, signals: Sequence[NDArray[np.float32]]) -> bool:
        """Look at a block of angle, rad, and speed, rad/s ((N,) each); return whether it ends the experiment."""
        return self._judge(now, self._watch.resolver(steady, first_sample, signals))

    def advance(self, now: int, steady: float) -> list[ReferenceBlock]:
        """Return the blocks that are to be published now."""
        if self._experiment.active:
            self._judge(now, self._watch.fault(steady))
        blocks = self._experiment.advance(now)
        self._take_settings()
        return blocks

    def finish(self, now: int) -> list[ReferenceBlock]:
        """Stop for good; return all blocks down to the last zero."""
        return self._experiment.finish(now, "Stopped, because the node ends.")

    def health(self, now: int, steady: float) -> Health:
        """Tell where the experiment is and what it covers."""
        experiment, settings = self._experiment, self._settings
        state = experiment.state(now)
        i_d, i_q = experiment.current(now)
        values = {
            "state": state.value,
            "trajectory": settings.trajectory,
            "elapsed [s]": f"{experiment.elapsed(now):.3f}",
            "duration [s]": f"{total_duration(settings, make_trajectory(settings)):.3f}",
            "i_max [A]": f"{settings.i_max:g}",
            "i_d [A]": f"{i_d:.4g}",
            "i_q [A]": f"{i_q:.4g}",
            "coverage": f"{experiment.coverage:.3f}",
        }
        values |= {f"lost samples of {name}": str(lost) for name, lost in self._watch.lost.items()}
        if state is State.TRIPPED:
            return Health(Level.ERROR, experiment.trip_reason, values)
        if experiment.active:
            return Health(Level.OK, f"{state.value}: {100 * experiment.coverage:.0f} % of the disc visited.", values)
        fault = self._watch.fault(steady)
        if fault is not None:
            return Health(Level.WARN, f"A start would be refused: {fault.reason}", values)
        return Health(Level.OK, experiment.stop_reason or "Waiting for a start.", values)

    def _judge(self, now: int, fault: Fault | None) -> bool:
        if fault is None or not self._experiment.active:
            return False
        self._experiment.trip(now, fault.reason, immediate=fault.immediate)
        return True

    def _take_settings(self) -> None:
        if not self._experiment.active and self._experiment.settings is not self._settings:
            self._experiment.configure(self._settings)
            self._watch.settings = self._settings

    def _tripped(self) -> str:
        return f"Tripped earlier: {self._experiment.trip_reason} " if self._experiment.trip_reason else ""
