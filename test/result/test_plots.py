"""Pictures: data where there are data, round numbers at the levels, and no warning whatever the map."""

from __future__ import annotations

import shutil
import struct
import time
from dataclasses import replace
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import paper_figures
import pytest
from matplotlib.backends.backend_pgf import LatexManager
from matplotlib.image import imread
from matplotlib.text import Text

from drive_id.common.messages import Message
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.maps.flux_map import HarmonicMap
from drive_id.errors import ConfigurationError
from drive_id.result.pictures.caption import Caption
from drive_id.result.pictures.diagnostics import draw_diagnostics
from drive_id.result.pictures.panels import Disc, levels
from drive_id.result.pictures.picture import rendered
from drive_id.result.pictures.plots import draw_flux_maps, result_pictures, trajectory

NAMES = ["diagnostics.png", "flux_map.png"]


@pytest.fixture(scope="module")
def excerpts(fitted):
    return fitted.excerpts


@pytest.fixture(scope="module")
def drive(fitted):
    return fitted.drive


@pytest.fixture(scope="module")
def maps(fitted):
    return fitted.plot()


@pytest.fixture(scope="module")
def diagnostics(drive, excerpts):
    return draw_diagnostics(drive, excerpts)


@pytest.fixture(scope="module")
def overview(drive, excerpts, simulation):
    return paper_figures.draw_result(drive, excerpts, simulation.truth)


def size(png: bytes) -> tuple[int, int]:
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", png[16:24])


