"""Which files of tests begin first: those that take longest, so that no worker is left alone with one at the end."""

from pathlib import Path

LONGEST = (
    "workbook/test_faults.py",
    "motion/test_designing.py",
    "motion/test_optimal.py",
    "workbook/test_build.py",
    "workbook/test_failures.py",
    "workbook/test_accept.py",
    "workbook/test_committed.py",
    "site/test_files.py",
    "motion/test_joint.py",
    "worstcase/test_regression.py",
    "motion/test_observer_contest.py",
    "workbook/test_cluster.py",
    "shared/test_fuzz.py",
    "shared/test_examples.py",
    "motion/test_modal_identification.py",
    "readings/test_running.py",
)
PLACES = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}


def rank(file: Path) -> int:
    """Place of a file; those that are not among the longest follow in their own order."""
    return PLACES.get(file, len(LONGEST))
