"""The archive and the live page in a browser: what they say agrees with Python, and they load nothing else."""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from browser import check_quiet, element, wait_for

from drive_id.live.live_view import LiveView
from drive_id.reporting.web.archive import Archive
from drive_id.reporting.web.page import archive_page, write_page
from drive_id.result.comparison import compare

pytestmark = pytest.mark.browser

CELLS = "return [...document.querySelectorAll('#body tr')].map((row) => row.cells[arguments[0]].innerText)"
POINTS = """
const told = (circle) => [circle.textContent, circle.cy.baseVal.value];
return [...document.querySelectorAll('#trends svg')].map((s) => [...s.querySelectorAll('circle')].map(told));
"""
PAINTED = """
const canvas = document.getElementById('disc');
const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
return pixels.filter((value, k) => k % 4 === 3 && value > 0).length / (canvas.width * canvas.height);
"""
"""Share of the pixels of the disc that are not clear."""
NARROW = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": False}


@pytest.fixture(scope="module")
def results(fitted, tmp_path_factory):
    """Three results; the second has more flux and R, the third another name."""
    root, found = tmp_path_factory.mktemp("archive"), []
    for day, (serial, factor) in enumerate((("17", 1.0), ("17", 1.01), ("18", 1.0)), start=1):
        known, drive, flux = fitted.provenance, fitted.drive, fitted.flux_map
        settings, date = replace(known.settings, serial=serial), f"2026-05-{day:02d}T10:00:00+00:00"
        flux = replace(flux, psi_d=factor * flux.psi_d)
        found.append(
            replace(
                fitted, provenance=replace(known, settings=settings, date=date),
                drive=replace(drive, flux_map=flux, resistance=factor * drive.resistance),
            )
        )  # fmt: skip
        found[-1].save(root / f"day {day}", draw=False)
    write_page(root / "index.html", archive_page(Archive(root).entries(), "All results"))
    return SimpleNamespace(page=root / "index.html", found=found, root=root)


@pytest.fixture
def opened(browser, results):
    browser.get(results.page.as_uri())
    yield browser
    check_quiet(browser)


def tick(browser, *folders):
    for folder in folders:
        boxes = browser.find_elements("css selector", "#body tr")
        next(row for row in boxes if folder in row.text).find_element("css selector", "input").click()


def test_it_sorts_and_filters(opened):
    dates = opened.execute_script(CELLS, 1)
    assert dates == sorted(dates, reverse=True)
    assert len(dates) == 3
    column = next(b for b in opened.find_elements("css selector", "#head button") if b.text == "R")
    column.send_keys("\ue007")  # Enter
    assert opened.switch_to.active_element.text == "R"
    shown = [float(text.split()[0]) for text in opened.execute_script(CELLS, 8)]
    assert shown == sorted(shown)
    element(opened, "filter").send_keys("18 joint")
    assert opened.execute_script(CELLS, 3) == ["18"]
    assert element(opened, "count").text == "1 of 3 results"


def test_ticked_results_are_compared_as_python_compares_them(opened, results):
    tick(opened, "day 1", "day 2")
    expected = compare(results.found[1], results.found[0])
    row = next(r for r in opened.find_elements("css selector", "#compared tr") if r.text.startswith("R "))
    units = float(row.text.rpartition("(")[2].split()[0].replace("−", "-"))
    assert units == pytest.approx(expected.resistance_in_sigma, rel=0.01)
    caption = opened.find_element("css selector", "#compared figcaption").text
    rms = float(caption.partition("rms ")[2].split()[0])
    assert rms == pytest.approx(1e3 * np.sqrt(np.nanmean(expected.difference[..., 0] ** 2)), rel=0.02)
    largest = float(caption.partition("largest ")[2].split()[0])
    assert largest == pytest.approx(np.nanmax(np.abs(expected.in_sigma[..., 0])), rel=0.1)
    element(opened, "untick").click()
    assert "Tick two" in element(opened, "compared").text


