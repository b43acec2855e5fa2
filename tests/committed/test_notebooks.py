"""Notebooks as they are committed: executed, clean, and in the form that the runner relies on."""

import ast
import json
import re

import pytest

from stillwork.base import paths
from stillwork.workbook.notebooks import notebook_text, select

NOTEBOOKS = select()
FORBIDDEN = ("image/png", "text/html", "papermill", "injected-parameters", "widget-view", str(paths.root()))


def cells(notebook, kind="code"):
    return [cell for cell in json.loads(notebook.source)["cells"] if cell["cell_type"] == kind]


def text(cell) -> str:
    return "".join(cell["source"])


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.name)
class TestNotebook:
    def test_was_accepted_with_clean_text_outputs(self, notebook):
        code = cells(notebook)
        assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1)), (
            "run `make accept`"
        )
        outputs = [output for cell in code for output in cell["outputs"]]
        assert outputs
        for output in outputs:
            assert output["output_type"] != "error"
            assert output.get("name") != "stderr", output
        dumped = json.dumps(outputs) + json.dumps([cell["metadata"] for cell in code])
        assert not [word for word in FORBIDDEN if word in dumped]

    def test_its_page_is_named_after_its_file(self, notebook):
        named = re.findall(r"Page\(['\"](.+?)['\"]\)", "\n".join(map(text, cells(notebook))))
        assert named == [notebook.name]

    def test_begins_with_a_title_and_ends_with_words(self, notebook):
        every = json.loads(notebook.source)["cells"]
        assert text(every[0]).startswith("# ")
        assert every[-1]["cell_type"] == "markdown"

    def test_every_parameter_has_a_comment(self, notebook):
        assert notebook.parameters
        [cell] = [c for c in cells(notebook) if "parameters" in c["metadata"].get("tags", [])]
        lines = text(cell).splitlines()
        last = {node.target.id: lines[node.end_lineno - 1] for node in ast.parse(text(cell)).body}
        assert not [line for line in last.values() if not re.search(r"#\s*\S", line)]

    def test_a_cell_is_read_at_a_glance(self, notebook):
        """None is empty, and none but the list of parameters has more lines than fit on a screen beside its figure."""
        own = [c for c in cells(notebook) if "parameters" not in c["metadata"].get("tags", [])]
        assert not [cell["id"] for cell in own if not 1 <= len(text(cell).splitlines()) <= 25]

    def test_defines_no_algorithm(self, notebook):
        for cell in cells(notebook):
            for node in ast.walk(ast.parse(text(cell))):
                assert not isinstance(node, ast.FunctionDef | ast.ClassDef), text(cell)

    def test_no_cell_hides_its_value_with_a_semicolon(self, notebook):
        # nbval runs cells outside the history, where IPython looks for it: the value would appear there
        assert not [text(cell) for cell in cells(notebook) if text(cell).rstrip().endswith(";")]

    def test_cell_ids_are_names(self, notebook):
        ids = [cell["id"] for cell in json.loads(notebook.source)["cells"]]
        assert len(set(ids)) == len(ids)
        assert not [each for each in ids if re.fullmatch(r"[0-9a-f-]{8,}", each)]

    def test_its_file_is_the_one_that_accept_writes(self, notebook):
        assert notebook.source == notebook_text(json.loads(notebook.source)), "run `make accept`"
