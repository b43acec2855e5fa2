"""State-space models, their responses, and their interconnection."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg
from scipy.sparse import csgraph

from stillwork.base.bounds import NonNegative, Vector
from stillwork.base.checks import InputError, short_repr
from stillwork.base.extras import require_package
from stillwork.base.validation import by_value, check_fields, checked

# Above this condition of the eigenvectors, residues would lose more than half of the digits.
WORST_CONDITION = 1e6


@by_value
@dataclass(frozen=True)
class StateModel:
    r"""Model :math:`\dot x = Ax + Bu,\; y = Cx + Du`, or :math:`x_{k+1} = Ax_k + Bu_k` when `sample_time` > 0.

    Parameters
    ----------
    a, b, c, d : array_like
        Shapes (states, states), (states, inputs), (outputs, states) and (outputs, inputs).
    sample_time : float
        s; 0 in continuous time.

    Raises
    ------
    InputError
        When the shapes do not fit together.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapter 3.

    Examples
    --------
    >>> low_pass = lti.StateModel([[-10.0]], [[10.0]], [[1.0]], [[0.0]])
    >>> np.abs(low_pass.frequency_response([10.0])).round(3)  # at its corner, 10 rad/s
    array([[[0.707]]])
    """

    a: Float64[np.ndarray, "states states"]
    b: Float64[np.ndarray, "states inputs"]
    c: Float64[np.ndarray, "outputs states"]
    d: Float64[np.ndarray, "outputs inputs"]
    sample_time: NonNegative = 0.0  # s; 0: continuous time

    def __post_init__(self):
        check_fields(self)
        n, (outputs, inputs) = len(self.a), self.d.shape
        if self.a.shape != (n, n) or self.b.shape != (n, inputs) or self.c.shape != (outputs, n):
            shapes = ", ".join(str(getattr(self, name).shape) for name in "abcd")
            raise InputError(f"a, b, c, d have shapes {shapes}, which do not fit together")

    @property
    def poles(self) -> Complex128[np.ndarray, " states"]:
        """Eigenvalues of A, computed on a balanced matrix."""
        return _eigenvalues(self.a.tobytes(), len(self.a)).copy()

    @property
    def is_stable(self) -> bool:
        """Whether every pole lies strictly inside the stability region."""
        if self.sample_time:
            return bool(np.all(np.abs(self.poles) < 1))
        return bool(np.all(self.poles.real < 0))

    @property
    @checked
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

    @checked
    def select(self, inputs: Sequence[int], outputs: Sequence[int]) -> "StateModel":
        """Keep only these inputs and outputs.

        Parameters
        ----------
        inputs, outputs : sequence of int
            Their indices, from 0, in the desired order.

        Returns
        -------
        StateModel
            With all of the states.

        Raises
        ------
        InputError
            When a place does not exist.

        Examples
        --------
        >>> lags = lti.StateModel(np.diag([-1.0, -10.0]), np.diag([1.0, 10.0]), np.eye(2), np.zeros((2, 2)))
        >>> lags.select([1], [1]).frequency_response([10.0]).round(3)  # the faster one, at its corner
        array([[[0.5-0.5j]]])
        """
        i, o = list(inputs), list(outputs)
        if not i or not o:
            raise InputError("inputs or outputs is empty; choose one of each at least")
        return StateModel(self.a, self.b[:, i], self.c[o], self.d[np.ix_(o, i)], self.sample_time)

    @checked
    def frequency_response(self, omega: Vector) -> Complex128[np.ndarray, "outputs inputs frequencies"]:
        """Response at `omega` (rad/s): by residues, or by solving if the eigenvectors are ill-conditioned.

        Parameters
        ----------
        omega : array_like, shape (frequencies,)
            Frequencies, rad/s.

        Returns
        -------
        ndarray, shape (outputs, inputs, frequencies)
            Complex, y per u.

        Raises
        ------
        InputError
            When there is no frequency, or one of them is a pole.

        Examples
        --------
        >>> low_pass = lti.StateModel([[-10.0]], [[10.0]], [[1.0]], [[0.0]])
        >>> low_pass.frequency_response([10.0]).round(3)  # at its corner, 10 rad/s
        array([[[0.5-0.5j]]])
        """
        if not len(omega):
            raise InputError("omega is empty; give at least one frequency")
        point = np.exp(1j * omega * self.sample_time) if self.sample_time else 1j * omega
        response = np.repeat(self.d[:, :, None].astype(complex), len(omega), axis=2)
        if not len(self.a):
            return response
        poles, residues = self._residues
        if residues is not None:
            with np.errstate(all="ignore"):  # what is not finite is refused
                return response + residues @ (1 / (point[None, :] - poles[:, None]))
        scale, a, _, _ = self._decomposed
        b, c = self.b / scale[:, None], self.c * scale
        solved = np.zeros((len(omega), *b.shape), complex)
        # Each part drives only later ones: a line of delays is as many as it has samples.
        for part in self._coupled:
            shifted = point[:, None, None] * np.eye(len(part)) - a[np.ix_(part, part)]
            solved[:, part] = np.linalg.solve(shifted, b[part] + a[part] @ solved)
        return response + np.moveaxis(c @ solved, 0, -1)

    @cached_property  # a peak between grid points is computed many times
    def _coupled(self) -> list[np.ndarray]:
        """States that drive each other, as parts of the whole in an order in which a part is driven by earlier ones alone."""
        return coupled_states(self._decomposed[1])

    @property
    def _decomposed(self):
        """See `_decomposition`."""
        return _decomposition(self.a.tobytes(), len(self.a))

    @cached_property
    def _residues(self):
        """Poles, and the residue of every pole where the eigenvectors allow it."""
        scale, _, poles, vectors = self._decomposed
        if vectors is None:
            return poles, None
        right = linalg.solve(vectors, self.b / scale[:, None])
        return poles, ((self.c * scale) @ vectors)[:, None, :] * right.T[None]

    @cached_property
    def _triangular(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C in states of which each drives only earlier ones: the complex Schur form of the balanced A."""
        scale, balanced, _, _ = self._decomposed
        a, turn = linalg.schur(balanced, output="complex")
        return a, turn.conj().T @ (self.b / scale[:, None]), (self.c * scale) @ turn

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
        """The same model as `control.StateSpace`.

        Returns
        -------
        control.StateSpace
            In discrete time when `sample_time` is above 0.

        Raises
        ------
        MissingPackage
            When python-control is not installed.

        Examples
        --------
        >>> low_pass = lti.StateModel([[-10.0]], [[10.0]], [[1.0]], [[0.0]])
        >>> float(low_pass.to_control().dcgain())
        1.0
        """
        control = require_package("control")

        return control.StateSpace(self.a, self.b, self.c, self.d, self.sample_time or 0)


