"""The result of a fit: flux map, harmonics, resistance, inverter curve and a report on the fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drive_id.common.origins import ORIGINS, Origin
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.methods.parameters import FitReport, Parameters
from drive_id.types import FloatArray

if TYPE_CHECKING:
    from drive_id.core.validation.simulated_current import SimulatedCurrent


@dataclass(frozen=True)
class LinearMachine:
    """The machine at zero current: ``psi_d = psi_pm + l_d i_d``, ``psi_q = l_q i_q``; method ``static``.

    Standard errors are infinite for what the points leave open.
    """

    psi_pm: float  # flux linkage of the magnets, Wb
    sigma_psi_pm: float  # its standard error, Wb
    l_d: float  # inductance, H
    sigma_l_d: float  # its standard error, H
    l_q: float  # inductance, H
    sigma_l_q: float  # its standard error, H


@dataclass(frozen=True)
class Cogging:
    """One harmonic of the cogging torque."""

    order: int  # electrical
    amplitude: float  # Nm
    sigma: float  # its standard error, Nm


@dataclass(frozen=True)
class TorqueFit:
    """What the shaft torque says of a flux map.

    The model is ``T = g 3/2 p (psi_d i_q - psi_q i_d) - T_f sign(w) - b w - T_c(theta) + T_0`` with the mechanical
    speed w; b and T_0 only where the speeds in the recording tell them from T_f.

    Parameters
    ----------
    gain, sigma_gain : float
        g and its standard error. A common gain error of voltages or currents, which the electrical signals do not show,
        makes it differ from 1.
    friction, sigma_friction : float
        T_f and its standard error, Nm. Where ``viscous_friction`` is None, it is all friction at the recorded speed;
        where ``offset`` is None, it includes the offset of the torque sensor.
    viscous_friction, sigma_viscous_friction : float or None
        b and its standard error, Nm s/rad.
    offset, sigma_offset : float or None
        T_0 of the torque sensor and its standard error, Nm.
    cogging : tuple of Cogging
        The significant harmonics of T_c.
    rms_map : float
        Difference, rms, between the torque of the map and the measured torque corrected for friction, cogging and
        offset, Nm.
    rms_residual : float
        The same with the gain, Nm.
    pole_pairs : int
    samples : int
        In the fit.
    """

    gain: float
    sigma_gain: float
    friction: float
    sigma_friction: float
    viscous_friction: float | None
    sigma_viscous_friction: float | None
    offset: float | None
    sigma_offset: float | None
    cogging: tuple[Cogging, ...]
    rms_map: float
    rms_residual: float
    pole_pairs: int
    samples: int


@dataclass(frozen=True)
class Mechanics:
    """What the motion of a free shaft says of its mechanics, by the torque T of the flux map.

    The model is ``g T = (J + dJ) dw/dt + b w + T_f sign(w) + T_0 + T_c(theta)`` with the mechanical speed w and the
    known inertia dJ of discs. A term that the motion cannot tell is None. Voltages and currents alone leave the common
    gain g open, by which all values scale: 1 is assumed unless an inertia is known.

    Parameters
    ----------
    inertia, sigma_inertia : float
        J without discs and its standard error, kg m^2; where it was given, that value and 0.
    friction, sigma_friction : float or None
        T_f, N m.
    viscous_friction, sigma_viscous_friction : float or None
        b, with the drag of the iron loss, N m s/rad.
    load, sigma_load : float or None
        T_0, against positive rotation, N m.
    cogging : tuple of Cogging
        The significant harmonics of T_c.
    gain, sigma_gain : float or None
        g: true torque over that of the map; None where no inertia is known.
    explained : float
        Share of the energy of the torque that the motion explains, 0 to 1.
    seconds : float
        Of data in the regression.
    cogging_visible : float or None
        Amplitude below which a harmonic would not have been reported, N m; None where none was looked for, and in
        results of earlier versions.
    """

    inertia: float
    sigma_inertia: float
    friction: float | None
    sigma_friction: float | None
    viscous_friction: float | None
    sigma_viscous_friction: float | None
    load: float | None
    sigma_load: float | None
    cogging: tuple[Cogging, ...]
    gain: float | None
    sigma_gain: float | None
    explained: float
    seconds: float
    cogging_visible: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class IdentifiedDrive(Parameters):
    """An identified drive: the parameters and how good they are, without their origin."""

    method: str  # psm, joint, full, locked or static; imported for a map of another tool
    i_max: float  # radius of the current disc of the experiment, A
    report: FitReport
    torque: TorqueFit | None = None  # the recorded shaft torque against that of the map
    mechanics: Mechanics | None = None  # of a free shaft, by the torque of the map
    simulated: SimulatedCurrent | None = None  # where the MAD comes from; None when the result was read from files
    linear: LinearMachine | None = None  # magnet flux and inductances at zero current; method static

    @cached_property
    def answering(self) -> FluxMap:
        """The map that answers also where samples only enclose a current, with the standard errors of the fit there."""
        found, modes = self.flux_map, self.error_modes
        if modes is None or not (beyond := modes.known & ~found.inside).any():
            return found
        sigma_d, sigma_q = (
            np.where(beyond, np.linalg.norm(errors, axis=0), own)
            for errors, own in ((modes.psi_d, found.sigma_d), (modes.psi_q, found.sigma_q))
        )
        return replace(found, sigma_d=sigma_d, sigma_q=sigma_q, enclosed=beyond)

    @property
    def origin(self) -> Origin:
        """What results of this method hold, and the words for it."""
        return ORIGINS[self.method]

    @cached_property
    def sizes(self) -> dict[str, float]:
        """Sizes by SI unit, of this drive's fluxes, R and so on, by which all values of a kind have one unit."""
        found = self.flux_map
        i_d, i_q = found.grid()[found.inside].T
        slopes = found.inductances(i_d, i_q)
        steepest = np.maximum(slopes[..., 0, 0], slopes[..., 1, 1])
        known = steepest[np.isfinite(steepest)]
        inductance = float(np.median(known)) if known.size else 0.0
        sizes = {"Wb": found.largest, "Wb/K": found.largest, "H": inductance, "Ω": abs(self.resistance)}
        sizes |= {"A": self.i_max, "V": abs(self.voltage_error)}
        return {unit: size for unit, size in sizes.items() if size > 0}

    @property
    def sigma_drop(self) -> FloatArray | None:
        """Standard error of the inverter's curve (C,), V: of each current, or in proportion; None where unknown."""
        sigma, height = self.sigma_inverter_voltage, self.voltage_error
        if sigma is None and height and np.isfinite(self.sigma_voltage_error):
            sigma = np.abs(self.inverter_voltage / height) * self.sigma_voltage_error
        return sigma if sigma is not None and np.isfinite(sigma).all() else None
