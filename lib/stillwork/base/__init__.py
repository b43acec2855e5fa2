"""What everything stands on: checked arguments, kernels, tables, lazy faces."""
