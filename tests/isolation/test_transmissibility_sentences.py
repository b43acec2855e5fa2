"""The sentences of a page follow a parameter that moves: no number in them is typed, and their sense is that of the run."""

import re

import pytest

from workbook import paths
from workbook.choices.notebook_study import code_cells

NAME = "isolation/04-transmissibility"


def run(monkeypatch, folder, **settings):
    """The page after its cells up to the explorer, run with other parameters."""
    monkeypatch.setenv(paths.OUTPUT_VARIABLE, str(folder))
    names = {}
    for source, declares in code_cells(NAME):
        exec(compile(source, NAME, "exec"), names)
        if declares:
            names |= settings
    return names["page"]


@pytest.mark.slow
def test_the_sentences_have_the_numbers_of_the_run_with_another_floor(monkeypatch, tmp_path):
    quick = {"felms_s": 40.0, "record_s": 20.0}
    wide, narrow = (
        run(monkeypatch, tmp_path / str(corner), **quick, low_pass_hz=corner) for corner in (1500.0, 80.0)
    )
    said = []
    for page in (wide, narrow):
        ours = {claim.entry.id: claim.ours for claim in page.claims.claims}
        first = page.conclusions[0]
        assert first.endswith("(published: 3 to 200).")  # neither end agrees
        low, high = map(float, re.findall(r"[\d.]+", first)[1:3])
        assert (low, high) == (
            round(ours["isolation.fig-7.lower-end"]),
            round(ours["isolation.fig-7.upper-end"]),
        )
        share = ours["isolation.fig-7.integrators-leave"]
        assert f"leave {100 * share:.0f} % at 3 Hz" in page.conclusions[4]
        said.append(page.conclusions)
    assert len(said[0]) == len(said[1]) == 6
    assert said[0][0] != said[1][0]
