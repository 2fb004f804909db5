"""What is fitted, as congruences of the columns of :class:`~drive_id.core.full.model.FullModel`: ``x -> Z T x``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from drive_id.core.full.model import CONSTANT, MAGNET, RESISTANCE, SENSOR_ORDERS, FullModel
from drive_id.core.full.windows import SHIFTS
from drive_id.types import FloatArray

PENALTIES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Weights of the map's roughness to try, relative to the mean information of a coefficient."""

_HARMONIC_RIDGE = 0.1
"""Relative to the mean information of a coefficient of the map, of which a harmonic's has many times as much: where
the trajectory and the rotor repeat together, so that harmonics and map cannot be told apart, the map gets the flux."""

_DROP_RIDGE = 1e-7


@dataclass(frozen=True)
class Choice:
    """What is fitted.

    Parameters
    ----------
    reciprocal : bool
        The maps are gradients of a co-energy.
    orders : tuple of int
        Harmonics in use, those of the sensors included.
    per_phase : bool
        One inverter curve for each phase.
    inverter : bool
        With an inverter curve at all.
    constant : bool
        With a constant voltage in the stator frame.
    penalty : float
        Of the map's roughness.
    delay : float
        By which the voltages act later than recorded, samples.
    magnet : bool
        With a magnet's flux that changes with the temperature.
    lag : bool
        With what a drive leaves that compensates its inverter by earlier currents.
    """

    reciprocal: bool
    orders: tuple[int, ...]
    per_phase: bool = False
    inverter: bool = True
    constant: bool = True
    penalty: float = PENALTIES[0]
    delay: float = 0.0
    magnet: bool = False
    lag: bool = False


def delay_shares(delay: float) -> FloatArray:
    """Return the voltage columns' weights (len(SHIFTS),) for a delay in samples, -4 to 4.

    The commanded voltage is held, so that a delay of a part of a sample takes just that part of the sample before.
    """
    shares = []
    for shift in SHIFTS:
        if shift < 0:
            shares.append(np.clip(delay + shift + 1, 0.0, 1.0))
        else:
            shares.append(-np.clip(-delay - shift, 0.0, 1.0))
    return np.array(shares)


def basis(model: FullModel, choice: Choice) -> sparse.csr_array:
    """Return T (size, M), from the unknowns of a choice to the columns of the regression."""
    size, parts = model.size, []

    def place(block: sparse.sparray | FloatArray, first: int) -> None:
        block = sparse.coo_array(block)
        parts.append(sparse.coo_array((block.data, (block.coords[0] + first, block.coords[1])), (size, block.shape[1])))

    place(np.ones((1, 1)), RESISTANCE)
    if choice.constant:
        place(np.eye(2), CONSTANT.start)
    if choice.magnet:
        place(np.ones((1, 1)), MAGNET)
    if choice.inverter:
        shapes = len(model.shapes.scales)
        drops = np.eye(3 * shapes) if choice.per_phase else np.kron(np.eye(shapes), np.ones((3, 1)))
        place(drops, model.drops.start)
    if choice.lag:
        place(np.eye(len(model.shapes.coarse.scales)), model.lags.start)
    gradient = model.flux.gradient
    place(gradient[:, 1:] if choice.reciprocal else sparse.eye_array(model.flux.parameters), model.map.start)
    for order in choice.orders:
        space = model.space(order)
        free = order in SENSOR_ORDERS or not choice.reciprocal
        one = sparse.eye_array(space.parameters) if free else space.gradient[:, 1:]
        place(sparse.block_diag([one, one]), model.harmonics[order].start)
    return sparse.csr_array(sparse.hstack(parts))


def roughness(model: FullModel, total: FloatArray, penalty: float) -> sparse.csr_array:
    """Return the penalty on the columns (size, size): of second differences of the map, slight ridges elsewhere."""
    diagonal = np.diag(total)
    unit = float(diagonal[model.map].mean())
    ridge = np.zeros(model.size)
    for columns in model.harmonics.values():
        ridge[columns] = _HARMONIC_RIDGE * unit
    for inverter in (model.drops, model.lags):
        ridge[inverter] = _DROP_RIDGE * float(diagonal[inverter].mean())
    before, after = model.map.start, model.size - model.map.stop
    rough = sparse.block_diag(
        [sparse.csr_array((before, before)), penalty * unit * model.flux.roughness, sparse.csr_array((after, after))]
    )
    return sparse.csr_array(rough + sparse.diags_array(ridge))
