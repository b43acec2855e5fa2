"""Controllers, studies and pictures of the work on filters in fixed-point adaptive control."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "differentiation": ("steady_errors",),
        "metrics": ("compare", "judge"),
        "noise": ("Noise",),
        "oscillator": ("VanDerPol", "load_oscillator"),
        "published": ("PUBLISHED_CASES", "added_controllers", "published_controllers"),
    },
)
