"""Inputs for ``fuzz.py``: good ones of every kind and ways to damage them.

Everything follows from a kind and a number, so that a finding is reproduced by naming both.
"""

from __future__ import annotations

import io
import json
import random
import shutil
import sqlite3
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

import drive_id
from drive_id.bench.machines import machine_map
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.fit_settings import FitSettings
from drive_id.files.inputs.archive import npz_bytes
from drive_id.files.messages.messages import BLOCK_FIELDS, message_typestore, schema_text
from drive_id.files.results import information
from drive_id.files.write.writer import write_recording
from drive_id.fitting.fit import accumulate_bags
from drive_id.fitting.sources import Sources

SECONDS = 1.5
TRAJECTORY = Lissajous(frequency_d=7.3, frequency_q=2.3)
LARGE = [b"\xff" * 8, bytes(8), (1 << 40).to_bytes(8, "little"), (1 << 31).to_bytes(8, "little"), b"\x7f\xc0\0\0" * 2]
JOINT = ("--method", "joint")


@dataclass(frozen=True)
class Limit:
    """What the process has too little of: a name of ``fuzz_limits.LIMIT_KINDS``, or empty, and how much it has."""

    name: str = ""
    value: float = 0.0


UNLIMITED = Limit()


@dataclass(frozen=True)
class Case:
    """One input, ready to be given to the command line."""

    kind: str
    number: int
    damage: str  # what was done to it, in words
    arguments: tuple[str, ...]  # of ``drive-id``; relative to the folder of the case
    compare: str = ""  # name of the good input with whose map a map from this one must agree; empty: no map to compare
    limit: Limit = UNLIMITED


# -- good inputs -------------------------------------------------------------------------------------------------------


def make_corpus(folder: Path) -> None:
    """Write one good input of every kind into a folder."""
    samples = drive_id.simulate("ipm", SECONDS, seed=7, noise=1e-3, trajectory=TRAJECTORY)
    write_recording(folder / "ours", samples, samples.truth, compression="zstd", chunk_size=60_000)
    write_recording(folder / "plain", samples, compression="", chunk_size=60_000)
    _copy_mcap(folder / "ours", folder / "nocrc.mcap")
    _copy_sqlite(folder / "ours", folder / "sqlite")
    shutil.move(str(next((folder / "sqlite").glob("*.db3"))), folder / "sqlite.db3")
    packed = zstandard.ZstdCompressor().compress((folder / "nocrc.mcap").read_bytes())
    (folder / "packed.mcap.zstd").write_bytes(packed)
    accumulate_bags(Sources([folder / "ours"]), folder / "ours.info", FitSettings(method="joint"))
    drive_id.fit(folder / "ours", method="joint", output=folder / "result")
    for picture in (folder / "result").glob("*.png"):
        picture.unlink()
    machine = machine_map("ipm")
    arrays = {"id": machine.i_d, "iq": machine.i_q, "psi_d": machine.psi_d, "psi_q": machine.psi_q}
    scalars = {"R": machine.resistance, "pole_pairs": machine.pole_pairs}
    (folder / "machine.npz").write_bytes(npz_bytes(arrays | scalars))
    (folder / "signals.yaml").write_text(_SIGNALS, encoding="utf-8")
    (folder / "config.yaml").write_text("method: joint\nsplines_d: 8\ni_max: 180.0\nharmonic_orders: [6, 12]\n")


_SIGNALS = "".join(
    f"{section}:\n  topic: {topic}\n  stamp: header\n  sample_period: sample_period\n  first_sample: first_sample\n"
    f"  {fields}\n"
    for section, topic, fields in (
        ("currents", "phase_currents", "fields: [a, b, c]"),
        ("voltages", "phase_voltages", "fields: [a, b, c]\n  scale: 1.0"),
        ("resolver", "resolver", "angle: angle\n  speed: speed\n  angle_unit: rad"),
    )
)


