"""How far to measure: a mode beyond the measured band breaks the promise below the frequency that is named, and none above."""

from dataclasses import replace

import numpy as np
import pytest

from motion.true_machines import TrueMachine
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.machine_loops import DesignSettings, SearchSettings, reach
from stillwork.control.uncertainty import uncertainty_of
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.machine.machine_designs import INTENSITIES, Designed
from stillwork.machine.promise import breaking_hz

RATE = 8000.0
MODES = {"hertz": (180.0, 290.0), "damping": (0.05, 0.001), "position": (0.8, 0.01)}
TRUE = TrueMachine(mass=12.0, **MODES, delay=1 / RATE)
HERTZ = np.arange(5.0, 320.0, 0.25)


def peak(machine, pid):
    """Of the sampled loop, from the state equations of the machine and the law of the PID, on a fine grid."""
    a, b, c = machine.sampled(RATE)
    near = [
        f * (1 + np.linspace(-6, 6, 121) * z) for f, z in zip(machine.hertz, machine.damping, strict=True)
    ]
    hertz = np.concatenate([np.geomspace(1.0, RATE / 2.001, 3000), *near])
    z = np.exp(2j * np.pi * hertz / RATE)
    plant = np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, b[:, None].astype(complex))[..., 0] @ c
    s = 2 * RATE * (z - 1) / (z + 1)
    w = pid.low_pass
    law = pid.gain * (s + pid.integrator) * (s / pid.differentiator + 1) * w * w
    law = law / (s * (s * s + 2 * pid.low_pass_damping * w * s + w * w))
    return float(np.abs(1 / (1 + law * plant)).max())


def with_another(hertz, share):
    new = {"hertz": hertz, "damping": 0.001, "position": share}
    return replace(TRUE, **{name: (*values, new[name]) for name, values in MODES.items()})


@pytest.mark.slow
def test_it_is_named_up_to_where_one_mode_more_breaks_the_promise():
    seen = TRUE.response(HERTZ) * np.exp(2j * np.pi * HERTZ / RATE)  # the delay is the loop's
    machine = build_machine(load_machine((HERTZ, seen), "m", "N"), modes_hz=[], fit_hz=(0, 0))
    use, search = DesignSettings(None, 5, INTENSITIES, False), SearchSettings(1 / RATE, 1.0, {})
    reached = reach(machine, use, search)
    spreads = (uncertainty_of(machine, {}),)
    made = Designed(machine, (), RATE, 1.0, (), {}, spreads, {"PID": use}, {"PID": reached}, (), {})
    pid, named = reached.safe.controller, breaking_hz(made, "PID")
    assert peak(TRUE, pid) == pytest.approx(SIX_DB, rel=0.02)
    assert HERTZ[-1] < named < 10 * RATE
    near, far = named * np.linspace(0.85, 0.99, 8), named * np.geomspace(1.01, 4.0, 24)
    for share in (-0.8, 0.8):
        assert (
            max(peak(with_another(f, share), pid) for f in far) < 1.01 * SIX_DB
        )  # their tails lift the peak of the loop itself
    assert max(peak(with_another(f, share), pid) for f in near for share in (-0.8, 0.8)) > 1.05 * SIX_DB
