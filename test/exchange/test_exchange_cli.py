"""drive-id import, export and compare: what they print, write and refuse."""

from __future__ import annotations

import json

import numpy as np
import pytest
from exchange_machine import AT, I_D, I_Q, PAIRS, RESISTANCE, flux, grids, result

import drive_id
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.trajectories import mtpa
from drive_id.exchange.exports.formats import EXPORTS
from drive_id.files.results.identification import write_results
from drive_id.fitting.simulated import load_machine


@pytest.fixture
def run(run, monkeypatch, tmp_path):
    """Run the command line from the folder of the test."""
    monkeypatch.chdir(tmp_path)
    return run


@pytest.fixture
def drive(tmp_path):
    """Write a result folder of the machine, its inverter without a drop."""
    found = result()
    write_results(tmp_path / "drive", found.drive, found.provenance)
    return tmp_path / "drive"


def machine_file(path):
    psi_d, psi_q = flux(*grids())
    np.savez(path, id=I_D, iq=I_Q, psi_d=psi_d, psi_q=psi_q, R=RESISTANCE, pole_pairs=PAIRS)
    return path


def test_import_writes_a_result_as_fit_does(run, tmp_path):
    machine_file(tmp_path / "motor.npz")
    code, out, err = run("import", "motor.npz", "--output", "imported", "--u-dc", 48, "--machine", "my motor")
    assert (code, err) == (0, "")
    assert "conventions of the file: axis pm" in out
    assert {path.name for path in (tmp_path / "imported").iterdir()} == {
        "identification.json", "flux_map.npz", "flux_map.png",
    }  # fmt: skip
    found = drive_id.load("imported")
    np.testing.assert_allclose(found.flux_map.psi_dq(*AT), flux(*AT), atol=1e-12)
    assert (found.method, found.machine, found.u_dc, found.pole_pairs) == ("imported", "my motor", 48.0, PAIRS)
    code, out, _ = run("info", "imported")
    assert (code, "Imported map" in out, "450 mΩ" in out) == (0, True, True)
    machine = load_machine("imported")
    assert (machine.pole_pairs, machine.resistance) == (PAIRS, RESISTANCE)
    samples = drive_id.simulate(found, seconds=0.05)
    assert np.isfinite(samples.i_abc).all()
    assert mtpa(MachineModel.of(found), 10.0, 5).torque[-1] > 0


def test_import_refuses_in_one_sentence_and_writes_nothing(run, tmp_path):
    i_d, i_q = grids()
    psi_d, psi_q = flux(i_d, i_q)
    rows = np.stack([x.ravel() for x in (i_q, -i_d, psi_q, -psi_d)], axis=-1)  # as SyR-e's axes
    np.savetxt(tmp_path / "sr.csv", rows, delimiter=",", header="Id,Iq,Fd,Fq", comments="")
    columns = ("--columns", "i_d=Id,i_q=Iq,psi_d=Fd,psi_q=Fq")
    code, out, err = run("import", "sr.csv", "--output", "m", *columns)
    assert (code, out) == (1, "")
    assert "it would be plausible with '--axis sr'." in err
    assert err.count("\n") == 1
    assert not (tmp_path / "m").exists()
    code, out, _ = run("import", "sr.csv", "--output", "m", *columns, "--axis", "sr", "--json")
    assert json.loads(out)["sigma_resistance"] is None
    (tmp_path / "others").mkdir()
    (tmp_path / "others" / "file").touch()
    code, _, err = run("import", "sr.csv", "--output", "others", *columns, "--axis", "sr")
    assert (code, "--force" in err) == (1, True)
    assert run("import", "sr.csv", "--output", "others", *columns, "--axis", "sr", "--force", "--quiet")[0] == 0
    for wrong in (
        ("--columns", "i_d"),
        ("--columns", "x=1"),
        ("--resistance", "-1"),
        ("--angle", "x"),
        ("--order", "x"),
    ):
        code, out, err = run("import", "sr.csv", "--output", "never", *wrong)
        assert (code, out, err.count("\n")) == (1, "", 1), wrong
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize("name", ["motulator", "vesc"])
def test_export(run, drive, tmp_path, name):
    file = f"out{EXPORTS[name].suffix}"
    arguments = ("export", drive, "--format", name, "--output", file, "--grid", 21, "--range", -10, 10)
    code, out, err = run(*arguments)
    assert (code, err, EXPORTS[name].title in out) == (0, "", True)
    code, _, err = run(*arguments)
    assert (code, "exists already" in err) == (1, True)
    code, out, _ = run(*arguments, "--force", "--json")
    tree = json.loads(out)
    assert (tree["format"], tree["missing"], len(tree["warnings"])) == (name, 0, int(name == "vesc"))
    if name == "motulator":
        with np.load(tmp_path / file) as content:
            assert np.unique(content["i_s_dq"].real).tolist() == [float(k) for k in range(-10, 11)]
            np.testing.assert_allclose(content["psi_s_dq"][3, 15], complex(*flux(-7.0, 5.0)), atol=2e-4)
    else:
        assert tree["warnings"][0].startswith(
            "The bandwidth is 160 Hz. The gains rest on the smallest incremental inductance within i_max, "
        )


