"""Plausibility of samples before they are fitted: errors where a map would be wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drive_id.errors import CoverageError, DataError, StandstillError
from drive_id.types import FloatArray, Samples

_NOISE_SHARE = 0.1
_RESOLVER_TOLERANCE = 0.02
_LEAST_TURN = 2 * np.pi
WINDOW = 128
"""Advances of the rotor that are summed before speed and angle are compared."""

USUAL_QUANTILE = 0.999
_SPIKE_FACTOR = 10.0
_JUMP = 0.2
_JUMP_FACTOR = 5.0
_REMEDY = "drive the machine along a trajectory that fills the current disc, such as a Lissajous figure."


def check_rotation(recordings: Sequence[Samples]) -> None:
    """Check that the machine turns and that the resolver's angle and speed tell the same story.

    Raises
    ------
    StandstillError
        When it turned by less than one electrical revolution: without speed, the flux induces no voltage.
    DataError
        When the angle does not advance as the speed says (mechanical for electrical units, sign, wrong field).
    """
    turns = [advances(samples, run) for samples in recordings for run in samples.runs()]
    for samples in recordings:
        _check_jumps(samples)
    expected, advance = (np.concatenate(parts) for parts in zip(*turns, strict=True))
    turned = max(_range(np.cumsum(expected)), _range(np.cumsum(advance)))
    starts = np.arange(0, len(expected), WINDOW)  # sums over windows: noise of the speed would pull the ratio to zero
    if len(expected):
        expected, advance = np.add.reduceat(expected, starts), np.add.reduceat(advance, starts)
    judge_rotation(turned, float(expected @ expected), float(expected @ advance))


def _check_jumps(samples: Samples) -> None:
    """Refuse single samples at which the angle jumps away from where the speed takes it."""
    deviation = np.zeros(len(samples))
    for run in samples.runs():
        expected, advance = advances(samples, run)
        deviation[run][1:] = np.abs(np.angle(np.exp(1j * (advance - expected))))
    usual = float(np.quantile(deviation, USUAL_QUANTILE))
    jumps = np.flatnonzero(deviation > jump_limit(usual))
    if len(jumps):
        at = (samples.stamp[jumps[0]] - samples.stamp[0]) * 1e-9
        raise jump_error(len(jumps), at, deviation[jumps[0]])


def jump_limit(usual: float) -> float:
    """Return the distance, rad, beyond which the angle jumps, from the one that all but a few samples stay below."""
    return max(_JUMP, _JUMP_FACTOR * usual)


def jump_error(count: int, at: float, by: float) -> DataError:
    """Return the error for jumps of the angle, the first of which is ``by``, rad, ``at`` so many seconds."""
    return DataError(
        f"The resolver's angle or speed jumps in {count} places, the first at {at:.6f} s by "
        f"{by:.2f} rad within one sample: repair or cut out the faulty samples."
    )


def judge_rotation(turned: float, square: float, product: float) -> None:
    """Judge what is known of the rotation; see :func:`check_rotation`.

    Parameters
    ----------
    turned : float
        Range of the angle or of the integrated speed, whichever is larger, rad.
    square, product : float
        Over all windows of time, the sum of the squared turns by the speed, and that of their products with the turns
        by the angle, rad^2.
    """
    if turned < _LEAST_TURN:
        raise StandstillError(
            f"The machine turned by only {turned / (2 * np.pi):.2f} electrical revolutions: without speed its flux "
            "induces no voltage, so record while it turns."
        )
    ratio = product / square if square > 0 else 0.0
    if not abs(ratio - 1) <= _RESOLVER_TOLERANCE:
        raise DataError(
            f"The resolver's angle advances {ratio:.3f} times as fast as its speed says: give both in electrical "
            "radians (set the pole pairs or the scale in the signals file) and with the same sign."
        )


def check_trajectory(recordings: Sequence[Samples], i_dq: Sequence[FloatArray]) -> None:
    """Check that the currents move by more than their noise, and that none is beyond all others.

    Parameters
    ----------
    recordings : sequence of Samples
    i_dq : sequence of (N, 2) float
        Their currents in the rotor frame, A.

    Raises
    ------
    CoverageError
        When the references stand still, or a step from sample to sample is as large as the whole range.
    DataError
        When a few currents are many times larger than all others.
    """
    _check_references(recordings)
    low = np.min([i.min(axis=0) for i in i_dq], axis=0)
    high = np.max([i.max(axis=0) for i in i_dq], axis=0)
    steps = [np.diff(i[run], axis=0) for samples, i in zip(recordings, i_dq, strict=True) for run in samples.runs()]
    scale = max(float(np.max(high - low)), np.finfo(np.float64).tiny)  # squares of absurd currents must not overflow
    step = scale * np.sqrt(np.mean((np.concatenate(steps) / scale) ** 2, axis=0))
    amplitude = np.concatenate([np.hypot(*i.T) for i in i_dq])
    judge_trajectory(low, high, step, float(amplitude.max()), float(np.quantile(amplitude, USUAL_QUANTILE)))


def judge_trajectory(low: FloatArray, high: FloatArray, step: FloatArray, largest: float, usual: float) -> None:
    """Judge what is known of the currents, A; see :func:`check_trajectory`.

    Parameters
    ----------
    low, high : (2,) float
        Range of i_d and i_q.
    step : (2,) float
        Root mean square of their steps from sample to sample.
    largest, usual : float
        Largest amplitude, and the one that all but a few samples stay below.
    """
    if np.any(step >= _NOISE_SHARE * (high - low)):
        worst = int(np.argmax(step / np.maximum(high - low, 1e-300)))
        raise CoverageError(
            f"The current i_{'dq'[worst]} stays within {float((high - low)[worst]):.3g} A and shows only noise: "
            f"{_REMEDY}"
        )
    if largest > _SPIKE_FACTOR * usual:
        raise DataError(
            f"A current of {largest:.4g} A stands out where {100 * USUAL_QUANTILE:.1f} % of all samples stay below "
            f"{usual:.4g} A: repair or cut out the faulty samples."
        )


def _check_references(recordings: Sequence[Samples]) -> None:
    """Refuse an operating point that is held: what is left to see are ripple and noise around it."""
    references = [samples.i_dq_reference for samples in recordings if samples.i_dq_reference is not None]
    if len(references) < len(recordings) or not all(np.isfinite(reference).all() for reference in references):
        return
    held = np.ptp(np.concatenate(references), axis=0)
    if not held.any():
        raise held_error(*references[0][0])


def held_error(d: float, q: float) -> CoverageError:
    """Return the error for references that stay at one point, A."""
    return CoverageError(f"The current references stay at i_d = {d:.4g} A, i_q = {q:.4g} A throughout: {_REMEDY}")


def advances(samples: Samples, run: slice) -> tuple[FloatArray, FloatArray]:
    """Return by how much the rotor turns from sample to sample, as the speed and as the angle have it, rad."""
    expected: FloatArray = samples.speed[run][:-1] * samples.sample_period
    return expected, np.angle(np.exp(1j * np.diff(samples.angle[run])))


def _range(values: FloatArray) -> float:
    return float(np.ptp(values)) if len(values) else 0.0
