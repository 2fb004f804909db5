"""The file of a plan: parameters that the nodes take, written whole or not at all."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest
import yaml

from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.common.settings import from_mapping
from drive_id.core.experiment.settings import ExperimentSettings, make_trajectory
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.planning.free_shaft import plan_free_shaft
from drive_id.core.planning.planner import Plan, PlannedExperiment
from drive_id.core.planning.prediction import Prediction
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import OutputError
from drive_id.files.results.plan_file import (
    check_plan_output,
    free_shaft_tree,
    free_shaft_yaml,
    plan_tree,
    plan_yaml,
    write_plan,
)

MACHINE = RoughMachine(300.0, 4, 0.01, 1.4e-4, 2.9e-4, 0.06, 400.0)
PREDICTION = Prediction(1e-4, 2e-4, 1e-3, 1e-3, 2e-3)


def planned(*speeds: float, sample_period: float = 1e-4) -> Plan:
    experiment = PlannedExperiment(Lissajous(300.0, 7.3, 12.0), speeds, 10.0)
    paper = PlannedExperiment(Lissajous(300.0, 3.7, 1.1), (500.0,), 10.0)
    settings = PlanSettings(**asdict(MACHINE), sample_period=sample_period)
    return Plan(settings, MACHINE, experiment, PREDICTION, paper, PREDICTION, (30.0,) * len(speeds))


def parameters(text: str) -> list[dict]:
    return [node["ros__parameters"] for node in yaml.safe_load(text).values()]


@pytest.mark.parametrize("sample_period", [1e-4, 1e-6, 1.25e-4])
def test_the_nodes_take_the_parameters(sample_period):
    plan = planned(250.0, -610.0, sample_period=sample_period)
    trajectory, bench = parameters(plan_yaml(plan, "ipm"))
    settings = from_mapping(ExperimentSettings, trajectory, "the plan")
    assert make_trajectory(settings) == plan.experiment.trajectory
    assert settings.duration == 10.0
    assert settings.sample_period == sample_period
    assert settings.speed_min < MACHINE.electrical(-610.0) < MACHINE.electrical(250.0) < settings.speed_max
    assert from_mapping(BenchSettings, {"machine": bench.pop("machine")}, "the plan").machine == "ipm"
    drive = from_mapping(SimulationSettings, bench, "the plan")
    assert drive.speeds == (250.0, -610.0)
    assert drive.segment_durations == (5.0, 5.0)
    assert drive.sample_period == sample_period


def test_every_number_is_a_floating_point_one():
    """ROS refuses a whole number where it expects another, and mixed lists altogether."""
    for node in parameters(plan_yaml(planned(250.0, 600.0))):
        node.pop("repeat", None)
        for value in node.values():
            entries = value if isinstance(value, list) else [value]
            assert len({type(entry) for entry in entries}) == 1
            assert not isinstance(entries[0], int)


@pytest.mark.parametrize("speeds", [(500.0,), (-500.0,), (-900.0, -300.0)])
def test_the_band_of_the_speed_holds_the_speeds(speeds):
    settings = from_mapping(ExperimentSettings, parameters(plan_yaml(planned(*speeds)))[0], "the plan")
    for speed in speeds:
        assert settings.speed_min < MACHINE.electrical(speed) < settings.speed_max


def test_the_tree_is_json():
    found = json.loads(json.dumps(plan_tree(planned(250.0, -250.0)), allow_nan=False))
    assert found["speeds"] == [250.0, -250.0]
    assert found["predicted"]["flux_q"] == 2e-4
    assert found["met"]


def test_an_earlier_plan_is_replaced_and_nothing_else(tmp_path):
    path, text = tmp_path / "new" / "plan.yaml", plan_yaml(planned(500.0))
    write_plan(path, text)
    write_plan(path, text)
    assert path.read_text() == text
    assert [entry.name for entry in path.parent.iterdir()] == ["plan.yaml"]
    other = tmp_path / "other.yaml"
    other.write_text("mine: true")
    with pytest.raises(OutputError, match=r"other\.yaml"):
        check_plan_output(other)
    with pytest.raises(OutputError):
        write_plan(tmp_path, text)
    assert other.read_text() == "mine: true"


@pytest.mark.parametrize("inertia", [0.003, 0.03, 0.3])
def test_a_plan_for_a_free_shaft_is_a_file_that_publisher_and_bench_take(inertia):
    machine = RoughMachine(300.0, 4, 0.01, 1.5e-4, 3.5e-4, 0.066, 400.0)
    plan = plan_free_shaft(PlanSettings(**asdict(machine)), inertia)
    nodes = {name: node["ros__parameters"] for name, node in yaml.safe_load(free_shaft_yaml(plan, "ipm")).items()}
    settings = from_mapping(ExperimentSettings, nodes["/**/trajectory_publisher"], "the plan")
    assert make_trajectory(settings).frequency == pytest.approx(plan.frequency)
    assert settings.shaft_speed_max == pytest.approx(4 * plan.speed_max)
    bench = nodes["/**/bench_simulator"]
    of_bench = {name: bench.pop(name) for name in ("machine",)}
    assert from_mapping(SimulationSettings, bench, "the plan").inertia == pytest.approx(plan.inertia)
    assert from_mapping(BenchSettings, of_bench, "the plan").machine == "ipm"
    tree = json.loads(json.dumps(free_shaft_tree(plan), allow_nan=False))
    assert tree["added_inertia"] == pytest.approx(plan.inertia - inertia)
