"""The rig, its floor and its paths: what this notebook alone needs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import optimize

from experiments.isolation.floors import ShapedFloor, coloured_floor, flat_floor
from experiments.isolation.responses import responses, thinned
from experiments.isolation.rig import Rig
from experiments.isolation.twin import Twin, equal_struts
from stillwork.base.checks import InputError, require_number
from stillwork.signals.criteria import criterion_density, criterion_velocity, one_third_octave_velocity
from stillwork.signals.spectra import Spectrum, band_power
from workbook import figures


def series(sections: np.ndarray, sample_time: float):
    """Sections one after another, as a `control.StateSpace`."""
    import control

    whole = control.ss([], [], [], [[1.0]], sample_time)
    for row in sections:
        whole = control.ss(control.tf(row[:3], row[3:], sample_time)) * whole
    return whole


def control_paths(twin: Twin, feedback: bool = True):
    """Primary and secondary path, a0 to a1 and u to a1 (a1 behind its conditioner), as discrete `control.StateSpace`."""
    import control

    sample_time = twin.sample_time
    n = twin.actuators

    def bank(sections, channels):
        return control.append(*[series(sections, sample_time)] * channels)

    delay = control.append(*[control.ss(0, 1, 1, 0, sample_time)] * n)
    force_path = bank(twin.instruments.actuator, n) * delay
    plant = twin.plant.discrete(sample_time).to_control()
    from_force, from_floor = plant[:, :n], plant[:, n:]
    open_path = (from_force + bank(twin.instruments.parasitic, n)) * force_path
    disturbance = from_floor + open_path * control.ss([], [], [], twin.plant.floor_inertia, sample_time)
    conditioning = bank(twin.instruments.conditioning, twin.outputs)
    if feedback:
        skyhook = bank(twin.skyhook_filter, twin.outputs)
        closed = control.feedback(np.eye(twin.outputs), open_path * skyhook * conditioning)
        open_path, disturbance = closed * open_path, closed * disturbance
    return conditioning * disturbance, conditioning * open_path


# === Modes ========================================================================================================
# Suspension modes of a twin with its real skyhook loop: weak integrator, notch, lag and delay included.


@dataclass(frozen=True)
class Modes:
    """Frequencies and relative damping of the suspension modes, by rising frequency."""

    frequencies_hz: Float64[np.ndarray, " modes"]  # of each pair of poles
    damping: Float64[np.ndarray, " modes"]


def suspension_modes(twin: Twin, feedback: bool = True) -> Modes:
    """Poles of the sampled loop that belong to the suspension, none of them overdamped."""
    import control

    open_path = control_paths(twin, feedback=False)[1]
    skyhook = series(twin.skyhook_filter, twin.sample_time)
    gain = control.append(*[skyhook * float(feedback)] * twin.outputs)
    poles = np.linalg.eigvals(control.feedback(np.eye(twin.outputs), open_path * gain).A)
    poles = np.log(poles[np.abs(poles) > 1e-6].astype(complex)) / twin.sample_time
    undamped = np.sqrt(np.linalg.eigvals(np.linalg.solve(twin.plant.mass, twin.plant.stiffness)).real)
    size = np.abs(poles)
    near = (poles.imag > 0) & (size > undamped.min() / 3) & (size < 3 * undamped.max())
    if near.sum() != len(undamped):
        raise InputError(
            f"{near.sum()} oscillating modes near the suspension instead of {len(undamped)}; lower the skyhook gain"
        )
    order = np.argsort(size[near])
    return Modes(size[near][order] / (2 * np.pi), (-poles.real / size)[near][order])


# === Path fit =====================================================================================================
# A fit of the secondary path, a discrete `control.TransferFunction`, compared with a twin's own path (section 2.1, Fig. 3).


def diagonal_path(twin: Twin, frequencies_hz: ArrayLike) -> Complex128[np.ndarray, "actuators frequencies"]:
    """Diagonal elements from command to measured platform acceleration, skyhook loop closed; m/s^2 per N."""
    return np.ascontiguousarray(np.einsum("fii->if", responses(twin, frequencies_hz).secondary))


def dominance(twin: Twin, frequencies_hz: ArrayLike) -> Float64[np.ndarray, " frequencies"]:
    """Least diagonal element of the open 6 × 6 path over the sum of the others in its row, magnitudes.

    Above 1 the path is diagonally dominant in the strict sense. The skyhook loop is open: its diagonal form is
    what the dominance argues for (section 2.1).
    """
    size = np.abs(responses(twin, frequencies_hz, feedback=False).secondary)
    diagonal = np.einsum("fii->fi", size)
    with np.errstate(divide="ignore"):  # struts without cross-coupling: infinite
        return (diagonal / (size.sum(axis=2) - diagonal)).min(axis=1)


def fit_error_db(twin: Twin, frequencies_hz: ArrayLike, fit) -> Float64[np.ndarray, "actuators frequencies"]:
    """Magnitude of the path over that of the fit, dB."""
    z = np.exp(2j * np.pi * np.asarray(frequencies_hz, dtype=float) * twin.sample_time)
    return 20 * np.log10(np.abs(diagonal_path(twin, frequencies_hz) / fit(z)))


def fit_reaches_hz(twin: Twin, above_hz: float, fit) -> float:
    """Highest frequency up to which, from `above_hz` on, the fit's magnitude stays within 3 dB."""
    require_number("above_hz", above_hz, above=0.0, below=twin.instruments.sample_rate / 2)
    f = np.arange(above_hz, twin.instruments.sample_rate / 2, 1.0)
    outside = np.any(np.abs(fit_error_db(twin, f, fit)) > 3.0, axis=0)
    return float(f[np.argmax(outside)] if outside.any() else f[-1])


