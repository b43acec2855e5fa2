"""How the pictures of adaptation tell the two algorithms apart."""

from workbook import figures

STYLES = {"FeLMS": "--", "FeRLS": "-"}
COLORS = {"FeLMS": figures.GREEN, "FeRLS": figures.BLACK}  # as in Figs. 7 and 8
