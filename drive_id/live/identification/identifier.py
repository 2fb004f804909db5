"""Identification on request, without ROS: of recordings by name, or of the live samples so far."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from drive_id.common.health import Health, Level, Observation
from drive_id.common.messages import Message
from drive_id.common.quantity import counted, measured
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import Conclusion
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.core.signals.join import JoinReport
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.messages.messages import PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER, SCALAR_SAMPLES
from drive_id.files.messages.signals_file import SignalMap, our_scalar, read_signals
from drive_id.files.read.block_stream import BlockStream
from drive_id.files.results.folder import check_output
from drive_id.files.results.identification import Provenance
from drive_id.files.storage.bag import open_bag
from drive_id.fitting.completion import completed
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.result import Identification
from drive_id.fitting.sources import Sources
from drive_id.live.data_directory import existing_recording
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.live_evidence import LiveEvidence, Snapshot
from drive_id.live.identification.live_parts import BEFORE, LiveParts
from drive_id.live.identification.operating_points import PointDecimator
from drive_id.live.identification.refits import Refit, RefitJob, Refits, moving, of_snapshot
from drive_id.live.identification.result_folders import LastMap, ResultFolders, new_folder
from drive_id.live.publishers import Publisher, of_type, publisher_findings, uncounted
from drive_id.live.translator import SignalBlock
from drive_id.live.worker import Cancelled
from drive_id.types import SCALARS, Progress

TYPES = (PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Reply:
    """What came of a request."""

    code: str  # ok, busy, or that of the error
    message: str  # a sentence
    identification: IdentifiedDrive | None = None  # unless there was an error
    warnings: tuple[Message, ...] = ()  # about the samples and about the fit
    stamp: int = 0  # of the last sample, ns
    output: str = ""  # folder of the result files
    samples: JoinReport | None = None  # what became of the live signals, also without success
    provenance: Provenance | None = None  # of the result
    refit: Refit | None = None  # the fit of the live samples, for later ones to start from
    provisional: bool = False  # nobody requested it: the result of a fit in the background

    @property
    def success(self) -> bool:
        """Whether there is a result."""
        return self.code == "ok"


Job = Callable[[Progress], Reply]
BUSY = Reply("busy", "A request is under way: ask again when it is done.")
CANCELLED = Reply("cancelled", "The request was cancelled; nothing was written.")
DEACTIVATED = Reply("inactive", "The node was deactivated, so the request was ended; nothing was written.")
VANISHED = Reply("cancelled", "The client of the request is gone, so the request was cancelled.")


class Identifier:
    """Accumulates live samples, and makes jobs of requests. Not for several threads at once; the jobs are.

    Parameters
    ----------
    topics : tuple of str
        Of currents, voltages and resolver, for messages.
    scalar_topics : mapping of str to str, optional
        Topics of the optional signals, by their names in :class:`~drive_id.types.Samples`.
    node : str
        Full name of the node.
    """

    def __init__(
        self,
        settings: IdentificationSettings,
        fit: FitSettings,
        topics: tuple[str, str, str] = TYPES,
        scalar_topics: Mapping[str, str] | None = None,
        node: str = "/identification",
    ) -> None:
        self.settings = settings
        self.folders = ResultFolders(settings, node)
        self.operating_points = PointDecimator(settings.operating_point_rate)
        self.topics = topics
        self._scalar_topics = dict(scalar_topics or {name: name for name in SCALARS})
        self._parts = LiveParts(LiveEvidence(fit, topics))
        self.refits = Refits(settings)
        self._begin()
        self._unreadable = 0
        self._last_error = ""
        self._forgotten = ""  # a sentence on why

    @property
    def live(self) -> LiveEvidence:
        """The samples of the present drive."""
        return self._parts.present

    @property
    def life(self) -> int:
        """Number of times that samples were forgotten, or another drive began: a fit of those before is of no use."""
        return self._parts.life

    def receive(self, section: int, data: bytes) -> None:
        """Take one serialized message of currents (0), voltages (1) or resolver (2)."""
        try:
            if self._parts.block(self.topics[section], data):
                self._begin()
            piece = self._streams[section].decode(data)
            self.operating_points.add(section, piece)
            self.live.add(section, piece)
        except DriveIdError as error:
            self._note(error)

    def publishers(self, found: Sequence[Sequence[Publisher]]) -> None:
        """Take who publishes each of the three signals; look several times a second."""
        for topic, kind, each in zip(self.topics, TYPES, found, strict=True):
            if self._parts.publishers(topic, of_type(each, kind)):
                self._begin()

    def receive_block(self, block: SignalBlock) -> None:
        """Take translated samples of a bench's own topics."""
        for section, signal in enumerate(block.signals()):
            self.operating_points.add(section, signal)
            self.live.add(section, signal)

    def receive_scalar(self, name: str, data: bytes) -> None:
        """Take one serialized message of an optional signal, by its name in :class:`~drive_id.types.Samples`."""
        try:
            self.live.join.add_scalar(name, self._scalar_streams[name].decode(data))
        except DriveIdError as error:
            self._note(error)

    def _note(self, error: DriveIdError) -> None:
        self._unreadable += 1
        self._last_error = str(error)

    def configure(self, fit: FitSettings) -> bool:
        """Take other settings, and tell whether the live samples had to be forgotten."""
        forgotten = self._parts.configure(fit)
        if forgotten:
            self._begin()
            self._forgotten = "The live samples before were forgotten, because the settings of the fit have changed."
        return forgotten

    def reset(self) -> None:
        """Forget the live samples."""
        self._parts.reset()
        self._begin()
        self._unreadable, self._last_error, self._forgotten = 0, "", ""

    def _begin(self) -> None:
        """Forget the last fit, and count anew what arrives."""
        self.refits.forget()
        self._streams = tuple(BlockStream(topic, kind) for topic, kind in zip(self.topics, TYPES, strict=True))
        scalars = self._scalar_topics.items()
        self._scalar_streams = {name: BlockStream(topic, SCALAR_SAMPLES) for name, topic in scalars}

    def job(
        self,
        bags: Sequence[str],
        method: str,
        signals: str = "",
        names: Mapping[str, str] = MappingProxyType({}),
        part: str = "",
        *,
        i_max: float = 0.0,
        temperatures: Sequence[float] = (),
        u_dc: Sequence[float] = (),
        session: int = 0,
    ) -> Job:
        """Make a job of a request, to be run in another thread.

        Parameters
        ----------
        bags : sequence of str
            Names of recordings; empty: the live samples so far.
        method : str
            Empty: that of the settings.
        signals : str
            Signals file for the bags; empty: our messages under the names of this drive.
        names : mapping of str to str
            Of machine, serial, bench, operator and notes; those that are empty are as in the settings.
        part : str
            Of live samples of two drives: those of the one ``before`` or ``after`` the change.
        i_max : float
            Radius of the disc, A; 0: as in the settings.
        temperatures, u_dc : sequence of float
            Of each bag; empty: as in the settings.
        session : int
            Of the references, for the result; 0: not known.

        Raises
        ------
        DriveChangedError
            When the live samples are of two drives, and no part is named.
        DriveIdError
            When the request makes no sense, or the signals file cannot be read.
        """
        conditions = {"temperatures": temperatures, "u_dc": u_dc}
        conditions = {name: values for name, values in conditions.items() if len(values)}
        named = as_requested(self.live.settings, method=method, i_max=i_max, **names, **conditions)
        if bags:
            if part:
                raise ConfigurationError("The request names a part and bags: a part is of the live samples only.")
            own = read_signals(Path(signals).expanduser()) if signals else self._signals()
            work = partial(_fit_bags, tuple(bags), own, bool(signals), named, self.settings, session)
            return partial(_guarded, self.folders, work)
        if signals:
            raise ConfigurationError("The request names a signals file, but no bags: it is for bags only.")
        if conditions:
            raise ConfigurationError(
                f"The request gives {' and '.join(conditions)}, but no bags: live samples are summed by the parameters."
            )
        live = self._parts.chosen(part)
        snapshot = live.snapshot(method, i_max)
        fit = snapshot.gathered.evidence.settings
        samples = moving(snapshot.gathered.evidence) + sum(len(piece.samples) for piece in snapshot.rest)
        earlier = self.refits.earlier(fit, samples) if live is self.live else None
        surest = self.refits.surest if live is self.live and fit == self.live.settings else None
        work = partial(_fit_live, snapshot, earlier, named, self.settings, self._forgotten, part, surest, session)
        return partial(_guarded, self.folders, work)

    def check(self, bags: Sequence[str], *request: Any, **further: Any) -> None:
        """Raise DriveIdError for what a request would be refused for whose bags do not exist yet, see :meth:`job`.

        It takes no time, so whoever is about to record them can ask before anything moves.
        """
        self.job(bags, *request, **further)
        conditions = {name: further[name] for name in ("temperatures", "u_dc") if name in further}
        as_requested(self.live.settings, **conditions).check_recordings(len(bags))

    def refit(self) -> RefitJob | None:
        """Return a fit of the live samples in the background if one is due, see :class:`Refits`."""
        return self.refits.job(self.live)

    def take(self, refit: Refit) -> None:
        """Keep a fit of the live samples for later ones to start from, unless it was by other settings."""
        if refit.settings == self.live.settings:
            self.refits.take(refit)

    def provisional(self, refit: Refit) -> Reply:
        """Return the map of a fit in the background."""
        drive = refit.drive
        return Reply("ok", _sentence(drive), drive, drive.report.warnings, stamp=refit.stamp, provisional=True)

    def health(
        self, doing: str, publishers: Sequence[Sequence[Publisher]], further: Sequence[Observation] = ()
    ) -> Health:
        """Return how the live samples are.

        Parameters
        ----------
        doing : str
            A sentence on what is under way.
        publishers : sequence of sequence of Publisher
            Of each topic.
        further : sequence of Observation
            Of the node.
        """
        self.live.advance()  # samples that wait for a batch are not lost
        report = self.live.join.report()
        evidence = self.live.evidence
        values = {
            "samples": str(report.samples),
            "gaps": str(report.gaps),
            "unreadable messages": str(self._unreadable),
            "coverage": "" if evidence is None else f"{evidence.coverage():.4f}",
            "method": self.live.settings.method,
            **self.refits.values(),
        }
        findings = [*further, *self.folders.findings()]
        streams = (*self._streams, *self._scalar_streams.values())
        findings += [(Level.WARN, uncounted(each.topic)) for each in streams if each.count.counts_nothing]
        for track, kind, found in zip(self.live.join.tracks, TYPES, publishers, strict=True):
            values |= {f"{track.name}: samples": str(track.read), f"{track.name}: samples lost": str(track.lost)}
            if track.not_finite:
                values[f"{track.name}: samples NaN or infinite"] = str(track.not_finite)
            findings += publisher_findings(track.name, kind, found)
        for stream in self._scalar_streams.values():
            if stream.count.samples:
                values[f"{stream.topic}: samples"] = str(stream.count.samples)
        if self.live.join.tracks[0].read:
            findings += [(Level.WARN, warning) for warning in report.warnings]
        if self._unreadable:
            sentence = f"{counted(self._unreadable, 'message')} could not be read, the last because: {self._last_error}"
            findings.append((Level.WARN, sentence))
        if evidence is None:
            sentence = "Live samples are not accumulated, for i_max is not set: set it to the disc's radius in A."
            findings.append((Level.WARN, sentence))
        findings += self._parts.findings()
        findings.append((Level.OK, self._forgotten or f"{counted(report.samples, 'live sample')}."))
        return Health.of(doing, findings, values)

    def _signals(self) -> SignalMap:
        """Return where the signals are in a bag that was recorded beside this drive, under whatever names."""
        usual = SignalMap()
        currents, voltages, resolver = self.topics
        return replace(
            usual,
            currents=replace(usual.currents, topic=currents),
            voltages=replace(usual.voltages, topic=voltages),
            resolver=replace(usual.resolver, topic=resolver),
            optional={name: replace(our_scalar(name), topic=topic) for name, topic in self._scalar_topics.items()},
        )


