"""Open choices of the worst-case paper: at the defaults what the notebooks give, and each choice does what it says."""

import numpy as np
import pytest

from choices.defaults import require_accepted
from notebooks.worstcase.fir_identification import sample_bounded
from notebooks.worstcase.tracking import EXCITATIONS, PUBLISHED_NORM, weighted_excitation
from workbook.choices.checking import today


@pytest.mark.slow
def test_without_leaving_anything_out_the_defaults_give_what_the_notebooks_gave():
    """The study whose turn it is today."""
    studies = "identification", "tracking", "updates"
    require_accepted("worstcase", studies[today() % len(studies)])


def test_both_noise_laws_keep_their_bound_and_differ():
    rng = np.random.default_rng(3)
    deviation = {}
    for law in ("uniform", "cut Gaussian"):
        noise = sample_bounded(rng, law, 0.1, 20000)
        assert np.abs(noise).max() <= 0.1
        deviation[law] = noise.std() / 0.1
    # Of the uniform law 1 / sqrt 3; of a Gaussian of deviation 1/2, cut at two of them, 0.8796 of that.
    assert deviation["uniform"] == pytest.approx(1 / np.sqrt(3), rel=0.02)
    assert deviation["cut Gaussian"] == pytest.approx(0.8796 / 2, rel=0.02)


def test_every_excitation_has_the_published_norm():
    for amplitude, samples in EXCITATIONS.values():
        rows = amplitude * np.random.default_rng(7).standard_normal((200, 5, samples))
        assert np.linalg.norm(rows, 2, axis=(1, 2)).mean() == pytest.approx(PUBLISHED_NORM, rel=0.03)
    amplitude, samples = weighted_excitation(0.95)
    weights = 0.95 ** (np.arange(samples - 1, -1, -1) / 2)
    rows = amplitude * np.random.default_rng(7).standard_normal((200, 5, samples)) * weights
    assert np.linalg.norm(rows, 2, axis=(1, 2)).mean() == pytest.approx(PUBLISHED_NORM, rel=0.03)
