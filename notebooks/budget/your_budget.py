"""Your budget: a machine's TOML, its budget, and an explorer over its floor, sensor and bandwidth."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.budget.waterfall import paint_waterfall
from stillwork.base.toml_files import read_toml
from stillwork.control.budget_sources import criterion_floor
from stillwork.control.error_budget import Source, UnstableLoop, error_budget
from stillwork.control.floor_machine import FloorMachine
from stillwork.control.pid import Pid, PidFamily
from stillwork.design.budget import machine_of, new_budget, sources_of
from workbook import figures


def open_machine(
    file: str, floor: str, folder: str
) -> tuple[FloorMachine, list[Source], tuple[float, float]]:
    """Machine, sources and band of a TOML; the template of the wafer-like stage, written to `folder`, without one."""
    if not file:
        new_budget(folder)
        file = f"{folder}/wafer-stage.toml"
    entries = read_toml(file)
    built = machine_of(entries)
    low, high = entries["band_hz"]
    rate = 1 / built.sample_time if built.sample_time else 0.0
    return (
        built,
        sources_of(entries, floor, Path(file).parent, rate, built.stage_mass),
        (float(low), float(high)),
    )


def promised_and_kept(built: FloorMachine, sources: list[Source], band: tuple[float, float]) -> float:
    """Largest distance between what halving a source is said to save and what it saves, over the error."""
    network = built.network()
    budget = error_budget(network, sources, band)
    distances = []
    for k, source in enumerate(sources):
        better = [*sources]
        if source.density is None:
            tones = tuple((tone[0], *(size / 2 for size in tone[1:])) for tone in source.tones)
            better[k] = replace(source, tones=tones)
        else:
            better[k] = replace(source, density=lambda f, old=source.density: old(f) / 4)
        kept = budget.rms[0] - error_budget(network, better, band).rms[0]
        distances.append(abs(kept - budget.saved()[k, 0]) / budget.rms[0])
    return max(distances)


def explore_own(built: FloorMachine, sources: list[Source], band: tuple[float, float]):
    """Drawing function of the explorer: the machine's waterfall on a floor class, at another bandwidth and sensor."""

    def draw(floor: str, bandwidth: float, sensor: float, feedforward_db: float):
        others = [source for source in sources if source.places != ("floor",)]
        louder = [
            replace(s, density=lambda f, old=s.density: sensor**2 * old(f))
            if s.places == ("stage sensor",) and s.density
            else s
            for s in others
        ]
        law = built.controller
        if isinstance(law, Pid):
            law = PidFamily(built.stage_mass)(bandwidth * law.differentiator * 3 / (2 * np.pi))
        steps = {
            "passive": {"skyhook": 0.0, "feedforward": 0.0},
            "and skyhook": {"feedforward": 0.0},
            "and feedforward": {"feedforward": 1 - 10 ** (-feedforward_db / 20)},
        }
        budgets = {}
        for name, step in steps.items():
            try:
                network = replace(built, controller=law, **step).network()
            except UnstableLoop:
                continue
            budgets[name] = error_budget(network, [criterion_floor("floor", "floor", floor), *louder], band)
        if not budgets:
            figure, axes = figures.new(height=3.2)
            axes.set(title="unstable; lower the bandwidth", xlabel="methods", ylabel="error, rms (nm)")
            return figure
        return paint_waterfall(
            budgets, f"{floor}, {bandwidth:.2g} times the bandwidth, {sensor:.2g} times the sensor's noise"
        )

    return draw
