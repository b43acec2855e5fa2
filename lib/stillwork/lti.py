"""Linear time-invariant models: modal and state-space form, exact discretisation, fast responses, norms."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.checks import InputError, require_array, require_choice, require_count, require_number
from stillwork.kernels import kernel

# Above this condition of the eigenvectors, residues would lose more than half of the digits.
WORST_CONDITION = 1e6


@dataclass(frozen=True)
class StateModel:
    r"""Model :math:`\dot x = Ax + Bu,\; y = Cx + Du`, or :math:`x_{k+1} = Ax_k + Bu_k` when `step` > 0."""

    a: Float64[np.ndarray, "states states"]
    b: Float64[np.ndarray, "states inputs"]
    c: Float64[np.ndarray, "outputs states"]
    d: Float64[np.ndarray, "outputs inputs"]
    step: float = 0.0  # s, sample time; 0: continuous time

    def __post_init__(self):
        for name in "abcd":
            object.__setattr__(self, name, require_array(name, getattr(self, name), ndim=2))
        n, (outputs, inputs) = len(self.a), self.d.shape
        if self.a.shape != (n, n) or self.b.shape != (n, inputs) or self.c.shape != (outputs, n):
            shapes = ", ".join(str(getattr(self, name).shape) for name in "abcd")
            raise InputError(f"a, b, c, d have shapes {shapes}, which do not fit together")
        require_number("step", self.step, at_least=0.0)

    @property
    def poles(self) -> Complex128[np.ndarray, " states"]:
        """Eigenvalues of A, computed on a balanced matrix."""
        return linalg.eigvals(self.a).astype(complex) if len(self.a) else np.zeros(0, complex)

    @property
    def is_stable(self) -> bool:
        """Whether every pole lies strictly inside the stability region."""
        if self.step:
            return bool(np.all(np.abs(self.poles) < 1))
        return bool(np.all(self.poles.real < 0))

    @property
    def zeros(self) -> Complex128[np.ndarray, " zeros"]:
        """Finite invariant zeros of a square model, from a balanced pencil."""
        if len(self.c) != self.b.shape[1]:
            raise InputError("model is not square; its zeros need as many inputs as outputs")
        rate = np.linalg.norm(linalg.matrix_balance(self.a, permute=False)[0])
        n = len(self.a)
        whole = np.block([[self.a / rate, self.b / rate], [self.c, self.d]])
        whole, _ = linalg.matrix_balance(whole, permute=False, separate=True)
        mass = np.zeros_like(whole)
        mass[:n, :n] = np.eye(n)
        values = linalg.eig(whole, mass, right=False, homogeneous_eigvals=True)
        finite = np.abs(values[1]) > 1e-10 * np.abs(values[0])
        return (rate * values[0][finite] / values[1][finite]).astype(complex)

    def select(self, inputs: Sequence[int], outputs: Sequence[int]) -> "StateModel":
        """Keep only these inputs and outputs."""
        i, o = list(inputs), list(outputs)
        return StateModel(self.a, self.b[:, i], self.c[o], self.d[np.ix_(o, i)], self.step)

    def frequency_response(self, omega: ArrayLike) -> Complex128[np.ndarray, "outputs inputs frequencies"]:
        """Response at `omega` (rad/s): by residues, or by solving where the eigenvectors are too skew."""
        omega = require_array("omega", omega, ndim=1)
        point = np.exp(1j * omega * self.step) if self.step else 1j * omega
        response = np.repeat(self.d[:, :, None].astype(complex), len(omega), axis=2)
        if not len(self.a):
            return response
        poles, residues = self._residues
        if residues is not None:
            return response + residues @ (1 / (point[None, :] - poles[:, None]))
        scale, a, _, _ = self._decomposed
        b, c = self.b / scale[:, None], self.c * scale
        shifted = point[:, None, None] * np.eye(len(a)) - a
        return response + np.moveaxis(c @ np.linalg.solve(shifted, b[None].astype(complex)), 0, -1)

    @cached_property
    def _decomposed(self):
        """Scale that balances A, the balanced A, its poles, and its eigenvectors where they are not too skew."""
        a, (scale, _) = linalg.matrix_balance(self.a, permute=False, separate=True)
        poles, vectors = linalg.eig(a)
        skew = np.linalg.cond(vectors) > WORST_CONDITION
        return scale, a, poles.astype(complex), None if skew else vectors.astype(complex)

    @cached_property
    def _residues(self):
        """Poles, and the residue of every pole where the eigenvectors allow it."""
        scale, _, poles, vectors = self._decomposed
        if vectors is None:
            return poles, None
        right = linalg.solve(vectors, self.b / scale[:, None])
        return poles, ((self.c * scale) @ vectors)[:, None, :] * right.T[None]

    @cached_property
    def _recursion(self):
        """Poles, drive and read-out of the decoupled recursion, one of each conjugate pair, real and imaginary."""
        scale, _, poles, vectors = self._decomposed
        one = poles.imag >= 0  # a pair contributes twice the real part of one of them
        twice = np.where(poles[one].imag > 0, 2.0, 1.0)
        left = linalg.inv(vectors)[one]
        parts = [
            poles[one],
            (left @ (self.b / scale[:, None])).T,
            ((self.c * scale) @ vectors[:, one]) * twice,
        ]
        return left / scale, [np.ascontiguousarray(half) for part in parts for half in (part.real, part.imag)]

    def to_control(self):
        """The same model as `control.StateSpace`."""
        import control

        return control.StateSpace(self.a, self.b, self.c, self.d, self.step or 0)


def from_control(system) -> StateModel:
    """Take a `control.StateSpace`; a system with an unspecified sample time is refused."""
    if system.dt is None or system.dt is True:
        raise InputError("system.dt is unspecified; give 0 for continuous time or the sample time in s")
    matrices = (np.array(m, dtype=float, ndmin=2) for m in (system.A, system.B, system.C, system.D))
    return StateModel(*matrices, step=float(system.dt))


def interconnect(
    models: Sequence[StateModel],
    feedback: Float64[np.ndarray, "all_inputs all_outputs"],
    inputs: Float64[np.ndarray, "all_inputs external"],
    outputs: Float64[np.ndarray, "wanted all_outputs"],
    direct: Float64[np.ndarray, "wanted external"] | None = None,
) -> StateModel:
    r"""Connect models by :math:`u = Fy + Gr`, and read :math:`z = Hy + Jr`; u and y are all of theirs, stacked.

    Raises
    ------
    InputError
        When the sample times differ or a loop without dynamics has no unique solution.
    """
    if len({model.step for model in models}) != 1:
        raise InputError("models have different sample times; discretise them with the same step first")
    a, b, c, d = (linalg.block_diag(*(getattr(model, name) for model in models)) for name in "abcd")
    loop = np.eye(len(d)) - d @ feedback
    if np.linalg.cond(loop) > 1e12:
        raise InputError("the loop has direct feedthrough all around with gain 1; it has no unique solution")
    c, d_in = np.linalg.solve(loop, c), np.linalg.solve(loop, d @ inputs)  # y = C x + D_in r
    direct = np.zeros((len(outputs), inputs.shape[1])) if direct is None else direct
    return StateModel(
        a + b @ feedback @ c,
        b @ (inputs + feedback @ d_in),
        outputs @ c,
        outputs @ d_in + direct,
        models[0].step,
    )


@dataclass(frozen=True)
class ModalModel:
    r"""Decoupled modes :math:`\ddot\eta_i + 2\zeta_i\omega_i\dot\eta_i + \omega_i^2\eta_i = \phi_{ai}^T f`.

    The output is :math:`y = \sum_i \phi_{si}\eta_i + D f`, or its velocity counterpart with
    :math:`\dot\eta_i`. A rigid-body mode has zero frequency and zero damping.
    """

    frequencies: Float64[np.ndarray, " modes"]  # omega_i, rad/s, ascending
    damping: Float64[np.ndarray, " modes"]  # zeta_i
    input_shapes: Float64[np.ndarray, "modes inputs"]  # phi_a, mass-normalised
    output_shapes: Float64[np.ndarray, "outputs modes"]  # phi_s
    feedthrough: Float64[np.ndarray, "outputs inputs"]  # compliance T_DC
    measures: str = "position"

    def __post_init__(self):
        for name in ("frequencies", "damping", "input_shapes", "output_shapes", "feedthrough"):
            object.__setattr__(self, name, require_array(name, getattr(self, name)))
        n = len(self.frequencies)
        if self.input_shapes.shape[0] != n or self.output_shapes.shape[1] != n or self.damping.shape != (n,):
            raise InputError(f"shapes and damping do not fit {n} frequencies; give one of each a mode")
        if np.any(self.frequencies < 0) or np.any(np.diff(self.frequencies) < 0):
            raise InputError("frequencies must be ascending and not negative, in rad/s")
        if np.any(self.damping < 0) or np.any(self.damping >= 1):
            raise InputError("damping must be at least 0 and below 1 (ratio to critical)")
        if np.any(self.damping[self.frequencies == 0] != 0):
            raise InputError("damping of a mode of zero frequency must be 0: its ratio has no meaning")
        require_choice("measures", self.measures, ("position", "velocity"))

    @property
    def rigid_modes(self) -> int:
        """Number of modes of zero frequency."""
        return int(np.count_nonzero(self.frequencies == 0))

    @property
    def poles(self) -> Complex128[np.ndarray, " poles"]:
        """Both poles of every mode."""
        w, z = self.frequencies, self.damping
        upper = w * (-z + 1j * np.sqrt(1 - z**2))
        return np.concatenate([upper, upper.conj()])

    def modes(self, chosen: Sequence[int] | slice) -> "ModalModel":
        """Keep only these modes (and the feedthrough)."""
        return replace(
            self,
            frequencies=self.frequencies[chosen],
            damping=self.damping[chosen],
            input_shapes=self.input_shapes[chosen],
            output_shapes=self.output_shapes[:, chosen],
        )

    def at(self, inputs: Sequence[int], outputs: Sequence[int]) -> "ModalModel":
        """Keep only these inputs and outputs: actuators and sensors at other places."""
        return replace(
            self,
            input_shapes=self.input_shapes[:, list(inputs)],
            output_shapes=self.output_shapes[list(outputs)],
            feedthrough=self.feedthrough[np.ix_(list(outputs), list(inputs))],
        )

    def compliance(self) -> Float64[np.ndarray, "outputs inputs"]:
        """Static gain of the flexible modes, eq. (2.13) of the observer thesis (m/N)."""
        flexible = self.frequencies > 0
        gains = self.input_shapes[flexible] / self.frequencies[flexible, None] ** 2
        return self.output_shapes[:, flexible] @ gains

    def frequency_response(self, omega: ArrayLike) -> Complex128[np.ndarray, "outputs inputs frequencies"]:
        """Response at `omega` (rad/s) from the closed-form residues of each mode."""
        omega = require_array("omega", omega, ndim=1)
        if self.rigid_modes and np.any(omega == 0):
            raise InputError("omega holds 0, where a rigid-body mode has no finite response; leave it out")
        w, z = self.frequencies[:, None], self.damping[:, None]
        modal = 1 / ((w - omega) * (w + omega) + 2j * z * w * omega)
        if self.measures == "velocity":
            modal = modal * (1j * omega)
        residues = self.output_shapes[:, None, :] * self.input_shapes.T[None]
        return residues @ modal + self.feedthrough[:, :, None]

    def state_space(self, form: int = 1) -> StateModel:
        """State-space model of form 1 (states grouped by mode, (2.9)) or 2 (positions, then velocities, (2.6))."""
        require_choice("form", str(form), ("1", "2"))
        n = len(self.frequencies)
        a, b = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, self.input_shapes.shape[1]))
        c = np.zeros((len(self.output_shapes), 2 * n))
        position, velocity = _places(n, form)
        a[position, velocity] = 1
        a[velocity, position] = -(self.frequencies**2)
        a[velocity, velocity] = -2 * self.damping * self.frequencies
        b[velocity] = self.input_shapes
        c[:, position if self.measures == "position" else velocity] = self.output_shapes
        return StateModel(a, b, c, self.feedthrough)

    def to_control(self):
        """The same model as `control.StateSpace`, in form 1."""
        return self.state_space().to_control()


def _places(modes: int, form: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the modal positions and of the modal velocities in the state."""
    if form == 1:
        return np.arange(0, 2 * modes, 2), np.arange(1, 2 * modes, 2)
    return np.arange(modes), np.arange(modes, 2 * modes)


