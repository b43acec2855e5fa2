"""The picture drawn in one pass against that of matplotlib's own `savefig`, to the last bit."""

import io

import numpy as np
import pytest
from matplotlib.axis import Axis
from matplotlib.image import imread

from workbook import figures, rendering

X = np.linspace(0.5, 3000, 400)


def log_axes():
    figure, axes = figures.new(2, 2, sharex=True)
    axes[0, 0].loglog(X, X**2)
    axes[0, 1].semilogx(X, np.sin(X), label="sine")
    axes[1, 0].plot(X, X**-3.0)
    axes[1, 0].set_yscale("log")
    axes[1, 1].set_yscale("symlog")
    axes[1, 1].plot(X, X - 1000)
    axes[1, 0].set_title("decades")
    axes[0, 1].legend()
    figure.suptitle("above all")
    return figure


def less_than_a_decade():
    figure, axes = figures.new(1, 2)
    axes[0].loglog([2.0, 7.0], [0.3, 0.9])
    axes[1].loglog([2.0, 4.0], [21.0, 27.0])
    axes[1].set_xlabel("f (Hz)")
    return figure


def minor_ticks_of_every_kind():
    figure, axes = figures.new(2, 3, sharex="row")
    for panel in axes.flat:
        panel.loglog(X, X)
    axes[0, 0].grid(True, which="minor")
    axes[0, 1].tick_params(which="minor", length=9, color="r", top=True, direction="inout")
    axes[0, 2].tick_params(labelbottom=False)
    axes[1, 0].minorticks_off()
    axes[1, 1].tick_params(which="both", left=False, labelleft=False, right=True, labelright=True)
    axes[1, 2].invert_xaxis()
    axes[1, 2].set_ylim(10, 1000)
    return figure


def linear_minor_ticks():
    figure, axes = figures.new()
    axes.plot(X, X)
    axes.minorticks_on()
    axes.set_ylabel("y")
    axes.set_xticks([], minor=False)
    return figure


def twins():
    figure, axes = figures.new()
    axes.semilogx(X, X, color=figures.BLUE)
    axes.set_title("two quantities")
    other = axes.twinx()
    other.loglog(X, 1 / X, color=figures.RED)
    other.set_ylabel("reciprocal")
    above = axes.secondary_xaxis("top", functions=(lambda x: 2 * x, lambda x: x / 2))
    above.set_xlabel("doubled")
    return figure


def insets():
    figure, axes = figures.new()
    axes.loglog(X, X)
    inset = axes.inset_axes([0.1, 0.6, 0.3, 0.3])
    inset.loglog(X, X**2)
    inset.sharex(axes)
    return figure


def maps():
    from matplotlib.colors import LogNorm

    figure, axes = figures.new(1, 2)
    z = np.outer(np.arange(1.0, 20), np.arange(1.0, 30))
    figure.colorbar(axes[0].pcolormesh(z, norm=LogNorm()), ax=axes[0], label="level")
    figure.colorbar(axes[1].imshow(z, aspect="equal"), ax=axes[1])
    axes[1].set_title("map")
    return figure


def bars_and_texts():
    figure, axes = figures.new(1, 2, sharey=True)
    axes[0].barh(["one", "two", "three"], [1.0, 20, 300], label="count")
    axes[0].set_xscale("log")
    axes[0].annotate("here", (20, 1), (100, 1.5), arrowprops={"arrowstyle": "->"})
    axes[1].text(0.5, 1.0, r"$\alpha^2 = \frac{1}{2}$")
    axes[1].set_title(r"$\sqrt{x}$ and a long title that needs its room")
    figure.legend(loc="outside lower center")
    return figure


def hidden():
    figure, axes = figures.new(2, 2, sharex="col", sharey=True)
    for panel in axes.flat:
        panel.loglog(X, X)
    axes[0, 0].axis("off")
    axes[0, 1].set_visible(False)
    axes[1, 0].xaxis.set_visible(False)
    return figure


def equal_aspect():
    figure, axes = figures.new(1, 2)
    for panel, adjustable in zip(axes, ("box", "datalim"), strict=True):
        panel.plot(np.cos(X), 2 * np.sin(X))
        panel.set_aspect("equal", adjustable=adjustable)
        panel.minorticks_on()
    return figure


def without_a_layout():
    figure, axes = figures.new()
    figure.set_layout_engine("none")
    axes.loglog(X, X)
    return figure


def polar():
    figure, axes = figures.new(subplot_kw={"projection": "polar"})
    axes.plot(X, X)
    return figure


def shared_offsets():
    figure, axes = figures.new(2, 2, sharex=True, sharey=True, gridspec_kw={"width_ratios": [1, 4]})
    for panel in axes.flat:
        panel.plot(1e7 + X, 1e-6 * X)
    axes[0, 0].set_ylabel("far from one")
    return figure


KINDS = (
    *(log_axes, less_than_a_decade, minor_ticks_of_every_kind, linear_minor_ticks, twins, insets, maps),
    *(bars_and_texts, hidden, equal_aspect, without_a_layout, polar, shared_offsets),
)


def saved(figure, dpi):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    buffer.seek(0)
    return np.rint(255 * imread(buffer)).astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=[kind.__name__ for kind in KINDS])
def test_the_pixels_are_those_of_savefig(kind):
    figure = kind()
    picture = rendering.pixels(figure, 120)
    np.testing.assert_array_equal(picture, saved(kind(), 120))
    np.testing.assert_array_equal(rendering.pixels(figure, 120), picture)
    np.testing.assert_array_equal(saved(figure, 120), picture)  # what it left behind draws the same


@pytest.mark.slow
def test_ticks_are_placed_once_for_each_place_of_a_panel(monkeypatch):
    calls = []
    place = Axis._update_ticks
    monkeypatch.setattr(Axis, "_update_ticks", lambda axis: calls.append(axis) or place(axis))
    figure = log_axes()
    rendering.pixels(figure, 80)
    assert (
        max(calls.count(axis) for axis in set(calls)) <= 4
    )  # two rounds of the layout, the last, the drawing
    assert not any("_update_ticks" in vars(axis) for axis in set(calls))  # as it was, for whoever draws next


@pytest.mark.slow
def test_figures_in_a_row_do_not_touch_one_another():
    made = [log_axes(), twins(), log_axes()]
    first, other, last = (rendering.pixels(figure, 80) for figure in made)
    np.testing.assert_array_equal(first, last)
    np.testing.assert_array_equal(first, saved(log_axes(), 80))
    np.testing.assert_array_equal(other, saved(twins(), 80))
