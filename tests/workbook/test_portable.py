"""Which notebooks are built under which stand-ins, and what is told; the builds themselves are left out."""

import pytest

from stillwork.base.checks import InputError
from stillwork.workbook import portable as module
from stillwork.workbook.compare import Comparison
from stillwork.workbook.notebooks import select


@pytest.fixture
def built(monkeypatch):
    """What would be built, by stand-in; every result agrees but that of motion/02 under the oldest processor."""
    asked = {}

    def build(processor, names):
        asked[processor.name] = names
        apart = ("fig-2-3.png",) if processor.name.startswith("2004") else ()
        found = [
            Comparison(name, 3, 1e-9, apart * (name == "motion/02-model-reduction"), (), (), ())
            for name in names
        ]
        return found, True

    monkeypatch.setattr(module, "_build", build)
    monkeypatch.setattr(module, "_flags", lambda: {"avx", "avx2", "fma"})
    return asked


def test_all_stand_ins_that_this_machine_can_be_build_everything(built, capsys):
    assert module.portable() == 1
    assert len(built) == len(module.PROCESSORS) - 1
    assert {len(names) for names in built.values()} == {len(select())}
    told = capsys.readouterr().out
    assert "Skylake-X)" in told and "lacks avx512f" in told
    assert (
        "2004, SSE2 alone: motion/02-model-reduction: fig-2-3.png" in told and "5 of 6 stand-ins ran" in told
    )


def test_a_sample_is_a_few_notebooks_under_two_processors(built):
    assert module.portable(sample=True) == 0
    assert built == dict.fromkeys(module.SAMPLED, tuple(each.name for each in select(*module.SAMPLE)))


def test_notebooks_and_a_processor_are_chosen_by_name(built):
    assert module.portable(["motion/02-model-reduction", "worstcase"], processor="2013") == 0
    ((processor, names),) = built.items()
    assert "Haswell" in processor and names == tuple(
        each.name for each in select("motion/02-model-reduction", "worstcase")
    )


@pytest.mark.parametrize("wrong", [{"processor": "2025"}, {"targets": ["motion/99"]}])
def test_what_is_not_there_is_refused_before_anything_is_built(built, wrong):
    with pytest.raises(InputError, match=r"2004, SSE2 alone; 2011|there is no notebook or room"):
        module.portable(**wrong)
    assert not built


def test_a_stand_in_that_does_not_run_here_is_no_agreement(built, capsys):
    assert module.portable(processor="Skylake") == 1
    assert "0 of 1 stand-ins ran: nothing was compared" in capsys.readouterr().out and not built
