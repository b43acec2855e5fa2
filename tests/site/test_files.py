"""The site's files, checked without a browser: links, escaping, places, completeness."""

import io
import json
import re
import zlib
from collections import Counter
from functools import cache
from html.parser import HTMLParser

import pytest
from PIL import Image

from workbook import paths
from workbook.choices.command import judged_ledger
from workbook.claims import ledger
from workbook.notebooks import select
from workbook.publish import replace_folder
from workbook.site.build import site_files
from workbook.site.links import broken_links
from workbook.site.metadata import papers

pytestmark = pytest.mark.slow

HOSTILE = "<script>alert('x')</script><img src=x onerror=alert(1)> & \"quoted\""


class Elements(HTMLParser):
    """A page's elements, without the colours of source code, which carry nothing and are most of them."""

    def __init__(self, text: bytes):
        super().__init__()
        self.found: list[tuple[str, dict]] = []
        self.feed(re.sub(r'<span class="[^"<>]*">', "", text.decode()))

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))

    def of(self, *tags: str) -> list[dict]:
        return [attributes for tag, attributes in self.found if tag in tags]


elements = cache(Elements)


@pytest.fixture(scope="module")
def files():
    return site_files()


@pytest.fixture(scope="module")
def written(files, tmp_path_factory):
    folder = tmp_path_factory.mktemp("built") / "site"
    replace_folder(folder, files)
    return folder


@pytest.fixture
def toy(toy, monkeypatch):
    """A workbook of one built notebook, full of text that a page must not take for its own."""
    name = "isolation/01-first"
    toy.add_page(name)
    toy.replace(f"notebooks/{name}.ipynb", "# A toy", json.dumps(f"# A toy {HOSTILE}")[1:-1])
    toy.replace(f"notebooks/{name}.ipynb", "# V", json.dumps(f"# V {HOSTILE}")[1:-1])
    toy.replace("data/isolation/published.toml", 'quantity = "gain"', f"quantity = '''{HOSTILE}'''")
    toy.write(
        "data/isolation/published.toml",
        (toy.root / "data/isolation/published.toml").read_text() + f"reason = '''{HOSTILE}'''\n",
    )
    toy.write(f"figures/{name}/claims.json", json.dumps({"isolation.gain": {"ours": 2.5}}))

    picture = io.BytesIO()
    Image.new("RGB", (7, 5)).save(picture, "PNG")
    for stem in ("fig-1", "<b>&'quoted'"):
        (toy.root / f"figures/{name}/{stem}.png").write_bytes(picture.getvalue())
        (toy.root / f"figures/{name}/{stem}.csv").write_text("panel,series,x,y,z\n")
    monkeypatch.setenv("STILLWORK_ROOT", str(toy.root))
    return toy


def test_every_link_leads_somewhere(written):
    assert broken_links(written) == []


def test_a_broken_link_is_named(tmp_path):
    good = '<h1 id="here">A</h1><a href="#here">x</a><a href="a.html#here">x</a><a href="https://example.org">x</a>'
    bad = [
        '<a href="nowhere.html">',
        '<a href="a.html#nowhere">',
        '<a href="../../outside.html">',
        '<img src="https://example.org/a.png">',
        '<script src="//example.org/a.js"></script>',
        '<a href="javascript:alert(1)">',
    ]
    (tmp_path / "a.html").write_text(good, encoding="utf-8")
    assert broken_links(tmp_path) == []
    (tmp_path / "b.html").write_text(f"<span class='s'>{good}</span>" + "".join(bad), encoding="utf-8")
    assert [line.rpartition(": ")[2] for line in broken_links(tmp_path)] == [
        "no such file",
        "no such place",
        "no such file",
        *3 * ["leaves the site"],
    ]


