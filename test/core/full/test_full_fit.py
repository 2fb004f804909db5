"""Method ``full`` on recordings of known truth that no simulator made: what it chooses, calibrates and enforces."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from synthetic import every, reciprocal_flux, saturating_flux
from synthetic import record as record_of

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import effect_search, selection, window_sums
from drive_id.core.full import fit as full_fit
from drive_id.core.full.calibration import corrected, rotated
from drive_id.core.full.effect_report import effect_entries, unseen_warning
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.full.fit import _with_rivals, fit_full, sigma
from drive_id.core.full.linearized import Taken
from drive_id.core.full.model import RESISTANCE, ModelSpec, delay_shares
from drive_id.core.full.solver import CurrentNoise, Solver, correct_attenuation
from drive_id.core.full.standard_errors import changes_by_batch, residual_statistics
from drive_id.core.full.windows import SHIFTS, Windows, kept_of
from drive_id.core.maps.flux_models import jacobian, positive_definite
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import gather, identify
from drive_id.errors import ConfigurationError, DataError

FULL = FitSettings("full", i_max=300.0, harmonic_orders=())
"""Without candidates of harmonics, which the recordings do not have."""
HEIGHTS = np.array([5.0, 4.0, 3.0])


def record(flux=reciprocal_flux, **options):
    return record_of(flux, **options)


def drop(i_abc):
    """Return drops of another height in each phase, V."""
    return HEIGHTS * np.tanh(i_abc / 6.0)


def even_drop(i_abc):
    return 4.0 * np.tanh(i_abc / 6.0)


def errors(identification, flux=reciprocal_flux):
    """Return the NRMSE of both fluxes on the map within the disc."""
    flux_map = identification.flux_map
    grid = flux_map.grid()
    i_dq = grid[flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= 295.0)]
    true = flux(i_dq)
    return np.sqrt(np.mean((identification.flux_map.continued(i_dq) - true) ** 2, axis=0)) / np.abs(true).max(axis=0)


def covered(identification):
    """Return the share of the map's values that are within two standard errors of the truth."""
    flux_map = identification.flux_map
    off = np.stack([flux_map.psi_d, flux_map.psi_q], axis=-1) - reciprocal_flux(flux_map.grid())
    return np.mean(np.abs(off / np.stack([flux_map.sigma_d, flux_map.sigma_q], axis=-1))[flux_map.inside] < 2.0)


def fitted(samples, settings=FULL):
    evidence = gather([samples], settings)
    return fit_full(evidence.windows.finished(), settings, evidence.turn, evidence.noise_variance)


@pytest.fixture(scope="module")
def samples():
    return record(drop=even_drop, duration=4.0, noise=0.3)


@pytest.fixture(scope="module")
def unequal(samples):
    """The same, by current sensors of unequal gains, which are an effect."""
    return replace(samples, i_abc=samples.i_abc * np.array([1.006, 0.997, 0.997]))


@pytest.fixture(scope="module")
def with_gains(unequal):
    return fitted(unequal)


@pytest.fixture(scope="module")
def result(samples):
    return identify([samples], FitSettings("full", i_max=300.0))


def test_it_finds_the_truth_and_says_how_well(result):
    assert np.all(errors(result) < 1e-3)
    assert abs(result.resistance - 0.02) < 1e-4
    assert result.sigma_resistance < 3e-4, "the drop's shape leaves 1.3 % of R open"
    np.testing.assert_allclose(result.inverter_voltage[-20:], 4.0, rtol=0.02)
    assert np.all(result.sigma_inverter_voltage[-20:] < 0.1)
    assert result.flux_map.harmonics == ()
    assert result.report.warnings == ()
    assert all(sentence.endswith(".") for sentence in result.statements)


