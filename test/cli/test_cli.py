"""The command line: what it prints where, what it leaves behind, and one sentence for each kind of bad input."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
import yaml
from drive_bags import blocks_of, changed, with_arrays, write_blocks

import drive_id
from drive_id.cli import app as cli
from drive_id.cli.options import merged_settings
from drive_id.common.quantity import measured
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import OutputError
from drive_id.files.messages.messages import PHASE_CURRENTS, PHASE_VOLTAGES
from drive_id.files.write.writer import write_recording
from drive_id.reporting.page import report
from drive_id.result.advice import USUAL

SCRIPT = Path(sys.executable).with_name("drive-id")
RESULTS = ["diagnostics.npz", "flux_map.npz", "harmonics.npz", "identification.json"]
"""Of a machine with rotor-position harmonics."""
JOINT = ("--method", "joint")
"""Where the method is not the point: a fit in a tenth of the time."""


def script(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    """Run the installed console script."""
    command = [SCRIPT, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)


def tree(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def assert_one_sentence(ran, said: str) -> None:
    assert ran.code == 1, ran
    assert ran.out == ""
    lines = ran.err.splitlines()
    assert len(lines) == 1, ran.err
    assert lines[0].startswith("drive-id: ")
    assert lines[0].endswith((".", "?"))
    assert lines[0].count(". ") <= 2, "a line of at most three sentences"
    assert said in lines[0]


# -- bad bags: each ends with one sentence, exit code 1 and no trace -------------------------------------------------


def text_file(path, _bag, _samples):
    path.write_text("this is no bag")


def missing_path(_path, _bag, _samples):
    pass


def cut(share):
    def make(path, bag, _samples):
        shutil.copytree(bag, path)
        (file,) = path.glob("*.mcap")
        os.truncate(file, int(share * file.stat().st_size))

    make.__name__ = f"cut_at_{share}"
    return make


def of_arrays(name, **functions):
    """Change whole signals: the array's name to a function of the samples."""

    def make(path, _bag, samples):
        write_recording(path, with_arrays(samples, **{key: change(samples) for key, change in functions.items()}))

    make.__name__ = name
    return make


def of_blocks(name, change):
    """Change the messages of a recording."""

    def make(path, _bag, samples):
        changed(path, samples, change)

    make.__name__ = name
    return make


def wrong_type(path, _bag, samples):
    types = {"/phase_currents": PHASE_CURRENTS, "/phase_voltages": PHASE_VOLTAGES, "/resolver": PHASE_CURRENTS}
    blocks = blocks_of(samples)
    for block in blocks["/resolver"]:
        block["values"] = np.column_stack([block["values"], block["values"][:, 0]])
    write_blocks(path, blocks, types)


def all_at_once(blocks):
    for block in blocks["/phase_currents"]:
        block["stamp"] = 1_000_000_000


def two_drives(path, _bag, samples):
    blocks = blocks_of(samples)
    both = {f"/drive_{k}{topic}": parts for k in (1, 2) for topic, parts in blocks.items()}
    kinds = {"phase_currents": PHASE_CURRENTS, "phase_voltages": PHASE_VOLTAGES}
    types = {topic: kinds.get(topic.split("/")[-1], "drive_id_msgs/msg/Resolver") for topic in both}
    write_blocks(path, both, types)


def turned_currents(samples, i_d, i_q):
    """Currents (N, 3) of given d and q components at the angle of the samples."""
    complex_current = (np.asarray(i_d) + 1j * np.asarray(i_q)) * np.exp(1j * samples.angle)
    return (complex_current[:, None] * np.exp(-2j * np.pi / 3 * np.arange(3))).real


def straight_line(angle):
    def currents(samples):
        along = 200 * np.sin(7.3 * 2 * np.pi * 1e-4 * np.arange(len(samples)))
        noise = 0.3 * np.random.default_rng(0).normal(size=samples.i_abc.shape)
        return turned_currents(samples, along * np.cos(angle), along * np.sin(angle)) + noise

    return currents


