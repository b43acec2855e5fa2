"""The command `design` of a matrix response: by SciPy's own plant, sample by sample, and by the C that it writes."""

import ctypes
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from motion.test_decoupled import HZ, accelerance, machine
from motion.true_machines import error_law
from shared.compiled import STRICT, call, pointer
from stillwork.base.checks import InputError
from stillwork.identification.machine_files import load_machine
from stillwork.machine import retest
from stillwork.machine.axes import _first_fitted, read_axes
from stillwork.machine.axes_loops import AxesLoops
from stillwork.machine.axes_modes import fit_matrix
from stillwork.machine.decoupled import Axes, decouplings
from stillwork.machine.design import design_file
from stillwork.machine.retest import retest_file

RATE = 5e3
BOX = "frequency=0.02,gain=0.05,none"


def sampled(omega, ratio, out, into):
    """A, B, C of a machine with the force held, one sample late, by SciPy."""
    n, m = 2 * len(omega), into.shape[1]
    a, b, c = np.zeros((n, n)), np.zeros((n, m)), np.zeros((len(out), n))
    for k, w in enumerate(omega):
        a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, 1.0], [-w * w, -2 * ratio * w]]
    b[1::2], c[:, ::2] = into, out
    a, b, *_ = signal.cont2discrete((a, b, c, np.zeros((len(out), m))), 1 / RATE)
    late = np.block([[a, b], [np.zeros((m, n + m))]])
    return late, np.vstack([np.zeros((n, m)), np.eye(m)]), np.hstack([c, np.zeros((len(out), m))])


def written(folder):
    """T_y, T_u and A, B, C, D of each axis's controller from its error to its force, by the files."""
    about = json.loads((folder / "axes.json").read_text())
    laws = []
    for each in about["axes"]:
        laws.append(error_law(json.loads((folder / each["controller"]).read_text())["state_space"]))
    return np.array(about["sensing"]), np.array(about["actuation"]), laws, about


def closed_loop(plant, folder):
    """Largest magnitude of a pole with all axes closed, and peaks (dB) of each axis's error over its own setpoint."""
    a, b, c = plant
    sensing, actuation, laws, _ = written(folder)
    b, c = b @ actuation, sensing @ c
    n, sizes = len(a), [len(law[0]) for law in laws]
    whole = np.zeros((n + sum(sizes), n + sum(sizes)))
    given = np.zeros((len(whole), len(laws)))
    whole[:n, :n] = a
    place = n
    for k, (ak, bk, ck, dk) in enumerate(laws):
        own = slice(place, place + len(ak))
        whole[:n, :n] -= b[:, [k]] @ dk @ c[[k]]
        whole[:n, own] += b[:, [k]] @ ck
        whole[own, :n] -= bk @ c[[k]]
        whole[own, own] = ak
        given[:n, k], given[own, k] = (b[:, [k]] @ dk)[:, 0], bk[:, 0]
        place += len(ak)
    read = np.hstack([-c, np.zeros((len(c), len(whole) - n))])
    z = np.exp(1j * np.concatenate([np.geomspace(1e-3, np.pi, 4000)]))
    found = [np.diag(read @ np.linalg.solve(each * np.eye(len(whole)) - whole, given)) + 1 for each in z]
    return np.abs(np.linalg.eigvals(whole)).max(), 20 * np.log10(np.abs(found).max(axis=0))


def design(folder, seen, name="machine", **more):
    np.savez(folder / f"{name}.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
    options = {"uncertainty": BOX} | more
    return design_file(str(folder / f"{name}.npz"), str(folder / name), RATE, **options)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "seed"), [(2, 1), (3, 2)])
