"""A plan as a file of ROS parameters, for ``trajectory_publisher`` and ``bench_simulator``, and as plain values."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drive_id.core.planning.free_shaft import AMPLITUDE, FreeShaftPlan
from drive_id.core.planning.planner import Plan, PlannedExperiment
from drive_id.files.inputs.input_file import open_input
from drive_id.files.results.folder import check_absent, replace_file

_HEADER = "# Planned by drive-id plan"
_SLEW_RESERVE = 1.05
_SPEED_RESERVE = 1.1
_LEAD_TIME, _MOST_AHEAD = 0.3, 50_000  # s, set-points


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
    """Write a plan as ROS parameters.

    Parameters
    ----------
    plan : Plan
    machine : str
        For the simulated bench: a shipped machine by name, or a machine file.
    """
    experiment, trajectory, settings = plan.experiment, plan.experiment.trajectory, plan.settings
    electrical = [plan.machine.electrical(speed) for speed in experiment.speeds]
    band = [min(electrical) * (_SPEED_RESERVE if min(electrical) < 0 else 1 / _SPEED_RESERVE)]
    band += [max(electrical) * (_SPEED_RESERVE if max(electrical) > 0 else 1 / _SPEED_RESERVE)]
    speeds = ", ".join(_number(speed) for speed in experiment.speeds)
    shares = ", ".join([_number(experiment.share)] * len(experiment.speeds))
    lines = [
        f"{_HEADER}: {experiment.duration:g} s in all, {experiment.share:g} s at each of {speeds} rpm.",
        "# Start trajectory and recorder together, and change the speed of the load machine on the way. For instance:",
        "#   ros2 run drive_id trajectory_publisher --ros-args --params-file THIS_FILE",
        "",
        "/**/trajectory_publisher:",
        "  ros__parameters:",
        "    trajectory: lissajous",
        f"    i_max: {_number(trajectory.i_max)}",
        f"    frequency_d: {_number(trajectory.frequency_d)}",
        f"    frequency_q: {_number(trajectory.frequency_q)}",
        f"    form: {trajectory.form}",
        f"    duration: {_number(experiment.duration)}",
        "    repeat: 1",
        f"    slew_rate: {_number(math.ceil(_SLEW_RESERVE * trajectory.slope))}",
        f"    sample_period: {_number(settings.sample_period)}",
        f"    lead_time: {_number(min(_LEAD_TIME, _MOST_AHEAD * settings.sample_period))}",
        "    # Band of the electrical speed, rad/s.",
        f"    speed_min: {_number(band[0])}",
        f"    speed_max: {_number(band[1])}",
        "",
        "# Where there is a simulated bench in place of the load machine; its speeds begin when it starts.",
        "/**/bench_simulator:",
        "  ros__parameters:",
        *([f"    machine: {json.dumps(machine)}"] if machine else []),
        f"    i_max: {_number(trajectory.i_max)}",
        f"    sample_period: {_number(settings.sample_period)}",
        f"    speeds: [{speeds}]",
        f"    segment_durations: [{shares}]",
    ]
    return "\n".join(lines) + "\n"


def free_shaft_tree(plan: FreeShaftPlan) -> dict[str, Any]:
    """Return a plan for a free shaft as plain values; speeds mechanical, rad/s, errors percent."""
    names = (
        "inertia", "added_inertia", "share", "acceleration", "speed_max", "mean_speed", "frequency", "duration",
        "swing",
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
    return "\n".join([
        f"{_HEADER}: a free shaft of {plan.inertia:.4g} kg m^2 swings for {figure.duration:.4g} s.",
        "# Better let a first start measure shaft_acceleration: characterize --first-start --free-shaft.",
        "",
        "/**/trajectory_publisher:",
        "  ros__parameters:",
        "    trajectory: free_shaft",
        f"    i_max: {_number(plan.machine.i_max)}",
        f"    amplitude: {_number(AMPLITUDE)}",
        "    # Electrical, rad/s^2 (by i_max) and rad/s.",
        f"    shaft_acceleration: {_number(plan.acceleration / AMPLITUDE * pairs)}",
        f"    shaft_speed_max: {_number(plan.speed_max * pairs)}",
        f"    mean_speed: {_number(plan.mean_speed * pairs)}",
        f"    swing_frequency: {_number(plan.frequency)}",
        f"    duration: {_number(plan.duration)}",
        "    repeat: 1",
        f"    slew_rate: {_number(math.ceil(_SLEW_RESERVE * figure.slope))}",
        f"    sample_period: {_number(plan.settings.sample_period)}",
        f"    lead_time: {_number(min(_LEAD_TIME, _MOST_AHEAD * plan.settings.sample_period))}",
        "",
        "# Where there is a simulated bench in place of the drive.",
        "/**/bench_simulator:",
        "  ros__parameters:",
        *([f"    machine: {json.dumps(machine)}"] if machine else []),
        f"    i_max: {_number(plan.machine.i_max)}",
        f"    sample_period: {_number(plan.settings.sample_period)}",
        "    free_shaft: true",
        f"    inertia: {_number(plan.inertia)}",
    ]) + "\n"  # fmt: skip


def check_plan_output(path: Path) -> None:
    """Check, before the work is done, that a plan may be written to a path.

    Raises
    ------
    OutputError
        When there is something else than an earlier plan.
    """
    try:
        with open_input(path) as opened:
            if opened.read(len(_HEADER)) == _HEADER.encode():
                return
    except (OSError, ValueError):
        pass  # not ours
    check_absent(path)


def write_plan(path: Path, text: str) -> None:
    """Write a plan, all of it or nothing; an earlier one is replaced.

    Raises
    ------
    OutputError
        When there is something else under this name, or it cannot be written.
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


def _number(value: float) -> str:
    """Write a number so that YAML and ROS take it for a floating-point one."""
    text = f"{value:.9g}"
    mantissa, exponent, power = text.partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + exponent + power
