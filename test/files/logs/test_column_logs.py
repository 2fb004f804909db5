"""One recording in every container gives the same numbers, at once and part by part; damage is one sentence."""

from __future__ import annotations

import builtins
import contextlib
import gc
import os
from dataclasses import replace

import h5py
import numpy as np
import pytest
from bag_samples import assert_equal_samples, make_samples
from column_files import WRITERS, write_csv, write_mdf, write_tdms
from scipy.io import savemat

from drive_id.core.signals.join import joined
from drive_id.errors import (
    BagError,
    ConfigurationError,
    DriveIdError,
    MessageTypeError,
    MissingTopicError,
    NotABagError,
)
from drive_id.files.logs import column_log
from drive_id.files.logs.open_log import open_log
from drive_id.files.logs.tables import csv_dialect
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.info import bag_info
from drive_id.files.read.reader import bag_pieces
from drive_id.files.read.several import read_recording
from drive_id.fitting.sources import Sources, radius_of

N = 5000


@pytest.fixture(scope="module")
def samples():
    made = make_samples(N, gap_at=2100)
    u_dc = 500 + 20 * np.sin(0.01 * np.arange(N))
    return replace(made, stamp=made.stamp - made.stamp[0], dc_link_voltage=u_dc)


@pytest.fixture(scope="module")
def columns(samples):
    phases = {f"{name}_{phase}": x[:, k] for name, x in (("i", samples.i_abc), ("d", samples.u_abc / 600))
              for k, phase in enumerate("abc")}  # fmt: skip
    rotor = {"theta": samples.angle, "omega": samples.speed, "u_dc": samples.dc_link_voltage}
    references = {"id_ref": samples.i_dq_reference[:, 0], "iq_ref": samples.i_dq_reference[:, 1]}
    return {"time_s": samples.stamp * 1e-9, **phases, **rotor, **references}


def signals(prefix="", stamp="stamp: {p}time_s, stamp_unit: s,", speed=True):
    text = f"""
defaults: {{{stamp.format(p=prefix)} sample_period: 1e-4}}
currents: {{fields: ["{prefix}i_a", "{prefix}i_b", "{prefix}i_c"]}}
voltages: {{fields: ["{prefix}d_a", "{prefix}d_b", "{prefix}d_c"], scale: {{field: "{prefix}u_dc"}}}}
resolver: {{angle: "{prefix}theta"{f', speed: "{prefix}omega"' if speed else ""}}}
reference: {{fields: ["{prefix}id_ref", "{prefix}iq_ref"]}}
optional: {{dc_link_voltage: {{field: "{prefix}u_dc"}}}}
"""
    return parse_signals(text, "test")


def mapped(name):
    writer, prefix = WRITERS[name]
    return writer, signals(prefix, *([""] if name == "log.mf4" else []))


@pytest.mark.parametrize("name", WRITERS)
def test_the_numbers_are_those_of_the_recording(name, tmp_path, samples, columns, monkeypatch):
    monkeypatch.setattr("drive_id.files.read.reader._LOCKING_PAIRS", 100)
    writer, signal_map = mapped(name)
    path = writer(tmp_path / name, columns)
    found = read_recording(path, signal_map).samples
    np.testing.assert_array_equal(found.stamp, samples.stamp)
    np.testing.assert_array_equal(found.run_starts, samples.run_starts)
    for what in ("i_abc", "angle", "speed", "i_dq_reference", "dc_link_voltage"):
        np.testing.assert_allclose(getattr(found, what), getattr(samples, what), rtol=1e-12, err_msg=what)
    np.testing.assert_allclose(found.u_abc, samples.u_abc / 600 * samples.dc_link_voltage[:, None], rtol=1e-12)
    true = column_log.ColumnLog.parts
    monkeypatch.setattr(column_log.ColumnLog, "parts", lambda log, wanted, rows=700: true(log, wanted, rows))
    assert_equal_samples(joined(list(bag_pieces(path, signal_map))), found)
    largest = np.hypot(*samples.i_dq_reference.T).max()
    assert radius_of(path, Sources([path], signal_map)) == pytest.approx(largest, rel=5e-3)


