"""Settings of a fit: the one source for files, command line and nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace

from drive_id.common.origins import METHODS, ORIGINS
from drive_id.common.quantity import counted
from drive_id.common.settings import Checked, setting
from drive_id.common.temperature import COLDEST, HOTTEST, REFERENCE_TEMPERATURE
from drive_id.errors import ConfigurationError

_MOST_FUNCTIONS = 1024  # of the paper's regression: memory grows with their square
MOST_ORDERS = 8  # harmonics in a fit: memory grows with their square
MOST_POLE_PAIRS = 1000
"""The largest ring generators have some hundred."""


@dataclass(frozen=True)
class FitSettings(Checked):
    """Settings of a fit."""

    method: str = setting(
        "full",
        "psm: the paper's flux and resistance; joint: the paper's with the inverter; full: windows, rotor harmonics, "
        "an inverter curve and calibration; locked: the same at one position of a locked rotor, relative to zero "
        "current; static: operating points of slow logs in d and q",
        choices=METHODS,
    )
    flux_model: str = setting(
        "spline",
        "spline: tensor-product cubic B-splines; polynomial: of total degree polynomial_degree; "
        "linear: magnet flux plus inductance matrix",
        choices=("spline", "polynomial", "linear"),
    )
    splines_d: int = setting(8, "cubic B-splines along i_d", minimum=4, maximum=64)
    splines_q: int = setting(8, "cubic B-splines along i_q", minimum=4, maximum=64)
    polynomial_degree: int = setting(5, "total degree of the polynomial flux model", minimum=1, maximum=12)
    inverter_current_scale: float = setting(1.0, "i_s in u_e tanh(i / i_s)", unit="A", minimum=1e-6, maximum=1e6)
    i_max: float | None = setting(
        None, "radius of the current disc; default: that of the recorded references, or the largest measured amplitude",
        unit="A", minimum=1e-3, maximum=1e6,
    )  # fmt: skip
    longest_rest: float = setting(
        0.02,
        "samples after a longer rest below 2 % of i_max are left out: the steep slope of the inverter's curve there "
        "turns current noise into voltage noise",
        unit="s", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    maps: str = setting(
        "auto",
        "full: reciprocal maps are gradients of a co-energy, free maps are not; auto: reciprocal unless the data "
        "contradict it",
        choices=("auto", "reciprocal", "free"),
    )
    harmonic_orders: tuple[int, ...] = setting(
        (6, 12, 18, 24), "full: candidate rotor-position harmonics, electrical orders", minimum=3, maximum=96
    )
    search_orders: bool = setting(
        True, "full: whether to search the residuals for harmonics of other orders, and to fit those found"
    )
    per_phase_inverter: bool = setting(False, "full: whether to fit one inverter curve per phase")
    monotone: bool = setting(
        False,
        "whether to make the estimated map reciprocal and monotone (convex co-energy), also beyond the data; its "
        "movement is reported",
    )
    passive_maps: bool = setting(False, "full: whether to enforce a positive definite inductance matrix")
    calibrate_delay: bool = setting(True, "full: whether to estimate the delay of the voltages after their stamps")
    calibrate_angle: bool = setting(True, "full: whether to estimate the resolver's offset from the mirror symmetry")
    calibrate_currents: bool = setting(True, "full: whether to estimate offsets and gain mismatch of the currents")
    temperatures: tuple[float, ...] = setting(
        (), "full: temperature of each recording, in order; resistance and map then hold at 20 degrees Celsius",
        unit="degC", minimum=COLDEST, maximum=HOTTEST,
    )  # fmt: skip
    u_dc: tuple[float, ...] = setting(
        (), "full: DC-link voltage of each recording, in order", unit="V", minimum=1e-3, maximum=1e6
    )
    u_dc_reference: float | None = setting(
        None, "full: DC-link voltage at which the inverter's curve holds; default: that of the first recording",
        unit="V", minimum=1e-3, maximum=1e6,
    )  # fmt: skip
    voltage_delay: float = setting(
        0.0, "full: known delay of the voltages after their stamps, used when it is not estimated",
        unit="samples", minimum=-4.0, maximum=4.0,
    )  # fmt: skip
    rows_are_points: bool = setting(
        False, "static: whether each sample of the log is an operating point already, such as a mean of a test plan"
    )
    pole_pairs: int = setting(
        0,
        "number of pole pairs, to compare a recorded shaft torque with the map (0: that of the signals file or the "
        "simulation) and to detect an eccentric rotor",
        minimum=0,
        maximum=MOST_POLE_PAIRS,
    )
    rated_current: float | None = setting(
        None,
        "full: rated current, amplitude, at which inductances and torque are reported; default, and from 95 % of "
        "i_max on: near i_max",
        unit="A", minimum=1e-3, maximum=1e6,
    )  # fmt: skip
    inertia: float | None = setting(
        None,
        "inertia of a free shaft, known by design, without added_inertia: shows the common gain error",
        unit="kg m^2", minimum=1e-9, maximum=1e6,
    )  # fmt: skip
    added_inertia: tuple[float, ...] = setting(
        (),
        "inertia added to a free shaft in each recording, in order, 0 for none: two different ones show the common "
        "gain error",
        unit="kg m^2", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    grid_points: int = setting(65, "points of the map along each axis", minimum=9, maximum=1025)
    machine: str = setting("", "name of the machine, for titles and captions; default: that of a simulation")
    serial: str = setting("", "serial number of the machine")
    bench: str = setting("", "test bench of the recording")
    operator: str = setting("", "who recorded")
    notes: str = setting("", "anything else worth knowing with the result")

    def idle(self) -> list[str]:
        """Return the settings that differ from their defaults but do not affect the method."""
        defaults = type(self)()
        return [name for name in ORIGINS[self.method].ignores if getattr(self, name) != getattr(defaults, name)]

    def check_recordings(self, count: int) -> None:
        """Raise ConfigurationError unless temperatures and DC-link voltages match the number of recordings."""
        for name in ("temperatures", "u_dc", "added_inertia"):
            given = len(getattr(self, name))
            if given not in {0, count}:
                raise ConfigurationError(
                    f"{name} has {counted(given, 'entry', 'entries')} for "
                    f"{counted(count, 'recording')}: give one for each, in order."
                )

    def conditions(self, number: int) -> tuple[float, float]:
        """Return by how much the winding of a recording is above the reference, K, and its DC link over the reference.

        Raises ConfigurationError when temperatures or DC-link voltages are set, but none for this recording.
        """
        one = self.of_recording(number)
        heating = one.temperatures[0] - REFERENCE_TEMPERATURE if one.temperatures else 0.0
        return heating, one.u_dc[0] / one.u_dc_reference if one.u_dc and one.u_dc_reference else 1.0

    def of_recording(self, number: int) -> FitSettings:
        """Return the settings for one recording that will be merged with others.

        Raises ConfigurationError when conditions are given, but none for this recording.
        """
        for name in ("temperatures", "u_dc"):
            if getattr(self, name) and number >= len(getattr(self, name)):
                raise ConfigurationError(
                    f"{name} has {counted(len(getattr(self, name)), 'entry', 'entries')} and there "
                    f"are more recordings: give one for each, "
                    "in order."
                )
        one = slice(number, number + 1)
        reference = self.u_dc_reference or (self.u_dc[0] if self.u_dc else None)
        return replace(self, temperatures=self.temperatures[one], u_dc=self.u_dc[one], u_dc_reference=reference)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.temperatures and self.u_dc and len(self.temperatures) != len(self.u_dc):
            raise ConfigurationError(
                f"There are {counted(len(self.temperatures), 'temperature')} and {len(self.u_dc)} "
                f"DC-link voltages: give both for "
                "each recording, and set them at once."
            )
        if len(set(self.harmonic_orders)) != len(self.harmonic_orders) or len(self.harmonic_orders) > MOST_ORDERS:
            raise ConfigurationError(
                f"harmonic_orders is {self.harmonic_orders}: give at most {MOST_ORDERS} orders, each once."
            )
        if self.splines_d * self.splines_q > _MOST_FUNCTIONS:
            raise ConfigurationError(
                f"splines_d x splines_q is {self.splines_d} x {self.splines_q}: choose at most {_MOST_FUNCTIONS} "
                "functions, more do not fit into memory."
            )
