"""The loops of the over-actuated rig and its tracking, and an explorer of one entry (notebook 24)."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike
from scipy import linalg, signal
from scipy.optimize import linear_sum_assignment

from experiments.motion.intervals import Values
from experiments.motion.loop_conditions import slope
from experiments.motion.pictures import add_magnitude, highest, paint_magnitudes, plain
from experiments.motion.rig import POSITIONS, Geometry, assumed_geometry, plate_modes, published
from experiments.motion.rig_designs import (
    CASES,
    COLOURS,
    FORCES,
    MOTIONS,
    RigSettings,
    bandwidths,
    frequencies,
    printed,
    published_settings,
    rig_controllers,
    rig_loops,
)
from experiments.motion.rig_loops import MEASURES, RigBandwidth, RigLoop
from experiments.motion.rig_study import Levelling, levelling_rms, lines_of, to_error
from stillwork.base.checks import InputError
from stillwork.control.discrete_damping import sampled_feedback
from stillwork.control.feedback import fed_back
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.signals.spectra import estimate_spectrum
from workbook import figures


def sampled_damping(
    model: ModalModel, gains: Float64[np.ndarray, "inputs flexible"], sample_time: float
) -> tuple[Float64[np.ndarray, " flexible"], Float64[np.ndarray, " flexible"]]:
    """Damping ratios under u = K eta_dot on true states: of the continuous and of the sampled flexible modes.

    What a gain designed in continuous time gives when its force is held over a sample (section 4.1.2), sorted by
    the frequency of the continuous modes; each sampled mode stands beside the continuous one nearest to it.
    """
    rigid = model.rigid_modes
    gain = np.zeros((gains.shape[0], 2 * len(model.frequencies)))
    gain[:, 2 * rigid + 1 :: 2] = gains
    continuous, sampled = fed_back(model, gain), sampled_feedback(model, gain, sample_time)
    poles = [
        (each.frequencies * (-each.damping + 1j * np.sqrt(1 - each.damping**2)))[rigid:]
        for each in (continuous, sampled)
    ]
    nearest = linear_sum_assignment(np.abs(poles[0][:, None] - poles[1]))[1]
    return continuous.damping[rigid:], sampled.damping[rigid:][nearest]


def placed_damping(model: ModalModel, target: float, sample_time: float) -> Float64[np.ndarray, " flexible"]:
    """Damping ratios that pole placement on the sampled flexible modes reaches (section 4.1.2), ascending frequency.

    The frequencies stay, all damping ratios shall become `target`. The gain acts on positions too.
    """
    flexible = model.modes(slice(model.rigid_modes, None))
    held = zoh_modes(flexible, sample_time)
    upper = np.exp(flexible.frequencies * (-target + 1j * np.sqrt(1 - target**2)) * sample_time)
    with warnings.catch_warnings():
        # The poles are placed all the same; only their most robust eigenvectors were still being looked for.
        warnings.filterwarnings("ignore", message="Convergence was not reached")
        try:
            gain = signal.place_poles(held.a, held.b, np.concatenate([upper, upper.conj()])).gain_matrix
        except ValueError as error:
            raise InputError(f"the poles of model cannot be placed ({error}); leave modes out") from None
    poles = np.log(linalg.eigvals(held.a - held.b @ gain).astype(complex)) / sample_time
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    return -poles.real / np.abs(poles)


def compensated_feedback(loop: RigLoop, pids: Sequence[Pid]) -> float:
    """Largest singular value over frequency of O_yu C_fb, which section 6.3 keeps below 1 (scaled directions)."""
    o_yu = np.moveaxis(loop.compensator.frequency_response(loop.omega)[3:, :3], -1, 0)
    seen = loop.decoupling.sensing @ o_yu @ loop.decoupling.actuation * loop.controlled(pids)[:, None, :]
    return float(np.linalg.norm(seen, 2, axis=(1, 2)).max())


UNITS = (("m/N", "m/Nm", "m/Nm"), ("rad/N", "rad/Nm", "rad/Nm"), ("rad/N", "rad/Nm", "rad/Nm"))


def levelling_error(
    loop: RigLoop,
    pids: Sequence[Pid],
    trajectory: Levelling,
    noise: NoiseIntensities,
    rng: np.random.Generator,
    periods: int = 1,
) -> Float64[np.ndarray, "3 samples"]:
    """True error over the last period (m, rad, rad), simulated with noise after `periods` periods of settling."""
    model = to_error(loop, pids)
    count = round(trajectory.period / loop.sample_time)
    if abs(count * loop.sample_time - trajectory.period) > 1e-9 * trajectory.period:
        raise InputError("period of the trajectory is not a multiple of the sample time; change one of them")
    time = np.arange((periods + 1) * count) * loop.sample_time
    known = (lines_of(trajectory, loop) @ np.exp(1j * np.outer(trajectory.omega, time))).real
    sizes = np.sqrt(np.repeat([noise.process, noise.sensor], 3))
    random = sizes[:, None] * rng.standard_normal((6, len(time)))
    inputs = np.vstack([known[:3], known[3:] + random[:3], random[3:]])
    return simulate(model, inputs)[:, -count:]


def physical_plant(loop: RigLoop) -> np.ndarray:
    """Decoupled plant from (Fz, Mx, My) to (z, rx, ry) in SI units, shape (3, 3, frequencies)."""
    edges = loop.decoupling.edges
    return loop.equivalent_plant() / edges[:, None, None] / edges[None, :, None]


def places(axis, geometry: Geometry, shape: np.ndarray | None = None) -> None:
    """Plate, actuators and sensors seen from above, over the contours of a mode shape."""
    x, y = geometry.half
    if shape is not None:
        grid = np.linspace(-1, 1, len(shape))
        largest = np.abs(shape).max()
        axis.contourf(
            grid * x, grid * y, shape.T, levels=np.linspace(-largest, largest, 12), cmap="RdBu_r", alpha=0.7
        )
    axis.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=figures.GREY, linewidth=0.8)
    used = geometry.actuator_places[list(geometry.used)]
    idle = geometry.actuator_places[[geometry.left_out]]
    axis.plot(*used.T, "o", color=figures.BLACK, markersize=5, markerfacecolor="none", label="actuator")
    axis.plot(*idle.T, "s", color=figures.BLACK, markersize=4, label="actuator, idle")
    axis.plot(*geometry.sensor_places.T, "x", color=figures.BLACK, markersize=4, label="sensor")
    axis.set_aspect("equal")
    axis.grid(False)


def paint_mode_shapes(geometry: Geometry):
    """The eight flexible modes with the published frequencies."""
    p = published()
    modes = plate_modes(geometry.width / geometry.length, geometry.poisson, 8)
    grid = np.linspace(-1, 1, 25)
    xi, eta = (g.ravel() for g in np.meshgrid(grid, grid, indexing="ij"))
    shapes = modes.shapes(xi, eta).reshape(25, 25, 8)
    figure, axes = figures.new(2, 4, height=3.9, sharex=True, sharey=True)
    for k, axis in enumerate(axes.ravel()):
        places(axis, geometry, shapes[:, :, k])
        axis.set_title(f"mode {k + 1}, {p['frequencies_hz'][k]:.0f} Hz")
    figures.label(axes, "x (m)", "y (m)")
    figures.legend_below(axes[0, 0], 3)
    return figure


def paint_decoupled_plants(loops: Sequence[RigLoop]):
    """All nine entries of the decoupled plant at the four positions: Figs 6.3 and 6.5 to 6.7."""
    figure, axes = figures.new(3, 3, height=6.2, sharex=True, sharey=False)
    for number, loop in enumerate(loops, 1):
        plant = physical_plant(loop)
        for place in np.ndindex(3, 3):
            # Thinner in turn: positions coincide in places, as on a symmetric plate.
            style = {"linewidth": (2.8, 1.9, 1.1, 0.6)[number - 1], "label": f"position {number}"}
            add_magnitude(axes[place], loop.omega, plant[place], **style)
    printed_hz = published()["frequencies_hz"]
    for i, j in np.ndindex(3, 3):
        low = {"transform": axes[i, j].get_xaxis_transform(), "markersize": 3}
        figures.mark_published(
            axes[i, j], printed_hz, np.full(8, 0.03), "published frequencies, Table 6.1", **low
        )
        axes[i, j].set_title(f"${FORCES[j]}$ to ${MOTIONS[i]}$")
        axes[i, j].set_ylabel(f"magnitude (dB re 1 {UNITS[i][j]})", fontsize=7)
    figures.label(axes, "frequency (Hz)")
    # Nine panels with axes of their own: the constrained layout would take longer than all the rest.
    figure.set_layout_engine(None)
    figure.subplots_adjust(left=0.09, right=0.99, bottom=0.12, top=0.96, wspace=0.4, hspace=0.28)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=5, fontsize=7)
    return figure


def paint_one_entry(loops: Mapping[str, Sequence[RigLoop]], to: int):
    """From F_z to one direction of the decoupled plant under the four uses of the observer: Figs 6.8 and 6.9."""
    panels = {f"position {number}": {} for number in range(1, 5)}
    for case, each in loops.items():
        for lines, loop in zip(panels.values(), each, strict=True):
            width = 1.8 if case == "Original" else 0.9  # AD lies on it between resonances
            lines[case] = (
                loop.omega,
                physical_plant(loop)[to, 0],
                {"color": COLOURS[case], "linewidth": width},
            )
    quantity = f"$F_z$ to ${MOTIONS[to]}$\n(dB re 1 {UNITS[to][0]})"
    figure, axes = paint_magnitudes(panels, quantity, rows=2, height=4.6, sharex=True, sharey=True)
    for axis in axes.ravel():
        low = {"transform": axis.get_xaxis_transform(), "markersize": 3}
        hertz = published()["frequencies_hz"]
        figures.mark_published(axis, hertz, np.full(len(hertz), 0.03), "published, Table 6.1", **low)
    figures.legend_below(axes[0, 0], 5)
    return figure


def paint_tracking_errors(
    errors: Mapping[str, np.ndarray], sample_time: float, printed: Mapping[str, np.ndarray]
):
    """True errors (m and rad) over one period, a column a use of the observer, that of the original in grey: Figs 6.10, 6.11.

    Dashed: plus and minus the `printed` rms (um and urad), of a trajectory that is not published.
    """
    figure, axes = figures.new(3, len(errors), height=4.6, sharex=True, sharey="row")
    every = 10  # samples between those drawn: the errors are slow
    original = errors["Original"]
    time = np.arange(original.shape[1])[::every] * sample_time
    for column, (case, error) in zip(axes.T, errors.items(), strict=True):
        for k, axis in enumerate(column):
            if case != "Original":
                axis.plot(time, 1e6 * original[k, ::every], color=figures.GREY, linewidth=2, label="Original")
            axis.plot(time, 1e6 * error[k, ::every], color=COLOURS[case], linewidth=0.8, label=case)
            for sign, name in ((1, "plus and minus the printed rms"), (-1, "_")):
                level = {"color": figures.BLACK, "linestyle": "--", "linewidth": 1.0, "label": name}
                axis.plot(time[[0, -1]], [sign * printed[case][k]] * 2, **level)
        column[0].set_title(case)
    for k, axis in enumerate(axes[:, 0]):
        axis.set_ylabel(f"error in ${MOTIONS[k]}$ ({'µm' if k == 0 else 'µrad'})")
    figures.label(axes, "time (s)")
    names = "no observer", "as titled", "plus and minus the printed rms"
    figure.legend(axes[0, 1].lines[:3], names, loc="outside lower center", ncols=3)
    return figure


def paint_bandwidths(designs: Mapping[str, Mapping[str, RigBandwidth]]):
    """Table 6.2: bandwidth of every use of the observer by both measures, with the printed values."""
    figure, axes = figures.new(1, 3, height=2.6, sharey=True)
    theirs = printed("table-6-2")
    for k, axis in enumerate(axes):
        for shift, (measure, mark) in zip((-0.12, 0.12), zip(MEASURES, "os", strict=True), strict=True):
            ours = [designs[measure][case].crossing_hz.mean(axis=0)[k] for case in CASES]
            axis.plot(np.arange(4) + shift, ours, mark, markersize=5, label=f"6 dB of {measure}")
        figures.mark_published(axis, np.arange(4), [theirs[case][k] for case in CASES])
        axis.set_xticks(range(4), [case.replace(" and ", "\nand ") for case in CASES], fontsize=7)
        axis.set_title(f"${MOTIONS[k]}$")
    axes[0].set_ylim(0, 1.1 * max(each.max() for each in theirs.values()))
    figures.label(axes, "use of the observer", "bandwidth (Hz)")
    figures.legend_below(axes[0], 3)
    return figure


ENTRIES = {"Fz to z": 0, "Fz to rx": 1}


def paint_rig(use: str, entry: str, target_damping: float, sensor_exponent: float, position: int):
    """Explorer: one entry of what the controller sees, with and without one use of the observer."""
    settings, row = published_settings(), ENTRIES[entry]
    noise = NoiseIntensities(settings.noise.process, 10**sensor_exponent)
    settings = replace(settings, noise=noise, target_damping=target_damping)
    omega = frequencies(20.0, points=80, around=5)
    loops = rig_loops(assumed_geometry(), settings, None, [POSITIONS[position - 1]], omega, ("Original", use))
    figure, axis = plain()
    for name, (loop, *_) in loops.items():
        add_magnitude(axis, omega, physical_plant(loop)[row, 0], color=COLOURS[name], label=name)
    axis.set(xlabel="frequency (Hz)", ylabel=f"$F_z$ to ${MOTIONS[row]}$ (dB re 1 {UNITS[row][0]})")
    axis.legend()
    return figure


def positions_apart(plants: ArrayLike, omega: np.ndarray) -> Bool[np.ndarray, "pairs 3 3"]:
    """Which entries of two positions' decoupled plants differ by more than 3 dB somewhere above 100 Hz (Fig. 6.3)."""
    level = 20 * np.log10(np.abs(plants))[..., omega > 2 * np.pi * 100]
    pairs = [(i, j) for i in range(len(level)) for j in range(i)]
    return np.array([np.abs(level[i] - level[j]).max(axis=-1) for i, j in pairs]) > 3


