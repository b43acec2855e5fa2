"""Damping in a decoupled machine: what this notebook alone needs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy import linalg

from experiments.motion.decoupled_damping import added_damping, band_passed, constrained_damping
from experiments.motion.decoupling_pictures import paint_transfer_matrix
from experiments.motion.decoupling_schemes import (
    SCHEMES,
    Settings,
    low_frequency_slopes,
    off_diagonal_peak,
    oscillates_stably,
    sample_beam,
    scheme_gain,
    with_scheme,
)
from experiments.motion.designs import SIX, Design, stage_bandwidth
from experiments.motion.intervals import Values
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Infeasible
from stillwork.control.decoupling import decouple, decoupled_plant
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel
from workbook import proportion_interval, run_study
from workbook.studies import Study

PRINTED_SLOPES = {  # towards low frequency, of the entries (0, 1) and (1, 0), by scheme
    name: (0.0, 0.0)
    for name in SCHEMES
    if name not in ("each mode", "minimal interaction", "total actuation")
} | {"minimal actuation": (0.0, -1.0), "stiffness": (-2.0, -2.0), "stiffness, second order": (-1.0, -1.0)}
JUDGED = {  # of which scheme, and of which of the two entries
    "band-pass": ("band-passes", (0, 1)),
    "common-band-pass": ("common band-pass", (0, 1)),
    "minimal-actuation.first": ("minimal actuation", (0,)),
    "minimal-actuation.second": ("minimal actuation", (1,)),
    "over-actuation": ("over-actuation", (0, 1)),
    "combined": ("band-passes and over-actuation", (0, 1)),
    "stiffness": ("stiffness", (0, 1)),
    "stiffness-fourth-order": ("stiffness, fourth order", (0, 1)),
    "stiffness-over-actuation": ("stiffness, over-actuation", (0, 1)),
}


def worst_slopes(study: Study) -> dict[str, float]:
    """Of each judged scheme (`JUDGED`) the slope that is furthest from the printed one, without rounding's digits."""
    found = {}
    for claim, (name, entries) in JUDGED.items():
        slopes = np.stack([study[f"{name}: slopes"][:, k, 1 - k] for k in entries], axis=1).ravel()
        worst = slopes[np.argmax(np.abs(slopes - PRINTED_SLOPES[name][entries[0]]))]
        found[claim] = round(float(worst), 4) + 0.0
    return found


def minimal_order(gain: StateModel) -> int:
    """Order of a minimal realisation of a stable model, by the rank of its Hankel operator."""
    rate = np.abs(gain.poles).max()
    a = gain.a / rate
    # Of unit size: the rank is judged against rounding.
    b, c = (matrix / np.linalg.norm(matrix) for matrix in (gain.b, gain.c))
    reach = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    seen = linalg.solve_continuous_lyapunov(a.T, -c.T @ c)
    hankel = np.sqrt(np.maximum(linalg.eigvals(reach @ seen).real, 0))
    return int(np.count_nonzero(hankel > 1e-6 * hankel.max()))


def kept_out_trial(rng: np.random.Generator, settings: Settings) -> Mapping[str, np.ndarray]:
    """Over-actuation on one machine when the actuators decouple the first or the second flexible mode too.

    ``peaks``, shape (decoupled mode, damped mode): the largest off-diagonal entry around each damped mode over the
    undamped one.
    """
    machine = sample_beam(rng)
    rigid = machine.rigid_modes
    plant = machine.at(range(rigid + 1), range(rigid))
    gain = scheme_gain("over-actuation", plant, settings)
    damped = range(rigid, rigid + settings.damped)
    peaks = []
    for mode in damped:
        decoupling = decouple(plant, (*range(rigid), mode))
        system, bare = (decoupled_plant(plant, decoupling, part * gain) for part in (1, 0))
        frequencies = plant.frequencies[list(damped)]
        peaks.append([off_diagonal_peak(system, w) / off_diagonal_peak(bare, w) for w in frequencies])
    return {"peaks": np.array(peaks)}


FACTORS, SELECTIVITY = (1.05, 1.1, 1.2, 1.5), 2.0  # on the frequencies; Q of the band-passes