def as_requested(fit: FitSettings, **fields: Any) -> FitSettings:
    """Return settings with those fields of a request that are neither 0 nor empty; raises ConfigurationError."""
    arrays = {name for name in fields if isinstance(getattr(fit, name), tuple)}
    given: dict[str, Any] = {name: tuple(value) if name in arrays else value for name, value in fields.items()}
    given = {name: value for name, value in given.items() if value}
    return replace(fit, **given)


def check_fields(recordings: int, **fields: Any) -> None:
    """Raise ConfigurationError unless a fit of so many recordings may have these fields of a request."""
    as_requested(FitSettings(), **fields).check_recordings(recordings)


def again(last: LastMap) -> Reply:
    """Return the reply of a result that was read from its folder."""
    reply = _reply(last.result, last.folder)
    return replace(reply, message=f"From {last.folder}: {reply.message}", stamp=last.stamp)


def failed(error: DriveIdError, samples: JoinReport | None = None) -> Reply:
    """Return the reply to a request that led to an error."""
    return Reply(error.code, str(error), samples=samples)


def _guarded(folders: ResultFolders, work: Job, tell: Progress) -> Reply:
    """Do the work and remember its result; every error becomes a reply."""
    try:
        return _kept(folders, work, tell)
    except DriveIdError as error:
        return failed(error)
    except Exception as error:  # noqa: BLE001  # a mistake of ours must not take the node down
        _log.exception("A fit failed")
        return Reply("internal", f"The fit failed by an error of drive_id itself ({type(error).__name__}): report it.")