def from_state_space(model: StateModel, form: int = 1) -> ModalModel:
    """Read the modal parameters back from a state-space model of form 1 or 2.

    Raises
    ------
    InputError
        When the matrices do not have the structure of that form.
    """
    require_choice("form", str(form), ("1", "2"))
    position, velocity = _places(len(model.a) // 2, form)
    if len(model.a) % 2:
        raise InputError(f"model has {len(model.a)} states; a modal form has two a mode")
    w = np.sqrt(np.abs(model.a[velocity, position]))
    rate = -model.a[velocity, velocity]
    measures = "velocity" if np.any(model.c[:, velocity]) else "position"
    read = ModalModel(
        w,
        np.divide(rate, 2 * w, out=np.zeros_like(w), where=w > 0),
        model.b[velocity],
        model.c[:, velocity if measures == "velocity" else position],
        model.d,
        measures,
    )
    built = read.state_space(form)
    for name in "abc":
        if not np.allclose(getattr(built, name), getattr(model, name), rtol=1e-12, atol=0):
            raise InputError(
                f"{name} does not have the structure of modal form {form}; use modal_model on M and K"
            )
    return read


def modal_model(
    mass: ArrayLike,
    stiffness: ArrayLike,
    input_map: ArrayLike,
    output_map: ArrayLike,
    damping_ratio: float | ArrayLike = 0.0,
    damping_matrix: ArrayLike | None = None,
) -> ModalModel:
    r"""Modal model of :math:`M\ddot q + D\dot q + Kq = S_a f,\; y = S_s q`, (2.1)-(2.5) of the observer thesis.

    Parameters
    ----------
    mass, stiffness : array_like, shape (nodes, nodes)
        Symmetric, kg and N/m; the mass matrix positive definite.
    input_map : array_like, shape (nodes, inputs)
    output_map : array_like, shape (outputs, nodes)
    damping_ratio : float or array_like, shape (modes,)
        Modal damping of the flexible modes; used when there is no `damping_matrix`.
    damping_matrix : array_like, shape (nodes, nodes), optional
        Damping that the mode shapes decouple (proportional damping), N s/m.

    Raises
    ------
    InputError
        When M or K is not symmetric or not (semi)definite, or the damping does not decouple.
    """
    mass = require_array("mass", mass, ndim=2)
    n = len(mass)
    stiffness = require_array("stiffness", stiffness, shape=(n, n))
    for name, matrix in (("mass", mass), ("stiffness", stiffness)):
        if matrix.shape != (n, n) or not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0):
            raise InputError(f"{name} is not symmetric; give a symmetric {n} x {n} matrix")
    try:
        squares, shapes = linalg.eigh(stiffness, mass)
    except linalg.LinAlgError:
        raise InputError("mass is not positive definite; every degree of freedom needs mass") from None
    # A rigid-body mode comes out at rounding level; 1e-10 of the largest is far above that and far below a mode.
    floor = 1e-10 * max(squares[-1], 0)
    if squares[0] < -floor:
        raise InputError("stiffness has a negative eigenvalue; a structure needs a semidefinite matrix")
    w = np.sqrt(np.where(squares > floor, squares, 0))
    if damping_matrix is None:
        ratio = np.broadcast_to(require_array("damping_ratio", damping_ratio), (n,))
        ratio = np.where(w > 0, ratio, 0.0)
    else:
        modal = shapes.T @ require_array("damping_matrix", damping_matrix, shape=(n, n)) @ shapes
        rest = np.abs(modal - np.diag(np.diag(modal))).max()
        if rest > 1e-8 * np.abs(modal).max() or np.any(
            np.abs(np.diag(modal)[w == 0]) > 1e-8 * np.abs(modal).max()
        ):
            raise InputError(
                "damping_matrix does not decouple in the mode shapes; give damping_ratio instead"
            )
        ratio = np.divide(np.diag(modal), 2 * w, out=np.zeros(n), where=w > 0)
    input_map = require_array("input_map", input_map, shape=(n, None))
    output_map = require_array("output_map", output_map, shape=(None, n))
    return ModalModel(
        w, ratio, shapes.T @ input_map, output_map @ shapes, np.zeros((len(output_map), input_map.shape[1]))
    )