def stiff_bandwidths(selectivity: float, **stage) -> tuple[float, list[float]]:
    """Achievable bandwidth (Hz) of the stage by PID alone, and with active stiffness by factor, without and with band-pass.

    `stage` goes to `stage_bandwidth`; 0 where none is feasible.
    """
    reached = []
    for factor in FACTORS:
        for filtered in (None, selectivity):
            try:
                stiff = Design(Application(stiffness=factor, selectivity=filtered))
                reached.append(float(stage_bandwidth(stiff, **stage).crossing_hz.mean()))
            except Infeasible:
                reached.append(0.0)
    return float(stage_bandwidth("PID", **stage).crossing_hz.mean()), reached


def stiffness_values(alone: float, reached: list[float]) -> Values:
    """Conclusion 3.4 as the ledger has it."""
    return {"motion.conclusion-3-4.stiffness-bandwidth": float(np.mean(np.array(reached) <= 1.1 * alone))}


def stiffness(*, stage_damping: float, six: str, seed: int) -> Values:
    """The same for another stage or limit; it has no fast variant."""
    return stiffness_values(*stiff_bandwidths(SELECTIVITY, damping_ratio=stage_damping, limit=SIX[six]))


# === The appendix =================================================================================================

INDEX = ["161 Hz", "517 Hz", "760 Hz"]


def appendix(
    page,
    *,
    plants: Mapping[str, ModalModel],
    settings: Settings,
    systems: Mapping[str, StateModel],
    study: Study,
    drawn: Sequence[str],
    runs: int,
    seed: int,
) -> None:
    """What the page of motion/18 judges beside its answer."""
    _of_constraints(page, plants, settings, systems["undamped"])
    _of_stiffness(page, plants, settings, systems["undamped"])
    page.text("""## With the observer

Slopes off the diagonal between 0.03 and 0.3 Hz, with perfect estimates and with the previous notebook's Kalman observer:""")
    seen, rows = [name for name in SCHEMES if name != "total actuation"], {}  # there is nothing left there
    for name in seen:
        for who, observed in (("true states", False), ("Kalman", True)):
            system = with_scheme(name, plants[name], settings, observed)
            slopes = low_frequency_slopes(system, 0.03, 0.3)
            rows.setdefault(f"q1 from u2, {who}", []).append(slopes[0, 1])
            rows.setdefault(f"q2 from u1, {who}", []).append(slopes[1, 0])
    page.show(pd.DataFrame(rows, index=seen).round(2) + 0.0)
    _of_geometries(page, study, drawn, settings, runs, seed)


