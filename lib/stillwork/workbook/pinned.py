"""The settings of processor and process under which numbers are made; `pinned.env` says each one's reason."""

import os
from functools import cache
from pathlib import Path

from stillwork.base.checks import InputError, shown

FILE = Path(__file__).with_name("pinned.env")

# Other processors' settings in place of some pins, as ``NAME=VALUE`` words: what `make portable` turns.
OTHER = "STILLWORK_PROCESSOR"

# Among these: a program that the kernels' Python runs under, in place of the processor itself.
EMULATOR = "STILLWORK_EMULATOR"


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
                f"{OTHER} holds {shown(word)}; give NAME=VALUE words, of {', '.join(pins())}, {EMULATOR} and others, "
                "or name a stand-in: python -m stillwork portable --processor NAME"
            )
    return {**pins(), **dict(word.split("=", 1) for word in words)}


def environment() -> dict[str, str]:
    """This process's environment under `settings`."""
    return {
        name: value for name, value in {**os.environ, **settings()}.items() if value or name not in pins()
    }
