"""What a release refuses and holds."""

import io
import subprocess
import tarfile

import pytest

from benchmarks import release
from workbook.checks import InputError


@pytest.fixture
def workbook(tmp_path, monkeypatch):
    """A checkout that states its version in each of the files that do."""
    (tmp_path / "data").mkdir()
    (tmp_path / ".gitignore").write_text("build/\n")
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "toy"\nversion = "0.1.0"\n')
    (tmp_path / "CITATION.cff").write_text("version: 0.1.0\n")
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 0.1.0 (unreleased)\n\n- All.\n")
    (tmp_path / "codecheck.yml").write_text("---\npaper:\n  title: toy\n  authors:\n    - name: A\n")
    run = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(tmp_path)]
    for command in (["init", "-q"], ["add", "-A"], ["commit", "-q", "-m", "all"]):
        subprocess.run([*run, *command], check=True)
    monkeypatch.setenv("STILLWORK_ROOT", str(tmp_path))
    return tmp_path


def test_what_is_not_committed_is_not_released(workbook):
    (workbook / "CITATION.cff").write_text("version: 0.1.0\ntitle: toy\n")
    with pytest.raises(InputError, match=r"^CITATION\.cff\b"):
        release.release()


def test_a_tree_that_changes_while_the_release_is_made_is_not_released(workbook, monkeypatch):
    change = {}
    monkeypatch.setattr(release.stillwork, "__version__", "0.1.0")
    monkeypatch.setattr(release, "build_site", lambda: change["now"]())
    monkeypatch.setattr(release, "wheel", lambda root: {"toy.whl": b""})
    monkeypatch.setattr(release, "zipped", lambda folder, name: b"")
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(workbook)]
    change["now"] = lambda: subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "more"]).returncode
    with pytest.raises(InputError, match=r"[0-9a-f]{40}.*[0-9a-f]{40}"):
        release.release()
    assert not (workbook / "build/release").exists()
    change["now"] = lambda: bool((workbook / "new.py").write_text(""))
    with pytest.raises(InputError, match=r"^new\.py\b"):
        release.release()
    (workbook / "new.py").unlink()
    change["now"] = lambda: 0
    assert release.release() == 0
    assert (workbook / "build/release/SHA256SUMS").is_file()


@pytest.mark.parametrize(
    ("file", "text"), [("CITATION.cff", "version: 0.2.0\n"), ("CHANGELOG.md", "# Changelog\n\n## 0.2.0\n")]
)
def test_versions_that_differ_are_found(workbook, file, text):
    assert release.same_version() == "0.1.0"
    (workbook / file).write_text(text)
    with pytest.raises(InputError, match=rf"^{file}\b.*0\.2\.0.*pyproject\.toml.*0\.1\.0"):
        release.same_version()


def test_an_archive_holds_what_is_committed_and_has_the_same_bytes_twice(workbook):
    (workbook / "not-committed").write_text("")
    content = release.archive("0.1.0")
    assert content == release.archive("0.1.0")
    with tarfile.open(fileobj=io.BytesIO(content)) as whole:
        names = {each.name for each in whole.getmembers() if each.isfile()}
    wanted = {".gitignore", "pyproject.toml", "CITATION.cff", "CHANGELOG.md", "codecheck.yml"}
    assert names == {f"stillwork-0.1.0/{name}" for name in wanted}
