"""The result files: what stands in them, and that they appear whole, in folders of ours only."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from result_folder import forget_digests

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import OutputError, ResultError
from drive_id.files.results import folder as results
from drive_id.files.results.folder import check_absent, check_output, replace_folder
from drive_id.files.results.identification import Provenance, read_results, results_tree, write_results


@pytest.fixture
def written(fitted, tmp_path):
    write_results(tmp_path / "out", fitted.drive, fitted.provenance)
    return tmp_path / "out"


def strict_json(path: Path):
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_the_flux_map_is_as_agreed(written, fitted):
    with np.load(written / "flux_map.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    scalars = {
        name: arrays.pop(name)
        for name in (
            "resistance", "i_max", "pole_pairs", "u_dc", "speed_range", "duration", "method", "machine", "date",
            "version", "units", "serial", "bench", "operator", "notes",
        )
    }  # fmt: skip
    modes = {name.removeprefix("modes_"): arrays.pop(name) for name in list(arrays) if name.startswith("modes_")}
    assert set(arrays) == {"i_d", "i_q", "psi_d", "psi_q", "sigma_d", "sigma_q", "inside"}
    assert set(modes) == {"psi_d", "psi_q", "resistance", "inverter_voltage", "voltage_error"}
    for name in ("psi_d", "psi_q"):
        assert modes[name].dtype == np.float32
        error = np.linalg.norm(modes[name], axis=0)
        np.testing.assert_allclose(error, np.nan_to_num(arrays[name.replace("psi", "sigma")]), rtol=1e-5)
    assert np.linalg.norm(modes["resistance"]) == pytest.approx(fitted.sigma_resistance, rel=1e-5)
    assert np.linalg.norm(modes["voltage_error"]) == pytest.approx(fitted.sigma_voltage_error, rel=1e-5)
    assert (scalars["resistance"], scalars["i_max"], scalars["pole_pairs"], scalars["u_dc"]) == (
        fitted.resistance, fitted.i_max, 4, 400.0,
    )  # fmt: skip
    assert (str(scalars["method"]), str(scalars["machine"])) == ("joint", "ipm")
    assert str(scalars["version"]) == json.loads((written / "identification.json").read_text())["versions"]["drive_id"]
    assert set(json.loads(str(scalars["units"]))) <= set(arrays) | set(scalars)
    for name, array in arrays.items():
        assert array.shape == ((65,) if name in ("i_d", "i_q") else (65, 65)), name
        assert array.dtype == (np.bool_ if name == "inside" else np.float64), name
    inside = arrays["inside"]
    for name in ("psi_d", "psi_q"):
        assert np.isfinite(arrays[name]).all()
    for name in ("sigma_d", "sigma_q"):
        assert np.isfinite(arrays[name][inside]).all()
        assert (arrays[name][inside] > 0).all()
        assert np.isnan(arrays[name][~inside]).all()
    k, m = 40, 12  # the first index is i_d
    assert inside[k, m]
    psi = [arrays["psi_d"][k, m], arrays["psi_q"][k, m]]
    np.testing.assert_allclose(psi, fitted.flux_map.psi_dq(arrays["i_d"][k], arrays["i_q"][m]), rtol=1e-12)
    for name, axis in (("psi_d", 0), ("psi_q", 1)):
        both = np.diff(inside.astype(int), axis=axis) == 0
        rising = np.diff(arrays[name], axis=axis)[both & np.delete(inside, -1, axis)] > 0
        assert rising.mean() > 0.95, name


def test_joint_errors_are_read_again_and_may_be_missing(written, fitted):
    modes, again = fitted.drive.error_modes, read_results(written)[0].error_modes
    forget_digests(written)
    for name in ("psi_d", "psi_q", "resistance", "inverter_voltage", "voltage_error"):
        np.testing.assert_allclose(getattr(again, name), getattr(modes, name), rtol=1e-6, err_msg=name)
    with np.load(written / "flux_map.npz") as file:
        arrays = dict(file)
    earlier = {name: values for name, values in arrays.items() if not name.startswith("modes_")}
    np.savez(written / "flux_map.npz", **earlier)
    assert read_results(written)[0].error_modes is None
    for wrong in ({"modes_psi_d": arrays["modes_psi_d"][:, :5]}, {"modes_resistance": np.full(3, np.nan)}):
        np.savez(written / "flux_map.npz", **arrays | wrong)
        with pytest.raises(ResultError, match="error modes that do not fit"):
            read_results(written)
    np.savez(written / "flux_map.npz", **earlier, modes_psi_d=arrays["modes_psi_d"])
    with pytest.raises(ResultError, match="is damaged"):
        read_results(written)


def test_a_map_of_texts_is_refused(written):
    with np.load(written / "flux_map.npz") as file:
        arrays = dict(file)
    forget_digests(written)
    np.savez(written / "flux_map.npz", **arrays | {"sigma_q": arrays["sigma_q"].astype(str)})
    with pytest.raises(ResultError, match="no numbers"):
        read_results(written)


def test_the_identification_is_as_agreed(written, fitted, bag):
    tree = strict_json(written / "identification.json")
    assert set(tree) == {
        "format", "format_version", "method", "machine", "i_max", "resistance", "sigma_resistance", "voltage_error",
        "sigma_voltage_error", "inverter_curve", "harmonics", "calibrations", "metrics", "warnings", "statements",
        "messages", "settings", "inputs", "versions", "pole_pairs", "u_dc", "speed_range", "duration", "date",
        "magnet_coefficient", "torque", "mechanics", "linear_machine", "files", "resistance_temperature", "last_stamp",
        "session",
    }  # fmt: skip
    assert (tree["pole_pairs"], tree["u_dc"], tree["duration"]) == (4, 400.0, pytest.approx(2.0))
    assert tree["speed_range"] == pytest.approx([500 * np.pi / 30 * 4] * 2, rel=1e-5)
    assert datetime.fromisoformat(tree["date"]).tzinfo is not None
    assert (tree["format"], tree["format_version"]) == ("drive_id/identification", 1)
    assert (tree["method"], tree["machine"]) == ("joint", "ipm")
    assert tree["resistance"] == fitted.drive.resistance
    assert tree["voltage_error"] == fitted.drive.voltage_error > 0
    curve = tree["inverter_curve"]
    assert len(curve["current"]) == len(curve["voltage"])
    assert curve["voltage"][-1] == pytest.approx(tree["voltage_error"])
    assert curve["voltage"][0] == pytest.approx(-tree["voltage_error"])
    metrics = tree["metrics"]
    assert set(metrics) == {
        "nrmse_d", "nrmse_q", "samples_read", "samples_used", "gaps", "rows", "parameters", "rank", "unseen",
        "condition", "residual_rms", "mad_d", "mad_q", "coverage",
    }  # fmt: skip
    assert metrics["nrmse_d"] == fitted.provenance.nrmse[0]
    assert metrics["samples_read"] == 20_000
    assert tree["warnings"] == list(fitted.warnings)
    assert tree["settings"] == json.loads(json.dumps(FitSettings(method="joint").__dict__))
    (file,) = bag.glob("*.mcap")
    assert [entry["file"] for entry in tree["inputs"]] == [str(file)]
    assert len(tree["inputs"][0]["sha256"]) == 64
    assert {"drive_id", "python", "numpy", "scipy", "numba"} <= set(tree["versions"])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_becomes_null(fitted, tmp_path, value):
    report = replace(fitted.drive.report, mad_d=value, condition=value)
    broken = replace(
        fitted.drive,
        report=report,
        sigma_resistance=value,
        inverter_voltage=np.full_like(fitted.drive.inverter_voltage, value),
    )
    write_results(tmp_path / "out", broken, replace(fitted.provenance, nrmse=(value, 0.5)))
    tree = strict_json(tmp_path / "out" / "identification.json")
    assert tree["sigma_resistance"] is None
    assert tree["metrics"]["mad_d"] is tree["metrics"]["condition"] is tree["metrics"]["nrmse_d"] is None
    assert tree["metrics"]["nrmse_q"] == 0.5
    assert set(tree["inverter_curve"]["voltage"]) == {None}
    assert tree["resistance"] == fitted.drive.resistance


def test_without_a_truth_there_is_no_score(fitted):
    tree = results_tree(fitted.drive, Provenance(inputs={}, settings=FitSettings(method="joint")))
    assert tree["metrics"]["nrmse_d"] is tree["metrics"]["nrmse_q"] is None
    assert tree["machine"] == ""
    assert tree["warnings"] == list(fitted.drive.report.warnings)


def test_equal_results_are_equal_files(written, fitted, tmp_path):
    write_results(tmp_path / "again", fitted.drive, fitted.provenance)
    for name in ("identification.json", "flux_map.npz"):
        assert (tmp_path / "again" / name).read_bytes() == (written / name).read_bytes()


def test_earlier_results_are_replaced_and_other_files_stay(written, fitted):
    (written / "notes.txt").write_text("mine")
    first = (written / "flux_map.npz").read_bytes()
    other = replace(fitted.drive, resistance=5.0, flux_map=replace(fitted.drive.flux_map))
    other.flux_map.__dict__["psi_d"] = 2 * fitted.drive.flux_map.psi_d
    write_results(written, other, fitted.provenance)
    assert strict_json(written / "identification.json")["resistance"] == 5.0
    assert (written / "flux_map.npz").read_bytes() != first
    assert sorted(path.name for path in written.iterdir()) == ["flux_map.npz", "identification.json", "notes.txt"]


def test_what_is_unknown_is_read_as_unknown(fitted, tmp_path):
    report = replace(fitted.drive.report, mad_d=np.nan, condition=np.inf)
    write_results(
        tmp_path, replace(fitted.drive, report=report, sigma_resistance=np.inf), replace(fitted.provenance, nrmse=None)
    )
    drive, provenance = read_results(tmp_path)
    assert np.isnan(drive.report.mad_d)
    assert drive.report.condition == drive.sigma_resistance == np.inf
    assert provenance.nrmse is None


NEWER = (
    "last_stamp", "session", "pole_pairs", "u_dc", "speed_range", "duration", "date", "magnet_coefficient", "files",
)  # fmt: skip


def test_an_older_result_is_read(written, fitted):
    """One without what later versions added, and with a setting that is no more."""
    marker = written / "identification.json"
    tree = {name: value for name, value in json.loads(marker.read_text()).items() if name not in NEWER}
    tree["settings"]["forgotten"] = 3
    marker.write_text(json.dumps(tree))
    with np.load(written / "flux_map.npz") as file:
        arrays = {name: file[name] for name in ("i_d", "i_q", "psi_d", "psi_q", "sigma_d", "sigma_q", "inside")}
    np.savez(written / "flux_map.npz", **arrays)
    drive, provenance = read_results(written)
    assert drive.resistance == fitted.resistance
    assert [getattr(provenance, name) for name in NEWER[:-2]] == [0, 0, None, None, None, None, ""]


def edited(written, **entries):
    marker = written / "identification.json"
    marker.write_text(json.dumps(json.loads(marker.read_text()) | entries))


def with_large(written, name, at):
    """Put one value of an array far beyond all others."""
    with np.load(forget_digests(written) / "flux_map.npz") as stored:
        arrays = dict(stored)
    arrays[name][at] = 1e300
    np.savez(written / "flux_map.npz", **arrays)


def with_curve(written, change):
    """Change an entry of the inverter curve, as rows that are lost from its lists do."""
    curve = json.loads((written / "identification.json").read_text())["inverter_curve"]
    edited(written, inverter_curve=curve | {name: edit(curve[name]) for name, edit in change.items()})


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda written: (written / "identification.json").unlink(), "is not a result folder (it has no "),
        (lambda written: (written / "identification.json").write_text("{"), "is damaged (it is not JSON)"),
        (lambda written: edited(written, format="other"), "is damaged (another format)"),
        (lambda written: edited(written, format_version=2), "was written by a newer drive_id (format 2, "),
        (lambda written: edited(written, inverter_curve=None), "is damaged (a value is of another kind"),
        (lambda written: edited(written, resistance="much"), "is damaged ('much' is no number)"),
        (lambda written: edited(written, resistance_temperature=[]), "is damaged ([] is no number)"),
        (lambda written: edited(written, torque={"gain": "1", "cogging": []}), "is damaged ('1' is no number)"),
        (lambda written: edited(written, u_dc="9" * 40), "is damaged (u_dc is '99"),
        (lambda written: edited(written, pole_pairs=[]), "is damaged (pole_pairs is []"),
        (lambda written: edited(written, pole_pairs=1e308), "is damaged (pole_pairs is 1e+308"),
        (lambda written: edited(written, i_max=-1.0), "is damaged (i_max is -1.0)"),
        (lambda written: edited(written, harmonics=[6]), "is damaged (harmonics.npz: No such file"),
        (lambda written: edited(written, settings={"method": "best"}), "method is 'best': it must be one of"),
        (lambda written: (written / "flux_map.npz").unlink(), "is damaged (flux_map.npz: No such file"),
        (
            lambda written: (written / "flux_map.npz").write_bytes(b"PK"),
            "is damaged (flux_map.npz was not written with its identification.json, as after a kill or ",
        ),
        (lambda written: (forget_digests(written) / "flux_map.npz").write_bytes(b"PK"), "is damaged ("),
        (lambda written: with_large(written, "i_d", 3), "has axes that do not rise"),
        (lambda written: with_large(written, "i_d", -1), "holds currents or fluxes beyond any drive"),
        (lambda written: with_large(written, "psi_q", (2, 3)), "holds currents or fluxes beyond any drive"),
        (lambda written: with_curve(written, {"voltage": lambda x: x[3:]}), "currents and voltages differ in number"),
        (lambda written: with_curve(written, {"current": lambda x: x[::-1]}), "inverter curve's currents do not rise"),
        (
            lambda written: with_curve(written, {"voltage": lambda x: [1e300, *x[1:]]}),
            "inverter curve holds values beyond any drive",
        ),
        (lambda written: with_curve(written, {"voltage": lambda x: ["x", *x[1:]]}), "is damaged ('x' is no number)"),
        (
            lambda written: np.savez(forget_digests(written) / "flux_map.npz", i_d=np.arange(9.0)),
            "is damaged (i_q is missing)",
        ),
    ],
)  # fmt: skip
def test_what_is_not_a_result_is_said_in_one_sentence(written, damage, said):
    damage(written)
    with pytest.raises(ResultError) as caught:
        read_results(written)
    assert said in str(caught.value)
    assert str(written) in str(caught.value)
    assert "\n" not in str(caught.value)


FILES = {"b.bin": b"b", "mark.json": b'{"format": "ours"}'}


def put(directory, files=FILES, **options):
    replace_folder(directory, files, marker="mark.json", kind="ours", **options)


def test_deep_folders_are_made(tmp_path):
    put(tmp_path / "a" / "b" / "c")
    assert {path.name: path.read_bytes() for path in (tmp_path / "a" / "b" / "c").iterdir()} == FILES
    assert [path.name for path in tmp_path.rglob("*")] == [
        "a",
        "b",
        "c",
        *[p.name for p in (tmp_path / "a/b/c").iterdir()],
    ]


def test_an_empty_folder_and_a_link_to_a_folder_are_filled(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    put(tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "empty" / "b.bin").read_bytes() == b"b"
    put(tmp_path / "empty")


def test_the_working_folder_may_be_the_output(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    put(Path())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.bin", "mark.json"]


def test_one_by_one_the_marker_comes_first(tmp_path, monkeypatch):
    """Its digests refuse what is not yet its own."""
    put(tmp_path / "out")
    order = []
    move = Path.replace
    monkeypatch.chdir(tmp_path / "out")
    monkeypatch.setattr(Path, "replace", lambda path, target: order.append(target.name) or move(path, target))
    put(Path(), {"mark.json": b"{}", "z.bin": b"z", "b.bin": b"new"}, stale=["b.bin"])
    assert order[0] == "mark.json"
    assert sorted(order) == ["b.bin", "mark.json", "z.bin"]
    assert sorted(path.name for path in Path().iterdir()) == ["mark.json", "z.bin"]


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("inside", [False, True])
def test_a_failure_half_way_leaves_everything_as_it_was(tmp_path, monkeypatch, existing, inside):
    if existing:
        put(tmp_path / "out")
        monkeypatch.chdir(tmp_path / "out" if inside else tmp_path)
    before = sorted(tmp_path.rglob("*"))
    write = results.write_synced

    def full(path, data):
        if path.name == "mark.json":
            raise OSError(28, "No space left on device")
        write(path, data)

    monkeypatch.setattr(results, "write_synced", full)
    with pytest.raises(OutputError, match="No space left on device"):
        put(tmp_path / "out", {"b.bin": b"new", "mark.json": b""})
    assert sorted(tmp_path.rglob("*")) == before
    if existing:
        assert (tmp_path / "out" / "b.bin").read_bytes() == b"b"


@pytest.mark.parametrize("hindrance", ["no such call", "a parent that is not writable"])
def test_existing_results_need_no_permission_beside_them(tmp_path, monkeypatch, hindrance):
    """The folder may be a mount point, or the only writable one."""
    put(tmp_path / "out")
    inode = (tmp_path / "out").stat().st_ino
    if hindrance == "no such call":
        monkeypatch.setattr(results, "exchanged", lambda *_: False)
    else:
        monkeypatch.setattr(results.os, "access", lambda path, _mode: Path(path) != tmp_path)
    put(tmp_path / "out", FILES | {"b.bin": b"new"})
    assert (tmp_path / "out").stat().st_ino == inode
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == FILES | {"b.bin": b"new"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_else_is_in_the_folder_stays(tmp_path):
    out = tmp_path / "out"
    put(out, FILES | {"old.bin": b"old"})
    (out / "notes" / "deep").mkdir(parents=True)
    (out / "notes" / "deep" / "b.bin").write_text("of the same name")
    (out / "link").symlink_to("nowhere")
    out.chmod(0o750)
    put(out, FILES | {"b.bin": b"new"}, stale=["old.bin"])
    assert out.stat().st_mode & 0o777 == 0o750
    assert (out / "notes" / "deep" / "b.bin").read_text() == "of the same name"
    assert (out / "link").readlink() == Path("nowhere")
    assert sorted(path.name for path in out.iterdir()) == ["b.bin", "link", "mark.json", "notes"]
    assert (out / "b.bin").read_bytes() == b"new"


def test_files_and_names_are_on_the_disk_before_they_are_seen(tmp_path, monkeypatch):
    put(tmp_path / "out")
    synced, exchange, sync = [], results.exchanged, results.sync_folder
    monkeypatch.setattr(results, "sync_folder", lambda folder: synced.append(folder.name) or sync(folder))
    monkeypatch.setattr(results, "exchanged", lambda one, other: synced.append("exchange") or exchange(one, other))
    put(tmp_path / "out")
    assert synced == ["results", "exchange", tmp_path.name]


KILLS = """
import os, random, signal, sys, time
from pathlib import Path
from drive_id.files.results.folder import FORMAT, MARKER, replace_folder
from drive_id.files.results.identification import read_results

