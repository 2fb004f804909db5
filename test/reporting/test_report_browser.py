"""The report in a browser: it opens quickly, every control does something, and the console stays empty."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import check_quiet, element, wait_for

from drive_id.common.messages import Message
from drive_id.reporting.page.report import report_files

pytestmark = pytest.mark.browser

WARNING = "A warning with <b>markup</b> & an ampersand."
STATE = """
const traces = document.getElementById(`chart-${arguments[0]}`).data;
const text = JSON.stringify(traces.map((trace) => [trace.type, trace.name, trace.z ?? trace.y]));
let sum = 0;
for (let k = 0; k < text.length; k += 1) sum = (31 * sum + text.charCodeAt(k)) % 1000003;
return `${traces.length} ${sum}`;
"""
"""Number of traces, and a check sum of what they show."""


@pytest.fixture(scope="module")
def result(full_like):
    provenance = replace(full_like.provenance, warnings=(Message.told(WARNING),), machine="<ipm> & co")
    return replace(full_like, provenance=provenance, stored=full_like.diagnostics)


@pytest.fixture(scope="module")
def path(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_bytes(report_files(result)["report.html"])
    return path


@pytest.fixture
def opened(browser, path):
    """Open the page, once for all tests; after each, nothing may have been complained of or loaded."""
    if browser.current_url != path.as_uri():
        browser.get(path.as_uri())
        wait_for(browser, "return document.documentElement.dataset.drawn === 'true'")
    yield browser
    check_quiet(browser)


def choose(browser, name, value):
    from selenium.webdriver.support.ui import Select

    Select(element(browser, name)).select_by_value(value)


def state(browser, name):
    return browser.execute_script(STATE, name)


def changed(browser, name, before, what):
    """Wait until a chart shows something else, and return its state."""
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 20, poll_frequency=0.05).until(lambda driven: state(driven, name) != before, str(what))
    return state(browser, name)


def test_it_opens_at_once(opened):
    paint = opened.execute_script(
        "return performance.getEntriesByName('first-contentful-paint')[0].startTime + performance.timeOrigin "
        "- performance.timing.navigationStart"
    )
    assert paint < 2000
    assert opened.title == "Identified drive: <ipm> & co"
    assert WARNING in element(opened, "warnings").text
    assert opened.execute_script("return document.querySelectorAll('.js-plotly-plot').length") == 8


def from_above(browser):
    """Show the map as a plane: without a graphics card, the surface takes a second to draw."""
    choose(browser, "map-view", "map")
    wait_for(browser, "return document.getElementById('chart-map').data[0].type !== 'surface'")


def as_surface(browser):
    choose(browser, "map-view", "surface")
    wait_for(browser, "return document.getElementById('chart-map').data[0].type === 'surface'")


def test_every_control_changes_what_it_controls(opened, result):
    from selenium.webdriver.support.ui import Select

    from_above(opened)
    used = {"map-view"}
    for name, chart in (
        ("map-quantity", "map"), ("comparison-method", "comparison"), ("comparison-flux", "comparison"),
        ("residuals-over", "residuals"), ("residuals-statistic", "residuals"), ("currents-show", "currents"),
    ):  # fmt: skip
        used.add(name)
        options = [option.get_attribute("value") for option in Select(element(opened, name)).options]
        assert len(options) >= 2, name
        for value in [*options[1:4], options[0]]:  # each further quantity of the map is drawn alike
            before = state(opened, chart)
            choose(opened, name, value)
            changed(opened, chart, before, (name, value))
    for name in ("map-continuation", "map-trajectory"):
        used.add(name)
        before = state(opened, "map")
        element(opened, name).click()
        after = changed(opened, "map", before, name)
        assert int(after.split()[0]) == int(before.split()[0]) + 2, name  # in both maps
        element(opened, name).click()
        assert changed(opened, "map", after, name) == before
    used.add("map-speeds")
    before = state(opened, "map")
    element(opened, "map-speeds").send_keys(", 700\ue007")
    assert int(changed(opened, "map", before, "speeds").split()[0]) == int(before.split()[0]) + 2
    as_surface(opened)
    used.add("map-turn")
    eye = "return document.getElementById('chart-map').layout.scene.camera.eye.x"
    before = opened.execute_script(eye)
    element(opened, "map-turn").send_keys("\ue014\ue014")  # to the right
    wait_for(opened, f"{eye} !== arguments[0]", before)
    used |= {"probe-d", "probe-q"}
    for name, value in (("probe-d", "-101.5"), ("probe-q", "57")):
        opened.execute_script("arguments[0].value = ''", element(opened, name))
        element(opened, name).send_keys(value)
    said = element(opened, "probe").text
    psi_d = 1e3 * float(result.flux_map.psi_dq(-101.5, 57.0)[0])
    assert said.startswith("ψd = ")
    assert float(said.split("=")[1].split("±")[0]) == pytest.approx(psi_d, rel=1e-3), said
    fields = opened.find_elements("css selector", "select, input")
    assert used == {field.get_attribute("id") for field in fields}


def test_a_click_sets_the_probe_and_marks_it_on_every_plane(opened):
    from selenium.webdriver.common.action_chains import ActionChains

    chart = element(opened, "chart-operation")
    opened.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
    x, y = opened.execute_script(
        "const [{xaxis, yaxis}, box] = [arguments[0]._fullLayout, arguments[0].getBoundingClientRect()];"
        "const [x, y] = [xaxis._offset + xaxis.c2p(-60), yaxis._offset + yaxis.c2p(75)];"
        "return [x - box.width / 2, y - box.height / 2]",
        chart,
    )
    ActionChains(opened).move_to_element_with_offset(chart, x, y).click().perform()
    wait_for(opened, "return document.getElementById('probe-q').value !== '57'")
    probed = [float(element(opened, name).get_attribute("value")) for name in ("probe-d", "probe-q")]
    assert probed == pytest.approx([-60.0, 75.0], abs=8.0)  # the nearest node
    mark = "const [{x, y}] = document.getElementById(arguments[0]).layout.annotations; return [x, y]"
    for name in ("chart-operation", "chart-comparison"):
        assert opened.execute_script(mark, name) == probed


def test_surfaces_are_named_and_seen_whole(opened):
    """The narrower a scene, the farther its camera: labels of the axes were cut at both sides."""
    as_surface(opened)
    names, far, shape = opened.execute_script(
        "const chart = document.getElementById('chart-map'); const { annotations, scene } = chart.layout; "
        "const { x, y } = scene.domain; const { eye } = scene.camera; "
        "return [annotations.map(({ text }) => text), Math.hypot(eye.x, eye.y), "
        "chart.clientHeight * (y[1] - y[0]) / (chart.clientWidth * (x[1] - x[0]))]"
    )
    assert names == ["<b>ψ<sub>d</sub></b>", "<b>ψ<sub>q</sub></b>"]
    assert shape > 1.2, "two beside each other are higher than wide"
    assert far > 1.9 * shape


def test_the_surface_has_its_axes_in_order(opened, result):
    """In plotly's own terms: a row of z is a y."""
    as_surface(opened)
    j, k = 40, 22
    x, y, z = opened.execute_script(
        "const t = document.getElementById('chart-map').data[0]; "
        "return [t.x, t.y, t.z].map((values) => values[arguments[1]][arguments[0]])", j, k,
    )  # fmt: skip
    assert (x, y) == (pytest.approx(result.flux_map.i_d[j], rel=1e-4), pytest.approx(result.flux_map.i_q[k], rel=1e-4))
    assert z == pytest.approx(1e3 * result.flux_map.psi_d[j, k], rel=1e-4)
    assert abs(z - 1e3 * result.flux_map.psi_d[k, j]) > 1.0


