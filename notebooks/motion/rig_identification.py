"""Identification of the rig as in section 6.2: four multisine experiments in closed loop, one modal model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Complex128, Float64
from scipy.optimize import least_squares

from experiments.motion.pictures import add_magnitude, paint_magnitudes, plain
from experiments.motion.rig import (
    EdgeDecoupling,
    Geometry,
    assumed_geometry,
    decoupling,
    published,
    rig_model,
)
from experiments.motion.rig_designs import (
    RigSettings,
    bandwidths,
    frequencies,
    model_errors,
    published_settings,
    rig_controllers,
    rig_loops,
)
from experiments.motion.rig_loops import sampled_controller
from stillwork.control.loops import channel, closed_loop
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.discretisation import sampled_modes, zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel
from workbook import figures

ALL = (0, 1, 2, 3)
POWERS = (0, 2, 4)  # of the frequency, in the series for the compliance of the modes above the band
DAMPING = (1e-5, 0.3)  # range of the damping ratios that the fit of a matrix looks for
DAMPING_GUESS = 0.005  # where it begins


def random_phase_multisine(
    rng: np.random.Generator, samples: int, rms: float
) -> Float64[np.ndarray, " samples"]:
    """One period of a multisine with equal amplitudes and random phases on every line up to the Nyquist frequency."""
    spectrum = np.zeros(samples // 2 + 1, complex)
    lines = samples // 2 - 1
    spectrum[1:-1] = np.exp(2j * np.pi * rng.random(lines))
    return np.fft.irfft(spectrum) * (samples * rms / np.sqrt(2 * lines))


@dataclass(frozen=True)
class MultisineRecords:
    """Spectra of the measured periods; one experiment an actuator, several realisations of the phases each."""

    omega: Float64[np.ndarray, " lines"]  # rad/s, of the excited lines
    reference: Complex128[np.ndarray, "experiments realisations lines"]  # what was added to one actuator
    inputs: Complex128[np.ndarray, "experiments realisations periods actuators lines"]
    outputs: Complex128[np.ndarray, "experiments realisations periods sensors lines"]


def run_multisine(
    loop: StateModel,
    actuators: int,
    sensors: int,
    deviations: tuple[float, float],
    rng: np.random.Generator,
    *,
    samples: int = 16384,
    rms: float = 1.0,
    realisations: int = 10,
    periods: int = 2,
    settling: int = 2,
) -> MultisineRecords:
    """Excite one actuator after the other in closed loop; keep the periods after the settling.

    The discrete loop leads from added force, unmeasured force at the plant (both one an actuator) and sensor noise to
    the commanded forces and the measured outputs; `deviations` are those of the unmeasured force (N) and of the
    sensor noise (m) a sample. For every one of the `realisations` the phases are drawn anew.
    """
    sizes = np.repeat(deviations, [actuators, sensors])
    lines = slice(1, samples // 2)
    reference, inputs, outputs = [], [], []
    for actuator in range(actuators):
        for _ in range(realisations):
            one = random_phase_multisine(rng, samples, rms)
            signals = np.zeros((2 * actuators + sensors, (settling + periods) * samples))
            signals[actuator] = np.tile(one, settling + periods)
            signals[actuators:] = sizes[:, None] * rng.standard_normal(
                (actuators + sensors, signals.shape[1])
            )
            measured = simulate(loop, signals)[:, settling * samples :]
            spectra = np.fft.rfft(measured.reshape(len(measured), periods, samples), axis=2)[:, :, lines]
            reference.append(np.fft.rfft(one)[lines])
            inputs.append(np.moveaxis(spectra[:actuators], 0, 1))
            outputs.append(np.moveaxis(spectra[actuators:], 0, 1))
    shape = (actuators, realisations)
    return MultisineRecords(
        2 * np.pi * np.fft.rfftfreq(samples, loop.sample_time)[lines],
        np.array(reference).reshape(*shape, -1),
        np.array(inputs).reshape(*shape, *inputs[0].shape),
        np.array(outputs).reshape(*shape, *outputs[0].shape),
    )


class ResponseMatrix(NamedTuple):
    """An estimated frequency response matrix."""

    omega: Float64[np.ndarray, " lines"]  # rad/s
    response: Complex128[np.ndarray, "lines sensors actuators"]
    deviation: Float64[np.ndarray, "lines sensors actuators"]  # standard deviation of the complex error


def joint_input_output(records: MultisineRecords) -> ResponseMatrix:
    r"""Plant from the responses of inputs *and* outputs to the excitation: :math:`G = T_{yr}T_{fr}^{-1}`.

    Every period is averaged at the excited lines and divided by the known excitation. What the loop feeds back of
    the noise is independent of that excitation and averages out of both, so no bias of the loop remains; the
    realisations give the variance.
    """
    t_f, t_y = (
        np.einsum("ermal,erl->rlae", spectra, 1 / records.reference) / spectra.shape[2]
        for spectra in (records.inputs, records.outputs)
    )
    turn = np.linalg.inv(t_f.mean(axis=0))
    response = t_y.mean(axis=0) @ turn
    errors = (t_y - response @ t_f) @ turn
    count = len(errors)
    return ResponseMatrix(
        records.omega, response, np.sqrt((np.abs(errors) ** 2).sum(axis=0) / (count * (count - 1)))
    )


@dataclass(frozen=True)
class Experiment:
    """All four actuators and sensors of the rig under a slow controller."""

    plant: ModalModel
    decoupling: EdgeDecoupling
    controller: StateModel  # from the errors at the sensors to forces
    noise: NoiseIntensities  # covariances a sample, N^2 and m^2

    def loop(self) -> StateModel:
        """From what is added to the force, w and d to f and y, as `run_multisine` takes it."""
        closed = closed_loop(zoh_modes(self.plant, self.controller.sample_time), None, self.controller)
        seen = channel(closed, ("u_ff", "w", "d"), ("f", "e_meas"), 4, 4)
        # Without a setpoint the measured error is minus the measurement.
        signs = np.repeat([[1.0], [-1.0]], 4, axis=0)
        return StateModel(seen.a, seen.b, signs * seen.c, signs * seen.d, seen.sample_time)

    def response(
        self, omega: Float64[np.ndarray, " lines"]
    ) -> Complex128[np.ndarray, "lines sensors actuators"]:
        """Sampled response of the rig at `omega` (rad/s)."""
        return np.moveaxis(zoh_response(self.plant, self.controller.sample_time, omega), -1, 0)

    def deviation(
        self, omega: Float64[np.ndarray, " lines"], rms: float, averages: int
    ) -> Float64[np.ndarray, "lines sensors actuators"]:
        """Standard deviation that `joint_input_output` must have: exactly what the noise leaves after averaging.

        The error of an experiment is (G w + d) over the excitation, turned by the inverse of the input responses,
        I + C G.
        """
        response = self.response(omega)
        turn = np.eye(4) + np.moveaxis(self.controller.frequency_response(omega), -1, 0) @ response
        seen = self.noise.process * (np.abs(response) ** 2).sum(axis=2) + self.noise.sensor
        return np.sqrt(seen[:, :, None] * (np.abs(turn) ** 2).sum(axis=1)[:, None, :] / (averages * rms**2))

    def bias(self, omega: np.ndarray, response: np.ndarray, top_hz: float) -> float:
        """Mean over the lines up to `top_hz` and over z, rx, ry of the relative error of the decoupled plant.

        Noise averages out of this mean, a bias stays.
        """
        slow = omega <= 2 * np.pi * top_hz
        d = self.decoupling
        ours, true = (
            np.diagonal(d.sensing @ each @ d.actuation, axis1=1, axis2=2)
            for each in (response[slow], self.response(omega[slow]))
        )
        return float(abs(np.mean(ours / true - 1)))

    def convergence(
        self, records: MultisineRecords, top_hz: float, counts: Sequence[int]
    ) -> dict[str, list[float]]:
        """`bias` of the joint and of the direct estimate from the first realisations."""
        found: dict[str, list[float]] = {"joint input-output": [], "direct": []}
        for count in counts:
            kept = (each[:, :count] for each in (records.reference, records.inputs, records.outputs))
            part = MultisineRecords(records.omega, *kept)
            for name, response in (
                ("joint input-output", joint_input_output(part).response),
                ("direct", direct_response(part)),
            ):
                found[name].append(self.bias(part.omega, response, top_hz))
        return found


def rig_experiment(geometry: Geometry, settings: RigSettings, bandwidth_hz: float) -> Experiment:
    """The experiment with controllers of that design bandwidth in all directions."""
    directions = decoupling(geometry, ALL, ALL)
    pids = rig_controllers(directions.masses)(bandwidth_hz, bandwidth_hz)
    controller = sampled_controller(pids, directions, settings.sample_time)
    return Experiment(rig_model(geometry), directions, controller, settings.noise)


def direct_response(records: MultisineRecords) -> Complex128[np.ndarray, "lines sensors actuators"]:
    """Plant from inputs and outputs alone, S_yf S_ff^-1: biased in closed loop, for comparison."""
    inputs, outputs = records.inputs, records.outputs
    cross, power = (np.einsum("ermal,ermbl->lab", left, inputs.conj()) for left in (outputs, inputs))
    return cross @ np.linalg.inv(power)


def smoothed_deviation(estimate: ResponseMatrix) -> Float64[np.ndarray, " lines"]:
    """Deviation over frequency: root mean square over entries and over fifteen neighbouring lines."""
    power = (estimate.deviation**2).mean(axis=(1, 2))
    kernel = np.ones(15)
    sums = np.convolve(power, kernel, mode="same") / np.convolve(np.ones_like(power), kernel, mode="same")
    return np.sqrt(sums)


@dataclass(frozen=True)
class ModalMatrixFit:
    """A modal model with rigid body and compliance, and how well it fits."""

    model: ModalModel
    deviation: Float64[np.ndarray, " modes"]  # standard deviation of the flexible frequencies (rad/s) ...
    damping_deviation: Float64[np.ndarray, " modes"]  # ... and of the damping ratios
    rank_one: Float64[np.ndarray, " modes"]  # second over first singular value of each mode's residue
    misfit: float  # root mean square of the weighted error; 1 where only noise remains


def fit_modal_matrix(
    omega: Float64[np.ndarray, " lines"],
    response: Complex128[np.ndarray, "lines sensors actuators"],
    deviation: Float64[np.ndarray, " lines"],
    modes: int,
    sample_time: float,
    rigid_modes: int,
) -> ModalMatrixFit:
    r"""Fit frequencies, damping and residue matrices by weighted least squares over all entries at once.

    The plant is sampled with a zero-order hold: :math:`G = R_0b_0 + \sum_i R_ib_i(\omega_i, \zeta_i) +
    \frac{1+z^{-1}}2(D + \omega^2D_2 + \omega^4D_4)`, where :math:`b_i` is the exact sampled response of one mode of
    unit residue. :math:`D` is the compliance of higher modes, the next terms its growth towards their resonances;
    the hold delays it by half a sample, as the exact response of an undamped mode does. The model keeps :math:`D`.
    The residues follow linearly from frequencies and damping, which alone are searched (variable projection). The
    modes are found one after the other, each where what the others leave is largest. At the end every residue is
    brought to rank one, the rigid body's to rank `rigid_modes`. The response (lines, outputs, inputs) is in m/N, and
    `deviation` the standard deviation of an entry's complex error on each line.
    """
    problem = MatrixProblem(omega, response, deviation, sample_time)
    parameters = np.zeros((2, 0))
    for count in range(1, modes + 1):
        left = problem.residual(parameters).reshape(2, len(omega), -1)
        where = omega[(left**2).sum(axis=(0, 2)).argmax()]
        parameters = np.column_stack([parameters, np.log([where, DAMPING_GUESS])])
        # A mode may move by 2 % at a time: further away it would take the place of another.
        low = np.stack([parameters[0] - 0.02, np.full(count, np.log(DAMPING[0]))])
        high = np.stack([parameters[0] + 0.02, np.full(count, np.log(DAMPING[1]))])
        best = least_squares(
            lambda p: problem.residual(p.reshape(2, -1)),
            np.clip(parameters, low + 1e-9, high - 1e-9).ravel(),
            bounds=(low.ravel(), high.ravel()),
            x_scale=np.repeat([0.002, 0.3], count),
            max_nfev=60 if count == modes else 6,
            xtol=1e-10,
        )
        parameters = best.x.reshape(2, -1)
    if best.status <= 0:
        raise ArithmeticError("the search for frequencies and damping did not end")
    parameters = parameters[:, np.argsort(parameters[0])]
    gains = problem.residues(parameters)
    spread = problem.spread(parameters)
    u, s, v = np.linalg.svd(np.concatenate([gains[:1], gains[1 + len(POWERS) :]]))
    # Of the rigid body as many singular vectors as it has modes, of every other residue the first.
    which = np.append(np.zeros(rigid_modes, int), np.arange(1, modes + 1))
    first = np.append(np.arange(rigid_modes), np.zeros(modes, int))
    sizes = np.sqrt(s[which, first])
    still = np.zeros(rigid_modes)
    frequencies, damping = np.exp(parameters)
    model = ModalModel(
        np.concatenate([still, frequencies]),
        np.concatenate([still, damping]),
        v[which, first] * sizes[:, None],
        u[which, :, first].T * sizes,
        gains[1],
    )
    return ModalMatrixFit(
        model,
        frequencies * spread[0],
        damping * spread[1],
        s[1:, 1] / s[1:, 0] if s.shape[1] > 1 else np.zeros(len(s) - 1),  # one entry is of rank one
        float(np.sqrt(np.mean(np.sum(problem.residual(parameters).reshape(2, -1) ** 2, axis=0)))),
    )


class MatrixProblem:
    """Weighted data, and what is linear in the residues."""

    def __init__(self, omega, response, deviation, sample_time):
        self.omega, self.deviation, self.sample_time = omega, deviation, sample_time
        self.shape = response.shape[1:]
        target = (response / deviation[:, None, None]).reshape(len(omega), -1)
        self.goal = stacked(target)
        held = (1 + np.exp(-1j * omega * sample_time)) / 2
        self.fixed = held * (omega / omega.max()) ** np.array(POWERS)[:, None]

    def _columns(self, parameters):
        """Orthogonal columns (rigid body, compliance terms, modes), their triangle and their sizes."""
        modes, ratios = np.exp(parameters)
        each = sampled_modes(np.append(0.0, modes), np.append(0.0, ratios), self.sample_time, self.omega)
        whole = (np.vstack([each[:1], self.fixed, each[1:]]) / self.deviation).T
        columns = stacked(whole)
        sizes = np.linalg.norm(columns, axis=0)
        return *np.linalg.qr(columns / sizes), sizes

    def residual(self, parameters) -> np.ndarray:
        q, _, _ = self._columns(parameters)
        return (self.goal - q @ (q.T @ self.goal)).ravel()

    def residues(self, parameters) -> np.ndarray:
        q, r, sizes = self._columns(parameters)
        return (np.linalg.solve(r, q.T @ self.goal) / sizes[:, None]).reshape(-1, *self.shape)

    def spread(self, parameters) -> np.ndarray:
        """Standard deviations of the logarithms; each of the two parts of an error has half its variance."""
        moves = 1e-6 * np.eye(parameters.size).reshape(-1, *parameters.shape)
        jacobian = [self.residual(parameters + move) - self.residual(parameters - move) for move in moves]
        jacobian = np.array(jacobian) / 2e-6
        return np.sqrt(np.diag(np.linalg.inv(jacobian @ jacobian.T)) / 2).reshape(parameters.shape)


def stacked(values: np.ndarray) -> np.ndarray:
    """Real parts above imaginary ones."""
    return np.concatenate([values.real, values.imag])


def paint_identified(omega: np.ndarray, measured: np.ndarray, model: np.ndarray, deviation: np.ndarray):
    """Actuator 1 to all sensors: measured, fitted, what is left, and what the noise explains: Fig. 6.4."""
    lines = {
        "measured": (measured, {"color": figures.ORANGE, "linewidth": 2.2}),
        "model": (model, {"color": figures.BLACK, "linewidth": 0.8}),
        "difference": (measured - model, {"color": figures.GREY, "linewidth": 0.4}),
        "least deviation": (deviation, {"color": figures.BLUE, "linewidth": 1.0, "linestyle": "--"}),
    }
    panels = {
        f"sensor {k + 1}": {name: (omega, values[:, k, 0], style) for name, (values, style) in lines.items()}
        for k in range(4)
    }
    quantity = "actuator 1 to sensor\n(dB re 1 m/N)"
    figure, axes = paint_magnitudes(panels, quantity, rows=2, height=5.0, sharex=True, sharey=True)
    for axis in axes.ravel():
        low = {"transform": axis.get_xaxis_transform(), "markersize": 3}
        figures.mark_published(
            axis, published()["frequencies_hz"], np.full(8, 0.03), "published, Table 6.1", **low
        )
    figures.legend_below(axes[0, 0], 5, fontsize=7)
    return figure


def paint_identification(rms: float, averages: int, bandwidth_hz: float, sensor_exponent: float):
    """Explorer: response of the rig, and the deviation that an identification in closed loop leaves."""
    settings = published_settings()
    settings = replace(settings, noise=NoiseIntensities(settings.noise.process, 10**sensor_exponent))
    experiment = rig_experiment(assumed_geometry(), settings, bandwidth_hz)
    omega = frequencies(1.0, 1500.0, points=90, around=5)
    response, deviation = experiment.response(omega), experiment.deviation(omega, rms, averages)
    figure, axis = plain()
    add_magnitude(axis, omega, response[:, 2, 0], color=figures.BLUE, label="response")
    add_magnitude(axis, omega, deviation[:, 2, 0], ls="--", color=figures.BLACK, label="least deviation")
    axis.set(xlabel="frequency (Hz)", ylabel="actuator 1 to sensor 3 (dB re 1 m/N)")
    axis.legend()
    return figure


# === The appendix =================================================================================================


def appendix(
    page,
    *,
    geometry: Geometry,
    settings: RigSettings,
    experiment: Experiment,
    estimate: ResponseMatrix,
    fit: ModalMatrixFit,
    excitation: float,
    averages: int,
    seed: int,
) -> None:
    """What the page of motion/26 shows beside its answer."""
    page.text("""## Noise

