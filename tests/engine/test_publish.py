"""Whole or not at all, also when the swap itself is cut short."""

import errno
import os
import shutil
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest

from workbook.checks import InputError
from workbook.publish import (
    RECORD,
    Edited,
    read_record,
    replace_all,
    replace_record,
    tidy,
)


@pytest.fixture(autouse=True)
def quick_disk(monkeypatch):
    """Nothing here waits for the disk."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


OLD = {"a.csv": b"old"}
NEW = {"a.csv": b"new", "deep/b.csv": b"b"}


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class Killed(BaseException):
    """Stands for SIGKILL: no handler of the code under test may take it for an error."""


STEPS = ("mkdir", "write_bytes", "symlink_to", "rename", "unlink", "rmdir")


def cut_after(monkeypatch, steps: int) -> list[str]:
    """Let this many changes of the file system happen, then nothing any more: neither repairs nor removals."""

    def killed(*_arguments):
        raise Killed

    rmtree = "workbook.publish.shutil.rmtree"
    monkeypatch.setattr(rmtree, lambda *_, **__: None)
    return before_step(monkeypatch, lambda step: step >= steps, killed, rmtree)


def before_step(
    monkeypatch, wanted: Callable[[int], bool], act: Callable, rmtree: str = "shutil.rmtree"
) -> list[str]:
    """Call `act` with the name and the arguments of a change of the file system before it happens."""
    done: list[str] = []

    def counted(name, call):
        def step(*arguments, **options):
            done.append(name)
            if wanted(len(done) - 1):
                act(name, *arguments)
            return call(*arguments, **options)

        return step

    for name in STEPS:
        monkeypatch.setattr(Path, name, counted(name, getattr(Path, name)))
    for name in ("replace", "link", "fsync"):
        monkeypatch.setattr(os, name, counted(name, getattr(os, name)))
    monkeypatch.setattr(rmtree, counted("rmtree", shutil.rmtree))
    return done


def test_a_record_is_whole_old_or_new_wherever_it_is_cut(tmp_path, monkeypatch):
    target = tmp_path / "topic" / "notebook"
    replace_record(target, OLD, {"cell a": "1"})
    seen = set()
    for steps in range(40):
        with monkeypatch.context() as patch:
            cut_after(patch, steps)
            try:
                replace_record(target, NEW, {"cell a": "2"})
            except Killed:
                pass
            else:
                break
        found = {name: text for name, text in content(target.resolve()).items() if name != RECORD}
        inputs, complaints = read_record(target)
        assert complaints == []
        assert (found, inputs) in ((OLD, {"cell a": "1"}), (NEW, {"cell a": "2"}))
        seen.add(inputs["cell a"])
        tidy(target)
        assert len(os.listdir(target.with_name(".notebook"))) == 1
        replace_record(target, OLD, {"cell a": "1"})
    assert seen == {"1", "2"}
    assert read_record(target) == ({"cell a": "2"}, [])


def link_to_nowhere(file: Path) -> None:
    file.unlink()
    file.symlink_to("nowhere")


@pytest.mark.parametrize(
    ("harm", "complaint"),
    [
        (lambda folder: (folder / "a.csv").unlink(), "output a.csv missing"),
        (lambda folder: (folder / "a.csv").write_text(""), "output a.csv was changed by hand"),
        (lambda folder: (folder / "deep/x").write_text(""), "output deep/x is not the build's"),
        (lambda folder: (folder / RECORD).unlink(), "its record is missing"),
        (lambda folder: (folder / RECORD).write_text('{"seal": 1}'), "its record is damaged"),
        (lambda folder: link_to_nowhere(folder / "a.csv"), "output a.csv was changed by hand"),
    ],
)
def test_what_is_not_as_it_was_written_is_named(tmp_path, harm, complaint):
    target = tmp_path / "notebook"
    assert read_record(target) is None
    replace_record(target, NEW, {})
    harm(target)
    assert read_record(target)[1] == [complaint]


def change(root: Path, after: dict[str, bytes | None]) -> None:
    """Make some files hold this, whatever stands there now."""
    there = {name: (root / name).read_bytes() if (root / name).exists() else None for name in after}
    replace_all(root, {name: (there[name], after[name]) for name in after})


BEFORE = {"notebooks/a": b"1", "figures/b": b"1", "figures/gone": b"1"}
AFTER = {"notebooks/a": b"2", "figures/b": b"2", "figures/new/c": b"new"}
CHANGED = {**AFTER, "figures/gone": None}


def accepted_files(root: Path) -> dict[str, bytes]:
    return {name: text for name, text in content(root).items() if "/." not in name}


def test_what_somebody_saves_meanwhile_stays_and_nothing_is_changed(tmp_path, monkeypatch):
    """At every step before the first file is put in its place."""
    for steps in count():
        shutil.rmtree(tmp_path)
        change(tmp_path, BEFORE)

        def save(step, *arguments):
            (tmp_path / "figures/b").write_bytes(b"mine")

        with monkeypatch.context() as patch:
            done = before_step(patch, steps.__eq__, save)
            try:
                change(tmp_path, CHANGED)
            except Edited as error:
                assert str(error) == "changed while accepting: figures/b; nothing was written, repeat"
            else:
                break
        assert "replace" not in done
        assert accepted_files(tmp_path) == {**BEFORE, "figures/b": b"mine"}
        assert not list(tmp_path.rglob(".*.accepting"))
    assert steps > 3 and done[steps] in ("replace", "unlink")


def test_a_file_in_the_place_of_a_folder_is_left_and_nothing_is_changed(tmp_path):
    (tmp_path / "notebooks").write_text("in the way")
    with pytest.raises(OSError, match="notebooks"):
        change(tmp_path, {"figures/a": b"1", "notebooks/a": b"1"})
    assert content(tmp_path) == {"notebooks": b"in the way"}


def test_a_disk_that_refuses_leaves_nothing_or_what_the_next_accept_completes(tmp_path, monkeypatch):
    seen = set()
    for steps in count():
        shutil.rmtree(tmp_path)
        change(tmp_path, BEFORE)

        def refuse(*_arguments):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        with monkeypatch.context() as patch:
            done = before_step(patch, steps.__eq__, refuse)
            try:
                change(tmp_path, CHANGED)
                outcome = "done"
            except InputError:
                outcome = "in part"
            except OSError:
                outcome = "nothing"
        if steps >= len(done):
            break
        if outcome == "in part":
            change(tmp_path, CHANGED)
        assert accepted_files(tmp_path) == (BEFORE if outcome == "nothing" else AFTER), (
            f"{steps} {done[steps]}"
        )
        seen.add(outcome)
    assert seen == {"nothing", "in part"}