def test_the_true_machine_is_stable_and_keeps_its_peaks(tmp_path, untuned, n, seed):
    """With gains of the axes anywhere at the ends of the box, too; and inputs in other units and order change nothing."""
    true = machine(n, seed)
    said = design(tmp_path, accelerance(*true), limit=30.0)
    omega, ratio, out, into = true
    radius, peaks = closed_loop(sampled(*true), tmp_path / "machine")
    *_, about = written(tmp_path / "machine")
    assert "stable, whichever axes are open" in said[1] and radius < 1
    assert peaks == pytest.approx(about["checked"]["sensitivity_db"], abs=0.05)
    assert peaks.max() < 6.02
    for signs in np.random.default_rng(0).choice([0.95, 1.05], (4, n)):
        moved = sampled(omega, ratio, out, into * signs)
        assert closed_loop(moved, tmp_path / "machine")[0] < 1
    units, order = np.geomspace(1e-2, 1e2, n), np.roll(np.arange(n), 1)
    design(tmp_path, accelerance(omega, ratio, out, (into * units)[:, order]), "turned")
    one, other = (
        np.sort([each["provenance"]["design_hz"] for each in _controllers(tmp_path / name)])
        for name in ("machine", "turned")
    )
    assert one == pytest.approx(other, rel=1e-3)


@pytest.mark.slow
def test_axes_that_act_on_each_other_are_slowed_until_the_true_machine_holds(tmp_path, untuned):
    """Two modes that only couple the axes, which no axis alone shows."""
    omega, ratio, out, into = machine(2, 1)
    into = into @ np.linalg.inv(out[:, :2] @ into[:2])
    omega = np.append(omega, 2 * np.pi * np.array([140.0, 150.0]))
    out, into = np.hstack([out, 30.0 * np.eye(2)]), np.vstack([into, np.eye(2)[::-1]])
    said = design(tmp_path, accelerance(omega, ratio, out, into))
    assert any("slowed from" in line for line in said)
    pages = [(tmp_path / "machine" / f"axis-{k}" / "report.html").read_text() for k in (1, 2)]
    for k, page in enumerate(pages, 1):
        assert ("slowed from" in page) is any(line.startswith(f"axis {k} slowed") for line in said)
    radius, peaks = closed_loop(sampled(omega, ratio, out, into), tmp_path / "machine")
    assert radius < 1 and peaks.max() < 6.05


@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_mode_that_moves_does_so_in_all_entries_as_in_the_true_machine(n):
    """Its parts and what it adds, by the response of the machine whose modes have moved; behind any decoupling."""
    omega, ratio, out, into = machine(n, n, modes=3)
    rng = np.random.default_rng(n)
    sensing, actuation = (np.eye(n) + 0.1 * rng.uniform(-1, 1, (n, n)) for _ in range(2))
    late = 3e-4
    seen = sensing @ accelerance(omega, ratio, out, into, delay=late) @ actuation
    modes = fit_matrix(2 * np.pi * HZ, seen, [], late)
    assert np.sort(modes.frequencies) == pytest.approx(omega[n:], rel=1e-3)
    factors = np.array([1.05, 0.97, 1.02])
    order = np.argsort(modes.frequencies)
    moved = accelerance(np.append(omega[:n], factors * omega[n:]), ratio, out, into, delay=late)
    given = np.empty(3)
    given[order] = factors
    added = sensing @ moved @ actuation - seen
    assert np.abs(modes.moved(2 * np.pi * HZ, given) - added).max() < 0.02 * np.abs(added).max()


@pytest.mark.slow
@pytest.mark.parametrize(("n", "seed"), [(2, 4), (3, 6)])
def test_each_mode_of_the_true_machine_may_move_by_itself(tmp_path, untuned, n, seed):
    """Also modes that only couple the axes: by the poles and sensitivities of the true machine with each of them moved."""
    omega, ratio, out, into = machine(n, seed)
    into = into @ np.linalg.inv(out[:, :n] @ into[:n])
    rng = np.random.default_rng(seed)
    omega = np.append(omega, 2 * np.pi * rng.uniform(100.0, 200.0, n))
    out, into = np.hstack([out, 30.0 * np.eye(n)]), np.vstack([into, np.roll(np.eye(n), 1, axis=0)])
    said = design(tmp_path, accelerance(omega, ratio, out, into), uncertainty="frequency=0.05,gain=0.05,none")
    assert any("each mode moves by itself in all entries" in line for line in said)
    for k in range(n, len(omega)):
        for factor in (0.95, 0.97, 1.03, 1.05):
            moved = omega * np.where(np.arange(len(omega)) == k, factor, 1.0)
            radius, peaks = closed_loop(
                sampled(moved, ratio, out, into * rng.choice([0.95, 1.05], n)), tmp_path / "machine"
            )
            assert radius < 1 and peaks.max() < 6.1