def resonance_hz(twin: Twin, low_hz: float, high_hz: float) -> float:
    """Frequency of the highest peak of the first diagonal element between two frequencies, refined."""
    f = np.linspace(low_hz, high_hz, 2001)
    middle = int(np.clip(np.argmax(np.abs(diagonal_path(twin, f)[0])), 1, len(f) - 2))
    found = optimize.minimize_scalar(
        lambda x: -np.abs(diagonal_path(twin, [x])[0, 0]),
        bounds=(f[middle - 1], f[middle + 1]),
        method="bounded",
    )
    return float(found.x)


# === Rig pictures =================================================================================================
# Figures of the rig, its floor and its paths (notebook 01).


_STRUT_M = 0.06  # drawn length; the model needs only directions
_VIEW = np.radians([25.0, 20.0])  # azimuth, elevation


def paint_rig(rig: Rig):
    """Struts, platform and floor sensors, from the side (oblique) and from above."""
    figure, (oblique, above) = figures.new(1, 2, height=3.4)
    tops = rig.struts.positions
    feet = tops + _STRUT_M * rig.struts.directions * np.sign(-rig.struts.directions[:, 2:3])
    sensors = rig.floor_sensors.positions + np.array([0.0, 0.0, feet[:, 2].min()])
    angle = np.linspace(0, 2 * np.pi, 73)
    rim = np.linalg.norm(tops[:, :2], axis=1).max()
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    plate = 1.25 * np.linalg.norm(feet[:, :2], axis=1).max() * circle + np.array([0.0, 0.0, feet[:, 2].min()])
    azimuth, elevation = _VIEW
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array(
        [np.sin(azimuth) * np.sin(elevation), -np.cos(azimuth) * np.sin(elevation), np.cos(elevation)]
    )
    views = (
        (oblique, np.stack([right, up]), "across (m)", "up (m)", "seen from the side"),
        (above, np.eye(3)[:2], "x (m)", "y (m)", "seen from above"),
    )
    for axes, view, xlabel, ylabel, title in views:
        axes.plot(*(view @ plate.T), color=figures.GREY, label="floor plate")
        axes.plot(*(view @ (rim * circle).T), color=figures.BLACK, lw=2, label="platform")
        for number, (top, foot) in enumerate(zip(tops, feet, strict=True), 1):
            ends = view @ np.stack([top, foot]).T
            label = "strut: actuator and accelerometer" if number == 1 else f"_strut {number}"
            axes.plot(*ends, color=figures.BLUE, lw=2.5, marker="o", ms=3, label=label)
            away = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0])
            style = {"color": figures.BLUE, "ha": "center", "va": "center", "fontsize": 8}
            axes.annotate(str(number), ends[:, 1], xytext=9 * away, textcoords="offset points", **style)
        axes.plot(*(view @ sensors.T), "^", color=figures.RED, ms=8, label="floor accelerometer (vertical)")
        for number, place in enumerate(sensors, 1):
            style = {"xytext": (7, -2), "textcoords": "offset points", "color": figures.RED, "fontsize": 8}
            axes.annotate(str(number), view @ place, **style)
        axes.set(xlabel=xlabel, ylabel=ylabel, title=title, aspect="equal")
    figures.legend_below(oblique, 4)
    return figure


