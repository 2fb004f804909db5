"""Result files of a fit: ``identification.json``, ``flux_map.npz`` and, with rotor harmonics, ``harmonics.npz``.

All three are written and read here. Numbers that are not finite are null in the JSON; what a recording does not tell
(pole pairs, DC link) is null in the JSON and NaN in the npz.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS
from drive_id.common.quantity import plain
from drive_id.common.settings import from_mapping
from drive_id.common.version import VERSION
from drive_id.core.fit_settings import MOST_POLE_PAIRS, FitSettings
from drive_id.core.maps.error_modes import ErrorModes
from drive_id.core.maps.flux_map import FluxMap, HarmonicMap
from drive_id.core.methods.parameters import FitReport
from drive_id.core.result.diagnostics import Diagnostics
from drive_id.core.result.identification import Cogging, IdentifiedDrive, LinearMachine, Mechanics, TorqueFit
from drive_id.errors import DriveIdError, ResultError
from drive_id.files.inputs.archive import DAMAGED, damage, npz_bytes, read_arrays
from drive_id.files.inputs.input_file import read_input, read_text_input
from drive_id.files.results.diagnostics import DIAGNOSTICS, diagnostics_bytes, read_diagnostics
from drive_id.files.results.folder import FORMAT, LARGEST_MARKER, MARKER, check_recordings, is_ours, replace_folder
from drive_id.types import FloatArray

if TYPE_CHECKING:
    from drive_id.core.full.effects.effect import Calibration

FORMAT_VERSION = 1
_PICTURES = {f"{name}.{suffix}" for name in ("flux_map", "diagnostics") for suffix in ("png", "svg", "pdf")}
_PICTURES |= {"report.html", "report.pdf"}
_NPZ = "flux_map.npz"
_HARMONICS = "harmonics.npz"
_DEPENDENCIES = ("numpy", "scipy", "numba", "rosbags", "mcap")
_UNITS = {
    "i_d": "A", "i_q": "A", "psi_d": "Wb", "psi_q": "Wb", "sigma_d": "Wb", "sigma_q": "Wb", "resistance": "ohm",
    "i_max": "A", "u_dc": "V", "speed_range": "rad/s, electrical", "duration": "s",
}  # fmt: skip
_PHASES = ("voltage_a", "voltage_b", "voltage_c")
_SIGMA = "sigma_voltage"
_AMPLITUDES = ("psi_d_cos", "psi_d_sin", "psi_q_cos", "psi_q_sin")
_MOST = 1e9
"""A, Wb and V, in maps and inverter curves: no drive comes near, and squares and products of such values are finite."""
_MAP = tuple(entry.name for entry in fields(FluxMap) if entry.default is MISSING)
_MODES = tuple(f"modes_{entry.name}" for entry in fields(ErrorModes))
"""Arrays of the joint errors: one standard error of each of M independent causes along the first axis."""
_LARGEST = 1 << 27  # bytes of a file of a result, a hundred times those of a fit
_DAMAGE = (DriveIdError, *DAMAGED)


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from, and what is known of the experiment besides; None and empty for what is not known."""

    inputs: Mapping[str, str]  # file to its sha256
    settings: FitSettings
    machine: str = ""  # its name
    nrmse: tuple[float, float] | None = None  # of psi_d and psi_q against the ground truth, if the recording carried it
    warnings: tuple[Message, ...] = ()  # about the recording; those about the fit are in its report
    pole_pairs: int | None = None
    u_dc: float | None = None  # DC-link voltage, V
    speed_range: tuple[float, float] | None = None  # lowest and highest electrical speed in the recording, rad/s
    duration: float | None = None  # of the samples, without gaps, s
    date: str = ""  # of the last sample, ISO 8601 in UTC; of the fit, where the stamps are not times of day
    versions: Mapping[str, str] = field(default_factory=dict)  # of the software that made it; empty: of this process
    temperature: float | None = None  # of the winding, degrees C, to which R refers; None: as in the experiment
    last_stamp: int = 0  # of the last sample, ns; 0 where it is not known
    session: int = 0  # of the references under which it was recorded


