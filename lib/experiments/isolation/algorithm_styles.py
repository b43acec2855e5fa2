"""How the pictures of adaptation tell the two algorithms apart."""

from workbook import figures

STYLES = {"FeLMS": "--", "FeRLS": "-"}
COLOURS = {"FeLMS": figures.GREEN, "FeRLS": figures.BLACK}  # as in Figs. 7 and 8
