"""Logs that are wrong in one way each are named before a fit, and foreign logs get a signals file that fits."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import synthetic
from column_files import columns, write_csv, write_mdf, write_parquet
from drive_bags import renamed
from foreign_rows import write_rows
from scipy.io import savemat

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.checks.recognition import angle_like, is_count, likely_counts
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.several import read_recording
from drive_id.files.write.writer import write_recording
from drive_id.fitting.simulated import run_experiment
from drive_id.inspection.inspect import check
from drive_id.inspection.names import name_groups, suggests

POLE_PAIRS = 4
CHECKS = Path(__file__).parents[2] / "docs" / "findings.md"


@pytest.fixture(scope="module")
def samples(simulation):
    made = simulation.samples
    return replace(made.part(0, 12_000), truth=None, stamp=made.stamp[:12_000] - made.stamp[0])


def shaft(samples):
    return np.unwrap(samples.angle) / POLE_PAIRS


def swapped(x):
    return x[:, [0, 2, 1]]


def every(samples, n):
    names = ("stamp", "i_abc", "u_abc", "angle", "speed", "i_dq_reference")
    return {name: getattr(samples, name)[::n] for name in names} | {"sample_period": n * samples.sample_period}


def drifting(samples):
    """The machine accelerates by a fifth, and currents and voltages turn with it."""
    share = 1 + 0.2 * np.arange(len(samples)) / len(samples)
    angle = np.cumsum(samples.speed * share) * samples.sample_period
    turned = {name: frames.to_abc(frames.to_dq(x, samples.angle), angle) for name, x in
              (("i_abc", samples.i_abc), ("u_abc", samples.u_abc))}  # fmt: skip
    return turned | {"speed": samples.speed * share, "angle": angle}


def as_phases(vector):
    """Alpha and beta as a reader takes them for phases a and b."""
    return np.column_stack([vector.real, vector.imag, -vector.real - vector.imag])


def narrow(samples):
    """Samples with currents of the first quadrant, at their times."""
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    kept = (i_dq[:, 0] < 0) & (i_dq[:, 1] > 0)
    names = ("stamp", "i_abc", "u_abc", "angle", "speed", "i_dq_reference")
    starts = np.flatnonzero(np.diff(np.flatnonzero(kept), prepend=-9) > 1)
    return {name: getattr(samples, name)[kept] for name in names} | {"run_starts": starts}


def doubled(samples):
    """Rows of which each hundredth is there twice."""
    at = np.arange(len(samples))
    return at - (at % 100 == 40)


def tripped(samples, u_abc, at=11_700):
    """From a sample on, the currents die out within 0.5 ms, and the log holds these voltages."""
    die = np.exp(-np.maximum(np.arange(len(samples)) - at, 0) / 5.0)[:, None]
    u = samples.u_abc.copy()
    u[at:] = u_abc
    return {"i_abc": samples.i_abc * die, "u_abc": u, "i_dq_reference": None}


RNG = np.random.default_rng(5)
WRONG = {
    "duty cycles": ("duty_cycles", lambda s: {"u_abc": s.u_abc / 400 + 0.5}),
    "duty cycles around zero": ("duty_cycles", lambda s: {"u_abc": s.u_abc / 200}),
    "degrees": ("angle_unit", lambda s: {"angle": np.rad2deg(np.mod(s.angle, 2 * np.pi))}),
    "mechanical angle": ("pole_pairs", lambda s: {"angle": shaft(s), "speed": s.speed / POLE_PAIRS}),
    "rpm": ("angle_speed", lambda s: {"speed": s.speed / POLE_PAIRS * 30 / np.pi}),
    "clockwise": ("direction", lambda s: {"angle": -s.angle, "speed": -s.speed}),
    "swapped voltages": ("phases_swapped", lambda s: {"u_abc": swapped(s.u_abc)}),
    "swapped currents": ("phases_swapped", lambda s: {"i_abc": swapped(s.i_abc)}),
    "shifted voltages": ("phases_shifted", lambda s: {"u_abc": s.u_abc[:, [1, 2, 0]]}),
    "reversed phase": ("phase_reversed", lambda s: {"i_abc": s.i_abc * [1, -1, 1]}),
    "generator sign": ("current_sign", lambda s: {"i_abc": -s.i_abc}),
    "offset": ("angle_offset", lambda s: {"angle": s.angle + 0.8}),
    "milliamperes": ("current_scale", lambda s: {"i_abc": 1e3 * s.i_abc}),
    "kelvin": ("temperature_range", lambda s: {"winding_temperature": np.full(len(s), 353.0)}),
    "millivolts": ("voltage_scale", lambda s: {"u_abc": 1e3 * s.u_abc}),
    "currents for voltages": ("exchanged", lambda s: {"i_abc": s.u_abc, "u_abc": s.i_abc, "i_dq_reference": None}),
    "alpha and beta": ("alpha_beta", lambda s: {"u_abc": as_phases(frames.space_vector(s.u_abc))}),
    "between phases": ("line_voltages", lambda s: {"u_abc": s.u_abc - np.roll(s.u_abc, -1, axis=1)}),
    "no voltage": ("no_voltage", lambda s: {"u_abc": 0 * s.u_abc}),
    "jump": ("angle_jump", lambda s: {"angle": s.angle + 2 * (np.arange(len(s)) > 5000)}),
    "slow clock": ("sample_period", lambda s: {"stamp": s.stamp * 1000, "sample_period": 0.1}),
    "voltages of another time": ("time_shift", lambda s: {"u_abc": np.roll(s.u_abc, 25, axis=0)}),
    "voltages of another drive": ("unexplained", lambda s: {"u_abc": s.u_abc[::-1] * [1.0, -0.4, 0.2]}),
    "every tenth sample": ("decimated", lambda s: every(s, 10)),
    "a loss of voltage": ("outlier", lambda s: {"u_abc": s.u_abc * (np.abs(np.arange(len(s)) - 21_575) > 25)[:, None]}),
    "a flipped bit": ("single_sample", lambda s: {"angle": s.angle + 0.02 * (np.arange(len(s)) == 7000)}),
    "standstill": ("standstill", lambda s: {"angle": 0.3 + 0 * s.angle, "speed": 0 * s.speed}),
    "every fourtieth sample": ("coarse_sampling", lambda s: every(s, 40)),
    "slow angle": ("held_angle", lambda s: {"angle": np.repeat(s.angle[::8], 8)[: len(s)]}),
    "drifting speed": ("speed_drift", drifting),
    "constant references": ("held_references", lambda s: {"i_dq_reference": 0 * s.i_dq_reference + [-20.0, 30.0]}),
    "noise only": ("no_trajectory", lambda s: {"i_dq_reference": None, "i_abc": 1e-3 * RNG.normal(size=s.i_abc.shape)}),
    "current spike": (
        "current_spike",
        lambda s: {"i_abc": s.i_abc + 1e4 * (np.arange(len(s)) == 900)[:, None] * [1, 0, -1]},
    ),
    "unequal gains": ("zero_sequence", lambda s: {"i_abc": s.i_abc * [1.1, 1.0, 1.0]}),
    "readings of a converter": ("zero_sequence", lambda s: {"i_abc": np.round(s.i_abc * 25) + 8192}),
    "two readings of a converter": (
        "current_offset",
        lambda s: {"i_abc": (np.round(s.i_abc * 25) + 8192) @ [[1, 0, -1], [0, 1, -1], [0, 0, 0]]},
    ),
    "a phase of three times the gain": ("zero_sequence", lambda s: {"i_abc": s.i_abc * [1.0, 3.0, 1.0]}),
    "current offset": ("current_offset", lambda s: {"i_abc": s.i_abc + np.array([20.0, -10.0, -10.0])}),
    "voltage offset": ("voltage_offset", lambda s: {"u_abc": s.u_abc + np.array([8.0, -4.0, -4.0])}),
    "saturated current": ("current_clipped", lambda s: {"i_abc": np.clip(s.i_abc, -150.0, 150.0)}),
    "saturated voltage": ("voltage_clipped", lambda s: {"u_abc": np.clip(s.u_abc, -25.0, 25.0)}),
    "predictive control": ("single_vectors", lambda s: {"u_abc": synthetic.single_vectors(s.u_abc)}),
    "stuck phase": (
        "phase_stuck",
        lambda s: {"i_abc": np.where((np.arange(len(s)) // 400 == 9)[:, None] * [False, True, False], 1.5, s.i_abc)},
    ),
    "cut off to half a volt": ("truncated", lambda s: {"u_abc": np.trunc(2 * s.u_abc) / 2}),
    "coarse converter": ("phase_quantized", lambda s: {"i_abc": np.round(s.i_abc / 10) * 10}),
    "one corner": ("coverage", narrow),
    "every third current": ("held_currents", lambda s: {"i_abc": np.repeat(s.i_abc[::3], 3, axis=0)[: len(s)]}),
    "every second row": (
        "held_currents",
        lambda s: {name: np.repeat(getattr(s, name)[::2], 2, axis=0)[: len(s)] for name in ("i_abc", "u_abc")},
    ),
    "doubled rows": (
        "repeated_rows",
        lambda s: {name: getattr(s, name)[doubled(s)] for name in ("i_abc", "u_abc", "angle", "i_dq_reference")},
    ),
    "currents of before": ("repeated_rows", lambda s: {"i_abc": s.i_abc[doubled(s)]}),
    "a trip": ("inverter_tripped", lambda s: tripped(s, s.u_abc[11_700])),
    "a trip that the control does not notice": ("inverter_tripped", lambda s: tripped(s, s.u_abc[7000:], 7000)),
    "a trip with its voltages": ("inverter_tripped", lambda s: tripped(s, 0.0)),
    "jitter": ("stamp_jitter", lambda s: {"stamp": s.stamp + RNG.integers(-30_000, 30_000, len(s))}),
    "gaps": ("gaps", lambda s: {"stamp": s.stamp + 1_000_000 * (np.arange(len(s)) > 5000)}),
}


REFUSED = (
    "every third current",
    "every second row",
    "readings of a converter",
    "two readings of a converter",
    "a phase of three times the gain",
)
"""Sums, or constant parts, as large as the currents: each gave a map with a warning."""
LONG = ("a loss of voltage", "drifting speed", "current offset")
"""What shows against several passes of a trajectory."""


@pytest.fixture(scope="module")
def long():
    settings = SimulationSettings(current_noise=1e-3)
    return replace(run_experiment(machine_map("ipm"), settings, seconds=5.0).samples, truth=None)


@pytest.mark.parametrize("name", WRONG)
def test_every_wrong_use_is_named_before_a_fit(name, tmp_path, samples, long):
    code, change = WRONG[name]
    samples = long if name in LONG else samples
    changed = {"run_starts": np.array([0, 5001])} if name == "gaps" else {}
    if name in ("generator sign", "offset", "swapped currents"):
        changed["i_dq_reference"] = None  # would be wrong, too
    write_bag = replace(samples, **changed, **change(samples))
    write_path = tmp_path / "log.parquet"
    table = {
        "t": write_bag.stamp * 1e-9,
        **{f"i{k}": x for k, x in enumerate(write_bag.i_abc.T)},
        **{f"u{k}": x for k, x in enumerate(write_bag.u_abc.T)},
        "th": write_bag.angle,
        "w": write_bag.speed,
    }
    text = "defaults: {stamp: t, stamp_unit: s}\ncurrents: {fields: [i0, i1, i2]}\nvoltages: {fields: [u0, u1, u2]}\n"
    text += "resolver: {angle: th, speed: w}\n"
    if write_bag.winding_temperature is not None:
        table |= {"warm": write_bag.winding_temperature}
        text += "optional: {winding_temperature: {field: warm}}\n"
    if write_bag.i_dq_reference is not None:
        table |= {"d": write_bag.i_dq_reference[:, 0], "q": write_bag.i_dq_reference[:, 1]}
        text += "reference: {fields: [d, q]}\n"
    found = check(write_parquet(write_path, table), signals=parse_signals(text, "test"))
    assert code in [finding.code for finding in found.findings], found.findings
    if name in REFUSED:
        assert next(finding.kind for finding in found.findings if finding.code == code) == "error"
    told = json.loads(json.dumps(found.tree(), allow_nan=False))["findings"]
    entry = next(entry for entry in told if entry["code"] == code)
    assert set(entry) >= {"code", "message", "value"}


def test_every_finding_of_the_documented_table_is_tried():
    """Each row of docs/findings.md, but for those on files and drafts, has a case above."""
    documented = set(re.findall(r"^\| ((?:`\w+`(?:, )?)+) \| check", CHECKS.read_text(encoding="utf-8"), re.MULTILINE))
    codes = {code for cell in documented for code in re.findall(r"\w+", cell)}
    assert len(codes) > 35
    assert codes - {code for code, _ in WRONG.values()} == {"memory", "draft_unsure", "no_draft"}


def test_stamps_of_another_unit_are_named(tmp_path, samples):
    """A time in ms, declared as s beside a period in s."""
    path = write_parquet(tmp_path / "log.parquet", columns(samples))
    text = """
