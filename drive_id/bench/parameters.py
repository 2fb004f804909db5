"""Constants, state and signals of the simulated drive, as the compiled kernels take them."""

from __future__ import annotations

from typing import NamedTuple

from drive_id.types import FloatArray

HISTORY = 6  # commands kept: the coming one, the one held now, and older ones for the fault of a late voltage log


class SplineTable(NamedTuple):
    """Uniform cubic B-spline coefficients of f(i_d, i_q, theta), see :mod:`drive_id.bench.splines`."""

    coefficients: FloatArray  # (D + 2, Q + 2, 2, H + 3), or (D + 2, Q + 2, 2, 1) without rotor position; Wb
    d_start: float  # first node, A
    d_rate: float  # nodes per ampere
    q_start: float
    q_rate: float
    theta_start: float  # rad
    theta_rate: float  # nodes per radian


class PhaseDrop(NamedTuple):
    """Parameters of the one law of voltage drop, see :func:`phase_drop`."""

    dead_time_voltage: float  # V
    charge_current: float  # A
    threshold_voltage: float  # V
    threshold_current: float  # A
    resistance: float  # ohm


class Plant(NamedTuple):
    """Constants of machine, inverter and shaft."""

    table: SplineTable
    resistance: float  # ohm
    drop: PhaseDrop
    ripple: float  # amplitude of the speed ripple as a fraction of the mean speed
    ripple_order: float  # periods of the ripple per electrical revolution
    period: float  # sample period, s
    current_tolerance: float  # Newton step after which the current counts as found, A
    flux_tolerance: float  # what the bend of the drop may cost in one step, Wb


class Controller(NamedTuple):
    """Constants of the current controller."""

    table: SplineTable  # the rough map that the drive is tuned with
    resistance: float  # ohm
    bandwidth: float  # rad/s
    integral_rate: float  # 1/s
    u_max: float  # largest amplitude of the voltage vector, V
    compensate: bool  # add the phase drop to the command


class Sensors(NamedTuple):
    """Faults of what is measured and logged."""

    current_gain: FloatArray  # (3,)
    current_offset: FloatArray  # (3,) A
    current_quantum: float  # A, 0 for none
    two: bool  # the third current follows from the other two
    angle_offset: float  # rad
    log_lead: int  # the log at k shows the command of k + log_lead
    held_fraction: float  # of a period, during which the previous command is still held


class DriveState(NamedTuple):
    """What is carried from sample to sample; the kernels write into these arrays."""

    flux: FloatArray  # (2,) in the stator frame, Wb
    current: FloatArray  # (2,) in the rotor frame, A
    mean_angle: FloatArray  # (1,) electrical angle without ripple, wrapped to a mechanical revolution, rad
    integral: FloatArray  # (2,) of the controller, V
    flux_reference: FloatArray  # (3, 2) newest first, Wb
    commands: FloatArray  # (HISTORY, 3) newest first: coming, held, former ..., V
    compensations: FloatArray  # (HISTORY, 3) V


class Signals(NamedTuple):
    """Arrays for the signals of one block of samples."""

    i_abc: FloatArray  # (N, 3) measured, A
    u_abc: FloatArray  # (N, 3) logged, V
    angle: FloatArray  # (N,) measured, rad
    speed: FloatArray  # (N,) measured, rad/s
    i_dq_true: FloatArray  # (N, 2) A
    angle_true: FloatArray  # (N,) rad


class Noise(NamedTuple):
    """Additive noise of one block of samples."""

    current: FloatArray  # (N, 3) A
    angle: FloatArray  # (N,) rad
    speed: FloatArray  # (N,) rad/s
