"""``drive-id check`` and ``drive-id convert``, as they are called."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from column_files import columns, write_csv
from typer.testing import CliRunner

from drive_id.cli.app import app, main
from drive_id.core.fit_settings import FitSettings
from drive_id.files.messages.signals_file import read_signals
from drive_id.files.read.several import read_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.sources import Sources


@pytest.fixture(scope="module")
def log(simulation, tmp_path_factory):
    stamp = simulation.samples.stamp
    logged = columns(simulation.samples, time_s=(stamp - stamp[0]) * 1e-9)
    return write_csv(tmp_path_factory.mktemp("log") / "log.csv", logged)


def run(*words, code=0):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == code, (result.output, result.exception)
    return result.output


def test_a_draft_fits_without_edits_as_the_recording_does(log, bag, tmp_path):
    said = run("check", log, "--draft", tmp_path / "s.yaml", "--picture", tmp_path / "p.png")
    assert "Draft in" in said
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    signals = read_signals(tmp_path / "s.yaml")
    settings = FitSettings(method="joint")
    found = fit_bags(Sources([log], signals), None, settings).drive
    wanted = fit_bags(Sources([bag]), None, settings).drive
    np.testing.assert_allclose(found.flux_map.psi_d, wanted.flux_map.psi_d, atol=1e-5)
    np.testing.assert_allclose(found.resistance, wanted.resistance, rtol=1e-4)
    run("convert", log, tmp_path / "bag", "--signals", tmp_path / "s.yaml")
    ours, theirs = read_recording(tmp_path / "bag").samples, read_recording(log, signals).samples
    for name in ("i_abc", "u_abc", "i_dq_reference"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name).astype(np.float32))
    np.testing.assert_array_equal(ours.stamp, theirs.stamp)
    assert "drive-id" not in run("check", tmp_path / "bag")


def test_what_programs_read(log, tmp_path):
    (tmp_path / "wrong.yaml").write_text(
        "defaults: {stamp: time_s, stamp_unit: s}\ncurrents: {fields: [ia, ib, ic]}\n"
        "voltages: {fields: [ua, uc, ub]}\nresolver: {angle: theta}\n"
    )
    tree = json.loads(run("check", log, "--signals", tmp_path / "wrong.yaml", "--json"))
    (finding,) = [entry for entry in tree["findings"] if entry["code"] == "phases_swapped"]
    assert "Phases b and c of the voltages" in finding["message"]
    assert finding["value"] == pytest.approx(finding["values"]["unexplained"])
    assert {field["name"] for field in tree["topics"][0]["fields"]} >= {"ia", "theta"}
    assert tree["overview"]["sample_period"] == pytest.approx(1e-4)
    assert tree["draft"] is None
    (tmp_path / "none.yaml").write_text(
        "defaults: {stamp: time_s, stamp_unit: s}\ncurrents: {fields: [ia, ib, ix]}\n"
        "voltages: {fields: [ua, uc, ub]}\nresolver: {angle: theta}\n"
    )
    tree = json.loads(run("check", log, "--signals", tmp_path / "none.yaml", "--json"))
    assert [entry["code"] for entry in tree["findings"]] == ["missing_topic"]
    assert run("check", log, "--quiet") == ""


def test_bad_input_is_one_sentence(log, tmp_path, capsys, monkeypatch):
    def refused(*words):
        monkeypatch.setattr(sys, "argv", ["drive-id", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 1
        return capsys.readouterr().err

    assert "There is no " in refused("check", tmp_path / "none")
    (tmp_path / "x.mcap").write_bytes(b"no bag")
    assert "neither an MCAP" in refused("check", tmp_path / "x.mcap")
    (tmp_path / "there.yaml").write_text("mine")
    assert "overwrite it with --force" in refused("check", log, "--draft", tmp_path / "there.yaml")
    assert (tmp_path / "there.yaml").read_text() == "mine"
    (tmp_path / "text.csv").write_text("t,a\n" + "".join(f"{k},{k % 7}\n" for k in range(300)))
    for options in ((), ("--quiet",), ("--json",)):
        said = refused("check", tmp_path / "text.csv", "--draft", tmp_path / "draft.yaml", *options)
        assert "draft.yaml was not written: Nothing in" in said
        assert said.count("looks like") == 1
    assert not (tmp_path / "draft.yaml").exists()
    assert "no picture that can be drawn" in refused("check", log, "--picture", tmp_path / "p.gif")
    (tmp_path / "bag").mkdir()
    assert "exists" in refused("convert", log, tmp_path / "bag", "--signals", tmp_path / "there.yaml")
    assert "is not a mapping" in refused("convert", log, tmp_path / "new", "--signals", tmp_path / "there.yaml")
    assert not (tmp_path / "new").exists()