def _of_constraints(page, plants: Mapping[str, ModalModel], settings: Settings, undamped: StateModel) -> None:
    page.text(r"""## Gains under constraints

$\phi_{ai}^\top K_{dj}/(2\zeta_{des,j}\omega_j)$; the printed (4.18) and (4.20) lack the minus sign and would take damping away.
Minimal actuation (Fig. 4.18): two actuators leave the first rigid-body mode alone, but push the second. Over-actuation (Fig. 4.19):
with a third both stay free; $\Gamma$ no longer excites the first flexible mode, but the force that damps the second does, so its
peak returns. Total actuation (Fig. 4.20): five actuators for five modes; off the diagonal only rounding is left.""")
    machine, table = plants["total actuation"], {}
    for name in ("each mode", "minimal actuation", "over-actuation", "total actuation"):
        forces = plants[name].input_shapes @ scheme_gain(name, plants[name], settings)[:, 5::2]
        for j in range(settings.damped):
            wanted = 2 * settings.increase * machine.frequencies[2 + j]
            table[name, INDEX[j]] = forces[:, j] / wanted
    page.show(pd.DataFrame(table, index=["rigid 1", "rigid 2", *INDEX]).round(3) + 0.0)
    plant, three, five = (plants[name] for name in ("each mode", "over-actuation", "total actuation"))
    wanted, fed = _wanted(settings)
    minimal = decoupled_plant(plant, decouple(plant), constrained_damping(plant, wanted)[:, fed])
    drawn = {"undamped": undamped, "minimal actuation": minimal}
    page.save("fig-4-18", paint_transfer_matrix(drawn, slopes={(0, 1): 0, (1, 0): -1}, low_hz=0.1))
    free = decoupled_plant(three, decouple(three), constrained_damping(three, wanted)[:, fed])
    bare = decoupled_plant(three, decouple(three), np.zeros((3, fed.stop)))
    over = {"undamped": bare, "over-actuation": free}
    page.save("fig-4-19", paint_transfer_matrix(over, slopes={(0, 1): 0, (1, 0): 0}))
    alone = constrained_damping(five, wanted)[:, fed]
    original, total = (decoupled_plant(five, decouple(five), gain) for gain in (np.zeros_like(alone), alone))
    page.save("fig-4-20", paint_transfer_matrix({"undamped": original, "total actuation": total}))
    omega, off_diagonal = 2 * np.pi * np.geomspace(1.0, 2000.0, 400), ~np.eye(2, dtype=bool)
    response = total.frequency_response(omega)
    left = np.abs(response)[off_diagonal].max(axis=0) / np.abs(response)[~off_diagonal].min(axis=0)
    page.check("motion.section-4-3.total-actuation", round(float(left.max()), 10))  # what is left is rounding
    ratio = response[~off_diagonal] / original.frequency_response(omega)[~off_diagonal]
    page.check("motion.section-4-3.total-overlap", round(float(np.abs(ratio - 1).max()), 10))
    reached = added_damping(five, total)[0][: settings.damped] / settings.increase
    page.check("motion.section-4-3.total-damping", round(float(np.abs(reached - 1).max()), 8))
    turned = decoupled_plant(five, decouple(five), -alone)
    printed_sign = np.round(added_damping(five, turned)[0], 4) + 0.0
    page.show(f"added damping ratio with the printed sign: {printed_sign}")
    _of_both(page, three, over, settings)


def _wanted(settings: Settings) -> tuple[list[float], slice]:
    """Increase of the three flexible modes' damping ratios, and the states that are fed back."""
    increases = [settings.increase] * settings.damped + [0.0] * (3 - settings.damped)
    return increases, slice(0, 2 * (2 + settings.damped))


def _of_both(page, three: ModalModel, drawn: Mapping[str, StateModel], settings: Settings) -> None:
    page.text("""## Both together

Remark 4.3.4: three actuators keep the flexible modes from each other; the band-passes (4.16) keep them from the rigid body.""")
    wanted, fed = _wanted(settings)
    apart = constrained_damping(three, wanted, undisturbed=(2, 3, 4))[:, fed]
    both = decoupled_plant(three, decouple(three), band_passed(three, apart, settings.selectivity))
    page.save("combined", paint_transfer_matrix({**drawn, "both": both}, slopes={(0, 1): 0, (1, 0): 0}))
    forces = np.abs(three.input_shapes[2:] @ apart[:, np.any(apart, axis=0)])
    own = np.eye(len(forces), settings.damped, dtype=bool)
    left = forces[~own].max() / forces[own].min()
    page.check("motion.section-4-3.combined-internal", round(float(left), 10))  # what is left is rounding