@pytest.mark.accuracy
@pytest.mark.parametrize(("of_current", "of_angle"), [(3.0, 0.0), (0.0, 0.01)])
def test_what_noise_takes_from_the_map_is_given_back(of_current, of_angle):
    """Against the fit to the same currents and angle without noise, in the mean over other noise."""
    clean = record(drop=even_drop, duration=4.0)
    choice = ModelSpec(reciprocal=True, orders=(), penalty=1e-4)
    i_dq = 290 * np.random.default_rng(0).uniform(-0.7, 0.7, (300, 2))

    def with_and_without(size, seed=0):
        rng = np.random.default_rng(seed)
        i_abc = clean.i_abc + size * of_current * rng.standard_normal(clean.i_abc.shape)
        angle = clean.angle + size * of_angle * rng.standard_normal(len(clean))
        evidence = gather([replace(clean, i_abc=i_abc, angle=angle)], FULL)
        information = evidence.windows.finished()
        solver = Solver.over(information)
        solution = solver.solve(choice)
        met = CurrentNoise.met(evidence.current_variance, information.kept(), evidence.angle_variance)
        whole, _ = correct_attenuation(solver, solution, met)
        rows, columns = information.model.flux.rows(i_dq), information.model.map
        return np.array([rows.dot(each.estimate[columns]) for each in (solution, whole)])

    diluted, whole = np.mean([with_and_without(1.0, seed) for seed in range(8)], axis=0) - with_and_without(0.0)[0]
    foreseen = diluted - whole
    assert 0.7 < np.sum(diluted * foreseen) / np.sum(foreseen**2) < 2.0
    assert np.linalg.norm(whole) < 0.8 * np.linalg.norm(diluted)


def test_noise_of_the_angle_explains_what_it_does_to_windows(samples):
    fit = fitted(samples, replace(FULL, maps="reciprocal"))
    windows, estimate = Windows.joined(list(fit.selection.search.sums.kept())).thinned(500), fit.solution.estimate
    usual = fit.model.residuals(windows, estimate)
    squares = np.zeros(len(windows))
    for end in (0, 1):
        moved = replace(windows, angle=windows.angle.copy(), i_dq=windows.i_dq.copy())
        moved.angle[:, end] += 1e-4
        moved.i_dq[:, end] = (windows.i_dq[:, end] @ [1.0, 1j] * np.exp(-1e-4j)).view(np.float64).reshape(-1, 2)
        squares += np.square(fit.model.residuals(moved, estimate) - usual).sum(axis=1)
    noise = CurrentNoise(0.0, windows, angle_variance=1e-8)
    expected = windows.weights * squares
    np.testing.assert_allclose(noise.at_ends(fit.model, estimate, windows), expected, rtol=0.01)


@pytest.mark.accuracy
def test_what_only_noise_moves_is_not_known():
    """The slope across a ring is taken from noise, which attenuates it to nothing."""

    def ring(t, i_max):
        return i_max * np.stack([np.cos(6 * np.pi * t), np.sin(6 * np.pi * t)], axis=-1)

    fit = fitted(record(current=ring, i_max=90.0, drop=even_drop, duration=4.0, noise=0.1), replace(FULL, i_max=90.0))
    i_dq = 0.97 * ring(np.linspace(0, 0.3, 50), 90.0)
    rows = fit.model.flux.rows(i_dq)
    off = rows.dot(fit.solution.estimate[fit.model.map]) - reciprocal_flux(i_dq)
    foreseen = np.square(rows.dot(fit.assessment.changes[fit.model.map])).sum(axis=-1)
    assert 0.3 < np.sqrt(np.mean(off**2) / np.mean(foreseen)) < 2.0


def test_deviations_grow_with_the_noise(result):
    """With noise of 1 % and one speed, half a sample of delay is left open as well, unless it is known."""
    noisy = identify([record(drop=even_drop, duration=4.0, noise=3.0)], replace(FULL, calibrate_delay=False))
    inside = result.flux_map.inside & noisy.flux_map.inside
    growth = noisy.flux_map.sigma_d[inside] / result.flux_map.sigma_d[inside]
    assert 4 < np.median(growth) < 12
    assert np.isnan(result.flux_map.sigma_d[~result.flux_map.inside]).all()


@pytest.mark.accuracy
def test_free_maps_are_taken_when_the_machine_is_not_reciprocal():
    found = identify([record(saturating_flux, drop=even_drop, duration=4.0, noise=0.3)], FULL)
    assert np.all(errors(found, saturating_flux) < 1e-3)
    assert any("not reciprocal" in warning for warning in found.report.warnings)


