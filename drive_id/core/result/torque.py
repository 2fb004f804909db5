"""The measured shaft torque against that of the flux map: common gain, friction, cogging."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.block_regression import SIGNIFICANT, BlockRegression, grouped, is_one
from drive_id.core.result.identification import Cogging, IdentifiedDrive, TorqueFit
from drive_id.types import FloatArray, Samples

MOST_ORDER = 24
"""Highest electrical order of cogging that is looked for."""
_CHUNK = 1 << 15
"""Samples at a time, which bounds the memory."""
_BLOCKS = 40
"""Blocks of time, about, between which the residuals scatter."""
_FEWEST_BLOCKS = 8
"""Blocks below which their scatter is no standard error."""
_LARGEST_GAIN_ERROR = 0.05  # beyond which a warning says so
_SPEEDS_APART = 1.2  # fastest over slowest speed from which on viscous friction is told from Coulomb's
_SAMPLES_PER_PERIOD = 8.0
"""Samples of the torque signal per period of the highest order, so that interpolation takes away less than 5 %."""


def with_torque(drive: IdentifiedDrive, excerpts: Sequence[Samples], pole_pairs: int | None) -> IdentifiedDrive:
    """Return the drive with what the shaft torque in the excerpts says of it; the same drive where there is none.

    Without pole pairs, a statement says that they are unknown.
    """
    pieces = [piece for piece in excerpts if piece.shaft_torque is not None]
    if not pieces:
        return drive
    if pole_pairs is None:
        return replace(drive, statements=(*drive.statements, Message("torque_not_compared.pole_pairs")))
    found = fit_torque(drive.flux_map, drive.corrected(pieces), pole_pairs)
    if found is None:
        return replace(drive, statements=(*drive.statements, Message("torque_not_compared.few")))
    warnings = (*drive.report.warnings, *_warnings(found))
    return replace(
        drive,
        torque=found,
        statements=(*drive.statements, _statement(found)),
        report=replace(drive.report, warnings=warnings),
    )


@one_blas_thread()
def fit_torque(flux_map: FluxMap, pieces: Sequence[Samples], pole_pairs: int) -> TorqueFit | None:
    """Fit gain, friction and cogging to the shaft torque of those pieces that have one.

    Linear least squares over sums per block of time, so that memory does not grow with the samples. Standard errors
    come from the scatter between the blocks, because neighbouring residuals are correlated, and from those of the map.
    None with too few samples of known torque within the map.
    """
    total = sum(len(piece) for piece in pieces)
    size = max(total // _BLOCKS, 1)
    orders = _resolved_orders(pieces)
    blocks: list[FloatArray] = []
    speeds: list[FloatArray] = []  # the range in each block
    signs: set[float] = set()
    for piece in pieces:
        for start in range(0, len(piece), min(size, _CHUNK)):
            part = piece.part(start, min(start + min(size, _CHUNK), len(piece)))
            rows = _rows(flux_map, part, pole_pairs, orders)
            if len(rows):
                blocks.append(rows.T @ rows)
                speeds.append(np.percentile(np.abs(rows[:, _SPEED]), [5, 95]))
                signs |= set(np.sign(rows[:, _SPEED]).tolist())
    blocks = grouped(blocks, _BLOCKS)
    if len(blocks) < _FEWEST_BLOCKS:
        return None
    slow, fast = np.min(speeds, axis=0)[0], np.max(speeds, axis=0)[1]
    base = [_GAIN, _FRICTION]
    if fast > _SPEEDS_APART * slow:
        base.append(_SPEED)
    if len(signs) > 1:
        base.append(_OFFSET)
    every = [*base, *range(_HARMONICS, _HARMONICS + 2 * len(orders))]
    solution = BlockRegression.of(np.array(blocks), _TORQUE, every)
    kept = [(k, order) for k, order in enumerate(orders) if solution.wald(_HARMONICS + 2 * k) > SIGNIFICANT]
    columns = [*base, *(_HARMONICS + 2 * k + part for k, _ in kept for part in (0, 1))]
    solution = BlockRegression.of(np.array(blocks), _TORQUE, columns)

    def estimate(column: int) -> tuple[float, float]:
        """Return a coefficient and its standard error, for which errors of the map count as common to all currents."""
        value, sigma = solution.estimate(column)
        return value, float(np.sqrt(sigma**2 + solution.total[_MAP, _MAP] / solution.total[column, column]))

    viscous, offset = (estimate(c) if c in columns else (None, None) for c in (_SPEED, _OFFSET))
    gain, friction = estimate(_GAIN), estimate(_FRICTION)
    samples = int(solution.total[_OFFSET, _OFFSET])
    unit = solution.coefficients.copy()
    unit[columns.index(_GAIN)] = 1.0
    return TorqueFit(
        gain=gain[0],
        sigma_gain=gain[1],
        friction=friction[0],
        sigma_friction=friction[1],
        viscous_friction=viscous[0],
        sigma_viscous_friction=viscous[1],
        offset=offset[0],
        sigma_offset=offset[1],
        cogging=tuple(Cogging(order, *solution.amplitude(_HARMONICS + 2 * k)) for k, order in kept),
        rms_map=solution.rms(unit, samples),
        rms_residual=solution.rms(solution.coefficients, samples),
        pole_pairs=pole_pairs,
        samples=samples,
    )


_TORQUE, _GAIN, _FRICTION, _SPEED, _OFFSET, _MAP, _HARMONICS = range(7)
"""Columns: measured torque, torque of the map, direction, mechanical speed, 1, standard error of the map's torque, and
from the last one on cosines and sines of the harmonics."""


def _rows(flux_map: FluxMap, samples: Samples, pole_pairs: int, orders: Sequence[int]) -> FloatArray:
    """Return the rows (N, 6 + 2H) of the samples with a known torque within the map, that turn."""
    torque = samples.shaft_torque
    if torque is None:
        return np.zeros((0, _HARMONICS + 2 * len(orders)))
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    psi_d, psi_q = flux_map.psi_dq(i_dq[:, 0], i_dq[:, 1])
    of_map = 1.5 * pole_pairs * (psi_d * i_dq[:, 1] - psi_q * i_dq[:, 0])
    speed = samples.speed / pole_pairs
    known = np.isfinite(torque) & np.isfinite(of_map) & (speed != 0)
    angle = samples.angle[known]
    sigma_d, sigma_q = flux_map.sigma(i_dq[known, 0], i_dq[known, 1])
    sigma = 1.5 * pole_pairs * np.hypot(sigma_d * i_dq[known, 1], sigma_q * i_dq[known, 0])
    columns = [torque[known], of_map[known], -np.sign(speed[known]), -speed[known], np.ones(int(known.sum()))]
    columns.append(np.where(np.isfinite(sigma), sigma, 0.0))
    columns += [-wave(order * angle) for order in orders for wave in (np.cos, np.sin)]
    return np.column_stack(columns)


def _resolved_orders(pieces: Sequence[Samples]) -> list[int]:
    """Return the electrical orders that the torque signal resolves: between its own samples it is a straight line."""
    bends = count = turned = time = 0.0
    for piece in pieces:
        torque = piece.shaft_torque
        if torque is None:
            continue
        second = np.abs(np.diff(torque[np.isfinite(torque)], 2))
        bends += float(np.sum(second > 1e-9 * np.nanmax(np.abs(torque), initial=0.0)))
        count += len(second)
        turned += float(np.sum(np.abs(piece.speed))) * piece.sample_period
        time += piece.duration
    if not (bends and turned):
        return []
    rate, turns = bends / max(count, 1.0) / (time / sum(map(len, pieces))), turned / time / (2 * np.pi)
    highest = int(min(MOST_ORDER, rate / (_SAMPLES_PER_PERIOD * turns)))
    return list(range(1, highest + 1))


def _statement(found: TorqueFit) -> Message:
    return Message(
        "torque.confirmed" if is_one(found.gain, found.sigma_gain) else "torque",
        off=abs(found.gain - 1),
        gain=found.gain,
        sigma_gain=found.sigma_gain,
        rms_map=found.rms_map,
        rms_residual=found.rms_residual,
    )


def _warnings(found: TorqueFit) -> Iterator[Message]:
    if found.gain < 0:
        yield Message("torque_differs.negative", gain=found.gain)
    elif abs(found.gain - 1.0) > max(_LARGEST_GAIN_ERROR, 3 * found.sigma_gain):
        yield Message("torque_differs", gain=found.gain, pole_pairs=found.pole_pairs)
