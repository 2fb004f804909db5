"""Inertia, friction and cogging of a free shaft, from its motion and the torque of the flux map.

The torque balance is weighted by a bell w that vanishes with its slope at both ends of a window, and the derivatives
are moved from the angle to the bell: ``int w d2theta/dt2 = int w'' theta``, ``int w dtheta/dt = -int w' theta``.
Nothing measured is differentiated, so neither noise nor the lag of a speed signal matters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.error_modes import ErrorModes
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.block_regression import SIGNIFICANT, BlockRegression, is_one
from drive_id.core.result.identification import Cogging, IdentifiedDrive, Mechanics
from drive_id.types import TINY, FloatArray, Samples

_Flux = Callable[[FloatArray, FloatArray], FloatArray]
"""Flux psi_dq (N, 2), Wb, over currents (N, 2), A, and angles (N,), rad."""

ORDERS = (6, 12, 18, 24)
"""Electrical orders of cogging that are looked for."""
_SHORTEST = 4e-3  # width of the bell, s, at least
_LONGEST = 0.1  # at most
_BELLS = 8
"""Bells per width: neighbours overlap."""
_SWEEP = 0.06
"""Half the frequency at which i_d sweeps the disc, relative to that of the torque: what errors of the map leave repeats
with the sweep, and is no scatter."""
_FEWEST = 8  # cosines below that frequency by which the scatter is estimated, at least
_MOST = 40  # at most
_OUTSIDE = 0.05
"""Share of a bell in which the current may lie beyond the data of the map, where its continuation is taken."""
_RESTING = 0.02
"""Speed relative to the largest one at which a shaft rests: friction then is what holds it."""
_NEAR_REST = 0.1
"""The same below which friction need not be Coulomb's: its change of sign takes some speed, and may have a peak."""
_EXPLAINED = 0.9
"""Share of the torque's energy that the motion must explain to be that of a free shaft."""
_HELD = 0.3
"""The same without cogging and ripple, below which a shaft is held: most are, and the waves take a tenth of a fit."""
_TOLD = 5.0
"""Standard errors of friction, viscous friction or load from which on the motion tells it."""
_COMMON = 1e-4
"""What method full leaves in the size common to all fluxes of simulated drives, and no standard error holds."""
_LEAST_WAVE = 0.05
"""Rms of a harmonic under the bells below which it has averaged out."""
_SAME_SPEED = 1.2  # fastest over slowest speed up to which viscous friction is not told from Coulomb's
_LEAST_VARIATION = 0.05
"""Variation of the squared flux from which on the drag of iron loss is told from viscous friction."""
_LEAST_TURN = 2 * math.pi
"""Range of the angle below which no harmonic is looked for, rad."""


def with_mechanics(
    drive: IdentifiedDrive, excerpts: Sequence[Samples], pole_pairs: int | None, settings: FitSettings
) -> IdentifiedDrive:
    """Return the drive with the mechanics of its free shaft; the same drive if its torque does not move the shaft.

    There are no mechanics without pole pairs. Of the settings, ``inertia`` and ``added_inertia`` count.
    """
    if pole_pairs is None or not excerpts:
        return drive
    discs = settings.added_inertia
    if discs and len(discs) != len(excerpts):
        drive, discs = replace(drive, statements=(*drive.statements, Message("disc_unused"))), ()
    known = settings.inertia, drive.error_modes
    found = fit_mechanics(drive.flux_map, drive.corrected(excerpts), pole_pairs, discs, *known)
    if found is None:
        return drive
    return replace(drive, mechanics=found, statements=(*drive.statements, *_statements(found)))


_TORQUE, _MAP, _INERTIA, _DISC, _VISCOUS, _FRICTION, _LOAD, _IRON, _SLOW, _HARMONICS = range(10)
"""Columns: torque of the map, its standard error, mechanical acceleration, the same times the added inertia, mechanical
speed, direction, 1, speed times the variation of the squared flux, direction where the shaft is slow, and then the
harmonics; all under a bell."""
_PER_ORDER = 12
"""Columns of each order: cosine and sine, of cogging, and the same times i_d, i_q, i_d^2, i_d i_q and i_q^2, for the
ripple of the flux harmonics."""