def test_axes_and_gaps(run, drive, tmp_path):
    code, out, _ = run(
        "export", drive, "--format", "csv", "--output", "map.csv", "--axis-d", "-30:5:0", "--axis-q", "-12,-6,-2,0,8"
    )
    assert code == 0
    assert "Warning: 10 of 35 points of the table have no data" in out
    lines = [line for line in (tmp_path / "map.csv").read_text().splitlines() if not line.startswith("#")]
    rows = np.genfromtxt(lines, delimiter=",", names=True)
    assert np.unique(rows["i_q"]).tolist() == [-12.0, -6.0, -2.0, 0.0, 8.0]
    np.testing.assert_array_equal(np.isnan(rows["psi_d"]), rows["i_d"] < -20)
    assert np.isfinite(rows["i_d"]).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--format", "mat"), "files of this kind can be syre"),
        (("--format", "csv", "--grid", 40, "--range", -10, 10), "choose --grid 41"),
        (("--format", "csv", "--grid", 0), "choose 4 to 2001 points"),
        (("--format", "csv", "--axis-d", "1,2,3,4"), "--axis-d does not contain 0"),
        (("--format", "csv", "--axis-d", "-1:1:2", "--axis-q", "-1:1:2", "--grid", 5), "drop one pair"),
        (("--format", "vesc", "--bandwidth", -1, "--output", "out.xml"), "bandwidth is -1.0 Hz"),
        (("--format", "simscape"), "out.csv ends in .csv, but --format simscape writes .mat files: name it out.mat."),
        (("--format", "plecs", "--output", "out"), "out has no suffix"),
    ],
)
def test_export_refuses_in_one_sentence(run, drive, tmp_path, options, said):
    code, out, err = run("export", drive, "--output", "out.csv", *options)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert said in err
    assert not list(tmp_path.glob("out*"))


def test_export_of_what_is_no_result(run, tmp_path):
    code, _, err = run("export", tmp_path, "--format", "csv", "--output", "out.csv")
    assert (code, "is not a result folder" in err) == (1, True)
    assert run("export", tmp_path, "--output", "out")[0] == 2


def test_compare(run, drive, tmp_path):
    machine_file(tmp_path / "motor.npz")
    assert run("import", "motor.npz", "--output", "imported", "--quiet")[0] == 0
    code, out, _ = run("compare", "imported", drive, "--output", "difference.png")
    assert (code, "ψ_q, rms" in out) == (0, True)
    assert (tmp_path / "difference.png").read_bytes().startswith(b"\x89PNG")
    assert run("compare", "imported", drive, "--output", "difference.png")[0] == 1
    code, out, _ = run("compare", "imported", drive, "--json")
    tree = json.loads(out)
    assert tree["nrmse_d"] < 1e-12
    assert "The same machine, as far as the standard errors can tell." in tree["verdict"]
    assert (tree["resistance"], tree["inverter_curve"], tree["picture"]) == (0.0, None, None)
    assert run("compare", "imported", drive, "--quiet")[1] == ""
