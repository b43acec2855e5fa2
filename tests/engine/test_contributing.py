"""What a contributor does first, done in a copy: a cell added in Jupyter, a new result, a new topic."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from engine import toy as toys
from engine.test_committed import NAME, README, committed
from layering import modules

pytestmark = pytest.mark.slow

# As Jupyter saves them: ids of chance, lines as a list; it leaves an empty cell behind the last that was run.
ADDED = [
    {"id": "3f2a9c1b", "source": ["def double(value):\n", "    return 2*value\n", "double( 2 )"]},
    {
        "id": "0c41d7aa",
        "source": [
            "import os, sys\n",
            "import  math\n",
            "f = lambda x: x; x = [1]; x\n",
            "%time 1+1\n",
            "!true",
        ],
    },
    {"id": "70b1e4d2-9a51-4c0e", "source": []},
]


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """A workbook of one accepted notebook, at a commit."""
    toy = toys.make(tmp_path_factory.mktemp("begun"))
    toy.add_page(NAME)
    (toy.root / "data/motion/published.toml").unlink()
    toy.write("data/isolation/paper.toml", "order = 1\n")
    (toy.root / "environment.txt").write_text("")
    toy.write("README.md", README)
    toy.write(".gitignore", "build/\n__pycache__/\n")
    toy.commit()
    build_and_accept(toy)
    yield toy
    toys.clean_up(toy)


@pytest.fixture
def toy(begun, tmp_path):
    with toys.copy_of(begun, tmp_path) as copy:
        yield copy


def build_and_accept(toy):
    for command in ("figures", "accept"):
        done = toy.run(command)
        assert done.returncode == 0, done.stdout + done.stderr
    toy.commit()


def require_style(toy, *places):
    """The style of this checkout; the toy has a library of its own, which ruff takes for the first party's."""
    settings = ["--config", f"{Path(__file__).parents[2]}/pyproject.toml"]
    settings += ["--config", 'lint.isort.known-first-party=["notebooks", "workbook"]']
    for style in (["format", "--check"], ["check"]):
        done = subprocess.run([sys.executable, "-m", "ruff", *style, *settings, *places], cwd=toy.root)
        assert done.returncode == 0


def test_a_cell_added_in_jupyter_is_accepted_as_it_is(toy, monkeypatch):
    file = toy.root / f"notebooks/{NAME}.ipynb"
    notebook = json.loads(file.read_text(encoding="utf-8"))
    for cell in ADDED:
        made = {"cell_type": "code", "metadata": {}, "outputs": [], "execution_count": None}
        notebook["cells"].append(made | cell)
    file.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    toy.commit()
    build_and_accept(toy)
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    assert [cell["id"] for cell in cells[-3:]] == [cell["id"] for cell in ADDED]
    assert cells[-3]["outputs"][0]["data"] == {"text/plain": ["4"]}
    assert committed(toy, monkeypatch).failed == set()
    require_style(toy, "notebooks")
    assert f"notebooks.{NAME.replace('/', '.')}" in modules(toy.root)  # the rules of imports read it


def test_a_new_result_and_a_new_topic_pass_as_they_are_written(toy, monkeypatch):
    first = toy.run("new", "isolation", "09-payload")
    assert first.returncode == 0, first.stderr
    other = toy.run("new", "crane", "01-sway", "--create")
    assert other.returncode == 0, other.stderr
    toy.commit()
    assert toy.reasons().keys() == {"isolation/09-payload", "crane/01-sway"}
    build_and_accept(toy)
    assert committed(toy, monkeypatch).failed == set()
    readme = (toy.root / "README.md").read_text(encoding="utf-8")
    assert readme.index("| `isolation` | 2 |") < readme.index("| `crane` | 1 |")
    index = (toy.root / "notebooks/index.ipynb").read_text(encoding="utf-8")
    assert "## Crane (`crane`)" in index and "(crane/01-sway.ipynb)" in index
    require_style(toy, "notebooks", "tests")
    options = [*"-p no:cacheprovider -o addopts= -o".split(), "pythonpath=lib ."]
    command = [sys.executable, "-m", "pytest", *options, "tests"]
    done = subprocess.run(command, cwd=toy.root, env=toy.environment(), capture_output=True, text=True)
    assert "4 passed" in done.stdout, done.stdout
