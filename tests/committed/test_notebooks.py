"""Notebooks as they are committed: executed, clean, and in the form that the runner relies on."""

import ast
import json
import re
import tomllib

import pytest

from workbook import paths
from workbook.choices.axes import load_axes
from workbook.claims import load_entries
from workbook.compare import cells_apart
from workbook.notebooks import PICTURES, notebook_text, select
from workbook.site.explorers import statements
from workbook.site.metadata import papers
from workbook.tasks import Task

NOTEBOOKS = select()
FORBIDDEN = ("papermill", "injected-parameters", "widget-view", str(paths.root()))


def cells(notebook, kind="code"):
    return [cell for cell in json.loads(notebook.source)["cells"] if cell["cell_type"] == kind]


def text(cell) -> str:
    return "".join(cell["source"])


def test_there_are_notebooks_and_their_pictures_are_small():
    assert NOTEBOOKS
    every = [output for each in NOTEBOOKS for cell in cells(each) for output in cell["outputs"]]
    assert sum(len(output.get("data", {}).get("image/png", "")) for output in every) < 10e6


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.name)
class TestNotebook:
    def test_was_accepted_with_clean_text_outputs(self, notebook):
        code = [cell for cell in cells(notebook) if text(cell)]  # an empty one is not executed
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
        assert dumped.count("image/png") <= PICTURES

    def test_a_fresh_run_prints_what_is_committed(self, notebook):
        assert cells_apart(Task(notebook, {}, {})) == []

    def test_its_page_is_named_after_its_file(self, notebook):
        named = re.findall(r"Page\(['\"](.+?)['\"]\)", "\n".join(map(text, cells(notebook))))
        assert named == [notebook.name]

    def test_begins_with_a_title(self, notebook):
        assert text(json.loads(notebook.source)["cells"][0]).startswith("# ")

    def test_every_parameter_has_a_comment(self, notebook):
        assert notebook.parameters
        [cell] = [c for c in cells(notebook) if "parameters" in c["metadata"].get("tags", [])]
        lines = text(cell).splitlines()
        last = {node.target.id: lines[node.end_lineno - 1] for node in ast.parse(text(cell)).body}
        assert not [line for line in last.values() if not re.search(r"#\s*\S", line)]

    def test_no_cell_hides_its_value_with_a_semicolon(self, notebook):
        # nbval runs cells outside the history, where IPython looks for it: the value would appear there
        hiding = [text(cell) for cell in cells(notebook) if text(cell).rstrip().endswith(";")]
        assert hiding == [], "assign the value to a name instead"

    def test_a_conclusion_shows_a_value_or_rests_on_a_condition(self, notebook):
        calls = [
            node
            for node in ast.walk(ast.Module(statements(notebook.source), []))
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "page.conclude"
        ]
        assert not [ast.unparse(call)[:80] for call in calls if not call.keywords], "write it in Markdown"

    def test_its_file_is_the_one_that_accept_writes(self, notebook):
        assert notebook.source == notebook_text(json.loads(notebook.source)), "run `make accept`"


def printed_starts() -> list[tuple[str, str, float, str]]:
    """Of every explorer's control that calls its start printed: notebook, control, start, and place."""
    found = []
    for notebook in select():
        for node in ast.walk(ast.Module(statements(notebook.source), [])):
            if isinstance(node, ast.keyword) and isinstance(call := node.value, ast.Call):
                given = {
                    each.arg: each.value.value
                    for each in call.keywords
                    if isinstance(each.value, ast.Constant)
                }
                if given.get("basis") == "printed":
                    start = printed_start(call)
                    found.append((notebook.name, str(node.arg), start, str(given["place"])))
    return found


def printed_start(call: ast.Call) -> float:
    """The number at which a `Slider` or a `Choice` starts; of one in decades that of which it is the logarithm."""
    kind = ast.unparse(call.func)
    named = {each.arg: each.value for each in call.keywords}
    start = ast.literal_eval(named.get("start") or call.args[1 if kind == "Choice" else 2])
    if kind == "Choice":
        return numbers_in(start)[0]
    unit = ast.literal_eval(named.get("unit") or (call.args[3] if len(call.args) > 3 else ast.Constant("")))
    return float(f"1e{start:g}") if unit.startswith("log10") else start


def is_printed(topic: str, start: float, place: str) -> bool:
    """Whether the ledger, an open choice, the settings of the paper or of a machine have this number from this place."""
    if any(each.published == start and each.place.startswith(place) for each in load_entries(topic).values()):
        return True
    if start in papers()[topic]["printed"].get(place, []):
        return True
    if any(
        place in each.source and start in numbers_in(each.source) for each in load_axes(topic)[0].values()
    ):
        return True
    for file in paths.data(topic, "").glob("*.toml"):
        published = tomllib.loads(file.read_text("utf-8")).get("published")
        if isinstance(published, dict) and start in published.values() and place in file.read_text("utf-8"):
            return True
    return False


def numbers_in(words: str) -> list[float]:
    return [float(each) for each in re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]\w)", words)]


def test_what_a_slider_calls_printed_is_what_the_ledger_or_the_settings_have_from_that_place():
    wrong = []
    for notebook, control, start, place in printed_starts():
        if not is_printed(notebook.partition("/")[0], start, place):
            wrong.append(f"{notebook}: {control} starts at {start:g}, which {place} does not print")
    assert wrong == []


def test_another_number_from_the_same_place_is_not_printed():
    for notebook, _, start, place in printed_starts():
        assert not is_printed(notebook.partition("/")[0], 1.03 * start, place)
