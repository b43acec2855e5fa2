"""The doctor names every package that is not as pinned."""

from importlib import metadata

import pytest

from workbook.environment import doctor, drift, pins


@pytest.fixture
def pinned(tmp_path, monkeypatch):
    """Make a workbook with these pins."""
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))

    def write(*lines):
        blocks = [
            f"{line} \\\n    --hash=sha256:00 \\\n    --hash=sha256:11\n    # via x\n" for line in lines
        ]
        (tmp_path / "environment.txt").write_text("# compiled\n" + "".join(blocks), encoding="utf-8")

    return write


NUMPY = f"numpy=={metadata.version('numpy')}"


def test_reads_the_pins_that_hold_here(pinned):
    pinned(NUMPY, "old==1.0 ; python_version < '3'", "new==2.0 ; python_version > '3'", "odd-name==1.0.post1")
    assert pins() == {"numpy": metadata.version("numpy"), "new": "2.0", "odd-name": "1.0.post1"}


def test_names_what_drifted_and_what_is_missing(pinned, capsys):
    pinned("numpy==0.1", f"scipy=={metadata.version('scipy')}", "no-such-package==3.2")
    expected = [
        f"numpy is {metadata.version('numpy')} (pinned 0.1)",
        "no-such-package is missing (pinned 3.2)",
    ]
    assert drift() == expected
    assert doctor() == 1
    printed = capsys.readouterr().out
    assert all(f"DRIFT    {line}" in printed for line in expected)
    assert "1 of 3 packages" in printed
