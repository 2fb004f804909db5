"""Figures over the current plane: torque, inductances, ripple, gains of the current controllers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.ripple import TorqueRipple
from drive_id.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class CurrentMaps:
    """Figures on a grid of currents; where not ``inside``, they rest on the extrapolated map.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        A.
    inside : (D, Q) bool
    psi_d, psi_q : (D, Q) float
        Wb.
    torque, sigma_torque : (D, Q) float
        Nm; standard errors are NaN where not inside, or not known.
    ripple : (D, Q) float
        Peak-to-peak torque over the rotor position without cogging, Nm.
    inductances, sigma_inductances : (D, Q, 2, 2) float
        Incremental, [[L_dd, L_dq], [L_qd, L_qq]], H.
    apparent_d, apparent_q : (D, Q) float
        H, see :meth:`~drive_id.analysis.machine.MachineModel.apparent_inductances`.
    kp_d, kp_q : (D, Q) float
        Proportional gains of the current controllers, V/A.
    ki : float
        Integral gain of both, V/(A s).
    """

    i_d: FloatArray
    i_q: FloatArray
    inside: BoolArray
    psi_d: FloatArray
    psi_q: FloatArray
    torque: FloatArray
    sigma_torque: FloatArray
    ripple: FloatArray
    inductances: FloatArray
    sigma_inductances: FloatArray
    apparent_d: FloatArray
    apparent_q: FloatArray
    kp_d: FloatArray
    kp_q: FloatArray
    ki: float

    @classmethod
    def of(cls, model: MachineModel, i_d: FloatArray, i_q: FloatArray, bandwidth: float) -> CurrentMaps:
        """Evaluate on a grid of currents, A, with controllers for a bandwidth, Hz.

        The controllers cancel the pole of each axis: kp = 2 pi f L and ki = 2 pi f R, with the incremental inductance
        of the nearest monotone map, so that no gain is negative; NaN where there are no data.
        """
        d, q = np.meshgrid(i_d, i_q, indexing="ij")
        psi_d, psi_q = model.psi_dq(d, q)
        inductances = model.inductances(d, q)
        apparent_d, apparent_q = model.apparent_inductances(d, q)
        rate = 2 * np.pi * bandwidth
        gains = rate * np.where(model.inside(d, q)[..., None, None], model.control_inductances(d, q), np.nan)
        return cls(
            i_d=i_d,
            i_q=i_q,
            inside=model.inside(d, q),
            psi_d=psi_d,
            psi_q=psi_q,
            torque=model.torque(d, q),
            sigma_torque=model.sigma_torque(d, q),
            ripple=TorqueRipple.of(model).peak_to_peak(d, q),
            inductances=inductances,
            sigma_inductances=model.sigma_inductances(d, q),
            apparent_d=apparent_d,
            apparent_q=apparent_q,
            kp_d=gains[..., 0, 0],
            kp_q=gains[..., 1, 1],
            ki=rate * model.resistance,
        )

    @property
    def saliency(self) -> FloatArray:
        """Ratio L_qq / L_dd of the incremental inductances (D, Q)."""
        return np.asarray(self.inductances[..., 1, 1] / self.inductances[..., 0, 0])

    def arrays(self) -> dict[str, FloatArray | BoolArray]:
        """Return all arrays by their names in ``maps.npz``."""
        names = {"dd": (0, 0), "dq": (0, 1), "qd": (1, 0), "qq": (1, 1)}
        return {
            "i_d": self.i_d,
            "i_q": self.i_q,
            "torque": self.torque,
            "sigma_torque": self.sigma_torque,
            **{f"L_{name}": self.inductances[..., a, b] for name, (a, b) in names.items()},
            "inside": self.inside,
            **{f"sigma_L_{name}": self.sigma_inductances[..., a, b] for name, (a, b) in names.items()},
            "psi_d": self.psi_d,
            "psi_q": self.psi_q,
            "L_d": self.apparent_d,
            "L_q": self.apparent_q,
            "saliency": self.saliency,
            "torque_ripple": self.ripple,
            "kp_d": self.kp_d,
            "kp_q": self.kp_q,
            "ki": np.array(self.ki),
        }
