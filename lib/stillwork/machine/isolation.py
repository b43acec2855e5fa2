"""A self-tuned feedforward for an isolator: its filters, its effect, and whether its adaptation converges.

    M q'' + C (q' - q0') + K (q - q0) = f,   q0 = G p

q are positions along the actuators, p those of the floor sensors, f the forces behind the actuators' pole and a delay.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg, signal, special, stats

from stillwork.base.bounds import Count, Natural, NonNegative, Positive
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.isolation_filters import (
    NoiseShaping,
    SecondaryPath,
    inverse_secondary_shaping,
    noise_shaping,
    skyhook,
    weak_highpass,
    weak_integrator,
)
from stillwork.estimation.mean_adaptation import Responses, Steady

IMAGES = 20  # of a sampled response at multiples of the rate, on either side
# Of a step, that counts as nothing: an offset may be a million times the motion in band (chosen).
SETTLED = 1e-8
ORDER, POWERS = 3, 2  # of the weak integrator, and how often it is applied
HIGHEST = (
    0.99  # probability that another stretch as long as the record stays below what is called the highest
)
SMOOTHING = 5.0  # time constant of the adaptation over that of the smoothing (chosen)


def held_force(f: np.ndarray, pole: float, delay: float, sample_time: float) -> np.ndarray:
    """From a command to the force at frequencies in Hz: hold, delay (s) and the actuator's pole (rad/s)."""
    s = 2j * np.pi * f
    return pole / (s + pole) * np.exp(-s * (delay + sample_time / 2)) * np.sinc(f * sample_time)


def folded_force(f: np.ndarray, pole: float, delay: float, sample_time: float) -> np.ndarray:
    """What sampling folds of that force to frequencies in Hz: `held_force` at multiples of the rate beside them."""
    images = np.delete(np.arange(-IMAGES, IMAGES + 1), IMAGES)[:, None] / sample_time
    return held_force(f + images, pole, delay, sample_time).sum(axis=0)


@by_value
@dataclass(frozen=True)
class Isolator:
    """Mechanics of an isolator along its actuators, and the noise of its sensors."""

    mass: Float64[
        np.ndarray, "axes axes"
    ]  # M (axes, axes), kg: J' f on the body, q = J x; M^-1 = J M_body^-1 J'
    damping: Float64[np.ndarray, "axes axes"]  # C, N s/m
    stiffness: Float64[np.ndarray, "axes axes"]  # K, N/m
    floor: Float64[
        np.ndarray, "axes sensors"
    ]  # G (axes, sensors): motion of each axis's foot per motion of each floor sensor
    actuator_pole: Positive  # w_a, rad/s
    delay: NonNegative  # s, from sample to force, without the hold
    floor_noise: NonNegative  # m/s^2/sqrt(Hz), of each floor sensor
    platform_noise: NonNegative  # likewise, of each platform sensor

    def __post_init__(self):
        check_fields(self)
        axes = len(self.mass)
        for name in ("mass", "damping", "stiffness"):
            matrix = require_array(name, getattr(self, name), shape=(axes, axes))
            size = np.abs(matrix).max()
            if not np.allclose(matrix, matrix.T, atol=1e-6 * size):
                raise InputError(f"{name} is not symmetric; give a physical matrix")
            if np.linalg.eigvalsh(matrix)[0] <= (-1e-9 * size if name == "damping" else 0):
                raise InputError(f"{name} is not positive definite; give a physical matrix")
        require_array("floor", self.floor, shape=(axes, None))

    @property
    def axes(self) -> int:
        """Number of actuators, and of platform sensors."""
        return len(self.mass)

    @property
    def sensors(self) -> int:
        """Number of floor sensors."""
        return self.floor.shape[1]

    @cached_property
    def modes(self) -> tuple[Float64[np.ndarray, " axes"], Float64[np.ndarray, "axes axes"]]:
        """Undamped angular frequencies, rad/s, rising, and mass-normalised shapes in the columns."""
        squares, shapes = linalg.eigh(self.stiffness, self.mass)
        return np.sqrt(squares), shapes

    @property
    def frequencies_hz(self) -> Float64[np.ndarray, " axes"]:
        """Undamped frequencies, rising."""
        return self.modes[0] / (2 * np.pi)

    @checked
    def paths(
        self, frequencies_hz: Float64[np.ndarray, " frequencies"], sample_time: Positive
    ) -> tuple[
        Complex128[np.ndarray, "frequencies axes sensors"],
        Complex128[np.ndarray, "frequencies axes axes"],
        Complex128[np.ndarray, "frequencies axes axes"],
    ]:
        """P1 from the floor sensors' acceleration to the platform's, P2 from a held command, and P2 with the aliases of sampling.

        The steps of a held command shake the platform at multiples of the rate, too, which a sampler folds back to low
        frequencies, where the acceleration itself is small.
        """
        f = frequencies_hz
        s = 2j * np.pi * f[:, None, None]
        suspended = s * self.damping + self.stiffness
        whole = np.linalg.inv(s * s * self.mass + suspended)
        through = self.actuator_pole, self.delay, sample_time
        held = s * s * whole * held_force(f, *through)[:, None, None]
        folded = folded_force(f, *through)[:, None, None] * np.linalg.inv(self.mass)
        return whole @ suspended @ self.floor, held, held + folded


