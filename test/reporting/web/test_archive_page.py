"""The archive of a folder: what its page holds, and what it refuses to hold."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import drive_id
from drive_id.cli.app import app
from drive_id.errors import ConfigurationError, OutputError
from drive_id.reporting.web.archive import Archive, _map
from drive_id.reporting.web.archive import rows as told
from drive_id.reporting.web.page import archive_page, write_page
from drive_id.result.result import Result

HOSTILE = "</script><script>alert(1)</script>"


def named(result, machine, day, serial="17"):
    settings = replace(result.provenance.settings, serial=serial)
    date = f"2026-03-{day:02d}T08:00:00+00:00"
    provenance = replace(result.provenance, machine=machine, settings=settings, date=date)
    return replace(result, provenance=provenance)


@pytest.fixture
def folder(fitted, tmp_path):
    root = tmp_path / "all"
    for day, machine in ((3, "ipm"), (5, HOSTILE), (4, "ipm")):
        named(fitted, machine, day).save(root / f"day {day}", draw=False)
    (root / "broken").mkdir()
    (root / "broken" / "identification.json").write_text("{")
    (root / ".hidden").mkdir()
    (root / ".hidden" / "identification.json").write_text("{")
    (root / "day 3" / "report.html").write_text("a report")
    return root


def data_of(page):
    return json.loads(re.search(r'id="rows">(.*?)</script>', page, re.DOTALL)[1])["rows"]


def test_a_row_tells_what_the_result_tells(folder, fitted):
    rows = told(Archive(folder).entries())
    assert [row["folder"] for row in rows] == ["day 5", "day 4", "day 3", "broken"]
    assert [row.get("report") for row in rows] == [False, False, True, False]
    assert "JSON" in rows[-1]["error"]
    assert str(folder) not in rows[-1]["error"]
    loaded = drive_id.load(folder / "day 4")
    value, sigma, unit, text = rows[1]["quantities"]["R"]
    assert (value, sigma, unit) == (1e3 * loaded.resistance, 1e3 * loaded.sigma_resistance, "mΩ")
    assert text == str(next(q for q in fitted.headline if q.name == "R"))
    assert (rows[1]["machine"], rows[1]["serial"], rows[1]["method"]) == ("ipm", "17", "joint")


def test_maps_of_one_machine_share_their_nodes(fitted):
    """Also where the radius of the disc differs; the values are those of the map, in mWb."""
    found, other = _map(fitted.flux_map, fitted.i_max), _map(fitted.flux_map, 0.97 * fitted.i_max)
    assert found["step"] == other["step"] == 2.0 ** np.round(np.log2(fitted.i_max / 16))
    i_d, i_q = (found["step"] * np.array(found[name]) for name in ("k_d", "k_q"))
    assert len(i_d) > 100
    expected = 1e3 * np.stack(fitted.flux_map.psi_dq(i_d, i_q))
    np.testing.assert_allclose([found["psi_d"], found["psi_q"]], expected, rtol=1e-5)


def test_only_what_changed_is_read_again(folder, fitted, monkeypatch):
    archive, read, load = Archive(folder), [], Result.load
    archive.entries()
    monkeypatch.setattr(Result, "load", staticmethod(lambda path: read.append(path.name) or load(path)))
    archive.entries()
    assert read == []
    named(fitted, "another", 6).save(folder / "day 4", draw=False)
    assert archive.entries()[0].row["machine"] == "another"
    assert read == ["day 4"]


def test_no_text_of_a_result_is_markup(folder):
    page = archive_page(Archive(folder).entries(), "a & <b>")
    assert "<script>alert" not in page
    assert [row.get("machine") for row in data_of(page)] == [HOSTILE, "ipm", "ipm", None]
    assert "<title>a &amp; &lt;b&gt;</title>" in page


def test_a_page_replaces_only_a_page(tmp_path):
    target = tmp_path / "index.html"
    write_page(target, archive_page([], "one"))
    write_page(target, archive_page([], "two"))
    assert "<title>two</title>" in target.read_text()
    target.write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        write_page(target, archive_page([], "three"))
    assert target.read_text() == "mine"


def test_the_command_indexes_a_folder_and_compares_results(folder, tmp_path):
    run = CliRunner().invoke
    assert run(app, ["index", str(folder)]).output.strip() == f"{folder / 'index.html'}: 4 results."
    page = tmp_path / "two.html"
    chosen = [str(folder / "day 4"), str(folder / "day 3")]
    assert run(app, ["index", *chosen, "--output", str(page), "--quiet"]).output == ""
    text = page.read_text()
    assert [row["folder"] for row in data_of(text)] == ["all/day 4", "all/day 3"]
    assert '"ticked": 2' in text
    told = json.loads(run(app, ["index", str(folder), "--json"]).output)
    assert told["page"] == str(folder / "index.html")
    assert {Path(name).name for name in told["results"]} == {"day 3", "day 4", "day 5", "broken"}
    refused = run(app, ["index", *chosen]).exception
    assert isinstance(refused, ConfigurationError)
    assert "--output" in str(refused)
    with pytest.raises(ConfigurationError, match="not a folder"):
        Archive(tmp_path / "nowhere")
