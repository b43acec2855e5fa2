"""What the terminal says of a variant: its place, and the claims that moved."""

import json
import shutil

import pytest


@pytest.fixture
def toy(toy):
    toy.add_page("motion/01-page")
    conclude = (
        "page.conclude('The gain is {gain:.1f}, as printed.', 'The gain is {gain:.1f}, not as printed.', "
        "when='motion.gain', gain=gain(level))"
    )
    toy.replace("notebooks/motion/01-page.ipynb", '"page.claims"', json.dumps(f"{conclude}\npage.claims"))
    return toy


def texts(file):
    """What an executed notebook shows, cell after cell."""
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    outputs = [output["data"] for cell in cells for output in cell.get("outputs", []) if "data" in output]
    return ["".join(data.get("text/markdown", data["text/plain"])) for data in outputs]


@pytest.mark.slow
def test_a_variant_says_where_it_is_and_how_it_differs(toy):
    name, variant = "motion/01-page", "build/variants/motion/01-page/level=2.0"
    assert toy.run("figures", name).returncode == 0
    shutil.copytree(toy.root / f"build/figures/{name}", toy.root / f"figures/{name}")
    told = toy.run("figures", name, "-p", "level=2").stdout
    assert f"motion/01-page (level=2.0): {variant}\n" in told
    shown = texts(toy.root / variant / "01-page.ipynb")
    note = (
        "Other settings than the accepted: level 2.0 for 1.0; 1 of 1 numbers left their tolerance, 0 entered.\n"
        "left: motion.gain (gain): 4 for 2"
    )
    assert "".join(f"  {line}\n" for line in note.splitlines()) in told
    assert shown[1] == note.replace("\n", "  \n")  # above the first claim
    assert "The gain is 4.0, not as printed." in shown
    assert shown[-1].startswith(note)
    accepted = texts(toy.root / f"build/figures/{name}/01-page.ipynb")
    assert "The gain is 2.0, as printed." in accepted and "Other settings" not in "".join(accepted)

    told = toy.run("figures", name, "-p", "seed=7").stdout
    assert "0 of 1 numbers left their tolerance, 0 entered" in told
