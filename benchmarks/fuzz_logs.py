"""Further kinds of input for ``fuzz.py``: logs in every container, slow logs, other tools' maps, results."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_inputs import FIT, Kind, changed, in_a_result, in_arrays, in_bytes
from scipy.io import savemat

import drive_id
from drive_id.types import Samples

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from column_files import WRITERS  # type: ignore[import-not-found]  # the writers of the tests
from other_bags import SIGNALS, write_json, write_ros1  # type: ignore[import-not-found]

_DEFAULTS = "defaults: {{{time} sample_period: 1e-4}}\n"
_COLUMNS = """\
currents: {{fields: ["{p}i_a", "{p}i_b", "{p}i_c"]}}
voltages: {{fields: ["{p}u_a", "{p}u_b", "{p}u_c"]}}
resolver: {{angle: "{p}theta", speed: "{p}omega"}}
reference: {{fields: ["{p}id_ref", "{p}iq_ref"]}}
"""
_SLOW = """\
defaults: {stamp: t, stamp_unit: s}
currents: {frame: dq, fields: [i_d, i_q]}
voltages: {frame: dq, fields: [u_d, u_q]}
resolver: {speed: n, speed_unit: rpm, mechanical: true, pole_pairs: 4}
"""
_TOPICS = ("log.bag", "log_json.mcap")
LOGS = (*WRITERS, *_TOPICS)
_EPOCH = 1_700_000_000_000_000_000


# -- good inputs -------------------------------------------------------------------------------------------------------


def make_logs(folder: Path, samples: Samples) -> None:
    """Write the same samples as a log of every container, and a slow log and maps of other tools.

    Parameters
    ----------
    folder : Path
        The corpus.
    samples : Samples
    """
    assert samples.i_dq_reference is not None
    columns: dict[str, Any] = {"time_s": (samples.stamp - samples.stamp[0]) * 1e-9}
    for name, values in (("i", samples.i_abc), ("u", samples.u_abc)):
        columns |= {f"{name}_{phase}": np.ascontiguousarray(values[:, k]) for k, phase in enumerate("abc")}
    columns |= {"theta": samples.angle, "omega": samples.speed}
    columns |= {f"i{axis}_ref": np.ascontiguousarray(samples.i_dq_reference[:, k]) for k, axis in enumerate("dq")}
    for name, (write, prefix) in WRITERS.items():
        write(folder / name, columns)
        time = "" if name == "log.mf4" else f'stamp: "{prefix}time_s", stamp_unit: s,'
        text = _DEFAULTS.format(time=time) + _COLUMNS.format(p=prefix)
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    stamped = replace(samples, stamp=samples.stamp - samples.stamp[0] + _EPOCH)
    write_ros1(folder / "log.bag", stamped)
    write_json(folder / "log_json.mcap", stamped)
    for name in _TOPICS:
        (folder / f"{name}.yaml").write_text(SIGNALS, encoding="utf-8")
    _write_slow(folder / "slow.csv")
    (folder / "slow.csv.yaml").write_text(_SLOW, encoding="utf-8")
    _write_maps(folder)


def _write_slow(path: Path) -> None:
    """Write telemetry at 10 Hz of a machine without saturation at nine operating points."""
    rng = np.random.default_rng(4)
    resistance, psi_pm, l_d, l_q = 0.05, 0.08, 0.4e-3, 1.1e-3
    i_dq = np.repeat(rng.uniform((-80, -80), (0, 80), (9, 2)), 20, axis=0)
    omega = np.repeat(rng.uniform(100, 400, 9), 20)
    u_d = resistance * i_dq[:, 0] - omega * l_q * i_dq[:, 1]
    u_q = resistance * i_dq[:, 1] + omega * (psi_pm + l_d * i_dq[:, 0])
    values = [0.1 * np.arange(180), *i_dq.T, u_d, u_q, omega / 4 * 30 / np.pi]
    noisy = np.column_stack(values) + rng.normal(0, 1, (180, 6)) * [0, 0.05, 0.05, 0.02, 0.02, 0.5]
    np.savetxt(path, noisy, delimiter=",", header="t,i_d,i_q,u_d,u_q,n", comments="", fmt="%.6g")


def _write_maps(folder: Path) -> None:
    i_d, i_q = np.meshgrid(np.arange(-20.0, 15.1, 2.5), np.arange(-18.0, 18.1, 3.0))
    s = np.sqrt(1 + (i_d / 20) ** 2 + (i_q / 6) ** 2)
    psi_d, psi_q = 0.1 + 0.0075 * i_d / s + 0.002 * i_d, 3 / 36 * i_q / s + 0.003 * i_q
    maps = {"Id": i_d, "Iq": i_q, "Fd": psi_d, "Fq": psi_q}
    data = {"Rs": 0.45, "p": 3, "Imax": 15.0, "Vdc": 320.0, "axisType": "PM"}
    savemat(folder / "syre.mat", {"motorModel": {"data": data, "FluxMap_dq": maps}})
    savemat(folder / "fdfq_idiq_n256.mat", maps | {"dataSet": {"axisType": "PM"}})
    table = np.column_stack([each.ravel() for each in (i_d, i_q, psi_d, psi_q)])
    np.savetxt(folder / "map.csv", table, delimiter=",", header="i_d,i_q,psi_d,psi_q", comments="", fmt="%.8g")


def load_readers(corpus: Path) -> None:
    """Read each log once in this process, so that its forks need not load the libraries."""
    for name in LOGS:
        drive_id.read_bag(corpus / name, signals=corpus / f"{name}.yaml")


# -- kinds -------------------------------------------------------------------------------------------------------------


def _named(name: str) -> str:
    return name.replace(".", "_")


_LOG = {
    FIT.replace("{x}", "{x} --signals {corpus}/{x}.yaml") + "joint": 5,
    "convert {x} out --signals {corpus}/{x}.yaml": 2,
    "check {x} --signals {corpus}/{x}.yaml": 1,
    "check {x} --signals {corpus}/{x}.yaml --json": 1,
    "check {x} --draft draft.yaml": 1,
    "info {x}": 1,
}
_SLOW_LOG = {
    "fit {x} --signals {corpus}/{x}.yaml --output out --method static": 4,
    "check {x} --signals {corpus}/{x}.yaml": 1,
}
_RESULT = {
    "simulate --machine {x} --output out --seconds 0.05": 4,
    "export {x} --format csv --output out.csv": 2,
    "compare {x} {corpus}/result": 2,
    "analyze {x} --output out": 1,
}
_KNOWN = " --pole-pairs 3 --resistance 0.45"

LOG_KINDS: dict[str, Kind] = {
    **{_named(name): changed(name, in_bytes, _LOG, "nocrc.mcap") for name in LOGS},
    "static": changed("slow.csv", in_bytes, _SLOW_LOG),
    **{
        f"import_{_named(name)}": changed(name, damage, {f"import {{x}} --output out{known}": 1})
        for name, damage, known in (
            ("machine.npz", in_arrays, ""),
            ("map.csv", in_bytes, _KNOWN),
            ("syre.mat", in_bytes, ""),
            ("fdfq_idiq_n256.mat", in_bytes, _KNOWN),
        )
    },
    "check": changed("ours", in_bytes, {"check {x}": 1, "check {x} --json": 1}),
    "from_result": changed("result", in_a_result, _RESULT),
}