def resistive(samples):
    """Voltages that explain the currents of a straight line."""
    return 0.05 * straight_line(2.0)(samples)


def held_angle(samples):
    return np.full(len(samples), 0.3) + 1e-4 * np.random.default_rng(0).normal(size=len(samples))


BAD_BAGS = [
    (text_file, "is not a table of numbers below a line with the names"),
    (missing_path, "There is no "),
    (cut(0.5), ""),
    (wrong_type, "/resolver"),
    (of_blocks("all_at_once", all_at_once), ""),
    (two_drives, "several drives (/drive_1, /drive_2)"),
    (of_arrays("standstill", speed=lambda s: 0 * s.speed, angle=held_angle), "record while it turns"),
    (of_arrays("line_between", i_abc=straight_line(2.0), u_abc=resistive), "fills the current disc"),
]
"""One of each way to be refused: every mistake has its test in test_bag_errors, test_prescan or test_findings."""


@pytest.mark.parametrize(("make", "said"), BAD_BAGS, ids=lambda value: getattr(value, "__name__", ""))
def test_bad_bags(run, bag, simulation, tmp_path, make, said):
    make(tmp_path / "bad", bag, simulation.samples)
    before = tree(tmp_path)
    ran = run("fit", tmp_path / "bad", "--output", "results/below")
    assert_one_sentence(ran, said)
    assert "bad" in ran.err or make.__name__ in STATED_WITHOUT_PATH
    assert tree(tmp_path) == before


STATED_WITHOUT_PATH = {"standstill", "line_between"}
"""Judged when all bags are one recording."""


def test_the_script_itself_ends_with_one_sentence(tmp_path):
    (tmp_path / "bad.mcap").write_text("no bag")
    ran = script("fit", "bad.mcap", "--output", "results", cwd=tmp_path)
    assert_one_sentence(SimpleNamespace(code=ran.returncode, out=ran.stdout, err=ran.stderr), "bad.mcap")
    assert tree(tmp_path) == ["bad.mcap"]


def test_an_error_as_json(run):
    ran = run("fit", "none", "--output", "results", "--json")
    assert ran.code == 1
    assert json.loads(ran.out)["error"]["code"] == "not_a_bag"
    assert json.loads(ran.out)["error"]["message"] in ran.err


def test_one_of_two_drives_can_be_chosen(run, bag, simulation, tmp_path):
    two_drives(tmp_path / "two", bag, simulation.samples)
    assert run("fit", tmp_path / "two", "--output", "results", "--namespace", "drive_2", "-q", *JOINT).code == 0
    ran = run("fit", tmp_path / "two", "--output", "other", "--namespace", "drive_3")
    assert_one_sentence(ran, "no topic /drive_3/phase_currents")


# -- bad outputs -----------------------------------------------------------------------------------------------------


def test_a_folder_of_others_is_not_touched_without_force(run, bag):
    Path("results").mkdir()
    Path("results/notes.txt").write_text("mine")
    assert_one_sentence(run("fit", bag, "--output", "results"), "--force to write beside them")
    assert tree(Path()) == ["results", "results/notes.txt"]
    assert run("fit", bag, "--output", "results", "--force", *JOINT).code == 0
    assert tree(Path("results")) == [*(name for name in RESULTS if name != "harmonics.npz"), "notes.txt"]
    assert Path("results/notes.txt").read_text() == "mine"
    assert run("fit", bag, "--output", "results", *JOINT).code == 0  # by now it is ours


@pytest.mark.parametrize(
    "content", ["{}", "[1]", "not json", '{"format": "another"}', "[" * 100_000], ids=lambda text: text[:12]
)
def test_a_folder_is_not_ours_by_the_name_of_a_file_alone(run, bag, content):
    Path("results").mkdir()
    Path("results/identification.json").write_text(content)
    assert_one_sentence(run("fit", bag, "--output", "results"), "not results of drive_id")
    assert Path("results/identification.json").read_text() == content


