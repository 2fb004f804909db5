"""The report: one file that loads nothing, with all sections, whatever the result holds or lacks."""

from __future__ import annotations

import base64
import gzip
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_page import Page
from result_folder import forget_digests

import drive_id
from drive_id.common.messages import Message
from drive_id.common.quantity import measured
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.maps.flux_map import FluxMap
from drive_id.errors import ConfigurationError, OutputError, ResultError
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.sources import Sources
from drive_id.reporting.page import pdf, report
from drive_id.reporting.page.charts import MOST_POINTS, charts_of
from drive_id.reporting.page.content import SECTIONS, content_of
from drive_id.reporting.page.html import rendered_page
from drive_id.reporting.page.operation import torque_map
from drive_id.reporting.page.report import check_report_output, report_files

HOSTILE = '</script><script>alert(1)</script> <b>&amp; "ipm"\' {{ 7 * 7 }} $x$'


def page_of(result, operation=None) -> Page:
    """Return the report without its pictures; they take most of the time, and so do lines of operation not given."""
    operation = operation or torque_map(result)
    return Page(rendered_page(content_of(result, operation), charts_of(result, operation), {}))


@pytest.fixture(scope="module")
def page(fitted):
    return Page(report_files(fitted)["report.html"].decode())


@pytest.fixture(scope="module")
def operation(fitted):
    """The lines of operation of the fit, whatever its texts say."""
    return torque_map(fitted)


@pytest.fixture(scope="module")
def loaded(fitted, tmp_path_factory):
    """Its folder, and the page of what is loaded from there."""
    folder = tmp_path_factory.mktemp("loaded") / "result"
    fitted.save(folder, draw=False)
    return folder, page_of(drive_id.load(folder))


@pytest.fixture(scope="module")
def page_of_full(full_like):
    return page_of(full_like)


@pytest.fixture(scope="module")
def page_of_import(imported):
    return page_of(imported)


@pytest.fixture(scope="module")
def imported(fitted):
    """A map without standard errors, inverter, residuals or pole pairs."""
    found = fitted.flux_map
    unknown = np.full(found.psi_d.shape, np.nan)
    flux_map = FluxMap(found.i_d, found.i_q, found.psi_d, found.psi_q, unknown, unknown, found.inside)
    report = replace(fitted.drive.report, mad_d=np.nan, mad_q=np.nan, residual_rms=np.nan, condition=np.inf)
    drive = replace(
        fitted.drive,
        method="imported",
        flux_map=flux_map,
        report=report,
        resistance=np.nan,
        sigma_resistance=np.nan,
        voltage_error=0.0,
        inverter_voltage=np.zeros_like(fitted.drive.inverter_voltage),
        error_modes=None,
        simulated=None,
    )
    provenance = replace(
        fitted.provenance, pole_pairs=None, u_dc=None, speed_range=None, duration=None, date="", nrmse=None, machine=""
    )
    return drive_id.Identification(drive, provenance)


@pytest.mark.slow  # reports are drawn
@pytest.mark.parametrize("name", ["page", "page_of_full", "page_of_import"])
def test_nothing_is_loaded_and_the_file_is_small(name, request):
    page = request.getfixturevalue(name)
    assert len(page.source.encode()) < 5e6
    for element in page.all():
        for attribute in ("src", "href", "srcset", "action", "data", "poster"):
            link = element.attributes.get(attribute, "#")
            assert link.startswith(("#", "data:")), (element.tag, link)
        assert not any(attribute.startswith("on") for attribute in element.attributes)
    (style,) = page.all("style")
    assert not re.search(r"url\(|@import|https?:", style.text())
    policy = next(e for e in page.all("meta") if e.attributes.get("http-equiv") == "Content-Security-Policy")
    assert policy.attributes["content"].startswith("default-src 'none';")
    assert not page.all("iframe", "object", "embed", "base")