@pytest.mark.parametrize("delay", [-3.2, -1.4, -1.0, 0.0, 0.5, 1.0, 2.0, 3.7])
def test_shares_shift_a_held_voltage(delay):
    """Integrals of a staircase, moved in time, against the staircase and its neighbours."""
    u = np.random.default_rng(0).standard_normal(60)
    staircase = np.concatenate([[0.0], np.cumsum(u)])
    exact = np.interp(np.arange(10, 50) - delay, np.arange(61), staircase)
    shares = delay_shares(delay)
    neighbours = np.array([[*(u[k + shift] for shift in SHIFTS), 0.0] for k in range(10, 50)])
    np.testing.assert_allclose(staircase[10:50] - neighbours @ shares, exact, atol=1e-12)
    assert shares.sum() == pytest.approx(delay)


def answering(samples, gain, noise):
    """Add noise, A, to the currents, and let the controller answer at once: by a voltage, V/A, that moves the flux."""
    rng, turn, period = np.random.default_rng(7), np.exp(1j * samples.angle), samples.sample_period
    i_dq = frames.space_vector(samples.i_abc) / turn
    inverse = np.linalg.inv(by_current(bent_flux, np.stack([i_dq.real, i_dq.imag], axis=1)))
    error = noise * frames.space_vector(rng.standard_normal((len(samples), 3)))
    voltage, psi = np.empty(len(samples), np.complex128), 0j
    for k in range(len(samples)):
        d, q = inverse[k] @ np.array([(psi / turn[k]).real, (psi / turn[k]).imag])
        error[k] += (d + 1j * q) * turn[k]
        voltage[k] = -gain * error[k]
        psi += period * voltage[k]
    return replace(samples, i_abc=samples.i_abc + frames.phases(error), u_abc=samples.u_abc + frames.phases(voltage))


def bent_flux(i_dq):
    """Return the flux of a machine that saturates so much that one speed tells a delay from an offset, Wb."""
    d, q = np.moveaxis(i_dq, -1, 0)
    return np.stack([0.08 + 8e-5 * d + 0.02 * np.tanh(d / 180), 1e-4 * q + 0.045 * np.tanh(q / 110)], axis=-1)


def by_current(flux, i_dq, step=1e-3):
    """Return the inductances (N, 2, 2), H."""
    return np.stack([flux(i_dq + x) - flux(i_dq - x) for x in step * np.eye(2)], axis=-1) / (2 * step)


@pytest.mark.accuracy
def test_a_winding_that_cools_by_a_hundred_kelvin_is_doubted():
    """With one speed in each recording, maps that are not reciprocal are as if R differed."""

    def turning(i_dq):
        return bent_flux(i_dq) + 1.2e-5 * np.stack([i_dq[..., 1], 0.0 * i_dq[..., 0]], axis=-1)

    recordings = [record(turning, duration=3.0, noise=0.3, speed=speed) for speed in (800.0, -480.0)]
    found = identify(recordings, FULL)
    (told,) = (warning for warning in found.report.warnings if warning.code == "resistance_change")
    assert told.values["kelvin"] < -60.0
    assert "non-reciprocal" in told


@pytest.mark.accuracy
def test_a_decimated_log_is_told_where_the_controller_answers_at_once():
    """Its answer predicts the noise, which hid the delay (0.00 +- 0.09 samples): nothing was told."""
    quick = answering(record(bent_flux, duration=6.0, speed=500.0), gain=0.3, noise=0.3)
    found = identify([every(quick, 2)], replace(FULL, maps="reciprocal"))
    assert abs(found.resistance - 0.02) < 2 * found.sigma_resistance
    assert {warning.code for warning in found.report.warnings} & {"decimated", "voltage_delay", "current_latency"}


@pytest.mark.accuracy
def test_measured_voltages_behind_a_filter_are_told_and_in_the_errors():
    """A filter with the pole 0.56 is 1.27 samples late at low frequency."""
    samples = record(drop=even_drop, duration=4.0, noise=0.3, speed=628.0)
    found = identify([replace(samples, u_abc=lfilter([0.44], [1.0, -0.56], samples.u_abc, axis=0))], FULL)
    told = next(entry for entry in found.calibrations if entry.name == "voltage_delay")
    assert told.message.kind == "warning"
    assert told.message in found.report.warnings
    assert told.value == pytest.approx(-0.56 / 0.44, rel=0.2)
    assert covered(found) > 0.9


