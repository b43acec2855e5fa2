"""Matrix responses: read whole or refused, decoupled whatever their units, and judged as by the poles of their loops."""

import itertools

import numpy as np
import pytest
from scipy import linalg, signal
from scipy.io import savemat

from shared.universal_files import function, write_universal
from stillwork.base.checks import InputError
from stillwork.identification.matrix_files import load_matrix, places
from stillwork.machine.decoupled import decouplings, interaction, judge

HZ = np.arange(2.0, 600.0)


def machine(n, seed, modes=2, share=0.05, springs_hz=0.0):
    """Mass, loss and stiffness of rigid bodies and modes beside them, and where sensors and actuators are."""
    rng = np.random.default_rng(seed)
    hertz = np.concatenate([springs_hz * np.linspace(0.7, 1.3, n), np.sort(rng.uniform(150.0, 500.0, modes))])
    sensors, actuators = (np.eye(n) + 0.3 * rng.uniform(-1, 1, (n, n)) for _ in range(2))
    shapes = np.sqrt(share) * rng.uniform(0.5, 1.0, (2, modes, n)) * rng.choice([-1.0, 1.0], (1, modes, n))
    omega = 2 * np.pi * hertz
    return (
        omega,
        0.01,
        np.hstack([sensors / rng.uniform(2, 9, n), shapes[0].T]),
        np.vstack([actuators, shapes[1]]),
    )


def accelerance(omega, ratio, out, into, hertz=HZ, delay=0.0):
    """(lines, outputs, inputs) in 1/kg."""
    s = 2j * np.pi * hertz[:, None]
    modes = s**2 / (s**2 + 2 * ratio * omega * s + omega**2)
    return np.einsum("om,fm,mi->foi", out, modes, into) * np.exp(-s * delay)[:, :, None]


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("real 1,2", ("1", "2")), ("imag_h21", ("2", "1")), ("phase y2/u1 (deg)", ("y2", "u1")), ("P.frf[1,2]", ("1", "2")),
        ("magnitude 12 (m/s^2/N)", ("1", "2")), ("H_{y[0], u[1]}", ("y0", "u1")), ("frf 2+Z/10-X ((m/s2)/N)", ("2+Z", "10-X")),
        ("h ((rad/s^2)/(N m))[3,1]", ("3", "1")), ("frequency (Hz)", None), ("real 1", None), ("h (m/s^2/N)", None),
        ("real u2->y1 (m/N)", ("y1", "u2")), ("real u2 to y1", ("y1", "u2")), ("imaginary from input 2 to output 1", ("output1", "input2")),
        ("magnitude F2 X1", ("X1", "F2")), ("real y1 u2", ("y1", "u2")), ("real 2 \u2192 1", ("1", "2")), ("real a2/a1", ("a2", "a1")),
        ("real z/F1 (m/s^2/N)", ("z", "F1")), ("magnitude tilt/u (rad/N)", ("tilt", "u")), ("real g/N", None), ("h m/s", None),
    ],
)  # fmt: skip
def test_a_name_states_output_and_input(name, place):
    assert places([name]).get(name) == place


@pytest.mark.parametrize("name", ["real u2/y1", "real y1->u2"])
def test_a_name_that_says_both_is_refused(name):
    with pytest.raises(InputError, match="write it as output over input"):
        places([name])


def test_the_order_is_that_of_the_file_and_is_said(tmp_path):
    seen = accelerance(*machine(2, 1))
    named = {f"u{2 - i} to y{10 - o} (m/s^2/N)": seen[:, o, i] for o in range(2) for i in range(2)}
    np.savez(tmp_path / "m.npz", **{"frequency (Hz)": HZ}, **named)
    found = load_matrix(tmp_path / "m.npz")
    assert found.outputs == ("y10", "y9") and found.inputs == ("u2", "u1")
    assert np.allclose(found.accelerance, seen)
    assert found.order.startswith(
        "outputs in order: y10, y9; inputs in order: u2, u1 (u2 to y10 (m/s^2/N): output y10 "
    )


