"""Conventions of other tools' maps, and their conversion to ours: peak SI values, magnet on +d, q 90 degrees ahead."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import product
from math import pi, sqrt
from typing import Any

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.points import MapPoints

CHOICES = {
    "axis": ("pm", "sr"),
    "order": ("dq", "qd"),
    "sign": ("motor", "generator"),
    "magnet": ("plus", "minus"),
    "q_axis": ("leads", "lags"),
    "current": ("peak", "rms", "power"),
    "flux": ("peak", "rms", "power"),
}
"""Values of the conventions; the first is ours."""
_AMPLITUDE = {"peak": 1.0, "rms": sqrt(2.0), "power": sqrt(2.0 / 3.0)}


@dataclass(frozen=True)
class Conventions:
    """How a file measures currents and fluxes. The defaults are ours.

    Parameters
    ----------
    axis : {"pm", "sr"}
        d is the axis of the magnet, or the axis of largest permeance, 90 degrees ahead of it.
    order : {"dq", "qd"}
        Arrays are indexed [i_d, i_q] and columns named as they are, or with d and q exchanged.
    sign : {"motor", "generator"}
        Currents and torque are positive when the machine takes up or delivers power.
    magnet : {"plus", "minus"}
        The magnet is on the positive or negative side of its axis.
    q_axis : {"leads", "lags"}
        q is 90 degrees electrical ahead of d in the direction of positive angle and torque, or behind it.
    current, flux : {"peak", "rms", "power"}
        Scaling: peak values, RMS values, or a power-invariant transformation.
    current_scale, flux_scale : float
        Factors to ampere and weber, 0.001 for values in milliampere.

    Raises
    ------
    ConfigurationError
        When a value is none of these, or a factor is not positive.
    """

    axis: str = "pm"
    order: str = "dq"
    sign: str = "motor"
    magnet: str = "plus"
    q_axis: str = "leads"
    current: str = "peak"
    flux: str = "peak"
    current_scale: float = 1.0
    flux_scale: float = 1.0

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                raise ConfigurationError(f"--{_option(name)} is '{value}': it must be {' or '.join(choices)}.")
        for name in ("current_scale", "flux_scale"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ConfigurationError(f"--{_option(name)} is {value}: give a positive factor.")

    def differing(self, other: Conventions) -> str:
        """Return the entries that differ from another's as command-line options."""
        return " ".join(f"--{_option(name)} {getattr(self, name)}" for name in self._changed(other))

    def alternatives(self, names: tuple[str, ...]) -> Iterator[Conventions]:
        """Yield all others that differ in some of the named choices, those with the fewest changes first."""
        own = tuple(getattr(self, name) for name in names)
        combinations = sorted(
            product(*(CHOICES[name] for name in names)),
            key=lambda values: sum(a != b for a, b in zip(values, own, strict=True)),
        )
        for values in combinations[1:]:
            changed: dict[str, Any] = dict(zip(names, values, strict=True))
            yield replace(self, **changed)

    def changes(self, other: Conventions) -> int:
        """Count the entries in which another differs."""
        return len(self._changed(other))

    def _changed(self, other: Conventions) -> list[str]:
        return [entry.name for entry in fields(self) if getattr(self, entry.name) != getattr(other, entry.name)]


def _option(name: str) -> str:
    return name.replace("_", "-")


def converted(points: MapPoints, conventions: Conventions) -> MapPoints:
    """Return a map in our conventions.

    Equal phase currents and fluxes require, for d on the axis of largest permeance, ``i = J i_sr``, ``psi = J psi_sr``
    and an angle that is 90 degrees less.

    Parameters
    ----------
    conventions : Conventions
        Those of the file. Where ``points.shape`` is given, their order was that of the indices, and is done with.
    """
    transform = np.eye(2)
    shift = 0.0
    if conventions.order == "qd" and points.shape is None:
        transform = transform[::-1]
    if conventions.q_axis == "lags":
        transform = np.diag([1.0, -1.0]) @ transform
    if conventions.magnet == "minus":
        transform, shift = -transform, shift + pi
    if conventions.axis == "sr":
        transform, shift = np.array([[0.0, -1.0], [1.0, 0.0]]) @ transform, shift - pi / 2
    into = 1.0 if conventions.sign == "motor" else -1.0
    amperes = into * _AMPLITUDE[conventions.current] * conventions.current_scale
    webers = _AMPLITUDE[conventions.flux] * conventions.flux_scale
    psi = webers * np.einsum("ab,nbh->nah", transform, points.psi_dq)
    sigma = points.sigma_dq
    return replace(
        points,
        i_dq=amperes * points.i_dq @ transform.T,
        psi_dq=psi,
        theta=None if points.theta is None else points.theta + shift,
        torque=None if points.torque is None else into * points.torque,
        sigma_dq=None if sigma is None else webers * sigma @ np.abs(transform).T,
    )
