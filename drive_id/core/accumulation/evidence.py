"""Sufficient statistics of a fit: sums and counts over all samples, of a size that does not depend on their number."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS
from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.coverage import FLUX_CELLS, Visits, disc_coverage
from drive_id.core.maps.flux_models import Polynomial, TensorSpline
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.running_sums import Accumulator, SavedSums, below, exactly, prefixed
from drive_id.core.numerics.scans import mark_rests
from drive_id.core.paper.regression import RegressionSums
from drive_id.core.signals.current_noise import POWER, angle_variance, noise_variance
from drive_id.errors import ConfigurationError
from drive_id.types import BoolArray, FloatArray, Samples

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.full.window_sums import WindowSums

DOMAIN_MARGIN = 1.05
"""Half width of the map by the i_max that is set."""
_IDLE_CURRENT = 0.02  # of i_max, below which the drive rests
_LEAST_DISC = 0.5
"""Radius of a disc relative to that of the map's range from which on the cells of the map resolve it."""
_SHAPING = (
    "flux_model", "splines_d", "splines_q", "polynomial_degree", "inverter_current_scale", "longest_rest",
    "harmonic_orders", "grid_points",
)  # fmt: skip  # settings that shape the sums; all others are of the solution
_COUNTS = ("samples", "gaps", "idle", "_differences")
_SUMS = ("_time", "_difference_square", "_turn_square", "_interpolation_square", "_angle_square", "_turned_square")


def check_live(method: str) -> None:
    """Raise ConfigurationError for method ``static``, which sums nothing over samples."""
    if not ORIGINS[method].live:
        raise ConfigurationError(
            "Method static fits operating points of whole logs, not accumulated or live samples: use drive-id fit LOG "
            "--method static, or drive_id.fit."
        )


