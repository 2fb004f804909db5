"""The command line ``drive-id``: thin, and quick to start because the numerics are loaded only when needed."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

import drive_id
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.settings import from_mapping

if TYPE_CHECKING:
    from drive_id.core.identify import Progress as Tell

app = typer.Typer(
    name="drive-id",
    help="Identify flux maps, resistance and inverter voltage error of electric drives from ROS 2 bags.",
    epilog="Exit codes: 0 done, 1 bad input (one sentence says what), 2 wrong usage.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
out = Console()
err = Console(stderr=True)

Settings = TypeVar("Settings")
JsonFlag = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output, nothing else.")]
QuietFlag = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Any setting by name; may be repeated.")
]
SourcesArgument = Annotated[
    list[Path],
    typer.Argument(help="Bags of one drive, or what 'accumulate' made of them.", show_default=False, metavar="BAG..."),
]
BagsArgument = Annotated[
    list[Path], typer.Argument(help="Bags (folders or files) of one drive.", show_default=False, metavar="BAG...")
]
SignalsOption = Annotated[Path | None, typer.Option(help="YAML file: where the signals are in the bag.")]
NamespaceOption = Annotated[str, typer.Option(help="Of the drive, when a bag holds several.")]
FitConfigOption = Annotated[Path | None, typer.Option(help="YAML file with settings of the fit.")]
RadiusOption = Annotated[float | None, typer.Option(help="Radius of the current disc, A.")]
ClusterOption = Annotated[
    str,
    typer.Option("--dask", metavar="ADDRESS|local[:N]", help="Dask cluster that does the work, or N processes here."),
]
SkipFlag = Annotated[bool, typer.Option("--skip-bad", help="Leave out bags that cannot be used, and warn of them.")]


def main() -> None:
    """Run the command line; bad input ends with exit code 1 and one sentence."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # our matrices are small: more threads only wait
    try:
        app()
    except DriveIdError as error:
        if "--json" in sys.argv:
            typer.echo(json.dumps({"error": {"code": error.code, "message": str(error)}}))
        sentence = "".join(character if character.isprintable() else " " for character in str(error))
        err.print(f"drive-id: {sentence}", style="red", markup=False, highlight=False, soft_wrap=True)
        raise SystemExit(1) from None
    except (KeyboardInterrupt, SystemExit) as end:
        interrupt = _interrupt_behind(end)
        if interrupt is None:
            raise
        said = str(interrupt) or "no output was left behind."
        err.print(f"drive-id: interrupted; {said}", markup=False, highlight=False, soft_wrap=True)
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
    from drive_id.core.trajectories import Lissajous
    from drive_id.sim.settings import SimulationSettings
    from drive_id.workflows import load_machine, simulate_bag

    options: dict[str, Any] = {"inverter": inverter, "current_noise": noise, "harmonics": harmonics, "seed": seed}
    if speed:
        options["speeds"] = tuple(speed)
    chosen = _settings(SimulationSettings, config, settings, options)
    trajectory = Lissajous(frequency_d=frequency_d, frequency_q=frequency_q, form=form)
    with _working(quiet or as_json) as tell:
        tell("Simulating", 0.0)
        simulation = simulate_bag(load_machine(machine), chosen, output, trajectory, seconds)
    truth = simulation.truth
    if as_json:
        typer.echo(json.dumps({"bag": str(output), "machine": truth.machine, "samples": len(simulation.samples)}))
    elif not quiet:
        out.print(
            f"{output}: {len(simulation.samples)} samples of machine {truth.machine}, {truth.i_max:.4g} A.",
            markup=False, highlight=False, soft_wrap=True,
        )  # fmt: skip


