"""What `benchmarks/fuzz.py` throws at the toolbox and at the workbook: calls, files, tables, settings."""
