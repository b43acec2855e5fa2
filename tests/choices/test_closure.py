"""What a study's digest follows, and what it does not."""

import subprocess
import sys

import pytest

from workbook.choices.closure import modules

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


def test_all_that_is_imported_anywhere_is_followed(package):
    inside = "study plain near inside lazy deep deep.down far".split()
    assert set(modules("work.study")) == {"work", "other", *(f"work.{name}" for name in inside)}


def test_it_holds_what_python_imports():
    """Of the library, every module that importing one loads."""
    name = "workbook.choices.judging"
    script = f"import sys, {name}\nprint(*[m for m in sys.modules if m.split('.')[0] in ('stillwork', 'workbook')])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= set(modules(name))


@pytest.mark.parametrize(
    ("file", "moves"),
    [
        ("lib/plain.py", True),
        ("lib/commented.py", False),
        ("lib/apart.py", False),
        ("data/motion/rig.toml", True),
        ("data/motion/deep/record.csv", True),
        ("data/motion/published.toml", False),
        ("data/motion/choices.toml", False),
        ("data/motion/choices.csv", False),
        ("data/isolation/rig.toml", False),
    ],
)
def test_the_digest_moves_with_code_and_data_and_nothing_else(tmp_path, file, moves):
    for name in ("lib/plain.py", "lib/apart.py", "data/motion/rig.toml", "data/motion/deep/record.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n")
    (tmp_path / "lib/commented.py").write_text('"""Of words."""\n\n\n2  # alone\n')
    (tmp_path / "lib/study.py").write_text("import plain, commented\n")
    before = digest(tmp_path)
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text("2\n")
    assert (digest(tmp_path) != before) == moves


def digest(root):
    """Without the memory that a process keeps."""
    from workbook.choices import closure

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STILLWORK_ROOT", str(root))
        patch.syspath_prepend(root / "lib")
        for kept in (closure.study_digest, closure.syntax_tree, closure.code_of):
            kept.cache_clear()
        return closure.study_digest("study:f", "motion")
