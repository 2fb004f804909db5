"""Report of the effects in the model: values with standard errors, sentences, and remaining alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.effects.effect import CERTAIN, Calibration, Reported
from drive_id.core.full.fit import FullFit
from drive_id.core.full.lack_of_fit import LackOfFit
from drive_id.core.full.model import RESISTANCE
from drive_id.core.full.solver import LEAST_TOLD
from drive_id.core.full.standard_errors import sigma as fitted_sigma
from drive_id.core.full.window_sums import MOST_KEPT
from drive_id.core.full.windows import MOST_DELAY, SEARCHED, STRIDE, Windows
from drive_id.core.maps.flux_models import jacobian
from drive_id.types import FloatArray

_NEGLIGIBLE = 5e-4
"""Rms of the residuals beyond noise, relative to the integrated voltages, below which there is no warning: it cost no
random drive 0.1 % of the flux."""
_MUCH = 2e-3
"""The same from which on there is a warning whatever they seem to move: only what recurs in cells is seen to. At most
0.13 % on 125 drives of the population; 0.3 % where a DC link that fell moved the flux by 1 to 4 %."""
_MOVED, _OF_SIGMA = 1e-3, 0.7
"""Share of the flux that residuals beyond noise, or a rival of an effect, must move to be warned of, or of the standard
error of R, which they are a part of: as large as all else."""
_FOLLOWED = MOST_DELAY - 0.25
"""Samples by which signals may come later than others where their clocks differ: a fit that does not follow ends just
within what windows keep, at 3.9 of 6 samples, and one of 3.6 was right."""
_CONCENTRATED = 1.5
"""Residuals at small currents, relative to all, from which on they are told to lie there."""
_SUSPICIOUS = 0.15
"""Share of the squared residuals that an explanation must reach to be named."""
_UNSEEN = 2.0
"""Mean square residual of the windows left out of the selection over that of the others, from which on they hold what
the model lacks: 1.10 to 1.17 on good drives of the population, 7.1 where a variation of the DC link was misjudged."""
OUTLYING = 20.0
"""Residuals of one batch, squared, relative to the median, from which on an event in time is told."""
_WHILE = 1.0
"""s, over which the DC link's mean is taken: ripples average out, and a battery falls more slowly."""
_ALIKE = 0.5
"""Share of the best explanation above which another one is named, too."""
_MOST_NAMED = 2
"""Most explanations named: a longer list helps nobody."""


def misfit_found(fit: FullFit) -> Message | None:
    """Describe residuals above noise: size, region and likely cause; None if they are small."""
    misfit = fit.assessment.misfit
    beyond = fit.solution.residual_rms**2 * (1 - misfit.ratio**-2)
    if misfit.ratio < LEAST_TOLD or beyond < _NEGLIGIBLE**2 * fit.total_voltage:
        return None
    d, q = misfit.i_dq
    values = {"ratio": misfit.ratio, "worst": misfit.worst, "i_d": d, "i_q": q}
    if fit.assessment.outlying > OUTLYING:
        return Message("misfit.time", time=fit.assessment.outlying_time, **values)
    moved, moves = _moved(fit)
    if not moves and beyond < _MUCH**2 * fit.total_voltage:
        return Message("harmless_misfit", moved=moved, **values)
    if misfit.low > _CONCENTRATED * misfit.ratio:
        return Message("misfit.small_currents", low=misfit.low, **values)
    return _with_cause("misfit", fit, **values)


def _moved(fit: FullFit) -> tuple[float, bool]:
    """Return by how much residuals beyond noise move the flux, relative, and whether that or R matters."""
    misfit = fit.assessment.misfit
    moved = _share_moved(fit, misfit.changes, misfit)
    of_resistance = float(np.linalg.norm(misfit.changes[RESISTANCE]))
    return moved, moved > _MOVED or of_resistance > _OF_SIGMA * fit.sigma(RESISTANCE)


