"""The interface of a method, and what it returns to the code that all methods share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.methods.parameters import FitReport, Parameters
from drive_id.errors import DataError
from drive_id.types import BoolArray, FloatArray, Samples

if TYPE_CHECKING:  # takes 0.1 s, which methods psm and joint do without
    from drive_id.core.full.fit import EarlierFit

CURVE_POINTS = 201
"""Points of the inverter's curve in a result, from -i_max to i_max."""


class Limits(NamedTuple):
    """When a fit warns or is refused, and the method's own remedy for a model that is not passive."""

    unexplained: float  # share of the voltage that the model leaves
    refused: float  # the same, beyond which there is no map
    mad: float  # mean absolute deviation of the simulated current over i_max
    reversed: float  # flux of the magnet against the d axis over the largest flux, which the method cannot err by
    remedy: str | None = None
    impossible: bool = False  # whether results that no machine can have are refused


EffectVoltages = Callable[[Sequence[Samples]], tuple[list[FloatArray], bool]]
"""Returns the phase voltages (N, 3) that effects take in pieces of recordings, V, and whether all effects are included:
some act over whole recordings and are left out for mere pieces."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate(Parameters):
    """What a method finds: the parameters, with the map on the grid of the visits, and how good they are."""

    drop: tuple[FloatArray, FloatArray]
    """Equally spaced phase currents (C,), A, and the inverter's drop there, V, for simulations."""
    report: FitReport  # as far as the method knows it
    unexplained: float  # rms residual over the rms of all integrated voltages
    outlying_time: float | None  # where samples stand out from all others, in time of data, s
    warnings: tuple[Message, ...]  # of this method only
    effects: EffectVoltages | None = None  # what effects beside map, R and drop take
    fit: EarlierFit | None = None  # what a fit of further samples can take over; only of method full


def check_sums(sums: Sequence[FloatArray], voltage: float) -> None:
    """Raise DataError unless all sums are finite, and that of the squared voltages is not zero."""
    if not (all(np.isfinite(each).all() for each in sums) and voltage > 0):
        raise DataError(
            "The commanded voltages are zero or equal in all phases, or voltages or currents are out of all range: "
            "check their fields and scales."
        )


class Method(Protocol):
    """One of ``psm``, ``joint`` and ``full``."""

    @property
    def limits(self) -> Limits:
        """When to warn."""

    def conclude(self, evidence: Evidence, inside: BoolArray, earlier: EarlierFit | None = None) -> Estimate:
        """Estimate maps and parameters; data support the map where ``inside`` (D, Q) on the grid of the visits.

        ``earlier`` is a fit by the same settings from most of these samples, whose selection method ``full`` takes
        over. Raises DataError when there are too few data for this method, or :func:`check_sums` does.
        """
