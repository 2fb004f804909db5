"""Sentences of a report that do not depend on the result."""

from __future__ import annotations

NOT_STORED = (
    "This result folder holds no diagnostics.npz, because an earlier version wrote it: fit the recording again to see "
    "this section."
)
SECTIONS = {
    "glance": "At a glance",
    "warnings": "Warnings",
    "map": "Flux maps",
    "comparison": "With and without a model of the inverter",
    "inverter": "Inverter",
    "residuals": "Residuals",
    "currents": "Simulated against measured current",
    "operation": "Torque, MTPA and MTPV",
    "identifiable": "What is known, and what to do next",
    "method": "Paragraph of method",
    "origin": "Settings, inputs and versions",
}
"""Headings by name, in their order."""
