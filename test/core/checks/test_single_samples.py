"""One wrong sample among many is found where it is; nothing else is taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import cut

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.checks.prescan import Prescan
from drive_id.fitting.simulated import run_experiment


@pytest.fixture(scope="module")
def samples():
    return run_experiment(machine_map("pmsyrm"), SimulationSettings(current_noise=1e-3), seconds=1.0).samples


def single(samples, pieces=None):
    prescan = Prescan()
    if pieces is None:
        prescan.add(samples)
    else:
        for start in range(0, len(samples), pieces):
            piece, continues = cut(samples, start, min(start + pieces, len(samples)))
            prescan.add(piece, continues=continues)
    return [finding for finding in prescan.copy().findings() if finding.code == "single_sample"]


def with_flipped(samples, name, at, bit):
    """Flip a bit of a float32."""
    values = getattr(samples, name).astype(np.float32)
    values.reshape(len(values), -1)[at, -1:].view(np.uint32)[...] ^= np.uint32(1 << bit)
    return replace(samples, **{name: values.astype(np.float64)})


def test_good_samples_are_told_nothing(samples):
    assert single(samples) == []


@pytest.mark.parametrize(
    ("pieces", "at"),
    [(None, 2), (None, 4711), (None, 9997), (1667, 3), (1667, 4711), (1667, 5001), (1667, 5002)]
    + [(5000, at) for at in (2, 3, 4999, 5000, 5001, 5002, 9997)],
)
@pytest.mark.parametrize(("name", "error"), [("i_abc", 4.0), ("angle", 0.06)])
def test_a_wrong_sample_is_located_wherever_pieces_end(samples, at, pieces, name, error):
    values = getattr(samples, name).copy()
    values.reshape(len(values), -1)[at, -1] -= error
    (finding,) = single(replace(samples, **{name: values}), pieces)
    assert finding.values["samples"] == 1
    assert finding.values["time"] == pytest.approx((samples.stamp[at] - samples.stamp[0]) * 1e-9, abs=1e-9)
    assert finding.values["size"] == pytest.approx(error * (2 / 3 if name == "i_abc" else 1.0), rel=0.1)
    assert ("phase c" if name == "i_abc" else "angle") in finding


@pytest.mark.parametrize("amplitude", [0.05, 300.0])
@pytest.mark.parametrize("turn", [0.02, -0.3])
@pytest.mark.parametrize(("phase", "name"), [(1, "phase b"), (None, "angle")])
def test_a_wrong_sample_of_drives_of_any_size_and_speed(samples, amplitude, turn, phase, name):
    angle = turn * np.arange(len(samples)) + 0.1
    i_abc = amplitude * np.cos(angle[:, None] - 2 * np.pi / 3 * np.arange(3))
    u_abc, speed = 60.0 / amplitude * i_abc, np.full(len(samples), turn / samples.sample_period)
    if phase is None:
        angle[4711] += 0.06
    else:
        i_abc[4711, phase] += 0.1 * amplitude
    angle = np.angle(np.exp(1j * angle))
    changed = replace(samples, i_abc=i_abc, u_abc=u_abc, angle=angle, speed=speed, i_dq_reference=None)
    (finding,) = single(changed)
    assert name in finding
    assert finding.values["samples"] == 1
    assert finding.values["time"] == pytest.approx((samples.stamp[4711] - samples.stamp[0]) * 1e-9, abs=1e-9)


def test_a_jump_of_the_angle_by_a_turn_is_none(samples):
    angle = samples.angle.copy()
    angle[5000] += 2 * np.pi
    assert single(replace(samples, angle=angle)) == []


@pytest.mark.parametrize("bit", [31, 23, 22])
def test_flipped_bits_of_large_currents(samples, bit):
    at = int(np.abs(samples.i_abc[100:, 2]).argmax()) + 100
    (finding,) = single(with_flipped(samples, "i_abc", at, bit))
    assert finding.values["time"] == pytest.approx(at * 1e-4, abs=1e-6)


@pytest.mark.parametrize(
    ("pieces", "at"),
    [(None, 4), (None, 4711), (None, 9994), (1667, 4999), (1667, 5001)] + [(5000, at) for at in (4, 4999, 5001, 9994)],
)
@pytest.mark.parametrize(("name", "error"), [("i_abc", 4.0), ("angle", 0.06)])
def test_two_wrong_samples_in_a_row_are_located(samples, at, pieces, name, error):
    values = getattr(samples, name).copy()
    values.reshape(len(values), -1)[at : at + 2, -1] -= error
    (finding,) = single(replace(samples, **{name: values}), pieces)
    assert finding.values["samples"] == 2
    times = (samples.stamp[at : at + 2] - samples.stamp[0]) * 1e-9
    assert np.abs(times - finding.values["time"]).min() < 1e-9
    assert finding.values["size"] == pytest.approx(error * (2 / 3 if name == "i_abc" else 1.0), rel=0.1)


def test_steps_are_no_single_samples(samples):
    """Held references that step, as in a test of inductances."""
    i_abc = samples.i_abc + np.where(np.arange(len(samples))[:, None] // 500 % 2, [1.0, -0.5, -0.5], 0.0)
    assert single(replace(samples, i_abc=i_abc)) == []


def test_noise_that_is_everywhere_is_none(samples):
    rng = np.random.default_rng(2)
    i_abc = samples.i_abc + rng.choice([0.0, 2.0], size=samples.i_abc.shape, p=[0.98, 0.02])
    assert single(replace(samples, i_abc=i_abc)) == []
