"""Foundations: checked arguments, kernels, tables, lazy exports."""
