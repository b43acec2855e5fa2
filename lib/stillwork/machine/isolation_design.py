"""Design of an isolator's self-tuned feedforward, and its certificate before it is switched on."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.polynomial import legendre
from scipy import linalg, optimize, signal

from stillwork.base.bounds import Natural, NonNegative, Positive, one_of, within
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.isolation_filters import FrequencyNotch, NoiseShaping
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.mean_adaptation import (
    ALGORITHMS,
    Responses,
    Steady,
    error_spectra,
    mean_adaptation,
    scatter,
)
from stillwork.machine.isolation import (
    SMOOTHING,
    Certificate,
    FeedforwardLoop,
    FloorSpectra,
    Isolator,
    Mismatch,
    by_drift,
    encirclements,
    over_the_band,
    path_angle,
    path_mismatch,
    slow_level,
)

HIGHEST_SENSITIVITY_DB = 6.0  # of the skyhook loop
HIGHEST_PHASE = 90.0  # degrees
SLOWEST = 0.1  # of the mean update's eigenvalues, of FeRLS: a mode takes ten time constants at most
# Of `Mismatch.loop_gain` at CREST times the slow level's rms: chosen on four random isolators on a microseism, with paths in
# their box, driven to where they break. None ran away at 2, and some at 4.
LIMIT, CREST = 1.0, 3.0
GROWTH = 1e3  # of the guard's level, at most
WITHIN = 1.1  # power of the remaining motion, over that once settled, at which weights count as settled
FASTER = 1.05  # between time constants that are tried
PERIODS = 3.0  # of the band's lower end that a time constant holds for each regressor: half of it leaves 5 % more motion
EVEN_HZ = 0.25  # between the lines on which densities are convolved
LOWEST_HZ = 1.0  # from where the remaining motion is judged
RATIOS = (0.0, 0.1, 0.2, 0.4, 0.7)  # relative damping that the skyhook adds, tried
LOW_SHARE, HIGH_SHARE = 0.4, 8.0  # of the lowest and the highest mode, where the band begins and ends at most
TRUSTED_PHASE = 50.0  # degrees of the path's error at the band's upper end
CUTOFFS_HZ = (0.5, 1.0, 2.0, 3.0, 4.5)  # of the weak integrators, tried
HIGHPASSES = (1, 2, 3)  # of the floor sensors, tried
LATER = 4  # samples of delay that are tried beyond the isolator's own
EVEN = 10.0  # regularisation of FeLMS over the power of the regressors: an even step but for bursts
ALIKE = 1.2  # of the least power of the remaining motion: up to there the fastest adaptation is taken
LONGEST_S, BEYOND_S = 300.0, 1e6  # largest time constant considered, and sought for a message
SEGMENTS = 4  # of a record, half overlapping, that the finest lines average over at least
COARSE = 4  # of the coarse lines, which give way to fine ones
BURST_S = 0.5  # of a stretch of a record whose power counts
DRAWS = 24  # of isolators in the box, for the band of a prediction
ENDS = 16  # of the box, beside them: all of one axis, and those where all modes are off alike of several
PARTS = 20  # of a record, whose means show a drift
DRIFT_HZ = 0.01  # a drift is slower: half the lowest frequency at which a floor is judged
DRIFTS = 0.75  # of how the parts' means scatter, that a drift makes (chosen)
FADE_S = 5.0  # at both ends of the record, a twentieth of it at most: in half a second a microseism leaks above 1 Hz
# How far the shares of the box go of what `spread` is: of each mode's mass and stiffness, damping, actuator pole
SPREADS = {"mass": 1.0, "stiffness": 1.0, "damping": 4.0, "pole": 2.0}

Responding = Complex128[np.ndarray, "frequencies axes inputs"]
Paths = Callable[[Float64[np.ndarray, " frequencies"]], tuple[Responding, Responding, Responding]]


@checked
def floor_spectra(
    acceleration: Float64[np.ndarray, "sensors samples"],
    sample_rate: Positive,
    source: str,
    resolution_hz: Positive = 0.25,
    slow_hz: Positive = 0.02,
) -> FloorSpectra:
    """Cross spectra of a record by Welch's method, on bands of one per cent where the lines lie closer.

    The first lines are as fine as the record allows with some averaging, but not finer than `slow_hz`. What is
    slower is taken for a drift of the sensors: of a motion it would be a step where the record begins again.
    """
    count = acceleration.shape[1]
    fade = min(2 * FADE_S * sample_rate / count, 0.1)
    acceleration, drift = _without_drift(acceleration, sample_rate)
    length = round(sample_rate / resolution_hz)
    if length < 2:
        raise InputError(
            f"resolution_hz is {resolution_hz:g} at {sample_rate:g} samples a second; give half of that at most"
        )
    if count < 2 * length:
        raise InputError(f"{source} is too short; give at least {2 / resolution_hz:g} s")
    f, lines = _cross_lines(acceleration, sample_rate, length)
    bands = [(f, lines)]
    longest = min(round(sample_rate / slow_hz), count // SEGMENTS)
    if longest > 2 * length and len(f) > 2 * COARSE:
        edge = f[COARSE] - (f[1] - f[0]) / 2  # a strong slow peak leaks into the first coarse lines
        fine, slow = _cross_lines(acceleration, sample_rate, longest)
        below = fine < edge
        bands = [(fine[below], slow[below]), (f[COARSE:], lines[COARSE:])]
    parts = [binned(*band, count / sample_rate, source) for band in bands]
    return FloorSpectra(
        np.concatenate([part.frequencies_hz for part in parts]),
        np.concatenate([each.widths_hz for each in parts]),
        np.concatenate([each.density for each in parts]),
        count / sample_rate,
        source,
        _bursts(acceleration, sample_rate),
        acceleration * signal.windows.tukey(count, fade),
        sample_rate,
        drift,
    )


def _without_drift(rows: np.ndarray, sample_rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows without mean and drift, and the drift's largest slope a second.

    It is a polynomial no faster than `DRIFT_HZ`, of a short record a straight line, that makes `DRIFTS` of how the means of
    `PARTS` scatter.
    """
    count = rows.shape[1]
    rows = rows - rows.mean(axis=1, keepdims=True)
    order = int(np.clip(2 * count / sample_rate * DRIFT_HZ, 1, PARTS // 3))
    means = np.stack([part.mean(axis=1) for part in np.array_split(rows, 10 * PARTS, axis=1)])
    place = (np.arange(len(means)) + 0.5) * 2 / len(means) - 1
    curves = legendre.legfit(place, means, order)
    coarse = [each.reshape(PARTS, 10, -1).mean(axis=1) for each in (means, legendre.legval(place, curves).T)]
    found = np.sum(coarse[1] ** 2, axis=0) > DRIFTS * np.sum(coarse[0] ** 2, axis=0)
    curves = np.where(found, curves, 0.0)
    slopes = legendre.legval(np.linspace(-1, 1, 10 * PARTS), legendre.legder(curves))
    steepest = np.take_along_axis(slopes, np.abs(slopes).argmax(axis=1)[:, None], axis=1)[:, 0]
    return rows - legendre.legval(np.linspace(-1, 1, count), curves), steepest * 2 * sample_rate / count


def _cross_lines(acceleration, sample_rate, length):
    """Frequencies above zero and the cross-spectral densities of a_i with conj(a_j) there."""
    f, density = signal.csd(
        acceleration[:, None], acceleration[None], sample_rate, nperseg=length, detrend="constant"
    )
    return f[1:-1], np.conj(np.moveaxis(density, -1, 0))[1:-1]


def _bursts(acceleration, sample_rate) -> tuple[float, float]:
    window = round(BURST_S * sample_rate)
    pieces = acceleration[:, : acceleration.shape[1] // window * window].reshape(
        len(acceleration), -1, window
    )
    power = pieces.var(axis=2).mean(axis=0)
    mean = power.mean()
    return float(np.mean(power**2) / mean**2), float(np.mean(power**3) / mean**3)


@checked
def binned(
    f: Float64[np.ndarray, " lines"],
    density: Complex128[np.ndarray, "lines sensors sensors"],
    duration: Positive,
    source: str,
    bursts: tuple[float, float] = (1.0, 1.0),
) -> FloorSpectra:
    """Even lines from one step on, averaged over bands of one per cent."""
    step = f[1] - f[0]
    edges = [0]
    while edges[-1] < len(f):
        edges.append(edges[-1] + max(1, round(0.01 * f[edges[-1]] / step)))
    edges[-1] = len(f)
    counts = np.diff(edges)
    mean = np.add.reduceat(density, edges[:-1]) / counts[:, None, None]
    centres = np.add.reduceat(f, edges[:-1]) / counts
    return FloorSpectra(centres, counts * step, mean.astype(complex), duration, source, bursts)


@checked
def choose_beta(loop: FeedforwardLoop, floor: FloorSpectra) -> float:
    """The beta with which beta H leaves the power of the shaped floor unchanged."""
    f = floor.frequencies_hz
    own = np.einsum("faa->f", floor.density).real * floor.widths_hz
    sections = np.vstack([loop.noise_shaping, loop.highpass])
    shaped = own * np.abs(signal.freqz_sos(sections, f, fs=loop.rate)[1]) ** 2
    through = np.abs(signal.freqz_sos(replace(loop, beta=1.0).integrator, f, fs=loop.rate)[1]) ** 2
    return float(np.sqrt(shaped.sum() / (shaped * through).sum()))


@by_value
@dataclass(frozen=True)
class IsolationDesign:
    """A loop on one isolator and floor: its adaptation, whether it converges, and its fixed point."""

    loop: FeedforwardLoop
    isolator: Isolator
    paths: "MovingPaths"
    steady: Steady
    step: float  # 1 - lambda of FeRLS, mu of FeLMS
    moves: "MovingWeights | None"  # about those of `steady`; none with a given step
    settings: FeLms | FeRls
    time_constant: float  # s, of the adaptation: of FeLMS that of its fastest direction
    variance: float  # share by which weights that move raise the remaining motion's power, expected
    certificate: Certificate
    motion: float  # mean square of the remaining acceleration of all axes with it, (m/s^2)^2
    mismatch: Mismatch
    # G: the weights are kept while |G psi| is above its level, 1 at `CREST` times the rms of the floor they are designed for
    guard: Float64[np.ndarray, "regressors regressors"]
    growth: float  # to where a floor that stays louder may raise the level: slow motion as large as the mismatch allows

    def __post_init__(self):
        check_fields(self)


@checked
def try_loop(
    loop: FeedforwardLoop,
    isolator: Isolator,
    paths_of: Paths,
    floor: FloorSpectra,
    algorithm: Annotated[str, one_of(ALGORITHMS)],
    variance: Positive,
    mismatch: Mismatch,
    step: Positive | None = None,
    shortest: NonNegative = 0.0,
) -> IsolationDesign:
    """A loop with the fastest adaptation that keeps the `variance` and tolerates the floor's slow motion, or with `step`.

    Its time constant is `shortest` (s) or more.
    """
    f, widths = floor.frequencies_hz, floor.widths_hz
    moving = moving_paths(loop, paths_of, f)
    responses = moving.seen
    noises = isolator.floor_noise, isolator.platform_noise
    steady = mean_adaptation(responses, widths, floor.density, *noises, 0.0)
    power = float(np.trace(steady.correlation))
    # Of FeLMS the fastest direction sees the largest share of the regressors' power a step.
    share = 1.0 if algorithm == "FeRls" else float(np.linalg.eigvalsh(steady.correlation)[-1]) / power
    slow, surge = slow_level(responses, floor, noises[0], steady)
    if floor.drift is not None:
        slow = float(np.hypot(slow, np.linalg.norm(over_the_band(steady) @ by_drift(loop, floor.drift))))
    level = CREST * slow
    inside = (f >= LOWEST_HZ) & (f <= loop.shaping.lowpass_hz)
    left = motion_density(moving, steady.weights, floor, noises)
    motion = float((left * widths)[:, inside].sum())
    moves = None
    if step is None:
        moves = moving_weights(responses, steady, floor, noises, loop.rate, algorithm, surge)
        added = _added_motion(responses, moves, widths * inside, share * loop.rate)
        slowest = max(shortest, PERIODS * len(steady.correlation) / loop.shaping.highpass_hz)
        while slowest < BEYOND_S and not (
            added(slowest) <= variance * motion and mismatch.loop_gain(level, slowest) <= LIMIT
        ):
            slowest *= FASTER
        step = 1 / (slowest * share * loop.rate)
    time_constant = 1 / (step * share * loop.rate)
    loop = replace(loop, smoothing=time_constant / SMOOTHING)
    if algorithm == "FeRls":
        covariance = step * np.linalg.inv(steady.correlation)
        settings: FeLms | FeRls = FeRls(
            (covariance + covariance.T) / 2, forgetting=1 - step, path_delay=loop.path_delay
        )
    else:
        settings = FeLms(step * (1 + EVEN), EVEN * power, path_delay=loop.path_delay)
    more = 0.0 if moves is None else added(time_constant)
    certified = LIMIT / max(mismatch.loop_gain(1.0, time_constant), LIMIT / (GROWTH * level))
    guarded = min(level, certified)
    return IsolationDesign(
        loop=loop,
        isolator=isolator,
        paths=moving,
        steady=steady,
        step=float(step),
        moves=moves,
        settings=settings,
        time_constant=float(time_constant),
        variance=float(more / motion),
        certificate=_certify(
            loop, responses, paths_of, steady, algorithm, mismatch.loop_gain(level, time_constant)
        ),
        motion=float(motion + more),
        mismatch=mismatch,
        guard=np.linalg.cholesky(np.linalg.inv(steady.correlation)).T / guarded,
        growth=float(certified / guarded),
    )


@by_value
@dataclass(frozen=True)
class MovingWeights:
    """What weights that move about their fixed point add, for one unit of step."""

    covariance: Float64[np.ndarray, "modes modes"]  # of the weights as they wander
    regressors: Complex128[np.ndarray, "frequencies regressors regressors"]  # their density
    force: Complex128[np.ndarray, "frequencies axes axes"]  # see `jitter_density`
    surge: float  # of the power of slow motion, see `slow_level`

    def __post_init__(self):
        check_fields(self)

    @property
    def products(self) -> np.ndarray:
        """The covariance by axis and regressor, twice."""
        shape = self.force.shape[1], self.regressors.shape[1]
        return self.covariance.reshape(*shape, *shape)

    def jitter(self, paths: Responses, smoothing: float) -> np.ndarray:
        """Density of the motion by weights that move within the band, for one unit of step squared, (axes, frequencies)."""
        f, through = paths.frequencies_hz, paths.secondary
        each = np.einsum("fab,fbc,fac->af", through, self.force, np.conj(through), optimize=True).real
        return each / (f**2 * (1 + (2 * np.pi * f * smoothing) ** 2))

    def wandering(self, paths: Responses) -> np.ndarray:
        """Density of the motion by weights that wander, (axes, frequencies)."""
        driven = np.einsum("bicj,fij->fbc", self.products, self.regressors, optimize=True)
        return np.einsum(
            "fab,fbc,fac->af", paths.secondary, driven, np.conj(paths.secondary), optimize=True
        ).real


def moving_weights(
    paths: Responses, steady: Steady, floor: FloorSpectra, noises, rate: float, algorithm: str, surge: float
) -> MovingWeights:
    seen = floor.density + noises[0] ** 2 * np.eye(floor.density.shape[1])
    return MovingWeights(
        floor.bursts[0] * scatter(paths, steady, floor.widths_hz, floor.density, *noises, rate, algorithm),
        paths.regressors @ seen @ np.conj(paths.regressors.transpose(0, 2, 1)),
        floor.bursts[1] * jitter_density(paths, steady, floor, noises, rate, algorithm),
        surge,
    )


def _added_motion(
    paths: Responses, moves: MovingWeights, counted: np.ndarray, rate: float
) -> Callable[[float], float]:
    """Power that moving weights add, by the time constant, where slow motion is as strong as it may become.

    Per step as the weights wander from the fixed point; per step squared as they move within the band, where they carry
    the regressors' slow power into it and resonances that the filtered error does not show are struck.
    """
    slow, fast = np.sum(moves.wandering(paths) @ counted), moves.jitter(paths, 0.0).sum(axis=0) * counted

    def added(time_constant):
        step, smooth = (
            1 / (time_constant * rate),
            1 + (2 * np.pi * paths.frequencies_hz * time_constant / SMOOTHING) ** 2,
        )
        return float(slow * step + moves.surge * np.sum(fast / smooth) * step**2)

    return added


@checked
def adapt_slower(
    design: IsolationDesign,
    around: list[IsolationDesign],
    floor: FloorSpectra,
    variance: Positive,
    time_constant: Positive,
    correction: Callable | None = None,
) -> tuple[IsolationDesign, list[IsolationDesign]]:
    """The same loop with a time constant (s) that is no shorter; a certified one stays certified."""
    rate, algorithm = design.loop.rate, type(design.settings).__name__

    def again(each: IsolationDesign, **more) -> IsolationDesign:
        paths = paths_through(each.isolator, rate, correction)
        return try_loop(
            design.loop, each.isolator, paths, floor, algorithm, variance, design.mismatch, **more
        )

    slower = again(design, shortest=time_constant)
    return slower, [again(each, step=slower.step) for each in around]


@checked
def settling_time(design: IsolationDesign, floor: FloorSpectra) -> float:
    """Time (s) in which the mean of the weights goes from zero to where the remaining motion has `WITHIN` times its power.

    Infinite where it takes a thousand time constants or more.
    """
    steady, rate = design.steady, design.step * design.loop.rate
    recursive = isinstance(design.settings, FeRls)
    moves = steady.rls_update if recursive else steady.update / np.trace(steady.correlation)
    noises = design.isolator.floor_noise, design.isolator.platform_noise
    inside = (floor.frequencies_hz >= LOWEST_HZ) & (floor.frequencies_hz <= design.loop.shaping.lowpass_hz)

    def more(time: float) -> float:
        left = (linalg.expm(-moves * rate * time) @ steady.weights.ravel()).reshape(steady.weights.shape)
        power = motion_density(design.paths, steady.weights - left, floor, noises)
        return float((power * floor.widths_hz)[:, inside].sum()) - WITHIN * design.motion

    longest = 1e3 * design.time_constant
    if more(0.0) <= 0:
        return 0.0
    if more(longest) > 0:
        return np.inf
    return float(optimize.brentq(more, 0.0, longest, rtol=1e-3)) + design.loop.smoothing


def jitter_density(
    paths: Responses,
    steady: Steady,
    floor: FloorSpectra,
    noises: tuple[float, float],
    rate: float,
    algorithm: str,
) -> Complex128[np.ndarray, "frequencies axes axes"]:
    """Density of the force by weights that move within the band, times f^2 and per step squared.

    So fast they only sum up e psi_N'. Of Gaussian signals its correlation over a lag is made of those of e and of psi_N, each with
    itself and with the other.
    """
    f, shaped = paths.frequencies_hz, paths.shaping[:, None, None] * paths.regressors
    seen = floor.density + noises[0] ** 2 * np.eye(floor.density.shape[1])
    plain = paths.regressors
    power = np.einsum("f,fis,fst,fjt->ij", floor.widths_hz, plain, seen, np.conj(plain), optimize=True).real
    root = linalg.cholesky(power, lower=True) / np.trace(steady.correlation)
    if algorithm == "FeRls":
        root = linalg.solve(steady.correlation, root * np.trace(steady.correlation))
    lags = 2 * round(rate / 2 / EVEN_HZ)
    even = np.fft.rfftfreq(lags, 1 / rate)

    def correlated(density: np.ndarray) -> np.ndarray:
        rows = [np.interp(even, f, each, right=0.0) for each in density.reshape(len(f), -1).T]
        return np.fft.irfft(rows, lags).T.reshape(lags, *density.shape[1:]) * rate / 2

    own, mixed = error_spectra(paths, steady.weights, floor.density, *noises)
    together = correlated(mixed @ root)
    turned = np.roll(together[::-1], 1, axis=0)
    alone = correlated(np.einsum("fis,fst,fit->f", root.T @ shaped, seen, np.conj(root.T @ shaped)))
    whole = correlated(own) * alone[:, None, None] + np.einsum("tak,tbk->tab", together, turned)
    density = np.fft.rfft(whole, axis=0).reshape(len(even), -1).T
    rows = np.array([np.interp(f, even, each) for each in density])
    return 2 * rate / (2 * np.pi) ** 2 * rows.T.reshape(len(f), *own.shape[1:])


@by_value
@dataclass(frozen=True)
class MovingPaths:
    """What the platform truly does, beside what its sampled sensors show."""

    seen: Responses
    primary: Complex128[np.ndarray, "frequencies axes sensors"]  # without the skyhook
    held: Complex128[
        np.ndarray, "frequencies axes axes"
    ]  # likewise, from a held command, between samples, too
    skyhook: Complex128[np.ndarray, " frequencies"]

    def __post_init__(self):
        check_fields(self)

    def transmissibility(self, weights: np.ndarray) -> Complex128[np.ndarray, "frequencies axes sensors"]:
        """From the floor to the platform, with frozen weights."""
        return self.primary + self.held @ self.commands(weights)[0]

    def noises(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From the noise of floor and platform sensors to the platform."""
        _, floor, platform = self.commands(weights)
        return self.held @ floor, self.held @ platform

    def commands(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """From the floor, the noise of its sensors and that of the platform's to the command, with frozen weights."""
        alone = weights @ self.seen.regressors - self._damped(self.seen.feedforward(weights))
        return alone - self._damped(self.seen.primary), alone, -self._damped(self.seen.sensitivity)

    def _damped(self, seen):
        return self.skyhook[:, None, None] * seen


def moving_paths(loop: FeedforwardLoop, paths_of: Paths, f: np.ndarray) -> MovingPaths:
    primary, held, sampled = paths_of(f)
    responses = loop.responses(primary, sampled, f)
    return MovingPaths(responses, primary, held, signal.freqz_sos(loop.skyhook, f, fs=loop.rate)[1])


@checked
def paths_through(isolator: Isolator, rate: Positive, correction: Callable | None = None) -> Paths:
    """The paths of an isolator over frequencies in Hz, with what was measured beyond its model; see `design_isolation`."""

    def paths(f):
        primary, held, sampled = isolator.paths(f, 1 / rate)
        more = np.zeros(1)
        if correction is not None:
            more = require_array("what correction returns", correction(f), dtype=complex)
        return primary, held + more, sampled + more

    return paths


@checked
def motion_density(
    paths: MovingPaths, weights: np.ndarray, floor: FloorSpectra, noises: tuple[float, float]
) -> Float64[np.ndarray, "axes frequencies"]:
    """Density of the platform's true acceleration with frozen weights, (m/s^2)^2/Hz."""
    return density_through(floor, noises, paths.transmissibility(weights), *paths.noises(weights))


def density_through(floor: FloorSpectra, noises: tuple[float, float], whole, *sensor_paths) -> np.ndarray:
    """Spectrum due to the floor through `whole` and to the noise of both kinds of sensors through `sensor_paths`."""
    own = np.einsum("fas,fst,fat->af", whole, floor.density, np.conj(whole), optimize=True).real
    return own + sum(
        level**2 * np.sum(np.abs(each) ** 2, axis=2).T
        for level, each in zip(noises, sensor_paths, strict=True)
    )


def _certify(
    loop: FeedforwardLoop, responses: Responses, paths_of: Paths, steady: Steady, algorithm: str, slow: float
) -> Certificate:
    """Whether an adaptation may be switched on, from the loop's responses on the floor's frequencies and on a fine grid."""
    f = responses.frequencies_hz
    band = (f >= loop.shaping.highpass_hz) & (f <= loop.shaping.lowpass_hz)
    angles = path_angle(responses.path_error[band])
    worst = int(np.argmax(angles))
    peak = 20 * np.log10(np.linalg.norm(responses.sensitivity, 2, axis=(1, 2)).max())
    values = steady.rls_eigenvalues if algorithm == "FeRls" else steady.lms_eigenvalues
    slowest = float(values.real.min())
    fine = np.geomspace(1e-2, 0.499 * loop.rate, 3000)
    damping = signal.freqz_sos(loop.skyhook, fine, fs=loop.rate)[1]
    turns = encirclements(loop.cleared(paths_of(fine)[2], fine) * damping[:, None, None])
    problems = []
    if angles[worst] > HIGHEST_PHASE:
        problems.append(
            f"the path estimate is off by more than 90 degrees at {f[band][worst]:.3g} Hz: the adaptation would climb there; "
            "identify the path again, or narrow the band"
        )
    if turns:
        problems.append("the skyhook loop is unstable; lower its gain or the delay")
    elif peak > HIGHEST_SENSITIVITY_DB:
        problems.append(f"the skyhook loop peaks at {peak:.2g} dB; lower its gain or the delay")
    if slowest <= (SLOWEST if algorithm == "FeRls" else 0.0):
        problems.append(
            f"the mean of the weights does not converge: its update has an eigenvalue of {slowest:.2g}"
        )
    if slow > LIMIT * (1 + 1e-9):
        problems.append(
            f"the floor's slow motion is {slow / LIMIT:.3g} times what this adaptation tolerates; adapt more slowly, or know the path better"
        )
    return Certificate(
        float(angles[worst]), float(f[band][worst]), float(peak), slowest, float(slow), tuple(problems)
    )


def perturbed(isolator: Isolator, spread: float, draw: Callable[[int], np.ndarray]) -> Isolator:
    """An isolator of the box: every mode's mass, stiffness and damping and the actuators' pole, each by itself.

    `draw` gives as many numbers, from -1 to 1.
    """
    omega, shapes = isolator.modes
    back = np.linalg.inv(shapes)
    n = len(omega)
    mass, stiffness, damping, pole = (
        1 + share * spread * draw(size) for share, size in zip(SPREADS.values(), (n, n, n, 1), strict=True)
    )
    damped = np.diag(shapes.T @ isolator.damping @ shapes)
    matrices = [
        back.T @ np.diag(each) @ back
        for each in (mass, omega**2 * stiffness, np.maximum(damped, 0) * damping)
    ]
    return replace(
        isolator,
        **{
            name: (each + each.T) / 2
            for name, each in zip(("mass", "stiffness", "damping"), matrices, strict=True)
        },
        actuator_pole=float(isolator.actuator_pole * pole[0]),
    )


def at_end(isolator: Isolator, spread: float, signs: Sequence[float]) -> Isolator:
    """The isolator at an end of its box: a sign for each mode's mass, each one's stiffness and damping, and for the pole."""
    left = iter(signs)
    return perturbed(isolator, spread, lambda count: np.array([next(left) for _ in range(count)]))


def alike_ends(axes: int) -> list[list[float]]:
    """The signs of the `ENDS` at which all modes are off alike."""
    each = axes, axes, axes, 1
    return [np.repeat(signs, each).tolist() for signs in product((-1.0, 1.0), repeat=len(each))]


def _box(isolator: Isolator, spread: float, rng: np.random.Generator) -> list[Isolator]:
    """`DRAWS` isolators somewhere in the box, then those at its `ENDS`."""
    inside = [perturbed(isolator, spread, lambda count: rng.uniform(-1, 1, count)) for _ in range(DRAWS)]
    return inside + [at_end(isolator, spread, signs) for signs in alike_ends(isolator.axes)]


def _choose_band(loop: FeedforwardLoop, paths_of: Paths, frequencies_hz: np.ndarray) -> tuple[float, float]:
    """From below the lowest mode to where the path's phase is no longer reliable, or beyond the highest mode."""
    low = LOW_SHARE * float(frequencies_hz[0])
    high = min(HIGH_SHARE * float(frequencies_hz[-1]), loop.rate / 8)
    f = np.geomspace(low, high, 300)
    wide = replace(loop, shaping=replace(loop.shaping, highpass_hz=low, lowpass_hz=high))
    primary, _, sampled = paths_of(f)
    angles = path_angle(wide.responses(primary, sampled, f).path_error)
    over = np.flatnonzero((angles > TRUSTED_PHASE) & (f > 1.5 * frequencies_hz[-1]))
    return low, float(f[over[0]] if len(over) else high)


@checked
def design_isolation(
    isolator: Isolator,
    floor: FloorSpectra,
    rate: Positive,
    *,
    estimate: Isolator | None = None,
    correction: Callable | None = None,
    band_hz: tuple[float, float] = (0.0, 0.0),
    notches: tuple[FrequencyNotch, ...] = (),
    algorithm: Annotated[str, one_of(ALGORITHMS)] = "FeRls",
    variance: Annotated[float, within(above=0.0, at_most=1.0)] = 0.1,
    spread: Annotated[float, within(at_least=0.0, below=0.2)] = 0.05,
    seed: Natural = 0,
) -> tuple[IsolationDesign, list[IsolationDesign]]:
    """Choose skyhook gain, integrator cut-off, beta and adaptation, certified on the isolator and over its box.

    Parameters
    ----------
    isolator : Isolator
        The isolator as known.
    floor : FloorSpectra
        Floor on which the weights are learnt.
    rate : float
        Samples per second.
    estimate : Isolator, optional
        The isolator assumed by the filters; by default the same.
    correction : callable, optional
        From frequencies in Hz to the measured P2 less that of the isolator.
    band_hz : tuple of float
        Band of the filtered error, Hz; (0, 0): chosen.
    notches : tuple of FrequencyNotch
        In it.
    algorithm : str
        ``FeRls`` or ``FeLms``.
    variance : float
        Share by which the scatter of the weights may raise the power of the remaining motion.
    spread : float
        Relative uncertainty of the isolator, see `SPREADS`.
    seed : int
        Seed of the draws from the box.

    Returns
    -------
    IsolationDesign
    list of IsolationDesign
        The same loop on isolators of the box: `DRAWS` somewhere in it, then `ENDS`.

    Raises
    ------
    InputError
        When no loop that was tried may be switched on; the message states why.
    """
    estimate = isolator if estimate is None else estimate
    own = paths_through(isolator, rate, correction)
    first = _first_loop(isolator, estimate, own, floor, rate, band_hz, notches)
    box = _box(isolator, spread, np.random.default_rng(seed))
    paths = [paths_through(each, rate, correction) for each in box]
    tried = [
        try_loop(loop, isolator, own, floor, algorithm, variance, mismatch)
        for loop, mismatch in _candidates(first, floor, [own, *paths])
    ]
    if not tried:
        raise InputError(
            f"band_hz begins at {first.shaping.highpass_hz:.3g} Hz, below twice every cut-off tried; begin at 1 Hz or above"
        )
    # What speaks against the loop without a skyhook no smaller gain cures.
    mildest = min(tried, key=lambda each: (each.loop.gain, len(each.certificate.problems)))
    against = "not to be switched on: " + "; ".join(mildest.certificate.problems)
    failed = []
    for design in _in_order(tried, against):
        around = []
        for each, path in zip(box, paths, strict=True):
            around.append(
                try_loop(design.loop, each, path, floor, algorithm, variance, design.mismatch, design.step)
            )
            if problems := around[-1].certificate.problems:
                failed.append((design.loop.gain, problems))
                break
        else:
            return design, around
    if mildest.certificate.problems:
        raise InputError(against)
    reasons = "; ".join(min(failed)[1])
    raise InputError(f"not to be switched on: somewhere within {100 * spread:g} % of this isolator {reasons}")


def _mean_mode(estimate: Isolator) -> tuple[float, float]:
    """Mass (kg) and frequency (rad/s) of which the skyhook's gains are multiples."""
    mass = 1 / float(np.mean(np.diag(np.linalg.inv(estimate.mass))))
    return mass, float(np.exp(np.mean(np.log(estimate.modes[0]))))


def _first_loop(
    isolator: Isolator,
    estimate: Isolator,
    own: Paths,
    floor: FloorSpectra,
    rate: float,
    band_hz,
    notches,
) -> FeedforwardLoop:
    """A loop in its band, as given or chosen, from which those that are tried are made."""
    mass, omega = _mean_mode(estimate)
    shaping = NoiseShaping(1.0, rate / 8, 3, notches)
    first = FeedforwardLoop(rate, 0.4 * mass * omega, 2.0, 1.0, shaping, estimate)
    low, high = band_hz if any(band_hz) else _choose_band(first, own, estimate.frequencies_hz)
    top = float(floor.frequencies_hz[-1])
    if not any(band_hz) and top > isolator.frequencies_hz[-1]:
        high = min(high, top)
    if high > top:
        raise InputError(
            f"{floor.source} is known up to {top:.4g} Hz, the band ends at {high:.4g} Hz, and what lies between could not be "
            "certified; measure the floor further, or end the band there"
        )
    return replace(first, shaping=replace(shaping, highpass_hz=float(low), lowpass_hz=float(high)))


def _candidates(
    first: FeedforwardLoop, floor: FloorSpectra, box: list[Paths]
) -> Iterator[tuple[FeedforwardLoop, Mismatch]]:
    """All gains, cut-offs and high-passes that are tried, each with its beta, and the mismatch over the `box`.

    The path's delay is that of the least mismatch of its first path, the nominal one.
    """
    mass, omega = _mean_mode(first.estimate)
    cutoffs = [each for each in CUTOFFS_HZ if each <= first.shaping.highpass_hz / 2]
    f = np.geomspace(first.shaping.highpass_hz / 4, 0.499 * first.rate, 1500)
    seen = [(primary, sampled) for primary, _, sampled in (each(f) for each in box)]
    for ratio in RATIOS:
        loop, least = first, np.inf
        for delay in range(int(first.estimate.delay * first.rate) + LATER):
            late = replace(first, gain=2 * ratio * mass * omega, path_delay=delay)
            off = float(np.max(path_mismatch(late.responses(*seen[0], f)) / f**2))
            if off < least:
                loop, least = late, off
        mismatch = Mismatch(f, np.max([path_mismatch(loop.responses(*each, f)) for each in seen], axis=0))
        for cutoff, highpasses in product(cutoffs, HIGHPASSES):
            each = replace(loop, cutoff_hz=cutoff, highpasses=highpasses)
            yield replace(each, beta=choose_beta(each, floor)), mismatch


def _in_order(tried: list[IsolationDesign], against: str) -> list[IsolationDesign]:
    """The designs that may be switched on and adapt in time, the least remaining motion first."""
    safe = [each for each in tried if not each.certificate.problems]
    if not safe:
        raise InputError(against)
    quick = [each for each in safe if each.time_constant <= LONGEST_S]
    if not quick:
        least = min(each.time_constant for each in safe)
        raise InputError(
            f"not to be switched on: with this floor's slow motion the adaptation needs a time constant of {least:.3g} s or "
            f"more with every high-pass of the floor sensors; above {LONGEST_S:g} s it is too slow: start the band at a higher "
            "frequency, so that higher cut-offs fit below it, know the path better (a smaller spread), or allow a larger variance"
        )
    least = ALIKE * min(each.motion for each in quick)
    return sorted(quick, key=lambda each: (max(each.motion, least), each.time_constant))
