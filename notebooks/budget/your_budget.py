"""Your budget: a machine's TOML, its budget, and an explorer over its floor, sensor and bandwidth."""

from dataclasses import replace
from tempfile import TemporaryDirectory

import numpy as np

from experiments.budget.waterfall import paint_waterfall
from stillwork.control.budget import ErrorBudget, UnstableLoop, error_budget
from stillwork.control.budget_sources import criterion_floor
from stillwork.control.pid import Pid, PidFamily
from stillwork.machine.budget import nanometres
from stillwork.machine.budget_tables import MachineFile, open_machine
from stillwork.machine.isolate import isolate_file
from stillwork.machine.machine_toml import new_machine
from workbook import figures, paths


def open_own(file: str, floor: str) -> MachineFile:
    """Machine, sources and band of a TOML; without one those of the template of the wafer-like stage."""
    with TemporaryDirectory() as folder:
        if not file:
            new_machine(f"{folder}/wafer-stage.toml")
        return open_machine(file or f"{folder}/wafer-stage.toml", floor)  # the template names no other file


def sources_table(budget: ErrorBudget):
    """A row a source: its rms and its share of the power."""
    from pandas import DataFrame

    rows = {
        name: (nanometres(rms), f"{100 * share:.1f} %")
        for name, rms, share in zip(
            budget.names, budget.rms_by_source[:, 0], budget.shares[:, 0], strict=True
        )
    }
    rows["all"] = nanometres(budget.rms[0]), ""
    return DataFrame.from_dict(rows, orient="index", columns=["rms", "of the power"])


def chain(rate: float = 2000.0) -> dict[str, ErrorBudget]:
    """The template's small stage on the shipped slab: passive, with the methods that its file assumes, and with `isolate`.

    From the response of the isolator in [isolator] and the record of the floor to a feedforward in C, and to the budget.
    """
    slab = str(paths.data("isolation", "slab_footfall/slab_vertical.csv"))
    with TemporaryDirectory() as folder:
        file, written = f"{folder}/machine.toml", f"{folder}/isolator"
        new_machine(file, "small-isolator")
        isolate_file(file, slab, written, rate)
        designed, assumed = (open_machine(file, slab, isolate=each) for each in (written, ""))
        machines = {
            "passive": replace(designed.machine, isolator=None),
            "as assumed": assumed.machine,
            "with isolate": designed.machine,
        }
        return {
            name: error_budget(each.network(), designed.sources, designed.band)
            for name, each in machines.items()
        }


def promised_and_kept(own: MachineFile) -> float:
    """Largest distance between what halving a source is said to save and what it saves, over the error."""
    network, sources, band = own.machine.network(), own.sources, own.band
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


def explore_own(own: MachineFile):
    """Drawing function of the explorer: the machine's waterfall on a floor class, at another bandwidth and sensor."""
    built, sources, band = own.machine, own.sources, own.band

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
