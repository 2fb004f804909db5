"""Instrumental variables for the windows of method ``full``: bias by current noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import sparse
from single_fit import Accumulation, Errors, solved

from drive_id.bench.drive import Simulation
from drive_id.core import frames
from drive_id.core.full.model import RESISTANCE, SHIFT, VOLTAGE, FullModel, ModelSpec, roughness, sum_basis
from drive_id.core.full.windows import SHIFTS, Windows
from drive_id.core.maps.coenergy import GradientSpline
from drive_id.core.maps.flux_models import TensorSpline, fitted, sites
from drive_id.core.numerics.bspline import Axis
from drive_id.core.validation.current_simulation import simulate_current
from drive_id.types import FloatArray, IntArray

_LONGEST_LAG = 40  # samples
_FINE = 72


def compared(simulation: Simulation, choice: ModelSpec) -> Iterator[tuple[str, Errors, float]]:
    """Yield the name of each estimator, its errors, and the delay of the voltages that it finds, samples."""
    data = Accumulation(simulation)
    windows = Windows.joined(data.information.kept())
    begin, end = _places(windows, simulation)
    regressors = _rows(data.model, windows)
    measured = frames.to_dq(simulation.samples.i_abc, simulation.samples.angle)
    first = data.estimate(choice)
    sources = {
        "instruments: references, lagged to fit": _lagged(simulation.samples.i_dq_reference, measured),
        "instruments: currents simulated from the first fit": _simulated(data, first, choice),
        "instruments: true currents": simulation.i_dq_true,
    }
    products = regressors.T @ regressors
    yield "least squares", data.solved(choice, products=products), _delay(data, choice, products)
    for name, i_dq in sources.items():
        rows = _rows(data.model, replace(windows, i_dq=np.stack([i_dq[begin], i_dq[end]], axis=1)))
        products = rows.T @ regressors
        yield name, data.solved(choice, products=products), _delay(data, choice, products)
    products = rows.T @ rows
    name = "least squares, true currents at the ends of the windows"
    yield name, data.solved(choice, products=products), _delay(data, choice, products)


def _delay(data: Accumulation, choice: ModelSpec, products: FloatArray) -> float:
    """Estimate a delay of the voltages of up to a sample as one more unknown, its column being its own instrument."""
    model, t = data.model, sum_basis(data.model, choice)
    penalty = t.T @ roughness(model, data.total, choice.penalty) @ t
    voltage, shift = VOLTAGE, SHIFT.start + SHIFTS.index(-1)
    normal = np.block(
        [
            [t.T @ (t.T @ products.T).T + penalty.toarray(), (t.T @ products[:, shift])[:, None]],
            [(t.T @ products[shift])[None], products[shift, shift]],
        ]
    )
    scale = np.sqrt(np.diag(normal))
    moment = np.append(t.T @ products[:, voltage], products[shift, voltage]) / scale
    return float(solved(normal / scale[:, None] / scale, moment)[-1] / scale[-1])


def _places(windows: Windows, simulation: Simulation) -> tuple[IntArray, IntArray]:
    """Return the samples where the windows start and end, (N,) each; the recording has no gaps."""
    period = simulation.samples.sample_period
    begin = np.rint(windows.time / period).astype(np.int64)
    end = begin + np.rint(windows.duration / period).astype(np.int64)
    assert np.array_equal(simulation.samples.angle[begin], windows.angle[:, 0])
    assert np.array_equal(simulation.samples.angle[end], windows.angle[:, 1])
    return begin, end


def _rows(model: FullModel, windows: Windows) -> FloatArray:
    """Return the regression's rows (2 N, size)."""
    each = sparse.eye_array(model.size, format="csr")
    return model.design_times(windows, each, model.orders).reshape(-1, model.size)


def _lagged(reference: FloatArray | None, measured: FloatArray) -> FloatArray:
    """Delay the references (N, 2) by as many samples as fit the measured currents best."""
    assert reference is not None
    errors = [
        np.sum((measured[_LONGEST_LAG:] - reference[_LONGEST_LAG - lag : len(reference) - lag]) ** 2)
        for lag in range(_LONGEST_LAG)
    ]
    lag = int(np.argmin(errors))
    return np.concatenate([np.repeat(reference[:1], lag, axis=0), reference[: len(reference) - lag]])


def _simulated(data: Accumulation, estimate: FloatArray, choice: ModelSpec) -> FloatArray:
    """Simulate the currents (N, 2) open loop with an estimate (size,)."""
    model, evidence = data.model, data.evidence
    d, q = (Axis(axis.low, axis.high, _FINE) for axis in (evidence.d, evidence.q))
    places = sites(d, q, 2)
    points = places.reshape(-1, 2)

    def spline(space: GradientSpline, gamma: FloatArray) -> FloatArray:
        psi = space.rows(points).dot(gamma)
        return fitted(psi.reshape(places.shape), d, q)

    harmonics = {}
    for order in choice.orders:
        a, b = np.split(estimate[model.harmonics[order]], 2)
        harmonics[order] = spline(model.harmonic, a), spline(model.harmonic, b)
    current = np.linspace(-1.2 * evidence.i_max, 1.2 * evidence.i_max, 1001)
    drop = (model.shapes(current) @ estimate[model.phase_columns()]).mean(axis=1)
    samples, gamma = data.simulation.samples, spline(model.flux, estimate[model.map])
    return simulate_current(samples, TensorSpline(d, q), gamma, harmonics, float(estimate[RESISTANCE]), (current, drop))