def positions(*, plate_aspect: float, rig_sensors: float, seed: int) -> Values:
    """How many of them, on another plate; it has no fast variant."""
    base = assumed_geometry()
    geometry = replace(base, width=plate_aspect * base.length, sensors=(rig_sensors, base.sensors[1]))
    loops = rig_loops(geometry, published_settings(), omega=frequencies(), cases=("Original",))
    apart = positions_apart([loop.equivalent_plant() for loop in loops["Original"]], frequencies())
    return {"motion.fig-6-3.positions-apart": float(np.mean(apart))}


# === The appendix =================================================================================================


def appendix(
    page,
    *,
    geometry: Geometry,
    settings: RigSettings,
    errors: np.ndarray,
    loops: Mapping[str, list[RigLoop]],
    shown: Mapping[str, list[RigLoop]],
    designs: Mapping,
    measure: str,
    trajectory: Levelling,
    records: Mapping,
) -> None:
    """What the page of motion/24 judges beside its answer."""
    _of_the_plants(page, shown)
    _of_the_slope(page, geometry, settings, errors)
    _of_the_gain(page, geometry, settings, errors, loops)
    page.text("## Bandwidths (Hz) in z, rx and ry, and what stops them")
    rows = {}
    for case, theirs in printed("table-6-2").items():
        rows[case] = {"published": ", ".join(f"{each:g}" for each in theirs)}
        for which in MEASURES:
            design = designs[which][case]
            rows[case][which] = ", ".join(f"{f:.1f}" for f in design.crossing_hz.mean(axis=0))
            rows[case][f"stopped by ({which})"] = design.active
    page.show(pd.DataFrame(rows).T)
    _of_the_noise_model(page, geometry, settings, errors, measure)
    _of_levelling(page, settings, loops, designs[measure], trajectory, records)


