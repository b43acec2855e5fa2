"""What the promise of the command ``design`` rests on: the written coefficients in every loop and all over the box."""

from collections.abc import Sequence

import numpy as np

from stillwork.base.checks import InputError
from stillwork.control.bandwidth import SIX_DB, Loop
from stillwork.control.digital import DigitalController, equivalent_biquads, from_biquads
from stillwork.control.loops import LoopResponse
from stillwork.control.machine_loops import HELD, OF_ERROR, AchievableBandwidth, encirclement_difference
from stillwork.control.phased_loops import phased_loops, phased_places
from stillwork.control.uncertainty import Uncertainty, make_box
from stillwork.machine.hardware import ALLOWED_DB, own_functions, peak_with, section_response
from stillwork.machine.machine_designs import Designed

# Modes beyond the band: up to how many times the rate they are looked for, at how many frequencies and phases.
FOLDS, LOOKED, PHASES = 10, 4000, 48
UNSEEN_DAMPING = 0.005  # of a mode that is looked for where none was seen: that of matrices without damping


def over_the_box(reached: AchievableBandwidth, spreads: Sequence[Uncertainty]) -> dict[str, float]:
    """Largest magnitude of each loop function all over the boxes, by another search than the design's: more starts."""
    if all(spread.is_empty for spread in spreads):
        return {}
    pid = reached.safe.controller
    pairs = [(loop, spreads[0]) for loop in reached.model_loops]
    pairs += zip(reached.elsewhere, spreads[1:], strict=True)
    sizes = [
        [size for size, _ in make_box(loop, spread).worst(loop, pid, OF_ERROR, every=True, starts=24)]
        for loop, spread in pairs
    ]
    return dict(zip(HELD, np.max(sizes, axis=0).tolist(), strict=True))


def breaking_hz(made: Designed, use: str) -> float:
    """Up to which frequency (Hz) beyond the measured band one mode more could break the promise of a use; 0: at none.

    The mode has the largest share and the smallest damping ratio of those in the model; where it has none, the share of the
    rigid body and the damping ratio `UNSEEN_DAMPING`. At its resonance, where the
    processor sees it folded and behind the hold, it adds so much to the plant at whatever phase.
    """
    machine, reached, rate = made.machine, made.found[use], made.rate
    if machine.fit is None:
        return 0.0
    model, end = machine.sensors[0], machine.fit.omega[-1] / (2 * np.pi)
    seen = min(1, len(model.damping) - 1)
    share = np.abs(model.input_shapes[seen:, 0] * model.output_shapes[0, seen:]).max()
    hertz = np.linspace(end, max(FOLDS * rate, 2 * end), LOOKED)
    folded = np.maximum(np.abs(hertz / rate - np.round(hertz / rate)), 1 / LOOKED) * rate
    added = (
        share
        / (2 * model.damping[1:].min(initial=np.inf if seen else UNSEEN_DAMPING) * (2 * np.pi * hertz) ** 2)
        * np.abs(np.sinc(hertz / rate))
    )
    turned = added * np.exp(2j * np.pi * np.arange(PHASES) / PHASES)[:, None]
    breaks = np.zeros(LOOKED, dtype=bool)
    for loop in reached.model_loops:
        at = loop.at(reached.safe.controller, 2 * np.pi * folded)
        with_it = LoopResponse(at.plant + turned, at.observer, at.controller)
        for name in HELD:
            breaks |= np.abs(getattr(with_it, name)).max(axis=0) > SIX_DB
    return float(hertz[breaks].max(initial=0.0))


def beyond(made: Designed) -> str:
    """What the promise is without, where the model is that of a measured band, and how far to measure."""
    still = ""
    if suspension := float(made.machine.sensors[0].frequencies[0]) / (2 * np.pi):
        still = f"not for another suspension than that at {suspension:.4g} Hz, which is not moved in the box"
    if made.machine.fit is None:
        return still
    hertz = breaking_hz(made, made.ranking[0])
    like = "as large and as lightly damped as any in it"
    if not len(made.machine.resonances_hz):
        like = f"as large as the rigid body and damped by {100 * UNSEEN_DAMPING:g} %"
    further = f"; one {like} could break it up to {hertz:.4g} Hz: measure to there" if hertz else ""
    return f"not for modes above the measured band, which ends at {made.machine.fit.omega[-1] / (2 * np.pi):.4g} Hz{further}{still and '; '}{still}"


