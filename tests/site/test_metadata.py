"""Metadata for archives: what CITATION.cff, which Zenodo reads, asks for, and what the article cites.

The schema of CITATION.cff beside this file is that of the Citation File Format 1.2.0 as its authors publish it
(S. Druskat and others, https://citation-file-format.github.io), under CC BY 4.0.
"""

import json
import re
from datetime import date
from pathlib import Path

import jsonschema
import pytest
import yaml

from workbook import paths
from workbook.site.metadata import project

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
