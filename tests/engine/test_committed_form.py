"""JupyterLab saves a committed notebook in its committed form: only what a person changed changes the checkout."""

import asyncio
import copy
import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from types import SimpleNamespace

import nbformat
import pytest
from hatchling.build import build_editable
from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager

from workbook import lab
from workbook.notebooks import cleaned, notebook_text, select

ROOT = Path(__file__).parents[2]
NAME = "notebooks/isolation/05-power.ipynb"
COMMITTED = ["notebooks/index.ipynb", *(f"notebooks/{each.name}.ipynb" for each in select())]


class Checkout:
    """A committed copy of the notebooks, and a server that has it open."""

    def __init__(self, root: Path):
        self.root = root
        for name in COMMITTED:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, root / name)
        shutil.copy(ROOT / ".gitignore", root)
        (root / "data" / "isolation").mkdir(parents=True)
        (root / "data" / "isolation" / "published.toml").touch()
        self.git("init", "--quiet")
        self.commit()
        self.manager = AsyncLargeFileManager(root_dir=str(root))
        lab._load_jupyter_server_extension(SimpleNamespace(contents_manager=self.manager))

    def git(self, *arguments: str) -> str:
        identity = ["-c", "user.name=reader", "-c", "user.email=reader@example.org"]
        done = subprocess.run(
            ["git", *identity, *arguments], cwd=self.root, capture_output=True, text=True, check=True
        )
        return done.stdout

    def commit(self) -> None:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", "as it is")

    def changed(self) -> str:
        return self.git("status", "--porcelain")

    def open(self, name: str = NAME) -> dict:
        """What a page gets."""
        return copy.deepcopy(asyncio.run(self.manager.get(name))["content"])

    def save(self, page: dict, name: str = NAME) -> dict:
        """What a page is told after it sent itself, as plain JSON."""
        model = {"type": "notebook", "format": "json", "content": json.loads(json.dumps(page))}
        return asyncio.run(self.manager.save(model, name))

    def cells(self, name: str = NAME) -> dict[str, dict]:
        return {each["id"]: each for each in json.loads((self.root / name).read_text("utf-8"))["cells"]}


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    monkeypatch.setenv("JUPYTER_DATA_DIR", str(tmp_path / "jupyter"))  # signatures of trusted notebooks
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path / "checkout"))
    return Checkout(tmp_path / "checkout")