def texts(figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def panel(figure, title: str):
    return next(axes for axes in figure.axes if title in axes.get_title())


def half(flux_map):
    """Return the map with data at positive i_q only."""
    return replace(flux_map, inside=flux_map.inside & (flux_map.i_q > 0))


@pytest.mark.cases
@pytest.mark.parametrize("dpi", [140, 200])  # letters of whole pixels are widest, relative to the page, at 140
@pytest.mark.parametrize("which", ["maps", "diagnostics"])
def test_the_picture_has_content_and_nothing_is_cut_off(which, dpi, request, tmp_path):
    png = rendered(request.getfixturevalue(which), dpi=dpi)
    assert size(png)[0] == 7.2 * dpi
    (tmp_path / "picture.png").write_bytes(png)
    pixels = imread(tmp_path / "picture.png")[..., :3]
    assert len(np.unique((pixels * 255).astype(int) @ [1, 256, 65536])) > 500
    edge = np.concatenate([pixels[:2].ravel(), pixels[-2:].ravel(), pixels[:, :2].ravel(), pixels[:, -2:].ravel()])
    assert (edge == 1.0).all()


def shown_texts(figure):
    """Yield everything written, without the tick labels beyond the ends of their axes."""
    yield from figure.texts
    for legend in figure.legends:
        yield from legend.get_texts()
    for axes in [*figure.axes, *(bar for outer in figure.axes for bar in outer.child_axes)]:
        yield from (axes.title, axes.xaxis.label, axes.yaxis.label, *axes.texts)
        yield from axes.get_legend().get_texts() if axes.get_legend() else ()
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks():
                if low <= tick.get_loc() <= high:
                    yield from (label for label in (tick.label1, tick.label2) if label.get_visible())


@pytest.mark.parametrize("dpi", [100, 140])
@pytest.mark.parametrize("which", ["maps", "diagnostics", "overview"])
def test_no_text_stands_on_other_text(which, dpi, request):
    figure = request.getfixturevalue(which)
    figure.set_dpi(dpi)
    rendered(figure, dpi=dpi)
    renderer = figure.canvas.get_renderer()
    boxes = [
        (text.get_text(), text.get_window_extent(renderer).shrunk(0.9, 0.8))
        for text in shown_texts(figure)
        if text.get_text().strip()
    ]
    assert len(boxes) > 40
    for number, (text, box) in enumerate(boxes):
        for other, beside in boxes[:number]:
            assert not box.overlaps(beside), (text, other)


def test_the_colour_bars_are_as_tall_as_the_axes(maps):
    rendered(maps)
    panels = [axes for axes in maps.axes if axes.get_xlabel()]
    assert len(panels) == 2
    for axes in panels:
        (bar,) = axes.child_axes
        outer, inner = axes.get_position(), bar.get_position()
        assert inner.y0 == pytest.approx(outer.y0, abs=1e-3)
        assert inner.y1 == pytest.approx(outer.y1, abs=1e-3)
        assert inner.x0 > outer.x1


def test_both_axes_have_the_same_scale(maps, drive):
    for axes in maps.axes:
        assert axes.get_aspect() == 1.0
        assert axes.get_xlim() == axes.get_ylim()
        assert drive.i_max < axes.get_xlim()[1] < 1.1 * drive.i_max


def test_the_ticks_of_the_colour_bars_are_round(maps):
    rendered(maps)
    for axes in maps.axes:
        for bar in axes.child_axes:
            labels = [label.get_text().replace("−", "-") for label in bar.get_yticklabels()]
            shown = [text for text in labels if text]
            assert 4 <= len(shown) <= 12
            assert max(len(text) for text in shown) <= 6


def test_level_lines_are_labelled_where_their_flux_is(maps, drive):
    flux_map = drive.flux_map
    for axes, psi in zip(maps.axes, (flux_map.psi_d, flux_map.psi_q), strict=True):
        labels = [text for text in axes.texts if text.get_text() != "no data"]
        assert len(labels) >= 4
        for label in labels:
            i_d, i_q = label.get_position()
            assert np.hypot(i_d, i_q) < drive.i_max
            at_d = [np.interp(i_d, flux_map.i_d, column) for column in psi.T]
            assert float(label.get_text().replace("−", "-")) == pytest.approx(
                1e3 * np.interp(i_q, flux_map.i_q, at_d), abs=0.3
            )


@pytest.mark.parametrize(("low", "high"), [(0.0113, 0.0981), (-0.0712, 0.0689), (-3e-7, 2e-7), (1e3, 1.7e5)])
@pytest.mark.parametrize("count", [10, 20])
def test_levels_enclose_the_range_in_round_steps(low, high, count):
    found = levels(low, high, count)
    assert found[0] <= low
    assert found[-1] >= high
    assert 2 <= len(found) <= count + 3
    step = np.diff(found)
    np.testing.assert_allclose(step, step[0], rtol=1e-6)
    assert round(step[0] / 10 ** np.floor(np.log10(step[0] * 1.000001)), 6) in (1, 2, 5)


def test_levels_of_no_range_at_all():
    found = levels(0.5, 0.5, 10)
    assert found[0] <= 0.5 <= found[-1]
    assert np.all(np.diff(found) > 0)


def test_only_what_the_data_support_is_drawn(drive):
    flux_map = drive.flux_map
    corner = replace(flux_map, psi_d=np.where(flux_map.inside, flux_map.psi_d, 1e6))
    figure = draw_flux_maps(corner, drive.i_max)
    rendered(figure)
    assert max(bar.get_ylim()[1] for axes in figure.axes for bar in axes.child_axes) < 1e3  # mWb


def test_areas_without_data_are_hatched_and_labelled(drive):
    disc = Disc(half(drive.flux_map), drive.i_max)
    lower = disc.blank[:, disc.axis < -0.1 * drive.i_max]
    assert lower[disc.radius[:, disc.axis < -0.1 * drive.i_max] < drive.i_max].all()
    assert disc.blank[:, disc.axis > 0.1 * drive.i_max].mean() < 0.05
    assert not disc.blank[disc.radius > drive.i_max].any()
    figure = draw_flux_maps(half(drive.flux_map), drive.i_max)
    for axes in figure.axes:
        (label,) = [text for text in axes.texts if text.get_text() == "no data"]
        assert label.get_position()[1] < 0
    assert "no data" not in texts(draw_flux_maps(full_map(drive.flux_map), drive.i_max))


def test_what_samples_only_enclose_is_drawn_pale(drive):
    """With its level lines, where it was hatched: the result tells values and errors there."""
    whole = full_map(drive.flux_map)
    inside = np.hypot(whole.i_d[:, None], whole.i_q) > 0.4 * drive.i_max
    holed = replace(whole, inside=inside)
    assert "no data" in texts(draw_flux_maps(holed, drive.i_max))
    enclosed = replace(holed, enclosed=~inside)
    disc = Disc(enclosed, drive.i_max)
    assert not disc.blank.any()
    assert (disc.pale[disc.radius < 0.3 * drive.i_max] < 0.5).all()
    assert (disc.pale[(disc.radius > 0.5 * drive.i_max) & (disc.radius < drive.i_max)] >= 0.5).all()
    figure = draw_flux_maps(enclosed, drive.i_max)
    assert "no data" not in texts(figure)
    assert any("paler" in text.get_text() for text in figure.legends[0].get_texts())


def full_map(flux_map):
    return replace(flux_map, inside=np.ones_like(flux_map.inside))


def test_the_trajectory_is_drawn_sample_by_sample_and_breaks_at_gaps(drive, excerpts):
    (samples,) = excerpts
    gapped = replace(samples, run_starts=np.array([0, 1000, 5000]))
    i_dq = trajectory([gapped, gapped.part(0, 10)])
    assert len(i_dq) == len(samples) + 3 + 11
    assert np.flatnonzero(np.isnan(i_dq[:, 0])).tolist() == [1000, 5001, len(samples) + 2, len(samples) + 13]
    figure = draw_flux_maps(drive.flux_map, drive.i_max, i_dq)
    for axes in figure.axes:
        longest = max(axes.lines, key=lambda line: len(line.get_xdata()))
        np.testing.assert_array_equal(longest.get_xdata(), i_dq[:, 0])
        assert longest.get_rasterized()
    assert trajectory([]) is None


def test_the_caption_says_what_is_known(fitted):
    drive = replace(fitted.drive, method="full", resistance=0.0100012, sigma_resistance=1.4e-5, i_max=300.0)
    known = replace(fitted.provenance, date="2023-11-14T22:13:20+00:00", pole_pairs=None)
    result = replace(fitted, drive=drive, provenance=known)
    caption = result.caption()
    assert caption.text().splitlines() == [
        "ipm  ·  method full  ·  2023-11-14 22:13 UTC",
        r"$R$ = 10.001 ± 0.014 mΩ  ·  speed 209.4 rad/s electrical  ·  $i_\mathrm{max}$ = 300 A",
    ]
    assert "speed 500 rpm" in replace(caption, pole_pairs=4).text()
    assert "speed -100 to 209.4 rad/s" in replace(caption, speeds=(-100.0, 209.44)).text()
    unknown = replace(caption, machine="", date="", speeds=None, sigma_resistance=float("inf"))
    assert unknown.text() == "method full\n" r"$R$ = 10 mΩ  ·  $i_\mathrm{max}$ = 300 A"
    assert Caption().text() == ""
    assert str(caption) == "ipm, method full, 2023-11-14, R = 10 mΩ, 209.4 rad/s electrical, i_max = 300 A"
    assert "500 rpm" in str(replace(caption, pole_pairs=4))
    nothing = replace(result, provenance=replace(known, machine="", date="", speed_range=None)).caption()
    assert (nothing.machine, nothing.date, nothing.speeds) == ("", "", None)
    assert str(nothing) == "method full, R = 10 mΩ, i_max = 300 A"


def test_a_name_of_any_characters_is_printed(drive):
    for name in ("50 $ motor", "$\\frac{", "電動機 \N{PILE OF POO}\n\x00", "x" * 300):
        assert size(rendered(draw_flux_maps(drive.flux_map, drive.i_max, None, Caption(name))))


@pytest.mark.cases
@pytest.mark.parametrize("figure_format", ["png", "svg", "pdf"])
def test_formats(drive, excerpts, figure_format):
    pictures = result_pictures(drive, excerpts, Caption("ipm"), figure_format=figure_format)
    assert sorted(pictures) == [f"diagnostics.{figure_format}", f"flux_map.{figure_format}"]
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[figure_format]
    for content in pictures.values():
        assert content.startswith(start)
        assert len(content) < 3e6  # the trajectory is not drawn as 20000 vectors


def test_a_column_of_a_journal_is_serif_with_fonts_that_journals_take(drive, excerpts):
    pictures = result_pictures(drive, excerpts, Caption("ipm"), figure_format="pdf", style="ieee")
    for content in pictures.values():
        assert b"/MediaBox [ 0 0 252 " in content  # points: 3.5 in
        assert b"STIXGeneral" in content
        assert b"/Subtype /Type3" not in content
    with pytest.raises(ConfigurationError, match="style is 'acm': it must be one of screen, ieee"):
        result_pictures(drive, excerpts, style="acm")


def test_a_figure_shows_itself_in_a_notebook_and_saves_fonts_that_journals_take(fitted, tmp_path):
    figure = fitted.plot()
    assert figure._repr_png_().startswith(b"\x89PNG")
    figure.savefig(tmp_path / "map.pdf")
    assert b"/Subtype /Type3" not in (tmp_path / "map.pdf").read_bytes()


def test_pgf_is_refused_without_tex_and_written_with_it(drive, excerpts, monkeypatch):
    """TeX is replaced here by a measure of its own: what it measures is not the point."""
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(ConfigurationError, match="install xelatex or lualatex"):
        result_pictures(drive, excerpts, figure_format="pgf")
    monkeypatch.setattr(shutil, "which", lambda name: name)
    measure = SimpleNamespace(get_width_height_descent=lambda text, _: (5.0 * len(text), 8.0, 2.0))
    monkeypatch.setattr(LatexManager, "_get_cached_or_new", lambda: measure)
    for content in result_pictures(drive, excerpts, figure_format="pgf").values():
        assert content.startswith(b"%% Creator: Matplotlib, PGF backend")
        assert b"includegraphics" not in content


@pytest.mark.slow  # it is timed again where the machine is busy
def test_both_pictures_take_less_than_a_second_and_a_half(drive, excerpts):
    taken = []
    for _ in range(3):  # the first one loads fonts
        begin = time.thread_time()
        result_pictures(drive, excerpts)
        taken.append(time.thread_time() - begin)
    assert min(taken) < 1.5


def tiny(flux_map):
    inside = np.zeros_like(flux_map.inside)
    inside[30:32, 40] = True
    return replace(flux_map, inside=inside)


def degenerate(drive):
    """Yield results of which each is odd in several ways that do not hide each other."""
    flux_map = drive.flux_map
    nan, zero, few = np.full_like(flux_map.psi_d, np.nan), np.zeros_like(flux_map.psi_d), np.linspace(-300.0, 300.0, 4)
    square, none = np.ones((4, 4)), 0 * drive.inverter_voltage
    many = 10.0 ** np.linspace(-9, 3, nan.size).reshape(nan.shape)
    wild = np.where(flux_map.inside, flux_map.psi_d, 1e100)
    coarse = replace(
        flux_map, i_d=few, i_q=few, psi_d=few[:, None] * square, psi_q=few * square, sigma_d=square, sigma_q=square,
        inside=square > 0,
    )  # fmt: skip
    for changes in (
        {"psi_d": zero + 0.05, "psi_q": zero, "sigma_d": nan, "sigma_q": nan},
        {"psi_d": 0.05 + 1e-12 * flux_map.psi_d, "sigma_d": zero + np.inf, "sigma_q": zero + np.inf},
        {"psi_d": 1e6 * flux_map.psi_d, "psi_q": 1e6 * flux_map.psi_q, "sigma_d": zero, "sigma_q": zero},
        {"psi_d": wild, "sigma_d": zero + 1e-3, "sigma_q": zero + 1e-3},
        {"i_d": flux_map.i_d - 350.0, "i_q": flux_map.i_q + 350.0, "sigma_d": many},
        {"i_d": flux_map.i_d + 1e4},
        {"inside": zero > 0},
    ):
        yield replace(drive, flux_map=replace(flux_map, **changes))
    yield replace(drive, flux_map=tiny(flux_map), method="psm", inverter_voltage=none, voltage_error=0.0)
    yield replace(drive, flux_map=coarse, inverter_voltage=none, voltage_error=0.0, error_modes=None)
    yield replace(drive, i_max=1e-3, sigma_voltage_error=float("inf"), sigma_resistance=float("nan"))
    yield replace(drive, i_max=1e5)


@pytest.mark.slow  # all pictures of several results
@pytest.mark.parametrize("part", [0, 1])  # for two processes
def test_degenerate_results_are_drawn_without_a_warning(drive, excerpts, part):
    for found in list(degenerate(drive))[part::2]:
        pictures = result_pictures(found, [excerpts[0].part(0, 50)])
        assert sorted(pictures) == NAMES
        assert all(size(picture)[0] == 1440 for picture in pictures.values())


def test_the_settings_of_matplotlib_stay_as_they_are(drive):
    before = dict(mpl.rcParams)
    result_pictures(drive, [])
    assert dict(mpl.rcParams) == before


def test_the_inverter_curve_has_its_band(drive):
    sigma = np.linspace(0.0, 0.1, len(drive.inverter_current))
    figure = draw_diagnostics(replace(drive, sigma_inverter_voltage=sigma), [])
    axes = panel(figure, "Inverter")
    (band,) = axes.collections
    top = band.get_datalim(axes.transData).y1
    assert top == pytest.approx(drive.inverter_voltage[-1] + 0.196)
    assert "±1.96 σ ≤ 0.2 V" in texts(figure)
    three = np.stack([drive.inverter_voltage * factor for factor in (0.9, 1.0, 1.1)], axis=1)
    assert {"phase a", "phase b", "phase c"} <= set(texts(draw_diagnostics(replace(drive, phase_voltages=three), [])))
    for method, why in (("psm", "Method psm does not model the inverter"), ("imported", "The map was imported")):
        found = texts(draw_diagnostics(replace(drive, method=method), []))
        assert any(why in " ".join(text.split()) for text in found)


def test_sections_along_the_axes_are_those_of_the_map(diagnostics, drive):
    own, cross = panel(diagnostics, "along the axes"), panel(diagnostics, "Cross")
    flux_map = drive.flux_map
    row = np.abs(flux_map.i_q).argmin()
    line = own.lines[0]
    known = np.isfinite(line.get_ydata())
    assert known.mean() > 0.5
    np.testing.assert_array_equal(line.get_xdata(), flux_map.i_d)
    np.testing.assert_allclose(line.get_ydata()[known], 1e3 * flux_map.psi_d[known, row], atol=1.0)
    zero = np.nanargmin(np.where(np.isfinite(cross.lines[0].get_ydata()), np.abs(flux_map.i_q), np.nan))
    assert cross.lines[0].get_ydata()[zero] == 0.0
    lower = draw_diagnostics(replace(drive, flux_map=tiny(flux_map)), [])
    assert texts(lower).count("no data on the axes") == 2


def curves(figure):
    """Return angle (B,), rad, mean and rms of the residual, (B, 2) each, V."""
    lines = panel(figure, "Residual").lines
    mean_d, rms_d, mean_q, rms_q = (line.get_ydata() for line in lines)
    return np.deg2rad(lines[0].get_xdata()), np.stack([mean_d, mean_q], axis=1), np.stack([rms_d, rms_q], axis=1)


def test_the_residual_shows_the_harmonics_that_joint_lacks(diagnostics, drive, excerpts):
    angle, mean, rms = curves(diagnostics)
    order = np.abs(np.fft.rfft(mean[:, 0]))
    assert order[1:].argmax() + 1 == 6
    assert np.all(rms >= np.abs(mean))
    amplitude = 1e-3
    wave = HarmonicMap(6, *(np.full_like(drive.flux_map.psi_d, value) for value in (amplitude, 0.0, 0.0, 0.0)))
    _, other, _ = curves(
        draw_diagnostics(replace(drive, flux_map=replace(drive.flux_map, harmonics=(wave,))), excerpts)
    )
    speed = excerpts[0].speed.mean()
    np.testing.assert_allclose((mean - other)[:, 0], -6 * speed * amplitude * np.sin(6 * angle), atol=0.03)
    np.testing.assert_allclose((mean - other)[:, 1], speed * amplitude * np.cos(6 * angle), atol=0.03)


def test_the_residual_is_that_of_corrected_signals(drive, excerpts, diagnostics):
    offset = Calibration("voltage_offset_alpha", 2.0, 0.1, "V", True, Message.told(""))
    angle, mean, _ = curves(draw_diagnostics(replace(drive, calibrations=(offset,)), excerpts))
    np.testing.assert_allclose((curves(diagnostics)[1] - mean)[:, 0], 2 * np.cos(angle), atol=0.02)


def test_the_result_in_one_figure(overview):
    assert size(rendered(overview, dpi=140))[0] == 1456
    assert len([axes for axes in overview.axes if axes.get_xlabel()]) == 3
    assert "true" in texts(overview)


def test_unused_memory_in_surfaces_is_no_reason_to_warn(drive, simulation, monkeypatch):
    """Matplotlib pads faces of fewer corners with whatever the memory held before."""
    empty = np.empty

    def dirty(shape, *args, **options):
        array = empty(shape, *args, **options)
        if array.dtype == np.float64:
            array.fill(1.7e308)
        return array

    monkeypatch.setattr(np, "empty", dirty)
    figure = paper_figures.draw_comparison(drive, drive, simulation.truth, "d")
    assert size(rendered(figure, dpi=120)) == (1320, 1080)


@pytest.mark.cases
@pytest.mark.parametrize("component", ["d", "q"])
def test_the_comparison(drive, simulation, component):
    worse = replace(drive.flux_map, psi_d=1.1 * drive.flux_map.psi_d)
    psm = replace(drive, flux_map=worse)
    figure = paper_figures.draw_comparison(drive, psm, simulation.truth, component)
    assert size(rendered(figure, dpi=120)) == (1320, 1080)
    flat = [axes for axes in figure.axes if axes.child_axes]
    assert len(flat) == 2
    limits = {axes.collections[0].get_clim() for axes in flat}
    assert len(limits) == 1  # both errors in one scale
    (low, high), = limits  # fmt: skip
    assert low == -high
    largest = [np.nanmax(np.abs(axes.collections[0].get_array())) for axes in flat]
    assert high == pytest.approx(max(largest))
    if component == "d":
        assert largest[1] > 3 * largest[0]
