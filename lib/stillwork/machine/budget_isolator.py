"""What `isolate` wrote, as the frame, the law and the sensors of an error budget."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stillwork.base.checks import InputError, require_array
from stillwork.base.toml_files import Table
from stillwork.control.digital import from_biquads
from stillwork.control.isolation_filters import skyhook, weak_highpass, weak_integrator
from stillwork.lti.state_space import StateModel, interconnect
from stillwork.machine.isolation import ORDER, POWERS, folded_steps


class WrittenIsolator(NamedTuple):
    """One axis of an isolator with its settled feedforward."""

    about: Table  # the JSON

    @property
    def mass(self) -> float:
        """kg, of frame and stage."""
        return self._mechanics("mass")

    @property
    def suspension_hz(self) -> float:
        """Of frame and stage on the springs."""
        return float(np.sqrt(self._mechanics("stiffness") / self.mass)) / (2 * np.pi)

    @property
    def suspension_damping(self) -> float:
        """Ratio to critical."""
        return self._mechanics("damping") / (2 * float(np.sqrt(self._mechanics("stiffness") * self.mass)))

    @property
    def noises(self) -> dict[str, float]:
        """m/s^2/sqrt(Hz), by the sensor's place."""
        own = self.about.table("isolator")
        return {"frame sensor": float(own["platform_noise"]), "floor sensor": float(own["floor_noise"])}

    def _mechanics(self, name: str) -> float:
        return require_array(name, self.about.table("isolator")[name], shape=(1, 1)).item()

    @property
    def pole_hz(self) -> float:
        """Of the actuator."""
        return float(self.about.table("isolator")["actuator_pole_hz"])

    def law(self, sample_time: float, delay: float) -> StateModel:
        """From frame and floor sensor to the force, sampled; the network's own `delay` (samples) is taken off.

        The weights are the design's, frozen. The hold of a slower loop counts as half its longer period of delay, and its filters
        are taken at the network's rate, where Tustin's rule warps them less: motion of some parts in a thousand of the passive one.
        """
        about, own = self.about, self.about.table("isolator")
        cutoff, beta = 2 * np.pi * about["cutoff_hz"], about["beta"]
        weights = require_array("weights", about["weights"], shape=(1, POWERS + 1))
        integrator = from_biquads(weak_integrator(ORDER, cutoff, beta, sample_time), sample_time)
        late = (own["delay_s"] + 0.5 / about["rate_hz"]) / sample_time - delay - 0.5
        if late < -1e-6:
            raise InputError(
                f"the isolator acts {-late * sample_time:.3g} s sooner than the machine's controllers; give [controller] fewer "
                "delay_samples or a higher rate_hz"
            )
        chain = [
            from_biquads(skyhook(about["skyhook_gain"], sample_time), sample_time),
            from_biquads(weak_highpass(ORDER, cutoff, about["highpasses"], sample_time), sample_time),
            *[integrator] * POWERS,
            _waiting(max(late, 0.0), sample_time),
            self._folded(sample_time, delay),
        ]
        n, out = len(chain), len(chain) - 2
        feedback, inputs = np.zeros((n, n)), np.zeros((n, 2))
        feedback[range(2, out), range(1, out - 1)] = 1
        feedback[out, :out] = [-1.0, *weights[0]]
        feedback[n - 1, out], feedback[0, n - 1] = 1, -1
        inputs[[0, 1], [0, 1]] = 1
        return interconnect(chain, feedback, inputs, np.eye(n)[[out]])

    def _folded(self, sample_time: float, delay: float) -> StateModel:
        """From the held force to what its steps fold into the frame's readings, which the C takes off."""
        above, late = folded_steps(2 * np.pi * self.pole_hz * sample_time, delay)
        steps = above / self.mass * (np.eye(late + 1)[-2:-1] - np.eye(late + 1)[-1:])
        return StateModel(
            np.eye(late + 1, k=-1), np.eye(late + 1)[:, :1], steps, np.zeros((1, 1)), sample_time
        )


def _waiting(samples: float, sample_time: float) -> StateModel:
    """A delay of some samples; of a fraction of one by a straight line between two."""
    whole = int(samples)
    n, part = whole + 1, samples - whole
    c = np.zeros((1, n))
    c[0, whole] += part
    if whole:
        c[0, whole - 1] += 1 - part
    return StateModel(
        np.eye(n, k=-1), np.eye(n)[:, :1], c, np.array([[0.0 if whole else 1 - part]]), sample_time
    )


def read_isolator_design(folder: str) -> WrittenIsolator:
    """The design in a folder that `isolate` wrote, or in its JSON file; of one axis with one floor sensor that moves its foot."""
    files = [Path(folder)] if folder.endswith(".json") else sorted(Path(folder).glob("*.json"))
    if len(files) != 1:
        raise InputError(
            f"{folder} holds {len(files)} designs; give the JSON file that stillwork isolate wrote"
        )
    try:
        about = Table(dict(json.loads(files[0].read_text(encoding="utf-8"))), files[0].name)
    except (OSError, ValueError, TypeError, RecursionError):
        raise InputError(
            f"{files[0].name} cannot be read; give the JSON file that stillwork isolate wrote"
        ) from None
    foot = np.asarray(about.table("isolator")["floor"], dtype=float)
    if foot.shape != (1, 1) or foot != 1:
        raise InputError(
            f"{files[0].name} is of {foot.shape[0]} axes and {foot.shape[1]} floor sensors; a budget is along one axis: design "
            "that axis by itself, with floor = [[1.0]]"
        )
    return WrittenIsolator(about)
