"""Names out of files on pages, in pictures and in C: texts, whatever they hold."""

import re
import warnings
from html.parser import HTMLParser

import numpy as np
import pytest

from stillwork.control.digital import DigitalController
from stillwork.lti.state_space import StateModel
from stillwork.machine.c_code import controller_code
from stillwork.machine.desk import machine_to_begin_with
from stillwork.machine.desk_page import offline_page
from stillwork.machine.report import report_file

HOSTILE = [
    "$\\frac{x}", "$$", "a\nb", "**//\nint injected;/*", "*/ int injected; /*", "//\\\nint injected;", "??/\n*/ int injected;/*",
    "<script>injected</script>", "</title><img src=x onerror=injected>", "\\input{/etc/passwd}", "_under", "${source}", "%s%n", "a\x1b[2Jb",
]  # fmt: skip
PAGE = "html head meta title style body h1 h2 p details summary pre table tr th td img link".split()


class Elements(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.sources = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name == "src" or name.startswith("on")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "other"), zip(HOSTILE[::2], HOSTILE[1::2], strict=True))
def test_a_name_out_of_a_file_stays_a_text(tmp_path, name, other):
    """Two at once: each has a channel of the record and a signal of the controller."""
    rows = np.random.default_rng(3).standard_normal((2, 1024))
    names = f"{name} x (m/s^2)", f"y {other} [m/s^2]"
    np.savez(tmp_path / "a.npz", **{"fs (Hz)": 500.0, **dict(zip(names, rows, strict=True))})
    with warnings.catch_warnings():
        warnings.simplefilter(
            "error"
        )  # of formulas that are none, letters without a picture, legends without an entry
        lines = report_file(str(tmp_path / "a.npz"), str(tmp_path / "a.html"), unit="m/s^2")
    assert all(map(str.isprintable, lines))
    page = Elements((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert set(page.tags) <= set(PAGE) and all(each.startswith("data:image/png") for each in page.sources)
    *desks, plain = (
        Elements(offline_page([machine_to_begin_with() | {"name": each}])) for each in (name, other, "x")
    )
    assert all((desk.tags, desk.sources) == (plain.tags, plain.sources) for desk in desks)
    model = StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[2.5]]), 1e-3)
    for text in controller_code(DigitalController(model, (names[0],), (names[1],)), "loop").values():
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert "injected" not in code and "??" not in text and not re.search(r"\\\n", text)
