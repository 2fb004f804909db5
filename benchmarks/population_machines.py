"""Random machines of the population, each the gradient of a co-energy that is not that of the shipped machines.

In units of i_max and of the largest flux, with v = (x + x_f, y) and r^2 = v Q v, the co-energy is

    W = psi_0 x + 1/2 l_d x^2 + 1/2 l_q y^2 + E F(r) + psi_b i_b (1 + c x) ln cosh(y / i_b)
        + sum_h [cos(h theta + phi_h) (a_h x + k_h E F(r)) + sin(h theta + phi_h) (b_h y + m_h x y / s)],

    F'(r) = r (1 + r^n)^(-1/n),        s = sqrt(1 + x^2 + y^2).

n is the sharpness of saturation, an off-diagonal Q cross-magnetises (no mirror symmetry), and psi_b, i_b belong to a
saturating bridge of the rotor. A *measured* machine is known on a coarse, rough grid only: the gradient of a quintic
spline of its co-energy, or, not quite reciprocal, monotone cubics (pchip) of its fluxes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator, RectBivariateSpline

from drive_id.types import FloatArray, MachineMap

FAMILIES = ("ipm", "bridge", "spm", "pmsyrm", "measured", "synrm", "asymmetric", "slotless")
REACH = 1.3
"""Largest current of the maps, in i_max: simulated currents overshoot."""
_SPACING, _SPACING_BRIDGE = 1 / 40, 0.4
"""Of the simulation's grid in i_max, and of i_b along i_q where that is less."""
_ANGLES = 32
"""Of the simulation's grid in a sixth of a turn: eight in the shortest period, that of order 24."""

Random = np.random.Generator


@dataclass(frozen=True)
class Harmonic:
    """One rotor harmonic: electrical order, phase, and a, b, k, m above."""

    order: int
    phase: float
    magnet: tuple[float, float]
    iron: tuple[float, float]