@pytest.mark.accuracy
def test_voltages_that_are_a_whole_sample_early_may_be_filtered():
    """The pole 0.5 is one sample late at low frequency: the fluxes miss what it takes, 0.2 %."""
    samples = record(drop=even_drop, duration=4.0, noise=0.3, speed=628.0)
    found = identify([replace(samples, u_abc=lfilter([0.5], [1.0, -0.5], samples.u_abc, axis=0))], FULL)
    told = next(entry for entry in found.calibrations if entry.name == "voltage_delay")
    assert told.value == -1.0
    assert "Filtered measured voltages" in told.message
    assert told.message.kind == "statement"
    assert covered(found) > 0.9


@pytest.mark.parametrize("delay", [-0.25, -0.5, -0.7])
def test_an_early_voltage_follows_from_what_was_held_before_an_end(delay):
    shares = delay_shares(delay)
    assert shares[-1] == delay
    assert not shares[:-1].any()


@pytest.mark.accuracy
@pytest.mark.parametrize("late", [1, -1])
def test_voltages_recorded_beside_their_time_are_moved_back(samples, late):
    shifted = replace(samples, u_abc=np.roll(samples.u_abc, -late, axis=0))
    fit = fitted(shifted)
    assert fit.spec.delay == pytest.approx(late, abs=0.05)
    assert fit.assessment.jump is None, "it is late throughout"
    plain = fitted(shifted, replace(FULL, calibrate_delay=False, voltage_delay=float(late)))
    assert plain.spec.delay == late
    assert abs(plain.solution.resistance - 0.02) < 1e-3


@pytest.mark.accuracy
def test_what_is_uncertain_of_a_delay_is_uncertain_of_the_map(samples):
    """A delay of no half or whole sample, by which the fluxes turn, is not known exactly."""
    once, twice = (np.roll(samples.u_abc, -shift, axis=0) for shift in (1, 2))
    fit = fitted(replace(samples, u_abc=0.3 * once + 0.7 * twice))
    assert fit.spec.delay == pytest.approx(1.7, abs=0.1)
    form = np.zeros(fit.model.size)
    form[fit.model.map] = fit.model.flux.rows(np.zeros((1, 2))).sparse(fit.model.flux.parameters).toarray()[1]
    turned = fit.selection.search.found.delay.sigma * np.abs(fit.assessment.speeds).mean() * samples.sample_period
    assert sigma(form @ fit.assessment.changes) > 0.9 * turned * 0.08  # psi_q by psi_d = 80 mWb


@pytest.mark.accuracy
def test_what_a_rival_of_an_effect_would_change_is_uncertain_and_told_if_it_matters(with_gains):
    fit = with_gains
    (name,), rival = fit.spec.effects, "iron_loss"
    search = fit.selection.search
    search = replace(search, found=replace(search.found, taken=(Taken(name, (rival,)),)))
    selection = replace(fit.selection, search=search)
    change = _with_rivals(selection.solver, selection.solution, selection)[name]
    with_rival = selection.solver.solve(replace(fit.spec, effects=(rival,)))
    np.testing.assert_allclose(
        change[fit.model.map], (with_rival.estimate - selection.solution.estimate)[fit.model.map], atol=1e-12
    )
    assert not change[fit.model.effects].any()
    for factor, told in ((100.0, True), (1e-9, False)):
        judged = replace(fit.assessment, by_rivals={name: factor * change})
        entries = list(effect_entries(replace(fit, selection=selection, assessment=judged)))
        assert any(entry.doubtful for entry in entries) == told
        for entry in entries:  # of several values, those that are nothing are not in doubt
            assert entry.doubtful == (told and abs(entry.value) > 3 * entry.sigma)
            assert entry.message.values["rivals"] == rival


def skewed_flux(i_dq):
    """Return the gradient of a co-energy that is not even in i_q: 0.5 % of the flux."""
    d, q = np.moveaxis(i_dq, -1, 0)
    return reciprocal_flux(i_dq) + 5e-9 * np.stack([2 * d * q, d**2], axis=-1)


@pytest.mark.parametrize(("offset", "applied"), [(0.0, False), (0.05, True)])
def test_a_skew_of_the_machine_makes_the_angle_uncertain_by_as_much(offset, applied):
    """The map was turned by what the skew feigns, silently: 0.3 % of the flux, at 20 standard errors."""
    samples = record(skewed_flux, drop=even_drop, duration=4.0, noise=0.3)
    found = identify([replace(samples, angle=samples.angle + offset)], FULL)
    (entry,) = (entry for entry in found.calibrations if entry.name == "resolver_offset")
    assert entry.applied == applied
    assert entry.value == pytest.approx(offset, abs=2 * entry.sigma)
    assert 1e-3 < entry.sigma < 0.01
    inside = found.flux_map.inside
    psi = np.stack([found.flux_map.psi_d, found.flux_map.psi_q], axis=-1)[inside]
    sigma = np.stack([found.flux_map.sigma_d, found.flux_map.sigma_q], axis=-1)[inside]
    assert np.sqrt(np.mean(((psi - skewed_flux(found.flux_map.grid()[inside])) / sigma) ** 2)) < 2


