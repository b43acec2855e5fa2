"""The commands for a machine of one's own, and what only they need; they stand on the whole toolbox."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "c_code": ("adaptation_code", "controller_code", "least_squares_code"),
        "margins": ("loop_margins",),
        "readings": ("require_explained",),
    },
)
