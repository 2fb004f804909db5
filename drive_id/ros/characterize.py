"""``characterize``: run one experiment with the nodes of a drive, identify it, and print the results.

Requires the nodes ``experiment``, ``trajectory_publisher``, ``recorder`` and ``identification``, and a drive (or
``bench_simulator``) that publishes ``phase_currents``, ``phase_voltages`` and ``resolver`` and follows
``current_reference``::

    with --first-start: find angle and acceleration of a drive without load machine, and write files that say so
    a goal of the action of the node experiment: record one trajectory, identify the drive

With ``--clear-fault``, nothing but a latched trip of the publisher is cleared.

All names are relative: ``--ros-args -r __ns:=/drive_1`` selects the nodes of a namespace. Whatever goes wrong, the
drive is left at zero current, and one sentence says what it was.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from rclpy.exceptions import ROSInterruptException
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from drive_id.common.quantity import counted
from drive_id.errors import DriveIdError, ExperimentError
from drive_id.files.machines.ground_truth import decode_truth
from drive_id.fitting.result import load
from drive_id.nodes.support.arguments import ros_arguments
from drive_id.nodes.support.replies import NAMES
from drive_id.ros.bench import Bench, Identified
from drive_id.ros.calls import Progress
from drive_id.ros.comparison import comparison
from drive_id.ros.first_start import commission, swing_up
from drive_id.types import GroundTruth

RECORDED = "recording"
"""Title of the only column without a comparison."""
COMPARED = {  # title of the column: whether from the recording, method
    "live, joint": (False, "joint"),  # at once: its sums are accumulated already
    "live, full": (False, "full"),
    "recording, full": (True, "full"),
    "recording, psm": (True, "psm"),
}
_HEARTBEAT = 5.0
"""Time between reports where the output is no terminal, s."""
_CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)
_WIDTH = 200  # characters: more than the table ever takes, so that it looks the same on every terminal


def say(sentence: str) -> None:
    """Print a sentence as one line."""
    _CONSOLE.print(sentence)


@contextmanager
def telling(console: Console) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that shows progress: a bar on a terminal, elsewhere a line every few seconds."""
    if not console.is_terminal:
        told = [0.0]

        def print_line(now: Progress) -> None:
            if now.waited < told[0]:
                told[0] = 0.0
            if now.waited > told[0] + _HEARTBEAT:
                told[0] = now.waited
                say(f"   {now.waited:3.0f} s  {now.sentence}")

        yield print_line
        return
    columns = (
        BarColumn(30),
        TextColumn("{task.fields[covered]}"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, covered="")

        def show(now: Progress) -> None:
            runs = 0 < now.elapsed < now.duration
            bar.update(
                task,
                description=now.sentence,
                total=now.duration if runs else None,
                completed=now.elapsed if runs else 0,
                covered=f"{100 * now.coverage:3.0f} % of the disc" if runs and now.of_disc else "",
            )

        yield show


def plain_folder(output: Path, title: str) -> Path:
    """Return the folder, with a plain name, for the result with this title."""
    return output / title.replace(", ", "_")


def read_truth(path: Path) -> GroundTruth:
    """Read what bench_simulator wrote when it was started."""
    try:
        return decode_truth(path.read_bytes(), str(path))
    except OSError as error:
        reason = error.strerror or error
        raise ExperimentError(f"The truth in {path} cannot be read ({reason}): give another --truth.") from error


def prepare_output(output: Path, titles: Iterable[str]) -> None:
    """Create the folder for the results, before anything starts; refuse a folder that already holds results."""
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise ExperimentError(f"{output} cannot be made a folder ({reason}): give another --output.") from error
    for folder in (plain_folder(output, title) for title in titles):
        if folder.exists():
            raise ExperimentError(f"{folder} exists already: remove it, or give another --output.")


def keep(results: Mapping[str, Identified], truth: GroundTruth | None, output: Path) -> None:
    """Write the table, rename the result folders to plain names, and print the statements of the fits."""
    with (output / "table.txt").open("w", encoding="utf-8") as file:
        Console(file=file, width=_WIDTH).print(comparison(results, truth))
    stated: dict[str, list[str]] = {}  # by title
    for title, result in results.items():
        folder = plain_folder(output, title)
        shutil.move(result.output, folder)
        document = json.loads((folder / "identification.json").read_text(encoding="utf-8"))
        stated[title] = document["statements"]
        if len(results) == 1:
            found = load(folder)
            found.report(folder / "report.html")
            for quantity in found.headline:  # more than a reply tells
                say(f"   {quantity.name}: {quantity}")
    print_sentences("What the fits state:", stated)
    say(f"Results: {', '.join(str(plain_folder(output, title)) for title in results)}")


def print_sentences(heading: str, found: Mapping[str, Iterable[str]]) -> None:
    """Print the sentences of results by title: each sentence once, with the titles of the results that hold it."""
    titles: dict[str, list[str]] = {}
    for title, sentences in found.items():
        for sentence in sentences:
            titles.setdefault(sentence, []).append(title)
    if titles:
        say(heading)
    for sentence, where in titles.items():
        say(f"   {'; '.join(where)}: {sentence}")


def characterize(bench: Bench, options: argparse.Namespace) -> int:
    """Run the experiment, print and keep its results, and return the exit code."""
    say("1. The nodes are started.")
    bench.wait_until_ready(options.start_up)
    truth = read_truth(options.truth) if options.truth else None
    signals = ""
    if options.first_start:
        say("   All nodes are ready: first start.")
        name = options.recording or time.strftime("%Y%m%d_%H%M%S")
        commissioned = commission(
            bench, options.output, name, lambda _, sentence: say(f"   {sentence}"), angle_known=options.angle_known
        )
        say(f"   {commissioned.sentence()}")
        signals = str(commissioned.signals.resolve())
        if not options.free_shaft:
            say(f"Results: {commissioned.parameters}, {commissioned.signals}")
            return 0
    elif options.free_shaft:
        swing_up(bench)
    say("2. All nodes are ready: the trajectory is recorded, then the drive is identified.")
    names = {name: getattr(options, name) for name in NAMES}
    wanted = {"signals": signals, "i_max": options.i_max, "repeat": options.repeat, "duration": options.duration}
    results: dict[str, Identified] = {}
    if options.compare:
        recording = bench.run_experiment(options.recording, **wanted)
        say(f"   {recording.message}")
        say("3. The drive is identified.")
        for title, (recorded, method) in COMPARED.items():
            begin = time.monotonic()
            bags = [recording.uri] if recorded else []
            results[title] = bench.identify(bags, method, signals if recorded else "", i_max=options.i_max, **names)
            say(f"   {title}: {time.monotonic() - begin:.1f} s")
    else:
        recording, results[RECORDED] = bench.characterize(options.recording, method=options.method, **wanted, **names)
        say(f"   {recording.message}")
    Console(width=_WIDTH).print(comparison(results, truth))
    print_sentences("Warnings:", {title: result.report.warnings for title, result in results.items()})
    if options.output:
        keep(results, truth, options.output)
    else:
        say(f"Results: {', '.join(result.output for result in results.values())}")
    if recording.dropped:
        sys.stderr.write(
            f"characterize: lost {counted(recording.dropped, 'sample')}: see the recorder's diagnostics.\n"
        )
    return 1 if recording.dropped else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="characterize", description="Record one trajectory, identify the drive, print the result."
    )
    parser.add_argument("--recording", default="", help="name of the recording; default: date and time")
    parser.add_argument("--method", default="", help="full, joint or psm; default: as the node is configured")
    for name in NAMES:
        parser.add_argument(f"--{name}", default="", help="for titles and files; default: as the node is configured")
    parser.add_argument("--i-max", type=float, default=0.0, help="A; default: as trajectory_publisher is configured")
    parser.add_argument("--duration", type=float, default=0.0, help="of the trajectory, s; likewise")
    parser.add_argument("--repeat", type=int, default=0, help="repetitions of the trajectory; likewise")
    parser.add_argument("--compare", action="store_true", help="identify live and recorded, by all methods")
    parser.add_argument(
        "--first-start", action="store_true", help="find angle and acceleration of a drive without load machine first"
    )
    parser.add_argument(
        "--angle-known", action="store_true", help="with --first-start: angle_offset is set already, only shake"
    )
    parser.add_argument(
        "--drive", default="", help="with --first-start: node of the drive, with parameters encoder_offset, ..."
    )
    parser.add_argument("--free-shaft", action="store_true", help="trajectory free_shaft: without load machine")
    parser.add_argument("--truth", type=Path, help="file that bench_simulator wrote, to compare with")
    parser.add_argument("--output", type=Path, help="folder, made if missing, for the table and the results")
    parser.add_argument(
        "--clear-fault", action="store_true", help="only clear a trip of the trajectory publisher whose cause is gone"
    )
    parser.add_argument("--timeout", type=float, default=60.0, help="for each step, s")
    parser.add_argument("--start-up", type=float, default=300.0, help="time for all nodes to become ready, s")
    with ros_arguments():
        own = remove_ros_args(sys.argv)[1:]
    options = parser.parse_args(own)
    if options.first_start and not options.output:
        parser.error("--first-start needs --output, the folder for its files")
    if options.first_start and options.compare:
        parser.error("--compare identifies live samples as well, which do not know the angle of a --first-start")
    return options


