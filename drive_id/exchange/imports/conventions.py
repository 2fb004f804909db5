"""Conventions of other tools' maps, and their conversion to ours: peak SI values, magnet on +d, q 90 degrees ahead."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import product
from math import pi, sqrt
from typing import Any

import numpy as np

from drive_id.common.settings import Checked, setting
from drive_id.core import frames
from drive_id.exchange.imports.points import MapPoints

_LEAST_SCALE = 1e-30  # only excludes zero and negative factors
_AMPLITUDE = {"peak": 1.0, "rms": sqrt(2.0), "power": sqrt(2.0 / 3.0)}


@dataclass(frozen=True)
class Conventions(Checked):
    """How a file measures currents and fluxes. The defaults are ours."""

    axis: str = setting(
        "pm", "d is the axis of the magnet, or of largest permeance, 90 degrees ahead of it", choices=("pm", "sr")
    )
    order: str = setting(
        "dq",
        "arrays are indexed [i_d, i_q] and columns named as they are, or with d and q exchanged",
        choices=("dq", "qd"),
    )
    sign: str = setting(
        "motor", "currents and torque are positive when the machine takes up or delivers power",
        choices=("motor", "generator"),
    )  # fmt: skip
    magnet: str = setting("plus", "the side of its axis on which the magnet is", choices=("plus", "minus"))
    q_axis: str = setting(
        "leads", "q is 90 degrees electrical ahead of d in the direction of positive angle and torque, or behind it",
        choices=("leads", "lags"),
    )  # fmt: skip
    current: str = setting("peak", "peak, RMS, or of a power-invariant transformation", choices=tuple(_AMPLITUDE))
    flux: str = setting("peak", "likewise", choices=tuple(_AMPLITUDE))
    current_scale: float = setting(1.0, "factor to ampere, 0.001 for milliampere", minimum=_LEAST_SCALE)
    flux_scale: float = setting(1.0, "factor to weber", minimum=_LEAST_SCALE)

    def differing(self, other: Conventions) -> list[str]:
        """Return the entries that differ from another's as command-line options."""
        values = ((entry.name, getattr(self, entry.name), getattr(other, entry.name)) for entry in fields(self))
        return [f"--{name.replace('_', '-')} {own}" for name, own, others in values if own != others]

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


CHOICES: dict[str, tuple[str, ...]] = {
    entry.name: entry.metadata["choices"] for entry in fields(Conventions) if entry.metadata["choices"]
}
"""Values of the conventions; the first is ours."""


def converted(points: MapPoints, conventions: Conventions) -> MapPoints:
    """Return a map in our conventions from one in those of a file.

    Equal phase currents and fluxes require, for d on the axis of largest permeance, ``i = J i_sr``, ``psi = J psi_sr``
    and an angle that is 90 degrees less. Where ``points.shape`` is given, their order was that of the indices, and is
    done with.
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
        transform, shift = frames.J @ transform, shift - pi / 2
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
