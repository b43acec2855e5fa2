"""The reader's side: the static site, and the committed files that are derived from ledger and notebooks.

Nothing here is used by a notebook, so that no change here makes a result stale.
"""