base, rounds = Path(sys.argv[1]), int(sys.argv[2])
contents = [{path.name: path.read_bytes() for path in (base / name).iterdir()} for name in ("one", "two")]
seen = set()
for k in range(rounds):
    children = []
    for first in (k, k + 1):  # two fits into one folder
        if not (child := os.fork()):
            while True:
                for content in (contents[first % 2], contents[1 - first % 2]):
                    replace_folder(base / "out", content, marker=MARKER, kind=FORMAT)
        children.append(child)
    time.sleep(random.uniform(0.002, 0.03))
    for child in children:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    if not (base / "out").exists():
        continue
    found = {path.name: path.read_bytes() for path in (base / "out").iterdir()}
    assert found in contents, sorted(found)
    seen.add(read_results(base / "out")[0].resistance)
print(len(seen))
"""


@pytest.mark.process
def test_a_kill_leaves_the_old_or_the_new(written, fitted, tmp_path):
    """Of two fits that write into one folder, killed at random moments: 200 kills."""
    written.rename(tmp_path / "one")
    write_results(tmp_path / "two", replace(fitted.drive, resistance=5.0), fitted.provenance)
    ran = subprocess.run(
        [sys.executable, "-c", KILLS, tmp_path, "100"], capture_output=True, text=True, timeout=120, check=False
    )
    assert (ran.stdout.strip(), ran.returncode) == ("2", 0), ran.stderr


def test_a_folder_in_the_way_of_a_file(tmp_path):
    (tmp_path / "out" / "b.bin").mkdir(parents=True)
    with pytest.raises(OutputError, match="cannot be written"):
        put(tmp_path / "out", force=True)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["b.bin"]


def test_an_unreadable_folder(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()

    def denied(_path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", denied)
    with pytest.raises(OutputError, match="Permission denied"):
        check_output(tmp_path / "out")


def test_what_is_new_must_not_exist(tmp_path):
    check_absent(tmp_path / "new" / "deeper")
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to("nowhere")
    for name in ("file", "dangling", "."):
        with pytest.raises(OutputError, match="exists already"):
            check_absent(tmp_path / name)
    with pytest.raises(OutputError, match="because of"):
        check_absent(tmp_path / "file" / "below")
    with pytest.raises(OutputError, match="File name too long"):
        check_absent(tmp_path / ("x" * 300))
