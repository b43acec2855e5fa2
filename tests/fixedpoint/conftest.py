import numpy as np
import pytest

from experiments.fixedpoint import load_oscillator
from notebooks.fixedpoint.your_plant import load_models
from stillwork.control import asin_trajectory


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
def arm():
    return load_models("arm.py")


@pytest.fixture(scope="session")
def short():
    """A trajectory long enough for every filter to settle, short enough for a naive twin."""
    return asin_trajectory(duration=0.6)


@pytest.fixture
def rng():
    return np.random.default_rng(20221201)
