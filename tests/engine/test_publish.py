"""Whole or not at all, also when the swap itself is cut short."""

import errno
import io
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
        (lambda folder: (folder / RECORD).write_text("{}"), "its record is damaged"),
        (lambda folder: (folder / RECORD).write_text('{"seal": 1}'), "its record is damaged"),
        (lambda folder: (folder / RECORD).write_text("[" * 100_000), "its record is damaged"),
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


MINE = b" mine"


def edited(edit: Callable, file: Path) -> list[bytes | None]:
    """What stands there after an edit; nothing where it found nothing to remove."""
    if edit is remove and not file.exists():
        return []
    os.makedirs(file.parent, exist_ok=True)
    edit(file)
    return [file.read_bytes() if file.exists() else None]


def edit_in_place(file: Path) -> None:
    with file.open("ab") as stream:
        stream.write(MINE)


def edit_by_rename(file: Path) -> None:
    beside = file.with_name("~")
    with beside.open("wb") as stream:
        stream.write((file.read_bytes() if file.exists() else b"") + MINE)
    os.rename(beside, file)


def remove(file: Path) -> None:
    os.remove(file)


EDITS = (edit_in_place, edit_by_rename, remove)


@pytest.mark.slow
@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("name", [*CHANGED, "figures/own"])
def test_what_somebody_changes_meanwhile_stays_and_nothing_else_is_changed(tmp_path, monkeypatch, edit, name):
    """At every step, but for the moment between the last look and our rename."""
    seen, file = set(), tmp_path / name
    for steps in count():
        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
        change(tmp_path, {**BEFORE, "figures/own": b"1"})
        theirs: list[bytes | None] = []

        def act(step, *arguments, theirs=theirs):
            if step not in ("replace", "unlink") or file not in arguments:
                theirs += edited(edit, file)

        with monkeypatch.context() as patch:
            done = before_step(patch, steps.__eq__, act)
            try:
                change(tmp_path, CHANGED)
            except Edited as error:
                assert str(error) == f"changed while accepting: {name}; nothing was written, repeat"
                base = BEFORE
            else:
                base = AFTER
        if steps >= len(done):
            break
        wanted = {**base, "figures/own": b"1", **dict(zip([name], theirs, strict=False))}
        if base is AFTER and theirs and theirs[0] and name in AFTER:
            assert theirs[0].startswith(AFTER[name])  # on top of the new one
        assert accepted_files(tmp_path) == {each: text for each, text in wanted.items() if text is not None}
        assert not list(tmp_path.rglob(".*.accepting"))
        seen.add(base is AFTER)
    untouched = name == "figures/own" or (name == "figures/new/c" and edit is remove)
    assert seen == ({True} if untouched else {False, True})


def test_a_file_in_the_place_of_a_folder_is_left_and_nothing_is_changed(tmp_path):
    (tmp_path / "notebooks").write_text("in the way")
    with pytest.raises(OSError, match="notebooks"):
        change(tmp_path, {"figures/a": b"1", "notebooks/a": b"1"})
    assert content(tmp_path) == {"notebooks": b"in the way"}


ERRORS = (("once", errno.EMFILE), ("done", errno.EIO), ("from then on", errno.EROFS))
CHANGES = ("replace", "rename", "link", "unlink", "mkdir", "rmdir", "symlink", "fsync")
CALLS = {os: (*CHANGES, "open", "stat", "lstat", "scandir", "listdir", "readlink"), io: ("open",)}


def fail_at(monkeypatch, steps: int, number: int, how: str = "once") -> list[str]:
    """Let call number `steps` of the file system fail with this error: once, with its work done, or all from then on."""
    done: list[str] = []

    def counted(name, call):
        def step(*arguments, **options):
            done.append(name)
            if len(done) - 1 < steps or (len(done) - 1 > steps and how != "from then on"):
                return call(*arguments, **options)
            if how == "done" and name in ("replace", "rename"):
                call(*arguments, **options)
            raise OSError(number, os.strerror(number), str(arguments[:1]))

        return step

    for module, names in CALLS.items():
        for name in names:
            monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    return done


def outcome_of(call: Callable) -> str:
    try:
        call()
    except InputError:
        return "in part"
    except OSError:
        return "nothing"
    return "done"


@pytest.mark.slow
@pytest.mark.parametrize(("how", "number"), ERRORS)
def test_an_error_of_the_disk_leaves_a_change_as_it_says(tmp_path, monkeypatch, number, how):
    """Only where the disk refuses to take back, too, some files are new, and the message says so."""
    seen = set()
    for steps in count():
        shutil.rmtree(tmp_path)
        change(tmp_path, BEFORE)
        with monkeypatch.context() as patch:
            done = fail_at(patch, steps, number, how)
            outcome = outcome_of(lambda: change(tmp_path, CHANGED))
        if len(done) <= steps:
            break
        if outcome == "in part":
            change(tmp_path, CHANGED)
        assert accepted_files(tmp_path) == (BEFORE if outcome == "nothing" else AFTER), (
            f"{steps} {done[steps]}"
        )
        if how != "from then on":
            assert not list(tmp_path.rglob(".*.accepting")), f"{steps} {done[steps]}"
        seen.add(outcome)
    assert {"nothing"} <= seen <= ({"nothing", "in part"} if how == "from then on" else {"nothing", "done"})
