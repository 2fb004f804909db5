"""The certificate of a verification: one HTML page with figures, limits and verdict."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from datetime import datetime, timezone

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from drive_id.analysis.verification import Judgement, Verification
from drive_id.common.quantity import counted, measured
from drive_id.reporting.page.html import filled
from drive_id.result.pictures.panels import PSI, add_colour_bar, levels, name_currents, place
from drive_id.result.pictures.picture import rendered
from drive_id.result.result import Result

_WIDEST = 1.0
"""End of the colour scale, % of the largest flux; an arrow there tells of more."""
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
    given = result.provenance.settings
    facts = {
        "Machine": result.machine or "unknown",
        "Serial number": given.serial or "not given",
        "Operator": given.operator or "not given",
        "Bench": given.bench or "not given",
        "Verified": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "Map": f"method {result.method}, {result.date[:16].replace('T', ' ')} UTC" if result.date else result.method,
        "Recording": "; ".join(recordings),
        "Disc": f"{100 * found.coverage:.0f} % of the disc of {result.i_max:.4g} A, "
        f"{counted(len(found.i_dq), 'cell')} with data",
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
        failed=any(entry.passed is False for entry in judged),
        verdict=verdict(judged).partition(": ")[2],
        facts=facts,
        rows=[row(entry) for entry in judged],
        pictures={
            axis: base64.b64encode(rendered(_picture(found, result.i_max, axis), dpi=110)).decode() for axis in "dq"
        },
        note=_METHOD,
    )


def _picture(found: Verification, i_max: float, axis: str) -> Figure:
    figure = Figure(figsize=(4.3, 3.5))
    panel, colours = place(figure, 0.75, 0.5, 2.6, 2.6), 100 * found.difference[:, "dq".index(axis)] / found.largest
    i_d, i_q = found.i_dq.T
    drawn = panel.scatter(i_d, i_q, 90, colours, marker="s", cmap="RdBu_r", vmin=-_WIDEST, vmax=_WIDEST)
    drawn.set_edgecolor("0.6")  # cells without a difference are white as the page is
    panel.add_patch(Circle((0, 0), i_max, fill=False, linewidth=0.8))
    panel.set(xlim=(-1.05 * i_max, 1.05 * i_max), ylim=(-1.05 * i_max, 1.05 * i_max))
    name_currents(panel, f"{PSI[axis]}, % of the largest flux")
    below, above = bool((colours < -_WIDEST).any()), bool((colours > _WIDEST).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    add_colour_bar(panel, drawn, levels(-_WIDEST, _WIDEST, 8), extend=extend)
    return figure