def test_every_notebook_number_and_module_is_there(files):
    for notebook in select():
        assert f"notebooks/{notebook.name}.html" in files
        assert files[f"notebooks/{notebook.name}.ipynb"].decode() == notebook.source
    rows = {each["id"] for each in elements(files["ledger.html"]).of("tr") if "id" in each}
    assert rows == {f"row-{claim.entry.id}" for claim in ledger()}
    assert "reference/stillwork.signals.spectra.html" in files


ENTRY = re.compile(r"(.+?)\s+(\S+):(\S+)\s+(-?\d+)\s+?(\S*)\s+(.*)")  # as Sphinx reads a line of an inventory


def test_the_inventory_leads_to_every_public_name(files):
    """`objects.inv` read by the format's rules: four lines of head, then deflated lines."""
    head, rest = files["objects.inv"].split(b"zlib.\n", 1)
    first, project, version, last = head.decode().split("\n")
    assert (
        first == "# Sphinx inventory version 2"
        and last == "# The remainder of this file is compressed using "
    )
    assert project == "# Project: stillwork" and re.fullmatch(r"# Version: [\d.]+", version)
    lines = zlib.decompress(rest).decode().splitlines()
    found = {}
    for line in lines:
        name, domain, role, priority, address, shown = ENTRY.fullmatch(line).groups()
        assert (domain, shown) == ("py", "-") and priority in ("0", "1")
        found[name] = role, address
    assert len(found) == len(lines)
    for _, address in found.values():
        page, _, place = address.partition("#")
        assert page in files
        if place:
            assert place in places_of(files[page])
    assert found["stillwork.lti.state_space"][0] == "module"
    assert found["stillwork.lti.state_space.StateModel"][0] == "class"
    assert found["stillwork.lti.state_space.StateModel.frequency_response"][0] == "method"
    assert found["stillwork.signals.spectra.estimate_spectrum"][0] == "function"


@cache
def places_of(page: bytes) -> set[str]:
    return set(re.findall(r'\bid="([^"]+)"', page.decode()))


def test_every_committed_figure_is_shown(files):
    shown = {
        src
        for name in files
        if name.startswith("notebooks/") and name.endswith(".html")
        for src in [each["src"].removeprefix("../../") for each in elements(files[name]).of("img")]
    }
    committed = {
        file.relative_to(paths.root()).as_posix() for file in (paths.root() / "figures").glob("*/*/[!.]*.png")
    }
    assert committed <= shown


def test_advice_rests_on_verdicts_that_stand():
    """With another verdict the sentence is to be written anew."""
    verdicts = {claim.entry.id: claim.verdict for claim in judged_ledger()}
    for paper in papers().values():
        assert paper["builder"][-1:] in (".", "")
        for entry, stated in paper["rests"].items():
            assert stated == verdicts[entry]


def test_the_search_index_leads_to_places_that_are_there(files):
    text = files["search-index.js"].decode()
    found = json.loads(text.removeprefix("globalThis.searchIndex = ").removesuffix(";\n"))
    kinds = Counter(kind for _, kind, _, _ in found)
    assert kinds["ledger"] == len(ledger())
    assert set(kinds) == {
        "ledger",
        "reference",
        "code",
        "page",
        "guide",
        "course",
        *(notebook.topic for notebook in select()),
    }
    places: dict[str, set] = {}
    for title, _, address, _ in found:
        page, _, place = address.partition("#")
        if page not in places:
            places[page] = {values.get("id") for _, values in elements(files[page]).found}
        assert title, address
        assert place in places[page], address


def test_foreign_text_is_escaped(toy):
    files = site_files()
    for name, content in files.items():
        if name.endswith(".html"):
            page = elements(content)
            assert [each for each in page.of("script") if "src" not in each] == [], name
            assert [each for each in page.of("img") if each["src"] == "x"] == [], name
            assert page.of("b") == [], name
            assert not [each for _, each in page.found if any(key.startswith("on") for key in each)], name
    assert "&lt;script&gt;alert" in files["ledger.html"].decode()
    assert "not replicated" in files["ledger.html"].decode()
