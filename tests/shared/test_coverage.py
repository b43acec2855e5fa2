"""Every judged entry is tried over the open choices of its paper, or the ledger gives the reason why none is open."""

import pytest

from workbook import paths
from workbook.choices.axes import load_axes
from workbook.claims import load_entries

# Judged at one combination alone so far, by the notebook that judges them: each lacks a study.
UNTRIED: dict[str, set[str]] = {
    "fixedpoint/06-fixed-point": {
        "fixedpoint.eq-6.decrease",
    },
    "fixedpoint/07-fair-comparison": {
        "fixedpoint.section-4.low-pass-cheapest",
    },
    "isolation/01-floor-and-paths": {
        "isolation.fig-2.flat-between-criteria",
        "isolation.fig-2.flat-follows-criteria",
        "isolation.fig-3.resonance",
        "isolation.setup.diagonal-dominance",
        "isolation.setup.equivalent-mass",
        "isolation.setup.suspension-frequencies",
    },
    "isolation/02-convergence": {
        "isolation.convergence.other-actuators",
        "isolation.equal-variance.faster-each-kept",
        "isolation.equal-variance.faster-each-own",
        "isolation.equal-variance.faster-each-step",
        "isolation.equal-variance.faster-each-ten-times",
        "isolation.equal-variance.speed-up-kept",
        "isolation.equal-variance.speed-up-own",
        "isolation.equal-variance.speed-up-step",
        "isolation.equal-variance.speed-up-ten-times",
        "isolation.convergence.band-37-felms",
        "isolation.convergence.band-37-ferls",
        "isolation.convergence.error-falls",
        "isolation.convergence.literal-floor",
        "isolation.convergence.literal-trace",
        "isolation.convergence.more-uniform",
        "isolation.convergence.pole-allows-300-hz",
        "isolation.convergence.same-final",
        "isolation.convergence.same-variance",
        "isolation.convergence.speed-up-rigid",
        "isolation.convergence.start",
        "isolation.convergence.ten-times",
        "isolation.convergence.vanishing-variance",
        "isolation.table-1-rigid.final-w1",
        "isolation.table-1-rigid.final-w2",
        "isolation.table-1-rigid.final-w3",
        "isolation.table-1-rigid.final-w4",
        "isolation.table-1-rigid.final-w5",
        "isolation.table-1-rigid.final-w6",
        "isolation.table-1-rigid.final-w7",
        "isolation.table-1-rigid.final-w8",
        "isolation.table-1-rigid.final-w9",
    },
    "isolation/04-transmissibility": {
        "isolation.fig-7.beyond-400-hz",
        "isolation.fig-7.off-diagonal-bounds",
        "isolation.fig-7.passive-low-frequency",
        "isolation.fig-7.waterbed",
        "isolation.fig-7.same-by-both",
    },
    "isolation/05-power": {
        "isolation.fig-8.same-by-both",
    },
    "isolation/06-efficient-update": {
        "isolation.update.fits-sampling",
    },
    "isolation/07-numerical-stability": {
        "isolation.stability.not-eliminated",
        "isolation.stability.observed",
    },
    "motion/16-twenty-nine-scans": {
        "motion.conclusion-2-2.every-place",
        "motion.fig-4-9.axis",
        "motion.section-4-2-5.both-best",
        "motion.section-4-2-5.compensation",
        "motion.section-4-2-5.damping-mean",
        "motion.section-4-2-5.damping-variance",
        "motion.section-4-2-5.redesign",
        "motion.section-4-2-5.settling",
        "motion.section-4-2-5.transient",
    },
    "motion/17-mimo-decoupling": {
        "motion.section-4-3.kept-gain",
        "motion.section-4-3.moving-actuators",
        "motion.section-4-3.moving-sensors-peaks",
    },
    "motion/18-decoupled-damping": {"motion.conclusion-3-4.stiffness-bandwidth"},
    "motion/19-observer-contest": {
        "motion.conclusion-5-4.kalman-not-beaten",
        "motion.conclusion-5-5.penalised-gains-with-noise",
        "motion.conclusion-5-5.regularised-gains-with-noise",
    },
    "motion/20-optimal-observer": {
        "motion.conclusion-5-2.trades",
        "motion.conclusion-5-1.optimum-does-not-track",
        "motion.fig-5-5.rises",
        "motion.section-5-1-2.infeasible-at-one",
        "motion.section-5-1-2.kalman-above-front",
        "motion.table-5-1.baseline",
        "motion.table-5-1.kalman",
        "motion.table-5-1.optimal",
    },
    "motion/21-robust-comparison": {
        "motion.table-5-2.nearest-median-ad",
        "motion.fig-5-10.drawn",
        "motion.section-5-3-2.lambda-near-limit",
        "motion.section-5-4-3.mc-errors",
        "motion.section-5-4-3.output-error",
        "motion.section-5-4-3.pseudo-inverse",
        "motion.table-5-2.ad-worse-than-nominal",
        "motion.table-5-2.mc-better-than-nominal",
        "motion.table-5-2.nominal.ad",
        "motion.table-5-2.nominal.ad-redesigned",
        "motion.table-5-2.nominal.mc",
        "motion.table-5-2.nominal.mc-ad",
        "motion.table-5-2.nominal.mc-ad-redesigned",
        "motion.table-5-2.nominal.mc-redesigned",
    },
    "motion/24-over-actuated-rig": {
        "motion.fig-6-3.positions-apart",
    },
}


def uncovered(topic: str) -> set[str]:
    tried = {entry for study in load_axes(topic)[1] for entry in study.entries}
    judged = [each for each in load_entries(topic).values() if each.kind not in ("reported", "check")]
    return {each.id for each in judged if not each.open and each.id not in tried}


@pytest.mark.parametrize("topic", paths.topics())
def test_every_judged_entry_has_a_study_or_says_that_nothing_is_open(topic):
    listed = set().union(*UNTRIED.values())
    assert uncovered(topic) - listed == set(), (
        "give it a study in choices.toml, or open = 'none: ...' in the ledger"
    )
    known = {name for name in listed if name in load_entries(topic)}
    assert known - uncovered(topic) == set(), "no longer lacking: take it off the list"


@pytest.mark.parametrize("topic", paths.topics())
def test_none_says_that_nothing_is_open_and_is_tried_all_the_same(topic):
    tried = {entry for study in load_axes(topic)[1] for entry in study.entries}
    assert [name for name, each in load_entries(topic).items() if each.open and name in tried] == []
