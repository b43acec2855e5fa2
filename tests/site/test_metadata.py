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
