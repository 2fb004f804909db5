"""Rough machine model: the share of the voltage that it explains, for the declared and for other readings.

Over windows of about 60 degrees electrical, in the stator frame,

    int u dt = R int i dt + c int h(i) dt + change of e^{j theta} f(e^{-j theta} i),

where h is the smoothed sign of each phase current and f = dW/di the gradient of a polynomial co-energy W of degree 4:
16 real unknowns, linear. Coefficients that an angle offset rotates are complex, so that any offset fits equally well;
those of i and |i|^2 i are real because of reciprocity. R, c and the inductance cannot be negative, which reveals wrong
signs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.types import TINY, FloatArray, Samples

DELAYS = tuple(np.arange(-2.0, 2.01, 0.25).tolist())
"""Delays of the voltages that are tried, samples."""
# columns of the unknowns of the rough model that cannot be negative, and that which goes with the inductance
_RESISTANCE, _DROP, _INDUCTANCE, _SATURATION = 0, 1, 4, 5
_WINDOW_TURN = np.pi / 3  # rad: as in method full
_LONGEST_WINDOW = 512  # samples: bounds the drift of an offset at low speed
_NODES = 750  # most windows of a run in a fit: 16 unknowns need no more
_SIGN_WIDTH = 0.02
"""Width of the smoothed sign relative to the largest current."""
_RIDGE = 1e-9  # of the unit diagonal: keeps columns without data solvable, far below their noise


@dataclass(frozen=True)
class Reading:
    """One way to read the signals."""

    ratio: tuple[int, int] = (1, 1)  # factor on the angle as a fraction; negative: it counts the other way
    turned: float = 0  # rotation of the voltages against the currents, in steps of 60 degrees
    mirrored: bool = False  # two phases of the voltages swapped, before they are turned
    reversed_current: int = -1  # phase whose sign is changed, below of the voltages; -1: none
    reversed_voltage: int = -1

    @property
    def voltage_order(self) -> tuple[int, int, int]:
        """In which order to read the phases of voltages that are turned by whole steps."""
        order, turned = (0, 2, 1) if self.mirrored else (0, 1, 2), int(self.turned)
        thirds = ((turned + 3) % 6 if turned % 2 else turned) // 2
        a, b, c = (order[(k - thirds) % 3] for k in range(3))
        return a, b, c

    @property
    def voltage_sign(self) -> int:
        """The sign of these voltages."""
        return -1 if self.turned % 2 else 1


DECLARED = Reading()
"""The signals as they are."""


@dataclass(frozen=True, eq=False)
class RoughFit:
    """The rough model under one reading."""

    reading: Reading
    unexplained: float  # root mean square of the residual over that of the integrated voltage
    delay: float  # of the voltages against the log, samples
    without_delay: float  # ``unexplained`` at delay 0
    resistance: float  # ohm, and, below, H, the mean of both axes
    inductance: float
    magnet: complex  # Wb, and, below, (L_d - L_q)/2, H: rotated by once and twice the angle offset
    saliency: complex
    estimate: FloatArray  # (16,), all unknowns, of scaled currents


@dataclass(frozen=True, eq=False)
class Excerpt:
    """One gap-free run, integrated."""

    run: Samples
    i_max: float  # current by which currents are scaled, A
    angle: FloatArray  # (N,), unwrapped, rad
    i_s: ComplexArray  # (N,), dimensionless
    lossy: ComplexArray  # (2, N), integrals of the current, and of its smoothed signs, s
    volts: ComplexArray  # (N + 1,), integral of the voltage, Vs
    window: int  # samples in which the voltage turns by about 60 degrees
    nodes: int = _NODES  # most windows

    def coarse(self) -> Excerpt:
        """Return the excerpt with fewer windows, for the search for the likeliest of 130 readings."""
        return replace(self, nodes=_NODES // 3)

    @classmethod
    def of(cls, run: Samples, i_max: float) -> Excerpt:
        """Integrate a gap-free run."""
        period, i_s, u_s = run.sample_period, frames.space_vector(run.i_abc / i_max), frames.space_vector(run.u_abc)
        sign = frames.space_vector(np.tanh(run.i_abc / (_SIGN_WIDTH * i_max)))
        turn = abs(float(np.angle(np.vdot(u_s[:-1], u_s[1:]))))
        longest = min(_LONGEST_WINDOW, max(len(i_s) // 4, 1))
        return cls(
            run,
            i_max,
            np.unwrap(run.angle),
            i_s,
            lossy=np.array([_trapezoids(x, period) for x in (i_s, sign)]),
            volts=np.asarray(period * np.concatenate([[0j], np.cumsum(u_s)])),
            window=int(np.clip(round(_WINDOW_TURN / max(turn, 1e-9)), 1, longest)),
        )

    def with_signs(self, reading: Reading) -> Excerpt:
        """Return the excerpt with the sign of one phase changed."""
        if reading.reversed_current < 0 and reading.reversed_voltage < 0:
            return self
        phases = np.arange(3)
        i_abc = np.where(phases == reading.reversed_current, -self.run.i_abc, self.run.i_abc)
        u_abc = np.where(phases == reading.reversed_voltage, -self.run.u_abc, self.run.u_abc)
        return Excerpt.of(replace(self.run, i_abc=i_abc, u_abc=u_abc), self.i_max)


@dataclass(frozen=True, eq=False)
class _BalanceSums:
    """Normal equations of some windows: matrix (P, P), right sides (P, D) and squares (D,) for each delay."""

    matrix: FloatArray
    right: FloatArray
    square: FloatArray

    def left(self, x: FloatArray) -> float:
        """Return the squared residual of an estimate at the first delay."""
        return float(self.square[0] - 2 * x @ self.right[:, 0] + x @ self.matrix @ x)


def rough_fit(
    excerpts: Sequence[Excerpt], reading: Reading = DECLARED, delays: Sequence[float] = DELAYS
) -> RoughFit | None:
    """Fit the rough model.

    Parameters
    ----------
    delays : sequence of float
        Among which the best is chosen, samples.

    Returns
    -------
    RoughFit or None
        None without windows or voltage.
    """
    parts = _aligned([excerpt.with_signs(reading) for excerpt in excerpts], reading, delays)
    if not parts:
        return None
    total = _BalanceSums(
        *(np.sum([getattr(part, name) for part in parts], axis=0) for name in ("matrix", "right", "square"))
    )
    if not (np.isfinite(total.matrix).all() and np.isfinite(total.square).all() and (total.square > 0).all()):
        return None
    solved = _solved(total.matrix, total.right)
    left = total.square - np.sum(solved * total.right, axis=0)
    shares = np.sqrt(np.maximum(left, 0.0) / total.square)
    best = int(shares.argmin())
    x, i_max = solved[:, best], excerpts[0].i_max
    resistance, _, magnet_d, magnet_q, inductance, _, saliency_d, saliency_q, *_ = x.tolist()
    return RoughFit(
        reading,
        unexplained=float(shares[best]),
        delay=float(delays[best]),
        without_delay=float(shares[int(np.abs(delays).argmin())]),
        resistance=resistance / i_max,
        inductance=inductance / i_max,
        magnet=complex(magnet_d, magnet_q),
        saliency=complex(saliency_d, saliency_q) / i_max,
        estimate=x,
    )


def residuals(excerpts: Sequence[Excerpt], fit: RoughFit) -> tuple[FloatArray, FloatArray]:
    """Return the squared residuals (N,) that a fit leaves of each excerpt, and the squared integrated voltages (N,)."""
    sums = [_sums(excerpt, fit.reading, (fit.delay,), 0.0) for excerpt in excerpts]
    pairs = [(0.0, 0.0) if part is None else (part.left(fit.estimate), float(part.square[0])) for part in sums]
    left, square = np.array(pairs).reshape(-1, 2).T
    return left, square


def _aligned(excerpts: Sequence[Excerpt], reading: Reading, delays: Sequence[float]) -> list[_BalanceSums]:
    """Return the sums of each run; those of an angle that is divided by q, turned by the best multiple of 2 pi/q.

    The multiple is unknown after each gap; the longest run is the reference for the others.
    """
    over, under = reading.ratio
    choices = []
    for excerpt in sorted(excerpts, key=lambda excerpt: len(excerpt.i_s), reverse=True):
        found = [_sums(excerpt, reading, delays, 2 * np.pi * over * turn / under) for turn in range(under)]
        choices.append([sums for sums in found if sums is not None])
    choices = [found for found in choices if found]
    if not choices:
        return []
    first = choices[0][0]
    x = _solved(first.matrix, first.right[:, :1])[:, 0]
    return [first, *(min(found, key=lambda sums: sums.left(x)) for found in choices[1:])]


def _sums(excerpt: Excerpt, reading: Reading, delays: Sequence[float], turned: float) -> _BalanceSums | None:
    n = len(excerpt.i_s)
    step = max(excerpt.window // 2, -(-n // excerpt.nodes))
    reach = math.ceil(np.abs(delays).max())
    nodes = np.arange(reach, n - reach - 1, step)
    ahead = -(-excerpt.window // step)
    if len(nodes) <= ahead:
        return None
    rotor = np.exp(1j * (reading.ratio[0] / reading.ratio[1] * excerpt.angle[nodes] + turned))
    terms = _flux_terms(excerpt.i_s[nodes] / rotor) * rotor
    columns = _changes(np.concatenate([excerpt.lossy[:, nodes], terms]), ahead)
    right, square = np.empty((len(columns), len(delays))), np.empty(len(delays))
    phase = np.exp(1j * np.pi / 3 * reading.turned)
    for k, delay in enumerate(delays):
        below = math.floor(-delay)
        share = -delay - below
        volts = (1 - share) * excerpt.volts[nodes + below] + share * excerpt.volts[nodes + below + 1]
        y = _changes(phase * (volts.conj() if reading.mirrored else volts)[None], ahead)[0]
        right[:, k], square[k] = columns @ y, y @ y
    return _BalanceSums(columns @ columns.T, right, square)


def _flux_terms(i: ComplexArray) -> ComplexArray:
    """Return the gradients (14, N) of the terms of the co-energy: 2 dW/di*, for i_d + j i_q (N,)."""
    conjugate, one = i.conj(), np.ones_like(i)
    square = i * conjugate
    return np.array([
        one, 1j * one,  # Re(p* i)
        i,  # |i|^2 / 2
        square * i,  # |i|^4 / 4
        conjugate, 1j * conjugate,  # Re(p* i^2) / 2
        i**2 + 2 * square, 1j * (2 * square - i**2),  # Re(p* i) |i|^2
        conjugate**2, 1j * conjugate**2,  # Re(p* i^3) / 3
        i**3 + 3 * square * conjugate, 1j * (3 * square * conjugate - i**3),  # Re(p* i^2) |i|^2
        conjugate**3, 1j * conjugate**3,  # Re(p* i^4) / 4
    ])  # fmt: skip


def _solved(matrix: FloatArray, right: FloatArray, without: frozenset[int] = frozenset()) -> FloatArray:
    """Solve the normal equations for (P, D) without negative inductance, resistance and drop, and some unknowns."""
    free = np.array([k for k in range(len(right)) if k not in without])
    scale = np.sqrt(np.maximum(np.diag(matrix), TINY))[free, None]
    scaled, x = matrix[free[:, None], free] / (scale * scale.T), np.zeros_like(right)
    x[free] = np.linalg.solve(scaled + _RIDGE * np.eye(len(free)), right[free] / scale) / scale
    for k in (_INDUCTANCE, _RESISTANCE, _DROP):
        negative = x[k] < 0
        if negative.any():
            x[:, negative] = _solved(
                matrix, right[:, negative], without | ({k, _SATURATION} if k == _INDUCTANCE else {k})
            )
    return x


def _changes(values: ComplexArray, ahead: int) -> FloatArray:
    """Return the changes of (P, N) values over ``ahead`` nodes, real parts, then imaginary ones."""
    change = values[:, ahead:] - values[:, :-ahead]
    return np.concatenate([change.real, change.imag], axis=1)


def _trapezoids(x: ComplexArray, period: float) -> ComplexArray:
    return np.asarray(period * np.concatenate([[0], np.cumsum(0.5 * (x[1:] + x[:-1]))]))
