"""Damaged and hostile inputs through the command line: no crash, no hang, no traceback, no silent wrong map.

    python benchmarks/fuzz.py --seconds 60               a random slice, other inputs each time
    python benchmarks/fuzz.py --seconds 300 --seed 1     the same inputs each time, as far as the time reaches
    python benchmarks/fuzz.py --replay sample_mcap:123   one input again; what is left of it is printed

Each input is given to ``drive-id`` in a process of its own, which is measured: more than 10 s of processor time or
400 MB over what the program takes anyway (a fit with nine harmonics: 350 MB) is a finding, like any other end than a
result or one sentence. A fit that succeeds on a damaged recording must give the map of the good one, within 4 standard
errors or 1 %, or warn.
Some good inputs are given to a process that is interrupted, or has too little memory, disk or open files.
Findings are written to ``fuzz_findings.json``, each with the command that repeats it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from fuzz_inputs import KINDS as BAG_KINDS
from fuzz_inputs import SECONDS, TRAJECTORY, UNLIMITED, Case, Limit, make_corpus
from fuzz_limits import LIMIT_KINDS
from fuzz_logs import LOG_KINDS, load_readers, make_logs
from scipy.interpolate import RegularGridInterpolator

import drive_id
from drive_id.cli import app
from drive_id.live.worker import return_free_memory

PROCESSOR, WALL, MEMORY = 10.0, 90.0, 400e6
"""Budget of one input: s of processor time, s until it is taken for a hang, bytes over those of the good inputs."""
SIGMAS, SHARE = 4.0, 0.01
KINDS = BAG_KINDS | LOG_KINDS | LIMIT_KINDS
_READY = ".ready"
"""File that says that the program begins, and may be interrupted."""
_OURS = frozenset({".out.txt", ".err.txt", _READY})
_COMPILING = "drive_id: compiling for this computer, "
"""How a line begins that is told beside any outcome, where machine code is not cached yet."""
OUTCOMES = ("crash", "hang", "traceback", "over time", "over memory", "not one sentence", "left behind", "wrong map")


@dataclass(frozen=True)
class Ran:
    """How ``drive-id`` ended: exit code (negative: signal), output, processor time, s, and further memory, bytes."""

    code: int
    out: str
    err: str
    processor: float
    memory: float
    hung: bool = False


@dataclass(frozen=True)
class Finding:
    """What is wrong with the end of one input."""

    outcome: str
    kind: str
    number: int
    damage: str
    arguments: tuple[str, ...]
    said: str
    repeat: str


# -- one input ---------------------------------------------------------------------------------------------------------


def run(arguments: tuple[str, ...], folder: Path, limit: Limit = UNLIMITED) -> Ran:
    """Run the command line in a forked process, from a folder, with too little of something."""
    return_free_memory()  # of making the input; it would hide what the reader takes
    base = _resident()
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        _child(arguments, folder, limit)
    hung, due = False, 0.0 if limit.name == "interrupt" else np.inf
    while True:
        found, status, used = os.wait4(child, os.WNOHANG)
        if found:
            break
        if not hung and time.monotonic() - start > WALL:
            os.kill(child, signal.SIGKILL)
            hung = True
        if not due and (folder / _READY).exists():
            due = time.monotonic() + limit.value
        elif 0 < due < time.monotonic():
            os.kill(child, signal.SIGINT)
            due = np.inf
        time.sleep(0.002)
    out, err = ((folder / name).read_text(errors="replace") for name in (".out.txt", ".err.txt"))
    code = os.waitstatus_to_exitcode(status)
    return Ran(code, out, err, used.ru_utime + used.ru_stime, max(used.ru_maxrss * 1024 - base, 0), hung)


def _child(arguments: tuple[str, ...], folder: Path, limit: Limit) -> None:
    """Be ``drive-id``; does not return."""
    try:
        os.chdir(folder)
        Path(".out.txt").touch()
        for descriptor, name in ((1, "/dev/full" if limit.name == "full_output" else ".out.txt"), (2, ".err.txt")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), descriptor)
        virtual = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        further = int(limit.value) if limit.name == "memory" else 4 << 30
        resource.setrlimit(resource.RLIMIT_AS, (virtual + further, resource.RLIM_INFINITY))
        if limit.name == "file_size":
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit.value), resource.RLIM_INFINITY))
        elif limit.name == "open_files":
            most = len(list(Path("/proc/self/fd").iterdir())) + int(limit.value)
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        sys.argv = ["drive-id", *arguments]
        Path(_READY).touch()
        code = 0
        try:
            app.main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as when the interpreter ends
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:  # noqa: BLE001  # whatever it is, it is a finding
        import traceback  # noqa: PLC0415

        traceback.print_exc()
        sys.stderr.flush()
        code = 70
    os._exit(code)


def _resident() -> float:
    return float(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))


def judged(ran: Ran, case: Case, folder: Path, good: Path | None, given: Collection[str] = ()) -> tuple[str, str]:
    """Return the outcome that is a finding, and what was said; empty texts for a good end.

    ``given`` names what was in the folder before.
    """
    said = (ran.err or ran.out).strip()[-600:]
    lines = [line for line in ran.err.strip().splitlines() if not line.startswith(_COMPILING)]
    sentence = len(lines) == 1 and lines[0].startswith("drive-id: ") and lines[0].endswith(".")
    left = {path.name for path in folder.iterdir()} - _OURS - set(given)  # under whatever name
    wrong = _differs(folder / "out", good) if ran.code == 0 and good else ""
    checks = {
        "hang": ran.hung,
        "traceback": "Traceback" in ran.err or "MemoryError" in ran.err,
        "crash": ran.code not in ((0, 1, 2, 130) if case.limit.name == "interrupt" else (0, 1, 2)),
        "over time": ran.processor > PROCESSOR,
        "over memory": ran.memory > MEMORY and not case.limit.name,
        "not one sentence": ran.code in (1, 130) and not sentence,
        "left behind": ran.code in (1, 130)
        and case.limit.name != "full_output"  # of which the result is whole, and cannot be shown
        and bool(left) != (" is complete" in said),
        "wrong map": bool(wrong),
    }
    found = next((outcome for outcome, holds in checks.items() if holds), "")
    return found, f"exit code {ran.code}, {ran.processor:.1f} s, {ran.memory * 1e-6:.0f} MB: {wrong or said}"


def _differs(found: Path, good: Path) -> str:
    """Say how a map differs from the good one beyond its errors without any further warning; empty if it does not.

    Only where both have data: what is left of a recording that was cut reaches less of the plane, and its map says so.
    """
    trees = [json.loads((path / "identification.json").read_text()) for path in (found, good)]
    warnings, usual = ({re.sub(r"[0-9.]+", "#", text) for text in tree["warnings"]} for tree in trees)
    if warnings - usual:
        return ""
    with np.load(found / "flux_map.npz") as new, np.load(good / "flux_map.npz") as old:
        grid = np.stack(np.meshgrid(old["i_d"], old["i_q"], indexing="ij"), axis=-1)
        inside = old["inside"] & (np.hypot(grid[..., 0], grid[..., 1]) <= old["i_max"])
        axes = new["i_d"], new["i_q"]
        inside &= RegularGridInterpolator(axes, new["inside"] * 1.0, "nearest", bounds_error=False)(grid) == 1.0
        worst = 0.0
        for axis in "dq":
            psi, sigma = (
                RegularGridInterpolator(axes, new[f"{name}_{axis}"], bounds_error=False)(grid)
                for name in ("psi", "sigma")
            )
            allowed = np.maximum(
                SIGMAS * np.fmax(sigma, old[f"sigma_{axis}"]), SHARE * np.abs(old[f"psi_{axis}"][inside]).max()
            )
            off = np.abs(psi - old[f"psi_{axis}"]) / allowed
            worst = max(worst, float(np.nanmax(off[inside], initial=0.0)))
    return f"the map is {worst:.2f} times as far off as allowed, without a further warning" if worst > 1 else ""


# -- workers -----------------------------------------------------------------------------------------------------------


class Tester:
    """Tries inputs one after the other, each in a fork of this process, which has loaded everything before."""

    def __init__(self, corpus: Path, scratch: Path, kinds: Collection[str]) -> None:
        self._corpus = corpus
        self._scratch = Path(tempfile.mkdtemp(dir=scratch))
        os.environ["TMPDIR"] = str(self._scratch)
        tempfile.tempdir = None
        self._good("nocrc.mcap", "joint")
        drive_id.load(corpus / "result")
        drive_id.simulate(corpus / "machine.npz", 0.05)
        if set(kinds) & set(LOG_KINDS | LIMIT_KINDS):
            load_readers(corpus)

    def _good(self, name: str, method: str) -> Path:
        """Return the result of a good input."""
        if name in ("packed.mcap.zstd", "sqlite.db3"):  # the same samples without a truth
            name = "nocrc.mcap"
        target = self._scratch / f"{name.replace('/', '_')}_{method}"
        if not target.exists():
            drive_id.fit(self._corpus / name, settings=drive_id.FitSettings(method=method)).save(target)
        return target

    def attempt(self, kind: str, number: int, *, show: bool) -> Finding | None:
        """Make one input and try it."""
        folder = self._scratch / "case"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        case = Case(kind, number, *KINDS[kind](self._corpus, folder, random.Random(f"{kind}:{number}")))
        good = self._good(*case.compare.split()) if case.compare else None
        given = {path.name for path in folder.iterdir()}
        ran = run(case.arguments, folder, case.limit)
        if show:
            print(case, f"exit code {ran.code}, {ran.processor:.2f} s, {ran.memory * 1e-6:.0f} MB", ran.err, sep="\n")
        outcome, said = judged(ran, case, folder, good, given)
        if not outcome:
            return None
        repeat = f"python benchmarks/fuzz.py --replay {kind}:{number}"
        return Finding(outcome, kind, number, case.damage[:300], case.arguments, said, repeat)


_testers: list[Tester] = []
"""That of this process, which begins with it."""


def _begin(*of_tester: Any) -> None:
    """Load everything; drawing would take longer than all else."""
    patch("drive_id.result.pictures.plots.result_pictures", return_value={}).start()
    _testers.append(Tester(*of_tester))


def _attempt(kind: str, number: int, show: bool) -> tuple[str, Finding | None]:
    return kind, _testers[0].attempt(kind, number, show=show)


def tried(
    inputs: Iterable[tuple[str, int]], jobs: int, corpus: Path, kinds: Collection[str], *, show: bool = False
) -> Iterator[tuple[str, Finding | None]]:
    """Try inputs, kinds and numbers, in so many processes; yield kind and finding of each."""
    context, waiting = multiprocessing.get_context("spawn"), set[Future[tuple[str, Finding | None]]]()
    with (
        tempfile.TemporaryDirectory(prefix="drive_id-fuzz-") as scratch,
        ProcessPoolExecutor(jobs, context, _begin, (corpus, Path(scratch), kinds)) as pool,
    ):
        for kind, number in inputs:
            waiting.add(pool.submit(_attempt, kind, number, show))
            if len(waiting) >= 2 * jobs:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (each.result() for each in done)
        yield from (each.result() for each in waiting)


# -- command line ------------------------------------------------------------------------------------------------------


def main() -> None:
    """Try inputs, report, and exit with code 1 when there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to try random inputs")
    parser.add_argument("--seed", type=int, default=None, help="first number; default: another one each time")
    parser.add_argument("--kinds", default="", help="names of kinds, with commas; default: all")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--replay", metavar="KIND:NUMBER", help="try one input again")
    parser.add_argument("--count", type=int, help="try so many inputs of each kind, one after the other, and no more")
    parser.add_argument("--findings", type=Path, default=Path("fuzz_findings.json"))
    parser.add_argument("--keep", type=Path, help="leave the corpus in this folder, and take it from there")
    options = parser.parse_args()
    kinds = options.kinds.split(",") if options.kinds else list(KINDS)
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        parser.error(f"{', '.join(unknown)}: the kinds are {', '.join(KINDS)}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory(prefix="drive_id-fuzz-") as temporary:
        corpus = (options.keep or Path(temporary) / "corpus").absolute()
        if not (corpus / "machine.npz").exists():
            corpus.mkdir(parents=True)
            make_corpus(corpus)
        if set(kinds) & set(LOG_KINDS | LIMIT_KINDS) and not (corpus / "slow.csv").exists():
            make_logs(corpus, drive_id.simulate("ipm", SECONDS, seed=7, noise=1e-3, trajectory=TRAJECTORY))
        findings: list[Finding] = []
        counts: Counter[str] = Counter()
        for kind, finding in _chosen(corpus, kinds, options):
            counts[kind] += 1
            if finding is not None:
                findings.append(finding)
                print(f"{finding.outcome}: {finding.repeat}\n  {finding.damage}\n  {finding.said}", flush=True)
    report(findings, counts)
    if findings:
        options.findings.write_text(json.dumps([asdict(finding) for finding in findings], indent=1))
        raise SystemExit(1)
    if not counts:
        raise SystemExit("Nothing was tried: give it more --seconds.")


def _chosen(corpus: Path, kinds: list[str], options: argparse.Namespace) -> Iterator[tuple[str, Finding | None]]:
    """Yield kind and finding of each input that the options ask for."""
    if options.replay:
        kind, _, number = options.replay.partition(":")
        return tried([(kind, int(number))], 1, corpus, [kind], show=True)
    seed = options.seed if options.seed is not None else random.SystemRandom().randrange(1 << 32)
    print(f"Numbers from {seed}", flush=True)
    if options.count:
        chosen = [(kind, seed + k) for k in range(options.count) for kind in kinds]
        return tried(chosen, 1, corpus, kinds)
    end = time.time() + options.seconds
    endless = ((kind, number) for number in itertools.count(seed) for kind in kinds)
    return tried(itertools.takewhile(lambda _: time.time() < end, endless), options.jobs, corpus, kinds)


def report(findings: list[Finding], tried: Counter[str]) -> None:
    """Print inputs and findings by kind."""
    outcomes = Counter((finding.kind, finding.outcome) for finding in findings)
    print(f"| {'kind':19} | inputs | " + " | ".join(OUTCOMES) + " |")
    print("|---" * (2 + len(OUTCOMES)) + "|")
    for kind in tried:
        counts = " | ".join(str(outcomes[kind, outcome]) for outcome in OUTCOMES)
        print(f"| {kind:19} | {tried[kind]} | {counts} |")
    totals = " | ".join(str(sum(finding.outcome == outcome for finding in findings)) for outcome in OUTCOMES)
    print(f"| {'all':19} | {sum(tried.values())} | {totals} |")


if __name__ == "__main__":
    main()
