"""motulator, where it is installed, loads our exports and simulates the drive; its own code judges the maps."""

from __future__ import annotations

import io

import numpy as np
import pytest
from exchange_machine import AT, I_D, I_Q, PAIRS, RESISTANCE, U_DC, flux, result

from drive_id.exchange.exports.exporting import content_of
from drive_id.exchange.exports.options import ExportOptions

utils = pytest.importorskip(
    "motulator.drive.utils", reason="motulator is not installed: its releases since 0.6 need Python 3.12"
)
if not hasattr(utils, "MagneticModel"):
    pytest.skip("this motulator is older than its magnetic models (0.6)", allow_module_level=True)

OWN_GRID = ExportOptions(I_D, I_Q)


def exported(name, choice=OWN_GRID):
    return io.BytesIO(content_of(result(), name, choice)[0])


def flux_map():
    data = np.load(exported("motulator"))
    return utils.MagneticModel(i_s_dq=data["i_s_dq"], psi_s_dq=data["psi_s_dq"], type="flux_map"), data


def test_it_finds_the_fluxes_at_asymmetric_points():
    magnetic, data = flux_map()
    psi_d, psi_q = flux(*AT)
    np.testing.assert_allclose(np.asarray(magnetic(AT[0] + 1j * AT[1])), psi_d + 1j * psi_q, atol=2e-3)
    assert (data["R_s"], data["n_p"]) == (RESISTANCE, PAIRS)


@pytest.mark.filterwarnings("ignore")  # of its own dependencies
def test_it_simulates_the_drive():
    from motulator.drive import model
    from motulator.drive.control import sm

    magnetic, data = flux_map()
    n_p, R_s, load, speed = int(data["n_p"]), float(data["R_s"]), 3.0, 60.0
    currents = magnetic.invert()
    machine = model.SynchronousMachine(model.SaturatedSynchronousMachinePars(n_p=n_p, R_s=R_s, i_s_dq_fcn=currents))
    drive = model.Drive(machine, model.MechanicalSystem(J=0.005), model.VoltageSourceConverter(u_dc=U_DC))
    estimated = sm.SaturatedSynchronousMachinePars(n_p=n_p, R_s=R_s, i_s_dq_fcn=currents, psi_s_dq_fcn=magnetic)
    vector = sm.CurrentVectorController(
        estimated, sm.CurrentVectorControllerCfg(i_s_max=14.0, J=0.005, sensorless=False)
    )
    control = sm.VectorControlSystem(vector, sm.SpeedController(J=0.005, alpha_s=2 * np.pi * 8))
    control.set_speed_ref(lambda t: speed * (t > 0.01))
    drive.mechanics.set_external_load_torque(lambda t: load * (t > 0.2))
    end = model.Simulation(drive, control).simulate(t_stop=0.6).mdl
    assert float(np.real(end.mechanics.w_M[-1])) == pytest.approx(speed, rel=0.01)
    current = np.mean(end.machine.i_s_dq[-200:])
    psi_d, psi_q = flux(current.real, current.imag)
    torque = 1.5 * PAIRS * (psi_d * current.imag - psi_q * current.real)
    assert torque == pytest.approx(load, rel=0.02)
    assert float(np.mean(end.machine.tau_M[-200:])) == pytest.approx(load, rel=0.02)
