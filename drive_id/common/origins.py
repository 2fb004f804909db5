"""Where a result is from: what results of each origin hold, and the words for them.

A result is *fitted* by one of five methods, or *imported*. Nothing else in the package compares their names: whatever
depends on one asks its :class:`Origin`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from drive_id.errors import ConfigurationError


@dataclass(frozen=True)
class Origin:
    """A method, or another source of results."""

    name: str  # as in ``identification.json``, in ``FluxMap`` and in the settings of a fit
    title: str  # for the rows of a table of several
    summary: str  # what was done, a sentence for the paragraph to paste
    heading: str = "Identified drive"  # of the tables and pages of a result
    fitted: bool = True  # whether R and standard errors were estimated; else they are what a file says
    inverter: bool = True  # whether results have the inverter's curve
    harmonics: bool = False  # whether they have rotor-position harmonics
    slopes: bool = False
    """Whether the standard errors hold for inductances away from zero current, too: others miss the bias there."""
    diagnostics: bool = True
    """Whether results have residuals over time and angle, a simulated current, and other methods beside them."""
    live: bool = True
    """Whether it sums over samples, so that it serves live samples and information files."""
    windows: bool = False  # whether it sums over windows
    no_inverter: str = ""  # why it is missing; empty where it is not
    no_diagnostics: str = ""
    no_torque: str = ""
    limits: tuple[str, ...] = ()
    """What the data leave open; the last one is what R rests on if all data are of one speed."""
    pole_pairs: str = "set pole_pairs in the fit, or in the signals file"  # how to give their number, in the imperative
    advice: str = ""  # code of the message on what another method would add; empty where there is none
    reference: str = ""  # to cite; empty without
    ignores: tuple[str, ...] = ()  # settings of a fit that have no effect

    @property
    def turning(self) -> bool:
        """Whether the map is the mean over rotor positions, magnet flux included.

        Else it is the flux at one position minus that at zero current, and neither torque nor voltages of the turning
        machine follow from it.
        """
        return not self.no_torque

    @property
    def caption(self) -> str:
        """For one line below a figure."""
        return f"method {self.name}" if self.fitted else self.name

    @property
    def one_speed(self) -> str:
        """What R rests on if all data are of one speed; empty where nothing was fitted."""
        return self.limits[-1] if self.limits else ""


_OF_THE_DATA = (
    (
        "A common gain error of all voltages or all currents leaves no trace; only a measured shaft torque, or a free "
        "shaft of known inertia, shows it."
    ),
    "A zero-sequence error of the phase voltages leaves no trace.",
    "A constant offset of the angle rotates currents and map together; it shows only if the machine is symmetric.",
)
_LINEAR_PART = "The linear part of the inverter's voltage drop is included in R."
_TRANSIENTS = "At one constant speed, R is determined by the transients alone."
_PAPER = (
    "Methods psm and joint are those of Montecchio et al., Joint identification of permanent magnet synchronous "
    "machine and inverter, IET 2025, doi:10.1049/icp.2025.2025."
)
_OF_PAPER = ("flux_model", "splines_d", "splines_q", "polynomial_degree", "inverter_current_scale")
_OF_CONDITIONS = ("temperatures", "u_dc", "u_dc_reference")
_OF_FULL = (
    "maps", "harmonic_orders", "search_orders", "per_phase_inverter", "passive_maps", "calibrate_delay",
    "calibrate_angle", "calibrate_currents", "voltage_delay", "rated_current",
)  # fmt: skip

PSM: Final = Origin(
    name="psm",
    title="psm: inverter not modelled",
    summary=(
        "The voltage equation, integrated over each sample, was solved for the coefficients of tensor-product splines "
        "and R by linear least squares, without a model of the inverter."
    ),
    inverter=False,
    no_inverter="Method psm does not model the inverter: its drop is in the flux map and in R.",
    limits=("The inverter's voltage drop is not separated from R and the flux map.", *_OF_THE_DATA, _TRANSIENTS),
    advice="use_full",
    reference=_PAPER,
    ignores=(*_OF_FULL, *_OF_CONDITIONS, "rows_are_points"),
)
JOINT: Final = Origin(
    name="joint",
    title="joint: the paper's method",
    summary=(
        "The voltage equation, integrated over each sample, was solved jointly for the coefficients of tensor-product "
        "splines, R and the inverter's voltage error by linear least squares."
    ),
    limits=(_LINEAR_PART, *_OF_THE_DATA, _TRANSIENTS),
    advice="use_full",
    reference=_PAPER,
    ignores=PSM.ignores,
)
_RECIPROCAL = (
    "At one constant speed, R is determined by the transients and, unless free maps are fitted, by reciprocity."
)
FULL: Final = Origin(
    name="full",
    title="full",
    summary=(
        "The voltage equation, integrated in the stator frame over windows of about 60° electrical, was solved for "
        "penalized splines of the flux and its rotor-position harmonics, R and a free inverter curve by linear least "
        "squares, with correction for current noise and heteroscedasticity-consistent standard errors."
    ),
    harmonics=True,
    slopes=True,
    windows=True,
    limits=(_LINEAR_PART, *_OF_THE_DATA, _RECIPROCAL),
    reference=_PAPER,
    ignores=(*_OF_PAPER, "rows_are_points"),
)
_AT_REST = "The magnets' flux and the torque are unknown: a constant flux induces no voltage in a machine at rest."
LOCKED: Final = Origin(
    name="locked",
    title="locked: rotor at rest",
    heading="Drive with a locked rotor",
    summary=(
        "The rotor was locked: the flux at this one position, minus that at zero current, was fitted as penalized "
        "splines with R and a free inverter curve to the voltage equation, integrated over windows, by linear least "
        "squares, with correction for current noise and heteroscedasticity-consistent standard errors."
    ),
    windows=True,
    no_torque=_AT_REST,
    limits=(
        _LINEAR_PART,
        _AT_REST,
        "The fluxes are those of one rotor position: the mean map differs by the rotor-position harmonics.",
        "Gain errors, offsets of currents and angle, and a delay of the voltages leave no trace.",
    ),
    reference=_PAPER,
    ignores=(
        *_OF_PAPER, "rows_are_points", "maps", "harmonic_orders", "search_orders", "calibrate_delay",
        "calibrate_angle", "calibrate_currents", "inertia", "added_inertia", "rated_current",
    ),
)  # fmt: skip
_SYMMETRIC = "At one constant speed, R is separable from the fluxes only by assuming reciprocal, symmetric maps."
STATIC: Final = Origin(
    name="static",
    title="static: operating points",
    summary=(
        "The voltage equation at steady state, averaged over operating points at constant currents and speed, was "
        "solved for reciprocal flux maps or, from few currents, magnet flux and inductances, with R and the inverter's "
        "drop, by penalized least squares with weak priors."
    ),
    diagnostics=False,
    live=False,
    no_diagnostics=(
        "Method static fits means over operating points: it has no residual over time or angle, simulates no current, "
        "and the methods for samples cannot be run beside it."
    ),
    limits=(_LINEAR_PART, *_OF_THE_DATA, "Rotor-position harmonics average out at operating points.", _SYMMETRIC),
    advice="record_fast",
    ignores=(*_OF_FULL, *_OF_PAPER, "monotone", "longest_rest"),
)
IMPORTED: Final = Origin(
    name="imported",
    title="imported",
    heading="Imported map",
    summary="The map was not identified here: it was read from a file.",
    fitted=False,
    inverter=False,
    harmonics=True,
    diagnostics=False,
    live=False,
    no_inverter="The map was imported, and files of maps hold no curve of an inverter.",
    no_diagnostics="The map was imported: there is no recording to compare it with.",
    pole_pairs="import the file again with --pole-pairs",
)
ORIGINS: Final = {origin.name: origin for origin in (PSM, JOINT, FULL, LOCKED, STATIC, IMPORTED)}
"""By name, in the order in which they are shown beside one another."""
METHODS: Final = tuple(name for name, origin in ORIGINS.items() if origin.fitted)
"""Names that a fit may be asked for."""


def origin_named(name: str) -> Origin:
    """Return the origin of this name; raises ConfigurationError when there is none."""
    if name not in ORIGINS:
        raise ConfigurationError(f"'{name:.40}' is no origin of a result: it must be one of {', '.join(ORIGINS)}.")
    return ORIGINS[name]
