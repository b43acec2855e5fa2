"""Measured signals: records and their files, spectra, criteria of vibration."""

from stillwork.base.faces import face

__all__, __getattr__, __dir__ = face(
    __name__,
    {
        "moving_average": ("moving",),
        "records": ("Record", "load_record"),
        "spectra": ("estimate_response", "estimate_spectrum"),
    },
)
