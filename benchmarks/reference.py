"""Analyses of six machines against a reference of its own: quintic splines and general-purpose optimizers.

    python benchmarks/reference.py [--write]

The reference shares no code with drive_id.analysis: scipy's splines of degree 5 through the same tables, a bounded
scalar search for MTPA, SLSQP from many starts for MTPV and the envelope. ``--write`` puts the table into the page
docs/engineering/control_measured.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np
from reporting import write_between
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import minimize, minimize_scalar

from drive_id.analysis.field_weakening import DriveLimits, envelope
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import mtpa, mtpv
from drive_id.fitting.result import Identification
from drive_id.types import FloatArray, MachineMap

_PAGE = Path(__file__).parent.parent / "docs" / "engineering" / "control_measured.md"
_RADIUS, _STEP, _PAIRS, _RESISTANCE, _LINK = 15.0, 0.75, 3, 0.45, 320.0
_STARTS = 12
_FIGURES = ("Torque", "L inside", "L at the border", "MTPA", "MTPV", "Envelope", "Inverse")


@dataclass(frozen=True, eq=False)
class Reference:
    """Fluxes of a table by splines of degree 5."""

    d: RectBivariateSpline
    q: RectBivariateSpline

    @classmethod
    def of(cls, table: MachineMap) -> Reference:
        """Interpolate the table."""
        return cls(*(RectBivariateSpline(table.i_d, table.i_q, psi, kx=5, ky=5) for psi in (table.psi_d, table.psi_q)))

    def psi(self, i_dq: FloatArray) -> FloatArray:
        """Return psi_d, psi_q (..., 2), Wb."""
        return np.stack([self.d.ev(*np.moveaxis(i_dq, -1, 0)), self.q.ev(*np.moveaxis(i_dq, -1, 0))], axis=-1)

    def torque(self, i_dq: FloatArray) -> FloatArray:
        """Return the torque (...), Nm."""
        psi = self.psi(i_dq)
        return np.asarray(1.5 * _PAIRS * (psi[..., 0] * i_dq[..., 1] - psi[..., 1] * i_dq[..., 0]))

    def inductances(self, i_dq: FloatArray) -> FloatArray:
        """Return the incremental inductances (N, 2, 2), H."""
        slopes = [[spline.ev(*i_dq.T, dx=1 - k, dy=k) for k in range(2)] for spline in (self.d, self.q)]
        return np.moveaxis(np.array(slopes), -1, 0)

    def voltage(self, i_dq: FloatArray, speed: float) -> float:
        """Return the voltage amplitude, V, at a mechanical speed, rad/s."""
        psi = self.psi(i_dq)
        omega = _PAIRS * speed
        return float(np.hypot(_RESISTANCE * i_dq[0] - omega * psi[1], _RESISTANCE * i_dq[1] + omega * psi[0]))


def _saturating(i_d: FloatArray, i_q: FloatArray, magnet: float, l_d: float) -> tuple[FloatArray, FloatArray]:
    """Return gradients of a co-energy that saturates along both axes, and across."""
    s = np.sqrt(1 + (i_d / 20) ** 2 + (i_q / 8) ** 2)
    return magnet + l_d * i_d / s + 0.002 * i_d, l_d * 400 / 64 * i_q / s + 0.003 * i_q


def machines() -> dict[str, tuple[Identification, MachineMap]]:
    """Return results with exact maps, and their tables."""
    sys.path.insert(0, str(Path(__file__).parent.parent / "test" / "support"))  # where exact results are
    exact_result = import_module("exact_results").exact_result
    axis = np.arange(-20.25, 20.26, _STEP)
    half = axis[axis >= 0]

    def table(name: str, i_q: FloatArray, psi: tuple[FloatArray, FloatArray]) -> MachineMap:
        return MachineMap(name, axis, i_q, *psi, _RESISTANCE, _PAIRS, _RADIUS, _LINK)

    d, q = np.meshgrid(axis, axis, indexing="ij")
    ipm = _saturating(d, q, 0.1, 0.0075)
    dent = np.exp(-((d / 1.0) ** 2 + (q / 1.0) ** 2))
    tables = [
        table("IPM", axis, ipm),
        table("IPM, half plane", half, _saturating(d[:, axis >= 0], q[:, axis >= 0], 0.1, 0.0075)),
        table("IPM with a notch at zero", axis, (ipm[0] - 0.012 * d * dent, ipm[1] - 0.012 * q * dent)),
        table("SPM, linear", axis, (0.1 + 0.008 * d, 0.008 * q)),
        table("SynRM", axis, _saturating(d, q, 0.0, 0.03)),
        table("IPM, data to 0.75 i_max", axis, ipm),
    ]
    out = {entry.name: (exact_result(entry), entry) for entry in tables}
    found, entry = out[tables[-1].name]
    seen = replace(found.flux_map, inside=np.hypot(d, q) <= 0.75 * _RADIUS)
    out[entry.name] = replace(found, drive=replace(found.drive, flux_map=seen)), entry
    return out


def figures(result: Identification, table: MachineMap) -> list[float]:
    """Return the largest difference of each quantity, relative; NaN where there is none."""
    model, reference = MachineModel.of(result), Reference.of(table)
    rng = np.random.default_rng(1)
    points = rng.uniform(-_RADIUS, _RADIUS, (4000, 2))
    points = points[(np.hypot(*points.T) <= _RADIUS) & model.inside(*points.T)]
    deep = np.all(
        [model.inside(*(points + shift).T) for shift in _STEP * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])], 0
    )
    largest = float(np.abs(reference.torque(points)).max())
    slopes = reference.inductances(points)
    apart = np.abs(model.inductances(*points.T) - slopes).max(axis=(1, 2)) / np.median(np.abs(slopes[:, 0, 0]))
    psi = reference.psi(points)
    back = np.stack(model.current(*psi.T), axis=-1)
    off = np.hypot(*(back - points).T)[deep] / _RADIUS
    return [
        float(np.abs(model.torque(*points.T) - reference.torque(points)).max()) / largest,
        float(apart[deep].max()),
        float(apart[~deep].max()) if (~deep).any() else math.nan,
        _mtpa(model, reference),
        _mtpv(model, reference),
        _envelope(model, reference),
        float(np.nanmax(off)) if model.monotone_inside else math.nan,
    ]


def _mtpa(model: MachineModel, reference: Reference) -> float:
    """Return the largest share of torque that our angles give away."""
    found, lost = mtpa(model, _RADIUS, 16), []
    for current, i_d, i_q, inside in zip(found.current, found.i_d, found.i_q, found.inside, strict=True):
        if current < 1.0 or not inside:
            continue

        def torque(angle: float, current: float = current) -> float:
            return -float(reference.torque(current * np.array([math.cos(angle), math.sin(angle)])))

        scan = np.linspace(0.05, math.pi - 0.05, 60)
        best = scan[int(np.argmin([torque(angle) for angle in scan]))]
        most = -minimize_scalar(
            torque, bounds=(best - 0.06, best + 0.06), method="bounded", options={"xatol": 1e-9}
        ).fun
        lost.append((most - float(reference.torque(np.array([i_d, i_q])))) / most)
    return float(max(lost))


def _most(reference: Reference, constraints: list[dict[str, object]], start: FloatArray | None = None) -> float:
    """Return the largest torque within constraints, from many starts, Nm."""
    best, rng = -math.inf, np.random.default_rng(2)
    starts = rng.uniform([-_RADIUS, 0.0], [_RADIUS, _RADIUS], (_STARTS, 2))
    for i_dq in starts if start is None else [start, *starts]:
        found = minimize(
            lambda x: -float(reference.torque(x)),
            i_dq,
            method="SLSQP",
            constraints=constraints,
            options={"ftol": 1e-12},
        )
        if found.success and all(float(entry["fun"](found.x)) > -1e-6 for entry in constraints):  # type: ignore[operator]
            best = max(best, -found.fun)
    return best


def _mtpv(model: MachineModel, reference: Reference) -> float:
    """Return the largest share of torque that our points give away at their flux; NaN without MTPV."""
    found, lost = mtpv(model, _RADIUS, 16), []
    for i_d, i_q, inside in zip(found.i_d, found.i_q, found.inside, strict=True):
        point = np.array([i_d, i_q])
        flux = float(np.hypot(*reference.psi(point)))
        if not inside or float(reference.torque(point)) < 1e-2:
            continue
        within = [
            {"type": "ineq", "fun": lambda x, flux=flux: flux**2 - float(np.sum(reference.psi(x) ** 2))},
            {"type": "ineq", "fun": lambda x: (1.2 * _RADIUS) ** 2 - float(x @ x)},
        ]
        most = _most(reference, within, point)
        lost.append((most - float(reference.torque(point))) / most)
    return max(lost, default=math.nan)


def _envelope(model: MachineModel, reference: Reference) -> float:
    """Return the largest difference of the torque at six speeds, relative to the largest; NaN without data there."""
    limit = _LINK / math.sqrt(3)
    speed = np.linspace(0.0, 1200.0, 6)
    found = envelope(model, DriveLimits(_RADIUS, limit), speed)
    largest, apart = float(np.nanmax(found.torque)), []
    for k, torque in enumerate(found.torque):
        if not (np.isfinite(torque) and model.inside(*found.i_dq[k])):
            continue
        within = [
            {"type": "ineq", "fun": lambda x: _RADIUS**2 - float(x @ x)},
            {"type": "ineq", "fun": lambda x, w=speed[k]: limit**2 - reference.voltage(x, float(w)) ** 2},
        ]
        apart.append(abs(_most(reference, within, found.i_dq[k]) - float(torque)) / largest)
    return max(apart, default=math.nan)


def main() -> None:
    """Print the table, and write it if wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write it into docs/engineering/control_measured.md")
    wanted = parser.parse_args()
    lines = [f"| Machine | {' | '.join(_FIGURES)} |", "|---|" + "---:|" * len(_FIGURES)]
    for name, (result, table) in machines().items():
        shown = " | ".join("" if math.isnan(value) else f"{value:.0e}" for value in figures(result, table))
        lines.append(f"| {name} | {shown} |")
        print(lines[-1], flush=True)
    if wanted.write:
        write_between(_PAGE, "benchmarks/reference.py", "\n".join(lines))


if __name__ == "__main__":
    main()