def test_outputs_that_cannot_be(run, bag, tmp_path):
    Path("file").write_text("mine")
    Path("dangling").symlink_to("nowhere")
    Path("line\nbreak").mkdir()
    before = tree(tmp_path)
    for output, said in (
        ("file", "is a file"),
        ("file/below", "because of file"),
        ("file/below/deeper", "because of file"),
        ("dangling", "is a file"),
        ("x" * 300, "File name too long"),
        ("line\nbreak/" + "x" * 300, "File name too long"),
    ):
        assert_one_sentence(run("fit", bag, "--output", output), said)
        ran = run("simulate", "--machine", "ipm", "--output", output, "--seconds", "0.01")
        assert_one_sentence(ran, "exists" if output in ("file", "dangling") else said)
    assert_one_sentence(run("simulate", "--machine", "x" * 300, "--output", "out"), "no machine 'xxx")
    assert tree(tmp_path) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only to root; see the test with access denied by hand")
def test_a_read_only_parent(run, bag, tmp_path):
    tmp_path.joinpath("work").chmod(0o500)
    try:
        assert_one_sentence(run("fit", bag, "--output", "results"), "cannot be written")
        assert_one_sentence(run("fit", bag, "--output", "deeper/results"), "cannot be written")
    finally:
        tmp_path.joinpath("work").chmod(0o700)


def test_access_denied(run, bag, monkeypatch):
    monkeypatch.setattr(os, "access", lambda _path, mode, **_options: not mode & os.W_OK)
    assert_one_sentence(run("fit", bag, "--output", "results"), "cannot be written because of .")
    assert_one_sentence(run("simulate", "--machine", "ipm", "--output", "new"), "cannot be written because of .")


# -- bad settings ----------------------------------------------------------------------------------------------------

HUGE = "1" + 400 * "0"


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("method", "NAME=VALUE"),
        ("splines=8", "'splines' in the options does not exist: did you mean"),
        ("splines_d=3", "at least 4 and at most"),
        ("splines_d=[8", "is not valid YAML"),
        ("i_max=" + HUGE, "must be a number or null"),
        ("method=on", "True: it must be text"),
        ("method=\0", "is not valid YAML"),
    ],
    ids=lambda text: text[:24],
)
def test_bad_settings(run, bag, assignment, said):
    assert_one_sentence(run("fit", bag, "--output", "results", "--set", assignment), said)
    assert tree(Path()) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"splines_d: 3", "In file.yaml: splines_d is 3: it must be at least 4"),
        (b"spline_d: 8", "'spline_d' in file.yaml does not exist: did you mean 'splines_d'?"),
        (b"splines_d: [", "cannot be read"),
        (b"{}\n---\n{}", "cannot be read"),
    ],
    ids=lambda value: str(value[:12]),
)
def test_bad_settings_files(run, bag, content, said):
    Path("file.yaml").write_bytes(content)
    assert_one_sentence(run("fit", bag, "--output", "results", "--config", "file.yaml"), said)
    assert tree(Path()) == ["file.yaml"]


def test_settings_files_that_are_none(run, bag):
    assert_one_sentence(run("fit", bag, "--output", "r", "--config", "none.yaml"), "No such file")
    Path("folder").mkdir()
    assert_one_sentence(run("fit", bag, "--output", "r", "--config", "folder"), "Is a directory")
    assert_one_sentence(run("fit", bag, "--output", "r", "--signals", "none.yaml"), "none.yaml")


