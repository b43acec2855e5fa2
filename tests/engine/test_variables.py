"""No variable of the environment changes a build unseen: each is pinned, cleared, an input, or passed with a reason."""

import importlib.util
import json
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

from engine.toy import cell
from workbook.inputs import environment_inputs
from workbook.pinned import environment, pins, settings, treatment, variables

READERS = """numba llvmlite numpy scipy matplotlib pandas control PIL cvxpy jaxtyping IPython ipykernel ipywidgets
comm jupyter_client jupyter_core traitlets nbclient nbformat zmq tornado papermill debugpy""".split()
# Parts that build extensions, test the package, or serve another system; and programs that we do not start.
OTHERS = re.compile(
    r"/(tests?|testing|distutils|f2py|_build_utils|conftest\.py|_vendored|cuda|vendored)(/|$)"
)
READ = re.compile(
    r"(?:environ(?:\.get|\.pop|\.setdefault)?|getenv|_readenv|_getenv|_env)\s*[\[(]\s*['\"](\w+)['\"]"
    r"|['\"](\w+)['\"]\s+(?:not\s+)?in\s+(?:os\.)?environ"
)
LIBRARIES = ("libscipy_openblas*", "libopenblas*", "libgfortran*", "libgomp*")
NAMES = re.compile(rb"\0((?:OPENBLAS|GOTO|OMP|GOMP|GFORTRAN|MKL|BLIS|KMP)_[A-Z0-9_]+)\0")

# Passed without a line of the table: who reads them, and why they move nothing.
HARMLESS = {
    "other systems": {"APPDATA", "LOCALAPPDATA", "PROGRAMDATA", "WINDIR", "PROCESSOR_ARCHITECTURE", "pathext"}
    | {"PROCESSOR_ARCHITEW6432", "QT_MAC_WANTS_LAYER", "VS_PROFILER"},
    "a window, which no kernel opens": {"DISPLAY", "WAYLAND_DISPLAY", "TERM"},
    "programs that a person starts": {"EDITOR", "PAGER", "LESS", "SHELL", "USER"},
    "paths of Jupyter's settings, which kernels are not given": {
        "CONDA_PREFIX",
        "CONDA_DEFAULT_ENV",
        "VIRTUAL_ENV",
    },
    "a graphics processor, which nothing uses": {"CUDA_PATH"},
    "tests of the packages, and no variables": {"PYTEST_CURRENT_TEST", "ASYNC_TEST_TIMEOUT", "FOO"}
    | {"__autoreload_class__"},
    "clouds and web servers": {"BOTO3_ENDPOINT_URL", "GITHUB_ACCESS_TOKEN", "CONTENT_LENGTH", "CONTENT_TYPE"}
    | {"HTTP_", "TORNADO_EXTENSION", "TORNADO_NO_EXTENSION"},
}


@cache
def names_read() -> dict[str, set[str]]:
    """Variables that the installed packages and their libraries read, each with the packages."""
    found: dict[str, set[str]] = {}
    for package in READERS:
        folder = Path(importlib.util.find_spec(package).origin).parent
        for file in folder.rglob("*.py"):
            if not OTHERS.search(f"/{file.relative_to(folder).as_posix()}"):
                text = file.read_text(encoding="utf-8", errors="replace")
                for one, other in READ.findall(text) if "env" in text else ():
                    found.setdefault(one or other, set()).add(package)
    packages = Path(importlib.util.find_spec("numpy").origin).parents[1]
    for library in LIBRARIES:
        for file in packages.glob(f"*.libs/{library}"):
            for name in NAMES.findall(file.read_bytes()):
                found.setdefault(name.decode(), set()).add(library.rstrip("*"))
    return found


def has_line(name: str) -> bool:
    return name in pins() or any(name.startswith(start) for named in variables().values() for start in named)


@pytest.mark.slow
def test_every_variable_that_the_packages_read_has_its_line():
    known = set().union(*HARMLESS.values())
    found = names_read()
    assert len(found) > 150
    assert {name: found[name] for name in found if not has_line(name) and name not in known} == {}
    assert known <= found.keys()  # else it goes


def test_what_is_cleared_is_not_there_and_the_rest_is_as_the_table_says(monkeypatch):
    for name in ("NUMBA_CPU_NAME", "NUMBA_", "OMP_DISPLAY_ENV", "PYTHONSTARTUP", "LC_ALL", "MATPLOTLIBRC"):
        monkeypatch.setenv(name, "odd")
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH", "LD_PRELOAD", "LABORATORY", "HOME"):
        monkeypatch.setenv(name, "mine")
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    now = environment()
    assert "odd" not in now.values()
    assert sorted(name for name in now if now[name] == "mine") == sorted(
        ("PYTHONPATH", "LD_LIBRARY_PATH", "LD_PRELOAD", "LABORATORY", "HOME")
    )
    assert settings().items() <= now.items()
    assert environment_inputs()["setting LD_PRELOAD"] == "mine"
    monkeypatch.delenv("LD_PRELOAD")
    assert "setting LD_PRELOAD" not in environment_inputs()