@pytest.mark.parametrize("name", WRITERS)
def test_long_logs_are_read_part_by_part(name, tmp_path, columns):
    writer, _ = mapped(name)
    with open_log(writer(tmp_path / name, columns)) as log:
        group = max(log.groups, key=lambda group: len(group.columns))
        wanted = [column_log.Column(group.name, column) for column in list(group.columns)[:3]]
        parts = list(log.parts(wanted, 600))
        assert len(parts) >= 8
        assert parts[-1].progress == pytest.approx(1.0)
        for column in wanted:
            whole = np.concatenate([part.values[column] for part in parts])
            key = column.name.replace("log.", "").replace("log/", "")
            np.testing.assert_array_equal(whole, columns[key])
    info = bag_info(tmp_path / name)
    assert {topic.name.split(": ")[-1] for topic in info.topics} >= {column.name for column in wanted}


@pytest.mark.cases
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # asammdf, after it refused a file
@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files_are_refused_in_one_sentence(name, tmp_path, columns):
    writer, signal_map = mapped(name)
    data = writer(tmp_path / name, columns).read_bytes()
    rng = np.random.default_rng(5)
    for k in range(3):
        cut = data[: int(len(data) * rng.uniform(0.01, 0.9))] if k % 2 else None
        if cut is None:
            changed = bytearray(data)
            for at in rng.integers(24, len(data), 200):
                changed[at] = int(rng.integers(256))
            cut = bytes(changed)
        (tmp_path / f"{k}{name}").write_bytes(cut)
        with contextlib.suppress(DriveIdError):  # or it is read: bytes of the samples were changed
            read_recording(tmp_path / f"{k}{name}", signal_map)
    gc.collect()  # what asammdf leaves behind


def test_truncated_channels_are_told_by_us_alone(tmp_path, columns, capfd):
    path = write_tdms(tmp_path / "log.tdms", columns)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(DriveIdError, match=r"cannot be read \(its columns have .* rows\)"):
        read_recording(path, signals())
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("stamp", [np.inf, 1e300])
def test_damaged_stamps_of_channels_are_out_of_range(tmp_path, columns, stamp):
    times = columns["time_s"].copy()
    times[7] = stamp
    path = write_mdf(tmp_path / "log.mf4", {**columns, "time_s": times})
    with pytest.raises(DriveIdError, match="out of range"):
        read_recording(path, signals(stamp=""))


