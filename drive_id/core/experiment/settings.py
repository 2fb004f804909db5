"""Settings of an experiment: trajectory, publication of the references, and limits of the drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drive_id.common.settings import Checked, setting
from drive_id.core.experiment.free_shaft import (
    FASTEST_SWING,
    TRIP_FACTOR,
    FreeShaft,
    RotatingVector,
    SpeedFeedback,
    swing_frequency,
)
from drive_id.core.experiment.trajectories import Lissajous, Spiral, Stair, Trajectory
from drive_id.errors import ConfigurationError

FREE_SHAFT = "free_shaft"
FIRST_START = "first_start"
TRAJECTORIES = ("lissajous", "stair", "spiral", FREE_SHAFT, FIRST_START)
_MOST_AHEAD = 100_000  # set-points published ahead
_LONGEST_RAMP = 10.0  # from i_max to zero, s


@dataclass(frozen=True)
class ExperimentSettings(Checked):
    """Settings of the trajectory publisher."""

    trajectory: str = setting(
        "lissajous",
        "Trajectory in the current disc: the paper's Lissajous figure, a stair of operating points, or a spiral; "
        "without load machine: free_shaft; to find the angle of a new drive: first_start", choices=TRAJECTORIES,
    )  # fmt: skip
    i_max: float = setting(
        100.0, "Radius of the current disc, which no reference ever leaves", unit="A", minimum=1e-3, maximum=1e6
    )
    frequency_d: float = setting(
        3.7, "Lissajous: frequency of the d reference, Phi_d / 2 pi", unit="Hz", minimum=0.0, maximum=1e4
    )
    frequency_q: float = setting(
        1.1, "Lissajous: frequency of the q reference, Phi_q / 2 pi", unit="Hz", minimum=0.0, maximum=1e4
    )
    form: str = setting(
        "smooth", "Lissajous: root without kinks, or as the paper prints it", choices=("smooth", "printed")
    )
    duration: float = setting(
        10.0, "Lissajous and free_shaft: of the whole figure; spiral: out and back", unit="s", minimum=1e-2, maximum=1e5
    )
    stair_points: int = setting(9, "Stair: grid points per axis", minimum=3, maximum=101)
    dwell_time: float = setting(0.2, "Stair: time at each operating point", unit="s", minimum=1e-3, maximum=1e4)
    spiral_turns: float = setting(10.0, "Spiral: turns from the centre to the rim", minimum=0.5, maximum=1000.0)
    shaft_acceleration: float | None = setting(
        None, "free_shaft: electrical acceleration by the largest torque, T_max pole_pairs / J; without it, only with "
        "swing_frequency, and nothing holds the mean speed", unit="rad/s^2", minimum=1e-3, maximum=1e9,
    )  # fmt: skip
    shaft_speed_max: float | None = setting(
        None, "free_shaft: highest electrical speed planned; it trips at 1.2 times this",
        unit="rad/s", minimum=1e-3, maximum=1e6,
    )  # fmt: skip
    mean_speed: float = setting(
        0.0, "free_shaft: mean electrical speed, for heavy rotors about half of shaft_speed_max",
        unit="rad/s", minimum=-1e6, maximum=1e6,
    )  # fmt: skip
    swing_frequency: float | None = setting(
        None, "free_shaft: frequency of i_q; default: so that the swing takes 85 % of the speeds, from 5 to 60 Hz",
        unit="Hz", minimum=0.5, maximum=200.0,
    )  # fmt: skip
    amplitude: float = setting(0.95, "free_shaft: amplitude relative to i_max", minimum=1e-3, maximum=1.0)
    first_start_current: float = setting(0.15, "first_start: amplitude relative to i_max", minimum=1e-3, maximum=1.0)
    angle_offset: float = setting(
        0.0, "What the drive's electrical angle is ahead of the magnet axis, as a first start finds it: references are "
        "turned back by it", unit="rad", minimum=-math.pi, maximum=math.pi,
    )  # fmt: skip
    repeat: int = setting(1, "Repetitions of the trajectory; 0: until it is stopped", minimum=0, maximum=1_000_000)
    slew_rate: float = setting(
        10000.0, "Largest |di/dt| of the references, also when ramping in and out", unit="A/s", minimum=1.0, maximum=1e9
    )
    sample_period: float = setting(
        1e-4, "Time between two set-points: the control period of the drive", unit="s", minimum=1e-6, maximum=1e-1
    )
    publish_rate: float = setting(50.0, "Rate at which blocks are published", unit="Hz", minimum=1.0, maximum=1000.0)
    lead_time: float = setting(
        0.3, "How far ahead set-points are published: as long, the drive goes on if this node dies",
        unit="s", minimum=5e-3, maximum=10.0,
    )  # fmt: skip
    frame_id: str = setting("drive", "Name of the drive in the message headers")
    dry_run: bool = setting(False, "Compute and supervise an experiment, but publish no references")
    watch: bool = setting(
        True, "Run only while the drive reports, follows and is in order; false: without feedback, at your own risk"
    )
    require_status: bool = setting(True, "Run only with a drive that publishes drive_status")
    watch_timeout: float = setting(
        0.5,
        "Longest time without a message of resolver, phase_currents or drive_status, or with a clock that stands still",
        unit="s", minimum=1e-2, maximum=60.0,
    )  # fmt: skip
    clock_offset: float | None = setting(
        None, "Largest distance of the drive's stamps from the clock of this node; default: half of lead_time",
        unit="s", minimum=1e-3, maximum=60.0,
    )  # fmt: skip
    follow_band: float | None = setting(
        None, "Largest distance of measured currents from the references; default: 0.2 i_max, free_shaft 0.35 i_max",
        unit="A", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    follow_time: float = setting(
        0.1, "Time constant by which this distance is averaged", unit="s", minimum=1e-3, maximum=10.0
    )
    speed_min: float | None = setting(
        None, "Lowest electrical speed allowed; default: -speed_max", unit="rad/s", minimum=-1e6, maximum=1e6
    )
    speed_max: float | None = setting(
        None, "Highest electrical speed allowed; default: the limit in drive_status, or no start",
        unit="rad/s", minimum=-1e6, maximum=1e6,
    )  # fmt: skip
    current_limit: float | None = setting(
        None,
        "Largest measured phase current allowed, besides 1.1 times the limit in drive_status; default: 1.25 i_max, "
        "free_shaft 1.2 i_max", unit="A", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    current_ceiling: float | None = setting(
        None, "What neither i_max nor current_limit may exceed; fixed at start: what machine and inverter stand",
        unit="A", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    temperature_max: float | None = setting(
        None, "Highest winding or magnet temperature allowed; default: the limit in drive_status",
        unit="degC", minimum=-60.0, maximum=1000.0,
    )  # fmt: skip
    dc_link_voltage_min: float | None = setting(
        None, "Lowest DC-link voltage allowed; default: any", unit="V", minimum=0.0, maximum=1e6
    )
    dc_link_voltage_max: float | None = setting(
        None, "Highest DC-link voltage allowed; default: the limit in drive_status", unit="V", minimum=0.0, maximum=1e6
    )
    emergency_stops: tuple[str, ...] = setting(
        ("emergency_stop",), "Topics of the emergency stops, one for each button: any of them trips"
    )
    emergency_stop_timeout: float | None = setting(
        None, "Longest time without a message on any of emergency_stops; default: they may be silent",
        unit="s", minimum=1e-2, maximum=60.0,
    )  # fmt: skip
    require_lease: bool = setting(False, "Start only for a client that sends heartbeats")
    lease_time: float = setting(
        2.0, "Longest time without a heartbeat, if the client that started has sent any",
        unit="s", minimum=0.1, maximum=60.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.speed_min is not None and self.speed_max is not None and self.speed_min >= self.speed_max:
            raise ConfigurationError(
                f"speed_min is {self.speed_min:g} rad/s and speed_max {self.speed_max:g} rad/s: the band must not be "
                "empty."
            )
        for name in ("i_max", "current_limit"):
            value = getattr(self, name)
            if None not in (value, self.current_ceiling) and value > self.current_ceiling:
                raise ConfigurationError(
                    f"{name} is {value:g} A, above current_ceiling, {self.current_ceiling:g} A, which is fixed when "
                    "the node starts."
                )
        if self.current_limit is not None and self.current_limit < self.i_max:
            raise ConfigurationError(
                f"current_limit is {self.current_limit:g} A, below i_max, {self.i_max:g} A: the trajectory itself "
                "would stop the experiment."
            )
        if self.lead_time < 2 / self.publish_rate:
            raise ConfigurationError(
                f"lead_time is {self.lead_time:g} s at {self.publish_rate:g} blocks per second: it must be at least "
                "two intervals, or set-points come too late."
            )
        if self.lead_time < 10 * self.sample_period:
            raise ConfigurationError(
                f"lead_time is {self.lead_time:g} s: it must be at least ten sample periods of "
                f"{self.sample_period:g} s."
            )
        if self.lead_time > _MOST_AHEAD * self.sample_period:
            raise ConfigurationError(
                f"lead_time is {self.lead_time:g} s: it must be at most {_MOST_AHEAD} sample periods of "
                f"{self.sample_period:g} s."
            )
        if self.i_max > _LONGEST_RAMP * self.slew_rate:
            raise ConfigurationError(
                f"slew_rate is {self.slew_rate:g} A/s: it must bring i_max, {self.i_max:g} A, to zero within "
                f"{_LONGEST_RAMP:g} s."
            )
        self._check_shaft()
        steepest = make_trajectory(self).slope
        if steepest > self.slew_rate * (1 + 1e-9):
            raise ConfigurationError(
                f"The {self.trajectory} trajectory needs up to {steepest:.4g} A/s where slew_rate allows "
                f"{self.slew_rate:.4g} A/s: make it slower or smaller, or raise slew_rate."
            )

    def _check_shaft(self) -> None:
        if self.trajectory in {FREE_SHAFT, FIRST_START} and self.repeat == 0:
            raise ConfigurationError(f"repeat is 0: {self.trajectory} must have an end, so set 1 or more.")
        if self.trajectory != FREE_SHAFT:
            return
        if self.shaft_speed_max is None:
            raise ConfigurationError(
                "shaft_speed_max is not set: free_shaft needs the highest speed to plan for, rad/s."
            )
        if self.shaft_acceleration is None and self.swing_frequency is None:
            raise ConfigurationError(
                "Neither shaft_acceleration nor swing_frequency is set: a first start measures the former "
                "(characterize --first-start)."
            )
        if self.shaft_acceleration is None and self.mean_speed != 0.0:
            raise ConfigurationError("mean_speed is set without shaft_acceleration: nothing could hold it.")
        if abs(self.mean_speed) >= self.shaft_speed_max:
            raise ConfigurationError(
                f"mean_speed is {self.mean_speed:g} rad/s: it must be below shaft_speed_max, "
                f"{self.shaft_speed_max:g} rad/s."
            )

    @property
    def covers_disc(self) -> bool:
        """Whether the trajectory is to visit the whole disc: a first start turns a vector, or shakes a free shaft."""
        shakes = self.trajectory == FREE_SHAFT and self.shaft_acceleration is None
        return self.trajectory != FIRST_START and not shakes

    @property
    def stator_frame(self) -> bool:
        """Whether the references are alpha and beta, not d and q."""
        return self.trajectory == FIRST_START

    @property
    def planned_speed(self) -> float:
        """Speed at which a free shaft trips, rad/s; infinite for other trajectories."""
        shaft = self.trajectory == FREE_SHAFT and self.shaft_speed_max is not None
        return TRIP_FACTOR * self.shaft_speed_max if shaft and self.shaft_speed_max else math.inf

    @property
    def largest_phase_current(self) -> float:
        """Limit of the measured phase currents, A."""
        factor = TRIP_FACTOR if self.trajectory == FREE_SHAFT else 1.25
        wanted = factor * self.i_max if self.current_limit is None else self.current_limit
        return wanted if self.current_ceiling is None else min(wanted, self.current_ceiling)

    @property
    def largest_clock_offset(self) -> float:
        """Limit of the distance between stamps and clock, s."""
        return 0.5 * self.lead_time if self.clock_offset is None else self.clock_offset

    @property
    def largest_distance(self) -> float:
        """Limit of the distance between measured currents and references, A."""
        factor = 0.35 if self.trajectory == FREE_SHAFT else 0.2  # a quarter of the bandwidth lags by a quarter
        return factor * self.i_max if self.follow_band is None else self.follow_band


def make_trajectory(settings: ExperimentSettings) -> Trajectory:
    """Return the trajectory of these settings."""
    if settings.trajectory == "stair":
        return Stair(settings.i_max, settings.stair_points, settings.dwell_time, settings.slew_rate)
    if settings.trajectory == "spiral":
        return Spiral(settings.i_max, settings.spiral_turns, settings.duration)
    if settings.trajectory == FREE_SHAFT:
        return _swing(settings)
    if settings.trajectory == FIRST_START:
        return RotatingVector(settings.first_start_current * settings.i_max)
    return Lissajous(settings.i_max, settings.frequency_d, settings.frequency_q, settings.form)


def _swing(settings: ExperimentSettings) -> FreeShaft:
    """Return the swing that fits the speeds; where that is faster than 60 Hz, with less current."""
    amplitude, frequency = settings.amplitude, settings.swing_frequency
    if frequency is None:
        assert settings.shaft_acceleration is not None
        assert settings.shaft_speed_max is not None
        wanted = swing_frequency(amplitude * settings.shaft_acceleration, settings.shaft_speed_max, settings.mean_speed)
        frequency = min(wanted, FASTEST_SWING)
        amplitude *= min(1.0, frequency / wanted)
    return FreeShaft(amplitude * settings.i_max, frequency, settings.duration)


def speed_feedback(settings: ExperimentSettings, trajectory: Trajectory) -> SpeedFeedback | None:
    """Return what holds the mean speed of a free shaft; None for other trajectories."""
    if not isinstance(trajectory, FreeShaft):
        return None
    share, acceleration = trajectory.i_max / settings.i_max, settings.shaft_acceleration
    own = None if acceleration is None else share * acceleration
    return SpeedFeedback(trajectory.frequency, own, settings.mean_speed, settings.lead_time)


def total_duration(settings: ExperimentSettings, trajectory: Trajectory) -> float:
    """Return the duration of a trajectory with its repetitions, without the ramps, s; infinite if it has no end."""
    if settings.repeat == 0:
        return math.inf
    return settings.repeat * (trajectory.duration if math.isfinite(trajectory.duration) else settings.duration)
