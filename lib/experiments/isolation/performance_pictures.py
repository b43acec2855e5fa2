"""Figures of transmissibility and power (notebooks 04 and 05)."""

from workbook import figures

STYLES = {
    "passive": {"color": figures.PURPLE},
    "feedback": {"color": figures.BLUE},
    "FeLMS": {"color": figures.GREEN, "ls": "--", "zorder": 3},  # lies on FeRLS
    "FeRLS": {"color": figures.BLACK},
    "output noise": {"color": figures.RED, "ls": ":"},
}
