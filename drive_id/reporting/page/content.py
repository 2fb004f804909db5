"""What a report says: the same words and numbers for the page and for the PDF."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import JOINT, ORIGINS, PSM, origin_named
from drive_id.common.quantity import Quantity, measured, rounded
from drive_id.common.version import VERSION
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.diagnostics import ComparedMethod
from drive_id.files.results.identification import Provenance, results_tree
from drive_id.reporting.page.operation import TorqueMap
from drive_id.reporting.tables import shaft_rows
from drive_id.result.advice import single_speed, sorted_statements
from drive_id.result.result import Result
from drive_id.types import FloatArray

_NOT_STORED = (
    "This result folder holds no diagnostics.npz, because an earlier version wrote it: fit the recording again to see "
    "this section."
)
SECTIONS = {
    "glance": "At a glance",
    "map": "Flux maps",
    "comparison": "With and without a model of the inverter",
    "inverter": "Inverter",
    "residuals": "Residuals",
    "currents": "Simulated against measured current",
    "operation": "Torque, MTPA and MTPV",
    "identifiable": "What is known, and what to do next",
    "method": "Method, as a paragraph",
    "origin": "Settings, inputs and versions",
}
"""Headings by name, in their order."""
_ANSWER = ("ψ_PM", "L_d at zero", "L_q at zero", "R", "Torque at")
"""Beginnings of the names of the figures that stand first and large."""
_LEAST_CURRENT = 0.01
"""Share of the largest current of a line below which its points are not listed."""


@dataclass(frozen=True)
class Merit:
    """A figure of merit at a glance."""

    name: str
    value: str
    level: str  # good, fair, weak or unknown; empty where there is nothing to judge
    meaning: str  # what it says, and what counts as good and weak


@dataclass(frozen=True)
class TextTable:
    """Rows of text below a header."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Content:
    """All text and numbers of a report."""

    title: str
    subtitle: str
    answer: tuple[Quantity, ...]  # at most five of the headline, for all to see
    headline: tuple[Quantity, ...]  # what is asked for first
    figures: tuple[Merit, ...]  # quality at a glance
    advice: str  # what would help most; empty where nothing is known
    warnings: tuple[str, ...]
    knowledge: dict[str, tuple[str, ...]]
    """By heading: what the result states, what the data leave open, and what to do next."""
    values: TextTable
    methods: TextTable
    calibrations: TextTable
    settings: TextTable
    inputs: TextTable
    versions: TextTable
    operation: TextTable
    drop: str  # what the inverter's drop amounts to; empty where the DC link is not known
    residual: str  # how large the residual is beside the voltage; empty where it is not known
    comparison: str  # a sentence on what modelling the inverter changes; empty where it is not known
    paragraph: str  # of method, to paste
    missing: dict[str, str]  # section to why it shows nothing
    twin: dict[str, Any]  # identification.json


def content_of(result: Result, operation: TorqueMap | None) -> Content:
    """Put a result into words and tables; ``operation`` as of :func:`~drive_id.reporting.page.operation.torque_map`."""
    known = _without_folders(result.provenance)
    twin = results_tree(result.drive, known)
    said, nothing = sorted_statements(result.drive)
    return Content(
        title=f"{result.origin.heading}: {result.name or 'unnamed machine'}",
        subtitle=str(result.caption()),
        answer=_answer(result.headline),
        headline=result.headline,
        figures=_figures(result),
        advice=next(iter(result.advice), ""),
        warnings=(*known.warnings, *result.drive.report.warnings),
        knowledge={
            "What the result states": tuple(said),
            "What such data leave open": result.origin.limits,
            "What to do next": result.advice,
            "What was tested and not found": tuple(nothing),
        },
        values=_values(result),
        methods=_methods(result),
        calibrations=_calibrations(result),
        settings=_settings(result),
        inputs=TextTable(
            f"Files that were {'fitted' if result.origin.fitted else 'imported'}, and their digests",
            ("File", "SHA-256"),
            tuple(known.inputs.items()),
        ),
        versions=TextTable(
            "Software that made the result",
            ("Software", "Version"),
            tuple((name, str(version)) for name, version in twin["versions"].items()),
        ),
        drop=_drop(result),
        residual=_residual(result),
        comparison=_comparison(result),
        paragraph=_paragraph(result),
        operation=_operation(operation),
        missing=_missing(result, operation),
        twin=twin,
    )


