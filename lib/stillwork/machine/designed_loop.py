"""What `design` wrote of a loop, read back: the controller in the machine's units, the model and the gains."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from stillwork.base.checks import require_array
from stillwork.base.toml_files import Table
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.digital import DigitalController, in_units, load_controller, of_reference
from stillwork.control.pid import Notch, Pid
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


class DesignedLoop(NamedTuple):
    """What the file of a controller holds of its design."""

    controller: DigitalController  # of r and y, in the units in which the machine was measured
    made: Table  # its provenance
    loop: Loop  # on the model
    pid: Pid

    def response(self, omega: np.ndarray) -> np.ndarray:
        """From the error to the force at frequencies (rad/s), its own feedback of the force included."""
        _, k_y, k_f = self.controller.model.frequency_response(omega)[0]
        return -k_y / (1 - k_f)


def load_design(file: str) -> DesignedLoop:
    written = load_controller(file)
    about = Table(dict(written.about), Path(file).name)
    made, observer = about.table("provenance"), about.table("compensator")
    sample_time = written.model.sample_time
    a, b, c, d = (require_array(f"compensator: {name}", observer[name]) for name in "abcd")
    loop = make_loop(
        model_of(about.table("model")),
        _observer(a, b, c, d, sample_time),
        sample_time=sample_time,
        delay=made["delay_samples_of_the_loop"],
    )
    gains = about["gains"]
    pid = Pid(**gains | {"notches": tuple(Notch(**gain) for gain in gains["notches"])})
    return DesignedLoop(in_the_units_of_the_file(of_reference(written), made), made, loop, pid)


def in_the_units_of_the_file(controller: DigitalController, made: Table) -> DigitalController:
    """The controller in the units in which the machine was measured, not those of its drive."""
    counts, constant = made.get("encoder_counts"), made.get("motor_constant")
    return in_units(controller, 1 / (counts or 1.0), constant or 1.0, ("position", "force"))


def _observer(a, b, c, d, sample_time: float) -> StateModel:
    n = len(d)
    if not a.size:  # without states the lists are empty
        a, b, c = np.zeros((0, 0)), np.zeros((0, n)), np.zeros((n, 0))
    return StateModel(a, b, c, d, sample_time)


def model_of(entries: Table) -> ModalModel:
    """The model that the design was made for, as its file holds it."""
    frequencies, damping, residues = (
        require_array(f"model: {name}", entries[name], ndim=1)
        for name in ("frequencies_rad_s", "damping", "residues")
    )
    shapes = np.sqrt(np.abs(residues))
    return ModalModel(
        frequencies,
        damping,
        shapes[:, None],
        (shapes * np.sign(residues))[None],
        np.array([[entries["compliance"]]]),
        drag=entries["drag_1_s"],
    )
