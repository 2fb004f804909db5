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
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

import drive_id
from drive_id.core import frames
from drive_id.exchange.exports.exporting import content_of, export_map
from drive_id.exchange.exports.options import ExportOptions
from drive_id.fitting.simulated import load_machine

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
