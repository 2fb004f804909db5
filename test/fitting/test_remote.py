"""A recording on object storage gives the same as its copy here, of which nothing is left."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import drive_id
from drive_id.cli.options import beside
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, NotABagError
from drive_id.files.inputs.remote import url_of
from drive_id.fitting.fit import accumulate_bags
from drive_id.fitting.sources import Sources, accumulate_sources

JOINT = FitSettings(method="joint")


@pytest.fixture
def store(bag, other_bag, tmp_path, monkeypatch):
    """A storage in memory with a folder, a single file, an information file and what is none of them."""
    fsspec = pytest.importorskip("fsspec", reason="the extra remote is not installed")
    system = fsspec.filesystem("memory")
    system.put(str(bag), "/store/bag", recursive=True)
    system.put(str(next(other_bag.glob("*.mcap"))), "/store/other.mcap")
    system.pipe("/store/notes.mcap", b"no bag")
    accumulate_bags(Sources([other_bag]), tmp_path / "x.info", FitSettings(method="joint", i_max=300.0))
    system.put(str(tmp_path / "x.info"), "/store/x.info")
    copies = tmp_path / "copies"
    copies.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(copies))
    yield "memory://store"
    system.rm("/store", recursive=True)
    assert not list(copies.iterdir())


def test_a_url_survives_being_a_path():
    for url in ("s3://bucket/monday/bag_0.mcap", "memory://bag", "gs://bucket/a b", "file:///data/bag"):
        assert url_of(Path(url)) == url
    for path in ("bag", "/data/bag", "C:/bag", "a:b/c", "../s3:/bag"):
        assert not url_of(Path(path))


def test_what_is_fetched_is_accumulated_like_what_is_here(store, bag, other_bag):
    here = accumulate_sources(Sources([bag, other_bag]), JOINT)
    urls = Sources([Path(f"{store}/bag"), Path(f"{store}/other.mcap")])
    with ThreadPoolExecutor(2) as executor:
        for sources in (urls, Sources(urls.paths, executor=executor)):
            found = accumulate_sources(sources, JOINT)
            for name, array in here.evidence.state().items():
                np.testing.assert_array_equal(array, found.evidence.state()[name], err_msg=name)
    assert [*found.digests.values()] == [*here.digests.values()]
    assert all(file.startswith(f"{store}/") for file in found.digests)


def test_a_fit_takes_urls_and_information_files_there(store, bag, other_bag, tmp_path):
    urls = [f"{store}/bag", f"{store}/x.info"]
    for _ in range(2):  # the same recordings may be fitted again
        found = drive_id.fit(urls, output=tmp_path / "out")
    assert found.method == "joint"  # of the information file
    assert found.resistance == drive_id.fit([bag, other_bag], method="joint", i_max=300.0, skip_bad=True).resistance


def test_what_is_wrong_there_is_named_by_its_url(store):
    for name, said in (("gone", "cannot be fetched"), ("notes.mcap", "is neither an MCAP nor a sqlite3 recording")):
        for settings in (JOINT, FitSettings(method="joint", i_max=300.0)):
            with pytest.raises(NotABagError, match=f"^{store}/{name} {said}"):
                accumulate_sources(Sources([Path(f"{store}/{name}")]), settings)
    with pytest.raises(NotABagError, match=r"^nothing://a/b cannot be fetched \(Protocol not known: nothing"):
        accumulate_sources(Sources([Path("nothing://a/b")]), JOINT)


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(
        ConfigurationError, match=r"^s3://b/bag needs the package fsspec: pip install 'drive_id\[remote\]'"
    ):
        accumulate_sources(Sources([Path("s3://b/bag")]), JOINT)


def test_the_result_of_a_url_is_written_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert beside(Path("s3://bucket/bag.mcap"), "_full") == tmp_path / "bag_full"
