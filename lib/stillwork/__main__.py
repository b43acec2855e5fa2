"""Command line: ``python -m stillwork figures|readings|claims|portable|accept|site|release|refresh|inspect|report|design|export|contest|verify|new|doctor``."""

import argparse
import json
import os
import re
import sys

from stillwork.base import paths
from stillwork.base.checks import InputError, nearest, one_line, require_number
from stillwork.base.extras import MissingPackage, missing

# A grammar of addresses that jsonschema builds for a second or two when a notebook format is loaded, if it can be
# had; nothing here holds an address against it.
sys.modules.setdefault("rfc3987_syntax", None)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code (2 for wrong input, 130 when interrupted)."""
    parser, words = _parser()
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        parser.error(f"unknown {unknown[0]!r}{nearest(unknown[0], words)}")
    try:
        return options.run(options)
    except BrokenPipeError:  # the reader, e.g. `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (InputError, OSError, ImportError) as error:
        told = missing(error) if isinstance(error, ModuleNotFoundError) else error
        if isinstance(told, ImportError) and not isinstance(told, MissingPackage):
            raise
        print(f"stillwork: {one_line(str(told))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        if arguments is None:  # what was being made when it came goes half made, and without a word
            sys.unraisablehook = lambda *_: None
        return 130


def _parser() -> tuple[argparse.ArgumentParser, list[str]]:
    """The parser, and all its options."""
    parser = argparse.ArgumentParser(
        prog="python -m stillwork",
        description="The workbook's commands; `make help` lists those that set up the environment by themselves.",
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    figures = commands.add_parser("figures", help="build the figures that are stale", allow_abbrev=False)
    figures.add_argument("targets", nargs="*", metavar="ROOM[/NOTEBOOK]", help="by default everything")
    figures.add_argument(
        "-p",
        dest="settings",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="set a parameter; the results go to build/variants/",
    )
    figures.add_argument("--jobs", type=_count, metavar="N", help="kernels at once (default: one a core)")
    figures.add_argument("--scheduler", metavar="ADDRESS", help="run on the workers of a Dask cluster")
    figures.add_argument("--force", action="store_true", help="build what is up to date, too")
    figures.add_argument("--why", action="store_true", help="only say what would be built, and why")
    figures.set_defaults(run=_figures)

    readings = commands.add_parser(
        "readings", help="try every choice that the works leave open", allow_abbrev=False
    )
    readings.add_argument("room", nargs="?", metavar="ROOM")
    readings.add_argument("--jobs", type=_count, metavar="N", help="processes (default: one a core)")
    readings.add_argument("--scheduler", metavar="ADDRESS", help="run on the workers of a Dask cluster")
    readings.add_argument(
        "--budget",
        type=_minutes,
        metavar="MINUTES",
        help="begin no reading after so long; run again to go on",
    )
    readings.set_defaults(run=_readings)

    claims = commands.add_parser("claims", help="print the ledger", allow_abbrev=False)
    claims.add_argument("room", nargs="?", metavar="ROOM")
    claims.add_argument("--entry", metavar="ID", help="one entry whole, with its readings")
    claims.add_argument("--json", action="store_true")
    claims.add_argument(
        "--built", action="store_true", help="with what the last build found, accepted or not"
    )
    claims.set_defaults(run=_claims)

    portable = commands.add_parser(
        "portable", help="build under other processors' settings and compare", allow_abbrev=False
    )
    portable.add_argument("--sample", action="store_true", help="a few notebooks under two of them")
    portable.set_defaults(run=_portable)

    accept = commands.add_parser("accept", help="take the built results over into notebooks/ and the ledger")
    accept.set_defaults(run=_accept)

    site = commands.add_parser("site", help="write the static site to build/site")
    site.set_defaults(run=_site)

    release = commands.add_parser(
        "release", help="write wheel, site and archive to build/release, and try the wheel"
    )
    release.set_defaults(run=_release)

    refresh = commands.add_parser(
        "refresh", help="rewrite what follows from ledger and notebooks: README tables, index, manifests"
    )
    refresh.set_defaults(run=_refresh)

    inspect = commands.add_parser(
        "inspect", help="say what a file of yours holds and which notebooks can use it"
    )
    inspect.add_argument("file", metavar="FILE")
    inspect.set_defaults(run=_inspect)

    report = commands.add_parser(
        "report",
        help="write one page about a measurement of yours; what is missing, it asks",
        allow_abbrev=False,
    )
    report.add_argument("file", metavar="FILE", help="of a machine, a record, or power spectral densities")
    report.add_argument("--out", default="", metavar="PAGE", help="by default FILE.html, here")
    report.add_argument("--unit", default="", help="of a record's channels, or of densities")
    _add_reading(report)
    report.set_defaults(run=_report)

    design = commands.add_parser(
        "design", help="from a machine's file to a controller in C, and a page about it", allow_abbrev=False
    )
    design.add_argument("file", metavar="FILE", help="frequency response, hammer records, or M and K")
    design.add_argument("--rate", type=float, metavar="HZ", required=True, help="of the controller")
    _add_output(design)
    design.add_argument("--delay", type=int, metavar="SAMPLES", default=1, help="from measurement to force")
    design.add_argument("--limit", type=float, metavar="N", default=float("inf"), help="largest force")
    _add_reading(design)
    design.add_argument(
        "--loop-hz",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        default=(0.0, 0.0),
        help="where the measurement can be trusted",
    )
    design.add_argument("--mirrored-sensor", action="store_true", help="serve a mirrored sensor, too")
    design.add_argument(
        "--doubt", type=float, default=0.05, metavar="SHARE", help="by which resonances may differ"
    )
    design.add_argument("--damping-ratio", type=float, default=0.005, help="of matrices without damping")
    design.set_defaults(run=_design)

    export = commands.add_parser(
        "export", help="write C99 of a controller, or of FeRls or FeLms, from a file", allow_abbrev=False
    )
    export.add_argument("file", metavar="FILE", help="controller.json, or TOML")
    _add_output(export)
    export.set_defaults(run=_export)

    contest = commands.add_parser(
        "contest",
        help="run observers, yours among them, against hidden seeds and rank them",
        allow_abbrev=False,
    )
    contest.add_argument("files", nargs="*", metavar="MY_OBSERVER.py", help="each defines a class Observer")
    contest.add_argument(
        "--seeds", type=_count, metavar="N", default=2, help="scans a plant and doubt (default: 2)"
    )
    contest.add_argument(
        "--public",
        metavar="NUMBER",
        default="20180628",
        help="what the hidden seeds follow from, e.g. a lottery's draw",
    )
    contest.add_argument(
        "--loops", type=_count, metavar="N", help="seeds of which the loops are run, too (default: all)"
    )
    contest.add_argument(
        "--heavy", type=_count, metavar="N", help="seeds on which our heavy entrants run (default: all)"
    )
    contest.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help="of ours this one and the Kalman filter alone; the others' rows are those of the table --out",
    )
    contest.add_argument("--jobs", type=_count, metavar="N", help="processes (default: one a core)")
    contest.add_argument("--scheduler", metavar="ADDRESS", help="run on the workers of a Dask cluster")
    contest.add_argument("--out", metavar="FILE.csv", help="write the table there")
    contest.set_defaults(run=_contest)

    verify = commands.add_parser("verify", help="check stored results again by another library alone")
    verify.add_argument("name", metavar="NAME", help="e.g. joint")
    verify.set_defaults(run=_verify)

    new = commands.add_parser(
        "new", help="begin a result: notebook, ledger entry and test", allow_abbrev=False
    )
    new.add_argument("room", metavar="ROOM")
    new.add_argument("name", metavar="NAME", help="a number and words, e.g. 09-payload")
    new.set_defaults(run=_new)

    doctor = commands.add_parser("doctor", help="compare this environment with environment.txt")
    doctor.set_defaults(run=_doctor)
    usage = " ".join(command.format_usage() for command in commands.choices.values())
    return parser, re.findall(r"--?[a-z]+", usage)


def _add_output(command: argparse.ArgumentParser) -> None:
    """Options of what writes C into a folder."""
    command.add_argument("--out", metavar="DIR", required=True, help="a new or empty folder")
    command.add_argument("--name", default="controller", help="what all names in C begin with")
    command.add_argument("--precision", default="double", metavar="double|single")


def _add_reading(command: argparse.ArgumentParser) -> None:
    """Options of what reads a machine."""
    command.add_argument(
        "--fit-hz", type=float, nargs=2, metavar=("LOW", "HIGH"), default=(0.0, 0.0), help="of the fit"
    )
    command.add_argument("--response-unit", default="", help="by default what the file says, or m/s^2")
    command.add_argument("--force-unit", default="", help="by default what the file says, or N")
    command.add_argument("--response", default="", metavar="NAME", help="of several complex ones")
    command.add_argument("--sample-rate", type=float, metavar="HZ", help="of records that do not say it")


def _count(text: str) -> int:
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of kernels; give 1 or more")
    return int(text)


def _minutes(text: str) -> float:
    try:
        return require_number("budget", text, above=0)
    except InputError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time; give minutes, more than 0") from None


def _figures(options) -> int:
    from stillwork.workbook.build import build_figures

    settings = {}
    for text in options.settings:
        name, equals, value = text.partition("=")
        if not equals or not name.isidentifier():
            raise InputError(f"-p {text!r} is not a setting; give -p NAME=VALUE")
        if name in settings:
            raise InputError(f"-p {name} is given twice; keep one")
        settings[name] = value
    return build_figures(
        *options.targets,
        settings=settings,
        jobs=options.jobs,
        scheduler=options.scheduler,
        force=options.force,
        why=options.why,
    )


def _readings(options) -> int:
    from stillwork.workbook.readings.command import compute_readings

    return compute_readings(
        options.room, jobs=options.jobs, scheduler=options.scheduler, budget_min=options.budget
    )


def _claims(options) -> int:
    from stillwork.workbook.claims import ledger
    from stillwork.workbook.lock import settle
    from stillwork.workbook.report import entry_text, find, ledger_text, screen
    from stillwork.workbook.tasks import built

    if options.room not in (None, *paths.ROOMS):
        raise InputError(f"there is no room {options.room!r}{nearest(options.room, paths.ROOMS)}")
    settle()
    claims = ledger(built() if options.built else None, options.room)
    if options.entry:
        claims = [find(claims, options.entry)]
    if options.json:
        print(json.dumps(_with_readings(claims), indent=1, ensure_ascii=False))
    elif options.entry:
        print(entry_text(_with_readings(claims)[0], screen()))
    else:
        print(ledger_text(claims, screen()))
    return 0


def _with_readings(claims: list) -> list[dict]:
    """The claims as plain values, each with how it stands over its readings (None where it has none)."""
    from stillwork.workbook.readings.command import standings_of

    rooms = dict.fromkeys(claim.entry.room for claim in claims)
    standings = {name: standing for room in rooms for name, standing in standings_of(room).items()}
    return [
        claim.as_dict()
        | {"readings": standings[claim.entry.id].as_dict() if claim.entry.id in standings else None}
        for claim in claims
    ]


def _portable(options) -> int:
    from stillwork.workbook.portable import portable

    return portable(options.sample)


def _accept(_options) -> int:
    from stillwork.site.derived import refresh
    from stillwork.workbook.accept import accept

    return accept(refresh)


def _site(_options) -> int:
    from stillwork.site.build import build_site
    from stillwork.workbook.lock import settle

    settle()
    return build_site()


def _release(_options) -> int:
    from stillwork.site.release import release
    from stillwork.workbook.lock import settle

    settle()
    return release()


def _refresh(_options) -> int:
    from stillwork.site.derived import refresh
    from stillwork.workbook.lock import settle

    settle()
    print(", ".join(refresh()) or "all current")
    return 0


def _inspect(options) -> int:
    from stillwork.inspecting import inspect_file

    print(inspect_file(options.file))
    return 0


def _report(options) -> int:
    from stillwork.reporting import Missing, report_file

    chosen = {name: value for name, value in vars(options).items() if name not in ("run", "file", "out")}
    if any(chosen["fit_hz"]):
        chosen["fit_hz"] = tuple(chosen["fit_hz"])
    else:
        del chosen["fit_hz"]
    while True:
        try:
            print("\n".join(map(one_line, report_file(options.file, options.out, **chosen))))
        except Missing as missed:
            if not sys.stdin.isatty():
                raise
            answer = input(f"{one_line(missed.question)}: ").strip()
            chosen[missed.name] = _number(answer) if missed.name == "sample_rate" else answer
        else:
            return 0


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{text!r} is no number of Hz; begin again") from None


def _design(options) -> int:
    from stillwork.designing import design_file

    chosen = {name: value for name, value in vars(options).items() if name not in ("run", "file", "out")}
    chosen |= {band: tuple(chosen[band]) for band in ("fit_hz", "loop_hz")}
    print("\n".join(map(one_line, design_file(options.file, options.out, **chosen))))
    return 0


def _export(options) -> int:
    from stillwork.exporting import export_file

    written = export_file(options.file, options.out, options.name, options.precision)
    print(f"{options.out}: {', '.join(written)}")
    return 0


def _contest(options) -> int:
    from importlib import import_module  # the experiments stand above the package, in a checkout alone

    command = import_module("experiments.motion.observer_contest.table")
    chosen = {name: value for name, value in vars(options).items() if name not in ("run", "files")}
    return command.hold_contest(options.files, **chosen)


def _verify(options) -> int:
    from importlib import import_module

    prefix = "verify_"
    files = sorted((paths.root() / "lib" / "experiments").glob(f"*/{prefix}*.py"))
    modules = {
        file.stem.removeprefix(prefix): f"experiments.{file.parent.name}.{file.stem}" for file in files
    }
    if options.name not in modules:
        raise InputError(f"there is nothing to verify called {options.name!r}; use {', '.join(modules)}")
    return 0 if import_module(modules[options.name]).main() else 1


def _new(options) -> int:
    from stillwork.site.scaffold import new_result

    print("\n".join(new_result(options.room, options.name)))
    print(f'fill them in, then: make figures ARGS="{options.room}/{options.name}"')
    return 0


def _doctor(_options) -> int:
    from stillwork.workbook.doctor import doctor

    return doctor()


if __name__ == "__main__":
    sys.exit(main())
