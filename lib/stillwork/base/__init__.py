"""What everything stands on: checked arguments, paths, kernels, tables, lazy faces."""
