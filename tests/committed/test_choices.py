"""Committed combinations are of the committed axes, and what the code gives now is what stands there."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from committed.again import compute_again
from workbook import paths
from workbook.choices.axes import Axis, Multiverse, load_axes
from workbook.choices.checking import moves, note, parts_a_day, today
from workbook.choices.command import robustness_of
from workbook.choices.kept import read_settings, settings_text
from workbook.choices.results import read_results
from workbook.choices.running import design
from workbook.choices.settings import joint_settings, printed_entries
from workbook.choices.windows import search_window, searches
from workbook.claims import load_entries

PARTS = 4  # tests that share the studies of a topic, for workers to take


def studies(topic: str) -> list[Multiverse]:
    """Those of a topic whose combinations were run; none of a topic that has not got so far."""
    return load_axes(topic)[1] if paths.data(topic, "choices.csv").exists() else []


@pytest.mark.parametrize("topic", paths.topics())
def test_they_are_of_these_axes(topic):
    found = {each.multiverse.study: each for each in read_results(studies(topic))}
    other = [
        each.study
        for each in studies(topic)
        if each.study not in found or found[each.study].design != design(each)
    ]
    if other:
        pytest.fail(
            f"choices.toml has other axes than the values of {', '.join(other)}; "
            f'run make choices ARGS="{topic} --changed"',
            pytrace=False,
        )


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("topic", paths.topics())
def test_those_whose_turn_it_is_today_come_out_again(topic, part):
    found = []
    for before in read_results(studies(topic)[part::PARTS]):
        now, tried = compute_again(before, today(), parts_a_day())
        moved = {at: lines for at in tried if (lines := moves(before, now, [at], load_entries(topic)))}
        note(before.multiverse, moved)
        if moved:
            found += [line for at in sorted(moved) for line in moved[at]]
            found.append(f'run make choices ARGS="{topic} --study {before.multiverse.study}"')
    if found:
        pytest.fail("\n".join(found), pytrace=False)


@pytest.mark.parametrize("topic", paths.topics())
def test_every_axis_that_moves_an_entry_says_so(topic):
    moved = {name: standing.undeclared for name, standing in robustness_of(topic).items()}
    assert not {name: axes for name, axes in moved.items() if axes}


def notebook_of(multiverse: Multiverse) -> Path | None:
    """The notebook whose defaults a study has: itself, or the one beside its module."""
    module, colon, _ = multiverse.function.partition(":")
    stem = module.rpartition("." if colon else "/")[2]
    found = (paths.root() / "notebooks" / multiverse.topic).glob("*.ipynb")
    return next((file for file in found if stem in (file.stem, file.stem[3:].replace("-", "_"))), None)


def names(line: str, axis: Axis, option: str) -> bool:
    """Whether a line that speaks of joint settings names the option: its number, or a word of it or of the choice's name."""
    if all(isinstance(each, int | float) and not isinstance(each, bool) for each in axis.options):
        numbers = map(float, re.findall(r"\d+\.?\d*(?:e[+-]?\d+)?", line))
        return any(math.isclose(float(option), each) for each in numbers)
    words = re.findall(r"[a-z]{4,}|\d+", f"{option} {axis.name}".lower())
    return option in line or bool(set(words) & set(re.findall(r"[a-z]{4,}|\d+", line.lower())))


@pytest.mark.parametrize("topic", paths.topics())
def test_a_notebook_whose_default_loses_numbers_names_the_joint_setting(topic):
    """In a line on joint settings, or in a sentence that it or its module computes from settings.csv."""
    kept, missing = read_settings(topic), set()
    for multiverse in studies(topic) if kept else ():
        if (file := notebook_of(multiverse)) is None:
            continue
        module = file.with_name(file.stem[3:].replace("-", "_") + ".py")
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        text = "\n".join("".join(cell["source"]) for cell in cells)
        text += module.read_text(encoding="utf-8") if module.exists() else ""
        said = [line for line in text.split("\n") if re.search(r"joint settings?\b|settings\.csv", line)]
        for axis in multiverse.axes:
            option, default = kept.best[axis.name], axis.texts[axis.default_index]
            mine = [each for each in kept.settings if (each.axis, each.option) == (axis.name, default)]
            computed = re.search(r"read_joint|wanted\(", text) and f'"{axis.name}"' in text
            if (
                mine[0].agree < kept.agree
                and not computed
                and not any(names(line, axis, option) for line in said)
            ):
                missing.add(
                    f"{topic}/{file.stem}: {axis.name} is not {option}, the joint setting; say why there"
                )
    assert not missing, "\n".join(sorted(missing))


SETTINGS = [topic for topic in paths.topics() if paths.data(topic, "settings.csv").exists()]
BY_SETTINGS = 'run make settings ARGS="{}"'


@pytest.mark.parametrize("topic", SETTINGS)
def test_settings_are_those_of_these_combinations(topic):
    """The windows are kept; what follows from them and from the combinations is found again."""
    kept = read_settings(topic)
    if settings_text(joint_settings(topic, kept.windows)) != settings_text(kept):
        pytest.fail(f"settings.csv is of other combinations; {BY_SETTINGS.format(topic)}", pytrace=False)


@pytest.mark.parametrize("topic", SETTINGS)
def test_the_window_whose_turn_it_is_today_comes_out_again(topic):
    tasks = list(searches(studies(topic), printed_entries(topic)).values())
    kept = read_settings(topic).windows
    assert {each.axis for each in kept} == {axis.name for _, axis, _, _ in tasks}, BY_SETTINGS.format(topic)
    for multiverse, axis, point, entries in tasks[today() % len(tasks) :][:1] if tasks else ():
        texts = {each.name: each.texts[k] for each, k in zip(multiverse.axes, point, strict=True)}
        for name, pieces in search_window(multiverse, axis, point, entries).items():
            mine = [each for each in kept if (each.axis, each.number) == (axis.name, name)]
            (before,) = [each for each in mine if dict(each.others).items() <= texts.items()]
            assert np.ravel(before.pieces) == pytest.approx(np.ravel(pieces), rel=1e-4), name
