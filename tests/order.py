"""Which files of tests begin first: those that take longest, so that no worker is left alone with one at the end."""

from pathlib import Path

LONGEST = (
    "shared/test_wrong_values.py",
    "motion/test_observer_contest.py",
    "engine/test_failures.py",
    "motion/test_modal_identification.py",
    "engine/test_build.py",
    "site/test_files.py",
    "engine/test_committed.py",
    "site/test_guide.py",
    "engine/test_accept.py",
    "motion/test_designing.py",
    "engine/test_cluster.py",
    "engine/test_contributing.py",
    "engine/test_variables.py",
    "worstcase/test_regression.py",
    "motion/test_joint.py",
    "choices/test_running.py",
    "choices/test_checking.py",
    "isolation/test_adaptation.py",
    "engine/test_warm.py",
    "isolation/test_convergence.py",
    "shared/test_kernels.py",
    "site/test_course.py",
    "site/test_reporting.py",
    "site/test_release.py",
    "site/test_commands.py",
    "shared/test_matfiles.py",
    "fixedpoint/test_choices.py",
    "engine/test_variants.py",
    "fixedpoint/test_mechanism.py",
    "isolation/test_your_floor.py",
    "site/test_states.py",
)
PLACES = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}


def rank(file: Path) -> int:
    """Place of a file; those that are not among the longest follow in their own order."""
    return PLACES.get(file, len(LONGEST))