def test_options_win_over_the_file_and_an_error_names_both(run, bag):
    Path("file.yaml").write_text("splines_d: 6\nmethod: joint\n")
    ran = run(
        "fit", bag, "--output", "r", "--config", "file.yaml", "--set", "splines_d=5", "--method", "psm", "--json"
    )  # fmt: skip
    settings = json.loads(ran.out)["settings"]
    assert (settings["splines_d"], settings["method"], settings["splines_q"]) == (5, "psm", 8)
    ran = run("fit", bag, "--output", "r", "--config", "file.yaml", "--set", "spline_d=5")
    assert_one_sentence(ran, "'spline_d' in file.yaml and the options does not exist")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--machine", "none.npz"], "none.npz"),
        (["--seconds", "inf"], "choose a duration"),
        (["--set", "current_gain=[1, 2]"], "[1, 2]: it must be a list of 3 numbers"),
        (["--noise", "-1"], "current_noise is -1.0: it must be at least 0"),
    ],
    ids=str,
)
def test_bad_simulations(run, options, said):
    ran = run("simulate", "--machine", "ipm", "--output", "new", "--seconds", "0.01", *options)
    assert_one_sentence(ran, said)
    assert tree(Path()) == []


def test_wrong_usage_is_exit_code_2(run, bag):
    for arguments in (
        ["fit", "--output", "results"],
        ["fit", bag, "--output", "results", "--unknown"],
        ["simulate", "--machine", "ipm", "--output", "new", "--seconds", "0"],
        ["simulate", "--machine", "ipm", "--output", "new", "--seconds", "many"],
        ["nonsense"],
    ):
        ran = run(*arguments)
        assert ran.code == 2
        assert "Traceback" not in ran.err
    assert tree(Path()) == []


# -- good input ------------------------------------------------------------------------------------------------------


def test_simulate_and_fit_recover_the_truth(run, tmp_path):
    options = ["--inverter", "tanh", "--harmonics", "0", "--noise", "0", "--frequency-d", "7.3", "--frequency-q", "2.3"]
    scale = ["--set", "inverter_current=1.0", "--set", "inverter_voltage=4.0"]
    simulated = run("simulate", "--machine", "ipm", "--output", "bag", "--seconds", 2, *options, *scale)
    assert simulated.code == 0
    assert simulated.out.count("\n") == 1
    assert "20000 samples of machine ipm" in simulated.out
    ran = run("fit", "bag", "--output", "results")
    assert ran.code == 0, ran.err
    assert ran.err == ""
    assert "Results in results" in ran.out
    assert "Truth" in ran.out
    result = json.loads(Path("results/identification.json").read_text())
    assert result["machine"] == "ipm"
    assert result["resistance"] == pytest.approx(10e-3, rel=0.02)
    assert result["voltage_error"] == pytest.approx(4.0, rel=0.02)
    assert max(result["metrics"]["nrmse_d"], result["metrics"]["nrmse_q"]) < 2e-3
    assert tree(Path("results")) == [name for name in RESULTS if name != "harmonics.npz"]
    assert tree(tmp_path / "system_tmp") == []


@pytest.mark.slow  # a picture is drawn in each format
def test_the_format_of_the_pictures_is_an_option(run, bag):
    for figure_format, start in (("svg", b"<?xml"), ("pdf", b"%PDF")):
        assert run("fit", bag, "--output", "results", "--method", "psm", "--figure-format", figure_format).code == 0
        pictures = [f"diagnostics.{figure_format}", f"flux_map.{figure_format}"]
        assert tree(Path("results")) == sorted([*pictures, "diagnostics.npz", "flux_map.npz", "identification.json"])
        assert all((Path("results") / name).read_bytes().startswith(start) for name in pictures)
    assert run("fit", bag, "--output", "other", "--figure-format", "bmp").code == 2
    assert run("fit", bag, "--output", "other", "--style", "acm").code == 2


def test_pictures_are_drawn_whatever_the_backend_of_matplotlib(bag, tmp_path):
    """A notebook leaves the name of its own in the environment of the programs that it starts."""
    command = [SCRIPT, "fit", bag, "--output", tmp_path / "out", *JOINT, "--style", "ieee", "--quiet"]
    environment = os.environ | {"MPLBACKEND": "a_backend_that_does_not_exist"}
    subprocess.run(command, check=True, timeout=120, env=environment)
    assert (tmp_path / "out" / "flux_map.png").exists()