def test_each_reason_stands_in_the_table_once():
    everything = [start for named in variables().values() for start in named]
    assert len(everything) == len(set(everything))
    assert all(reason.strip() for named in variables().values() for reason in named.values())
    for start in variables()["cleared"]:
        assert treatment(f"{start}ODD") == "cleared"


# What a switch, a number, a path or a name may be; where Python or the driver itself would not start with it, another.
ODD = {
    "PYTHONIOENCODING": "latin-1",
    "PYTHONWARNINGS": "always",
    "PYTHONMALLOC": "debug",
    "PYTHONSTARTUP": "{root}/startup.py",
    "PYTHONHASHSEED": "7",
    "PYTHONINTMAXSTRDIGITS": "640",
    "PYTHONOPTIMIZE": "2",
    "MPLBACKEND": "svg",
    "MPLCONFIGDIR": "/proc/none",
    "MATPLOTLIBRC": "{root}/matplotlibrc",
    "IPYTHONDIR": "/proc/none",
    "JUPYTER_CONFIG_DIR": "/proc/none",
    "JUPYTER_RUNTIME_DIR": "/proc/none",
    "NBFORMAT_VALIDATOR": "jsonschema",
    "PYZMQ_BACKEND": "cython",
    "NUMBA_CPU_NAME": "generic",
    "OPENBLAS_CORETYPE": "Prescott",
    "OPENBLAS_VERBOSE": "2",
    "OMP_DISPLAY_ENV": "VERBOSE",
    "OMP_NUM_THREADS": "2",
    "NPY_PROMOTION_STATE": "legacy",
    "TZ": "Asia/Kathmandu",
    "LC_ALL": "de_DE.ISO-8859-1",
    "LANG": "de_DE.ISO-8859-1",
    "COLUMNS": "30",
    "NO_COLOR": "1",
    "FORCE_COLOR": "1",
}

CELLS = (
    """import hashlib, locale, os, time, warnings
import numpy as np, pandas, scipy.linalg, scipy.optimize
from stillwork.base.kernels import kernel""",
    """matrix = np.random.default_rng(seed).normal(size=(90, 90))
values = [scipy.linalg.eigh(matrix + matrix.T)[0], np.linalg.inv(matrix), np.exp(matrix), matrix @ matrix]
values += [scipy.optimize.minimize(lambda x: ((x - 1) ** 4).sum(), np.zeros(3)).x]
print([hashlib.sha256(each.tobytes()).hexdigest()[:12] for each in values], np.float32(3) + 3.0)""",
    """@kernel
def _total(x):
    total = 0.0
    for value in x:
        total += np.exp(value)
    return total
print(_total(matrix[0]).hex())""",
    """print(pandas.DataFrame(matrix[:2]), time.tzname, time.strftime("%H", time.localtime(0)))
print(locale.getpreferredencoding(), len(set(map(hash, "abc"))), hash("seed"), __debug__)
print([(each[0], each[2].__name__) for each in warnings.filters])""",
    """assert "of_the_user" not in globals()
print(sorted(name for name in os.environ if name in NAMES))""",
)


@pytest.mark.slow
@pytest.mark.parametrize("home", ["/proc", None])
def test_a_build_under_odd_variables_gives_the_same_bytes(toy, home):
    """All at once: one build for two hundred variables, of which the last cell shows that none arrives."""
    toy.add_page("motion/01-odd")
    file = toy.root / "notebooks/motion/01-odd.ipynb"
    whole = json.loads(file.read_text())
    odd = {name: "1" for name in names_read() if treatment(name) in ("cleared", "pinned")} | ODD
    odd = {name: value.format(root=toy.root) for name, value in odd.items()}
    sources = [text.replace("NAMES", repr(sorted(odd))) for text in CELLS]
    whole["cells"] += [cell(f"odd-{number}", source) for number, source in enumerate(sources)]
    toy.write("notebooks/motion/01-odd.ipynb", json.dumps(whole))
    toy.write("startup.py", "of_the_user = 1\n")
    toy.write("matplotlibrc", "lines.linewidth: 9\n")
    command = toy.command("figures", "motion/01-odd", "--force")
    results = []
    for variables_now in ({}, odd):
        around = {name: value for name, value in toy.environment().items() if treatment(name) == "passed"}
        around = {name: value for name, value in around.items() if name != "HOME" or home}
        around |= {**variables_now, **({"HOME": home} if home and variables_now else {})}
        done = subprocess.run(
            command, cwd=toy.root, env=around, capture_output=True, text=True, errors="replace"
        )
        assert done.returncode == 0, done.stdout + done.stderr
        results.append(toy.results())
    outputs = [outputs_of(files["build/figures/motion/01-odd/01-odd.ipynb"]) for files in results]
    assert outputs[0] == outputs[1]
    assert results[0] == results[1]
    assert toy.reasons() == {}


def outputs_of(executed: bytes) -> list:
    return [each.get("outputs") for each in json.loads(executed)["cells"]]
