"""State-space models, their responses, and their interconnection."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from operator import mul

import numpy as np
import scipy  # its `signal` is loaded where it is called: it takes half a second
from jaxtyping import Complex128, Float64
from scipy import linalg
from scipy.sparse import csgraph

from stillwork.base.bounds import NonNegative, Positive, Vector
from stillwork.base.checks import InputError, nearest
from stillwork.base.extras import require_package
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.foreign import matrices, minimal
from stillwork.lti.scaling import state_scale

# Above this condition of the eigenvectors, or where residues cancel by as much, they would lose more than half of the digits.
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
    input_labels, output_labels, state_labels : sequence of str, optional
        Names, as python-control has them.

    Raises
    ------
    InputError
        When the shapes or the numbers of names do not fit together.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapter 3.

    Notes
    -----
    ``+ - * / **``, `feedback` and ``g(s)`` are those of python-control: ``g * h`` feeds the outputs of h to g, and a model
    of one channel serves each of another's. What they give keeps names of states while these differ. Where a function of
    this library takes a model, it takes one of python-control or of `scipy.signal` as well, or a tuple of arrays.

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
    input_labels: tuple[str, ...] = ()
    output_labels: tuple[str, ...] = ()
    state_labels: tuple[str, ...] = ()

    __array_ufunc__ = None  # an array times a model is the model's to compute

    def __post_init__(self):
        check_fields(self)
        n, (outputs, inputs) = len(self.a), self.d.shape
        if self.a.shape != (n, n) or self.b.shape != (n, inputs) or self.c.shape != (outputs, n):
            shapes = ", ".join(str(getattr(self, name).shape) for name in "abcd")
            raise InputError(f"a, b, c, d have shapes {shapes}, which do not fit together")
        for kind, count in (("input", inputs), ("output", outputs), ("state", n)):
            names = getattr(self, f"{kind}_labels")
            if names and len(set(names)) != count:
                raise InputError(
                    f"{kind}_labels has {len(set(names))} different names; give {count}, or none"
                )

    @classmethod
    def converted(cls, name: str, system) -> "StateModel":
        """A system of another library as this one.

        Parameters
        ----------
        name : str
            What errors call it.
        system : StateModel or control.StateSpace or scipy.signal.lti or tuple
            As `from_control` takes it.

        Returns
        -------
        StateModel

        Raises
        ------
        InputError
            When it is no such model.

        Examples
        --------
        >>> lti.StateModel.converted("lag", ([[-1.0]], [[1.0]], [[1.0]], [[0.0]])).is_stable
        True
        """
        return system if isinstance(system, cls) else cls(**matrices(system, name))

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
        """Finite invariant zeros: where the response loses rank (for a square model, where its inverse has poles).

        By the reduction to a square pencil of Emami-Naeini and Van Dooren, Automatica 18 (1982).
        """
        scale = state_scale(self.a, self.b, self.c)
        a, b, c = self.a * scale / scale[:, None], self.b / scale[:, None], self.c * scale
        rate = np.linalg.norm(a) or 1.0
        sizes = [np.linalg.norm(each) or 1.0 for each in (b, c)]
        system = a / rate, b / sizes[0], c / sizes[1], self.d * rate / sizes[0] / sizes[1]
        a, b, c, d = _square_pencil(*system)
        if not len(a):
            return np.zeros(0, complex)
        m = b.shape[1]
        turn = linalg.qr(np.hstack([c, d]).T)[0][
            :, m:
        ]  # of all directions, those that the outputs do not see
        values = linalg.eigvals(np.hstack([a, b]) @ turn, turn[: len(a)])
        return values.astype(complex) * rate

    @checked
    def select(self, inputs: Sequence[int | str], outputs: Sequence[int | str]) -> "StateModel":
        """Keep only these inputs and outputs.

        Parameters
        ----------
        inputs, outputs : sequence of int or str
            Their indices, from 0, or their names, in the desired order.

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
        i, o = _places("inputs", inputs, self.input_labels), _places("outputs", outputs, self.output_labels)
        if not i or not o:
            raise InputError("inputs or outputs is empty; choose one of each at least")
        return StateModel(
            *(self.a, self.b[:, i], self.c[o], self.d[np.ix_(o, i)], self.sample_time),
            input_labels=_chosen(self.input_labels, i),
            output_labels=_chosen(self.output_labels, o),
            state_labels=self.state_labels,
        )

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
        return self._values(
            np.exp(1j * omega * self.sample_time) if self.sample_time else 1j * omega, "omega"
        )

    @checked
    def __call__(self, s: Complex128[np.ndarray, "..."]) -> complex | Complex128[np.ndarray, "..."]:
        """The transfer function at s, in discrete time at z, as python-control has it.

        Parameters
        ----------
        s : complex or array_like
            rad/s.

        Returns
        -------
        complex or ndarray, shape (outputs, inputs) and that of s
            Of a model of one input and one output of the shape of s alone.

        Raises
        ------
        InputError
            When s is empty, or one of it is a pole.

        Examples
        --------
        >>> low_pass = lti.StateModel([[-10.0]], [[10.0]], [[1.0]], [[0.0]])
        >>> low_pass(0), low_pass([-5.0, 10j]).round(3)
        (1.0, array([2. +0.j , 0.5-0.5j]))
        """
        values = self._values(s.ravel(), "s").reshape(*self.d.shape, *s.shape)
        if not np.isfinite(values).all():
            raise InputError("s holds a pole of the model; leave it out")
        return values if self.d.size > 1 else values[0, 0] if s.ndim else values.item()

    def _values(self, point: np.ndarray, name: str) -> np.ndarray:
        """The transfer function at points of the plane."""
        if not len(point):
            raise InputError(f"{name} is empty; give at least one frequency")
        response = np.repeat(self.d[:, :, None].astype(complex), len(point), axis=2)
        if not len(self.a):
            return response
        poles, residues = self._residues
        if residues is not None:
            with np.errstate(all="ignore"):  # what is not finite is refused
                return response + residues @ (1 / (point[None, :] - poles[:, None]))
        scale, a, _, _ = self._decomposed
        b, c = self.b / scale[:, None], self.c * scale
        solved = np.zeros((len(point), *b.shape), complex)
        # Each part drives only later ones: a line of delays is as many as it has samples.
        for part in self._coupled:
            shifted = point[:, None, None] * np.eye(len(part)) - a[np.ix_(part, part)]
            try:
                solved[:, part] = np.linalg.solve(shifted, b[part] + a[part] @ solved)
            except np.linalg.LinAlgError:
                raise InputError(f"{name} holds a pole of the model; leave it out") from None
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
        residues = ((self.c * scale) @ vectors)[:, None, :] * right.T[None]
        return poles, None if _cancel(poles, residues, float(self.sample_time > 0)) else residues

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

    def __getitem__(self, places) -> "StateModel":
        """``model[outputs, inputs]``: indices, names, slices, or lists of indices and names."""
        if not isinstance(places, tuple) or len(places) != 2:
            raise InputError("give model[outputs, inputs], each an index, a name, a slice or a list")
        outputs, inputs = (
            list(range(count)[each])
            if isinstance(each, slice)
            else [each]
            if isinstance(each, int | str)
            else each
            for each, count in zip(places, self.d.shape, strict=True)
        )
        return self.select(inputs, outputs)

    @checked
    def feedback(
        self, other: "StateModel | float | np.ndarray | None" = None, sign: int = -1
    ) -> "StateModel":
        """The closed loop of this model, with `other` from its outputs back to its inputs.

        Parameters
        ----------
        other : StateModel or float or array_like, optional
            Model or gain in the way back; 1 without.
        sign : int
            -1 subtracts what comes back, 1 adds it.

        Returns
        -------
        StateModel
            From this model's inputs to its outputs.

        Raises
        ------
        InputError
            When the sizes or sample times do not fit, or the loop has no unique solution.

        Examples
        --------
        >>> integrator = lti.StateModel([[0.0]], [[5.0]], [[1.0]], [[0.0]])
        >>> integrator.feedback().poles.real
        array([-5.])
        """
        back = self._operand(1.0 if other is None else other)
        if sign not in (-1, 1) or not isinstance(back, StateModel):
            raise InputError(f"sign is {sign} or other no model; give -1 or 1, and a model or a gain")
        (outputs, inputs), n = self.d.shape, sum(self.d.shape)
        if back.d.size == 1:
            back = back._repeated(inputs)
        if back.d.shape != (inputs, outputs):
            raise InputError(f"other has shape {back.d.shape}; give {inputs} outputs and {outputs} inputs")
        turn = np.zeros((n, n))
        turn[:inputs, outputs:], turn[inputs:, :outputs] = sign * np.eye(inputs), np.eye(outputs)
        loop = interconnect([self, back], turn, np.eye(n, inputs), np.eye(outputs, n))
        return self._named(loop, self)

    def _operand(self, other):
        """What this model is added to or multiplied with, as a model; a measured response of python-control as it is."""
        if isinstance(other, int | float | np.integer | np.floating | np.ndarray):
            return constant(np.atleast_2d(other), self.sample_time)
        if hasattr(other, "frdata"):
            return other
        try:
            return StateModel.converted("the other model", other)
        except InputError:
            if hasattr(other, "dt") or isinstance(other, tuple):
                raise
            return None

    def _repeated(self, count: int) -> "StateModel":
        """A model of one channel in each of `count` channels."""
        if count == 1:
            return self
        a, b, c, d = (np.kron(np.eye(count), each) for each in (self.a, self.b, self.c, self.d))
        return StateModel(a, b, c, d, self.sample_time)

    def _spread(self, shape: tuple[int, int]) -> "StateModel":
        """A model of one channel from every input to every output; another as it is."""
        if self.d.size > 1 or shape == (1, 1):
            return self
        column, row = np.ones((shape[0], 1)), np.ones((1, shape[1]))
        return replace(
            self,
            b=self.b @ row,
            c=column @ self.c,
            d=column @ self.d @ row,
            input_labels=(),
            output_labels=(),
        )

    def __neg__(self) -> "StateModel":
        return replace(self, c=-self.c, d=-self.d)

    def __add__(self, other):
        other = self._operand(other)
        if not isinstance(other, StateModel):
            return NotImplemented if other is None else self.to_control() + other
        one, other = self._spread(other.d.shape), other._spread(self.d.shape)
        if other.d.shape != one.d.shape:
            raise InputError(
                f"models of shapes {one.d.shape} and {other.d.shape} cannot be added; give equal ones"
            )
        outputs, inputs = (np.eye(size) for size in one.d.shape)
        apart = np.zeros((2 * len(inputs), 2 * len(outputs)))
        both = np.vstack([inputs, inputs]), np.hstack([outputs, outputs])
        return one._named(interconnect([one, other], apart, *both), one)

    __radd__ = __add__

    def __sub__(self, other):
        other = self._operand(other)
        return NotImplemented if other is None else self + -other

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        other = self._operand(other)
        if not isinstance(other, StateModel):
            return NotImplemented if other is None else self.to_control() * other
        return self._after(other)

    def __rmul__(self, other):
        other = self._operand(other)
        return other._after(self) if isinstance(other, StateModel) else NotImplemented

    def __truediv__(self, other):
        other = self._operand(other)
        return NotImplemented if other is None else self * other**-1

    def __rtruediv__(self, other):
        return other * self**-1

    def __pow__(self, power):
        """So many of this model in series; below zero of its inverse."""
        if not isinstance(power, int | np.integer) or len(set(self.d.shape)) > 1:
            raise InputError(
                f"a model of shape {self.d.shape} has no power {power}; give a whole number, and as many inputs as outputs"
            )
        if not power:
            return constant(np.eye(len(self.d)), self.sample_time)
        return reduce(mul, [self if power > 0 else self._inverse()] * abs(power))

    def _inverse(self) -> "StateModel":
        if _least_condition(self.d) > 1e12:
            raise InputError(
                "d is singular: the inverse is improper; add a direct part, or a pole to what divides it"
            )
        c, d = np.linalg.solve(self.d, self.c), np.linalg.inv(self.d)
        inverse = replace(self, a=self.a - self.b @ c, b=self.b @ d, c=-c, d=d)
        return replace(inverse, input_labels=self.output_labels, output_labels=self.input_labels)

    def _after(self, first: "StateModel") -> "StateModel":
        """`first`, then this; a model of one channel is repeated in each of the other's."""
        last = self._repeated(len(first.d)) if self.d.size == 1 else self
        first = first._repeated(last.d.shape[1]) if first.d.size == 1 else first
        if len(first.d) != last.d.shape[1]:
            raise InputError(
                f"models of shapes {last.d.shape} and {first.d.shape} are no product; give as many "
                "outputs of the second as inputs of the first"
            )
        inner, inputs, outputs = len(first.d), first.d.shape[1], len(last.d)
        turn = np.zeros((inputs + inner, inner + outputs))
        turn[inputs:, :inner] = np.eye(inner)
        ends = np.eye(inputs + inner, inputs), np.eye(inner + outputs)[inner:]
        return last._named(interconnect([first, last], turn, *ends), first)

    def _named(self, model: "StateModel", first: "StateModel") -> "StateModel":
        return replace(model, input_labels=first.input_labels, output_labels=self.output_labels)

    def to_control(self):
        """The same model as `control.StateSpace`, with its names.

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
        >>> low_pass = lti.StateModel([[-10.0]], [[10.0]], [[1.0]], [[0.0]], input_labels=["force"])
        >>> float(low_pass.to_control().dcgain()), low_pass.to_control().input_labels
        (1.0, ['force'])
        """
        control = require_package("control")
        names = {
            f"{kind}s": list(getattr(self, f"{kind}_labels"))
            for kind in ("input", "output", "state")
            if getattr(self, f"{kind}_labels")
        }
        return control.StateSpace(self.a, self.b, self.c, self.d, self.sample_time or 0, **names)

    def to_scipy(self):
        """The same model as `scipy.signal.StateSpace`, which holds no names.

        Returns
        -------
        scipy.signal.StateSpace
            In discrete time when `sample_time` is above 0.

        Examples
        --------
        >>> low_pass = lti.StateModel([[-10.0]], [[10.0]], [[1.0]], [[0.0]])
        >>> low_pass.to_scipy().poles
        array([-10.])
        """
        time = {"dt": self.sample_time} if self.sample_time else {}
        return scipy.signal.StateSpace(self.a, self.b, self.c, self.d, **time)


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


