"""The site's files, checked without a browser: links, escaping, places, completeness."""

import io
import itertools
import json
import re
import shutil
import subprocess
import tomllib
from collections import Counter
from functools import cache
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest
from PIL import Image

from stillwork.base.checks import InputError
from workbook import paths
from workbook.choices.command import robustness_of
from workbook.choices.judging import Robustness
from workbook.claims import Claim, Entry, Tolerance, ledger
from workbook.headlines import headlines, said_first, summary_of
from workbook.notebooks import select
from workbook.publish import replace_folder
from workbook.report import column
from workbook.site import reference
from workbook.site.build import site_files
from workbook.site.links import broken_links
from workbook.site.mathematics import markdown
from workbook.site.metadata import papers
from workbook.site.specification import class_of, remark, sentence, status

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


def test_every_built_number_has_one_place(files):
    claims = [claim for claim in ledger() if claim.notebook]
    for notebook in {claim.notebook for claim in claims}:
        places = [each.get("id") for each in elements(files[f"notebooks/{notebook}.html"]).of("li")]
        for claim in claims:
            assert places.count(f"claim-{claim.entry.id}") == (claim.notebook == notebook)


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


def test_an_explorer_of_which_no_settings_are_kept_shows_its_picture(toy):
    file = toy.root / "notebooks/isolation/01-first.ipynb"
    notebook = json.loads(file.read_text(encoding="utf-8"))
    data = {"image/png": "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJ"}
    notebook["cells"][-1]["outputs"] = [{"output_type": "display_data", "data": data, "metadata": {}}]
    file.write_text(json.dumps(notebook), encoding="utf-8")
    page = site_files()["notebooks/isolation/01-first.html"].decode()
    assert "The explorer at its start; it moves in Jupyter" in page


def test_what_a_work_says_first_is_judged_by_an_entry_of_its_own_ledger():
    known = {claim.entry.id: claim.entry.topic for claim in ledger()}
    for topic, paper in papers().items():
        for part in ("headline", "found"):
            named = [each["entry"] for each in paper[part]]
            assert {known.get(each) for each in named} <= {topic}


def test_advice_rests_on_verdicts_that_stand():
    """With another verdict, or another class over the combinations, the sentence is to be written anew."""
    verdicts = {claim.entry.id: claim.verdict for claim in ledger()}
    for topic, paper in papers().items():
        classes = {name: each.class_ for name, each in robustness_of(topic).items() if each.class_}
        assert paper["builder"][-1:] in (".", "")
        for entry, stated in paper["rests"].items():
            assert stated == ", ".join([verdicts[entry], *([classes[entry]] if entry in classes else [])])


def test_the_front_page_shows_each_work_by_its_picture_and_what_came_out(files):
    page = elements(files["index.html"])
    text = " ".join(re.sub(r"<[^>]*>", " ", files["index.html"].decode()).split())
    pictures = {each["src"] for each in page.of("img")}
    for paper in papers().values():
        assert not paper["hero"] or f"thumbnails/{paper['hero']}.webp" in pictures
        assert paper["by"] in text
        assert paper["builder"] in text


def test_every_count_of_the_front_page_leads_to_its_rows(files):
    links = {unquote(each["href"]) for each in elements(files["index.html"]).of("a")}
    wanted = {f"ledger.html?topic={claim.entry.topic}&counted={column(claim)}" for claim in ledger()}
    assert {each for each in links if "counted=" in each} == wanted


def test_what_came_out_is_a_sentence_that_the_combinations_end(files):
    """Of each statement that holds under all of its combinations, counted in the rows of its study."""
    text = " ".join(re.sub(r"<[^>]*>", " ", files["index.html"].decode()).replace(" .", ".").split())
    seen = 0
    for topic, paper in papers().items():
        if not (file := paths.data(topic, "choices.csv")).exists():
            continue
        lines = file.read_text(encoding="utf-8").splitlines()
        for statement in paper["found"]:
            name = statement["entry"]
            heads = [number for number, line in enumerate(lines) if name in line.split(",")]
            if not heads:
                continue
            rows = list(itertools.takewhile(lambda line: line[:1].isdigit(), lines[heads[0] + 1 :]))
            column = lines[heads[0]].split(",").index(name)
            robustness = robustness_of(topic)[name]
            if {row.split(",")[column] for row in rows} == {"1"} and robustness.share == 1:
                seen += 1
                assert f"under all {robustness.tried} combinations" in text
    assert seen