defaults: {stamp: time_s, stamp_unit: ms, sample_period: 1e-4}
currents: {fields: [ia, ib, ic]}
voltages: {fields: [ua, ub, uc]}
resolver: {angle: theta, speed: omega}
"""
    found = check(path, signals=parse_signals(text, "test"))
    assert found.findings[0].code == "sample_period"
    assert "as if one were in ms" in found.findings[0]
    assert found.overview is None


def test_our_own_recording_has_no_finding(bag, simulation):
    found = check(bag)
    assert "No problems found.\nSamples  " in repr(found)
    assert "array(" not in repr(found)
    assert [finding.code for finding in found.findings] == []
    figures = found.overview.figures
    assert figures["samples"] == len(simulation.samples)
    assert figures["coverage"] > 0.8
    assert figures["speed_mean"] == pytest.approx(500 / 60 * 2 * np.pi * POLE_PAIRS, rel=1e-3)
    assert figures["turn_per_sample"] == pytest.approx(figures["speed_mean"] * 1e-4, rel=1e-3)
    assert found.draft is None
    names = {table.name: table for table in found.contents.tables}
    assert names["/phase_currents"].block == 100
    assert set(names["/resolver"].columns) >= {"angle", "speed"}


def test_our_messages_on_other_topics_get_a_draft(tmp_path, samples):
    write_recording(tmp_path / "ours", samples)
    renamed(tmp_path / "ours", tmp_path / "bag", phase_currents="sensors/i", phase_voltages="u", resolver="rotor")
    found = check(tmp_path / "bag")
    read = read_recording(tmp_path / "bag", parse_signals(found.draft.text, "draft")).samples
    np.testing.assert_array_equal(read.i_abc, samples.i_abc.astype(np.float32))
    assert read.i_dq_reference is not None


# -- drafts --------------------------------------------------------------------------------------------------------


def assert_reads(path, draft, samples, *, angle=0.05, noise=1e-3):
    """Check that the signals file reads what was recorded; an angle offset is estimated."""
    found = read_recording(path, parse_signals(draft.text, "the draft")).samples
    assert len(found) > len(samples) - 50
    there = np.searchsorted(samples.stamp, found.stamp - found.stamp[0] + samples.stamp[0])
    for mine, true, least in ((found.i_abc, samples.i_abc, noise), (found.u_abc, samples.u_abc, 0.05)):
        assert np.abs(frames.space_vector(mine) - frames.space_vector(true)[there]).max() < least
    away = np.angle(np.exp(1j * (found.angle - samples.angle[there])))
    assert np.abs(away).max() < angle
    assert np.mean(found.speed) == pytest.approx(np.mean(samples.speed), rel=0.01)
    return found


def degrees_and_rpm(s):
    return {"theta": np.rad2deg(np.mod(shaft(s), 2 * np.pi)), "omega": s.speed / POLE_PAIRS * 30 / np.pi}


def counts(s, per_turn, modulus, sign=1, start=777):
    return np.mod(np.floor(sign * shaft(s) / (2 * np.pi) * per_turn) + start, modulus)


def dq_names(s, angle, kind):
    i, u = (frames.to_dq(x, angle) for x in (s.i_abc, s.u_abc))
    none = dict.fromkeys(("ia", "ib", "ic", "ua", "ub", "uc"))
    return none | {f"i_{kind[0]}": i[:, 0], f"i_{kind[1]}": i[:, 1], f"u_{kind[0]}": u[:, 0], f"u_{kind[1]}": u[:, 1]}


def blank_wraps(s):
    theta = np.mod(s.angle, 2 * np.pi)
    theta[np.flatnonzero(np.diff(theta) < -3)[::4]] = np.nan
    return theta


KINDS = {
    "plain": lambda _: {},
    "degrees of the shaft and rpm": degrees_and_rpm,
    "counts": lambda s: {"theta": None, "omega": None, "enc": counts(s, 4096, 4096)},
    "counts backwards": lambda s: {"theta": None, "omega": None, "enc": counts(s, 8192, 8192, -1)},
    "a 16-bit count of 10000 per turn": lambda s: {"theta": None, "omega": None, "enc": counts(s, 10_000, 65_536)},
    "a 16-bit count of 4096 per turn": lambda s: {"theta": None, "omega": None, "enc": counts(s, 4096, 65_536)},
    "a 16-bit count that starts again once": lambda s: {
        "theta": None,
        "omega": None,
        "enc": counts(s, 4096, 65_536, start=50_000),
    },
    "a 16-bit count of 4000 per turn": lambda s: {"theta": None, "omega": None, "enc": counts(s, 4000, 65_536)},
    "alpha and beta": lambda s: dq_names(s, np.zeros(len(s)), ("alpha", "beta")),
    "d and q": lambda s: dq_names(s, s.angle, ("d", "q")),
    "q behind d": lambda s: {
        name: -x if name in ("i_q", "u_q") else x for name, x in dq_names(s, s.angle, ("d", "q")).items()
    },
    "d for q": lambda s: dq_names(s, s.angle, ("q", "d")),
    "half turns": lambda s: {"theta": np.mod(s.angle / np.pi, 2) - 1},
    "gradians": lambda s: {"theta": np.mod(s.angle / np.pi, 2) * 200},
    "turns of the shaft without an end": lambda s: {"theta": 1000 + shaft(s) / (2 * np.pi), "omega": None},
    "blank angles at wraps": lambda s: {"theta": blank_wraps(s), "omega": None},
    "two currents": lambda _: {"ic": None},
    "swapped voltages": lambda s: {"ub": s.u_abc[:, 2], "uc": s.u_abc[:, 1]},
    "no names": lambda s: (
        {f"ch{k}": x for k, x in enumerate(np.column_stack([s.i_abc, s.u_abc]).T)}
        | dict.fromkeys(("ia", "ib", "ic", "ua", "ub", "uc"))
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_drafts_read_what_was_recorded(kind, tmp_path, samples):
    path = write_parquet(tmp_path / "log.parquet", columns(samples, **KINDS[kind](samples)))
    found = check(path)
    assert not [finding for finding in found.findings if finding.kind == "error"]
    zero_sequence = np.abs(samples.i_abc.sum(axis=1)).max()
    read = assert_reads(path, found.draft, samples, noise=zero_sequence if kind == "two currents" else 1e-3)
    assert read.i_dq_reference is not None or kind == "no names"


def resolver_of(s, per_turn, turns_per_turn=POLE_PAIRS):
    """Counts of a resolver that starts again so often per turn of the shaft."""
    return counts(s, per_turn * turns_per_turn, per_turn, start=0)


@pytest.mark.parametrize("speed", [None, "n_rpm"])
def test_a_speed_tells_the_pole_pairs_of_a_resolver_in_degrees(speed, tmp_path, samples):
    """It starts again twice per turn: two pole pairs were drafted for four, and torque was a half."""
    table = columns(samples, omega=None, theta=np.degrees(np.mod(2 * shaft(samples), 2 * np.pi)))
    table |= {speed: samples.speed / POLE_PAIRS * 30 / np.pi} if speed else {}
    path = write_parquet(tmp_path / "log.parquet", table)
    draft = check(path).draft
    assert_reads(path, draft, samples)
    rotor = parse_signals(draft.text, "the draft").resolver
    assert (rotor.pole_pairs, rotor.angle_scale) == ((POLE_PAIRS, 0.5) if speed else (2, 1.0))
    assert (f"by {speed}, in rpm" if speed else "if the angle starts again once per turn of the shaft") in draft.text


def interpolated(s):
    k = np.arange(len(s))
    return np.interp(k, k[::10], np.mod(s.angle, 2 * np.pi)[::10])


ODD_ANGLES = {
    "interpolated across wraps": (lambda s: {"theta": interpolated(s)}, "theta (", "not interpolated"),
    "sine and cosine": (lambda s: {"theta": None, "sin_th": np.sin(s.angle), "cos_th": np.cos(s.angle)}, "sin_th and",
                        "atan2(sin, cos)"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD_ANGLES)
def test_an_angle_that_is_none_is_named_with_the_way_out(kind, tmp_path, samples):
    """Nothing looked like a rotor angle, whatever was named so."""
    made, *said = ODD_ANGLES[kind]
    (finding,) = check(write_parquet(tmp_path / "log.parquet", columns(samples, omega=None, **made(samples)))).findings
    assert all(part in finding for part in said)
    assert len(str(finding).split()) <= 36


def test_an_interpolated_angle_is_no_swinging_shaft(tmp_path, samples):
    """The refusal asked for a slow rotation of a shaft that had turned 40 times."""
    path = write_parquet(tmp_path / "log.parquet", columns(samples, omega=None, theta=interpolated(samples)))
    text = "defaults: {stamp: time_s, stamp_unit: s}\ncurrents: {fields: [ia, ib, ic]}\n"
    text += "voltages: {fields: [ua, ub, uc]}\nresolver: {angle: theta}\n"
    (finding,) = [found for found in check(path, signals=parse_signals(text, "x")).findings if found.kind == "error"]
    assert "to and fro within 1.00 electrical revolutions, as where it was interpolated" in finding


def test_a_held_angle_is_found_and_told(tmp_path, samples):
    table = columns(samples, omega=None, theta=np.mod(np.repeat(samples.angle[::10], 10), 2 * np.pi))
    found = check(write_parquet(tmp_path / "log.parquet", table))
    assert "held_angle" in {finding.code for finding in found.findings}


UNKNOWN = {
    "resolver of the machine's pole pairs": ("rot_cnt", lambda s: resolver_of(s, 16_384)),
    "resolver of two pole pairs": ("resolver_raw", lambda s: resolver_of(s, 4096, 2)),
    "5000 lines on 16 bits": ("qdec", lambda s: counts(s, 20_000, 65_536)),
    "16384 on 16 bits": ("qdec", lambda s: counts(s, 16_384, 65_536)),
    "20000 without an end": ("pos_cnt", lambda s: np.floor(shaft(s) / (2 * np.pi) * 20_000)),
}
"""Counts that show no pole pairs, with the name of their column."""


@pytest.mark.parametrize("speed", [None, "n_rpm"])
@pytest.mark.parametrize("kind", UNKNOWN)
def test_pole_pairs_that_no_data_show_are_left_out(kind, speed, tmp_path, samples):
    """Only a speed of the shaft tells them; one or two were drafted without a mark, and torque was a quarter."""
    name, made = UNKNOWN[kind]
    table = columns(samples, theta=None, omega=None, **{name: made(samples)})
    if speed:
        table[speed] = samples.speed / POLE_PAIRS * 30 / np.pi
    path = write_parquet(tmp_path / "log.parquet", table)
    found = check(path)
    assert_reads(path, found.draft, samples)
    rotor = parse_signals(found.draft.text, "the draft").resolver
    assert rotor.pole_pairs == (POLE_PAIRS if speed else None)
    assert ("draft_unsure" in [finding.code for finding in found.findings]) == (not speed)
    if speed:
        assert f"# by {speed}, in rpm of the shaft" in found.draft.text


@pytest.mark.parametrize(("name", "known"), [("w_shaft", None), ("drehzahl", POLE_PAIRS)])
def test_a_speed_of_an_unknown_unit_tells_no_pole_pairs(name, known, tmp_path, samples):
    """Revolutions per minute with 4 pole pairs are degrees per second with 24."""
    speed = samples.speed / POLE_PAIRS * 30 / np.pi
    table = columns(samples, theta=None, omega=None, rot_cnt=resolver_of(samples, 16_384), **{name: speed})
    draft = check(write_parquet(tmp_path / "log.parquet", table)).draft
    assert parse_signals(draft.text, "the draft").resolver.pole_pairs == known


READINGS = {
    "14 bits": (lambda i: np.round(i * 25 + 8192), 1 / 25, "8192"),
    "16 bits, small": (lambda i: np.round(i * 4 + 32_790), 1 / 4, "32768"),
    "off the half": (lambda i: np.round(i * 8 + np.array([2148, 2136, 2200])), 1 / 8, "21"),
    "volts of a Hall sensor": (lambda i: i * 0.008 + 2.5, 1 / 0.008, "2.5"),
}
"""Readings of currents, their scale, and the zero in the draft."""


@pytest.mark.parametrize("phases", ["uvw", "uv"])
@pytest.mark.parametrize("kind", READINGS)
def test_readings_of_a_converter_get_scale_and_offset_to_edit(kind, phases, tmp_path, samples):
    """They were taken for amperes: a disc of thousands of amperes, and R 88 % off."""
    reading, scale, zero = READINGS[kind]
    logged = {f"isense_{phase}": x for phase, x in zip(phases, reading(samples.i_abc).T, strict=False)}
    path = write_parquet(tmp_path / "log.parquet", columns(samples, ia=None, ib=None, ic=None, **logged))
    found = check(path)
    assert not [finding for finding in found.findings if finding.kind == "error"]
    assert zero in next(line for line in found.draft.text.splitlines() if "# EDIT: A per count" in line)
    signals = parse_signals(found.draft.text, "the draft")
    warnings = read_recording(path, signals).warnings
    marked = [str(message.values["setting"]) for message in warnings if message.code == "guessed_setting"]
    assert [setting.partition(":")[0] for setting in marked] == ["scale", "offset"]
    i = signals.currents
    assert i.scale == 1.0
    told = replace(i, scale=scale, offset=tuple(offset * scale for offset in i.offsets))
    read = read_recording(path, replace(signals, currents=told)).samples
    away = np.abs(read.i_abc[:, :2] - samples.i_abc[: len(read), :2])
    assert away.max() < 6.0  # the zero is known to some counts
    only_scale = check(path, signals=replace(signals, currents=replace(i, scale=scale)))
    assert any(finding.kind == "error" for finding in only_scale.findings)


@pytest.mark.parametrize("ahead", [0.0, 0.5, 1.5])
def test_an_angle_ahead_that_no_data_show_is_a_guess(ahead, tmp_path, samples):
    """Voltages in d and q: R was 36 % off without a warning, and an estimated angle offset turned them further."""
    theta = samples.angle + ahead * samples.speed * samples.sample_period
    u = frames.to_dq(samples.u_abc, theta)
    table = columns(samples, ua=None, ub=None, uc=None, Vd_cmd=u[:, 0], Vq_cmd=u[:, 1])
    path = write_parquet(tmp_path / "log.parquet", table)
    draft = check(path).draft
    warnings = read_recording(path, parse_signals(draft.text, "the draft")).warnings
    scale, found = [message for message in warnings if message.code == "guessed_setting"]
    assert (scale.values["setting"], found.values["setting"]) == ("scale: 1", "angle_advance: 0.0")
    assert draft.text.splitlines()[int(found.values["lines"]) - 1].strip().startswith("angle_advance: 0.0  # EDIT")
    assert "R and the fluxes" in str(found)
    assert "angle_offset: 0 " in draft.text
    told = re.sub("angle_advance: 0.0  # EDIT.*", f"angle_advance: {ahead}", draft.text.replace("scale: 1  ", "#"))
    read = read_recording(path, parse_signals(told, "told"))
    assert not read.warnings
    away = frames.space_vector(read.samples.u_abc) / frames.space_vector(samples.u_abc)
    assert np.abs(np.angle(away)).max() < 1e-3


def test_duty_cycles_with_and_without_a_dc_link(tmp_path, samples):
    u_dc = 400 + 20 * np.sin(20e-9 * samples.stamp)
    duty = {f"duty_{phase}": samples.u_abc[:, k] / u_dc + 0.5 for k, phase in enumerate("UVW")}
    none = dict.fromkeys(("ua", "ub", "uc"))
    path = write_csv(tmp_path / "log.csv", columns(samples, **none, **duty, V_bus=u_dc))
    draft = check(path).draft
    assert "duty cycles from 0 to 1" in draft.text
    assert_reads(path, draft, samples)
    around = {name: values - 0.5 for name, values in duty.items()}
    path = write_csv(tmp_path / "around.csv", columns(samples, **none, **around, V_bus=u_dc))
    assert "NOT SURE: The duty cycles lie around zero" in check(path).draft.text
    path = write_csv(tmp_path / "without.csv", columns(samples, **none, **duty))
    draft = check(path).draft
    assert "scale: 400  # EDIT: U_dc, V, for duty cycles from 0 to 1" in draft.text
    assert any("no DC-link voltage is in the log" in sentence for sentence in draft.unsure)
    recording = read_recording(path, parse_signals(draft.text, "draft"))
    assert "guessed_setting" in [message.code for message in recording.warnings]
    assert not read_recording(path, parse_signals(draft.text.replace("# EDIT", "#"), "edited")).warnings
    found = recording.samples
    part = found.u_abc - found.u_abc.mean(axis=1, keepdims=True)
    assert np.abs(frames.space_vector(part) / frames.space_vector(samples.u_abc) - 400 / u_dc).max() < 1e-6


def test_an_offset_that_the_saliency_alone_shows_is_a_guess(tmp_path):
    """Without a magnet, a draft may exchange d and q, which a fit cannot see."""
    for magnet, guessed in ((0.0, True), (0.08, False)):
        made = synthetic.record(
            lambda i_dq, m=magnet: synthetic.reciprocal_flux(i_dq) - [0.08 - m, 0.0], duration=1.5, noise=0.1
        )
        made = replace(made, i_dq_reference=frames.to_dq(made.i_abc, made.angle))
        path = write_csv(tmp_path / "log.csv", columns(made))
        draft = check(path).draft
        found = read_recording(path, parse_signals(draft.text, "draft")).warnings
        assert [message.values["setting"] for message in found] == ["angle_offset: 0"] * guessed
        assert not read_recording(path, parse_signals(draft.text.replace("# EDIT", "#"), "edited")).warnings


def test_a_foreign_bag_of_several_topics_with_jitter(tmp_path, samples):
    """Encoder at a third of the rate, a slow DC link, stamps of arrival that jitter by a tenth of the period."""
    samples = samples.part(0, 5000)
    rng = np.random.default_rng(1)
    n, start = len(samples), 1_700_000_000_000_000_000
    stamp = start + samples.stamp
    u_dc = 400 + 20 * np.sin(20e-9 * samples.stamp)
    topics = {
        "/inverter/phase_currents": samples.i_abc,
        "/inverter/duty": samples.u_abc / u_dc[:, None] + 0.5,
        "/encoder": counts(samples, 65_536, 65_536)[::3, None],
        "/dc_link": u_dc[::50, None],
    }
    stamps = {
        "/inverter/phase_currents": stamp,
        "/inverter/duty": stamp,
        "/encoder": stamp[::3],
        "/dc_link": stamp[::50],
    }
    moved = {name: x + rng.integers(-10_000, 10_000, len(x)) for name, x in stamps.items()}
    path = write_rows(tmp_path / "bag", topics, moved)
    found = check(path)
    jittering = [finding for finding in found.findings if finding.code == "stamp_jitter"]
    assert not [finding for finding in jittering if "/inverter" in finding]  # taken as equally spaced
    assert {"equally_spaced: true", "interpolate: true"} <= {
        line.split("  #")[0].strip() for line in found.draft.text.splitlines()
    }
    read = read_recording(path, parse_signals(found.draft.text, "draft")).samples
    assert len(read) > n - 10
    assert len(read.run_starts) == 1
    first = int(np.abs(samples.i_abc - read.i_abc[0]).sum(axis=1).argmin())
    np.testing.assert_array_equal(read.i_abc, samples.i_abc[first : first + len(read)])
    away = np.angle(np.exp(1j * (read.angle - samples.angle[first : first + len(read)])))
    assert np.abs(away).max() < 0.05


def test_jitter_is_named_where_the_signals_file_does_not(tmp_path, samples):
    """At 20 kHz, 20 us of jitter: as it is, a fit would invent gaps; equally spaced, it has none."""
    rng = np.random.default_rng(2)
    table = columns(samples, n=np.arange(len(samples)), theta=samples.angle)
    table["time_s"] = 5e-5 * np.arange(len(samples)) + rng.uniform(-20e-6, 20e-6, len(samples))
    path = write_parquet(tmp_path / "log.parquet", table)
    text = """
