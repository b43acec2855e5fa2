"""The settings of processor and process under which numbers are made; `pinned.env` states the reason of each.

Of the other variables of the environment `variables.toml` states which are cleared and which are inputs.
"""

import os
import tomllib
from functools import cache
from pathlib import Path

from workbook import paths
from workbook.checks import InputError, short_repr

FILE = Path(__file__).with_name("pinned.env")
VARIABLES = Path(__file__).with_name("variables.toml")

# Another processor's settings in place of some pins, as ``NAME=VALUE`` words (`.ci/run` builds a sample so).
OTHER = "STILLWORK_PROCESSOR"


@cache
def pins() -> dict[str, str]:
    """The environment variables of `pinned.env`."""
    lines = FILE.read_text(encoding="utf-8").splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def settings() -> dict[str, str]:
    """The pins, with what `OTHER` puts in their place; a variable set to nothing is left to the machine.

    Raises
    ------
    InputError
        When a word of `OTHER` is no setting.
    """
    words = os.environ.get(OTHER, "").split()
    for word in words:
        if not word.partition("=")[0].isidentifier() or "=" not in word:
            raise InputError(
                f"{OTHER} holds {short_repr(word)}; give NAME=VALUE words, of {', '.join(pins())} and others"
            )
    return {**pins(), **dict(word.split("=", 1) for word in words)}


@cache
def variables() -> dict[str, dict[str, str]]:
    """The environment by `variables.toml`: by treatment, then by beginning of the name, the reason."""
    return tomllib.loads(VARIABLES.read_text(encoding="utf-8"))


def treatment(name: str) -> str:
    """What becomes of a variable in a build: ``pinned``, ``cleared``, ``passed`` or, passed as well, ``inputs``."""
    if name in pins():
        return "pinned"
    starts = {start: kind for kind, named in variables().items() for start in named if name.startswith(start)}
    return starts[max(starts, key=len)] if starts else "passed"


def passed_inputs() -> dict[str, str]:
    """Variables of this process that are passed and whose values results hang on."""
    return {name: value for name, value in os.environ.items() if treatment(name) == "inputs"}


def environment() -> dict[str, str]:
    """Environment of a build's processes: this one's without what is cleared, `settings`, a place for matplotlib.

    That place is the build's own, with a list of matplotlib's own fonts alone: neither a home that cannot be written
    to nor the machine's fonts are seen in pictures and outputs.
    """
    kept = {name: value for name, value in os.environ.items() if treatment(name) in ("passed", "inputs")}
    fixed = {name: value for name, value in settings().items() if value or name not in pins()}
    own = {"MPLCONFIGDIR": str(paths.root() / "build" / "matplotlib"), "MPL_IGNORE_SYSTEM_FONTS": "1"}
    return {**kept, **own, **fixed}
