import sys
from pathlib import Path

import pytest
from hypothesis import settings

# As in `stillwork.__main__`: a second or two of every process that loads nbformat.
sys.modules.setdefault("rfc3987_syntax", None)

# The machine's load must not decide a test.
settings.register_profile("workbook", deadline=None)
settings.load_profile("workbook")


@pytest.fixture(autouse=True)
def as_a_person(monkeypatch):
    """Tests look at this checkout's library as a person does, unless they say otherwise."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1] / "lib"))
    monkeypatch.delenv("STILLWORK_OUTPUT", raising=False)
