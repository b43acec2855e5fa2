"""``make release``: wheel, site and archive in ``build/release``; `make test` tries the wheel as a stranger would."""

import hashlib
import io
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import yaml

import stillwork
from workbook import paths, publish
from workbook.checks import InputError
from workbook.provenance import commit, modified
from workbook.site.build import build_site
from workbook.site.metadata import project


def release() -> int:
    """Write the release of the commit at hand; returns 1 when a link is broken.

    Raises
    ------
    InputError
        Without a commit, when something is not committed or changes meanwhile, or when the versions of the metadata differ.
    """
    of = committed()
    version = same_version()
    if build_site():
        return 1
    files = {
        **wheel(paths.root()),
        f"stillwork-{version}.tar.gz": archive(version),
        f"stillwork-{version}-site.zip": zipped(paths.root() / "build/site", f"stillwork-{version}-site"),
    }
    if committed() != of:
        raise InputError(f"{of} was checked out when the release began, {commit()} is now; begin again")
    sums = "".join(f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in files.items())
    target = paths.root() / "build/release"
    publish.replace_folder(target, {**files, "SHA256SUMS": sums.encode()})
    print(f"{target}:")
    for name, content in files.items():
        print(f"  {name}  {len(content) / 1e6:.1f} MB")
    print(f"of commit {of}; what is left to a person stands in CONTRIBUTING.md under Release")
    return 0


def committed() -> str:
    """The commit that is checked out, of which nothing is changed."""
    if (checked_out := commit()) is None:
        raise InputError(
            "a release is made from a commit, and git has none here; use a clone of the repository"
        )
    if changed := sorted(name for name in modified() if not name.startswith("build/")):
        raise InputError(f"{changed[0]} is not committed, and {len(changed)} in all; commit before a release")
    return checked_out


def same_version() -> str:
    """The version, which every file that states one must state alike."""
    citation = yaml.safe_load((paths.root() / "CITATION.cff").read_text(encoding="utf-8"))
    changes = (paths.root() / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (\S+)", changes, re.MULTILINE)
    stated = {
        "pyproject.toml": project()["version"],
        "CITATION.cff": str(citation["version"]),
        "lib/stillwork/__init__.py": stillwork.__version__,
        "CHANGELOG.md": headings[0] if headings else "none",
    }
    version = stated["pyproject.toml"]
    for file, other in stated.items():
        if other != version:
            raise InputError(f"{file} states version {other}, pyproject.toml {version}; make them one")
    return version


def wheel(root: Path) -> dict[str, bytes]:
    """The wheel by its name."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
        subprocess.run(command, cwd=root, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return {file.name: file.read_bytes() for file in Path(folder).glob("*.whl")}


def archive(version: str) -> bytes:
    """All that is committed, as a tar file; the same bytes for the same commit."""
    command = ["git", "-c", "tar.tar.gz.command=gzip -cn", "archive", "--format=tar.gz"]
    done = subprocess.run(
        [*command, f"--prefix=stillwork-{version}/", "HEAD"],
        cwd=paths.root(),
        check=True,
        stdout=subprocess.PIPE,
    )
    return done.stdout


def zipped(folder: Path, name: str) -> bytes:
    """A folder as a zip file, the same bytes for the same files."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as whole:
        for file in sorted(file for file in folder.rglob("*") if file.is_file()):
            path = f"{name}/{file.relative_to(folder).as_posix()}"
            whole.writestr(zipfile.ZipInfo(path), file.read_bytes(), zipfile.ZIP_DEFLATED)
    return content.getvalue()


if __name__ == "__main__":
    try:
        sys.exit(release())
    except InputError as error:
        sys.exit(f"release: {error}")