def zoh_modes(model: ModalModel, step: float) -> StateModel:
    """Exact zero-order-hold discretisation in closed form, mode by mode, in modal form 1.

    The transition matrix is (2.29) of the observer thesis taken to the modal states; the input matrix keeps
    the damping that (2.33) leaves out.
    """
    require_number("step", step, above=0.0)
    w, z = model.frequencies, model.damping
    s = np.sqrt(1 - z**2)
    angle, decay = w * s * step, np.exp(-z * w * step)
    ratio, cosine = z / s, np.cos(angle)
    # sin(wd T)/wd, with its limit T for a rigid body
    sinc = step * np.sinc(angle / np.pi)
    sine = np.sin(angle)
    blocks = np.empty((len(w), 2, 2))
    blocks[:, 0, 0] = decay * (cosine + ratio * sine)
    blocks[:, 0, 1] = decay * sinc
    blocks[:, 1, 0] = -decay * w**2 * sinc
    blocks[:, 1, 1] = decay * (cosine - ratio * sine)
    flexible = w > 0
    lifted = -np.expm1(-z * w * step) + decay * (2 * np.sin(angle / 2) ** 2 - ratio * sine)
    gains = np.empty((len(w), 2))
    gains[:, 0] = np.divide(lifted, w**2, out=np.full(len(w), step**2 / 2), where=flexible)
    gains[:, 1] = decay * sinc
    b = (gains[:, :, None] * model.input_shapes[:, None, :]).reshape(2 * len(w), -1)
    continuous = model.state_space()
    return StateModel(linalg.block_diag(*blocks), b, continuous.c, continuous.d, step)


