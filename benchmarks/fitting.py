"""The fit in this process: compared with the dense script and with reading the samples once."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from dense_script import fit as dense_fit
from measuring import Cost, in_turns
from recordings import experiment
from reporting import Row, Section, faster, seconds, smaller

from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.flux_models import TensorSpline
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.core.numerics.bspline import Axis
from drive_id.core.paper.regression import RegressionSums
from drive_id.core.paper.solver import Solution, solve
from drive_id.core.result.identify import identify
from drive_id.types import Samples

TITLE = "Fit in process, 10 s at 10 kHz"


def joint(samples: Samples) -> Solution:
    """Accumulate and solve method ``joint``, as ``drive-id fit`` does."""
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    low, high = i_dq.min(axis=0), i_dq.max(axis=0)
    model = TensorSpline(Axis(low[0], high[0], 8), Axis(low[1], high[1], 8))
    information = RegressionSums(model, TanhShape())
    information.add(samples)
    return solve(information.total, information.rows, with_inverter=True)


def dense(samples: Samples) -> tuple[float, float, Any]:
    """Run the dense script."""
    return dense_fit(samples.stamp, samples.i_abc, samples.u_abc, samples.angle, samples.speed)


def plain_sum(samples: Samples) -> float:
    """Read all samples once: a lower bound for any fit."""
    return float(sum(array.sum() for array in (samples.i_abc, samples.u_abc, samples.angle, samples.speed)))


def has_full() -> bool:
    """Tell whether method ``full`` is there."""
    (method,) = (field for field in fields(FitSettings) if field.name == "method")
    return "full" in method.metadata.get("choices", ())


def peak_memory(action: Callable[[], Any]) -> Cost:
    """Return the peak of additional memory allocated by Python and numpy."""
    tracemalloc.start()
    action()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return Cost(0.0, 0.0, peak)


def section(repeats: int) -> Section:
    """Measure."""
    samples = experiment(10.0)
    actions: dict[str, Callable[[], Any]] = {
        "dense": lambda: dense(samples),
        "joint": lambda: joint(samples),
        "identify": lambda: identify([samples], FitSettings(method="joint")),
    }
    if has_full():
        actions["full"] = lambda: identify([samples], FitSettings(method="full"))
    costs = in_turns(actions, repeats)
    rows = [
        faster("`joint`: accumulate and solve, against the dense script", costs["dense"], costs["joint"], 30),
        smaller(
            "its memory beyond the samples", peak_memory(lambda: dense(samples)), peak_memory(lambda: joint(samples))
        ),
        faster("`joint` with maps, standard errors and simulated currents", costs["dense"], costs["identify"]),
    ]
    if "full" in costs:
        rows.append(faster("`full`, complete, against the dense script's `joint`", costs["dense"], costs["full"], 1))
        rows.append(_long_fit(repeats))
    rows.append(_bandwidth(repeats))
    return Section(TITLE, _agreement(samples), tuple(rows))


def _long_fit(repeats: int) -> Row:
    long = experiment(60.0)
    cost = in_turns({"full": lambda: identify([long], FitSettings(method="full"))}, repeats)["full"]
    real, cpu = (f"{60.0 / taken:.0f} × real time" for taken in (cost.elapsed, cost.cpu))
    return Row("`full`, complete, 60 s at 10 kHz", "", seconds(cost.elapsed), real, cpu, "≤ 2.5 s")


def _bandwidth(repeats: int) -> Row:
    long = experiment(60.0)
    costs = in_turns({"sum": lambda: plain_sum(long), "joint": lambda: joint(long)}, max(repeats, 3))
    total, ours = costs["sum"], costs["joint"]
    per = {name: seconds(cost.elapsed / len(long)) for name, cost in costs.items()}
    ratio, cpu = (f"1/{value:.0f}" for value in (ours.elapsed / total.elapsed, ours.cpu / total.cpu))
    return Row("`joint` per sample, against a plain sum of the samples (60 s)", per["sum"], per["joint"], ratio, cpu)


def _agreement(samples: Samples) -> str:
    """Say that both solve the same problem."""
    ours, (resistance, voltage_error, gamma) = joint(samples), dense(samples)
    seen = np.abs(gamma) < 1
    difference = np.abs(ours.gamma - gamma)[seen].max() / np.abs(gamma[seen]).max()
    return (
        f"Both find R = {resistance * 1e3:.4f} / {ours.resistance * 1e3:.4f} mΩ and u_e = {voltage_error:.4f} / "
        f"{ours.voltage_error:.4f} V; their flux parameters differ by {difference:.0e} of the largest."
    )
