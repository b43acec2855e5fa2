"""Metadata for archives: what CITATION.cff, which Zenodo reads, and CODECHECK 2.0 ask for.

The schema of CITATION.cff beside this file is that of the Citation File Format 1.2.0 as its authors publish it
(S. Druskat and others, https://citation-file-format.github.io), under CC BY 4.0. CODECHECK's rules are written
here from its documentation: it gives no schema whose licence lets it be copied.
"""

import json
import re
from datetime import date
from pathlib import Path, PurePosixPath

import jsonschema
import pytest
import yaml

from workbook import paths
from workbook.site import metadata
from workbook.site.metadata import binder, project

CITATION = yaml.safe_load((paths.root() / "CITATION.cff").read_text(encoding="utf-8"))


def test_the_citation_file_keeps_the_schema_of_its_format():
    schema = json.loads(
        (Path(__file__).parent / "citation-file-format-1.2.0.json").read_text(encoding="utf-8")
    )
    citation = json.loads(json.dumps(CITATION, default=date.isoformat))
    jsonschema.validate(citation, schema)
    for harm in ({"licence": "BSD-3-Clause"}, {"date-released": "today"}, {"authors": []}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(citation | harm, schema)


def test_codemeta_says_the_same_as_the_citation_file():
    stated = json.loads((paths.root() / "codemeta.json").read_text(encoding="utf-8"))
    same = {
        "version": CITATION["version"],
        "dateModified": CITATION["date-released"].isoformat(),
        "license": f"https://spdx.org/licenses/{CITATION['license']}",
        "keywords": CITATION["keywords"],
        "name": CITATION["title"].partition(":")[0],
        "description": project()["description"],
    }
    assert {name: stated[name] for name in same} == same
    assert [each["name"] for each in stated["author"]] == [each["name"] for each in CITATION["authors"]]
    required = {re.match(r"[\w-]+", each)[0] for each in project()["dependencies"]}
    assert set(stated["softwareRequirements"]) == required


def test_the_paper_cites_what_its_bibliography_has():
    text = (paths.root() / "paper" / "paper.md").read_text(encoding="utf-8")
    _, head, body = text.split("---\n", 2)
    about = yaml.safe_load(head)
    assert [each["name"] for each in about["authors"]] == [each["name"] for each in project()["authors"]]
    bibliography = (paths.root() / "paper" / about["bibliography"]).read_text(encoding="utf-8")
    cited = set(re.findall(r"@(\w+)", body))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE))
    assert {"Summary", "Statement of need", "State of the field", "References"} <= set(
        re.findall(r"^# (.+)$", body, re.MULTILINE)
    )
    assert len(body.split()) < 1750  # what the journal takes at most


def test_the_workflow_runs_the_commands_of_the_readme():
    workflow = yaml.safe_load((paths.root() / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    commands = [step["run"] for step in job["steps"] if "run" in step]
    readme = (paths.root() / "README.md").read_text(encoding="utf-8")
    shown, *_ = re.findall(r"^```\n(make figures .*?)^```", readme, re.MULTILINE | re.DOTALL)
    typed = [line.partition("#")[0].strip() for line in shown.splitlines()]
    assert commands[: len(typed) - 1] == typed[1:]  # the first builds one figure of the second
    versions = job["strategy"]["matrix"]["python"]
    named = re.search(r"Python (3\.\d+) to (3\.\d+)", readme)
    assert versions == list(named.groups())


def test_the_manifest_keeps_the_rules_that_its_author_can():
    """Rules of https://codecheck.org.uk/spec/config/2.0, by their numbers in the register's list.

    Not those of the codechecker (8 to 13 and 24 to 26), and not an author's ORCID and the address of the article (20
    to 22, 27, 28): a release says that they are missing.
    """
    text = (paths.root() / "codecheck.yml").read_text(encoding="utf-8")
    manifest = yaml.safe_load(text)  # CC-CFG-001
    assert text.startswith("---\n")  # 002
    for item in manifest["manifest"]:  # 004
        place = PurePosixPath(item["file"])  # 005
        assert not place.is_absolute() and ".." not in place.parts  # 006
        assert (paths.root() / place).is_file()  # CC-BUN-001
        assert item["comment"]  # 007
    assert manifest["version"] == "https://codecheck.org.uk/spec/config/2.0/"  # 014, 015
    assert manifest["paper"]["title"]  # 016, 017
    assert manifest["paper"]["authors"]  # 018
    assert all(author["name"] for author in manifest["paper"]["authors"])  # 019
    assert not re.search("FIXME|XXXXX", text)  # 023
    assert "reference-other" not in manifest["paper"]  # 029
    assert (paths.root() / "LICENSE").is_file()  # CC-BUN-005


@pytest.fixture(params=["", "https://example.org/a-b/c.d/"])
def public(request, monkeypatch):
    """The project without a public address, and with one."""
    urls = {"urls": {"Repository": request.param}} if request.param else {}
    about = {name: value for name, value in project().items() if name != "urls"} | urls
    monkeypatch.setattr(metadata, "project", lambda: about)
    return request.param.rstrip("/")


def test_binder_opens_a_notebook_of_the_release_where_there_is_an_address(public):
    found = binder("notebooks/isolation/02-convergence.ipynb")
    place = f"v{project()['version']}?labpath=notebooks%2Fisolation%2F02-convergence.ipynb"
    address = "https%3A%2F%2Fexample.org%2Fa-b%2Fc.d"
    assert found == (f"https://mybinder.org/v2/git/{address}/{place}" if public else "")
