"""Closed loops with modes known within bounds, as a model in feedback with uncertain numbers."""

from dataclasses import replace

import numpy as np
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.control.loops import INPUTS, OUTPUTS, closed_loop
from stillwork.control.uncertainty import Share
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@checked
def uncertain_channel(
    plant: ModalModel,
    compensator: StateModel | None,
    controller: StateModel,
    source: str,
    target: str,
    *,
    frequency: Share = 0.0,
    damping: Share = 0.0,
    gain: Share = 0.0,
) -> tuple[StateModel, int]:
    r"""One channel of a `closed_loop` of a plant with uncertain modes, for `lti.prove_gain`.

    Each flexible mode's frequency lies within :math:`\omega(1\pm frequency)` and the coefficient of its velocity within
    :math:`2\zeta\omega(1\pm\max(frequency, damping))`, independently; the gain of the actuator within
    :math:`1\pm gain`. Observer and controller stay as they are. Shapes and compliance are taken as known.

    Parameters
    ----------
    plant : ModalModel
        Of one input and one output.
    compensator : StateModel, optional
        See `closed_loop`.
    controller : StateModel
    source, target : str
        Of `closed_loop`: ``u_ff`` to ``u`` is S_I, ``v`` to ``e_true`` S_O, ``r`` to ``e_true`` the tracking.
    frequency, damping, gain : float
        Relative, below 1.

    Returns
    -------
    model : StateModel
        The uncertain numbers' inputs and outputs first, then the channel's.
    uncertain : int
        Number of uncertain numbers.

    Raises
    ------
    InputError
        When nothing is uncertain, or the plant has several inputs or outputs.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapter 10.

    Examples
    --------
    A peak of S_I below 6 dB with the frequency of a mode 5 % lower or higher and all between, proven.

    >>> stage = lti.ModalModel([0.0, 2000.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> pid = control.PidFamily(1 / 0.09)(15.0).state_space()
    >>> model, uncertain = control.uncertain_channel(stage, None, pid, "u_ff", "u", frequency=0.05)
    >>> lti.prove_gain(model, uncertain, level=2.0).proven
    True
    """
    if len(plant.output_shapes) != 1 or plant.input_shapes.shape[1] != 1:
        raise InputError("plant has several inputs or outputs; give one of each")
    if source not in INPUTS or target not in OUTPUTS:
        raise InputError(f"channel {source!r} to {target!r} is unknown; use {INPUTS} and {OUTPUTS}")
    flexible = np.flatnonzero(plant.frequencies > 0) if frequency or damping else np.zeros(0, int)
    if not len(flexible) and not gain:
        raise InputError("frequency, damping and gain leave nothing uncertain; give one of them above 0")
    # The squared frequency runs from (1 - f)^2 to (1 + f)^2 times its own; its middle is (1 + f^2) times.
    middle = np.where(plant.frequencies > 0, np.sqrt(1 + frequency**2), 1.0)
    centred = replace(plant, frequencies=plant.frequencies * middle, damping=plant.damping / middle)
    loop = closed_loop(centred, compensator, controller)
    wide = max(frequency, damping)
    into, out = [], []
    for mode in flexible:
        omega, spring, damper = plant.frequencies[mode], np.zeros(len(loop.a)), np.zeros(len(loop.a))
        spring[2 * mode] = -2 * frequency * omega**2
        damper[2 * mode + 1] = -2 * plant.damping[mode] * omega * wide
        accelerate = np.eye(len(loop.a))[2 * mode + 1]
        for row in (spring, damper):
            if np.any(row):
                into.append(accelerate)
                out.append(row)
    uncertain = len(into)
    b = np.array(into).reshape(uncertain, len(loop.a)).T
    c = np.array(out).reshape(uncertain, len(loop.a))
    inputs, outputs = [INPUTS.index(source)], [OUTPUTS.index(target)]
    if gain:  # the force is (1 + gain delta) times the commanded one
        inputs, outputs = [INPUTS.index("w"), *inputs], [OUTPUTS.index("f"), *outputs]
    d = linalg.block_diag(np.zeros((uncertain, uncertain)), loop.d[np.ix_(outputs, inputs)])
    b, c = np.hstack([b, loop.b[:, inputs]]), np.vstack([c, loop.c[outputs]])
    if gain:
        b[:, uncertain] *= gain
        d[:, uncertain] *= gain
        uncertain += 1
    return StateModel(loop.a, b, c, d), uncertain
