"""Command line: ``python -m stillwork figures|readings|claims|portable|accept|site|release|refresh|inspect|report|design|desk|export|contest|verify|new|doctor``."""

import argparse
import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from stillwork.base import paths
from stillwork.base.checks import InputError, nearest, one_line, require_number
from stillwork.base.extras import MissingPackage, missing

# A grammar of addresses that jsonschema builds for a second or two when a notebook format is loaded, if it can be
# had; nothing here holds an address against it.
sys.modules.setdefault("rfc3987_syntax", None)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code (2 for wrong input, 130 when interrupted)."""
    parser = _parser()
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        parser.error(f"unknown {unknown[0]!r}{_meant(unknown[0], options.command)}")
    try:
        return _run(**vars(options))
    except BrokenPipeError:  # the reader, e.g. `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (InputError, OSError, ImportError) as error:
        told = missing(error) if isinstance(error, ModuleNotFoundError) else error
        if isinstance(told, ImportError) and not isinstance(told, MissingPackage):
            raise
        if isinstance(told, OSError) and told.filename and told.strerror:
            told = f"{os.fsdecode(told.filename)}: {told.strerror}"
        print(f"stillwork: {one_line(str(told))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        if arguments is None:  # what was being made when it came goes half made, and without a word
            sys.unraisablehook = lambda *_: None
        return 130


def _run(command: "Command", **chosen) -> int:
    """Call the function of a command with its options and print what it returns, unless that is the exit code."""
    if command.needs_checkout:
        paths.root()  # who has none misses no package
    if command.settles:
        import_module("stillwork.workbook.lock").settle()
    module, _, name = command.target.partition(":")
    told = getattr(import_module(module), name)(**chosen)
    if isinstance(told, int):
        return told
    print(told if isinstance(told, str) else "\n".join(map(one_line, told)))
    return 0


def _meant(word: str, command: "Command") -> str:
    """What an option that a command does not have may have meant: one of its own, or which commands have it."""
    if word[:1] != "-":
        return ""
    name = word.partition("=")[0]
    others = [each for each, other in COMMANDS.items() if name in other.words]
    return f"; it is an option of {', '.join(others)}" if others else nearest(name, command.words)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m stillwork",
        description="The workbook's commands; `make help` lists those that set up the environment by themselves.",
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        own = commands.add_parser(name, help=command.help, allow_abbrev=False)
        own.set_defaults(command=command)
        for names, how in command.options:
            own.add_argument(*names, **how)
    return parser


Option = tuple[tuple[str, ...], dict[str, Any]]  # what `add_argument` takes


def _option(*names: str, **how) -> Option:
    return names, how


def _count(text: str) -> int:
    # Decimal alone: int() takes no superscripts, and not more than some thousand digits.
    if not text.isdecimal() or len(text) > 9 or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number; give 1 or more")
    return int(text)


def _named(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("'' names nothing; give a name")
    return text


def _minutes(text: str) -> float:
    try:
        return require_number("budget", float(text), above=0)
    except ValueError:  # an `InputError` among them
        raise argparse.ArgumentTypeError(f"{text!r} is not a time; give minutes, more than 0") from None


class Command(NamedTuple):
    """A command: each option is an argument of the function that it calls."""

    help: str
    target: str  # ``module:function``, imported when it is called
    options: tuple[Option, ...] = ()
    needs_checkout: bool = True
    settles: bool = False  # an accept that was killed is finished first

    @property
    def words(self) -> list[str]:
        """Its options, as they are typed."""
        return [name for names, _ in self.options for name in names if name[:1] == "-"]


def _number(name: str, metavar: str, help: str, type: Callable = _count, **how) -> Option:
    return _option(f"--{name}", type=type, metavar=metavar, help=help, **how)


def _text(name: str, metavar: str, help: str, **how) -> Option:
    return _option(f"--{name}", type=_named, metavar=metavar, help=help, **how)


def _flag(name: str, help: str) -> Option:
    return _option(f"--{name}", action="store_true", help=help)


def _file(help: str) -> Option:
    return _option("file", type=_named, metavar="FILE", help=help)


def _band(name: str, help: str) -> Option:
    return _option(f"--{name}", type=float, nargs=2, metavar=("LOW", "HIGH"), default=(0.0, 0.0), help=help)


_TARGETS = _option("targets", nargs="*", metavar="ROOM[/NOTEBOOK]", help="by default everything")
_ROOM = _option("room", nargs="?", metavar="ROOM")
_KERNELS = _number("jobs", "N", "kernels at once (default: one a core)")
_PROCESSES = _number("jobs", "N", "processes (default: one a core)")
_SCHEDULER = _text("scheduler", "ADDRESS", "run on the workers of a Dask cluster")
_C_FOLDER = (
    _text("out", "DIR", "a new or empty folder", dest="folder", required=True),
    _option("--name", default="controller", help="what all names in C begin with"),
    _option("--precision", default="double", metavar="double|single"),
)
_OF_A_MACHINE = (
    _band("fit-hz", "of the fit"),
    _option("--response-unit", default="", help="by default what the file says, or m/s^2"),
    _option("--force-unit", default="", help="by default what the file says, or N"),
    _option("--response", default="", metavar="NAME", help="of several complex ones"),
    _number("sample-rate", "HZ", "of records that do not say it", float),
)
_UNCERTAINTY = _option(
    "--uncertainty",
    default="",
    metavar="NAME=SHARE,...",
    help="frequency, residue, damping, gain, mass, delay (s); none; default frequency=0.05,gain=0.05",
)
_DAMPING_RATIO = _option("--damping-ratio", type=float, default=0.005, help="of matrices without damping")

COMMANDS = {
    "figures": Command(
        "build the figures that are stale",
        "stillwork.workbook.commands:figures",
        (
            _TARGETS,
            _option(
                "-p",
                dest="settings",
                metavar="NAME=VALUE",
                action="append",
                default=[],
                help="set a parameter; the results go to build/variants/",
            ),
            _KERNELS,
            _SCHEDULER,
            _flag("force", "build what is up to date, too"),
            _flag("why", "only say what would be built, and why"),
        ),
    ),
    "readings": Command(
        "try every choice that the works leave open",
        "stillwork.workbook.readings.command:compute_readings",
        (
            _ROOM,
            _PROCESSES,
            _SCHEDULER,
            _number(
                "budget",
                "MINUTES",
                "begin no reading after so long; run again to go on",
                _minutes,
                dest="budget_min",
            ),
            _flag("changed", "only studies with a value that moved, in a sample, and those never run"),
            _text("study", "NAME", "only this study of the room, all of it"),
        ),
    ),
    "claims": Command(
        "print the ledger",
        "stillwork.workbook.commands:claims",
        (
            _ROOM,
            _text("entry", "ID", "one entry whole, with its readings"),
            _flag("json", "as JSON"),
            _flag("built", "with what the last build found, accepted or not"),
        ),
        settles=True,
    ),
    "portable": Command(
        "build under other processors' settings and compare",
        "stillwork.workbook.portable:portable",
        (
            _TARGETS,
            _option(
                "--processor",
                default="",
                metavar="NAME",
                help="part of a stand-in's name, e.g. 2004; qemu emulates one",
            ),
            _flag("sample", "a few notebooks under two of them"),
        ),
    ),
    "accept": Command(
        "copy the built results into notebooks/ and figures/", "stillwork.site.commands:accept"
    ),
    "site": Command("write the static site to build/site", "stillwork.site.build:build_site", settles=True),
    "release": Command(
        "write wheel, site and archive to build/release, and try the wheel",
        "stillwork.site.release:release",
        settles=True,
    ),
    "refresh": Command(
        "rewrite what follows from ledger and notebooks: README tables, index, manifests",
        "stillwork.site.commands:refresh",
        settles=True,
    ),
    "inspect": Command(
        "say what a file of yours holds and which notebooks can use it",
        "stillwork.inspecting:inspect_file",
        (_file("a record, a frequency response, a machine or a trajectory of yours"),),
        needs_checkout=False,
    ),
    "report": Command(
        "write one page about a measurement of yours; what is missing, it asks",
        "stillwork.reporting:report_asking",
        (
            _file("of a machine, a record, or power spectral densities"),
            _option("--out", default="", metavar="PAGE", help="by default FILE.html, here"),
            _option("--unit", default="", help="of a record's channels, or of densities"),
            *_OF_A_MACHINE,
        ),
        needs_checkout=False,
    ),
    "design": Command(
        "from a machine's file to a controller in C, and a page about it",
        "stillwork.designing:design_file",
        (
            _file("frequency response, hammer records, or M and K"),
            _number("rate", "HZ", "of the controller", float, required=True),
            *_C_FOLDER,
            _number("delay", "SAMPLES", "from measurement to force, whole or not", float, default=1.0),
            _number("limit", "N", "largest output, N, N m or A", float, default=float("inf")),
            _number("counts", "N", "encoder counts a m or rad: inputs in counts", float, default=0.0),
            _number("motor-constant", "K", "N/A or N m/A: output in A", float, default=0.0),
            *_OF_A_MACHINE,
            _band("loop-hz", "where the measurement can be trusted"),
            _flag("mirrored-sensor", "serve a mirrored sensor, too"),
            _UNCERTAINTY,
            _DAMPING_RATIO,
        ),
        needs_checkout=False,
    ),
    "desk": Command(
        "write one page on which a loop is shaped by hand on a measurement, in any browser",
        "stillwork.desk:desk_file",
        (
            _option("file", nargs="?", default="", metavar="FILE", help="as for design; without, an example"),
            _option("--out", default="", metavar="PAGE", help="by default FILE.html, here"),
            _number("rate", "HZ", "of the controller, to begin with", float, default=0.0),
            _number("delay", "SAMPLES", "from measurement to force, to begin with", float, default=1.0),
            *_OF_A_MACHINE,
            _band("loop-hz", "where the measurement can be trusted"),
            _UNCERTAINTY,
            _DAMPING_RATIO,
        ),
        needs_checkout=False,
    ),
    "export": Command(
        "write C99 of a controller, or of FeRls or FeLms, from a file",
        "stillwork.exporting:export_file",
        (_file("controller.json, or TOML"), *_C_FOLDER),
        needs_checkout=False,
    ),
    "contest": Command(
        "run observers, yours among them, against hidden seeds and rank them",
        "experiments.motion.observer_contest.table:hold_contest",  # in a checkout alone, which it says by itself
        (
            _option("files", nargs="*", metavar="MY_OBSERVER.py", help="each defines a class Observer"),
            _number("seeds", "N", "scans a plant and doubt (default: 2)", default=2),
            _text(
                "public",
                "NUMBER",
                "what the hidden seeds follow from, e.g. a lottery's draw",
                default="20180628",
            ),
            _number("loops", "N", "seeds of which the loops are run, too (default: all)"),
            _number("heavy", "N", "seeds on which our heavy entrants run (default: all)"),
            _option(
                "--only",
                action="append",
                default=[],
                metavar="NAME",
                help="of ours this one and the Kalman filter alone; the others' rows are those of the table --out",
            ),
            _PROCESSES,
            _SCHEDULER,
            _text("out", "FILE.csv", "write the table there"),
        ),
        needs_checkout=False,
    ),
    "verify": Command(
        "check stored results again by another library alone",
        "stillwork.workbook.commands:verify",
        (_option("name", metavar="NAME", help="e.g. joint"),),
    ),
    "new": Command(
        "begin a result: notebook, ledger entry and test",
        "stillwork.site.commands:new",
        (
            _option("room", metavar="ROOM"),
            _option("name", metavar="NAME", help="a number and words, e.g. 09-payload"),
            _flag("create", "in a room that is not there yet"),
        ),
    ),
    "doctor": Command("compare this environment with environment.txt", "stillwork.workbook.doctor:doctor"),
}


if __name__ == "__main__":
    sys.exit(main())