def paint_modes(rig: Rig, passive: Modes, closed: Modes, gain: float):
    """Frequency and damping of the modes beside the published ones; damping over the skyhook's gain."""
    figure, (left, right) = figures.new(1, 2, height=2.9)
    left.axvspan(15, 45, color=figures.GREY, alpha=0.15, lw=0)
    left.text(30, 0.02, "published range", ha="center", color=figures.GREY, fontsize=8)
    left.plot(passive.frequencies_hz, passive.damping, "o", color=figures.BLUE, ms=6, label="passive")
    left.plot(closed.frequencies_hz, closed.damping, "s", color=figures.RED, ms=6, label="with skyhook loop")
    left.set(xlabel="frequency (Hz)", ylabel="relative damping", xlim=(10, 53))
    gains = np.linspace(0, 350, 36)
    ideal = np.array([rig.damping_ratios(each) for each in gains])
    modes = {"x, y": (0, figures.BLUE), "z": (2, figures.GREEN), "θx, θy, θz": (5, figures.ORANGE)}
    for name, (mode, color) in modes.items():
        right.plot(gains, ideal[:, mode], color=color, label=f"{name}, ideal skyhook")
    style = {"color": figures.RED, "label": "real loop at the published gain"}
    right.plot(np.full(6, gain), closed.damping, "s", **style)
    right.set(xlabel="skyhook gain (N s/m)", xlim=(0, 350))
    for axes in (left, right):
        axes.axhline(0.7, color=figures.BLACK, ls=":", lw=1)
        axes.set(ylim=(0, 1.05))
    left.text(11, 0.72, "published: about 0.7 for all", fontsize=8)
    left.legend(loc="center left", bbox_to_anchor=(0, 0.45))
    right.legend(loc="upper left")
    return figure