@pytest.mark.slow
def test_a_geometry_is_taken_with_more_sensors_than_axes(tmp_path, untuned):
    """T_y of three sensors by their places, T_u computed; by the true machine's poles."""
    omega, ratio, out, into = machine(2, 3)
    out = np.vstack([out, [[0.5, 0.5]] @ out])
    sensing = np.linalg.pinv(out[:, :2])
    np.savez(
        tmp_path / "plant.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": accelerance(omega, ratio, out, into)}
    )
    text = f'[decoupling]\nresponse = "plant.npz"\naxes = ["z", "tilt"]\nsensing = {sensing.tolist()}\n'
    (tmp_path / "my.toml").write_text(text + 'units = [["m", "N"], ["rad", "N"]]\n')
    said = design_file(str(tmp_path / "my.toml"), str(tmp_path / "machine"), RATE, uncertainty=BOX)
    radius, peaks = closed_loop(sampled(omega, ratio, out, into), tmp_path / "machine")
    assert "sensing as given; z:" in said[0] and radius < 1 and peaks.max() < 6.02
    assert (
        "largest |S_kk|" in said[1]
        and said[2].startswith("C and reasons")
        and said[3].startswith("among the places each mode moves by itself")
        and said[3].endswith("; not promised: what lies between the lines or beyond them")
    )
    assert _controllers(tmp_path / "machine")[1]["provenance"]["mass_unit"] == "N/(rad/s^2)"


