"""From records to models: frequency responses, multisines, modal fits, regressors, machines from files."""

from stillwork.base.faces import face

__all__, __getattr__, __dir__ = face(
    __name__,
    {
        "frequency_response": ("Identified", "closed_loop_response", "impact_response"),
        "machine": ("Machine", "build_machine"),
        "machine_files": ("load_machine",),
        "modal_fit": ("ModalFit", "fit_modal_matrix", "fit_modes"),
        "multisine": ("joint_input_output", "random_phase_multisine", "run_multisine"),
        "regressors": ("arx_regressors", "exponential_bound", "fir_regressors", "noise_bound", "row_bound"),
    },
)
