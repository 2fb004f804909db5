"""Report of the effects in the model: values with standard errors, sentences, and remaining alternatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drive_id.core import frames
from drive_id.core.full.calibration import VOLTAGE_MISMATCH, Calibration
from drive_id.core.full.effect_search import Taken
from drive_id.core.full.fit import FullFit
from drive_id.core.full.fit import sigma as fitted_sigma
from drive_id.core.full.lack_of_fit import LEAST_TOLD
from drive_id.core.full.model import RESISTANCE
from drive_id.core.full.windows import LAGS
from drive_id.core.maps.flux_models import jacobian
from drive_id.temperature import COPPER
from drive_id.types import FloatArray

NOUNS = {
    "iron_loss": "iron loss",
    "hysteresis": "iron loss by hysteresis",
    "coercivity": "iron loss by hysteresis of constant coercivity",
    "current_latency": "a filter or a latency of the currents",
    "angle_latency": "a latency of the angle",
    "flux_lag": "flux that lags the current (eddy currents in the magnets)",
    **{f"flux_lag_{1e3 * lag:g}ms": f"flux that lags the current by {1e3 * lag:g} ms" for lag in LAGS},
    "copper_heating": "heating of the winding",
    "magnet_heating": "heating of the magnets",
    "copper_recordings": "another winding temperature in a later recording",
    "magnet_recordings": "another magnet temperature in a later recording",
    "eccentricity": "an eccentric resolver",
    "eccentric_rotor": "a flux that varies over the mechanical turn (eccentric rotor)",
    "resolver_first": "a resolver error of the first electrical order",
    "resolver_second": "a resolver error of the second electrical order",
    "dc_link": "a varying DC-link voltage",
    "phase_resistance": "unequal phase resistances",
    "voltage_gains": "unequal voltage gains of the phases",
    "voltage_delay": "a delay of the voltages",
}
"""Name of each effect in sentences."""

TESTED = (
    "iron loss, lag of the flux, heat, latencies, resolver, unequal phases, rotor-position harmonics, ripple of a "
    "rectified DC link"
)

_MICRO, _MILLI = 1e6, 1e3
_NEGLIGIBLE = 5e-4
"""Rms of the residuals beyond noise, relative to the integrated voltages, below which there is no warning: it cost no
random drive 0.1 % of the flux."""
_CONCENTRATED, _SUSPICIOUS, _OUTLYING = 1.5, 0.15, 20.0
_ALIKE, _MOST_NAMED = 0.5, 2
"""Share of the best explanation above which another one is named too, and the most that are named."""


def misfit_warning(fit: FullFit) -> str | None:
    """Describe residuals above noise: size, region and likely cause; None if they are small."""
    misfit = fit.misfit
    beyond = fit.solution.residual_rms**2 * (1 - misfit.ratio**-2)
    if misfit.ratio < LEAST_TOLD or beyond < _NEGLIGIBLE**2 * fit.total_voltage:
        return None
    d, q = misfit.i_dq
    where = f"most of all around i_d = {d:.3g} A, i_q = {q:.3g} A ({misfit.worst:.1f} times)"
    return (
        f"The residuals are {misfit.ratio:.1f} times as large as current noise explains, {where}: {_suspect(fit)}; the "
        "standard errors include what repeats over current and rotor position."
    )


def _suspect(fit: FullFit) -> str:
    """Name the tested cause that explains the residuals best."""
    misfit, (noun, share) = fit.misfit, likeliest_cause(fit)
    if fit.outlying > _OUTLYING:
        return f"the samples around {fit.outlying_time:.2f} s of data stand out from all others"
    if misfit.low > _CONCENTRATED * misfit.ratio:
        return (
            "they gather at small currents, where dead time and ripple of the inverter act; lower the dead time or the "
            "DC-link voltage"
        )
    if share > _SUSPICIOUS:
        return f"of the causes tested, {noun} would explain most, {100 * share:.0f} % of their squares"
    return (
        f"none of the causes tested ({TESTED}) explains them; check for voltages limited by the DC link, or a DC-link "
        "voltage that varies"
    )


def likeliest_cause(fit: FullFit) -> tuple[str, float]:
    """Return the causes that would explain most of the squared residuals, as nouns, and the largest share."""
    causes = fit.misfit.causes
    largest = max(causes.values(), default=0.0)
    close = sorted((name for name in causes if causes[name] > _ALIKE * largest), key=lambda name: -causes[name])
    return " or ".join(_cause(name) for name in close[:_MOST_NAMED]), largest


def _cause(name: str) -> str:
    kind, _, number = name.partition(" ")
    nouns = {
        "harmonic": f"a rotor-position harmonic of order {number}",
        "ripple": f"a DC-link voltage that ripples at {number} Hz (record it)",
        "devices": "drops of the inverter that differ between the phases (set per_phase_inverter)",
    }
    return nouns[kind] if kind in nouns else NOUNS[name]


def not_reciprocal_warning(fit: FullFit) -> str:
    """Report maps that are not reciprocal, with the cause suggested by the score tests."""
    noun, share = likeliest_cause(fit)
    cause = (
        f"of the causes tested, {noun} would explain most, {100 * share:.0f} % of the squared residuals"
        if share > _SUSPICIOUS
        else f"none of the causes tested ({TESTED}) explains this, so the machine itself may not be reciprocal"
    )
    return (
        f"The maps are not reciprocal: free maps predict left-out data {100 * fit.selection.advantage:.0f} % better, "
        f"so they were used; {cause}; at a single speed free maps leave resistance and voltage delay undetermined: "
        "record several speeds."
    )


def effect_entries(fit: FullFit, *, several_speeds: bool) -> list[Calibration]:
    """Return the values of all effects in the model, in the order in which they were found."""
    entries: list[Calibration] = []
    for taken in fit.selection.search.taken:
        if taken.name in fit.spec.effects:
            entries += _entries(fit, taken, several_speeds=several_speeds)
    return entries


def _entries(fit: FullFit, taken: Taken, *, several_speeds: bool) -> list[Calibration]:
    columns = fit.model.effect(taken.name)
    value, sigma = fit.solution.estimate[columns], fitted_sigma(fit.changes[columns])
    name = taken.name.split("_lag_")[0] + ("_lag" if "_lag_" in taken.name else "")
    reported = _REPORTS.get(name, _gains)(_Found(fit, taken.name, value, sigma))
    open_question = _open(taken, several_speeds=several_speeds)
    return [
        Calibration(
            key, x, dx, unit, True, sentence + open_question, doubtful=bool(open_question) or key == VOLTAGE_MISMATCH
        )
        for key, x, dx, unit, sentence in reported
    ]


def _open(taken: Taken, *, several_speeds: bool) -> str:
    """Name other effects that explain the residuals nearly as well, and the recording that would distinguish them."""
    if not taken.rivals:
        return ""
    others = " or ".join(NOUNS[name] for name in taken.rivals)
    remedy = "a faster trajectory" if several_speeds else "a second recording at another speed, in the other direction"
    return f" This is open: {others} would explain these data nearly as well; {remedy} would tell."


Value = tuple[str, float, float, str, str]
"""Name, value, standard error, unit and sentence."""


class _Found(NamedTuple):
    """An effect, the estimates of its columns and their standard errors."""

    fit: FullFit
    name: str
    value: FloatArray
    sigma: FloatArray


Report = Callable[[_Found], list[Value]]


def _iron(found: _Found) -> list[Value]:
    g, dg = float(found.value[0]), float(found.sigma[0])
    if found.name == "iron_loss":
        sentence = (
            f"Iron loss was identified as a conductance of {g:.4g} +- {dg:.2g} S across the induced voltage; eddy "
            "currents and hysteresis cannot be told apart below three speeds."
        )
        return [("iron_loss_conductance", g, dg, "S", sentence)]
    if found.name == "coercivity":
        sentence = (
            f"Iron loss was identified as hysteresis: a current of {g:.4g} +- {dg:.2g} A along the induced voltage, "
            "whatever its size."
        )
        return [("iron_loss_current", g, dg, "A", sentence)]
    sentence = f"Iron loss was identified as hysteresis: a conductance of {g:.4g} +- {dg:.2g} S rad/s over the speed."
    return [("iron_loss_hysteresis", g, dg, "S rad/s", sentence)]


def _latency(found: _Found) -> list[Value]:
    x, dx = _MICRO * float(found.value[0]), _MICRO * float(found.sigma[0])
    what = "angle is" if found.name == "angle_latency" else "currents are filtered or sampled"
    when = "late" if x > 0 else "early"
    sentence = f"The {what} {abs(x):.3g} +- {dx:.2g} us {when}; this was corrected."
    return [(found.name, x, dx, "us", sentence)]


def _lag(found: _Found) -> list[Value]:
    x, dx = float(found.value[0]), float(found.sigma[0])
    cause = "as eddy currents in the magnets cause; this was corrected."
    if found.name == "flux_lag":
        sentence = f"The flux lags the current by {_MICRO * x:.3g} +- {_MICRO * dx:.2g} us, {cause}"
        return [(found.name, _MICRO * x, _MICRO * dx, "us", sentence)]
    time = found.name.removeprefix("flux_lag_")
    sentence = f"A share of {100 * x:.3g} +- {100 * dx:.2g} % of the flux lags the current by about {time}, {cause}"
    return [(found.name, x, dx, "1", sentence)]


def _copper(found: _Found) -> list[Value]:
    reference = float(found.fit.solution.estimate[RESISTANCE])
    out = []
    for k, (x, dx) in enumerate(zip(found.value, found.sigma, strict=True)):
        if found.name == "copper_recordings" and not found.fit.met(found.name, k):
            continue
        kelvin = x / reference / COPPER
        change = f"by {_MILLI * x:.4g} +- {_MILLI * dx:.2g} mohm ({100 * x / reference:+.2g} %, {kelvin:+.0f} K)"
        if found.name == "copper_heating":
            sentence = (
                f"The resistance changed {change} with the heat of the longest recording; resistance and map hold at "
                "its start."
            )
            out.append(("resistance_rise", float(x), float(dx), "ohm", sentence))
        else:
            sentence = (
                f"In recording {k + 2} the resistance differs {change} from that of the first, which is reported."
            )
            out.append((f"resistance_change_{k + 2}", float(x), float(dx), "ohm", sentence))
    return out


def _magnet(found: _Found) -> list[Value]:
    """Report the change of psi_d at zero current, by flux and by the equivalent current of the magnet."""
    forms = np.zeros((found.fit.model.size, len(found.value) // 2))
    slope = jacobian(found.fit.model.flux, found.fit.solution.estimate[found.fit.model.map], np.zeros((1, 2)))[0, 0, 0]
    first = found.fit.model.effect(found.name).start
    for k in range(forms.shape[1]):
        forms[first + 2 * k : first + 2 * k + 2, k] = 1.0, slope
    out = []
    for k, (x, dx) in enumerate(
        zip(forms.T @ found.fit.solution.estimate, fitted_sigma(forms.T @ found.fit.changes), strict=True)
    ):
        if not found.fit.met(found.name, 2 * k):
            continue
        change = f"by {_MILLI * x:.4g} +- {_MILLI * dx:.2g} mVs"
        if found.name == "magnet_heating":
            sentence = (
                f"The magnet's flux changed {change} with the heat of the longest recording; the map holds at its "
                "start."
            )
            out.append(("magnet_flux_change", float(x), float(dx), "Wb", sentence))
        else:
            sentence = (
                f"In recording {k + 2} the magnet's flux differs {change} from that of the first, which is reported."
            )
            out.append((f"magnet_flux_change_{k + 2}", float(x), float(dx), "Wb", sentence))
    return out


def _of_pairs(found: _Found) -> tuple[float, float]:
    """Return the amplitude of cosine and sine, rms over the runs that have them, and its standard error."""
    pairs, errors = found.value.reshape(-1, 2), found.sigma.reshape(-1, 2)
    met = [k for k in range(len(pairs)) if found.fit.met(found.name, 2 * k)]
    amplitude = float(np.sqrt(np.mean(np.sum(pairs[met] ** 2, axis=1))))
    deviation = float(np.sqrt(np.mean(errors[met] ** 2) / len(met)))
    return amplitude, deviation


def _resolver(found: _Found) -> list[Value]:
    amplitude, deviation = _of_pairs(found)
    poles = found.fit.selection.search.columns.pole_pairs
    turn = {
        "eccentricity": f"once per mechanical turn of {poles} pole pairs",
        "resolver_first": "once per electrical turn",
        "resolver_second": "twice per electrical turn",
    }[found.name]
    sentence = (
        f"The angle has an error of {np.rad2deg(amplitude):.3g} +- {np.rad2deg(deviation):.2g} degrees electrical "
        f"{turn}; this was corrected."
    )
    return [(f"resolver_{found.name.removeprefix('resolver_')}", amplitude, deviation, "rad", sentence)]


def _rotor(found: _Found) -> list[Value]:
    amplitude, deviation = _of_pairs(found)
    poles = found.fit.selection.search.columns.pole_pairs
    sentence = (
        f"The flux varies by {100 * amplitude:.3g} +- {100 * deviation:.2g} % over the mechanical turn of {poles} pole "
        "pairs, as an eccentric rotor causes; the map is the mean."
    )
    return [("rotor_eccentricity", amplitude, deviation, "1", sentence)]


def _link(found: _Found) -> list[Value]:
    x, dx = float(found.value[0]), float(found.sigma[0])
    sentence = (
        f"The voltages follow {100 * x:.3g} +- {100 * dx:.2g} % of the DC link's variation (0: compensated by the "
        "drive, 100: not); this was corrected."
    )
    return [("dc_link_share", x, dx, "1", sentence)]


def _phases(found: _Found) -> list[Value]:
    out = []
    for phase, x, dx in zip(
        "abc", (*found.value, -found.value.sum()), (*found.sigma, np.hypot(*found.sigma)), strict=True
    ):
        sentence = f"The resistance of phase {phase} is {_MILLI * x:.3g} +- {_MILLI * dx:.2g} mohm above the mean."
        out.append((f"resistance_{phase}", float(x), float(dx), "ohm", sentence))
    return out


def _gains(found: _Found) -> list[Value]:
    """Report the mismatch g: the voltage is u + g conj(u). A phase k with the gain 1 + e has g = -e/3 e^{2j phi_k}."""
    g = complex(*found.value)
    amplitude, deviation = abs(g), float(np.linalg.norm(found.sigma))
    along = np.real(g * np.exp(-2j * frames.PHASE_SHIFTS))
    phase = int(np.argmax(np.abs(along)))
    sentence = (
        f"The voltages' gains differ by {100 * amplitude:.3g} +- {100 * deviation:.2g} %, as if phase {'abc'[phase]} "
        f"were {-300 * along[phase]:+.2g} % off; this was corrected, but a gain error that all phases share, which "
        "scales R and all fluxes, cannot be seen and is probably as large: check the gains of the voltages."
    )
    return [(VOLTAGE_MISMATCH, amplitude, deviation, "1", sentence)]


_REPORTS: dict[str, Report] = {
    "iron_loss": _iron,
    "hysteresis": _iron,
    "coercivity": _iron,
    "current_latency": _latency,
    "angle_latency": _latency,
    "flux_lag": _lag,
    "copper_heating": _copper,
    "copper_recordings": _copper,
    "magnet_heating": _magnet,
    "magnet_recordings": _magnet,
    "eccentricity": _resolver,
    "eccentric_rotor": _rotor,
    "resolver_first": _resolver,
    "resolver_second": _resolver,
    "dc_link": _link,
    "phase_resistance": _phases,
}
