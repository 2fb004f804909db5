"""Result files of a fit: ``identification.json`` and ``flux_map.npz``, written whole or not at all."""

from __future__ import annotations

import io
import json
import math
import os
import platform
import tempfile
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import drive_id
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identification import Identification
from drive_id.errors import OutputError

FORMAT = "drive_id/identification"
FORMAT_VERSION = 1
_JSON, _NPZ, _HARMONICS = "identification.json", "flux_map.npz", "harmonics.npz"
_PICTURES = {f"{name}.{suffix}" for name in ("flux_map", "diagnostics") for suffix in ("png", "svg", "pdf")}
_DEPENDENCIES = ("numpy", "scipy", "numba", "rosbags", "mcap")


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from.

    Parameters
    ----------
    inputs : dict of str to str
        File to its sha256.
    settings : FitSettings
    machine : str
        Name, empty when unknown.
    nrmse : (float, float) or None
        Of psi_d and psi_q against the ground truth, when the bag carried it.
    warnings : tuple of str
        Of reading the bags, to stand beside those of the fit.
    """

    inputs: Mapping[str, str]
    settings: FitSettings
    machine: str = ""
    nrmse: tuple[float, float] | None = None
    warnings: tuple[str, ...] = field(default=())


def check_output(directory: Path, *, force: bool = False, marker: str = _JSON, kind: str = FORMAT) -> None:
    """Check, before the work is done, that results may be written to a folder.

    Parameters
    ----------
    directory : Path
    force : bool
        Allow a folder that holds other files.
    marker, kind : str
        JSON file, and the format it names, by which a folder is known as ours.

    Raises
    ------
    OutputError
        When it is a file, or holds something else than earlier results of ours and ``force`` is not given, or when
        it cannot be written to.
    """
    try:
        if not _is_there(directory):
            _check_base(directory, directory.parent)
            return
        if not directory.is_dir():
            raise OutputError(f"The output {directory} is a file: give a folder.")
        _check_base(directory, directory)
        if any(directory.iterdir()) and not force and not _is_ours(directory / marker, kind):
            raise OutputError(
                f"The output folder {directory} holds files that are not results of drive_id: give another folder, or "
                "--force to write beside them."
            )
    except OSError as error:
        raise _refused(directory, error) from error


def check_absent(path: Path) -> None:
    """Check, before the work is done, that something new may be written to a path.

    Raises
    ------
    OutputError
        When there is something, or it cannot be written.
    """
    try:
        if _is_there(path):
            raise OutputError(f"The output {path} exists already: remove it or give another name.")
        _check_base(path, path.parent)
    except OSError as error:
        raise _refused(path, error) from error


def replace_folder(
    directory: Path,
    files: Mapping[str, bytes],
    *,
    marker: str,
    kind: str,
    force: bool = False,
    stale: Collection[str] = (),
) -> None:
    """Write files to a folder so that they appear under their names only when all of them are complete.

    Parameters
    ----------
    directory : Path
        Created when missing; other files in it stay.
    files : mapping of str to bytes
    marker, kind, force
        See :func:`check_output`.
    stale : collection of str
        Files of earlier results to remove.

    Raises
    ------
    OutputError
        See :func:`check_output`; also when the disk is full.
    """
    check_output(directory, force=force, marker=marker, kind=kind)
    try:
        exists = directory.is_dir()
        base = directory if exists else directory.parent  # where a file can be renamed to its place
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=base, prefix=".drive_id-") as temporary:
            staged = Path(temporary) / "results"
            staged.mkdir()
            for name, content in files.items():
                (staged / name).write_bytes(content)
            if not exists:
                staged.rename(directory)
                return
            for name in sorted(files, key=lambda name: name == marker):
                (staged / name).replace(directory / name)
            for name in stale:
                (directory / name).unlink(missing_ok=True)
    except OSError as error:
        raise _refused(directory, error) from error


def write_results(
    directory: Path,
    identification: Identification,
    provenance: Provenance,
    *,
    force: bool = False,
    pictures: Mapping[str, bytes] | None = None,
) -> None:
    """Write the result files of a fit: ``identification.json``, ``flux_map.npz`` and pictures.

    Parameters
    ----------
    directory : Path
        See :func:`replace_folder`; results of an earlier fit in it are replaced.
    identification : Identification
    provenance : Provenance
    force : bool
        Write into a folder that holds other files.
    pictures : mapping of str to bytes, optional
        Further files by name.

    Raises
    ------
    OutputError
        See :func:`replace_folder`.
    """
    arrays = io.BytesIO()
    np.savez_compressed(arrays, **asdict(identification.flux_map))
    tree = results_tree(identification, provenance)
    text = json.dumps(tree, indent=1, allow_nan=False) + "\n"
    harmonics = {_HARMONICS: _harmonics(identification)} if identification.harmonics else {}
    files = {_NPZ: arrays.getvalue(), **harmonics, **(pictures or {}), _JSON: text.encode()}
    stale = set() if not _is_ours(directory / _JSON, FORMAT) else {_HARMONICS, *_PICTURES} - set(files)
    replace_folder(directory, files, marker=_JSON, kind=FORMAT, force=force, stale=stale)


def _harmonics(identification: Identification) -> bytes:
    """Return an npz of the harmonics: ``order`` (H,), the axes, and amplitudes (H, D, Q), Wb."""
    found, arrays = identification.harmonics, io.BytesIO()
    np.savez_compressed(
        arrays,
        order=np.array([harmonic.order for harmonic in found]),
        i_d=identification.flux_map.i_d,
        i_q=identification.flux_map.i_q,
        psi_d_cos=np.array([harmonic.psi_d_cos for harmonic in found]),
        psi_d_sin=np.array([harmonic.psi_d_sin for harmonic in found]),
        psi_q_cos=np.array([harmonic.psi_q_cos for harmonic in found]),
        psi_q_sin=np.array([harmonic.psi_q_sin for harmonic in found]),
    )
    return arrays.getvalue()


def _curve(identification: Identification) -> dict[str, Any]:
    deviation, phases = identification.inverter_deviation, identification.phase_voltages
    return {
        "convention": "voltage drop of one phase, positive for positive current",
        "current": identification.inverter_current.tolist(),
        "voltage": identification.inverter_voltage.tolist(),
        **({} if deviation is None else {"sigma_voltage": deviation.tolist()}),
        **(
            {} if phases is None else dict(zip(("voltage_a", "voltage_b", "voltage_c"), phases.T.tolist(), strict=True))
        ),
    }


def results_tree(identification: Identification, provenance: Provenance) -> dict[str, Any]:
    """Return the content of ``identification.json``; numbers that are not finite become null."""
    report = identification.report
    nrmse_d, nrmse_q = provenance.nrmse or (None, None)
    tree = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "method": identification.method,
        "machine": provenance.machine,
        "i_max": identification.i_max,
        "resistance": identification.resistance,
        "sigma_resistance": identification.sigma_resistance,
        "voltage_error": identification.voltage_error,
        "sigma_voltage_error": identification.sigma_voltage_error,
        "inverter_curve": _curve(identification),
        "harmonics": [harmonic.order for harmonic in identification.harmonics],
        "calibrations": [asdict(entry) for entry in identification.calibrations],
        "statements": list(identification.statements),
        "metrics": {
            "nrmse_d": nrmse_d,
            "nrmse_q": nrmse_q,
            **{name: value for name, value in asdict(report).items() if name != "warnings"},
        },
        "warnings": [*provenance.warnings, *report.warnings],
        "settings": asdict(provenance.settings),
        "inputs": [{"file": file, "sha256": digest} for file, digest in provenance.inputs.items()],
        "versions": _versions(),
    }
    finite: dict[str, Any] = _finite(tree)
    return finite


def _is_there(path: Path) -> bool:
    """Tell whether there is something, be it a link to nowhere; raises for names that cannot be."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _check_base(path: Path, base: Path) -> None:
    while not _is_there(base) and base != base.parent:
        base = base.parent
    if not base.is_dir() or not os.access(base, os.W_OK | os.X_OK):
        raise OutputError(f"The output {path} cannot be written because of {base}: give another name.")


def _refused(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"The output {path} cannot be written ({error.strerror or type(error).__name__}): make room or give another "
        "name."
    )


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _versions() -> dict[str, str]:
    return {
        "drive_id": drive_id.__version__,
        "python": platform.python_version(),
        **{name: found for name in _DEPENDENCIES if (found := _version(name))},
    }


def _version(name: str) -> str:
    """Return the version of a distribution; empty where it is not installed, as numba may be."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _is_ours(marker: Path, kind: str) -> bool:
    try:
        tree = json.loads(marker.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(tree, dict) and tree.get("format") == kind
