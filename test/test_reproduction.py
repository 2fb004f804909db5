"""The paper's experiments on one shipped machine, in half their length."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import reproduction


@pytest.fixture(scope="module")
def results():
    return reproduction.reproduce(machines=("ipm",), seconds=5.0)


def test_the_experiments_are_those_of_the_paper():
    real, ideal, compensated = reproduction.SIMULATION, reproduction.IDEAL, reproduction.COMPENSATED
    for settings in (real, ideal, compensated):
        assert (settings.sample_period, settings.speeds) == (1e-4, (500.0,))
    assert (real.inverter, real.harmonics, real.inverter_compensation) == ("dead_time", 1.0, False)
    assert (ideal.inverter, ideal.harmonics, ideal.current_noise) == ("none", 0.0, 0.0)
    assert compensated.inverter_compensation
    assert reproduction.SECONDS == 10.0


@pytest.mark.accuracy
def test_every_experiment_has_all_methods(results):
    assert [(row.experiment, row.method) for row in results.rows] == [
        (experiment, method)
        for experiment in ("simulation", "bench", "ideal", "compensated")
        for method in ("psm", "joint", "full")
    ]
    assert {row.machine for row in results.rows} == {"ipm"}
    assert all(np.isfinite([row.nrmse_d, row.nrmse_q, row.resistance]).all() for row in results.rows)


@pytest.mark.accuracy
def test_with_an_inverter_joint_is_at_least_three_times_better(results):
    psm, joint, _ = results.select("simulation")
    assert 3 * joint.nrmse_d < psm.nrmse_d
    assert 3 * joint.nrmse_q < psm.nrmse_q
    assert joint.mad_d < psm.mad_d
    assert joint.mad_q < psm.mad_q
    assert psm.voltage_error == 0.0
    assert joint.voltage_error == pytest.approx(4.0, rel=0.15)
    assert abs(joint.resistance - joint.true_resistance) < 0.2 * abs(psm.resistance - psm.true_resistance)


@pytest.mark.accuracy
@pytest.mark.parametrize("experiment", ["simulation", "bench"])
def test_full_is_at_least_twenty_times_better_than_joint(results, experiment):
    _, joint, full = results.select(experiment)
    assert 20 * full.nrmse_d < joint.nrmse_d
    assert 20 * full.nrmse_q < joint.nrmse_q
    assert 3 * full.mad_d < joint.mad_d
    assert 3 * full.mad_q < joint.mad_q


@pytest.mark.accuracy
def test_full_finds_the_resistance_and_the_height_of_the_curve(results):
    _, _, full = results.select("simulation")
    assert full.resistance == pytest.approx(full.true_resistance, rel=0.01)
    assert full.voltage_error == pytest.approx(4.0, rel=0.02)


@pytest.mark.accuracy
def test_at_the_bench_joint_is_better_than_psm(results):
    psm, joint, _ = results.select("bench")
    assert joint.nrmse_d < psm.nrmse_d
    assert joint.nrmse_q < psm.nrmse_q
    assert joint.mad_d < psm.mad_d
    assert joint.mad_q < psm.mad_q


@pytest.mark.accuracy
@pytest.mark.parametrize(("experiment", "limit"), [("ideal", 1e-3), ("compensated", 2e-3)])
def test_without_an_inverter_all_methods_agree(results, experiment, limit):
    psm, joint, full = results.select(experiment)
    for row in (psm, joint, full):
        assert max(row.nrmse_d, row.nrmse_q) < limit
        assert row.resistance == pytest.approx(row.true_resistance, rel=0.02)
    assert max(abs(joint.voltage_error), abs(full.voltage_error)) < 0.05
    assert results.agreement[experiment] < limit
    assert results.agreement["simulation"] > 10 * results.agreement[experiment]


@pytest.mark.accuracy
def test_tables_and_claims_show_the_rows(results):
    tables = results.tables()
    assert [len(table.rows) for table in tables] == [3, 3, 3]
    shown = [list(column.cells) for column in tables[0].columns]
    assert shown[1] == ["PSM identification", "Joint identification", "Full identification"]
    assert shown[2] == [f"{100 * row.nrmse_d:.3f} %" for row in results.select("simulation")]
    claims = results.claims()
    assert len(claims) == 2
    _, joint, full = results.select("ideal")
    assert f"u_e = {joint.voltage_error:+.4f} V by joint, {full.voltage_error:+.4f} V by full" in claims[0]
    for method in ("psm", "joint", "full"):
        assert claims[0].count(f"{method} ") >= 2


@pytest.mark.accuracy
def test_what_diverged_is_said_and_is_null(results):
    diverged = replace(results.rows[0], mad_d=float("nan"), mad_q=float("nan"))
    broken = replace(results, rows=(diverged, *results.rows[1:]))
    assert next(iter(broken.tables()[1].columns[2].cells)) == "diverged"
    assert broken.tree()["rows"][0]["mad_d"] is None
    json.dumps(broken.tree(), allow_nan=False)


@pytest.mark.accuracy
def test_the_files(results, tmp_path):
    reproduction.write_reproduction(tmp_path / "out", results)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["reproduction.json", "tables.txt"]
    assert json.loads((tmp_path / "out" / "reproduction.json").read_text()) == json.loads(json.dumps(results.tree()))
    text = (tmp_path / "out" / "tables.txt").read_text()
    for said in ("NRMSE of flux maps in simulation", "Joint identification", "Without an inverter"):
        assert said in text
