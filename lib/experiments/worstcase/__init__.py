"""Trials and the measured pair of the work on bounded uncertainty."""
