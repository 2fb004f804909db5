"""Sentences of a report that do not depend on the result."""

from __future__ import annotations

NOT_STORED = (
    "This result folder holds no diagnostics.npz, because its map was imported or fitted by an earlier version: fit "
    "the recording again to see this section."
)
METHODS = {"psm": "psm: inverter not modelled", "joint": "joint: the paper's method", "full": "full"}
"""Names of the methods, in the order in which they are shown."""
CITATION = (
    "Methods psm and joint are those of Montecchio et al., Joint identification of permanent magnet synchronous "
    "machine and inverter, IET 2025, doi:10.1049/icp.2025.2025."
)
LIMITS = (
    "The linear part of the inverter's voltage drop is included in R.",
    "A common gain error of all voltages or all currents leaves no trace; only a measured shaft torque shows it.",
    "A zero-sequence error of the phase voltages leaves no trace.",
    "A constant offset of the angle rotates currents and map together; it shows only if the machine is symmetric.",
    "At one constant speed, R is determined by the transients, and by reciprocal maps where method full uses them.",
)
"""What no method can tell from such data."""
METHODS_TEXT = {
    "psm": (
        "The voltage equation, integrated over each sample, was solved for the coefficients of tensor-product splines "
        "and R by linear least squares, without a model of the inverter."
    ),
    "joint": (
        "The voltage equation, integrated over each sample, was solved jointly for the coefficients of tensor-product "
        "splines, R and the inverter's voltage error by linear least squares."
    ),
    "full": (
        "The voltage equation, integrated in the stator frame over windows of about 60° electrical, was solved for "
        "penalized splines of the flux and its rotor-position harmonics, R and a free inverter curve by linear least "
        "squares, with correction for current noise and heteroscedasticity-consistent standard errors."
    ),
}
"""What each method does, for the paragraph to paste."""
SECTIONS = {
    "glance": "Quality at a glance",
    "warnings": "Warnings",
    "map": "Flux maps",
    "comparison": "With and without a model of the inverter",
    "inverter": "Inverter",
    "residuals": "Residuals",
    "currents": "Simulated against measured current",
    "operation": "Torque, MTPA and MTPV",
    "identifiable": "What is identifiable, and what to record next",
    "method": "Paragraph of method",
    "origin": "Settings, inputs and versions",
}
"""Headings by name, in their order."""