def _of_stiffness(page, plants: Mapping[str, ModalModel], settings: Settings, undamped: StateModel) -> None:
    page.text(r"""## Active stiffness

A force proportional to the position of a mode, for $\kappa$ times its frequency,

$$K_{sj} = -(\phi_{aj}^\top)^\dagger\,(\kappa^2 - 1)\,\omega_j^2,\qquad \lim_{s\to0}s^2\,\frac{q}{u} = I + R\,K_s\,\big(\Omega^2 - F\,K_s\big)^{-1}\,\Theta$$

with the rows $\phi_{ai}^\top$ of the rigid body in $R$, of the flexible modes in $F$, and $\Omega^2 = \mathrm{diag}(\omega_j^2)$,
couples with slope -2 (Remark 4.3.5). A band-pass of second order leaves -1, one of fourth order 0. But it takes damping away: the
frequency moves above its centre, where its phase lags. By the wanted factor on the frequencies:""")
    stiff = {
        name: with_scheme(name, plants[name], settings) for name in SCHEMES if name.startswith("stiffness")
    }
    drawn = {
        "no feedback": undamped,
        "fourth-order band-pass (unstable)": stiff["stiffness, fourth order"],
        "active stiffness": stiff["stiffness"],
    }
    page.save("stiffness", paint_transfer_matrix(drawn, slopes={(0, 1): -2, (1, 0): -2}, low_hz=0.1))
    factors = {}
    for factor in (1.02, 1.05, 1.1, settings.stiffness_factor):
        changed = replace(settings, stiffness_factor=factor)
        found = [with_scheme(name, plants[name], changed) for name in stiff]
        factors[factor] = ["stable" if oscillates_stably(system) else "unstable" for system in found]
    page.show(pd.DataFrame(factors, index=list(stiff)))
    page.text("""Conclusion 3.4: on the stage of chapter 3 active stiffness does not significantly increase the bandwidth. We try four
factors on the frequencies, with and without band-pass.""")
    alone, reached = stiff_bandwidths(settings.selectivity)
    page.conclude(
        "None is feasible (PID alone reaches {alone:.1f} Hz): however slow the controller is, $S_I$ exceeds 6 dB at a resonance.",
        "{some} of {all} are feasible; PID alone reaches {alone:.1f} Hz.",
        when=not any(reached),
        alone=alone,
        some=sum(each > 0 for each in reached),
        all=len(reached),
    )
    for claim, ours in stiffness_values(alone, reached).items():
        page.check(claim, ours)


def _of_geometries(
    page, study: Study, drawn: Sequence[str], settings: Settings, runs: int, seed: int
) -> None:
    page.text("""## Over geometries

The off-diagonal peak over the undamped one, then the share of machines whose peak over-actuation raises, by the mode that the
actuators keep out:""")
    off_diagonal = ~np.eye(2, dtype=bool)
    low = {name: study[f"{name}: low"][:, off_diagonal].max(axis=1) for name in drawn}
    peak = {name: study[f"{name}: peak"] for name in drawn}
    filters = ("band-passes", "common band-pass")
    shift = {name: np.abs(study[f"{name}: shift"]) for name in filters}
    added, across = ({name: study[f"{name}: {what}"] for name in filters} for what in ("added", "crosswise"))
    orderings = {
        "common-shifts": (shift["common band-pass"] > shift["band-passes"]).all(axis=1),
        "common-couples-modes": (across["common band-pass"] > across["band-passes"]).all(axis=1),
        "common-damps-less": (added["common band-pass"] < added["band-passes"]).all(axis=1),
        "over-actuation-peak": peak["over-actuation"] > 1,
        "dynamic-beats-minimal": low["band-passes"] < low["minimal actuation"],
        "dynamic-beats-over": peak["band-passes"] < peak["over-actuation"],
    }
    for claim, obeys in orderings.items():
        page.check(f"motion.section-4-3.{claim}", obeys.mean(), proportion_interval(obeys.sum(), runs))
    crosswise = np.median(across["common band-pass"] / across["band-passes"], axis=0).round(2)
    page.show(
        f"force of one damped mode at the other's resonance, common filter over individual ones: {crosswise}"
    )
    shifted = {name: round(100 * float(values.max()), 3) for name, values in shift.items()}
    page.show("largest shift of a damped frequency (%)", pd.Series(shifted))
    columns = {
        "stable (fraction)": {name: study[f"{name}: stable"].mean() for name in drawn},
        "peak at 517 Hz, median": {name: np.median(peak[name]) for name in drawn},
        "97.5 %": {name: np.quantile(peak[name], 0.975) for name in drawn},
    }
    page.show(pd.DataFrame(columns).round(3))
    kept_out = run_study(kept_out_trial, runs, seed, settings=settings)["peaks"]
    names = INDEX[: settings.damped]
    rows = [f"{name} kept out" for name in names]
    page.show(pd.DataFrame((kept_out > 1).mean(axis=0), index=rows, columns=names))