@by_value
@dataclass(frozen=True)
class FeedforwardLoop:
    """The filters of the loop, as sections and as responses on an isolator."""

    rate: Positive  # samples a second
    gain: NonNegative  # k_v, N s/m, of the skyhook on every axis
    cutoff_hz: Positive  # alpha, of the weak integrators and the high-passes
    beta: Positive  # 1/s: the weak integrator's normalisation
    shaping: NoiseShaping
    estimate: Isolator  # what the path is taken for
    # Of the floor sensors, one after another: slow motion and offsets are no regressors.
    highpasses: Count = 1
    path_delay: Natural = 0  # samples from a command to its filtered error
    # s: of a first-order low-pass that the weights pass on their way to the command; the error takes off what was sent
    smoothing: NonNegative = 0.0
    # Whether the platform's readings are cleared of what sampling folds of the steps of the held command; through an
    # anti-alias filter they have little of it
    clearing: bool = True

    def __post_init__(self):
        check_fields(self)
        # Below it filters lose their digits.
        require_number("cutoff_hz", self.cutoff_hz, at_least=1e-9 * self.rate)

    @property
    def sample_time(self) -> float:
        """s."""
        return 1 / self.rate

    @cached_property
    def path(self) -> SecondaryPath:
        """One axis for all of N: the mean inverse mass and the mean frequency, with the skyhook."""
        omega, _ = self.estimate.modes
        mass = float(1 / np.mean(np.diag(np.linalg.inv(self.estimate.mass))))
        mean = float(np.exp(np.mean(np.log(omega))))
        own = float(np.trace(self.estimate.damping) / self.estimate.axes) + self.gain
        return SecondaryPath(mass, max(own, 0.1 * mass * mean), mass * mean**2, self.estimate.actuator_pole)

    @property
    def smooth(self) -> float:
        """Share of their distance from the adapted weights by which those of the command follow them each sample."""
        return 1.0 if self.smoothing == 0 else float(-np.expm1(-self.sample_time / self.smoothing))

    @cached_property
    def folded(self) -> tuple[Float64[np.ndarray, "axes axes"], int]:
        """F and d: sampling folds F (u(k - d) - u(k - d - 1)) of the held command u into the readings, at low frequencies."""
        estimate = self.estimate
        above, late = folded_steps(estimate.actuator_pole * self.sample_time, estimate.delay * self.rate)
        return self.clearing * above * np.linalg.inv(estimate.mass), late

    @checked
    def cleared(
        self,
        secondary: Complex128[np.ndarray, "frequencies axes axes"],
        frequencies_hz: Float64[np.ndarray, " frequencies"],
    ) -> Complex128[np.ndarray, "frequencies axes axes"]:
        """A sampled path to the platform's readings, from which `folded` is taken off."""
        matrix, late = self.folded
        z = np.exp(-2j * np.pi * frequencies_hz / self.rate)
        return secondary - ((1 - z) * z**late)[:, None, None] * matrix

    @cached_property
    def integrator(self) -> np.ndarray:
        """Sections of beta H."""
        return weak_integrator(ORDER, 2 * np.pi * self.cutoff_hz, self.beta, self.sample_time)

    @cached_property
    def highpass(self) -> np.ndarray:
        """Sections of all high-passes."""
        return weak_highpass(ORDER, 2 * np.pi * self.cutoff_hz, self.highpasses, self.sample_time)

    @property
    def settling(self) -> float:
        """Time (s) until a step at a floor sensor has decayed to `SETTLED` of it in the regressors.

        Of the n-th power of a / (s + a), as in the last regressor.
        """
        poles = ORDER * (self.highpasses + POWERS)
        return float(special.gammainccinv(poles, SETTLED) / (2 * np.pi * self.cutoff_hz))

    @cached_property
    def noise_shaping(self) -> np.ndarray:
        """Sections of N."""
        return noise_shaping(self.shaping, self.path, self.sample_time)

    @cached_property
    def skyhook(self) -> np.ndarray:
        """Sections of the skyhook loop; the command gets minus its output."""
        return skyhook(self.gain, self.sample_time)

    @cached_property
    def error(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """N P2hat^-1 without the skyhook, after · sections of each mode · before: (axes, axes), (axes, sections, 6), (axes, axes).

        The modified error takes N of the whole command off it, which takes the skyhook's part out as the controller made it.
        """
        estimate = self.estimate
        omega, shapes = estimate.modes
        damping = np.diag(shapes.T @ estimate.damping @ shapes)
        sections = [
            inverse_secondary_shaping(
                self.shaping,
                self.path,
                self.sample_time,
                SecondaryPath(1.0, float(max(d, 0.002 * w)), float(w**2), estimate.actuator_pole),
            )
            for d, w in zip(damping, omega, strict=True)
        ]
        return np.linalg.inv(shapes), np.array(sections), np.linalg.inv(shapes.T)

    @checked
    def responses(
        self,
        primary: Complex128[np.ndarray, "frequencies axes sensors"],
        secondary: Complex128[np.ndarray, "frequencies axes axes"],
        frequencies_hz: Float64[np.ndarray, " frequencies"],
    ) -> Responses:
        """Responses of the loop for sampled paths that do not include the skyhook yet.

        Of weights that stay the modified error is N P2hat^-1 a1 + N z^-d K a1, with K the skyhook and d the path's delay, and its
        regressors are z^-d N psi.
        """
        f, sensors = frequencies_hz, primary.shape[2]
        if not ((f > 0) & (f < self.rate / 2)).all():
            raise InputError(f"frequencies_hz must lie above 0 and below {self.rate / 2:g} Hz, half the rate")
        damping, integrator, shaping, highpass = (
            signal.freqz_sos(sections, f, fs=self.rate)[1]
            for sections in (self.skyhook, self.integrator, self.noise_shaping, self.highpass)
        )
        secondary = self.cleared(secondary, f)
        sensitivity = np.linalg.inv(np.eye(secondary.shape[1]) + secondary * damping[:, None, None])
        stack = highpass[:, None] * integrator[:, None] ** np.arange(POWERS + 1)
        before, sections, after = self.error
        each = np.stack([signal.freqz_sos(rows, f, fs=self.rate)[1] for rows in sections], axis=1)
        late = shaping * np.exp(-2j * np.pi * f * self.path_delay / self.rate)
        skyhook = (late * damping)[:, None, None] * np.eye(secondary.shape[1])
        return Responses(
            frequencies_hz=f,
            primary=sensitivity @ primary,
            secondary=sensitivity @ secondary,
            sensitivity=sensitivity,
            regressors=(stack[:, :, None, None] * np.eye(sensors)).reshape(len(f), -1, sensors),
            shaping=late,
            error=(after * each[:, None, :]) @ before + skyhook,
            conditioning=np.ones(len(f), complex),
        )


@checked
def folded_steps(pole: Positive, delay: NonNegative) -> tuple[float, int]:
    """By how much a held ramp of one a sample, behind a `pole` (times a sample) and a `delay` (samples), exceeds its mean at a sample.

    Also the samples, one or more, of the delay.
    """
    late, part = divmod(delay, 1.0)
    since = (1 - part) % 1.0  # the last step
    above = 0.5 - since + 1 / pole + np.exp(-pole * since) / np.expm1(-pole)
    return float(above), max(int(late + round(part)), 1)


@by_value
@dataclass(frozen=True)
class FloorSpectra:
    """Cross-spectral densities of the floor sensors on bands of frequency, (m/s^2)^2/Hz, one-sided."""

    frequencies_hz: Float64[np.ndarray, " frequencies"]
    widths_hz: Float64[np.ndarray, " frequencies"]
    density: Complex128[np.ndarray, "frequencies sensors sensors"]
    duration: Positive  # s, of what was measured
    source: str
    # E[p^2] / E[p]^2 and E[p^3] / E[p]^3 of the power p of half a second: 1 of a floor that keeps its strength
    bursts: tuple[float, float]
    record: Float64[np.ndarray, "sensors samples"] | None = (
        None  # m/s^2, from which they were estimated; from rest to rest, without drift
    )
    record_hz: NonNegative = 0.0  # its sample rate
    drift: Float64[np.ndarray, " sensors"] | None = None  # m/s^3, of the record's sensors, at its steepest

    def __post_init__(self):
        check_fields(self)
        if not (self.frequencies_hz[:1] > 0).all() or (np.diff(self.frequencies_hz) <= 0).any():
            raise InputError("frequencies_hz does not rise from above 0; give rising frequencies")


@by_value
@dataclass(frozen=True)
class Certificate:
    """Whether the adaptation may be switched on; `problems` lists the reasons against it."""

    phase_deg: float  # largest angle of P2hat^-1 P2 in the band; 180 beyond 90 where no bound exists
    phase_hz: float
    sensitivity_db: float  # largest of the skyhook loop
    slowest: float  # smallest real part of the mean update's eigenvalues: of R^-1 A, or of A over its trace
    slow: float  # slow level of the floor times the path's mismatch over the memory; see `path_mismatch`
    problems: tuple[str, ...]


@checked
def path_angle(error: Complex128[np.ndarray, "frequencies axes axes"]) -> Float64[np.ndarray, " frequencies"]:
    """Largest angle of x' E x over all x, in degrees: for one axis the phase error; 180 if it exceeds 90."""
    found = np.full(len(error), 180.0)
    turned = np.conj(error.transpose(0, 2, 1))
    hermitian, skew = (error + turned) / 2, (error - turned) / 2j
    safe = np.linalg.eigvalsh(hermitian)[:, 0] > 0
    # x' E x = x' H x (1 + i tan) with the generalised eigenvalues of the skew part over the Hermitian one.
    root = np.linalg.inv(np.linalg.cholesky(hermitian[safe]))
    tangents = np.linalg.eigvalsh(root @ skew[safe] @ np.conj(root.transpose(0, 2, 1)))
    found[safe] = np.degrees(np.arctan(np.abs(tangents).max(axis=1)))
    return found


@checked
def encirclements(loop: Complex128[np.ndarray, "frequencies axes axes"]) -> int:
    """How often det(I + L) of a stable L turns about 0 from the first frequency to the last; 0: the loop is stable."""
    turned = np.unwrap(np.angle(np.linalg.det(np.eye(loop.shape[1]) + loop)))
    return int(np.rint((turned[-1] - turned[0]) / np.pi))


@by_value
@dataclass(frozen=True)
class Mismatch:
    """What of a command the modified error takes wrongly, largest in a box of paths: |N P2hat^-1 P2 - N z^-d|, 1/kg.

    Weights that move by chance carry slow motion into the band. The modified error knows what was sent, and takes its effect
    off but for this mismatch D, through which that motion feeds itself.
    """

    frequencies_hz: Float64[np.ndarray, " frequencies"]
    size: Float64[np.ndarray, " frequencies"]

    def __post_init__(self):
        check_fields(self)

    @checked
    def loop_gain(self, level: NonNegative, time_constant: Positive) -> float:
        """Largest gain over the frequencies w of dv = -(step R^-1 psi_N D[psi' v]) at a `level` sqrt(psi' R^-1 psi).

        It is level |D(w)| / w a time constant of the adaptation, with the weights smoothed before they act.
        """
        w = 2 * np.pi * self.frequencies_hz
        smoothed = np.hypot(1.0, w * time_constant / SMOOTHING)
        return float(level / time_constant * np.max(self.size / (w * smoothed)))


@checked
def path_mismatch(paths: Responses) -> Float64[np.ndarray, " frequencies"]:
    """`Mismatch.size` of one path."""
    off = paths.error @ paths.secondary - paths.shaping[:, None, None] * np.eye(paths.secondary.shape[2])
    return np.linalg.norm(off, 2, axis=(1, 2))


@checked
def by_drift(
    loop: FeedforwardLoop, drift: Float64[np.ndarray, " sensors"]
) -> Float64[np.ndarray, " regressors"]:
    """The regressors of a drift (m/s^3, of each sensor) once it has lasted: of 1 - (a / (s + a))^n, n s / a for slow s."""
    if loop.highpasses > 1:
        return np.zeros((POWERS + 1) * len(drift))
    slow = ORDER / (2 * np.pi * loop.cutoff_hz)
    return np.kron(slow * (slow * loop.beta) ** np.arange(POWERS + 1), drift)


@checked
def over_the_band(steady: Steady) -> Float64[np.ndarray, "regressors regressors"]:
    """What multiplies regressors so that the sum of their squares is psi' R^-1 psi, with R = E[psi_N psi_N']."""
    return np.linalg.cholesky(np.linalg.inv(steady.correlation)).T


@checked
def slow_level(
    paths: Responses, floor: FloorSpectra, sensor_noise: NonNegative, steady: Steady
) -> tuple[float, float]:
    """Rms of sqrt(psi' R^-1 psi), with R = E[psi_N psi_N']: how much larger the regressors are than within the band.

    Then how much larger its square is over another stretch of the floor's duration, at most (`HIGHEST`): of a Gaussian floor, whose
    power over T seconds has 2 T (int S df)^2 / int S^2 df degrees of freedom.
    """
    seen = floor.density + sensor_noise**2 * np.eye(floor.density.shape[1])
    psi = over_the_band(steady) @ paths.regressors
    density = np.einsum("fis,fst,fit->f", psi, seen, np.conj(psi), optimize=True).real
    power = density @ floor.widths_hz
    freedom = 2 * floor.duration * power**2 / (density**2 @ floor.widths_hz)
    return float(np.sqrt(power)), float(stats.chi2.ppf(HIGHEST, freedom) / freedom)
