"""Spoiled TOML and JSON: models that a reader changes, the ledger, what builds found."""

import json
import tomllib
from pathlib import Path

import numpy as np
import tomlkit

from experiments.fixedpoint.oscillator import load_oscillator
from experiments.isolation.twin import load_twin
from fuzzing.hostile import wrong
from stillwork.design.inspect import inspect_file
from workbook import paths
from workbook.claims import ledger, load_entries

# A TOML file holds no other kinds.
PLAIN = (
    0,
    -1,
    1.5,
    1e300,
    float("nan"),
    float("inf"),
    10**400,
    "text",
    "",
    True,
    [],
    [1, 2],
    [[1.0]],
    ["a"],
    {},
    {"a": 1},
)


def case(rng: np.random.Generator) -> tuple:
    """A shipped file with one or two spoiled values, or damaged text, for its reader."""
    readers = {
        "load_twin": ("isolation", ("rigid_body.toml", "fitted.toml"), load_twin),
        "load_oscillator": ("fixedpoint", ("oscillator.toml",), load_oscillator),
        "inspect": ("isolation", ("rigid_body.toml", "fitted.toml"), inspect_file),
        "entries": ("worstcase", ("published.toml",), lambda _: load_entries("worstcase")),
        "ledger": ("worstcase", ("claims.json",), lambda _: ledger(Path("figures"), "worstcase")),
    }  # fmt: skip
    names = list(readers)
    name = names[rng.integers(len(names))]
    topic, files, read = readers[name]
    file = files[rng.integers(len(files))]
    content = _spoiled(rng, topic, file)

    def call():
        place = _checkout(topic, file)
        place.write_bytes(content)
        original, paths.root = paths.root, lambda: Path.cwd()
        try:
            read(str(place))
        finally:
            paths.root = original

    return f"{name} of {file}", [content[:0]], False, call


def _checkout(topic: str, file: str) -> Path:
    """The place of a file in a workbook of its own, in the present folder, beside the files that it needs."""
    folder = Path("figures", topic, "01-found") if file.endswith(".json") else Path("data", topic)
    folder.mkdir(parents=True, exist_ok=True)
    if file.endswith(".json"):
        Path("data", topic).mkdir(parents=True, exist_ok=True)
        Path("data", topic, "published.toml").write_bytes(paths.data(topic, "published.toml").read_bytes())
    return folder / file


def _spoiled(rng, topic: str, file: str) -> bytes:
    if file.endswith(".json"):
        names = list(load_entries(topic))
        tree = {name: {"ours": 1.0, "interval": [0.5, 1.5]} for name in rng.choice(names, 3, replace=False)}
        text = json.dumps(_changed(rng, tree), default=str)
    else:
        source = paths.data(topic, file).read_text(encoding="utf-8")
        tree = _changed(rng, tomllib.loads(source))
        try:
            text = tomlkit.dumps(tree)
        except Exception:  # what TOML cannot express
            text = source
    data = bytearray(text.encode())
    if rng.random() < 0.3:
        place = int(rng.integers(len(data) or 1))
        data[place : place + int(rng.integers(1, 30))] = bytes(
            rng.integers(0, 256, rng.integers(0, 3)).tolist()
        )
    return bytes(data)


def _changed(rng, tree):
    """The tree with one or two of its values, at any depth, replaced, left out or renamed."""
    tree = json.loads(json.dumps(tree, default=str))
    for _ in range(rng.integers(1, 3)):
        branch = tree
        while isinstance(branch, dict) and branch:
            key = list(branch)[rng.integers(len(branch))]
            if isinstance(branch[key], dict) and branch[key] and rng.random() < 0.85:
                branch = branch[key]
                continue
            action = rng.integers(4)
            if action == 0:
                del branch[key]
            elif action == 1:
                branch[f"{key}x"] = branch.pop(key)
            else:
                value = wrong(rng, branch[key]) if action == 2 else None
                branch[key] = (
                    value if isinstance(value, int | float | str) else PLAIN[rng.integers(len(PLAIN))]
                )
            break
    return tree if rng.random() < 0.97 else PLAIN[rng.integers(len(PLAIN))]
