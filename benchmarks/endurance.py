"""Hours of live identification, many requests, killed nodes: prints the tables of docs/engineering/reliability.md.

    python benchmarks/endurance.py                               everything, in a few minutes
    python benchmarks/endurance.py --only live --minutes 62
    python benchmarks/endurance.py --only requests --requests 1000
    python benchmarks/endurance.py --only kills --rounds 30
    python benchmarks/endurance.py --only interrupts --rounds 300     of fits with several workers

The seed determines requests, kills and interrupts; the timing of threads and processes differs from run to run. The
exit code is 1 if there is a finding. Modules: live_watch, node_requests, node_kills, interrupts.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as drive-id sets it: before numpy is loaded

from reporting import machine


def live(options: argparse.Namespace, folder: Path) -> Iterator[str]:
    """Test a drive that is identified live, in real time; yield findings."""
    from live_watch import watch  # noqa: PLC0415  # needs ROS 2, as the parts below

    found = watch(options.minutes, folder / "live", options.method)
    _row("node", "memory at first, MB", "median", "peak", "growth per hour", head=True)
    for name in found.memory:
        _row(f"`{name}`", *found.row(name))
    replies = found.replies
    print(f"\n{options.minutes:g} min: {replies.codes.total()} requests, {replies.told}, ", end="")
    print(f"slowest {replies.slowest:.1f} s; {found.recorded} samples recorded, {found.dropped} lost; ", end="")
    print(f"{len(found.trips)} trips")
    for reason, count in Counter(re.sub(r"[-+.\d]*\d", "…", reason) for reason in found.trips).most_common():
        print(f"{count} × {reason}")
    yield from replies.findings


def requests(options: argparse.Namespace, folder: Path) -> Iterator[str]:
    """Test many requests; yield findings."""
    from node_requests import many_requests  # noqa: PLC0415

    found = many_requests(options.requests, options.seed, folder / "requests")
    replies, memory = found.replies, found.memory
    _row("requests", "answered", "codes", "slowest", "memory", "growth per 1000 requests", head=True)
    _row(
        str(found.sent), str(found.sent - replies.codes["no answer"]), replies.told, f"{replies.slowest:.1f} s",
        f"{min(memory, default=0):.0f} to {max(memory, default=0):.0f} MB", f"{found.growth:+.0f} MB",
    )  # fmt: skip
    yield from replies.findings


def kills(options: argparse.Namespace, folder: Path) -> Iterator[str]:
    """Test rounds of killed nodes; yield findings."""
    from node_kills import kills as run  # noqa: PLC0415

    result, findings = run(options.rounds, options.seed, folder / "kills")
    _row("rounds", "actions", "recordings", "messages", "longest loss", "in flight", "findings", head=True)
    actions = ", ".join(f"{count} × {action}" for action, count in result.actions.most_common())
    in_flight = f"{result.runs_cut} times, at most {result.most_cut}"
    longest = f"{result.longest:.2f} s"
    _row(
        str(result.rounds),
        actions,
        str(result.recordings),
        str(result.messages),
        longest,
        in_flight,
        str(len(findings)),
    )
    yield from findings


def interrupts(options: argparse.Namespace, folder: Path) -> Iterator[str]:
    """Test work on further processes, whose results are large; yield findings."""
    import interrupts as interrupting  # noqa: PLC0415  # a part imports what it needs

    del folder
    tally = interrupting.rounds(options.rounds, options.seed)
    _row("what happens", "rounds", "longest time to the end", head=True)
    for kind, count in tally.rounds.items():
        _row(kind, str(count), f"{tally.longest[kind]:.1f} s")
    yield from tally.findings


PARTS: dict[str, Callable[[argparse.Namespace, Path], Iterator[str]]] = {
    "live": live,
    "requests": requests,
    "kills": kills,
    "interrupts": interrupts,
}


def _row(*cells: str, head: bool = False) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)
    if head:
        print("|---" * len(cells) + "|", flush=True)


def main() -> None:
    """Run the requested parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PARTS), help=f"parts, separated by commas: {','.join(PARTS)}")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1.0, help="duration of live")
    parser.add_argument("--method", default="full", help="method of the live identification")
    parser.add_argument("--requests", type=int, default=50)
    parser.add_argument("--rounds", type=int, default=3, help="rounds of kills and of interrupts")
    options = parser.parse_args()
    wanted = options.only.split(",")
    if unknown := [name for name in wanted if name not in PARTS]:
        parser.error(f"{', '.join(unknown)}: the parts are {', '.join(PARTS)}")
    print(*machine(), sep="\n")
    findings = []
    with tempfile.TemporaryDirectory(prefix="drive_id_endurance_") as folder:
        for name in wanted:
            part = Path(folder) / name
            part.mkdir()
            print(f"\n{name}\n", flush=True)
            for finding in PARTS[name](options, part):
                print(f"FINDING: {finding}", flush=True)
                findings.append(finding)
    print(f"\n{len(findings)} findings")
    raise SystemExit(bool(findings))


if __name__ == "__main__":
    main()
