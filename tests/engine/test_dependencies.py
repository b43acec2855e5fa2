"""What results depend on: the modules that some code leads to, the data that these name, the packages that they load."""

import subprocess
import sys

import pytest

from workbook import dependencies
from workbook.checks import InputError

FILES = {
    "work/__init__.py": "_NAMES = {'lazy': ('Late', 'later'), 'unused': ('Never',)}\n\n\ndef __getattr__(name): ...\n",
    "work/study.py": "import numpy\nfrom work import Late, plain\nfrom . import near\nfrom .deep.down import thing\n",
    "work/plain.py": "def f():\n    from work.inside import g\n",
    "work/near.py": "",
    "work/inside.py": "import work.study\n",  # a circle
    "work/lazy.py": "import other\n",
    "work/unused.py": "",
    "work/deep/__init__.py": "",
    "work/deep/down.py": "from .. import far\nthing = 1\n",
    "work/far.py": "",
    "work/apart.py": "",
    "other.py": "",
}


@pytest.fixture
def package(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def modules(*names, code=""):
    dependencies.look_again()
    return set(dependencies.closure([code], names))


INSIDE = {
    "work",
    "other",
    *(f"work.{name}" for name in "study plain near inside lazy deep deep.down far".split()),
}


def test_all_that_is_imported_anywhere_is_followed(package):
    assert modules("work.study") == INSIDE
    assert modules(code="from work.study import thing") == INSIDE
    assert modules(code="import work as w\nw.Late()") == {"work", "work.lazy", "other"}
    with pytest.raises(InputError, match=r"'work\.none'"):
        modules("work.none")


def test_it_holds_what_python_imports():
    """Of the library, every module that importing one loads."""
    name = "workbook.choices.judging"
    script = f"import sys, {name}\nprint(*[m for m in sys.modules if m.split('.')[0] in ('stillwork', 'workbook')])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= modules(name)


CHOSEN = "from workbook import paths\nfile = paths.data('motion', 'rig.toml')\n"


@pytest.mark.parametrize(
    ("file", "moves"),
    [
        ("lib/plain.py", True),
        ("lib/commented.py", False),
        ("lib/apart.py", False),
        ("lib/plain.txt", True),
        ("data/motion/rig.toml", True),
        ("data/motion/other.toml", False),
        ("data/isolation/deep/record.csv", True),
        ("data/isolation/record.csv", False),
        ("data/budget/any/record.csv", True),
        ("data/budget/published.toml", False),
        ("data/budget/choices.csv", False),
    ],
)
def test_the_digests_move_with_code_and_named_data_and_nothing_else(tmp_path, monkeypatch, file, moves):
    texts = {
        "lib/study.py": CHOSEN + "import plain, commented\n",
        "lib/plain.py": "from workbook import paths\ndef f(name): paths.data('isolation', 'deep/record.csv')\n"
        "def g(name): return paths.data('budget', f'{name}.toml')\nNAME = __file__, 'plain.txt'\n",
        "lib/commented.py": '"""Of words."""\n\n\n2  # alone\n',
        "data/motion/rig.toml": "1\n",
        "data/isolation/deep/record.csv": "1\n",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))

    def found():
        dependencies.look_again()
        return dependencies.dependencies(modules=["study"])

    before = found()
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text(
        (texts.get(file, "") + "3\n") if file != "lib/commented.py" else '"""More words."""\n2'
    )
    assert (found() != before) == moves


def test_packages_are_those_that_are_imported_and_what_they_require():
    found = dependencies.packages(["import scipy.signal"])
    assert {"scipy", "numpy", "ipykernel"} <= found
    assert not {"ruff", "pytest", "nbval", "mypy"} & found
    assert "scikit-learn" in dependencies.packages(["from sklearn.svm import SVC"])