def _answer(found: tuple[Quantity, ...]) -> tuple[Quantity, ...]:
    """Return the five quantities that are asked for most; others where the result has none of these."""
    first = [next((q for q in found if q.name.startswith(name)), None) for name in _ANSWER]
    chosen = [q for q in first if q is not None]
    return (*chosen, *(q for q in found if q not in chosen))[: len(_ANSWER)]


def flux_sigma(result: Result) -> float:
    """Return the median of the larger standard error of both fluxes where there are data, Wb; NaN where unknown."""
    found = result.flux_map
    sigma = np.maximum(found.sigma_d, found.sigma_q)[found.inside]
    return float(np.median(sigma)) if sigma.size and np.isfinite(sigma).all() else math.nan


def _without_folders(known: Provenance) -> Provenance:
    """Return a provenance whose files are named without the folders of the computer where it was made."""
    folders = sorted({f"{Path(file).parent.parent}/" for file in known.inputs if Path(file).is_absolute()}, key=len)

    def short(text: str) -> str:
        for folder in reversed(folders):
            text = text.replace(folder, "") if folder != "//" else text
        return text

    inputs = {short(file): digest for file, digest in known.inputs.items()}
    warnings = tuple(Message.told(short(said), said.code, said.values) for said in known.warnings)
    return replace(known, inputs=inputs, warnings=warnings)


def _figures(result: Result) -> tuple[Merit, ...]:
    metrics, origin = result.metrics, result.origin
    flux, sigma = result.flux_map.largest, flux_sigma(result)
    count, coverage = len(result.warnings), metrics["coverage"]
    found = [
        Merit("Warnings", str(count), level(count, 0, 2), "Each is a sentence below that says what to do."),
        Merit(
            "Disc covered", percent(coverage), level(1 - coverage, 0.05, 0.2),
            f"Share of the disc of {number(result.i_max)} A with data. Good from 95 %, weak below 80 %.",
        ),
    ]  # fmt: skip
    if origin.fitted or math.isfinite(sigma):
        said = "Median over the map, of the largest flux."
        found.append(_share("Standard error of the flux", sigma / flux if flux else math.nan, 0.002, 0.01, said))
    if origin.fitted:
        known = result.sigma_resistance / max(abs(result.resistance), 1e-12)
        said = f"R = {result.told(result.resistance, result.sigma_resistance, 'Ω')}."
        found.append(_share("Standard error of R", known, 0.02, 0.1, said))
    if origin.diagnostics:
        mad = max(metrics["mad_d"], metrics["mad_q"]) / result.i_max
        said = (
            "Mean deviation of the open-loop simulation from the measurement, of i_max: "
            f"{measured(metrics['mad_d'], unit='A')} in d, {measured(metrics['mad_q'], unit='A')} in q."
        )
        found.append(_share("Simulated current", mad, 0.01, 0.03, said))
    if math.isfinite(metrics["nrmse_d"]):
        worst = max(metrics["nrmse_d"], metrics["nrmse_q"])
        said = f"NRMSE {percent(metrics['nrmse_d'])} in ψ_d, {percent(metrics['nrmse_q'])} in ψ_q."
        found.append(_share("Error against the simulation's truth", worst, 0.002, 0.01, said))
    return tuple(found)


def _share(name: str, share: float, good: float, weak: float, meaning: str) -> Merit:
    """Return a share that is better the smaller it is, and in its meaning what counts as good and weak."""
    limits = f"Good up to {percent(good)}, weak above {percent(weak)}."
    return Merit(name, percent(share), level(share, good, weak), f"{meaning} {limits}")


def level(value: float, good: float, weak: float) -> str:
    """Judge a value that is better the smaller it is."""
    if not math.isfinite(value):
        return "unknown"
    return "good" if value <= good else "fair" if value <= weak else "weak"


