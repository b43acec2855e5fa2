"""Whole or not at all, also when the swap itself is cut short."""

import os
from pathlib import Path

import pytest

from stillwork.workbook.publish import recover, replace_file, replace_folder

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
