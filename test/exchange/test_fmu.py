"""FMUs: valid by fmpy, and the same currents as the simulated drive, which integrates in other variables and frames."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from dataclasses import replace

import fmpy
import numpy as np
import pytest
from exact_results import exact_result
from exchange_machine import result
from flashed_machines import NAMES, drive
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

import drive_id
from drive_id.core import frames
from drive_id.exchange.exports.exporting import content_of, export_map
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.fitting.simulated import load_machine
from drive_id.types import MachineMap

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler 'cc'")
FORMATS = ["fmu", "fmu-2"]


def transient(inverter):
    """The machine ipm without harmonics, exactly known, and a transient of it; the inverter's curve in 601 points."""
    machine = replace(load_machine("ipm"), theta=None, psi_d_theta=None, psi_q_theta=None)
    samples = drive_id.simulate(machine, 0.12, speed=700.0, inverter=inverter)
    found, truth = exact_result(machine), samples.truth
    known = replace(found.drive, inverter_current=truth.inverter_current, inverter_voltage=truth.inverter_voltage)
    return replace(found, drive=known), samples


@pytest.mark.cases
@pytest.mark.parametrize(
    ("name", "inverter", "accuracy"), [("fmu", "none", 2e-5), ("fmu-2", "none", 2e-5), ("fmu", "dead_time", 4e-5)]
)
def test_currents_of_a_transient(name, inverter, accuracy, tmp_path):
    found, samples = transient(inverter)
    axis = np.linspace(-1.25 * found.i_max, 1.25 * found.i_max, 41)
    path = tmp_path / "drive.fmu"
    export_map(found, name, path, ExportOptions(axis, axis, filled=True))
    references = {v.name: v.valueReference for v in fmpy.read_model_description(str(path)).modelVariables}
    inputs = [references[v] for v in ("u_a", "u_b", "u_c", "speed")]
    states = [references[v] for v in ("i_d", "i_q", "angle")]
    outputs = [references[v] for v in ("i_a", "i_b", "i_c", "torque")]
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    with Opened(path, tmp_path / "unzipped") as unit:
        write, read = (unit.setFloat64, unit.getFloat64) if name == "fmu" else (unit.setReal, unit.getReal)
        write(states, [*i_dq[0], samples.angle[0]])
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        period, got = samples.sample_period, []
        for k in range(len(samples)):
            got.append(read(outputs))
            write(inputs, [*samples.u_abc[k], samples.speed[k] / found.pole_pairs])
            unit.doStep(currentCommunicationPoint=k * period, communicationStepSize=period)
    got = np.array(got)
    assert np.abs(np.hypot(*i_dq.T)).max() > 0.5 * found.i_max
    assert np.abs(got[:, :3] - samples.i_abc).max() < accuracy * found.i_max
    psi_d, psi_q = found.flux_map.psi_dq(*i_dq.T)
    torque = 1.5 * found.pole_pairs * (psi_d * i_dq[:, 1] - psi_q * i_dq[:, 0])
    inside = np.isfinite(torque)
    assert np.abs(got[inside, 3] - torque[inside]).max() < 1e-3 * np.nanmax(np.abs(torque))


def pulses(found, model, count):
    """Voltages (K, 2) within the limit of the DC link that drive the current to random places up to 1.45 i_max.

    Returned with their period, the electrical speed and the currents (K + 1, 2): those of an integration of the map in
    Python, by another rule and with errors below 1e-6 of i_max.
    """
    rng, limit, i_max = np.random.default_rng(1), found.u_dc / np.sqrt(3), found.i_max
    largest = np.hypot(*model.psi_dq(*(1.45 * i_max * np.array([[1, -1, 0, 0], [0, 0, 1, -1]])))).max()
    period, speed = largest / limit / 3, 0.3 * limit / largest

    def induced(i):
        psi_d, psi_q = model.psi_dq(*i)
        return found.resistance * i + speed * np.array([-psi_q, psi_d])

    def slope(_, i, u):
        return np.linalg.solve(model.inductances(*i), u - induced(i))

    voltages, currents = [], [np.zeros(2)]
    for k in range(count):
        if k % 6 == 0:  # each third time back to zero
            turn, size = rng.uniform(0, 2 * np.pi), 1.45 * i_max * (k % 18 != 12) * max(rng.uniform(), k % 12 == 0)
            wanted = np.array(model.psi_dq(size * np.cos(turn), size * np.sin(turn)))
        u = induced(currents[-1]) + (wanted - model.psi_dq(*currents[-1])) / period
        u *= min(1.0, limit / np.hypot(*u))
        options = {"method": "DOP853", "rtol": 1e-7, "atol": 1e-7 * i_max, "max_step": period / 4}
        currents.append(solve_ivp(slope, (0, period), currents[-1], args=(u,), **options).y[:, -1])
        voltages.append(u)
    return np.array(voltages), period, speed, np.array(currents)


