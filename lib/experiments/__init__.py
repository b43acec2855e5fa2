"""Code that only the notebooks of this workbook need: one package per topic. It is not installed."""
