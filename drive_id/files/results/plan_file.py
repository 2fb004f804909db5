"""A plan as a file of ROS parameters, for ``trajectory_publisher`` and ``bench_simulator``, and as plain values."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from drive_id.common.quantity import plain
from drive_id.core.planning.free_shaft import AMPLITUDE, FreeShaftPlan
from drive_id.core.planning.planner import Plan, PlannedExperiment
from drive_id.files.results.folder import check_own, replace_file

_HEADER = "# Planned by drive-id plan"
_SLEW_RESERVE = 1.05
"""Limit of the slew rate by the steepest slope of the figure: rounding must not trip it."""
_SPEED_RESERVE = 1.1
"""Band of the speed by the planned speeds: a load machine overshoots them."""
_LEAD_TIME = 0.3
"""s that set-points are published ahead of time."""
_DIGITS = 9  # of parameters
_MOST_AHEAD = 50_000
"""Set-points that are published ahead at most."""


def plan_tree(plan: Plan) -> dict[str, Any]:
    """Return a plan as plain values; deviations are fractions, speeds rpm."""
    return {
        "format": "drive_id plan",
        **_experiment_tree(plan.experiment),
        "predicted": asdict(plan.prediction),
        "met": plan.met,
        "voltages": list(plan.voltages),
        "largest_voltage": plan.machine.largest_voltage,
        "slope": plan.experiment.trajectory.slope,
        "paper": _experiment_tree(plan.paper) | {"predicted": asdict(plan.paper_prediction)},
        "reason": plan.reason(),
        "statements": plan.statements(),
        "warnings": plan.warnings(),
        "machine": asdict(plan.machine),
        "settings": asdict(plan.settings),
    }


def plan_yaml(plan: Plan, machine: str = "") -> str:
    """Write a plan as ROS parameters; ``machine``, for the simulated bench, is shipped by this name, or a file."""
    experiment, trajectory = plan.experiment, plan.experiment.trajectory
    electrical = [plan.machine.electrical(speed) for speed in experiment.speeds]
    speeds = ", ".join(f"{speed:g}" for speed in experiment.speeds)
    said = [
        f"{_HEADER}: {experiment.duration:g} s in all, {experiment.share:g} s at each of {speeds} rpm.",
        "# Start trajectory and recorder together, and change the speed of the load machine on the way. For instance:",
        "#   ros2 run drive_id trajectory_publisher --ros-args --params-file THIS_FILE",
        "# speed_min and speed_max are the band of the electrical speed, rad/s.",
    ]
    publisher = {
        "trajectory": "lissajous",
        "i_max": trajectory.i_max,
        "frequency_d": trajectory.frequency_d,
        "frequency_q": trajectory.frequency_q,
        "form": trajectory.form,
        **_timing(experiment.duration, trajectory.slope, plan.settings.sample_period),
        "speed_min": min(electrical) * (_SPEED_RESERVE if min(electrical) < 0 else 1 / _SPEED_RESERVE),
        "speed_max": max(electrical) * (_SPEED_RESERVE if max(electrical) > 0 else 1 / _SPEED_RESERVE),
    }
    bench = {
        "i_max": trajectory.i_max,
        "sample_period": plan.settings.sample_period,
        "speeds": list(experiment.speeds),
        "segment_durations": [experiment.share] * len(experiment.speeds),
    }
    return _parameters(said, publisher, bench, machine)


def free_shaft_tree(plan: FreeShaftPlan) -> dict[str, Any]:
    """Return a plan for a free shaft as plain values; speeds mechanical, rad/s, errors percent."""
    names = (
        "inertia", "added_inertia", "share", "acceleration", "speed_max", "mean_speed", "frequency", "duration",
        "bandwidth", "swing",
    )  # fmt: skip
    flux, inertia = plan.expected
    return {
        "format": "drive_id plan",
        "trajectory": "free_shaft",
        **{name: getattr(plan, name) for name in names},
        "expected": {"flux": flux, "inertia": inertia},
        "statements": plan.statements(),
        "warnings": plan.warnings(),
        "machine": asdict(plan.machine),
        "settings": asdict(plan.settings),
    }


def free_shaft_yaml(plan: FreeShaftPlan, machine: str = "") -> str:
    """Write a plan for a free shaft as ROS parameters, see :func:`plan_yaml`."""
    pairs, figure = plan.machine.pole_pairs, plan.figure
    said = [
        f"{_HEADER}: a free shaft of {plan.inertia:.4g} kg m^2 swings for {figure.duration:.4g} s.",
        "# Better let a first start measure shaft_acceleration: characterize --first-start --free-shaft.",
        "# shaft_acceleration (by i_max, rad/s^2), shaft_speed_max and mean_speed (rad/s) are electrical.",
    ]
    publisher = {
        "trajectory": "free_shaft",
        "i_max": plan.machine.i_max,
        "amplitude": AMPLITUDE,
        "shaft_acceleration": plan.acceleration / AMPLITUDE * pairs,
        "shaft_speed_max": plan.speed_max * pairs,
        "mean_speed": plan.mean_speed * pairs,
        "swing_frequency": plan.frequency,
        **_timing(plan.duration, figure.slope, plan.settings.sample_period),
    }
    bench = {
        "i_max": plan.machine.i_max,
        "sample_period": plan.settings.sample_period,
        "free_shaft": True,
        "inertia": plan.inertia,
    }
    return _parameters(said, publisher, bench, machine)


def _timing(duration: float, slope: float, sample_period: float) -> dict[str, Any]:
    return {
        "duration": duration,
        "repeat": 1,
        "slew_rate": math.ceil(_SLEW_RESERVE * slope) * 1.0,
        "sample_period": sample_period,
        "lead_time": min(_LEAD_TIME, _MOST_AHEAD * sample_period),
    }


def _parameters(said: list[str], publisher: dict[str, Any], bench: dict[str, Any], machine: str) -> str:
    """Write the parameters of the publisher, and of a simulated bench in place of the load machine, below comments."""
    bench = ({"machine": machine} if machine else {}) | bench
    nodes = {"/**/trajectory_publisher": publisher, "/**/bench_simulator": bench}
    tree = {node: {"ros__parameters": plain(values, _DIGITS)} for node, values in nodes.items()}
    return "\n".join([*said, "", yaml.safe_dump(tree, sort_keys=False)])


def check_plan_output(path: Path) -> None:
    """Check, before the work is done, that a plan may be written to a path.

    Raises OutputError when there is something else than an earlier plan.
    """
    check_own(path, _HEADER, len(_HEADER))


def write_plan(path: Path, text: str) -> None:
    """Write a plan, all of it or nothing; an earlier one is replaced.

    Raises OutputError when there is something else under this name, or it cannot be written.
    """
    check_plan_output(path)
    replace_file(path, text.encode())


def _experiment_tree(experiment: PlannedExperiment) -> dict[str, Any]:
    trajectory = experiment.trajectory
    return {
        "frequency_d": trajectory.frequency_d,
        "frequency_q": trajectory.frequency_q,
        "form": trajectory.form,
        "speeds": list(experiment.speeds),
        "duration_per_speed": experiment.share,
        "duration": experiment.duration,
    }
