"""Further kinds of input for ``fuzz.py``: logs in every container, slow logs, other tools' maps, results."""

from __future__ import annotations

import json
import random
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_inputs import Kind, changed_arrays, damage_result, damaged, damaged_text
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

import drive_id
from drive_id.types import Samples

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from column_files import WRITERS  # type: ignore[import-not-found]  # the writers of the tests

Made = tuple[str, tuple[str, ...], str]

_DEFAULTS = "defaults: {{{time} sample_period: 1e-4}}\n"
_COLUMNS = """\
currents: {{fields: ["{p}i_a", "{p}i_b", "{p}i_c"]}}
voltages: {{fields: ["{p}u_a", "{p}u_b", "{p}u_c"]}}
resolver: {{angle: "{p}theta", speed: "{p}omega"}}
reference: {{fields: ["{p}id_ref", "{p}iq_ref"]}}
"""
_ROWS = """\
defaults: {topic: /log, stamp: log_time, sample_period: 1e-4}
currents: {fields: ["i[0]", "i[1]", "i[2]"]}
voltages: {fields: ["u[0]", "u[1]", "u[2]"]}
resolver: {angle: angle, speed: speed}
"""
_SLOW = """\
defaults: {stamp: t, stamp_unit: s}
currents: {frame: dq, fields: [i_d, i_q]}
voltages: {frame: dq, fields: [u_d, u_q]}
resolver: {speed: n, speed_unit: rpm, mechanical: true, pole_pairs: 4}
"""
_TOPICS = ("log.bag", "log_json.mcap")
LOGS = (*WRITERS, *_TOPICS)
_IMPORTS = ("machine.npz", "map.csv", "syre.mat", "fdfq_idiq_n256.mat")


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
    _write_ros1(folder / "log.bag", samples)
    _write_json(folder / "log_json.mcap", samples)
    for name in _TOPICS:
        (folder / f"{name}.yaml").write_text(_ROWS, encoding="utf-8")
    _write_slow(folder / "slow.csv")
    (folder / "slow.csv.yaml").write_text(_SLOW, encoding="utf-8")
    _write_maps(folder)


def _write_ros1(path: Path, samples: Samples) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    definition = "time stamp\nfloat64[3] i\nfloat64[3] u\nfloat64 angle\nfloat64 speed\n"
    store.register(get_types_from_msg(definition, "bench_msgs/msg/Row"))
    row, time = store.types["bench_msgs/msg/Row"], store.types["builtin_interfaces/msg/Time"]
    with Rosbag1Writer(path) as writer:
        connection = writer.add_connection("/log", row.__msgtype__, typestore=store)
        for k, stamp in enumerate(_epoch(samples)):
            message = row(
                time(*divmod(stamp, 10**9)), samples.i_abc[k], samples.u_abc[k], samples.angle[k], samples.speed[k]
            )
            writer.write(connection, stamp, store.serialize_ros1(message, row.__msgtype__))


def _write_json(path: Path, samples: Samples) -> None:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("")
        channel = writer.register_channel("/log", "json", writer.register_schema("Row", "jsonschema", b"{}"))
        for k, stamp in enumerate(_epoch(samples)):
            row = {"i": samples.i_abc[k].tolist(), "u": samples.u_abc[k].tolist()}
            row |= {"angle": samples.angle[k], "speed": samples.speed[k]}
            writer.add_message(channel, stamp, json.dumps(row).encode(), stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def _epoch(samples: Samples) -> list[int]:
    return [1_700_000_000_000_000_000 + int(stamp - samples.stamp[0]) for stamp in samples.stamp]


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


def _damaged_file(source: Path, folder: Path, rng: random.Random) -> str:
    """Write a damaged copy; texts are damaged line by line, too."""
    if source.suffix == ".csv" and rng.random() < 0.5:
        text, said = damaged_text(source.read_text(encoding="utf-8"), rng)
        data = text.encode("utf-8", "surrogatepass")
    else:
        data, said = damaged(source.read_bytes(), rng)
    (folder / source.name).write_bytes(data)
    return said


def _log(name: str) -> Kind:
    def make(corpus: Path, folder: Path, rng: random.Random) -> Made:
        said = _damaged_file(corpus / name, folder, rng)
        signals = ("--signals", str(corpus / f"{name}.yaml"))
        arguments, compare = rng.choices(
            (
                (("fit", name, *signals, "--output", "out", "--method", "joint"), "nocrc.mcap joint"),
                (("convert", name, "out", *signals), ""),
                (("check", name, *signals, *rng.choice(((), ("--json",)))), ""),
                (("check", name, "--draft", "draft.yaml"), ""),
                (("info", name), ""),
            ),
            (5, 2, 2, 1, 1),
        )[0]
        return said, arguments, compare

    return make


def _static(corpus: Path, folder: Path, rng: random.Random) -> Made:
    said = _damaged_file(corpus / "slow.csv", folder, rng)
    signals = ("--signals", str(corpus / "slow.csv.yaml"))
    if rng.random() < 0.2:
        return said, ("check", "slow.csv", *signals), ""
    return said, ("fit", "slow.csv", *signals, "--method", "static", "--output", "out"), ""


def _import(name: str) -> Kind:
    def make(corpus: Path, folder: Path, rng: random.Random) -> Made:
        if name.endswith(".npz") and rng.random() < 0.7:
            data, said = changed_arrays(corpus / name, rng, signed=False)
            (folder / name).write_bytes(data)
        else:
            said = _damaged_file(corpus / name, folder, rng)
        known = () if name in ("machine.npz", "syre.mat") else ("--pole-pairs", "3", "--resistance", "0.45")
        return said, ("import", name, "--output", "out", *known), ""

    return make


def _check(corpus: Path, folder: Path, rng: random.Random) -> Made:
    shutil.copytree(corpus / "ours", folder / "ours")
    file = rng.choice(sorted((folder / "ours").iterdir()))
    data, said = damaged(file.read_bytes(), rng)
    file.write_bytes(data)
    return said, ("check", "ours", *rng.choice(((), ("--json",)))), ""


def _from_result(corpus: Path, folder: Path, rng: random.Random) -> Made:
    """Use a damaged result as a machine, and by the commands after a fit."""
    shutil.copytree(corpus / "result", folder / "result")
    said = damage_result(folder / "result", rng)
    arguments: tuple[str, ...] = rng.choices(
        (
            ("simulate", "--machine", "result", "--output", "out", "--seconds", "0.05"),
            ("export", "result", "--format", "csv", "--output", "out.csv"),
            ("compare", "result", str(corpus / "result")),
            ("analyze", "result", "--output", "out"),
        ),
        (4, 2, 2, 1),
    )[0]
    return said, arguments, ""


def _named(name: str) -> str:
    return name.replace(".", "_")


LOG_KINDS: dict[str, Kind] = {
    **{_named(name): _log(name) for name in LOGS},
    "static": _static,
    **{f"import_{_named(name)}": _import(name) for name in _IMPORTS},
    "check": _check,
    "from_result": _from_result,
}
