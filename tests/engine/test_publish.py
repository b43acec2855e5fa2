"""Whole or not at all, also when the swap itself is cut short."""

import os
import shutil
from pathlib import Path

import pytest

from workbook.publish import (
    RECORD,
    read_record,
    replace_record,
    tidy,
)

OLD = {"a.csv": b"old"}
NEW = {"a.csv": b"new", "deep/b.csv": b"b"}


def content(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class Killed(BaseException):
    """Stands for SIGKILL: no handler of the code under test may take it for an error."""


STEPS = ("mkdir", "write_bytes", "rename", "unlink")


def cut_after(monkeypatch, steps: int) -> None:
    """Let this many changes of the file system happen, then nothing any more: neither repairs nor removals."""
    done = []

    def counted(call):
        def step(*arguments, **options):
            done.append(call)
            if len(done) > steps:
                raise Killed
            return call(*arguments, **options)

        return step

    for name in STEPS:
        monkeypatch.setattr(Path, name, counted(getattr(Path, name)))
    monkeypatch.setattr("workbook.publish.shutil.rmtree", counted(shutil.rmtree))


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
        tidy(target)  # as the next build does
        found = {name: text for name, text in content(target).items() if name != RECORD}
        inputs, complaints = read_record(target)
        assert complaints == []
        assert (found, inputs) in ((OLD, {"cell a": "1"}), (NEW, {"cell a": "2"}))
        seen.add(inputs["cell a"])
        assert os.listdir(target.parent) == ["notebook"]
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
        (lambda folder: (folder / RECORD).write_text('{"inputs": 1}'), "its record is damaged"),
        (lambda folder: link_to_nowhere(folder / "a.csv"), "output a.csv was changed by hand"),
    ],
)
def test_what_is_not_as_it_was_written_is_named(tmp_path, harm, complaint):
    target = tmp_path / "notebook"
    assert read_record(target) is None
    replace_record(target, NEW, {})
    harm(target)
    assert read_record(target)[1] == [complaint]