def test_plotly_is_there_once_and_whole(page):
    from plotly.offline import get_plotlyjs

    packed = "".join(page.by_id("plotly").parts())
    assert gzip.decompress(base64.b64decode(packed)).decode() == get_plotlyjs()
    assert page.source.count(packed[:200]) == 1


def test_all_sections_are_there_and_reached(page):
    sections = [element.attributes["id"] for element in page.all("section")]
    assert sections == list(SECTIONS)
    (nav,) = page.all("nav")
    assert [link.attributes["href"] for link in nav.all("a")] == [f"#{name}" for name in SECTIONS]
    assert [heading.text() for heading in page.all("h2")] == list(SECTIONS.values())
    assert len(page.all("h1")) == len(page.all("main")) == len(page.all("header")) == 1


def test_controls_have_names_and_tables_captions(page):
    names = [element.attributes["id"] for element in page.all() if "id" in element.attributes]
    assert len(names) == len(set(names))
    for control in page.all("select", "input"):
        assert control.parent.tag == "label", control.attributes
        assert control.parent.text(), control.attributes
    assert all(button.text() and button.attributes["type"] == "button" for button in page.all("button"))
    tables = page.all("table")
    assert len(tables) >= 6
    for table in tables:
        (caption,) = table.all("caption")
        assert caption.text()
        assert all(cell.attributes["scope"] in {"col", "row"} for cell in table.all("th"))
    assert all(image.attributes["alt"] for image in page.all("img"))
    assert page.all("html")[0].attributes["lang"] == "en"


@pytest.mark.slow  # a report is drawn
def test_the_twin_is_identification_json(page, loaded):
    folder, again = loaded
    stored = json.loads((folder / "identification.json").read_text(encoding="utf-8"))
    digests = stored.pop("files")
    assert set(digests) == {"flux_map.npz", "diagnostics.npz"}
    (recorded,) = stored["inputs"]
    recorded["file"] = "/".join(Path(recorded["file"]).parts[-2:])  # no folders of this computer
    assert page.data("identification") == stored
    assert again.data("identification") == stored


@pytest.mark.slow  # a report is drawn
def test_names_and_warnings_stay_text(fitted, operation):
    provenance = replace(
        fitted.provenance,
        machine=HOSTILE,
        warnings=(Message.told(HOSTILE),),
        inputs={HOSTILE: "0" * 64},
        date="<i>today</i>",
    )
    page = page_of(replace(fitted, provenance=provenance), operation)
    assert len(page.all("script")) == 4
    assert not page.all("b", "i")
    (heading,) = page.all("h1")
    assert heading.text() == f"Identified drive: {HOSTILE}"
    assert page.by_id("warnings").text().count(HOSTILE) == 1
    assert page.data("identification")["machine"] == HOSTILE
    assert page.data("identification")["warnings"][0] == HOSTILE


def test_the_map_has_its_axes_in_order(fitted, page):
    """Checked at a point whose i_d and i_q differ, against the map's own queries."""
    drawn, found = page.data("charts")["map"], fitted.flux_map
    quantities = {entry["name"]: entry for entry in drawn["quantities"]}
    j, k = 40, 22
    i_d, i_q = drawn["i_d"][j], drawn["i_q"][k]
    assert i_d == pytest.approx(found.i_d[j], rel=1e-4)
    assert i_q == pytest.approx(found.i_q[k], rel=1e-4)
    assert drawn["inside"][k][j] == 1
    psi_d, psi_q = found.psi_dq(i_d, i_q)
    assert quantities["psi_d"]["z"][k][j] == pytest.approx(1e3 * psi_d, rel=1e-3)
    assert quantities["psi_q"]["z"][k][j] == pytest.approx(1e3 * psi_q, rel=1e-3)
    assert quantities["psi_d"]["sigma"][k][j] == pytest.approx(1e3 * found.sigma(i_d, i_q)[0], rel=0.02)
    factor = {"mWb": 1e3, "µWb": 1e6}[quantities["sigma_q"]["unit"]]
    assert quantities["sigma_q"]["z"][k][j] == pytest.approx(factor * found.sigma(i_d, i_q)[1], rel=0.02)
    step = 1e-2
    for name, flux, current in (("L_dq", 0, (0, step)), ("L_qd", 1, (step, 0)), ("L_dd", 0, (step, 0))):
        after, before = (found.psi_dq(i_d + s * current[0], i_q + s * current[1])[flux] for s in (1, -1))
        factor = {"mH": 1e3, "µH": 1e6}[quantities[name]["unit"]]
        assert quantities[name]["z"][k][j] == pytest.approx(factor * (after - before) / (2 * step), rel=2e-2), name
    torque = 1.5 * 4 * (psi_d * i_q - psi_q * i_d)
    assert quantities["torque"]["z"][k][j] == pytest.approx(torque, rel=1e-2)
    unlike = [quantities[name]["z"][j][k] for name in ("psi_d", "psi_q", "torque")]
    assert np.abs(np.subtract(unlike, [1e3 * psi_d, 1e3 * psi_q, torque])).min() > 0.5
    corner = [drawn["inside"][0][0], quantities["sigma_d"]["z"][0][0], quantities["L_dd"]["z"][0][0]]
    assert corner == [0, None, None]


