"""A headless Chromium for tests of pages."""

from __future__ import annotations

import json
import shutil
from contextlib import contextmanager

import pytest

BROWSERS, DRIVER = ("chromium", "chromium-browser", "google-chrome"), "chromedriver"
SWITCHES = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1300,900",
    "--enable-unsafe-swiftshader", "--hide-scrollbars", "--force-prefers-reduced-motion",
)  # fmt: skip


@contextmanager
def driven():
    """Yield a browser; the test is skipped where there is none."""
    selenium = pytest.importorskip("selenium", reason="selenium is not installed: pip install selenium")
    binary = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which(DRIVER)
    if binary is None or driver is None:
        pytest.skip("there is no Chromium with its driver here: apt install chromium chromium-driver")
    assert selenium.__version__
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for switch in SWITCHES:
        options.add_argument(switch)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield browser
    finally:
        browser.quit()


def wait_for(browser, script, *arguments):
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(browser, 60, poll_frequency=0.05).until(
        lambda driven: driven.execute_script(script, *arguments), script
    )


def element(browser, name):
    return browser.find_element("id", name)


def check_quiet(browser, allowed=("file:", "data:", "blob:")):
    """Check that nothing was complained of, and nothing loaded but from the allowed places."""
    complaints = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert not complaints, complaints
    asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    loaded = {entry["params"]["request"]["url"] for entry in asked if entry["method"] == "Network.requestWillBeSent"}
    assert not {url for url in loaded if not url.startswith(allowed)}