Spread over the realisations over the least deviation under this noise; it is larger, because force noise makes a free body drift:""")
    rows = {}
    for low, high in ((0.5, 3), (3, 20), (20, 100), (100, 400), (400, 1300)):
        chosen = (estimate.omega > 2 * np.pi * low) & (estimate.omega < 2 * np.pi * high)
        least = experiment.deviation(estimate.omega[chosen], excitation, averages)
        rows[f"{low} to {high} Hz"] = np.sqrt(np.mean((estimate.deviation[chosen] / least) ** 2))
    page.show(pd.Series(rows).round(2))
    page.show(f"weighted misfit of the model: {fit.misfit:.2f} (1: only noise is left)")
    page.text("## Table 6.1\n\nStandard deviations, and how far each residue matrix was from rank one.")
    table = published()
    columns = {
        "published (Hz)": table["frequencies_hz"],
        "identified (Hz)": (fit.model.frequencies[3:] / (2 * np.pi)).round(3),
        "deviation (Hz)": (fit.deviation / (2 * np.pi)).round(4),
        "published damping": table["damping"],
        "identified": fit.model.damping[3:].round(5),
        "deviation": fit.damping_deviation.round(6),
        "not rank one": fit.rank_one.round(4),
    }
    page.show(pd.DataFrame(columns, index=pd.RangeIndex(1, 9, name="mode")))
    page.text("""## Bandwidths with the identified model