def _cancel(poles: np.ndarray, residues: np.ndarray, origin: float) -> bool:
    """Whether residues of nearly equal poles cancel: they do in any units, eigenvectors are skew in some of them alone."""
    size = abs(poles - origin)
    near = abs(poles[:, None] - poles) <= 1e-3 * size
    if near.sum() <= len(poles):
        return False
    with np.errstate(all="ignore"):  # as far from a pole as this is from the origin
        shares = np.where(near, 1 / (poles + size * np.exp(1j) - poles[:, None]), 0.0)
        sums, sizes = (
            np.linalg.norm(each, axis=0) for each in (residues @ shares, abs(residues) @ abs(shares))
        )
    return bool((sizes > WORST_CONDITION * sums).any())


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
def from_control(system: StateModel) -> StateModel:
    """Take a model of python-control or `scipy.signal`, or a tuple of arrays; one without a sample time is refused.

    Every function that takes a model does this by itself.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction or scipy.signal.lti or scipy.signal.dlti or tuple
        A transfer function becomes a cascade of sections without the poles that its zeros cancel (those nearer than
        1e-6 of their size), which a `CancellationWarning` names. A tuple holds A, B, C, D, and may hold the sample time in s.

    Returns
    -------
    StateModel
        The same names of signals and states; `sample_time` 0 in continuous time.

    Raises
    ------
    InputError
        When it is no such model, is improper, or its sample time is unspecified: None with python-control, True with both.

    Examples
    --------
    >>> from control import tf
    >>> np.sort(lti.from_control(tf([1.0], [1.0, 3.0, 2.0])).poles.real)
    array([-2., -1.])
    """
    return system