def _values(result: Result) -> TextTable:
    drive, metrics = result.drive, result.metrics
    given = result.provenance.settings
    names = {"Serial number": given.serial, "Bench": given.bench, "Operator": given.operator, "Notes": given.notes}
    rows = [("Machine", result.machine or "unknown"), *((name, text) for name, text in names.items() if text)]
    rows += [(quantity.name, str(quantity)) for quantity in result.headline]
    if not math.isfinite(result.resistance):
        rows.append(("R", "unknown"))
    if drive.magnet_coefficient is not None:
        rows.append(("Magnet flux per kelvin", result.told(*drive.magnet_coefficient, "Wb/K")))
    if result.harmonics:
        rows.append(("Rotor-position harmonics", ", ".join(str(h.order) for h in result.harmonics)))
    if result.torque is not None:
        rows.append(("Common gain by the shaft torque", measured(result.torque.gain, result.torque.sigma_gain)))
    if result.mechanics is not None:
        rows += shaft_rows(result.mechanics)
    rows += [
        ("Origin", result.origin.caption),
        ("Pole pairs", str(result.pole_pairs or "unknown")),
        ("DC link", f"{number(result.u_dc)} V" if result.u_dc else "unknown"),
        ("Identified", result.date.replace("T", " ").replace("+00:00", " UTC") or "unknown"),
    ]
    if not result.origin.fitted:
        rows.append(("Points read", str(metrics["samples_read"])))
        return TextTable("Values in the file", ("Quantity", "Value"), tuple(rows))
    rows += [
        ("Electrical speed", _speed(result)),
        ("Duration of the data", f"{number(result.duration)} s" if result.duration else "unknown"),
        ("Samples used", f"{metrics['samples_used']} of {metrics['samples_read']}"),
        *([("Gaps", str(metrics["gaps"]))] if result.origin.live else []),
        ("Unknowns determined", f"{metrics['rank']} of {metrics['parameters']}")
        if result.origin.live
        else ("Unknowns", str(metrics["parameters"])),
        ("Condition number", number(metrics["condition"], 3)),
    ]
    return TextTable("Identified values (± standard error) and the experiment", ("Quantity", "Value"), tuple(rows))


def _speed(result: Result) -> str:
    if result.speed_range is None:
        return "unknown"
    ends = result.speed_range[:1] if single_speed(result.provenance) else result.speed_range
    text = f"{' to '.join(map(number, ends))} rad/s"
    if result.pole_pairs is None:
        return text
    rpm = (number(speed * 30 / math.pi / result.pole_pairs) for speed in ends)
    return f"{text} ({' to '.join(rpm)} rpm of the shaft)"


def _methods(result: Result) -> TextTable:
    """Lay out the result beside the paper's methods."""
    rows: list[tuple[str, ...]] = []
    judged, metrics = result.diagnostics, result.metrics
    if judged is not None and judged.comparisons:
        own = ComparedMethod(
            method=result.method,
            samples=int(metrics["samples_used"]),
            resistance=result.resistance,
            sigma_resistance=result.sigma_resistance,
            voltage_error=result.voltage_error,
            sigma_voltage_error=result.sigma_voltage_error,
            residual_rms=judged.residual_rms,
            mad_d=metrics["mad_d"],
            mad_q=metrics["mad_q"],
            nrmse_d=metrics["nrmse_d"],
            nrmse_q=metrics["nrmse_q"],
        )
        every = sorted([own, *judged.comparisons], key=lambda found: list(ORIGINS).index(found.method))
        rows = [_method_row(found, result.told, own=found is own) for found in every]
    return TextTable(
        "The same data with and without a model of the inverter",
        ("Method", "R", "Inverter drop", "Residual, rms", "Mean error of simulated i_d / i_q", "NRMSE ψ_d / ψ_q"),
        tuple(rows),
    )


def _method_row(found: ComparedMethod, told: Callable[..., str], *, own: bool) -> tuple[str, ...]:
    origin = origin_named(found.method)
    name = f"{origin.title}{' (this result)' if own else ''}"
    if found.failure:
        return name, f"no result: {found.failure}", "", "", "", ""
    pair = math.isfinite(found.nrmse_d)
    return (
        name,
        told(found.resistance, found.sigma_resistance, "Ω"),
        measured(found.voltage_error, found.sigma_voltage_error, "V") if origin.inverter else "not modelled",
        measured(found.residual_rms, unit="V"),
        f"{number(found.mad_d, 3)} / {number(found.mad_q, 3)} A" if math.isfinite(found.mad_d) else "unknown",
        f"{percent(found.nrmse_d)} / {percent(found.nrmse_q)}" if pair else "no truth known",
    )


