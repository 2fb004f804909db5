"""Pictures: data where there are data, round numbers at the colour bars, and no warning whatever the map."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from drive_id.core import frames
from drive_id.report.plots import _levels, draw_comparison, draw_flux_maps, to_png


@pytest.fixture(scope="module")
def maps(fitted):
    (samples,) = fitted.recording.validation
    return draw_flux_maps(
        fitted.identification.flux_map,
        fitted.identification.i_max,
        frames.to_dq(samples.i_abc, samples.angle),
        "a title",
    )


def size(png: bytes) -> tuple[int, int]:
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", png[16:24])


def test_the_picture_has_content(maps, tmp_path):
    png = to_png(maps)
    assert size(png) == (1320, 600)
    (tmp_path / "maps.png").write_bytes(png)
    pixels = imread(tmp_path / "maps.png")[..., :3]
    assert len(np.unique((pixels * 255).astype(int).reshape(-1, 3), axis=0)) > 500
    edge = np.concatenate([pixels[:2].ravel(), pixels[-2:].ravel(), pixels[:, :2].ravel(), pixels[:, -2:].ravel()])
    assert (edge == 1.0).all()  # nothing is cut off


def test_the_colour_bars_are_as_tall_as_the_axes(maps):
    to_png(maps)
    panels = [axes for axes in maps.axes if axes.get_xlabel()]
    assert len(panels) == 2
    for axes in panels:
        (bar,) = axes.child_axes
        outer, inner = axes.get_position(), bar.get_position()
        assert inner.y0 == pytest.approx(outer.y0, abs=1e-3)
        assert inner.y1 == pytest.approx(outer.y1, abs=1e-3)
        assert inner.x0 > outer.x1


def test_the_ticks_of_the_colour_bars_are_round(maps):
    to_png(maps)
    for axes in maps.axes:
        for bar in axes.child_axes:
            labels = [label.get_text().replace("−", "-") for label in bar.get_yticklabels()]
            shown = [text for text in labels if text]
            assert 4 <= len(shown) <= 12
            assert max(len(text) for text in shown) <= 6


@pytest.mark.parametrize(("low", "high"), [(0.0113, 0.0981), (-0.0712, 0.0689), (-3e-7, 2e-7), (1e3, 1.7e5)])
@pytest.mark.parametrize("count", [10, 20])
def test_levels_enclose_the_range_in_round_steps(low, high, count):
    levels = _levels(low, high, count)
    assert levels[0] <= low
    assert levels[-1] >= high
    assert 2 <= len(levels) <= count + 3
    step = np.diff(levels)
    np.testing.assert_allclose(step, step[0], rtol=1e-6)
    assert round(step[0] / 10 ** np.floor(np.log10(step[0] * 1.000001)), 6) in (1, 2, 5)


def test_levels_of_no_range_at_all():
    levels = _levels(0.5, 0.5, 10)
    assert levels[0] <= 0.5 <= levels[-1]
    assert np.all(np.diff(levels) > 0)


def test_a_map_without_any_slope_is_drawn_without_a_warning(fitted):
    flux_map = fitted.identification.flux_map
    flat = replace(flux_map, psi_d=np.full_like(flux_map.psi_d, 0.05), psi_q=np.zeros_like(flux_map.psi_q))
    assert size(to_png(draw_flux_maps(flat, fitted.identification.i_max)))


def test_only_what_the_data_support_is_drawn(fitted):
    flux_map = fitted.identification.flux_map
    corner = replace(flux_map, psi_d=np.where(flux_map.inside, flux_map.psi_d, 1e6))
    figure = draw_flux_maps(corner, fitted.identification.i_max)
    to_png(figure)
    assert max(bar.get_ylim()[1] for axes in figure.axes for bar in axes.child_axes) < 1.0


def test_unused_memory_in_surfaces_is_no_reason_to_warn(fitted, simulation, monkeypatch):
    """Matplotlib pads faces of fewer corners with whatever the memory held before."""
    empty = np.empty

    def dirty(shape, *args, **options):
        array = empty(shape, *args, **options)
        if array.dtype == np.float64:
            array.fill(1.7e308)
        return array

    monkeypatch.setattr(np, "empty", dirty)
    figure = draw_comparison(fitted.identification, fitted.identification, simulation.truth, "d")
    assert size(to_png(figure)) == (1320, 1080)


@pytest.mark.parametrize("component", ["d", "q"])
def test_the_comparison(fitted, simulation, component):
    worse = replace(fitted.identification.flux_map, psi_d=1.1 * fitted.identification.flux_map.psi_d)
    psm = replace(fitted.identification, flux_map=worse)
    figure = draw_comparison(fitted.identification, psm, simulation.truth, component)
    assert size(to_png(figure)) == (1320, 1080)
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