def _kept(folders: ResultFolders, work: Job, tell: Progress) -> Reply:
    """Do the work and remember its result, which goes if it was cancelled meanwhile."""
    reply = work(tell)
    try:
        tell("Writing", 1.0)
    except Cancelled:
        if reply.output:
            shutil.rmtree(reply.output, ignore_errors=True)
        raise
    if reply.output:
        folders.note(Path(reply.output), reply.stamp)
    return reply


def _fit_bags(
    names: Sequence[str],
    own: SignalMap,
    wanted: bool,
    fit: FitSettings,
    settings: IdentificationSettings,
    session: int,
    tell: Progress,
) -> Reply:
    """Fit recordings by the signals of this drive where they have its topics, or by those ``wanted``."""
    paths = [existing_recording(Path(settings.data_directory), name) for name in names]
    output = new_folder(settings, fit.method)
    tell("Reading", 0.0)
    topics = {own.currents.topic, own.voltages.topic, own.resolver.topic}
    signals = own if wanted or all(_holds(path, topics) for path in paths) else None
    sources = Sources(paths, signals, compared=settings.picture)
    result = _of_session(fit_bags(sources, output, fit, tell=tell), session)
    if settings.picture or session:
        result.save(output, draw=settings.picture)
    return _reply(result, output)


