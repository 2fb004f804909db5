"""The certificate of a verification: one HTML page with figures, limits and verdict."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from drive_id.analysis.verification import Judgement, Verification
from drive_id.pictures.panels import PSI, add_colour_bar, levels, name_currents, place
from drive_id.pictures.picture import rendered
from drive_id.quantity import measured
from drive_id.reporting.page.html import filled
from drive_id.result.result import Result

_WIDEST = 5.0
"""End of the colour scale, standard errors."""
_METHOD = (
    "The voltage balance is integrated over windows of the recording in the stator frame, as in the fit; what the map "
    "does not explain is attributed to cells of the current plane, to resistance and drop by least squares. "
    "Standard errors are those of the recording (scatter between blocks of time) and of the map together. A gain error "
    "that both recordings share is not seen, except by a measured torque."
)


def verdict(judged: Sequence[Judgement]) -> str:
    """Return the verdict in a sentence or two."""
    failed = [entry.name.lower() for entry in judged if entry.passed is False]
    unknown = [f"{x.name.lower()} ({x.reason})" for x in judged if x.passed is None and x.limit is not None]
    if failed:
        said = f"Not passed: {'; '.join(failed)}."
    else:
        said = f"Passed: all figures{' that were measured' if unknown else ''} are within their limits."
    return f"{said} Not judged: {'; '.join(unknown)}." if unknown else said


def row(entry: Judgement) -> tuple[str, str, str, str]:
    """Return name, value, limit and verdict of a figure as texts."""
    word = {True: "passed", False: "NOT PASSED", None: "not judged"}[entry.passed]
    value = f"{entry.value:.3g} {entry.unit}" if np.isfinite(entry.value) else "unknown"
    because = f": {entry.reason}" if entry.reason else ""
    return entry.name, value, "" if entry.limit is None else f"{entry.limit:g}", f"{word}{because}"


def certificate(result: Result, found: Verification, judged: Sequence[Judgement], recordings: Sequence[str]) -> str:
    """Render the certificate; of the recordings, it names files and digests."""
    facts = {
        "Machine": result.name or "unknown",
        "Map": f"method {result.method}, {result.date[:16].replace('T', ' ')} UTC" if result.date else result.method,
        "Recording": "; ".join(recordings),
        "Cells with data": f"{len(found.i_dq)}, {100 * found.coverage:.0f} % of the disc of {result.i_max:.4g} A",
        "Change of the magnet's flux": measured(100 * found.magnet[0], 100 * found.magnet[1], "%"),
        "Change of the resistance": measured(100 * found.resistance[0], 100 * found.resistance[1], "%"),
        "Change of the inverter's drop": measured(100 * found.drop[0], 100 * found.drop[1], "%"),
    }
    if found.torque is not None:
        facts["Torque over that of the map"] = measured(found.torque.gain, found.torque.sigma_gain)
        facts["Torque, rms difference"] = measured(found.torque.rms_map, unit="Nm")
    return filled(
        "certificate.html",
        title=f"Verification of the flux map: {result.name or 'unknown machine'}",
        verdict=verdict(judged),
        facts=facts,
        rows=[row(entry) for entry in judged],
        picture=base64.b64encode(rendered(_picture(found), dpi=110)).decode(),
        note=_METHOD,
    )


def _picture(found: Verification) -> Figure:
    figure = Figure(figsize=(8.6, 3.5))
    for column, axis in enumerate("dq"):
        panel, colours = place(figure, 0.75 + 4.2 * column, 0.5, 2.6, 2.6), found.in_sigma[:, column]
        i_d, i_q = found.i_dq.T
        drawn = panel.scatter(i_d, i_q, 90, colours, marker="s", cmap="RdBu_r", vmin=-_WIDEST, vmax=_WIDEST)
        name_currents(panel, f"{PSI[axis]}, standard errors")
        add_colour_bar(panel, drawn, levels(-_WIDEST, _WIDEST, 8))
    return figure
