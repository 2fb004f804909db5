"""Options that commands of ``drive-id`` share, merging of settings, and where a command writes when it is not told."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, fields
from itertools import count
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, TypeVar, get_type_hints

import typer
from rich.text import Text
from typer.core import TyperCommand, TyperOption

from drive_id.cli.console import printable
from drive_id.common.quantity import spelled
from drive_id.common.settings import from_mapping
from drive_id.errors import ConfigurationError
from drive_id.files.inputs.remote import url_of

Settings = TypeVar("Settings")
_LARGEST_CONFIG = 1 << 20
"""Bytes of a settings file; ours have a few thousand."""
_MOST_SETTINGS = 10_000
"""Entries of a settings file or value; documents with more are refused before they are built."""


def output(meaning: str) -> Any:
    """Return the option for what a command writes."""
    return typer.Option("--output", "-o", help=meaning)


JsonFlag = Annotated[bool, typer.Option("--json", help="Print machine-readable output.")]
QuietFlag = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
VerboseFlag = Annotated[
    bool,
    typer.Option("--verbose", "-v", help="Show all notes and figures."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Any setting of --help-settings."),
]
LogArgument = Annotated[
    Path,
    typer.Argument(help="Bag, or CSV, Parquet, MATLAB, MDF, TDMS or HDF5 file.", show_default=False, metavar="LOG"),
]
ResultArgument = Annotated[
    Path, typer.Argument(help="Result folder of fit or import.", show_default=False, metavar="DIR")
]
SignalsOption = Annotated[Path | None, typer.Option(help="Signals file (YAML).")]
NamespaceOption = Annotated[str, typer.Option(help="ROS namespace of one of several drives.")]
RadiusOption = Annotated[float | None, typer.Option(help="Disc radius, A.  \\[default: of references]")]
PolePairsOption = Annotated[
    int | None, typer.Option("--pole-pairs", help="Number of pole pairs, if the result does not contain it.", min=1)
]
LinkOption = Annotated[
    float | None, typer.Option("--u-dc", help="DC-link voltage, V.  \\[default: that of the result]", min=1e-3)
]
WorkersOption = Annotated[int, typer.Option(help="Processes that read the bags.")]
DaskOption = Annotated[str | None, typer.Option("--dask", metavar="ADDRESS", help="Dask cluster that reads the bags.")]
SkipFlag = Annotated[bool, typer.Option("--skip-bad", help="Leave out unusable bags; warn of them.")]
FitConfigOption = Annotated[Path | None, typer.Option(help="YAML file with settings.")]
ForceFlag = Annotated[bool, typer.Option("--force", help="Overwrite results; allow other files.")]


def listing(settings: str | None) -> type[TyperCommand]:
    """Return a class of commands with ``--help-settings``, which lists the fields of a dataclass, ``module:name``."""
    if settings is None:
        return TyperCommand

    def show_settings(ctx: Any, _: Any, wanted: bool) -> None:
        if not wanted:
            return
        from drive_id.reporting.tables import plain_table

        table = plain_table("Settings for --set NAME=VALUE and --config", ["Name", "Default", "Meaning"])
        for entry in fields(resolve_name(settings)):
            meaning, unit = entry.metadata["description"], spelled(entry.metadata["unit"])
            default = entry.default if isinstance(entry.default, str) else json.dumps(entry.default)
            shown = "" if entry.default in (None, ()) else default
            table.add_row(entry.name, Text(shown), Text(f"{meaning}, {unit}" if unit else meaning))
        printable().print(table)
        ctx.exit()

    class Listing(TyperCommand):
        def __init__(self, *arguments: Any, params: list[Any], **others: Any) -> None:
            asked = TyperOption(
                param_decls=["--help-settings"], is_flag=True, is_eager=True, expose_value=False,
                callback=show_settings, help="List the settings.",
            )  # fmt: skip
            super().__init__(*arguments, params=[*params, asked], **others)

    return Listing


def merged_settings(
    cls: Callable[..., Settings],
    config: Path | None,
    assignments: list[str] | None,
    options: dict[str, Any],
    base: Settings | None = None,
) -> Settings:
    """Merge base settings, a YAML file, --set and named options; later ones win."""
    import yaml

    from drive_id.files.inputs.input_file import read_text_input
    from drive_id.files.inputs.yaml_tree import load_yaml

    hints = get_type_hints(cls) if assignments else {}
    unreadable = (OSError, ValueError, RecursionError, yaml.YAMLError)
    values: dict[str, Any] = asdict(base) if base else {}  # type: ignore[call-overload]  # a dataclass
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
            value = load_yaml(text, _MOST_SETTINGS)
        except unreadable as error:
            raise ConfigurationError(f"The value in --set {assignment:.200} is not valid YAML: quote it.") from error
        hint = hints.get(name.strip())
        if type(value) in (int, float) and hint is str:
            value = text.strip()  # 0017 is a serial number, not 15
        elif type(value) in (int, float) and hint == tuple[float, ...]:
            value = [value]  # one voltage needs no brackets
        values[name.strip()] = value
    chosen = {name: value for name, value in options.items() if value is not None}
    where = [str(config)] if config else []
    where += ["the options"] if assignments or chosen or not config else []
    return from_mapping(cls, values | chosen, " and ".join(where))  # type: ignore[arg-type]  # a dataclass


def beside(source: Path, ending: str) -> Path:
    """Return a path beside the input, its name with an ending (``log_full``), numbered where that is taken.

    Beside a URL is here. The suffix of a file is left out; a number stands before that of the ending.
    """
    where = Path(source.name).absolute() if url_of(source) else source.absolute()
    name = where.name if where.is_dir() else where.stem
    stem, dot, suffix = ending.partition(".")
    numbered = (where.with_name(f"{name}{stem}{f'_{n}' if n > 1 else ''}{dot}{suffix}") for n in count(1))
    return next(path for path in numbered if not path.exists())