def _comparison(result: Result) -> str:
    """Say how far the map without a model of the inverter, or with one if this has none, is from the result."""
    judged = result.diagnostics
    every = {found.method: found for found in judged.comparisons} if judged else {}
    other = every.get(PSM.name if result.origin.inverter else JOINT.name)
    if other is None or other.psi_d is None or other.psi_q is None:
        return ""
    apart = map_difference(result, other)
    inside = result.flux_map.inside
    largest = max(float(np.abs(values[inside]).max(initial=0.0)) for values in apart)
    share = percent(largest / result.flux_map.largest)
    change = result.told(abs(other.resistance - result.resistance), unit="Ω")
    return (
        f"The map of method {other.method} differs from this one by up to {result.told(largest, unit='Wb')} "
        f"({share} of the largest flux), and its R by {change}."
    )


def _residual(result: Result) -> str:
    """Say how large the residual is beside the voltage that was commanded."""
    judged = result.diagnostics
    if judged is None or judged.over_plane is None or not judged.over_plane.commanded > 0:
        return ""
    size, commanded = judged.residual_rms, judged.over_plane.commanded
    return (
        f"The residual is {measured(size, unit='V')} rms, {percent(size / commanded)} of the commanded "
        f"{measured(commanded, unit='V')} rms."
    )


def map_difference(result: Result, other: ComparedMethod) -> tuple[FloatArray, FloatArray]:
    """Return psi_d and psi_q (D, Q) of another method minus those of the result, Wb."""
    assert other.psi_d is not None
    assert other.psi_q is not None
    return other.psi_d - result.flux_map.psi_d, other.psi_q - result.flux_map.psi_q


def _calibrations(result: Result) -> TextTable:
    rows = (
        (
            found.name.replace("_", " "),
            result.told(found.value, found.sigma, found.unit),
            "corrected" if found.applied else "not corrected",
        )
        for found in result.calibrations
        if found.applied or math.isfinite(found.sigma)  # else nothing was estimated
    )
    return TextTable("Sensor faults and effects of the drive", ("Name", "Value", "In the map"), tuple(rows))


def _settings(result: Result) -> TextTable:
    usual = FitSettings()
    settings = vars(result.provenance.settings) if result.origin.fitted else {}
    rows = (
        (name, _setting(name, value), "default" if value == getattr(usual, name) else "set")
        for name, value in settings.items()
    )
    return TextTable("Settings of the fit", ("Setting", "Value", "Origin"), tuple(rows))