def test_json_is_the_file_and_nothing_else(run, bag):
    ran = run("fit", bag, "--output", "results", "--json", *JOINT)
    assert ran.code == 0
    assert ran.err == ""
    assert ran.out.count("\n") == 1
    stored = json.loads(Path("results/identification.json").read_text())
    assert set(stored.pop("files")) == {"flux_map.npz", "diagnostics.npz"}
    assert json.loads(ran.out) == {"path": "results"} | stored


def test_quiet_prints_nothing(run, bag):
    for arguments in (
        ["simulate", "--machine", "spm", "--output", "new", "--seconds", "0.01"],
        ["fit", bag, "--output", "results"],
    ):
        ran = run(*arguments, "--quiet")
        assert (ran.code, ran.out, ran.err) == (0, "", "")
    assert Path("new/metadata.yaml").exists()
    assert tree(Path("results")) == RESULTS


def test_simulate_tells_in_json_what_it_wrote(run):
    ran = run("simulate", "--machine", "pmsyrm", "--output", "new", "--seconds", "0.01", "--json")
    assert json.loads(ran.out) == {"bag": "new", "machine": "pmsyrm", "samples": 100}
    assert ran.err == ""


def test_a_seed_makes_the_same_recording_again(run):
    for folder, seed in (("a", 5), ("b", 5), ("c", 6)):
        name = f"{folder}/bag"
        run("simulate", "--machine", "spm", "--output", name, "--seconds", "0.01", "--noise", "0.01", "--seed", seed)
    first, again, other = (Path(folder, "bag", "bag_0.mcap").read_bytes() for folder in "abc")
    assert first == again
    assert first != other


def test_info(run, bag):
    ran = run("info", bag)
    assert ran.code == 0
    for said in ("/phase_currents", "drive_id_msgs/msg/Resolver", "200", "2.000 s", "with its ground truth"):
        assert said in ran.out
    found = json.loads(run("info", bag, "--json").out)
    assert found["storage"] == "mcap"
    assert found["ground_truth"] is True
    assert found["complete"] is True
    assert found["messages"] == 800
    assert {topic["name"] for topic in found["topics"]} == {
        "/current_reference", "/phase_currents", "/phase_voltages", "/resolver",
    }  # fmt: skip
    assert_one_sentence(run("info", "none"), "There is no none here")


@pytest.mark.slow  # a fit by the default method
def test_info_of_a_result_and_its_simulation(run, bag):
    """A result folder is shown, and drives a simulation whose fit gives the result again."""
    fitted = run("fit", bag, "--output", "result", "--method", "full", "--json")
    tree = json.loads(fitted.out)
    assert json.loads(run("info", "result", "--json").out) == {"path": "result"} | tree
    ran = run("info", "result")
    assert (ran.code, ran.err) == (0, "")
    for said in (
        measured(tree["resistance"], tree["sigma_resistance"], "Ω"),
        "4 pole pairs",
        "400 V",
        "6, 12",
    ):
        assert said in ran.out
    ran = run("simulate", "--machine", "result", "--output", "again", "--seconds", "2", "--noise", "1e-3",
              "--frequency-d", "7.3", "--frequency-q", "2.3", "--json")  # fmt: skip
    assert json.loads(ran.out) == {"bag": "again", "machine": "ipm", "samples": 20000}
    again = json.loads(run("fit", "again", "--output", "second", "--json").out)
    assert max(again["metrics"]["nrmse_d"], again["metrics"]["nrmse_q"]) < 5e-3
    assert again["resistance"] == pytest.approx(tree["resistance"], rel=0.02)