@pytest.mark.accuracy
def test_one_segment_that_gains_most_does_not_prevent_the_rest_from_confirming(unequal, monkeypatch):
    """Where the speed was reversed, iron loss that saves 94 % of the squares was left out, and R was 16 % off."""
    ours = effect_search.held_out

    def with_one(*given):
        errors = ours(*given)
        errors[len(errors) // 2, 1:] += 200 * errors.sum(axis=0)[1:]
        return errors

    monkeypatch.setattr(effect_search, "held_out", with_one)
    assert fitted(unequal).spec.effects


@pytest.mark.accuracy
def test_an_effect_whose_size_depends_on_an_open_one_stays(unequal, with_gains, monkeypatch):
    """Heating beside a drop that follows the logged link was dropped: R was 5 % off at four standard errors."""
    before = with_gains
    (name,) = before.spec.effects
    own = before.model.effect(name)
    change = np.zeros(before.model.size)
    change[own] = before.solution.estimate[own]
    monkeypatch.setattr(full_fit, "_with_undecided", lambda *_: {"iron_loss": change})
    found = fitted(unequal)
    assert found.spec.effects == (name,)
    assert np.all(sigma(found.assessment.changes[own]) >= np.abs(change[own]))


@pytest.mark.accuracy
def test_what_an_effect_that_is_left_out_would_change_is_uncertain(unequal, with_gains, monkeypatch):
    """Hysteresis at one speed was confirmed by the search and then not significant: psi_q was 2.6 % off at 7 sigma."""
    weak = iter(with_gains.spec.effects)
    monkeypatch.setattr(full_fit, "_weakest", lambda *_: next(weak, None))
    without = fitted(unequal)
    assert with_gains.spec.effects and not without.spec.effects  # noqa: PT018
    own = without.model.map
    change = np.abs(with_gains.solution.estimate - without.solution.estimate)[own]
    large = change > 0.1 * change.max()
    assert np.all(sigma(without.assessment.changes[own])[large] > 0.9 * change[large])


@pytest.mark.accuracy
def test_what_an_effect_that_data_left_out_do_not_confirm_would_change_is_uncertain(unequal, with_gains, monkeypatch):
    """Hysteresis in twelve segments of random steps: R was 22 % off at 5.3 of its errors, and nothing was said."""
    monkeypatch.setattr(effect_search, "_unconfirmed", lambda _, __, chosen: next(iter(sorted(chosen.members)), None))
    without = fitted(unequal)
    solver, spec = without.selection.solver, without.spec
    assert not spec.effects
    chosen = with_gains.spec.effects
    assert without.selection.search.found.undecided[: len(chosen)] == chosen
    one, other = (solver.solve(replace(spec, effects=each.spec.effects)).estimate for each in (without, with_gains))
    assert np.all(sigma(without.assessment.changes)[without.model.map] > 0.99 * np.abs(other - one)[without.model.map])


@pytest.mark.accuracy
def test_voltages_that_slip_within_a_recording_are_refused_at_once(samples, monkeypatch):
    """Cells and free maps were tried on them before: 40 s of processor time."""
    monkeypatch.setattr(selection, "_resolved", None)
    part, half = samples.part(0, 20_000), 10_000
    u_abc = np.concatenate([part.u_abc[:half], np.roll(part.u_abc, 1, axis=0)[half:]])
    with pytest.raises(DataError, match=r"From 1\.[02]\d s of recording 2 on .*come later"):
        identify([part, replace(part, u_abc=u_abc)], FULL)


@pytest.mark.accuracy
def test_one_speed_of_few_samples_per_turn_is_warned_of():
    one, other = (record(duration=1.0, noise=0.3, speed=speed) for speed in (5000.0, -4500.0))
    warned = [{said.code for said in identify(parts, FULL).report.warnings} for parts in ([one], [one, other])]
    assert ["fast_rotation" in codes for codes in warned] == [True, False]


def test_an_offset_of_the_angle_is_found_by_symmetry(samples):
    turned = identify([replace(samples, angle=samples.angle + 0.03)], FULL)
    found = {entry.name: entry for entry in turned.calibrations}["resolver_offset"]
    assert found.applied
    assert found.value == pytest.approx(0.03, abs=max(4 * found.sigma, 2e-4))
    assert np.all(errors(turned) < 2e-3)
    as_measured = identify([replace(samples, angle=samples.angle + 0.03)], replace(FULL, calibrate_angle=False))
    assert errors(as_measured).max() > 5e-3


@pytest.mark.accuracy
def test_gain_mismatch_is_traced_back(samples):
    gains, offset = np.array([1.006, 0.997, 0.997]), np.array([0.6, -0.2, -0.4])
    faulty = identify([replace(samples, i_abc=samples.i_abc * gains + offset)], FULL)
    found = {entry.name: entry for entry in faulty.calibrations}
    expected = np.sum((gains - 1) * np.exp(2j * frames.PHASE_SHIFTS)) / 3
    value = complex(found["current_gain_mismatch_alpha"].value, found["current_gain_mismatch_beta"].value)
    assert abs(value - expected) < 0.15 * abs(expected)
    value = complex(found["current_offset_alpha"].value, found["current_offset_beta"].value)
    assert abs(value - frames.space_vector(offset[None])[0]) < 0.1
    assert np.all(errors(faulty) < 2e-3)


@pytest.mark.accuracy
def test_what_one_faulty_sensor_adds_to_all_currents_is_in_the_errors(samples):
    """1 % of one phase is a third of that of all currents, which no log shows."""
    found = identify([replace(samples, i_abc=samples.i_abc * (1.01, 1.0, 1.0))], FULL)
    said = next(said for said in found.statements if said.code == "common_gain")
    assert said.values["share"] == pytest.approx(0.01 / 3, rel=0.1)
    assert covered(found) > 0.9


def test_another_curve_of_the_drop_counts_beyond_the_errors_by_batches(samples, monkeypatch):
    fit = fitted(samples)
    solver = fit.selection.solver
    solution = solver.solve(replace(fit.spec, wide=0))
    monkeypatch.setattr(full_fit, "_BY_SHAPE", 0.0)  # any change counts
    batches = np.zeros((len(solution.estimate), 1))
    assert full_fit._among_curves(solver, solution, batches, False)[RESISTANCE] != 0
    monkeypatch.setattr(full_fit, "_BY_SHAPE", 2.0)
    batches[RESISTANCE] = fit.solution.resistance
    assert not full_fit._among_curves(solver, solution, batches, False).any()
    assert full_fit._among_curves(solver, solution, batches, True)[RESISTANCE] != 0  # the drop is no curve


@pytest.mark.parametrize(("wide", "share"), [(0.05, 1 / 1.04), (0.25, 0.5), (1.0, 1 / 17)])
def test_a_curve_counts_as_far_as_the_data_decide_on_it_and_not_what_is_known_of_inverters(wide, share):
    """A share of the drop in the last shape, at 2.5 standard errors: 0.4 made R of a clean drive 5 % uncertain."""
    columns, plain = np.arange(2, 32).reshape(-1, 3), np.zeros(32)
    plain[RESISTANCE], plain[columns[0]] = 1.0, 2.0
    bent = plain.copy()
    bent[RESISTANCE], bent[columns[0]], bent[columns[-1]] = 1.04, 2.0 * (1 - wide), 2.0 * wide

    def solve(spec):
        estimate, variance = (bent, 1.0 + 0.016**2) if spec.wide == 2 else (plain, 1.0)
        return SimpleNamespace(spec=spec, estimate=estimate, variance_of_resistance=variance)

    solver = SimpleNamespace(model=SimpleNamespace(phase_columns=lambda: columns), solve=solve)
    change = full_fit._among_curves(solver, solve(ModelSpec(True, ())), np.zeros((32, 1)), False)
    assert change[RESISTANCE] == pytest.approx(0.04 * share)


def test_each_phase_may_have_its_own_curve():
    settings = replace(FULL, per_phase_inverter=True)
    found = identify([record(drop=drop, duration=4.0, noise=0.3)], settings)
    np.testing.assert_allclose(found.phase_voltages[-20:].mean(axis=0), HEIGHTS, rtol=0.03)
    assert np.all(errors(found) < 2e-3)


def test_a_map_that_folds_can_be_kept_from_it():
    """Few noisy data and free maps give spurious folds."""
    weak = record(drop=even_drop, duration=1.5, noise=12.0)
    free = replace(FULL, maps="free")
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(0, 295, 30))
    i_dq = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)
    fits = [fitted(weak, replace(free, passive_maps=wish)) for wish in (False, True)]
    slopes = [jacobian(fit.model.flux, fit.solution.estimate[fit.model.map], i_dq) for fit in fits]
    folded, kept = map(positive_definite, slopes)
    assert not folded.all()
    assert (~kept).sum() < 0.1 * (~folded).sum()