def _of_the_plants(page, shown: Mapping[str, list[RigLoop]]) -> None:
    page.text("""## MC alone, AD alone, and one entry

Figs 6.5, 6.6, 6.8 and 6.9. With MC most peaks shrink but stay, because the observer's frequencies are
off. AD flattens the peaks. How the highest points change from no observer to MC, in two bands:""")
    without, compensated = (paint_decoupled_plants(shown[case]) for case in ("Original", "MC"))
    page.save("fig-6-5", compensated)
    for band in ((1200, 2000), (850, 910)):
        pairs = zip(without.axes, compensated.axes, strict=True)
        grown = [highest(after, *band)[:4, 1] - highest(before, *band)[:4, 1] for before, after in pairs]
        least, most = ([f"{each:.0f}" for each in end(grown, axis=0)] for end in (np.min, np.max))
        page.show(
            f"{band[0]} to {band[1]} Hz, positions 1 to 4: highest points change by {', '.join(least)} to {', '.join(most)} dB"
        )
    page.save("fig-6-6", paint_decoupled_plants(shown["AD"]))
    page.save("fig-6-8", paint_one_entry(shown, 0))
    page.save("fig-6-9", paint_one_entry(shown, 1))


def _of_the_slope(page, geometry: Geometry, settings: RigSettings, errors: np.ndarray) -> None:
    page.text("""## The coupling at low frequencies

MC removes the compliance from the coupling. AD does not change it, because its band-passes leave no force at low frequencies. The
steepest slope between 0.02 and 0.2 Hz, over all off-diagonal entries and positions:""")
    slow = 2 * np.pi * np.geomspace(0.02, 0.2, 5)
    steepest = {}
    for name, selectivity in (("band-passes", settings.selectivity), ("none", None)):
        chosen = replace(settings, selectivity=selectivity)
        found = rig_loops(geometry, chosen, errors, omega=slow, cases=("AD",))["AD"]
        slopes = [
            slope(slow, loop.equivalent_plant()[i, j])
            for loop in found
            for i, j in np.ndindex(3, 3)
            if i != j
        ]
        steepest[name] = max(np.abs(slopes))
    page.show(pd.Series(steepest).round(2))
    page.check("motion.section-6-4-1.band-pass-slope", steepest["band-passes"])