def _share_moved(fit: FullFit, changes: FloatArray, missed: LackOfFit | None = None) -> float:
    """Return by how much changes (size, K) of the estimate move the flux, rms over the data, relative to it."""
    model, windows = fit.model, Windows.joined(fit.selection.search.sums.kept())
    currents = windows.thinned(SEARCHED).i_dq[:, 0]
    rows = model.flux.rows(currents)
    flux = rows.dot(fit.solution.estimate[model.map])
    squares = sum(np.square(rows.dot(change)) for change in changes[model.map].T)
    if missed is not None:
        squares = squares + missed.missed_at(currents, model.i_max)
    return float(np.sqrt(np.mean(squares, axis=0).max() / np.mean(np.square(flux).sum(axis=1))))


def _open(fit: FullFit, name: str) -> bool:
    """Tell whether a rival of an effect would move the flux or R by so much that a user must know."""
    change = fit.assessment.by_rivals.get(name)
    if change is None:
        return False
    of_resistance = abs(float(change[RESISTANCE]))
    return _share_moved(fit, change[:, None]) > _MOVED or of_resistance > _OF_SIGMA * fit.sigma(RESISTANCE)


def unseen_warning(fit: FullFit) -> Message | None:
    """Report windows that were left out of the selection and that the selected model does not describe."""
    ratio, sums = fit.assessment.unseen, fit.selection.search.sums
    beyond = fit.solution.residual_rms**2 * (1 - 1 / max(ratio, 1.0))
    if ratio < _UNSEEN or beyond < _NEGLIGIBLE**2 * fit.total_voltage:
        return None
    unused = 1 - sum(map(len, sums.kept())) / sums.windows
    return Message("misfit.unseen", ratio=float(np.sqrt(ratio)), unused=unused, limit=MOST_KEPT * STRIDE)


def not_reciprocal_warning(fit: FullFit) -> Message:
    """Report maps that are not reciprocal, with the cause suggested by the score tests."""
    return _with_cause("not_reciprocal", fit, advantage=fit.selection.advantage)


def _with_cause(code: str, fit: FullFit, **values: float) -> Message:
    """Name the causes that would explain most of the squared residuals, if that is much."""
    causes = fit.assessment.misfit.causes
    largest = max(causes.values(), default=0.0)
    if largest <= _SUSPICIOUS:
        return Message(code, **values)
    close = sorted((name for name in causes if causes[name] > _ALIKE * largest), key=lambda name: -causes[name])
    return Message(f"{code}.cause", causes=",".join(close[:_MOST_NAMED]), explained=largest, **values)


def effect_entries(fit: FullFit) -> list[Calibration]:
    """Return the values of all effects in the model, in the order in which they were found."""
    found, estimate = fit.selection.search.found, fit.solution.estimate
    columns = found.columns
    out: list[Calibration] = []
    drop = float(fit.model.shapes.coarse(np.array(fit.model.i_max)) @ fit.model.coarse_drop(estimate))
    slopes, links = jacobian(fit.model.flux, estimate[fit.model.map], np.zeros((1, 2))), _links(fit)
    kept = fit.selection.search.sums.kept()
    parts, longest = _parts(kept, columns.divided), _longest_run(kept)
    for taken in found.taken:
        if taken.name not in fit.spec.effects:
            continue
        own = fit.model.effect(taken.name)
        changes = fit.assessment.changes[own]
        reported = Reported(
            value=estimate[own],
            sigma=fitted_sigma(changes),
            sigma_of=partial(_sigma_of, changes),
            met=partial(fit.met, taken.name),
            rivals=taken.rivals,
            open=_open(fit, taken.name),
            several_speeds=fit.steady is None,
            fastest=float(np.abs(fit.assessment.speeds).max()),
            period=float(np.mean([windows.period.mean() for windows in kept])),
            resistance=float(estimate[RESISTANCE]),
            inductance=float(slopes[0, 0, 0]),
            i_max=fit.model.i_max,
            drop=drop,
            pole_pairs=columns.pole_pairs,
            link=columns.link,
            links=links,
            ripple=columns.ripple,
            turns=columns.ripple * longest,
            time_constant=np.inf if columns.winding is None else columns.winding.constant,
            parts=parts,
        )
        out += CATALOGUE[taken.name].report(reported)
    return _doubted_heat(out)