def paint_floors(floors: dict[str, ShapedFloor], measured: dict[str, Spectrum], ground: tuple):
    """Fig. 2: floor spectra as filtered noise and as estimated from a realisation, criteria and the ground."""
    figure, axes = figures.new(1, 1, height=3.6)
    f = np.geomspace(1, 1000, 400)
    colors = dict(zip(floors, (figures.BLUE, figures.SKY, figures.RED, figures.ORANGE), strict=False))
    for name, spectrum in measured.items():
        inside = (spectrum.frequencies_hz >= 1.0) & (spectrum.frequencies_hz <= 1000)
        density = spectrum.density.mean(axis=0)
        shown = np.flatnonzero(inside)[thinned(spectrum.frequencies_hz[inside], density[inside])]
        look = {"color": colors[name], "lw": 2.5, "alpha": 0.35}
        axes.loglog(spectrum.frequencies_hz[shown], density[shown], label=f"{name}, estimated", **look)
    for name, floor in floors.items():
        axes.loglog(f, floor.density(f)[0], color=colors[name], label=name)
    band = np.geomspace(1, 80, 100)
    for name, style in (("BBN-B", "--"), ("BBN-C", ":")):
        axes.loglog(band, criterion_density(name, band), style, color=figures.BLACK, label=name)
    shown = ground[0] >= 1.0
    axes.loglog(
        ground[0][shown], ground[1][shown], color=figures.GREEN, lw=0.8, label="LIGO ground, measured"
    )
    axes.axvspan(40, 90, color=figures.GREY, alpha=0.15, lw=0, label="published: raised at 40-90 Hz")
    axes.axvline(150, color=figures.GREY, alpha=0.3, lw=4, label="published: raised near 150 Hz")
    axes.set(xlabel="frequency (Hz)", ylabel="acceleration PSD ((m/s²)²/Hz)", ylim=(1e-14, 1e-3))
    axes.set(xlim=(1, 1000))
    lines = {label: line for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    shown = {label: line for label, line in lines.items() if not label.endswith("estimated")}
    shown["pale: estimated from a record"] = axes.lines[0]
    axes.legend(shown.values(), shown, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def paint_paths(twins: dict[str, Twin], frequencies_hz: np.ndarray, fit):
    """Fig. 3: the six diagonal elements from command to platform acceleration, and the fit (2)."""
    figure, (upper, lower) = figures.new(2, 1, height=4.6, sharex=True, gridspec_kw={"height_ratios": [2, 1]})
    f = frequencies_hz
    for (name, twin), color in zip(twins.items(), (figures.BLUE, figures.RED), strict=False):
        for k, (path, error) in enumerate(
            zip(diagonal_path(twin, f), fit_error_db(twin, f, fit), strict=True), 1
        ):
            label = name if k == 1 else f"_{name}, element {k}"
            upper.loglog(f, np.abs(path), color=color, lw=0.9, label=label)
            lower.semilogx(f, error, color=color, lw=0.9, label=f"_{name}, element {k}")
    upper.loglog(
        f, np.abs(fit(np.exp(2j * np.pi * f * fit.dt))), "--", color=figures.BLACK, label="fit, eq. (2)"
    )
    upper.axvline(962, color=figures.GREY, ls=":", lw=1)
    upper.annotate("published: 962 Hz", (930, 0.003), ha="right", fontsize=8, color=figures.GREY)
    lower.axvline(500, color=figures.GREY, ls=":", lw=1)
    lower.annotate("published: good to here", (480, -9), ha="right", fontsize=8, color=figures.GREY)
    upper.set(ylabel="|a₁ / u| (m/s² per N)")
    lower.set(xlabel="frequency (Hz)", ylabel="model over fit (dB)", ylim=(-12, 12), xlim=(f[0], f[-1]))
    upper.legend(loc="upper left")
    return figure


def explore_floor(low_pass_hz: float, gain: float):
    """Explorer: the two options of the flat floor and the height of the coloured bands, against BBN-A to -D."""
    figure, axes = figures.new(1, 1, height=3.2)
    f = np.geomspace(1, 1000, 300)
    floor = coloured_floor(low_pass_hz, gain=gain)
    axes.loglog(f, floor.density(f)[0], color=figures.BLUE, label="floor")
    band = np.geomspace(1, 80, 60)
    colors = {"A": figures.PURPLE, "B": figures.RED, "C": figures.ORANGE, "D": figures.GREEN}
    for letter, color in colors.items():
        name = f"BBN-{letter}"
        axes.loglog(band, criterion_density(name, band), "--", color=color, label=name)
    axes.set(xlabel="frequency (Hz)", ylabel="acceleration PSD ((m/s²)²/Hz)", ylim=(1e-10, 1e-3))
    axes.legend(loc="upper left", ncols=2)
    return figure


# === Open choices =================================================================================================


def suspension(*, strut_damping: float, strut_tilt: float, rotations: float, seed: int) -> dict[str, float]:
    """Section 2's numbers of the rig, as in notebook 01."""
    twin = equal_struts(
        strut_damping=strut_damping, actuator_pole=300.0, strut_tilt=strut_tilt, rotations=rotations
    )
    # With equal struts all modes follow one law of their frequency, so the loop keeps their order.
    damping, shares = suspension_modes(twin).damping, twin.rig.mass * twin.rig.modes[1] ** 2
    kinds = {"horizontal": shares[0] + shares[1] > 0.5, "vertical": shares[2] > 0.5}
    kinds["rotations"] = ~(kinds["horizontal"] | kinds["vertical"])
    found = {f"isolation.setup.damping-{kind}": damping[rows].mean() for kind, rows in kinds.items()}
    return found | rig_values(twin)


def rig_values(twin: Twin) -> dict[str, float]:
    """Suspension frequencies to the printed digits, equivalent mass and diagonal dominance, as the ledger has them."""
    passive = suspension_modes(twin, feedback=False).frequencies_hz
    return {
        "isolation.setup.suspension-frequencies": float(np.mean((passive > 14.95) & (passive < 45.05))),
        "isolation.setup.equivalent-mass": twin.plant.equivalent_mass,
        "isolation.setup.diagonal-dominance": float(
            np.mean(dominance(twin, np.geomspace(1, 1000, 2000)) > 1)
        ),
    }


def follows_criteria(low_pass_hz: float) -> float:
    """Share of the one-third-octave bands from 8 to 80 Hz in which the flat floor lies between BBN-C and BBN-B."""
    grid = np.geomspace(1, 90, 2000)
    bands, velocity = one_third_octave_velocity(grid, flat_floor(low_pass_hz).density(grid)[0])
    judged = (bands > 7.9) & (bands < 81)
    upper, lower = (criterion_velocity(name, bands) for name in ("BBN-B", "BBN-C"))
    return float(np.mean(((velocity < upper) & (velocity > lower))[judged]))


def between_criteria(floors: dict[str, ShapedFloor]) -> tuple[dict[str, float], dict[str, float]]:
    """Rms acceleration from 4 to 80 Hz of each floor, and of BBN-B and BBN-C, m/s^2."""
    grid = np.geomspace(1, 90, 2000)

    def rms(density: np.ndarray) -> float:
        return float(np.sqrt(band_power(grid, density, 4.0, 80.0)))

    found = {name: rms(floor.density(grid)[0]) for name, floor in floors.items()}
    return found, {name: rms(criterion_density(name, grid)) for name in ("BBN-B", "BBN-C")}


def floor_bands(*, floor_upper_end: float, seed: int) -> dict[str, float]:
    """Fig. 2's flat floor beside the criteria."""
    return {"isolation.fig-2.flat-follows-criteria": follows_criteria(floor_upper_end)}


# === Appendix =====================================================================================================


def appendix(page, *, rigid: Twin, fitted: Twin, floors: dict[str, ShapedFloor], fit) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    rigid, fitted : Twin
    floors : dict of str to ShapedFloor
    fit : control.TransferFunction
        Equation (2), discrete.
    """
    page.text("""## Numbers of the rig and its floor

Modes without and with the skyhook loop; what lag and delay of the sampled loop add to the damping dω/2k; rms acceleration at 4-80 Hz of the floors and the criteria; deviation from (2) at 5-500 Hz.""")
    passive, closed = suspension_modes(rigid, feedback=False), suspension_modes(rigid)
    more = 100 * (closed.damping / rigid.rig.damping_ratios(rigid.skyhook.gain) - 1)
    rms, limits = between_criteria(floors)
    band = np.linspace(5, 500, 500)
    page.show(
        f"passive, Hz: {passive.frequencies_hz.round(1)}, damping {passive.damping.round(2)}",
        f"with skyhook, Hz: {closed.frequencies_hz.round(1)}, damping {closed.damping.round(2)}",
        f"above dω/2k, %: {more.round().astype(int)}",
        *(f"{name}: {value:.2g} m/s²" for name, value in {**rms, **limits}.items()),
    )
    for twin in (rigid, fitted):
        error = np.abs(fit_error_db(twin, band, fit)).max(axis=0)
        page.show(f"{twin.name}: up to {error.max():.1f} dB, at {band[error.argmax()]:.0f} Hz")
    page.text("""## Is the path diagonally dominant?

We test it on the open loop of the rigid body: each diagonal element against the sum of the others in its row. It is so at low
frequencies only; above the suspension frequencies a diagonal element is about twice any other of its row, but less than their
sum. Then the damping of (2).""")
    page.check("isolation.setup.diagonal-dominance", rig_values(rigid)["isolation.setup.diagonal-dominance"])
    path = rigid.feedforward.path
    page.check("isolation.setup.damping-fit", path.damping / (2 * np.sqrt(path.stiffness * path.mass)))