@app.command(epilog="A bag of your own messages: write a signals file, see config/signals_example_stranger.yaml.")
def fit(
    bags: SourcesArgument,
    output: Annotated[Path, typer.Option(help="Folder for identification.json, flux_map.npz and a picture.")],
    method: Annotated[
        str | None, typer.Option(help="full, or the paper's: joint, psm (no inverter model).  [default: full]")
    ] = None,
    i_max: RadiusOption = None,
    signals: SignalsOption = None,
    namespace: NamespaceOption = "",
    config: FitConfigOption = None,
    settings: SetOption = None,
    cluster: ClusterOption = "",
    skip_bad: SkipFlag = False,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Identify flux maps, resistance and inverter voltage error from recorded bags."""
    from drive_id.core.fit_settings import FitSettings
    from drive_id.files.results import results_tree
    from drive_id.files.signals import read_signals
    from drive_id.merging import stored_settings
    from drive_id.tables import fit_table
    from drive_id.workflows import fit_bags

    stored = stored_settings(bags, skip_bad=skip_bad)
    chosen = _settings(FitSettings, config, settings, {"method": method, "i_max": i_max}, stored)
    signal_map = read_signals(signals) if signals else None
    with _working(quiet or as_json) as tell:
        result = fit_bags(
            bags, output, chosen, signals=signal_map, namespace=namespace, cluster=cluster, skip_bad=skip_bad,
            force=force, tell=tell,
        )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(results_tree(result.identification, result.provenance), allow_nan=False))
    elif not quiet:
        out.print(fit_table(result))
        for warning in result.warnings:
            out.print(f"Warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
        out.print(f"Results in {output}", markup=False, highlight=False, soft_wrap=True)


@app.command(
    epilog="Example: drive-id accumulate mon --i-max 300 --output mon.info; drive-id fit mon.info tue --output all"
)
def accumulate(
    bags: BagsArgument,
    output: Annotated[Path, typer.Option(help="Information file to write, for example X.info.")],
    i_max: Annotated[
        float | None, typer.Option(help="Radius of the current disc, A.  [default: that of the recorded references]")
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
    from drive_id.files.information import information_tree
    from drive_id.files.signals import read_signals
    from drive_id.workflows import accumulate_bags

    chosen = _settings(FitSettings, config, settings, {"method": method, "i_max": i_max})
    signal_map = read_signals(signals) if signals else None
    with _working(quiet or as_json) as tell:
        result = accumulate_bags(
            bags, output, chosen, signals=signal_map, namespace=namespace, cluster=cluster, skip_bad=skip_bad, tell=tell
        )
    if as_json:
        typer.echo(json.dumps({"information": str(output)} | information_tree(result)))
    elif not quiet:
        for warning in result.warnings:
            out.print(f"Warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
        radius = f"{result.evidence.i_max:.4g} A"
        out.print(
            f"{output}: {result.samples} samples, disc of {radius}.", markup=False, highlight=False, soft_wrap=True
        )


@app.command()
def info(
    bag: Annotated[Path, typer.Argument(help="Bag (folder or file), or information file.", show_default=False)],
    as_json: JsonFlag = False,
) -> None:
    """Tell what a bag holds, without reading its messages, or what an information file does."""
    import dataclasses

    from drive_id.files.bag_info import bag_info
    from drive_id.files.information_name import is_information
    from drive_id.tables import info_table

    if is_information(bag):
        _print_information(bag, as_json=as_json)
        return
    found = bag_info(bag)
    if as_json:
        typer.echo(json.dumps(dataclasses.asdict(found)))
        return
    out.print(info_table(found))
    if found.ground_truth:
        out.print("The recording is a simulation and carries its ground truth.")
    if found.problem:
        out.print(f"Warning: {found.problem}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def _print_information(path: Path, *, as_json: bool) -> None:
    from drive_id.files.information import information_tree, read_information
    from drive_id.tables import information_table

    stored = read_information(path)
    if as_json:
        typer.echo(json.dumps({"path": str(path), "software": stored.software} | information_tree(stored.accumulated)))
        return
    out.print(information_table(path, stored))
    for warning in stored.accumulated.warnings:
        out.print(f"Warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)


@app.command(epilog="Example: drive-id recover bag && drive-id fit bag_recovered --output result")
def recover(
    bag: Annotated[Path, typer.Argument(help="MCAP bag (folder or file) that breaks off.", show_default=False)],
    output: Annotated[Path | None, typer.Option(help="Bag to write.  [default: BAG_recovered]")] = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Make a whole bag, for any reader, of one that breaks off or is damaged; the given one is not touched."""
    import dataclasses

    from drive_id.files.bag_recover import recover_bag

    recovery = recover_bag(bag, output)
    if as_json:
        typer.echo(json.dumps(dataclasses.asdict(recovery) | {"output": str(recovery.output)}))
    elif not quiet:
        for warning in recovery.damage or ("The recording is whole: nothing had to be recovered.",):
            out.print(warning, style="yellow", markup=False, highlight=False, soft_wrap=True)
        out.print(
            f"{recovery.output}: {sum(recovery.topics.values())} messages, {recovery.duration:.3f} s.",
            markup=False, highlight=False, soft_wrap=True,
        )  # fmt: skip


@app.command(
    name="plan",
    epilog="Example: drive-id plan --machine ipm --accuracy 0.05 --speed-max 1000 --output plan.yaml",
)
def plan_experiment(
    machine: Annotated[str, typer.Option(help="ipm, spm, pmsyrm, or a machine file, to take all data from.")] = "",
    i_max: RadiusOption = None,
    pole_pairs: Annotated[int | None, typer.Option(help="Of the machine.")] = None,
    resistance: Annotated[float | None, typer.Option(help="Rough, ohm.")] = None,
    inductance_d: Annotated[float | None, typer.Option(help="Rough, H.")] = None,
    inductance_q: Annotated[float | None, typer.Option(help="Rough, H.")] = None,
    magnet_flux: Annotated[float | None, typer.Option(help="Rough, Wb.")] = None,
    u_dc: Annotated[float | None, typer.Option(help="DC link, V.")] = None,
    sample_period: Annotated[float | None, typer.Option(help="s.  [default: 1e-4]")] = None,
    noise: Annotated[float | None, typer.Option(help="Current noise, fraction of i_max.  [default: 0.001]")] = None,
    speed_min: Annotated[float | None, typer.Option(help="Lowest, rpm.  [default: 250]")] = None,
    speed_max: Annotated[float | None, typer.Option(help="Highest, rpm.  [default: 1500]")] = None,
    reverse: Annotated[bool | None, typer.Option("--reverse/--one-direction", help="Turn backwards, too.")] = None,
    accuracy: Annotated[float | None, typer.Option(help="Of the flux, percent.  [default: 0.05]")] = None,
    duration: Annotated[float | None, typer.Option(help="s.  [default: what the accuracy needs]")] = None,
    duration_max: Annotated[float | None, typer.Option(help="s.  [default: 60]")] = None,
    output: Annotated[Path | None, typer.Option(help="File of ROS parameters to write (YAML).")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with settings of the plan.")] = None,
    settings: SetOption = None,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Propose trajectory, speeds and duration for a wanted accuracy, from rough data of the machine."""
    from drive_id.core.plan import plan
    from drive_id.core.plan_settings import PlanSettings
    from drive_id.files.plan_file import check_plan_output, plan_tree, plan_yaml, write_plan
    from drive_id.tables import plan_tables
    from drive_id.workflows import rough_settings

    options: dict[str, Any] = {
        "i_max": i_max, "pole_pairs": pole_pairs, "resistance": resistance, "inductance_d": inductance_d,
        "inductance_q": inductance_q, "magnet_flux": magnet_flux, "u_dc": u_dc, "sample_period": sample_period,
        "current_noise": noise, "speed_min": speed_min, "speed_max": speed_max, "reverse": reverse,
        "accuracy": accuracy, "duration": duration, "duration_max": duration_max,
    }  # fmt: skip
    chosen = _settings(PlanSettings, config, settings, options, rough_settings(machine) if machine else None)
    if output is not None:
        check_plan_output(output)
    with _working(quiet or as_json) as tell:
        found = plan(chosen, tell)
    text = plan_yaml(found, machine)
    if output is not None:
        write_plan(output, text)
    if as_json:
        typer.echo(json.dumps(plan_tree(found), allow_nan=False))
    elif not quiet:
        for table in plan_tables(found):
            out.print(table)
        for sentence in (found.reason(), *found.statements()):
            out.print(sentence, markup=False, highlight=False, soft_wrap=True)
        for warning in found.warnings():
            out.print(f"Warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
        shown = f"Written to {output}" if output is not None else "\n" + text.rstrip()
        out.print(shown, markup=False, highlight=False, soft_wrap=True)


@app.command()
def reproduce(
    output: Annotated[Path | None, typer.Option(help="Folder for the tables and figures.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False,
    as_json: JsonFlag = False,
    quiet: QuietFlag = False,
) -> None:
    """Print the paper's tables for the shipped simulated drives, and draw its figures."""
    from drive_id.reproduction import check_reproduction_output, write_reproduction
    from drive_id.reproduction import reproduce as run

    if output is not None:
        check_reproduction_output(output, force=force)
    with _working(quiet or as_json) as tell:
        results = run(tell)
        if output is not None:
            write_reproduction(output, results, force=force)
    if as_json:
        typer.echo(json.dumps(results.tree(), allow_nan=False))
    elif not quiet:
        for table in results.tables():
            out.print(table)
        for sentence in results.claims():
            out.print(sentence, highlight=False, soft_wrap=True)


def _settings(
    cls: Callable[..., Settings],
    config: Path | None,
    assignments: list[str] | None,
    options: dict[str, Any],
    base: Settings | None = None,
) -> Settings:
    """Merge settings to start from, a YAML file, --set and named options, the later ones winning."""
    import dataclasses

    import yaml

    unreadable = (OSError, ValueError, RecursionError, yaml.YAMLError)
    values: dict[str, Any] = dataclasses.asdict(base) if base else {}  # type: ignore[call-overload]  # a dataclass
    if config is not None:
        try:
            tree = yaml.safe_load(config.read_text(encoding="utf-8"))
        except unreadable as error:
            reason = getattr(error, "problem", None) or getattr(error, "strerror", None) or "it is no YAML"
            raise ConfigurationError(f"The settings file {config} cannot be read ({reason}): check it.") from error
        if not isinstance(tree, dict | None):
            raise ConfigurationError(f"The settings file {config} is not a list of 'name: value' lines: rewrite it so.")
        values |= tree or {}
    for assignment in assignments or []:
        name, sign, text = assignment.partition("=")
        if not sign:
            raise ConfigurationError(f"--set {assignment} is not of the form NAME=VALUE: write it so.")
        try:
            values[name.strip()] = yaml.safe_load(text)
        except unreadable as error:
            raise ConfigurationError(f"The value in --set {assignment:.200} is not valid YAML: quote it.") from error
    chosen = {name: value for name, value in options.items() if value is not None}
    where = [str(config)] if config else []
    where += ["the options"] if assignments or chosen or not config else []
    return from_mapping(cls, values | chosen, " and ".join(where))  # type: ignore[arg-type]  # a dataclass


@contextmanager
def _working(silent: bool) -> Iterator[Tell]:
    """Show a progress bar on standard error while the body works."""
    columns = (
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with Progress(*columns, console=err, transient=True, disable=silent or not err.is_terminal) as bar:
        task = bar.add_task("Starting", total=1.0)
        doing = ""

        def tell(what: str, share: float) -> None:
            nonlocal doing
            name = what.partition(",")[0]
            if name != doing:  # another task, which takes another time
                doing = name
                bar.reset(task)
            bar.update(task, description=what, completed=share)

        yield tell


if __name__ == "__main__":
    main()