def test_each_form_of_a_matrix_comes_out_as_it_went_in(tmp_path):
    import control

    seen = accelerance(*machine(2, 1))
    whole = np.moveaxis(seen, 0, -1)
    np.savez(tmp_path / "a.npz", **{"frequency (Hz)": HZ, "h (m/s^2/N)": seen})
    np.savez(tmp_path / "frd.npz", omega=2 * np.pi * HZ, frdata=whole)
    savemat(tmp_path / "tool.mat", {"P": {"frf": whole, "freq_hz": HZ}})
    control.FrequencyResponseData(whole, 2 * np.pi * HZ).to_pandas().to_csv(tmp_path / "frd.csv")
    columns = {"frequency (Hz)": HZ}
    for o, i in np.ndindex(2, 2):
        columns[f"real h{o + 1}{i + 1} (m/s^2/N)"] = seen[:, o, i].real
        columns[f"imaginary h{o + 1}{i + 1} (m/s^2/N)"] = seen[:, o, i].imag
    np.savetxt(
        tmp_path / "pairs.csv",
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    for name in ("a.npz", "frd.npz", "tool.mat", "frd.csv", "pairs.csv"):
        found = load_matrix(tmp_path / name)
        assert np.allclose(found.accelerance, seen, rtol=1e-12), name
        assert np.allclose(found.hertz, HZ, rtol=1e-12)
        assert len(found.outputs) == len(found.inputs) == 2


def test_a_universal_file_is_a_matrix_by_nodes_and_directions(tmp_path):
    seen = accelerance(*machine(2, 1))
    ends = ((1, 3), (1, 2))
    write_universal(
        tmp_path / "m.uff",
        [
            function("frf", HZ, seen[:, o, i], node=1, reference=1, rsp_dir=ends[o][1], ref_dir=ends[i][1])
            for o in range(2) for i in range(2)
        ],
    )  # fmt: skip
    found = load_matrix(tmp_path / "m.uff")
    assert found.outputs == ("1+Z", "1+Y") and np.allclose(found.accelerance, seen, rtol=1e-6)


def test_one_response_is_no_matrix_and_a_part_of_one_is_refused(tmp_path):
    np.savez(tmp_path / "one.npz", f=HZ, h=accelerance(*machine(2, 1))[:, 0, 0])
    assert load_matrix(tmp_path / "one.npz") is None
    seen = accelerance(*machine(2, 1))
    np.savez(tmp_path / "part.npz", frequency=HZ, h11=seen[:, 0, 0], h12=seen[:, 0, 1], h21=seen[:, 1, 0])
    with pytest.raises(InputError, match="1 of the matrix are missing"):
        load_matrix(tmp_path / "part.npz")


@pytest.mark.parametrize("n", [2, 3, 6])
@pytest.mark.parametrize("springs_hz", [0.0, 40.0])
def test_the_low_end_becomes_diagonal_whatever_the_units(n, springs_hz):
    """By the true R of the machine: of its rigid bodies, or of its compliance at rest."""
    omega, ratio, out, into = machine(n, n, springs_hz=springs_hz)
    seen = accelerance(omega, ratio, out, into, delay=2e-4)
    low, (best, *_) = decouplings(HZ, seen)
    rigid = slice(n) if not springs_hz else slice(None)
    weights = np.ones(n) if not springs_hz else 1 / omega**2
    true = (out[:, rigid] * weights) @ into[rigid]
    inner = best.sensing @ true @ best.actuation
    assert low.free is not bool(springs_hz)
    assert np.abs(inner - np.diag(np.diag(inner))).max() < 0.02 * np.diag(inner).min()
    rng = np.random.default_rng(3)
    units, order = 10.0 ** rng.uniform(-3, 3, (2, n)), rng.permutation(n)
    given = units[0][:, None] * out, (into * units[1])[:, order]
    turned = accelerance(omega, ratio, *given, delay=2e-4)
    other = decouplings(HZ, turned)[1][0]
    left = (interaction(axes.of(seen)) for axes, seen in ((best, seen), (other, turned)))
    assert other.words == best.words and next(left) == pytest.approx(next(left), rel=1e-3, abs=1e-7)


@pytest.mark.parametrize("springs_hz", [4.0, 8.0])
def test_a_machine_on_soft_springs_is_decoupled_above_them(springs_hz):
    """By the true R of its bodies."""
    true = machine(2, 2, springs_hz=springs_hz)
    low, (axes, *_) = decouplings(HZ, accelerance(*true))
    rigid = axes.sensing @ true[2][:, :2] @ true[3][:2] @ axes.actuation
    assert low.free and interaction((rigid + 0j)[None])[0] < 0.05


@pytest.mark.parametrize("n", [2, 3, 6])
@pytest.mark.parametrize("low_hz", [10.0, 15.0, 22.0, 30.0])
def test_a_machine_whose_lines_begin_among_its_springs_is_decoupled_in_mass_and_stiffness(n, low_hz):
    """By SciPy's eigenvectors of random matrices, coupled in both, with two masses on springs of their own beside them."""
    rng = np.random.default_rng(10 * n)
    shape, turned = np.eye(n) + 0.3 * rng.uniform(-1, 1, (n, n)), np.linalg.qr(rng.standard_normal((n, n)))[0]
    body = shape.T @ np.diag(rng.uniform(2, 9, n)) @ shape
    root = np.linalg.cholesky(body) @ turned
    held = root @ np.diag((2 * np.pi * np.linspace(25.0, 40.0, n)) ** 2) @ root.T
    mass, stiffness = linalg.block_diag(body, 0.3 * np.eye(2)), linalg.block_diag(held, np.zeros((2, 2)))
    for k, hertz in enumerate((190.0, 310.0)):
        spring = np.append(rng.standard_normal(n) / np.sqrt(n), -np.eye(2)[k])
        stiffness += 0.3 * (2 * np.pi * hertz) ** 2 * np.outer(spring, spring)
    squares, shapes = linalg.eigh(stiffness, mass)
    out, into = (np.eye(n) + 0.3 * rng.uniform(-1, 1, (n, n)) for _ in range(2))
    hertz = np.arange(low_hz, 600.0)
    seen = accelerance(np.sqrt(squares), 0.01, out @ shapes[:n], shapes[:n].T @ into, hertz)
    seen = seen * (1 + 0.002 * rng.standard_normal(seen.shape))
    _, (axes, *_) = decouplings(hertz, seen)
    for inner in (np.linalg.inv(body), np.linalg.inv(held)):
        true = axes.sensing @ out @ inner @ into @ axes.actuation
        assert interaction((true + 0j)[None])[0] < 0.2


def test_what_has_fewer_rigid_bodies_than_axes_is_refused():
    omega, ratio, out, into = machine(3, 1)
    out[:, 0] = 0.0
    with pytest.raises(InputError, match="fewer rigid-body modes than axes"):
        decouplings(HZ, accelerance(omega, ratio, out, into))


def test_the_interaction_is_that_of_two_by_two_in_closed_form():
    seen = accelerance(*machine(2, 4))
    product = seen[:, 0, 1] * seen[:, 1, 0] / (seen[:, 0, 0] * seen[:, 1, 1])
    assert interaction(seen) == pytest.approx(np.sqrt(np.abs(product)), rel=1e-9)


def stable(kept, machine_, laws):
    """By the poles of all closed with these axes' controllers; the bodies of the other axes stay where they are."""
    a, b, c = machine_
    kept = list(kept)
    ak, bk, ck, dk = (linalg.block_diag(*(getattr(laws[j], m) for j in kept)) for m in "ABCD")
    closed = np.block([[a - b[:, kept] @ dk @ c[kept], b[:, kept] @ ck], [-bk @ c[kept], ak]])
    return np.linalg.eigvals(closed).real.max() < 1e-3


def test_loops_are_judged_as_their_poles_do():
    """Of random machines with a controller an axis: stable with all closed, or with any two, if SciPy's poles are."""
    hertz, seen = np.geomspace(0.05, 3e3, 6000), {True: 0, False: 0}
    omega = 2 * np.pi * hertz
    for seed in range(60):
        n = 2 + seed % 2
        modes, ratio, out, into = machine(n, seed, share=0.1)
        rng, one = np.random.default_rng(seed), np.eye(n)
        into = into @ np.linalg.inv(out[:, :n] @ into[:n])  # decoupled
        ends = list(itertools.permutations(range(n), 2))  # and modes that only couple two axes
        modes = np.append(modes, 2 * np.pi * rng.uniform(150.0, 200.0, len(ends)))
        out = np.hstack([out, *(rng.uniform(0.02, 0.6) * one[:, [i]] for i, _ in ends)])
        into = np.vstack([into, *(one[j] for _, j in ends)])
        a = linalg.block_diag(*([[0.0, 1.0], [-w * w, -2 * ratio * w]] for w in modes))
        b, c = np.zeros((len(a), n)), np.zeros((n, len(a)))
        b[1::2], c[:, ::2] = into, out
        speed = 2 * np.pi * rng.uniform(5.0, 60.0, n)
        laws = [signal.ZerosPolesGain([-v / 9, -v / 3], [0.0, -5 * v], 5 * v * v).to_ss() for v in speed]
        if not all(stable([j], (a, b, c), laws) for j in range(n)):
            continue
        inner = accelerance(modes, ratio, out, into, hertz) * (-1 / omega**2)[:, None, None]
        k = np.stack([signal.freqresp(law, omega)[1] for law in laws], axis=1)
        judged = judge([inner * k[:, None, :]])
        sets = [kept for size in range(2, n + 1) for kept in itertools.combinations(range(n), size)]
        broken = {kept for kept in sets if not stable(kept, (a, b, c), laws)}
        assert judged.counted and set(judged.unstable) == broken
        assert not broken or judged.bound.max() >= 1  # below 1 it is a proof
        seen[judged.stable] += 1
    assert min(seen.values()) > 3, seen
