"""Evidence that is merged, stored and restored is that of the samples added one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import record

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.bspline import Axis
from drive_id.errors import ConfigurationError
from drive_id.types import Samples

I_MAX = 300.0


def evidence(*recordings: Samples, settings: FitSettings | None = None, i_max: float = I_MAX) -> Evidence:
    found = Evidence.within(settings or FitSettings(method="joint"), i_max)
    for samples in recordings:
        found.add(samples)
    return found


@pytest.fixture(scope="module")
def recordings():
    """Three of different lengths, speeds and noise; the first ends in the middle of a block of time."""
    return [
        record(duration=1.13, noise=0.3, seed=1),
        record(duration=0.8, noise=0.3, speed=150.0, seed=2),
        record(duration=1.5, noise=0.1, speed=300.0, seed=3),
    ]


def assert_alike(one: Evidence, other: Evidence, rtol: float = 1e-12) -> None:
    for name in ("samples", "gaps", "idle"):
        assert getattr(one, name) == getattr(other, name), name
    for name in ("sample_period", "noise_share"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=rtol), name
    np.testing.assert_array_equal(one.visits.count, other.visits.count)
    total = other.information.total
    np.testing.assert_allclose(one.information.total, total, rtol=rtol, atol=rtol * np.abs(total).max())
    assert (one.information.rows, one.information.outside) == (other.information.rows, other.information.outside)


def test_merged_is_added_one_after_the_other(recordings):
    one, two, three = (evidence(samples) for samples in recordings)
    assert_alike(one.merged(two).merged(three), evidence(*recordings))
    assert one.samples == len(recordings[0])  # as they were


def test_samples_can_be_added_to_what_was_merged(recordings):
    merged = evidence(recordings[0]).merged(evidence(recordings[1]))
    before = merged.copy()
    merged.add(recordings[2])
    assert_alike(merged, evidence(*recordings))
    assert_alike(before, evidence(*recordings[:2]))


def test_nothing_merged_changes_nothing(recordings):
    assert_alike(evidence(recordings[0]).merged(evidence()), evidence(recordings[0]))
    assert_alike(evidence().merged(evidence(recordings[0])), evidence(recordings[0]))


def test_a_restored_state_goes_on_as_if_nothing_had_been(recordings):
    """In the middle of a block of time, and of a rest."""
    whole = recordings[0]
    cut = 4321
    first, second = whole.part(0, cut), whole.part(cut - 1, len(whole))
    straight, restored = evidence(first), evidence()
    restored.restore(straight.state())
    assert_alike(restored, straight)
    for found in (straight, restored):
        found.add(second, continues=True)
    assert_alike(restored, straight)
    total = straight.information.total.max()
    np.testing.assert_allclose(restored.information.blocks, straight.information.blocks, atol=1e-12 * total)


def test_errors_of_interpolated_angles_are_averaged_over_recordings(recordings):
    first, second = replace(recordings[0], angle_error=3e-3), recordings[1]
    expected = 9e-6 * len(first) / (len(first) + len(second))
    both = evidence(first).merged(evidence(second))
    assert both.interpolation_variance == pytest.approx(expected)
    assert evidence(first, second).interpolation_variance == pytest.approx(expected)
    assert Samples.joined([first, replace(second, stamp=second.stamp + 10**12)]).angle_error ** 2 == pytest.approx(
        expected
    )


def test_a_state_of_another_model_is_refused(recordings):
    state = evidence(recordings[0]).state()
    for settings in (
        FitSettings("joint", splines_d=9),
        FitSettings("joint", grid_points=33),
        FitSettings("joint", flux_model="linear"),
    ):
        with pytest.raises(ValueError, match="is needed"):
            evidence(settings=settings).restore(state)
    del state["information/rows"]
    with pytest.raises(KeyError):
        evidence().restore(state)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (lambda: evidence(settings=FitSettings("joint", splines_q=9)), r"splines_q is 8 in one and 9 in the other"),
        (
            lambda: evidence(settings=FitSettings("joint", longest_rest=1.0)),
            r"longest_rest is 0.02 in one and 1.0 in the other",
        ),
        (lambda: evidence(i_max=280.0), r"i_max is 300 A in one and 280 A in the other"),
        (
            lambda: Evidence(FitSettings(method="joint"), Axis(-300, 300, 8), Axis(-310, 310, 8), I_MAX),
            r"their maps have different ranges",
        ),
    ],
)
def test_what_was_accumulated_differently_is_not_merged(other, said):
    with pytest.raises(ConfigurationError, match=rf"differently \({said}\) and cannot be merged: .*\.$"):
        evidence().merged(other())


def test_methods_and_radii_of_settings_do_not_matter(recordings):
    one, two = evidence(recordings[0]), evidence(recordings[1], settings=FitSettings(method="psm", i_max=I_MAX))
    assert_alike(one.merged(two), evidence(*recordings[:2]))


@pytest.mark.parametrize("most", [4, 6, 10, 64])
def test_recordings_added_one_after_the_other_get_the_same_blocks_as_merged_ones(recordings, most):
    """Also where they are halved on the way, in the middle of a recording."""
    together, merged = evidence(), evidence()
    parts = [evidence() for _ in recordings]
    for found in (together, merged, *parts):
        found.information.max_blocks = most
    for samples, part in zip(recordings, parts, strict=True):
        together.next_recording()
        together.add(samples)
        part.add(samples)
        merged = merged.merged(part)
    assert len(together.information.blocks) <= most
    assert together.information.block_duration == merged.information.block_duration
    total = together.information.total.max()
    np.testing.assert_allclose(together.information.blocks, merged.information.blocks, atol=1e-12 * total)


def test_full_forms_the_sums_of_the_paper_only_where_they_are_asked_for(recordings):
    full = FitSettings(method="full", i_max=I_MAX)
    alone, more = (Evidence.within(full, I_MAX, compared=compared) for compared in (False, True))
    for each in (alone, more):
        each.add(replace(recordings[1], i_abc=1.2 * recordings[1].i_abc))
    assert {*more.accumulators()} - {*alone.accumulators()} == {"information"}
    assert alone.outside == more.outside > 0
    for one, other in zip(*(each.windows.finished().triangles() for each in (alone, more)), strict=True):
        np.testing.assert_array_equal(one, other)
    for merged in (alone.merged(more), more.merged(alone)):
        assert (merged.information, merged.outside) == (None, 2 * more.outside)
    joint = replace(full, method="joint")
    assert (alone.suits(joint), more.suits(joint)) == (False, True)
    assert more.copy(joint).information.rows > 0
    with pytest.raises(ConfigurationError, match="for method full, which is not enough for method joint: accumulate"):
        alone.copy(joint)