def test_a_result_that_does_not_know_its_pole_pairs(run, simulation, tmp_path):
    write_recording(tmp_path / "blind", simulation.samples)
    assert run("fit", tmp_path / "blind", "--output", "result", "--method", "joint", "-q").code == 0
    assert json.loads(run("info", "result", "--json").out)["pole_pairs"] is None
    simulated = ("simulate", "--machine", "result", "--seconds", "0.1", "--json")
    assert_one_sentence(run(*simulated[:-1], "--output", "none"), "give pole_pairs")
    ran = run(*simulated, "--output", "one", "--pole-pairs", "4", "--u-dc", "350")
    assert json.loads(ran.out)["machine"] == "identified"
    Path("result/flux_map.npz").unlink()
    assert_one_sentence(run("info", "result"), "The result folder result is damaged")
    Path("result/identification.json").unlink()
    assert_one_sentence(run(*simulated[:-1], "--output", "none"), "result is not a result folder")


def test_statements_stand_under_the_warnings(run, bag):
    ran = run("fit", bag, "--output", "results")
    tree = json.loads(Path("results/identification.json").read_text())
    statements = tree["statements"]
    lines = ran.out.splitlines()
    kinds = [entry["kind"] for entry in tree["messages"]["statements"]]
    codes = [entry["code"] for entry in tree["messages"]["statements"]]
    of_this_fit = [text for text, code in zip(statements, codes, strict=True) if code not in USUAL]
    told = [text for text, kind in zip(statements, kinds, strict=True) if kind == "statement" and text in of_this_fit]
    assert told
    assert lines[-len(told) - 1 :] == [*told, "Results in results"]
    assert len(told) < len(statements) - 1  # those of what was not found are told on demand
    (advice,) = (line for line in lines if line.startswith("What would help most: "))
    assert lines.index(advice) < lines.index(told[0])
    verbose = run("info", "results", "--verbose").out.splitlines()
    assert set(statements[:-1]) < set(verbose)


def test_info_of_a_recording_that_breaks_off(run, bag, tmp_path):
    cut(0.7)(tmp_path / "bad", bag, None)
    ran = run("info", tmp_path / "bad")
    assert ran.code == 0
    assert "Warning: " in ran.out
    assert json.loads(run("info", tmp_path / "bad", "--json").out)["complete"] is False


def test_version_and_help(run):
    assert run("--version").out == f"drive-id {drive_id.__version__}\n"
    for command in ("simulate", "fit", "info", "plan"):
        assert run(command, "--help").code == 0
        assert command in run("--help").out


