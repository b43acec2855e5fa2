import pytest

from stillwork.control.machine_loops import reach
from stillwork.machine import machine_designs


@pytest.fixture
def untuned(monkeypatch):
    """Designs with the first settings of each use, as a search begins: a tenth of the time of one that tunes them."""

    def first_settings(machine, first, contained, search, on_step):
        return machine_designs._Reached(first, reach(machine, first, search))

    monkeypatch.setattr(machine_designs, "_furthest", first_settings)