def replayed(found, name, voltages, period, speed, folder):
    """Return rows of i_d, i_q, psi_d, psi_q (K + 1, 4) of the exported drive at these voltages."""
    path = folder / f"{name}.fmu"
    path.write_bytes(content_of(found, name)[0])
    references = {v.name: v.valueReference for v in fmpy.read_model_description(str(path)).modelVariables}
    wanted = [references[v] for v in ("i_d", "i_q", "psi_d", "psi_q")]
    with Opened(path, folder / f"{name} unzipped") as unit:
        write, read = (unit.setFloat64, unit.getFloat64) if name == "fmu" else (unit.setReal, unit.getReal)
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        got = [read(wanted)]
        for k, u in enumerate(voltages):
            write([references[v] for v in ("u_d", "u_q", "speed")], [*u, speed / found.pole_pairs])
            unit.doStep(currentCommunicationPoint=k * period, communicationStepSize=period)
            got.append(read(wanted))
    return np.array(got)


@pytest.mark.parametrize(
    ("name", "count"), [("spm", 18), *(pytest.param(name, 24, marks=pytest.mark.accuracy) for name in NAMES[-2:])]
)
def test_an_independent_integration_is_followed_to_one_and_a_half_i_max(name, count, tmp_path):
    """A solver with a constant step was off by 4e-3 of i_max where a bridge is left, and tables by 3e-3 in a fold."""
    found = drive(name)
    model = MapTable.of(found, ExportOptions()).machine
    voltages, period, speed, currents = pulses(found, model, count)
    assert np.hypot(*currents.T).max() > 1.4 * found.i_max
    for version in FORMATS if name == "fold" else ["fmu"]:
        got = replayed(found, version, voltages, period, speed, tmp_path)
        assert np.abs(got[:, :2] - currents).max() < 1e-3 * found.i_max


@pytest.mark.cases
@pytest.mark.parametrize("version", FORMATS)
def test_beyond_one_and_a_half_i_max_it_continues_with_the_slopes_and_says_so_once(version, tmp_path, capfd):
    found = drive("spm")
    model = MapTable.of(found, ExportOptions()).machine
    period, count = 1e-3, 80
    voltages = np.outer(np.arange(3 * count) // count != 1, found.resistance * found.i_max * np.array([0.5, 2.2]))
    got = replayed(found, version, voltages, period, 0.0, tmp_path)
    assert capfd.readouterr().out.count("[WARNING] The current is beyond 1.5 i_max") == 2  # it was back in between
    np.testing.assert_allclose(got[-1, :2], voltages[-1] / found.resistance, rtol=1e-3)
    edge = np.clip(got[-1, :2], -1.5 * found.i_max, 1.5 * found.i_max)
    wanted = model.psi_dq(*edge) + model.inductances(*edge) @ (got[-1, :2] - edge)
    np.testing.assert_allclose(got[-1, 2:], wanted, rtol=1e-3)


@pytest.mark.slow  # tables of 321 points along an axis
def test_where_no_table_is_fine_enough_it_is_told():
    """A narrow ridge across both axes: an axis cannot be refined for it."""
    axis = np.arange(-150, 151) / 10
    d, q = np.meshgrid(axis, axis, indexing="ij")
    ridge = 0.04 * np.tanh((d + q) / 0.2)
    found = exact_result(MachineMap("ridge", axis, axis, 4e-3 * d + ridge, 8e-3 * q + ridge, 0.45, 3, 10.0, 320.0))
    _, exported = content_of(found, "fmu")
    assert "currents err by up to" in " ".join(exported.warnings)


class Opened:
    """An instance of an FMU for co-simulation, freed at the end."""

    def __init__(self, path, folder):
        description = fmpy.read_model_description(str(path))
        kind = FMU2Slave if description.fmiVersion == "2.0" else FMU3Slave
        self.unit = kind(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path), str(folder)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="drive",
        )

    def __enter__(self):
        self.unit.instantiate()
        if isinstance(self.unit, FMU2Slave):
            self.unit.setupExperiment(startTime=0.0)
        return self.unit

    def __exit__(self, *_):
        self.unit.terminate()
        self.unit.freeInstance()


@pytest.mark.cases
@pytest.mark.parametrize("name", FORMATS)
def test_valid_and_one_model_in_both_interfaces(name, tmp_path):
    path = tmp_path / "drive.fmu"
    content, _ = content_of(result(), name)
    path.write_bytes(content)
    assert content == content_of(result(), name)[0]
    assert validate_fmu(str(path)) == []
    given = {"u_q": 3.0, "speed": 20.0, "winding_temperature": 120.0}
    wanted = ["i_d", "i_q", "torque", "inside"]
    options = {"stop_time": 0.02, "start_values": given, "output_interval": 1e-3, "output": wanted}
    by_us = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", **options)[-1]
    by_cvode = fmpy.simulate_fmu(str(path), fmi_type="ModelExchange", relative_tolerance=1e-8, **options)[-1]
    np.testing.assert_allclose(list(by_us), list(by_cvode), rtol=1e-4)
    assert by_us["inside"] == 1.0


@pytest.mark.cases
@pytest.mark.parametrize("name", FORMATS)
def test_sources_compile_strictly(name, tmp_path):
    (tmp_path / "drive.fmu").write_bytes(content_of(result(), name)[0])
    with zipfile.ZipFile(tmp_path / "drive.fmu") as archive:
        archive.extractall(tmp_path)
    source = f"fmi{2 if name == 'fmu-2' else 3}.c"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    subprocess.run(["cc", *flags, source], cwd=tmp_path / "sources", check=True, capture_output=True)
