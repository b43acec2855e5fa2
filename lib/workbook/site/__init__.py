"""The reader's side: the static site, and committed files that follow from others.

Nothing here is used by a notebook, so that no change here makes a result stale.
"""
