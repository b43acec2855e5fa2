"""JupyterLab itself: `make lab` lands on the map of the house, and an explorer's slider moves its picture."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from stillwork import paths

ROOT = Path(__file__).parents[2]
NOTEBOOK = "isolation/06-efficient-update"
TOKEN = "only-for-this-test"


def lab_options() -> list[str]:
    """What `make lab` tells JupyterLab, but for the folder and the address."""
    command = subprocess.run(
        ["make", "-n", "ENVIRONMENT=any", "lab"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    options = re.findall(r"--\S+", command)
    assert options
    return [each for each in options if not each.startswith("--ServerApp")]


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Address of a JupyterLab on a copy of the index and of one notebook's explorer."""
    home = tmp_path_factory.mktemp("lab")
    folder = home / "notebooks"
    (folder / NOTEBOOK).parent.mkdir(parents=True)
    shutil.copy(paths.root() / "notebooks/index.ipynb", folder)
    whole = json.loads((paths.root() / f"notebooks/{NOTEBOOK}.ipynb").read_text(encoding="utf-8"))
    code = [cell for cell in whole["cells"] if cell["cell_type"] == "code"]
    kept = [
        cell for cell in code if cell["id"] == "imports" or "".join(cell["source"]).startswith("explore(")
    ]
    assert len(kept) == 2
    for cell in kept:
        cell["outputs"] = []
    (folder / f"{NOTEBOOK}.ipynb").write_text(json.dumps({**whole, "cells": kept}), encoding="utf-8")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = os.environ | {
        "PYTHONPATH": str(ROOT / "lib"),
        "JUPYTER_CONFIG_DIR": str(home / "config"),
        "JUPYTER_RUNTIME_DIR": str(home / "runtime"),
        "IPYTHONDIR": str(home / "ipython"),
        "JUPYTERLAB_SETTINGS_DIR": str(home / "settings"),
        "JUPYTERLAB_WORKSPACES_DIR": str(home / "workspaces"),
        "JUPYTER_PREFER_ENV_PATH": "1",
    }
    command = [sys.executable, "-m", "jupyter", "lab", *lab_options(), "--no-browser", "--allow-root"]
    command += [f"--ServerApp.root_dir={folder}", f"--port={port}", "--ServerApp.port_retries=0"]
    command += [f"--IdentityProvider.token={TOKEN}", "--LabApp.expose_app_in_browser=True"]
    command += ["--LabApp.news_url=None", "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate"]
    with (home / "log").open("w") as log:
        server = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log)
        address = f"http://127.0.0.1:{port}"
        try:
            _wait_until_up(address, server, home / "log")
            yield address
        finally:
            server.terminate()
            server.wait(30)


def _wait_until_up(address: str, server: subprocess.Popen, log: Path) -> None:
    end = time.monotonic() + 120
    while True:
        try:
            urllib.request.urlopen(f"{address}/api?token={TOKEN}", timeout=5)
            return
        except OSError:
            assert server.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.3)


# Whether the panel of a notebook stands and commands are about it. Without asking, they may be about none, because
# the page had its focus first, or about another one, which JupyterLab opens again because it was open before.
PANEL = """
const shell = window.jupyterapp?.shell;
const panel = shell && [...shell.widgets("main")].find((widget) => widget.context?.path === arguments[0]);
if (!panel?.isRevealed || !panel.context.isReady) return false;
if (shell.currentWidget !== panel) shell.activateById(panel.id);
return shell.currentWidget === panel;
"""


def asynchronously(browser, script: str) -> None:
    """Run a script that may ``await`` JupyterLab's own promises; what it throws fails the test."""
    wrapped = f"const done = arguments[0]; (async () => {{ {script} }})().then(() => done(''), (error) => done(String(error)))"
    assert browser.driver.execute_async_script(wrapped) == ""


def until(browser, script: str, *arguments):
    """What `script` returns once that is not empty; it finds what it looks at anew each time."""
    wait = WebDriverWait(browser.driver, 120)
    try:
        return wait.until(lambda _: browser.run(script, *arguments))
    except TimeoutException:
        page, said = browser.run("return document.body.innerText"), browser.messages()
        pytest.fail(f"waited in vain for: {script}\nthe page: {page}\nthe console: {said}")


def test_it_lands_on_the_map_of_the_house(browser, lab):
    browser.resize(1440)
    browser.open(f"{lab}/?token={TOKEN}")
    until(browser, PANEL, "index.ipynb")
    heading = until(browser, "return document.querySelector('.jp-Notebook h1')?.textContent")
    assert heading.startswith("The house")
    assert browser.driver.current_url.startswith(f"{lab}/lab/tree/index.ipynb")
    title = json.loads((ROOT / f"notebooks/{NOTEBOOK}.ipynb").read_text("utf-8"))["cells"][0]["source"]
    title = "".join(title).splitlines()[0].removeprefix("# ")
    address = until(
        browser,
        "return [...document.querySelectorAll('.jp-Notebook a')].find((a) => a.textContent === arguments[0])?.href",
        title,
    )
    assert NOTEBOOK in address


# What stands on the explorer: the slider's number, the picture's address, the message.
STATE = """
const text = (selector) => document.querySelector(selector)?.textContent;
const picture = document.querySelector(".widget-image[src^='blob:']")?.src;
return picture && [text(".widget-readout"), picture, text(".widget-html-content")];
"""
PUBLISHED, MOVED = "at the published setting", "moved from the published setting"


def test_a_slider_moves_number_and_picture_and_the_button_returns(browser, lab):
    browser.resize(1440, 1400)
    browser.driver.set_script_timeout(300)  # the kernel may have to compile first
    browser.open(f"{lab}/lab/tree/{NOTEBOOK}.ipynb?token={TOKEN}")
    until(browser, PANEL, f"{NOTEBOOK}.ipynb")
    asynchronously(
        browser,
        "const app = window.jupyterapp, panel = app.shell.currentWidget; await panel.sessionContext.ready;"
        "if (!await app.commands.execute('notebook:run-all-cells')) throw new Error("
        "  JSON.stringify(panel.content.model.toJSON().cells.map((cell) => cell.outputs)));"
        "await panel.content.scrollToItem(panel.content.widgets.length - 1)",
    )
    before = until(browser, STATE)
    assert before[2] == PUBLISHED

    browser.driver.find_element(By.CSS_SELECTOR, ".noUi-handle").send_keys(Keys.ARROW_RIGHT)
    after = until(
        browser, f"const now = (() => {{ {STATE} }})(); return now?.[2] === arguments[0] && now", MOVED
    )
    assert float(after[0]) > float(before[0])
    assert after[1] != before[1]

    browser.driver.find_element(By.CSS_SELECTOR, "button.jupyter-button").click()
    home = until(
        browser, f"const now = (() => {{ {STATE} }})(); return now?.[2] === arguments[0] && now", PUBLISHED
    )
    assert home[0] == before[0]
