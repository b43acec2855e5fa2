"""The machine: its floors in pictures, the first estimate by hand beside the budget, and a published noise specification."""

from itertools import product

import numpy as np
from scipy import linalg

from experiments.budget.machine import BAND_HZ, FLOORS, budget_of, floor, machine, parameters
from stillwork.base.toml_files import read_toml
from stillwork.control.budget_sources import criterion_floor, shaped, white
from stillwork.control.error_budget import Network, Source, error_budget
from stillwork.control.floor_machine import FloorMachine, weak_integrator
from stillwork.control.pid import PidFamily
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, constant, interconnect
from workbook import figures, paths

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


def largest_ratios(found: dict[str, list[tuple[float, float]]]) -> dict[str, float]:
    """Largest factor between the budget and the estimate, of the floor's part and of the sensor's."""
    p = parameters().table("estimate")
    return {
        part: max(
            max(ours[k] / theirs, theirs / ours[k])
            for hertz in found
            for ours, theirs in zip(found[hertz], p[f"{part}_{hertz}"], strict=True)
        )
        for k, part in enumerate(("floor", "sensor"))
    }


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


# === Six axes =====================================================================================================

AXES = ("floor x", "floor y", "floor z")


def struts() -> tuple[np.ndarray, np.ndarray]:
    """Ends of the six struts from the frame's centre of mass (m), and their directions, (6, 3) each."""
    p, lines = (
        parameters().table("six_axes"),
        read_toml(paths.data("isolation", "rigid_body.toml")).table("struts"),
    )
    ends, directions = np.array(lines["positions"]), np.array(lines["directions"])
    ends = ends * p["radius"] / np.linalg.norm(ends[0])
    ends[:, 2] = -p["height"]
    return ends, -directions


def six_axis_network(skyhook: bool, feedforward: bool, offset: float) -> Network:
    """The frame as a body on six struts, the stage `offset` m beside its centre of mass along x, all laws strut by strut.

    In motions relative to the floor, whose accelerations along x, y and z push the body. Each strut has the skyhook and the
    feedforward of the machine with one axis; the stage moves along z.
    """
    own, six = machine(skyhook=skyhook, feedforward=feedforward), parameters().table("six_axes")
    k, d, critical = (each / np.sum(struts()[1][:, 2] ** 2) for each in own.suspension)
    ends, along = struts()
    jacobian = np.hstack([along, np.cross(ends, along)])
    gyration = np.square(six["gyration"])
    beside = np.array(
        [0.0, 0.0, 1.0, 0.0, -offset, 0.0]
    )  # of the frame's motion, what the stage above sees along z
    heavy = own.frame_mass + own.stage_mass * np.array([1.0, 1, 0, 0, 0, 0])  # the stage goes along sideways
    inverse = np.diag(1 / (heavy * np.append(np.ones(3), gyration)))
    stage_model = own.stage.state_space()
    n = len(stage_model.a)
    a = np.zeros((12 + n, 12 + n))
    a[:6, 6:12], a[12:, 12:] = np.eye(6), stage_model.a
    a[6:12, :6] = -inverse @ jacobian.T @ jacobian * k
    a[6:12, 6:12] = -inverse @ jacobian.T @ jacobian * d
    b = np.zeros((12 + n, 3 + 7))  # floor along three axes; the stage's drive and six struts
    b[6:9, :3] = -np.eye(3)
    b[6:12, 3], b[6:12, 4:] = -inverse @ beside, inverse @ jacobian.T
    b[12:, 3] = stage_model.b[:, 0]
    b[13, 2] = -1 / stage_model.c[0, 0]
    apart = np.concatenate([-beside, np.zeros(6), stage_model.c[0]])
    absolute = a[6:12].copy(), b[6:12] + np.eye(6, 10) * np.array([1.0] * 3 + [0.0] * 3)[:, None]
    c = np.vstack([apart, apart, jacobian @ absolute[0], np.zeros((3, 12 + n))])
    through = np.vstack([np.zeros((2, 10)), jacobian @ absolute[1], np.eye(3, 10)])
    through[:2, 3] = stage_model.d[0, 0]
    names = [f"strut {place + 1}" for place in range(6)]
    return Network(
        StateModel(a, b, c, through),
        _strut_laws(own, along, (k, d, critical)),
        dict.fromkeys(AXES, "m/s^2"),
        {"stage drive": "N"} | dict.fromkeys(names, "N"),
        {"stage to frame": "m"},
        {"stage sensor": "m"}
        | {f"{name}'s sensor": "m/s^2" for name in names}
        | {f"sensor of {axis}": "m/s^2" for axis in AXES},
    )


def _strut_laws(own: FloorMachine, along: np.ndarray, numbers: tuple[float, float, float]) -> StateModel:
    """From the stage's sensor, six struts' and three of the floor to the stage's drive and the six struts."""
    k, d, critical = numbers
    sky, one = 2 * np.pi * own.skyhook_hz, np.ones((1, 1))
    stage_law = own.controller.state_space()
    laws = [StateModel(stage_law.a, stage_law.b, -stage_law.c, -stage_law.d)]
    laws += [StateModel(-sky * one, one, -own.skyhook * critical * one, 0 * one)] * 6
    laws += [
        weak_integrator(own.integrator_hz, own.integrator_order)
    ] * 6  # of each axis once, then of these once more
    feedback = np.eye(13, 13, k=-3) * (np.arange(13) >= 10)[:, None]
    outputs = np.zeros((7, 13))
    outputs[:7, :7] = np.eye(7)
    outputs[1:, 7:10], outputs[1:, 10:] = -own.feedforward * d * along, -own.feedforward * k * along
    return interconnect(laws, feedback, np.eye(13, 10), outputs)


def six_over_one(criterion: str, offset: float, skyhook: bool = True, feedforward: bool = True) -> float:
    """Error with six axes over that with one, where the floor just meets a criterion along x, y and z."""
    p = parameters().table("noise")
    network = six_axis_network(skyhook, feedforward, offset)
    floors = [criterion_floor(axis, axis, criterion) for axis in AXES]
    others = [
        white("stage sensor", "stage sensor", "m", p["sensor"]),
        white("stage drive", "stage drive", "N", p["drive"]),
        *(white(f"{k + 1}", f"strut {k + 1}'s sensor", "m/s^2", p["frame_sensor"]) for k in range(6)),
        *(white(f"its {axis}", f"sensor of {axis}", "m/s^2", p["floor_sensor"]) for axis in AXES),
    ]
    alone = budget_of(machine(skyhook=skyhook, feedforward=feedforward), criterion).rms[0]
    return float(error_budget(network, [*floors, *others], BAND_HZ).rms[0] / alone)


def paint_six_axes(offsets: np.ndarray):
    """Error with six axes over that with one, by how far the stage is beside the centre of mass."""
    figure, axes = figures.new(height=2.6)
    for name, (skyhook, feedforward) in CASES.items():
        ratios = [six_over_one("VC-B", offset, skyhook, feedforward) for offset in offsets]
        axes.plot(1e3 * offsets, ratios, "o-", markersize=3, linewidth=0.9, label=name)
    axes.set(xlabel="stage beside the centre of mass (mm)", ylabel="error with six axes\nover that with one")
    axes.legend()
    return figure
