"""Forked kernels: each a process of its own, that ends when it should, and tells how; and the settings they run under."""

import os
import signal
import sys

import psutil
import pytest

from engine.toy import until
from workbook.kernels import ForkedKernel, kernel_environment, stop, warmed
from workbook.pinned import environment, pins, settings

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no kernel is forked")


@pytest.fixture(scope="module")
def forks():
    with warmed(True) as there:
        yield there


def begin(folder, **more):
    """A kernel that waits for a front end."""
    folder.mkdir(exist_ok=True)
    variables = kernel_environment(folder, folder / "output") | more
    kernel = ForkedKernel(str(folder / "connection.json"), variables, str(folder))
    until((folder / "connection.json").exists)
    return kernel


@on_linux
@pytest.mark.slow
def test_a_kernel_leads_a_group_of_its_own_where_it_was_sent(forks, tmp_path):
    first, second = kernels = [begin(tmp_path / name, MARK=name) for name in "ab"]
    for name, kernel in zip("ab", kernels, strict=True):
        process = psutil.Process(kernel.pid)
        until(lambda pid=kernel.pid: os.getpgid(pid) == pid)
        assert process.cwd() == str(tmp_path / name)
        assert process.num_fds() < 100
        assert kernel.poll() is None
    os.killpg(first.pid, signal.SIGKILL)
    assert first.wait(300) == -signal.SIGKILL
    assert second.poll() is None
    second.terminate()
    assert second.wait(300) != 0
    assert not psutil.pid_exists(second.pid)


@on_linux
@pytest.mark.slow
def test_only_what_is_slow_to_import_is_there_before_the_fork(forks, tmp_path):
    """Else a change of the library between two kernels of a build would go unseen."""
    kernel = begin(tmp_path / "kernel")
    parent = psutil.Process(kernel.pid).parent()
    with open(f"/proc/{parent.pid}/maps", encoding="utf-8") as maps:
        assert "numpy" in maps.read()
    variables = parent.environ()
    assert {name: variables[name] for name in settings()} == settings()
    kernel.kill()
    assert kernel.wait(300) == -signal.SIGKILL


def test_no_kernel_is_forked_where_that_is_not_wanted():
    with warmed(False) as forks:
        assert not forks
    stop("no build")


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
    assert settings() != pins()
