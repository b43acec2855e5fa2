import numpy as np
import pytest

from stillwork.fixedpoint import asin_trajectory, load_oscillator


@pytest.fixture(scope="session")
def models():
    return load_oscillator()


@pytest.fixture(scope="session")
def exact(models):
    return models["exact"].plant


@pytest.fixture(scope="session")
def approximate(models):
    return models["approximate"].plant


@pytest.fixture(scope="session")
def short():
    """A trajectory long enough for every filter to settle, short enough for a naive twin."""
    return asin_trajectory(duration=0.6)


@pytest.fixture
def rng():
    return np.random.default_rng(20221201)