def _copy_mcap(bag: Path, target: Path) -> None:
    """Copy a bag without any checksum, as fast recorders write it."""
    with target.open("wb") as stream, AnyReader([bag]) as reader:
        writer = McapWriter(stream, chunk_size=60_000, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("ros2")
        keys = {}
        for name, info in reader.topics.items():
            kind = str(info.msgtype)
            schema = writer.register_schema(kind, "ros2msg", schema_text(kind).encode())
            keys[name] = writer.register_channel(name, "cdr", schema)
        for connection, time, raw in reader.messages():
            writer.add_message(keys[connection.topic], time, bytes(raw), time)
        writer.finish()  # type: ignore[no-untyped-call]


def _copy_sqlite(bag: Path, target: Path) -> None:
    store = message_typestore()
    with AnyReader([bag]) as reader, Writer(target, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        keys = {
            name: writer.add_connection(name, str(info.msgtype), typestore=store)
            for name, info in reader.topics.items()
        }
        for connection, time, raw in reader.messages():
            writer.write(keys[connection.topic], time, raw)


# -- damage ------------------------------------------------------------------------------------------------------------


def damaged(data: bytes, rng: random.Random) -> tuple[bytes, str]:
    """Return a damaged copy, and what was done to it."""
    out, said = bytearray(data), []
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        at, length = rng.randrange(max(len(out), 1)), rng.choice((1, 4, 16, 300, 4096))
        way = rng.randrange(8)
        if way in (0, 1):
            bit = rng.randrange(8)
            out[at : at + 1] = bytes([out[at] ^ (1 << bit)]) if out else b""
            said.append(f"bit {bit} of byte {at} flipped")
        elif way == 2:
            del out[at:]
            said.append(f"cut at {at}")
        elif way == 3:
            large = rng.choice(LARGE)
            out[at : at + len(large)] = large
            said.append(f"{large.hex()} at {at}")
        elif way == 4:
            del out[at : at + length]
            said.append(f"{length} bytes removed at {at}")
        elif way == 5:
            out[at:at] = rng.randbytes(length)
            said.append(f"{length} random bytes inserted at {at}")
        elif way == 6:
            out[at : at + length] = bytes(min(length, len(out) - at))
            said.append(f"{length} bytes zeroed at {at}")
        else:
            source = rng.randrange(max(len(out), 1))
            out[at : at + length] = out[source : source + length]
            said.append(f"{length} bytes copied from {source} to {at}")
    return bytes(out), ", ".join(said)


def damaged_text(text: str, rng: random.Random) -> tuple[str, str]:
    """Return a text with tokens replaced, lines moved, or pieces of YAML that have a meaning."""
    lines, said = text.splitlines(), []
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(lines))
        way = rng.randrange(5)
        if way == 0:
            lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)] + rng.choice(_TOKENS)
        elif way == 1:
            key, _, _ = lines[at].partition(":")
            lines[at] = f"{key}: {rng.choice(_TOKENS)}"
        elif way == 2:
            lines.insert(at, rng.choice(lines))
        elif way == 3:
            del lines[at]
            lines = lines or [""]
        else:
            lines[at] = " " * rng.randrange(9) + lines[at].strip()
        said.append(f"line {at}: {lines[min(at, len(lines) - 1)][:60]!r}")
    return "\n".join(lines), "; ".join(said)


_TOKENS = (
    "", "~", "{}", "[]", "-1", "1e400", ".nan", ".inf", "0", "9" * 5000, "1:" * 3000 + "1", "'", '"', "&a *a", "*b",
    "!!binary x", "!!python/object:os.system x", "\x00", "\u202e", "x" * 5000, "[" * 3000, "[a, b]", "{a: {b: c}}",
    "true", "2020-01-01", "a[0]", "a[::0]", "a[999999999999]", "state.current[0", "dc_link_voltage", "log_time",
    "/dev/zero", "| \n  x", "<<: {a: b}", "../../etc/passwd",
)  # fmt: skip


def in_bytes(path: Path, rng: random.Random) -> str:
    """Damage a file, or one of a folder; texts line by line, too. Return what was done."""
    file = rng.choice(sorted(path.iterdir())) if path.is_dir() else path
    if file.suffix in (".csv", ".yaml") and rng.random() < 0.5:
        return in_lines(file, rng)
    data, said = damaged(file.read_bytes(), rng)
    file.write_bytes(data)
    return said


def in_lines(path: Path, rng: random.Random) -> str:
    """Damage a text line by line."""
    text, said = damaged_text(path.read_text(encoding="utf-8"), rng)
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return said


def in_arrays(path: Path, rng: random.Random) -> str:
    """Damage an npz, mostly by its arrays; the digest of an information file is mostly renewed."""
    if rng.random() < 0.3:
        return in_bytes(path, rng)
    signed = path.suffix == ".info" and rng.random() < 0.7
    data, said = changed_arrays(path, rng, signed=signed)
    path.write_bytes(data)
    return f"{said}, signed" if signed else said