def test_the_help_of_a_fit_fits_a_screen_and_settings_have_their_own(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = run("fit", "--help").out
    assert len(shown.splitlines()) <= 48
    assert "--help-settings" in shown
    asked = run("fit", "--help-settings")
    assert asked.code == 0
    assert all(entry.name in asked.out for entry in fields(FitSettings))


def test_the_commands_stand_in_groups(run):
    shown = run("--help").out
    places = [shown.index(text) for text in (" Everyday ", " fit ", " Use of a map ", " Experiment ", " Data ")]
    assert places == sorted(places)


def test_a_csv_file_without_a_signals_file_is_told_what_to_type(run):
    Path("log.csv").write_text("t,i_a\n0,1\n1e-4,2\n")
    assert_one_sentence(run("fit", "log.csv"), "'drive-id check log.csv --draft signals.yaml'")


# -- the process -----------------------------------------------------------------------------------------------------


def test_every_command_can_be_quiet_and_speak_json():
    for name, command in typer.main.get_command(cli.app).commands.items():
        known = {option for parameter in command.params for option in parameter.opts}
        assert {"--json", "--quiet"} <= known, name


def test_a_terminal_without_unicode_is_served(bag):
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    ran = script("info", bag, env=environment)
    assert ran.returncode == 0, ran.stderr
    assert "/phase_currents" in ran.stdout


def cpu_seconds(process: subprocess.Popen) -> float:
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.process
def test_an_interrupt_ends_without_a_traceback_and_leaves_nothing(tmp_path):
    command = [SCRIPT, "simulate", "--machine", "ipm", "--output", "new", "--seconds", "900"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while cpu_seconds(process) < 2.0:  # until it simulates, on a busy machine too
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert said == "drive-id: interrupted; no output was left behind.\n"
    assert tree(tmp_path) == []


# -- plans -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # an experiment is planned
@pytest.mark.usefixtures("coarse_plans")
def test_a_plan_is_printed_and_written(run):
    ran = run("plan", "--machine", "spm", "--duration", "4", "--speed-max", "800", "--output", "plan.yaml")
    assert ran.code == 0, ran.err
    for said in ("Lissajous figure", "Paper's, 4 s", "u_dc / sqrt(3)", "separate R from a rotation", "plan.yaml"):
        assert said in ran.out
    written = yaml.safe_load(Path("plan.yaml").read_text())
    assert written["/**/trajectory_publisher"]["ros__parameters"]["duration"] == 4.0
    assert max(written["/**/bench_simulator"]["ros__parameters"]["speeds"]) <= 800.0


@pytest.mark.slow  # an experiment is planned
@pytest.mark.usefixtures("coarse_plans")
def test_a_plan_from_rough_data_as_json(run):
    data = {"i-max": 20, "pole-pairs": 3, "resistance": 0.35, "inductance-d": 2e-3, "inductance-q": 3e-3}
    data |= {"magnet-flux": 0.09, "u-dc": 325, "duration": 4, "speed-max": 800}
    options = [word for name, value in data.items() for word in (f"--{name}", value)]
    ran = run("plan", *options, "--one-direction", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert min(found["speeds"]) > 0
    assert found["predicted"]["resistance"] < found["paper"]["predicted"]["resistance"]
    assert found["settings"]["i_max"] == 20.0


def test_plans_that_cannot_be(run):
    assert_one_sentence(run("plan", "--i-max", "20"), "The plan needs pole_pairs, resistance,")
    assert_one_sentence(run("plan", "--machine", "none"), "no machine 'none'")
    assert_one_sentence(run("plan", "--machine", "ipm", "--u-dc", "20"), "reduce i_max or speed_min, or raise u_dc")
    Path("mine.yaml").write_text("mine: true")
    assert_one_sentence(run("plan", "--machine", "ipm", "--output", "mine.yaml"), "mine.yaml")
    assert Path("mine.yaml").read_text() == "mine: true"


# -- reports -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # two reports are drawn
@pytest.mark.usefixtures("plain_reports")
def test_a_fit_leaves_a_report_and_a_new_one_without_it_none(run, bag):
    """And the machine has its name in all files."""
    named = ("--machine", "EM 3", "--set", "serial='007'")
    ran = run("fit", bag, *JOINT, "--output", "results", *named, "--report")
    assert ran.out.splitlines()[0] == "Identified drive: EM 3, serial 007, method joint"
    written = json.loads(Path("results/identification.json").read_text())
    assert (written["machine"], written["settings"]["serial"]) == ("EM 3", "007")
    with np.load("results/flux_map.npz", allow_pickle=False) as file:
        assert (str(file["machine"]), str(file["serial"])) == ("EM 3", "007")
    assert str(drive_id.load("results").caption()).startswith("EM 3, serial 007, method joint")
    assert "report.html" in tree(Path("results"))
    said = json.loads(run("report", "results", "--output", "elsewhere/mine.html", "--json").out)
    assert said == {"report": ["elsewhere/mine.html"], "warnings": []}
    for page in ("results/report.html", "elsewhere/mine.html"):
        assert "<title>Identified drive: EM 3, serial 007</title>" in Path(page).read_text(encoding="utf-8")
    assert run("fit", bag, *JOINT, "--output", "results", "--quiet").code == 0
    assert "report.html" not in tree(Path("results"))


@pytest.mark.cases
@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OutputError("The output results cannot be written (disk full)."), "the output results cannot be written"),
        (OSError(24, "Too many open files"), "Too many open files"),
        (ImportError("x.so: failed to map segment"), "x.so: failed to map"),
        (MemoryError(), "the memory is not sufficient."),
    ],
)
def test_a_report_that_cannot_be_added_leaves_the_result(run, bag, monkeypatch, error, said):
    """The computer runs out of something when the pictures are made."""
    save = drive_id.Identification.save

    def refused(self, path, **options):
        if options.get("draw"):
            raise error
        return save(self, path, **options)

    monkeypatch.setattr(drive_id.Identification, "save", refused)
    ran = run("fit", bag, *JOINT, "--output", "results", "--report", "--quiet")
    assert_one_sentence(ran, "The result in results is complete, but without pictures: ")
    assert said in ran.err
    assert drive_id.load("results").resistance > 0


