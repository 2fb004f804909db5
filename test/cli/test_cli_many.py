"""The command line with information files, and with several processes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import test_cli
from drive_bags import with_arrays
from test_cli import JOINT, assert_one_sentence, tree

from drive_id.files.write.writer import write_recording


def test_accumulated_files_are_fitted_like_their_bags(run, bag, other_bag):
    ran = run("accumulate", bag, "--output", "one.info", *JOINT)
    assert (ran.code, ran.out, ran.err) == (0, "one.info: 20000 samples, disc of 300 A.\n", "")
    assert run("accumulate", other_bag, "--i-max", 300, "--output", "below/two.info", "-q", *JOINT).out == ""
    results = []
    for sources in (["one.info", "below/two.info"], [bag, other_bag], ["one.info", other_bag]):
        ran = run("fit", *sources, "--i-max", 300, "--output", "out", "--json", *JOINT)
        assert ran.code == 0, ran.err
        results.append(json.loads(ran.out))
    for result in results:
        for name in ("resistance", "sigma_resistance", "voltage_error", "sigma_voltage_error", "i_max"):
            assert result[name] == pytest.approx(results[0][name], rel=1e-9), name
        assert result["metrics"]["nrmse_q"] == pytest.approx(results[0]["metrics"]["nrmse_q"], rel=1e-9)
        assert [entry["sha256"] for entry in result["inputs"]] == [entry["sha256"] for entry in results[0]["inputs"]]
    assert sorted(path.name for path in Path().iterdir()) == ["below", "one.info", "out"]


def test_what_an_information_file_holds(run, bag):
    ran = run("accumulate", bag, "--output", "x.info", "--json", *JOINT)
    told = json.loads(ran.out)
    assert told["information"] == "x.info"
    ran = run("info", "x.info", "--json")
    assert json.loads(ran.out) == {
        "path": "x.info", "software": test_cli.drive_id.__version__,
        **{name: value for name, value in told.items() if name != "information"},
    }  # fmt: skip
    ran = run("info", "x.info")
    assert ran.code == 0
    for said in ("20000, 2.000 s, 0 gaps", "300 A, ", "2.000 s of 1 recording", "ipm", "sha256"):
        assert said in ran.out


def test_settings_come_from_the_file_unless_they_are_given(run, bag):
    run("accumulate", bag, "--output", "x.info", "--set", "splines_d=6", "-q", *JOINT)
    ran = run("fit", "x.info", "--output", "out", "--json", "--method", "psm")
    settings = json.loads(ran.out)["settings"]
    assert (settings["splines_d"], settings["method"], settings["i_max"]) == (6, "psm", 300.0)
    ran = run("fit", "x.info", "--output", "new", "--set", "splines_d=7")
    assert_one_sentence(ran, "x.info was accumulated differently (splines_d is 6 there and 7 here)")
    ran = run("fit", "x.info", "--output", "new", "--i-max", 280)
    assert_one_sentence(ran, "x.info was accumulated differently (i_max is 300 A there and 280 A here)")
    written = [f"out/{name}" for name in test_cli.RESULTS if name != "harmonics.npz"]
    assert tree(Path()) == ["out", *written, "x.info"]


def test_bad_input_is_told_in_one_sentence_and_leaves_nothing(run, bag, simulation, tmp_path):
    write_recording(tmp_path / "blind", with_arrays(simulation.samples))
    (tmp_path / "cut.info").write_bytes(b"PK\x03\x04")
    (tmp_path / "notes").write_text("mine")
    before = tree(tmp_path)
    for arguments, said in (
        (("accumulate", tmp_path / "blind", "--output", "x.info"), "give --i-max"),
        (("accumulate", bag, "--output", tmp_path / "notes"), "exists already"),
        (("accumulate", bag, "--output", tmp_path / "notes" / "x.info"), "because of"),
        (("accumulate", bag, "--output", "x.info", "--i-max", "-3"), "i_max is -3"),
        (("accumulate", bag, "none", "--output", "x.info", "--i-max", "300"), "There is no none here"),
        (("fit", "none.info", "--output", "out"), "none.info cannot be read (No such file or directory)"),
        (("fit", bag, tmp_path / "cut.info", "--output", "out"), "cut.info is not an information file"),
        (("info", tmp_path / "cut.info"), "cut.info is not an information file"),
    ):
        assert_one_sentence(run(*arguments), said)
    assert tree(tmp_path) == before


def test_bad_bags_are_left_out_on_request(run, bag, other_bag, tmp_path):
    (tmp_path / "bad.mcap").write_text("no bag")
    ran = run("fit", bag, tmp_path / "bad.mcap", other_bag, "--output", "out", "--skip-bad", *JOINT)
    assert ran.code == 0
    assert f"Warning: Left out: {tmp_path / 'bad.mcap'} is neither" in ran.out
    warnings = json.loads(Path("out/identification.json").read_text())["warnings"]
    assert warnings[0].startswith(f"Left out: {tmp_path / 'bad.mcap'} is neither")


@pytest.mark.process
def test_several_processes(run, bag, other_bag, tmp_path):
    """The way the workers are started by the command itself."""
    fit = ("fit", bag, other_bag, "--i-max", 300, "--output", tmp_path / "out", "--json", *JOINT)
    alone = run(*fit)
    ran = test_cli.script(*fit, "--workers", "2", cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    results = [json.loads(text) for text in (alone.out, ran.stdout)]
    for name in ("resistance", "sigma_resistance", "voltage_error", "inputs", "i_max", "versions"):
        assert results[0][name] == results[1][name], name
