"""From records to models: frequency responses, modal fits, regressors, machines from files."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "complex_frequency": ("stabilisation",),
        "frequency_response": ("Identified",),
        "machine": ("build_machine",),
        "machine_files": ("load_machine",),
        "modal_fit": ("fit_modes", "identify_modes"),
        "regressors": ("fir_regressors",),
    },
)
