"""The site as `make site` wrote it, and a Chromium that notes every request and every message."""

import json
import os
import shutil
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

from workbook import paths

# No window, and nothing of Chromium's own on the network.
SWITCHES = (
    "headless=new",
    "disable-gpu",
    "disable-dev-shm-usage",
    "disable-background-networking",
    "disable-component-update",
    "disable-quic",
    "disable-sync",
    "no-first-run",
)


class Browser:
    """A headless Chromium: `open` a page, `run` a script, `resize`, and what it asked for and said since."""

    def __init__(self, profile: Path):
        options = webdriver.ChromeOptions()
        options.binary_location = _program("chromium", "chromium-browser", "google-chrome")
        options.add_argument(f"--user-data-dir={profile}")
        for switch in SWITCHES:
            options.add_argument(f"--{switch}")
        if os.geteuid() == 0:  # Chromium has no sandbox for root
            options.add_argument("--no-sandbox")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(_program("chromedriver")))
        self.driver.set_script_timeout(60)
        self.driver.execute_cdp_cmd("Emulation.setFocusEmulationEnabled", {"enabled": True})

    def open(self, address: str) -> None:
        self.driver.get(address)
        # From the disk the driver may come back before the styles have.
        WebDriverWait(self.driver, 60).until(lambda _: self.run("return document.readyState") == "complete")
        waiting = "return document.querySelectorAll('figure[data-states]:not([data-ready])').length"
        WebDriverWait(self.driver, 60).until(lambda _: not self.run(waiting))

    def run(self, script: str, *arguments):
        return self.driver.execute_script(script, *arguments)

    def resize(self, width: int, height: int = 900) -> None:
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def dark(self, wanted: bool) -> None:
        scheme = {"name": "prefers-color-scheme", "value": "dark" if wanted else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})

    def requests(self) -> list[str]:
        """Addresses that were asked for since the last call."""
        entries = [json.loads(each["message"])["message"] for each in self.driver.get_log("performance")]
        return [
            entry["params"]["request"]["url"]
            for entry in entries
            if entry["method"] == "Network.requestWillBeSent"
        ]

    def require_quiet(self) -> None:
        """That nothing was asked for but what is here, and nothing was said, since the last call."""
        local = ("file:", "data:", "blob:", "chrome:", "about:")
        assert not [each for each in self.requests() if not each.startswith(local)]
        assert not self.messages()

    def messages(self) -> list[str]:
        """What the console said since the last call."""
        return [each["message"] for each in self.driver.get_log("browser")]


def _program(*names: str) -> str:
    found = next(filter(None, map(shutil.which, names)), None)
    assert found, f"{names[0]} is not installed: apt-get install chromium chromium-driver"
    return found


@pytest.fixture(scope="session")
def site():
    """What `make browser` has just written."""
    folder = paths.root() / "build" / "site"
    assert (folder / "index.html").is_file(), "run make site"
    return folder


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    one = Browser(tmp_path_factory.mktemp("profile"))
    yield one
    one.driver.quit()