def _of_the_gain(page, geometry: Geometry, settings: RigSettings, errors: np.ndarray, loops: Mapping) -> None:
    page.text(r"""## The observer and the damping gain

The damping gain, designed in continuous time, is used at 10 kHz (section 6.3). With true states this makes little difference.
Where modes lie close together the gain misses the target of 0.04.""")
    damped = loops["AD"][0].compensator
    model, target = damped.observer.model, settings.target_damping
    continuous, sampled = sampled_damping(model, damped.gains, settings.sample_time)
    rows = {"continuous": continuous, "sampled": sampled}
    page.show(pd.DataFrame(rows, index=pd.RangeIndex(1, 9, name="mode")).round(4).T)
    page.check("motion.section-6-3.continuous-gain", max(abs(sampled / continuous - 1)))
    placed = placed_damping(model, target, settings.sample_time)
    page.show(f"pole placement: largest distance from the target {max(abs(placed - target)):.4f}")
    page.check("motion.section-6-3.pole-placement", np.mean(abs(placed - target) > abs(sampled - target)))
    page.text(r"""For controllers of 6 and 8 Hz we check the condition on the noise model above 0.3 Hz,

$$\max_\omega\ \bar\sigma\big(\Upsilon\,O_{yu}\,\Gamma\,C_{fb}\big) < 1,$$

with $O_{yu}$ from $f$ to $\hat y_{flex}$ and $\bar\sigma$ the largest singular value, for several $Q_\nu$:""")
    pids, printed = rig_controllers(geometry.edge_masses)(6.0, 8.0), published()["noise_model"]
    shares = {}
    for intensity in (printed, 1e-7, 1e-12):
        each = rig_loops(geometry, replace(settings, noise_model=intensity), errors, cases=("MC",))["MC"]
        shares[intensity] = [compensated_feedback(loop, pids) for loop in each]
    page.show(pd.Series({f"{intensity:g}": max(each) for intensity, each in shares.items()}).round(3))
    page.check("motion.section-6-3.noise-model", np.mean(np.array(shares[printed]) < 1))