@one_blas_thread()
def fit_mechanics(
    flux_map: FluxMap,
    pieces: Sequence[Samples],
    pole_pairs: int,
    discs: Sequence[float] = (),
    inertia: float | None = None,
    modes: ErrorModes | None = None,
) -> Mechanics | None:
    """Fit inertia, friction, load and cogging to the motion.

    Takes the inertia added in each piece (default: none) and the known inertia without discs, kg m^2, joint errors and
    rotor-position harmonics of the map. Without the joint errors, its errors count for each term as if they all fell on
    it. None if the torque of the map does not explain the motion, as with a load machine, or with too little data.
    """
    known = flux_map, pieces, pole_pairs, discs or (0.0,) * len(pieces), inertia
    # most shafts are held: no need to wait until scipy is loaded
    if _fitted(*known, lambda i_dq, _: flux_map.bilinear(i_dq), None, orders=()) is None:
        return None
    return _fitted(*known, flux_map.flux, modes)


def _fitted(
    flux_map: FluxMap,
    pieces: Sequence[Samples],
    pole_pairs: int,
    discs: Sequence[float],
    inertia: float | None,
    flux: _Flux,
    modes: ErrorModes | None,
    orders: Sequence[int] = ORDERS,
) -> Mechanics | None:
    """Fit the motion, with a function for the flux and electrical orders of cogging."""
    width = _bell_width(flux_map, flux, pieces)
    motions = [
        _Motion.of(flux_map, flux, piece.part(run.start, run.stop), pole_pairs, disc, width, orders)
        for piece, disc in zip(pieces, discs, strict=True)
        for run in piece.runs()
    ]
    data = np.concatenate([motion.rows[motion.kept] for motion in motions])
    if len(data) < _BELLS * _FEWEST:
        return None
    two_discs = len(set(discs)) > 1
    whole = _with_known(data.shape[1], inertia)
    data = data @ whole
    columns, looked = _told_columns(data, pieces, disc=two_discs and inertia is None)
    if modes is not None:
        of_map = np.sum([motion.products(modes, flux_map, pole_pairs, whole[:, columns]) for motion in motions], axis=0)
    else:
        squares = (data[:, columns] ** 2).sum(axis=0)
        of_map = np.diag(np.sqrt((data[:, _MAP] ** 2).sum() * squares))
    of_map = np.vstack([of_map, _COMMON * data[:, _TORQUE] @ data[:, columns]])
    cosines = min(max(int(_SWEEP * len(data) / _BELLS), _FEWEST), _MOST)
    solution = BlockRegression.of_series(data, _TORQUE, columns, cosines, of_map, block=_BELLS)
    energy = solution.total[_TORQUE, _TORQUE]
    explained = 1.0 - solution.rms(solution.coefficients, 1.0) ** 2 / max(energy, TINY)
    coefficient, sigma = solution.estimate(_INERTIA)
    if explained < (_EXPLAINED if orders else _HELD) or coefficient < _TOLD * sigma:
        return None
    gain = None
    if inertia is not None or two_discs:
        gain = _gain(solution, _INERTIA if inertia is not None else _DISC)
    by = 1.0 if gain is None else gain[0]
    own, sigma_own = (inertia, 0.0) if inertia is not None else _inertia(solution, by, known=two_discs)
    friction, viscous, load = (_term(solution, column, by) for column in (_FRICTION, _VISCOUS, _LOAD))
    return Mechanics(
        inertia=own,
        sigma_inertia=sigma_own,
        friction=friction[0],
        sigma_friction=friction[1],
        viscous_friction=viscous[0],
        sigma_viscous_friction=viscous[1],
        load=load[0],
        sigma_load=load[1],
        cogging=tuple(
            Cogging(orders[(column - _HARMONICS) // _PER_ORDER], *(by * x for x in solution.amplitude(column)))
            for column in looked
            if solution.wald(column) > SIGNIFICANT
        ),
        cogging_visible=by * math.sqrt(SIGNIFICANT) * max(map(solution.scatter, looked)) if looked else None,
        gain=None if gain is None else gain[0],
        sigma_gain=None if gain is None else gain[1],
        explained=float(explained),
        seconds=len(data) * width / _BELLS,
    )


def _told_columns(data: FloatArray, pieces: Sequence[Samples], *, disc: bool) -> tuple[list[int], list[int]]:
    """Return the columns that the motion tells from each other, and of them the first one of each order of cogging."""
    base = [_INERTIA, *([_DISC] if disc else []), *_of_speeds(data[:, _VISCOUS])]
    if _VISCOUS in base and np.std(data[:, _IRON]) > _LEAST_VARIATION * np.std(data[:, _VISCOUS]):
        base.append(_IRON)
    if data[:, _SLOW].any():
        base.append(_SLOW)
    turned = max((float(np.ptp(np.unwrap(piece.angle))) for piece in pieces), default=0.0)
    looked = [
        column
        for column in range(_HARMONICS, data.shape[1], _PER_ORDER)
        if turned > _LEAST_TURN and np.sqrt(np.mean(data[:, column : column + 2] ** 2)) > _LEAST_WAVE
    ]
    return [*base, *(column + part for column in looked for part in range(_PER_ORDER))], looked


def _gain(solution: BlockRegression, column: int) -> tuple[float, float]:
    """Return the common gain, whose inverse is the coefficient of a known inertia, and its standard error."""
    inverse, sigma = solution.estimate(column)
    return 1 / inverse, sigma / inverse**2


def _inertia(solution: BlockRegression, by: float, *, known: bool) -> tuple[float, float]:
    """Return the inertia without discs and its standard error; ``known``: by two of them."""
    value, sigma = solution.estimate(_INERTIA)
    if not known:
        return value, sigma
    at = [solution.columns.index(column) for column in (_INERTIA, _DISC)]  # J = g (J / g), g = 1 / coefficient
    slope = np.array([by, -(by**2) * value])
    return by * value, math.sqrt(float(slope @ solution.covariance[np.ix_(at, at)] @ slope))


def _term(solution: BlockRegression, column: int, by: float) -> tuple[float | None, float | None]:
    """Return a term and its standard error, None if the motion does not tell it.

    Negative friction is none: then the torque is in error with the speed, as by a latency of the angle.
    """
    if column not in solution.columns:
        return None, None
    value, sigma = solution.estimate(column)
    told = (abs(value) if column == _LOAD else value) > _TOLD * sigma > 0
    return (by * value, by * sigma) if told else (None, None)


def _with_known(count: int, inertia: float | None) -> FloatArray:
    """Return what makes the column of the inertia the torque of the whole known one, as a matrix behind rows."""
    change = np.eye(count)
    if inertia is not None:
        change[_INERTIA, _INERTIA], change[_DISC, _INERTIA] = inertia, 1.0
    return change


def _of_speeds(speed: FloatArray) -> list[int]:
    """Return the columns of friction and load that speeds (N,), rad/s, tell from each other."""
    size = np.abs(speed)
    low, high = np.percentile(size, [5, 95])
    slowest, fastest = np.percentile(speed, [5, 95])  # not those of a run-up
    reversed_ = slowest < -0.2 * high and fastest > 0.2 * high
    return [_FRICTION, *([_VISCOUS] if high > _SAME_SPEED * low else []), *([_LOAD] if reversed_ else [])]


def _bell_width(flux_map: FluxMap, flux: _Flux, pieces: Sequence[Samples]) -> float:
    """Return half the mean period of the torque, s, by its changes of sign."""
    changes, seconds = 0, 0.0
    for piece in pieces:
        torque = _torque(flux_map, flux, piece, 1)[0]
        step = max(1, round(1e-3 / piece.sample_period))
        smooth = torque[: len(torque) // step * step].reshape(-1, step).mean(axis=1)
        active = np.abs(smooth) > 0.1 * np.abs(smooth).max(initial=0.0)  # noise about zero torque is no swing
        changes += int(np.count_nonzero(np.diff(np.sign(smooth[active]))))
        seconds += float(active.sum()) * step * piece.sample_period
    return min(max(seconds / max(changes, 1), _SHORTEST), _LONGEST)


def _torque(
    flux_map: FluxMap, flux: _Flux, samples: Samples, pole_pairs: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return torque and its standard error, Nm; 1.0 where the current is beyond the data; |psi|^2; (N,) each."""
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    i_d, i_q = i_dq.T
    psi = flux(i_dq, samples.angle)
    sigma_d, sigma_q = flux_map.sigma(i_d, i_q)
    sigma = np.hypot(sigma_d * i_q, sigma_q * i_d)
    scale = 1.5 * pole_pairs
    inside = np.isfinite(sigma)
    torque = scale * (psi[:, 0] * i_q - psi[:, 1] * i_d)
    return torque, scale * np.where(inside, sigma, 0.0), np.where(inside, 0.0, 1.0), (psi**2).sum(axis=1)


@dataclass(frozen=True, eq=False)
class _Motion:
    """A gap-free run under bells."""

    samples: Samples
    bell: FloatArray  # (2 H + 3,)
    stride: int  # samples from one bell to the next
    rows: FloatArray  # (W, C), see the columns above
    kept: NDArray[np.bool_]  # (W,), the rows that enter

    @classmethod
    def of(
        cls,
        flux_map: FluxMap,
        flux: _Flux,
        run: Samples,
        pole_pairs: int,
        disc: float,
        width: float,
        orders: Sequence[int],
    ) -> _Motion:
        """Put the run under bells of a width, s."""
        period = run.sample_period
        half = max(round(0.5 * width / period), 4)
        stride = max(2 * half // _BELLS, 1)
        bell = (1 - (np.arange(-half, half + 1) / (half + 0.5)) ** 2) ** 4
        bell /= bell.sum()
        padded = np.concatenate([[0.0, 0.0], bell, [0.0, 0.0]])
        slope, bend = (padded[2:] - padded[:-2]) / (2 * period), np.diff(padded, 2) / period**2
        wide = padded[1:-1]
        if len(run) < len(wide):
            return cls(run, wide, stride, np.zeros((0, _HARMONICS + _PER_ORDER * len(orders))), np.zeros(0, np.bool_))
        angle = np.unwrap(run.angle)
        speed = np.gradient(angle, period) / pole_pairs
        steady = np.convolve(speed, np.full(stride, 1 / stride), "same")
        slow = np.abs(steady) < _NEAR_REST * np.abs(steady).max()
        torque, sigma, outside, squares = _torque(flux_map, flux, run, pole_pairs)
        usual = np.mean((flux_map.psi_d**2 + flux_map.psi_q**2)[flux_map.inside])
        i_d, i_q = frames.to_dq(run.i_abc, run.angle).T
        factors = (np.ones(len(run)), i_d, i_q, i_d**2, i_d * i_q, i_q**2)
        waves = [by * wave(order * angle) for order in orders for by in factors for wave in (np.cos, np.sin)]

        def under(kernel: FloatArray, x: FloatArray) -> FloatArray:
            places = np.lib.stride_tricks.sliding_window_view(x, len(kernel))[::stride]
            return np.asarray(places @ kernel)

        acceleration = under(bend, angle) / pole_pairs
        columns = [
            under(wide, torque), under(wide, sigma), acceleration, disc * acceleration,
            -under(slope, angle) / pole_pairs, under(wide, np.sign(steady)),
        ]  # fmt: skip
        columns += [
            np.ones(len(acceleration), np.float64),
            under(wide, speed * (squares / usual - 1)),
            under(wide, np.where(slow, np.sign(steady), 0.0)),
            *(under(wide, wave) for wave in waves),
        ]
        size = under(wide, np.abs(steady))
        kept = (under(wide, outside) < _OUTSIDE) & (size > _RESTING * size.max())
        return cls(run, wide, stride, np.column_stack(columns), kept)

    def products(self, modes: ErrorModes, flux_map: FluxMap, pole_pairs: int, chosen: FloatArray) -> FloatArray:
        """Return the products (M, K) of combinations ``chosen`` (C, K) of the columns with the torque of each mode."""
        rows, count = np.where(self.kept[:, None], self.rows @ chosen, 0.0), len(self.rows)
        weights = np.zeros((len(self.samples), rows.shape[1]))
        for k, height in enumerate(self.bell):
            weights[k : k + self.stride * count : self.stride][:count] += height * rows
        i_dq = frames.to_dq(self.samples.i_abc, self.samples.angle)
        weights *= 1.5 * pole_pairs
        by_d = flux_map.collected(weights * i_dq[:, 1:], i_dq).reshape(-1, rows.shape[1])
        by_q = flux_map.collected(weights * -i_dq[:, :1], i_dq).reshape(-1, rows.shape[1])
        return modes.psi_d.reshape(len(modes), -1) @ by_d + modes.psi_q.reshape(len(modes), -1) @ by_q


def _statements(found: Mechanics) -> Iterator[Message]:
    values = {name: getattr(found, name) for name in ("explained", "inertia", "sigma_inertia", "gain", "sigma_gain")}
    if found.gain is None or found.sigma_gain is None:
        yield Message("motion", **values)
    else:
        confirmed = is_one(found.gain, found.sigma_gain)
        yield Message("motion.confirmed" if confirmed else "motion.gain", off=abs(found.gain - 1), **values)
    if not found.cogging and found.cogging_visible is not None:
        yield Message("cogging_unseen", visible=found.cogging_visible)
    if found.friction is None or found.viscous_friction is None:
        yield Message("friction_open")
