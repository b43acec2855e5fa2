"""Panels without the work that an explorer has no time for."""

from workbook import figures


def plain(panels: int = 1, height: float = 2.8, **margins: float):
    """Panels beside each other without the constrained layout, which takes longer than an explorer may."""
    figure, axes = figures.new(1, panels, height=height)
    figure.set_layout_engine(None)
    figure.subplots_adjust(**{"left": 0.1, "bottom": 0.18, "right": 0.98, "top": 0.9} | margins)
    return figure, axes