def test_the_trend_holds_the_results_of_one_serial_number(opened, results):
    from selenium.webdriver.support.ui import Select

    select = Select(element(opened, "group"))
    assert [option.text for option in select.options] == ["ipm, 17 (2)", "ipm, 18 (1)"]
    psi, resistance = opened.execute_script(POINTS)
    assert [text.split(": ")[0] for text, _ in psi] == ["2026-05-01 10:00", "2026-05-02 10:00"]
    assert psi[0][1] > psi[1][1], "more flux is further up"
    assert str(next(q for q in results.found[0].headline if q.name == "R")) in resistance[0][0]
    ticks, index = opened.execute_script(
        "const svg = document.querySelector('#trends svg'), at = (text) => text.getAttribute('text-anchor') === 'end';"
        "return [[...svg.querySelectorAll('text')].filter(at).map((text) => text.textContent),"
        "svg.querySelector('text tspan').textContent]"
    )
    steps = np.diff([float(text) for text in ticks[:-1]])  # the last one is of the time
    assert f"{steps[0]:.1e}"[:3] in {"1.0", "2.0", "5.0"}
    np.testing.assert_allclose(steps, steps[0])
    assert index == "PM"


def test_a_phone_scrolls_in_one_direction_and_the_keyboard_reaches_everything(opened):
    from selenium.webdriver.common.keys import Keys

    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", NARROW)
    tick(opened, "day 1", "day 2")
    names = "return [...document.querySelectorAll('#body tr:first-child .column')].map((name) => name.innerHTML)"
    assert "ψ<sub>PM</sub>" in opened.execute_script(names)
    opened.execute_script("document.querySelector('#group option').textContent = 'A long name, '.repeat(9)")
    wait_for(opened, "return document.documentElement.scrollWidth <= 400")
    opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    opened.execute_script("document.activeElement.blur()")
    wanted = len(opened.find_elements("css selector", "input, button, select, a[href]"))
    reached = set()
    for _ in range(3 * wanted):
        opened.switch_to.active_element.send_keys(Keys.TAB)
        here = opened.switch_to.active_element
        if here.tag_name in {"input", "button", "select", "a"}:
            reached.add(here.id)
    assert len(reached) == wanted


def lines_of(fitted):
    """What a live feed prints during an experiment, in pieces."""
    view, found, drive = LiveView(), fitted.flux_map, fitted.drive
    for angle in np.linspace(0.0, 20.0, 300):
        view.point(200 * np.cos(angle), 200 * np.sin(1.1 * angle), 100.0)
    view.state("publisher", {"state": "running", "reason": "", "dry_run": False, "elapsed": 3.0, "duration": 10.0})
    view.state("drive", {"enabled": True, "fault": "", "speed": 100.0, "dc_link_voltage": 400.0})
    names = ("psi_d", "psi_q", "sigma_d", "sigma_q", "inside")
    view.flux_map(
        SimpleNamespace(
            i_d=found.i_d, i_q=found.i_q, i_max=fitted.i_max, resistance=drive.resistance,
            sigma_resistance=drive.sigma_resistance, voltage_error=2.0, sigma_voltage_error=0.1, coverage=0.9,
            provisional=True, machine="ipm", method="full", warnings=["A warning."],
            **{name: getattr(found, name).ravel() for name in names},
        )
    )  # fmt: skip
    yield view.take()
    for k in (1, 2, 4):
        values = {"fit: samples": str(10_000 * k), "fit: resistance [ohm]": "0.01"}
        view.health("/identification", 0, "Fits.", values | {"fit: sigma of resistance [ohm]": str(2e-4 / k**0.5)}, k)
    yield view.take()
    view.state("publisher", {"state": "tripped", "reason": "The drive was lost.", "elapsed": 4.0, "duration": 10.0})
    yield view.take()
    ended = {"state": "idle", "reason": "", "dry_run": False, "elapsed": 0.0, "duration": 10.0, "completed": True}
    view.state("publisher", ended)
    yield view.take()


