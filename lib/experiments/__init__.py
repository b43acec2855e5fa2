"""What the notebooks of this workbook need and nobody else: one package a topic. It is not installed."""
