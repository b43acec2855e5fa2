"""Builds the site: every page as a string, all files in one folder that appears whole or not at all."""

import base64
import json
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import jinja2
from markupsafe import Markup

from workbook import paths, publish
from workbook.checks import InputError
from workbook.choices.axes import load_axes
from workbook.choices.command import judged_ledger
from workbook.choices.kept import read_settings
from workbook.choices.settings import ranges
from workbook.claims import KINDS, VERDICTS, Claim
from workbook.notebooks import notebook_file
from workbook.provenance import commit, modified
from workbook.report import (
    APART,
    REPLICATIONS,
    column,
    interval_text,
    our_quantity,
    published_quantity,
    tally,
)
from workbook.site import reference, search
from workbook.site.links import broken_links
from workbook.site.mathematics import markdown
from workbook.site.metadata import about, address, binder, papers, project
from workbook.site.pages import Figure, NotebookPage, read_page
from workbook.site.settings import by_axis, unsearched
from workbook.site.specification import curves, said_of, sentence, status
from workbook.site.states import kept_states, make_states, missing_states
from workbook.tasks import tasks
from workbook.timings import benchmarks

HERE = Path(__file__).parent
OVERVIEWS = (
    "index.html",
    "ledger.html",
    "gallery.html",
    "benchmarks.html",
    "replicate.html",
    "reference/index.html",
)
SEARCHED = ("choices/", "settings/")  # folders of further ones


def build_site(still: bool = False) -> int:
    """Write ``build/site``; returns 1, with a line for each, when a link of it leads nowhere.

    With `still` the explorers of which nothing is kept are left as pictures, and said to be at the end.
    """
    target, wanted = paths.root() / "build" / "site", tasks()
    lacking = missing_states(wanted, kept_states(wanted)) if still else []
    if not still:
        make_states(wanted)
    files = site_files()
    publish.replace_folder(target, files)
    broken = broken_links(target)
    for line in broken:
        print(line)
    pages = sum(name.endswith(".html") for name in files)
    print(f"{pages} pages, {len(broken)} broken links: {target / 'index.html'}")
    if lacking:
        print(f"{len(lacking)} explorers are still pictures: `make site` computes them (some minutes, once)")
    return int(bool(broken))


def _own_pages() -> dict[str, dict]:
    """Pages that ``[tool.workbook] pages`` of pyproject.toml adds: by file, ``module:function`` of the checkout's folder.

    A function gives `title`, `description`, `body` and `files`, scripts and styles by name; nothing where it has no page.
    """
    made = {}
    for name, target in paths.own_settings().get("pages", {}).items():
        module, _, function = target.partition(":")
        if page := getattr(import_module(module), function)(paths.root()):
            made[name] = page
    return made


def site_files() -> dict[str, bytes]:
    """The site's files by path, with the explorers' states that are kept."""
    claims, wanted = judged_ledger(notes=True), tasks()
    states, modules = kept_states(wanted), reference.read_modules()
    starts = {name: base64.b64decode(kept.get("start", "")) for name, kept in states.items()}
    pages = [read_page(task, claims, starts.get(task.notebook.name, b"")) for task in wanted]
    guides = {name: file.read_text(encoding="utf-8") for name, file in _documents("*.md").items()}
    topics = [_topic(name, paper, claims, pages) for name, paper in papers().items()]
    own = _own_pages()
    render = _renderer(
        own_pages=own,
        topics=[topic for topic in topics if topic["pages"] or topic["counts"]],
        machines=_listed([topic["on"] for topic in topics if topic["on"] and topic["source"]]),
        # Of a folder its front stands in the navigation and leads to the others.
        guides={
            name: _title(text) for name, text in guides.items() if "/" not in name or name.endswith("/index")
        },
        places=reference.index(modules),
        timed=bool(timed := benchmarks()),
        verdicts=[verdict for verdict in VERDICTS if any(claim.verdict == verdict for claim in claims)],
        counts=Counter(map(column, claims)),
        curved={curve.claim.entry.id for topic in topics for curve in topic["curves"]},
    )
    bodies = {name: markdown(text) for name, text in guides.items()}
    files = static_files()
    files["index.html"] = _front(render, claims, pages, states)
    files |= _ledger_pages(render, claims, pages)
    files |= _choice_pages(render, topics)
    files["gallery.html"] = render("gallery.html", "", pages=pages)
    files["benchmarks.html"] = render("benchmarks.html", "", tables=timed)
    files["replicate.html"] = render(
        "replicate.html", "", pages=pages, binder=binder("notebooks/index.ipynb")
    )
    for page in pages:
        files |= _notebook_files(render, page, pages, states.get(page.name, {}))
    files |= _reference_pages(render, modules)
    files |= _guide_pages(render, guides, bodies)
    for name, page in own.items():
        files[name] = render("own.html", "", page=page)
        files |= {f"static/{each}": text.encode() for each, text in page["files"].items()}
    files["search.html"] = render("search.html", "")
    others = {name: files[name] for name in files if name in OVERVIEWS or name.startswith(SEARCHED)}
    files["search-index.js"] = search.script(search.index(pages, bodies, modules, claims, others))
    return files