class Evidence:
    """Sums of the fit's method, counts of visited currents and noise statistics of the samples so far.

    Parameters
    ----------
    d, q : Axis
        Ranges of the map.
    i_max : float
        Radius of the current disc of the experiment, A.
    compared : bool
        Form the sums of the paper's regression, whatever the method, so that method ``full`` serves all methods.

    Raises
    ------
    ConfigurationError
        For method ``static``.
    """

    def __init__(self, settings: FitSettings, d: Axis, q: Axis, i_max: float, *, compared: bool = False) -> None:
        check_live(settings.method)
        self.settings = settings
        self.d = d
        self.q = q
        self.i_max = i_max
        over_windows = ORIGINS[settings.method].windows
        self.information = self._regression_sums() if compared or not over_windows else None
        self.windows = self._window_sums() if over_windows else None
        self.visits = Visits(
            np.linspace(d.low, d.high, settings.grid_points), np.linspace(q.low, q.high, settings.grid_points)
        )
        self._recordings = 0
        self.reached = 0.0
        """Radius of the disc that the prescan found, whatever i_max is set to, A; 0 where it is not known."""
        self.findings: tuple[Message, ...] = ()
        """What the checks found in the samples, errors aside."""
        self.samples = 0
        self.gaps = 0
        self.idle = 0
        self._outside = 0  # see outside
        self._quiet = 0  # samples since the current was last away from zero
        self._time = 0.0
        # of fourth differences of the noise of i_dq, per component: what information files have always held
        self._difference_square = 0.0
        self._differences = 0
        self._turn_square = 0.0
        self._interpolation_square = 0.0  # of the error of interpolated angles
        # of white noise in the angle, and of what it makes of the currents in the rotor frame, per difference above
        self._angle_square = self._turned_square = 0.0

    @classmethod
    def within(cls, settings: FitSettings, i_max: float, *, compared: bool = False) -> Evidence:
        """Prepare for samples of unknown range in a disc of known radius, A."""
        edge = DOMAIN_MARGIN * i_max
        d, q = (Axis(-edge, edge, count) for count in (settings.splines_d, settings.splines_q))
        return cls(settings, d, q, i_max, compared=compared)

    def _regression_sums(self) -> RegressionSums:
        """Return empty sums of the paper's regression."""
        degree = 1 if self.settings.flux_model == "linear" else self.settings.polynomial_degree
        spline = self.settings.flux_model == "spline"
        model = TensorSpline(self.d, self.q) if spline else Polynomial(degree, self.i_max)
        return RegressionSums(model, TanhShape(self.settings.inverter_current_scale))

    def _window_sums(self) -> WindowSums:
        from drive_id.core.full.model import FullModel  # noqa: PLC0415  # takes 0.1 s
        from drive_id.core.full.window_sums import WindowSums  # noqa: PLC0415

        low, high = np.array([self.d.low, self.q.low]), np.array([self.d.high, self.q.high])
        reciprocal = self.settings.maps != "free"
        orders = self.settings.harmonic_orders if ORIGINS[self.settings.method].turning else ()
        return WindowSums(FullModel(low, high, self.i_max, orders, reciprocal=reciprocal))

    def add(
        self,
        samples: Samples,
        done: Callable[[int], None] | None = None,
        *,
        continues: bool = False,
        prompt: bool = False,
    ) -> None:
        """Accumulate further samples.

        With ``continues``, they continue the previous piece and begin with its last sample, which counts once. ``done``
        is told after each part how many of them are done; ``prompt`` leaves no products for the fit to form, see
        :meth:`~drive_id.core.full.window_sums.WindowSums.add`.
        """
        new = slice(1, None) if continues else slice(None)
        i_dq = frames.to_dq(samples.i_abc, samples.angle)
        idle = self._idle(samples, i_dq, continues=continues)
        self.idle += int(idle[new].sum())
        if self.windows is not None:
            self.windows.add(samples, idle, continues=continues, prompt=prompt)
        if self.information is not None:
            self.information.add(samples, done, idle)
        else:
            self._outside += self._beyond(samples, i_dq)
            if done:
                done(len(samples))
        self.visits.add(i_dq[new])
        self.gaps += len(samples.run_starts) - (continues or self.samples == 0)
        self.samples += len(samples) - continues
        self._time += (len(samples) - continues) * samples.sample_period
        self._turn_square += float(np.sum((samples.speed[new] * samples.sample_period) ** 2))
        self._interpolation_square += (len(samples) - continues) * samples.angle_error**2
        for run in samples.runs():
            count = 2 * max(run.stop - run.start - 4, 0)
            self._difference_square += count * POWER * noise_variance(i_dq[run], samples.angle[run])
            of_angle = count * angle_variance(samples.angle[run])
            self._angle_square += of_angle
            self._turned_square += of_angle * float(np.mean(np.square(i_dq[run])))
            self._differences += count

    def next_recording(self) -> None:
        """Begin another recording: adding its samples then equals merging it.

        Raises ConfigurationError when temperatures or DC-link voltages are set, but none for this recording.
        """
        if self.information is not None:
            self.information.next_recording()
        conditions = self.settings.conditions(self._recordings)
        if self.windows is not None:
            self.windows.next_recording(*conditions)
        self._recordings += 1

    def _beyond(self, samples: Samples, i_dq: FloatArray) -> int:
        """Return the number of :attr:`outside` among samples."""
        out = np.zeros(len(samples), np.bool_)
        for axis, current in zip((self.d, self.q), i_dq.T, strict=True):
            out |= (current < axis.low) | (current > axis.high)
        return sum(int((out[run][1:] | out[run][:-1]).sum()) for run in samples.runs())

    def _idle(self, samples: Samples, i_dq: FloatArray, *, continues: bool) -> BoolArray:
        """Tell (N,) which samples follow a rest near zero current longer than the settings allow."""
        idle = np.zeros(len(samples), np.bool_)
        least, period, longest = _IDLE_CURRENT * self.i_max, samples.sample_period, self.settings.longest_rest
        for run in samples.runs():
            before = self._quiet - 1 if continues and run.start == 0 else 0
            self._quiet = mark_rests(i_dq[run], least, period, longest, before, idle[run])
        return idle

    def copy(self, settings: FitSettings | None = None) -> Evidence:
        """Return an independent copy, perhaps for another method; finished blocks are shared.

        All other settings that shape the sums must be equal. Raises ConfigurationError when the other method needs sums
        that were not accumulated, or sums nothing over samples.
        """
        other = copy.copy(self)
        other.settings = settings or self.settings
        if other.settings.i_max is not None:
            other.i_max = other.settings.i_max
        check_live(other.settings.method)
        if not self._serves(other.settings.method):
            raise ConfigurationError(
                f"The samples were accumulated for method {self.settings.method}, which is not enough for method "
                f"{other.settings.method}: accumulate them for that method."
            )
        over_windows = ORIGINS[other.settings.method].windows
        other.information = self.information.copy() if self.information is not None else None
        other.visits = self.visits.copy()
        other.windows = self.windows.copy() if over_windows and self.windows is not None else None
        return other

    def merged(self, other: Evidence) -> Evidence:
        """Return the evidence of all recordings of both; neither changes.

        Sums of the paper's regression that one of them lacks are left out. Raises ConfigurationError when they were
        accumulated differently; see :meth:`difference`.
        """
        if difference := self.difference(other):
            raise ConfigurationError(
                f"Two recordings were accumulated differently ({difference}) and cannot be merged: accumulate both "
                "with the same settings and the same i_max."
            )
        both, theirs = self.copy(), other.accumulators()
        both._outside = self.outside + other.outside  # noqa: SLF001  # of its own class
        both.information = both.information if other.information is not None else None
        for name, accumulator in both.accumulators().items():
            accumulator.merge(theirs[name])
        for name in (*_COUNTS, *_SUMS):
            setattr(both, name, getattr(self, name) + getattr(other, name))
        both.gaps += self.samples > 0 and other.samples > 0
        both.reached = max(self.reached, other.reached)
        both.findings = tuple(dict.fromkeys((*self.findings, *other.findings)))
        both._quiet = 0  # noqa: SLF001  # of its own class
        return both

    def _serves(self, method: str) -> bool:
        """Tell whether the sums that a method needs are there."""
        return (self.windows if ORIGINS[method].windows else self.information) is not None

    def suits(self, settings: FitSettings) -> bool:
        """Tell whether a fit with these settings can use this evidence; raises ConfigurationError for ``static``."""
        check_live(settings.method)
        shaping = (*_SHAPING, "temperatures", "u_dc", "u_dc_reference")
        same = all(getattr(self.settings, name) == getattr(settings, name) for name in shaping)
        return same and self.resolves(settings.i_max) and self._serves(settings.method)

    @property
    def largest_disc(self) -> float:
        """Radius of the largest disc within the range of the map, A."""
        return min(self.d.high, -self.d.low, self.q.high, -self.q.low) / DOMAIN_MARGIN

    def resolves(self, i_max: float | None) -> bool:
        """Tell whether the map can be of a disc of another radius, A: within its range, and not much smaller."""
        largest = self.largest_disc
        return i_max is not None and _LEAST_DISC * largest <= i_max * (1 + 1e-9) and i_max <= largest * (1 + 1e-9)

    def difference(self, other: Evidence, this: str = "in one", that: str = "in the other") -> str:
        """Return what keeps this evidence and the other from being merged; empty if nothing does."""
        for name in _SHAPING:
            mine, theirs = (getattr(settings, name) for settings in (self.settings, other.settings))
            if mine != theirs:
                return f"{name} is {mine} {this} and {theirs} {that}"
        turning = [ORIGINS[each.settings.method].turning for each in (self, other)]
        if (self.windows is None) != (other.windows is None) or turning[0] != turning[1]:
            return f"method is {self.settings.method} {this} and {other.settings.method} {that}"
        if self.i_max != other.i_max:
            return f"i_max is {self.i_max:.6g} A {this} and {other.i_max:.6g} A {that}"
        if (self.d, self.q) != (other.d, other.q):
            return "their maps have different ranges"
        return ""

    def state(self) -> SavedSums:
        """Return sums and counts, without settings, ranges and radius."""
        own: SavedSums = {name: np.array(getattr(self, name)) for name in (*_COUNTS, *_SUMS, "_quiet", "reached")}
        own["findings"] = np.array(json.dumps([finding.tree() for finding in self.findings]))
        for name, accumulator in self.accumulators().items():
            own |= prefixed(name, accumulator.state())
        return own

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        for name in (*_COUNTS, *_SUMS, "_quiet", "reached"):
            setattr(self, name, exactly(state[name], np.array(getattr(self, name))).item())
        self.findings = tuple(map(Message.stored, json.loads(str(state["findings"]))))
        for name, accumulator in self.accumulators().items():
            accumulator.restore(below(name, state))

    def accumulators(self) -> dict[str, Accumulator]:
        """Return the accumulators it consists of, by name."""
        parts = {"information": self.information, "visits": self.visits, "windows": self.windows}
        return {name: part for name, part in parts.items() if part is not None}

    @property
    def outside(self) -> int:
        """Number of pairs of consecutive samples of which one lies beyond the map's range."""
        return self._outside if self.information is None else self.information.outside

    @property
    def sample_period(self) -> float:
        """Mean sample period, s."""
        return self._time / max(self.samples, 1)

    @property
    def turn(self) -> float:
        """Root mean square of the angle turned per sample, rad."""
        return float(np.sqrt(self._turn_square / max(self.samples, 1)))

    @property
    def noise_variance(self) -> float:
        """Variance of white noise in i_d and i_q each, A^2."""
        return self._difference_square / max(self._differences, 1) / POWER

    @property
    def current_variance(self) -> float:
        """Variance of white noise in i_d and i_q each without that of the angle, A^2."""
        return max(self.noise_variance - self._turned_square / max(self._differences, 1), 0.0)

    @property
    def angle_variance(self) -> float:
        """Variance of white noise in the angle, rad^2."""
        return self._angle_square / max(self._differences, 1)

    @property
    def interpolation_variance(self) -> float:
        """Mean square error of interpolated angles, rad^2; 0 for angles recorded with each sample."""
        return self._interpolation_square / max(self.samples, 1)

    @property
    def noise_share(self) -> float:
        """Energy that noise adds to the differences of a basis function, per energy of its rotation.

        Noise of standard deviation sigma in i_dq changes a function by about
        sigma / h from sample to sample, h being the width of a cell; rotation contributes omega T times the function.
        """
        return float(
            2 * self.noise_variance / max(self.turn * min(self.d.width, self.q.width), np.finfo(np.float64).tiny) ** 2
        )

    def inside(self) -> BoolArray:
        """Tell where on the grid of the visits data support a map of this resolution."""
        if not ORIGINS[self.settings.method].windows:
            return self.visits.inside(self.d.width, self.q.width)
        return self.visits.inside(*((axis.high - axis.low) / FLUX_CELLS for axis in (self.d, self.q)))

    def coverage(self) -> float:
        """Return the share of the current disc with data, 0 to 1."""
        return disc_coverage(self.visits.i_d, self.visits.i_q, self.inside(), self.i_max)