def test_the_methods_are_those_fits_of_their_own(bag, fitted, page):
    alone = fit_bags(Sources([bag]), None, FitSettings(method="psm"))
    (psm,) = fitted.diagnostics.comparisons
    assert psm.method == "psm"
    assert psm.resistance == pytest.approx(alone.resistance, rel=1e-6)
    assert (psm.mad_d, psm.mad_q) == pytest.approx((alone.metrics["mad_d"], alone.metrics["mad_q"]), rel=1e-4)
    assert psm.nrmse_d == pytest.approx(alone.metrics["nrmse_d"], rel=1e-4)
    np.testing.assert_allclose(psm.psi_q, alone.flux_map.psi_q, rtol=1e-6, atol=1e-9)
    assert psm.residual_rms > 1.2 * fitted.diagnostics.residual_rms
    section = page.by_id("comparison")
    rows = [row.text() for row in section.all("tr")]
    assert any(measured(alone.resistance, alone.sigma_resistance, "Ω") in row for row in rows)
    apart = page.data("charts")["comparison"]["methods"][0]["psi_q"]
    j, k = 40, 22
    at = alone.flux_map.psi_q[j, k] - fitted.flux_map.psi_q[j, k]
    assert apart[k][j] == pytest.approx(1e3 * at, rel=1e-3)


