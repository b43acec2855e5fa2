"""Linear time-invariant models: modal and state-space form, exact discretisation, fast responses, norms."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "discretisation": (
            "tustin",
            "zoh",
        ),
        "generalised_plant": ("GeneralisedPlant",),
        "modal": ("ModalModel", "modal_model"),
        "norms": ("h2_norm", "hinf_norm"),
        "peaks": ("resonance_grid",),
        "reduction": ("truncate",),
        "simulation": ("simulate",),
        "structured": ("GainProof", "prove_gain"),
        "foreign": ("CancellationWarning",),
        "state_space": (
            "MinimalRealisation",
            "StateModel",
            "from_control",
            "interconnect",
            "minimal_realisation",
        ),
    },
)
