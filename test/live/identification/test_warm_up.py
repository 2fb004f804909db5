"""After the warm-up, live samples need no kernel that is not loaded yet."""

from __future__ import annotations

import numpy as np
import pytest
from loaded_kernels import loaded

from drive_id.bench.bench import SimulatedBench
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.fit_settings import FitSettings
from drive_id.files.messages.block_codec import encode_block
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.identification.warm_up import warm_up

I_MAX = 100.0
SECONDS = 2.0


def messages():
    """Yield section and serialized message of all that a bench publishes while its current follows a trajectory."""
    bench = SimulatedBench(machine_map("ipm"), SimulationSettings(), BenchSettings())
    t = 1e-4 * np.arange(round(SECONDS * 1e4), dtype=np.float64)
    wanted = Lissajous(I_MAX, 7.3, 2.3)(t).astype(np.float32)
    bench.references.add(0, 1e-4, *wanted.T)
    bench.advance(0)
    for now in range(10_000_000, round(SECONDS * 1e9), 10_000_000):
        for block in bench.advance(now):
            for section, columns in enumerate((block.currents, block.voltages, block.resolver)):
                yield section, encode_block(block.stamp, block.first_sample, block.sample_period, columns, "drive")


@pytest.mark.parametrize("method", ["full", "joint"])
def test_nothing_is_compiled_or_loaded_when_samples_arrive(method):
    """A message's callback loaded two kernels, seconds of compilation on a fresh machine."""
    fit = FitSettings(method=method, i_max=I_MAX)
    received = list(messages())
    warm_up(fit)
    before = loaded()
    assert len(before) > 10
    identifier = Identifier(IdentificationSettings(), fit)
    for message in received:
        identifier.receive(*message)
    assert identifier.refit() is not None
    identifier.job([], "")
    assert identifier.health("", [()] * 3).values["samples"] != "0"
    assert loaded() - before == set()
