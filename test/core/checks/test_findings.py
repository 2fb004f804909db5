"""Every mistake in a recording is told by its code, with numbers and a remedy; good drives are told nothing."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from random_drives import OTHERS, random_recording
from synthetic import cut, every, only, single_vectors

from drive_id.bench.machines import MACHINES
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks import readings, waveforms
from drive_id.core.checks.balance import Excerpt
from drive_id.core.checks.prescan import Prescan
from drive_id.core.checks.repeats import repeat_findings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import gather, identify
from drive_id.errors import DataError
from drive_id.fitting.simulated import run_experiment
from drive_id.types import Samples

GOOD_DRIVES = int(os.environ.get("DRIVE_ID_GOOD_DRIVES", "15"))
"""With 200, the test below takes some minutes."""


def found(*recordings: Samples):
    prescan = Prescan()
    for samples in recordings:
        prescan.add(samples)
    return prescan.findings()


def recorded(machine: str, speed: float, seconds: float = 2.0, **options) -> Samples:
    machine_map = (MACHINES | OTHERS)[machine].to_map()
    settings = SimulationSettings(speeds=(speed,), current_noise=1e-3, **options)
    return replace(run_experiment(machine_map, settings, seconds=seconds).samples, i_dq_reference=None)


DRIVES = {
    "ipm": ("ipm", 500.0, 4),
    "spm": ("spm", -1500.0, 3),
    "pmsyrm": ("pmsyrm", 300.0, 2),
    "synrm": ("synrm", 900.0, 2),
    "slotless": ("slotless", 400.0, 1),
    "fast": ("fast", 2500.0, 5),
}


PAIRS = (("ipm", "synrm"), ("slotless", "pmsyrm"), ("spm", "fast"))


@pytest.fixture(scope="module")
def drives():
    return {name: recorded(machine, speed) for name, (machine, speed, _) in DRIVES.items()}


@pytest.fixture(scope="module")
def ipm(drives):
    return drives["ipm"]


def turned(samples, factor):
    """The angle and speed multiplied by a factor, the angle wrapped as a resolver gives it."""
    angle = factor * np.unwrap(samples.angle)
    return replace(samples, angle=np.angle(np.exp(1j * angle)), speed=factor * samples.speed)


def signed(x_abc, phase):
    return x_abc * np.where(np.arange(3) == phase, -1.0, 1.0)


def pair(x_abc):
    """Return alpha, beta and what a reader adds as phase c."""
    a, b, c = x_abc.T
    alpha, beta = (2 * a - b - c) / 3, (b - c) / np.sqrt(3)
    return np.column_stack([alpha, beta, -alpha - beta])


def told(samples):
    (finding,) = found(samples)
    assert finding.count(". ") <= 2
    assert finding.endswith(".")
    assert finding[0].isupper()
    return finding


# -- what the voltages say of angle and phases ---------------------------------------------------------------------


READINGS = {
    "clockwise": (lambda s: turned(s, -1), "direction", "against the order of the phases"),
    "half the pole pairs": (lambda s: turned(s, 0.5), "pole_pairs", "with 2 pole pairs"),
    "8 for 4 pole pairs": (lambda s: turned(s, 2), "pole_pairs", "(from 8 to 4, for example)"),
    "3 for 4 pole pairs": (lambda s: turned(s, 0.75), "pole_pairs", "by 4/3"),
    "a third, clockwise": (lambda s: turned(s, -1 / 3), "pole_pairs", "with 3 pole pairs"),
    "currents a, b": (lambda s: replace(s, i_abc=s.i_abc[:, [1, 0, 2]]), "phases_swapped", "a and b of the currents"),
    "voltages b, c": (lambda s: replace(s, u_abc=s.u_abc[:, [0, 2, 1]]), "phases_swapped", "b and c of the voltages"),
    "voltages a, c": (lambda s: replace(s, u_abc=s.u_abc[:, [2, 1, 0]]), "phases_swapped", "a and c of the voltages"),
    "both a, b": (
        lambda s: replace(s, i_abc=s.i_abc[:, [1, 0, 2]], u_abc=s.u_abc[:, [1, 0, 2]]),
        "direction",
        "two phases swapped in currents and voltages alike",
    ),
    "currents shifted": (lambda s: replace(s, i_abc=s.i_abc[:, [1, 2, 0]]), "phases_shifted", "in the order b, c, a"),
    "voltages shifted": (lambda s: replace(s, u_abc=s.u_abc[:, [1, 2, 0]]), "phases_shifted", "in the order c, a, b"),
    "currents negative": (lambda s: replace(s, i_abc=-s.i_abc), "current_sign", "wrong sign"),
    "voltages negative": (lambda s: replace(s, u_abc=-s.u_abc), "current_sign", "wrong sign"),
    "voltage c negative": (lambda s: replace(s, u_abc=signed(s.u_abc, 2)), "phase_reversed", "voltage of phase c"),
    "current b negative": (lambda s: replace(s, i_abc=signed(s.i_abc, 1)), "phase_reversed", "current of phase b"),
    "currents for voltages": (
        lambda s: replace(s, i_abc=s.u_abc, u_abc=s.i_abc), "exchanged", "exchange their topics or fields"
    ),
    "alpha and beta for a and b": (
        lambda s: replace(s, u_abc=pair(s.u_abc)), "alpha_beta", "The voltages seem to be alpha and beta components"
    ),
    "currents alpha and beta": (
        lambda s: replace(s, i_abc=pair(s.i_abc)), "alpha_beta", "The currents seem to be alpha and beta components"
    ),
    "all alpha and beta": (
        lambda s: replace(s, i_abc=pair(s.i_abc), u_abc=pair(s.u_abc)), "alpha_beta", "The currents and voltages seem"
    ),
}  # fmt: skip


@pytest.mark.cases
@pytest.mark.parametrize(
    ("case", "drive"),
    [
        pytest.param(case, drive, marks=[pytest.mark.slow] if drive == PAIRS[k % 3][1] else [])  # of two drives, one
        for k, case in enumerate(READINGS)
        for drive in PAIRS[k % 3]
    ],
)
def test_signals_of_another_meaning(drives, case, drive):
    change, code, said = READINGS[case]
    prescan = Prescan()
    prescan.add(change(drives[drive]))
    first = prescan.findings()[0]
    assert (first.code, first.kind) == (code, "error")
    assert said in first
    with pytest.raises(DataError) as error:
        prescan.check("joint")  # as each fit does
    assert str(error.value) == first


def test_a_third_phase_from_the_others_hides_no_reversed_one(ipm):
    a, b, _ = signed(ipm.i_abc, 1).T
    finding = told(replace(ipm, i_abc=np.column_stack([a, b, -a - b])))
    assert finding.kind == "error"


def test_voltages_in_the_proposed_order_are_right(ipm):
    """The sentence is obeyed."""
    shifted = replace(ipm, u_abc=ipm.u_abc[:, [1, 2, 0]])
    assert "in the order c, a, b" in told(shifted)
    assert found(replace(shifted, u_abc=shifted.u_abc[:, [2, 0, 1]])) == ()


@pytest.mark.cases
@pytest.mark.parametrize("drive", ["ipm", "spm", "slotless"])
@pytest.mark.parametrize("shift", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_voltages_between_phases_in_all_orders(drives, drive, shift, sign):
    samples = drives[drive]
    between = np.roll(samples.u_abc - np.roll(samples.u_abc, -sign, axis=1), shift, axis=1)
    first = found(replace(samples, u_abc=between))[0]
    assert (first.code, first.kind) == ("line_voltages", "error")
    back = np.roll(between, -shift, axis=1)
    assert found(replace(samples, u_abc=(back - np.roll(back, sign, axis=1)) / 3)) == ()


@pytest.mark.parametrize("drive", ["ipm", "spm", "pmsyrm", "slotless", "fast"])
@pytest.mark.parametrize("degrees", [-150.0, -90.0, 35.0, 90.0, 180.0])
def test_an_offset_of_the_angle_is_proposed(drives, drive, degrees):
    samples = drives[drive]
    finding = told(replace(samples, angle=samples.angle + np.deg2rad(degrees)))
    assert (finding.code, finding.kind) == ("angle_offset", "warning")
    left = np.deg2rad(degrees) + finding.values["angle_offset"]
    assert abs(np.angle(np.exp(1j * left))) < np.deg2rad(5)


def test_an_offset_without_a_magnet_is_told_but_for_quarters(drives):
    samples = drives["synrm"]
    for degrees, left in ((30.0, 0.0), (120.0, 90.0)):
        finding = told(replace(samples, angle=samples.angle + np.deg2rad(degrees)))
        assert "a multiple of 90" in finding
        offset = np.rad2deg(finding.values["angle_offset"]) + degrees
        assert (offset - left + 45) % 90 - 45 == pytest.approx(0, abs=4)
    assert found(replace(samples, angle=samples.angle + np.pi / 2)) == ()


def test_an_offset_is_no_matter_of_the_currents_driven(ipm):
    """Motoring only: saturation alone must not look like an offset."""
    assert found(only(ipm, frames.to_dq(ipm.i_abc, ipm.angle)[:, 1] > 0)) == ()


@pytest.mark.parametrize(("drive", "late"), [("ipm", -25), ("ipm", 30), ("spm", -17), ("spm", 12)])
def test_voltages_of_another_time(drives, drive, late):
    samples = drives[drive]
    n = len(samples) - abs(late)
    kept = samples.part(0, n) if late > 0 else samples.part(-late, len(samples))
    finding = found(replace(kept, u_abc=samples.u_abc[late:] if late > 0 else samples.u_abc[:n]))[0]
    assert finding.code == "time_shift"
    assert finding.values["delay"] == pytest.approx(late, abs=1)


@pytest.mark.parametrize(("share", "late"), [(0.0052, False), (0.052, True)])
def test_what_a_rough_model_leaves_itself_is_no_shift(ipm, monkeypatch, share, late):
    """At 50 kHz, a shift of five samples halved the 0.5 % that are left, and was told."""
    run = Excerpt.of(ipm.part(0, 4000), 300.0)
    declared = replace(readings.rough_fit([run]), without_delay=share)
    shifted = replace(declared, unexplained=0.5 * share, delay=5.0)
    monkeypatch.setattr(readings, "rough_fit", lambda *_, **__: shifted)
    finding = readings._time_shift([run], declared)
    assert (finding is not None) == late


@pytest.mark.parametrize(("doubled", "codes"), [(0, []), (40, ["repeated_rows"])])
def test_a_rest_that_a_coarse_converter_reads_as_a_few_steps_is_no_repetition(doubled, codes):
    k, rng = np.arange(8000), np.random.default_rng(0)
    angle = 0.05 * k
    i_s = np.where(k % 2000 < 400, 0.0, 80.0) * np.exp(1j * (angle + 1))
    step = 200 / 2**10
    i_abc = step * np.rint((frames.phases(i_s) + rng.normal(0, 0.2 * step, (len(k), 3))) / step + 1.2)
    for row in 500 + 35 * np.arange(doubled):
        i_abc[row] = i_abc[row - 1]
    run = Samples(
        k * 100_000, i_abc, frames.phases(0.1 * i_s + 60j * np.exp(1j * angle)), angle, 500.0 + 0 * angle, 1e-4
    )
    assert [finding.code for finding in repeat_findings([run], 80.0)] == codes


@pytest.mark.parametrize(("induced", "codes"), [(0.12, []), (0.0, ["inverter_tripped"])])
def test_a_new_speed_without_current_is_no_trip(induced, codes):
    """Between two speeds, the voltage of the magnet changes with the speed, and its sign with it."""
    n, period = 4000, 1e-4
    speed = np.concatenate([np.full(n, 600.0), np.linspace(600.0, -500.0, n)])
    angle = np.cumsum(speed) * period
    i_s, flux = np.zeros(2 * n, complex), np.full(2 * n, 0.12 + 0.0j)
    i_s[:n] = 80 * np.exp(2j * np.pi * 7 * period * np.arange(n))
    flux[n:] = induced
    noise = np.random.default_rng(2).normal(0.0, 0.1, (2 * n, 3))
    i_abc, u_abc = (frames.phases(x * np.exp(1j * angle)) for x in (i_s, 1j * speed * flux + 0.02 * i_s))
    if not codes:
        u_abc += 0.01 * noise
    else:
        u_abc[n:] = u_abc[n - 1]  # held
    run = Samples(np.arange(2 * n) * 100_000, i_abc + noise, u_abc, angle, speed, period)
    assert [finding.code for finding in repeat_findings([run], 80.0)] == codes


@pytest.mark.parametrize("turned", [0.0, 0.7, np.pi / 2])
def test_currents_on_a_line_tell_no_time(turned):
    """A saturation along it was taken for a shift of 58 samples; a change of speed would fix the time."""
    n, period, speed, resistance = 2000, 1e-4, 200.0, 0.01
    t = period * np.arange(n + 1)
    along = 10 * np.sin(2 * np.pi * 1.25 * t)
    direction, turn = np.exp(1j * turned), np.exp(1j * speed * t)
    i_s = along * direction * turn
    psi_s = (0.05 + 0.01 * np.arctan(along / 8) * direction) * turn
    u_s = np.diff(psi_s) / period + resistance * (i_s[1:] + i_s[:-1]) / 2
    stamp, angle = np.arange(n) * 100_000, speed * t[:n]
    line = Samples(stamp, frames.phases(i_s[:n]), frames.phases(u_s), angle, np.full(n, speed), period)
    assert "time_shift" not in [finding.code for finding in found(line)]


def test_voltages_of_another_drive(ipm):
    other = recorded("ipm", 730.0)
    finding = told(replace(ipm, u_abc=other.u_abc))
    assert (finding.code, finding.kind) == ("unexplained", "error")


@pytest.mark.parametrize(("drive", "n"), [("spm", 5), ("spm", 10), ("ipm", 10)])
def test_a_decimated_log(drives, drive, n):
    codes = {finding.code: finding for finding in found(every(drives[drive], n))}
    assert "set decimation: n for the voltages" in codes["decimated"]
    assert codes["decimated"].values["rate"] == pytest.approx(1e4 / n)


# -- angle, speed and time ---------------------------------------------------------------------------------------------


def test_units_of_the_angle(ipm):
    turns = np.unwrap(ipm.angle) / (2 * np.pi)
    for unit, said in ((360.0, "in degrees"), (1.0, "in revolutions"), (4096.0, "in counts"), (400.0, "in gon")):
        for angle in (unit * (turns % 1), unit * ((turns + 0.5) % 1 - 0.5)):
            finding = told(replace(ipm, angle=angle))
            assert (finding.code, finding.kind) == ("angle_unit", "error")
            assert said in finding
            assert finding.values["factor"] == pytest.approx(2 * np.pi / unit)


def test_degrees_that_never_wrap(drives):
    for samples in drives.values():
        degrees = np.rad2deg(np.unwrap(samples.angle))
        finding = told(replace(samples, angle=degrees))
        assert finding.code == "angle_unit"
        assert finding.values["factor"] == pytest.approx(np.pi / 180)
    samples = drives["ipm"]
    both = replace(samples, angle=np.rad2deg(np.unwrap(samples.angle)), speed=np.rad2deg(samples.speed))
    assert "speed_unit: deg/s" in told(both)


@pytest.mark.parametrize("pole_pairs", [1, 3, 7])
def test_a_mechanical_angle_over_several_electrical_turns_is_in_radians(ipm, pole_pairs):
    assert found(replace(ipm, angle=np.unwrap(ipm.angle) % (2 * np.pi * pole_pairs))) == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: replace(s, speed=-s.speed), "as if one of them counted the other way"),
        (lambda s: replace(s, speed=s.speed / 4), "the speed were mechanical and the machine had 4 pole pairs"),
        (lambda s: replace(s, speed=s.speed * 4), "the angle were mechanical and the machine had 4 pole pairs"),
        (lambda s: replace(s, speed=s.speed / 4 * 30 / np.pi), "in rpm and the machine had 4 pole pairs"),
        (lambda s: replace(s, speed=s.speed / 4 / (2 * np.pi)), "in revolutions per second and the machine had 4 pole"),
        (lambda s: replace(s, speed=np.rad2deg(s.speed)), "the speed were in degrees per second"),
        (lambda s: replace(s, speed=s.speed * 1e-3), "the unit of the time were wrong"),
        (lambda s: replace(s, speed=s.speed * 0.77), "logged speed. Give both"),
    ],
)
def test_what_a_ratio_of_the_speeds_means(ipm, change, said):
    finding = told(change(ipm))
    assert (finding.code, finding.kind) == ("angle_speed", "error")
    assert said in finding


@pytest.mark.parametrize("factor", [1000, 1e-3])
def test_stamps_in_a_wrong_unit(ipm, factor):
    stamp = (np.arange(len(ipm)) * 100_000 * factor).astype(np.int64)
    finding = told(replace(ipm, stamp=stamp, sample_period=1e-4 * factor, speed=ipm.speed / factor))
    assert (finding.code, finding.kind) == ("sample_period", "error")


def test_an_angle_that_is_logged_too_rarely(drives):
    samples = drives["fast"]
    held = samples.angle[np.arange(len(samples)) // 2 * 2]
    assert "held_angle" in {finding.code for finding in found(replace(samples, angle=held))}


def test_a_rotor_that_turns_far_from_sample_to_sample():
    samples = recorded("fast", 3000.0, sample_period=5e-4)
    assert "coarse_sampling" in {finding.code for finding in found(samples)}


@pytest.mark.accuracy
def test_a_speed_that_drifts():
    drifting = recorded("ipm", 500.0, seconds=10.0)
    n = len(drifting)
    share = 1 + 0.1 * np.arange(n) / n
    angle = np.cumsum(drifting.speed * share) * 1e-4
    warped = replace(drifting, speed=drifting.speed * share, angle=np.angle(np.exp(1j * angle)))
    i_dq = frames.to_dq(drifting.i_abc, drifting.angle)
    warped = replace(warped, i_abc=frames.to_abc(i_dq, warped.angle))
    drift = next(finding for finding in found(warped) if finding.code == "speed_drift")
    assert drift.values["drift"] == pytest.approx(0.095, abs=0.015)


def test_steps_of_the_speed_are_no_drift():
    machine = MACHINES["ipm"].to_map()
    settings = SimulationSettings(speeds=(500.0, 550.0, 600.0, 650.0), current_noise=1e-3)
    assert found(run_experiment(machine, settings, seconds=8.0).samples) == ()


# -- currents and voltages -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize(("scale", "offset"), [(2.0, 0.0), (1.0, 0.5)])
def test_duty_cycles(drives, drive, scale, offset):
    samples = drives[drive]
    u_dc = max((MACHINES | OTHERS)[DRIVES[drive][0]].u_dc, 2.1 * float(np.abs(samples.u_abc).max()))
    finding = told(replace(samples, u_abc=scale * samples.u_abc / u_dc + offset))
    assert (finding.code, finding.kind) == ("duty_cycles", "error")
    assert ("scale: u_dc / 2" if scale == 2 else "scale: u_dc in") in finding


def test_small_voltages_are_no_duty_cycles():
    samples = recorded("slotless", 50.0, seconds=4.0)
    small = replace(samples, u_abc=samples.u_abc * 0.4)
    assert np.abs(small.u_abc).max() < 1.15
    assert found(small) == ()


def test_no_voltage(ipm):
    finding = told(replace(ipm, u_abc=np.full_like(ipm.u_abc, 3.0)))
    assert (finding.code, finding.kind) == ("no_voltage", "error")


@pytest.mark.cases
@pytest.mark.parametrize(("factor", "said"), [(1e3, "(mA for A)"), (1 / 300, "(per unit for A)"), (0.7071, "(rms for")])
def test_the_scale_of_currents_with_references(factor, said):
    samples = run_experiment(MACHINES["ipm"].to_map(), SimulationSettings(), seconds=2.0).samples
    finding = told(replace(samples, i_abc=factor * samples.i_abc))
    assert finding.code == "current_scale"
    assert said in finding
    assert finding.values["gain"] == pytest.approx(factor, rel=0.02)


def test_the_scale_of_currents_without_references(ipm):
    assert "in mA" in told(replace(ipm, i_abc=1000 * ipm.i_abc))
    assert "in kA or per unit" in told(replace(ipm, i_abc=1e-3 * ipm.i_abc))


@pytest.mark.parametrize(("factor", "code"), [(1e3, "voltage_scale"), (1e-3, "duty_cycles")])
def test_the_scale_of_voltages(ipm, factor, code):
    assert told(replace(ipm, u_abc=factor * ipm.u_abc)).code == code


@pytest.mark.parametrize("gain", [1.3, 1.1, 0.95])
@pytest.mark.parametrize("phase", [0, 1, 2])
def test_a_sensor_of_another_gain(ipm, gain, phase):
    finding = found(replace(ipm, i_abc=ipm.i_abc * np.where(np.arange(3) == phase, gain, 1.0)))[0]
    assert finding.code == "zero_sequence"
    assert f"phase {'abc'[phase]} reads {gain} times its true current" in finding


def test_noise_of_the_currents_is_no_fault_of_their_gains(ipm):
    noise = np.random.default_rng(3).normal(0.0, 0.02 * np.abs(ipm.i_abc).max(), ipm.i_abc.shape)
    assert "zero_sequence" not in [finding.code for finding in found(replace(ipm, i_abc=ipm.i_abc + noise))]


def test_a_constant_sum_of_the_currents(ipm):
    offset = found(replace(ipm, i_abc=ipm.i_abc + np.array([20.0, 0.0, 0.0])))[0]
    assert "20 A of it constant" in offset


def test_offsets(ipm):
    offset = np.array([12.0, -4.0, -8.0])
    by_code = {finding.code: finding for finding in found(replace(ipm, i_abc=ipm.i_abc + offset))}
    assert by_code["current_offset"].values["alpha"] == pytest.approx(12.0, abs=1.0)
    by_code = {finding.code: finding for finding in found(replace(ipm, u_abc=ipm.u_abc + 0.25 * offset))}
    assert by_code["voltage_offset"].values["alpha"] == pytest.approx(3.0, abs=0.4)


def test_sensors_that_saturate(ipm):
    finding = found(replace(ipm, i_abc=np.clip(ipm.i_abc, -200, 200)))[0]
    assert finding.code == "current_clipped"
    assert finding.values["limit"] == pytest.approx(200.0)


@pytest.mark.parametrize("kind", ["phase", "amplitude", "hexagon"])
def test_voltages_at_a_limit(drives, kind):
    u_s = drives["spm"].u_abc @ (2 / 3 * np.exp(2j * np.pi / 3 * np.array([0, 1, -1])))
    if kind == "phase":
        size, limit = np.abs(u_s.real), 0.8 * np.abs(u_s.real).max()
    elif kind == "amplitude":
        size, limit = np.abs(u_s), 0.9 * np.abs(u_s).max()
    else:
        normals = np.exp(-1j * np.pi / 6 * np.array([1, 3, 5]))
        size = np.abs((u_s[:, None] * normals).real).max(axis=1)
        limit = 0.9 * size.max()
    limited = u_s * np.minimum(1.0, limit / np.maximum(size, 1e-9))
    u_abc = (limited[:, None] * np.exp(-2j * np.pi / 3 * np.array([0, 1, -1]))).real
    by_code = {finding.code: finding for finding in found(replace(drives["spm"], u_abc=u_abc))}
    assert by_code["voltage_clipped"].values["share"] > 0.015
    assert f"({kind}" in by_code["voltage_clipped"]


def test_discontinuous_pwm_is_named(drives):
    """One phase is clamped at each moment, which the zero sequence does."""
    u_abc = drives["spm"].u_abc
    at, limit = np.arange(len(u_abc)), 1.2 * np.abs(u_abc).max()
    clamped = u_abc[at, np.abs(u_abc).argmax(axis=1)]
    u_abc = u_abc + (np.copysign(limit, clamped) - clamped)[:, None]
    (finding,) = (each for each in found(replace(drives["spm"], u_abc=u_abc)) if each.code == "voltage_clipped")
    assert f"one phase is clamped at {limit:.4g} V" in finding


def test_voltages_that_are_single_vectors_of_the_inverter(drives):
    """Those of a modulated voltage are none, nor are pulses along one axis."""
    u_abc = drives["spm"].u_abc
    codes = {finding.code for finding in found(replace(drives["spm"], u_abc=single_vectors(u_abc)))}
    assert "single_vectors" in codes
    assert not codes & {"voltage_clipped", "phase_quantized"}
    pulses = np.outer(np.sign(np.sin(np.arange(len(u_abc)) / 50.0)), [40.0, -20.0, -20.0])
    for other in (u_abc, pulses):
        assert "single_vectors" not in {finding.code for finding in found(replace(drives["spm"], u_abc=other))}


def test_a_stuck_phase(ipm):
    i_abc, u_abc = ipm.i_abc.copy(), ipm.u_abc.copy()
    i_abc[5000:5300, 1] = i_abc[5000, 1]
    u_abc[9000:9400, 2] = 0.0
    for samples, said in (
        (replace(ipm, i_abc=i_abc), "current of phase b"),
        (replace(ipm, u_abc=u_abc), "voltage of phase c stays at 0 V for 399 samples from 0.9000 s on"),
    ):
        finding = next(finding for finding in found(samples) if finding.code == "phase_stuck")
        assert finding.kind == "error"
        assert said in finding


def test_the_crest_of_a_slow_wave_in_coarse_steps_is_not_stuck(ipm):
    wave = 74.0 * np.cos(2 * np.pi * (24.0 * 1e-4 * np.arange(len(ipm)))[:, None] - 2 * np.pi / 3 * np.arange(3))
    coarse = np.round(wave)
    assert waveforms._held_phase(np.repeat(coarse, 2, axis=0), 74.0) is None
    stuck = coarse.copy()
    stuck[1000:1100, 1] = stuck[1000, 1]
    phase, start, *_ = waveforms._held_phase(stuck, 74.0)
    assert phase == 1
    assert 990 <= start <= 1000


def test_a_fast_rotor_does_not_make_exchanged_signals_likelier():
    """48 degrees per sample, of which the rough model misses more than with currents and voltages exchanged."""
    assert "exchanged" not in {finding.code for finding in found(recorded("ipm", 20_000.0))}


def test_a_coarse_phase(ipm):
    i_abc = ipm.i_abc.copy()
    i_abc[:, 1] = 10 * np.round(i_abc[:, 1] / 10)
    by_code = {finding.code: finding for finding in found(replace(ipm, i_abc=i_abc))}
    assert "phase b takes only" in by_code["phase_quantized"]
    assert by_code["phase_quantized"].values["step"] == pytest.approx(10.0)
    fine = replace(ipm, i_abc=np.round(ipm.i_abc / 0.15) * 0.15)  # 12 bits
    assert found(fine) == ()


@pytest.mark.parametrize("frame", ["phases", "rotor"])
@pytest.mark.parametrize("signal", ["current", "voltage"])
def test_readings_that_are_cut_off_and_not_rounded(drives, signal, frame):
    """By integers in the step of an 8-bit signal, of phases or of dq readings that were turned to phases."""
    samples = drives["spm"]
    name = "i_abc" if signal == "current" else "u_abc"
    x_abc = getattr(samples, name)
    x = x_abc if frame == "phases" else frames.to_dq(x_abc, samples.angle)
    step = np.abs(x_abc).max() / 128

    def told(to_integer):
        kept = step * to_integer(x / step)
        logged = kept if frame == "phases" else frames.to_abc(kept, samples.angle)
        return {each.code: each for each in found(replace(samples, **{name: logged}))}.get("truncated")

    cut_off = told(np.trunc)
    assert cut_off.values["step"] == pytest.approx(step)
    whole, cut = (np.abs(frames.space_vector(x)).mean() for x in (x_abc, step * np.trunc(x_abc / step)))
    assert cut_off.values["share"] == pytest.approx(1 - cut / whole if frame == "phases" else 0.5 / 128, rel=0.3)
    assert told(np.round) is None
    assert told(np.floor) is None, "which the sum of the phases takes, or an offset"


# -- good drives, and the way through evidence ----------------------------------------------------------------------


@pytest.mark.accuracy
def test_good_drives_are_told_nothing():
    accused = {}
    for seed in range(GOOD_DRIVES):
        described, samples = random_recording(seed, longest=15.0 if GOOD_DRIVES > 25 else 2.2)
        if findings := found(samples):
            accused[described] = findings
    assert accused == {}


def test_recordings_at_several_speeds_and_of_short_runs_are_good(ipm):
    assert found(ipm, replace(recorded("ipm", -900.0), stamp=ipm.stamp + 10**11)) == ()
    assert found(replace(ipm, run_starts=np.arange(0, len(ipm), 250))) == ()


@pytest.mark.cases
@pytest.mark.parametrize("case", ["clockwise", "currents a, b", "8 for 4 pole pairs"])
def test_pieces_and_arrays_are_judged_alike(ipm, case):
    """Live samples and bags come in pieces."""
    changed = READINGS[case][0](ipm)
    prescan = Prescan()
    for start in range(0, len(changed), 913):
        piece, continues = cut(changed, start, min(start + 913, len(changed)))
        prescan.add(piece, continues=continues)
    assert prescan.findings() == found(changed)


def test_findings_travel_with_the_evidence(ipm):
    samples = replace(ipm, angle=ipm.angle + 1.0)
    settings = FitSettings("joint", i_max=300.0)
    one, other = gather([samples], settings), gather([ipm], settings)
    (finding,) = one.findings
    assert other.findings == ()
    assert other.merged(one).findings == one.merged(one).findings == (finding,)
    restored = Evidence.within(settings, 300.0)
    restored.restore(one.state())
    assert restored.findings == (finding,)
    assert finding in identify([samples], settings).report.warnings


@pytest.mark.cases
@pytest.mark.parametrize("drive", ["ipm", "spm"])
def test_a_loss_of_voltage_is_located(drive):
    samples = recorded(*DRIVES[drive][:2], seconds=5.0)
    u_abc = samples.u_abc.copy()
    u_abc[21_550:21_600] = 0.0
    finding = told(replace(samples, u_abc=u_abc))
    assert finding.code == "outlier"
    assert finding.values["time"] == pytest.approx(2.15, abs=0.2)