def write_results(
    directory: Path,
    identification: IdentifiedDrive,
    provenance: Provenance,
    *,
    force: bool = False,
    pictures: Mapping[str, bytes] | None = None,
    diagnostics: Diagnostics | None = None,
) -> None:
    """Write the result files of a fit, pictures by their names beside them, and diagnostics for reports.

    Results of an earlier fit of the same recordings are replaced; with ``force``, those of others, too, and the folder
    may hold other files. Raises OutputError, see :func:`~drive_id.files.results.folder.replace_folder` and
    :func:`~drive_id.files.results.folder.check_recordings`.
    """
    check_recordings(directory, provenance.inputs, force=force)
    harmonics = {_HARMONICS: _harmonics(identification.flux_map)} if identification.flux_map.harmonics else {}
    judged = {DIAGNOSTICS: diagnostics_bytes(diagnostics)} if diagnostics else {}
    found = {_NPZ: _flux_map(identification, provenance), **harmonics, **judged}
    digests = {name: sha256(content).hexdigest() for name, content in found.items()}
    text = json.dumps(results_tree(identification, provenance) | {"files": digests}, indent=1, allow_nan=False) + "\n"
    files = {**found, **(pictures or {}), MARKER: text.encode()}
    stale = {_HARMONICS, DIAGNOSTICS, *_PICTURES} - files.keys() if is_ours(directory / MARKER) else ()
    replace_folder(directory, files, marker=MARKER, kind=FORMAT, force=force, stale=stale)


def read_results(directory: Path) -> tuple[IdentifiedDrive, Provenance]:
    """Read the result folder of a fit: its map is the stored grid, and all warnings are in the provenance.

    Raises ResultError when it is not a result folder, is damaged, or was written by a newer version.
    """
    with _told(directory):
        try:
            return _read(directory)
        except _MixedError:
            return _read(directory)  # it may have been replaced between the first file and the last


def read_outline(directory: Path) -> tuple[dict[str, Any], Provenance]:
    """Read ``identification.json`` of a result folder, without the map; raises as :func:`read_results` does."""
    with _told(directory):
        tree = _tree(directory)
        return tree, _provenance(tree, str(directory))


@contextmanager
def _told(directory: Path) -> Iterator[None]:
    """Raise ResultError for whatever is wrong with the files that are read in the body."""
    try:
        yield
    except _DAMAGE as error:
        if isinstance(error, ResultError) and not isinstance(error, _MixedError):
            raise
        raise ResultError(
            f"The result folder {directory} is damaged ({damage(error)}): fit the recording again."
        ) from error


class _MixedError(ResultError):
    """A file of a result folder is not the one that was written with the others."""


def _read(directory: Path) -> tuple[IdentifiedDrive, Provenance]:
    where = directory / MARKER
    if not where.exists():
        raise ResultError(
            f"{directory} is not a result folder (it has no {MARKER}): give a folder that 'drive-id fit' wrote."
        )
    tree = _tree(directory)
    if tree["format"] != FORMAT:
        raise ValueError("another format")
    if int(tree["format_version"]) > FORMAT_VERSION:
        raise ResultError(
            f"{directory} was written by a newer drive_id (format {tree['format_version']}, and this "
            f"drive_id, {VERSION}, knows format {FORMAT_VERSION}): update it."
        )
    stored = _content(directory, _NPZ, tree)
    flux_map = _read_flux_map(stored)
    shape = flux_map.psi_d.shape
    if tree["harmonics"]:
        flux_map = replace(flux_map, harmonics=_read_harmonics(_content(directory, _HARMONICS, tree), shape))
    modes = _read_modes(stored, shape, len(tree["inverter_curve"]["current"]))
    return _identification(tree, flux_map, modes), _provenance(tree, str(directory))


def _tree(directory: Path) -> dict[str, Any]:
    tree = json.loads(read_text_input(directory / MARKER, LARGEST_MARKER))
    if not isinstance(tree, dict):
        raise ValueError("another format")  # noqa: TRY004  # of a file: its text is told
    return tree


def _content(directory: Path, name: str, tree: Mapping[str, Any]) -> bytes:
    """Return a file's content; refuse that of another fit, which results of earlier versions cannot tell."""
    content = read_input(directory / name, _LARGEST)
    if "files" in tree and tree["files"].get(name) != sha256(content).hexdigest():
        raise _MixedError(f"{name} was not written with its {MARKER}, as after a kill or a change by hand")
    return content


def read_judged(directory: Path, flux_map: FluxMap) -> Diagnostics | None:
    """Read the diagnostics beside a result; None where there are none, as in folders of earlier versions.

    Raises ResultError when the file is damaged.
    """
    try:
        if not (directory / DIAGNOSTICS).exists():
            return None
        return read_diagnostics(_content(directory, DIAGNOSTICS, _tree(directory)), flux_map.psi_d.shape)
    except _DAMAGE as error:
        raise ResultError(
            f"{directory / DIAGNOSTICS} is damaged ({damage(error)}): delete it to use the result without it, or fit "
            "the recording again."
        ) from error


