"""Shared by the commands of ``drive-id``: options, merging of settings, output to the console."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.text import Text
from typer.core import TyperCommand

from drive_id.errors import ConfigurationError
from drive_id.settings import from_mapping

if TYPE_CHECKING:
    from rich.console import Console
    from rich.segment import Segment
    from rich.table import Table

    from drive_id.fitting.result import Identification
    from drive_id.types import Progress as Tell

Settings = TypeVar("Settings")
_PIPE_WIDTH = 200
"""Characters per line when the output is not a terminal."""
_LARGEST_CONFIG, _MOST_SETTINGS = 1 << 20, 10_000
JsonFlag = Annotated[bool, typer.Option("--json", help="Print machine-readable output.")]
QuietFlag = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
VerboseFlag = Annotated[
    bool,
    typer.Option("--verbose", "-v", help="Also show what was tested and not found, and figures of the regression."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Any setting by its name, see below; may be repeated."),
]
SourcesArgument = Annotated[
    list[Path],
    typer.Argument(help="Bags or other logs of one drive, or information files.", show_default=False, metavar="BAG..."),
]
BagsArgument = Annotated[
    list[Path],
    typer.Argument(help="Bags (folders or files) or other logs of one drive.", show_default=False, metavar="BAG..."),
]
SignalsOption = Annotated[Path | None, typer.Option(help="YAML file that says where the signals are in the log.")]
NamespaceOption = Annotated[str, typer.Option(help="ROS namespace of the drive, when a bag holds several.")]
FitConfigOption = Annotated[Path | None, typer.Option(help="YAML file with fit settings.")]
RadiusOption = Annotated[
    float | None, typer.Option(help="Radius of the current disc, A.  \\[default: that of the recorded references]")
]
PolePairsOption = Annotated[
    int | None, typer.Option("--pole-pairs", help="Number of pole pairs, if the result does not contain it.", min=1)
]
LinkOption = Annotated[
    float | None, typer.Option("--u-dc", help="DC-link voltage, V.  \\[default: that of the result]", min=1e-3)
]
WorkersOption = Annotated[int, typer.Option(help="Processes that read the bags.", min=1)]


class FigureFormat(str, Enum):
    """File format of pictures."""

    png = "png"
    svg = "svg"
    pdf = "pdf"


FigureFormatOption = Annotated[
    FigureFormat | None, typer.Option("--figure-format", help="Format of the pictures.  \\[default: png]")
]
FiguresFlag = Annotated[
    bool | None,
    typer.Option("--figures/--no-figures", help="Also draw pictures, after the result is printed.  \\[default: no]"),
]
SkipFlag = Annotated[bool, typer.Option("--skip-bad", help="Leave out bags that cannot be used, with a warning.")]


def listing(settings: Callable[[], type[Any]]) -> type[TyperCommand]:
    """Return a class of commands whose help lists the settings of the dataclass that is returned."""

    class Listing(TyperCommand):
        def format_help(self, ctx: Any, formatter: Any) -> None:
            super().format_help(ctx, formatter)
            import json
            from dataclasses import fields

            from drive_id.quantity import spelled
            from drive_id.reporting.tables import plain_table

            table = plain_table("Settings for --set NAME=VALUE and --config", ["Name", "Default", "Meaning"])
            for entry in fields(settings()):
                meaning, unit = entry.metadata["description"], spelled(entry.metadata["unit"])
                default = entry.default if isinstance(entry.default, str) else json.dumps(entry.default)
                shown = "" if entry.default in (None, ()) else default
                table.add_row(entry.name, Text(shown), Text(f"{meaning}, {unit}" if unit else meaning))
            _console().print(table)

    return Listing


@cache
def out() -> Console:
    """Return standard output, as wide as the terminal; in a file or a pipe, wide enough for any table."""
    console = _console()
    return console if console.is_terminal else _console(width=_PIPE_WIDTH)


@cache
def err() -> Console:
    """Return standard error."""
    return _console(stderr=True)


def _console(**options: Any) -> Console:
    """Return a console that prints no control characters of its texts: files have names that move the cursor."""
    from rich.console import Console

    class Printable(Console):
        def render(self, *arguments: Any, **options: Any) -> Iterator[Segment]:
            for segment in super().render(*arguments, **options):
                text = "".join(letter for letter in segment.text if letter.isprintable() or letter == "\n")
                yield segment if segment.control else segment._replace(text=text)

    return Printable(**options)


def say(sentence: str, *, to: Callable[[], Console] = out, style: str | None = None) -> None:
    """Print text as it is."""
    to().print(sentence, style=style, markup=False, highlight=False, soft_wrap=True)


def show(table: Table) -> None:
    """Print a table, its title on one line whatever the width of the terminal."""
    if table.title:
        out().print(table.title, style="table.title", highlight=False, soft_wrap=True)
        table.title = None
    out().print(table)


def show_result(result: Identification, *, verbose: bool = False) -> None:
    """Print a result: values and quality, one line of advice, warnings, statements; what was not found if verbose."""
    from drive_id.reporting.tables import fit_table
    from drive_id.result.advice import sorted_statements

    show(fit_table(result, verbose=verbose))
    for sentence in result.advice[:1]:
        say(f"What would help most: {sentence}")
    for warning in result.warnings:
        warn(warning)
    found, nothing = sorted_statements(result.drive)
    for statement in (*found, *(nothing if verbose else ())):
        say(statement)


def warn(sentence: str) -> None:
    """Print a warning."""
    say(f"Warning: {sentence}", style="yellow")


def merged_settings(
    cls: Callable[..., Settings],
    config: Path | None,
    assignments: list[str] | None,
    options: dict[str, Any],
    base: Settings | None = None,
) -> Settings:
    """Merge base settings, a YAML file, --set and named options; later ones win."""
    import dataclasses

    import yaml

    from drive_id.files.inputs.input_file import read_text_input
    from drive_id.files.inputs.yaml_tree import load_yaml

    unreadable = (OSError, ValueError, RecursionError, yaml.YAMLError)
    values: dict[str, Any] = dataclasses.asdict(base) if base else {}  # type: ignore[call-overload]  # a dataclass
    if config is not None:
        try:
            tree = load_yaml(read_text_input(config, _LARGEST_CONFIG), _MOST_SETTINGS)
        except unreadable as error:
            reason = getattr(error, "problem", None) or getattr(error, "strerror", None) or "it is not YAML"
            raise ConfigurationError(f"The settings file {config} cannot be read ({reason}): check it.") from error
        if not isinstance(tree, dict | None):
            raise ConfigurationError(f"The settings file {config} is not made of 'name: value' lines: rewrite it so.")
        values |= tree or {}
    for assignment in assignments or []:
        name, sign, text = assignment.partition("=")
        if not sign:
            raise ConfigurationError(f"--set {assignment} is not of the form NAME=VALUE: write it so.")
        try:
            values[name.strip()] = load_yaml(text, _MOST_SETTINGS)
        except unreadable as error:
            raise ConfigurationError(f"The value in --set {assignment:.200} is not valid YAML: quote it.") from error
    chosen = {name: value for name, value in options.items() if value is not None}
    where = [str(config)] if config else []
    where += ["the options"] if assignments or chosen or not config else []
    return from_mapping(cls, values | chosen, " and ".join(where))  # type: ignore[arg-type]  # a dataclass


@contextmanager
def working(silent: bool) -> Iterator[Tell]:
    """Show a progress bar on standard error while the body works, if that is a terminal, not only coloured."""
    if silent or not (err().is_terminal and err().file.isatty()):
        yield lambda _what, _share: None
        return
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with Progress(*columns, console=err(), transient=True) as bar:
        task = bar.add_task("Starting", total=None)  # no total: the bar pulses and shows no percentage
        doing = ""

        def tell(what: str, share: float | None) -> None:
            nonlocal doing, task
            name = what.partition(",")[0]
            if name != doing:  # a new step with its own clock
                doing = name
                bar.remove_task(task)
                task = bar.add_task(what, total=None if share is None else 1.0)
            bar.update(task, description=what, completed=share or 0.0)

        yield tell
