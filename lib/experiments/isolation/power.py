"""Power that the feedforward removes, and the limit that output noise sets (section 5.2.2, Fig. 8)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import ShapedFloor
from experiments.isolation.performance import CaseRecord, expected_density, record_cases, third_octaves, tune
from experiments.isolation.simulation import sample_seeds
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array
from stillwork.signals.spectra import Spectrum, band_power

BAND_HZ = (1.0, 300.0)  # the paper's range of interest
RESOLUTION_HZ = 0.25  # fine enough for the suspension's skirt at 1 Hz


def reduction_percent(
    frequencies_hz: ArrayLike, before: ArrayLike, after: ArrayLike
) -> Float64[np.ndarray, " channels"]:
    """Share of the power at 1-300 Hz that is gone, per cent, for densities of shape (channels, frequencies)."""
    left, total = (
        np.array([band_power(frequencies_hz, row, *BAND_HZ) for row in rows]) for rows in (after, before)
    )
    return 100 * (1 - left / total)


def without_lines(spectrum: Spectrum, lines_hz: ArrayLike) -> Spectrum:
    """Spectrum with a straight bridge over two bins on either side of each line (a Hann window's main lobe)."""
    f, density = spectrum.frequencies_hz, spectrum.density.copy()
    for line in require_array("lines_hz", lines_hz, ndim=1):
        middle = int(np.argmin(np.abs(f - line)))
        ends = [max(middle - 3, 0), min(middle + 3, len(f) - 1)]
        inside = slice(ends[0] + 1, ends[1])
        density[:, inside] = [np.interp(f[inside], f[ends], row[ends]) for row in density]
    return Spectrum(f, density, spectrum.averages)


def limit_ratio_db(
    frequencies_hz: ArrayLike, density: ArrayLike, limit: ArrayLike, lines_hz: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], Float64[np.ndarray, "3 bands"]]:
    """Mean density of several runs over that of the limit, in one-third-octave bands from 3 to 200 Hz, dB.

    Densities have shape (runs, 3, frequencies); mains lines are bridged because their size in the twins is assumed.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    centres, inside = third_octaves(f)
    over, under = (
        without_lines(Spectrum(f, np.mean(np.asarray(each), axis=0), len(each)), lines_hz).density
        for each in (density, limit)
    )
    ratio = [over[:, band].mean(axis=1) / under[:, band].mean(axis=1) for band in inside]
    return centres, 10 * np.log10(np.stack(ratio, axis=1))


def floor_level_for(
    twin: Twin, floor: ShapedFloor, weights: ArrayLike, removed_percent: ArrayLike
) -> Float64[np.ndarray, "3"]:
    """Amplitude of the floor in z, θx, θy, relative to `floor`, at which given shares of the power are removed.

    The sensors' noise stays, so a weaker floor leaves a larger share. Weights are kept.

    The shares are those of the power at 1-300 Hz that are removed, per cent, over feedback only.
    """
    left = 1 - require_array("removed_percent", removed_percent, shape=(3,)) / 100
    f = np.geomspace(*BAND_HZ, 1000)
    powers = []
    for given in (None, weights):
        causes = expected_density(twin, floor, f, weights=given)
        by_floor = np.array([band_power(f, row, *BAND_HZ) for row in causes["floor"]])
        noise = np.array(
            [band_power(f, row, *BAND_HZ) for row in causes["floor noise"] + causes["output noise"]]
        )
        powers.append((by_floor, noise))
    (floor_before, noise_before), (floor_after, noise_after) = powers
    square = (noise_after - left * noise_before) / (left * floor_before - floor_after)
    if np.any(square <= 0):
        raise InputError("removed_percent cannot be reached with these weights; give a lower value")
    return np.sqrt(square)


def power_trial(
    draws: Sequence[np.random.Generator],
    *,
    twin: Twin,
    floor: ShapedFloor,
    felms_s: float | None,
    ferls_s: float,
    record_s: float,
) -> list[dict[str, np.ndarray]]:
    """Repetitions of the experiment of Fig. 8 for `run_study` with `together`: adapt, freeze, record, compare.

    ``removed FeLMS``, ``removed FeRLS``: share of the power at 1-300 Hz that the feedforward removes from the
    feedback-only case, per cent, (3,); ``removed limit``: the same if only the output noise were left;
    ``removed with mains``: as FeRLS, lines counted, which all others but the spectra bridge. ``in band``, ``above band``: power with
    FeRLS over that of the output noise at 3-200 and 300-500 Hz, (3,); ``low end``: power with FeRLS over feedback
    only at 1-2 Hz. ``density feedback``, ``... FeLMS``, ``... FeRLS``, ``... output noise``: spectra, (3,
    frequencies). Without `felms_s` FeLMS is left out.
    """
    seeds = sample_seeds(draws)
    tuned = tune(twin, floor, felms_s, ferls_s, seeds)
    records = {}
    for name in ("feedback", *tuned[0]):
        weights = None if name == "feedback" else [each[name] for each in tuned]
        after = [seed + 1 for seed in seeds]
        records[name] = record_cases(twin, floor, name, record_s, after, weights=weights)
    return [
        _removed(twin, dict(zip(records, each, strict=True))) for each in zip(*records.values(), strict=True)
    ]


def _removed(twin: Twin, records: dict[str, CaseRecord]) -> dict[str, np.ndarray]:
    measured = {name: record.spectrum(RESOLUTION_HZ) for name, record in records.items()}
    measured["output noise"] = records["feedback"].output_noise(RESOLUTION_HZ)
    bridged = {name: without_lines(each, twin.instruments.mains_hz) for name, each in measured.items()}
    f = measured["feedback"].frequencies_hz
    found: dict[str, np.ndarray] = {}
    if "FeLMS" in bridged:
        found["removed FeLMS"] = reduction_percent(f, bridged["feedback"].density, bridged["FeLMS"].density)
    return (
        found
        | measures(bridged["feedback"], bridged["FeRLS"], bridged["output noise"])
        | {
            "removed with mains": reduction_percent(
                f, measured["feedback"].density, measured["FeRLS"].density
            ),
            **{f"density {name}": spectrum.density for name, spectrum in measured.items()},
        }
    )


def measures(before: Spectrum, after: Spectrum, limit: Spectrum) -> dict[str, np.ndarray]:
    """Of FeRLS, in the words of `power_trial`, from spectra with feedback alone, with it, and of the output noise."""
    f = before.frequencies_hz
    return {
        "removed FeRLS": reduction_percent(f, before.density, after.density),
        "removed limit": reduction_percent(f, before.density, limit.density),
        "in band": after.power(3.0, 200.0) / limit.power(3.0, 200.0),
        "above band": after.power(300.0, 500.0) / limit.power(300.0, 500.0),
        "low end": after.power(1.0, 2.0) / before.power(1.0, 2.0),
    }
