"""The comparison at equal variance: speed-up by start and by step, against loops that share no code with the library."""

import numpy as np
import pytest

from experiments.isolation.floors import flat_floor
from experiments.isolation.simulation import simulate_together
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import load_twin
from notebooks.isolation import convergence
from workbook.studies import Study

SECONDS, SEEDS = 30.0, range(4)


def settled_from(courses, final):
    """Time from which each course (seeds, kept, 9), kept every 0.1 s, stays within 63 % of the final value."""
    times = np.empty((len(courses), 9))
    for run, course in enumerate(courses):
        for k in range(9):
            late = [i for i, value in enumerate(course[:, k]) if abs(value - final[k]) > 0.63 * abs(final[k])]
            times[run, k] = 0.1 * (late[-1] + 2 if late else 1)
    return times


@pytest.mark.slow
def test_the_speed_up_at_equal_variance_is_that_of_plain_loops():
    twin, floor = load_twin("fitted"), flat_floor(80.0)
    steady = steady_state(twin, floor)
    options = {"adaptations": {"": None}, "signals_from_s": 0.0, "signals": ("filtered_regressors", "error")}
    runs = [each[""] for each in simulate_together(twin, floor, SECONDS, seeds=SEEDS, **options)]
    regressors = np.stack([run.filtered_regressors.T for run in runs], axis=1)  # (samples, seeds, 9)
    disturbance = np.stack([run.error[0] for run in runs], axis=1)  # (samples, seeds), of the first actuator
    # Only the order of path and weights is exchanged: the error of weights w is d + w psi_N.
    memories, starts = np.array([10.0, 20.0, 20.0, 20.0]), np.array([1.0, 1.0, 2.0, 10.0])
    forgetting = np.exp(-2e-4 / memories)[:, None, None, None]
    first = np.diag(np.diag(np.linalg.inv(steady.correlation)))
    covariance = (starts * (1 - np.exp(-2e-4 / memories)))[:, None, None, None] * np.tile(first, (4, 4, 1, 1))
    ferls, felms, bolder = np.zeros((4, 4, 9)), np.zeros((4, 9)), np.zeros((4, 9))
    kept = {"FeRLS": [], "FeLMS": [], "bolder": []}
    for k, (psi, d) in enumerate(zip(regressors, disturbance, strict=True)):
        along = covariance @ psi[None, :, :, None]  # (4, seeds, 9, 1)
        whole = forgetting + psi[None, :, None, :] @ along
        covariance = (covariance - along @ along.swapaxes(2, 3) / whole) / forgetting
        error = d + np.sum(ferls * psi, axis=2)
        ferls = ferls - error[:, :, None] * (covariance @ psi[None, :, :, None])[..., 0]
        trace = 1e-5 + np.sum(psi**2, axis=1)
        felms = felms - (1e-4 * (d + np.sum(felms * psi, axis=1)) / trace)[:, None] * psi
        bolder = bolder - (2.1e-4 * (d + np.sum(bolder * psi, axis=1)) / trace)[:, None] * psi
        if k % 500 == 499:
            for name, weights in (("FeRLS", ferls), ("FeLMS", felms), ("bolder", bolder)):
                kept[name].append(weights.copy())
    final = steady.weights[0]
    lms, step = (settled_from(np.stack(kept[name], axis=1), final) for name in ("FeLMS", "bolder"))
    rls = [settled_from(np.stack([each[v] for each in kept["FeRLS"]], axis=1), final) for v in range(4)]

    def ratio(slow, fast):
        return np.exp(np.log(slow / fast)[:, 3:].mean())

    naive = [ratio(lms, each) for each in rls] + [ratio(step, rls[0])]
    settings = [{"memory_s": m, "initial_covariance": s} for m, s in zip(memories, starts, strict=True)]
    cases = [convergence.Case("FeLMS"), *(convergence.Case("FeRLS", **each) for each in settings)]
    cases.append(convergence.Case("FeLMS", step_size=convergence.EQUAL_STEP))
    plain, *others, quick = convergence.repeat_all(cases, seed=5, runs=8, duration_s=SECONDS)
    ours = [convergence.speed_up(convergence.pair(plain, each))[0] for each in others]
    ours.append(convergence.speed_up(convergence.pair(quick, others[0]))[0])
    assert ours == pytest.approx(naive, rel=0.2)  # other floors: a run of one scatters by a tenth
    assert naive[1] < 1.6 < 2 < naive[2] < 3 < 7 < naive[3]


def test_scatter_is_compared_in_the_logarithm():
    above, below = np.full((3, 9), 4.0), np.full((3, 9), 2.0)
    above[1], below[1] = 8.0, 2.0
    ours, (low, high) = convergence.scatter_ratio(above, below)
    assert ours == pytest.approx(2 ** (4 / 3)) and low < ours < high


def test_a_speed_up_is_the_geometric_mean_of_w4_to_w9():
    felms, ferls = np.full((2, 9), 100.0), np.full((2, 9), 1.0)
    felms[:, 3:] = 6.0
    ferls[:, 3:6], ferls[1, 8] = 2.0, 9.0
    study = Study(0, {"FeLMS tau": felms, "FeRLS tau": ferls})
    expected = np.sqrt(np.array([3**3 * 6**3, 3**3 * 6**2 * 6 / 9]).prod() ** (1 / 6))
    assert convergence.speed_up(study)[0] == pytest.approx(expected)
    assert convergence.faster_each(study)[0] == 0.5