def test_a_table_has_its_nearest_joint_combination_and_what_comes_near_there(files):
    """Of Table 4.1, by brute force over the rows of its study; the first is the default, whose numbers are the ledger's."""
    lines = paths.data("motion", "choices.csv").read_text(encoding="utf-8").splitlines()
    (head,) = [number for number, line in enumerate(lines) if "motion.table-4-1.mc.mean" in line.split(",")]
    rows = list(itertools.takewhile(lambda line: line[:1].isdigit(), lines[head + 1 :]))
    claims = {claim.entry.id: claim for claim in ledger() if claim.entry.id.startswith("motion.table-4-1.")}
    names = [name for name in lines[head].split(",") if name in claims and claims[name].entry.kind == "value"]
    found = [dict(zip(lines[head].split(","), row.split(","), strict=True)) for row in rows]
    found[0] |= {name: claims[name].ours for name in names}
    off = [[abs(float(row[name]) / claims[name].entry.published - 1) for name in names] for row in found]
    best = min(off, key=lambda each: sum(min(one, 1) for one in each))
    counts = [f"{sum(each <= size for each in best)} of {len(best)}" for size in (0.05, 0.15, 0.25)]
    text = files["choices/motion.html"].decode()
    row = re.search(r"<tr><td><code>motion.table-4-1</code></td><td>(.*?)</td><td>.*?</td>(.*?)</tr>", text)
    assert ("(moved)" in row[1]) == (best is not off[0])
    assert re.findall(r"<td>(.*?)</td>", row[2]) == [*counts, str(len(rows))]


def test_a_thumbnail_is_a_small_copy_of_its_picture(files):
    small = {name: content for name, content in files.items() if name.startswith("thumbnails/")}
    whole = {name for name in files if name.startswith("figures/") and name.endswith(".csv")}
    assert {name.replace("thumbnails/", "figures/").replace(".webp", ".csv") for name in small} == whole
    assert sum(map(len, small.values())) < 4e6
    name = min(small)
    little = Image.open(io.BytesIO(small[name]))
    large = Image.open(io.BytesIO(files[name.replace("thumbnails/", "figures/").replace(".webp", ".png")]))
    assert little.width == min(480, large.width)
    assert little.width / little.height == pytest.approx(large.width / large.height, rel=0.01)
    difference = np.asarray(large.convert("L").resize(little.size, Image.Resampling.BOX), float) - np.asarray(
        little.convert("L"), float
    )
    assert abs(difference).mean() < 6  # of 255


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


def test_every_page_describes_itself(files):
    for name, content in files.items():
        if name.endswith(".html"):
            described = [
                each["content"] for each in elements(content).of("meta") if each.get("name") == "description"
            ]
            assert len(described) == 1, name
            assert len(described[0]) > 20, name


ENTRY = Entry("topic.fig-1.a", "Fig. 1", "time", "s", "value", 2.0, Tolerance("digits", relative=0.1))


def agreeing_in(entry, some, of):
    """An entry that agrees in some of its combinations."""
    settings = tuple((k,) for k in range(of))
    agrees = np.arange(of)[:, None] < some
    return Robustness(entry, (), settings, np.ones((of, 1)), agrees, np.zeros((of, 1), bool))


def test_how_a_statement_stands_is_told_by_its_combinations_else_by_its_verdict():
    entry, claim = ENTRY, Claim(ENTRY, 4.0)
    assert status(claim, None) == "not here: 4 s"
    assert status(Claim(entry, 2.1), None) == "agrees here"
    assert status(Claim(entry, None), None) == "not built"
    assert class_of(None) == "not tried"
    for agreeing, words, name in (
        (4, "agrees under all 4 combinations", "robust"),
        (0, "differs under all 4 combinations", "not reproduced"),
        (1, "agrees under 1 of 4 combinations", "depends"),
    ):
        standing = agreeing_in(entry, agreeing, 4)
        assert status(claim, standing) == words
        assert class_of(standing) == name