@by_value
@dataclass(frozen=True)
class MinimalRealisation:
    """A model without the states that its response does not need.

    Parameters
    ----------
    model : StateModel
    removed : array_like, shape (removed,)
        Singular values that were counted as zero, of the size of their matrix, falling; one for each state that went.

    Examples
    --------
    >>> lag = lti.StateModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> lti.minimal_realisation(lag).removed
    array([], dtype=float64)
    """

    model: StateModel
    # the singular values that were counted as zero, of the size of their matrix, falling: as many as states that went
    removed: Float64[np.ndarray, " removed"]


@checked
def minimal_realisation(model: StateModel, tolerance: Positive = 1e-10) -> MinimalRealisation:
    """Leave out the states that the inputs do not reach or the outputs do not see.

    Parameters
    ----------
    model : StateModel
    tolerance : float
        A singular value counts as zero below this part of the size of its matrix (B, then A; states balanced), where the
        response stays the same to 1e-6 without its states.

    Returns
    -------
    MinimalRealisation
        The smaller model, and the singular values that went.

    References
    ----------
    Van Dooren, The generalized eigenstructure problem in linear system theory, IEEE Trans. Automatic Control 26 (1981).

    Examples
    --------
    >>> lag = lti.StateModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> found = lti.minimal_realisation(lag + lag)  # two equal lags are one
    >>> found.model.poles.real, len(found.removed)
    (array([-1.]), 1)
    """
    a, b, c, removed = minimal(model.a, model.b, model.c, tolerance)
    if len(a) == len(model.a):
        return MinimalRealisation(model, removed)
    labels = {"input_labels": model.input_labels, "output_labels": model.output_labels}
    return MinimalRealisation(StateModel(a, b, c, model.d, model.sample_time, **labels), removed)