def test_a_report_is_refused_in_one_sentence(run, fitted, monkeypatch):
    fitted.save("results", draw=False)
    with monkeypatch.context() as patch:
        patch.setattr(report, "report_files", lambda _, __: {"report.html": b"<!-- a drive_id report -->"})
        assert run("report", "results", "--output", "mine.html").out == "Report in mine.html\n"
    Path("mine.html").unlink()
    Path("notes.html").write_text("mine")
    assert_one_sentence(run("report", "results", "--output", "notes.html"), "notes.html exists already")
    assert_one_sentence(run("report", "results", "--output", "report.docx"), "end with .html or .pdf")
    assert_one_sentence(run("report", "nothing", "--output", "r.html"), "not a result folder")
    Path("results/diagnostics.npz").write_bytes(b"PK")
    said = "diagnostics.npz is damaged (diagnostics.npz was not written with its identification.json"
    assert_one_sentence(run("report", "results", "--output", "r.html"), said)
    assert tree(Path()) == sorted(
        ["notes.html", "results", *(f"results/{name}" for name in RESULTS if "harm" not in name)]
    )


HOSTILE = "x\udcff\x1b[31m\x9b2J\u202ey.csv"
"""A name that is not UTF-8, sets a colour, clears the screen, and is written backwards."""


ONE_AFTER_ANOTHER = """
import sys
from drive_id.cli.app import main
codes = []
for words in sys.argv[1:]:
    sys.argv = ["drive-id", *words.split("\\t")]
    try:
        main()
    except SystemExit as end:
        codes.append(end.code)
print(*codes)
"""
"""Runs commands, each one's words between tabs, and prints their exit codes."""


@pytest.mark.process
def test_names_neither_move_the_cursor_nor_stop_the_output(tmp_path, simulation):
    samples = simulation.samples
    names = ["t", "i_a", "i_b", "i_c", "u_a", "u_b", "u_c", "theta\x1b[2J\u202e", "omega\x07"]
    columns = [samples.stamp * 1e-9, *samples.i_abc.T, *samples.u_abc.T, samples.angle, samples.speed]
    table = "\n".join([",".join(names), *(",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True))])
    (tmp_path / HOSTILE).write_text(table, encoding="utf-8")
    commands = (
        ("info", HOSTILE),
        ("check", HOSTILE),
        ("check", HOSTILE, "--draft", "draft.yaml"),
        ("fit", HOSTILE, "--signals", "draft.yaml", "--output", "result", *JOINT),
        ("report", "result", "--output", "report.html"),
        ("info", "result"),
        ("fit", "result/" + HOSTILE, "--output", "again"),
    )
    command = [os.fsencode(part) for part in (sys.executable, "-c", ONE_AFTER_ANOTHER, *map("\t".join, commands))]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    ran = subprocess.run(command, capture_output=True, timeout=120, check=False, cwd=tmp_path, env=environment)
    text = (ran.stderr + ran.stdout).decode("utf-8")
    assert text.endswith("\n0 0 0 0 0 0 1\n"), text
    assert "Traceback" not in text
    assert all(letter.isprintable() or letter == "\n" for letter in text), text
    assert (tmp_path / "report.html").read_bytes().decode("utf-8")


def test_serial_numbers_and_single_voltages_need_no_quotes():
    """YAML reads 0017 as the octal number 15."""
    chosen = merged_settings(FitSettings, None, ["serial=0017", "u_dc=540", "notes=on a hot day"], {})
    assert (chosen.serial, chosen.u_dc, chosen.notes) == ("0017", (540.0,), "on a hot day")
