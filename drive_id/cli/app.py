"""The command line ``drive-id``: thin, and quick to start because the numerics are loaded only when needed."""

import atexit
import gc
import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

import drive_id
from drive_id.cli.options import (
    BagsArgument,
    ClusterOption,
    FigureFormat,
    FigureFormatOption,
    FitConfigOption,
    JsonFlag,
    NamespaceOption,
    QuietFlag,
    RadiusOption,
    SetOption,
    SignalsOption,
    SkipFlag,
    SourcesArgument,
    err,
    merged_settings,
    out,
    say,
    show,
    warn,
    working,
)
from drive_id.cli.plan import plan_experiment
from drive_id.errors import DriveIdError

app = typer.Typer(
    name="drive-id",
    help="Identify flux maps, resistance and inverter voltage error of electric drives from ROS 2 bags.",
    epilog="Exit codes: 0 done, 1 bad input (one sentence says what), 2 wrong usage.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def main() -> None:
    """Run the command line; bad input ends with exit code 1 and one sentence."""
    atexit.register(gc.freeze)  # the process ends: to look for garbage once more takes a third of a second
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # our matrices are small: more threads only wait
    try:
        app()
    except DriveIdError as error:
        if "--json" in sys.argv:
            typer.echo(json.dumps({"error": {"code": error.code, "message": str(error)}}))
        sentence = "".join(character if character.isprintable() else " " for character in str(error))
        say(f"drive-id: {sentence}", to=err, style="red")
        raise SystemExit(1) from None
    except (KeyboardInterrupt, SystemExit) as end:
        interrupt = _interrupt_behind(end)
        if interrupt is None:
            raise
        said = str(interrupt) or "no output was left behind."
        say(f"drive-id: interrupted; {said}", to=err)
        raise SystemExit(130) from None


def _interrupt_behind(end: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt that typer made a silent exit of."""
    while end is not None and not isinstance(end, KeyboardInterrupt):
        end = end.__cause__ or end.__context__
    return end


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"drive-id {drive_id.__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: drive-id simulate --machine ipm --output bag; drive-id fit bag --output result")
def simulate(
    machine: Annotated[str, typer.Option(help="ipm, spm, pmsyrm, or a machine file (.npz, SyR-e .mat).")],
    output: Annotated[Path, typer.Option(help="Bag (folder) to write.")],
    speed: Annotated[list[float] | None, typer.Option(help="Mechanical, rpm; repeat for several in turn.")] = None,
    seconds: Annotated[float, typer.Option(help="Duration, s.", min=1e-3)] = 10.0,
    inverter: Annotated[str | None, typer.Option(help="none, tanh, dead_time or two_stage.")] = None,
    noise: Annotated[float | None, typer.Option(help="Current noise, as a fraction of i_max.")] = None,
    harmonics: Annotated[float | None, typer.Option(help="Factor on the rotor-position harmonics, 0 to 1.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of all noise.")] = None,
    frequency_d: Annotated[float, typer.Option(help="Of the d reference, Hz.")] = 3.7,
    frequency_q: Annotated[float, typer.Option(help="Of the q reference, Hz.")] = 1.1,
    form: Annotated[str, typer.Option(help="Lissajous root: smooth, or printed as in the paper.")] = "smooth",
    config: Annotated[Path | None, typer.Option(help="YAML file with settings of the simulation.")] = None,
    settings: SetOption = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Simulate a drive on a Lissajous trajectory and record it as a rosbag2 bag, its ground truth attached."""
    from drive_id.bench.settings import SimulationSettings
    from drive_id.core.experiment.trajectories import Lissajous
    from drive_id.fitting.simulated import load_machine, simulate_bag

    options: dict[str, Any] = {"inverter": inverter, "current_noise": noise, "harmonics": harmonics, "seed": seed}
    if speed:
        options["speeds"] = tuple(speed)
    chosen = merged_settings(SimulationSettings, config, settings, options)
    trajectory = Lissajous(frequency_d=frequency_d, frequency_q=frequency_q, form=form)
    with working(quiet or as_json) as tell:
        tell("Simulating", None)
        simulation = simulate_bag(load_machine(machine), chosen, output, trajectory, seconds)
    truth = simulation.truth
    if as_json:
        typer.echo(json.dumps({"bag": str(output), "machine": truth.machine, "samples": len(simulation.samples)}))
    elif not quiet:
        say(f"{output}: {len(simulation.samples)} samples of machine {truth.machine}, {truth.i_max:.4g} A.")


@app.command(epilog="A bag of your own messages: write a signals file, see config/signals_example_stranger.yaml.")
def fit(
    bags: SourcesArgument,
    output: Annotated[Path, typer.Option(help="Folder for identification.json, flux_map.npz and pictures.")],
    method: Annotated[
        str | None, typer.Option(help="full, or the paper's: joint, psm (no inverter model).  \\[default: full]")
    ] = None,
    i_max: RadiusOption = None,
    signals: SignalsOption = None,
    namespace: NamespaceOption = "",
    config: FitConfigOption = None,
    settings: SetOption = None,
    cluster: ClusterOption = "",
    skip_bad: SkipFlag = False,
    figure_format: FigureFormatOption = FigureFormat.png,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Identify flux maps, resistance and inverter voltage error from recorded bags."""
    from functools import partial

    from drive_id.core.fit_settings import FitSettings
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.results.folder import results_tree
    from drive_id.fitting.merging import stored_settings
    from drive_id.fitting.workflows import fit_bags
    from drive_id.report.plots import result_pictures
    from drive_id.report.tables import fit_table

    stored = stored_settings(bags, skip_bad=skip_bad)
    chosen = merged_settings(FitSettings, config, settings, {"method": method, "i_max": i_max}, stored)
    signal_map = read_signals(signals) if signals else None
    with working(quiet or as_json) as tell:
        result = fit_bags(
            bags, output, chosen, signals=signal_map, namespace=namespace, cluster=cluster, skip_bad=skip_bad,
            force=force, draw=partial(result_pictures, figure_format=figure_format.value), tell=tell,
        )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(results_tree(result.identification, result.provenance), allow_nan=False))
    elif not quiet:
        show(fit_table(result))
        for warning in result.warnings:
            warn(warning)
        say(f"Results in {output}")


@app.command(
    epilog="Example: drive-id accumulate mon --i-max 300 --output mon.info; drive-id fit mon.info tue --output all"
)
def accumulate(
    bags: BagsArgument,
    output: Annotated[Path, typer.Option(help="Information file to write, for example X.info.")],
    i_max: Annotated[
        float | None, typer.Option(help="Radius of the current disc, A.  \\[default: that of the recorded references]")
    ] = None,
    method: Annotated[str | None, typer.Option(help="To be fitted with, full also with the others.")] = None,
    signals: SignalsOption = None,
    namespace: NamespaceOption = "",
    config: FitConfigOption = None,
    settings: SetOption = None,
    cluster: ClusterOption = "",
    skip_bad: SkipFlag = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Keep of bags what a fit needs, in a small file: fitting such files together is fitting the bags together."""
    from drive_id.core.fit_settings import FitSettings
    from drive_id.files.messages.signals_file import read_signals
    from drive_id.files.results.information import information_tree
    from drive_id.fitting.workflows import accumulate_bags

    chosen = merged_settings(FitSettings, config, settings, {"method": method, "i_max": i_max})
    signal_map = read_signals(signals) if signals else None
    with working(quiet or as_json) as tell:
        result = accumulate_bags(
            bags, output, chosen, signals=signal_map, namespace=namespace, cluster=cluster, skip_bad=skip_bad, tell=tell
        )
    if as_json:
        typer.echo(json.dumps({"information": str(output)} | information_tree(result)))
    elif not quiet:
        for warning in result.warnings:
            warn(warning)
        radius = f"{result.evidence.i_max:.4g} A"
        say(f"{output}: {result.samples} samples, disc of {radius}.")


@app.command()
def info(
    bag: Annotated[Path, typer.Argument(help="Bag (folder or file), or information file.", show_default=False)],
    as_json: JsonFlag = False,
) -> None:
    """Tell what a bag holds, without reading its messages, or what an information file does."""
    import dataclasses

    from drive_id.files.read.info import bag_info
    from drive_id.files.results.information_name import is_information
    from drive_id.report.tables import info_table

    if is_information(bag):
        _print_information(bag, as_json=as_json)
        return
    found = bag_info(bag)
    if as_json:
        typer.echo(json.dumps(dataclasses.asdict(found)))
        return
    show(info_table(found))
    if found.ground_truth:
        say("The recording is a simulation and carries its ground truth.")
    if found.problem:
        warn(found.problem)


def _print_information(path: Path, *, as_json: bool) -> None:
    from drive_id.files.results.information import information_tree, read_information
    from drive_id.report.tables import information_table

    stored = read_information(path)
    if as_json:
        typer.echo(json.dumps({"path": str(path), "software": stored.software} | information_tree(stored.accumulated)))
        return
    show(information_table(path, stored))
    for warning in stored.accumulated.warnings:
        warn(warning)


@app.command(epilog="Example: drive-id recover bag && drive-id fit bag_recovered --output result")
def recover(
    bag: Annotated[Path, typer.Argument(help="MCAP bag (folder or file) that breaks off.", show_default=False)],
    output: Annotated[Path | None, typer.Option(help="Bag to write.  \\[default: BAG_recovered]")] = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Make a whole bag, for any reader, of one that breaks off or is damaged; the given one is not touched."""
    import dataclasses

    from drive_id.files.write.recover import recover_bag

    recovery = recover_bag(bag, output)
    if as_json:
        typer.echo(json.dumps(dataclasses.asdict(recovery) | {"output": str(recovery.output)}))
    elif not quiet:
        for warning in recovery.damage or ("The recording is whole: nothing had to be recovered.",):
            say(warning, style="yellow")
        say(f"{recovery.output}: {sum(recovery.topics.values())} messages, {recovery.duration:.3f} s.")


app.command(
    name="plan",
    epilog="Example: drive-id plan --machine ipm --accuracy 0.05 --speed-max 1000 --output plan.yaml",
)(plan_experiment)


@app.command()
def reproduce(
    output: Annotated[Path | None, typer.Option(help="Folder for the tables and figures.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Print the paper's tables for the shipped simulated drives, and draw its figures."""
    from drive_id.report.reproduction import check_reproduction_output, write_reproduction
    from drive_id.report.reproduction import reproduce as run

    if output is not None:
        check_reproduction_output(output, force=force)
    with working(quiet or as_json) as tell:
        results = run(tell)
        if output is not None:
            write_reproduction(output, results, force=force)
    if as_json:
        typer.echo(json.dumps(results.tree(), allow_nan=False))
    elif not quiet:
        for table in results.tables():
            show(table)
        for sentence in results.claims():
            out().print(sentence, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