# Models that differ in their inputs and outputs alone, as the channels of a loop or the gains of a feedforward, have
# one A: what follows from it is kept, by its bytes. It must not be written to.


@lru_cache(maxsize=16)
def _eigenvalues(a: bytes, states: int) -> Complex128[np.ndarray, " states"]:
    if not states:
        return np.zeros(0, complex)
    matrix, unit = _matrix(a, states), 1.0
    if unit_of(matrix) != 1.0:  # LAPACK's own scaling loses the poles there
        with np.errstate(invalid="ignore"):
            matrix = linalg.matrix_balance(matrix, permute=False)[0]
        unit = unit_of(matrix)
    return linalg.eigvals(matrix / unit).astype(complex) * unit


@checked
def unit_of(matrix: Float64[np.ndarray, "rows columns"]) -> float:
    """A power of two beside the largest element, where its square would leave the range of numbers; else 1."""
    largest = np.abs(matrix).max(initial=0.0)
    return 1.0 if 1e-60 < largest < 1e60 else float(2.0 ** (np.frexp(largest)[1] - 1))


@lru_cache(maxsize=16)
def _decomposition(a: bytes, states: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Scale that balances A, the balanced A, its poles, and its eigenvectors where they are not too skew."""
    balanced, (scale, _) = linalg.matrix_balance(_matrix(a, states), permute=False, separate=True)
    unit = unit_of(balanced)
    poles, vectors = linalg.eig(balanced / unit)
    skew = np.linalg.cond(vectors) > WORST_CONDITION
    return scale, balanced, poles.astype(complex) * unit, None if skew else vectors.astype(complex)


@checked
def response_between(
    model: StateModel, omega: Float64[np.ndarray, " frequencies"]
) -> Complex128[np.ndarray, "outputs inputs frequencies"]:
    """As `frequency_response`, for few frequencies again and again: by back substitution where that would solve."""
    if not len(model.a) or model._residues[1] is not None:
        return model.frequency_response(omega)
    a, b, c = model._triangular
    point = np.exp(1j * omega * model.sample_time) if model.sample_time else 1j * omega
    apart = point - np.diag(a)[:, None]
    n, size = len(a), min(b.shape[1], len(c))
    states = np.zeros((n, size * len(omega)), complex)
    if len(c) < b.shape[1]:  # from the outputs' side, where they are fewer
        for k in range(n):
            seen = (a[:k, k] @ states[:k]).reshape(-1, len(omega)) + c[:, k, None]
            states[k] = (seen / apart[k]).ravel()
        response = (b.T @ states).reshape(-1, size, len(omega)).swapaxes(0, 1)
    else:
        for k in reversed(range(n)):
            driven = (a[k, k + 1 :] @ states[k + 1 :]).reshape(-1, len(omega)) + b[k, :, None]
            states[k] = (driven / apart[k]).ravel()
        response = (c @ states).reshape(len(c), size, len(omega))
    return response + model.d[:, :, None]


@checked
def state_scale(
    a: Float64[np.ndarray, "states states"],
    b: Float64[np.ndarray, "states inputs"],
    c: Float64[np.ndarray, "outputs states"],
) -> Float64[np.ndarray, " states"]:
    """Units of the states that balance A, B and C together, in the units that B and C are given in.

    A alone does not determine the scale of a rigid body. The balanced model is ``a * s / s[:, None]``, ``b / s[:, None]``, ``c * s``.
    """
    n, size = len(a), max(b.shape[1], len(c))
    whole = np.zeros((n + size, n + size))
    whole[:n, :n], whole[:n, n : n + b.shape[1]], whole[n : n + len(c), :n] = a, b, c
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    return scale[:n]


def _matrix(a: bytes, states: int) -> Float64[np.ndarray, "states states"]:
    return np.frombuffer(a).reshape(states, states)


@checked
def coupled_states(a: Float64[np.ndarray, "states states"]) -> list[np.ndarray]:
    """States that drive each other by A, as parts of the whole, each driven by itself and by parts before it alone."""
    count, label = csgraph.connected_components(a != 0, connection="strong")
    return [np.flatnonzero(label == part) for part in range(count)]


@checked
def constant(gain: Float64[np.ndarray, "outputs inputs"], sample_time: float = 0.0) -> StateModel:
    """A gain without states."""
    outputs, inputs = gain.shape
    if not gain.size:
        raise InputError(f"gain has shape {gain.shape}; give at least one input and one output")
    return StateModel(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0)), gain, sample_time)


@checked
def from_control(system) -> StateModel:
    """Take a `control.StateSpace`; a system with an unspecified sample time is refused.

    Parameters
    ----------
    system : control.StateSpace

    Returns
    -------
    StateModel
        The same matrices; `sample_time` 0 in continuous time.

    Raises
    ------
    InputError
        When it is not a `control.StateSpace`, or its sample time is unspecified.

    Examples
    --------
    >>> from control import ss
    >>> lti.from_control(ss(-1.0, 1.0, 1.0, 0.0)).is_stable
    True
    """
    if not all(hasattr(system, name) for name in ("A", "B", "C", "D", "dt")):
        raise InputError(f"system is {short_repr(system)}; give a control.StateSpace")
    if system.dt is None or system.dt is True:
        raise InputError("system.dt is unspecified; give 0 for continuous time or the sample time in s")
    a, b, c, d = (np.array(m, dtype=float, ndmin=2) for m in (system.A, system.B, system.C, system.D))
    return StateModel(a, b, c, d, sample_time=float(system.dt))


def _least_condition(matrix: np.ndarray) -> float:
    """Condition number of a matrix in the units that suit it best (Bauer 1963): the condition in newtons and metres means little for a loop."""
    try:
        return float(np.abs(linalg.eigvals(np.abs(np.linalg.inv(matrix)) @ np.abs(matrix))).max())
    except np.linalg.LinAlgError:
        return np.inf


@checked
def interconnect(
    models: Sequence[StateModel],
    feedback: Float64[np.ndarray, "all_inputs all_outputs"],
    inputs: Float64[np.ndarray, "all_inputs external"],
    outputs: Float64[np.ndarray, "wanted all_outputs"],
    direct: Float64[np.ndarray, "wanted external"] | None = None,
) -> StateModel:
    r"""Connect models by :math:`u = Fy + Gr`, and read :math:`z = Hy + Jr`; u and y are all inputs and outputs, stacked.

    Parameters
    ----------
    models : sequence of StateModel
    feedback : array_like, shape (all inputs, all outputs)
        F.
    inputs : array_like, shape (all inputs, external)
        G.
    outputs : array_like, shape (wanted, all outputs)
        H.
    direct : array_like, shape (wanted, external), optional
        J; zero without.

    Returns
    -------
    StateModel
        From r to z.

    Raises
    ------
    InputError
        When the sample times differ or a loop without dynamics has no unique solution.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapter 10.

    Examples
    --------
    >>> integrator = lti.StateModel([[0.0]], [[5.0]], [[1.0]], [[0.0]])
    >>> lti.interconnect([integrator], feedback=[[-1.0]], inputs=[[1.0]], outputs=[[1.0]]).poles.real
    array([-5.])
    """
    if not models:
        raise InputError("models is empty; give at least one")
    if len({model.sample_time for model in models}) != 1:
        raise InputError("models have different sample times; discretise them with the same one first")
    a, b, c, d = (_block_diagonal([getattr(model, name) for model in models]) for name in "abcd")
    if direct is None:
        direct = np.zeros((len(outputs), inputs.shape[1]))
    for name, matrix, wanted in (
        ("feedback", feedback, d.shape[::-1]),
        ("inputs", inputs, (d.shape[1], inputs.shape[1])),
        ("outputs", outputs, (len(outputs), len(d))),
        ("direct", direct, (len(outputs), inputs.shape[1])),
    ):
        if matrix.shape != wanted:
            raise InputError(
                f"{name} has shape {matrix.shape}; give {wanted[0]} x {wanted[1]} for these models"
            )
    loop = np.eye(len(d)) - d @ feedback
    if np.linalg.cond(loop) > 1e12 and _least_condition(loop) > 1e12:
        raise InputError("the loop has direct feedthrough all around with gain 1; it has no unique solution")
    c, d_in = np.linalg.solve(loop, c), np.linalg.solve(loop, d @ inputs)  # y = C x + D_in r
    return StateModel(
        a + b @ feedback @ c,
        b @ (inputs + feedback @ d_in),
        outputs @ c,
        outputs @ d_in + direct,
        models[0].sample_time,
    )


@checked
def block_matrix(
    rows: Sequence[int], columns: Sequence[int], *entries: Sequence[float | np.ndarray]
) -> Float64[np.ndarray, "rows columns"]:
    """A matrix of blocks, one of `entries` for each of `rows`; a number in it is so many times the unit matrix.

    Of the connections of `interconnect`, with the widths of what is joined.
    """
    return np.block(
        [
            [
                each if isinstance(each, np.ndarray) else each * np.eye(height, width)
                for each, width in zip(row, columns, strict=True)
            ]
            for row, height in zip(entries, rows, strict=True)
        ]
    )


def _block_diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """As `scipy.linalg.block_diag`, which takes ten times as long for blocks as small as these."""
    whole = np.zeros(np.sum([block.shape for block in blocks], axis=0))
    row = column = 0
    for block in blocks:
        rows, columns = block.shape
        whole[row : row + rows, column : column + columns] = block
        row, column = row + rows, column + columns
    return whole
