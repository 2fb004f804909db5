"""All that a fit needs to know of the samples, accumulated as they come: its size does not grow with them."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from drive_id.core import frames
from drive_id.core.bspline import Axis
from drive_id.core.coverage import Visits, disc_coverage
from drive_id.core.fit_settings import FitSettings
from drive_id.core.flux_models import FluxModel, Polynomial, TensorSpline
from drive_id.core.inverter import TanhShape
from drive_id.core.regression import Information
from drive_id.types import BoolArray, Samples

_DOMAIN_MARGIN = 1.05
_IDLE_CURRENT = 0.02


class Evidence:
    """The regression's information, the visited currents and the counts of a growing set of samples.

    Parameters
    ----------
    settings : FitSettings
    d, q : Axis
        Ranges of the map.
    i_max : float
        Radius of the current disc of the experiment, A.
    """

    def __init__(self, settings: FitSettings, d: Axis, q: Axis, i_max: float) -> None:
        self.settings = settings
        self.d = d
        self.q = q
        self.i_max = i_max
        self.information = Information(_model(settings, d, q, i_max), TanhShape(settings.inverter_current_scale))
        self.visits = Visits(
            np.linspace(d.low, d.high, settings.grid_points), np.linspace(q.low, q.high, settings.grid_points)
        )
        self.samples = 0
        self.gaps = 0
        self.idle = 0
        self._quiet = 0  # samples since the current was last away from zero
        self._time = 0.0
        self._zero_sequence_square = 0.0
        self._bend_square = 0.0  # of second differences of i_dq, per component
        self._bends = 0
        self._turn_square = 0.0

    @classmethod
    def within(cls, settings: FitSettings, i_max: float) -> Evidence:
        """Prepare for samples of unknown range in a disc of known radius, A."""
        edge = _DOMAIN_MARGIN * i_max
        return cls(settings, Axis(-edge, edge, settings.splines_d), Axis(-edge, edge, settings.splines_q), i_max)

    def add(self, samples: Samples, done: Callable[[int], None] | None = None, *, continues: bool = False) -> None:
        """Accumulate further samples.

        Parameters
        ----------
        samples : Samples
        done : callable, optional
            Told after each part how many of them are done.
        continues : bool
            They continue the piece before and begin with its last sample, which counts once.
        """
        new = slice(1, None) if continues else slice(None)
        i_dq = frames.to_dq(samples.i_abc, samples.angle)
        idle = self._idle(samples, np.hypot(*i_dq.T) < _IDLE_CURRENT * self.i_max, continues=continues)
        self.idle += int(idle[new].sum())
        self.information.add(samples, done, idle)
        self.visits.add(i_dq[new])
        self.gaps += len(samples.run_starts) - (continues or self.samples == 0)
        self.samples += len(samples) - continues
        self._time += (len(samples) - continues) * samples.sample_period
        self._zero_sequence_square += float(np.sum(samples.i_abc[new].sum(axis=1) ** 2))
        self._turn_square += float(np.sum((samples.speed[new] * samples.sample_period) ** 2))
        for run in samples.runs():
            bends = np.diff(i_dq[run], n=2, axis=0)
            self._bend_square += float(np.sum(bends**2))
            self._bends += bends.size

    def _idle(self, samples: Samples, quiet: BoolArray, *, continues: bool) -> BoolArray:
        """Tell (N,) which samples come after a longer rest near zero current than the settings allow."""
        idle = np.zeros(len(quiet), np.bool_)
        for run in samples.runs():
            before = self._quiet - 1 if continues and run.start == 0 else 0
            step = np.arange(1, run.stop - run.start + 1)
            resting = step - np.maximum.accumulate(np.where(quiet[run], -before, step))
            idle[run] = resting * samples.sample_period > self.settings.longest_rest
            self._quiet = int(resting[-1])
        return idle

    def copy(self, settings: FitSettings | None = None) -> Evidence:
        """Return evidence that goes its own way from here; cheap, for what is complete is shared.

        Parameters
        ----------
        settings : FitSettings, optional
            Another method; what else they say must be the same.
        """
        other = copy.copy(self)
        other.settings = settings or self.settings
        other.information = self.information.copy()
        other.visits = self.visits.copy()
        return other

    @property
    def model(self) -> FluxModel:
        """The flux model whose parameters the information is about."""
        return self.information.model

    @property
    def sample_period(self) -> float:
        """Mean sample period, s."""
        return self._time / max(self.samples, 1)

    @property
    def zero_sequence(self) -> float:
        """Root mean square of the sum of the phase currents, A."""
        return float(np.sqrt(self._zero_sequence_square / max(self.samples, 1)))

    @property
    def noise_share(self) -> float:
        """Energy that noise adds to the differences of a basis function, per energy of its rotation.

        Noise of deviation sigma in i_dq, estimated from second differences, changes a function by about sigma / h from
        sample to sample, h being the width of a cell; the voltage tells of the function itself by omega T.
        """
        variance = self._bend_square / max(self._bends, 1) / 6
        turn = np.sqrt(self._turn_square / max(self.samples, 1))
        return float(2 * variance / max(turn * min(self.d.width, self.q.width), np.finfo(np.float64).tiny) ** 2)

    def inside(self) -> BoolArray:
        """Tell where on the grid of the visits data support a map of this resolution."""
        return self.visits.inside(self.d.width, self.q.width)

    def coverage(self) -> float:
        """Return the share of the current disc with data, 0 to 1."""
        return disc_coverage(self.visits.i_d, self.visits.i_q, self.inside(), self.i_max)


def _model(settings: FitSettings, d: Axis, q: Axis, i_max: float) -> FluxModel:
    if settings.flux_model == "spline":
        return TensorSpline(d, q)
    return Polynomial(settings.polynomial_degree if settings.flux_model == "polynomial" else 1, i_max)
