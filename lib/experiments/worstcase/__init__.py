"""Trials, measured pair and pictures of the work on bounded doubt."""

from stillwork.base.faces import face

__all__, __getattr__, __dir__ = face(
    __name__,
    {
        "cone": ("solve_cone_program",),
        "total": ("total_least_squares",),
    },
)
