"""``make release``: wheel, site and archive in ``build/release``, the wheel tried as a stranger would."""

import contextlib
import hashlib
import io
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import venv
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import yaml

import stillwork
from stillwork.base.checks import InputError
from workbook import paths, publish
from workbook.provenance import commit, modified
from workbook.site.build import build_site
from workbook.site.metadata import project

# Tests of the toolbox that need nothing of a checkout but themselves.
STRANGER = ("algebra", "checks", "criteria", "digital", "examples", "records", "rounding", "spectra")


def release() -> int:
    """Write the release of the commit at hand; returns 1 when a test of the wheel failed or a link is broken.

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
    (name,) = (name for name in files if name.endswith(".whl"))
    if committed() != of:
        raise InputError(f"{of} was checked out when the release began, {commit()} is now; begin again")
    print(f"{name}: installed beside nothing of the checkout, its tests:", flush=True)
    if failed := try_wheel(name, files[name], files[f"stillwork-{version}.tar.gz"]):
        return failed
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
            "a release is made of a commit, and git knows none here; use a clone of the repository"
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


def try_wheel(name: str, content: bytes, source: bytes) -> int:
    """Install a wheel into a fresh environment and run its tests there; returns pytest's exit code."""
    with installed(name, content, source) as tested:
        return tested(STRANGER)


@contextlib.contextmanager
def installed(name: str, content: bytes, source: bytes) -> Iterator[Callable[[tuple[str, ...]], int]]:
    """A fresh environment with a wheel; runs tests of `tests/shared` there, by name, and returns pytest's exit code.

    Its requirements are lent by the environment at hand, so that this needs no network; of the checkout it sees a
    copy of the tests alone.

    Parameters
    ----------
    name : str
        Of the wheel.
    content, source : bytes
        The wheel, and the archive that the tests come from.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / name).write_bytes(content)
        venv.create(place / "venv", with_pip=True)
        python = place / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
        alone = {
            key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "STILLWORK_"))
        }
        install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", str(place / name)]
        subprocess.run([python, *install], check=True, env=alone)
        _lend(python, alone)
        with tarfile.open(fileobj=io.BytesIO(source)) as whole:
            inside = [
                each
                for each in whole.getmembers()
                if each.name.partition("/")[2] == "pyproject.toml" or "/tests/" in each.name
            ]
            whole.extraction_filter = getattr(tarfile, "data_filter", None)  # none before Python 3.11.4
            whole.extractall(place / "source", inside)
        (checkout,) = (place / "source").iterdir()
        quiet = [f"-pno:{each}" for each in ("nbval", "anyio", "cacheprovider")]

        def tested(names: tuple[str, ...]) -> int:
            tests = [f"tests/shared/test_{each}.py" for each in names]
            command = [python, "-P", "-m", "pytest", *tests, *quiet]
            return subprocess.run(command, cwd=checkout, env=alone).returncode

        yield tested


def _lend(python: Path, environment: dict[str, str]) -> None:
    """Let a fresh environment see the packages of this one, behind its own, without the library of the checkout."""
    ask = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    done = subprocess.run(ask, check=True, env=environment, stdout=subprocess.PIPE, text=True)
    packages = Path(done.stdout.strip())
    # By a link: Python reads the file in the locale's encoding, which may not know the letters of the path.
    (packages / "lent").symlink_to(sysconfig.get_path("purelib"))
    (packages / "lent.pth").write_text("lent\n")
