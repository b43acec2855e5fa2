"""Combinations: every choice that a work leaves open, tried in all its options, and what its numbers do then.

A multiverse analysis (Steegen, Tuerlinckx, Gelman and Vanpaemel, 2016) of published numbers. `axes` reads the
choices, `sampling` picks the combinations to try, `running` computes them, `results` keeps them, `judging` computes for
each entry of the ledger under what share of them it agrees and which choices decide that.
"""
