"""Method static from files, from the command line and from the transient bench."""

from __future__ import annotations

import json

import numpy as np
import pytest
from steady_state import LinearDrive, disc_points, telemetry
from synthetic import every
from typer.testing import CliRunner

import drive_id
from drive_id.bench import drive
from drive_id.bench.machines import machine_map
from drive_id.cli.app import app
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, SamplePeriodError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.fitting.fit import accumulate_bags, fit_bags
from drive_id.fitting.sources import Sources

SIGNALS = """
defaults: {stamp: t, stamp_unit: s}
currents: {frame: dq, fields: [i_d, i_q]}
voltages: {frame: dq, fields: [u_d, u_q]}
resolver: {speed: n, speed_unit: rpm, mechanical: true, pole_pairs: 4}
"""


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(12)
    speed = rng.choice([-1, 1], 9) * rng.uniform(100, 400, 9)
    return telemetry(LinearDrive(), disc_points(rng, 100, 9, least=0.2), speed, rng=rng)


def _rows(data):
    return np.column_stack([data.time, data.i_dq, data.u_dq, data.speed / 4 * 30 / np.pi])


@pytest.fixture(scope="module")
def log(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("slow") / "log.csv"
    np.savetxt(path, _rows(data), delimiter=",", header="t,i_d,i_q,u_d,u_q,n", comments="", fmt="%.15g")
    path.with_name("signals.yaml").write_text(SIGNALS, encoding="utf-8")
    return path


def test_arrays_and_a_csv_file_give_the_same(data, log, tmp_path):
    result = drive_id.fit(data)
    assert result.method == "static"
    run = CliRunner().invoke(
        app,
        ["fit", str(log), "--signals", str(log.with_name("signals.yaml")), "--method", "static", "--json", "--output",
         str(tmp_path / "out")],
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    tree = json.loads(run.stdout)
    assert tree["method"] == "static"
    assert tree["pole_pairs"] == 4
    assert tree["linear_machine"]["psi_pm"] == pytest.approx(result.linear.psi_pm, rel=1e-6)
    assert tree["resistance"] == pytest.approx(result.resistance, rel=1e-6)
    assert tree["speed_range"][0] < 0 < tree["speed_range"][1]
    loaded = drive_id.load(tmp_path / "out")
    assert loaded.linear.l_q == pytest.approx(result.linear.l_q, rel=1e-6)
    assert loaded.statements[0].startswith("9 operating points at rest")


@pytest.mark.accuracy
def test_the_transient_bench_gives_its_machine():
    """Held references on the switched drive with harmonics, recorded in phases at 10 kHz, averaged to 10 Hz."""
    machine, rng = machine_map("spm"), np.random.default_rng(1)
    i_dq = disc_points(rng, machine.i_max, 16, least=0.1)
    settings = drive_id.SimulationSettings(speeds=(400.0, 900.0), current_noise=0.002, seed=3)
    made = drive.simulate(machine, settings, np.repeat(i_dq, 6000, axis=0))
    result = drive_id.fit(made.samples, method="static")
    assert result.resistance == pytest.approx(machine.resistance, rel=0.03)
    psi = result.flux_map.psi_dq(0.0, 0.0)[0]
    d, q = len(machine.i_d) // 2, len(machine.i_q) // 2
    assert psi == pytest.approx(machine.psi_d[d, q], rel=0.02)
    assert result.voltage_error == pytest.approx(0.01 * machine.u_dc, rel=0.1)


def test_rows_that_are_points(data):
    settings = FitSettings(method="static", rows_are_points=True)
    result = drive_id.fit(data, settings=settings)
    assert result.metrics["samples_read"] == 90
    assert any("points left out: 9" in warning for warning in result.warnings)  # the disturbed samples


def test_what_does_not_fit_together_is_refused(data, log, tmp_path):
    with pytest.raises(ConfigurationError, match="fit OperatingData by method static"):
        drive_id.fit(data, method="full")
    signals = parse_signals(SIGNALS, "test")
    with pytest.raises(ConfigurationError, match="names no angle"):
        fit_bags(Sources([log], signals), None, FitSettings())
    with pytest.raises(ConfigurationError, match="Method static fits operating points"):
        accumulate_bags(Sources([log], signals), tmp_path / "x.info", FitSettings(method="static", i_max=100.0))
    mixed = parse_signals(SIGNALS.replace("voltages: {frame: dq, fields: [u_d, u_q]}",
                                          "voltages: {fields: [u_d, u_q]}"), "test")  # fmt: skip
    with pytest.raises(ConfigurationError, match="different frames"):
        fit_bags(Sources([log], mixed), None, FitSettings(method="static"))


def test_slow_phase_quantities_are_refused():
    slow = every(drive_id.simulate("spm", 0.5, speed=2000.0), 20)
    with pytest.raises(SamplePeriodError, match="log currents and voltages in d and q"):
        drive_id.fit(slow, method="static")


def _frames(rows):
    """Spread each row over three, as a CAN logger writes one row for each frame."""
    spread = np.full((3 * len(rows), 6), np.nan)
    for k, columns in enumerate(((1, 2), (3, 4), (5,))):
        spread[k::3, 0] = rows[:, 0] + 0.005 * k
        for column in columns:
            spread[k::3, column] = rows[:, column]
    return spread


@pytest.mark.parametrize("shape", ["one row per sample", "one row per frame", "points without a time"])
def test_a_draft_of_a_slow_log_gives_the_machine(data, tmp_path, shape):
    rows, names = _rows(data), ["time [s]", "motor_id", "motor_iq", "motor_ud", "motor_uq", "motor_rpm"]
    if shape == "one row per frame":
        rows = _frames(rows)
    elif shape == "points without a time":
        rows, names = rows.reshape(-1, 10, 6)[:, 1:].mean(axis=1)[:, 1:], names[1:]
    lines = [",".join("" if np.isnan(x) else f"{x:.12g}" for x in row) for row in rows]
    (tmp_path / "log.csv").write_text("\n".join([",".join(names), *lines]))
    run = CliRunner().invoke(app, ["check", str(tmp_path / "log.csv"), "--draft", str(tmp_path / "draft.yaml")])
    assert run.exit_code == 0, run.output
    assert "--method static" in run.output
    assert "error" not in run.output
    text = (tmp_path / "draft.yaml").read_text().replace("pole_pairs: 1 ", "pole_pairs: 4 ")
    result = fit_bags(Sources([tmp_path / "log.csv"], parse_signals(text, "draft")), None, FitSettings(method="static"))
    true = LinearDrive()
    assert result.linear.psi_pm == pytest.approx(true.psi_pm, rel=2e-3)
    assert result.linear.l_q == pytest.approx(true.l_q, rel=1e-2)
    assert result.resistance == pytest.approx(true.resistance, rel=0.03)


def test_a_log_without_names_of_d_and_q_has_no_draft(log, tmp_path):
    (tmp_path / "log.csv").write_text(log.read_text().replace("u_d,u_q,n", "x,y,z"))
    run = CliRunner().invoke(app, ["check", str(tmp_path / "log.csv")])
    assert "no_draft" in run.output
