"""Report of the effects in the model: values with standard errors, sentences, and remaining alternatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from drive_id.core import frames
from drive_id.core.full.calibration import CURRENT_ROTATION, VOLTAGE_MISMATCH, Calibration
from drive_id.core.full.effect_search import several_speeds
from drive_id.core.full.fit import FullFit
from drive_id.core.full.linearized import Taken
from drive_id.core.full.model import EFFECTS, RESISTANCE
from drive_id.core.full.solver import LEAST_TOLD
from drive_id.core.full.standard_errors import sigma as fitted_sigma
from drive_id.core.full.window_sums import MOST_KEPT
from drive_id.core.full.windows import SEARCHED, STRIDE, Windows
from drive_id.core.maps.flux_models import jacobian
from drive_id.messages import Message
from drive_id.temperature import COPPER
from drive_id.types import FloatArray

_NEGLIGIBLE = 5e-4
"""Rms of the residuals beyond noise, relative to the integrated voltages, below which there is no warning: it cost no
random drive 0.1 % of the flux."""
_MOVED, _OF_SIGMA = 1e-3, 0.7
"""Share of the flux that residuals beyond noise must move, or of the standard error of R (which they are a part of: as
large as all else), to be warned of."""
_CONCENTRATED = 1.5
"""Residuals at small currents, relative to all, from which on they are told to lie there."""
_SUSPICIOUS = 0.15
"""Share of the squared residuals that an explanation must reach to be named."""
_UNSEEN = 2.0
"""Mean square residual of the windows left out of the selection over that of the others, from which on they hold what
the model lacks: 1.10 to 1.17 on good drives of the population, 7.1 where a variation of the DC link was misjudged."""
OUTLYING = 20.0
"""Residuals of one batch, squared, relative to the median, from which on an event in time is told."""
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
    if not moves:
        return Message("harmless_misfit", moved=moved, **values)
    if misfit.low > _CONCENTRATED * misfit.ratio:
        return Message("misfit.small_currents", low=misfit.low, **values)
    return _with_cause("misfit", fit, **values)


def _moved(fit: FullFit) -> tuple[float, bool]:
    """Return by how much residuals beyond noise move the flux, relative, and whether that or R matters."""
    model, misfit = fit.model, fit.assessment.misfit
    currents = Windows.joined(fit.selection.search.sums.kept()).thinned(SEARCHED).i_dq[:, 0]
    rows = model.flux.rows(currents)
    flux = rows.dot(fit.solution.estimate[model.map])
    changes = [rows.dot(change) for change in misfit.changes[model.map].T]
    squares = sum((np.square(change) for change in changes), misfit.missed_at(currents, model.i_max))
    moved = float(np.sqrt(np.mean(squares, axis=0).max() / np.mean(np.square(flux).sum(axis=1))))
    of_resistance = float(np.linalg.norm(misfit.changes[RESISTANCE]))
    return moved, moved > _MOVED or of_resistance > _OF_SIGMA * fit.sigma(RESISTANCE)


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
    entries: list[Calibration] = []
    several = several_speeds(fit.assessment.speeds)
    for taken in fit.selection.search.found.taken:
        if taken.name in fit.spec.effects:
            entries += _REPORTS[taken.name](_ReportedEffect(fit, taken, several))
    return entries


@dataclass(frozen=True, eq=False)
class _ReportedEffect:
    """An effect of the model."""

    fit: FullFit
    taken: Taken
    several_speeds: bool

    @property
    def name(self) -> str:
        return self.taken.name

    @cached_property
    def value(self) -> FloatArray:
        """Estimates of its columns."""
        return self.fit.solution.estimate[self.fit.model.effect(self.name)]

    @cached_property
    def sigma(self) -> FloatArray:
        """Their standard errors."""
        return fitted_sigma(self.fit.assessment.changes[self.fit.model.effect(self.name)])

    def entry(
        self, name: str, value: float, sigma: float, unit: str, key: str = "", *, scale: float = 1.0, **more: Any
    ) -> Calibration:
        """Return a value and its standard error, shown in a unit of which an SI unit is ``scale``; ``more`` is told."""
        rivals = ",".join(self.taken.rivals) or None
        told = {"value": value, "sigma": sigma, **more, "rivals": rivals, "several_speeds": self.several_speeds}
        shown, doubtful = float(scale * value), rivals is not None or name == VOLTAGE_MISMATCH
        return Calibration(name, shown, float(scale * sigma), unit, True, Message(key or name, **told), doubtful)


def _one(found: _ReportedEffect) -> Iterator[Calibration]:
    name, unit, of_unit = _OF_ONE_VALUE[found.name]
    yield found.entry(name, of_unit * found.value[0], of_unit * found.sigma[0], unit)


def _late(found: _ReportedEffect) -> Iterator[Calibration]:
    x, dx = float(found.value[0]), float(found.sigma[0])
    yield found.entry(found.name, x, dx, "us", scale=1e6, size=abs(x), late=x > 0)


def _lag(found: _ReportedEffect) -> Iterator[Calibration]:
    lag = 1e-3 * float(found.name.removeprefix("flux_lag_").removesuffix("ms"))
    yield found.entry(found.name, found.value[0], found.sigma[0], "1", "flux_lag.share", lag=lag)


def _copper(found: _ReportedEffect) -> Iterator[Calibration]:
    reference = float(found.fit.solution.estimate[RESISTANCE])
    for k, (x, dx) in enumerate(zip(found.value, found.sigma, strict=True)):
        change = x / reference
        told = {"change": change, "kelvin": change / COPPER}
        if found.name == "copper_heating":
            winding, key = found.fit.selection.search.found.columns.winding, "resistance_rise"
            if winding is not None and np.isfinite(winding.constant):
                key, told = f"{key}.settling", {**told, "constant": winding.constant}
            yield found.entry("resistance_rise", x, dx, "ohm", key, **told)
        elif found.fit.met(found.name, k):
            yield found.entry(f"resistance_change_{k + 2}", x, dx, "ohm", "resistance_change", recording=k + 2, **told)


def _magnet(found: _ReportedEffect) -> Iterator[Calibration]:
    """Report the change of psi_d at zero current, by flux and by the equivalent current of the magnet."""
    forms = np.zeros((found.fit.model.size, len(found.value) // 2))
    slope = jacobian(found.fit.model.flux, found.fit.solution.estimate[found.fit.model.map], np.zeros((1, 2)))[0, 0, 0]
    first = found.fit.model.effect(found.name).start
    for k in range(forms.shape[1]):
        forms[first + 2 * k : first + 2 * k + 2, k] = 1.0, slope
    changes, sigmas = forms.T @ found.fit.solution.estimate, fitted_sigma(forms.T @ found.fit.assessment.changes)
    for k, (x, dx) in enumerate(zip(changes, sigmas, strict=True)):
        if not found.fit.met(found.name, 2 * k):
            continue
        if found.name == "magnet_heating":
            yield found.entry("magnet_flux_change", x, dx, "Wb")
        else:
            name, key = f"magnet_flux_change_{k + 2}", "magnet_flux_change.recording"
            yield found.entry(name, x, dx, "Wb", key, recording=k + 2)


def _wave(found: _ReportedEffect) -> Iterator[Calibration]:
    name, unit = _OF_WAVE.get(found.name, (found.name, "rad"))
    columns = found.fit.selection.search.found.columns
    told = {"frequency": columns.ripple} if found.name == "link_ripple" else {"pole_pairs": columns.pole_pairs}
    yield found.entry(name, *_amplitude(found), unit, **told)


def _amplitude(found: _ReportedEffect) -> tuple[float, float]:
    """Return the amplitude of cosine and sine, rms over the runs that have them, and its standard error."""
    pairs, errors = found.value.reshape(-1, 2), found.sigma.reshape(-1, 2)
    met = [k for k in range(len(pairs)) if found.fit.met(found.name, 2 * k)]
    amplitude = np.sqrt(np.mean(np.sum(pairs[met] ** 2, axis=1)))
    return float(amplitude), float(np.sqrt(np.mean(errors[met] ** 2) / len(met)))


def _phases(found: _ReportedEffect) -> Iterator[Calibration]:
    values, sigmas = (*found.value, -found.value.sum()), (*found.sigma, np.hypot(*found.sigma))
    for phase, (x, dx) in enumerate(zip(values, sigmas, strict=True)):
        yield found.entry(f"resistance_{'abc'[phase]}", x, dx, "ohm", "resistance_of_phase", phase=phase)


def _of_sensors(found: _ReportedEffect) -> Iterator[Calibration]:
    name, unit = _BY_AXIS[found.name]
    size = found.fit.model.i_max if unit == "A" else 1.0
    for axis, x, dx in zip(("alpha", "beta"), found.value, found.sigma, strict=True):
        yield found.entry(f"{name}_{axis}", x, dx, unit, f"{name}.fit", axis=axis, share=abs(x) / size)


def _gains(found: _ReportedEffect) -> Iterator[Calibration]:
    """Report the mismatch g: the voltage is u + g conj(u). A phase k with the gain 1 + e has g = -e/3 e^{2j phi_k}."""
    g = complex(*found.value)
    along = np.real(g * np.exp(-2j * frames.PHASE_SHIFTS))
    phase = int(np.argmax(np.abs(along)))
    sigma = float(np.linalg.norm(found.sigma))
    yield found.entry(VOLTAGE_MISMATCH, abs(g), sigma, "1", phase=phase, off=-3 * along[phase])


_OF_ONE_VALUE = {
    "iron_loss": ("iron_loss_conductance", "S", 1.0),
    "hysteresis": ("iron_loss_hysteresis", "S rad/s", 1.0),
    "coercivity": ("iron_loss_current", "A", 1.0),
    "dc_link": ("dc_link_share", "1", 1.0),
    "link_sag": ("link_sag", "%/kW", 1e5),
    "current_rotation": (CURRENT_ROTATION, "rad", 1.0),
}
"""Names and units under which effects are reported, and how many of the unit are one SI unit."""
_OF_WAVE = {
    "eccentricity": ("resolver_eccentricity", "rad"),
    "eccentric_rotor": ("rotor_eccentricity", "1"),
    "link_ripple": ("link_ripple", "1"),
}
_BY_AXIS = {"current_gains": ("current_gain_mismatch", "1"), "current_offset": ("current_offset", "A")}
"""Names and units, likewise."""

_REPORTS: dict[str, Callable[[_ReportedEffect], Iterator[Calibration]]] = {
    **dict.fromkeys(_OF_ONE_VALUE, _one),
    **dict.fromkeys(("current_latency", "angle_latency", "flux_lag"), _late),
    **dict.fromkeys(("copper_heating", "copper_recordings"), _copper),
    **dict.fromkeys(("magnet_heating", "magnet_recordings"), _magnet),
    **dict.fromkeys((*_OF_WAVE, "resolver_first", "resolver_second"), _wave),
    **dict.fromkeys(_BY_AXIS, _of_sensors),
    **dict.fromkeys((name for name in EFFECTS if name.startswith("flux_lag_")), _lag),
    "phase_resistance": _phases,
    "voltage_gains": _gains,
}
