"""The interface of a method, and what it returns to the code that all methods share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.maps.flux_models import TensorSpline
from drive_id.core.methods.parameters import FitReport, Parameters
from drive_id.messages import Message
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
    remedy: str | None = None
    impossible: bool = False  # whether results that no machine can have are refused


EffectVoltages = Callable[[Sequence[Samples]], tuple[list[FloatArray], bool]]
"""Returns the phase voltages (N, 3) that effects take in pieces of recordings, V, and whether all effects are included:
some act over whole recordings and are left out for mere pieces."""


@dataclass(frozen=True, eq=False)
class SimulationModel:
    """The identified drive as :func:`~drive_id.core.validation.current_simulation.simulate_current` takes it.

    Parameters
    ----------
    gamma : (P,) float
        Parameters of the mean map, Wb.
    harmonics : mapping of int to ((P,) float, (P,) float)
        Amplitudes of cosine and sine of each electrical order, Wb.
    drop : (C,) float, (C,) float
        Equally spaced phase currents, A, and the inverter's drop there, V.
    effects : callable, optional
        Gives what effects beside this model take.
    """

    model: TensorSpline
    gamma: FloatArray
    harmonics: Mapping[int, tuple[FloatArray, FloatArray]]
    drop: tuple[FloatArray, FloatArray]
    effects: EffectVoltages | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate(Parameters):
    """What a method finds: the parameters, the map on the grid of the visits, and how good they are.

    Parameters
    ----------
    psi, sigma : (D, Q, 2) float
        Flux map on the grid of the visits and its standard error, Wb; sigma is NaN where there are no data.
    positive_definite : callable
        Tells (N,) at which currents (N, 2), A, the inductance matrix is positive definite.
    report : FitReport
        As far as the method knows it.
    unexplained : float
        Rms residual over the rms of all integrated voltages.
    outlying_time : float or None
        Where samples stand out from all others, in time of data, s.
    warnings : tuple of Message
        Of this method only.
    harmonics : tuple of (int, (D, Q, 2) float, (D, Q, 2) float)
        Order, and amplitudes of cosine and sine, Wb.
    fit : EarlierFit or None
        What a fit of further samples can take over; only of method ``full``.
    """

    psi: FloatArray
    sigma: FloatArray
    simulation: SimulationModel
    positive_definite: Callable[[FloatArray], BoolArray]
    report: FitReport
    unexplained: float
    outlying_time: float | None
    warnings: tuple[Message, ...]
    harmonics: tuple[tuple[int, FloatArray, FloatArray], ...] = ()
    fit: EarlierFit | None = None


class Method(Protocol):
    """One of ``psm``, ``joint`` and ``full``."""

    @property
    def limits(self) -> Limits:
        """When to warn."""

    def conclude(self, evidence: Evidence, inside: BoolArray, earlier: EarlierFit | None = None) -> Estimate:
        """Estimate maps and parameters.

        Parameters
        ----------
        evidence : Evidence
            Of all samples.
        inside : (D, Q) bool
            Where on the grid of the visits data support the map.
        earlier : EarlierFit, optional
            By the same settings from most of these samples: method ``full`` takes its selection over.

        Raises
        ------
        DataError
            When there are too few data for this method.
        """
