"""What makes notebooks a workbook: page, ledger, figures, explorers, studies, and the runner."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "explorer": ("Choice", "Slider", "explore"),
        "page": ("Page",),
        "studies": ("Study", "mean_interval", "proportion_interval", "run_study", "spread_interval"),
    },
)
