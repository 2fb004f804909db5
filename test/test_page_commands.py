"""Every command of the pages and of ``make help`` is run, or it is said here why not and what stands for it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from page_commands import PAGES, ROOT, commands, make_commands
from ros_bench import own_domain
from steady_state import LinearDrive, disc_points, telemetry

import drive_id
from drive_id.cli.app import app
from drive_id.core.fit_settings import FitSettings
from drive_id.exchange.exports.options import ExportOptions
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.sources import Sources

WRITES = ("--output", "-o", "--draft")
BY_FULL = ("README.md",)
"""Pages that fit by the default method, which takes longest; the others take the same path by ``joint``."""
RECORDINGS = (
    *("monday", "tuesday", "wednesday", "thursday", "friday", "cold", "warm", "hot", "PLAIN_BAG", "DISC_BAG"),
    *("unit_0017", "bags/one", "bags/two"),
)
"""Recordings of these names on the pages, each at another speed: equal ones would be refused as the same."""

ELSEWHERE = {
    "drive-id serve results": "it does not end: test_server.py starts it",
    'drive-id fit PLAIN_BAG DISC_BAG --output DIR --set added_inertia="[0, 0.004]"': "test_mechanics.py",
    "drive-id fit BAG --output DIR --method locked": "of a locked rotor: test_locked.py",
    "drive-id import map.csv --columns": "a table with names of another tool: test_import_formats.py",
    "drive-id simulate --machine motor.npz": "needs a map beyond i_max: test_exports.py, test_cli.py",
    "drive-id fit bags/* --i-max 300 --dask": "needs a cluster: test_cli_dask.py starts one",
    "drive-id accumulate bags/* --i-max 300 --dask": "needs a cluster: test_cli_dask.py starts one",
    "drive-id fit s3://bench/monday": "needs a storage: test_remote.py has one in memory",
    "ssh ": "on other computers; its words are checked",
    "drive-id fit monday.info tuesday.info --output all": "merges what the other computers wrote: test_sources.py",
    "python -m build": "test_packaging.py builds the wheel, and .ci/run both by make package",
    "python benchmarks/page_pictures.py docs/images": "needs Chromium; test_benchmarks.py imports it",
    "pip install .": ".ci/run installs wheel and sdist by make package",
    "pip install plotly>=6 threadpoolctl>=3": "needs the network; test_packaging.py compares it with setup.py",
    "python -m venv audit": "needs the network",
    "rosdep install --from-paths src --ignore-src": "needs rosdep and its index; test_rosdep_keys.py knows the keys",
    "ln -s drive_id/msg_defs src/drive_id_msgs": "test_packaging.py follows it and lists the packages",
    "colcon build": "takes minutes; test_packaging.py lists the packages, and make colcon builds them",
    "export ROS_SECURITY_KEYSTORE=": "needs the CLI of ROS 2 and its keys; test_security_policy.py checks the policy",
    "ros2 security": "needs the CLI of ROS 2 and its keys; test_security_policy.py checks the policy",
    "ros2 run drive_id recorder --ros-args --enclave": "needs keys; test_security_policy.py checks the policy",
}
"""Commands of the pages, or their beginnings, that are not run here, and why; the words of all ours are checked."""

MAKE = {
    "help": "",
    "demo": "--seconds 2.0",
    "test": "--collect-only -q test/test_changelog.py",
    "test-all": "--version",
    "test ARGS='-k bag'": "--collect-only -q test/test_docs.py test/fitting/test_sources.py",
    "test JOBS=0": "--version",
    "test JOBS=0 ARGS='-k bag --pdb'": "--collect-only -q test/test_docs.py test/fitting/test_sources.py",
    "coverage": "--version",
    "coverage ARGS='test/core test/files'": "--version",
    "bench": "--help",
    "bench ARGS=--hour": "3.0 --quick --only growth",
    "safety": "--rounds 1 --only trips",
    "safety ARGS='--rounds 5'": "--rounds 1 --only restarts",
    "safety ARGS='--rounds 0 --scripts 200'": "--scripts 2",
    "safety ARGS='--rounds 0 --goals 60 --seed 4308'": "--goals 1",
    "safety ARGS='--rounds 0 --scripts 200 --seed 12'": "--scripts 1 --allowance 1.5",
    "population": "--help",
    "population ARGS='--seed 2'": "--count 1 --methods joint --jobs 1 --output old.json",  # more: test_population.py
    "population ARGS='--count 100 --seed 3'": "--help",
    "population ARGS='--only 17'": "--help",
    "population ARGS='--page docs/engineering/population.md --jobs 2'": "--help",
    "population ARGS='--against old.json'": "--help",
    "fuzz": "--count 1 --seed 0",  # all kinds
    "fuzz ARGS='--seconds 300'": "--count 1 --kinds signals",
    "fuzz ARGS='--seconds 420 --seed 20000'": "--count 1 --kinds signals",
    "fuzz ARGS='--seconds 540 --seed 2253471605 --jobs 1'": "--count 1 --kinds signals",
    "endure": "--only interrupts --rounds 1",
    "endure ARGS='--only interrupts --rounds 300'": "--rounds 1",
    "endure ARGS='--only kills --rounds 30'": "--rounds 1",
    "endure ARGS='--only kills --rounds 30 --seed 7'": "--rounds 1",
    "endure ARGS='--only live --minutes 62'": "--minutes 0.05 --method joint",
    "endure ARGS='--only requests --requests 1000 --seed 21'": "--requests 3",
}
"""What ``make`` is called with on the pages and in its help, and further options that shorten it.

