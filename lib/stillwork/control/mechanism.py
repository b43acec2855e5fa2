"""Plants with several coordinates: M(q) q'' + h(q, q') = u, from user-defined functions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.algebra import add_product, cholesky_root, cholesky_solve
from stillwork.base.checks import InputError, pluralise, require_array, require_count, require_number
from stillwork.base.kernels import borrowing_kernel, callback
from stillwork.base.validation import by_value, check_fields, checked, user_callback

INERTIA = "void(float64[::1], float64[::1], float64[:, ::1])"  # signatures of the two functions
BIAS = "void(float64[::1], float64[::1], float64[::1], float64[::1])"
MOST_COORDINATES = 1000  # M holds their square, and the controller solves with it in every sample


@by_value
@dataclass(frozen=True)
class Mechanism:
    """M(q) q'' + h(q, q') = u, one force (or torque) for each coordinate.

    Both functions are written in plain Python with `math` or `numpy`, in a file, and fill their last argument; they
    are compiled on first use and cached beside that file. Coordinates may be lengths or angles, in m or rad.

    Attributes
    ----------
    inertia : callable
        ``inertia(position, parameters, out)``: M, symmetric and positive definite, kg or kg m^2.
    bias : callable
        ``bias(position, velocity, parameters, out)``: h, all forces but the inertial ones, N or N m.
    coordinates : int
        Number of coordinates, at most 1000.
    parameters : ndarray, shape (parameters,)
        Passed to both functions; a change does not recompile them.

    Raises
    ------
    InputError
        When a function fails, leaves an entry unset, or the inertia is not symmetric.

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[:] = parameters[0] * np.eye(2)
    >>> def bias(position, velocity, parameters, out):
    ...     out[:] = 0.0, 9.81 * parameters[0]
    >>> load = control.Mechanism(inertia, bias, 2, [3.0])
    >>> load.force([0.0, 0.0], [0.0, 0.0], [1.0, 0.0]).round(2)  # N, along and up
    array([ 3.  , 29.43])
    """

    inertia: Callable
    bias: Callable
    coordinates: int
    parameters: ArrayLike = ()

    def __post_init__(self):
        check_fields(self)
        require_number(
            "coordinates", require_count("coordinates", self.coordinates), at_most=MOST_COORDINATES
        )
        object.__setattr__(self, "parameters", require_array("parameters", self.parameters, ndim=1))
        place = np.linspace(0.3, 0.7, self.coordinates)
        try:
            matrix, forces = self._mass(place), self._resistance(place, -place)
        except Exception as error:  # a reader's function may raise anything
            raise InputError(
                f"inertia or bias fails on {pluralise(self.coordinates, 'coordinate')} and {pluralise(len(self.parameters), 'parameter')} ({error}); "
                "give inertia(position, parameters, out) and bias(position, velocity, parameters, out)"
            ) from None
        if not (np.isfinite(matrix).all() and np.isfinite(forces).all()):
            raise InputError(
                f"inertia or bias leaves an entry of out unset, or not finite, at q = {place}; fill all of them"
            )
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12 * np.abs(matrix).max()):
            raise InputError(f"inertia is not symmetric at q = {place}: {matrix.tolist()}; correct it")

    @checked
    def mass(self, position: ArrayLike) -> Float64[np.ndarray, "coordinates coordinates"]:
        """M at a position.

        Parameters
        ----------
        position : array_like, shape (coordinates,)
            q.

        Returns
        -------
        ndarray, shape (coordinates, coordinates)
            kg or kg m^2.

        Raises
        ------
        InputError
            When it is not positive definite there, or there is not one position for every coordinate.

        Examples
        --------
        >>> def inertia(position, parameters, out):
        ...     out[:] = parameters[0] * np.eye(2)
        >>> def bias(position, velocity, parameters, out):
        ...     out[:] = 0.0, 9.81 * parameters[0]
        >>> load = control.Mechanism(inertia, bias, 2, [3.0])
        >>> load.mass([0.0, 0.0]).diagonal()  # kg
        array([3., 3.])
        """
        matrix = self._mass(require_array("position", position, shape=(self.coordinates,)))
        if not (np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 0):
            raise InputError(
                f"inertia is not positive definite at q = {np.asarray(position)}; correct the function or the parameters"
            )
        return matrix

    @checked
    def force(
        self, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
    ) -> Float64[np.ndarray, " coordinates"]:
        """Force u for an acceleration.

        Parameters
        ----------
        position, velocity, acceleration : array_like, shape (coordinates,)
            q, q' and q''.

        Returns
        -------
        ndarray, shape (coordinates,)
            N or N m.

        Raises
        ------
        InputError
            When there is not one of each for every coordinate, or M is not positive definite.

        Examples
        --------
        >>> def inertia(position, parameters, out):
        ...     out[:] = parameters[0] * np.eye(2)
        >>> def bias(position, velocity, parameters, out):
        ...     out[:] = 0.0, 9.81 * parameters[0]
        >>> load = control.Mechanism(inertia, bias, 2, [3.0])
        >>> load.force([0.0, 0.0], [0.0, 0.0], [0.0, 0.0]).round(2)  # N: it is held up
        array([ 0.  , 29.43])
        """
        shape = (self.coordinates,)
        place = require_array("position", position, shape=shape)
        speed = require_array("velocity", velocity, shape=shape)
        wanted = require_array("acceleration", acceleration, shape=shape)
        return self.mass(place) @ wanted + self._resistance(place, speed)

    @checked
    def acceleration(
        self, position: ArrayLike, velocity: ArrayLike, force: ArrayLike
    ) -> Float64[np.ndarray, " coordinates"]:
        """Acceleration q'' under a force.

        Parameters
        ----------
        position, velocity, force : array_like, shape (coordinates,)
            q, q' and u.

        Returns
        -------
        ndarray, shape (coordinates,)
            m/s^2 or rad/s^2.

        Raises
        ------
        InputError
            When there is not one of each for every coordinate, or M is not positive definite.

        Examples
        --------
        >>> def inertia(position, parameters, out):
        ...     out[:] = parameters[0] * np.eye(2)
        >>> def bias(position, velocity, parameters, out):
        ...     out[:] = 0.0, 9.81 * parameters[0]
        >>> load = control.Mechanism(inertia, bias, 2, [3.0])
        >>> load.acceleration([0.0, 0.0], [0.0, 0.0], [3.0, 0.0]).round(2)  # m/s^2: pushed, and falling
        array([ 1.  , -9.81])
        """
        pushed = require_array("force", force, shape=(self.coordinates,))
        resisted = self.force(position, velocity, np.zeros(self.coordinates))
        return np.linalg.solve(self.mass(position), pushed - resisted)

    @property
    def compiled(self):
        """The two functions as C callbacks, and the parameters: what the kernels take."""
        return callback(self.inertia, INERTIA), callback(self.bias, BIAS), self.parameters

    def _mass(self, position):
        matrix = np.full((self.coordinates, self.coordinates), np.nan)
        user_callback(self.inertia)(position, self.parameters, matrix)
        return matrix

    def _resistance(self, position, velocity):
        forces = np.full(self.coordinates, np.nan)
        user_callback(self.bias)(position, velocity, self.parameters, forces)
        return forces


@checked
def response_matrix(
    plant: Mechanism, model: Mechanism, position: ArrayLike
) -> Float64[np.ndarray, "coordinates coordinates"]:
    """F = M^-1 M_model: accelerations realised per acceleration commanded through an imperfect model.

    M F is symmetric and positive definite, so F has real and positive eigenvalues, and in the norm of the kinetic
    energy, x' M x, the norm of 1 + g F is its spectral radius: an iteration in which every coordinate has the local gain g
    contracts in that norm exactly where -2 / (largest eigenvalue) < g < 0. In the Euclidean norm a step may grow even
    there.
    """
    if plant.coordinates != model.coordinates:
        raise InputError(
            f"plant has {plant.coordinates} coordinates, model {model.coordinates}; give both the same ones"
        )
    return np.linalg.solve(plant.mass(position), model.mass(position))


@checked
def response_gains(
    plant: Mechanism, model: Mechanism, position: ArrayLike
) -> Float64[np.ndarray, " coordinates"]:
    """Eigenvalues of `response_matrix`, smallest first: one f' for each direction of the iteration."""
    return np.sort(np.linalg.eigvals(response_matrix(plant, model, position)).real)


@checked
def iteration_radius(
    plant: Mechanism, model: Mechanism, position: ArrayLike, local_gains: ArrayLike
) -> float:
    """Spectral radius of 1 + G F, with a local gain of each coordinate: below 1 the iteration converges at this position.

    Where the gains are equal this is `response_matrix`'s bound. Where they differ, 1 + G F may have complex eigenvalues, and no
    norm is known in which every step contracts: the radius holds near the fixed point, and for a model at rest.
    """
    response = response_matrix(plant, model, position)
    gains = require_array("local_gains", local_gains, shape=(plant.coordinates,))
    return float(np.abs(np.linalg.eigvals(np.eye(len(gains)) + gains[:, None] * response)).max())


@borrowing_kernel
def inverse_dynamics(inertia, bias, parameters, position, velocity, acceleration, work, force):
    """force = M acceleration + h; work: (2 n + 1, n) numbers."""
    size = len(position)
    inertia(position, parameters, work[:size])
    bias(position, velocity, parameters, force)
    add_product(work[:size], acceleration, force)


@borrowing_kernel
def forward_dynamics(inertia, bias, parameters, position, velocity, force, work, acceleration):
    """acceleration = M^-1 (force - h); false where M is not positive definite."""
    size = len(position)
    matrix, root, rest = work[:size], work[size : 2 * size], work[2 * size]
    inertia(position, parameters, matrix)
    bias(position, velocity, parameters, rest)
    if not cholesky_root(matrix, root, size):
        return False
    for i in range(size):
        rest[i] = force[i] - rest[i]
    cholesky_solve(root, rest, acceleration)
    return True
