import numpy as np
import pytest
from scipy import stats

from experiments.fixedpoint import PUBLISHED_CASES, Noise


@pytest.mark.parametrize("kind", ["gaussian", "logistic", "logistic-scale"])
def test_distribution(kind, rng):
    noise = Noise(kind, 1e-4)
    drawn = noise.sample(rng, 200_000)
    if kind == "gaussian":
        law = stats.norm(scale=1e-4)
    else:
        law = stats.logistic(scale=1e-4 if kind.endswith("scale") else 1e-4 * np.sqrt(3) / np.pi)
    assert stats.kstest(drawn, law.cdf).pvalue > 1e-3
    assert noise.standard_deviation == pytest.approx(law.std(), rel=1e-12)


def test_encoder_rounds(rng):
    encoder = Noise("encoder", 1e-3)
    position = np.linspace(0, 1, 100_001)
    error = encoder.measure(position, rng) - position
    assert np.abs(error).max() <= 0.5e-3 + 1e-12
    assert error.std() == pytest.approx(encoder.standard_deviation, rel=1e-2)


def test_same_seed_same_noise():
    noise = PUBLISHED_CASES["large logistic"]
    first, second = (noise.sample(np.random.default_rng(5), 10) for _ in range(2))
    assert (first == second).all()
