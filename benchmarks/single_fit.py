"""One solution of method ``full`` for a given choice, without the choosing: for the ablation."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from judging import normalized_curve
from scipy import linalg, sparse

from drive_id.bench.drive import Simulation
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.model import RESISTANCE, VOLTAGE, FullModel, ModelSpec, roughness, sum_basis
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.result.identify import gather
from drive_id.core.validation.metrics import nrmse, true_flux
from drive_id.types import FloatArray

Errors = tuple[float, float, float, float]
"""Of psi_d, psi_q, R and the inverter's curve, relative."""

_CURVE_POINTS = 201
_JITTER = 1e-13


def solved(scaled: FloatArray, moment: FloatArray) -> FloatArray:
    """Solve equations with a diagonal of ones, which instruments make asymmetric; nearly singular ones, too."""
    return np.asarray(linalg.solve(scaled + _JITTER * np.eye(len(moment)), moment))


class Accumulation:
    """The windows of one simulated experiment.

    Parameters
    ----------
    simulation : Simulation
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.evidence = gather([simulation.samples], FitSettings(method="full"))
        assert self.evidence.windows is not None
        self.information: WindowSums = self.evidence.windows.finished().freed(FitSettings().harmonic_orders)

    @property
    def model(self) -> FullModel:
        """What is fitted."""
        return self.information.model

    @cached_property
    def total(self) -> FloatArray:
        """Z'Z, (size, size)."""
        return np.asarray(self.information.folds.sum(axis=0))

    def solved(self, choice: ModelSpec, shape: int | None = None, products: FloatArray | None = None) -> Errors:
        """Solve, and compare with the truth.

        Parameters
        ----------
        choice : ModelSpec
        shape : int, optional
            The only one of the inverter's shapes to use.
        products : (size, size) float, optional
            Z'X of instruments Z and regressors X. Default: those of the regressors themselves.
        """
        return self.errors(self.estimate(choice, shape, products))

    def estimate(self, choice: ModelSpec, shape: int | None = None, products: FloatArray | None = None) -> FloatArray:
        """Return the columns' coefficients (size,), see :meth:`solved`."""
        t = self._basis(choice, shape)
        products = self.total if products is None else products
        penalty = t.T @ roughness(self.model, self.total, choice.penalty) @ t
        normal = t.T @ (t.T @ products.T).T + penalty.toarray()
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-24 * np.diag(normal).max()))
        moment = t.T @ products[:, VOLTAGE]
        x = solved(normal / scale[:, None] / scale, moment / scale) / scale
        return np.asarray(t @ x)

    @cached_property
    def places(self) -> tuple[FloatArray, FloatArray]:
        """Currents (N, 2), A, of the map with data and a known truth, and the true fluxes there (N, 2), Wb."""
        truth, grid = self.simulation.truth, self.evidence.visits.grid()
        i_dq = grid[self.evidence.inside() & (np.hypot(grid[..., 0], grid[..., 1]) <= truth.i_max)]
        true_psi = true_flux(truth, i_dq)
        known = np.isfinite(true_psi).all(axis=1)
        return i_dq[known], true_psi[known]

    def errors(self, estimate: FloatArray) -> Errors:
        """Compare an estimate (size,) with the truth, as :func:`judging.judge` does."""
        truth, model = self.simulation.truth, self.model
        i_dq, true_psi = self.places
        flux = nrmse(model.flux.rows(i_dq).dot(estimate[model.map]), true_psi)
        current = np.linspace(-self.evidence.i_max, self.evidence.i_max, _CURVE_POINTS)
        slope, curve = normalized_curve(truth, current)
        drop = (model.shapes(current) @ estimate[model.phase_columns()]).mean(axis=1)
        off = float(np.sqrt(np.mean((drop - curve) ** 2)) / np.abs(curve).max())
        return *flux, abs(float(estimate[RESISTANCE]) / (truth.resistance + slope) - 1), off

    def _basis(self, choice: ModelSpec, shape: int | None) -> sparse.csr_array:
        t = sum_basis(self.model, choice)
        if shape is None:
            return t
        kept = self.model.phase_columns()[shape]
        others = np.setdiff1d(self.model.phase_columns().ravel(), kept)
        return sparse.csr_array(t[:, np.asarray(abs(t[others]).sum(axis=0)).ravel() == 0])
