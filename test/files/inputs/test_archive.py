"""Arrays of npz files: what numpy reads, and nothing that declares more than it is worth."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from drive_id.files.inputs.archive import DAMAGED, RATIO, UNPACKED, read_arrays, unpacked_limit


def saved(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def member(
    shape: tuple[int, ...], kind: str, content: bytes, method: int = zipfile.ZIP_DEFLATED, *, unended: bool = False
) -> bytes:
    """Return an npz whose one array declares a shape and holds other content; its header may be a text without end."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": kind, "fortran_order": False, "shape": shape})
        said = header.getvalue().replace(b"'shape'", b"'''ape'") if unended else header.getvalue()
        archive.writestr("x.npy", said + content)
    return stream.getvalue()


def test_what_numpy_reads(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.array(3), "d/e": np.zeros((0, 4), "i2")}
    (tmp_path / "x.npz").write_bytes(saved(**arrays))
    with (tmp_path / "x.npz").open("rb") as stream:
        found = read_arrays(stream)
    assert set(found) == set(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
    assert set(read_arrays(saved(**arrays), ("a", "missing"))) == {"a"}


def test_what_would_unpack_to_too_much_is_not_unpacked(monkeypatch):
    bomb = saved(x=np.zeros(UNPACKED // 8 + 10_000))
    assert len(bomb) * RATIO + UNPACKED > UNPACKED
    data = saved(x=np.zeros(3 * UNPACKED // 8))
    monkeypatch.setattr(np.lib.format, "read_array", None)  # must not be reached
    with pytest.raises(ValueError, match="it would unpack to 101 MB"):
        read_arrays(data)


@pytest.mark.parametrize("content", [b"", 7 * b"\0", 33 * b"\0"])
def test_an_array_that_is_not_as_large_as_it_declares_is_refused_before_it_is_read(monkeypatch, content):
    monkeypatch.setattr(np.lib.format, "read_array", None)  # must not be reached
    with pytest.raises(ValueError, match="'x' is not of the size that it declares"):
        read_arrays(member((4,), "<f8", content))


def test_small_numbers_count_as_the_floats_they_become():
    data = saved(x=np.zeros(UNPACKED // 2, np.int8))
    with pytest.raises(ValueError, match="it would unpack to"):
        read_arrays(data)
    assert len(read_arrays(saved(x=np.zeros(UNPACKED // 16, np.int8)))["x"]) == UNPACKED // 16


@pytest.mark.slow  # contents of many sizes are packed
def test_incompressible_content_of_any_size():
    rng = np.random.default_rng(1)
    x = rng.normal(size=UNPACKED // 8 + 1000)
    np.testing.assert_array_equal(read_arrays(saved(x=x))["x"], x)
    assert unpacked_limit(1 << 40) == 1 << 30


@pytest.mark.parametrize(
    "data",
    [
        member((1 << 50,), "<f8", b""),
        member((-1,), "<f8", bytes(8)),
        member((2, 2), "<f8", bytes(24)),
        member((1,), "|O", bytes(8)),
        member((1,), "<f8", bytes(8), zipfile.ZIP_LZMA),
        member((1,), "<f8", bytes(8), zipfile.ZIP_BZIP2),
        member((1,), "<f8", bytes(8), unended=True),
        saved(x=np.zeros(3))[:-30],
        b"",
        b"PK\5\6" + b"\xff" * 18,
        b"PK\5\6",
    ],
)
def test_what_is_damaged(data):
    with pytest.raises(DAMAGED):
        read_arrays(data)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_members_of_one_name():
    stream = io.BytesIO(saved(x=np.zeros(3)))
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("x.npy", b"other")
    with pytest.raises(ValueError, match="two arrays of one name"):
        read_arrays(stream)
