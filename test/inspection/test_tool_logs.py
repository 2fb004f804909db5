"""Logs of other tools: each kind is read right by its draft, or refused in one true sentence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tool_logs

import drive_id
from drive_id.core import frames
from drive_id.errors import BagError, DriveIdError, OutputError
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.operating_log import read_operating_log
from drive_id.files.read.several import read_recording
from drive_id.inspection.inspect import check

N = 6000
SIGNALS = "currents: {fields: [ia, ib, ic]}\nvoltages: {fields: [ua, ub, uc]}\nresolver: {angle: theta}\n"
PHASES = ("ia", "ib", "ic", "ua", "ub", "uc")


@pytest.fixture(scope="module")
def samples(simulation):
    return replace(simulation.samples.part(0, N), truth=None)


@pytest.fixture(scope="module")
def columns(samples):
    phases = {f"{name}{phase}": x[:, k] for name, x in (("i", samples.i_abc), ("u", samples.u_abc))
              for k, phase in enumerate("abc")}  # fmt: skip
    return {"t": 1e-4 * np.arange(N), **phases, "theta": np.mod(samples.angle, 2 * np.pi)}


def stretched(columns, period, start=0.0):
    return columns | {"t": start + period * np.arange(N)}


def timeless(columns):
    return {name: x for name, x in columns.items() if name != "t"}


def drafted(path):
    """Return what the proposed signals file reads, with its text and warnings."""
    draft = check(path).draft
    assert draft is not None
    recording = read_recording(path, parse_signals(draft.text, "the draft"))
    return recording.samples, draft, [message.code for message in recording.warnings]


def assert_same(found, samples, period=1e-4, *, missing=0, volts=0.05):
    """Check each sample against the true one of its time."""
    assert found.sample_period == pytest.approx(period, rel=1e-4)
    assert N - 5 - missing <= len(found) <= N - missing
    at = np.rint((found.stamp - found.stamp[-1]) * 1e-9 / found.sample_period).astype(int) + N - 1
    last = np.argmin(np.abs(samples.i_abc - found.i_abc[-1]).sum(axis=1))
    at += last - (N - 1)
    assert np.abs(found.i_abc - samples.i_abc[at]).max() < 1e-3
    assert np.abs(frames.space_vector(found.u_abc) - frames.space_vector(samples.u_abc)[at]).max() < volts
    assert np.abs(np.angle(np.exp(1j * (found.angle - samples.angle[at])))).max() < 0.05


def fortran(path, columns):
    tool_logs.csv(path, columns, digits=dict.fromkeys(columns, "%.9E"))
    path.write_text(path.read_text().replace("E", "D"))
    return path


UNIT_FACTORS = {"t": 1e3, "i": 1e3, "u": 1e-3}
"""From s, A and V to ms, mA and kV, by the letter of a column."""


def without(columns, name, count):
    """Return columns of which one misses values, at most one after the other."""
    x = columns[name].copy()
    x[100 : 100 + 100 * count : 100] = np.nan
    return columns | {name: x}


def filled(columns, count, value, *names):
    """Return columns in which a number stands for missing values."""
    return columns | {name: np.nan_to_num(without(columns, name, count)[name], nan=value) for name in names}


TOOLS = {  # writer, sample period, s, and missing samples
    "LabVIEW, decimal commas": (lambda p, c: tool_logs.labview(p / "a.lvm", c), 1e-4, 0),
    "LabVIEW without times": (lambda p, c: tool_logs.labview(p / "a.txt", stretched(c, 5e-5), times=False), 5e-5, 0),
    "LabVIEW, points, another name": (lambda p, c: tool_logs.labview(p / "log", c, comma=False), 1e-4, 0),
    "LabVIEW without cells of comments": (lambda p, c: tool_logs.labview(p / "a.lvm", c, comments=False), 1e-4, 0),
    "LabVIEW without these and times": (
        lambda p, c: tool_logs.labview(p / "a.lvm", c, comments=False, times=False), 1e-4, 0,
    ),
    "an oscilloscope, units and labels above": (
        lambda p, c: tool_logs.csv(
            p / "a.csv", dict(zip(["TIME", *(f"CH{k}" for k in range(1, 8))], c.values(), strict=True)),
            head=f"Record Length,6000\nVertical Units,A,A,A,V,V,V,rad\nLabel,{','.join((*PHASES, 'theta'))}\n",
        ), 1e-4, 0,
    ),
    "exponents with D": (lambda p, c: fortran(p / "a.csv", c), 1e-4, 0),
    "PicoScope": (lambda p, c: tool_logs.picoscope(p / "a.csv", c, [*"sAAAVVVV"]), 1e-4, 0),
    "PicoScope in ms at 50 kHz": (
        lambda p, c: tool_logs.picoscope(p / "a.csv", stretched(c, 0.02), ["ms", *"AAAVVVV"]), 2e-5, 0,
    ),
    "PicoScope in us, beyond its range": (
        lambda p, c: tool_logs.picoscope(p / "a.csv", stretched(c, 100.0), ["us", *"AAAVVVV"], beyond=500), 1e-4, 11,
    ),
    "TwinCAT, one time": (
        lambda p, c: tool_logs.twincat(p / "a.csv", c, [[*PHASES, "theta"]], comma=False), 1e-4, 0,
    ),
    "TwinCAT, a time per channel, decimal commas": (
        lambda p, c: tool_logs.twincat(p / "a.csv", c, [[name] for name in (*PHASES, "theta")], comma=True), 1e-4, 0,
    ),
    "PlotJuggler": (
        lambda p, c: tool_logs.plotjuggler(
            p / "a.csv", c, {"/motor/current": [*PHASES[:3]], "/inverter/voltage": [*PHASES[3:]], "/encoder": ["theta"]}
        ), 1e-4, 0,
    ),
    "csv.gz": (lambda p, c: tool_logs.packed(p / "a.csv.gz", tool_logs.csv, c), 1e-4, 0),
    "zip of a CSV": (lambda p, c: tool_logs.packed(p / "a.csv.zip", tool_logs.csv, c), 1e-4, 0),
    "lvm.gz": (lambda p, c: tool_logs.packed(p / "a.lvm.gz", tool_logs.labview, c), 1e-4, 0),
    "npz": (lambda p, c: tool_logs.npz(p / "a.npz", c), 1e-4, 0),
    "npz with a structured array, any name": (lambda p, c: tool_logs.structured_npz(p / "a.dat", c), 1e-4, 0),
    "npz without times, a rate beside": (
        lambda p, c: tool_logs.npz(p / "a.npz", timeless(c) | {"fs": np.array(8000.0)}), 1.25e-4, 0,
    ),
    "HDF5 without times, a step as attribute": (
        lambda p, c: tool_logs.hdf5(p / "a.h5", timeless(c), {"version": 2}, {"dt": 8e-5, "unit": "1"}), 8e-5, 0,
    ),
    "HDF5 without times, the rates of log and control": (
        lambda p, c: tool_logs.hdf5(p / "a.h5", timeless(c), {"sample_rate": 4000, "Ts": 1e-4}, {}), 2.5e-4, 0,
    ),
    "JSON lines": (lambda p, c: tool_logs.json_lines(p / "a.jsonl", c), 1e-4, 0),
    "JSON lines, packed": (lambda p, c: tool_logs.packed(p / "a.jsonl.gz", tool_logs.json_lines, c), 1e-4, 0),
    "Feather": (lambda p, c: tool_logs.feather(p / "a.feather", stretched(c, 2e-4)), 2e-4, 0),
    "MDF with invalid samples": (
        lambda p, c: tool_logs.mdf(p / "a.mf4", c, {"ia": np.arange(100, 4100, 100)}), 1e-4, 40,
    ),
    "MDF, two channels invalid": (
        lambda p, c: tool_logs.mdf(p / "a.dat", c, {"ub": np.arange(50, 70), "theta": np.arange(300, 303)}), 1e-4, 23,
    ),
    "six digits at 8 kHz": (
        lambda p, c: tool_logs.csv(p / "a.csv", stretched(c, 1.25e-4, 100.0), digits={"t": "%.6g"}), 1.25e-4, 0,
    ),
    "whole ms at 10 kHz": (
        lambda p, c: tool_logs.csv(p / "a.csv", {"time_ms": np.floor(1e3 * c["t"]), **c} | {"t": c["t"] * np.nan}),
        1e-4, 0,
    ),
    "ms of six digits at 20 kHz, decimal commas": (
        lambda p, c: tool_logs.csv(
            p / "a.csv", {"time_ms": 1e3 * (50 + 0.5 * c["t"])} | {n: x for n, x in c.items() if n != "t"}, ";",
            comma=True, digits={"time_ms": "%.6g"},
        ), 5e-5, 0,
    ),
    "six digits at 16 kHz, semicolons": (
        lambda p, c: tool_logs.csv(p / "a.csv", stretched(c, 6.25e-5, 250.0), ";", digits={"t": "%.6g"}, comma=True),
        6.25e-5, 0,
    ),
    "zip of a LabVIEW file at 12.5 kHz": (
        lambda p, c: tool_logs.packed(p / "a.lvm.zip", tool_logs.labview, stretched(c, 8e-5)), 8e-5, 0,
    ),
    "JSON lines at 4 kHz": (lambda p, c: tool_logs.json_lines(p / "a.log", stretched(c, 2.5e-4, 7.0)), 2.5e-4, 0),
    "lost rows, tabs": (
        lambda p, c: tool_logs.csv(
            p / "a.txt", {n: np.delete(x, np.r_[1000:1007, 3000:3090, 5000]) for n, x in c.items()}, "\t"
        ), 1e-4, 98,
    ),
    "ISO dates": (lambda p, c: tool_logs.dated(p / "a.csv", c, "timestamp", "%Y-%m-%dT%H:%M:%S.%fZ", ","), 1e-4, 0),
    "ISO dates of another name at 4 kHz": (
        lambda p, c: tool_logs.dated(p / "a.csv", stretched(c, 2.5e-4), "Datum", "%Y-%m-%d %H:%M:%S.%f", ","),
        2.5e-4, 0,
    ),
    "dates with points of no known name": (
        lambda p, c: tool_logs.dated(p / "a.csv", stretched(c, 5e-5), "col0", "%d.%m.%Y %H:%M:%S.%f", ";"), 5e-5, 0,
    ),
    "dates with AM and PM": (
        lambda p, c: tool_logs.dated(p / "a.csv", c, "Time", "%m/%d/%Y %I:%M:%S.%f %p", ","), 1e-4, 0,
    ),
    "Parquet, dates with a time zone": (
        lambda p, c: tool_logs.parquet(p / "a.parquet", c, zone="Europe/Berlin"), 1e-4, 0,
    ),
    "names in a comment, as of numpy.savetxt": (lambda p, c: tool_logs.csv(p / "a.txt", c, " ", head="# "), 1e-4, 0),
    "a text in a column that is blank before": (
        lambda p, c: tool_logs.evented(p / "a.csv", c, row=3000), 1e-4, 0,
    ),
    "units in brackets, blank line, tabs": (
        lambda p, c: tool_logs.unit_row(p / "a.txt", c, [f"[{u}]" for u in ("s", *"AAAVVV", "rad")], "\t", comma=True),
        1e-4, 0,
    ),
    "units of ms, mA and kV, blank line": (
        lambda p, c: tool_logs.unit_row(
            p / "a.csv", {n: UNIT_FACTORS.get(n.strip("abc"), np.degrees(1)) * x for n, x in c.items()},
            ["ms", *["mA"] * 3, *["kV"] * 3, "deg"], ";", comma=False,
        ), 1e-4, 0,
    ),
    "words for missing values": (
        lambda p, c: tool_logs.csv(p / "a.csv", without(c, "ia", 40), blank="OVR"), 1e-4, 40,
    ),
    "stand-ins of a logger": (lambda p, c: tool_logs.csv(p / "a.csv", filled(c, 40, -9999.0, "ia", "uc")), 1e-4, 40),
    "stand-ins in the angle": (lambda p, c: tool_logs.csv(p / "a.csv", filled(c, 7, 1e30, "theta")), 1e-4, 7),
    "stand-ins of an integer type": (
        lambda p, c: tool_logs.npz(p / "a.npz", {n: x if n == "t" else np.float32(x) for n, x in filled(
            c, 12, 32767.0, "ub").items()}), 1e-4, 12,
    ),
    "Parquet of structs": (lambda p, c: tool_logs.nested(p / "a.parquet", c, structs=True), 1e-4, 0),
    "Feather of lists": (lambda p, c: tool_logs.nested(p / "a.feather", c, structs=False), 1e-4, 0),
    "nulls of Parquet": (lambda p, c: tool_logs.parquet(p / "a.parquet", without(c, "uc", 33)), 1e-4, 33),
    "nulls of JSON": (lambda p, c: tool_logs.json_lines(p / "a.jsonl", without(c, "ib", 12)), 1e-4, 12),
    "four digits from 10 s at 8 kHz": (
        lambda p, c: tool_logs.csv(p / "a.csv", stretched(c, 1.25e-4, 10.0), digits={"t": "%.4f"}), 1.25e-4, 0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("tool", TOOLS)
def test_logs_of_other_tools(tool, tmp_path, samples, columns):
    write, period, missing = TOOLS[tool]
    found, _, warnings = drafted(write(tmp_path, columns))
    assert_same(found, samples, period, missing=missing)
    assert ("values_missing" in warnings) == (bool(missing) and not tool.startswith(("lost rows", "stand-ins in the")))
    assert ("gaps" in warnings) == bool(missing)


@pytest.mark.parametrize("beside", [{"Ts": 1.25e-4}, {"fs": 8000.0, "dt": 1e-4}, {"fs": 8.0}])
def test_a_sample_time_that_may_be_another_one_is_a_guess(tmp_path, columns, beside):
    """Of a control, contradicted, or in other units."""
    path = tool_logs.npz(tmp_path / "a.npz", timeless(columns) | {name: np.array(x) for name, x in beside.items()})
    found, draft, warnings = drafted(path)
    assert found.sample_period == pytest.approx(beside.get("Ts", 1e-4))
    assert "guessed_setting" in warnings
    assert "# EDIT: s" in draft.text


def test_a_channel_without_a_valid_value_is_named(tmp_path, columns):
    path = tool_logs.mdf(tmp_path / "a.mf4", columns, {"ib": np.arange(N)})
    draft = check(path).draft
    assert "The log holds ib without a valid value." in draft.unsure
    assert "fields: [ia, {ia: -1, ic: -1}, ic]" in draft.text
    found = check(tool_logs.mdf(tmp_path / "b.mf4", columns, {"ib": np.arange(N), "ic": np.arange(N)}))
    assert found.draft is None
    (finding,) = [finding for finding in found.findings if finding.code == "no_draft"]
    assert "(ib, ic without a valid value): write the signals file" in finding


CAPTURES = {  # writer, and how many
    "CSV": (tool_logs.csv, 2),
    "CSV of three": (tool_logs.csv, 3),
    "LabVIEW": (lambda path, c: tool_logs.labview(path, c, parts=2), 2),
    "JSON lines": (tool_logs.json_lines, 2),
    "TwinCAT": (lambda path, c: tool_logs.twincat(path, c, [[*PHASES, "theta"]], comma=True), 3),
    "Parquet": (tool_logs.parquet, 4),
}
SECONDS = {"ROS 2": ("sec", "nanosec"), "ROS 1": ("header.stamp.secs", "header.stamp.nsecs"), "C": ("ts_s", "ts_ns"),
           "Unix": ("tv_sec", "tv_usec")}  # fmt: skip


@pytest.mark.cases
@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("names", SECONDS)
def test_seconds_and_nanoseconds_are_one_time_without_jitter(names, restarts, tmp_path, samples, columns):
    ns = 1_700_000_000_900_000_000 + 100_000 * (np.arange(N) % 4000 if restarts else np.arange(N))
    seconds, part = divmod(ns, 10**9)
    times = dict(zip(SECONDS[names], (seconds, part // 1000 if names == "Unix" else part), strict=True))
    rest = {name: x for name, x in columns.items() if name != "t"}
    path = tool_logs.csv(tmp_path / "a.csv", {**times, **rest}, digits=dict.fromkeys(times, "%.0f"))
    found, _, warnings = drafted(path)
    assert "stamp_jitter" not in [finding.code for finding in check(path).findings]
    assert found.sample_period == pytest.approx(1e-4, rel=1e-6)
    np.testing.assert_allclose(found.i_abc, samples.i_abc, atol=1e-3)
    assert warnings == ["gaps", "time_restarts"] * restarts
    assert found.stamp[0] == ns[0]


@pytest.mark.cases
@pytest.mark.parametrize("writer", CAPTURES)
def test_captures_whose_time_starts_again_are_runs(writer, tmp_path, samples, columns):
    write, parts = CAPTURES[writer]
    again = columns | {"t": np.mod(columns["t"], N / parts * 1e-4 - 1e-9)}
    path = write(tmp_path / "a", columns if writer == "LabVIEW" else again)
    found, _, warnings = drafted(path)
    assert len(found) == N
    np.testing.assert_allclose(found.i_abc, samples.i_abc, atol=1e-3)
    assert found.run_starts.tolist() == [N // parts * k for k in range(parts)]
    assert "time_restarts" in warnings
    assert found.sample_period == pytest.approx(1e-4, rel=1e-6)
    assert not {"stamp_jitter", "gaps"} & {finding.code for finding in check(path).findings}


def test_captures_with_a_header_each_are_runs(tmp_path, samples, columns):
    parts = [{name: x[rows] for name, x in columns.items()} for rows in np.array_split(np.arange(N), 3)]
    parts = [part | {"t": part["t"] - part["t"][0] - 0.01} for part in parts]  # the trigger is at zero
    path = tmp_path / "a.csv"
    path.write_text("".join(",".join(part) + "\n" + tool_logs.table(part) for part in parts))
    found, _, warnings = drafted(path)
    np.testing.assert_allclose(found.i_abc, samples.i_abc, atol=1e-3)
    assert found.run_starts.tolist() == [0, N // 3, 2 * N // 3]
    assert found.sample_period == pytest.approx(1e-4, rel=1e-6)
    assert "time_restarts" in warnings


TDMS = {
    "start of a group": ({name: {"wf_start_time": np.datetime64("2026-01-02T12:00:00.001000", "us")}
                          for name in ("ua", "ub", "uc")}, True),
    "offset of channels in one group": ({name: {"wf_start_offset": 0.005} for name in ("ua", "ub", "uc")}, False),
    "offset of the angle": ({"theta": {"wf_start_offset": 0.0021}}, False),
}  # fmt: skip


@pytest.mark.parametrize("late", TDMS)
@pytest.mark.parametrize("given", ["draft", "file"])
def test_each_waveform_begins_at_its_own_time(late, given, tmp_path, samples, columns):
    properties, groups = TDMS[late]
    entry = next(iter(properties.values()))
    shift = 10 if "wf_start_time" in entry else round(entry["wf_start_offset"] / 1e-4)
    moved = {name: x[shift:] if name in properties else x[: N - shift] for name, x in columns.items()}
    path = tool_logs.tdms(tmp_path / "a.tdms", moved, properties, groups=groups)
    recording = read_recording(path, parse_signals(SIGNALS, "x")) if given == "file" else None
    found = drafted(path)[0] if recording is None else recording.samples
    assert_same(found, samples, missing=2 * shift)
    if recording is None:
        assert "time_shift" not in [finding.code for finding in check(path).findings]


LATER = {  # writer of logs whose voltages begin later, and by how many samples
    "MDF": (lambda path, c: tool_logs.mdf_groups(path, c, 17e-4), 17),
    "TwinCAT": (lambda path, c: tool_logs.twincat(
        path, c, [["ia", "ib", "ic", "theta"], ["ua", "ub", "uc"]], comma=False, late=1e-3), 10),
    "TwinCAT with decimal commas": (lambda path, c: tool_logs.twincat(
        path, c, [["ia", "ib", "ic", "theta"], ["ua", "ub", "uc"]], comma=True, late=42e-4), 42),
}  # fmt: skip


@pytest.mark.parametrize("tool", LATER)
def test_each_group_begins_at_its_own_time(tool, tmp_path, samples, columns):
    write, shift = LATER[tool]
    moved = {name: x[shift:] if name[0] == "u" else x[: N - shift] for name, x in columns.items()}
    path = write(tmp_path / "a", moved)
    found, draft, _ = drafted(path)
    assert_same(found, samples, missing=2 * shift)
    assert "angle_offset: 0 " in draft.text  # where the draft took the groups for simultaneous, it turned the angle
    assert "time_shift" not in [finding.code for finding in check(path).findings]


@pytest.mark.parametrize("names", [("Time(i)", "Time(u)", "Time(theta)"), ("ti", "tu", "tth"), ("t", "t (2)", "t (3)")])
@pytest.mark.parametrize(("later", "every"), [(37, 1), (0, 2)])
def test_signals_that_have_a_time_of_their_own_each_are_read_at_it(names, later, every, tmp_path, samples, columns):
    """The first one was taken for all, and the voltages were told to act 37 samples later."""
    table = dict(zip(names, [columns["t"]] * 3, strict=True)) | columns
    last = (names[2], "theta")
    blank = np.full(N, np.nan)
    for name in last:
        table[name] = np.append(table[name][later::every], blank)[: N - later]
    order = [names[0], *PHASES[:3], names[1], *PHASES[3:], *last]
    path = tool_logs.csv(tmp_path / "a.csv", {name: table[name][: N - later] for name in order})
    found, draft, _ = drafted(path)
    assert_same(found, samples, missing=2 * later)
    assert "angle_offset: 0 " in draft.text
    assert "time_shift" not in [finding.code for finding in check(path).findings]


def test_phases_that_begin_at_different_times_are_refused(tmp_path, columns):
    path = tool_logs.tdms(tmp_path / "a.tdms", columns, {"ic": {"wf_start_offset": 0.001}}, groups=True)
    with pytest.raises(DriveIdError, match=r"columns of section 'currents' \(ia, ib, ic\) have different times"):
        read_recording(path, parse_signals(SIGNALS, "x"))


DUTY = {
    "percent": (100.0, ("duty_a", "duty_b", "duty_c"), "U_dc/100"),
    "percent without names": (100.0, ("ch4", "ch5", "ch6"), "U_dc/100"),
    "permille": (1000.0, ("d1", "d2", "d3"), "U_dc/1000"),
    "percent of another tool": (100.0, ("PWM_U", "PWM_V", "PWM_W"), "U_dc/100"),
    "counts of a smaller timer": (4200.0, ("TIM1_1", "TIM1_2", "TIM1_3"), "U_dc/4200"),
    "counts of a timer": (8400.0, ("CCR1", "CCR2", "CCR3"), "U_dc/8400"),
}


@pytest.mark.parametrize("kind", DUTY)
@pytest.mark.parametrize("link", [False, True])
def test_duty_cycles_are_no_volts_and_no_dc_link(kind, link, tmp_path, samples, columns):
    full, names, said = DUTY[kind]
    u_dc = 400.0 + (np.sin(np.arange(N)) if link else 0.0)
    duties = {name: full * (columns[f"u{phase}"] / u_dc + 0.5) for name, phase in zip(names, "abc", strict=True)}
    duties = {name: np.rint(x) for name, x in duties.items()} if full > 1000 else duties
    rest = {name: x for name, x in columns.items() if name[0] != "u"}
    rest |= {"u_dc": u_dc} if link else {}
    path = tool_logs.csv(tmp_path / "a.csv", {**rest, **duties, "n_rpm": np.full(N, 500.0)})
    found, draft, warnings = drafted(path)
    assert_same(found, samples, volts=0.05 if full <= 1000 else 0.3)
    assert ("guessed_setting" in warnings) == (not link)
    assert (f"# EDIT: {said}" in draft.text) == (not link)
    assert "pole_pairs: 4               # by n_rpm, in rpm of the shaft" in draft.text


PERCENT = {  # writers of logs of duty cycles without a DC link, of whose columns some are named by number
    "semicolons, decimal commas, no names": lambda path, c: tool_logs.csv(
        path, dict(zip(["zeit", *(f"ch{k}" for k in range(1, 9))], c.values(), strict=True)), ";", comma=True),
    "LabVIEW": tool_logs.labview,
    "PicoScope": lambda path, c: tool_logs.picoscope(path, c, ["s", *"AAA", *"%%%", "deg", "rpm"]),
    "TwinCAT": lambda path, c: tool_logs.twincat(path, c, [list(c)[1:4], list(c)[4:7], list(c)[7:]], comma=True),
}  # fmt: skip


@pytest.mark.parametrize("tool", PERCENT)
def test_percent_in_the_dialect_of_a_tool(tool, tmp_path, samples, columns):
    """With an electrical angle in degrees, and the speed of the shaft."""
    duties = {f"Duty_{phase}": 100 * (columns[f"u{phase}"] / 400 + 0.5) for phase in "abc"}
    currents = {name: columns[name] for name in ("t", *PHASES[:3])}
    path = PERCENT[tool](
        tmp_path / "a", currents | duties | {"angle": np.degrees(columns["theta"]), "rpm": np.full(N, 500.0)}
    )
    found, draft, warnings = drafted(path)
    assert_same(found, samples)
    assert "guessed_setting" in warnings
    assert "scale: 4  # EDIT: U_dc/100" in draft.text
    assert "angle_unit: deg" in draft.text
    said = "# no field is the speed of this angle" if "no names" in tool else "pole_pairs: 4               # by "
    assert said in draft.text, "a constant without a name is some multiple of any constant speed"


@pytest.mark.parametrize(("name", "scaled"), [("mod_a", True), ("duty_u", True), ("pwm_voltage_a", False)])
def test_percent_around_zero_is_told_from_volts_by_its_name(name, scaled, tmp_path, samples, columns):
    phases = "uvw" if name.endswith("u") else "abc"
    percent = {name[:-1] + phase: 200 / 400 * columns[f"u{abc}"] for phase, abc in zip(phases, "abc", strict=True)}
    rest = {key: x for key, x in columns.items() if key[0] != "u"}
    path = tool_logs.csv(tmp_path / "a.csv", {**rest, **percent, "u_dc": np.full(N, 400.0)})
    found, _, _ = drafted(path)
    got = frames.space_vector(found.u_abc)
    true = frames.space_vector(samples.u_abc)[: len(found)]
    np.testing.assert_allclose(got, true if scaled else true / 2, atol=0.05)


def test_a_guessed_period_is_told_by_the_fit(tmp_path, columns):
    rest = {name: x for name, x in columns.items() if name != "t"}
    found, draft, warnings = drafted(tool_logs.csv(tmp_path / "a.csv", rest))
    assert "sample_period: 0.0001         # EDIT" in draft.text
    assert len(found) == N
    assert "guessed_setting" in warnings


@pytest.mark.parametrize("shift", [-50, -10, 3, 10, 50])
@pytest.mark.parametrize("period", [5e-5, 1e-4, 2e-4])
def test_a_shift_in_time_is_found_at_any_period(shift, period, samples):
    from drive_id.core.checks.prescan import Prescan

    prescan = Prescan()
    late = replace(
        samples, u_abc=np.roll(samples.u_abc, -shift, axis=0), sample_period=period,
        speed=samples.speed * 1e-4 / period, stamp=np.rint(np.arange(N) * period * 1e9).astype(np.int64),
    ).part(60, N - 60)  # fmt: skip
    prescan.add(late)
    (finding,) = [finding for finding in prescan.findings() if finding.code == "time_shift"]
    assert finding.values["delay"] == pytest.approx(shift, abs=1.5)


FOREIGN = {
    "Excel": ("a.xlsx", b"PK\3\4", None),
    "a pickle": ("a.pkl", b"\x80\x05\x95", "save it with to_parquet"),
    "an array": ("a.npy", b"\x93NUMPY\1\0", "numpy.savez"),
    "bzip2": ("a.csv.bz2", b"BZh91AY", "unpack it"),
    "an oscilloscope": ("a.bin", b"AG10\0\0", "export it from its tool as CSV"),
    "unknown": ("a.wfm", b"\1\2\3\0\0", "export the log as CSV or Parquet"),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_what_is_not_read_is_named_with_the_way_out(kind, tmp_path):
    name, head, remedy = FOREIGN[kind]
    path = tmp_path / name
    path.write_bytes(head + bytes(100))
    if kind == "Excel":
        import zipfile

        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("[Content_Types].xml", "<x/>")
            archive.writestr("xl/sheet1.xml", "<x/>")
        remedy = "save its sheet as CSV"
    with pytest.raises(BagError, match=remedy):
        check(path)


OBJECTS = {
    "table": r"s = table2struct\(T, 'ToScalar', true\)\.$",
    "timetable": r"timetable2table\(T, 'ConvertRowTimes', false\).*s\.time = seconds\(T\.Properties\.RowTimes",
    "timeseries": r"save a struct of its time and data instead",
}


@pytest.mark.parametrize("write", [tool_logs.matlab_object, tool_logs.matlab_object_73])
@pytest.mark.parametrize("kind", OBJECTS)
@pytest.mark.parametrize("beside", [False, True])
def test_objects_of_matlab_are_named_with_the_way_out(write, kind, beside, tmp_path):
    """Whatever small arrays are beside them."""
    path = write(tmp_path / "a.mat", kind, {"gains": np.arange(4.0)} if beside else {})
    with pytest.raises(
        BagError, match=f"an object of MATLAB's class {kind}, which only MATLAB reads: .*{OBJECTS[kind]}"
    ):
        check(path)


@pytest.mark.cases
@pytest.mark.parametrize("write", [tool_logs.matlab_object, tool_logs.matlab_object_73])
@pytest.mark.parametrize("kind", OBJECTS)
def test_an_object_of_matlab_beside_a_whole_recording_does_no_harm(write, kind, tmp_path, samples, columns):
    whole = write(tmp_path / "whole.mat", kind, columns)
    assert_same(drafted(whole)[0], samples)
    told = {finding.code for finding in check(whole).findings}
    assert ("memory" in told) == (write is tool_logs.matlab_object)  # of version 5, held as a whole


def test_the_content_tells_the_kind_not_the_name(tmp_path, columns):
    path = tool_logs.csv(tmp_path / "log.weird", columns)
    assert log_kind(path) == "csv"
    assert len(drafted(path)[0]) == N


def vesc(path, *, coasting=0, period=0.02):
    """Write operating points of a machine with R = 20 mOhm, L_d = 20 uH, L_q = 30 uH and 12 mWb."""
    rng = np.random.default_rng(3)
    angle, radius = rng.uniform(0, 2 * np.pi, 80), 60 * np.sqrt(rng.uniform(0, 1, 80))
    i_dq = np.repeat(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]), 25, axis=0)
    erpm = np.repeat(rng.choice([3000.0, 6000.0, -3000.0], 80), 25)
    w = erpm * 2 * np.pi / 60
    u_dq = 0.02 * i_dq + np.column_stack([-w * 30e-6 * i_dq[:, 1], w * (12e-3 + 20e-6 * i_dq[:, 0])])
    i_dq[:coasting], u_dq[:coasting] = 0.0, 0.0
    return tool_logs.vesc_tool(path, i_dq, u_dq, erpm, period=period), i_dq[coasting:], erpm[coasting:]


@pytest.mark.parametrize(("coasting", "period"), [(0, 0.02), (0, 0.01), (500, 0.02)])
def test_vesc_tool_logs_get_a_draft_for_static(coasting, period, tmp_path):
    path, i_dq, erpm = vesc(tmp_path / "2026-01-02.csv", coasting=coasting, period=period)
    draft = check(path).draft
    assert draft is not None
    assert draft.static
    assert "pole_pairs" not in draft.text  # the speed is electrical
    assert draft.text.count("EDIT: times 0.8165") == 2
    log = read_operating_log(path, parse_signals(draft.text, "the draft"))
    np.testing.assert_allclose(log.data.i_dq, i_dq, atol=1e-6)
    np.testing.assert_allclose(log.data.speed, erpm * np.pi / 30)
    assert log.data.period == pytest.approx(period)
    assert ("inverter_off" in [warning.code for warning in log.warnings]) == bool(coasting)


SLOW = {  # how a slow log is written otherwise
    "commas": lambda text: text.replace(";\n", "\n").replace(";", ","),
    "decimal commas": lambda text: text.replace(".", ","),
    "names of another tool": lambda text: text.replace("ms_today", "Time [ms]").replace("erpm", "ERPM")
    .replace("d_axis_current", "Id").replace("q_axis_current", "Iq")
    .replace("d_axis_voltage", "Vd").replace("q_axis_voltage", "Vq"),
}  # fmt: skip


@pytest.mark.parametrize("how", SLOW)
def test_slow_logs_of_other_tools_get_a_draft_for_static(how, tmp_path):
    path, i_dq, erpm = vesc(tmp_path / "a.csv")
    path.write_text(SLOW[how](path.read_text()))
    draft = check(path).draft
    assert draft.static
    log = read_operating_log(path, parse_signals(draft.text, "the draft"))
    np.testing.assert_allclose(log.data.i_dq, i_dq, atol=1e-6)
    np.testing.assert_allclose(log.data.speed, erpm * np.pi / 30)
    assert log.data.period == pytest.approx(0.02)


UNITS = {
    "brackets": ("i{} [mA]", 1e3, "u{} [kV]", 1e-3),
    "parentheses": ("i{} (kA)", 1e-3, "u{} (mV)", 1e3),
    "ends of names": ("i{}_mA", 1e3, "u{}_mV", 1e3),
    "slashes": ("I{}/mA", 1e3, "U{} / kV", 1e-3),
    "the base": ("i{} [A]", 1.0, "u{}_V", 1.0),
}


@pytest.mark.parametrize("kind", UNITS)
def test_units_in_the_names_of_columns_are_used(kind, tmp_path, samples, columns):
    i_name, i_factor, u_name, u_factor = UNITS[kind]
    renamed = {"t": columns["t"], "theta": columns["theta"]}
    for phase in "abc":
        renamed[i_name.format(phase)] = i_factor * columns[f"i{phase}"]
        renamed[u_name.format(phase)] = u_factor * columns[f"u{phase}"]
    found, draft, _ = drafted(tool_logs.csv(tmp_path / "a.csv", renamed))
    assert_same(found, samples)
    assert "EDIT" not in draft.text  # kV are no duty cycles


TIMES = {  # of each row, by its number, what of it is a guess, and the period that the draft takes by 0.1 ms
    "ticks of 100 ns": (lambda k: 1000 * k, "stamp_unit: us", 10.0),
    "ticks of a timer of 32 bits": (lambda k: (8400 * k + 2**32 - 8_400_000) % 2**32, "stamp_unit: ns", 0.084),
    "us without a unit": (lambda k: 50.0 * k, "stamp_unit: us", 0.5),
    "numbers of rows": (lambda k: k, "sample_period: 0.0001", 1.0),
    "us since 1970": (lambda k: 1_790_000_000_000_000 + 100 * k, "", 1.0),
    "ms since 1970": (lambda k: 1_790_000_000_000 + k, "", 10.0),
    "days since 1900": (lambda k: 46_000.4 + k / 864e6, "", 1.0),
    "seconds since 1904": (lambda k: 3.87e9 + 1e-4 * k, "", 1.0),
    "ms without a unit": (lambda k: 0.1 * k, "", 1.0),
}


@pytest.mark.parametrize("kind", TIMES)
def test_a_time_of_which_nothing_tells_the_unit_is_a_guess(kind, tmp_path, columns):
    """Flux linkages were ten times too large without a mark, and dates of two clocks were refused."""
    made, setting, period = TIMES[kind]
    table = columns | {"t": made(np.arange(N))}
    path = tool_logs.csv(tmp_path / "a.csv", table, digits={"t": "%.17g"})
    signals = parse_signals(check(path).draft.text, "the draft")
    found = read_recording(path, signals)
    assert found.samples.sample_period == pytest.approx(period * 1e-4, rel=1e-3)
    assert len(found.samples.run_starts) == 1
    assert [message.values["setting"] for message in found.warnings] == [setting] * bool(setting)


def tdms_milli(path, c):
    units = {name: {"unit_string": "mA"} for name in PHASES[:3]}
    return tool_logs.tdms(path, milli(c), units, groups=False)


def milli(c):
    return c | {name: 1e3 * c[name] for name in PHASES[:3]}


def mdf_milli(path, c):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(x, c["t"], name=name, unit="mA" if name in PHASES[:3] else "")
                     for name, x in milli(c).items() if name != "t"])  # fmt: skip
        return file.save(path, overwrite=True)


def hdf5_milli(path, c):
    import h5py

    with h5py.File(path, "w") as file:
        for name, x in milli(c).items():
            file.create_dataset(name, data=x).attrs["units"] = "mA" if name in PHASES[:3] else ""
    return path


DECLARED = {"a.tdms": tdms_milli, "a.mf4": mdf_milli, "a.h5": hdf5_milli}


@pytest.mark.parametrize("name", DECLARED)
def test_units_that_a_container_declares_are_used(name, tmp_path, samples, columns):
    """Currents were 1000 times too large, without a mark where they are small."""
    small = columns | {name: 0.01 * columns[name] for name in PHASES[:3]}
    found, draft, _ = drafted(DECLARED[name](tmp_path / name, small))
    np.testing.assert_allclose(found.i_abc[10], 0.01 * samples.i_abc[10], atol=1e-3)
    assert "scale: 0.001" in draft.text
    assert "EDIT" not in draft.text


def test_dates_that_are_the_index_of_pandas_are_read(tmp_path, samples, columns):
    """The file was called damaged; dates in us at 20 kHz passed for times in us."""
    import pandas as pd

    times = pd.Timestamp("2026-01-02") + pd.to_timedelta(50 * np.arange(N), unit="us")
    table = pd.DataFrame({name: x for name, x in columns.items() if name != "t"}, index=times.as_unit("us"))
    table.rename_axis("timestamp").to_parquet(tmp_path / "a.parquet")
    found, draft, _ = drafted(tmp_path / "a.parquet")
    assert_same(found, samples, 5e-5)
    assert "EDIT" not in draft.text


def test_a_refusal_names_what_is_still_a_guess(tmp_path, columns):
    """A fit by a wrong guess asked for a longer recording."""
    path = tool_logs.csv(tmp_path / "a.csv", columns)
    guess = SIGNALS.replace(
        "voltages: {fields: [ua, ub, uc]}", "voltages:\n  fields: [ua, ub, uc]\n  scale: 1e-3  # EDIT"
    )
    signals = parse_signals("defaults: {stamp: t, stamp_unit: s}\n" + guess, "x")
    with pytest.raises(
        DriveIdError, match=r"they are duty cycles.* scale: 1e-3 in line 5 .* is a guess from the draft"
    ):
        drive_id.fit(path, signals=signals)


LINKS = {"mV by name": ("Vbus_mV", 1e3, 1e-3), "kV by name": ("Udc [kV]", 1e-3, 1e3), "tenths": ("udc", 10.0, None),
         "readings": ("vbus_raw", 51.0, None)}  # fmt: skip


@pytest.mark.parametrize("kind", LINKS)
def test_the_unit_of_a_dc_link_is_that_of_its_name_or_a_guess(kind, tmp_path, columns):
    name, factor, scale = LINKS[kind]
    u_dc = 64 + np.sin(0.01 * np.arange(N))
    duties = {f"d{phase}": columns[f"u{phase}"] / u_dc + 0.5 for phase in "abc"}
    rest = {key: x for key, x in columns.items() if key[0] != "u"}
    link = {name: np.rint(factor * u_dc) if factor > 1 else factor * u_dc}
    _, draft, warnings = drafted(tool_logs.csv(tmp_path / "a.csv", rest | duties | link))
    signals = parse_signals(draft.text, "the draft")
    assert (signals.voltages.scale.scale, signals.optional["dc_link_voltage"].scale) == (scale or 1.0, scale or 1.0)
    assert warnings == ["guessed_setting"] * (0 if scale else 2)  # where it scales, and where it is a signal


def scaled(c, factor, *, offset=0.0, whole=False):
    u = {f"u{phase}": factor * c[f"u{phase}"] + offset for phase in "abc"}
    return c | {name: np.rint(x) for name, x in u.items()} if whole else c | u


def components(c):
    z = sum(c[f"u{phase}"] * np.exp(2j * np.pi / 3 * k) for k, phase in enumerate("abc")) * 2 / 3
    return {name: x for name, x in c.items() if name[0] != "u"} | {"U_ALPHA": z.real, "U_BETA": z.imag}


OPEN = {  # columns, and what of the scale of the voltages or currents is a guess
    "currents by a rated one": (
        lambda c: c | {f"i{phase}": c[f"i{phase}"] / 300 for phase in "abc"},
        "no shares of a rated current",
    ),
    "tenths of volts": (lambda c: scaled(c, 10, whole=True), "V per count"),
    "voltages by the DC link": (lambda c: scaled(c, 1 / 80), "twice that for voltages over the DC-link voltage"),
    "duty cycles beyond any of these": (lambda c: scaled(c, 1 / 36), ""),
    "components": (components, "times 0.8165 if these components are power-invariant"),
}


@pytest.mark.parametrize("kind", OPEN)
def test_a_scale_that_no_data_show_is_a_guess(kind, tmp_path, columns):
    made, said = OPEN[kind]
    table = made(columns) | {"Vbus": 80.5 + np.sin(0.01 * np.arange(N))}
    _, draft, warnings = drafted(tool_logs.csv(tmp_path / "a.csv", table))
    marked = [line for line in draft.text.splitlines() if "EDIT" in line]
    assert len(marked) == len(warnings) == bool(said)
    assert all("scale" in line and said in line for line in marked)


@pytest.mark.parametrize("order", ["iaibicuaubuc", "uaubuciaibic", "iauaibubicuc", "uaiaubibucic"])
def test_currents_and_voltages_of_one_name_are_told_by_their_values(order, tmp_path, samples, columns):
    """Two sets of columns a, b, c, one behind the other or in turn; what follows from values is marked as not sure."""
    names = [order[k : k + 2] for k in range(0, len(order), 2)]
    header = ",".join(["t", *(name[1] for name in names), "theta"])
    rows = tool_logs.table({name: columns[name] for name in ("t", *names, "theta")})
    (tmp_path / "a.csv").write_text(f"{header}\n{rows}")
    found, draft, _ = drafted(tmp_path / "a.csv")
    assert_same(found, samples)
    assert "NOT SURE" in draft.text
    assert "by their values, not by their names" in draft.text
    assert "between phases" not in draft.text


def test_units_in_the_names_of_a_slow_log_are_used(tmp_path):
    path, i_dq, _ = vesc(tmp_path / "a.csv")
    text = path.read_text().split("\n", 1)
    names = text[0].replace("d_axis_current", "id_kA").replace("q_axis_current", "iq_kA")
    names = names.replace("d_axis_voltage", "vd_mV").replace("q_axis_voltage", "vq_mV")
    path.write_text(f"{names}\n{text[1]}")
    draft = check(path).draft
    log = read_operating_log(path, parse_signals(draft.text, "the draft"))
    np.testing.assert_allclose(log.data.i_dq, 1e3 * i_dq, atol=1e-3)
    assert np.abs(log.data.u_dq).max() < 0.1


def test_a_result_of_other_recordings_is_not_replaced(tmp_path, columns):
    first = tool_logs.csv(tmp_path / "one.csv", columns)
    other = tool_logs.csv(tmp_path / "two.csv", columns | {"ia": columns["ia"] + 1e-3})
    signals = parse_signals("defaults: {stamp: t, stamp_unit: s}\n" + SIGNALS, "x")
    how = {"signals": signals, "method": "psm", "output": tmp_path / "out"}
    drive_id.fit(first, **how)
    before = (tmp_path / "out" / "identification.json").read_bytes()
    with pytest.raises(OutputError, match=r"holds the result of one.csv, and not of two.csv: give another .* --force"):
        drive_id.fit(other, **how)
    assert (tmp_path / "out" / "identification.json").read_bytes() == before
    drive_id.fit(first, **how)
    drive_id.fit(other, **how, force=True)
    first.write_bytes(other.read_bytes() + b"\n")
    with pytest.raises(OutputError, match=r"holds the result of two.csv, and not of one.csv"):
        drive_id.fit(first, **how)
