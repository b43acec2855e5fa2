"""Metadata for archives: what CITATION.cff, Zenodo's deposits, CODECHECK 2.0 and RO-Crate 1.1 ask for.

The schema of CITATION.cff beside this file is that of the Citation File Format 1.2.0 as its authors publish it
(S. Druskat and others, https://citation-file-format.github.io), under CC BY 4.0. Zenodo's and CODECHECK's rules are
written here from their documentation: neither gives a schema whose licence lets it be copied.
"""

import json
import re
from datetime import date
from pathlib import Path, PurePosixPath

import jsonschema
import pytest
import yaml

from stillwork.base.checks import InputError
from workbook import paths
from workbook.site import metadata
from workbook.site.metadata import binder, codemeta, crate, project, release_date, zenodo
from workbook.site.papers import cited

CRATE = json.loads((paths.root() / "ro-crate-metadata.json").read_text(encoding="utf-8"))
CITATION = yaml.safe_load((paths.root() / "CITATION.cff").read_text(encoding="utf-8"))
ENTITIES = {each["@id"]: each for each in CRATE["@graph"]}


def references(value):
    """Every ``{"@id": ...}`` within a value."""
    if isinstance(value, dict):
        return (
            [value["@id"]]
            if set(value) == {"@id"}
            else [r for each in value.values() for r in references(each)]
        )
    return [r for each in value for r in references(each)] if isinstance(value, list) else []


def test_the_crate_is_one():
    assert len(ENTITIES) == len(CRATE["@graph"])
    about = ENTITIES["ro-crate-metadata.json"]
    assert CRATE["@context"] == "https://w3id.org/ro/crate/1.1/context"
    assert about["@type"] == "CreativeWork"
    assert about["about"] == {"@id": "./"}
    assert about["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    root = ENTITIES["./"]
    assert root["@type"] == "Dataset"
    assert {"name", "description", "datePublished", "license"} <= set(root)
    assert ENTITIES[root["publisher"]["@id"]]["@type"] == "Organization"  # recommended, as is a value alone
    assert root["author"] == root["publisher"]
    assert all("@type" in each for each in CRATE["@graph"])


def test_every_reference_of_the_crate_leads_to_an_entity():
    outside = {"https://w3id.org/ro/crate/1.1"}
    for entity in CRATE["@graph"]:
        assert {r for value in entity.values() for r in references(value)} <= {*ENTITIES, *outside}


def test_the_crates_files_are_there_and_all_pictures_are_in_it():
    files = {name for name, each in ENTITIES.items() if "File" in each["@type"]}
    assert files == {each["@id"] for each in ENTITIES["./"]["hasPart"]}
    assert all((paths.root() / name).is_file() for name in files)
    pictures = {
        each.relative_to(paths.root()).as_posix() for each in paths.root().glob("figures/*/*/[!.]*.csv")
    }
    assert pictures <= files
    made = [each["@id"] for entity in CRATE["@graph"] for each in entity.get("result", [])]
    assert pictures <= set(made)
    assert len(made) == len(set(made))


TEXT = {"type": "string", "minLength": 1}
# The fields of a deposit that are of use here, by https://developers.zenodo.org/#representation: no other is taken.
DEPOSIT = {
    "type": "object",
    "additionalProperties": False,
    "required": [
        "upload_type",
        "publication_date",
        "title",
        "creators",
        "description",
        "access_right",
        "license",
    ],
    "properties": {
        "upload_type": {"const": "software"},
        "publication_date": {"type": "string", "pattern": r"^\d{4}-\d{2}-\d{2}$"},
        "title": TEXT,
        "creators": {
            "type": "array",
            "minItems": 1,
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["name"],
                "properties": {
                    "name": TEXT,
                    "affiliation": TEXT,
                    "orcid": {"type": "string", "pattern": r"^(\d{4}-){3}\d{3}[\dX]$"},
                },
            },
        },
        "description": TEXT,
        "access_right": {"enum": ["open", "embargoed", "restricted", "closed"]},
        "license": {"const": "bsd-3-clause"},
        "keywords": {"type": "array", "items": TEXT},
        "version": TEXT,
        "language": {"type": "string", "pattern": "^[a-z]{3}$"},
        "related_identifiers": {
            "type": "array",
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["identifier", "relation"],
                "properties": {
                    "identifier": {"type": "string", "pattern": "^https://"},
                    "relation": {"enum": ["isSupplementTo", "isDerivedFrom", "cites"]},
                    "resource_type": {"const": "software"},
                },
            },
        },
    },
}


def test_zenodos_record_is_a_deposit_of_software(public):
    for made in (zenodo(cited()), (paths.root() / ".zenodo.json").read_text(encoding="utf-8")):
        record = json.loads(made)
        jsonschema.validate(record, DEPOSIT)
        assert all(paper["paper"] in record["description"] for paper in cited().values())
    with pytest.raises(jsonschema.ValidationError, match="upload_type"):
        jsonschema.validate(record | {"upload_type": "program"}, DEPOSIT)


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


def test_an_address_stands_in_every_record_once_there_is_one(public):
    records = (
        json.loads(codemeta(cited())).get("codeRepository", ""),
        json.loads(zenodo(cited())).get("related_identifiers", [{"identifier": ""}])[0]["identifier"],
        next(each for each in json.loads(crate(cited(), []))["@graph"] if each["@id"] == "./").get("url", ""),
    )
    assert set(records) == {public}


def test_binder_opens_a_notebook_of_the_release_where_there_is_an_address(public):
    found = binder("notebooks/isolation/02-convergence.ipynb")
    place = f"v{project()['version']}?labpath=notebooks%2Fisolation%2F02-convergence.ipynb"
    address = "https%3A%2F%2Fexample.org%2Fa-b%2Fc.d"
    assert found == (f"https://mybinder.org/v2/git/{address}/{place}" if public else "")


def test_all_tell_of_one_version_and_one_day():
    record = json.loads(zenodo(cited()))
    day = date.fromisoformat(release_date())
    assert CITATION["date-released"] == day
    assert record["publication_date"] == ENTITIES["./"]["datePublished"] == day.isoformat()
    assert record["version"] == ENTITIES["./"]["version"] == CITATION["version"] == project()["version"]
    assert record["title"] == CITATION["title"]


def test_a_citation_without_a_day_is_refused(tmp_path, monkeypatch):
    text = (paths.root() / "CITATION.cff").read_text(encoding="utf-8")
    (tmp_path / "data").mkdir()
    (tmp_path / "CITATION.cff").write_text(re.sub(r"date-released: .*\n", "", text), encoding="utf-8")
    monkeypatch.setattr(metadata.paths, "root", lambda: tmp_path)
    with pytest.raises(InputError, match="date-released"):
        release_date()