def results_tree(identification: IdentifiedDrive, provenance: Provenance) -> dict[str, Any]:
    """Return the content of ``identification.json``; numbers that are not finite become null."""
    report, known = identification.report, provenance
    warnings = (*known.warnings, *report.warnings)
    nrmse_d, nrmse_q = known.nrmse or (None, None)
    tree = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "method": identification.method,
        "machine": known.machine,
        "i_max": identification.i_max,
        "pole_pairs": known.pole_pairs,
        "u_dc": known.u_dc,
        "speed_range": known.speed_range,
        "duration": known.duration,
        "date": known.date,
        "last_stamp": known.last_stamp,
        "session": known.session,
        "resistance": identification.resistance,
        "resistance_temperature": known.temperature,
        "sigma_resistance": identification.sigma_resistance,
        "voltage_error": identification.voltage_error,
        "sigma_voltage_error": identification.sigma_voltage_error,
        "magnet_coefficient": identification.magnet_coefficient,
        "inverter_curve": _curve(identification),
        "harmonics": [harmonic.order for harmonic in identification.flux_map.harmonics],
        "calibrations": [
            asdict(entry) | {"sentence": entry.message, "message": entry.message.tree()}
            for entry in identification.calibrations
        ],
        "statements": list(identification.statements),
        "torque": None if identification.torque is None else asdict(identification.torque),
        "mechanics": None if identification.mechanics is None else asdict(identification.mechanics),
        "linear_machine": None if identification.linear is None else asdict(identification.linear),
        "metrics": {
            "nrmse_d": nrmse_d,
            "nrmse_q": nrmse_q,
            **{name: value for name, value in asdict(report).items() if name != "warnings"},
        },
        "warnings": list(warnings),
        "messages": {
            "warnings": [message.tree() for message in warnings],
            "statements": [message.tree() for message in identification.statements],
        },
        "settings": asdict(known.settings),
        "inputs": [{"file": file, "sha256": digest} for file, digest in known.inputs.items()],
        "versions": dict(known.versions) or _versions(),
    }
    finite: dict[str, Any] = plain(tree)
    return finite


def _flux_map(identification: IdentifiedDrive, provenance: Provenance) -> bytes:
    known = provenance
    scalars = {
        "resistance": identification.resistance,
        "i_max": identification.i_max,
        "pole_pairs": _number(known.pole_pairs),
        "u_dc": _number(known.u_dc),
        "speed_range": np.array(known.speed_range or (np.nan, np.nan)),
        "duration": _number(known.duration),
    }
    texts = {
        "method": identification.method,
        "machine": known.machine,
        "date": known.date,
        **{name: getattr(known.settings, name) for name in ("serial", "bench", "operator", "notes")},
        "version": dict(known.versions).get("drive_id", VERSION),
        "units": json.dumps(_UNITS),
    }
    arrays = {name: getattr(identification.flux_map, name) for name in _MAP}
    modes = identification.error_modes
    joint = {} if modes is None else {name: np.float32(getattr(modes, name[6:])) for name in _MODES}
    return npz_bytes(arrays | scalars | texts | joint)


def _harmonics(flux_map: FluxMap) -> bytes:
    """Return an npz of the harmonics: ``order`` (H,), the axes, and amplitudes (H, D, Q), Wb."""
    found = flux_map.harmonics
    arrays = {name: np.array([getattr(harmonic, name) for harmonic in found]) for name in _AMPLITUDES}
    order = np.array([harmonic.order for harmonic in found])
    return npz_bytes({"order": order, "i_d": flux_map.i_d, "i_q": flux_map.i_q, **arrays})


def _curve(identification: IdentifiedDrive) -> dict[str, Any]:
    sigma, phases = identification.sigma_inverter_voltage, identification.phase_voltages
    return {
        "convention": "voltage drop of one phase, positive for positive current",
        "current": identification.inverter_current.tolist(),
        "voltage": identification.inverter_voltage.tolist(),
        **({} if sigma is None else {_SIGMA: sigma.tolist()}),
        **({} if phases is None else dict(zip(_PHASES, phases.T.tolist(), strict=True))),
    }


