"""What a faulty experiment is told: each fault shows as the sentence that names it, and a good one is told nothing."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from synthetic import reciprocal_flux, record, saturating_flux, tanh_drop

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.prescan import Prescan
from drive_id.core.fit_settings import FitSettings
from drive_id.core.methods import full
from drive_id.core.result import conclusion, warnings
from drive_id.core.result.identify import identify, score
from drive_id.core.result.warnings import condemned
from drive_id.errors import ConfigurationError, DataError, UnexplainedError
from drive_id.types import GroundTruth, Samples


@pytest.fixture(scope="module")
def good():
    return record(drop=tanh_drop, duration=3.0, noise=0.1)


@pytest.fixture(scope="module")
def plain():
    """What method full fits soon: a reciprocal map, no candidates of harmonics."""
    return record(reciprocal_flux, drop=tanh_drop, duration=3.0, noise=0.1)


JOINT, FULL = FitSettings("joint"), FitSettings("full", harmonic_orders=())


def told(samples, settings=JOINT):
    return " ".join(identify([samples], settings).report.warnings)


def test_a_good_recording_is_told_nothing(good):
    assert told(good) == ""


def test_an_offset_of_the_angle_breaks_the_symmetry(good):
    assert "mirror symmetry" in told(replace(good, angle=good.angle + 0.3))


def test_a_simulation_that_is_off_condemns_no_map_whose_curve_is_a_mean(monkeypatch):
    """With a hard dead time, 8 % of i_max was simulated wrong by a map within 0.15 %."""
    samples = record(reciprocal_flux, drop=tanh_drop, duration=3.0, noise=0.1)
    monkeypatch.setattr(conclusion, "mean_absolute_deviation", lambda *_: (20.0, 20.0))
    assert "simulated current is 20 A off" in told(samples, FULL)
    ours = full._statements
    monkeypatch.setattr(full, "_statements", lambda *a: (*ours(*a), Message("zero_crossings", ratio=3.0)))
    assert "simulated current" not in told(samples, FULL)


def test_a_large_offset_is_proposed_once(good):
    turned = replace(good, i_abc=good.i_abc[:, [1, 2, 0]], u_abc=good.u_abc[:, [1, 2, 0]])
    for samples, degrees in ((replace(good, angle=good.angle + np.pi), 180), (turned, -120)):
        said = told(samples)
        found = re.search(r"d axis lies ([+-]\d+) degrees electrical from that of the given angle. Add", said)
        assert abs(np.exp(1j * np.deg2rad(float(found[1]) - degrees)) - 1) < 0.05
        assert "mirror symmetry" not in said
        assert "magnet's flux is negative" not in said


def test_an_angle_near_half_a_turn_off_makes_the_magnet_negative(good, monkeypatch):
    """Where the checks say nothing."""
    monkeypatch.setattr(Prescan, "findings", lambda *_: ())
    assert "magnet's flux is negative" in told(replace(good, angle=good.angle + np.pi))
    assert "resistance is negative" in told(replace(good, i_abc=-good.i_abc))


@pytest.mark.accuracy
def test_a_weak_magnet_half_a_turn_off_is_told(monkeypatch):
    """5 mWb of 130, where the checks say nothing; a machine without a magnet is told nothing."""
    monkeypatch.setattr(Prescan, "findings", lambda *_: ())
    for magnet, angle, negative in ((0.005, np.pi, True), (0.005, 0.0, False), (0.0, 0.0, False)):
        samples = record(lambda i_dq, m=magnet: reciprocal_flux(i_dq) - [0.08 - m, 0.0], duration=3.0, noise=0.1)
        result = identify([replace(samples, angle=samples.angle + angle)], FULL)
        assert ("magnet_negative" in [said.code for said in result.report.warnings]) == negative


def test_the_flux_of_a_current_beside_a_hole_is_no_magnet(monkeypatch):
    """Its data end at i_d = -18 A beside zero current, and psi_d is L_d i_d there."""
    monkeypatch.setattr(Prescan, "findings", lambda *_: ())

    def round_a_hole(t, i_max):
        radius, phase = i_max * (0.53 + 0.47 * np.cos(2 * np.pi * 0.7 * t)), 2 * np.pi * 5.3 * t
        return np.stack([-np.abs(radius * np.cos(phase)) - 6.0, radius * np.sin(phase)], axis=-1)

    samples = record(
        lambda i_dq: reciprocal_flux(i_dq) - [0.08, 0.0], duration=4.0, noise=0.1, i_max=290.0, current=round_a_hole
    )
    result = identify([samples], FULL)
    assert "magnet_negative" not in [said.code for said in result.report.warnings]


@pytest.mark.accuracy
def test_a_shift_in_time_that_the_fit_refutes_is_not_told(plain, monkeypatch):
    """The rough model of the checks takes saturation for one; three of 100 good drives were told to shift stamps."""
    shift = Message("time_shift", delay=18, late=2e-3, unexplained=0.1, unexplained_corrected=0.07)
    monkeypatch.setattr(Prescan, "findings", lambda *_: (shift,))
    late = replace(plain.part(0, len(plain) - 12), u_abc=plain.u_abc[12:])
    for samples, settings, kept in ((plain, FULL, False), (late, FULL, True), (plain, JOINT, True)):
        codes = [said.code for said in identify([samples], settings).report.warnings]
        assert ("time_shift" in codes) == kept


def test_wrong_signs_and_orders_are_refused(good):
    swapped = replace(good, i_abc=good.i_abc[:, [0, 2, 1]])
    for said, samples in (
        ("wrong sign", replace(good, i_abc=-good.i_abc)),
        ("wrong sign", replace(good, u_abc=-good.u_abc)),
        ("Phases b and c of the currents seem to be swapped", swapped),
    ):
        with pytest.raises(DataError, match=said):
            identify([samples], JOINT)


@pytest.mark.accuracy
@pytest.mark.parametrize("settings", [FitSettings("psm"), JOINT, FULL], ids=lambda settings: settings.method)
def test_a_map_that_explains_too_little_is_refused_with_the_likeliest_cause(good, settings, monkeypatch):
    rng, part = np.random.default_rng(0), good.part(0, 10_000)
    samples = replace(part, u_abc=rng.permutation(part.u_abc))
    with pytest.raises(DataError, match="unexplained, and no order of phases"):
        identify([samples], settings)
    cause, minor = Message.told("The cable is loose: fix it.", "x"), Message.told("It is wet: dry it.", "speed_drift")
    named = "most likely, the cable is loose: fix it"
    for found, said in (((), "valid map: check"), ((minor,), "valid map: check"), ((minor, cause), named)):
        monkeypatch.setattr(Prescan, "findings", lambda *_, found=found: found)
        with pytest.raises(UnexplainedError, match=said):
            identify([samples], settings)


def test_noise_that_hides_the_rotation_is_told():
    slow = record(duration=3.0, speed=20.0, noise=1.0)
    assert "noise of the currents is large" in told(slow)


def test_a_single_faulty_current_does_not_stretch_the_map(good):
    i_abc = good.i_abc.copy()
    i_abc[15_000] = [900.0, -450.0, -450.0]
    result = identify([replace(good, i_abc=i_abc)], JOINT)
    assert result.flux_map.i_d.max() < 310
    assert result.report.samples_used == result.report.samples_read - 3
    assert "2 pairs of samples lie beyond" in " ".join(result.report.warnings)


def test_a_faulty_voltage_is_located(good):
    u_abc = good.u_abc.copy()
    u_abc[21_550, 0] += 500.0
    assert "around 2.15 s" in told(replace(good, u_abc=u_abc))


def test_a_jump_of_the_angle_is_refused(good):
    angle = good.angle.copy()
    angle[12_345] += 0.5
    with pytest.raises(DataError, match=r"jumps in 2 places, the first at 1\.234500 s by 0\.50 rad"):
        identify([replace(good, angle=angle)])


def test_references_give_the_disc_unless_the_currents_contradict_them(good):
    i_dq = frames.to_dq(good.i_abc, good.angle)
    assert identify([replace(good, i_dq_reference=i_dq * 0.97)], JOINT).i_max == pytest.approx(291.0, rel=0.01)
    assert identify([replace(good, i_dq_reference=i_dq / 1000)], JOINT).i_max == pytest.approx(300.0, rel=0.01)
    without = replace(good, stamp=good.stamp + 10**12)
    assert identify([replace(good, i_dq_reference=i_dq / 3), without], JOINT).i_max == pytest.approx(300.0, rel=0.01)


def test_a_map_far_from_the_truth_scores_nothing(good):
    axis = np.linspace(-1.0, 1.0, 9)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    psi = saturating_flux(grid)
    truth = GroundTruth("tiny", axis, axis, psi[..., 0], psi[..., 1], 0.02, axis, axis, 0.1, 4)
    small = replace(good, i_abc=good.i_abc * 1000)
    assert np.isnan(score(identify([small], JOINT), truth)).all()


def test_nothing_and_too_much_are_refused(good):
    with pytest.raises(DataError, match="no recordings"):
        identify([])
    with pytest.raises(DataError, match="equal in all phases"):
        identify([replace(good, u_abc=np.full_like(good.u_abc, 50.0))])
    with pytest.raises(ConfigurationError, match="64 x 64"):
        FitSettings("joint", splines_d=64, splines_q=64)


@pytest.mark.slow  # a large model
def test_large_models_keep_few_blocks(good):
    result = identify([good], FitSettings("joint", splines_d=20, splines_q=20))
    assert np.isfinite(result.sigma_resistance)


def resting(samples, before):
    """Put a rest at zero current in front of a recording."""
    count = round(before / samples.sample_period)
    rest = record(lambda i: saturating_flux(i * 0), duration=before, i_max=1e-9, noise=0.1, seed=5)
    stamp = samples.stamp[0] + np.arange(-count, 0) * round(samples.sample_period * 1e9)
    return Samples.joined([replace(rest, stamp=stamp), samples])


def test_a_rest_before_the_trajectory_changes_nothing(good):
    """The rest has no inverter: were it used, the voltage error would come out wrong."""
    plain, rested = (
        identify([good], FitSettings("joint", i_max=300.0)),
        identify([resting(good, 1.0)], FitSettings("joint", i_max=300.0)),
    )
    assert rested.voltage_error == pytest.approx(plain.voltage_error, rel=2e-3)
    assert rested.resistance == pytest.approx(plain.resistance, rel=2e-3)
    assert rested.report.samples_used == pytest.approx(plain.report.samples_used + 200, abs=2)
    used = identify([resting(good, 1.0)], FitSettings("joint", i_max=300.0, longest_rest=10.0))
    assert used.report.samples_used > rested.report.samples_used + 9000
    change = abs(rested.voltage_error - plain.voltage_error)
    assert abs(used.voltage_error - plain.voltage_error) > 5 * change


def test_a_rest_that_comes_in_pieces_is_the_same_rest(good):
    samples = resting(good, 0.5)
    settings = FitSettings("joint", i_max=300.0)
    whole, pieces = Evidence.within(settings, 300.0), Evidence.within(settings, 300.0)
    whole.add(samples)
    for run in samples.runs():
        for start in range(run.start, run.stop - 1, 333):
            pieces.add(samples.part(start, min(start + 334, run.stop)), continues=start > run.start)
    assert pieces.idle == whole.idle > 4000
    assert pieces.information.rows == whole.information.rows
    np.testing.assert_allclose(pieces.information.total, whole.information.total, rtol=1e-9)


def test_what_no_machine_can_have_is_refused_by_full_and_told_by_joint(plain, monkeypatch):
    """Where the checks say nothing: joint's standard errors are too wide to condemn a result."""
    monkeypatch.setattr(Prescan, "findings", lambda *_: ())
    reversed_currents = replace(plain, i_abc=-plain.i_abc)
    with pytest.raises(UnexplainedError, match=r"The resistance comes out negative \(\N{MINUS SIGN}.*second speed"):
        identify([reversed_currents], FULL)
    assert "resistance is negative" in told(reversed_currents)