Of a program that another line runs on the same path, the help is enough.
"""
MAKE_ELSEWHERE = {
    "setup": "each run of the tests begins with it",
    "demo ARGS=--free-shaft": "test_commissioning.py runs it, and looks at what it finds",
    "DISTRO=kilted setup": "by .ci/run, for its tests with Kilted",
    "lint": "by .ci/run", "package": "by .ci/run", "docs": "by .ci/run",
    "check": "lint and quick tests: both by .ci/run", "test-rest": "by .ci/run",
    "lint test-all docs demo": "each alone",
    "ament": "needs the network, for linters of its own",
    "colcon": "runs all tests once more",
    "clean": "would remove the environment that runs this",
}  # fmt: skip
_IN_FLIGHT = "at most five messages of a killed node may be under way, which holds at the pace of an idle machine"
_STATED = "the stated times hold on a machine that does nothing else; test_safety.py allows for more"
ALONE = {
    "safety": _STATED,
    "safety ARGS='--rounds 5'": _STATED,
    "safety ARGS='--rounds 0 --scripts 200'": _STATED,
    "safety ARGS='--rounds 0 --goals 60 --seed 4308'": _STATED,
    "endure ARGS='--only kills --rounds 30'": _IN_FLIGHT,
    "endure ARGS='--only kills --rounds 30 --seed 7'": _IN_FLIGHT,
}
"""What has limits in real time needs the machine alone: DRIVE_ID_ALONE=1 make test-all JOBS=0 ARGS='-k make_is'."""
_SAME = re.compile(r"coverage ARGS='test/core test/files test/inspection ")  # other paths of tests


def elsewhere(text: str) -> bool:
    """Return whether the table says why a command is not run."""
    plain = text.replace('"', "")
    return any(plain.startswith(begin.replace('"', "")) for begin in ELSEWHERE)


def test_each_command_is_run_or_it_is_said_why_not():
    """A program that is new on the pages, or a new way to call make, needs a test or a line above."""
    ours = ("drive-id", "make", "ros2")
    unknown = [each for each in commands() if each.words[0] not in ours and not elsewhere(each.text)]
    assert [each for each in unknown if each.words[:2] != ["python", "-m"]] == []
    assert [text for text in make_commands() - MAKE.keys() - MAKE_ELSEWHERE.keys() if not _SAME.match(text)] == []


def test_the_tables_name_nothing_that_is_gone():
    shown = [each.text.replace('"', "") for each in commands()]
    assert [begin for begin in ELSEWHERE if not any(text.startswith(begin.replace('"', "")) for text in shown)] == []
    assert (MAKE.keys() | MAKE_ELSEWHERE.keys()) - make_commands() == set()
    told = " ".join([*ELSEWHERE.values(), *MAKE_ELSEWHERE.values()])
    files = {file.name for file in (ROOT / "test").rglob("test_*.py")}
    assert {name for name in re.findall(r"test_\w+\.py", told) if name not in files} == set()
    integration = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for text, reason in MAKE_ELSEWHERE.items():
        assert not reason.startswith("by .ci/run") or text.removesuffix(" setup") in integration, text


def test_the_words_of_each_command_are_understood():
    """By the parser of the command line itself, without running anything."""
    group = typer.main.get_command(app)
    shown = commands("drive-id")
    assert len(shown) > 40
    for each in shown:
        if each.words[1:] == ["--version"]:
            continue
        with group.make_context("drive-id", each.words[1:]) as context:
            name, command, words = group.resolve_command(context, each.words[1:])
            command.make_context(name, words, parent=context)


def test_what_is_launched_and_run_is_there():
    executables = dict(re.findall(r'^    "(\w+) = ([\w.]+):', (ROOT / "setup.py").read_text("utf-8"), re.MULTILINE))
    shown = commands("ros2", "python")
    runs = [each.words[3:] for each in shown if each.words[:3] == ["ros2", "run", "drive_id"]]
    runs += [
        [each.words[2].rpartition(".")[2], *each.words[3:]]
        for each in shown
        if each.words[0] == "python" and each.words[2].startswith("drive_id.")
    ]
    assert len(runs) > 5
    for executable, *arguments in runs:
        source = (ROOT / f"{executables[executable].replace('.', '/')}.py").read_text(encoding="utf-8")
        config = ROOT / "config" / f"{executable}.yaml"
        named = source + (config.read_text(encoding="utf-8") if config.exists() else "")
        for option, value in zip(arguments, [*arguments, ""][1:], strict=True):
            if option == "-p":
                assert re.search(rf"\b{value.partition(':=')[0]}\b", named), (executable, value)
            if option == "--params-file":
                assert (ROOT / value).exists() or value == "plan.yaml", value
            if executable == "characterize" and option.startswith("--"):
                assert f'"{option}"' in source, option
    launched = [each.words[2:] for each in shown if each.words[:2] == ["ros2", "launch"]]
    assert launched
    for package, file, *arguments in launched:
        assert package == "drive_id"
        text = (ROOT / "launch" / file).read_text(encoding="utf-8")
        text += (ROOT / "launch" / "identification.launch.py").read_text(encoding="utf-8")  # included by the other
        assert [each for each in arguments if f'"{each.partition(":=")[0]}"' not in text] == []


@pytest.fixture(scope="module")
def furniture(bag, tmp_path_factory):
    """A folder with all that the pages name: recordings, results, files of others; read only.

    The map of the results does not fold: of one that does, each export would look for the nearest that does not.
    """
    folder = tmp_path_factory.mktemp("pages")
    fitted = fit_bags(Sources([bag]), None, FitSettings("full", search_orders=False))
    for name in ("my_bag", "my_log", "LOG", "BAG"):
        shutil.copytree(bag, folder / name)
    for seed, name in enumerate(RECORDINGS):
        samples = drive_id.simulate("ipm", 0.5, speed=300.0 + 60.0 * seed, noise=1e-3, seed=seed)
        write_recording(folder / name, samples, samples.truth)
    fitted.save(folder / "my_drive")
    for name in ("result", "golden", "results/earlier"):
        shutil.copytree(folder / "my_drive", folder / name)
    drive_id.export(fitted, "syre", folder / "THOR.mat")
    shutil.copy(folder / "THOR.mat", folder / "other.mat")
    drive_id.export(fitted, "machine", folder / "motor.npz", ExportOptions(filled=True))
    drive_id.export(fitted, "csv", folder / "map.csv")
    text = (folder / "map.csv").read_text(encoding="utf-8")
    for ours, theirs in (("i_d", "Id"), ("i_q", "Iq"), ("psi_d", "Fd"), ("psi_q", "Fq")):
        text = re.sub(rf"\b{ours}\b", theirs, text, count=1)
    (folder / "map.csv").write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "config" / "signals_default.yaml", folder / "my_signals.yaml")
    page = (ROOT / "docs" / "report.md").read_text(encoding="utf-8")
    (limits,) = re.findall(r"^    (flux: .*?)\n\n", page, re.MULTILINE | re.DOTALL)
    (folder / "limits.yaml").write_text(re.sub("^ +", "", limits, flags=re.MULTILINE), encoding="utf-8")
    page = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    (slow,) = re.findall(r"^    (defaults: .*?)\n\n", page, re.MULTILINE | re.DOTALL)
    (folder / "slow.yaml").write_text(re.sub("^ +", "", slow, flags=re.MULTILINE), encoding="utf-8")
    rng = np.random.default_rng(12)
    log = telemetry(LinearDrive(), disc_points(rng, 100, 9, least=0.2), rng.choice([-300.0, 200.0], 9), rng=rng)
    columns = [log.time, log.i_dq, log.u_dq, log.speed / 4 * 30 / np.pi, np.full(len(log.time), 40.0)]
    np.savetxt(
        folder / "log.csv", np.column_stack(columns), delimiter=",", comments="", fmt="%.12g",
        header="t,i_d,i_q,u_d,u_q,n,temp",
    )  # fmt: skip
    return folder


def new_commands():
    """Return the commands of each page that no page before shows in the same words, and that are run here."""
    seen, found = set(), {}
    for page in PAGES:
        for each in commands("drive-id", pages=[page]):
            if not elsewhere(each.text) and each.text not in seen:
                seen.add(each.text)
                found.setdefault(page, []).append(each)
    return found


def test_a_command_that_two_pages_show_is_run_once():
    texts = [each.text for shown in new_commands().values() for each in shown]
    assert len(set(texts)) == len(texts)
    assert set(texts) == {each.text for each in commands("drive-id") if not elsewhere(each.text)}


@pytest.mark.slow  # fits of all commands of a page
@pytest.mark.usefixtures("coarse_plans")
@pytest.mark.parametrize(("page", "shown"), new_commands().items(), ids=[page.name for page in new_commands()])
def test_the_commands_of_a_page_run(page, shown, furniture, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(furniture, folder)
    monkeypatch.chdir(folder)
    if page.name == "report.md":  # whose days are results
        for name in ("monday", "tuesday", "wednesday"):
            shutil.rmtree(name)
            shutil.copytree("my_drive", name)
    drawn = False
    for each in shown:
        words = [
            file
            for word in each.words[1:]
            for file in (sorted(str(path) for path in Path().glob(word)) if "*" in word else [word])
        ]
        if words[0] == "simulate":
            words += ["--seconds", "2"]  # the last one counts
        if words[0] == "fit" and page.name not in BY_FULL and "--method" not in words:
            words += ["--method", "joint"]
        if drawn:  # a report takes as long as three fits
            words = [word for word in words if word != "--report"]
        drawn |= "--report" in words
        if "--workers" in words:
            words += ["--workers", "2"]  # each takes a second to start
        written = [Path(word) for at, word in enumerate(words) if words[at - 1] in WRITES]
        written += [Path(words[2])] if words[0] == "convert" else []
        for path in written:
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        try:
            code = app(words, standalone_mode=False)
        except SystemExit as end:
            code = end.code
        assert not code or (words[0], code) == ("verify", 3), each.text  # 3: a drive that does not pass
        assert all(path.exists() for path in written), each.text


def shortened(text):
    """Return a call of ``make`` as a parameter of the test below."""
    reason = ALONE.get(text, "") if "DRIVE_ID_ALONE" not in os.environ else ""
    return pytest.param(text, marks=pytest.mark.skipif(bool(reason), reason=f"needs the machine alone: {reason}"))


@pytest.mark.process
@pytest.mark.parametrize("text", [shortened(text) for text in MAKE])
def test_what_make_is_called_with_works(text, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp() / "make"
    folder.mkdir(exist_ok=True)
    words = shlex.split(text)
    given = " ".join(word.removeprefix("ARGS=") for word in words if word.startswith("ARGS="))
    others = [word for word in words if not word.startswith("ARGS=")]
    assert all((ROOT / word).exists() for word in given.split() if word.startswith("test/"))
    arguments = f"{given} {MAKE[text]}"
    arguments = re.sub(r"\bold\.json", lambda file: str(folder / file[0]), arguments)
    if re.search("--collect-only|--version", arguments) and "JOBS=0" not in others:
        others.append("JOBS=0")  # a worker more would only collect once more
    if words[0] == "demo":
        others.append(f"OUT={folder / 'demo'}")
    command = ["make", "-o", "setup", f"BIN={Path(sys.executable).parent}", *others, f"ARGS={arguments.strip()}"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "MAKE", "COV"))}
    domain, lock = own_domain()
    with lock:
        ran = subprocess.run(
            command, cwd=ROOT, env=environment | {"DRIVE_ID_DOMAIN": str(domain)},
            capture_output=True, text=True, timeout=600, check=False,
        )  # fmt: skip
    assert ran.returncode == 0, ran.stdout[-3000:] + ran.stderr[-3000:]
    assert "Traceback" not in ran.stderr