def _setting(name: str, value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "automatic" if value is None or (name == "pole_pairs" and not value) else str(value)


def _operation(operation: TorqueMap | None) -> TextTable:
    """Lay out a few points of the lines of operation."""
    rows = []
    for name, line in operation.lines.items() if operation else ():
        current = np.hypot(line.i_d, line.i_q)
        for wanted in np.linspace(current[0], current[-1], 5):
            if wanted < _LEAST_CURRENT * current[-1]:
                continue
            k = int(np.abs(current - wanted).argmin())
            angle = math.degrees(math.atan2(line.i_q[k], line.i_d[k]))
            torque = measured(float(line.torque[k]), float(line.sigma_torque[k]), "Nm")
            at = (float(current[k]), float(line.i_d[k]), float(line.i_q[k]))
            rows.append((name, *(f"{number(value)} A" for value in at), f"{number(angle)}°", torque))
    header = ("Line", "Current", "i_d", "i_q", "Angle", "Torque")
    return TextTable("Points of the lines of operation, where there are data", header, tuple(rows))


def _missing(result: Result, operation: TorqueMap | None) -> dict[str, str]:
    """Say why a section has nothing to show."""
    judged, missing = result.diagnostics, {}
    if judged is None:
        missing = dict.fromkeys(("comparison", "residuals", "currents"), result.origin.no_diagnostics or _NOT_STORED)
    else:
        if not judged.comparisons:
            missing["comparison"] = (
                "The paper's methods were not run on these data: fit the recording with --report or --figures."
            )
        if not np.isfinite(judged.over_time.mean).any():
            missing["residuals"] = "The recordings hold too few samples for a residual."
        if judged.simulated is None:
            missing["currents"] = "The simulated current diverged, or no samples were kept to simulate it."
    if not result.origin.inverter:
        missing["inverter"] = result.origin.no_inverter
    elif not np.any(result.drive.inverter_voltage):
        missing["inverter"] = "The result holds no inverter drop."
    if not result.origin.turning:
        missing |= {"comparison": "The paper's methods need a turning rotor.", "operation": result.origin.no_torque}
    elif operation is None:
        missing["operation"] = (
            f"The number of pole pairs is unknown, and without it there is no torque: {result.origin.pole_pairs}."
        )
    elif operation.speeds is None:
        missing["efficiency"] = (
            "Torque and efficiency over speed are not shown: they need R, the DC-link voltage (the setting u_dc of the "
            "fit), and a current that keeps it."
        )
    if operation is not None and "MTPV" not in operation.lines:
        missing["mtpv"] = (
            f"No MTPV is shown: it lies beyond {number(result.i_max)} A, or where there are no data. Within the data, "
            "the largest torque at a given flux is limited by the current."
        )
    return missing


def _drop(result: Result) -> str:
    """Say of which dead time the drop is, if it is of nothing else: the dead time costs u_dc t_d / T_switching."""
    if not result.origin.inverter or not result.u_dc or not math.isfinite(result.voltage_error):
        return ""
    share = result.voltage_error / result.u_dc
    drop = measured(result.voltage_error, result.sigma_voltage_error, "V")
    return (
        f"The drop at large current, {drop}, is that of a dead time of {percent(share)} of the switching period at "
        f"{number(result.u_dc)} V, {number(100 * share, 3)} µs at 10 kHz. The threshold voltages of the switches are "
        "part of it, so that the dead time itself is shorter."
    )


def _paragraph(result: Result) -> str:
    """Write a paragraph of method with the result's own numbers, to be pasted into a paper or a test report."""
    metrics, origin = result.metrics, result.origin
    what = f"of the machine {result.name}" if result.name else "of the machine"
    data = f" from {number(result.duration)} s of data" if result.duration else ""
    speed = f" at an electrical speed of {_speed(result)}" if result.speed_range else ""
    version = result.provenance.versions.get("drive_id", VERSION)
    drop = ""
    if origin.inverter:
        value = measured(result.voltage_error, result.sigma_voltage_error, "V")
        drop = f", the inverter's voltage drop at large current {value}"
    also, done = (" and the resistance", "identified") if origin.fitted else ("", "imported")
    first = (
        f"The flux linkage maps{also} {what} were {done}{data}{speed} with drive_id {version}; their current disc has "
        f"a radius of {number(result.i_max)} A."
    )
    sentences = [first, origin.summary]
    if math.isfinite(result.resistance):
        error = " (± standard error)" if math.isfinite(result.sigma_resistance) else ""
        resistance = result.told(result.resistance, result.sigma_resistance, "Ω")
        included = "; R includes the linear part of this drop" if drop else ""
        sentences.append(f"R = {resistance}{drop}{error}{included}.")
    if result.harmonics:
        orders = ", ".join(str(found.order) for found in result.harmonics)
        sentences.append(f"Rotor-position harmonics of electrical orders {orders} are separate from the mean map.")
    sigma = flux_sigma(result)
    if math.isfinite(sigma):
        share = percent(sigma / result.flux_map.largest)
        sentences.append(
            f"The median standard error of the flux is {result.told(sigma, unit='Wb')} ({share} of its largest value)."
        )
    judged = [f"The data cover {percent(metrics['coverage'])} of the disc"]
    if math.isfinite(metrics["mad_d"]):
        judged.append(
            "the current simulated in open loop deviates from the measured one by "
            f"{measured(metrics['mad_d'], unit='A')} in d and {measured(metrics['mad_q'], unit='A')} in q on average"
        )
    sentences.append("; ".join(judged) + ".")
    return " ".join(filter(None, (*sentences, origin.reference)))


def number(value: float | None, digits: int = 4) -> str:
    """Return a number to some significant digits, with a true minus sign; ``unknown`` where it is not finite."""
    if value is None or not math.isfinite(value):
        return "unknown"
    return rounded(value, digits).replace("-", "\N{MINUS SIGN}")


def percent(share: float) -> str:
    """Return a share in percent, to three significant digits."""
    return f"{number(100 * share, 3)} %" if math.isfinite(share) else "unknown"