def test_what_is_not_found_is_said_as_a_negation():
    entry, said = (
        ENTRY,
        {"says": "FeRLS settles in 2 s", "otherwise": "it settles in {ours}, not in {published}"},
    )
    assert sentence(said, Claim(entry, 2.1), None) == "FeRLS settles in 2 s."
    assert sentence(said, Claim(entry, 4.0), None) == "It settles in 4 s, not in 2 s."
    general = {"says": "The filter settles in 2 s"}
    assert sentence(general, Claim(entry, 4.0), None) == "We did not find this: the filter settles in 2 s."
    assert sentence(general, Claim(entry), None) == "Not computed yet: the filter settles in 2 s."


MOST = "Under most combinations of open choices, "


@pytest.mark.parametrize(
    ("agreeing", "ours", "otherwise", "words", "same"),
    [
        (4, 2.1, "it settles in {ours}", "It settles in 2 s.", "all 4"),
        (3, 2.1, "it settles in {ours}", "It settles in 2 s.", "3 of 4"),
        (0, 4.0, "it settles in {ours}", "It settles in 4 s.", "all 4"),
        (1, 4.0, "it settles in {ours}", "It settles in 4 s.", "3 of 4"),
        # The default is among the few: its value does not stand for what most combinations give.
        (1, 2.1, "it settles in {ours}", f"{MOST}we did not find this: it settles in 2 s.", "3 of 4"),
        (1, 2.1, "it settles later", f"{MOST}it settles later.", "3 of 4"),
        (3, 4.0, "it settles in {ours}", f"{MOST}it settles in 2 s.", "3 of 4"),
    ],
)
def test_sentence_and_remark_are_about_one_outcome(agreeing, ours, otherwise, words, same):
    said, standing = {"says": "It settles in 2 s", "otherwise": otherwise}, agreeing_in(ENTRY, agreeing, 4)
    assert sentence(said, Claim(ENTRY, ours), standing) == words
    assert (
        remark(Claim(ENTRY, ours), standing) == f"the same verdict under {same} combinations of open choices"
    )
    assert remark(Claim(ENTRY, ours), None) == Claim(ENTRY, ours).verdict


def test_no_sentence_of_the_ledger_contradicts_its_mark():
    """The headlines of all pages: what differs is worded as a negation, what agrees is not, and so is the remark."""
    found = []
    for topic in paths.topics():
        standings, pages = robustness_of(topic), {}
        for claim in ledger(topic=topic):
            pages.setdefault(claim.notebook, []).append(claim)
        for claims in pages.values():
            found += [
                line
                for line in headlines(claims, standings, said_first(topic))
                if line.claim.ours is not None
            ]
    assert len({line.claim.notebook for line in found}) > 50
    for line in found:
        negated = " instead" in line.found or "Not found: " in line.found
        assert negated == (
            line.claim.verdict in ("deviates", "fails") and line.claim.entry.published is not None
        )
        if line.kind in ("agrees", "differs"):
            assert negated == (line.kind == "differs") or line.claim.entry.published is None
        assert ("differs under all" in line.open_choices) <= (line.kind == "differs")
        assert ("agrees under all" in line.open_choices) <= (line.kind == "agrees")


def test_a_page_begins_with_its_summary_and_shows_a_row_for_each_claim(files):
    page = files["notebooks/motion/09-bandwidth-table.html"]
    begin = page.decode().partition('class="summary"')[2].partition("</section>")[0]
    assert summary_of("motion/09-bandwidth-table").lines[0].open_choices in begin
    rows = ["data-verdict" in row for row in elements(page).of("tr")]
    assert sum(rows) == sum(claim.notebook == "motion/09-bandwidth-table" for claim in ledger())


QUESTIONS = {
    "how do I install": "guide/install.html",
    "identify modes from FRF": "guide/(your-rig|install).html",
    "C code": "guide/(your-rig|install).html",
    "design controller": "guide/(your-rig|install).html",
    "bandwith": "notebooks/motion/09-bandwidth-table.html",
}