def _front(render, claims: list[Claim], pages: list[NotebookPage], states: dict) -> bytes:
    """The front, with the first explorer that a paper names to be moved there."""
    by_name = {page.name: page for page in pages}
    moving = [
        page.name
        for paper in papers().values()
        if (page := by_name.get(paper["moving"])) and "states" in states.get(page.name, {})
        if any(figure.csv is None for figure in page.figures)
    ]
    return render(
        "index.html",
        "",
        published=sum(column(claim) in REPLICATIONS for claim in claims),
        moving=by_name[moving[0]] if moving else None,
        states=states[moving[0]] if moving else {},
    )


def _ledger_pages(render, claims, pages) -> dict[str, bytes]:
    reasons, first = {}, {}  # of a group that shares its reasons the first entry prints them
    for claim in claims:
        if texts := tuple(dict.fromkeys(filter(None, (claim.unjudged, claim.entry.reason)))):
            reasons[claim.entry.id] = first.setdefault((claim.entry.topic, texts), claim.entry.id), texts
    page = render(
        "ledger.html",
        "",
        claims=claims,
        reasons=reasons,
        by_name={page.name: page for page in pages},
        kinds=[kind for kind in KINDS if any(claim.entry.kind == kind for claim in claims)],
    )
    plain = json.dumps([claim.as_dict() for claim in claims], indent=1).encode()
    return {"ledger.html": page, "ledger.json": plain}


def _choice_pages(render, topics: list[dict]) -> dict[str, bytes]:
    """Of each topic its numbers over their combinations, and which settings the paper must have used."""
    files = {}
    for topic in topics:
        name, joint = topic["name"], topic["joint"]
        if topic["curves"]:
            files[f"choices/{name}.html"] = render("choices.html", "../", topic=topic, curves=topic["curves"])
        if joint:
            axes, multiverses = load_axes(name)
            ours = {axis: axes[axis].texts[axes[axis].default_index] for axis in joint.best}
            files[f"settings/{name}.html"] = render(
                "settings.html",
                "../",
                topic=topic,
                joint=joint,
                axes=axes,
                searched={axis: ends for one in multiverses for axis, ends in one.windows.items()},
                unsearched=unsearched(multiverses),
                equal=topic["equal"],
                telling=joint.telling,
                moved={axis for axis in joint.telling if joint.best[axis] != ours[axis]},
                silent=sorted({each.axis for each in joint.settings} - joint.telling),
                windows=by_axis(joint),
            )
    return files


def _notebook_files(render, page, pages, states: dict) -> dict[str, bytes]:
    """A notebook's page, the notebook itself, and its figures with their data."""
    shown = render(
        "notebook.html",
        "../../",
        page=page,
        neighbours=_neighbours(page, pages),
        states=states,
        binder=binder(f"notebooks/{page.name}.ipynb"),
    )
    own = {".html": shown, ".ipynb": notebook_file(page.name).read_bytes()}
    files = {f"notebooks/{page.name}{suffix}": content for suffix, content in own.items()}
    for figure in page.figures:
        files[f"{figure.path}.png"] = figure.png
        if figure.csv is not None:
            files[f"{figure.path}.csv"] = figure.csv
            files[figure.thumbnail] = figure.small[0]
    return files


def _reference_pages(render, modules: list[reference.Module]) -> dict[str, bytes]:
    folders = reference.folders(modules)
    files = {
        "reference/index.html": render("reference.html", "../", folders=folders, doc=_doc),
        "objects.inv": reference.inventory(modules, project()["name"], project()["version"]),
    }
    for module in modules:
        files[f"reference/{module.name}.html"] = render(
            "module.html", "../", module=module, folders=folders, doc=_doc, source=_source(module.source)
        )
    return files


def _guide_pages(render, guides: dict[str, str], bodies: dict[str, str]) -> dict[str, bytes]:
    """The documents below ``docs``, and the scripts that they lead to."""
    files = {}
    for name, body in bodies.items():
        files[f"guide/{name}.html"] = render(
            "guide.html", _to_front(name), title=_title(guides[name]), body=Markup(body)
        )
    for name, file in _documents("*.py").items():
        files[f"guide/{name}.html"] = render(
            "source.html",
            _to_front(name),
            file=file.relative_to(paths.root()).as_posix(),
            source=_source(file.read_text(encoding="utf-8")),
        )
    return files


