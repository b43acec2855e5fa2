"""Which files of tests begin first: those that take longest, so that no worker is left alone with one at the end."""

from pathlib import Path

LONGEST = (
    "motion/test_modal_identification.py",
    "shared/test_fuzz.py",
    "motion/test_observer_contest.py",
    "workbook/test_faults.py",
    "motion/test_optimal.py",
    "workbook/test_failures.py",
    "workbook/test_build.py",
    "worstcase/test_regression.py",
    "site/test_files.py",
    "site/test_guide.py",
    "isolation/test_adaptation.py",
    "shared/test_rendering.py",
    "workbook/test_accept.py",
    "motion/test_joint.py",
    "site/test_reporting.py",
    "workbook/test_committed.py",
    "workbook/test_cluster.py",
    "isolation/test_convergence.py",
    "shared/test_kernels.py",
)
PLACES = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}


def rank(file: Path) -> int:
    """Place of a file; those that are not among the longest follow in their own order."""
    return PLACES.get(file, len(LONGEST))