@pytest.fixture
def live(fitted, results, tmp_path):
    """A server whose feed prints the next piece whenever the file ``go`` grows."""
    uvicorn = pytest.importorskip("uvicorn", reason="the extra web is not installed")
    from drive_id.reporting.web import server

    lines, go = tmp_path / "lines", tmp_path / "go"
    lines.write_text("".join(json.dumps(line) + "\n" for line in lines_of(fitted)))
    go.write_text("")
    script = (
        "import sys, time, pathlib\nfor n, line in enumerate(open(sys.argv[1])):\n"
        "    while len(pathlib.Path(sys.argv[2]).read_text()) < n: time.sleep(0.05)\n"
        "    print(line, end='', flush=True)\ntime.sleep(600)"
    )
    feed = server.Feed([sys.executable, "-c", script, str(lines), str(go)])
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    app = server.application(results.root, feed=feed)
    config = uvicorn.Config(app, port=port, log_level="error", timeout_graceful_shutdown=1)
    running = uvicorn.Server(config)
    thread = threading.Thread(target=running.run)
    thread.start()
    while not running.started:
        time.sleep(0.02)
    yield SimpleNamespace(url=f"http://127.0.0.1:{port}", go=go, stop=lambda: setattr(running, "should_exit", True))
    running.should_exit = True
    thread.join(20)


def test_the_live_page_follows_an_experiment(browser, live):
    browser.get(f"{live.url}/live")
    wait_for(browser, "return document.documentElement.dataset.points === '300'")
    wait_for(browser, "return document.getElementById('link').textContent === 'Following the drive.'")
    assert "running" in element(browser, "publisher").text
    assert "3 of 10 s" in element(browser, "publisher").text
    assert "400 V" in element(browser, "drive").text
    assert [item.text for item in browser.find_elements("css selector", "#warning-list li")] == ["A warning."]
    assert browser.execute_script(PAINTED) > 0.5, "the disc is coloured"
    live.go.write_text("1")
    wait_for(browser, "return document.getElementById('forecast').textContent !== ''")
    assert element(browser, "forecast").text == "11 s more, and R is within 1 % (95 %)."
    assert "10.00 ± 0.10 mΩ" in element(browser, "R").text
    assert len(browser.find_elements("css selector", "#course circle")) == 3
    assert not element(browser, "safety").is_displayed()
    live.go.write_text("12")
    wait_for(browser, "return !document.getElementById('safety').hidden")
    assert element(browser, "safety").text == "The publisher tripped: The drive was lost."
    shown = [name.text for name in browser.find_elements("css selector", ".figures .name")]
    assert shown == ["Publisher", "Drive", "R", "ψPM", "Inverter drop"]
    live.go.write_text("123")
    wait_for(browser, "return document.getElementById('publisher').innerText.includes('finished')")
    assert "10 of 10 s" in element(browser, "publisher").text
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", NARROW)
    wait_for(browser, "return document.documentElement.scrollWidth <= 400")
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert not browser.find_elements("css selector", "button, input"), "nothing that acts"
    check_quiet(browser, (live.url, "data:"))
    live.stop()
    wait_for(browser, "return document.getElementById('link').textContent.startsWith('The server does not answer')")
    assert "finished" in element(browser, "publisher").text, "what was known stays"
    browser.get("about:blank")
    browser.get_log("browser")  # which holds that the server went
    browser.get_log("performance")


def test_the_served_archive_leads_to_the_live_page(browser, live):
    browser.get(f"{live.url}/")
    browser.find_element("link text", "Live page").click()
    wait_for(browser, "return document.documentElement.dataset.points === '300'")
    browser.find_element("link text", "Archive").click()
    wait_for(browser, "return document.getElementById('count')?.textContent === '3 of 3 results'")
    check_quiet(browser, (live.url, "data:"))
