"""What results of each origin hold and say, as one table: sections of the report, fields of files, and words."""

from __future__ import annotations

import json

import numpy as np
import pytest
from steady_state import LinearDrive, disc_points, telemetry

import drive_id
from drive_id.common.origins import METHODS, ORIGINS, origin_named
from drive_id.core.accumulation.evidence import Evidence, check_live
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import ConfigurationError, ResultError
from drive_id.exchange.imports.importing import import_map
from drive_id.exchange.imports.source import Source
from drive_id.files.results.folder import MARKER
from drive_id.fitting.completion import completed
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.simulated import simulate
from drive_id.fitting.sources import Sources
from drive_id.reporting.page.content import Content, content_of
from drive_id.reporting.page.operation import torque_map
from drive_id.reporting.tables import fit_table

SECTIONS = ("comparison", "residuals", "currents", "inverter")

TABLE = {  # sections with data; figures at a glance; rows of the console's table; must be said, must not be said
    "psm": (
        {"comparison", "residuals", "currents"},
        {"Standard error of R", "Simulated current"},
        {"Mean error of simulated i_d / i_q", "Gaps", "Unknowns determined"},
        ("without a model of the inverter", "same recording by method full", "psm does not model the inverter"),
        ("reciproc", "linear part", "imported"),
    ),
    "joint": (
        set(SECTIONS),
        {"Standard error of R", "Simulated current"},
        {"Inverter drop", "Mean error of simulated i_d / i_q", "Gaps", "Unknowns determined"},
        ("solved jointly", "same recording by method full", "R includes the linear part of this drop"),
        ("reciproc", "does not model", "imported"),
    ),
    "full": (
        set(SECTIONS),
        {"Standard error of R", "Simulated current"},
        {"Inverter drop", "Mean error of simulated i_d / i_q", "Gaps", "Rotor-position harmonics"},
        ("in the stator frame over windows", "doi:10.1049"),
        ("by method full", "does not model", "imported"),
    ),
    "locked": (
        {"residuals", "currents", "inverter"},
        {"Standard error of R", "Simulated current"},
        {"Inverter drop", "Mean error of simulated i_d / i_q", "Gaps", "Unknowns determined"},
        ("The rotor was locked", "magnets' flux and the torque are unknown", "those of one rotor position"),
        ("ψ_PM", "MTPA", "reciproc", "same recording by method full", "another speed", "imported"),
    ),
    "static": (
        {"inverter"},
        {"Standard error of R"},
        {"Inverter drop", "ψ_PM", "L_d at zero current"},
        ("averaged over operating points", "simulates no current", "rotor angle at some kilohertz"),
        ("same recording", "diagnostics.npz", "transients alone", "Methods psm and joint", "imported"),
    ),
    "imported": (
        set(),
        set(),
        {"Points read"},
        ("Imported map", "were imported", "no recording to compare", "no curve of an inverter", "--pole-pairs"),
        ("identified with", "experiment", "another tool", "method", "psm", "Gaps",
         "Unknowns", "± standard error", "leave open", "diagnostics.npz"),
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def results(bag, tmp_path_factory):
    """A stored and loaded result of each origin."""
    folder = tmp_path_factory.mktemp("origins")
    rng = np.random.default_rng(3)
    currents = disc_points(rng, 100.0, 30)
    points = telemetry(LinearDrive(), currents, np.full(len(currents), 300.0), rng=rng)
    found = {name: fit_bags(Sources([bag]), None, FitSettings(method=name)) for name in ("psm", "joint", "full")}
    held = simulate("ipm", 3.0, speed=0.0, noise=1e-3, seed=1)
    found["locked"] = drive_id.fit(held, settings=FitSettings(method="locked"))
    found["static"] = drive_id.fit(points)
    axis = np.linspace(-90.0, 90.0, 7)
    psi_d, psi_q = LinearDrive().flux(*np.meshgrid(axis, axis, indexing="ij"), 0.0)
    np.savez(folder / "map.npz", id=axis, iq=axis, psi_d=psi_d, psi_q=psi_q)
    found["imported"] = import_map(Source(folder / "map.npz"))
    for name, result in found.items():
        assert (result.diagnostics is not None) == ORIGINS[name].diagnostics  # what is asked for is stored as well
        result.save(folder / name, draw=False)
    return {name: drive_id.load(folder / name) for name in found}


def words(content: Content, result: drive_id.Identification) -> str:
    """Return all that the report, a table of the console and Python say of a result, but for its settings."""
    tables = (content.values, content.methods, content.calibrations, content.operation, content.inputs)
    said = [content.title, content.subtitle, content.comparison, content.paragraph, *content.warnings]
    said += [f"{f.name} {f.value} {f.meaning}" for f in content.figures]
    said += [f"{quantity.name} {quantity} {quantity.note}" for quantity in content.headline]
    said += [f"{heading} {' '.join(found)}" for heading, found in content.knowledge.items() if found]
    said += [cell for table in tables if table.rows for row in (table.header, *table.rows) for cell in row]
    return " ".join([*said, *content.missing.values(), repr(result), result._repr_html_()])


@pytest.mark.slow  # a report is drawn for each origin
@pytest.mark.parametrize("name", TABLE)
def test_a_report_has_what_its_origin_has_and_says_what_is_true_of_it(results, name):
    sections, figures, rows, wanted, unwanted = TABLE[name]
    result = results[name]
    content = content_of(result, torque_map(result))
    assert {section for section in SECTIONS if section not in content.missing} == sections
    names = {figure.name for figure in content.figures}
    assert (
        names - {"Warnings", "Disc covered", "Standard error of the flux"} - {"Error against the simulation's truth"}
        == figures
    )
    assert ("Inverter drop" in {quantity.name for quantity in content.headline}) == ORIGINS[name].inverter
    assert ("Standard error of the flux" in names) == ORIGINS[name].fitted
    shown = {str(cell) for cell in fit_table(result, verbose=True).columns[0]._cells}
    assert rows <= shown
    assert not ({"Gaps", "Unknowns determined"} & shown) or ORIGINS[name].live
    said = words(content, result)
    for phrase in wanted:
        assert phrase in said, phrase
    for phrase in unwanted:
        assert phrase not in said, phrase
    assert "nan" not in said.lower().replace("nano", "").split()
    assert bool(content.settings.rows) == ORIGINS[name].fitted


def test_the_table_is_that_of_all_origins(results):
    assert set(TABLE) == set(ORIGINS)
    assert tuple(FitSettings.__dataclass_fields__["method"].metadata["choices"]) == METHODS
    for name, result in results.items():
        origin = result.origin
        assert origin is origin_named(name)
        assert origin.name == name == result.method
        assert bool(origin.no_inverter) != origin.inverter
        assert bool(origin.no_diagnostics) != origin.diagnostics
        assert (result.diagnostics is not None) == origin.diagnostics
        assert np.isfinite(result.sigma_resistance) == origin.fitted
        assert np.any(result.inverter_curve.voltage) == origin.inverter
        assert not result.harmonics or origin.harmonics


@pytest.mark.parametrize("name", ORIGINS)
def test_only_live_methods_sum_over_samples(name):
    if ORIGINS[name].live:
        evidence = Evidence.within(FitSettings(name), 100.0)
        assert (evidence.windows is not None) == ORIGINS[name].windows == (name in ("full", "locked"))
        return
    with pytest.raises(ConfigurationError, match="not accumulated or live samples"):
        check_live(name)


def test_an_unknown_origin_is_refused(results, tmp_path):
    with pytest.raises(ConfigurationError, match="'guess' is no origin of a result: it must be one of psm, joint"):
        origin_named("guess")
    result = results["joint"]
    result.save(tmp_path / "result", draw=False)
    marker = tmp_path / "result" / MARKER
    marker.write_text(json.dumps(json.loads(marker.read_text()) | {"method": "joint (provisional)"}))
    with pytest.raises(ResultError, match="damaged"):
        drive_id.load(tmp_path / "result")


@pytest.mark.parametrize(
    ("method", "changed", "sentence"),
    [
        ("psm", {"maps": "free"}, "Method psm ignores maps: remove it, or use method full."),
        ("joint", {"rows_are_points": True}, "Method joint ignores rows_are_points: remove it, or use method static."),
        ("full", {"splines_d": 9}, "Method full ignores splines_d: remove it, or use method psm or joint."),
        ("static", {"splines_d": 9, "maps": "free"}, "Method static ignores maps, splines_d: remove them."),
        (
            "static",
            {"monotone": True},
            "Method static ignores monotone: remove it, or use method psm, joint, full or locked.",
        ),
    ],
)
def test_a_setting_without_effect_is_named_with_the_methods_that_use_it(results, method, changed, sentence):
    settings = FitSettings(method=method, **changed)
    known = completed(results[method].drive, settings, excerpts=(), duration=1.0, last_stamp=0).provenance
    assert known.warnings == (sentence,)
