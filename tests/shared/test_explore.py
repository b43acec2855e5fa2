import shlex

import numpy as np
import pytest

from workbook import figures
from workbook.checks import InputError
from workbook.explorer import Choice, Slider, StaticPicture, build_line, explore
from workbook.redraw import Redraw

CONTROLS = {
    "gain": Slider(0.0, 10.0, 2.0, "V", basis="printed", place="Table 1"),
    "rate": Slider(1.0, 1e4, start=100.0, log=True),
    "order": Slider(1, 5, start=3, step=1, basis="assumed"),
    "floor": Choice(("flat", "coloured"), start="flat", basis="our result"),
}


def draw(gain=2.0, rate=100.0, order=3, floor="flat"):
    if gain > 9:
        raise InputError("gain is too high; give <9")
    figure, axes = figures.new(height=1)
    axes.plot(np.arange(5), gain * np.arange(5) ** order + rate, ":" if floor == "flat" else "-")
    axes.set_xlabel("time (s)")
    return figure


def parts(box):
    """Widgets of an explorer: controls by name, Reset, message, picture."""
    *rows, last, picture = box.children
    controls = dict(zip(CONTROLS, (row.children[0] for row in rows), strict=True))
    return controls, *last.children, picture


def test_in_a_build_it_is_a_picture_at_its_start(monkeypatch):
    monkeypatch.setenv("STILLWORK_OUTPUT", "/somewhere")
    shown = explore(draw, **CONTROLS)
    assert isinstance(shown, StaticPicture)
    assert repr(shown) == ("explorer at its start: gain = 2.0, rate = 100.0, order = 3, floor = flat")
    assert shown._repr_png_() == explore(draw, **CONTROLS).png
    assert shown.png.startswith(b"\x89PNG")


@pytest.mark.slow
def test_moving_a_control_redraws_and_reset_returns():
    controls, reset, message, picture = parts(explore(draw, **CONTROLS))
    at_home = picture.value
    assert bytes(at_home).startswith(b"\x89PNG")
    assert message.value == "at the start"
    for name, value in (("gain", 5.0), ("rate", 1000.0), ("order", 2), ("floor", "coloured")):
        before = picture.value
        controls[name].value = value
        assert picture.value != before
        assert message.value == "moved; in grey the start"
    reset.click()
    assert {name: control.value for name, control in controls.items()} == {
        name: control.start for name, control in CONTROLS.items()
    }
    assert picture.value == at_home
    assert message.value == "at the start"


@pytest.mark.slow
def test_a_preset_leads_all_controls_to_a_named_design_with_one_picture():
    seen = []

    def note(**settings):
        seen.append(settings)
        return draw(**settings)

    box = explore(note, {"loud": {"gain": 8.0, "floor": "coloured"}, "start": {}}, **CONTROLS)
    buttons, *rows = box.children[: 1 + len(CONTROLS)]
    rows[1].children[0].value = 1000.0
    before = len(seen)
    loud, start = buttons.children
    loud.click()
    assert seen[before:] == [{"gain": 8.0, "rate": 100.0, "order": 3, "floor": "coloured"}]
    start.click()
    assert seen[before + 1 :] == [{name: control.start for name, control in CONTROLS.items()}]


def test_an_impossible_setting_says_why_and_keeps_the_last_picture():
    controls, _, message, picture = parts(explore(draw, **CONTROLS))
    before = picture.value
    controls["gain"].value = 10.0
    assert "gain is too high; give &lt;9" in message.value
    assert picture.value == before
    controls["gain"].value = 3.0
    assert picture.value != before


@pytest.mark.parametrize(
    "slider", [Slider(0.2, 4.0, 1.8), Slider(0.01, 1.0, 0.3, log=True), Slider(1e-5, 1e3, 0.03, log=True)]
)
def test_the_start_is_one_of_the_slider_s_steps(slider):
    """As the front end counts them, from the lower end; else a touch would move it."""
    widget = slider.widget("x")
    way = np.log10(slider.start) - widget.min if slider.log else slider.start - widget.min
    assert way / widget.step == pytest.approx(round(way / widget.step), abs=1e-9)


def test_a_kept_figure_gives_the_pictures_of_one_made_anew():
    """Also with the lines of the start behind it, and where its explorer is made again."""
    kept = draw(gain=1.0, rate=1.0, order=1)

    def moved(gain):
        kept.axes[0].lines[0].set_ydata(gain * np.arange(5) + 1.0)
        kept.axes[0].relim()
        kept.axes[0].autoscale_view()
        return kept

    for _ in range(2):
        pictures = []
        for function in (moved, lambda gain: draw(gain, 1.0, 1)):
            box = explore(function, gain=Slider(1.0, 9.0, start=2.0))
            for value in (3.0, 5.0, 2.0, 4.0):
                box.children[0].children[0].value = value
                pictures.append(bytes(box.children[-1].value))
        assert pictures[:4] == pictures[4:]


def test_the_line_under_it_builds_the_page_with_what_is_shown():
    start = {"gain": 2.0, "floor": "flat", "shown": 0}
    at_home = build_line("isolation/01-first", ("gain", "floor"), start, start)
    assert at_home == 'make figures ARGS="isolation/01-first"'
    moved = start | {"gain": 0.25, "floor": "quite coloured", "shown": 1}
    line = build_line("isolation/01-first", ("gain", "floor"), moved, start)
    command, _, remark = line.partition("  # ")
    assert remark == "the page has no parameter shown"
    (arguments,) = shlex.split(command)[2:]
    assert shlex.split(arguments.removeprefix("ARGS=")) == [
        "isolation/01-first",
        "-p",
        "gain=0.25",
        "-p",
        "floor=quite coloured",
    ]
    assert build_line("isolation/01-first", ("other",), moved, start) == ""


def test_a_figure_that_is_kept_is_laid_out_again_where_its_label_would_leave_it():
    figure, axes = figures.new()
    [line] = axes.plot([0, 1], [0, 1])
    axes.set_ylabel("size")

    def draw(size: float):
        line.set_ydata([0, size])
        axes.relim()
        axes.autoscale_view()
        return figure

    redraw = Redraw(draw)
    for size in (1.0, 99999.0, 1.0):
        redraw(size=size)
        assert axes.yaxis.label.get_window_extent().x0 >= 0