def in_metadata(path: Path, rng: random.Random) -> str:
    """Damage the metadata.yaml of a bag."""
    return in_bytes(path / "metadata.yaml", rng)


def in_a_sample(path: Path, rng: random.Random) -> str:
    """Flip one bit in the values of one sample in a container without checksums."""
    if path.suffix == ".db3":
        return _in_a_row(path, rng)
    data = bytearray(path.read_bytes())
    with AnyReader([path]) as reader:
        messages = [(c.topic, bytes(raw)) for c, _, raw in reader.messages() if c.topic != "/current_reference"]
    topic, raw = messages[rng.randrange(len(messages))]
    start = data.find(raw)
    at, bit = rng.randrange(len(raw) // 2, len(raw)), rng.randrange(8)
    assert start >= 0
    data[start + at] ^= 1 << bit
    path.write_bytes(bytes(data))
    return f"bit {bit} of byte {at} in a message on {topic} flipped"


def _in_a_row(path: Path, rng: random.Random) -> str:
    with sqlite3.connect(path) as database:
        rows = database.execute("SELECT id, data FROM messages").fetchall()
        key, raw = rows[rng.randrange(len(rows))]
        at, bit = rng.randrange(len(raw)), rng.randrange(8)
        changed = raw[:at] + bytes([raw[at] ^ (1 << bit)]) + raw[at + 1 :]
        database.execute("UPDATE messages SET data = ? WHERE id = ?", (changed, key))
    database.close()
    return f"bit {bit} of byte {at} in message {key} flipped"


def changed_arrays(path: Path, rng: random.Random, *, signed: bool) -> tuple[bytes, str]:
    """Return an npz with a changed array or header; ``signed`` renews the digest of an information file."""
    with np.load(path, allow_pickle=False) as file:
        arrays: dict[str, Any] = dict(file.items())
    name = rng.choice(sorted(arrays))
    array = arrays[name]
    way = rng.randrange(7)
    odd = rng.choice((np.nan, np.inf, -1, 0, 1e300, -(2**62)))
    if name == "header":
        tree = json.loads(str(array))
        key = rng.choice(sorted(tree))
        tree[key] = rng.choice((None, -1, float("nan"), [], {}, "x", 10**30, [[1, 2]], True, 1e-300))
        arrays["header"], said = np.array(json.dumps(tree)), f"{key} of the header is {tree[key]!r}"
    elif way == 0:
        del arrays[name]
        said = f"without {name}"
    elif way == 1:
        arrays[name], said = array[..., :-1] if array.ndim else np.array([array]), f"{name} of another shape"
    elif way == 2 and array.dtype.kind in "fiu" and array.size:
        array = array.astype(np.float64).reshape(-1)
        array[rng.randrange(len(array))] = odd
        arrays[name], said = array.reshape(arrays[name].shape), f"{name} holds {odd}"
    elif way == 3 and array.dtype.kind in "fiu":
        with np.errstate(all="ignore"):
            arrays[name], said = (array * odd).astype(array.dtype), f"{name} multiplied by {odd}"
    elif way == 4:
        arrays[name], said = array.astype("U") if array.dtype.kind != "U" else np.zeros(3), f"{name} of another type"
    elif way == 5:
        arrays["other"], said = np.zeros(1 << 20), "with a further array"
    else:
        arrays[name], said = np.zeros((3, 0, 2)), f"{name} empty"
    if signed and "header" in arrays:
        tree = json.loads(str(arrays.pop("header")))
        tree["sha256"] = information._digest(tree, arrays)  # noqa: SLF001  # as one who knows the format can
        arrays["header"] = np.array(json.dumps(tree))
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue(), said


def in_a_result(result: Path, rng: random.Random) -> str:
    """Damage one file of a result folder, or change an entry of its JSON; return what was done."""
    file = result / rng.choice(("identification.json", "flux_map.npz"))
    if rng.random() < 0.7:  # as written by earlier versions: damage is not known by a digest
        tree = json.loads((result / "identification.json").read_text())
        del tree["files"]
        (result / "identification.json").write_text(json.dumps(tree))
    if file.suffix == ".npz" and rng.random() < 0.7:
        data, said = changed_arrays(file, rng, signed=False)
    elif rng.random() < 0.5:
        data, said = damaged(file.read_bytes(), rng)
    else:
        tree = json.loads((result / "identification.json").read_text())
        file = result / "identification.json"
        key = rng.choice(sorted(tree))
        tree[key] = rng.choice((None, -1, "x", [], {}, 1e308, [None], "9" * 4000, {"a": 1}, True))
        data, said = json.dumps(tree).encode(), f"{key} is {str(tree[key])[:40]!r}"
    file.write_bytes(data)
    return said


# -- kinds -------------------------------------------------------------------------------------------------------------

Kind = Callable[[Path, Path, random.Random], tuple[Any, ...]]
"""Writes a case into a folder, from the corpus: returns the last entries of its :class:`Case`, from the damage on."""


Damage = Callable[[Path, random.Random], str]
"""Damages a file or folder in place, and returns what was done."""


def changed(source: str, damage: Damage, commands: Mapping[str, int], good: str = "") -> Kind:
    """Return what damages a copy from the corpus, and gives it to one of the commands, which are weighted.

    ``{x}`` is the name of the copy. Fits must agree with that of ``good``, if that is given.
    """

    def make(corpus: Path, folder: Path, rng: random.Random) -> tuple[str, tuple[str, ...], str]:
        copy = folder / Path(source).name
        if (corpus / source).is_dir():
            shutil.copytree(corpus / source, copy)
        else:
            shutil.copy(corpus / source, copy)
        said = damage(copy, rng)
        command = rng.choices(list(commands), list(commands.values()))[0]
        arguments = tuple(word.format(x=copy.name, corpus=corpus) for word in command.split())
        return said, arguments, f"{good} {arguments[-1]}" if good and arguments[0] == "fit" else ""

    return make


FIT = "fit {x} --output out --method "
_FITS = {f"{FIT}joint": 6, f"{FIT}psm": 2, f"{FIT}full": 1}
_BAG = _FITS | {"info {x}": 3}


def _schema(corpus: Path, folder: Path, rng: random.Random) -> tuple[str, tuple[str, ...], str]:
    """Write a bag whose message definitions are damaged: nobody's messages, then, and read by their definition."""
    with AnyReader([corpus / "ours"]) as reader, (folder / "odd.mcap").open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE)
        writer.start("ros2")
        keys, said = {}, []
        for name, info in reader.topics.items():
            kind = str(info.msgtype)
            text = schema_text(kind)
            if kind in BLOCK_FIELDS and rng.random() < 0.6:
                text, what = damaged_text(text, rng)
                said.append(f"{name}: {what}")
            data = text.encode("utf-8", "replace")
            keys[name] = writer.register_channel(name, "cdr", writer.register_schema(kind, "ros2msg", data))
        for count, (connection, time, raw) in enumerate(reader.messages()):
            if count > 60:
                break
            writer.add_message(keys[connection.topic], time, bytes(raw), time)
        writer.finish()  # type: ignore[no-untyped-call]
    arguments = ("fit", "odd.mcap", "--output", "out", *JOINT)
    return " | ".join(said), arguments, ""


