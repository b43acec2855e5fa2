"""Command line of the engine: ``python -m workbook figures|choices|claims|accept|site|refresh|init|new|doctor``."""

import argparse
import os
import sys
from importlib import import_module

from workbook.checks import is_refusal, one_line

# A grammar of addresses that jsonschema builds for a second or two when a notebook format is loaded, if it can be
# had; nothing here holds an address against it.
sys.modules.setdefault("rfc3987_syntax", None)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code (2 for wrong input, 130 when interrupted)."""
    options = vars(_parser().parse_args(arguments))
    target, needs_root = options.pop("target"), options.pop("needs_root")
    try:
        if needs_root:  # who has no workbook misses no package
            import_module("workbook.paths").root()
        return _run(target, options)
    except BrokenPipeError:  # the reader, e.g. `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("", "workbook"):
            raise
        return _refuse(
            f"{error.name} is not installed; python -m pip install 'FOLDER_OR_WHEEL[site]', the clone or the wheel that this is of"
        )
    except OSError as error:
        told = error.filename and error.strerror and f"{os.fsdecode(error.filename)}: {error.strerror}"
        return _refuse(told or str(error))
    except ValueError as error:
        if not is_refusal(error):
            raise
        return _refuse(*str(error).split("\n"))
    except KeyboardInterrupt:
        if arguments is None:  # what was being made when it came goes half made, and without a word
            sys.unraisablehook = lambda *_: None
        return 130


def _refuse(*lines: str) -> int:
    print("workbook: " + "\n".join(map(one_line, lines)), file=sys.stderr)
    return 2


def _run(target: str, options: dict) -> int:
    """Call ``module:function`` with its options and print what it returns, unless that is the exit code."""
    module, _, name = target.partition(":")
    told = getattr(import_module(module), name)(**options)
    if isinstance(told, int):
        return told
    print("\n".join(map(one_line, told.split("\n") if isinstance(told, str) else told)))
    return 0


def offered() -> list[str]:
    """Names of the commands that work here: outside of a workbook only that which begins one."""
    try:
        import_module("workbook.paths").root()
    except OSError:
        return ["init"]
    return list(COMMANDS)


def model_file(path):
    """What the workbook can do with a TOML file of one's own: `workbook.own_files.model_file`."""
    from workbook.own_files import model_file

    return model_file(path)


def _above_zero(kind: type):
    """Reads a whole number or any number above 0."""

    def read(text: str):
        try:
            if 0 < (value := kind(text)) < 1e9:
                return value
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"{text!r} is no {'whole ' * (kind is int)}number above 0; give one")

    return read


def _named(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("'' names nothing; give a name")
    return text


COMMANDS = {
    "figures": "build the notebooks that are out of date",
    "choices": "try every choice that the papers leave open",
    "settings": "find which of these choices explain most printed numbers at once",
    "claims": "print the ledger",
    "accept": "copy the built results into notebooks/ and figures/",
    "site": "write the static site to build/site",
    "refresh": "rewrite the files derived from ledger and notebooks: README tables, index, manifests",
    "init": "start a workbook for a paper of your choice, in a new folder",
    "new": "start a result: notebook, its module, ledger entry and test",
    "doctor": "compare this environment with environment.txt",
}
TARGETS = {
    "accept": "workbook.commands:accept",
    "choices": "workbook.choices.command:compute_choices",
    "settings": "workbook.choices.settings:compute_settings",
    "site": "workbook.site.build:build_site",
    "init": "workbook.site.scaffold:begin",
    "doctor": "workbook.environment:doctor",
}  # of the others the function in `workbook.commands`


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m workbook",
        description="Commands of a workbook; in its folder all of them are listed here.",
        allow_abbrev=False,
    )
    group = parser.add_subparsers(required=True, metavar="COMMAND")
    listed = {name: {"help": COMMANDS[name]} for name in offered()}
    own = {
        name: group.add_parser(
            name, allow_abbrev=False, description=f"{text[:1].upper()}{text[1:]}.", **listed.get(name, {})
        )
        for name, text in COMMANDS.items()
    }
    for name, each in own.items():
        target = TARGETS.get(name, f"workbook.commands:{name}")
        each.set_defaults(target=target, needs_root=name != "init")
    cluster = {"type": _named, "metavar": "ADDRESS", "help": "run on the workers of a Dask cluster"}

    add = own["figures"].add_argument
    add("targets", nargs="*", metavar="TOPIC[/NOTEBOOK]", help="by default everything")
    set_by = "set a parameter; the results go to build/variants/"
    add("-p", dest="settings", metavar="NAME=VALUE", action="append", default=[], help=set_by)
    add("--jobs", type=_above_zero(int), metavar="N", help="kernels at once (default: one a core)")
    add("--scheduler", **cluster)
    add("--force", action="store_true", help="build what is up to date, too")
    add("--why", action="store_true", help="list what would be built, and why; build nothing")

    add = own["choices"].add_argument
    add("topic", nargs="?", metavar="TOPIC")
    add("--jobs", type=_above_zero(int), metavar="N", help="processes (default: one a core)")
    add("--scheduler", **cluster)
    until = "start no combination after this time; run again to continue"
    add("--budget", dest="budget_min", type=_above_zero(float), metavar="MINUTES", help=until)
    changed = "only studies that were never run or of which a sampled value moved"
    add("--changed", action="store_true", help=changed)
    add("--study", type=_named, metavar="NAME", help="only this study of the topic, all of its combinations")
    short = "compare the study's short form with its full form at every option"
    add("--short", action="store_true", help=short)

    add = own["settings"].add_argument
    add("topic", nargs="?", metavar="TOPIC")
    add("--jobs", type=_above_zero(int), metavar="N", help="processes (default: one a core)")

    add = own["claims"].add_argument
    add("topic", nargs="?", metavar="TOPIC")
    add("--entry", type=_named, metavar="ID", help="one entry in full, with its combinations")
    add("--json", action="store_true", help="as JSON")
    add("--built", action="store_true", help="with the results of the last build, accepted or not")

    still = "leave explorers that were not computed before as pictures, which takes half a minute"
    own["site"].add_argument("--still", action="store_true", help=still)

    own["init"].add_argument("folder", metavar="DIR")
    add = own["new"].add_argument
    add("topic", metavar="TOPIC")
    add("name", metavar="NAME", help="a number and words, e.g. 09-payload")
    add("--create", action="store_true", help="make the topic, too, if it does not exist")
    return parser


if __name__ == "__main__":
    sys.exit(main())
