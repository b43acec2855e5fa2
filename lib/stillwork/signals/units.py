"""Names of columns: what each holds, and in which unit."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Reading:
    """What a reader took a column of a file for."""

    quantity: (
        str  # frequency, time, rate, magnitude, phase, real, imaginary, complex, coherence, force or response
    )
    unit: str  # as it was read: Hz, rad/s, dB re 1 m/N, deg, m/s^2/N, ...
    column: str  # its name in the file
    written: (
        bool  # the unit stands in the file, or the caller gave it; otherwise it is the documented default
    )
