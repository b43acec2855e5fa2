"""Open choices of the worst-case paper: at the defaults what the notebooks give, and each choice does what it says."""

import numpy as np
import pytest

from choices.defaults import require_accepted
from experiments.worstcase.simulations import (
    FIG_2_PARAMETERS,
    fir_trial,
    path,
    sample_bounded,
    tracking_trial,
)
from experiments.worstcase.theory import random_problem
from notebooks.worstcase.tracking import EXCITATIONS, PUBLISHED_NORM, weighted_excitation
from workbook.studies import run_study

FIG_1 = {"parameters": (1.0, 0.5), "period": 20, "samples": 60, "input_noise": 0.1, "output_noise": 1.0}
FIG_2 = {
    "truth": path("constant", FIG_2_PARAMETERS, 120), "bound": 1.34, "forgetting": 0.95, "row_error": 0.25,
    "noise": 0.1, "penalty": 14.0,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("study", ["identification", "tracking", "updates"])
def test_without_leaving_anything_out_the_defaults_give_what_the_notebooks_gave(study):
    require_accepted("worstcase", study)


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


def test_the_update_is_the_one_that_is_asked_for():
    found = {
        u: run_study(fir_trial, 2, 1, progress=False, update=u, **FIG_1) for u in ("exact", "approximate")
    }
    exact, approximate = (each["min_max"][..., 5:] for each in found.values())
    assert 1e-6 < np.abs(exact - approximate).max() < 0.5
    assert np.array_equal(found["exact"]["total"], found["approximate"]["total"], equal_nan=True)


def test_a_delay_line_hands_its_samples_on_and_amplitude_scales_the_norm():
    lines = run_study(tracking_trial, 40, 1, progress=False, delay_line=True, amplitude=2.0, **FIG_2)
    rows = run_study(tracking_trial, 40, 1, progress=False, **FIG_2)
    assert lines["norm"].mean() == pytest.approx(2 * rows["norm"].mean(), rel=0.1)
    assert lines["norm"].std() > 2.2 * rows["norm"].std()  # rows that share samples scatter together


def test_errors_on_the_sphere_cost_more_than_those_within_it():
    loud = FIG_2 | {"truth": 10 * FIG_2["truth"], "noise": 1e-6}
    error = {
        law: run_study(tracking_trial, 20, 1, progress=False, error_law=law, **loud)["rls"][:, 60:].mean()
        for law in ("ball", "sphere", "one direction")
    }
    assert error["ball"] < error["sphere"]
    assert error["one direction"] not in (error["ball"], error["sphere"])


def test_every_excitation_has_the_published_norm():
    for amplitude, samples in EXCITATIONS.values():
        rows = amplitude * np.random.default_rng(7).standard_normal((200, 5, samples))
        assert np.linalg.norm(rows, 2, axis=(1, 2)).mean() == pytest.approx(PUBLISHED_NORM, rel=0.03)
    amplitude, samples = weighted_excitation(0.95)
    weights = 0.95 ** (np.arange(samples - 1, -1, -1) / 2)
    rows = amplitude * np.random.default_rng(7).standard_normal((200, 5, samples)) * weights
    assert np.linalg.norm(rows, 2, axis=(1, 2)).mean() == pytest.approx(PUBLISHED_NORM, rel=0.03)


def test_columns_differ_by_no_more_than_asked():
    for decades in (0.0, 4.0):
        sizes = [
            np.ptp(np.log10(np.linalg.norm(random_problem(np.random.default_rng(k), 6, decades)[0], axis=0)))
            for k in range(60)
        ]
        assert max(sizes) < decades + 1.2  # columns of a few rows scatter by themselves
    assert max(sizes) > 2
