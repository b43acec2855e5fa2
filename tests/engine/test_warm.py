"""The warmed process: kernels of their own, that end when they should, and tell how."""

import json
import os
import signal
import sys

import psutil
import pytest

from engine.toy import until
from workbook.pinned import environment, pins, settings
from workbook.warm import ForkServer, warmed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no kernel is forked"),
]


@pytest.fixture(scope="module")
def warm():
    process = ForkServer()
    yield process
    process.close()


def fork(warm, folder, *options: str):
    variables = environment() | {"STILLWORK_ROOT": str(folder), "MARK": "mine"}
    return warm.fork([str(folder / "log"), *options], variables, str(folder))


def begin(warm, folder):
    """A kernel that waits for a front end."""
    kernel = fork(warm, folder, "-f", str(folder / "connection.json"))
    until((folder / "connection.json").exists)
    return kernel


def test_a_kernel_that_ends_tells_its_exit_code(warm, tmp_path):
    assert fork(warm, tmp_path, "--version").wait(60) == 0
    assert fork(warm, tmp_path, "--IPKernelApp.nonsense").wait(60) > 0


def test_a_kernel_leads_a_group_of_its_own_where_it_was_sent(warm, tmp_path):
    kernels = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        kernels.append(begin(warm, tmp_path / name))
    for name, kernel in zip("ab", kernels, strict=True):
        assert os.getpgid(kernel.pid) == kernel.pid
        assert psutil.Process(kernel.pid).cwd() == str(tmp_path / name)
        assert psutil.Process(kernel.pid).num_fds() < 100
        assert kernel.poll() is None
    os.killpg(kernels[0].pid, signal.SIGKILL)
    assert kernels[0].wait(60) == -signal.SIGKILL
    assert kernels[1].poll() is None
    kernels[1].terminate()
    assert kernels[1].wait(60) != 0


def test_all_kernels_end_with_the_process_that_they_were_forked_from(tmp_path):
    with warmed(True) as process:
        kernel = begin(process, tmp_path)
    until(lambda: not psutil.pid_exists(kernel.pid))
    assert kernel.poll() == -signal.SIGKILL


def test_a_warmed_process_that_is_killed_is_an_error_and_no_stall(tmp_path):
    with warmed(True) as process:
        kernel = begin(process, tmp_path)
        process._process.kill()
        until(lambda: kernel.poll() is not None)
        until(lambda: not psutil.pid_exists(kernel.pid))
        with pytest.raises(RuntimeError, match="ended"):
            fork(process, tmp_path, "--version")


def test_nothing_of_the_workbook_is_imported_before_the_fork(warm, tmp_path):
    """Else a change of the library between two kernels of a build would go unseen."""
    begin(warm, tmp_path).kill()
    assert "stillwork" not in (tmp_path / "log").read_text()
    with open(f"/proc/{warm._process.pid}/maps", encoding="utf-8") as maps:
        assert "numpy" in maps.read()


def test_it_is_not_there_where_it_is_not_wanted():
    with warmed(False) as process:
        assert process is None


def test_the_settings_of_another_processor_stand_in_for_the_pins(monkeypatch):
    monkeypatch.setenv(
        "STILLWORK_PROCESSOR", "OPENBLAS_CORETYPE=Zen NPY_DISABLE_CPU_FEATURES= NUMBA_CPU_NAME=generic"
    )
    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "AVX512_SPR")
    now = environment()
    assert now["OPENBLAS_CORETYPE"] == "Zen"
    assert now["NUMBA_CPU_NAME"] == "generic"
    assert "NPY_DISABLE_CPU_FEATURES" not in now
    assert now["OMP_NUM_THREADS"] == pins()["OMP_NUM_THREADS"] == "1"
    assert json.dumps(settings()) != json.dumps(pins())
