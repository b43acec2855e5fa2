"""Open choices of the fixed-point paper: at the defaults what the notebooks give, and each choice does what it says."""

import numpy as np
import pytest

from choices.defaults import require_accepted
from notebooks.fixedpoint import every_claim
from workbook.choices.checking import today


@pytest.mark.slow
def test_without_leaving_anything_out_the_defaults_give_what_the_notebooks_gave():
    """The study whose turn it is today."""
    studies = "noise-free", "differentiation"
    require_accepted("fixedpoint", studies[today() % len(studies)])


def test_the_amplitude_of_a_noise_by_its_three_meanings():
    deviations = {
        (kind, meaning): every_claim.noise_of(kind, "large", meaning).standard_deviation
        for kind in ("gaussian", "logistic")
        for meaning in ("deviation", "scale", "three deviations")
    }
    assert deviations["gaussian", "scale"] == deviations["gaussian", "deviation"] == 1e-4
    assert deviations["logistic", "scale"] == pytest.approx(np.pi / np.sqrt(3) * 1e-4)
    assert deviations["logistic", "three deviations"] == pytest.approx(1e-4 / 3)


def test_coupled_noise_is_logistic_and_follows_the_gaussian():
    from scipy import stats

    normal = 1e-4 * np.random.default_rng(5).standard_normal(20000)
    found = every_claim.coupled_logistic(normal, 1e-4)
    assert stats.kstest(found, stats.logistic(scale=1e-4 * np.sqrt(3) / np.pi).cdf).pvalue > 1e-3
    assert np.corrcoef(normal, found)[0, 1] > 0.98
    assert np.isfinite(
        every_claim.coupled_logistic(np.array([-3e-3, 3e-3]), 1e-4)
    ).all()  # thirty deviations out
