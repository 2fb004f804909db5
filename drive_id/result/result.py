"""A result: the identified drive and its origin, as tables, as a machine model and as read from its folder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import Origin
from drive_id.common.quantity import Quantity, html_table, measured, spelled
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.headline import headline
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.errors import ConfigurationError
from drive_id.files.results.identification import Provenance, read_judged, read_results
from drive_id.result.advice import advice
from drive_id.result.pictures.caption import Caption
from drive_id.result.tables import map_dataset, pandas_library
from drive_id.types import FloatArray, GroundTruth, MachineMap, Samples

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from typing_extensions import Self

    from drive_id.core.accumulation.evidence import Evidence
    from drive_id.core.full.effects.effect import Calibration
    from drive_id.core.maps.flux_map import HarmonicMap
    from drive_id.core.result.diagnostics import Diagnostics
    from drive_id.core.result.identification import LinearMachine, Mechanics, TorqueFit

_MARGIN = 1.25
"""Reach of a machine map, in i_max: a simulated current overshoots its reference."""
_ENOUGH_SPEED = 3000.0
"""rpm at which the DC link of a machine map, where unknown, just drives the largest flux."""
_LEAST_ANGLES = 24
"""Of the rotor positions of a machine map."""
_ANGLES_PER_PERIOD = 12
"""Rotor positions per period of the highest harmonic, so that cubics between them are off by 0.02 % of it."""


@dataclass(frozen=True, eq=False)
class InverterCurve:
    """The identified voltage drop of one inverter phase.

    Parameters
    ----------
    current : (C,) float
        A, increasing.
    voltage : (C,) float
        V, positive for positive current.
    sigma : (C,) float or None
        Standard error of ``voltage``, V; method ``full``.
    phases : (C, 3) float or None
        The drop of each phase, V, when each was given a curve of its own.
    """

    current: FloatArray
    voltage: FloatArray
    sigma: FloatArray | None = None
    phases: FloatArray | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """An identified drive, its origin, and what is known of the experiment.

    Users have an :class:`drive_id.Identification`, which documents the fields, and draws, saves and reports itself.
    """

    drive: IdentifiedDrive
    provenance: Provenance
    excerpts: tuple[Samples, ...] = ()
    truth: GroundTruth | None = None
    last_stamp: int = 0
    stored: Diagnostics | None = None
    evidence: Evidence | None = None

    @property
    def method(self) -> str:
        """``psm``, ``joint``, ``full``, ``locked`` or ``static``; ``imported`` for a map of another tool."""
        return self.drive.method

    @property
    def origin(self) -> Origin:
        """What results of this method hold, and the words for it."""
        return self.drive.origin

    @property
    def machine(self) -> str:
        """Name of the machine; empty when unknown."""
        return self.provenance.machine

    @property
    def name(self) -> str:
        """Machine and serial number, as far as they are known."""
        serial = self.provenance.settings.serial
        return ", ".join(filter(None, (self.machine, f"serial {serial}" if serial else "")))

    @cached_property
    def headline(self) -> tuple[Quantity, ...]:
        """What is asked for first, with standard errors: magnet flux, inductances, R, drop, i_max, peak torque, J.

        What samples do not even enclose, or what is not known, is left out.
        """
        known = self.provenance
        return headline(
            self.drive, pole_pairs=self.pole_pairs, temperature=known.temperature, rated=known.settings.rated_current
        )

    def told(self, value: float, sigma: float = math.nan, unit: str = "") -> str:
        """Return a value and its standard error, in SI units, in the unit in which this result has all of its kind."""
        return measured(value, sigma, unit, self.drive.sizes.get(spelled(unit), math.nan))

    @property
    def advice(self) -> tuple[Message, ...]:
        """What to record next, the most useful first."""
        return advice(self.drive, self.provenance)

    @property
    def resistance(self) -> float:
        """R with the linear part of the inverter's drop, ohm."""
        return self.drive.resistance

    @property
    def sigma_resistance(self) -> float:
        """Standard error of the resistance, ohm; infinite when the recording is too short to estimate it."""
        return self.drive.sigma_resistance

    @property
    def voltage_error(self) -> float:
        """Drop of an inverter phase at large current, V, positive for a physical inverter; 0 for method ``psm``."""
        return self.drive.voltage_error

    @property
    def sigma_voltage_error(self) -> float:
        """Standard error of the voltage error, V."""
        return self.drive.sigma_voltage_error

    @property
    def inverter_curve(self) -> InverterCurve:
        """Drop of an inverter phase over its current."""
        drive = self.drive
        return InverterCurve(
            drive.inverter_current, drive.inverter_voltage, drive.sigma_inverter_voltage, drive.phase_voltages
        )

    @property
    def flux_map(self) -> FluxMap:
        """Flux linkages, incremental inductances and standard errors at any current that samples at least enclose."""
        return self.drive.answering

    @property
    def harmonics(self) -> tuple[HarmonicMap, ...]:
        """Rotor-position harmonics of the flux linkages; method ``full``."""
        return self.drive.flux_map.harmonics

    @property
    def calibrations(self) -> tuple[Calibration, ...]:
        """Faults of the sensors and effects of the drive, as estimated by method ``full``."""
        return self.drive.calibrations

    @property
    def torque(self) -> TorqueFit | None:
        """The recorded shaft torque against that of the map; None without one, or with unknown pole pairs."""
        return self.drive.torque

    @property
    def mechanics(self) -> Mechanics | None:
        """Inertia, friction and cogging of a free shaft; None where another torque moves it, or it is held."""
        return self.drive.mechanics

    @property
    def linear(self) -> LinearMachine | None:
        """Magnet flux and inductances at zero current; method ``static``."""
        return self.drive.linear

    @property
    def i_max(self) -> float:
        """Radius of the current disc of the experiment, A."""
        return self.drive.i_max

    @property
    def pole_pairs(self) -> int | None:
        """From the signals file or a simulation's ground truth; None when unknown."""
        return self.provenance.pole_pairs

    @property
    def u_dc(self) -> float | None:
        """DC-link voltage, V, from the settings or a simulation's ground truth; None when unknown."""
        return self.provenance.u_dc

    @property
    def speed_range(self) -> tuple[float, float] | None:
        """Lowest and highest electrical speed in the excerpts of the recordings, rad/s; None when unknown."""
        return self.provenance.speed_range

    @property
    def duration(self) -> float | None:
        """Time covered by samples, s; None when unknown."""
        return self.provenance.duration

    @property
    def date(self) -> str:
        """Of the recording (of the fit, when its stamps are not times of day), ISO 8601 in UTC."""
        return self.provenance.date

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Sentences with code and values, about the recording and about the fit."""
        return (*self.provenance.warnings, *self.drive.report.warnings)

    @property
    def statements(self) -> tuple[Message, ...]:
        """What fixed the unknowns that the data leave open, and what would help most; with code and values."""
        return self.drive.statements

    @property
    def metrics(self) -> Mapping[str, float]:
        """Figures of the fit by name, as in ``identification.json``; NaN where unknown.

        ``nrmse_d``, ``nrmse_q`` (against a ground truth), ``mad_d``, ``mad_q`` (A), ``coverage``, ``residual_rms`` (V)
        and the counts of :class:`~drive_id.core.methods.parameters.FitReport`.
        """
        nrmse_d, nrmse_q = self.provenance.nrmse or (math.nan, math.nan)
        report = {name: value for name, value in asdict(self.drive.report).items() if name != "warnings"}
        return {"nrmse_d": nrmse_d, "nrmse_q": nrmse_q} | report

    @cached_property
    def diagnostics(self) -> Diagnostics | None:
        """Residuals, simulated currents and the paper's methods, which are run now; of a folder, what it holds."""
        return self._judged(compared=True)

    def _judged(self, *, compared: bool) -> Diagnostics | None:
        if self.stored is not None or not self.excerpts:
            return self.stored
        from drive_id.core.result.diagnostics import diagnose  # noqa: PLC0415  # a loaded result does not need it

        known = self.provenance.settings, self.excerpts, self.truth, self.evidence
        return diagnose(self.drive, *known, compared=compared)

    def check_turning(self) -> None:
        """Raise ConfigurationError for a locked rotor, of which no torque or voltage of a turning machine follows."""
        if not self.origin.turning:
            raise ConfigurationError(
                "The rotor was locked, so the magnets' flux is unknown, and with it torque, voltage and the map of the "
                "turning machine: fit a recording of the turning machine by method full."
            )

    @classmethod
    def load(cls, directory: str | Path) -> Self:
        """Load a result folder; raises a ResultError when it is none, is damaged, or was written by a newer version."""
        try:
            drive, provenance = read_results(Path(directory))
            return cls(
                drive, provenance, last_stamp=provenance.last_stamp, stored=read_judged(Path(directory), drive.flux_map)
            )
        except TypeError as error:  # of Path
            raise ConfigurationError(
                f"{directory!r:.60} is not the path of a result folder: give a str or Path."
            ) from error

    def given(self, *, pole_pairs: int | None = None, u_dc: float | None = None) -> Self:
        """Return this result with the number of pole pairs and the DC-link voltage, V, where they are given."""
        found = {"pole_pairs": pole_pairs, "u_dc": u_dc}
        known = {name: value for name, value in found.items() if value is not None}
        if bad := next((name for name, value in known.items() if not 0 < value < math.inf), None):
            raise ConfigurationError(f"{bad} is {known[bad]}: it must be positive.")
        return replace(self, provenance=replace(self.provenance, **known))  # type: ignore[arg-type]  # of the two names

    def to_xarray(self) -> xr.Dataset:
        """Return the map as a Dataset over ``i_d``, ``i_q``, A: fluxes, inductances, errors; NaN without data.

        Raises
        ------
        ConfigurationError
            When xarray is not installed.
        """
        known = self.provenance
        told = {"machine": self.name, "method": self.method, "resistance": self.resistance, "i_max": self.i_max}
        told |= {"pole_pairs": known.pole_pairs, "date": known.date}
        return map_dataset(self.drive.flux_map, {name: value for name, value in told.items() if value is not None})

    def to_pandas(self) -> pd.DataFrame:
        """Return the points of the map with data as rows: currents, A, fluxes and errors, Wb, inductances, H.

        Raises
        ------
        ConfigurationError
            When pandas and xarray, which it needs, are not installed.
        """
        pandas_library()
        return self.to_xarray().to_dataframe().dropna(subset=["psi_d", "psi_q"]).reset_index()

    def caption(self) -> Caption:
        """Return machine, method, date, R, speed and i_max."""
        return Caption(
            machine=self.name,
            origin=self.origin.caption,
            date=f"{self.date[:16].replace('T', ' ')} UTC" if self.date else "",
            resistance=self.resistance,
            sigma_resistance=self.sigma_resistance,
            i_max=self.i_max,
            speeds=self.speed_range,
            pole_pairs=self.pole_pairs,
        )

    def to_machine(self, *, pole_pairs: int | None = None, u_dc: float | None = None) -> MachineMap:
        """Return the identified machine, to be simulated: its map with harmonics, continued beyond the data.

        Parameters
        ----------
        pole_pairs : int, optional
            Default: those of the result.
        u_dc : float, optional
            V. Default: that of the result, or enough for 3000 rpm.

        Returns
        -------
        MachineMap
            Reaching 1.25 i_max on both axes. Beyond the data, its slopes tend to the typical ones within them.

        Raises
        ------
        ConfigurationError
            When the pole pairs are unknown, or the rotor was locked.
        """
        self.check_turning()
        pairs = pole_pairs or self.pole_pairs
        if pairs is None:
            raise ConfigurationError(
                "The result does not tell the number of pole pairs, which a simulation needs: give pole_pairs."
            )
        from drive_id.core.maps.continuation import LongerGrid  # noqa: PLC0415  # a fit needs no scipy

        longer = LongerGrid.around(self.flux_map.whole, _MARGIN * self.i_max).flux_map()
        psi_d, psi_q = longer.psi_d, longer.psi_q
        theta, ripple_d, ripple_q = None, None, None
        if self.harmonics:
            theta = _angles([harmonic.order for harmonic in self.harmonics])
            ripple_d, ripple_q = (np.repeat(psi[..., None], len(theta), -1) for psi in (psi_d, psi_q))
            for h in longer.harmonics:
                cosine, sine = np.cos(h.order * theta), np.sin(h.order * theta)
                ripple_d += h.psi_d_cos[..., None] * cosine + h.psi_d_sin[..., None] * sine
                ripple_q += h.psi_q_cos[..., None] * cosine + h.psi_q_sin[..., None] * sine
        enough = math.sqrt(3) * float(np.hypot(psi_d, psi_q).max()) * _ENOUGH_SPEED * math.pi / 30 * pairs
        return MachineMap(
            name=self.machine or "identified",
            i_d=longer.i_d,
            i_q=longer.i_q,
            psi_d=psi_d,
            psi_q=psi_q,
            resistance=max(self.resistance, 0.0),
            pole_pairs=pairs,
            i_max=self.i_max,
            u_dc=u_dc or self.u_dc or enough,
            theta=theta,
            psi_d_theta=ripple_d,
            psi_q_theta=ripple_q,
        )

    def __repr__(self) -> str:
        warnings = f", {len(self.warnings)} warning{'s' * (len(self.warnings) != 1)}" if self.warnings else ""
        return f"<Identification: {self.caption()}{warnings}>"

    def _repr_html_(self) -> str:
        """Return a small table, for notebooks."""
        metrics = self.metrics
        mad = " / ".join(measured(metrics[name], unit="A") for name in ("mad_d", "mad_q"))
        rows = {
            "Machine": self.name,
            "Origin": self.origin.caption,
            **{quantity.name: str(quantity) for quantity in self.headline},
            "Disc covered": f"{100 * metrics['coverage']:.0f} %",
            "NRMSE of ψ_d / ψ_q": _percent(metrics["nrmse_d"], metrics["nrmse_q"]),
            "Mean error of simulated i_d / i_q": mad if self.origin.diagnostics else "",
            "Advice": next(iter(self.advice), ""),
            **{f"Warning {number}": text for number, text in enumerate(self.warnings, start=1)},
        }
        return html_table((name, text) for name, text in rows.items() if text)


def _percent(*values: float) -> str:
    return " / ".join(f"{100 * value:.3f} %" for value in values) if all(map(math.isfinite, values)) else ""


def _angles(orders: Sequence[int]) -> FloatArray:
    """Return angles that sample one common period of rotor-position harmonics, rad."""
    periods = math.gcd(*orders)
    count = max(_LEAST_ANGLES, _ANGLES_PER_PERIOD * max(orders) // periods)
    return np.arange(count, dtype=np.float64) * (2 * np.pi / periods / count)
