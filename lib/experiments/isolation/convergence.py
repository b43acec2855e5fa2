"""The two algorithms as pages call and draw them, and the band and the final values of Table 1."""

from workbook.palette import BLACK, GREEN

ALGORITHMS = ("FeLMS", "FeRLS")
STYLES = {"FeLMS": "--", "FeRLS": "-"}
COLOURS = {"FeLMS": GREEN, "FeRLS": BLACK}  # as in Figs. 7 and 8
SHARE = 0.63  # half width of the band around the final value, Table 1
FINAL_SHARE = 0.1  # of a run, at its end, whose mean is the final value
