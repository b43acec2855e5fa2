"""Which notebooks are built under which processors, and what is printed; the builds themselves are left out."""

import os
import signal
import subprocess
import sys
import time

import pytest

from engine.toy import set_signals
from stillwork.base.checks import InputError
from workbook import portable as module
from workbook.compare import Comparison
from workbook.notebooks import select

BUILD = module._build


@pytest.fixture
def built(monkeypatch):
    """What would be built, by processor; every result agrees but that of motion/02 under the oldest processor."""
    asked = {}

    def build(processor, names):
        asked[processor.name] = names
        apart = ("fig-2-3.png",) if processor.name.startswith("2004") else ()
        found = [
            Comparison(name, 3, 1e-9, apart * (name == "motion/02-model-reduction"), (), (), (), ())
            for name in names
        ]
        return found, 0

    monkeypatch.setattr(module, "_build", build)
    monkeypatch.setattr(module, "_flags", lambda: {"avx", "avx2", "fma"})
    return asked


@pytest.mark.slow
def test_all_stand_ins_that_this_machine_can_be_build_everything(built, capsys):
    assert module.portable() == 1
    assert len(built) == len(module.PROCESSORS) - 1
    assert {len(names) for names in built.values()} == {len(select())}
    told = capsys.readouterr().out
    assert "Skylake-X)" in told and "lacks avx512f" in told
    assert (
        "2004, SSE2 alone: motion/02-model-reduction: fig-2-3.png" in told and "5 of 6 processors ran" in told
    )


def test_a_sample_is_a_few_notebooks_under_two_processors(built):
    assert module.portable(sample=True) == 0
    assert module.sampled() and built == dict.fromkeys(
        module.SAMPLED, tuple(each.name for each in select(*module.sampled()))
    )


def test_notebooks_and_a_processor_are_chosen_by_name(built):
    assert module.portable(["motion/02-model-reduction", "worstcase"], processor="2013") == 0
    ((processor, names),) = built.items()
    assert "Haswell" in processor and names == tuple(
        each.name for each in select("motion/02-model-reduction", "worstcase")
    )


@pytest.mark.parametrize("wrong", [{"processor": "2025"}, {"targets": ["motion/99"]}])
def test_what_is_not_there_is_refused_before_anything_is_built(built, wrong):
    with pytest.raises(InputError, match=r"2004, SSE2|'motion/99'"):
        module.portable(**wrong)
    assert not built


def test_a_stand_in_that_does_not_run_here_is_no_agreement(built, capsys):
    assert module.portable(processor="Skylake") == 1
    assert "0 of 1 processors ran: nothing was compared" in capsys.readouterr().out and not built


# Tidies for longer than a Ctrl-C is usually given, and notes which interrupts came.
TIDY = """
import pathlib, signal, sys, time
came = []
for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(each, lambda number, _: came.append(number))
pathlib.Path("begun").touch()
print("as it comes", flush=True)
while not came:
    time.sleep(0.01)
time.sleep(1)
pathlib.Path("tidied").write_text(repr([int(each) for each in came]))
"""
RUN = f"""
import sys
from workbook.lock import run_whole
sys.exit(run_whole([sys.executable, "-c", {TIDY!r}]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_build_that_is_interrupted_tidies_up_and_is_told_once(tmp_path, number):
    process = subprocess.Popen(
        [sys.executable, "-c", RUN],
        cwd=tmp_path,
        start_new_session=True,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=set_signals,
    )
    while not (tmp_path / "begun").exists():
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, number)  # as a terminal does
    assert process.communicate() == ("as it comes\n", None)
    assert process.returncode == 128 + number
    assert (tmp_path / "tidied").read_text() == repr([int(number)])


def test_nothing_is_built_or_compared_after_an_interrupt(built, monkeypatch, capsys):
    begun = []
    monkeypatch.setattr(module, "run_whole", lambda command, env: begun.append(command) or 128 + 15)
    monkeypatch.setattr(module, "_build", BUILD)
    assert module.portable(["motion/02-model-reduction"]) == 128 + 15
    assert len(begun) == 1
    assert "processors ran" not in capsys.readouterr().out
