"""The pictures of the report and of the live page in the documentation: a simulated drive in a headless Chromium.

Usage: python benchmarks/page_pictures.py FOLDER
"""

from __future__ import annotations

import argparse
import json
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import uvicorn
from selenium import webdriver

import drive_id
from drive_id.core import frames
from drive_id.live.live_view import LiveView
from drive_id.reporting.web.server import Feed, application

SECONDS = 10.0
FITS = (0.3, 0.45, 0.65)
"""Share of the experiment after which the drive is fitted in the background; the last one is on the page."""
EVERY = 50
"""Samples between two points of the trajectory."""
REPORT, LIVE = (1400, 1700), (1200, 900)
"""Widths and heights of the pages, pixels."""


def lines(samples: drive_id.Samples) -> Iterator[str]:
    """Yield what a live feed prints during the experiment."""
    view, names = LiveView(), ("psi_d", "psi_q", "sigma_d", "sigma_q", "inside")
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    done = 0
    for share in FITS:
        count = int(share * len(samples))
        for i_d, i_q in i_dq[done:count:EVERY]:
            view.point(float(i_d), float(i_q), float(samples.speed[count]))
        done = count
        fit = drive_id.fit(samples.part(0, count), i_max=300.0)
        values = {"fit: samples": count, "fit: resistance [ohm]": fit.resistance}
        values |= {"fit: sigma of resistance [ohm]": fit.sigma_resistance}
        told = {name: str(value) for name, value in values.items()}
        view.health("/identification", 0, f"{count} live samples.", told, share * SECONDS)
        view.flux_map(
            SimpleNamespace(
                i_d=fit.flux_map.i_d, i_q=fit.flux_map.i_q, i_max=fit.i_max, resistance=fit.resistance,
                sigma_resistance=fit.sigma_resistance, voltage_error=fit.voltage_error,
                sigma_voltage_error=fit.sigma_voltage_error, coverage=fit.metrics["coverage"], provisional=True,
                machine=fit.machine, method=fit.method, warnings=list(fit.warnings),
                **{name: getattr(fit.flux_map, name) for name in names},
            )
        )  # fmt: skip
        course = {"state": "running", "reason": "", "dry_run": False, "elapsed": share * SECONDS, "duration": SECONDS}
        view.state("publisher", course)
        view.state("drive", {"enabled": True, "fault": "", "speed": samples.speed[count], "dc_link_voltage": 400.0})
        yield json.dumps(view.take()) + "\n"


@contextmanager
def served(folder: Path, feed: Path) -> Iterator[str]:
    """Serve a folder, with a live page that is fed by a file, and yield the address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    app = application(folder, feed=Feed(["tail", "-n", "+1", "-f", str(feed)]))
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="error", timeout_graceful_shutdown=1))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join()


def take(browser: webdriver.Chrome, address: str, size: tuple[int, int], ready: str, path: Path) -> None:
    """Write a picture of a page that is ready when a script returns true."""
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get(address)
    end = time.monotonic() + 60.0
    while not browser.execute_script(f"return {ready}"):
        if time.monotonic() > end:
            raise SystemExit(f"{address} is not ready after a minute.")
        time.sleep(0.1)
    time.sleep(1.0)  # for what is being drawn
    path.write_bytes(browser.get_screenshot_as_png())
    browser.get("about:blank")  # so that a server is free to end


def main() -> None:
    """Simulate, fit, and take the pictures."""
    parser = argparse.ArgumentParser(description="Take the pictures of the pages.")
    parser.add_argument("folder", type=Path)
    target: Path = parser.parse_args().folder
    target.mkdir(parents=True, exist_ok=True)
    samples = drive_id.simulate("ipm", seconds=SECONDS, noise=1e-3, seed=1)
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "google-chrome"
    for switch in ("headless=new", "no-sandbox", "hide-scrollbars", "enable-unsafe-swiftshader"):
        options.add_argument(f"--{switch}")
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive_id.fit(samples).save(folder / "ipm", report=True)
        (folder / "feed").write_text("".join(lines(samples)), encoding="utf-8")
        try:
            drawn = "document.documentElement.dataset.drawn === 'true'"
            take(browser, (folder / "ipm" / "report.html").as_uri(), REPORT, drawn, target / "report.png")
            with served(folder, folder / "feed") as address:
                heard = (
                    "document.documentElement.dataset.points > 0 && byId('link').textContent === 'Following the drive.'"
                )
                take(browser, f"{address}/live", LIVE, heard, target / "live.png")
        finally:
            browser.quit()


if __name__ == "__main__":
    main()
