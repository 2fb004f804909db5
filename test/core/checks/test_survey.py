"""The survey of pieces against the checks and the preparation of whole recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import cut, record

from drive_id.core.checks.survey import Survey
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import gather
from drive_id.errors import DriveIdError


def surveyed(samples, part, **options):
    survey = Survey(**options)
    for start in range(0, len(samples), part):
        piece, continues = cut(samples, start, min(start + part, len(samples)))
        survey.add(piece, continues=continues)
    return survey


@pytest.fixture(scope="module")
def samples():
    whole = record(duration=2.0, noise=0.3)
    stamp = whole.stamp + np.where(np.arange(20_000) >= 7000, 10**9, 0)
    return replace(whole, stamp=stamp, run_starts=np.array([0, 7000]))


@pytest.mark.parametrize("part", [20_000, 7000, 913])
@pytest.mark.parametrize("reference", [None, 1.0, 0.5])
def test_range_and_radius_are_those_of_the_whole(samples, part, reference):
    if reference:
        angle = np.linspace(0, 20, len(samples))
        circle = reference * 300 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        circle[:100] = np.nan
        samples = replace(samples, i_dq_reference=circle)
    survey = surveyed(samples, part, kept=100)
    survey.check()
    found, expected = survey.prepare(FitSettings(method="joint")), gather([samples], FitSettings(method="joint"))
    assert (found.d, found.q) == (expected.d, expected.q)
    assert found.i_max == pytest.approx(expected.i_max, rel=1e-14)
    assert survey.samples == len(samples)


def spoiled(samples):
    rng = np.random.default_rng(0)
    zero = np.zeros(len(samples))
    for size in (1e6, 1e200):
        spike = samples.i_abc.copy()
        spike[7100] = np.array([1, -0.5, -0.5]) * size
        yield replace(samples, i_abc=spike)
    yield replace(samples, speed=zero, angle=zero)
    yield replace(samples, speed=samples.speed / 4)
    yield replace(samples, angle=-samples.angle)
    yield replace(samples, i_abc=rng.normal(size=samples.i_abc.shape))
    yield replace(samples, i_abc=zero[:, None] + zero[:3])
    jump = samples.angle.copy()
    jump[[12_000, 9000]] += 2.0
    yield replace(samples, angle=jump)
    yield replace(samples, i_dq_reference=np.full((len(samples), 2), 3.0))


@pytest.mark.parametrize("number", range(9))
def test_errors_are_those_of_the_whole(samples, number):
    wrong = list(spoiled(samples))[number]
    with pytest.raises(DriveIdError) as expected:
        gather([wrong], FitSettings(method="joint"))
    with pytest.raises(type(expected.value)) as found:
        surveyed(wrong, 1731, kept=100).check()
    assert str(found.value) == str(expected.value)


def test_the_radius_of_the_settings_needs_no_survey():
    assert Survey().prepare(FitSettings("joint", i_max=7.0)).i_max == 7.0


def test_pieces_without_references_between_others_are_no_held_point(samples):
    survey = Survey()
    held = np.full((7000, 2), 3.0)
    first, _ = cut(samples, 0, 7000)
    survey.add(replace(first, i_dq_reference=held))
    survey.add(cut(samples, 7000, 20_000)[0])
    survey.check()