defaults: {stamp: time_s, stamp_unit: s, equally_spaced: SPACED}
currents: {fields: [ia, ib, ic]}
voltages: {fields: [ua, ub, uc]}
resolver: {angle: theta}
"""
    jittering = check(path, signals=parse_signals(text.replace("SPACED", "false"), "test"))
    assert "stamp_jitter" in [finding.code for finding in jittering.findings]
    spaced = check(path, signals=parse_signals(text.replace("SPACED", "true"), "test"))
    assert spaced.overview.figures["runs"] == 1
    assert spaced.overview.figures["samples"] == len(samples)
    assert not {"stamp_jitter", "gaps"} & {finding.code for finding in spaced.findings}


def test_nothing_that_looks_like_signals(tmp_path, samples):
    t = samples.stamp * 1e-9
    path = write_csv(tmp_path / "log.csv", {"time_s": t, "x": np.sin(t), "y": np.ones(len(t))})
    found = check(path)
    assert [finding.code for finding in found.findings] == ["no_draft"]
    assert found.draft is None


@pytest.mark.parametrize("rows", [60, 400])
def test_slow_logs_in_d_and_q_are_for_method_static(rows, tmp_path):
    k = np.arange(rows)
    waves = {name: np.sin(0.1 * n * k) for n, name in enumerate(("i_d", "i_q", "u_d", "u_q"), 1)}
    path = write_csv(tmp_path / "slow.csv", {"t": 0.1 * k, **waves, "n": np.where(k % 50 < 25, 500.0, -500.0)})
    found = check(path)
    assert "fit it with --method static" in found.draft.text
    assert parse_signals(found.draft.text, "draft").currents.fields == ("i_d", "i_q")
    (finding,) = [finding for finding in found.findings if finding.kind == "error"]
    assert "The drive never rests for 3 samples" in finding
    (again,) = check(path, signals=parse_signals(found.draft.text, "test")).findings
    assert again == finding


def test_channel_groups_are_named(tmp_path, samples):
    path = write_mdf(tmp_path / "log.mf4", columns(samples))
    found = check(path)
    assert_reads(path, found.draft, samples)
    assert found.contents.tables[0].stamp_source == "own"


def test_recording_of_strangers_written_again_as_ours(tmp_path, samples):
    path = write_parquet(tmp_path / "log.parquet", columns(samples))
    recording = read_recording(path, parse_signals(check(path).draft.text, "draft"))
    write_recording(tmp_path / "bag", recording.samples)
    assert [finding.code for finding in check(tmp_path / "bag").findings] == []


# -- parts ---------------------------------------------------------------------------------------------------------


def test_names():
    groups = {
        group.names for group in name_groups(["i_U [A]", "i_V [A]", "i_W [A]", "id", "iq", "x7", "x8", "x9", "ua"])
    }
    assert groups >= {("i_U [A]", "i_V [A]", "i_W [A]"), ("id", "iq"), ("x7", "x8", "x9")}
    parameters = tuple(f"r69[{k}] Phase current {phase}" for k, phase in enumerate("UVW"))
    assert [group.names for group in name_groups(["r62", *parameters])] == [parameters]
    assert suggests("phaseCurrent ", "current")
    assert suggests("V_bus", "dc")
    assert not suggests("speed", "angle")


def test_angles_and_counts():
    k = np.arange(3000)
    assert angle_like(np.mod(0.03 * k, 2 * np.pi)).unit == "rad"
    assert angle_like(np.mod(-1.7 * k, 360)).unit == "deg"
    assert angle_like(np.mod(0.011 * k, 1.0)).unit == "rev"
    found = angle_like(np.floor(np.mod(17.3 * k, 4096)))
    assert (found.unit, found.turn, found.certain) == ("counts", 4096, True)
    assert angle_like(np.mod(17.3 * k, 4096)).unit == "counts"  # resampled, with fractions
    assert angle_like(np.mod(3.7 * k, 1000.0)) is None  # milliseconds of a second
    once = angle_like(np.floor(np.mod(17.3 * k + 40_000, 65_536)))
    assert (once.unit, once.turn, once.wraps, once.certain) == ("counts", 65_536, True, True)
    assert angle_like(np.floor(17.3 * k) - 30_000 * (k > 2000)) is None  # a fall that no counter makes
    reversing = 0.03 * np.where(k < 1800, k, 1800 - 0.7 * (k - 1800))
    noise = 1e-3 * np.random.default_rng(0).normal(size=3000)
    assert angle_like(np.mod(reversing + noise, 2 * np.pi) - np.pi).unit == "rad"
    assert angle_like(reversing + noise, named=True).unit == "rad"
    assert angle_like(reversing + noise) is None
    assert angle_like(np.sin(0.01 * k), named=True) is None
    assert angle_like(np.abs(np.mod(0.03 * k, 2 * np.pi) - np.pi)) is None  # a triangle
    assert angle_like(np.sign(np.sin(0.01 * k)) + noise) is None  # a square wave
    assert angle_like(np.random.default_rng(0).normal(size=3000)) is None
    assert angle_like(np.ones(3000)) is None


@pytest.mark.parametrize(("unit", "turn"), [("rev", 1.0), ("rad", 2 * np.pi), ("deg", 360.0), ("counts", 4096.0)])
def test_an_angle_is_recognized_whatever_is_missing(unit, turn):
    rng, k = np.random.default_rng(0), np.arange(6000)
    for trial in range(75):
        speed = rng.choice([-1, 1]) * rng.choice([0.003, 0.03, 0.11]) * rng.uniform(0.6, 1.5)
        x = np.mod(speed * k + rng.random(), 1) * turn
        kept = np.ones(len(k), np.bool_)
        for start in rng.integers(0, 5700, rng.choice([1, 3, 10])):
            kept[start : start + rng.integers(1, 300)] = False
        stamp = 100_000 * k + rng.integers(0, 50_000, len(k)) * (trial % 2)
        found = angle_like((np.floor(x) if unit == "counts" else x)[kept], stamp[kept])
        assert found is not None
        assert found.unit == unit
        noise = rng.normal(size=kept.sum()) if trial % 2 else rng.uniform(0, turn, kept.sum())
        assert angle_like(noise, stamp[kept]) is None
    assert is_count(np.delete(k, [5, 6, 900]))
    assert not is_count(2 * k)
    assert (4096, 3) in likely_counts(30.0, 40_960.0)
    likely = likely_counts(33.4, 34_133.0)  # 4 pole pairs and 4096 counts
    assert (1024, 1) in likely
    ratios = [count / pole_pairs for count, pole_pairs in likely]
    assert len(set(ratios)) == len(ratios)


def csv_text(table, separator=",", decimal="."):
    rows = np.column_stack(list(table.values()))
    return "".join(separator.join(repr(float(x)).replace(".", decimal) for x in row) + "\n" for row in rows)


def clocked(table, form, separator, decimal):
    """Return rows whose first cell is the time as a text."""
    start = datetime(2024, 3, 1, 12, 59, 58)  # noqa: DTZ001
    rows = csv_text({name: x for name, x in table.items() if name != "time_s"}, separator, decimal).splitlines()
    times = [start + timedelta(microseconds=round(1e6 * t)) for t in table["time_s"]]
    return "".join(f"{time.strftime(form)}{separator}{row}\n" for time, row in zip(times, rows, strict=True))


SCOPE = "Model,MSO58\nSample Interval,1e-4\nRecord Length,6000\nZero Index,0\nVertical Units,A,A,A,V,V,V,rad\n\n"


@pytest.mark.cases
@pytest.mark.parametrize(
    "name", ["oscilloscope", "clock", "German date", "a date and a clock", "UTF-16", "white space", "numbered rows"]
)
def test_drafts_for_text_as_instruments_write_it(name, tmp_path, samples):
    table = columns(samples.part(0, 6000), id_ref=None, iq_ref=None, omega=None)
    names, own = ",".join(table), ",".join(list(table)[1:])
    text, encoding = {
        "oscilloscope": (SCOPE + f"Labels{',' * 7}\n" + names + "\n" + csv_text(table), "utf-8"),
        "clock": (f"time,{own}\n" + clocked(table, "%H:%M:%S.%f", ",", "."), "utf-8"),
        "German date": (
            f"Zeit,{own}\n".replace(",", ";") + clocked(table, "%d.%m.%Y %H:%M:%S,%f", ";", ","),
            "utf-8-sig",
        ),
        "a date and a clock": (f"Date,Time,{own}\n" + clocked(table, "%d.%m.%Y,%H:%M:%S.%f", ",", "."), "utf-8"),
        "UTF-16": (names + "\n" + csv_text(table), "utf-16"),
        "white space": (names.replace(",", "  ") + "\n" + csv_text(table, "  "), "utf-8"),
        "numbered rows": (
            f",{names}\n" + "".join(f"{k},{row}\n" for k, row in enumerate(csv_text(table).splitlines())),
            "utf-8",
        ),
    }[name]
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode(encoding))
    read = read_recording(path, parse_signals(check(path).draft.text, "draft")).samples
    assert read.sample_period == pytest.approx(1e-4)
    np.testing.assert_array_equal(read.i_abc, samples.i_abc[:6000])
    np.testing.assert_array_equal(read.u_abc, samples.u_abc[:6000])


def struct_array(records):
    kinds = [(field, object) for field in records[0]]
    found = np.zeros(len(records), kinds)
    for k, record in enumerate(records):
        found[k] = tuple(record.values())
    return found


@pytest.mark.process
@pytest.mark.parametrize("name", ["ControlDesk", "structure with time", "array"])
def test_drafts_for_structs_of_measurement_tools(name, tmp_path, samples):
    table = columns(samples.part(0, 6000), id_ref=None, iq_ref=None, omega=None)
    time, traces = table["time_s"], {key: x for key, x in table.items() if key != "time_s"}
    content = {
        "ControlDesk": {
            "rec1": {
                "X": struct_array([{"Name": "", "Data": time[None, :]}]),
                "Y": struct_array([{"Name": f"Model Root/{key}", "Data": x[None, :]} for key, x in traces.items()]),
            }
        },
        "structure with time": {
            "scope": {
                "time": time[:, None],
                "signals": struct_array([{"values": x[:, None], "label": key} for key, x in traces.items()]),
            }
        },
        "array": {"ans": np.vstack([time, *traces.values()])},
    }[name]
    path = tmp_path / "log.mat"
    savemat(path, content)
    read = read_recording(path, parse_signals(check(path).draft.text, "draft")).samples
    assert read.sample_period == pytest.approx(1e-4)
    np.testing.assert_array_equal(read.i_abc, samples.i_abc[:6000])
    np.testing.assert_array_equal(read.u_abc, samples.u_abc[:6000])


def test_drafts_for_line_to_line_voltages_milliamperes_and_no_time(tmp_path, samples):
    u_a, u_b, u_c = (samples.u_abc - samples.u_abc.mean(axis=1, keepdims=True)).T
    table = columns(samples, time_s=None, ua=None, ub=None, uc=None, id_ref=None, iq_ref=None, omega=None)
    table |= {"u_AB": u_a - u_b, "u_BC": u_b - u_c, "u_CA": u_c - u_a}
    table |= {name: 1e3 * table[name] for name in ("ia", "ib", "ic")}
    path = write_parquet(tmp_path / "log.parquet", table)
    draft = check(path).draft
    assert sum("No column shows the time" in text or "taken as mA" in text for text in draft.unsure) == 2
    read = read_recording(path, parse_signals(draft.text, "draft")).samples
    np.testing.assert_allclose(read.i_abc, samples.i_abc, rtol=1e-12)
    np.testing.assert_allclose(read.u_abc, np.column_stack([u_a, u_b, u_c]), atol=1e-9)


TWO = {
    "R and T": (("I_R", None, "I_T"), "[I_R, {I_R: -1, I_T: -1}, I_T]"),
    "2 and 3": ((None, "curr2", "curr3"), "[{curr2: -1, curr3: -1}, curr2, curr3]"),
    "U and V": (("ph_U_amp", "ph_V_amp", None), "[ph_U_amp, ph_V_amp]"),
}
"""Which two currents are logged, and what the draft says of them."""


def logged_currents(samples, names, factors):
    logged = {name: x * factor for name, x, factor in zip(names, samples.i_abc.T, factors, strict=True) if name}
    return columns(samples, ia=None, ib=None, ic=None, **logged)


@pytest.mark.parametrize("reversed_", [False, True])
@pytest.mark.parametrize("two", TWO)
def test_any_two_currents_get_a_draft(two, reversed_, tmp_path, samples):
    """Those of a and c held no two sets, and b and c passed for a and b; nor did one with its sensor reversed."""
    names, fields = TWO[two]
    second = max(k for k in range(3) if names[k])
    factors = [-1 if reversed_ and k == second else 1 for k in range(3)]
    path = write_parquet(tmp_path / "log.parquet", logged_currents(samples, names, factors))
    draft = check(path).draft
    assert f"fields: {fields}" in draft.text or reversed_
    assert any(f"of {names[second]} seems to be reversed" in said for said in draft.unsure) == reversed_
    signals = parse_signals(draft.text, "the draft")
    assert signals.voltages.fields == ("ua", "ub", "uc")
    read = read_recording(path, signals).samples
    assert np.abs(read.i_abc - samples.i_abc).max() < 5 * np.abs(samples.i_abc.sum(axis=1)).max()


@pytest.mark.parametrize("bits", [False, True])
@pytest.mark.parametrize("phase", range(3))
def test_one_reversed_sensor_of_three_is_drafted_with_its_sign(phase, bits, tmp_path, samples):
    factors = np.where(np.arange(3) == phase, -1, 1)
    table = logged_currents(samples, ("Iu", "Iv", "Iw"), factors)
    if bits:
        table |= {name: np.round(table[name] * 20) + 8192 for name in ("Iu", "Iv", "Iw")}
    found = check(write_parquet(tmp_path / "log.parquet", table))
    assert any(f"of I{'uvw'[phase]} seems to be reversed" in sentence for sentence in found.draft.unsure)
    currents = parse_signals(found.draft.text, "the draft").currents
    assert currents.scale == tuple(map(float, factors))
    assert currents.offsets == (tuple(-8192.0 * factors) if bits else (0.0,) * 3)
    assert not [finding for finding in found.findings if finding.kind == "error"]


@pytest.mark.parametrize("phase", range(3))
def test_one_reversed_voltage_of_three_is_drafted_with_its_sign(phase, tmp_path, samples):
    """The log held no two sets of phase quantities."""
    factors = np.where(np.arange(3) == phase, -1, 1)
    u = (samples.u_abc - samples.u_abc.mean(axis=1, keepdims=True)) * factors
    path = write_parquet(tmp_path / "log.parquet", columns(samples, **dict(zip(("ua", "ub", "uc"), u.T, strict=True))))
    draft = check(path).draft
    assert f"The voltage of u{'abc'[phase]} seems to be reversed, and its sign is changed: compare it." in draft.unsure
    assert_reads(path, draft, samples)


@pytest.mark.parametrize("names", [("V1", "V2", "V3"), ("U_u", "U_v", "U_w")])
@pytest.mark.parametrize("between", [False, True])
def test_voltages_between_phases_are_told_by_their_values(between, names, tmp_path, samples):
    """A fit refused the draft of those that are not called ab, bc and ca."""
    u = samples.u_abc - samples.u_abc.mean(axis=1, keepdims=True)
    logged = u - np.roll(u, -1, axis=1) if between else u
    table = columns(samples, ua=None, ub=None, uc=None, **dict(zip(names, logged.T, strict=True)))
    found = check(write_parquet(tmp_path / "log.parquet", table))
    assert any("as voltages between phases" in sentence for sentence in found.draft.unsure) == between
    signals = parse_signals(found.draft.text, "the draft")
    assert signals.voltages.frame == ("line_to_line" if between else "abc")
    assert not [finding for finding in found.findings if finding.kind == "error"]


def test_what_was_found_is_named_where_it_is_not_enough(tmp_path, samples):
    table = {"t": samples.stamp * 1e-9, "theta": np.mod(samples.angle, 2 * np.pi)}
    table |= {f"phase_{phase}": x for phase, x in zip("abc", samples.i_abc.T, strict=True)}
    (found,) = check(write_parquet(tmp_path / "log.parquet", table)).findings
    assert "no two sets of phase quantities that share their time" in found
    assert "(there is phase_a, phase_b, phase_c)" in found


def test_rows_that_are_there_twice_are_no_jitter(tmp_path, samples):
    """The draft took them for samples of their own, equally spaced: the period, and all fluxes, were 1 % off."""
    table = {name: x[doubled(samples)] for name, x in columns(samples).items()}
    path = write_parquet(tmp_path / "log.parquet", table)
    draft = check(path).draft
    assert "equally_spaced" not in draft.text
    assert "sample_period: 0.0001" in draft.text
    read = read_recording(path, parse_signals(draft.text, "the draft"))
    assert read.samples.sample_period == pytest.approx(1e-4)
    assert "stamps_cut" in {message.code for message in read.warnings}


@pytest.mark.parametrize(("start", "captures"), [(86_399.4, 1), (43_199.4, 1), (43_199.4, 2)])
def test_midnight_is_no_restart(start, captures, tmp_path, samples):
    table = columns(samples)
    clock = [str(timedelta(seconds=(start + t) % 86_400)) for t in np.round(table.pop("time_s"), 6).tolist()]
    rows = csv_text(table).splitlines()
    lines = [f"{time},{row}" for time, row in zip(clock, rows, strict=True)] * captures
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join(["Clock time", *table]), *lines]) + "\n", encoding="utf-8")
    read = read_recording(path, parse_signals(check(path).draft.text, "the draft"))
    assert len(read.samples) == captures * len(samples)
    assert len([*read.samples.runs()]) == captures
    assert [message.code for message in read.warnings].count("time_restarts") == captures - 1


def test_single_missing_values_are_named_and_do_not_prevent_a_draft(tmp_path, samples):
    table = columns(samples)
    table["ia"] = np.where(np.arange(len(samples)) % 4000 == 7, np.nan, table["ia"])
    found = check(write_parquet(tmp_path / "log.parquet", table))
    assert "fields: [ia, ib, ic]" in found.draft.text
    assert "equally_spaced" not in found.draft.text
    assert "values_missing" in [warning.code for warning in found.warnings]


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_absurd_numbers_count_as_missing_values(tmp_path, samples):
    table = columns(samples)
    table["ia"] = np.where(np.arange(len(samples)) == 4007, 1e300, table["ia"])
    assert "fields: [ia, ib, ic]" in check(write_parquet(tmp_path / "few.parquet", table)).draft.text
    table["ia"] = np.where(np.arange(len(samples)) % 2, -1e300, table["ia"])
    assert "fields: [ia, ib, ic]" not in str(check(write_parquet(tmp_path / "many.parquet", table)).draft)
