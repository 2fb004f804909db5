"""Inspect a log before a fit: contents, findings of the prescan, an overview, and a proposed signals file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.quantity import Tabled, plain
from drive_id.core.checks.overview import Overview, Overviewing
from drive_id.core.checks.prescan import Prescan
from drive_id.core.signals.join import SECTIONS
from drive_id.core.steady.operating_points import operating_points
from drive_id.errors import (
    ConfigurationError,
    DataError,
    DriveIdError,
    EmptyTopicError,
    MessageTypeError,
    MissingTopicError,
)
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.messages.message_reader import STAMP_LIMIT
from drive_id.files.messages.messages import BLOCK_FIELDS
from drive_id.files.messages.signals_file import SignalMap, parse_signals, signals_of
from drive_id.files.read.extraction import DividedError, UnusualError
from drive_id.files.read.operating_log import read_operating_log
from drive_id.files.read.reader import find_topics
from drive_id.files.read.several import SeveralBags
from drive_id.files.storage.bag import open_bag
from drive_id.inspection.clock import stamped
from drive_id.inspection.contents import Contents, Table, read_contents
from drive_id.inspection.draft import Draft, propose
from drive_id.types import Progress, silent

_MUCH_JITTER = 0.1  # of the period, from which on the jitter of stamps is told
_LOOKED = (ConfigurationError, DataError, EmptyTopicError, MessageTypeError, MissingTopicError)
"""What is wrong with the signals of a log that can be read."""


@dataclass(frozen=True, eq=False, repr=False)
class Inspection(Tabled):
    """What is in a log.

    Parameters
    ----------
    contents : Contents
    findings : tuple of Message
    overview : Overview or None
        None where no samples could be joined.
    draft : Draft or None
        Proposed if no signals file was given and the log does not hold our messages.
    warnings : tuple of Message
        Of reading and joining.
    """

    contents: Contents
    findings: tuple[Message, ...]
    overview: Overview | None
    draft: Draft | None
    warnings: tuple[Message, ...]

    @property
    def summary(self) -> str:
        """The findings and warnings, one a line."""
        said = [*(f"{finding.code}: {finding}" for finding in self.findings), *map("Warning: {}".format, self.warnings)]
        return "\n".join([f"{self.contents.path}: {self.contents.kind}", *(said or ["No problems found."])])

    def rows(self) -> list[tuple[str, ...]]:
        """Return quantities of the joined samples, as ``drive-id check`` prints them; none where none were joined."""
        if self.overview is None:
            return []
        seen = self.overview.figures
        low, mean, high = (seen[name] * 30 / np.pi for name in ("speed_min", "speed_mean", "speed_max"))
        every = f"{seen['sample_period'] * 1e6:.6g} µs"
        return [
            ("Samples", f"{seen['samples']} every {every}, {seen['duration']:.4g} s"),
            ("Gaps", f"{seen['runs'] - 1}, {seen['time_lost']:.4g} s in total"),
            ("Electrical speed", f"{low:.5g} to {high:.5g} rpm, mean {mean:.5g} rpm"),
            ("Turn per sample", f"{np.rad2deg(seen['turn_per_sample']):.3g}° electrical"),
            ("i_d", f"{seen['i_d_min']:.4g} to {seen['i_d_max']:.4g} A"),
            ("i_q", f"{seen['i_q_min']:.4g} to {seen['i_q_max']:.4g} A"),
            ("Disc", f"{seen['i_max']:.4g} A, {100 * seen['coverage']:.0f} % visited"),
        ]

    def tree(self) -> dict[str, Any]:
        """Return everything but the curves as plain values for JSON."""
        tree = {
            "path": str(self.contents.path),
            "kind": self.contents.kind,
            "topics": [_table_tree(table) for table in self.contents.tables],
            "overview": self.overview and dict(self.overview.figures),
            "findings": [finding_tree(finding) for finding in self.findings],
            "warnings": list(self.warnings),
            "draft": self.draft and {"text": self.draft.text, "unsure": list(self.draft.unsure)},
        }
        found: dict[str, Any] = plain(tree)
        return found


def check(
    log: str | os.PathLike[str],
    *,
    signals: str | os.PathLike[str] | SignalMap | None = None,
    namespace: str = "",
    draft: bool = False,
    tell: Progress = silent,
) -> Inspection:
    """Look at a log before a fit, as ``drive-id check`` does.

    Parameters
    ----------
    log : path
        Bag or file of columns.
    signals : path or SignalMap, optional
        Signals file. Default: our own messages, or else a proposal, the ``draft`` of what is returned.
    namespace : str
        Of the drive, when a bag holds several.
    draft : bool
        Propose a signals file even where one is given or the log holds our own messages.
    tell : callable, optional
        Called with what is being done and its progress, 0 to 1.

    Raises
    ------
    DriveIdError
        When it cannot be read.
    """
    if not isinstance(log, (str, os.PathLike)):
        raise ConfigurationError(f"drive_id.check cannot read a {type(log).__name__}: give the path of a log.")
    path = Path(log)
    signals = signals_of(signals)
    tell("Reading", 0.0)
    contents = read_contents(path, signals)
    findings: list[Message] = []
    proposal: Draft | None = None
    if draft or (signals is None and not _is_ours(path, namespace)):
        tell("Recognizing signals", None)
        try:
            proposal = propose(contents)
        except ConfigurationError as error:
            found = (Message("no_draft", reason=str(error)), *_time_findings(contents, SignalMap()))
            return Inspection(contents, found, None, None, ())
        signals = parse_signals(proposal.text, "the draft") if signals is None else signals
        findings += [Message("draft_unsure", reason=sentence) for sentence in proposal.unsure]
    signals = signals or SignalMap()
    look = _look if signals.resolver.angle else _look_at_points
    problems, overview, warnings = look(path, signals, namespace, tell)
    return Inspection(
        contents, (*problems, *findings, *_time_findings(contents, signals)), overview, proposal, warnings
    )


def _look(
    path: Path, signals: SignalMap, namespace: str, tell: Progress
) -> tuple[list[Message], Overview | None, tuple[Message, ...]]:
    """Read the log as a fit does, and return findings, overview and warnings."""
    reading = SeveralBags([path], signals, namespace, tell, threads=False)
    while True:
        prescan, overviewing = Prescan(), Overviewing()
        refused: DriveIdError | None = None
        try:
            for piece, _ in reading.pieces("Reading"):
                prescan.add(piece.samples, continues=piece.continues)
                overviewing.add(piece)
        except UnusualError:
            reading.read_whole()
            continue
        except DividedError:
            reading.divide()
            continue
        except _LOOKED as error:
            refused = error
        break
    found = [] if refused is None else [Message.told(str(refused), refused.code, kind="error")]
    if prescan.samples:
        found += prescan.findings()
    overview = overviewing.overview(prescan.radius) if prescan.samples else None
    if overview is not None:
        restarts = [message for message in reading.warnings if message.code == "time_restarts"]
        captures = max((int(message.values["places"]) for message in restarts), default=0)
        told = captures >= overview.figures["runs"] - 1  # where time starts again, nothing is lost and nothing jitters
        found += [finding for finding in overview.findings() if not (told and finding.code == "gaps")]
    return found, overview, reading.warnings


def _look_at_points(
    path: Path, signals: SignalMap, namespace: str, tell: Progress
) -> tuple[list[Message], None, tuple[Message, ...]]:
    """Read a log without an angle as method ``static`` does, and return findings and warnings."""
    tell("Reading", None)
    try:
        log = read_operating_log(path, signals, namespace=namespace)
        operating_points(log.data)
    except _LOOKED as error:
        return [Message.told(str(error), error.code, kind="error")], None, ()
    return [], None, log.warnings


def _is_ours(path: Path, namespace: str) -> bool:
    """Tell whether a bag holds our own messages of currents, voltages and rotor on their usual topics."""
    if log_kind(path):
        return False
    with open_bag(path) as bag:
        try:
            topics = find_topics(bag, SignalMap(), namespace)
        except ConfigurationError:  # of several drives, which the reader says, too
            return True
        except MissingTopicError:
            return False
    return {topics[section].type_name for section in SECTIONS} <= set(BLOCK_FIELDS)


def _time_findings(contents: Contents, signals: SignalMap) -> Iterator[Message]:
    """Yield topics whose stamps jitter, unless their samples are taken as equally spaced."""
    spaced = {source.topic or source.group for source in signals.sources().values() if source.equally_spaced}
    for table in (_stamped(table, signals) for table in contents.tables):
        if table.name in spaced:
            continue
        period, jitter = table.period, table.jitter
        if not table.columns or period is None or jitter is None or jitter <= _MUCH_JITTER * period * table.block:
            continue
        what = f"{'messages' if contents.is_bag else 'rows'} of {table.name or 'the table'}"
        yield Message("stamp_jitter", jitter=jitter, period=period, block_period=period * table.block, what=what)
    if not contents.bounded:
        yield Message("memory")


def _stamped(table: Table, signals: SignalMap) -> Table:
    """Return a table of columns with the stamps that the signals file names."""
    if len(table.stamp):
        return table
    for source in signals.sources().values():
        values = table.columns.get(source.stamp)
        if (
            values is not None
            and np.isfinite(values).all()
            and np.abs(values * source.tick).max(initial=0.0) < STAMP_LIMIT
        ):
            return stamped(table, source.stamp, source.tick)
    return table


def finding_tree(finding: Message) -> dict[str, Any]:
    """Return a finding as plain values: its first number is its value."""
    numbers = (value for value in finding.values.values() if not isinstance(value, str))
    return {
        "code": finding.code,
        "message": finding,
        "value": next(numbers, None),
        "values": finding.values,
        "severity": finding.kind,
    }


def _table_tree(table: Table) -> dict[str, Any]:
    period = table.period
    fields = []
    for name, x in table.columns.items():
        known = x[np.isfinite(x)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (math.nan, math.nan)
        fields.append({"name": name, "type": table.types.get(name, ""), "min": low, "max": high})
    return {
        "name": table.name,
        "type": table.kind,
        "count": table.rows,
        "rate": period and 1 / period,
        "message_rate": period and 1 / (period * table.block),
        "jitter": table.jitter,
        "samples_per_message": table.block,
        "fields": fields,
        "problem": table.problem,
    }