def zoh(model: StateModel, step: float) -> StateModel:
    """Zero-order-hold discretisation by the exponential of the balanced [A B; 0 0]."""
    require_number("step", step, above=0.0)
    if model.step:
        raise InputError("model is in discrete time already; give the continuous model")
    n, m = model.b.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = model.a * step, model.b * step
    # Unbalanced, the exponential of a stiff motion system is silently wrong.
    balanced, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    held = linalg.expm(balanced) * scale[:, None] / scale
    return StateModel(held[:n, :n], held[:n, n:], model.c, model.d, step)


def resonance_grid(
    poles: ArrayLike, low_hz: float, high_hz: float, points: int = 600, around: int = 40
) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies (rad/s): logarithmic, and `around` more on either side of every pole, dense at its width.

    A logarithmic grid alone (`around` = 0) steps over the peaks of lightly damped modes.
    """
    require_number("low_hz", low_hz, above=0.0)
    require_number("high_hz", high_hz, above=low_hz)
    require_count("points", points, at_least=2)
    require_count("around", around, at_least=0)
    poles = np.atleast_1d(np.asarray(poles, dtype=complex))
    centre = np.unique(np.abs(poles[np.abs(poles) > 0]))
    pole = poles[np.abs(poles) > 0][np.unique(np.abs(poles[np.abs(poles) > 0]), return_index=True)[1]]
    width = np.maximum(np.abs(pole.real), 1e-7 * centre)
    reach = np.arcsinh(0.5 * centre / width)
    steps = np.linspace(-1, 1, 2 * around + 1) if around else np.zeros(0)
    offsets = width[:, None] * np.sinh(reach[:, None] * steps)
    low, high = 2 * np.pi * low_hz, 2 * np.pi * high_hz
    every = np.concatenate([np.geomspace(low, high, points), (centre[:, None] + offsets).ravel()])
    return np.unique(every[(every >= low) & (every <= high)])


class Peak(NamedTuple):
    """The largest magnitude of a frequency response."""

    magnitude: float
    omega: float  # rad/s


def refine_peak(
    response: Callable[[np.ndarray], np.ndarray], omega: np.ndarray, magnitude: np.ndarray, near: float = 0.7
) -> Peak:
    """Peak of ``abs(response(omega))`` between grid points: zoom into every local maximum that could win.

    Parameters
    ----------
    response : callable
        Returns the complex (or real) response on an array of frequencies in rad/s.
    omega, magnitude : ndarray, shape (frequencies,)
        Grid and the magnitudes on it.
    near : float
        Local maxima above this part of the largest are refined.
    """
    last = len(omega) - 1
    inner = (magnitude[1:-1] >= magnitude[:-2]) & (magnitude[1:-1] >= magnitude[2:])
    places = np.concatenate([[0], 1 + np.flatnonzero(inner), [last]])
    places = places[magnitude[places] >= near * magnitude.max()]
    low, high = omega[np.maximum(places - 1, 0)], omega[np.minimum(places + 1, last)]
    rows = np.arange(len(places))
    for _ in range(5):  # each round shrinks the bracket by 4: a thousand times in all
        grid = np.linspace(low, high, 9, axis=1)
        values = np.abs(response(grid.ravel())).reshape(grid.shape)
        best = values.argmax(axis=1)
        low, high = grid[rows, np.maximum(best - 1, 0)], grid[rows, np.minimum(best + 1, 8)]
    winner = values.max(axis=1).argmax()
    return Peak(float(values[winner].max()), float(grid[winner, best[winner]]))


def hinf_norm(model: StateModel, tolerance: float = 1e-10) -> Peak:
    """H-infinity norm of a stable continuous model, and its frequency, by the eigenvalues of a Hamiltonian.

    No frequency grid: a level is exceeded exactly when the Hamiltonian has imaginary eigenvalues there
    (Boyd and Balakrishnan; Bruinsma and Steinbuch).
    """
    if model.step or not model.is_stable:
        raise InputError("model must be stable and in continuous time for this norm")
    rate = np.abs(model.poles).max()
    a, (scale, _) = linalg.matrix_balance(model.a / rate, permute=False, separate=True)
    b, c, d = model.b / scale[:, None] / rate, model.c * scale, model.d
    size = np.sqrt(np.linalg.norm(b) / np.linalg.norm(c)) if np.any(b) and np.any(c) else 1.0
    scaled = StateModel(a, b / size, c * size, d)

    def gains(omega: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.moveaxis(scaled.frequency_response(omega), -1, 0), ord=2, axis=(1, 2))

    start = np.concatenate([[0.0], np.abs(scaled.poles), np.abs(scaled.poles.imag)])
    values = gains(start)
    level, where = max(values.max(), np.linalg.norm(d, 2)), start[values.argmax()]
    for _ in range(60):
        raised = (1 + 2 * tolerance) * level
        crossings = _crossings(scaled, raised)
        if len(crossings) < 2:
            break
        middle = (
            np.sqrt(crossings[:-1] * crossings[1:])
            if crossings[0] > 0
            else (crossings[:-1] + crossings[1:]) / 2
        )
        values = gains(middle)
        if values.max() <= raised:
            break
        level, where = values.max(), middle[values.argmax()]
    return Peak(float(level), float(where * rate))


def _crossings(model: StateModel, level: float) -> np.ndarray:
    """Frequencies where a singular value equals `level`: imaginary eigenvalues of the Hamiltonian."""
    a, b, c, d = model.a, model.b, model.c, model.d
    r = level**2 * np.eye(d.shape[1]) - d.T @ d
    feed = np.linalg.solve(r, d.T @ c)
    upper = a + b @ feed
    q = c.T @ (c + d @ feed)
    hamiltonian = np.block([[upper, b @ np.linalg.solve(r, b.T)], [-q, -upper.T]])
    values = linalg.eigvals(hamiltonian)
    imaginary = np.abs(values.real) < 1e-8 * np.maximum(np.abs(values), 1e-8)
    return np.unique(np.abs(values[imaginary].imag))


def h2_norm(model: StateModel) -> float:
    """H2 norm of a stable, strictly proper continuous model: a balanced Lyapunov equation, residual checked.

    Raises
    ------
    InputError
        When the model is unstable, has feedthrough, or the equation is too ill-conditioned to trust.
    """
    if model.step or not model.is_stable or np.any(model.d):
        raise InputError("model must be stable, strictly proper and in continuous time for this norm")
    rate = np.abs(model.poles).max()
    a, (scale, _) = linalg.matrix_balance(model.a / rate, permute=False, separate=True)
    b, c = model.b / scale[:, None] / np.sqrt(rate), model.c * scale
    gramian = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    residual = np.abs(a @ gramian + gramian @ a.T + b @ b.T).max() / np.abs(b @ b.T).max()
    if residual > 1e-6:
        raise InputError(
            f"the Lyapunov equation left a relative residual of {residual:.1e}; rescale the model"
        )
    return float(np.sqrt(np.trace(c @ gramian @ c.T)))


def simulate(
    model: StateModel, inputs: ArrayLike, initial: ArrayLike | None = None
) -> Float64[np.ndarray, "outputs samples"]:
    """Outputs of a discrete model for given inputs, from an initial state (zero by default).

    The states are decoupled once, so that a sample costs two multiplications a state instead of a product
    of matrices; a model whose eigenvectors are too skew for that is stepped as it stands.

    Parameters
    ----------
    model : StateModel
        In discrete time.
    inputs : array_like, shape (inputs, samples)
    initial : array_like, shape (states,), optional
    """
    if not model.step:
        raise InputError("model is in continuous time; discretise it with zoh first")
    inputs = require_array("inputs", inputs, shape=(model.b.shape[1], None))
    initial = np.zeros(len(model.a)) if initial is None else initial
    initial = require_array("initial", initial, shape=(len(model.a),))
    direct = model.d @ inputs
    if not len(model.a):
        return direct
    scale, a, _, vectors = model._decomposed
    if vectors is None:
        driven = np.ascontiguousarray((model.b / scale[:, None] @ inputs).T)
        return direct + _step_dense(a, driven, model.c * scale, initial / scale)
    left, parts = model._recursion
    start = left @ initial
    halves = [np.ascontiguousarray(half) for half in (start.real, start.imag)]
    return direct + _step_decoupled(*parts, *halves, np.ascontiguousarray(inputs.T))


@kernel
def _step_dense(a, driven, c, start):
    n, samples, outputs = a.shape[0], driven.shape[0], c.shape[0]
    y = np.zeros((outputs, samples))
    x, following = start.copy(), np.zeros(n)
    for k in range(samples):
        for o in range(outputs):
            total = 0.0
            for i in range(n):
                total += c[o, i] * x[i]
            y[o, k] = total
        for i in range(n):
            total = driven[k, i]
            for j in range(n):
                total += a[i, j] * x[j]
            following[i] = total
        x[:] = following
    return y


@kernel
def _step_decoupled(pole_re, pole_im, drive_re, drive_im, read_re, read_im, start_re, start_im, u):
    n, samples, inputs, outputs = pole_re.shape[0], u.shape[0], u.shape[1], read_re.shape[0]
    y = np.zeros((outputs, samples))
    re, im = start_re.copy(), start_im.copy()
    for k in range(samples):
        for o in range(outputs):
            # Four sums side by side: one alone would wait for each of its additions.
            even_re, even_im, odd_re, odd_im = 0.0, 0.0, 0.0, 0.0
            for i in range(0, n - 1, 2):
                even_re += read_re[o, i] * re[i]
                even_im += read_im[o, i] * im[i]
                odd_re += read_re[o, i + 1] * re[i + 1]
                odd_im += read_im[o, i + 1] * im[i + 1]
            if n % 2:
                even_re += read_re[o, n - 1] * re[n - 1]
                even_im += read_im[o, n - 1] * im[n - 1]
            y[o, k] = (even_re + odd_re) - (even_im + odd_im)
        for i in range(n):
            next_re = pole_re[i] * re[i] - pole_im[i] * im[i]
            im[i] = pole_re[i] * im[i] + pole_im[i] * re[i]
            re[i] = next_re
        for j in range(inputs):
            force = u[k, j]
            for i in range(n):
                re[i] += drive_re[j, i] * force
                im[i] += drive_im[j, i] * force
    return y