def effect_refused(fit: FullFit) -> Message | None:
    """Return why the fit cannot follow as much of an effect as it found; None where it can."""
    search, jump = fit.selection.search, fit.assessment.jump
    columns = replace(search.found.columns, estimate=fit.solution.estimate)
    half = 0.5 * float(np.ptp(columns.spans, axis=1).max())
    period = min(float(windows.period.min()) for windows in search.sums.kept())
    drifts = jump is not None and np.isfinite(jump.drift)  # however little was found, the rest is left
    delay = max(fit.spec.delay, np.nan_to_num(search.found.delay.value), key=abs)  # taken or not
    steady = abs(delay * period + columns.late_currents)  # the drift comes on top
    reach = 0.0 if drifts else max(_FOLLOWED * period - steady, 0.0)
    for taken in search.found.taken:
        if taken.name in fit.spec.effects:
            value = fit.solution.estimate[fit.model.effect(taken.name)]
            if (said := CATALOGUE[taken.name].refused(value, half, reach)) is not None:
                return said
    return None


def _doubted_heat(entries: list[Calibration]) -> list[Calibration]:
    """Doubt each change of the magnet's flux that has the sign of that of R beside it: heat moves them apart."""
    out, found = [], {entry.name: entry for entry in entries}
    for entry in entries:
        number = entry.name.removeprefix("magnet_flux_change")
        copper = found.get(f"resistance_change{number}" if number else "resistance_rise")
        if copper is None or number == entry.name:
            out.append(entry)
            continue
        certain = all(abs(each.value) > CERTAIN * each.sigma for each in (entry, copper))
        told = Message("magnet_flux_change.doubted", **entry.message.values, kelvin=copper.message.values["kelvin"])
        opposed = certain and entry.value * copper.value > 0
        out.append(replace(entry, doubtful=True, message=told) if opposed else entry)
    return out


def _links(fit: FullFit) -> tuple[float, float]:
    """Return the lowest and the highest mean of the DC-link voltage in a while, V; NaN where it is not known."""
    link, voltage, recording, time = (
        np.concatenate([getattr(windows, name) for windows in fit.selection.search.sums.kept()])
        for name in ("link", "voltage", "recording", "time")
    )
    known = np.isfinite(link)
    _, whiles = np.unique([recording[known], time[known] // _WHILE], axis=1, return_inverse=True)
    products, voltage = (voltage.conj() * link)[known].real, voltage[known]
    weights = np.bincount(whiles, np.abs(voltage) ** 2)
    means = np.bincount(whiles, products)[weights > 0] / weights[weights > 0]
    return (float(means.min()), float(means.max())) if len(means) else (np.nan, np.nan)


def _longest_run(kept: Sequence[Windows]) -> float:
    """Return the duration of the longest run without a gap, s."""
    run, time = (np.concatenate([getattr(windows, name) for windows in kept]) for name in ("run", "time"))
    return max(float(np.ptp(time[run == number])) for number in np.unique(run))


def _parts(kept: Sequence[Windows], divided: str) -> tuple[dict[str, float], ...]:
    """Return the recording of each part of the data, and the time of its data where the part is behind a pause."""
    part, recordings, time = (
        np.concatenate([getattr(windows, name) for windows in kept]) for name in (divided, "recording", "time")
    )
    out: list[dict[str, float]] = []
    for number in range(int(part.max()) + 1):
        own = part == number
        recording = int(recordings[own][0]) if own.any() else number  # without windows, nothing is told of it
        since = time[own].min(initial=np.inf) - time[recordings == recording].min(initial=np.inf)
        out.append({"recording": recording + 1} | ({"pause": float(since)} if 0 < since < np.inf else {}))
    return tuple(out)


def _sigma_of(changes: FloatArray, forms: FloatArray) -> FloatArray:
    """Return the standard errors (L,) of combinations (K, L) of unknowns with changes (K, B)."""
    return fitted_sigma(forms.T @ changes)
