"""The way of a sample through the package, as CONTRIBUTING.md draws it, and where a figure lives on it."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import drive_id

ROOT = Path(__file__).parent.parent
PACKAGE = Path(drive_id.__file__).parent
DRAWN = re.findall(
    r"^    ( *)(\S+\.py) (\w+)",
    (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## The way of a sample")[1].split("## ")[0],
    re.MULTILINE,
)
WAY = [(len(indent) // 4, file, function) for indent, file, function in DRAWN]


def test_a_fit_calls_what_the_drawing_shows_in_its_order(bag, tmp_path):
    wanted, called, open_calls, names = {(file, function) for _, file, function in WAY}, {}, [], {}

    def name_of(code):
        path = Path(code.co_filename)
        name = (str(path.relative_to(PACKAGE)), code.co_name) if path.is_relative_to(PACKAGE) else None
        return name if name in wanted else None

    def follow(frame, event, _):
        code = frame.f_code
        if code not in names:
            names[code] = name_of(code)
        if (this := names[code]) is None:
            return
        if event == "call":
            called.setdefault(this, len(open_calls))
            open_calls.append(this)
        elif event == "return" and open_calls and open_calls[-1] == this:
            open_calls.pop()

    before = sys.getprofile()
    sys.setprofile(follow)
    try:
        drive_id.fit(bag, output=tmp_path / "map")
    finally:
        sys.setprofile(before)
    assert [(depth, *name) for name, depth in called.items()] == WAY


HOLDERS = {
    "the figure that was identified": {"Parameters"},
    "of the paper's regression, and its jackknife": {"Solution", "Jackknife"},
    "a rough one, before the fit, of a preview or of a compared method": {
        "RoughFit", "ResistanceSoFar", "Progress", "ComparedMethod",
    },
    "of the machine that is analyzed, with its error modes": {"MachineModel", "ModelErrors", "ErrorModes"},
    "of a verification and its limits": {"Verification", "VerificationLimits"},
    "an effect that is reported or expected, relative to it": {"Reported", "Fitted"},
    "on pictures and in lists of folders": {"Caption", "FoundResult"},
    "of plans": {"Prediction", "PlanSettings", "RoughMachine"},
    "of simulated drives, and their truth": {
        "Machine", "CoEnergyMachine", "PhaseDrop", "Plant", "Controller", "MachineMap", "GroundTruth",
    },
}  # fmt: skip


def test_the_resistance_lives_in_the_classes_that_are_known():
    """A further one is added to its meaning here, or reads it from another: one figure must not have two places."""
    found = {
        node.name
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
        and any(isinstance(line, ast.AnnAssign) and ast.unparse(line.target) == "resistance" for line in node.body)
    }
    assert found == set().union(*HOLDERS.values())
