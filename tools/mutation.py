"""Mutation testing: change drive_id in one place at a time and list the changes that no test detects.

    python tools/mutation.py --mutants 200 --seed 1 drive_id/core/checks drive_id/core/signals

The tests run once on the unchanged code, to learn their durations and the lines that each of them reaches. Every mutant
is then judged by the tests that reach its line until one fails: first those of ``make test``, the quickest first, then
those that only ``make test-rest`` runs. Survivors are listed: a survivor is equivalent (no input distinguishes it from
the original), or a test is missing. At the end stands how many of the others each of the two runs notices.

The kernels that numba compiles are not traced: their mutants are judged by all tests that reach the module.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import time
import traceback
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numba  # noqa: F401  # what every mutant needs is loaded once, and drive_id anew in each
import pytest
import scipy.interpolate
import scipy.sparse.linalg  # noqa: F401
from coverage import CoverageData

ROOT = Path(__file__).parent.parent
COMPARED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
"""The limit moved, and the comparison reversed."""
CALCULATED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
LONG = ("accuracy", "browser", "process", "slow")
"""Marks of tests that ``make test`` omits, unless they are essential."""
LONGEST = 600
"""Wall time after which a mutant counts as killed, s; before that, its CPU time is limited."""


@dataclass(frozen=True)
class Mutant:
    """One change: the number of the node among those of its file, and of the replacement among its replacements."""

    file: Path
    line: int
    lines: range
    node: int
    choice: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.before}  ->  {self.after}"


def replacements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what may stand in the place of a node."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for operator in COMPARED[type(node.ops[0])]:
            yield ast.Compare(node.left, [operator()], node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in CALCULATED:
        yield ast.BinOp(node.left, CALCULATED[type(node.op)](), node.right)
    elif isinstance(node, ast.AugAssign) and type(node.op) in CALCULATED:
        yield ast.AugAssign(node.target, CALCULATED[type(node.op)](), node.value)
        yield ast.Pass()
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
        yield ast.Constant(other_value(node.value))
    elif isinstance(node, (ast.If, ast.IfExp)) and not isinstance(node.test, (ast.Compare, ast.UnaryOp)):
        changed = copy.copy(node)
        changed.test = ast.UnaryOp(ast.Not(), node.test)
        yield changed
    elif isinstance(node, (ast.Raise, ast.Continue, ast.Break)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, (ast.Call, ast.Yield, ast.YieldFrom))
    ):
        yield ast.Pass()
    elif isinstance(node, ast.Return) and node.value is not None and ast.unparse(node.value) != "None":
        yield ast.Return(ast.Constant(None))


def other_value(value: float) -> float:
    """Return a number that differs enough to matter: the next integer, or twice the value."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int) and abs(value) < 10:
        return value + 1
    return 2 * value or 1.0


def left_out(tree: ast.Module) -> set[int]:
    """Return the identities of nodes without effect when the code runs: annotations and what is for type checks."""
    roots: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            roots += [*node.decorator_list, *([node.returns] if node.returns else [])]
        elif isinstance(node, ast.ClassDef):
            roots += node.decorator_list
        elif isinstance(node, (ast.arg, ast.AnnAssign)) and node.annotation:
            roots.append(node.annotation)
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            roots.append(node)
    return {id(node) for root in roots for node in ast.walk(root)}


def text(node: ast.AST) -> str:
    """Return the beginning of a node's source on one line."""
    first = ast.unparse(ast.fix_missing_locations(copy.deepcopy(node))).splitlines()[0]
    return first if len(first) <= 80 else first[:77] + "..."


