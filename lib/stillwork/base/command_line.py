"""The command line of the toolbox: commands, their options, and what becomes of an error."""

import argparse
import os
import re
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NamedTuple

from stillwork.base.checks import nearest, one_line
from stillwork.base.extras import MissingPackage, missing

# Modules of other packages whose commands are offered, too: each has ``COMMANDS`` (help by name), ``main(arguments)``,
# ``offered()``, the names of those that work in this folder, and ``model_file(path)``, which says what uses a TOML file
# as a machine.
OTHERS = "stillwork.commands"  # their group of entry points
BESIDE = "workbook.__main__"  # of an environment that was installed before its distribution named it there


def others() -> list[ModuleType]:
    """What else has commands in this environment."""
    found = {point.value for point in entry_points(group=OTHERS)}
    if not found and find_spec(BESIDE.partition(".")[0]):
        found = {BESIDE}
    return [import_module(name) for name in sorted(found)]


def run(program: str, commands: dict[str, "Command"], arguments: list[str] | None = None) -> int:
    """Run a command, of a program's or of `others`; returns the exit code (2 for wrong input, 130 when interrupted)."""
    words = sys.argv[1:] if arguments is None else arguments
    more: list[ModuleType] = []
    if not (words and words[0] in commands):
        more = others()
        for other in more:
            if words and words[0] in other.COMMANDS:
                return other.main(words)
    parser = _parser(program, commands, more)
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        parser.error(f"unknown {unknown[0]!r}{_meant(unknown[0], options.command, commands)}")
    try:
        return _run(**vars(options))
    except BrokenPipeError:  # the reader, e.g. `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (ValueError, OSError, ImportError) as error:
        if isinstance(error, ValueError) and not _is_refusal(error):
            raise
        told = missing(error) if isinstance(error, ModuleNotFoundError) else error
        if isinstance(told, ImportError) and not isinstance(told, MissingPackage):
            raise
        if isinstance(told, OSError) and told.filename and told.strerror:
            told = f"{os.fsdecode(told.filename)}: {told.strerror}"
        text = options.command.by_options(str(told))
        # A message of several lines has escaped what stands in them; the name of a file in another has not.
        lines = map(one_line, text.split("\n") if isinstance(told, ValueError) else [text])
        print(f"{program}: " + "\n".join(lines), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        if arguments is None:  # what was being made when it came goes half made, and without a word
            sys.unraisablehook = lambda *_: None
        return 130


def _run(command: "Command", **chosen) -> int:
    """Call the function of a command with its options and print what it returns, unless that is the exit code."""
    told = _function(command.target)(**chosen)
    if isinstance(told, int):
        return told
    lines = told.split("\n") if isinstance(told, str) else told
    print("\n".join(one_line(command.by_options(line)) for line in lines))
    return 0


def _is_refusal(error: ValueError) -> bool:
    """Whether the message is for the reader: an `InputError`, here or of that name in a package that is called."""
    return any(each.__name__ == "InputError" for each in type(error).__mro__)


def _function(target: str) -> Callable:
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def _meant(word: str, command: "Command", commands: dict[str, "Command"]) -> str:
    """What an option that a command does not have may have meant: one of its own, or which commands have it."""
    if word[:1] != "-":
        return ""
    name = word.partition("=")[0]
    others = [each for each, other in commands.items() if name in other.words]
    return f"; it is an option of {', '.join(others)}" if others else nearest(name, command.words, "--", 0.6)


def _parser(program: str, commands: dict[str, "Command"], more: list[ModuleType]) -> argparse.ArgumentParser:
    also = [
        f"{', '.join(each.offered())} (python -m {each.__name__.removesuffix('.__main__')} --help)"
        for each in more
    ]
    parser = argparse.ArgumentParser(
        prog=f"python -m {program}",
        epilog=f"also: {'; '.join(also)}" if also else None,
        allow_abbrev=False,
    )
    group = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, command in commands.items():
        listed: dict[str, Any] = {"help": command.help} if command.works_here else {}
        text = f"{command.help[:1].upper()}{command.help[1:]}."
        own = group.add_parser(name, allow_abbrev=False, description=text, **listed)
        own.set_defaults(command=command)
        for names, how in command.options:
            own.add_argument(*names, **how)
    return parser


Option = tuple[tuple[str, ...], dict[str, Any]]  # what `add_argument` takes


def option(*names: str, **how) -> Option:
    """An option, or where its name has no dash a word, as `add_argument` takes it."""
    return names, how


def count(text: str) -> int:
    """A number of things, as it is typed."""
    # Decimal alone: int() takes no superscripts, and not more than some thousand digits.
    if not text.isdecimal() or len(text) > 9 or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number; give 1 or more")
    return int(text)


def named(text: str) -> str:
    """A text that is not empty."""
    if not text:
        raise argparse.ArgumentTypeError("'' names nothing; give a name")
    return text


class Command(NamedTuple):
    """A command: each option is an argument of the function that it calls."""

    help: str
    target: str  # ``module:function``, imported when it is called
    options: tuple[Option, ...] = ()

    def by_options(self, text: str) -> str:
        """A text with the arguments of the function named as the options are: fit_hz is --fit-hz."""
        longer = {word[2:].replace("-", "_"): word for word in self.words if "-" in word[2:]}
        text, known, names = text.partition("; known: ")  # of a file
        if longer:
            text = re.sub(
                rf"(?<![\w./-])({'|'.join(longer)})(?![\w/]|\.\w)", lambda found: longer[found[0]], text
            )
        return text + known + names

    @property
    def works_here(self) -> bool:
        """Whether its package is there: some stand in a clone alone."""
        return find_spec(self.target.partition(".")[0]) is not None

    @property
    def words(self) -> list[str]:
        """Its options, as they are typed."""
        return [name for names, _ in self.options for name in names if name[:1] == "-"]


def number(name: str, metavar: str, help: str, type: Callable = count, **how) -> Option:
    """``--name NUMBER``."""
    return option(f"--{name}", type=type, metavar=metavar, help=help, **how)


def text(name: str, metavar: str, help: str, **how) -> Option:
    """``--name TEXT``."""
    return option(f"--{name}", type=named, metavar=metavar, help=help, **how)


def flag(name: str, help: str) -> Option:
    """``--name`` alone."""
    return option(f"--{name}", action="store_true", help=help)