def _read_flux_map(content: bytes) -> FluxMap:
    file = read_arrays(content, _MAP, largest=_LARGEST)
    arrays = {name: file[name] for name in _MAP}
    if any(values.dtype.kind not in "bfiu" for values in arrays.values()):
        raise ValueError(f"{_NPZ} has arrays that are no numbers")
    shape = (len(arrays["i_d"]), len(arrays["i_q"]))
    if min(shape) < 4 or any(values.shape != shape for name, values in arrays.items() if not name.startswith("i_")):
        raise ValueError(f"{_NPZ} has arrays that do not fit its axes")
    if not all(np.isfinite(arrays[name]).all() for name in ("i_d", "i_q", "psi_d", "psi_q")):
        raise ValueError(f"{_NPZ} holds fluxes that are not finite")
    if not all((np.diff(arrays[name]) > 0).all() for name in ("i_d", "i_q")):
        raise ValueError(f"{_NPZ} has axes that do not rise")
    if any((np.abs(arrays[name]) > _MOST).any() for name in ("i_d", "i_q", "psi_d", "psi_q")):
        raise ValueError(f"{_NPZ} holds currents or fluxes beyond any drive")
    return FluxMap(*arrays.values())


def _read_modes(content: bytes, shape: tuple[int, ...], points: int) -> ErrorModes | None:
    """Read the joint errors, which results of earlier versions do not have."""
    file = read_arrays(content, _MODES, largest=_LARGEST)
    if not any(name in file for name in _MODES):
        return None
    found = {name[6:]: np.asarray(file[name]) for name in _MODES}
    count = len(found["resistance"])
    shapes = {"psi_d": (count, *shape), "psi_q": (count, *shape), "inverter_voltage": (count, points)}
    if any(x.shape != shapes.get(name, (count,)) or not np.isfinite(x).all() for name, x in found.items()):
        raise ValueError(f"{_NPZ} has error modes that do not fit the map")
    numbers = {name: found[name].astype(np.float64) for name in ("resistance", "inverter_voltage", "voltage_error")}
    return ErrorModes(found["psi_d"].astype(np.float32), found["psi_q"].astype(np.float32), **numbers)


def _read_harmonics(content: bytes, shape: tuple[int, ...]) -> tuple[HarmonicMap, ...]:
    file = read_arrays(content, ("order", *_AMPLITUDES), largest=_LARGEST)
    orders, amplitudes = file["order"].tolist(), [np.asarray(file[name], float) for name in _AMPLITUDES]
    if any(values.shape != (len(orders), *shape) for values in amplitudes):
        raise ValueError(f"{_HARMONICS} has amplitudes that do not fit the flux map")
    return tuple(HarmonicMap(int(order), *parts) for order, *parts in zip(orders, *amplitudes, strict=True))


def _identification(tree: Mapping[str, Any], flux_map: FluxMap, modes: ErrorModes | None) -> IdentifiedDrive:
    curve, metrics = _read_curve(tree["inverter_curve"]), tree["metrics"]
    magnet, linear = tree.get("magnet_coefficient"), tree.get("linear_machine")
    report: dict[str, Any] = {}
    for entry in fields(FitReport):
        if entry.name != "warnings":
            value, unknown = metrics[entry.name], np.inf if entry.name == "condition" else np.nan
            report[entry.name] = _number(value, unknown) if entry.type == "float" else int(value)
    if tree["method"] not in ORIGINS:
        raise ValueError(f"method is {tree['method']!r:.40}")
    return IdentifiedDrive(
        method=tree["method"],
        i_max=_positive(tree, "i_max"),
        resistance=_number(tree["resistance"]),  # unknown in some imported maps
        sigma_resistance=_number(tree["sigma_resistance"], np.inf),
        voltage_error=float(tree["voltage_error"]),
        sigma_voltage_error=_number(tree["sigma_voltage_error"], np.inf),
        inverter_current=curve["current"],
        inverter_voltage=curve["voltage"],
        flux_map=flux_map,
        report=FitReport(**report),
        sigma_inverter_voltage=curve.get(_SIGMA),
        phase_voltages=np.stack([curve[name] for name in _PHASES], axis=1) if _PHASES[0] in curve else None,
        calibrations=tuple(map(_read_calibration, tree["calibrations"])),
        magnet_coefficient=None if magnet is None else (float(magnet[0]), _number(magnet[1], np.inf)),
        statements=_messages(tree, "statements"),
        torque=_with_cogging(TorqueFit, tree.get("torque")),
        mechanics=_with_cogging(Mechanics, tree.get("mechanics")),
        error_modes=modes,
        linear=None if linear is None else LinearMachine(**{name: _number(x, np.inf) for name, x in linear.items()}),
    )


