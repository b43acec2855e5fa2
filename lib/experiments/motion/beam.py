"""A beam, free at both ends, that stands in for the flexible system of section 4.3."""

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.toml_files import read_numbers
from stillwork.base.validation import checked
from stillwork.lti.modal import ModalModel
from workbook import paths

TERMS = 20  # polynomials of the Ritz series; the first six bending modes have converged to 1e-9 with them


def beam_parameters() -> dict:
    """What section 4.3 prints and what is assumed, from ``data/motion/beam.toml``."""
    return read_numbers(paths.data("motion", "beam.toml"))


def beam_shapes(places: ArrayLike, modes: int, taper: float = 0.0) -> Float64[np.ndarray, "places modes"]:
    """Mode shapes of a slender free beam of unit mass: translation, rotation, then bending.

    Ritz series in Legendre polynomials, which hold both rigid-body modes exactly and need no condition at
    the free ends.

    `places` run from 0 to 1, `modes` from 2 to 8. The thickness runs from 1 - taper/2 to 1 + taper/2; mass follows
    it, bending stiffness its cube.
    """
    places = np.asarray(places, float)
    at, weights = legendre.leggauss(TERMS + 2)
    thickness = 1 + taper * at / 2
    series = legendre.legvander(at, TERMS - 1)
    bending = legendre.legval(at, legendre.legder(np.eye(TERMS), 2)).T
    mass = series.T @ ((weights / 2 * thickness)[:, None] * series)
    stiffness = bending.T @ ((weights / 2 * thickness**3)[:, None] * bending)
    weight = 1 / np.sqrt(np.diag(mass))  # of the polynomials, for an even scale
    _, vectors = linalg.eigh(stiffness * weight[:, None] * weight, mass * weight[:, None] * weight)
    chosen = weight[:, None] * vectors[:, :modes]
    # The solver gives any two of the rigid-body motions: take translation and rotation about the centre of mass.
    rigid = np.eye(TERMS, 2)
    rigid[0, 1] = -mass[0, 1] / mass[0, 0]
    chosen[:, :2] = rigid / np.sqrt(np.einsum("im,ij,jm->m", rigid, mass, rigid))
    chosen *= np.sign(chosen.sum(axis=0))  # positive at the far end
    return legendre.legvander(2 * places - 1, TERMS - 1) @ chosen


@checked
def beam(actuators: ArrayLike, sensors: ArrayLike, *, taper: float = 0.0) -> ModalModel:
    """Forces on a free beam to positions along it: shapes of the beam, frequencies as published.

    `actuators` and `sensors` are places along the beam, 0 to 1. The published frequencies are not in the ratios of a
    uniform beam.
    """
    p = beam_parameters()
    published, assumed = p.table("published"), p.table("assumed")
    flexible = np.asarray(published["frequencies_hz"], float)
    ratio = assumed["damping_ratio"]
    frequencies = 2 * np.pi * np.concatenate([[0.0, 0.0], flexible])
    modes = len(frequencies)
    scale = 1 / np.sqrt(assumed["mass"])
    inputs = scale * beam_shapes(actuators, modes, taper).T
    outputs = scale * beam_shapes(sensors, modes, taper)
    damping = np.where(frequencies > 0, ratio, 0.0)
    return ModalModel(frequencies, damping, inputs, outputs, np.zeros((len(outputs), inputs.shape[1])))


@checked
def published_beam(actuators: int = 2) -> ModalModel:
    """The beam with the first `actuators` of its five actuators and both sensors."""
    places = beam_parameters().table("assumed")
    driven = np.asarray(places["actuators"], float)
    return beam(driven[:actuators], places["sensors"])