@pytest.mark.accuracy
def test_a_passive_map_is_left_alone(samples):
    plain, enforced = (fitted(samples, replace(FULL, passive_maps=wish)) for wish in (False, True))
    np.testing.assert_array_equal(plain.solution.estimate, enforced.solution.estimate)


def test_correction_takes_out_what_was_put_in(samples):
    offset, mismatch, angle = 2.0 - 1.0j, 0.004 + 0.002j, 0.02
    i_s = frames.space_vector(samples.i_abc)
    measured = i_s + mismatch * i_s.conj() + offset
    i_abc = (measured[:, None] * np.exp(-1j * frames.PHASE_SHIFTS)).real
    faulty = replace(samples, i_abc=i_abc, angle=samples.angle + angle, u_abc=np.roll(samples.u_abc, -1, axis=0))
    values = {
        "current_offset_alpha": 2.0, "current_offset_beta": -1.0, "current_gain_mismatch_alpha": 0.004,
        "current_gain_mismatch_beta": 0.002, "resolver_offset": angle, "voltage_delay": 1.0,
    }  # fmt: skip
    found = corrected(
        faulty, [Calibration(name, value, 0.0, "", True, Message.told("")) for name, value in values.items()]
    )
    np.testing.assert_allclose(frames.space_vector(found.i_abc), i_s, atol=2 * abs(mismatch) ** 2 * 300 + 1e-9)
    np.testing.assert_allclose(found.angle, samples.angle)
    np.testing.assert_allclose(frames.space_vector(found.u_abc)[1:], frames.space_vector(samples.u_abc)[1:], atol=1e-9)
    untouched = corrected(
        faulty, [Calibration(name, value, 0.0, "", False, Message.told("")) for name, value in values.items()]
    )
    np.testing.assert_allclose(frames.space_vector(untouched.i_abc), measured, atol=1e-9)