def static_files() -> dict[str, bytes]:
    """Style, script and icon. The font goes into the style: from the disk not every browser loads it as a file."""
    files = {f"static/{file.name}": file.read_bytes() for file in sorted((HERE / "static").iterdir())}
    font = base64.b64encode(files.pop("static/mathematics.woff"))
    style = files["static/site.css"]
    files["static/site.css"] = style.replace(b"mathematics.woff", b"data:font/woff;base64," + font)
    return files


def _neighbours(page: NotebookPage, pages: list[NotebookPage]) -> list[tuple[str, NotebookPage]]:
    """The notebooks before and after one in its topic, with the relation's name."""
    mine = [each for each in pages if each.topic == page.topic]
    at = mine.index(page)
    before = [("prev", mine[at - 1])] if at else []
    return before + [("next", each) for each in mine[at + 1 : at + 2]]


def _topic(name: str, paper: dict, claims: list[Claim], pages: list[NotebookPage]) -> dict:
    """What a template shows of a topic."""
    mine = [claim for claim in claims if claim.entry.topic == name]
    drawn = curves(name, mine)
    return {
        "name": name,
        **paper,
        "counts": Counter(map(column, mine)),
        "curves": drawn,
        "joint": read_settings(name),
        "headline": said_of(paper["headline"], mine),
        "found": said_of(paper["found"], mine),
        "rests": [entry for entry in paper["rests"] if any(claim.entry.id == entry for claim in mine)],
        "hero": next(_named([paper["hero"]], pages), None),
        "limits": list(_named(paper["limits"], pages)),
        "pages": [page for page in pages if page.topic == name],
    }


def _named(names: list[str], pages: list[NotebookPage]) -> Iterator[Figure]:
    """Pictures by ``<topic>/<notebook>/<figure>``."""
    return (each for page in pages for each in page.figures if each.path.removeprefix("figures/") in names)


def _listed(words: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def _imprint() -> dict[str, str]:
    """Who made the workbook, and how it is cited."""
    said = project()
    authors = ", ".join(each["name"] for each in said["authors"])
    begin = f"{authors}, " if authors else ""
    return {
        "authors": authors,
        "citation": f"{begin}{said['name']}: {said['description']}, version {said['version']}.",
    }


@cache
def _templates() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = lambda value: f"{value:.4g}"
    environment.filters["published"] = published_quantity
    environment.filters["ours"] = our_quantity
    environment.filters["interval"] = interval_text
    environment.filters["off_by"] = _off_by
    environment.filters["slug"] = lambda name: name.replace(",", "").replace(" ", "-")
    environment.filters["column"] = column
    environment.filters["tally"] = tally
    environment.filters["status"] = status
    environment.filters["sentence"] = sentence
    environment.filters["ranges"] = ranges
    return environment


def _renderer(**shared):
    """``render(template, root, **values)``; `root` leads from the page to the site's front."""
    site = {
        **about(),
        **_imprint(),
        "address": address(),
        "commit": commit() or "",
        "modified": bool({name for name in modified() if not name.startswith("build/")}),
        "replications": REPLICATIONS,
        "columns": (*REPLICATIONS, *APART),
    }

    def render(template: str, root: str, **values) -> bytes:
        page = _templates().get_template(template)
        text = page.render(root=root, site=site, **shared, **values)
        return text.replace("<pre>", '<pre tabindex="0">').encode()  # what scrolls is reached by keys, too

    return render


def _off_by(claim: Claim) -> str:
    """Distance from the published value as a reader takes it in: per cent, far off as a factor."""
    if claim.deviation is None:
        return ""
    if claim.deviation < 10:
        return f"{100 * claim.deviation:.2g} %" if claim.deviation < 1 else f"{100 * claim.deviation:.0f} %"
    return f"factor {claim.ours / claim.entry.published:.3g}"


def _documents(pattern: str) -> dict[str, Path]:
    """Files below ``docs`` by their path there without suffix; a page lies as deep, so that links serve in both."""
    folder = paths.root() / "docs"
    return {
        file.relative_to(folder).with_suffix("").as_posix(): file for file in sorted(folder.rglob(pattern))
    }


def _to_front(guide: str) -> str:
    """What leads from a guide's page to the site's front."""
    return "../" * (1 + guide.count("/"))


def _title(text: str) -> str:
    if found := re.match(r"# (.+)", text):
        return found[1]
    raise InputError(f"a guide begins with {text[:40]!r}; begin it with '# ' and its title")


def _doc(text: str, level: int = 2) -> Markup:
    return Markup(reference.doc_html(text, level))


@cache
def _source(text: str) -> Markup:
    """Highlighted source, every line a place to link to: ``#line-42``."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import PythonLexer

    return Markup(highlight(text, PythonLexer(), HtmlFormatter(linespans="line")))
