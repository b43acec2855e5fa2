"""JupyterLab itself: `make lab` lands on the map of the house, and an explorer's slider moves its picture."""

import json
import os
import shutil
import signal
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

ROOT = Path(__file__).parents[2]
NOTEBOOK = "isolation/06-efficient-update"
TOKEN = "only-for-this-test"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of what `make lab` needs."""
    folder = tmp_path_factory.mktemp("lab") / "checkout"
    ignored = shutil.ignore_patterns("__pycache__", ".ipynb_checkpoints")
    for name in ("lib", "contest", "data", "notebooks"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for file in ("Makefile", ".gitignore"):
        shutil.copy(ROOT / file, folder)
    return folder


@pytest.fixture(scope="module")
def lab(checkout):
    """Address of what `make lab` starts in the checkout."""
    home = checkout.parent
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")} | {
        "JUPYTER_CONFIG_DIR": str(home / "config"),
        "JUPYTER_DATA_DIR": str(home / "data"),
        "JUPYTER_RUNTIME_DIR": str(home / "runtime"),
        "IPYTHONDIR": str(home / "ipython"),
        "JUPYTERLAB_SETTINGS_DIR": str(home / "settings"),
        "JUPYTERLAB_WORKSPACES_DIR": str(home / "workspaces"),
    }
    options = ["--no-browser", "--allow-root", f"--port={port}", "--ServerApp.port_retries=0"]
    options += [f"--IdentityProvider.token={TOKEN}", "--LabApp.expose_app_in_browser=True"]
    options += ["--LabApp.news_url=None", "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate"]
    command = ["make", f"ENVIRONMENT={sys.prefix}", "lab", f"ARGS={' '.join(options)}"]
    with (home / "log").open("w") as log:
        server = subprocess.Popen(
            command, cwd=checkout, env=environment, stdout=log, stderr=log, start_new_session=True
        )
        address = f"http://127.0.0.1:{port}"
        try:
            _wait_until_up(address, server, home / "log")
            yield address
        finally:
            os.killpg(server.pid, signal.SIGTERM)
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


def test_it_lands_on_the_index_of_the_notebooks(browser, lab):
    browser.resize(1440)
    browser.open(f"{lab}/?token={TOKEN}")
    until(browser, PANEL, "notebooks/index.ipynb")
    heading = until(browser, "return document.querySelector('.jp-Notebook h1')?.textContent")
    assert heading.startswith("The notebooks")
    assert browser.driver.current_url.startswith(f"{lab}/lab/tree/notebooks/index.ipynb")
    title = json.loads((ROOT / f"notebooks/{NOTEBOOK}.ipynb").read_text("utf-8"))["cells"][0]["source"]
    title = "".join(title).splitlines()[0].removeprefix("# ")
    until(
        browser,
        "const link = [...document.querySelectorAll('.jp-Notebook a')].find((a) => a.textContent === arguments[0]);"
        "if (!link?.href) return false; link.click(); return true",
        title,
    )
    until(browser, PANEL, f"notebooks/{NOTEBOOK}.ipynb")


# What stands on the explorer: the slider's number, the picture's address, the message.
STATE = """
const text = (selector) => document.querySelector(selector)?.textContent;
const picture = document.querySelector(".widget-image[src^='blob:']")?.src;
return picture && [text(".widget-readout"), picture, text(".widget-html-content")];
"""
PUBLISHED, MOVED = "at the start", "moved; in grey the start"


def test_a_slider_moves_number_and_picture_and_the_button_returns(browser, lab):
    browser.resize(1440, 1400)
    browser.driver.set_script_timeout(300)  # the kernel may have to compile first
    browser.open(f"{lab}/lab/tree/notebooks/{NOTEBOOK}.ipynb?token={TOKEN}")
    until(browser, PANEL, f"notebooks/{NOTEBOOK}.ipynb")
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