def over_the_phases(
    made: Designed, reached: AchievableBandwidth, controllers: Sequence[DigitalController]
) -> list[list[str]]:
    """A row for the table of the box: the peak at places of it with the phases of the modes; none where they have none."""
    pid, rng = reached.safe.controller, np.random.default_rng(0)
    groups = [reached.model_loops, *((loop,) for loop in reached.elsewhere)]
    worst, count = 0.0, 0
    for group, machine, spread in zip(groups, (made.machine, *made.others), made.spreads, strict=True):
        if machine.fit is None or machine.fit.phased is None or spread.is_empty:
            continue
        for loop in phased_loops(group, machine.fit.phased, phased_places(spread, rng)):
            turns = encirclement_difference(loop, pid)
            controller = controllers[count % len(controllers)]
            worst = max(worst, np.inf if turns else float(np.abs(own_functions(loop, controller)).max()))
            count += 1
    if not count:
        return []
    if (size := 20 * np.log10(worst)) > ALLOWED_DB:
        raise InputError(
            f"{made.machine.source}: with the phases of its modes a peak of {size:.2f} dB was found in the box; state a "
            "little more uncertainty"
        )
    return [["largest with the phases of the modes", f"{size:.2f} dB at the {count} points tried"]]


def recheck(
    reached: AchievableBandwidth, controllers: list[DigitalController]
) -> dict[str, dict[str, float]]:
    """Largest peaks in dB with the written coefficients, by function and by loops: all loops of the search."""
    looked = {"on the model (dB)": reached.model_loops}
    if reached.perturbed:
        looked["at the worst places of the box (dB)"] = reached.perturbed
    if reached.loops is not reached.model_loops:
        looked["on the measurement (dB)"] = reached.loops
    found: dict[str, dict[str, float]] = {name: {} for name in HELD}
    for where, loops in looked.items():
        pairs = [(loop, controllers[k % len(controllers)]) for k, loop in enumerate(loops)]
        peaks = np.max([np.abs(own_functions(*pair)).max(axis=1) for pair in pairs], axis=0)
        for name, size in zip(HELD, peaks, strict=True):
            found[name][where] = float(20 * np.log10(size))
    return found


def checked_biquads(
    controller: DigitalController,
    judged: Sequence[tuple[Loop, DigitalController]],
    position: float = 1.0,
    drive: float = 1.0,
) -> dict | None:
    """The biquads of the whole controller as in its file; None unless they stabilise the model and stay below 6 dB.

    `judged` are the loops, the model's first, each with the controller in the loop's units; `position` and `drive` are
    the written controller's units per unit of the loop.
    """
    found = equivalent_biquads(controller)
    if found is None:
        return None
    loop = judged[0][0]
    peak = max(
        peak_with(each, own, section_response(found.feedback, each) * position / drive)
        for each, own in judged
    )
    if peak > ALLOWED_DB:
        return None
    own = from_biquads(found.feedback, loop.sample_time)
    plant = loop.sampled_plant
    into, out = plant.b / drive, plant.c * position
    a = np.block([[plant.a - into @ own.d @ out, into @ own.c], [-own.b @ out, own.a]])
    radius = float(np.abs(np.linalg.eigvals(a)).max())
    if radius >= 1:
        return None
    return {
        "law": "f = feedback(r - y) + reference(r), without limits; null: nothing is added",
        "feedback": found.feedback.tolist(),
        "reference": None if found.reference is None else found.reference.tolist(),
        "relative_error": found.error,
        "peak_db": peak,
        "spectral_radius_with_the_model": radius,
    }
