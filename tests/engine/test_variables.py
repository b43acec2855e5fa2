"""No variable of the environment changes a build unseen: each is pinned, cleared, an input, or passed with a reason."""

import json
import subprocess

import pytest

from engine.toy import cell
from workbook.inputs import environment_inputs
from workbook.pinned import environment, pins, settings, treatment, variables


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


# What a switch, a number, a path or a name may be; where Python or the driver itself would not start with it, another.
ODD = {
    "PYTHONIOENCODING": "latin-1",
    "PYTHONWARNINGS": "always",
    "PYTHONMALLOC": "debug",
    "PYTHONSTARTUP": "{root}/startup.py",
    "PYTHONHASHSEED": "7",
    "PYTHONOPTIMIZE": "2",
    "MPLBACKEND": "svg",
    "MPLCONFIGDIR": "/proc/none",
    "MATPLOTLIBRC": "{root}/matplotlibrc",
    "IPYTHONDIR": "/proc/none",
    "JUPYTER_CONFIG_DIR": "/proc/none",
    "JUPYTER_RUNTIME_DIR": "/proc/none",
    "NBFORMAT_VALIDATOR": "jsonschema",
    "NUMBA_CPU_NAME": "generic",
    "OPENBLAS_CORETYPE": "Prescott",
    "OMP_NUM_THREADS": "2",
    "NPY_PROMOTION_STATE": "legacy",
    "TZ": "Asia/Kathmandu",
    "LC_ALL": "de_DE.ISO-8859-1",
    "COLUMNS": "30",
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
def test_a_build_under_odd_variables_gives_the_same_bytes(toy):
    """All at once: one build for all variables of the table, of which the last cell shows that none arrives."""
    toy.add_page("motion/01-odd")
    file = toy.root / "notebooks/motion/01-odd.ipynb"
    whole = json.loads(file.read_text())
    odd = {f"{start}X" if start.endswith("_") else start: "1" for start in variables()["cleared"]}
    odd |= dict.fromkeys(pins(), "1") | ODD
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
        around |= variables_now | ({"HOME": "/proc"} if variables_now else {})
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