Observers from the identified model, from exact frequencies, and from frequencies off by the assumed half per cent.""")
    models = {
        "exact": {},
        "identified": {"known": fit.model},
        "frequencies 0.5 % off": {"errors": model_errors(np.random.default_rng(seed))},
    }
    reached = {
        name: {
            case: ", ".join(f"{f:.1f}" for f in design.crossing_hz.mean(axis=0))
            for case, design in bandwidths(rig_loops(geometry, settings, **given), "diagonal").items()
        }
        for name, given in models.items()
    }
    page.show(pd.DataFrame(reached))


def paint_bias(counts: Sequence[int], errors: dict[str, list[float]]):
    """Mean relative error below the bandwidth over the number of realisations, by each estimate."""
    figure, axis = figures.new(1, 1, height=2.6)
    for (name, each), colour in zip(errors.items(), (figures.BLUE, figures.RED), strict=True):
        axis.loglog(counts, each, "o-", color=colour, label=name)
    axis.set_xticks(counts, [str(count) for count in counts])
    axis.minorticks_off()
    axis.set_yticks([0.02, 0.05, 0.1, 0.2], ["0.02", "0.05", "0.1", "0.2"])
    axis.set(xlabel="realisations in every experiment", ylabel="mean relative error")
    axis.legend()
    return figure
