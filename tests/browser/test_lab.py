"""JupyterLab itself: `make lab` lands on the index of the notebooks, which opens one."""

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
