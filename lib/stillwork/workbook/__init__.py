"""The runner: builds the notebooks into figures, judges, accepts and diagnoses.

Nothing in this folder can influence a result, except the kernel settings in `execution`; so a change here
rebuilds no notebook.
"""
