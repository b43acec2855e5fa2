"""The machine: its floors in pictures, the first estimate by hand beside the budget, and a published noise specification."""

from itertools import product

import numpy as np
from scipy import linalg

from experiments.budget.machine import BAND_HZ, FLOORS, floor, machine, parameters
from stillwork.control.budget import Network, Source, error_budget
from stillwork.control.budget_sources import shaped, white
from stillwork.control.floor_machine import FloorMachine
from stillwork.control.pid import PidFamily
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, constant
from workbook import figures

CASES = {
    "passive": (False, False),
    "with feedforward": (False, True),
    "70 % damped": (True, False),
    "damped, with feedforward": (True, True),
}


def paint_floors():
    """Acceleration of every floor, and how the frame moves on it with the springs alone and with both methods."""
    figure, (left, right) = figures.new(1, 2, height=3.4)
    f = np.geomspace(0.6, 300, 400)
    for name in FLOORS:
        seen = floor(name)._at(f)[0, 0].real
        dashes = "-" if name.startswith("VC") else "--"  # the colours repeat
        left.loglog(f[seen > 0], np.sqrt(seen[seen > 0]), dashes, linewidth=0.9, label=name)
    for name, (skyhook, feedforward) in CASES.items():
        network = machine(skyhook=skyhook, feedforward=feedforward).network()
        right.loglog(f, np.abs(network.paths(f)[0, 0]), linewidth=0.9, label=name)
    left.set(xlabel="frequency (Hz)", ylabel="floor (m/s²/√Hz)", ylim=(1e-9, 1e-1))
    right.set(xlabel="frequency (Hz)", ylabel="error over floor (m per m/s²)")
    left.legend(fontsize=6, ncols=2)
    right.legend(fontsize=7)
    return figure


def estimate_again() -> dict[str, list[tuple[float, float]]]:
    """Floor's and sensor's part, nm rms, at 37 and 83 Hz, of the rigid stage of the first estimate, in the cases' order."""
    p = parameters().table("estimate")
    shape = np.full((1, 1), p["stage_mass"] ** -0.5)
    rigid = ModalModel(np.zeros(1), np.zeros(1), shape, shape, np.zeros((1, 1)))
    own = machine()
    frame = own.frame_mass + own.stage_mass - p["stage_mass"]
    sources = [floor("slab under footfall"), white("sensor", "stage sensor", "m", p["sensor"])]
    found: dict[str, list[tuple[float, float]]] = {}
    for hertz, (skyhook, feedforward) in product((37.0, 83.0), CASES.values()):
        built = FloorMachine(
            frame,
            p["suspension_hz"],
            own.suspension_damping,
            rigid,
            PidFamily(p["stage_mass"])(hertz),
            skyhook=0.7 - own.suspension_damping if skyhook else 0.0,
            feedforward=1 - 10**-1.5 if feedforward else 0.0,
            integrator_hz=0.05,  # the estimate has ideal integrators
        )
        powers = error_budget(built.network(), sources, BAND_HZ).powers[:, 0]
        found.setdefault(f"{hertz:g}", []).append(tuple(1e9 * np.sqrt(powers)))
    return found


def beside_the_estimate(found: dict[str, list[tuple[float, float]]]):
    """A row a case: both parts of the budget, nm rms, and those of the first estimate."""
    from pandas import DataFrame

    p, rows = parameters().table("estimate"), {}
    for hertz, powers in found.items():
        for k, (case, (floor_nm, sensor_nm)) in enumerate(zip(CASES, powers, strict=True)):
            theirs = {f"{part}, estimate": p[f"{part}_{hertz}"][k] for part in ("floor", "sensor")}
            rows[f"{hertz} Hz, {case}"] = {"floor": floor_nm, "sensor": sensor_nm} | theirs
    return DataFrame(rows).T


def lyapunov_distance() -> float:
    """Relative distance of the power that a coloured floor causes from that of one Lyapunov equation, largest of the cases."""
    corner = 2 * np.pi * 30.0
    colour = StateModel(
        corner * (np.eye(3, k=-1) - np.eye(3)),
        corner * np.eye(3, 1),
        1e-3 * np.eye(1, 3, 2),
        np.zeros((1, 1)),
    )
    distances = []
    for skyhook, feedforward in CASES.values():
        network = machine("MC and AD", skyhook=skyhook, feedforward=feedforward).network()
        source = shaped("floor", ("floor",), "m/s^2", colour)
        power = error_budget(network, [source], (1e-5, 1e7)).powers[0, 0]
        loop = network.loop.select([0], [0])
        a = np.block([[loop.a, loop.b @ colour.c], [np.zeros((3, len(loop.a))), colour.a]])
        b = np.vstack([0 * loop.b, colour.b])
        balanced, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
        b, c = b / scale[:, None], np.hstack([loop.c, loop.d @ colour.c])[0] * scale
        covariance = linalg.solve_continuous_lyapunov(balanced, -b @ b.T)
        distances.append(abs(power / (c @ covariance @ c) - 1))
    return max(distances)


def printed_specification() -> dict[str, float]:
    """Rms of the noise budgets that Dehaeze prints, from the densities printed with them, 1 to 1000 Hz: nm and nrad."""
    direct = Network(
        constant(np.array([[1.0, 0.0], [1.0, 0.0]])),
        constant(np.zeros((1, 1))),
        {"vibration": "m"},
        {"u": "N"},
        {"e": "m"},
        {"y": "m"},
    )
    levels = {"Dx": 1e-9, "Rx": 2e-8}
    return {
        name: 1e9
        * error_budget(
            direct,
            [Source(name, ("vibration",), "m", lambda f, level=level: level**2 / (1 + (f / 100) ** 2))],
            (1.0, 1000.0),
        ).rms[0]
        for name, level in levels.items()
    }