@pytest.fixture(scope="module")
def judged(plain):
    """What a fit is judged by: evidence, estimate, MAD and limits."""
    given = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conclusion, "condemned", lambda *each: given.append(each))
        identify([plain], FULL)
    return given[0]


@pytest.mark.parametrize(
    ("share", "diverges", "refused"), [(0.3, False, True), (0.2, False, False), (0.2, True, True), (0.05, True, False)]
)
def test_a_map_without_valid_inductances_over_much_of_the_disc_is_refused(
    judged, monkeypatch, share, diverges, refused
):
    monkeypatch.setattr(warnings, "_indefinite", lambda _, points: np.arange(points.sum()) < share * points.sum())
    evidence, estimate, mad, limits = judged
    said = condemned(evidence, estimate, (np.nan, np.nan) if diverges else mad, limits)
    assert (said is not None) == refused
    if refused:
        assert re.search(r"not positive definite at \d+ %", said)
        assert ("diverges" in said) == diverges


@pytest.mark.accuracy
def test_an_angle_far_off_is_refused_where_symmetry_shows_it(plain):
    """30 or 89 degrees would give a map that is wrong by 25 to 77 %; a half turn only changes its sign."""
    for degrees in (30.0, 89.0):
        turned = replace(plain, angle=plain.angle + np.deg2rad(degrees))
        with pytest.raises(DataError, match=r"mirror-symmetric.*Add -\d\.\d+ rad to the angle"):
            identify([turned], FULL)
