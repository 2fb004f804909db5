"""Recover known truths: from recordings made in closed form, without the simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import only, record, saturating_flux, tanh_drop

from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.paper.solver import jackknife, solve
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import identify
from drive_id.errors import CoverageError, DataError


def linear_flux(i_dq):
    return np.stack([0.08 + 2e-4 * i_dq[..., 0], 3e-4 * i_dq[..., 1]], axis=-1)


def errors(identification, flux=saturating_flux):
    grid = identification.flux_map.grid()
    inside = identification.flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= 300)
    true = flux(grid[inside])
    return np.sqrt(np.mean((identification.flux_map.psi[inside] - true) ** 2, axis=0)) / np.abs(true).max(axis=0)


@pytest.fixture(scope="module")
def clean():
    return record(drop=tanh_drop, duration=4.0)


def test_joint_recovers_flux_resistance_and_inverter(clean):
    result = identify([clean], FitSettings("joint"))
    assert errors(result).max() < 2e-3
    assert result.resistance == pytest.approx(0.02, rel=0.02)
    assert result.voltage_error == pytest.approx(4.0, rel=0.02)
    assert result.report.mad_d < 0.5
    assert result.report.mad_q < 0.5
    assert result.report.warnings == ()


def test_leaving_the_inverter_out_biases_flux_and_resistance(clean):
    result = identify([clean], FitSettings(method="psm"))
    assert errors(result).min() > 0.02
    assert result.resistance > 0.03
    assert result.voltage_error == 0.0
    assert result.inverter_voltage.max() == 0.0


def test_the_linear_machine_is_found_exactly_by_both_kinds_of_model():
    samples = record(linear_flux, duration=3.0)
    for settings in (
        FitSettings("joint"),
        FitSettings("joint", flux_model="linear"),
        FitSettings("joint", flux_model="polynomial"),
    ):
        result = identify([samples], settings)
        assert errors(result, linear_flux).max() < 5e-5  # the trapezoids of the paper
        assert result.resistance == pytest.approx(0.02, rel=1e-3)
        assert abs(result.voltage_error) < 1e-3


def test_a_polynomial_model_beats_the_linear_one_on_a_saturating_machine(clean):
    linear = errors(identify([clean], FitSettings("joint", flux_model="linear")))
    polynomial = errors(identify([clean], FitSettings("joint", flux_model="polynomial", polynomial_degree=7)))
    assert np.all(polynomial < 0.2 * linear)


@pytest.mark.cases
@pytest.mark.parametrize("speed", [-209.0, 42.0, 1250.0])
def test_any_speed_and_direction(speed):
    result = identify([record(drop=tanh_drop, speed=speed, duration=4.0)], FitSettings("joint"))
    assert errors(result).max() < 4e-3
    assert result.voltage_error == pytest.approx(4.0, rel=0.05)


def test_several_recordings_count_as_one(clean):
    half = len(clean) // 2
    parts = [clean.part(0, half + 1), clean.part(half, len(clean))]
    whole, split = (identify(recordings, FitSettings("joint")) for recordings in ([clean], parts))
    np.testing.assert_allclose(split.flux_map.psi_d, whole.flux_map.psi_d, atol=1e-9)
    assert split.resistance == pytest.approx(whole.resistance, rel=1e-9)


def test_accumulating_within_a_known_disc_needs_no_look_at_the_data_first(clean):
    offline = identify([clean], FitSettings("joint", i_max=300.0))
    evidence = Evidence.within(FitSettings("joint", i_max=300.0), 300.0)
    step = 777
    for start in range(0, len(clean) - 1, step):
        evidence.add(clean.part(start, min(start + step + 1, len(clean))))
    live = conclude(evidence, [])
    inside = offline.flux_map.inside
    np.testing.assert_allclose(live.flux_map.psi_q[inside], offline.flux_map.psi_q[inside], atol=1e-9)
    assert live.resistance == pytest.approx(offline.resistance, rel=1e-9)
    assert np.isnan(live.report.mad_d)
    assert live.report.warnings == ()


@pytest.mark.accuracy
def test_deviations_cover_the_scatter_of_repeated_experiments():
    """1-sigma values against the spread over seeds.

    They err on the wide side: noise in the regressors also biases each block, the same way in each experiment.
    """
    settings = FitSettings("joint", splines_d=5, splines_q=5)
    recordings = (record(linear_flux, noise=0.6, duration=4.0, seed=seed) for seed in range(10))
    results = [identify([samples], settings) for samples in recordings]
    for name in ("resistance", "voltage_error"):
        scatter = np.std([getattr(result, name) for result in results], ddof=1)
        stated = np.mean([getattr(result, f"sigma_{name}") for result in results])
        assert 1 < stated / scatter < 10
    inside = results[0].flux_map.inside
    scatter = np.std([result.flux_map.psi_d[32, 32] for result in results], ddof=1)
    stated = np.mean([result.flux_map.sigma_d[32, 32] for result in results])
    assert 1 < stated / scatter < 10
    assert np.isfinite(results[0].flux_map.sigma_d[inside]).all()


def test_leaving_a_block_out_is_what_the_deviations_say(clean):
    """The formula against really solving without the block."""
    evidence = Evidence.within(FitSettings("joint", splines_d=5, splines_q=5), 300.0)
    evidence.add(clean)
    blocks = evidence.information.blocks
    whole = solve(blocks.sum(axis=0), evidence.information.rows, with_inverter=True)
    spread = jackknife(blocks, whole)
    factor = np.sqrt((len(blocks) - 1) / len(blocks))
    for k in (0, len(blocks) // 2):
        without = solve(blocks.sum(axis=0) - blocks[k], evidence.information.rows, with_inverter=True)
        change = factor * abs(without.resistance - whole.resistance)
        assert abs(spread.resistance[k]) == pytest.approx(change, rel=0.05)


def hurried(samples, factor):
    """The same currents so many times as fast, in a machine of so many times the resistance."""
    return replace(
        samples,
        stamp=samples.stamp[0] + (samples.stamp - samples.stamp[0]) // factor,
        sample_period=samples.sample_period / factor,
        u_abc=samples.u_abc * factor,
        speed=samples.speed * factor,
    )


@pytest.mark.parametrize("method", ["psm", "joint"])
def test_one_block_of_time_leaves_the_deviations_unknown(method):
    """There is nothing to leave out; the map is that of the data all the same."""
    settings = FitSettings(method, splines_d=4, splines_q=4)
    drop = tanh_drop if method == "joint" else np.zeros_like
    single, several = (
        identify([hurried(record(drop=drop, duration=duration), 20)], settings) for duration in (1.98, 3.98)
    )
    for result, known in ((single, False), (several, True)):
        inside = result.flux_map.inside
        for deviation in (result.flux_map.sigma_d, result.flux_map.sigma_q):
            assert (np.isfinite(deviation[inside]) if known else np.isposinf(deviation[inside])).all()
            assert np.isnan(deviation[~inside]).all()
        assert np.isfinite(result.sigma_resistance) == known
        assert ("too short to estimate standard errors" in " ".join(result.report.warnings)) != known
        assert np.isfinite(result.flux_map.psi_d).all()
        assert max(errors(result)) < 0.02
    assert single.report.mad_q < 5


def test_half_a_disc_gives_half_a_map():
    samples = record(duration=4.0)
    half = only(samples, frames.to_dq(samples.i_abc, samples.angle)[:, 0] < 0)
    result = identify([half], FitSettings("joint", i_max=300.0))
    assert 0.4 < result.report.coverage < 0.6
    assert errors(result).max() < 5e-3
    grid = result.flux_map.grid()
    assert not result.flux_map.inside[grid[..., 0] > 20].any()
    assert np.isnan(result.flux_map.sigma_d[grid[..., 0] > 20]).all()
    assert np.abs(result.flux_map.psi_d).max() < 0.5  # sane values also where there are no data
    assert result.report.gaps == len(half.run_starts) - 1
    assert result.report.unseen > 0
    assert result.report.rank < result.report.parameters


def test_silence_is_refused(clean):
    with pytest.raises(DataError, match="voltages are zero"):
        identify([replace(clean, u_abc=np.zeros_like(clean.u_abc))])
    with pytest.raises(CoverageError):
        identify([replace(clean, i_abc=np.zeros_like(clean.i_abc))])