def _read_curve(curve: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Return current, voltage, its standard error and the voltages of the phases, as far as they are stored."""
    optional = {_SIGMA: [_SIGMA], _PHASES[0]: _PHASES}
    names = ["current", "voltage", *(name for first, group in optional.items() if first in curve for name in group)]
    arrays = {name: np.array([_number(x, np.inf if name == _SIGMA else np.nan) for x in curve[name]]) for name in names}
    current = arrays["current"]
    if len(current) < 2 or any(len(values) != len(current) for values in arrays.values()):
        raise ValueError("the inverter curve's currents and voltages differ in number")
    if not (np.diff(current) > 0).all():
        raise ValueError("the inverter curve's currents do not rise")
    if any((np.abs(values) > _MOST).any() for name, values in arrays.items() if name != _SIGMA):
        raise ValueError("the inverter curve holds values beyond any drive")
    return arrays


def _read_calibration(entry: Mapping[str, Any]) -> Calibration:
    from drive_id.core.full.effects.effect import Calibration  # noqa: PLC0415  # not needed to write a result

    return Calibration(
        name=str(entry["name"]),
        value=_number(entry["value"]),
        sigma=_number(entry["sigma"]),
        unit=str(entry["unit"]),
        applied=bool(entry["applied"]),
        message=Message.stored(entry.get("message", entry["sentence"])),
        doubtful=bool(entry.get("doubtful", False)),
    )


def _messages(tree: Mapping[str, Any], name: str) -> tuple[Message, ...]:
    """Read warnings or statements; earlier versions stored their sentences alone."""
    return tuple(map(Message.stored, tree.get("messages", tree)[name]))


_OfShaft = TypeVar("_OfShaft", TorqueFit, Mechanics)


def _with_cogging(kind: type[_OfShaft], tree: Mapping[str, Any] | None) -> _OfShaft | None:
    if tree is None:
        return None
    cogging = tuple(Cogging(**_numbers(entry)) for entry in tree["cogging"])
    return kind(**_numbers({name: value for name, value in tree.items() if name != "cogging"}), cogging=cogging)


def _provenance(tree: Mapping[str, Any], where: str) -> Provenance:
    """Read what is known besides; results of versions before these entries lack some of them."""
    names = {entry.name for entry in fields(FitSettings)}
    nrmse, speeds = (tree["metrics"]["nrmse_d"], tree["metrics"]["nrmse_q"]), tree.get("speed_range")
    return Provenance(
        inputs={str(entry["file"]): str(entry["sha256"]) for entry in tree["inputs"]},
        settings=from_mapping(FitSettings, {k: v for k, v in tree["settings"].items() if k in names}, where),
        machine=str(tree["machine"]),
        nrmse=None if None in nrmse else (float(nrmse[0]), float(nrmse[1])),
        warnings=_messages(tree, "warnings"),
        pole_pairs=None if tree.get("pole_pairs") is None else int(_positive(tree, "pole_pairs", MOST_POLE_PAIRS)),
        u_dc=None if tree.get("u_dc") is None else _positive(tree, "u_dc"),
        speed_range=None if speeds is None else (float(speeds[0]), float(speeds[1])),
        duration=None if not tree.get("duration") else _positive(tree, "duration"),
        date=str(tree.get("date", "")),
        last_stamp=_count(tree.get("last_stamp", 0), 63),
        session=_count(tree.get("session", 0), 64),
        versions=dict(tree["versions"]),
        temperature=None if tree.get("resistance_temperature") is None else _number(tree["resistance_temperature"]),
    )


def _count(value: Any, bits: int) -> int:
    if type(value) is not int or not 0 <= value < 1 << bits:
        raise ValueError(f"a stamp or a session is {value!r:.40}")
    return value


def _positive(tree: Mapping[str, Any], name: str, most: float = np.finfo(np.float64).max) -> float:
    """Return a number that is positive and not larger than ``most``."""
    value = tree[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value <= most:
        raise ValueError(f"{name} is {value!r:.40}")
    return float(value)


def _number(value: float | None, unknown: float = np.nan) -> float:
    if value is None:
        return unknown
    if not isinstance(value, (int, float)):
        raise ValueError(f"{value!r:.40} is no number")  # noqa: TRY004  # of a file: its text is told
    return float(value)


def _numbers(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries that are all numbers or None, as they are stored."""
    for value in tree.values():
        _number(value)
    return dict(tree)


def _versions() -> dict[str, str]:
    return {
        "drive_id": VERSION,
        "python": platform.python_version(),
        **{name: found for name in _DEPENDENCIES if (found := _version(name))},
    }


def _version(name: str) -> str:
    """Return the version of a distribution; empty where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
