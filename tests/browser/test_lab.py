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


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=reader", "-c", "user.email=reader@example.org"]
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A committed copy of what `make lab` needs."""
    folder = tmp_path_factory.mktemp("lab") / "checkout"
    ignored = shutil.ignore_patterns("__pycache__", ".ipynb_checkpoints")
    for name in ("lib", "contest", "data", "notebooks"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for file in ("Makefile", ".gitignore"):
        shutil.copy(ROOT / file, folder)
    git(folder, "init", "--quiet")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "as it is")
    return folder


@pytest.fixture(scope="module")
def lab(checkout):
    """Address of what `make lab` starts in the checkout; it saves every two seconds."""
    home = checkout.parent
    manager = home / "settings/@jupyterlab/docmanager-extension/plugin.jupyterlab-settings"
    manager.parent.mkdir(parents=True)
    manager.write_text('{"autosaveInterval": 2}')
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


def saved_by_itself(browser) -> None:
    """Wait until JupyterLab has saved the page, which it does as soon as there is something to save."""
    browser.run("window.jupyterapp.shell.currentWidget.context.model.dirty = true")
    until(browser, "return !window.jupyterapp.shell.currentWidget.context.model.dirty")
    assert not browser.run("return document.querySelector('.jp-Dialog')?.innerText")


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


def test_only_what_a_person_changes_is_saved(browser, lab, checkout):
    browser.open(f"{lab}/lab/tree/notebooks/index.ipynb?token={TOKEN}")
    until(browser, PANEL, "notebooks/index.ipynb")
    asynchronously(browser, "await window.jupyterapp.shell.currentWidget.sessionContext.ready")
    file = checkout / "notebooks/index.ipynb"
    times = [file.stat().st_mtime_ns]
    for _ in range(2):
        saved_by_itself(browser)
        times.append(file.stat().st_mtime_ns)
    assert len(set(times)) == 3
    assert git(checkout, "status", "--porcelain") == ""

    cell = "window.jupyterapp.shell.currentWidget.content.model.cells.get(0).sharedModel"
    title = browser.run(f"return {cell}.source")
    browser.run(f"{cell}.source += ' of mine'")
    saved_by_itself(browser)
    changed = git(checkout, "diff", "--unified=0").splitlines()
    assert [line for line in changed if line.startswith("+ ")] == [f'+    "{title.splitlines()[-1]} of mine"']
    assert git(checkout, "diff", "--numstat").split() == ["1", "1", "notebooks/index.ipynb"]
    browser.run(f"{cell}.source = arguments[0]", title)
    saved_by_itself(browser)
    assert git(checkout, "status", "--porcelain") == ""


# What stands on the explorer: the slider's number, the picture's address, the message.
STATE = """
const text = (selector) => document.querySelector(selector)?.textContent;
const picture = document.querySelector(".widget-image[src^='blob:']")?.src;
return picture && [text(".widget-readout"), picture, text(".widget-html-content")];
"""
PUBLISHED, MOVED = "at the start", "moved; in grey the start"


def test_a_slider_moves_number_and_picture_the_button_returns_and_nothing_of_it_is_saved(
    browser, lab, checkout
):
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

    for _ in range(2):
        saved_by_itself(browser)
    assert browser.run("return document.querySelector('.widget-readout')?.textContent") == home[0]
    assert git(checkout, "status", "--porcelain") == ""