def test_without_sums_the_methods_are_compared_if_all_samples_are_kept(fitted):
    (expected,), (whole,) = fitted.diagnostics.comparisons, replace(fitted, evidence=None).diagnostics.comparisons
    assert whole.resistance == pytest.approx(expected.resistance, rel=1e-9)
    half = tuple(part.part(0, len(part) // 2) for part in fitted.excerpts)
    (left,) = replace(fitted, evidence=None, excerpts=half).diagnostics.comparisons
    assert left.failure == "The fit kept no sums for it: fit with compare=True."


@pytest.mark.slow  # a report is drawn
def test_a_report_of_a_psm_fit_says_what_it_lacks(bag, operation):
    page = page_of(fit_bags(Sources([bag]), None, FitSettings(method="psm")), operation)
    assert "does not model the inverter" in page.by_id("inverter").text()
    assert not page.has_id("chart-inverter")
    assert "psm: inverter not modelled (this result)" in page.by_id("comparison").text()
    assert [method["name"] for method in page.data("charts")["comparison"]["methods"]] == ["joint"]


@pytest.mark.slow  # a report is drawn
def test_a_full_result_shows_bands_phases_and_faults(page_of_full):
    page = page_of_full
    drawn = page.data("charts")["inverter"]
    assert set(drawn["sigma"]) == {0.05}
    assert drawn["phases"][1][-1] == pytest.approx(1.1 * drawn["voltage"][-1], rel=1e-4)
    text = page.by_id("identifiable").text()
    assert "The data cover the whole current disc." in text
    assert "Record longer: " in text
    assert "What would help most" not in text
    (row,) = (row for row in page.by_id("identifiable").all("tr") if "resolver offset" in row.text())
    assert [cell.texts[-1].replace("\xa0", " ") for cell in row.children] == [
        "resolver offset",
        "0.573 ± 0.057 °",
        "corrected",
    ]
    assert [name.text() for name in row.all("span")] == ["Value", "In the map"]
    assert [entry["name"] for entry in page.data("charts")["comparison"]["methods"]] == ["psm", "joint"]


def test_an_imported_map_has_a_report(page_of_import):
    page = page_of_import
    for name in ("comparison", "residuals", "currents"):
        assert "no recording to compare" in page.by_id(name).text(), name
    assert "pole pairs is unknown" in page.by_id("operation").text()
    assert "no curve of an inverter" in page.by_id("inverter").text()
    (answer,) = (found for found in page.all("ul") if found.attributes.get("aria-label") == "What is asked for first")
    assert "unknown" not in answer.text()
    assert "nan" not in re.sub(r"[^a-z ]", " ", page.by_id("main").text().lower()).split()
    charts = page.data("charts")
    assert charts["inverter"] is charts["residuals"] is charts["currents"] is charts["operation"] is None
    assert [entry["name"] for entry in charts["map"]["quantities"]] == [
        "psi_d",
        "psi_q",
        "L_dd",
        "L_qq",
        "L_dq",
        "L_qd",
        "saliency",
    ]
    assert charts["map"]["quantities"][0]["sigma"] is None


@pytest.mark.slow  # a report is drawn
def test_a_stored_result_has_the_same_report(page, loaded):
    folder, stored = loaded
    assert (folder / "diagnostics.npz").stat().st_size < 3e5
    assert stored.by_id("comparison").text() == page.by_id("comparison").text()
    ours, theirs = (found.data("charts") for found in (page, stored))
    pairs = [(ours["currents"], theirs["currents"])]
    pairs += [(ours["residuals"][name], theirs["residuals"][name]) for name in ("time", "angle", "plane")]
    for mine, other in pairs:
        assert set(mine) == set(other)
        for name, values in mine.items():
            both = (np.array(side, float) for side in (values, other[name]))
            np.testing.assert_allclose(*both, rtol=1e-4, atol=1e-5, err_msg=name)
    quantities = zip(ours["map"].pop("quantities"), theirs["map"].pop("quantities"), strict=True)
    for mine, other in quantities:
        assert {**mine, "z": 0, "sigma": 0} == {**other, "z": 0, "sigma": 0}
        for name in ("z", "sigma"):
            both = (np.array(side[name], float) for side in (mine, other))
            np.testing.assert_allclose(*both, rtol=1e-4, err_msg=mine["name"])
    assert ours["map"] == theirs["map"] | {"trajectory": ours["map"]["trajectory"]}


@pytest.mark.slow  # a report is drawn
@pytest.mark.usefixtures("plain_reports")
def test_a_fit_stores_what_its_samples_give(bag, fitted, tmp_path):
    """From the sums of all samples, or from the samples that the result keeps: the same."""
    found = fit_bags(Sources([bag]), tmp_path / "result", FitSettings(method="joint"))
    assert drive_id.load(tmp_path / "result").diagnostics.comparisons == ()  # nobody asked for them
    found.save(tmp_path / "result", report=True)
    (stored,) = drive_id.load(tmp_path / "result").diagnostics.comparisons
    (kept,) = fitted.diagnostics.comparisons
    for name in ("resistance", "sigma_resistance", "residual_rms", "mad_d", "mad_q", "nrmse_d", "samples"):
        assert getattr(stored, name) == pytest.approx(getattr(kept, name), rel=1e-4), name
    np.testing.assert_allclose(stored.psi_d, kept.psi_d, rtol=1e-4, atol=1e-6)


@pytest.mark.slow  # a report is drawn
def test_a_folder_of_an_earlier_version_has_a_report(fitted, operation, tmp_path):
    fitted.save(tmp_path / "result", draw=False)
    (tmp_path / "result" / "diagnostics.npz").unlink()
    page = page_of(drive_id.load(tmp_path / "result"), operation)
    assert "holds no diagnostics.npz" in page.by_id("residuals").text()
    assert page.has_id("chart-inverter")
    assert page.has_id("chart-operation")


def test_a_folder_without_the_residual_over_the_plane_shows_none(fitted, operation, tmp_path):
    """An earlier version wrote its diagnostics."""
    fitted.save(tmp_path / "result", draw=False)
    path = forget_digests(tmp_path / "result") / "diagnostics.npz"
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **{name: values for name, values in arrays.items() if not name.startswith("plane_")})
    loaded = drive_id.load(tmp_path / "result")
    assert loaded.diagnostics.over_plane is None
    charts = charts_of(loaded, operation)
    assert charts["residuals"]["plane"] is None
    assert charts["residuals"]["time"]["x"]
    np.savez(path, **arrays | {"plane_rms": arrays["plane_rms"][:-1]})
    with pytest.raises(ResultError, match="over the current plane do not fit"):
        drive_id.load(tmp_path / "result")


@pytest.mark.essential
@pytest.mark.slow  # two maps of torque and efficiency
def test_losses_are_those_of_winding_and_iron_by_hand(fitted):
    """At the corner speed; copper by hand, and a given iron loss by the induced voltage."""
    entry = Calibration("iron_loss_conductance", 0.01, 1e-3, "S", applied=True, message=Message("region.whole"))
    losing = replace(fitted, drive=replace(fitted.drive, calibrations=(entry,)))
    with_iron = torque_map(losing)
    found, flux_map = with_iron.losses, losing.flux_map.whole
    d, q = (int(np.abs(axis - at).argmin()) for axis, at in ((flux_map.i_d, -100.0), (flux_map.i_q, 100.0)))
    i_d, i_q = flux_map.i_d[d], flux_map.i_q[q]
    psi = np.hypot(flux_map.psi_d[d, q], flux_map.psi_q[d, q])
    omega = found.speed * losing.pole_pairs
    assert found.losses["iron"][0][d, q] == pytest.approx(1.5 * 0.01 * (omega * psi) ** 2, rel=1e-6)
    assert found.losses["iron"][1][d, q] >= 0.1 * found.losses["iron"][0][d, q]
    without = torque_map(fitted).losses
    assert set(without.losses) == {"copper", "inverter"}
    assert np.isnan(without.speed)
    copper = 1.5 * fitted.resistance * (i_d**2 + i_q**2)
    assert without.losses["copper"][0][d, q] == pytest.approx(copper, rel=1e-9)
    views = {view["label"]: view["parts"] for view in charts_of(losing, with_iron)["map"]["views"]}
    assert views["Losses of winding and inverter"] == ["copper", "inverter"]
    assert [parts for label, parts in views.items() if label.startswith("Iron loss at ")] == [["iron"]]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no zip", None])
def test_damaged_diagnostics_are_named(fitted, tmp_path, content):
    fitted.save(tmp_path / "result", draw=False)
    path = tmp_path / "result" / "diagnostics.npz"
    path.write_bytes(path.read_bytes()[:2000] if content is None else content)
    with pytest.raises(ResultError, match=r"diagnostics\.npz is damaged .* delete it"):
        drive_id.load(tmp_path / "result")


def test_a_map_of_another_size_beside_its_diagnostics_is_damage(fitted, tmp_path):
    fitted.save(tmp_path / "result", draw=False)
    path = forget_digests(tmp_path / "result") / "diagnostics.npz"
    with np.load(path) as file:
        arrays = dict(file)
    arrays["psm_psi_d"] = arrays["psm_psi_d"][:-1]
    np.savez(path, **arrays)
    with pytest.raises(ResultError, match="does not fit the flux map"):
        drive_id.load(tmp_path / "result")


def test_fine_maps_are_thinned(fitted):
    fine = np.linspace(-310.0, 300.0, 401)
    psi_d, psi_q = 0.1 + 1e-4 * fine[:, None] + 0 * fine, 2e-4 * fine + 0 * fine[:, None]
    inside = np.ones(psi_d.shape, np.bool_)
    flux_map = FluxMap(fine, fine, psi_d, psi_q, 1e-5 * inside, 1e-5 * inside, inside)
    provenance = replace(fitted.provenance, pole_pairs=None)
    page = page_of(drive_id.Identification(replace(fitted.drive, flux_map=flux_map, error_modes=None), provenance))
    drawn = page.data("charts")["map"]
    assert len(drawn["i_d"]) == len(drawn["i_q"]) == MOST_POINTS
    assert (drawn["i_d"][0], drawn["i_d"][-1]) == (-310.0, 300.0)
    j, k = 10, 60
    assert drawn["quantities"][1]["z"][k][j] == pytest.approx(0.2 * drawn["i_q"][k], rel=1e-3)
    assert len(page.source.encode()) < 5e6


@pytest.mark.slow  # a report is drawn
def test_the_answer_stands_first_with_its_names(fitted, operation):
    named = replace(fitted.provenance.settings, serial="SN 7", operator="A. N. Other", notes="<cold>")
    page = page_of(replace(fitted, provenance=replace(fitted.provenance, settings=named)), operation)
    assert page.all("title")[0].text() == "Identified drive: ipm, serial SN 7"
    (tiles,) = (found for found in page.all("ul") if found.attributes.get("aria-label") == "What is asked for first")
    assert [[part.text() for part in list(tile.all("span"))[:3]] for tile in tiles.all("li")] == [
        [quantity.name.replace("_", ""), *str(quantity).replace("± ", "|± ").split(" |")]
        for name in ("ψ_PM", "L_d at zero current", "L_q at zero current", "R", "Torque at i_max, MTPA")
        for quantity in fitted.headline
        if quantity.name == name
    ]
    answer = [[quantity.name.replace("_", ""), str(quantity)] for quantity in fitted.headline]
    rows = [tuple(cell.text() for cell in row.children) for row in list(page.by_id("glance").all("tr"))[1:]]
    assert rows[:4] == [("Machine", "ipm"), ("Serial number", "SN 7"), ("Operator", "A. N. Other"), ("Notes", "<cold>")]
    assert [list(row) for row in rows[4 : 4 + len(answer)]] == answer


@pytest.mark.slow  # a report is drawn
def test_no_folder_of_this_computer_is_in_a_report(fitted, operation):
    (file,) = fitted.provenance.inputs
    folder = str(Path(file).parent.parent)
    assert Path(file).is_absolute()
    said = replace(fitted.provenance, warnings=(Message.told(f"{file} breaks off: check it."),))
    page = page_of(replace(fitted, provenance=said), operation)
    assert folder not in page.source
    assert "bag/bag_0.mcap breaks off: check it." in page.by_id("warnings").text()


def test_the_paragraph_has_the_results_own_numbers(fitted, page):
    text = page.by_id("paragraph").text()
    assert f"R = {measured(fitted.resistance, fitted.sigma_resistance, 'Ω')}" in text
    assert measured(fitted.voltage_error, fitted.sigma_voltage_error, "V") in text
    assert f"{measured(fitted.metrics['mad_d'], unit='A')} in d" in text
    assert "500 rpm" in text
    assert "doi:10.1049/icp.2025.2025" in text


@pytest.mark.slow  # a report is drawn
def test_the_levels_follow_the_figures(fitted, operation):
    report = replace(fitted.drive.report, coverage=0.5, mad_d=0.05 * fitted.i_max)
    changed = replace(fitted, drive=replace(fitted.drive, report=report), stored=fitted.diagnostics)
    page = page_of(changed, operation)
    (band,) = (found for found in page.all("ul") if found.attributes.get("aria-label") == "Quality")
    cards = {item.text().split(" 5")[0]: item for item in band.all("li")}
    assert cards["Disc covered"].attributes["class"] == "weak"
    assert "50 %" in cards["Disc covered"].text()
    assert cards["Simulated current"].attributes["class"] == "weak"
    assert re.search(r"leave out (49|50) % of the disc", page.by_id("identifiable").text())


def test_the_deviation_over_time_is_the_mad(fitted):
    found = fitted.diagnostics.simulated
    deviation = found.deviation.mean(axis=0)
    assert deviation == pytest.approx([fitted.metrics["mad_d"], fitted.metrics["mad_q"]], rel=1e-3)
    apart = np.abs(found.simulated - found.measured)
    assert apart.max() > 0.99 * found.deviation.max()
    assert found.time[-1] - found.time[0] <= 1.0
    assert len(found.time) <= 2001


# -- the files ---------------------------------------------------------------------------------------------------------


def test_a_report_is_replaced_and_nothing_else(fitted, page, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "report_files", lambda _, __: {"report.html": page.source.encode()})
    path = tmp_path / "new" / "report.html"
    assert fitted.report(path) == (path,)
    assert b"drive_id report" in path.read_bytes()[:300]
    check_report_output(path)
    path.write_text("<html>mine</html>")
    with pytest.raises(OutputError, match="exists already"):
        fitted.report(path)
    assert path.read_text() == "<html>mine</html>"
    with pytest.raises(ConfigurationError, match=r"end with \.html"):
        fitted.report(tmp_path / "report.txt")
    assert [file.name for file in tmp_path.rglob("*")] == ["new", "report.html"]


@pytest.mark.slow  # a report is drawn
def test_the_pdf_holds_the_same_words_within_its_pages(full_like, tmp_path, monkeypatch):
    pages, save = [], pdf.PdfPages.savefig

    def kept(self, figure, **options):
        pages.append(figure)
        save(self, figure, **options)

    monkeypatch.setattr(pdf.PdfPages, "savefig", kept)
    warnings = tuple(Message.told(f"Warning {number} of a report, {'long ' * 40}$x$ <b>.") for number in range(30))
    provenance = replace(full_like.provenance, warnings=warnings, machine=HOSTILE, inputs={"/long" * 60: "0" * 64})
    provenance = replace(provenance, u_dc=400.0)
    path = tmp_path / "report.html"
    written = replace(full_like, provenance=provenance).report(path, pdf=True)
    assert [file.name for file in written] == ["report.html", "report.pdf"]
    content = written[1].read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    assert len(content) < 3e6
    check_report_output(written[0], pdf=True)
    written[1].write_bytes(b"%PDF-1.4 of someone else")
    with pytest.raises(OutputError, match="exists already"):
        check_report_output(written[0], pdf=True)
    assert len(pages) > 4
    words = " ".join(text.get_text() for page in pages for text in page.texts)
    for heading in SECTIONS.values():
        assert heading in words
    for wanted in (
        "Warning 0 of",
        "Warning 29 of",
        "0" * 64,
        "The data cover the whole current disc.",
        f"page 1 of {len(pages)}",
    ):
        assert wanted in words, wanted
    assert sum(len(page.axes) for page in pages) == 8  # those of losses and efficiency, too
    for page in pages:
        renderer = page.canvas.get_renderer()
        width, height = page.bbox.width, page.bbox.height
        boxes = [text.get_window_extent(renderer) for text in page.texts]
        assert all(box.x0 > 0 and box.x1 < width and box.y0 > 0 and box.y1 < height for box in boxes)


@pytest.mark.slow  # a report is drawn
def test_the_efficiency_is_that_of_the_power_balance(fitted):
    """By brute force: the least current of the torque on a fine polar grid, and its losses."""
    result = replace(fitted, provenance=replace(fitted.provenance, u_dc=400.0))
    speeds = page_of(result).data("charts")["operation"]["speeds"]
    column, row = 5, 9
    torque, speed = speeds["torque"][row], speeds["speed"][column] * np.pi / 30
    amplitude, angle = np.meshgrid(np.linspace(1.0, 300.0, 1200), np.linspace(np.pi / 2, np.pi, 400), indexing="ij")
    i_d, i_q = amplitude * np.cos(angle), amplitude * np.sin(angle)
    psi_d, psi_q = result.flux_map.psi_dq(i_d, i_q)
    reached = 1.5 * result.pole_pairs * (psi_d * i_q - psi_q * i_d) >= torque
    current = amplitude[reached].min()
    theta = np.linspace(0.0, 2 * np.pi, 3600, endpoint=False)
    curve = result.inverter_curve
    inverter = 3 * np.mean(np.interp(current * np.cos(theta), curve.current, curve.voltage) * current * np.cos(theta))
    losses = 1.5 * result.resistance * current**2 + inverter
    expected = 100 * torque * speed / (torque * speed + losses)
    assert 50 < expected < 99.9
    assert speeds["efficiency"][row][column] == pytest.approx(expected, abs=0.05)
    assert speeds["iron"] is False


@pytest.mark.slow  # a report is drawn
def test_the_efficiency_is_known_up_to_the_largest_torque(fitted):
    """Its currents lie at the rim of the data, whose grid cells have corners beyond."""
    flux_map = fitted.flux_map
    whole = replace(flux_map, inside=np.hypot(*np.moveaxis(flux_map.grid(), -1, 0)) <= fitted.i_max)
    drive, provenance = replace(fitted.drive, flux_map=whole), replace(fitted.provenance, u_dc=400.0)
    speeds = page_of(replace(fitted, drive=drive, provenance=provenance)).data("charts")["operation"]["speeds"]
    below = np.array(speeds["torque"])[:, None] <= speeds["largest"]
    assert below.sum() > 200
    assert np.isfinite(np.array(speeds["efficiency"], float)[below]).all()


@pytest.mark.slow  # a report is drawn
def test_the_drop_is_told_as_a_dead_time(fitted, operation):
    """2 V of 400 V are 0.5 % of the period, 0.5 µs at 10 kHz."""
    drive = replace(fitted.drive, voltage_error=2.0, sigma_voltage_error=0.02)
    result = replace(fitted, drive=drive, provenance=replace(fitted.provenance, u_dc=400.0))
    said = page_of(result, operation).by_id("inverter").text()
    assert "2.000 ± 0.020 V, is that of a dead time of 0.5 % of the switching period at 400 V, 0.5 µs at 10 kHz" in said
    without = page_of(replace(result, provenance=replace(result.provenance, u_dc=None)))
    assert "dead time" not in without.by_id("inverter").text()
    assert "efficiency over speed are not shown" in without.by_id("operation").text()


def test_what_samples_only_enclose_is_shown_with_its_standard_error(fitted):
    """A hole around zero current, in whose place the joint errors are known."""
    found, modes = fitted.flux_map, fitted.drive.error_modes
    hole = found.inside & (np.hypot(found.i_d[:, None], found.i_q) < 40.0)
    drive = replace(fitted.drive, flux_map=replace(found, inside=found.inside & ~hole))
    holed = replace(fitted, drive=drive, stored=fitted.diagnostics)
    operation = torque_map(holed)
    drawn = charts_of(holed, operation)["map"]
    quantities = {entry["name"]: entry for entry in drawn["quantities"]}
    n, m = (int(at[0]) for at in np.nonzero(hole))
    assert (drawn["inside"][m][n], drawn["known"][m][n]) == (0, 1)
    factor = {"mWb": 1e3, "Wb": 1.0}[quantities["psi_d"]["unit"]]
    assert quantities["psi_d"]["sigma"][m][n] == pytest.approx(factor * np.linalg.norm(modes.psi_d[:, n, m]), rel=1e-3)
    assert quantities["L_dd"]["sigma"][m][n] > 0
    assert len(operation.lines["MTPA"]) == len(torque_map(fitted).lines["MTPA"])
    without = replace(holed, drive=replace(drive, error_modes=None))
    assert charts_of(without, None)["map"]["known"][m][n] == 0