def test_rotation():
    np.testing.assert_allclose(rotated(np.array([1.0, 0.0]), np.pi / 2), [0.0, 1.0], atol=1e-15)


def test_a_recording_of_too_few_windows_is_refused():
    with pytest.raises(DataError, match="fewer than the unknowns"):
        identify([record(duration=0.58)], replace(FULL, i_max=None))


def test_conditions_are_one_for_each_recording(samples):
    with pytest.raises(ConfigurationError, match="temperatures has 1 entry and there are more"):
        identify([samples, samples], replace(FULL, temperatures=(20.0,)))
    with pytest.raises(ConfigurationError, match="give both for each"):
        replace(FULL, temperatures=(20.0, 30.0), u_dc=(400.0,))


def test_temperatures_separate_winding_and_magnet():
    def hot_flux(i_dq):
        return reciprocal_flux(i_dq) - np.array([0.004, 0.0])

    cold = record(drop=even_drop, duration=3.0, noise=0.3)
    hot = record(hot_flux, resistance=0.02 * (1 + 3.93e-3 * 80), drop=even_drop, duration=3.0, noise=0.3, speed=300.0)
    found = identify([cold, hot], replace(FULL, temperatures=(20.0, 100.0)))
    assert found.resistance == pytest.approx(0.02, rel=0.01)
    coefficient, sigma = found.magnet_coefficient
    assert coefficient == pytest.approx(-0.004 / 80, abs=max(5 * sigma, 5e-7))
    assert np.all(errors(found) < 2e-3)
    assert max(found.report.mad_d, found.report.mad_q) < 0.3  # the simulated machine is as warm as the recorded one


