"""What the notebooks of this workbook need and nobody else: one package a room. It is not installed."""
