"""Results and samples as pandas, xarray and notebooks see them, against their own arrays."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import drive_id

FEW = {"current_points": 5, "torque_points": 2, "speed_points": 5}
"""Of an analysis, which is faster by far with few of them."""


@pytest.fixture(scope="module")
def samples():
    return drive_id.simulate("ipm", 2.0, noise=1e-3)


@pytest.fixture(scope="module")
def result(samples):
    return drive_id.fit(samples, method="joint")


def test_a_dataset_holds_the_map_with_units(result):
    found = result.to_xarray()
    inside = found["psi_d"].notnull().values
    np.testing.assert_array_equal(inside, result.flux_map.inside)
    k, n = np.argwhere(inside)[len(np.argwhere(inside)) // 2]
    at = float(found["i_d"][k]), float(found["i_q"][n])
    assert (found["psi_q"].units, found["L_dq"].units, found["i_d"].units) == ("Wb", "H", "A")
    assert float(found["psi_q"].sel(i_d=at[0], i_q=at[1])) == pytest.approx(float(result.flux_map.psi_dq(*at)[1]))
    assert float(found["L_dq"].sel(i_d=at[0], i_q=at[1])) == pytest.approx(result.flux_map.inductances(*at)[0, 1])
    table = result.to_pandas()
    assert len(table) == inside.sum()
    assert table["psi_d"].notna().all()


def test_a_frame_holds_the_samples(samples):
    frame = drive_id.samples_frame(samples.part(100, 300))
    np.testing.assert_array_equal(frame["u_c"], samples.u_abc[100:300, 2])
    assert frame.index[-1] == pytest.approx(199 * samples.sample_period)
    assert frame["run"].unique().tolist() == [0]


def test_a_result_is_drawn_on_given_axes(result):
    figure, panels = plt.subplots(1, 2)
    assert result.plot(panels) is figure
    assert all(panel.collections for panel in panels)
    plt.close(figure)
    with pytest.raises(drive_id.DriveIdError, match="pair of axes"):
        result.plot(panels[:1])


@pytest.mark.slow  # analyses are drawn
def test_an_analysis_is_a_table_and_a_picture(samples):
    """Of a map that does not fold: of one that does, each analysis would look for the nearest that does not."""
    result = drive_id.fit(samples, settings=drive_id.FitSettings(harmonic_orders=(6, 12), search_orders=False))
    found = drive_id.analyze(result, drive_id.AnalysisSettings(u_dc=(300.0, 400.0), **FEW))
    assert found.to_pandas().loc["max_torque", "value"] == found.figures["max_torque"].value
    figure, axes = plt.subplots()
    assert found.plot(axes) is figure
    assert axes.get_legend_handles_labels()[1] == ["300 V", "400 V"]
    plt.close(figure)
    assert "<th>max torque</th>" in found._repr_html_()
    assert found._repr_png_().startswith(b"\x89PNG")
    without = drive_id.analyze(
        replace(result, provenance=replace(result.provenance, u_dc=None)), drive_id.AnalysisSettings(**FEW)
    )
    assert without._repr_png_() is None


def test_a_notebook_gets_the_picture_of_a_result(result):
    image = plt.imread(io.BytesIO(result._repr_png_()))
    assert image.shape[:2] == (375, 720)
    assert image[..., :3].std() > 0.1


def test_samples_and_maps_show_their_ranges(samples, result):
    least, largest = re.search(r"<th>u_abc, V</th><td>(.*?)</td><td>(.*?)</td>", samples._repr_html_()).groups()
    assert float(least) == pytest.approx(samples.u_abc.min(), rel=1e-4)
    assert float(largest) == pytest.approx(samples.u_abc.max(), rel=1e-4)
    assert f"{result.flux_map.psi_q[result.flux_map.inside].max():.5g}" in result.flux_map._repr_html_()


def test_progress_is_shown_on_a_bar(samples):
    shown = []
    bar = SimpleNamespace(n=0.0, total=None, set_description=shown.append, refresh=lambda: None)
    drive_id.fit(samples, method="psm", tell=drive_id.on_bar(bar))
    assert "Accumulating" in shown
    assert "Solving" in shown
    assert bar.total == 1.0


@pytest.mark.slow  # reports are drawn
@pytest.mark.usefixtures("plain_reports")
def test_a_report_takes_what_a_folder_lacks(result, tmp_path):
    replace(result, provenance=replace(result.provenance, u_dc=None)).save(tmp_path / "folder")
    for name, known in (("without", {}), ("with", {"u_dc": 321.0})):
        (path,) = drive_id.report(tmp_path / "folder", tmp_path / f"{name}.html", **known)
        assert ("321 V" in path.read_text(encoding="utf-8")) == bool(known)
    from drive_id.reporting import tables

    assert tables
    assert callable(drive_id.report)  # no room of the package has its name


def test_wrong_types_are_told_in_a_sentence(samples, result):
    for currents in ("1 A", 1j, [[1.0], [2.0, 3.0]]):
        with pytest.raises(drive_id.DriveIdError, match="i_d and i_q are not real currents"):
            result.flux_map.psi_dq(currents, 0.0)
    with pytest.raises(drive_id.DriveIdError, match=r"settings is of type dict: give drive_id.FitSettings"):
        drive_id.fit(samples, settings={"method": "joint"})
    with pytest.raises(drive_id.DriveIdError, match="speed holds values of type complex128: pass real numbers"):
        drive_id.Samples(samples.stamp, samples.i_abc, samples.u_abc, samples.angle, samples.speed * 1j, 1e-4)
    with pytest.raises(drive_id.DriveIdError, match="must be a positive number of seconds"):
        replace(samples, sample_period="1e-4")
    with pytest.raises(drive_id.DriveIdError, match=r"stamp has shape \(\): give a stamp for each sample"):
        replace(samples, stamp=5)
    with pytest.raises(drive_id.DriveIdError, match=r"angle has shape \(\) where"):
        replace(samples, angle=5)
    with pytest.raises(drive_id.DriveIdError, match=r"speed has shape \(\): give a speed for each sample"):
        drive_id.OperatingData(np.zeros((3, 2)), np.zeros((3, 2)), 300.0)
    lists = [values[:50].tolist() for values in (samples.stamp, samples.i_abc, samples.u_abc, samples.angle)]
    assert len(drive_id.Samples(*lists, [52.0] * 50, 1e-4, [0])) == 50


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda _: drive_id.plan(None), r"settings is of type NoneType: give drive_id\.PlanSettings"),
        (lambda r: drive_id.analyze(r, 5), r"settings is of type int: give drive_id\.AnalysisSettings"),
        (lambda _: drive_id.simulate(settings=5), r"settings is of type int: give drive_id\.SimulationSettings"),
        (lambda _: drive_id.simulate(5), "machine is of type int: give a str or Path"),
        (drive_id.samples_frame, "samples is of type Identification: give drive_id.Samples"),
        (lambda _: drive_id.read_bag(5), "bag is of type int: give a str or Path"),
        (lambda _: drive_id.read_bag([None]), "bag is of type NoneType: give a str or Path"),
        (lambda _: drive_id.import_map(None), "source is of type NoneType: give a str or Path"),
        (lambda r: drive_id.export(r, "csv", 5), "path is of type int: give a str or Path"),
        (lambda r: drive_id.report(r, None), "path is of type NoneType: give a str or Path"),
        (lambda r: r.save(5), "directory is of type int: give a str or Path"),
    ],
)
def test_arguments_of_another_kind_are_told_in_a_sentence(call, said, result):
    with pytest.raises(drive_id.DriveIdError, match=said):
        call(result)
