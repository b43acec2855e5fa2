"""Measured signals: records and their files, spectra, criteria of vibration."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "moving_average": ("moving",),
        "records": ("Record", "load_record"),
        "spectra": ("estimate_response", "estimate_spectrum"),
    },
)
