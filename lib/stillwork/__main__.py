"""Command line: ``python -m stillwork inspect|report|design|isolate|budget|retest|desk|export|new|compile|contest``, and those of others."""

import os
import sys

# The matrices of a design are small: with the threads of a BLAS a fit takes 4.1 s of CPU, with one 1.5.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from stillwork.base.command_line import Command, Option, flag, named, number, option, run, text  # noqa: E402


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code (2 for wrong input, 130 when interrupted)."""
    return run("stillwork", COMMANDS, arguments)


def _file(help: str) -> Option:
    return option("file", type=named, metavar="FILE", help=help)


def _band(name: str, help: str) -> Option:
    return option(f"--{name}", type=float, nargs=2, metavar=("LOW", "HIGH"), default=(0.0, 0.0), help=help)


_C_FOLDER = (
    text("out", "DIR", "a new or empty folder", dest="folder", required=True),
    option("--name", default="controller", help="prefix of all names in the C code"),
    option("--precision", default="double", metavar="double|single"),
)
_OF_A_MACHINE = (
    _band("fit-hz", "band of the fit"),
    option("--response-unit", default="", help="default: as stated in the file, else m/s^2"),
    option("--force-unit", default="", help="default: as stated in the file, else N"),
    option("--response", default="", metavar="NAME", help="which one, if the file holds several"),
    number("sample-rate", "HZ", "of records that do not state it", float),
)

_OF_A_LOOP = (
    number("delay", "SAMPLES", "from measurement to force, may be a fraction; default 1", float, default=1.0),
    _band("loop-hz", "band in which the measurement is reliable"),
    option(
        "--uncertainty",
        default="",
        metavar="NAME=SHARE,...",
        help="frequency, residue, damping, gain, mass, delay (s), friction (1/s); none; default frequency=0.05,gain=0.05",
    ),
    option("--damping-ratio", type=float, default=0.005, help="for mass and stiffness without damping"),
)

_VERBOSE = flag("verbose", "print all findings, which are on the page")

COMMANDS = {
    "inspect": Command(
        "list what a file of yours holds and which commands and notebooks can use it",
        "stillwork.machine.inspect:inspect_file",
        (_file("your record, frequency response, machine or trajectory"),),
    ),
    "report": Command(
        "write a one-page report on your measurement; you are prompted for missing information",
        "stillwork.machine.report:report_asking",
        (
            _file("measured machine, record, or power spectral densities"),
            option("--out", default="", metavar="PAGE", help="default: FILE.html in this folder"),
            option("--unit", default="", help="of a record's channels, or of densities"),
            number("rate", "HZ", "of the controller (default: chosen and printed)", float, default=0.0),
            *_OF_A_MACHINE,
            *_OF_A_LOOP,
            _VERBOSE,
        ),
    ),
    "design": Command(
        "design a controller for your machine: C code and a report page",
        "stillwork.machine.design:design_file",
        (
            option(
                "files",
                type=named,
                nargs="+",
                metavar="FILE",
                help="frequency response, hammer records, or M and K; a matrix response is decoupled into axes; several files: one machine at other positions",
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
                help="of the setpoint: velocity, acceleration, jerk and optionally snap",
            ),
            number("counts", "N", "encoder counts per m or rad: inputs in counts", float, default=0.0),
            number("motor-constant", "K", "N/A or N m/A: output in A", float, default=0.0),
            number(
                "noise",
                "RMS",
                "sensor noise of one sample, in the controller's unit (default: rounding to counts)",
                float,
                default=0.0,
            ),
            number(
                "noise-share", "SHARE", "of the limit, allowed for noise; default 0.05", float, default=0.05
            ),
            number(
                "noise-ratio",
                "RATIO",
                "allowed noise ratio if noise or limit is unknown; default 30",
                float,
                default=0.0,
            ),
            *_OF_A_MACHINE,
            *_OF_A_LOOP,
            number("highest-hz", "HZ", "highest design bandwidth that is sought", float, default=0.0),
            flag("what-helps", "search for changes of the machine, too: takes five times as long"),
            _VERBOSE,
        ),
    ),
    "isolate": Command(
        "design a self-tuned feedforward for your isolator and floor: C code, certificate and report page",
        "stillwork.machine.isolate:isolate_file",
        (
            option(
                "machine",
                type=named,
                metavar="MACHINE",
                help="TOML of an isolator, or its measured response to its actuators",
            ),
            option("floor", type=named, metavar="FLOOR", help="record or spectra from the floor sensors"),
            number("rate", "HZ", "of the controller", float, required=True),
            text("out", "DIR", "a new or empty folder", dest="folder", required=True),
            option("--name", default="isolator", help="prefix of all names in the C code"),
            option("--precision", default="double", metavar="double|single"),
            option("--unit", default="", help="of the floor; default: as stated in the file"),
            option(
                "--channel", action="append", default=[], metavar="NAME", help="of the floor; repeat for more"
            ),
            number("limit", "N", "of each force", float, default=float("inf")),
            option("--algorithm", default="FeRls", metavar="FeRls|FeLms"),
            number(
                "variance", "SHARE", "power the weights' scatter may add; default 0.1", float, default=0.1
            ),
            number("spread", "SHARE", "uncertainty of the isolator; default 0.05", float, default=0.05),
            _band("band-hz", "of the filtered error (default: chosen)"),
            _VERBOSE,
        ),
    ),
    "budget": Command(
        "compute how still a machine can be, what limits it and what to buy next, on one page",
        "stillwork.machine.budget:budget_file",
        (
            option("machine", type=named, metavar="MACHINE.toml", help="stillwork new writes a template"),
            option("--floor", default="", metavar="FILE", help="record or spectral densities of your floor"),
            option(
                "--design", default="", metavar="DIR", help="written by design: use its stage and controller"
            ),
            option(
                "--isolate",
                default="",
                metavar="DIR",
                help="written by isolate: use its isolator and feedforward",
            ),
            option("--out", default="", metavar="DIR", help="folder of the page; default: this folder"),
            _VERBOSE,
        ),
    ),
    "new": Command(
        "write the commented template of a machine's TOML, which budget, isolate and design read",
        "stillwork.machine.machine_toml:new_machine",
        (
            option("file", metavar="FILE.toml", help="a new file"),
            option(
                "--like",
                default="wafer-stage",
                metavar="NAME",
                help="wafer-stage, microscope-stage, telescope-mirror or small-isolator: whose numbers it holds",
            ),
        ),
    ),
    "retest": Command(
        "check whether what a design promised holds on a new response; write a report page",
        "stillwork.machine.retest:retest_file",
        (
            option("controller", type=named, metavar="CONTROLLER.json", help="written by design"),
            _file("new measurement of the machine, in the same units"),
            option("--out", default="", metavar="PAGE", help="default: FILE.retest.html in this folder"),
            flag(
                "closed-loop",
                "FILE is the ratio of the force on the machine to the injected one, measured in closed loop",
            ),
            *_OF_A_MACHINE,
            _band("loop-hz", "band in which the measurement is reliable"),
            _VERBOSE,
        ),
    ),
    "desk": Command(
        "write a page on which you shape a loop by hand on a measurement, in any browser",
        "stillwork.machine.desk:desk_file",
        (
            option("file", nargs="?", default="", metavar="FILE", help="as for design; default: an example"),
            option("--out", default="", metavar="PAGE", help="default: FILE.html in this folder"),
            number("rate", "HZ", "of the controller at the start", float, default=0.0),
            *_OF_A_MACHINE,
            *_OF_A_LOOP,
        ),
    ),
    "export": Command(
        "write a controller, or FeRls or FeLms, as C99 from a file",
        "stillwork.machine.export:export_file",
        (_file("controller.json, or TOML"), *_C_FOLDER),
    ),
    "compile": Command(
        "compile the estimators and filters once after an installation, so that no first call waits",
        "stillwork.machine.compiling:compile_kernels",
        (),
    ),
    "contest": Command(
        "run an observer of yours, with your rights, and rank it beside the built-in ones",
        "contest.table:hold_contest",  # needs a checkout, and reports where there is none
        (
            option(
                "files",
                nargs="*",
                metavar="MY_OBSERVER.py",
                help="each defines a class Observer; without files the committed standings are printed",
            ),
            option(
                "--machine",
                action="append",
                default=[],
                metavar="NAME",
                help="run on this machine only; may be repeated (default: every machine)",
            ),
            flag("all", "run every scan of the table, with its closed loops, and the measured record"),
            flag("tuned", "first let the official tuner set the parameters that a file declares"),
            flag("verbose", "print the whole table, too"),
            text("out", "FILE.csv", "write the table with a column for each file"),
        ),
    ),
}


if __name__ == "__main__":
    sys.exit(main())
