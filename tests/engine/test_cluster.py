"""Whole notebooks on the workers of a real cluster."""

import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from engine import toy as toys

pytestmark = pytest.mark.slow


def test_notebooks_on_a_cluster_give_the_same_bytes_as_here(tmp_path):
    toy = toys.make(tmp_path)
    toy.add_page("isolation/01-first")
    toy.add("isolation/02-second", "ratio = 1 / 0")
    toy.add(
        "motion/01-first",
        "import os\nfrom pathlib import Path",
        "written = Path(os.environ['TOY'], 'parent').write_text(str(os.getppid()))",
    )
    cluster = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("cluster.py"))],
        cwd=toy.root,
        env=toy.environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        scheduler = cluster.stdout.readline().strip()
        done = toy.run("figures", "--scheduler", scheduler)
        assert done.returncode == 1 and "2 built, 1 failed" in done.stdout
        assert "cell [4] ratio = 1 / 0" in done.stdout
        parent = psutil.Process(int((toy.root / "parent").read_text()))
        assert "stillwork" not in parent.cmdline()  # a worker, not the runner
        with toys.copy_of(toy, tmp_path / "other") as other:
            other.replace("lib/experiments/isolation/model.py", "2.0", "3.0")
            refused = other.run("figures", "isolation/01-first", "--scheduler", scheduler)
            assert refused.returncode == 1
            assert "lib/experiments/isolation/model.py changed" in refused.stdout
    finally:
        cluster.communicate("")
    there = toy.results()
    assert toy.run("figures", "isolation/01-first", "motion", "--force").returncode == 0
    assert toy.results() == there
    toys.clean_up(toy)