def test_one_temperature_tells_that_the_map_holds_at_it():
    hot = record(resistance=0.02 * (1 + 3.93e-3 * 80), drop=even_drop, duration=3.0, noise=0.3)
    found = identify([hot], replace(FULL, temperatures=(100.0,)))
    assert found.resistance == pytest.approx(0.02, rel=0.01)
    told = {message.code: message for message in found.statements}
    assert told["map_temperature"].values["temperature"] == pytest.approx(100.0)
    assert "simulation_off" not in [message.code for message in found.report.warnings]


def test_merged_evidence_of_two_temperatures_is_concluded():
    """It has the settings of its first recording."""
    settings = replace(FULL, temperatures=(60.0, 90.0))
    parts = [Evidence.within(settings.of_recording(k), settings.i_max) for k in range(2)]
    recordings = [record(resistance=0.02 * (1 + 3.93e-3 * t), duration=3.0, noise=0.3) for t in (40.0, 70.0)]
    for part, samples in zip(parts, recordings, strict=True):
        part.next_recording()
        part.add(samples)
    found = conclude(parts[0].merged(parts[1]), recordings[:1])
    assert found.resistance == pytest.approx(0.02, rel=0.01)


def test_currents_beyond_i_max_do_not_doubt_the_model(samples):
    found = identify([samples], replace(FULL, i_max=180.0))
    assert max(found.report.mad_d, found.report.mad_q) > 3.0  # the map goes on linearly
    assert "simulation_off" not in [message.code for message in found.report.warnings]


def test_the_drop_scales_with_the_dc_link():
    low = record(drop=even_drop, duration=3.0, noise=0.3)
    high = record(drop=lambda i: 1.5 * even_drop(i), duration=3.0, noise=0.3, speed=-260.0)
    found = identify([low, high], replace(FULL, u_dc=(400.0, 600.0)))
    np.testing.assert_allclose(found.inverter_voltage[-20:], 4.0, rtol=0.02)
    assert max(found.report.mad_d, found.report.mad_q) < 0.3


def disturbed(samples, share):
    """Return samples whose inverter gives more than the commanded voltage by a share (N,)."""
    return replace(samples, u_abc=samples.u_abc / (1 + share[:, None]))


@pytest.mark.accuracy
def test_a_variation_in_step_with_the_segments_is_seen_whole(samples, monkeypatch):
    """Every second segment of 0.25 s has the positive half of its waves, from which its mean cannot be told."""
    monkeypatch.setattr(window_sums, "MOST_KEPT", 3000)
    wave = np.sin(2 * np.pi * 2.0 * 1e-4 * np.arange(len(samples)))
    found = fitted(disturbed(samples, 0.01 * wave), replace(FULL, maps="reciprocal"))
    assert (found.spec.effects, found.spec.delay) == (("link_ripple",), 0.0)
    ripple = found.solution.estimate[found.model.effect("link_ripple")][:2]
    assert np.hypot(*ripple) == pytest.approx(0.01, rel=0.05)


def test_the_changes_of_one_entry_are_those_of_all(samples):
    """But for the leverage, of which they take the mean."""
    fit = fitted(samples, replace(FULL, maps="reciprocal"))
    sums, solution = fit.selection.search.sums, fit.selection.solution
    noise = CurrentNoise.met(0.06, sums.kept())
    expected = residual_statistics(sums, solution, noise)[0][RESISTANCE]
    found = changes_by_batch(sums, solution, RESISTANCE)
    assert len(found) == len(expected)
    assert sigma(found) == pytest.approx(sigma(expected), rel=0.1)
    assert np.corrcoef(found, expected)[0, 1] > 0.95


@pytest.mark.accuracy
def test_what_happens_in_windows_left_out_of_the_selection_is_told(samples, monkeypatch):
    monkeypatch.setattr(window_sums, "MOST_KEPT", 3000)
    segment, unused = np.arange(len(samples)) // 2500, np.flatnonzero(~kept_of(np.arange(16), 2))
    settings = replace(FULL, maps="reciprocal")
    good, bad = (fitted(disturbed(samples, share * (segment == unused[4])), settings) for share in (0.0, 0.03))
    assert unseen_warning(good) is None
    assert 0.8 < good.assessment.unseen < 1.3
    warning = unseen_warning(bad)
    assert warning.values["ratio"] == pytest.approx(np.sqrt(bad.assessment.unseen))
    assert warning.values["ratio"] > 2
    assert warning.values["unused"] == pytest.approx(len(unused) / 16, abs=0.02)
