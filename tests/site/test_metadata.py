"""Metadata for archives: what Zenodo's deposits and RO-Crate 1.1 ask for."""

import json
import re
from datetime import date

import pytest
import yaml

from stillwork.base import paths
from stillwork.base.checks import InputError
from stillwork.site import metadata
from stillwork.site.derived import works
from stillwork.site.metadata import project, release_date, zenodo

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


def test_zenodos_record_has_what_a_deposit_of_software_needs():
    record = json.loads(zenodo(works()))
    assert record["upload_type"] == "software"
    assert record["access_right"] == "open"
    assert all(set(each) == {"name"} and each["name"] for each in record["creators"])
    assert record["license"] == "bsd-3-clause"
    assert len(record["title"]) > 10
    assert all(work["work"] in record["description"] for work in works().values())


def test_all_tell_of_one_version_and_one_day():
    record = json.loads(zenodo(works()))
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