def test_the_surface_has_a_smooth_edge(opened, result):
    """Nodes move by at most a cell, never amid the data, and the surface reaches beyond the nodes with data."""
    choose(opened, "map-quantity", "Flux linkages ψ_d and ψ_q")
    as_surface(opened)
    get = "const trace = document.getElementById('chart-map').data[0]; return [trace.x, trace.y, trace.z]"
    x, y, z = (np.array(values, float) for values in opened.execute_script(get))
    flux_map = result.flux_map
    grid = np.meshgrid(flux_map.i_d, flux_map.i_q)
    moved = np.maximum(*(np.abs(at - node) / np.ptp(node) * 64 for at, node in zip((x, y), grid, strict=True)))
    inside, psi = flux_map.inside.T, 1e3 * flux_map.psi_d.T
    amid = np.all([np.roll(inside, step, axis) for step in (-1, 0, 1) for axis in (0, 1)], axis=0)
    assert moved[amid].max() < 0.01 < moved.max() < 1.01  # numbers are rounded
    assert z[amid] == pytest.approx(psi[amid], rel=1e-3)
    assert np.isfinite(z[inside]).mean() > 0.99
    shown = np.isfinite(z) & ~inside
    assert shown.any()
    assert np.abs(z[shown] - psi[shown]).max() < 0.05 * np.ptp(psi)


