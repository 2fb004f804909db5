"""What the commands of ``drive-id`` print: sentences, tables, JSON and a progress bar."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from rich.segment import Segment
    from rich.table import Table

    from drive_id.fitting.result import Identification
    from drive_id.types import Progress as Tell

_PIPE_WIDTH = 200
"""Characters per line when the output is not a terminal."""
_wrapped = partial(textwrap.fill, break_long_words=False, break_on_hyphens=False)


@cache
def out() -> Console:
    """Return standard output, as wide as the terminal; in a file or a pipe, wide enough for any table."""
    console = printable()
    return console if console.is_terminal else printable(width=_PIPE_WIDTH)


@cache
def err() -> Console:
    """Return standard error."""
    return printable(stderr=True)


def printable(**options: Any) -> Console:
    """Return a console that prints no control characters of its texts: files have names that move the cursor."""
    from rich.console import Console

    class Printable(Console):
        def render(self, *arguments: Any, **options: Any) -> Iterator[Segment]:
            for segment in super().render(*arguments, **options):
                text = "".join(letter for letter in segment.text if letter.isprintable() or letter == "\n")
                yield segment if segment.control else segment._replace(text=text)

    return Printable(**options)


def say(sentence: str, *, to: Callable[[], Console] = out, style: str | None = None) -> None:
    """Print text as it is: in a terminal wrapped between words, in a file or a pipe on one line."""
    console = to()
    if console.is_terminal:  # rich would break a long path, which could not be copied then
        lines = (_wrapped(line, console.width) for line in sentence.splitlines())
        sentence = "\n".join(lines)
    console.print(sentence, style=style, markup=False, highlight=False, soft_wrap=True)


def warn(*sentences: str) -> None:
    """Print warnings."""
    for sentence in sentences:
        say(f"Warning: {sentence}", style="yellow")


def print_json(tree: Any) -> None:
    """Print values for programs; raises ValueError for a number that JSON does not have."""
    typer.echo(json.dumps(tree, allow_nan=False))


def show(table: Table) -> None:
    """Print a table, its title on one line whatever the width of the terminal."""
    if table.title:
        out().print(table.title, style="table.title", highlight=False, soft_wrap=True)
        table.title = None
    out().print(table)


def show_result(result: Identification, *, verbose: bool = False) -> None:
    """Print a result: values and quality, one line of advice, warnings, what is particular; all notes if verbose."""
    from drive_id.reporting.tables import fit_table
    from drive_id.result.advice import USUAL, sorted_statements

    show(fit_table(result, verbose=verbose))
    for sentence in result.advice[:1]:
        say(f"What would help most: {sentence}")
    warn(*result.warnings)
    found, nothing = sorted_statements(result.drive)
    for statement in (*found, *nothing) if verbose else found:
        if verbose or statement.code not in USUAL:
            say(statement)


@contextmanager
def working(silent: bool, doing: str = "Starting") -> Iterator[Tell]:
    """Show a progress bar on standard error while the body works, if that is a terminal, not only coloured."""
    if silent or not (err().is_terminal and err().file.isatty()):
        yield lambda _what, _share: None
        return
    from rich import progress

    columns = (
        progress.TextColumn("{task.description}"), progress.BarColumn(), progress.TaskProgressColumn(),
        progress.TimeElapsedColumn(), progress.TimeRemainingColumn(),
    )  # fmt: skip
    with progress.Progress(*columns, console=err(), transient=True) as bar:
        task = bar.add_task(doing, total=None)  # no total: the bar pulses and shows no percentage

        def tell(what: str, share: float | None) -> None:
            nonlocal doing, task
            name = what.partition(",")[0]
            if name != doing:  # a new step with its own clock
                doing = name
                bar.remove_task(task)
                task = bar.add_task(what, total=None if share is None else 1.0)
            bar.update(task, description=what, completed=share or 0.0)

        yield tell
