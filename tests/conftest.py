import pytest
from hypothesis import settings

# The machine's load must not decide a test.
settings.register_profile("workbook", deadline=None)
settings.load_profile("workbook")


@pytest.fixture(autouse=True)
def not_in_batch(monkeypatch):
    """Tests look at the library as a person does, unless they say otherwise."""
    monkeypatch.delenv("STILLWORK_OUTPUT", raising=False)