def test_the_buttons_do_what_they_say(opened, result, tmp_path):
    opened.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    element(opened, "download").click()
    target = tmp_path / "identification.json"
    wait_for_file(opened, target)
    assert json.loads(target.read_text(encoding="utf-8"))["machine"] == result.machine
    opened.execute_script("window.print = () => { window.printed = true; }")
    element(opened, "print").click()
    assert opened.execute_script("return window.printed")
    element(opened, "copy").click()
    wait_for(opened, "return document.getElementById('copy').textContent !== 'Copy the paragraph'")


def wait_for_file(browser, path: Path):
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 30).until(lambda _: path.exists() and path.stat().st_size > 0)


def test_it_is_dark_on_request_and_by_the_system(opened):
    def background():
        return opened.execute_script("return getComputedStyle(document.body).backgroundColor")

    text = "document.getElementById('chart-inverter').layout.font.color"
    before = opened.execute_script(f"return {text}")
    assert brightness(background()) > 200
    element(opened, "theme").click()
    assert brightness(background()) < 60
    assert element(opened, "theme").get_attribute("aria-pressed") == "true"
    wait_for(opened, f"return {text} !== arguments[0]", before)
    opened.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    )
    opened.refresh()
    wait_for(opened, "return document.documentElement.dataset.drawn === 'true'")
    assert brightness(background()) < 60
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_charts_follow_the_window_while_they_are_drawn(opened):
    from_above(opened)
    fits = "[...document.querySelectorAll('.chart')].every((chart) => chart._fullLayout.width === chart.clientWidth)"
    for k in range(6):
        size = {"width": 400 + 40 * (k % 5), "height": 800, "deviceScaleFactor": 1, "mobile": False}
        opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        opened.execute_script("document.getElementById('theme').click()")
        time.sleep(0.03 * k)
        opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        time.sleep(0.11)
    wait_for(opened, f"return document.documentElement.dataset.drawn === 'true' && {fits}")


def brightness(colour: str) -> float:
    return float(np.mean([float(part) for part in colour.partition("(")[2].rstrip(")").split(",")[:3]]))


def test_in_print_pictures_stand_for_the_charts(opened):
    shown = "return [...document.querySelectorAll(arguments[0])].filter((e) => e.offsetParent !== null).length"
    assert opened.execute_script(shown, ".chart") == 8
    assert opened.execute_script(shown, ".picture") == 0
    element(opened, "theme").click()
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert opened.execute_script(shown, ".chart") == 0
    assert opened.execute_script(shown, ".picture") == 8
    assert opened.execute_script(shown, "button, select, nav") == 0
    assert brightness(opened.execute_script("return getComputedStyle(document.body).backgroundColor")) > 250
    opened.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    element(opened, "theme").click()


def test_a_narrow_window_scrolls_in_one_direction(opened):
    opened.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    )
    wait_for(opened, "return document.documentElement.scrollWidth <= 400")
    opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_all_controls_are_reached_by_the_keyboard(opened):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    as_surface(opened)  # the map cannot be turned when seen from above
    wanted = {field.get_attribute("id") for field in opened.find_elements("css selector", "select, input, button")}
    opened.execute_script(
        "window.reached = []; document.activeElement.blur();"
        "document.addEventListener('focusin', (event) => window.reached.push(event.target.id))"
    )
    reached = set()
    for _ in range(len(wanted)):
        ActionChains(opened).send_keys(10 * Keys.TAB).perform()
        reached = set(opened.execute_script("return window.reached"))
        if wanted <= reached:
            break
    assert wanted <= reached
    assert opened.execute_script("return getComputedStyle(document.activeElement).outlineStyle") == "solid"