def _of_session(result: Identification, session: int) -> Identification:
    return replace(result, provenance=replace(result.provenance, session=session))


def _reply(result: Identification, output: Path, samples: JoinReport | None = None) -> Reply:
    return Reply(
        "ok", _sentence(result.drive), result.drive, result.warnings, result.last_stamp, str(output), samples,
        result.provenance,
    )  # fmt: skip


def _holds(path: Path, topics: set[str]) -> bool:
    with open_bag(path) as bag:
        return topics <= set(bag.topics)


def _fit_live(
    snapshot: Snapshot,
    earlier: Conclusion | None,
    fit: FitSettings,
    settings: IdentificationSettings,
    forgotten: str,
    part: str,
    surest: tuple[int, float] | None,
    session: int,
    tell: Progress,
) -> Reply:
    output = new_folder(settings, fit.method)
    check_output(output)
    tell("Solving", None)
    try:
        refit = of_snapshot(snapshot, earlier)
    except DriveIdError as error:
        return replace(failed(error, snapshot.join.report()), message=" ".join(filter(None, [str(error), forgotten])))
    evidence = snapshot.gathered.evidence
    doubt = refit.doubt(surest)
    result = completed(
        replace(refit.drive, statements=(*refit.drive.statements, *([] if doubt is None else [doubt]))),
        fit,
        excerpts=snapshot.validation(),
        duration=evidence.samples * evidence.sample_period,
        last_stamp=snapshot.join.last_stamp or 0,
        warnings=snapshot.join.report().warnings,
    )
    tell("Writing", None)
    result = _of_session(replace(result, evidence=evidence), session)
    result.save(output, draw=settings.picture)
    reply = _reply(result, output, snapshot.join.report())
    said = f"Of the samples {part} the change: {reply.message}" if part else reply.message
    return replace(reply, message=said, refit=None if part == BEFORE else refit)


def _sentence(identification: IdentifiedDrive) -> str:
    report = identification.report
    size = abs(identification.resistance)
    resistance = measured(identification.resistance, identification.sigma_resistance, "Ω", size)
    drop = measured(identification.voltage_error, identification.sigma_voltage_error, "V")
    drop = f", inverter drop {drop}" if identification.origin.inverter else ""
    return (
        f"Identified by method {identification.method} from {counted(report.samples_used, 'sample')}: resistance "
        f"{resistance}{drop}, {100 * report.coverage:.0f} % of the disc covered."
    )
