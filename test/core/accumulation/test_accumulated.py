"""What is kept of recordings, and how that of several becomes one."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from synthetic import record

from drive_id.common.messages import Message
from drive_id.core.accumulation.accumulated import VALIDATION_PIECES, Accumulated, beginning, bounded
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, DataError
from drive_id.types import GroundTruth


def truth(machine: str) -> GroundTruth:
    axis = np.linspace(-1.0, 1.0, 4)
    return GroundTruth(
        machine=machine, i_d=axis, i_q=axis, psi_d=np.zeros((4, 4)), psi_q=np.zeros((4, 4)), resistance=1.0, i_max=1.0,
        pole_pairs=4, inverter_current=axis, inverter_voltage=axis, details={},
    )  # fmt: skip


def accumulated(name: str, seed: int = 0, machine: str = "ipm") -> Accumulated:
    samples = record(duration=0.05, noise=0.3, seed=seed)
    evidence = Evidence.within(FitSettings(method="joint"), 300.0)
    evidence.add(samples)
    return Accumulated(
        evidence, (samples,), (Message.told(f"About {name}."),), {f"{name}.mcap": f"digest of {name}"}, truth(machine),
        len(samples), int(samples.stamp[-1]) + seed,
    )  # fmt: skip


def test_all_of_both_is_kept():
    both = accumulated("one").merged(accumulated("two", seed=7))
    assert both.samples == both.evidence.samples == 1000
    assert both.warnings == ("About one.", "About two.")
    assert both.digests == {"one.mcap": "digest of one", "two.mcap": "digest of two"}
    assert both.truth is not None
    assert both.last_stamp == accumulated("one").last_stamp + 7
    assert len(both.validation) == 2


def test_the_same_recording_is_not_merged_twice():
    with pytest.raises(ConfigurationError, match=r"copy.mcap and one.mcap are the same recording"):
        accumulated("one").merged(replace(accumulated("one"), digests={"copy.mcap": "digest of one"}))


def test_two_recordings_of_one_name_are_both_kept():
    one = accumulated("one")
    both = one
    for digest in ("second", "third"):
        both = both.merged(replace(one, digests={"one.mcap": digest}))
    assert both.digests == {"one.mcap": "digest of one", "one.mcap (2)": "second", "one.mcap (3)": "third"}


def test_two_machines_are_not_merged():
    one, two = accumulated("one"), accumulated("two", machine="spm")
    with pytest.raises(DataError, match=r"different machines \(ipm in one.mcap, spm in two.mcap\)"):
        one.merged(two)
    assert one.merged(replace(two, truth=None)).truth is None
    assert one.merged(accumulated("three")).truth is not None


def test_of_a_long_recording_its_beginning_is_kept():
    samples = replace(record(duration=3.0), run_starts=np.array([0, 5000, 20000, 25000]))
    cut = beginning(samples, 2.0)
    assert len(cut) == 20000
    np.testing.assert_array_equal(cut.run_starts, [0, 5000])
    np.testing.assert_array_equal(cut.angle, samples.angle[:20000])
    assert beginning(samples, 3.0) is samples
    assert len(beginning(samples, 1e-9)) == 1


def test_of_many_recordings_the_same_few_are_kept_in_whatever_order_they_come():
    pieces = [record(duration=0.001, seed=seed, noise=1.0) for seed in range(14)]
    kept = bounded(pieces)
    assert len(kept) == VALIDATION_PIECES
    for order in list(permutations(range(4)))[::5]:
        shuffled = [pieces[k] for k in (*order, *range(4, 14))]
        in_groups = bounded([*bounded(shuffled[:11]), *bounded(shuffled[11:])])
        assert {id(piece) for piece in in_groups} == {id(piece) for piece in kept}
    assert bounded(pieces[:3]) == tuple(pieces[:3])
