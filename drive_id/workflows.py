"""What the command line and the nodes do with bags: simulate one, fit some."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from drive_id.analysis.painting import Painter
from drive_id.core import frames
from drive_id.core.accumulated import Accumulated
from drive_id.core.conclusion import conclude
from drive_id.core.fit_settings import FitSettings
from drive_id.core.identification import FluxMap, Identification
from drive_id.core.identify import Progress, score, silent
from drive_id.core.plan_settings import PlanSettings, RoughMachine
from drive_id.core.trajectories import Lissajous
from drive_id.errors import ConfigurationError
from drive_id.files.bag_writer import write_recording
from drive_id.files.information import check_information_output, write_information
from drive_id.files.information_name import is_information
from drive_id.files.machines import read_machine
from drive_id.files.results import PICTURE, Provenance, check_absent, check_output, write_results
from drive_id.files.signals import SignalMap
from drive_id.fleet import accumulate_on_cluster
from drive_id.merging import accumulate_sources
from drive_id.sim.drive import Simulation, simulate
from drive_id.sim.machine import default_amplitude
from drive_id.sim.machines import machine_map
from drive_id.sim.settings import SimulationSettings
from drive_id.streaming import accumulate
from drive_id.types import MachineMap

_MOST_SAMPLES = 2e7


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit of bags yields.

    Parameters
    ----------
    recording : Accumulated
    identification : Identification
    provenance : Provenance
    """

    recording: Accumulated
    identification: Identification
    provenance: Provenance

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about the recording and about the fit."""
        return (*self.provenance.warnings, *self.identification.report.warnings)


def load_machine(name_or_file: str) -> MachineMap:
    """Return a shipped machine by name or read one from a ``.npz`` or ``.mat`` file.

    Raises
    ------
    ConfigurationError
        When there is none, or the file is not a machine.
    """
    path = Path(name_or_file)
    is_file = path.suffix in (".npz", ".mat") or os.path.exists(path)  # noqa: PTH110  # never raises, whatever the name
    return read_machine(path) if is_file else machine_map(name_or_file)


def rough_settings(name_or_file: str) -> PlanSettings:
    """Return settings of a plan with the rough data of a machine, see :func:`load_machine`."""
    machine_map = load_machine(name_or_file)
    return PlanSettings(**asdict(RoughMachine.from_map(machine_map, default_amplitude(machine_map))))


def run_experiment(
    machine: MachineMap, settings: SimulationSettings, trajectory: Lissajous | None = None, seconds: float = 10.0
) -> Simulation:
    """Drive a simulated machine along a trajectory.

    Parameters
    ----------
    machine : MachineMap
    settings : SimulationSettings
    trajectory : Lissajous, optional
        Its radius gives way to that of the settings or of the machine.
    seconds : float
        Duration, s.

    Raises
    ------
    ConfigurationError
        When machine, settings and duration do not make an experiment.
    """
    samples = seconds / settings.sample_period
    if not 2 <= samples <= _MOST_SAMPLES:
        raise ConfigurationError(
            f"{seconds:g} s at a period of {settings.sample_period:g} s make {samples:.3g} samples: choose a duration "
            f"that makes between 2 and {_MOST_SAMPLES:.0e}."
        )
    count = round(samples)
    i_max = settings.i_max or default_amplitude(machine)
    trajectory = replace(trajectory or Lissajous(), i_max=i_max)
    reference = trajectory(settings.sample_period * np.arange(count, dtype=np.float64))
    return simulate(machine, settings, reference)


def simulate_bag(
    machine: MachineMap, settings: SimulationSettings, output: Path, trajectory: Lissajous, seconds: float
) -> Simulation:
    """Drive a simulated machine along a trajectory and write the recording, its ground truth attached.

    Raises
    ------
    OutputError
        When the output exists or cannot be written.
    ConfigurationError
        When machine, settings and trajectory do not fit together.
    """
    check_absent(output)
    simulation = run_experiment(machine, settings, trajectory, seconds)
    write_recording(output, simulation.samples, simulation.truth)
    return simulation


def fit_bags(
    bags: Sequence[Path],
    output: Path | None,
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    cluster: str = "",
    skip_bad: bool = False,
    force: bool = False,
    picture: bool = True,
    painter: Painter | None = None,
    resumable: bool = True,
    tell: Progress = silent,
) -> Fit:
    """Fit one or several bags of one drive and write the results.

    Parameters
    ----------
    bags : sequence of Path
        And information files.
    output : Path, optional
        Folder for the result files; none are written without.
    settings : FitSettings
    signals : SignalMap, optional
        Where to find the signals in bags that are not ours.
    namespace : str
        Of the drive, when a bag holds several.
    cluster : str
        Dask cluster that accumulates them, see :func:`drive_id.fleet.accumulate_on_cluster`; empty: this process.
    skip_bad : bool
        Leave out bags that cannot be used, and warn of them.
    force : bool
        Write into a folder that holds other files.
    picture : bool
        Draw the maps beside the result files.
    painter : Painter, optional
        To draw it: one that was started early is ready when it is needed.
    resumable : bool
        While long bags are read, keep a checkpoint beside the output; another call goes on from it after an interrupt.
    tell : callable, optional

    Returns
    -------
    Fit

    Raises
    ------
    DriveIdError
        Nothing is written then.
    """
    if output is not None:
        check_output(output, force=force)
    with painter or Painter(wanted=picture and output is not None) as at_work:
        gather = _gatherer(bags, cluster, skip_bad=skip_bad, output=output if resumable else None)
        begin = partial(_begin_picture, at_work) if picture and output is not None else None
        fit = _fit(gather, bags, settings, signals, namespace, tell, begin)
        if output is not None:
            tell("Writing", 0.0)
            pictures = {PICTURE: at_work.picture()} if picture else {}
            write_results(output, fit.identification, fit.provenance, force=force, pictures=pictures)
    return fit


def _fit(
    gather: Callable[..., Accumulated],
    bags: Sequence[Path],
    settings: FitSettings,
    signals: SignalMap | None,
    namespace: str,
    tell: Progress,
    on_map: Callable[[Accumulated, FitSettings, FluxMap], None] | None,
) -> Fit:
    if not any(is_information(bag) for bag in bags):  # these know their own
        settings.check_recordings(len(bags))
    recording = gather(bags, settings, signals=signals, namespace=namespace, tell=tell)
    tell("Solving and validating", 1.0)
    told = partial(on_map, recording, settings) if on_map else lambda _: None
    identification = conclude(recording.evidence, recording.validation, told)
    truth = recording.truth
    nrmse = score(identification, truth) if truth else None
    strange = ("None of the map lies in the disc of the recorded truth: check the scale of the currents.",)
    idle = ", ".join(settings.idle())
    unheard = (f"Method {settings.method} does not look at {idle}: choose another method, or leave it out.",)
    provenance = Provenance(
        inputs=recording.digests,
        settings=settings,
        machine=truth.machine if truth else "",
        nrmse=nrmse,
        warnings=recording.warnings
        + (unheard if idle else ())
        + (strange if nrmse and not np.isfinite(nrmse).all() else ()),
    )
    return Fit(recording, identification, provenance)


def accumulate_bags(
    bags: Sequence[Path],
    output: Path,
    settings: FitSettings,
    *,
    signals: SignalMap | None = None,
    namespace: str = "",
    cluster: str = "",
    skip_bad: bool = False,
    tell: Progress = silent,
) -> Accumulated:
    """Accumulate bags of one drive, each by itself, and write an information file; parameters as of :func:`fit_bags`.

    Raises
    ------
    DriveIdError
        Nothing is written then.
    """
    check_information_output(output)
    gather = _gatherer(bags, cluster, skip_bad=skip_bad, apart=True)
    accumulated = gather(bags, settings, signals=signals, namespace=namespace, tell=tell)
    tell("Writing", 0.0)
    write_information(output, accumulated)
    return accumulated


def _gatherer(
    bags: Sequence[Path], cluster: str, *, skip_bad: bool, apart: bool = False, output: Path | None = None
) -> Callable[..., Accumulated]:
    """Return what turns bags into evidence: all of them together, or each by itself, here or on a cluster."""
    if cluster:
        return partial(accumulate_on_cluster, cluster=cluster, skip_bad=skip_bad)
    if apart or skip_bad or any(is_information(bag) for bag in bags):
        return partial(accumulate_sources, skip_bad=skip_bad)
    if output is None:
        return accumulate
    return partial(accumulate, checkpoint=output.absolute().with_name(f".{output.absolute().name}.checkpoint"))


def _begin_picture(painter: Painter, recording: Accumulated, settings: FitSettings, flux_map: FluxMap) -> None:
    """Begin to draw the identified maps with the trajectory over them."""
    i_dq = np.concatenate([frames.to_dq(part.i_abc, part.angle) for part in recording.validation])
    name = f"{recording.truth.machine}, " if recording.truth else ""
    painter.begin(flux_map, recording.evidence.i_max, i_dq, f"{name}method {settings.method}")