def mutants(file: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file, given relative to the repository."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    skipped = left_out(tree)
    for number, node in enumerate(ast.walk(tree)):
        if id(node) in skipped or not isinstance(node, (ast.expr, ast.stmt)):
            continue
        for choice, changed in enumerate(replacements(node)):
            last = node.lineno if isinstance(node, ast.If) else node.end_lineno or node.lineno
            lines = range(node.lineno, last + 1)
            yield Mutant(file, node.lineno, lines, number, choice, text(node), text(changed))


def mutated(mutant: Mutant) -> str:
    """Return the source of a file with one node replaced; the comments are lost."""
    tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
    target = next(node for number, node in enumerate(ast.walk(tree)) if number == mutant.node)
    changed = list(replacements(target))[mutant.choice]
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is target:
                setattr(parent, name, changed)
            elif isinstance(value, list) and any(entry is target for entry in value):
                setattr(parent, name, [changed if entry is target else entry for entry in value])
    return ast.unparse(ast.fix_missing_locations(tree))


class Loading(importlib.abc.MetaPathFinder):
    """Loads one module from another file, so that numba's cache holds no machine code of it either."""

    def __init__(self, name: str, file: Path) -> None:
        self.name, self.file = name, file

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return the specification of that module, and of no other."""
        del path, target
        return importlib.util.spec_from_file_location(self.name, self.file) if fullname == self.name else None


class Durations:
    """A plugin of pytest that notes the CPU time of each test with its fixtures, s, and why ``make test`` omits it."""

    def __init__(self) -> None:
        self.seconds: dict[str, tuple[float, str]] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Take the time of set-up, call and tear-down."""
        begun = time.process_time()
        outcome = yield
        marks = [mark for mark in LONG if item.get_closest_marker(mark) and not item.get_closest_marker("essential")]
        self.seconds[item.nodeid] = time.process_time() - begun, "".join(marks[:1])
        return outcome


class Begun:
    """A plugin of pytest that leaves the name of the test that began last: with ``-x``, of the one that failed."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Note its name."""
        self.file.write_text(nodeid, encoding="utf-8")


class Reach:
    """Which tests reach which lines, from one run of the unchanged code.

    Parameters
    ----------
    folder : Path
        Where the run left its notes.
    """

    def __init__(self, folder: Path) -> None:
        notes = json.loads((folder / "durations.json").read_text(encoding="utf-8"))
        self.seconds: dict[str, float] = {name: seconds for name, (seconds, _) in notes.items()}
        self.marks: dict[str, str] = {name: mark for name, (_, mark) in notes.items()}
        self.data = CoverageData(str(folder / "coverage"))
        self.data.read()

    def tests(self, mutant: Mutant) -> list[str]:
        """Return the tests that could notice a mutant, those of ``make test`` first, the quickest of each first."""
        contexts = self.data.contexts_by_lineno(str(ROOT / mutant.file))
        near = {name for line in mutant.lines for name in contexts.get(line, []) if name}
        if not near:  # what runs on import, and kernels
            near = {name for names in contexts.values() for name in names if name}
        found = {name.rpartition("|")[0] for name in near}
        shared = {name.partition("::")[0] for name in near if name.endswith("|setup")}
        found |= {name for name in self.seconds if name.partition("::")[0] in shared}
        return sorted(found & self.seconds.keys(), key=lambda name: (bool(self.marks[name]), self.seconds[name]))


def in_child(folder: Path, arguments: Sequence[str], loading: Loading | None, seconds: float) -> int:
    """Run pytest in a copy of this process and return its exit code, negative: the signal that ended it."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        os.setsid()
        os.chdir(ROOT)
        log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        if loading:
            sys.meta_path.insert(0, loading)
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
            signal.alarm(LONGEST)
            os._exit(pytest.main([*arguments], plugins=[Begun(folder / "begun")]))
        durations = Durations()
        code = pytest.main([*arguments], plugins=[durations])
        (folder / "durations.json").write_text(json.dumps(durations.seconds), encoding="utf-8")
        os._exit(code)
    finally:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(99)  # an error of the tool itself: do not return into the parent's loop


def measure(folder: Path, files: Sequence[Path], tests: Sequence[str]) -> None:
    """Run the tests on the unchanged code."""
    os.environ["COVERAGE_FILE"] = str(folder / "coverage")
    modules = {module_name(file.parent / "__init__.py") for file in files}
    arguments = ["-q", "-p", "no:cacheprovider", "--cov-context=test", "--cov-report=", *tests]
    arguments += [f"--cov={name}" for name in sorted(modules)]
    code = in_child(folder, arguments, None, 0)
    if code != 0:
        raise SystemExit(f"The tests fail without any mutation (exit code {code}): see {folder / 'log'}.")


def module_name(file: Path) -> str:
    """Return the dotted name of a file of the repository."""
    return ".".join(file.with_suffix("").parts).removesuffix(".__init__")


def killer(mutant: Mutant, tests: Sequence[str], folder: Path, seconds: float) -> str:
    """Return the first test that fails, or does not end, with a mutant; an empty string if none does."""
    (folder / "begun").write_text(tests[0], encoding="utf-8")  # which fails if drive_id cannot be imported
    file = folder / mutant.file.name
    file.write_text(mutated(mutant), encoding="utf-8")
    for cached in (folder / "__pycache__").glob(f"{file.stem}.*"):
        cached.unlink()
    code = in_child(
        folder, ["-x", "-q", "-p", "no:cacheprovider", *tests], Loading(module_name(mutant.file), file), seconds
    )
    if code in (5, 99):
        raise SystemExit(f"pytest ran no test for {mutant} (exit code {code}): see {folder / 'log'}.")
    return (folder / "begun").read_text(encoding="utf-8") if code else ""


def main() -> None:
    """Test a sample of the mutants and list the survivors."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("sources", nargs="+", type=Path, help="files and folders below the repository")
    parser.add_argument("--tests", nargs="+", default=["test/core"], help="test files and folders")
    parser.add_argument("--mutants", type=int, default=0, help="how many, drawn at random (default: all)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--most-seconds", type=float, default=10.0, help="CPU time of the tests of each run, s")
    parser.add_argument(
        "--folder", type=Path, default=ROOT / "out" / "mutation", help="folder for recorded data and mutated files"
    )
    parser.add_argument(
        "--reuse", action="store_true", help="reuse the data of the last run, if no file has changed since"
    )
    options = parser.parse_args()
    folder: Path = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    sys.path.insert(0, str(ROOT))
    files = [
        file.resolve().relative_to(ROOT)
        for source in options.sources
        for file in (sorted(source.rglob("*.py")) if source.is_dir() else [source])
    ]
    if not options.reuse:
        measure(folder, files, options.tests)
    reach = Reach(folder)
    drawn = [mutant for file in files for mutant in mutants(file)]
    total = len(drawn)
    if options.mutants:
        drawn = random.Random(options.seed).sample(drawn, min(options.mutants, total))
    survived = unreached = by_rest = 0
    for number, mutant in enumerate(drawn, 1):
        tests: list[str] = []
        seconds = {True: 0.0, False: 0.0}  # of the tests that only test-rest runs, and of the others
        for name in reach.tests(mutant):
            rest = bool(reach.marks[name])
            seconds[rest] += reach.seconds[name]
            if not tests or seconds[rest] <= options.most_seconds:
                tests.append(name)
        if not tests:
            unreached += 1
            print(f"{number}/{len(drawn)} no test reaches {mutant}", flush=True)
        elif not (name := killer(mutant, tests, folder, 4 * sum(seconds.values()) + 60)):
            survived += 1
            print(f"{number}/{len(drawn)} survived {len(tests)} tests: {mutant}", flush=True)
        else:
            mark = reach.marks.get(name, "")
            by_rest += bool(mark)
            print(f"{number}/{len(drawn)} {mark or 'make test'}: {name} notices {mutant}", flush=True)
    dead = len(drawn) - survived - unreached
    print(f"{len(drawn)} of {total} mutants: {dead} killed, {survived} survived, {unreached} reached by no test.")
    if dead:
        print(f"make test notices {(dead - by_rest) / dead:.0%} of them, only test-rest {by_rest / dead:.0%}.")


if __name__ == "__main__":
    main()
