"""What makes notebooks a workbook: page, ledger, figures, explorers, studies, and the runner."""

from importlib import import_module

_MODULES = {
    "Choice": "explorer",
    "Page": "page",
    "Slider": "explorer",
    "Study": "studies",
    "explore": "explorer",
    "mean_interval": "studies",
    "proportion_interval": "studies",
    "run_study": "studies",
    "spread_interval": "studies",
}  # of public names, imported when they are first used
__all__ = sorted(_MODULES)


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
