"""A new workbook, a new topic, a new result: files that run as they are and wait to be filled in."""

import json
import re
import shlex
from importlib import metadata
from keyword import iskeyword
from pathlib import Path

from workbook import paths
from workbook.checks import InputError, nearest
from workbook.notebooks import notebook_file, notebook_text
from workbook.publish import replace_file

# The worked example, so that build, ledger and test run from the first minute.
STARTER = Path(__file__).with_name("starter")
TOPIC, NAME = "paper", "01-deviation"
FILES = {
    "Makefile": "Makefile",
    "pyproject.toml": "pyproject.toml",
    "README.md": "README.md",
    ".gitignore": "gitignore.txt",
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
        written = new_result(TOPIC, NAME, create=True)
    texts = {name: starter(file, {"title": home.resolve().name}) for name, file in FILES.items()}
    pins = {each.name: each.version for each in metadata.distributions()}
    texts["environment.txt"] = "".join(f"{name}=={version}\n" for name, version in sorted(pins.items()))
    for name, text in texts.items():
        replace_file(home / name, text.encode())
    enter = f"cd {shlex.quote(str(folder))} && make figures"
    return [*written, *texts, f"put your paper in their place; it runs as it is: {enter}"]


def new_result(topic: str, name: str, create: bool = False) -> list[str]:
    """Write the files of a new result, and of a new topic what is said of its paper; returns their paths.

    Parameters
    ----------
    topic : str
        A topic's name.
    name : str
        ``nn-result``, e.g. ``09-payload``.
    create : bool
        Whether the topic is a new one, which this begins.

    Raises
    ------
    InputError
        When there is no such topic (or, to be created, it is there), a name has another form, or it is taken.
    """
    if create:
        _require_new_topic(topic)
    elif not paths.is_topic(topic):
        raise InputError(
            f"there is no topic {topic!r}{nearest(topic, paths.topics())}; to begin it, give --create"
        )
    if not re.fullmatch(r"\d\d-[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise InputError(f"name is {name!r}; give a number and words like '09-payload'")
    words = words_of(topic, name)
    # A new topic begins with a study of its example; an entry without one gives the reason.
    words["open"] = (
        "" if create else 'open = "none: the example leaves nothing open"  # or a study in choices.toml\n'
    )
    key, module = words["key"], words["module"]
    notebook = notebook_file(f"{topic}/{name}")
    beside = notebook.with_name(f"{module}.py")
    test = paths.root() / "tests" / topic / f"test_{module}.py"
    ledger = paths.data(topic, "published.toml")
    before = ledger.read_text(encoding="utf-8") if ledger.exists() else ""
    for file in (notebook, beside, test):
        if file.exists():
            raise InputError(f"{file.relative_to(paths.root())} exists already; choose another name")
    taken = sorted(each.stem for each in notebook.parent.glob("[0-9][0-9]-*.ipynb"))
    if same := [each for each in taken if each[:2] == name[:2]]:
        raise InputError(f"the number {name[:2]} is taken by {same[0]}; the last one is {taken[-1][:2]}")
    if f"[{topic}.{key}." in before:
        raise InputError(f"the ledger has entries {topic}.{key} already; choose another name")
    written = {
        notebook: notebook_text(json.loads(starter("notebook.json", words))),
        beside: starter("module.txt", words),
        test: starter("test.txt", words),
        ledger: (before + starter("published.toml", words)).lstrip("\n"),
    }
    if create:
        about = {**words, "title": topic.replace("_", " ").capitalize()}
        written[paths.data(topic, "paper.toml")] = starter("paper.toml", about)
        written[paths.data(topic, "choices.toml")] = starter("choices.toml", words)
    for file, text in written.items():
        replace_file(file, text.encode())
    return [file.relative_to(paths.root()).as_posix() for file in written]


def words_of(topic: str, name: str) -> dict[str, str]:
    """What stands in the templates of a result."""
    key = name.partition("-")[2]
    return {
        "topic": topic,
        "name": name,
        "key": key,
        "module": key.replace("-", "_"),
        "title": key.replace("-", " ").capitalize(),
    }


def _require_new_topic(topic: str) -> None:
    if not re.fullmatch(r"[a-z][a-z0-9_]*", topic) or iskeyword(topic):
        raise InputError(f"topic is {topic!r}; give small letters, digits and _, as Python's modules have")
    if paths.is_topic(topic):
        raise InputError(f"the topic {topic} is there already; leave out --create")


def starter(name: str, words: dict[str, str]) -> str:
    """A file of the worked example with `words` in their places, ``{{ word }}``."""
    text = (STARTER / name).read_text(encoding="utf-8")
    return re.sub(r"\{\{ (\w+) \}\}", lambda found: words[found[1]], text)
