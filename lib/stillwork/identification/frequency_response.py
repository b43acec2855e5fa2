"""Frequency responses from hits: cross spectra averaged over them, with their coherence."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Matrix, Positive
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import checked
from stillwork.signals.spectra import response_arrays

SILENT = 1e-6  # of the force's largest amplitude, below which a line holds rounding alone: no sensor's range is wider


class Identified(NamedTuple):
    """An estimated response; a named tuple, whose values are not checked.

    Parameters
    ----------
    omega : array_like, shape (frequencies,)
        rad/s, without zero.
    response : array_like, shape (frequencies,)
        Complex, output per input.
    coherence : array_like, shape (frequencies,)
        Of the excitation with the output, between 0 and 1.

    References
    ----------
    Bendat and Piersol, Random Data (2010), chapters 6, 7 and 9.

    Examples
    --------
    >>> omega = 2 * np.pi * np.arange(20.0, 200.0)
    >>> rigid = identification.Identified(omega, np.full(180, 0.1 + 0j), np.ones(180))  # 1/kg: 10 kg
    >>> len(rigid.omega)
    180
    """

    omega: Float64[np.ndarray, " frequencies"]  # rad/s, without zero
    response: Complex128[np.ndarray, " frequencies"]
    coherence: Float64[np.ndarray, " frequencies"]  # of the excitation with the output

    @classmethod
    def converted(cls, name: str, measured: Any) -> "Identified":
        """A response of another library as this one, without a line at rest; one without coherence counts as coherent.

        Parameters
        ----------
        name : str
            What errors call it.
        measured : Identified or control.FrequencyResponseData or ResponseEstimate or tuple
            Of one channel; a tuple holds the frequencies in Hz and the response.

        Returns
        -------
        Identified

        Raises
        ------
        InputError
            When it is no response of one channel.

        Examples
        --------
        >>> identification.Identified.converted("measured", ([0.0, 1.0], [0.1, 0.1])).omega.round(3)
        array([6.283])
        """
        if isinstance(measured, cls):
            return measured
        arrays = response_arrays(measured, name)
        (unit, lines), (_, response) = arrays.items()
        if response.ndim > 1:
            raise InputError(
                f"{name} has {response[0].size} channels; give one, as with python-control response[0, 0]"
            )
        omega = lines * (2 * np.pi if "Hz" in unit else 1.0)
        coherence = np.ravel(getattr(measured, "coherence", np.ones(len(omega))))
        return cls(*(each[omega > 0] for each in (omega, response, coherence)))


@checked(missing=True)
def impact_response(force: Matrix, response: ArrayLike, rate: Positive) -> Identified:
    """H1 estimate from hits, one record per hit, with cross spectra and the force's auto spectrum averaged over hits.

    The coherence of a single hit would be one everywhere, without meaning: it is NaN. Lines at which force or response
    has no power but rounding are left out.
    """
    response = require_array("response", response, shape=force.shape)
    if not len(force):
        raise InputError("force holds no hit; give one row per hit")
    f, a = (np.fft.rfft(x - x.mean(axis=1, keepdims=True), axis=1) for x in (force, response))
    s_ff, s_aa = (np.abs(f) ** 2).mean(axis=0), (np.abs(a) ** 2).mean(axis=0)
    s_fa = (f.conj() * a).mean(axis=0)
    omega = 2 * np.pi * np.fft.rfftfreq(force.shape[1], 1 / rate)
    keep = (s_ff > SILENT**2 * s_ff.max()) & (s_aa > 0) & (omega > 0)
    s_ff, s_aa, s_fa = (power[keep] for power in (s_ff, s_aa, s_fa))
    coherence = np.abs(s_fa) ** 2 / (s_ff * s_aa) if len(force) > 1 else np.full(len(s_ff), np.nan)
    found = Identified(omega[keep], s_fa / s_ff, coherence)
    if not len(found.omega):
        raise InputError("force or response has no power at any frequency; hit harder")
    if not np.isfinite(omega).all():
        raise InputError(f"rate is {rate:g}, too large for frequencies in rad/s; give it in Hz")
    if not np.isfinite(found.response).all() or (len(force) > 1 and not np.isfinite(found.coherence).all()):
        raise InputError("force or response is too large or too small for its power; give them in SI units")
    return found
