"""Command line of the engine: ``python -m workbook figures|choices|claims|accept|site|refresh|init|new|doctor``."""

import argparse
import sys

from stillwork.base.checks import require_number
from stillwork.base.command_line import Command, flag, number, option, run, text


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code (2 for wrong input, 130 when interrupted)."""
    return run("workbook", COMMANDS, arguments, RENAMED)


def _minutes(text: str) -> float:
    try:
        return require_number("budget", float(text), above=0)
    except ValueError:  # an `InputError` among them
        raise argparse.ArgumentTypeError(f"{text!r} is not a time; give minutes, more than 0") from None


RENAMED = {"readings": "choices"}  # by their old names, for this version
IN_A_WORKBOOK = ("workbook.paths:root",)  # who has none misses no package
_TARGETS = option("targets", nargs="*", metavar="TOPIC[/NOTEBOOK]", help="by default everything")
_TOPIC = option("topic", nargs="?", metavar="TOPIC")
_KERNELS = number("jobs", "N", "kernels at once (default: one a core)")
PROCESSES = number("jobs", "N", "processes (default: one a core)")
SCHEDULER = text("scheduler", "ADDRESS", "run on the workers of a Dask cluster")

COMMANDS = {
    "figures": Command(
        "build the notebooks that are out of date",
        "workbook.commands:figures",
        (
            _TARGETS,
            option(
                "-p",
                dest="settings",
                metavar="NAME=VALUE",
                action="append",
                default=[],
                help="set a parameter; the results go to build/variants/",
            ),
            _KERNELS,
            SCHEDULER,
            flag("force", "build what is up to date, too"),
            flag("why", "list what would be built, and why; build nothing"),
        ),
        before=IN_A_WORKBOOK,
    ),
    "choices": Command(
        "try every choice that the papers leave open",
        "workbook.choices.command:compute_choices",
        (
            _TOPIC,
            PROCESSES,
            SCHEDULER,
            number(
                "budget",
                "MINUTES",
                "start no combination after this time; run again to continue",
                _minutes,
                dest="budget_min",
            ),
            flag("changed", "only studies that were never run or of which a sampled value moved"),
            text("study", "NAME", "only this study of the topic, all of its combinations"),
            flag("short", "compare the study's short form with its full form at every option"),
        ),
        before=IN_A_WORKBOOK,
    ),
    "claims": Command(
        "print the ledger",
        "workbook.commands:claims",
        (
            _TOPIC,
            text("entry", "ID", "one entry in full, with its combinations"),
            flag("json", "as JSON"),
            flag("built", "with the results of the last build, accepted or not"),
        ),
        before=IN_A_WORKBOOK,
    ),
    "accept": Command(
        "copy the built results into notebooks/ and figures/",
        "workbook.commands:accept",
        before=IN_A_WORKBOOK,
    ),
    "site": Command(
        "write the static site to build/site", "workbook.site.build:build_site", before=IN_A_WORKBOOK
    ),
    "refresh": Command(
        "rewrite the files derived from ledger and notebooks: README tables, index, manifests",
        "workbook.commands:refresh",
        before=IN_A_WORKBOOK,
    ),
    "init": Command(
        "start a workbook for a paper of your choice, in a new folder",
        "workbook.site.scaffold:begin",
        (option("folder", metavar="DIR"),),
    ),
    "new": Command(
        "start a result: notebook, its module, ledger entry and test",
        "workbook.commands:new",
        (
            option("topic", metavar="TOPIC"),
            option("name", metavar="NAME", help="a number and words, e.g. 09-payload"),
            flag("create", "make the topic, too, if it does not exist"),
        ),
        before=IN_A_WORKBOOK,
    ),
    "doctor": Command(
        "compare this environment with environment.txt", "workbook.environment:doctor", before=IN_A_WORKBOOK
    ),
}


if __name__ == "__main__":
    sys.exit(main())