def main() -> None:
    """Run the experiment and print its table; the exit code is 0 only if everything succeeded."""
    try:
        options = _options()
    except DriveIdError as error:
        sys.stderr.write(f"characterize: {error}\n")
        sys.exit(1)
    # Ctrl-C shall raise KeyboardInterrupt here, also in the background of a script, which would ignore it; so shall a
    # request to end and, without nohup, the loss of the terminal.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    sys.exit(_run(options))


def _run(options: argparse.Namespace) -> int:
    bench: Bench | None = None
    try:
        if options.output:
            prepare_output(options.output, COMPARED if options.compare else (RECORDED,))
        with telling(_CONSOLE) as tell:
            bench = Bench(drive=options.drive, timeout=options.timeout, tell=tell, arguments=sys.argv)
            if options.clear_fault:
                bench.wait_for_publisher()
                say(bench.clear_fault())
                return 0
            return characterize(bench, options)
    except (DriveIdError, OSError, KeyboardInterrupt, ROSInterruptException) as error:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # one is enough, and the drive must come to rest
        said = bench.stop() if bench is not None else []  # before anything is written: the terminal may be gone
        sys.stderr.write(f"characterize: {str(error) or 'interrupted'}\n")
        for sentence in said:
            sys.stderr.write(f"   {sentence}\n")
        return 1
    finally:
        if bench is not None:
            bench.close()


if __name__ == "__main__":
    main()
