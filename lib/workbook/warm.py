"""What kernels are forked with: importing this imports what is slow, and does what is slow the first time.

Nothing of the library is imported before a fork: each kernel runs the code that stands in the checkout then.
"""

import gc

import control  # noqa: F401
import ipykernel.kernelapp  # noqa: F401
import ipywidgets  # noqa: F401
import jaxtyping  # noqa: F401
import numba
import numpy  # noqa: F401
import pandas  # noqa: F401
import scipy.interpolate
import scipy.linalg
import scipy.optimize
import scipy.signal
import scipy.stats  # noqa: F401
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

numba.njit(lambda number: number + 1.0)(1.0)
_figure = Figure(layout="constrained")
_axes = _figure.subplots()
_axes.loglog([1, 10], [1, 10], label=r"$\omega_1^{2}$")
_axes.set_xlabel("time (s)")
_axes.legend()
FigureCanvasAgg(_figure).draw()

gc.collect()
gc.freeze()  # what is here is shared by all kernels: let no collection touch it