# Of what else a newcomer may ask: one of the first three places.
NEWCOMERS = {
    "Kalman filter": r"reference/stillwork.estimation.*#(kalman_observer|ExtendedKalman|UnscentedKalman)$",
    "kalmann": "notebooks/motion/2[02]|reference/stillwork.estimation",
    "notch": "reference/stillwork.control.pid.html#Notch",
    "floor vibration spectrum": "guide/your-rig.html#A-floor",
    "recursive least squares": ".*#RecursiveLeastSquares",
    "recursiv least squares": ".*#RecursiveLeastSquares",
    "export to C": "guide/(install|your-rig).html",
    "sensitivity 6 dB": "guide/desk.html|notebooks/motion/05",
    "install pip": "guide/install.html",
    "csv file format": "guide/your-rig.html#The-files",
    "fixed point iteration": "notebooks/(fixedpoint/06|worstcase/02)",
    "error budget": "guide/budget.html",
    "active dampng": "notebooks/motion/07",
    "PID tuning": "notebooks/motion/05",
    "total least squares": ".*#total_least_squares|notebooks/worstcase/06",
    "H infinity": "reference/stillwork.*hinf",
    "add my own observer": "guide/contest.html#Run",
    "my own data": "guide/your-rig.html",
    "hammer test": "notebooks/motion/29",
    "change a parameter": "guide/install.html#Change",
    "LMS step size": "notebooks/isolation/02",
    "licence": "guide/install.html#Licence",
    "python version": "guide/install.html",
    "exercises": "guide/course/index.html",
    "teaching": "guide/course/teachers.html",
    "what is a verdict": "ledger.html",
    "open choices": "choices/",
    "robot arm": "index.html|notebooks/fixedpoint",
    "choose an estimator": "guide/estimators.html",
}


@pytest.mark.skipif(shutil.which("node") is None, reason="node runs the ranking: apt-get install nodejs")
@pytest.mark.parametrize(("questions", "first"), [(QUESTIONS, 1), (NEWCOMERS, 3)])
def test_the_search_puts_the_page_that_answers_first(files, tmp_path, questions, first):
    script = tmp_path / "ask.js"
    script.write_bytes(
        files["search-index.js"]
        + files["static/search.js"]
        + b"\nconst ranked = globalThis.rankedPlaces(globalThis.searchIndex);"
        + b"\nconst found = process.argv.slice(2).map((each) => ranked(each).places.map(({ address }) => address));"
        + b"\nconsole.log(JSON.stringify(found));"
    )
    done = subprocess.run(["node", script, *questions], capture_output=True, text=True, check=True)
    found = dict(zip(questions, json.loads(done.stdout), strict=True))
    missed = {
        question: found[question][:first]
        for question, wanted in questions.items()
        if not any(re.match(wanted, address) for address in found[question][:first])
    }
    assert not missed


def test_two_builds_give_the_same_bytes(files):
    for kept in (reference.doc_html, reference.read_source, markdown):
        kept.cache_clear()
    assert site_files() == files


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
    assert "deviates" in files["ledger.html"].decode()


def test_a_formula_that_cannot_be_shown_names_the_notebook(toy):
    toy.replace("notebooks/isolation/01-first.ipynb", "# A toy", "# A toy $\\\\frobnicate{x}$")
    with pytest.raises(InputError, match=r"^isolation/01-first\b.*frobnicate"):
        site_files()


def test_the_command_of_a_figure_stands_on_its_page(files):
    for notebook in select():
        text = files[f"notebooks/{notebook.name}.html"].decode()
        assert re.search(rf"make figures ARGS=&#34;{notebook.name} --force&#34;", text)


def test_pages_lead_to_binder_and_the_source_once_there_is_an_address(toy):
    def leading(page: str) -> list[str]:
        links = [each["href"] for each in elements(site_files()[page]).of("a")]
        return [unquote(each) for each in links if each.startswith("https://")]

    assert leading("notebooks/isolation/01-first.html") == []
    public = "https://example.org/a/b"
    text = (toy.root / "pyproject.toml").read_text()
    toy.write("pyproject.toml", f'{text}\n[project.urls]\nRepository = "{public}"\n')
    version = tomllib.loads(text)["project"]["version"]
    for page, file in (("notebooks/isolation/01-first", "isolation/01-first"), ("replicate", "index")):
        start = f"https://mybinder.org/v2/git/{public}/v{version}?labpath=notebooks/{file}.ipynb"
        assert leading(f"{page}.html") == [start, public]
