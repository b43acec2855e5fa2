"""Closed loops of plant, compensator and controller: state-space models for any size, responses for one loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Complex128

from stillwork.base.checks import InputError, require_choice, require_number
from stillwork.base.validation import by_value, checked
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, block_matrix, constant, interconnect

INPUTS = ("r", "u_ff", "w", "v", "d")
OUTPUTS = ("e_true", "e_meas", "u", "f")


@checked
def no_observer(plant: StateModel | ModalModel) -> StateModel:
    """The compensator of a loop without observer: (u_d, y_flex) = 0."""
    gain, sample_time = (
        (plant.feedthrough, 0.0) if isinstance(plant, ModalModel) else (plant.d, plant.sample_time)
    )
    return constant(np.zeros((sum(gain.shape), sum(gain.shape))), sample_time)


@checked
def closed_loop(
    plant: StateModel | ModalModel, compensator: StateModel | None, controller: StateModel
) -> StateModel:
    r"""Closed loop of Figs 3.4 and 3.20, for any number of inputs and outputs.

    :math:`y = P(f + w) - v`, :math:`f = u + u_d`, :math:`u = C_{fb}e_{meas} + u_{ff}`,
    :math:`e_{meas} = r - (y + d - y_{flex})`, :math:`e_{true} = r - y`,
    :math:`(u_d, y_{flex}) = O(f, y + d)`.

    Parameters
    ----------
    plant : StateModel or ModalModel
    compensator : StateModel, optional
        O, see `compensator`; None: no observer.
    controller : StateModel
        C_fb.

    Returns
    -------
    StateModel
        Inputs `INPUTS` and outputs `OUTPUTS`, each as wide as the plant's; pick channels with `channel`.

    Raises
    ------
    InputError
        When the numbers of inputs and outputs differ.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), Figs 3.4 and 3.20.

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
    >>> control.closed_loop(mass, None, control.PidFamily(10.0)(50.0).state_space()).is_stable
    True
    """
    states = plant.state_space() if isinstance(plant, ModalModel) else plant
    observer = no_observer(states) if compensator is None else compensator
    m, p = states.b.shape[1], len(states.c)
    if controller.d.shape != (m, p) or observer.d.shape != (m + p, m + p):
        raise InputError("compensator or controller does not have the plant's numbers of inputs and outputs")
    return interconnect([states, observer, controller], *_wiring(m, p))


@cache  # a search closes thousands of loops of one size
def _wiring(m: int, p: int) -> tuple[np.ndarray, ...]:
    """Constant matrices of `closed_loop` for m inputs and p outputs, as `interconnect` takes them."""
    found, made = (p, m, p, m), (m, m, p, p)  # y0 = P(f + w), u_d, y_flex, u_fb; f + w, f, y + d, e_meas
    given, wanted = (p, m, m, p, p), (p, p, m, m)  # `INPUTS`, `OUTPUTS`
    return (
        block_matrix(made, found, (0, 1, 0, 1), (0, 1, 0, 1), (1, 0, 0, 0), (-1, 0, 1, 0)),
        block_matrix(made, given, (0, 1, 1, 0, 0), (0, 1, 0, 0, 0), (0, 0, 0, -1, 1), (1, 0, 0, 1, -1)),
        block_matrix(wanted, found, (-1, 0, 0, 0), (-1, 0, 1, 0), (0, 0, 0, 1), (0, 1, 0, 1)),
        block_matrix(wanted, given, (1, 0, 0, 1, 0), (1, 0, 0, 1, -1), (0, 1, 0, 0, 0), (0, 1, 0, 0, 0)),
    )


@checked
def channel(
    loop: StateModel,
    source: str | Sequence[str],
    target: str | Sequence[str],
    inputs: int = 1,
    outputs: int = 1,
) -> StateModel:
    """Transfer between named signals of a `closed_loop` model, or between several of them in this order.

    S_I is u_ff to u, S_O is v to e_true, and r to e_true holds both T and the tracking behaviour.
    """
    chosen = []
    for names, known, of_plant in ((source, INPUTS, ("u_ff", "w")), (target, OUTPUTS, ("u", "f"))):
        places: dict[str, range] = {}
        for name in known:
            start = sum(map(len, places.values()))
            places[name] = range(start, start + (inputs if name in of_plant else outputs))
        wanted = (names,) if isinstance(names, str) else names
        if not set(wanted) <= set(known):
            raise InputError(f"channel {source!r} to {target!r} is unknown; use {INPUTS} and {OUTPUTS}")
        chosen.append([place for name in wanted for place in places[name]])
    return loop.select(*chosen)


@checked
def require_stable(loop: StateModel) -> None:
    """Refuse a closed loop that is unstable: its errors grow without bound and have no spectrum."""
    if not loop.is_stable:
        fastest = loop.poles.real.max()
        raise InputError(
            f"the closed loop is unstable (a pole at {fastest:+.3g} 1/s); lower the bandwidth or the gains"
        )


@checked
def require_deviations(deviations: dict[str, float]) -> None:
    """Refuse standard deviations of anything but the disturbances of a closed loop, ``w``, ``v`` and ``d``."""
    for name, deviation in deviations.items():
        require_choice("deviations", name, ("w", "v", "d"))
        require_number(f"deviations[{name!r}]", deviation, at_least=0.0)


@by_value
@dataclass(frozen=True)
class LoopResponse:
    """Frequency responses of single loops, the frequencies last; each function is computed when first used."""

    plant: Complex128[np.ndarray, "... f"]  # P
    observer: Complex128[np.ndarray, "2 2 ... f"]  # O, (u, y) to (u_d, y_flex)
    controller: Complex128[np.ndarray, "... f"]  # C_fb

    @cached_property
    def equivalent_plant(self) -> Complex128[np.ndarray, "... f"]:
        """P_eq, u to y_comp, (A.5)."""
        (o_uu, o_uy), (o_yu, o_yy) = self.observer
        return ((1 - o_yy) * self.plant - o_yu) / (1 - o_uu - o_uy * self.plant)

    @cached_property
    def _turn(self) -> Complex128[np.ndarray, "... f"]:
        (o_uu, _), (o_yu, _) = self.observer
        return 1 - self.controller * o_yu - o_uu

    @cached_property
    def reference_controller(self) -> Complex128[np.ndarray, "... f"]:
        """C_r, r to f."""
        return self.controller / self._turn

    @cached_property
    def output_controller(self) -> Complex128[np.ndarray, "... f"]:
        """-C_y, y to -f: (3.11), (3.37)."""
        (_, o_uy), (_, o_yy) = self.observer
        return (self.controller * (1 - o_yy) - o_uy) / self._turn

    @cached_property
    def loop(self) -> Complex128[np.ndarray, "... f"]:
        """P_eq C_fb, the loop at the controller."""
        return self.equivalent_plant * self.controller

    @cached_property
    def output_loop(self) -> Complex128[np.ndarray, "... f"]:
        """P C_eq, the loop at the plant's output."""
        return self.plant * self.output_controller

    @cached_property
    def input_sensitivity(self) -> Complex128[np.ndarray, "... f"]:
        """S_I."""
        return 1 / (1 + self.loop)

    @cached_property
    def output_sensitivity(self) -> Complex128[np.ndarray, "... f"]:
        """S_O."""
        return 1 / (1 + self.output_loop)

    @property
    def input_sensitivity_2(self) -> Complex128[np.ndarray, "... f"]:
        """S_I in the other order of plant and controller, which is the same for one input and output."""
        return self.input_sensitivity

    @property
    def output_sensitivity_2(self) -> Complex128[np.ndarray, "... f"]:
        """S_O likewise."""
        return self.output_sensitivity

    @cached_property
    def true_tracking(self) -> Complex128[np.ndarray, "... f"]:
        """From r to e_true."""
        return 1 - self.plant * self.reference_controller * self.output_sensitivity
