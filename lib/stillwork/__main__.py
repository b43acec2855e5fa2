"""Command line: ``python -m stillwork inspect|report|design|isolate|budget|retest|desk|export|contest``, and the commands of ``python -m workbook``."""

import os
import sys

# The matrices of a design are small: with the threads of a BLAS a fit takes 4.1 s of CPU, with one 1.5.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from stillwork.base.checks import InputError  # noqa: E402
from stillwork.base.command_line import Command, Option, flag, named, number, option, run, text  # noqa: E402
from workbook.__main__ import COMMANDS as OF_THE_WORKBOOK  # noqa: E402
from workbook.__main__ import PROCESSES, RENAMED, SCHEDULER  # noqa: E402


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code (2 for wrong input, 130 when interrupted)."""
    return run("stillwork", OF_THE_WORKBOOK | COMMANDS, arguments, RENAMED)


def new(topic: str, name: str, create: bool) -> list[str]:
    """``new budget`` alone writes templates of machines, ``new isolate FILE`` that of an isolator; else a result begins."""
    if topic == "budget" and not name:
        from stillwork.design.budget import new_budget

        return new_budget()
    if topic == "isolate" and name:
        from stillwork.design.isolate import new_file

        return new_file(name)
    from workbook import commands, paths

    paths.root()  # refuses what is no workbook
    if not name:
        raise InputError("name is missing; give a number and words, e.g. 09-payload")
    return commands.new(topic, name, create)


def _file(help: str) -> Option:
    return option("file", type=named, metavar="FILE", help=help)


def _band(name: str, help: str) -> Option:
    return option(f"--{name}", type=float, nargs=2, metavar=("LOW", "HIGH"), default=(0.0, 0.0), help=help)


_C_FOLDER = (
    text("out", "DIR", "a new or empty folder", dest="folder", required=True),
    option("--name", default="controller", help="what all names in C begin with"),
    option("--precision", default="double", metavar="double|single"),
)
_OF_A_MACHINE = (
    _band("fit-hz", "of the fit"),
    option("--response-unit", default="", help="by default what the file says, or m/s^2"),
    option("--force-unit", default="", help="by default what the file says, or N"),
    option("--response", default="", metavar="NAME", help="of several complex ones"),
    number("sample-rate", "HZ", "of records that do not say it", float),
)

_OF_A_LOOP = (
    number("delay", "SAMPLES", "from measurement to force, whole or not; default 1", float, default=1.0),
    _band("loop-hz", "where the measurement can be trusted"),
    option(
        "--uncertainty",
        default="",
        metavar="NAME=SHARE,...",
        help="frequency, residue, damping, gain, mass, delay (s), friction (1/s); none; default frequency=0.05,gain=0.05",
    ),
    option("--damping-ratio", type=float, default=0.005, help="of matrices without damping"),
)

COMMANDS = {
    "inspect": Command(
        "say what a file of yours holds and which notebooks can use it",
        "stillwork.design.inspect:inspect_file",
        (_file("a record, a frequency response, a machine or a trajectory of yours"),),
    ),
    "report": Command(
        "write one page about a measurement of yours; what is missing, it asks",
        "stillwork.design.report:report_asking",
        (
            _file("of a machine, a record, or power spectral densities"),
            option("--out", default="", metavar="PAGE", help="by default FILE.html, here"),
            option("--unit", default="", help="of a record's channels, or of densities"),
            number("rate", "HZ", "of the controller (default: chosen and printed)", float, default=0.0),
            *_OF_A_MACHINE,
            *_OF_A_LOOP,
        ),
    ),
    "design": Command(
        "from a machine's file to a controller in C, and a page about it",
        "stillwork.design.design:design_file",
        (
            option(
                "files",
                type=named,
                nargs="+",
                metavar="FILE",
                help="frequency response, hammer records, or M and K; several: one machine elsewhere, all served",
            ),
            number("rate", "HZ", "of the controller", float, required=True),
            *_C_FOLDER,
            number("limit", "N", "largest output, N, N m or A", float, default=float("inf")),
            option(
                "--limits",
                type=float,
                nargs="+",
                default=(),
                metavar="NUMBER",
                help="of the setpoint: velocity, acceleration, jerk, perhaps snap",
            ),
            number("counts", "N", "encoder counts a m or rad: inputs in counts", float, default=0.0),
            number("motor-constant", "K", "N/A or N m/A: output in A", float, default=0.0),
            number(
                "noise",
                "RMS",
                "of a sample, in the controller's unit (default: of counts)",
                float,
                default=0.0,
            ),
            number("noise-share", "SHARE", "of the limit it may take; default 0.05", float, default=0.05),
            number("noise-ratio", "RATIO", "allowed without it or a limit; default 30", float, default=0.0),
            *_OF_A_MACHINE,
            *_OF_A_LOOP,
            flag("mirrored-sensor", "serve a mirrored sensor, too"),
        ),
    ),
    "isolate": Command(
        "from an isolator and its floor to a self-tuned feedforward in C, certified, and a page about it",
        "stillwork.design.isolate:isolate_file",
        (
            option(
                "machine",
                type=named,
                metavar="MACHINE",
                help="TOML of an isolator, or its measured response to its actuators",
            ),
            option("floor", type=named, metavar="FLOOR", help="record or spectra of the floor sensors"),
            number("rate", "HZ", "of the controller", float, required=True),
            text("out", "DIR", "a new or empty folder", dest="folder", required=True),
            option("--name", default="isolator", help="what all names in C begin with"),
            option("--precision", default="double", metavar="double|single"),
            option("--unit", default="", help="of the floor, by default what the file says"),
            option(
                "--channel", action="append", default=[], metavar="NAME", help="of the floor; again for more"
            ),
            number("limit", "N", "of each force", float, default=float("inf")),
            option("--algorithm", default="FeRls", metavar="FeRls|FeLms"),
            number("variance", "SHARE", "that the weights' scatter may add; default 0.1", float, default=0.1),
            number("spread", "SHARE", "how far the isolator may be off; default 0.05", float, default=0.05),
            _band("band-hz", "of the filtered error (default: chosen)"),
        ),
    ),
    "budget": Command(
        "say how still a machine can be, what limits it, and what to buy next, on one page",
        "stillwork.design.budget:budget_file",
        (
            option("machine", type=named, metavar="MACHINE.toml", help="begin it by: stillwork new budget"),
            option("--floor", default="", metavar="FILE", help="a record or densities of your floor"),
            option("--design", default="", metavar="DIR", help="that design wrote: its stage and controller"),
            option("--out", default="", metavar="DIR", help="of the page, by default here"),
        ),
    ),
    "new": Command(
        "begin a result of the workbook; `new budget` alone: templates of machines for budget; `new isolate FILE`: of an isolator",
        "stillwork.__main__:new",
        (
            option("topic", metavar="TOPIC"),
            option("name", nargs="?", default="", metavar="NAME", help="a number and words, e.g. 09-payload"),
            flag("create", "in a topic that is not there yet"),
        ),
    ),
    "retest": Command(
        "say on a page whether a new response keeps what a design promised",
        "stillwork.design.retest:retest_file",
        (
            option("controller", type=named, metavar="CONTROLLER.json", help="that design wrote"),
            _file("the machine again, in the same units"),
            option("--out", default="", metavar="PAGE", help="by default FILE.retest.html, here"),
            flag(
                "closed-loop",
                "FILE is the force on the machine over the one injected, the controller running",
            ),
            *_OF_A_MACHINE,
            _band("loop-hz", "where the measurement can be trusted"),
        ),
    ),
    "desk": Command(
        "write one page on which a loop is shaped by hand on a measurement, in any browser",
        "stillwork.design.desk:desk_file",
        (
            option("file", nargs="?", default="", metavar="FILE", help="as for design; without, an example"),
            option("--out", default="", metavar="PAGE", help="by default FILE.html, here"),
            number("rate", "HZ", "of the controller, to begin with", float, default=0.0),
            *_OF_A_MACHINE,
            *_OF_A_LOOP,
        ),
    ),
    "export": Command(
        "write C99 of a controller, or of FeRls or FeLms, from a file",
        "stillwork.design.export:export_file",
        (_file("controller.json, or TOML"), *_C_FOLDER),
    ),
    "contest": Command(
        "run observers, yours among them, against hidden seeds and rank them",
        "contest.table:hold_contest",  # in a checkout alone, which it says by itself
        (
            option(
                "files",
                nargs="*",
                metavar="MY_OBSERVER.py",
                help="each defines a class Observer; or a library MY_OBSERVER.so, or tcp:HOST:PORT",
            ),
            number("seeds", "N", "scans a machine and uncertainty (default: 1)", default=1),
            flag("hidden", "read the public number that the seeds follow from, on standard input"),
            flag("tuned", "set the knobs that a file declares by the official tuner first"),
            number("loops", "N", "seeds of which the loops are run, too; 0 for none (default: all)", int),
            option(
                "--only",
                action="append",
                default=[],
                metavar="NAME",
                help="of ours this one and the Kalman filter alone; the others' rows are those of the table --out",
            ),
            text("dev", "FOLDER", "write the development set there, with its truth, and run nothing"),
            PROCESSES,
            SCHEDULER,
            text("out", "FILE.csv", "write or extend the table there, with its results as JSON beside it"),
        ),
    ),
}


if __name__ == "__main__":
    sys.exit(main())
