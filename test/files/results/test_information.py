"""Information files: what goes in comes out, written whole, and one sentence for whatever is none."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same_bits import assert_same_bits

import drive_id
from drive_id.common.messages import Message
from drive_id.core.accumulation.accumulated import Accumulated
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.conclusion import conclude
from drive_id.errors import InformationError, OutputError
from drive_id.files.results import folder, information
from drive_id.files.results.folder import is_information
from drive_id.files.results.information import (
    FORMAT_VERSION,
    check_information_output,
    encode_information,
    information_tree,
    read_information,
    write_information,
)


@pytest.fixture(scope="module")
def accumulated(simulation):
    evidence = Evidence.within(FitSettings("joint", i_max=300.0), 300.0)
    evidence.add(simulation.samples)
    return Accumulated(
        evidence, (simulation.samples,), (Message("gaps", gaps=3, time_lost=0.5),), {"bag/bag_0.mcap": "ab" * 32},
        simulation.truth, len(simulation.samples), int(simulation.samples.stamp[-1]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def encoded(accumulated):
    return encode_information(accumulated)


def decode_information(data, where):
    """Decode the content of an information file, named in errors."""
    return information._decoded(io.BytesIO(data), where)


def changed(encoded: bytes, **changes) -> bytes:
    """Return the file with other members, None for none; ``header`` is a function of the tree."""
    with np.load(io.BytesIO(encoded)) as file:
        arrays = dict(file.items())
    for name, change in changes.items():
        if name == "header":
            header = json.loads(str(arrays["header"]))
            change(header)
            arrays["header"] = np.array(json.dumps(header))
        elif change is None:
            del arrays[name]
        else:
            arrays[name] = change
    return signed(arrays)


def signed(arrays: dict[str, np.ndarray], **header) -> bytes:
    """Return a file of these members with the digest that they need."""
    tree = json.loads(str(arrays.pop("header"))) | header
    tree["sha256"] = information._digest(tree, arrays)
    stream = io.BytesIO()
    np.savez(stream, **arrays, header=np.array(json.dumps(tree)))
    return stream.getvalue()


def test_what_goes_in_comes_out(accumulated, tmp_path):
    path = tmp_path / "below" / "x.info"
    write_information(path, accumulated)
    stored = read_information(path)
    found = stored.accumulated
    assert stored.software == drive_id.__version__
    assert found.evidence.settings == accumulated.evidence.settings
    assert not found.evidence.difference(accumulated.evidence)
    assert_same_bits(found, accumulated)
    assert found.truth.machine == "ipm"
    np.testing.assert_array_equal(found.truth.psi_d, accumulated.truth.psi_d)
    (piece,), (samples,) = found.validation, accumulated.validation
    for name in ("stamp", "i_abc", "u_abc", "angle", "speed", "run_starts", "i_dq_reference"):
        np.testing.assert_array_equal(getattr(piece, name), getattr(samples, name), err_msg=name)
    assert [file.name for file in path.parent.iterdir()] == ["x.info"]
    assert path.stat().st_size < 3e6


def test_it_is_fitted_like_what_was_written(accumulated, encoded):
    found = decode_information(encoded, "x").accumulated
    one, two = (conclude(part.evidence, part.validation) for part in (found, accumulated))
    assert one.resistance == pytest.approx(two.resistance, rel=1e-12)
    assert one.sigma_resistance == pytest.approx(two.sigma_resistance, rel=1e-9)
    assert one.report.mad_d == pytest.approx(two.report.mad_d, rel=1e-9)


def test_no_more_is_kept_for_the_mad_than_said(accumulated):
    samples = replace(accumulated.validation[0], sample_period=1e-3)
    found = decode_information(encode_information(replace(accumulated, validation=(samples,))), "x").accumulated
    assert [len(piece) for piece in found.validation] == [2000]
    assert decode_information(encode_information(replace(accumulated, validation=())), "x").accumulated.validation == ()


def test_no_truth_and_no_references_are_no_trouble(accumulated):
    samples = replace(accumulated.validation[0], i_dq_reference=None)
    found = decode_information(
        encode_information(replace(accumulated, truth=None, validation=(samples,))), "x"
    ).accumulated  # fmt: skip
    assert found.truth is None
    assert found.validation[0].i_dq_reference is None


def test_what_is_told_of_it(accumulated):
    tree = json.loads(json.dumps(information_tree(accumulated), allow_nan=False))
    assert (tree["samples"], tree["i_max"], tree["machine"]) == (20000, 300.0, "ipm")
    assert tree["duration"] == pytest.approx(2.0)
    assert tree["coverage"] > 0.9


# -- what is no information file ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.7, 0.999])
def test_a_file_that_breaks_off(encoded, tmp_path, share):
    path = tmp_path / "x.info"
    path.write_bytes(encoded[: int(share * len(encoded))])
    with pytest.raises(InformationError, match=r"^\S*x\.info is not an information file of drive_id, or it is "):
        read_information(path)


def test_a_flipped_byte_is_seen(encoded):
    for at in range(100, len(encoded), len(encoded) // 20):
        data = bytearray(encoded)
        data[at] ^= 0x10
        try:
            found = decode_information(bytes(data), "x").accumulated
        except InformationError:
            continue
        np.testing.assert_array_equal(  # in a part of the container that says nothing
            found.evidence.information.blocks, decode_information(encoded, "x").accumulated.evidence.information.blocks
        )


def pickled() -> bytes:
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("it was unpickled",))

    stream = io.BytesIO()
    np.savez(stream, header=np.array([Trap()], object))
    return stream.getvalue()


def zipped() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        file.writestr("hello.txt", "hello")
    return stream.getvalue()


def single_array() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


@pytest.mark.parametrize(
    "data",
    [b"", b"text", b"PK\x03\x04", pickle.dumps([1]), pickled(), zipped(), single_array(), b"[" * 100000],
    ids=["empty", "text", "magic", "pickle", "pickled", "zip", "npy", "brackets"],
)
def test_another_kind_of_file(data):
    with pytest.raises(InformationError, match=r"^x is not an information file of drive_id, or it is damaged: .*\.$"):
        decode_information(data, "x")


@pytest.mark.parametrize(
    "change",
    [
        {"header": lambda header: header.update(format="drive_id/identification")},
        {"header": lambda header: header.pop("format")},
        {"header": lambda header: header.update(format_version="new")},
        {"header": lambda header: header.update(ranges=[[1, 2]])},
        {"header": lambda header: header.update(ranges=[[1, -2], [0, 1]])},
        {"header": lambda header: header.update(inputs=[])},
        {"header": lambda header: header.update(settings={"method": "magic"})},
        {"header": lambda header: header["settings"].update(splines_d=10**9)},
        {"header": lambda header: header["settings"].update(splines_d=9)},
        {"header": lambda header: header.update(validation_periods=[1e-4, 1e-4])},
        {"header": lambda header: header.update(validation_periods=[-1.0])},
        {"evidence/information/blocks": None},
        {"evidence/information/blocks": np.zeros((2, 2))},
        {"evidence/samples": np.array("many")},
        {"evidence/visits/count": np.zeros((3, 3), np.int64)},
        {"validation/0/i_abc": np.full((20000, 3), np.nan)},
        {"truth": np.zeros(5, np.uint8)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_content_that_does_not_fit(encoded, change):
    with pytest.raises(InformationError, match=r"^x is not an information file of drive_id, or it is damaged: .*\.$"):
        decode_information(changed(encoded, **change), "x")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"i_max": float("nan")}, "its i_max is nan"),
        ({"i_max": -180.0}, "its i_max is -180.0"),
        ({"i_max": float("inf")}, "its i_max is inf"),
        ({"samples": -1}, "its number of samples is -1"),
        ({"samples": 0}, "its number of samples is 0"),
        ({"samples": 1e5}, "its number of samples is"),
        ({"last_stamp": 1 << 63}, "its last stamp"),
        ({"validation_periods": [0.0]}, "its sample period is 0.0"),
        ({"ranges": [[-1.0, float("nan")], [-1.0, 1.0]]}, "its map has no range"),
    ],
)
def test_numbers_that_no_recording_gives(encoded, change, said):
    with pytest.raises(InformationError, match=said):
        decode_information(changed(encoded, header=lambda header: header.update(change)), "x")


def test_stamps_that_are_no_whole_numbers(encoded):
    with pytest.raises(InformationError, match="its stamps are no whole numbers"):
        decode_information(changed(encoded, **{"validation/0/stamp": np.full(20000, np.nan)}), "x")


@pytest.mark.parametrize("name", ["evidence/samples", "evidence/_turn_square", "evidence/information/blocks"])
def test_sums_that_no_recording_gives(encoded, name):
    with np.load(io.BytesIO(encoded)) as file:
        value = file[name].copy()
    value[...] = -1 if value.dtype.kind == "i" else np.nan
    with pytest.raises(InformationError, match=name.removeprefix("evidence/")):
        decode_information(changed(encoded, **{name: value}), "x")


@pytest.mark.parametrize("name", ["evidence/information/blocks", "evidence/samples", "validation/0/i_abc", "further"])
def test_whatever_is_changed_shows_in_the_digest(encoded, name):
    with np.load(io.BytesIO(encoded)) as file:
        arrays = dict(file.items())
    arrays[name] = arrays[name] * 1.001 if name in arrays else np.zeros(3)
    arrays[name] = arrays[name].astype(np.asarray(arrays[name]).dtype)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    with pytest.raises(InformationError, match="its content does not match its digest"):
        decode_information(stream.getvalue(), "x")


def test_sums_of_many_splines_are_written_so_that_they_can_be_read(simulation):
    """Nearly all of them are zero, and compressed they would look like an attack."""
    settings = FitSettings("joint", i_max=300.0, splines_d=24, splines_q=24)
    evidence = Evidence.within(settings, 300.0)
    evidence.add(simulation.samples)
    whole = Accumulated(evidence, (), (), {}, None, len(simulation.samples), 1, ("x.db3",))
    found = decode_information(encode_information(whole), "x").accumulated
    assert found.evidence.information.total.shape == (1155, 1155)
    assert found.unchecked == ("x.db3",)


def test_a_newer_version_is_named(encoded):
    def renew(header):
        header.update(format_version=FORMAT_VERSION + 1, software="9.9", settings={"unheard": "of"})

    with pytest.raises(InformationError) as caught:
        decode_information(changed(encoded, header=renew), "x.info")
    assert str(caught.value) == (
        f"x.info was written by drive_id 9.9 in version {FORMAT_VERSION + 1} of the format, and this drive_id, "
        f"{drive_id.__version__}, "
        f"knows it up to version {FORMAT_VERSION}: update it."
    )


def test_an_older_version_is_named(encoded):
    older = changed(encoded, header=lambda header: header.update(format_version=1, software="0.0"))
    sentence = r"by drive_id 0\.0 in version 1 of the format.*: accumulate its bags again\."
    with pytest.raises(InformationError, match=sentence):
        decode_information(older, "x.info")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InformationError, match=r"x.info cannot be read \(No such file or directory\)"):
        read_information(tmp_path / "x.info")


def test_information_files_are_told_from_bags(encoded, bag, tmp_path):
    path = tmp_path / "named_otherwise"
    path.write_bytes(encoded)
    (tmp_path / "cut.info").touch()
    (tmp_path / "folder.info").mkdir()
    for there, found in (
        (path, True), (tmp_path / "cut.info", True), (tmp_path / "none.info", True), (tmp_path / "none", False),
        (tmp_path / "folder.info", False), (bag, False), (next(bag.glob("*.mcap")), False), (Path("x" * 5000), False),
    ):  # fmt: skip
        assert is_information(there) is found, there


# -- where it may be written -------------------------------------------------------------------------------------------


def test_an_earlier_information_file_is_replaced_and_nothing_else(accumulated, encoded, tmp_path):
    path = tmp_path / "x.info"
    for _ in range(2):
        write_information(path, accumulated)
    newer = changed(encoded, header=lambda header: header.update(format_version=99))
    path.write_bytes(newer)
    check_information_output(path)
    for content in (b"mine", zipped(), single_array(), encoded[:1000]):
        path.write_bytes(content)
        with pytest.raises(OutputError, match="exists already"):
            write_information(path, accumulated)
        assert path.read_bytes() == content
    with pytest.raises(OutputError, match="exists already"):
        check_information_output(tmp_path)
    with pytest.raises(OutputError, match="because of"):
        check_information_output(path / "below")


def test_a_full_disk_leaves_what_was_there(accumulated, encoded, tmp_path, monkeypatch):
    def full(*_args):
        raise OSError(28, "No space left on device")

    path = tmp_path / "x.info"
    path.write_bytes(encoded)
    monkeypatch.setattr(folder, "write_synced", full)
    with pytest.raises(OutputError, match=r"x.info cannot be written \(No space left on device\): make room"):
        write_information(path, accumulated)
    assert path.read_bytes() == encoded
    assert [file.name for file in tmp_path.iterdir()] == ["x.info"]


def test_optional_signals_of_the_excerpt_come_back(accumulated):
    count = len(accumulated.validation[0])
    torque = np.where(np.arange(count) < 10, np.nan, 3.0)
    piece = replace(accumulated.validation[0], shaft_torque=torque, winding_temperature=np.full(count, 40.0))
    (found,) = decode_information(
        encode_information(replace(accumulated, validation=(piece,))), "x"
    ).accumulated.validation
    np.testing.assert_array_equal(found.shaft_torque, torque[: len(found)])
    np.testing.assert_array_equal(found.winding_temperature, 40.0)
    assert found.dc_link_voltage is None
