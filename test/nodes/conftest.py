"""A bench of nodes for each file, and the fit with which several tests compare what the nodes reply."""

from __future__ import annotations

import pytest
from ros_bench import ros_bench

from drive_id.core.fit_settings import FitSettings
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.sources import Sources

I_MAX = 300.0  # A


@pytest.fixture(scope="module")
def ros():
    """A bench for all tests of a file; those that need a fresh one each have a fixture of their own."""
    with ros_bench() as bench:
        yield bench


@pytest.fixture(scope="session")
def fitted_in_full(bag):
    """The fit of ``bag`` by method full on the grid of the nodes under test, nothing written."""
    return fit_bags(Sources([bag]), None, FitSettings("full", i_max=I_MAX)).drive
