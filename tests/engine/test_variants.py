"""What the terminal tells of a variant: its place, the claims that moved, and a picture of both."""

import io
import shutil

import pytest
from PIL import Image


@pytest.fixture
def toy(toy):
    toy.add_page("motion/01-page")
    return toy


@pytest.mark.slow
def test_a_variant_says_where_it_is_and_how_it_differs(toy):
    name, variant = "motion/01-page", "build/variants/motion/01-page/level=2.0"
    first = toy.run("figures", name, "-p", "level=2").stdout
    assert f"motion/01-page (level=2.0): {variant}\n" in first
    assert "no accepted results yet" in first

    assert toy.run("figures", name).returncode == 0
    shutil.copytree(toy.root / f"build/figures/{name}", toy.root / f"figures/{name}")
    told = toy.run("figures", name, "-p", "level=2").stdout  # built already: it is told again
    (row,) = [line.split() for line in told.splitlines() if line.startswith("  motion.gain ")]
    assert row == ["motion.gain", "2", "2", "4", "inside", "->", "outside"]
    assert "no figure moved" in told

    told = toy.run("figures", name, "-p", "seed=7").stdout
    assert "no claim moved" in told
    assert "both pictures: build/variants/motion/01-page/seed=7.png" in told
    both = Image.open(io.BytesIO((toy.root / "build/variants/motion/01-page/seed=7.png").read_bytes()))
    left, right = (
        Image.open(toy.root / f"{folder}/fig-1.png").convert("RGB")
        for folder in (f"figures/{name}", "build/variants/motion/01-page/seed=7")
    )
    assert both.width > left.width + right.width and both.height > left.height
    for picture, x in ((left, 0), (right, both.width - right.width)):
        top = both.height - 16 - picture.height
        assert both.crop((x, top, x + picture.width, top + picture.height)).tobytes() == picture.tobytes()
