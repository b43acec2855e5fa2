"""A notebook as a study: what it claims at other parameters, without writing anything."""

import json
from concurrent.futures import ThreadPoolExecutor

import pytest

from choices.toy_work import A, B, axis
from workbook.checks import InputError
from workbook.choices.notebook_study import run_notebook, study_digest
from workbook.choices.running import Journal, run_combinations
from workbook.dependencies import look_again

TOY = "motion/01-toy"
CELLS = [
    (
        "from stillwork.base.rounding import below\nfrom workbook import Page\npage = Page('motion/01-toy')",
        (),
    ),
    ("a: int = 0  # first\nb: int = 0  # second", ("parameters",)),
    ("print('not shown')\npage.check('motion.table-1.sum', a + 2 * b + a * b, (a, a + 9))", ()),
    ("page.check('motion.table-1.product', a * b)\npage.check('motion.order', float(a <= b))", ()),
    ("explore(nothing_of_that_name)", ()),
    ("page.save('picture', None)\npage.claims", ()),
]
ENTRIES = ("motion.table-1.sum", "motion.order")
STUDY = f'\n[studies.toy]\nfunction = "{TOY}"\nentries = ["motion.table-1.sum", "motion.order"]\n'


def write(folder, cells=CELLS, prose="# A toy"):
    made = [
        {"cell_type": "code", "id": f"c{k}", "metadata": {"tags": list(tags)}, "source": source}
        for k, (source, tags) in enumerate(cells)
    ]
    book = {"cells": [{"cell_type": "markdown", "id": "m", "metadata": {}, "source": prose}, *made]}
    file = folder / "notebooks" / f"{TOY}.ipynb"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(book))


def test_a_notebook_gives_what_it_claims_at_other_parameters(workbook, tmp_path, capsys):
    workbook()
    write(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert run_notebook(TOY, ENTRIES, {"a": 2, "b": 1}) == {
        "motion.table-1.sum": (6, (2.0, 11.0)),
        "motion.order": 0.0,
    }
    assert run_notebook(TOY, ENTRIES, {})["motion.order"] == 1.0
    assert sorted(tmp_path.rglob("*")) == before
    assert capsys.readouterr().out == ""


def test_a_parameter_that_it_does_not_have_is_named(workbook, tmp_path):
    workbook()
    write(tmp_path)
    with pytest.raises(InputError, match=r"no parameter 'c'"):
        run_notebook(TOY, ENTRIES, {"c": 1})
    with pytest.raises(InputError, match="no notebook 'motion/02-none'"):
        run_notebook("motion/02-none", ENTRIES, {})


def test_seeds_are_a_parameter_where_an_axis_lists_them(workbook, tmp_path):
    seeds = axis("seed-of-toy", [4, 5], 4, kind="seed")
    _, multiverses = workbook(A + seeds + STUDY)
    source = "page.check('motion.table-1.sum', a + seed)\npage.check('motion.order', 1.0)"
    write(tmp_path, [*CELLS[:1], ("a: int = 0\nseed: int = 4", ("parameters",)), (source, ())])
    (found,) = run_combinations(
        multiverses, lambda: ThreadPoolExecutor(1), Journal(tmp_path / "journal.jsonl")
    )
    assert found.values["motion.table-1.sum"].tolist() == [[a + 4, a + 5] for (a,) in found.design]


def test_its_digest_is_that_of_its_cells_and_of_what_they_import(workbook, tmp_path):
    workbook()

    def digest_of(*change):
        write(tmp_path, *change)
        study_digest.cache_clear()
        look_again()
        return study_digest(TOY)

    first = digest_of()
    assert digest_of(CELLS, "# Other words") == first
    assert digest_of([*CELLS[:2], (CELLS[2][0] + "\n1 + 1", ())]) != first
    assert (
        digest_of([(CELLS[0][0].replace("rounding import below", "checks import shown"), ()), *CELLS[1:]])
        != first
    )


def test_an_axis_file_that_names_no_notebook_of_the_topic_is_refused(workbook):
    with pytest.raises(InputError, match="function is 'other/01-toy'"):
        workbook(A + B + STUDY.replace(TOY, "other/01-toy"))
