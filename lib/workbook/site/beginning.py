"""A workbook for a paper of one's own: what its folder must hold, with one result that runs as it is."""

from importlib import metadata
from pathlib import Path

from stillwork.base.checks import InputError
from workbook import paths
from workbook.publish import replace_file
from workbook.site.scaffold import CHOICES, new_result, words_of

ROOM, NAME = "paper", "01-deviation"

FILES = {
    "Makefile": """\
# Two commands: make figures, make test. Another interpreter: make PYTHON=/path/to/python3 ...
PYTHON ?= python3
ARGS ?=
export STILLWORK_ROOT := $(CURDIR)
export PYTHONPATH := $(CURDIR)$(if $(PYTHONPATH),:$(PYTHONPATH))

.PHONY: figures test

figures: ## Build what is stale and try the open choices
	@$(PYTHON) -m workbook figures $(ARGS)
	@$(PYTHON) -m workbook readings

test: ## Hold what the notebooks compute against something that shares no code with it
	@$(PYTHON) -m pytest tests $(ARGS)
""",
    "pyproject.toml": """\
[project]
name = "{title}"
version = "0.1.0"
description = "The results of a paper, computed anew"

[tool.pytest.ini_options]
pythonpath = ["."]
addopts = ["--import-mode=importlib"]
""",
    "README.md": """\
# {title}

Every published number beside the one found here, with a verdict that is computed. `make figures` builds each notebook
and tries the choices that the paper leaves open, `make test` runs the tests. Then `python -m workbook accept` copies the
build into the tree, `python -m workbook site` writes it as web pages to `build/site/index.html`, `python -m workbook new`
begins the next result, and `python -m workbook --help` lists the rest.

<!-- ledger:begin -->
<!-- ledger:end -->
""",
    ".gitignore": "build/\n__pycache__/\n",
}


def begin(folder: str) -> list[str]:
    """Write a workbook of one result into a new or empty folder; returns its files, and what comes next.

    Raises
    ------
    InputError
        When the folder holds something, or is a file.
    """
    home = Path(folder)
    if home.is_file() or (home.is_dir() and any(home.iterdir())):
        raise InputError(f"folder is {folder}, which is there and not empty; name a new one")
    (home / "data").mkdir(parents=True)
    with paths.rooted(home):
        written = new_result(ROOM, NAME, create=True)
        choices = paths.data(ROOM, "readings.toml")
        replace_file(choices, CHOICES.format(**words_of(ROOM, NAME)).encode())
    title = home.resolve().name
    texts = {name: text.replace("{title}", title) for name, text in FILES.items()}
    pins = {each.name: each.version for each in metadata.distributions()}
    texts["environment.txt"] = "".join(f"{name}=={version}\n" for name, version in sorted(pins.items()))
    for name, text in texts.items():
        replace_file(home / name, text.encode())
    written += [choices.relative_to(home).as_posix(), *texts]
    return [*written, f"put your paper in their place; it runs as it is: cd {folder} && make figures"]
