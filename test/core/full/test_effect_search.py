"""The search among sets of effects, over sums of squares that are known beforehand."""

from types import SimpleNamespace

import numpy as np

from drive_id.core.full.effect_search import _Search, _taken, _undecided
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.reduced import Subset, delayed

BY_NOISE = 0.2


def search_among(saved):
    """Return the search where each effect saves a share of the squares, and two together what the larger one does."""
    of_voltage = np.eye(1, len(delayed(0.0)))  # of the columns that a delay combines

    def subset(names):
        left = 1.0 - max((saved[name] for name in names), default=0.0)
        values = {name: 1e-6 * np.ones((CATALOGUE[name].width, 1)) * of_voltage for name in names}
        return Subset(names, left * of_voltage.T @ of_voltage, values)

    plain, noise = SimpleNamespace(delay=0.0), SimpleNamespace(turn=0.02, period=1e-4)
    data = {"one_speed": True, "turn": 0.0, "parts": 1, "least": 0.0}
    rules = SimpleNamespace(allowed=tuple(saved), plain=plain, noise=noise, **data)
    return _Search(rules, SimpleNamespace(subset=subset), BY_NOISE)


def test_a_link_that_explains_too_little_to_be_taken_is_a_rival_of_what_explains_less():
    """A filter of the currents was taken instead of a link that falls: R was 22 % off, 13 standard errors, silently."""
    search = search_among({"current_latency": 0.10, "link_sag": 0.12})
    chosen = search.run()
    assert chosen.names == {"current_latency"}
    assert [each.rivals for each in _taken(search, chosen)] == [("link_sag",)]
    assert search_among({"current_latency": 0.10, "link_sag": 0.7}).run().names == {"link_sag"}


def test_what_leaves_more_than_a_misfit_may_be_is_no_rival():
    """Of a delay at two speeds, others saved 97 to 99.98 %: the errors of the flux were 20 to 50 times too large."""
    for left, rivals in ((0.02, ()), (0.0012, ()), (0.00105, ("phase_resistance",))):
        search = search_among({"current_latency": 0.999, "phase_resistance": 1.0 - left})
        assert [each.rivals for each in _taken(search, search.run())] == [rivals]


def test_a_member_that_saves_little_beside_what_is_left_is_open():
    """A map too coarse for its iron had a filter of the currents confirmed: R was 4 % off, 4.1 standard errors."""
    for saved, open_ in ((0.06, ("current_latency",)), (0.3, ())):
        search = search_among({"current_latency": saved})
        assert _undecided(search, search.run(), 1e3, ()) == open_