@dataclass(frozen=True)
class CoEnergy:
    """Parameters of the co-energy above, all per unit."""

    magnet: tuple[float, float]  # psi_0, x_f
    linear: tuple[float, float]  # l_d, l_q
    main: tuple[float, float]  # unsaturated inductances E Q_dd, E Q_qq of the iron
    knee: float  # current on the q axis at which the iron saturates
    sharpness: float  # n
    cross: float = 0.0  # Q_dq / sqrt(Q_dd Q_qq)
    bridge: tuple[float, float, float] = (0.0, 1.0, 0.0)  # psi_b, i_b, c
    harmonics: tuple[Harmonic, ...] = ()

    def _iron(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gradient of E F(r)."""
        m_d, m_q = self.main
        m_dq, energy = self.cross * np.sqrt(m_d * m_q), m_q * self.knee**2
        shifted = x + self.magnet[1]
        by_x, by_y = m_d * shifted + m_dq * y, m_dq * shifted + m_q * y
        r = np.sqrt((shifted * by_x + y * by_y) / energy)
        factor = (1 + r**self.sharpness) ** (-1 / self.sharpness)
        return factor * by_x, factor * by_y

    def flux(self, x: FloatArray, y: FloatArray, theta: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return psi_d and psi_q per unit, averaged over the rotor position or at electrical angles, rad."""
        iron_d, iron_q = self._iron(x, y)
        psi_b, i_b, tilt = self.bridge
        log_cosh = i_b * (np.logaddexp(y / i_b, -y / i_b) - np.log(2.0))
        psi_d = self.magnet[0] + self.linear[0] * x + iron_d + psi_b * tilt * log_cosh
        psi_q = self.linear[1] * y + iron_q + psi_b * (1 + tilt * x) * np.tanh(y / i_b)
        if theta is None:
            return psi_d, psi_q
        s = np.sqrt(1 + x**2 + y**2)
        for each in self.harmonics:
            c, w = np.cos(each.order * theta + each.phase), np.sin(each.order * theta + each.phase)
            psi_d = psi_d + c * (each.magnet[0] + each.iron[0] * iron_d) + w * each.iron[1] * y * (1 + y**2) / s**3
            psi_q = psi_q + w * (each.magnet[1] + each.iron[1] * x * (1 + x**2) / s**3) + c * each.iron[0] * iron_q
        return psi_d, psi_q


@dataclass(frozen=True)
class Measured:
    """A co-energy machine of which only rough values on a coarse grid are known."""

    origin: CoEnergy
    nodes: int  # along each axis
    roughness: float  # standard deviation of the errors of the nodes' fluxes, per unit
    reciprocal: bool  # a co-energy was interpolated
    sixth: float  # sixth harmonic, as a fraction of the flux
    seed: int  # of the roughness

    @cached_property
    def _interpolant(self) -> Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        axis, rng = np.linspace(-REACH, REACH, self.nodes), np.random.default_rng(self.seed)
        d, q = np.meshgrid(axis, axis, indexing="ij")
        step, shape = axis[1] - axis[0], (self.nodes, self.nodes)
        if self.reciprocal:
            fine = np.linspace(0.0, 1.0, 101)  # the co-energy along rays, by Simpson's rule
            weights = np.full(101, 2.0)
            weights[1::2], weights[[0, -1]] = 4.0, 1.0
            psi_d, psi_q = self.origin.flux(d[..., None] * fine, q[..., None] * fine)
            energy = (d[..., None] * psi_d + q[..., None] * psi_q) @ (weights / 300)
            energy = energy + self.roughness * step * rng.standard_normal(shape) / np.sqrt(2.0)
            spline = RectBivariateSpline(axis, axis, energy, kx=5, ky=5)
            return lambda x, y: (spline.ev(x, y, dx=1), spline.ev(x, y, dy=1))
        rough = [psi + self.roughness * rng.standard_normal(shape) for psi in self.origin.flux(d, q)]

        def evaluate(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Interpolate along i_q, then along i_d."""
            points, back = np.unique(np.asarray(x).ravel(), return_inverse=True)
            flat = np.asarray(y).ravel()
            lines = [PchipInterpolator(axis, psi, axis=0)(points) for psi in rough]
            out = np.empty((2, flat.size))
            for k in range(len(points)):
                chosen = back == k
                for part, line in zip(out, lines, strict=True):
                    part[chosen] = PchipInterpolator(axis, line[k])(flat[chosen])
            return out[0].reshape(np.shape(x)), out[1].reshape(np.shape(x))

        return evaluate

    def flux(self, x: FloatArray, y: FloatArray, theta: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return psi_d and psi_q per unit, averaged over the rotor position or at electrical angles, rad."""
        psi_d, psi_q = self._interpolant(*np.broadcast_arrays(x, y))
        wave = 1.0 if theta is None else 1 + self.sixth * np.cos(6 * theta)
        return psi_d * wave, psi_q * wave


@dataclass(frozen=True)
class Machine:
    """A machine in SI units."""

    shape: CoEnergy | Measured
    i_max: float
    flux_unit: float  # largest flux linkage within the disc, Wb
    resistance: float
    pole_pairs: int
    u_dc: float

    def flux(self, i_dq: FloatArray) -> FloatArray:
        """Return the true mean flux linkages (N, 2), Wb, at currents (N, 2), A."""
        x, y = i_dq.T / self.i_max
        return self.flux_unit * np.stack(self.shape.flux(x, y), axis=-1)

    def to_map(self, name: str) -> MachineMap:
        """Sample the fluxes densely for the simulation, which then integrates them with its own splines."""
        width = self.shape.bridge[1] if isinstance(self.shape, CoEnergy) and self.shape.bridge[0] else 1.0
        half = [int(np.ceil(REACH / spacing)) for spacing in (_SPACING, min(_SPACING, _SPACING_BRIDGE * width))]
        d, q = (REACH * np.linspace(-1.0, 1.0, 2 * n + 1) for n in half)
        psi_d, psi_q = (self.flux_unit * part for part in self.shape.flux(*np.meshgrid(d, q, indexing="ij")))
        known = {"i_d": self.i_max * d, "i_q": self.i_max * q, "psi_d": psi_d, "psi_q": psi_q}
        if not isinstance(self.shape, CoEnergy) or self.shape.harmonics:
            theta = np.arange(_ANGLES, dtype=np.float64) * (2 * np.pi / 6 / _ANGLES)
            waves = self.shape.flux(d[:, None, None], q[None, :, None], theta)
            known |= {"theta": theta}
            known |= {"psi_d_theta": self.flux_unit * waves[0], "psi_q_theta": self.flux_unit * waves[1]}
        return MachineMap(
            name, resistance=self.resistance, pole_pairs=self.pole_pairs, i_max=self.i_max, u_dc=self.u_dc, **known
        )


def random_shape(rng: Random, family: str) -> CoEnergy | Measured:
    """Return a random machine of a family, its largest flux within the disc being 1."""
    if family == "measured":
        origin = _scaled(_coenergy(rng, str(rng.choice(["ipm", "pmsyrm", "spm"]))))
        reciprocal = bool(rng.random() < 0.5)
        rough = 10 ** rng.uniform(-4.0, -3.0)
        return Measured(origin, int(rng.integers(13, 36)), rough, reciprocal, 0.01, int(rng.integers(2**31)))
    return _scaled(_coenergy(rng, family))


def _coenergy(rng: Random, family: str) -> CoEnergy:
    u = rng.uniform
    soft = float(np.exp(u(np.log(1.5), np.log(6.0))))
    if family == "spm":
        l_q = u(0.2, 0.6)
        out = CoEnergy((0.8, u(0.02, 0.2)), (0.2 * l_q,) * 2, (0.8 * l_q, 0.8 * l_q * u(1.0, 1.15)), u(0.5, 1.5), soft)
    elif family == "slotless":
        l_q = u(0.03, 0.12)
        out = CoEnergy((1.0, 0.0), (0.9 * l_q,) * 2, (0.1 * l_q, 0.1 * l_q), u(1.0, 2.0), soft)
    elif family in ("pmsyrm", "synrm"):
        small, magnet = u(0.12, 0.25), (u(0.15, 0.35), u(0.05, 0.2)) if family == "pmsyrm" else (0.0, 0.0)
        out = CoEnergy(magnet, (0.6 * small, 0.5 * small), (0.4 * small, u(1.2, 3.0)), u(0.25, 0.6), soft)
    else:
        l_d = u(0.2, 0.45)
        out = CoEnergy((u(0.4, 0.6), u(0.2, 0.8)), (0.4 * l_d,) * 2, (0.6 * l_d, l_d * u(1.5, 3.0)), u(0.4, 1.0), soft)
    if family == "synrm" and rng.random() < 0.5:  # d along the iron bridges
        out = replace(out, linear=out.linear[::-1], main=out.main[::-1], knee=float(u(0.8, 1.5)))
    if family == "bridge":
        out = replace(out, bridge=(u(0.05, 0.2) * 0.7, float(np.exp(u(np.log(0.014), np.log(0.08)))), u(-0.2, 0.2)))
    if family == "asymmetric":
        out = replace(out, cross=float(rng.choice([-1, 1]) * u(0.08, 0.25)))
    return replace(out, harmonics=_harmonics(rng, family))


def _harmonics(rng: Random, family: str) -> tuple[Harmonic, ...]:
    orders = ((), (6,), (6, 12), (6, 12, 18), (6, 12, 24))[rng.choice(5, p=(0.1, 0.25, 0.4, 0.15, 0.1))]
    size = 0.2 if family == "slotless" else 1.0
    out = []
    for order in orders:
        a, b, k, m = rng.uniform(-1.0, 1.0, 4) * size * rng.uniform(0.2, 1.5) * 1e-2 * 6 / order
        phase = rng.uniform(-1.0, 1.0) if family == "asymmetric" else 0.0
        magnet = (0.0, 0.0) if family == "synrm" else (0.7 * a, 0.7 * b)
        out.append(Harmonic(order, float(phase), magnet, (float(k), float(0.5 * m))))
    return tuple(out)


def _scaled(shape: CoEnergy) -> CoEnergy:
    """Divide all fluxes by the largest within the disc."""
    turn, radius = np.meshgrid(np.linspace(-np.pi, np.pi, 73), np.linspace(0.05, 1.0, 20))
    largest = float(np.hypot(*shape.flux(radius * np.cos(turn), radius * np.sin(turn))).max())
    return replace(
        shape,
        magnet=(shape.magnet[0] / largest, shape.magnet[1]),
        linear=(shape.linear[0] / largest, shape.linear[1] / largest),
        main=(shape.main[0] / largest, shape.main[1] / largest),
        bridge=(shape.bridge[0] / largest, *shape.bridge[1:]),
    )