def as_run(page: dict) -> dict:
    """What a run and a look around leave in the page."""
    page = copy.deepcopy(page)
    page["metadata"] = {
        "kernelspec": {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"},
        "language_info": {"name": "python", "version": "3.13.1", "codemirror_mode": {"name": "ipython"}},
        "widgets": {"application/vnd.jupyter.widget-state+json": {"state": {"a": {}}, "version_major": 2}},
    }
    for number, cell in enumerate(page["cells"]):
        if cell["cell_type"] == "markdown":
            cell["metadata"]["jp-MarkdownHeadingCollapsed"] = True
            continue
        cell["metadata"] |= {"trusted": True, "scrolled": True, "execution": {"shell.execute_reply": "now"}}
        cell["execution_count"] = 40 + number
        shown = {"text/plain": "<Figure>", "text/html": "<b>", "image/png": "iVBO"}
        view = {"application/vnd.jupyter.widget-view+json": {"model_id": "a", "version_major": 2}}
        cell["outputs"] = [
            {"output_type": "stream", "name": "stderr", "text": "slow\n"},
            {"output_type": "display_data", "data": view, "metadata": {}},
            {"output_type": "execute_result", "execution_count": 40 + number, "data": shown, "metadata": {}},
        ]
    return page


def code(page: dict) -> list[dict]:
    return [cell for cell in page["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
def test_run_and_saved_nothing_changes(checkout):
    for name in COMMITTED:
        page = as_run(checkout.open(name))
        checkout.save(page, name)
        checkout.save(page, name)  # the page goes on showing what it ran
    assert checkout.changed() == ""


def test_an_edited_cell_loses_its_results_and_the_others_keep_theirs(checkout):
    before, page = checkout.cells(), as_run(checkout.open())
    edited = next(cell for cell in code(page) if before[cell["id"]]["outputs"])
    edited["source"] = "# mine\n" + edited["source"]
    checkout.save(page)

    after = checkout.cells()
    assert list(after) == list(before)
    was, now = before.pop(edited["id"]), after.pop(edited["id"])
    assert after == before
    assert now == was | {"source": ["# mine\n", *was["source"]], "outputs": [], "execution_count": None}
    head = json.loads(checkout.git("show", f"HEAD:{NAME}"))
    rest = json.loads((checkout.root / NAME).read_text("utf-8"))
    assert {**rest, "cells": None} == {**head, "cells": None}


@pytest.mark.slow
def test_an_edit_taken_back_leaves_nothing(checkout):
    page = as_run(checkout.open())
    for cell in code(page):
        source, cell["source"] = cell["source"], "1 + 1"
        checkout.save(page)
        assert checkout.changed()
        cell["source"] = source
    checkout.save(page)
    assert checkout.changed() == ""


@pytest.mark.slow
def test_what_was_saved_can_be_accepted_and_then_stays(checkout):
    page = as_run(checkout.open())
    edited = code(page)[-1]
    edited["source"] = "1 + 1"
    checkout.save(page)
    file = checkout.root / NAME
    saved = json.loads(file.read_text("utf-8"))
    executed = json.loads(nbformat.writes(nbformat.from_dict(as_run(saved))))
    accepted = notebook_text(cleaned(saved, executed))
    assert "iVBO" not in accepted
    file.write_text(accepted, encoding="utf-8")
    assert checkout.cells()[edited["id"]]["execution_count"] == edited["execution_count"]

    checkout.save(page)
    assert file.read_text("utf-8") == accepted


def test_cells_may_come_go_and_change_places(checkout):
    before, page = checkout.cells(), as_run(checkout.open())
    kept = page["cells"][::-1]
    gone = kept.pop(3)
    shown = {
        "output_type": "execute_result",
        "execution_count": 90,
        "data": {"text/plain": "2"},
        "metadata": {},
    }
    new = {"cell_type": "code", "id": "5f2b9c1e-0000", "metadata": {"trusted": True}, "source": "1 + 1"}
    new |= {"execution_count": 90, "outputs": [shown]}
    words = {"cell_type": "markdown", "id": "words", "metadata": {}, "source": "![](attachment:a.png)"}
    words["attachments"] = {"a.png": {"image/png": "iVBO"}}
    checkout.save({**page, "cells": [new, *kept, words]})

    after = checkout.cells()
    assert list(after) == ["5f2b9c1e-0000", *[i for i in reversed(before) if i != gone["id"]], "words"]
    empty = {"metadata": {}, "source": ["1 + 1"], "execution_count": None, "outputs": []}
    assert after.pop("5f2b9c1e-0000") == new | empty
    assert after.pop("words") == words | {"source": [words["source"]]}
    assert after == {i: before[i] for i in after}

    checkout.save(page)
    assert checkout.changed() == ""


def test_a_cell_that_becomes_words_has_no_results(checkout):
    page = as_run(checkout.open())
    cell = next(each for each in page["cells"] if each["cell_type"] == "code")
    cell["cell_type"] = "markdown"
    del cell["outputs"], cell["execution_count"]
    checkout.save(page)
    assert set(checkout.cells()[cell["id"]]) == {"cell_type", "id", "metadata", "source"}


def test_tags_are_a_persons(checkout):
    page = checkout.open()
    tagged = next(cell for cell in code(page) if cell["metadata"].get("tags") == ["parameters"])
    tagged["metadata"]["tags"], other = [], code(page)[0]
    other["metadata"]["tags"] = ["mine"]
    checkout.save(page)
    assert checkout.cells()[tagged["id"]]["metadata"] == {}
    assert checkout.cells()[other["id"]]["metadata"] == {"tags": ["mine"]}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["notebooks/isolation/mine.ipynb", "mine.ipynb"])
def test_a_notebook_of_ones_own_keeps_everything(checkout, name):
    page = as_run(checkout.open())
    for _ in range(2):
        checkout.save(page, name)
        assert checkout.open(name)["metadata"] == page["metadata"]
        for now, was in zip(checkout.open(name)["cells"], page["cells"], strict=True):
            was["metadata"].pop("trusted", None)
            now["metadata"].pop("trusted", None)
            assert now == was


def test_a_committed_notebook_that_is_not_the_workbooks_keeps_everything(checkout):
    page = as_run(checkout.open())
    checkout.save(page, "docs.ipynb")
    checkout.commit()
    checkout.save(page, "docs.ipynb")
    assert checkout.changed() == ""
    assert "image/png" in (checkout.root / "docs.ipynb").read_text("utf-8")


@pytest.mark.slow
def test_another_root_of_the_server_changes_nothing(checkout):
    """As with plain `jupyter lab` in a folder above the checkout or below."""
    page = as_run(checkout.open())
    checkout.manager.root_dir = str(checkout.root.parent)
    checkout.save(page, f"{checkout.root.name}/{NAME}")
    checkout.manager.root_dir = str((checkout.root / NAME).parent)
    checkout.save(page, Path(NAME).name)
    assert checkout.changed() == ""


@pytest.mark.parametrize(
    "text", ["", "<<<<<<< HEAD\n{}", "[]", "3", '{"cells": 3}', '{"nbformat": 4, "cells": [{"id": 1}]}', None]
)
def test_a_broken_or_missing_file_is_made_good(checkout, text):
    page = as_run(checkout.open())
    file = checkout.root / NAME
    file.unlink()
    if text is not None:
        file.write_text(text, encoding="utf-8")
    checkout.save(page)
    assert checkout.changed() == ""


@pytest.mark.parametrize("harm", [{"cells": 3}, {"cells": [{"cell_type": "code"}]}])
def test_a_page_that_is_no_notebook_is_the_servers_to_refuse(checkout, harm):
    page = checkout.open() | harm
    with pytest.raises(Exception, match="saving"):
        checkout.save(page)
    assert checkout.changed() == ""


def test_a_file_opened_as_text_is_saved_as_typed(checkout):
    model = {"type": "file", "format": "text", "content": "{}"}
    asyncio.run(checkout.manager.save(model, NAME))
    assert (checkout.root / NAME).read_text("utf-8") == "{}"


@pytest.mark.slow
def test_without_git_a_notebook_is_saved_as_it_is(checkout):
    shutil.rmtree(checkout.root / ".git")
    checkout.save(as_run(checkout.open()))
    assert "image/png" in (checkout.root / NAME).read_text("utf-8")


def test_the_library_alone_leaves_a_server_as_it_is(tmp_path, monkeypatch):
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    server = SimpleNamespace()  # no contents manager to register with
    lab._load_jupyter_server_extension(server)
    assert vars(server) == {}


def test_an_installed_checkout_names_the_extension_to_every_server(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    with zipfile.ZipFile(tmp_path / build_editable(str(tmp_path))) as wheel:
        [name] = [each for each in wheel.namelist() if "/data/etc/jupyter/jupyter_server_config.d/" in each]
        settings = json.loads(wheel.read(name))
    assert settings == {"ServerApp": {"jpserver_extensions": {lab.__name__: True}}}
    assert lab._jupyter_server_extension_points() == [{"module": lab.__name__}]
