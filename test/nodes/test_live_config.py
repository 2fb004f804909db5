"""The shipped parameter files hold the defaults, say what each parameter means, and load."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest
import yaml
from live_drive import BENCH, PUBLISHER
from ros_bench import ros_bench

from drive_id.bench.faults import FaultSettings
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.core.experiment.encoder import Encoder
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.recording.recording_settings import RecordingSettings

CONFIG = Path(__file__).parent.parent.parent / "config"
FILES = {
    "trajectory_publisher": (PUBLISHER, (ExperimentSettings,)),
    "bench_simulator": (BENCH, (BenchSettings, SimulationSettings, Encoder, FaultSettings)),
    "recorder": ("drive_id.nodes.recorder", (RecordingSettings,)),
    "identification": ("drive_id.nodes.identification", (IdentificationSettings, FitSettings)),
}
OTHERS = {("identification", "i_max"): 100.0}
"""Values that are no defaults: live samples need a radius, that of the trajectory as shipped."""


def plain(default):
    if default is None:
        return math.nan
    return list(default) if isinstance(default, tuple) else default


@pytest.mark.parametrize("name", FILES)
def test_they_hold_the_defaults(name):
    held = yaml.safe_load((CONFIG / f"{name}.yaml").read_text())["/**"]["ros__parameters"]
    fields = [field for settings in FILES[name][1] for field in dataclasses.fields(settings)]
    assert {field.name for field in fields} == set(held)
    for field in fields:
        expected = OTHERS.get((name, field.name), plain(field.default))
        if isinstance(expected, float):
            expected = pytest.approx(expected, nan_ok=True)
        assert held[field.name] == expected, field.name


@pytest.mark.parametrize("name", FILES)
def test_every_parameter_has_a_comment_above_it_or_above_its_neighbours(name):
    above = ""
    for line in (CONFIG / f"{name}.yaml").read_text().splitlines():
        assert len(line) <= 120
        if line.startswith("    ") and ":" in line and not line.strip().startswith("#"):
            assert above.strip(), f"{line} has nothing above it"
        above = line


def test_real_nodes_load_them():
    with ros_bench() as ros:
        for name, (module, _) in FILES.items():
            given = yaml.safe_load((CONFIG / f"{name}.yaml").read_text())["/**"]["ros__parameters"]
            own = {folder: str(ros.folder) for folder in ("data_directory", "output_directory") if folder in given}
            node = ros.host(module, files=[CONFIG / f"{name}.yaml"], parameters=own).node
            for parameter, value in (given | own).items():
                loaded = node.get_parameter(parameter).value
                if isinstance(value, float):
                    assert loaded == pytest.approx(value, nan_ok=True), (name, parameter)
                else:
                    assert (list(loaded) if isinstance(value, list) else loaded) == value, (name, parameter)
