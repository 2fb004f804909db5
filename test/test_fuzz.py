"""What the fuzzer takes for an end that is none; test_page_commands.py runs it on an input of each kind."""

from __future__ import annotations

import json
import sys

import fuzz
import numpy as np
import pytest

if sys.platform != "linux":
    pytest.skip("the fuzzer measures processes by /proc", allow_module_level=True)


@pytest.mark.parametrize(
    ("ran", "outcome"),
    [
        ({}, ""),
        ({"code": 1, "err": "drive-id: It is none: give another.\n"}, ""),
        ({"code": 1, "err": "drive-id: It is none: give another.\nAnd more.\n"}, "not one sentence"),
        ({"code": 1, "err": "drive_id: compiling for this computer, once.\ndrive-id: None: give one.\n"}, ""),
        ({"code": 1, "err": ""}, "not one sentence"),
        ({"code": 1, "err": "drive-id: No end"}, "not one sentence"),
        ({"code": 70, "err": "Traceback (most recent call last):\n"}, "traceback"),
        ({"code": -11}, "crash"),
        ({"code": -9, "hung": True}, "hang"),
        ({"processor": 11.0}, "over time"),
        ({"memory": 5e8}, "over memory"),
    ],
)
def test_ends_are_judged(tmp_path, ran, outcome):
    usual = {"code": 0, "out": "", "err": "", "processor": 1.0, "memory": 1e6}
    case = fuzz.Case("mcap", 1, "", ("fit", "x"))
    assert fuzz.judged(fuzz.Ran(**usual | ran), case, tmp_path, None)[0] == outcome


@pytest.mark.parametrize(
    ("said", "names", "outcome"),
    [
        ("no output was left behind", [], ""),
        ("no output was left behind", ["out"], "left behind"),
        ("no output was left behind", [".drive_id-x"], "left behind"),
        ("out is complete", ["out"], ""),
        ("out is complete", [], "left behind"),
    ],
)
def test_what_an_interrupt_leaves_is_held_against_what_is_said(tmp_path, said, names, outcome):
    for name in (".out.txt", ".ready", "given.csv", *names):
        (tmp_path / name).touch()
    case = fuzz.Case("interrupt", 1, "", ("fit", "x"), "", fuzz.Limit("interrupt", 1.0))
    ran = fuzz.Ran(130, "", f"drive-id: interrupted; {said}.\n", 1.0, 1e6)
    assert fuzz.judged(ran, case, tmp_path, None, ["given.csv"])[0] == outcome


@pytest.mark.parametrize(
    ("factor", "warnings", "outcome"),
    [(1.0, [], ""), (1.005, [], ""), (1.03, [], "wrong map"), (1.03, ["It is damaged at 3.2 s."], "")],
)
def test_maps_are_compared(tmp_path, factor, warnings, outcome):
    axis = np.linspace(-10.0, 10.0, 21)
    psi = np.repeat(axis[:, None], 21, axis=1) * 1e-3
    for name, scale, said in (("good", 1.0, ["Usual 1."]), ("out", factor, ["Usual 2.", *warnings])):
        (tmp_path / name).mkdir()
        (tmp_path / name / "identification.json").write_text(json.dumps({"warnings": said}))
        np.savez(
            tmp_path / name / "flux_map.npz", i_d=axis, i_q=axis, psi_d=scale * psi, psi_q=psi, i_max=10.0,
            sigma_d=np.full((21, 21), 1e-6), sigma_q=np.full((21, 21), 1e-6), inside=np.ones((21, 21), bool),
        )  # fmt: skip
    case = fuzz.Case("mcap", 1, "", ("fit", "x"))
    assert fuzz.judged(fuzz.Ran(0, "", "", 1.0, 1e6), case, tmp_path, tmp_path / "good")[0] == outcome


def test_a_finding_names_what_repeats_it():
    finding = fuzz.Finding("crash", "mcap", 7, "cut", (), "", "python benchmarks/fuzz.py --replay mcap:7")
    assert finding.repeat.endswith(f"{finding.kind}:{finding.number}")
