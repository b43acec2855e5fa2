"""Measured signals: records and their files, spectra, criteria of vibration."""

from stillwork.base.faces import face

__all__, __getattr__, __dir__ = face(
    __name__,
    {
        "moving_average": ("moving", "rms"),
        "records": ("Record", "load_record", "resample"),
        "spectra": ("Spectrum", "estimate_response", "estimate_spectrum"),
    },
)
