"""The code of `docs/with-python-control.md` runs as it stands there."""

import re

import pytest

from workbook import paths

PAGE = (paths.root() / "docs/with-python-control.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_code_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))
    exec(compile(code, "with-python-control.md", "exec"), {})
    said = capsys.readouterr().out
    assert f"{1 / (2 * 0.01 * (1 - 0.01**2) ** 0.5) / 400:.6f}" in said  # the resonance's peak in closed form
    assert (tmp_path / "stage.npz").is_file()