def test_what_is_missing_of_a_geometry_is_named(tmp_path):
    seen = accelerance(*machine(3, 3))[:, :, :2]
    np.savez(tmp_path / "plant.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
    np.savez(tmp_path / "two.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen[:, :2]})
    with pytest.raises(InputError, match="one matrix at a time"):
        design_file([str(tmp_path / "two.npz")] * 2, str(tmp_path / "out"), RATE)
    with pytest.raises(InputError, match=r"plant\.npz holds 3 outputs and 2 inputs"):
        design_file(str(tmp_path / "plant.npz"), str(tmp_path / "out"), RATE)
    for text, message in (
        ("sensing = [[1.0, 0.0]]", "sensing"),
        ("sensing = [[1.0, 0.0, 0.0]]", "2 inputs"),
        ("sensor = 1", "unknown name 'sensor'"),
        ("outputs = ['1', '2', '4']", "name them alike"),
        ("sensing = [[1.0, 0, 0], [0, 1.0, 0]]\naxes = ['z']", "1 and 2 of 2 axes"),
        ("sensing = [[1.0, 0, 0], [0, 1.0, 0]]\nunits = ['m', 'N']", r'units = \[\["m", "N"\], '),
        ("sensing = [[1.0, 0, 0], [0, 1.0, 0]]\nunits = 'm'", r'units = \[\["m", "N"\], '),
        ("sensing = [[1.0, 0, 0], [2.0, 0, 0]]", "sensing has rank 1, and 2 axes: its rows depend"),
    ):
        (tmp_path / "my.toml").write_text(f'[decoupling]\nresponse = "plant.npz"\n{text}\n')
        with pytest.raises(InputError, match=message):
            design_file(str(tmp_path / "my.toml"), str(tmp_path / "out"), RATE)
    assert not (tmp_path / "out").exists()


def test_columns_of_mixed_units_are_refused_with_a_cure_that_keeps_them_true(tmp_path):
    seen = accelerance(*machine(2, 3))
    motion, drive = ("m/s^2", "rad/s^2"), ("N", "(N m)")
    named = {f"h{o + 1}{i + 1} ({motion[o]}/{drive[i]})": seen[:, o, i] for o in range(2) for i in range(2)}
    np.savez(tmp_path / "plant.npz", **{"frequency (Hz)": HZ}, **named)
    with pytest.raises(InputError, match=r"mixed units are not taken; .* state sensing and units in a table"):
        read_axes(str(tmp_path / "plant.npz"), {})
    np.savez(tmp_path / "plant.npz", **{"frequency (Hz)": HZ, "h": seen})
    text = 'sensing = [[1.0, 0.0], [0.0, 1.0]]\nunits = [["m", "N"], ["rad", "N m"]]\n'
    (tmp_path / "my.toml").write_text(f'[decoupling]\nresponse = "plant.npz"\n{text}')
    wanted = read_axes(str(tmp_path / "my.toml"), {})
    assert wanted.units == (("m", "N"), ("rad", "N m")) and "largest actuator" in wanted.matrix.notes[-1]
    # Where all actuators are in N, no computed combination of them is in N m; a given one may be.
    with pytest.raises(
        InputError, match=r"forces in N m, but those of the actuators are in N.*give actuation"
    ):
        read_axes(str(tmp_path / "my.toml"), {"force_unit": "N", "response_unit": "m/s^2"})
    with (tmp_path / "my.toml").open("a") as file:
        file.write("actuation = [[1.0, 2.0], [1.0, -2.0]]\n")
    assert not read_axes(
        str(tmp_path / "my.toml"), {"force_unit": "N", "response_unit": "m/s^2"}
    ).matrix.notes


def test_a_negative_magnitude_is_refused_unless_it_is_in_db(tmp_path):
    seen = accelerance(*machine(1, 3))[:, 0, 0]
    size, phase = 20 * np.log10(np.abs(seen)) - 40, np.degrees(np.angle(seen))

    def read(name):
        table, header = np.column_stack([HZ, size, phase]), f"frequency (Hz),{name},Phase (deg)"
        np.savetxt(tmp_path / "plant.csv", table, delimiter=",", header=header, comments="")
        return np.abs(load_machine(tmp_path / "plant.csv").accelerance.response)

    for name, cure in (
        ("Gain", "Gain (dB)"),
        ("Gain (1)", "Gain (dB)"),
        ("Gain (m/s^2/N)", "Gain (dB re 1 m/s^2/N)"),
    ):
        with pytest.raises(
            InputError, match=f"no linear magnitude is negative; name it {re.escape(cure)} if"
        ):
            read(name)
        assert read(cure) == pytest.approx(10 ** (size / 20))


def test_names_and_units_are_refused_of_axes_that_are_only_found(tmp_path):
    """By their index they would stand on axes in any order, in the page and in the C."""
    true = machine(2, 3)
    np.savez(tmp_path / "plant.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": accelerance(*true)})
    for text, message in (
        ('units = [["m", "N"], ["rad", "N m"]]', "units is given without sensing"),
        ('axes = ["z", "tilt"]', "axes is given without sensing or actuation"),
        (
            f'units = [["m", "N"]]\nactuation = {np.linalg.inv(true[3][:2]).tolist()}',
            "units is given without",
        ),
    ):
        (tmp_path / "my.toml").write_text(f'[decoupling]\nresponse = "plant.npz"\n{text}\n')
        with pytest.raises(InputError, match=message):
            read_axes(str(tmp_path / "my.toml"), {})


def test_the_order_of_a_geometry_is_stated_or_clear(tmp_path):
    seen = accelerance(*machine(2, 3))
    named = {f"y{10 - o}/u{i + 1} (m/s^2/N)": seen[:, o, i] for o in range(2) for i in range(2)}
    np.savez(tmp_path / "plant.npz", **{"frequency (Hz)": HZ}, **named)
    toml = tmp_path / "my.toml"
    text = '[decoupling]\nresponse = "plant.npz"\nsensing = [[1.0, 0.0], [0.0, 2.0]]\n'
    toml.write_text(text)
    with pytest.raises(InputError, match=r'outputs = \["y10", "y9"\]'):
        read_axes(str(toml), {})
    toml.write_text(text + 'outputs = ["y9", "y10"]\n')
    matrix = read_axes(str(toml), {}).matrix
    assert matrix.outputs == ("y9", "y10") and np.allclose(matrix.accelerance, seen[:, ::-1])


def test_a_given_axis_that_moves_against_its_force_is_refused_and_not_turned(tmp_path):
    omega, ratio, out, into = machine(2, 3)
    seen = accelerance(omega, ratio, out, into)
    np.savez(tmp_path / "plant.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
    sensing, actuation = np.linalg.inv(out[:, :2]), np.linalg.inv(into[:2]) * [1.0, -1.0]
    text = f"sensing = {sensing.tolist()}\nactuation = {actuation.tolist()}\n"
    (tmp_path / "my.toml").write_text(f'[decoupling]\nresponse = "plant.npz"\n{text}')
    with pytest.raises(InputError, match="axis 2, as given: it moves against its force; turn the signs"):
        design_file(str(tmp_path / "my.toml"), str(tmp_path / "out"), RATE)


def test_an_assumed_unit_is_not_stated_of_an_axis(tmp_path):
    omega, ratio, out, into = machine(2, 1)
    seen = accelerance(omega, ratio, out, into)
    for name, noted in (("h", True), ("h (m/s^2/N)", False)):
        file = tmp_path / "plant.npz"
        np.savez(file, **{"frequency (Hz)": HZ, name: seen})
        wanted = read_axes(str(file), {})
        given = Axes(np.linalg.inv(out[:, :2]), np.linalg.inv(into[:2]), "as given")
        _first_fitted(wanted, [given], tmp_path, (0.0, 0.0))
        assert bool(load_machine(tmp_path / "axis-1.npz").notes[1:]) is bool(wanted.matrix.notes) is noted


def _controllers(folder):
    about = json.loads((folder / "axes.json").read_text())
    return [json.loads((folder / each["controller"]).read_text()) for each in about["axes"]]


@pytest.mark.slow
def test_a_retest_of_the_whole_holds_on_its_machine_and_not_on_one_that_has_changed(
    tmp_path, untuned, monkeypatch
):
    """By the poles of the changed machine's loops: stable, and unstable where an actuator has turned round or is strong."""
    omega, ratio, out, into = machine(2, 1)
    design(tmp_path, accelerance(omega, ratio, out, into))
    held = str(tmp_path / "machine" / "axes.json")
    for name, factors in (("same", [1.0, 1.0]), ("strong", [1.0, 4.0]), ("turned", [1.0, -1.0])):
        seen = accelerance(omega, ratio, out, into * factors)
        file = str(tmp_path / f"{name}.npz")
        np.savez(file, **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
        said = retest_file(held, file, str(tmp_path / f"{name}.html"))
        radius, peaks = closed_loop(sampled(omega, ratio, out, into * factors), tmp_path / "machine")
        holds = bool(radius < 1 and peaks.max() < 6.01)
        assert ("the promise holds" in said[0]) is holds is (name == "same"), said
        assert (
            len(said) == 3 and said[1].count("|S_kk|") == 2 and said[2] == f"written: {tmp_path / name}.html"
        )
    turned = {f"h{o + 1}{i + 1} (m/s^2/N)": seen[:, o, i] * factors[i] for i in (1, 0) for o in (1, 0)}
    for named, verdict in (
        (turned, "the promise holds"),  # in another order, which is taken by the names
        ({name.replace("2 ", "3 ").replace("h2", "h3"): each for name, each in turned.items()}, None),
        ({name.replace("/N", "/A"): each for name, each in turned.items()}, None),
    ):
        np.savez(file, **{"frequency (Hz)": HZ}, **named)
        if verdict:
            said = retest_file(held, file, str(tmp_path / "reordered.html"), verbose=True)
            assert verdict in said[0] and "outputs in order: 1, 2; inputs in order: 1, 2" in said[4]
            continue
        with pytest.raises(InputError, match=r"name them alike|in the units of the design"):
            retest_file(held, file, str(tmp_path / "none.html"))
    with monkeypatch.context() as patched:
        patched.setattr(retest, "turns", lambda *_: (1, False))
        said = retest_file(held, str(tmp_path / "same.npz"), str(tmp_path / "few.html"))
        assert "not decided: the lines are too far apart" in said[0]
    with pytest.raises(InputError, match="is of 2 over 2"):
        np.savez(file, **{"frequency (Hz)": HZ, "h (m/s^2/N)": accelerance(*machine(3, 1))})
        retest_file(held, file, str(tmp_path / "other.html"))
    own = str(tmp_path / "machine" / "axis-1" / "controller_1.json")
    file = str(tmp_path / "machine" / "axis-1.npz")
    assert "the promise holds" in retest_file(own, file, str(tmp_path / "own.html"))[0]


@pytest.mark.parametrize("seed", range(4))
def test_another_order_or_sign_shows_at_the_lowest_lines(seed):
    """Whatever the controllers; noise and a change of gain within the box do not."""
    true, rng = machine(2, seed), np.random.default_rng(seed)
    _, (axes, *_) = decouplings(HZ, accelerance(*true))
    seen = axes.of(accelerance(*true))
    controllers = rng.standard_normal((len(HZ), 2)) + 1j * rng.standard_normal((len(HZ), 2))
    alone = 1 + np.einsum("fii->fi", seen) * controllers
    omega, ratio, out, into = true

    def found(out, into):
        other = axes.of(accelerance(omega, ratio, out, into))
        noisy = other * (1 + 0.02 * rng.standard_normal(other.shape))
        return retest._strange(noisy * controllers[:, None, :], alone)

    assert found(out, into * [1.1, 0.9]) == ""
    for changed in (
        (out[::-1], into),
        (out, into[:, ::-1]),
        (out, into * [1, -1]),
        (out, -into),
        (out, into * [1, 9]),
    ):
        assert "another order or sign" in found(*changed)


def test_what_one_axis_makes_of_another_is_the_closed_form_of_two():
    """S_jk = -L_jk / det(I + L), the largest over lines and places."""
    rng = np.random.default_rng(7)
    gains = [rng.standard_normal((9, 2, 2)) + 1j * rng.standard_normal((9, 2, 2)) for _ in range(3)]
    closed = SimpleNamespace(loops=[None, None], gains=lambda places: [gains[k] for k in places])
    for places in ([0], [0, 1, 2]):
        found, sizes = AxesLoops.crossed(closed, places), []
        for k in places:
            (a, b), (c, d) = np.moveaxis(gains[k], 0, -1)
            sizes.append(
                np.abs(np.array([[1 + d, -b], [-c, 1 + a]]) / ((1 + a) * (1 + d) - b * c)).max(axis=-1)
            )
        assert found == pytest.approx(np.max(sizes, axis=0))


@pytest.mark.slow
def test_a_diagonal_matrix_has_the_designs_of_its_entries(tmp_path, untuned):
    seen = accelerance(*machine(2, 5))
    seen[:, 0, 1] = seen[:, 1, 0] = 0.0
    design(tmp_path, seen)
    for k, held in enumerate(_controllers(tmp_path / "machine")):
        np.savez(tmp_path / f"{k}.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen[:, k, k]})
        design_file(str(tmp_path / f"{k}.npz"), str(tmp_path / str(k)), RATE, uncertainty=BOX)
        alone = json.loads((tmp_path / str(k) / "controller.json").read_text())
        assert held["state_space"] == alone["state_space"] and held["gains"] == alone["gains"]


@pytest.mark.slow
def test_the_c_of_the_whole_is_the_recursion_of_its_files(tmp_path, untuned):
    design(tmp_path, accelerance(*machine(2, 1)))
    folder = tmp_path / "machine"
    driver = """
#include "controller.h"
void run(long samples, const double *error, double *out)
{
    static controller_state s;
    for (long k = 0; k < samples; k++)
        (void)controller_step(&s, error + 2 * k, out + 2 * k);
}
"""
    (folder / "driver.c").write_text(driver)
    assert "   error[] in m: 1, 2\n   out[] in N: 1, 2\n*/" in (folder / "controller.h").read_text()
    page = (folder / "report.html").read_text()
    assert "Largest |S_jk|" in page and "in the middle of the box only; not promised" in page
    sources = ["controller.c", "axis-1/controller_1.c", "axis-2/controller_2.c"]
    call(["g++", "-std=c++17", "-x", "c++", *STRICT, "-fsyntax-only", sources[0]], folder)
    call(
        ["gcc", "-std=c99", *STRICT, "-O2", "-fPIC", "-shared", *sources, "driver.c", "-o", "all.so", "-lm"],
        folder,
    )
    error = np.random.default_rng(2).standard_normal((400, 2)) * 1e-6
    out = np.zeros_like(error)
    ctypes.CDLL(str(folder / "all.so")).run(ctypes.c_long(len(error)), pointer(error), pointer(out))
    sensing, actuation, laws, _ = written(folder)
    q = error @ sensing.T
    forces = [signal.dlsim((*law, 1.0), q[:, k])[1][:, 0] for k, law in enumerate(laws)]
    expected = np.stack(forces, axis=1) @ actuation.T
    assert out == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
