"""The command line ``drive-id``: thin, and quick to start because numerics are loaded only when needed."""

import atexit
import dataclasses
import gc
import io
import os
import signal
import sys
from collections.abc import Callable
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from drive_id.cli import console, options
from drive_id.cli.archive import index_results, serve_results
from drive_id.cli.logs import check_log, convert_log
from drive_id.cli.maps import export_result, import_file
from drive_id.cli.plan import plan_experiment
from drive_id.cli.results import analyze, compare_results, report_result, verify_result
from drive_id.common import interrupts
from drive_id.common.quantity import counted
from drive_id.common.version import VERSION
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError, OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from drive_id.fitting.result import Identification
    from drive_id.fitting.sources import Sources

app = typer.Typer(
    name="drive-id",
    help="Identify flux maps, resistance and inverter voltage error of electric drives from ROS 2 bags and other logs.",
    epilog="Exit codes: 0 done, 1 bad input (one line says what), 2 wrong usage, 3 verification not passed.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


class FigureFormat(str, Enum):
    """File format of pictures."""

    png = "png"
    svg = "svg"
    pdf = "pdf"
    pgf = "pgf"


class PictureStyle(str, Enum):
    """Look of pictures."""

    screen = "screen"
    ieee = "ieee"


def main() -> None:
    """Run the command line; on bad input, exit with code 1 and one sentence."""
    atexit.register(gc.freeze)  # a last garbage collection would take a third of a second
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt
    gc.set_threshold(200_000)  # messages are many objects without cycles: collecting took a fifth of a check
    os.environ["MPLBACKEND"] = "agg"  # pictures go to files; another one may not be installed, or not even exist
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for small matrices, more threads only wait
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not fit the terminal's encoding
    with interrupts.taken():
        try:
            _run()
        except BaseException as end:  # Python makes a RuntimeError of it where a class is being made
            if not _is_interrupt(end):
                raise
            console.say(f"drive-id: {interrupts.last_word()}", to=console.err)
            raise SystemExit(130) from None


def _run() -> None:
    """Run the command, and turn what is wrong into one sentence; an interrupt may come during that as well."""
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except DriveIdError as error:
        if "--json" in sys.argv:
            console.print_json({"error": {"code": error.code, "message": str(error)}})
        _fail(str(error))
    except MemoryError:
        _fail("The memory is not sufficient: close other programs, or give less data.")
    except ImportError as error:  # also where the system has no memory or no files left
        if _is_interrupt(error):  # while a library was loaded
            raise
        _fail(f"A library cannot be loaded ({error}): raise the limits of memory and files, or install it again.")
    except OSError as error:
        with suppress(OSError):  # or the interpreter would try the output once more
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        _fail(f"The system refuses a file or the output ({error.strerror or error}): make room, or raise the limit.")


def _fail(sentence: str) -> NoReturn:
    """Print what is wrong and exit with code 1."""
    text = "drive-id: " + "".join(letter if letter.isprintable() else " " for letter in sentence)
    try:
        console.say(text, to=console.err, style="red")
    except (ImportError, MemoryError, OSError):  # which it may be about
        sys.stderr.write(f"{text}\n")
    raise SystemExit(1) from None


def _is_interrupt(end: BaseException | None) -> bool:
    """Tell whether an interrupt ended the work, which typer turns into a silent exit."""
    while end is not None and not isinstance(end, KeyboardInterrupt):
        end = end.__cause__ or end.__context__
    return end is not None


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"drive-id {VERSION}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


def simulate(
    machine: Annotated[
        str, typer.Option(help="ipm, spm, pmsyrm, a machine file (.npz, .mat of SyR-e), or a result folder.")
    ],
    output: Annotated[Path, options.output("Bag (folder) to write.")],
    speed: Annotated[
        list[float] | None, typer.Option(help="Mechanical speed, rpm; may be repeated.  \\[default: 500]")
    ] = None,
    seconds: Annotated[float, typer.Option(help="Duration, s.", min=1e-3)] = 10.0,
    inverter: Annotated[
        str | None, typer.Option(help="none, tanh, dead_time, two_stage or switching.  \\[default: dead_time]")
    ] = None,
    noise: Annotated[float | None, typer.Option(help="RMS current noise, fraction of i_max.  \\[default: 0]")] = None,
    harmonics: Annotated[float | None, typer.Option(help="Factor on the rotor-position harmonics, 0 to 1.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all noise.")] = None,
    pole_pairs: options.PolePairsOption = None,
    u_dc: options.LinkOption = None,
    frequency_d: Annotated[float, typer.Option(help="Frequency of the d current reference, Hz.")] = 3.7,
    frequency_q: Annotated[float, typer.Option(help="Frequency of the q current reference, Hz.")] = 1.1,
    form: Annotated[str, typer.Option(help="Form of the trajectory: smooth, or printed (as in the paper).")] = "smooth",
    free_shaft: Annotated[
        bool,
        typer.Option("--free-shaft", help="No load machine: swing the shaft; --set inertia=..., cogging_torque, ..."),
    ] = False,
    speed_max: Annotated[float, typer.Option(help="Highest speed of a free shaft, rpm.")] = 1500.0,
    mean_speed: Annotated[float, typer.Option(help="Mean speed of a free shaft, rpm.")] = 0.0,
    swing_frequency: Annotated[
        float | None, typer.Option(help="Frequency of the swing, Hz.  \\[default: as the speeds allow]")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with settings of the simulation.")] = None,
    settings: options.SetOption = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Simulate a drive on a Lissajous trajectory, or its free shaft, and record a rosbag2 bag with its ground truth."""
    from drive_id.bench.settings import SimulationSettings
    from drive_id.bench.swing import Swing
    from drive_id.core.experiment.trajectories import Lissajous
    from drive_id.fitting.simulated import load_machine, simulate_bag

    given: dict[str, Any] = {"inverter": inverter, "current_noise": noise, "harmonics": harmonics, "seed": seed}
    given["speeds"] = tuple(speed) if speed else None
    chosen = options.merged_settings(SimulationSettings, config, settings, given)
    trajectory = (
        Swing(speed_max, mean_speed, swing_frequency)
        if free_shaft or chosen.free_shaft
        else Lissajous(frequency_d=frequency_d, frequency_q=frequency_q, form=form)
    )
    with console.working(quiet or as_json, "Simulating"):
        machine_map = load_machine(machine, pole_pairs=pole_pairs, u_dc=u_dc)
        simulation = simulate_bag(machine_map, chosen, output, trajectory, seconds)
    truth = simulation.truth
    if as_json:
        console.print_json({"bag": str(output), "machine": truth.machine, "samples": len(simulation.samples)})
    elif not quiet:
        console.say(
            f"{output}: {counted(len(simulation.samples), 'sample')} of machine {truth.machine}, {truth.i_max:.4g} A."
        )


def fit(
    bags: Annotated[
        list[Path],
        typer.Argument(
            help="Bags or other logs of one drive, or information files.", show_default=False, metavar="BAG..."
        ),
    ],
    output: Annotated[Path | None, options.output("Result folder.  \\[default: LOG_METHOD beside the log]")] = None,
    method: Annotated[
        str | None,
        typer.Option(help="full, static (slow dq log), locked; the paper's: joint, psm.  \\[default: full]"),
    ] = None,
    i_max: options.RadiusOption = None,
    machine: Annotated[str | None, typer.Option(help="Name of the machine, for titles.")] = None,
    serial: Annotated[str | None, typer.Option(help="Serial number of the machine.")] = None,
    rated_current: Annotated[float | None, typer.Option(help="Current of the reported L_d, L_q, A.")] = None,
    signals: options.SignalsOption = None,
    namespace: options.NamespaceOption = "",
    config: options.FitConfigOption = None,
    settings: options.SetOption = None,
    workers: options.WorkersOption = 1,
    dask: options.DaskOption = None,
    skip_bad: options.SkipFlag = False,
    figures: Annotated[bool, typer.Option("--figures", help="Draw pictures of the result.")] = False,
    no_figures: Annotated[bool, typer.Option("--no-figures", help="Draw none, as by default.", hidden=True)] = False,
    figure_format: Annotated[
        FigureFormat | None,
        typer.Option("--figure-format", help="png, svg, pdf or pgf.  \\[default: png]", metavar="FORMAT"),
    ] = None,
    style: Annotated[
        PictureStyle | None,
        typer.Option(help="ieee: 3.5 in wide, serif.  \\[default: screen]", metavar="STYLE"),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write report.html, compared with the paper's methods.")
    ] = False,
    force: options.ForceFlag = False,
    verbose: options.VerboseFlag = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Identify flux maps, resistance and inverter voltage error from recordings."""
    from drive_id.files.results.identification import results_tree
    from drive_id.fitting.fit import fit_bags

    drawn = report or figures or bool((figure_format or style) and not no_figures)
    sources = dataclasses.replace(_sources(bags, signals, namespace, workers, skip_bad=skip_bad), compared=drawn)
    stored = sources.stored_settings()
    chosen = options.merged_settings(
        FitSettings, config, settings,
        {
            "method": method, "i_max": i_max, "machine": machine, "serial": serial, "rated_current": rated_current,
        },
        stored,
    )  # fmt: skip
    output = output or options.beside(bags[0], f"_{chosen.method}")
    with console.working(quiet or as_json) as tell, _placed(sources, dask) as sources:
        result = fit_bags(sources, output, chosen, force=force, tell=tell)
    if as_json:
        console.print_json({"path": str(output)} | results_tree(result.drive, result.provenance))
    elif not quiet:
        console.show_result(result, verbose=verbose)
        console.say(f"Results in {output}")
    sys.stdout.flush()  # the answer does not wait for pictures
    if drawn:
        look = (figure_format or FigureFormat.png).value, (style or PictureStyle.screen).value
        _draw(result, output, look, report=report, quiet=quiet or as_json)


def _draw(result: "Identification", output: Path, look: tuple[Any, str], *, report: bool, quiet: bool) -> None:
    """Add pictures of a format and style, and the report, to a result folder."""
    missing = ""
    try:
        with console.working(quiet, "Writing the report" if report else "Drawing"):
            result.save(output, draw=True, report=report, figure_format=look[0], style=look[1])
    except (DriveIdError, ImportError, OSError, MemoryError) as error:
        missing = str(error).rstrip(".") or "the memory is not sufficient"
    if missing:  # raised here, where nothing holds what the failed pictures took
        raise OutputError(
            f"The result in {output} is complete, but without pictures: {missing[:1].lower()}{missing[1:]}."
        )
    if not quiet:
        console.say(f"Report in {output / 'report.html'}" if report else f"Pictures in {output}")


def _sources(paths: list[Path], signals: Path | None, namespace: str, workers: int, *, skip_bad: bool) -> "Sources":
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.fitting.sources import Sources

    return Sources(paths, read_signals(signals) if signals else None, namespace, workers, skip_bad)


@contextmanager
def _placed(sources: "Sources", dask: str | None) -> "Iterator[Sources]":
    """Give the sources as they are read here, or by the workers of a Dask cluster."""
    if dask is None:
        yield sources
        return
    from drive_id.fitting.dask_cluster import on_dask

    with on_dask(sources, dask) as placed:
        yield placed


def accumulate(
    bags: Annotated[
        list[Path],
        typer.Argument(
            help="Bags (folders or files) or other logs of one drive.", show_default=False, metavar="BAG..."
        ),
    ],
    output: Annotated[
        Path | None, options.output("Information file.  \\[default: a new one beside the log: LOG.info]")
    ] = None,
    i_max: options.RadiusOption = None,
    method: Annotated[
        str | None, typer.Option(help="Method of the later fit; full serves all but locked.  \\[default: full]")
    ] = None,
    signals: options.SignalsOption = None,
    namespace: options.NamespaceOption = "",
    config: options.FitConfigOption = None,
    settings: options.SetOption = None,
    workers: options.WorkersOption = 1,
    dask: options.DaskOption = None,
    skip_bad: options.SkipFlag = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Reduce bags to a small information file, which fit takes in their place."""
    from drive_id.files.results.information import information_tree
    from drive_id.fitting.fit import accumulate_bags

    chosen = options.merged_settings(FitSettings, config, settings, {"method": method, "i_max": i_max})
    sources = _sources(bags, signals, namespace, workers, skip_bad=skip_bad)
    output = output or options.beside(bags[0], ".info")
    with console.working(quiet or as_json) as tell, _placed(sources, dask) as sources:
        result = accumulate_bags(sources, output, chosen, tell)
    if as_json:
        console.print_json({"information": str(output)} | information_tree(result))
    elif not quiet:
        console.warn(*result.warnings)
        console.say(f"{output}: {counted(result.samples, 'sample')}, disc of {result.evidence.i_max:.4g} A.")


def info(
    path: Annotated[
        Path, typer.Argument(help="Bag or other log, result folder, or information file.", show_default=False)
    ],
    verbose: options.VerboseFlag = False,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Show what a bag, a result folder or an information file holds. Messages of a bag are not read."""
    from drive_id.files.logs.log_kind import log_kind
    from drive_id.files.read.info import bag_info
    from drive_id.files.results.folder import is_information, is_result
    from drive_id.reporting.tables import info_table

    if is_information(path):
        _print_information(path, as_json=as_json, quiet=quiet)
        return
    if is_result(path):
        _print_result(path, as_json=as_json, quiet=quiet, verbose=verbose)
        return
    found = bag_info(path)
    if not any(topic.encoding for topic in found.topics) and log_kind(path):
        from drive_id.inspection.spans import with_spans

        found = with_spans(found)
    if as_json:
        console.print_json(dataclasses.asdict(found))
    elif not quiet:
        console.show(info_table(found))
        if found.ground_truth:
            console.say("The recording is a simulation with its ground truth.")
        if found.problem:
            console.warn(found.problem)


def _print_result(path: Path, *, as_json: bool, quiet: bool, verbose: bool) -> None:
    from drive_id.analysis.machine import folded
    from drive_id.files.results.identification import results_tree
    from drive_id.fitting.result import load

    result = load(path)
    if as_json:
        console.print_json({"path": str(path)} | results_tree(result.drive, result.provenance))
    elif not quiet:
        console.show_result(result, verbose=verbose)
        console.warn(*filter(None, [folded(result)]))


def _print_information(path: Path, *, as_json: bool, quiet: bool) -> None:
    from drive_id.files.results.information import information_tree, read_information
    from drive_id.reporting.tables import information_table

    stored = read_information(path)
    if as_json:
        console.print_json({"path": str(path), "software": stored.software} | information_tree(stored.accumulated))
    elif not quiet:
        console.show(information_table(path, stored))
        console.warn(*stored.accumulated.warnings)


def recover(
    bag: Annotated[Path, typer.Argument(help="Damaged MCAP bag (folder or file).", show_default=False)],
    output: Annotated[Path | None, options.output("Bag to write.  \\[default: BAG_recovered]")] = None,
    as_json: options.JsonFlag = False,
    quiet: options.QuietFlag = False,
) -> None:
    """Copy the readable part of a truncated or damaged bag to a new, valid bag."""
    from drive_id.files.write.recover import recover_bag

    recovery = recover_bag(bag, output)
    if as_json:
        console.print_json(dataclasses.asdict(recovery) | {"output": str(recovery.output)})
    elif not quiet:
        for warning in recovery.damage or ("The recording is intact: nothing had to be recovered.",):
            console.say(warning, style="yellow")
        console.say(
            f"{recovery.output}: {counted(sum(recovery.topics.values()), 'message')}, {recovery.duration:.3f} s."
        )


_COMMANDS: dict[str, dict[str, tuple[Callable[..., None], str | None, str]]] = {
    "Everyday": {
        "check": (
            check_log, None,
            "Example: drive-id check log.csv --draft signals.yaml; drive-id check log.csv --signals signals.yaml",
        ),
        "fit": (
            fit, "drive_id.core.fit_settings:FitSettings",
            "For bags with other messages, write a signals file: see config/signals_example_stranger.yaml.",
        ),
        "info": (info, None, ""),
        "report": (
            report_result, None, "Example: drive-id fit bag --output result; drive-id report result -o result.html"
        ),
    },
    "Use of a map": {
        "analyze": (
            analyze, "drive_id.analysis.settings:AnalysisSettings",
            "Example: drive-id analyze result --output analysis --u-dc 400 --temperature 80",
        ),
        "export": (
            export_result, None,
            "Example: drive-id export result --format motulator --output map.npz --grid 41 --range -300 300",
        ),
        "import": (
            import_file, None,
            "Example: drive-id import THOR.mat --output thor; drive-id import map.csv --axis sr --output my_motor",
        ),
        "compare": (compare_results, None, "Example: drive-id compare monday tuesday --output difference.png"),
        "verify": (verify_result, None, "Example: drive-id verify result --bag friday --output certificate.html"),
        "index": (index_results, None, "Example: drive-id index results && xdg-open results/index.html"),
        "serve": (serve_results, None, "Example: drive-id serve results, then open http://127.0.0.1:8080"),
    },
    "Experiment": {
        "plan": (
            plan_experiment, "drive_id.core.planning.settings:PlanSettings",
            "Example: drive-id plan --machine ipm --accuracy 0.05 --speed-max 1000 --output plan.yaml",
        ),
        "simulate": (
            simulate, "drive_id.bench.settings:SimulationSettings",
            "Example: drive-id simulate --machine ipm --output bag; drive-id fit bag --output result",
        ),
    },
    "Data": {
        "convert": (convert_log, None, "Example: drive-id convert log.mf4 bag --signals signals.yaml"),
        "recover": (recover, None, "Example: drive-id recover bag && drive-id fit bag_recovered --output result"),
        "accumulate": (
            accumulate, "drive_id.core.fit_settings:FitSettings",
            "Example: drive-id accumulate mon --i-max 300 --output mon.info; drive-id fit mon.info tue --output all",
        ),
    },
}  # fmt: skip
"""By group of the help and by name: the function, the settings it lists, and the last line of its help."""
for _group, _commands in _COMMANDS.items():
    for _name, (_function, _settings, _epilog) in _commands.items():
        app.command(_name, cls=options.listing(_settings), epilog=_epilog or None, rich_help_panel=_group)(_function)


if __name__ == "__main__":
    main()