def _places(name: str, asked: Sequence[int | str], labels: tuple[str, ...]) -> list[int]:
    """Indices of signals that are asked for by index or by name."""
    for each in asked:
        if isinstance(each, str) and each not in labels:
            raise InputError(f"{name} holds {each!r}, which is none of {list(labels)}{nearest(each, labels)}")
    return [labels.index(each) if isinstance(each, str) else each for each in asked]


def _chosen(labels: tuple[str, ...], places: list[int]) -> tuple[str, ...]:
    """Names of the signals at these places; none where a signal is there twice."""
    return tuple(labels[each] for each in places) if labels and len(set(places)) == len(places) else ()


def _square_pencil(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A system with the same finite zeros whose D is square and regular: rows without D are followed until they have one."""
    least = 1e3 * np.finfo(float).eps * max(1.0, len(a)) * max(1.0, np.linalg.norm(d, 2) if d.size else 0.0)
    for _ in range(2):  # rows, and then columns as rows of the dual system
        a, b, c, d = _regular_rows(a, b, c, d, least)
        a, b, c, d = a.T, c.T, b.T, d.T
    return a, b, c, d


def _regular_rows(a, b, c, d, least: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    while True:
        left, values, _ = np.linalg.svd(d)
        rank = int(np.sum(values > least))
        c, d = left.T @ c, left.T @ d
        if rank == len(d) or not len(a):
            return a, b, c[:rank], d[:rank]
        _, values, right = np.linalg.svd(c[rank:])
        bound = int(np.sum(values > least))  # states that an output at zero holds at zero
        free = len(a) - bound
        turn = np.vstack([right[bound:], right[:bound]]).T
        a, b, c = turn.T @ a @ turn, turn.T @ b, c[:rank] @ turn
        c, d = np.vstack([c[:, :free], a[free:, :free]]), np.vstack([d[:rank], b[free:]])
        a, b = a[:free, :free], b[:free]
        if not bound:
            return a, b, c[:rank], d[:rank]


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
        From r to z; with the names of the states where all have one and no two the same.

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
    times = {model.sample_time for model in models if len(model.a)} or {
        models[0].sample_time
    }  # a gain has any
    if len(times) != 1:
        raise InputError("models have different sample times; discretise them with the same one first")
    names = tuple(name for model in models for name in model.state_labels)
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
        times.pop(),
        state_labels=names if len(set(names)) == len(a) else (),
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