def _of_the_noise_model(
    page, geometry: Geometry, settings: RigSettings, errors: np.ndarray, measure: str
) -> None:
    page.text(r"""## The noise model

Section 6.3 requires $Q_\nu\ge10^{-2}$. So large a random walk absorbs the motion of the modes. With MC *and* AD we use the decade with
the largest bandwidth on this curve, also in the next notebook (chosen after it was seen).""")
    intensities = 10.0 ** np.array([-10, -9, -8, -7, -6, -4, -2])
    curves: dict[str, list] = {"MC": [], "MC and AD": []}
    for intensity in intensities:
        chosen = replace(settings, noise_model=float(intensity), noise_model_both=float(intensity))
        tried = rig_loops(geometry, chosen, errors, cases=tuple(curves))
        reached = bandwidths(tried, measure)
        for case, each in curves.items():
            each.append(reached[case].crossing_hz.mean(axis=0)[0])
    figure, axis = figures.new(1, 1, height=2.8)
    for (case, each), colour in zip(curves.items(), (figures.BLUE, figures.RED), strict=True):
        axis.semilogx(intensities, each, "o-", color=colour, label=case)
        none = intensities[np.isnan(each)]
        if len(none):
            axis.plot(none, np.zeros(len(none)), "x", color=colour, label=f"{case}: none feasible")
    limit = {"color": figures.BLACK, "linewidth": 0.8, "label": "printed lower limit"}
    axis.axvline(published()["noise_model"], **limit)
    axis.set(xlabel="noise model $Q_\\nu$ (N$^2$ a sample)", ylabel="bandwidth in z (Hz)", ylim=(-0.5, None))
    axis.legend()
    page.save("noise-model", figure)
    both = np.array(curves["MC and AD"])
    page.conclude(
        "With MC and AD no bandwidth is feasible at the printed limit; the largest is {hz:.1f} Hz in $z$, at $Q_\\nu$ = {best:.0e}.",
        "With MC and AD {printed:.1f} Hz are feasible in $z$ at the printed limit; the largest is {hz:.1f} Hz, at $Q_\\nu$ = {best:.0e}.",
        when=bool(np.isnan(both[-1])),
        hz=np.nanmax(both),
        best=float(intensities[np.nanargmax(both)]),
        printed=both[-1],
    )


def _of_levelling(
    page, settings: RigSettings, loops: Mapping, designs: Mapping, trajectory: Levelling, records: Mapping
) -> None:
    page.text("""## Levelling

With the original controller the errors of all cases coincide, except at high frequencies; rms above 100 Hz, then the expected rms
errors with the original and with the redesigned controllers:""")
    columns = ["z (µm)", "rx (µrad)", "ry (µrad)"]
    spectra = {
        case: estimate_spectrum(record, 1 / settings.sample_time, 2.0) for case, record in records.items()
    }
    high = {case: np.sqrt(each.power(100.0, 4000.0)) for case, each in spectra.items()}
    page.show(pd.DataFrame({case: 1e6 * each for case, each in high.items()}, index=columns).T.round(5))
    page.check(
        "motion.section-6-4-2.ad-lowers-high-frequencies",
        np.mean([high[case] < high["Original"] for case in ("AD", "MC and AD")]),
    )
    for owner in ("original", "own"):
        expected = {
            case: 1e6
            * levelling_rms(
                loops[case][0],
                designs[case if owner == "own" else "Original"].pids,
                trajectory,
                settings.noise,
            )
            for case in CASES
        }
        page.show(f"{owner} controllers", pd.DataFrame(expected, index=columns).T.round(4))
