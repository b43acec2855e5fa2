"""The commands where others run them: in the background, without a home, in an unpacked archive with a name of its own."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from engine import toy as toys

pytestmark = pytest.mark.slow

TOPIC = "isolation/01-first"
HANDED_DOWN = (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE)  # by `nohup`, and to a script's background jobs


@pytest.fixture
def toy(tmp_path):
    made = toys.make(tmp_path / "ein Ort für alle")
    made.add_page(TOPIC)
    made.replace(f"notebooks/{TOPIC}.ipynb", "page.claims", "print('für \\u2113', rig)\\npage.claims")
    (made.root / "data/motion/published.toml").unlink()
    made.write("README.md", "# Toy\n\n<!-- ledger:begin -->\n<!-- ledger:end -->\n")
    shutil.copy(Path(__file__).parents[2] / "Makefile", made.root)
    yield made
    toys.clean_up(made)


def test_a_build_in_the_background_of_a_bare_machine_is_made_and_accepted(toy):
    """Signals ignored, no terminal, nothing to read from, no home, the locale C, no git, blanks and an umlaut in the path."""
    around = {"PATH": os.environ["PATH"], "LC_ALL": "C", "TMPDIR": str(toy.temporary), "TOY_MARK": toy.mark}
    around["HOME"] = "/nonexistent"

    def begin():
        toys.set_signals(*HANDED_DOWN)
        os.close(0)

    def make(*arguments):
        done = subprocess.run(
            ["make", f"ENVIRONMENT={sys.prefix}", *arguments],
            cwd=toy.root,
            env=around,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            encoding="utf-8",
            start_new_session=True,
            preexec_fn=begin,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "1 built, 0 failed" in make("figures", f"ARGS={TOPIC} --jobs 2")
    assert "accepted 1 notebooks" in make("accept")
    assert make("figures").startswith("nothing to do")
    assert "für ℓ" in (toy.root / f"notebooks/{TOPIC}.ipynb").read_text(encoding="utf-8")
    assert toy.leftovers() == []