KINDS: dict[str, Kind] = {
    **{
        kind: changed(name, in_bytes, _BAG | ({"recover {x} --output out": 1} if name.endswith(".mcap") else {}), name)
        for kind, name in {
            "mcap": "ours/ours_0.mcap",
            "mcap_plain": "plain/plain_0.mcap",
            "mcap_nocrc": "nocrc.mcap",
            "mcap_packed": "packed.mcap.zstd",
            "sqlite": "sqlite.db3",
        }.items()
    },
    "sample_mcap": changed("nocrc.mcap", in_a_sample, _FITS, "nocrc.mcap"),
    "sample_sqlite": changed("sqlite.db3", in_a_sample, _FITS, "sqlite.db3"),
    "metadata": changed("ours", in_metadata, {f"{FIT}joint": 6, f"{FIT}psm": 2, "info {x}": 3}, "ours"),
    "information": changed("ours.info", in_arrays, {"fit {x} --output out": 7, "info {x}": 3}),
    "machine": changed("machine.npz", in_arrays, {"simulate --machine {x} --output bag --seconds 0.05": 1}),
    "result": changed("result", in_a_result, {"info {x}": 1}),
    "signals": changed("signals.yaml", in_lines, {"fit {corpus}/ours --signals {x} --output out --method joint": 1}),
    "config": changed("config.yaml", in_lines, {"fit {corpus}/ours --config {x} --output out": 1}),
    "schema": _schema,
}