def test_a_missing_library_is_named_with_its_remedy(tmp_path, columns, monkeypatch):
    path = write_tdms(tmp_path / "log.tdms", columns)
    true = builtins.__import__

    def without(name, *arguments, **options):
        if name.startswith("nptdms"):
            raise ModuleNotFoundError("No module named 'nptdms'", name="nptdms")
        return true(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(NotABagError, match=r"nptdms is not installed, which reads it: run pip install 'drive_id\[con"):
        read_recording(path, signals())


def test_columns_are_found_by_name_and_group(tmp_path, columns):
    path = write_csv(tmp_path / "log.csv", columns)
    text = "currents: {{fields: [{a}, i_b]}}\nvoltages: {{fields: [d_a, d_b]}}\nresolver: {{angle: theta}}\n"
    with pytest.raises(MissingTopicError, match="no column 'i_aa' for the currents, did you mean 'i_a'"):
        read_recording(path, parse_signals(text.format(a="i_aa"), "f"))
    with pytest.raises(ConfigurationError, match="Section 'currents' names no time"):
        read_recording(path, parse_signals(text.format(a="i_a"), "f"))
    with pytest.raises(ConfigurationError, match=r"drive-id check .* --draft signals.yaml"):
        read_recording(path)
    with pytest.raises(MissingTopicError, match="has no group 'x' for the currents"):
        read_recording(path, parse_signals("defaults: {group: x, sample_period: 1e-4}\n" + text.format(a="i_a"), "f"))
    counted = read_recording(path, parse_signals("defaults: {sample_period: 2e-4}\n" + text.format(a="i_a"), "f"))
    np.testing.assert_array_equal(counted.samples.stamp, 200_000 * np.arange(N))


def test_channel_groups_of_other_rates(tmp_path, samples, columns):
    """The encoder is a group of its own, at a third of the rate; MDF knows the time of both."""
    from asammdf import MDF, Signal

    t = columns["time_s"]
    with MDF(version="4.10") as file:
        fast = [Signal(columns[name], t, name=name) for name in columns if name[:2] in ("i_", "d_")]
        file.append(fast, acq_name="inverter")
        file.append([Signal(np.unwrap(samples.angle)[::3], t[::3], name="angle")], acq_name="encoder")
        file.append([Signal(np.arange(5.0), np.arange(5.0), name="angle")], acq_name="other")
        file.save(tmp_path / "log.mf4", overwrite=True)
    text = """
currents: {fields: [i_a, i_b, i_c]}
voltages: {fields: [d_a, d_b, d_c]}
resolver: {group: encoder, angle: angle, interpolate: true}
"""
    found = read_recording(tmp_path / "log.mf4", parse_signals(text, "f")).samples
    there = np.isin(samples.stamp, found.stamp)
    assert there.sum() > N - 20
    np.testing.assert_allclose(found.i_abc, samples.i_abc[there], rtol=1e-12)
    away = np.abs(np.exp(1j * found.angle) - np.exp(1j * samples.angle[there]))
    assert away[np.abs(found.stamp - samples.stamp[2100]) > 50 * 100_000].max() < 1e-5  # the angle jumps at the gap
    with pytest.raises(MissingTopicError, match=r"Several groups .* have a column 'angle' \(encoder, other\)"):
        read_recording(tmp_path / "log.mf4", parse_signals(text.replace("group: encoder, ", ""), "f"))


def test_waveforms_of_tdms_have_their_own_time(tmp_path, samples, columns):
    from nptdms import ChannelObject, TdmsWriter

    kept = {name: x[:2100] for name, x in columns.items() if name != "time_s"}
    with TdmsWriter(str(tmp_path / "log.tdms")) as file:
        wave = {"wf_increment": 1e-4, "wf_start_offset": 0.5}
        file.write_segment([ChannelObject("g", name, x, properties=wave) for name, x in kept.items()])
    found = read_recording(tmp_path / "log.tdms", signals(stamp="")).samples
    np.testing.assert_array_equal(found.stamp, 500_000_000 + samples.stamp[:2100])


@pytest.mark.parametrize(
    ("text", "names", "decimal"),
    [
        ("# bench 7\n# 2024-01-01\nt;ia;ib\n0,0;1,5;2\n0,1;1,6;2\n0,2;1,7;2\n", ("t", "ia", "ib"), ","),
        ("t\tia\tib\ns\tA\tA\n0\t1\t2\n1\t1\t2\n2\t1\t2\n", ("t", "ia", "ib"), "."),
        ('"t","i ""u"" [A]"\n0,1e-3\n1,-2E+1\n2,nan\n', ("t", 'i "u" [A]'), "."),
        ("\ufefft, a, a\n0, 1, 2\n1, 1, 2\n2, 3, 4\n", ("t", "a", "a (3)"), "."),
    ],
)
def test_text_files_as_the_world_writes_them(tmp_path, text, names, decimal):
    path = tmp_path / "x.csv"
    path.write_text(text, encoding="utf-8")
    dialect = csv_dialect(path)
    assert (dialect.names, dialect.decimal) == (names, decimal)
    with open_log(path) as log:
        (part,) = log.parts([column_log.Column("", names[1])])
    assert len(part.values[column_log.Column("", names[1])]) == 3


def test_texts_are_no_tables(tmp_path):
    for name, text in (("a.csv", "1,2\n3,4\n"), ("b.txt", "hello\nworld\n"), ("c.csv", "a,b\nx,y\nz,w\n")):
        (tmp_path / name).write_text(text)
        with pytest.raises(MessageTypeError, match="is not a table of numbers"):
            read_recording(tmp_path / name, signals())
    (tmp_path / "d.bin").write_bytes(b"nothing known")
    with pytest.raises(BagError):
        read_recording(tmp_path / "d.bin", signals())


def test_commas_that_separate_and_are_decimal_signs_are_named(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("t,ia,ib\n" + "0,1,1,25,-0,5\n" * 5)
    with pytest.raises(MessageTypeError, match="6 cells below 3 names, as if commas separated columns and were dec"):
        csv_dialect(path)


def test_cells_left_blank_are_no_samples(tmp_path, samples, columns):
    """One table for signals of different rates: the DC link in every tenth row only."""
    sparse = np.where(np.arange(N) % 10 == 0, columns["u_dc"], np.nan)
    path = write_csv(tmp_path / "log.csv", {**columns, "u_dc": sparse})
    found = read_recording(path, signals()).samples
    assert len(found) == N
    np.testing.assert_allclose(found.dc_link_voltage, samples.dc_link_voltage, rtol=5e-3)


def test_mdf_files_are_read_without_loading_others(tmp_path, columns):
    """A CSV file needs no asammdf: the libraries are loaded one by one."""
    import subprocess
    import sys

    path = write_csv(tmp_path / "log.csv", columns)
    write_mdf(tmp_path / "log.mf4", columns)
    code = (
        "import sys; import drive_id; from drive_id.files.logs.open_log import open_log; from pathlib import Path\n"
        "assert not {'pandas', 'asammdf', 'h5py', 'nptdms', 'pyarrow'} & set(sys.modules)\n"
        f"open_log(Path({str(path)!r})).__enter__()\n"
        "assert 'pandas' in sys.modules and not {'asammdf', 'h5py', 'nptdms'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def _virtual(file, name, count, source):
    layout = h5py.VirtualLayout((count,), "f8")
    layout[:] = h5py.VirtualSource(source, "x", (count,))
    file.create_virtual_dataset(name, layout)


def _growing(file, name, count, source):
    layout = h5py.VirtualLayout((count,), "f8", (None,))
    layout[: h5py.h5s.UNLIMITED] = h5py.VirtualSource(source, "x", (count,), maxshape=(None,))[: h5py.h5s.UNLIMITED]
    file.create_virtual_dataset(name, layout)


def _external(file, name, count, source):
    file.create_dataset(name, (count,), "f8", external=[(source, 0, h5py.h5f.UNLIMITED)])


@pytest.mark.parametrize("store", [_virtual, _growing, _external])
def test_samples_in_other_files_are_refused_before_those_are_opened(store, tmp_path, columns):
    """The other file is a FIFO: opening it would wait for ever."""
    os.mkfifo(tmp_path / "fifo")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in columns:
            store(file, f"log/{name}", N, "fifo")
    with pytest.raises(DriveIdError, match=r"is stored in other files, which are not opened: write one file"):
        read_recording(tmp_path / "log.h5", mapped("log.h5")[1])


def test_links_to_other_files_are_no_columns(tmp_path, columns):
    os.mkfifo(tmp_path / "fifo")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in columns:
            file[f"log/{name}"] = h5py.ExternalLink("fifo", "x")
    with pytest.raises(MissingTopicError, match="holds no column of numbers"):
        read_recording(tmp_path / "log.h5", mapped("log.h5")[1])


def test_a_sparse_log_is_refused_by_its_size(tmp_path, columns):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in columns:
            file.create_dataset(f"log/{name}", (10**11,), "f8", chunks=(1 << 16,))
    with pytest.raises(DriveIdError, match="it unpacks to more than 269 MB, too much for its size"):
        read_recording(tmp_path / "log.h5", mapped("log.h5")[1])


@pytest.mark.slow  # a log of the largest size is packed
def test_a_packed_log_is_refused_by_its_size(tmp_path):
    path = tmp_path / "log.mat"
    savemat(path, {"x": np.zeros(1 << 27, np.int8), "y": np.zeros(1 << 28, np.int8)}, do_compression=True)
    with pytest.raises(DriveIdError, match=r"it unpacks to more than .* MB, too much for its size"), open_log(path):
        pass
