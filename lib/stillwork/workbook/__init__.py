"""The runner: builds the notebooks into figures, judges, accepts and diagnoses.

Nothing in this folder can influence a result, except the kernel settings in `jupyter_kernel`; so a change here
rebuilds no notebook.
"""
