"""The command `design` of a matrix response: by SciPy's own plant, sample by sample, and by the C that it writes."""

import ctypes
import json

import numpy as np
import pytest
from scipy import signal

from motion.test_decoupled import HZ, accelerance, machine
from shared.compiled import STRICT, call, pointer
from stillwork.machine.design import design_file

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
        space = json.loads((folder / each["controller"]).read_text())["state_space"]
        a, b, c, d = (np.array(space[name], dtype=float) for name in "abcd")
        laws.append((a + b[:, 1:] @ c, b[:, :1] + b[:, 1:] @ d[:, :1], c, d[:, :1]))
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


def _controllers(folder):
    about = json.loads((folder / "axes.json").read_text())
    return [json.loads((folder / each["controller"]).read_text()) for each in about["axes"]]


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
