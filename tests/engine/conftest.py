import pytest

from engine import toy as toys


@pytest.fixture
def toy(tmp_path):
    """A small workbook of its own for one test."""
    made = toys.make(tmp_path)
    yield made
    toys.clean_up(made)
