"""Operating points: voltage, stator current, power and losses of a drive that turns at a speed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from drive_id.analysis.bands import combined
from drive_id.analysis.machine import MachineModel
from drive_id.types import BoolArray, FloatArray

_IRON_ROUNDS = 3
"""Rounds in which the map's current follows from that of the stator: the loss hardly changes with what it takes."""


@dataclass(frozen=True, eq=False)
class Operation:
    """Steady operating points (...) of a drive; build them by :meth:`at`.

    With iron loss the stator current is the map's current plus that of the loss; otherwise both are the same. The power
    balance ``power = mechanical power + copper + iron + inverter`` holds exactly. Voltages neglect a resistance that is
    not known; losses and power of the winding are NaN then.

    Parameters
    ----------
    i_dq : (..., 2) float
        Current of the map, A, from which flux and torque follow.
    stator : (..., 2) float
        Current of the stator, A.
    u_dq : (..., 2) float
        Voltage that the inverter is commanded, its own drop included, V.
    speed : (...) float
        Mechanical, rad/s.
    torque : (...) float
        Nm.
    copper, iron, inverter : (...) float
        Losses, W.
    power : (...) float
        Electrical power 1.5 u i at the commanded voltage, W.
    """

    i_dq: FloatArray
    stator: FloatArray
    u_dq: FloatArray
    speed: FloatArray
    torque: FloatArray
    copper: FloatArray
    iron: FloatArray
    inverter: FloatArray
    power: FloatArray

    @classmethod
    def at(cls, model: MachineModel, i_dq: FloatArray, speed: FloatArray) -> Operation:
        """Evaluate at currents of the map (..., 2), A, and mechanical speeds (...), rad/s, that broadcast."""
        psi = np.stack(model.psi_dq(i_dq[..., 0], i_dq[..., 1]), axis=-1)
        return cls.of_flux(model, i_dq, psi, speed)

    @classmethod
    def of_flux(cls, model: MachineModel, i_dq: FloatArray, psi: FloatArray, speed: FloatArray) -> Operation:
        """Evaluate for known flux linkages (..., 2), Wb."""
        pairs = model.known_pole_pairs()
        electrical = pairs * np.asarray(speed)
        torque = 1.5 * pairs * (psi[..., 0] * i_dq[..., 1] - psi[..., 1] * i_dq[..., 0])
        induced = electrical[..., None] * np.stack([-psi[..., 1], psi[..., 0]], axis=-1)
        loss = model.iron.current(induced, electrical) if model.iron.known else np.zeros_like(induced)
        stator = i_dq + loss
        drop = np.stack(model.inverter_drop(stator[..., 0], stator[..., 1]), axis=-1)
        resistance = np.asarray(model.resistance + model.resistance_by_speed * electrical**2)
        u_dq = induced + np.nan_to_num(resistance)[..., None] * stator + drop
        copper = 1.5 * resistance * np.sum(stator**2, axis=-1)
        return cls(
            i_dq=i_dq,
            stator=stator,
            u_dq=u_dq,
            speed=np.broadcast_to(speed, u_dq.shape[:-1]),
            torque=np.broadcast_to(torque, u_dq.shape[:-1]),
            copper=copper,
            iron=1.5 * np.sum(induced * loss, axis=-1),
            inverter=1.5 * np.sum(drop * stator, axis=-1),
            power=np.where(np.isfinite(copper), 1.5 * np.sum(u_dq * stator, axis=-1), np.nan),
        )

    def chosen(self, rows: BoolArray) -> Operation:
        """Return some of the points along the first axis."""
        return Operation(**{name: values[rows] for name, values in vars(self).items()})

    def inside(self, model: MachineModel) -> BoolArray:
        """Tell at which points (...) the map rests on data."""
        return model.inside(self.i_dq[..., 0], self.i_dq[..., 1])

    @property
    def current(self) -> FloatArray:
        """Amplitude of the stator current (...), A."""
        return np.asarray(np.hypot(self.stator[..., 0], self.stator[..., 1]))

    @property
    def voltage(self) -> FloatArray:
        """Amplitude of the voltage (...), V."""
        return np.asarray(np.hypot(self.u_dq[..., 0], self.u_dq[..., 1]))

    @property
    def mechanical(self) -> FloatArray:
        """Mechanical power (...), W: torque times speed, mechanical losses not included."""
        return self.torque * self.speed

    @property
    def losses(self) -> FloatArray:
        """Sum of all losses (...), W."""
        return self.copper + self.iron + self.inverter

    @property
    def efficiency(self) -> FloatArray:
        """Output over input power (...), as motor or generator; NaN where both sides consume power, or neither does."""
        motor = (self.mechanical > 0) & (self.power > 0)
        generator = (self.mechanical < 0) & (self.power < 0)
        out = np.full(self.torque.shape, np.nan)
        out[motor] = self.mechanical[motor] / self.power[motor]
        out[generator] = self.power[generator] / self.mechanical[generator]
        return out


@dataclass(frozen=True, eq=False)
class OperationErrors:
    """Standard errors (...) at the currents of operating points, in the units of :class:`Operation`; NaN if unknown."""

    torque: FloatArray
    voltage: FloatArray
    losses: FloatArray
    power: FloatArray
    efficiency: FloatArray

    @classmethod
    def of(cls, model: MachineModel, points: Operation) -> OperationErrors:
        """Propagate the errors of a model to its operating points; NaN outside the data."""
        known, names = points.inside(model), [entry.name for entry in fields(cls)]
        changed = changes(model, points, names)
        sigmas = {name: np.nan if changed is None else combined(changed[name]) for name in names}
        return cls(**{name: np.where(known, sigma, np.nan) for name, sigma in sigmas.items()})


def changes(
    model: MachineModel, points: Operation, names: Iterable[str], *, of_stator: bool = True
) -> dict[str, FloatArray] | None:
    """Return the changes (M, ...) of figures by name with each cause of error of the model; None without errors.

    The currents of the stator stay the same, and with iron loss those of the map change by what the loss takes; or,
    unless ``of_stator``, those of the map stay.
    """
    errors = model.errors
    if errors is None or not len(errors):
        return None
    others = []
    for k, change in enumerate(errors.fluxes(points.i_dq[..., 0], points.i_dq[..., 1])):
        wrong = replace(
            model,
            resistance=model.resistance + errors.resistance[k],
            inverter_voltage=model.inverter_voltage + errors.inverter_voltage[k],
            iron=model.iron.changed(errors.iron[k]),
        )
        others.append(_changed(wrong, points, change, _IRON_ROUNDS if of_stator and wrong.iron.known else 0))
    return {name: np.array([getattr(other, name) - getattr(points, name) for other in others]) for name in names}


def _changed(model: MachineModel, points: Operation, change: FloatArray, rounds: int) -> Operation:
    """Evaluate a changed model, whose fluxes (..., 2) differ by ``change``, Wb, at the map's currents of points.

    In each further round, the map's currents follow from the stator currents of the points.
    """
    i_dq = points.i_dq
    for left in range(rounds, -1, -1):
        psi = np.stack(model.psi_dq(i_dq[..., 0], i_dq[..., 1]), axis=-1)
        found = Operation.of_flux(model, i_dq, psi + change, points.speed)
        if left:
            i_dq = i_dq + points.stator - found.stator
    return found
