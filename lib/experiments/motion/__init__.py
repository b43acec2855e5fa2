"""Machines, designs, studies and pictures of the observer thesis."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "beam": ("beam_shapes", "published_beam"),
        "designs": (
            "DESIGNS",
            "Design",
            "stage_bandwidth",
            "stage_compensator",
            "stage_loops",
            "stage_observer",
        ),
        "machines": (
            "chain",
            "published_deviations",
            "published_noise",
            "published_setpoint",
            "stage",
            "stage_mass",
        ),
        "position_dependence": (
            "at_place",
            "observer_at",
        ),
    },
)
