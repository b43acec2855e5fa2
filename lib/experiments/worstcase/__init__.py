"""Trials, measured pair and pictures of the work on bounded uncertainty."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "theory": ("solve_cone_program",),
    },
)
