"""Whole or not at all, also when the swap itself is cut short."""

import os
from pathlib import Path

import pytest

from stillwork.base.checks import InputError
from stillwork.workbook.publish import (
    RECORD,
    finish,
    read_record,
    recover,
    replace_all,
    replace_file,
    replace_folder,
    replace_record,
    tidy,
    unfinished,
)

OLD = {"a.csv": b"old"}
NEW = {"a.csv": b"new", "deep/b.csv": b"b"}


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_replaces_all_that_was_there(tmp_path):
    target = tmp_path / "room" / "notebook"
    replace_folder(target, {**OLD, "gone.csv": b""})
    replace_folder(target, NEW)
    assert content(target) == NEW
    assert os.listdir(target.parent) == ["notebook"]


def test_an_error_while_writing_leaves_the_old(tmp_path, monkeypatch):
    target = tmp_path / "notebook"
    replace_folder(target, OLD)
    write = Path.write_bytes

    def full(self, data):
        if data == b"b":
            raise OSError(28, "No space left on device")
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        replace_folder(target, NEW)
    with pytest.raises(OSError, match="No space"):
        replace_file(tmp_path / "notebook" / "a.csv", b"b")
    assert content(tmp_path) == {"notebook/a.csv": b"old"}


@pytest.mark.parametrize("cut", range(4))
def test_a_cut_swap_ends_with_one_whole_version(tmp_path, monkeypatch, cut):
    """Stop after each of: nothing, the first rename, the second, part of the old folder's removal."""
    target = tmp_path / "notebook"
    replace_folder(target, {**OLD, "c.csv": b"old"})
    steps = []
    rename = Path.rename

    class Killed(BaseException):
        pass

    def counted(self, *arguments):
        if len(steps) == cut:
            raise Killed
        steps.append(self)
        return rename(self, *arguments)

    def removal(folder, **_options):
        if cut == 3:
            (folder / "c.csv").unlink()
        if cut >= 2:
            raise Killed

    monkeypatch.setattr(Path, "rename", counted)
    monkeypatch.setattr("stillwork.workbook.publish.shutil.rmtree", removal)
    with pytest.raises(Killed):
        replace_folder(target, NEW)
    monkeypatch.undo()
    recover(target)
    assert content(target) == ({**OLD, "c.csv": b"old"} if cut < 2 else NEW)
    assert os.listdir(tmp_path) == ["notebook"]
    replace_folder(target, NEW)
    assert content(target) == NEW


def test_recovering_a_whole_folder_changes_nothing(tmp_path):
    target = tmp_path / "notebook"
    recover(target)
    assert os.listdir(tmp_path) == []
    replace_folder(target, OLD)
    recover(target)
    assert content(target) == OLD


class Killed(BaseException):
    """Stands for SIGKILL: no handler of the code under test may take it for an error."""


STEPS = ("mkdir", "write_bytes", "symlink_to", "rename", "unlink")


def cut_after(monkeypatch, steps: int) -> list[str]:
    """Let this many changes of the file system happen, then nothing any more: neither repairs nor removals."""
    done: list[str] = []

    def counted(name, call):
        def step(*arguments, **options):
            if len(done) >= steps:
                raise Killed
            done.append(name)
            return call(*arguments, **options)

        return step

    for name in STEPS:
        monkeypatch.setattr(Path, name, counted(name, getattr(Path, name)))
    monkeypatch.setattr(os, "replace", counted("replace", os.replace))
    monkeypatch.setattr("stillwork.workbook.publish.shutil.rmtree", counted("rmtree", lambda *_, **__: None))
    return done


def test_a_record_is_whole_old_or_new_wherever_it_is_cut(tmp_path, monkeypatch):
    target = tmp_path / "room" / "notebook"
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


def test_a_folder_that_stands_in_the_place_of_results_gives_way(tmp_path):
    target = tmp_path / "notebook"
    target.mkdir()
    (target / "mine.txt").write_text("x")
    replace_record(target, NEW, {})
    assert read_record(target) == ({}, [])
    assert set(content(target.resolve())) == {*NEW, RECORD}


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


def test_a_change_that_was_made_is_not_begun_again_when_its_journal_is_removed_in_part(tmp_path, monkeypatch):
    """A kill while the journal is removed: some of its files are gone by then."""

    def killed(folder, **_options):
        (folder / "gone.json").unlink(missing_ok=True)
        if not folder.is_dir():
            return
        raise Killed

    monkeypatch.setattr("stillwork.workbook.publish.shutil.rmtree", killed)
    with pytest.raises(Killed):
        replace_all(tmp_path, {"notebooks/a": b"1"})
    monkeypatch.undo()
    (tmp_path / "notebooks/a").write_bytes(b"written since")
    finish(tmp_path)
    assert content(tmp_path) == {"notebooks/a": b"written since"}
    assert not list(tmp_path.glob(".accepting*"))


def test_a_change_that_cannot_be_put_in_place_says_so_and_is_done_later(tmp_path):
    (tmp_path / "notebooks").write_text("in the way")
    with pytest.raises(InputError, match=r"accepted, but not all of it is in its place \(.*notebooks"):
        replace_all(tmp_path, {"figures/a": b"1", "notebooks/a": b"1"})
    assert unfinished(tmp_path)
    (tmp_path / "notebooks").unlink()
    finish(tmp_path)
    assert content(tmp_path) == {"figures/a": b"1", "notebooks/a": b"1"}
    assert not unfinished(tmp_path)


def test_many_files_change_as_one_wherever_it_is_cut(tmp_path, monkeypatch):
    before = {"notebooks/a": b"1", "figures/b": b"1", "figures/gone": b"1"}
    after = {"notebooks/a": b"2", "figures/b": b"2", "README": b"new"}
    changed = {**after, "figures/gone": None}

    def shelves():
        return {name: text for name, text in content(tmp_path).items() if not name.startswith(".")}

    seen = set()
    for steps in range(60):
        replace_all(tmp_path, {**before, "README": None})
        with monkeypatch.context() as patch:
            cut_after(patch, steps)
            try:
                replace_all(tmp_path, changed)
            except Killed:
                pass
            else:
                break
        finish(tmp_path)
        assert shelves() in (before, after)
        seen.add(shelves() == after)
        assert not list(tmp_path.glob(".accepting*"))
    assert seen == {False, True}
    assert shelves() == after
