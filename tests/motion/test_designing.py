"""The command `design`: what it writes controls the machine of the file, by python-control, and by the C itself."""

import ctypes
import json
import re

import numpy as np
import pytest
from scipy import signal

from shared.compiled import compiled, pointer
from stillwork.__main__ import main
from stillwork.base.checks import InputError
from stillwork.control.digital import from_biquads, load_controller
from stillwork.control.feedforward import Feedforward, Motion
from stillwork.control.machine_loops import pid_family
from stillwork.control.setpoint import MoveLimits
from stillwork.identification.machine import Machine, build_machine
from stillwork.identification.machine_files import load_machine, stated_units
from stillwork.lti.discretisation import tustin
from stillwork.lti.modal import modal_model
from stillwork.machine import promise
from stillwork.machine.design import WITHOUT_BIQUADS, design_file
from stillwork.machine.machine_designs import crossing, improvements, search_designs
from stillwork.machine.retest import retest_file
from workbook import paths

TEMPLATES = paths.data("motion", "your_machine")
RATE = 1e4
BOX = {"frequency": 0.05, "gain": 0.05}
MASS = np.diag([30.0, 10.0])
STIFFNESS = 1.5e7 * np.array([[1.0, -1.0], [-1.0, 1.0]])
PAIR = modal_model(MASS, STIFFNESS, [[1.0], [0.0]], [[0.0, 1.0]], damping_ratio=0.005)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder of the design of a non-collocated machine with limits of 40 N and of the setpoint, and what the command said."""
    folder = tmp_path_factory.mktemp("design")
    np.savez(folder / "<pair>.npz", M=MASS, K=STIFFNESS, input=[1.0, 0], output=[[0.0, 1.0]])
    said = design_file(
        str(folder / "<pair>.npz"),
        str(folder / "out"),
        RATE,
        limit=40.0,
        limits=[0.02, 0.5, 20.0],
        verbose=True,
    )
    return folder / "out", said


@pytest.mark.slow
def test_it_writes_all_of_it(written):
    """7 s of CPU, in the fixture that the tests below share: one whole design, as the command makes it."""
    folder = written[0]
    assert {file.name for file in folder.iterdir()} == {
        "controller.c", "controller.h", "controller_motion.c", "controller_motion.h", "controller.json", "report.html"
    }  # fmt: skip
    held = json.loads((folder / "controller.json").read_text())
    assert held["provenance"]["mass"] == pytest.approx(40.0) and held["high"] == [40.0]
    limits = held["motion"]["limits"]
    assert limits == {"velocity": 0.02, "acceleration": 0.5, "jerk": 20.0, "snap": None}
    assert (
        len(held["provenance"]["sha256"]) == 64
        and held["gains"]["gain"] > 0
        and held["biquads"]["relative_error"] < 1e-9
    )
    page = (folder / "report.html").read_text()
    assert (
        "&lt;pair&gt;.npz" in page
        and "<pair>" not in page
        and not re.search(r"(src|href)=\"http|<script", page)
    )
    assert held["provenance"]["uncertainty"] == {
        "frequency": [0.0, 0.05], "residue": [0.0, 0.0], "damping": [0.0, 0.0], "gain": 0.05, "mass": 0.0,
        "friction": 0.0, "delay": 0.0
    }  # fmt: skip


def test_limits_of_the_setpoint_are_checked_in_sum_before_the_search(tmp_path):
    """40 kg at 2 m/s^2 ask for more than 40 N."""
    file, out = changed(tmp_path, 1.0), str(tmp_path / "out")
    with pytest.raises(InputError, match=r"^limits\b.* sum to up to 80, the output is limited to 40"):
        design_file(file, out, RATE, limit=40.0, limits=[0.2, 2.0, 100.0])
    # At 10 mm/s a jerk of 100 m/s^3 brings 1 m/s^2: no move asks for more.
    Motion(Feedforward(acceleration=40.0), limits=MoveLimits(0.01, 2.0, 100.0)).require_within(40.0)


@pytest.mark.slow
def test_the_biquads_are_the_whole_controller(written):
    """By SciPy alone: as sections of r - y they move as the matrices do, and hold the machine by themselves."""
    held = json.loads((written[0] / "controller.json").read_text())
    space, sections = held["state_space"], held["biquads"]
    a, b, c, d = (np.array(space[name]) for name in "abcd")
    a, b, d = a + b[:, 1:] @ c, b[:, :1] + b[:, 1:] @ d[:, :1], d[:, :1]  # it is told its own force
    z = np.exp(1j * np.geomspace(1e-3, 3.1, 200))
    k = np.array([(c @ np.linalg.solve(each * np.eye(len(a)) - a, b) + d)[0, 0] for each in z])
    feedback = signal.sosfreqz(sections["feedback"], np.angle(z))[1]
    assert feedback == pytest.approx(k, rel=1e-8) and sections["reference"] is None
    top, bottom = signal.sos2tf(sections["feedback"])
    late = modal_model(MASS, STIFFNESS, [[1.0], [0.0]], [[0.0, 1.0]], damping_ratio=0.005).state_space()
    a, b, c, d, _ = signal.cont2discrete((late.a, late.b, late.c, late.d), 1 / RATE)
    plant = signal.StateSpace(
        np.block([[a, b], [np.zeros((1, 5))]]),
        np.eye(5)[:, 4:],
        np.append(c, [[0.0]], axis=1),
        [[0.0]],
        dt=1 / RATE,
    )
    cascade = from_biquads(sections["feedback"], 1 / RATE)
    loop = np.block([
        [plant.A - plant.B @ cascade.d @ plant.C, plant.B @ cascade.c],
        [-cascade.b @ plant.C, cascade.a],
    ])  # fmt: skip
    assert np.abs(np.linalg.eigvals(loop)).max() < 1 and len(top) == len(bottom)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_the_written_controller_keeps_six_decibels_by_python_control(written, factor):
    """On the machine of the file, and on those whose resonance is 5 % away from it."""
    import control

    controller = load_controller(written[0] / "controller.json")
    stiffness = factor**2 * STIFFNESS
    plant = modal_model(MASS, stiffness, [[1.0], [0.0]], [[0.0, 1.0]], damping_ratio=0.005)
    held = control.sample_system(plant.to_control(), 1 / RATE, "zoh")
    omega = 2 * np.pi * np.concatenate([np.geomspace(0.5, 4e3, 3000), np.linspace(205, 245, 4000)])
    z = np.exp(1j * omega / RATE)
    p = held(z) / z
    k = control.ss(controller.linear.to_control())(z)
    assert 20 * np.log10(np.abs(1 / (1 + k * p)).max()) < 6.01  # S, and r to e
    late = held * control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], 1 / RATE)
    loop = control.feedback(late * control.ss(controller.linear.to_control()), 1)
    assert np.all(np.abs(loop.poles()) < 1)


@pytest.mark.slow
def test_what_would_help_is_what_a_design_of_the_changed_file_finds(tmp_path):
    """Eight whole searches: with a sensor at the force, with twice the damping in files of their own, and without delay."""
    machine = Machine((PAIR,), 40.0, "pair")
    made = search_designs(machine, rate=2e3, delay=2.0)
    found = {words: (use, float(hertz)) for words, use, hertz in improvements([machine], made, 2.0)}
    arrays = {"M": MASS, "K": STIFFNESS, "input": [1.0, 0.0]}
    files = {  # three of the four; the other is of the kind of the last
        "the sensor where the force acts": (arrays | {"output": [[1.0, 0.0]]}, 0.005, 2.0),
        "twice the damping of its modes": (arrays | {"output": [[0.0, 1.0]]}, 0.01, 2.0),
        "no delay": (arrays | {"output": [[0.0, 1.0]]}, 0.005, 0.0),
    }
    before = bandwidth(made)
    for number, (words, (held, damping, delay)) in enumerate(files.items()):
        np.savez(tmp_path / f"{number}.npz", **held)
        said = design_file(
            str(tmp_path / f"{number}.npz"),
            str(tmp_path / f"out{number}"),
            2e3,
            delay=delay,
            damping_ratio=damping,
        )
        hertz = float(re.search(r"bandwidth of ([\d.]+) Hz", said[0])[1])
        if words in found:
            assert found[words][1] == pytest.approx(hertz, rel=5e-3) and f": {found[words][0]}" in said[0]
        else:
            assert hertz < 1.015 * before
    assert found


def bandwidth(made):
    return max(map(crossing, made.found.values()))


def test_notches_stand_where_tustin_puts_them():
    """The sampled controller of the family is smallest at the resonance itself."""
    machine = Machine((PAIR,), 40.0, "pair")
    pid = tustin(pid_family(machine, 3.0, 5, 1e-3)(20.0).state_space(), 1e-3)
    omega = 2 * np.pi * np.linspace(150, 300, 3001)
    lowest = omega[np.abs(pid.frequency_response(omega)[0, 0]).argmin()]
    assert lowest == pytest.approx(PAIR.frequencies[1], rel=1e-3)


def held_response(machine, hertz):
    """Of the machine behind SciPy's hold, a sample late, by solving at each frequency."""
    model = machine.state_space()
    a, b, c, d, _ = signal.cont2discrete((model.a, model.b, model.c, model.d), 1 / RATE)
    z = np.exp(2j * np.pi * hertz / RATE)
    rows = np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (len(z), *b.shape)))
    return ((c @ rows)[:, 0, 0] + d[0, 0]) / z


def changed(folder, factor, name="now.npz"):
    """The same machine with its resonance elsewhere."""
    np.savez(folder / name, M=MASS, K=factor**2 * STIFFNESS, input=[1.0, 0], output=[[0.0, 1.0]])
    return str(folder / name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "holds", "inside"), [(1.0, True, True), (0.96, True, True), (0.6, False, False)]
)
def test_a_retest_says_whether_the_promise_holds(written, tmp_path, monkeypatch, factor, holds, inside):
    """From 10 decibels down to the machine of the design, whose peaks are those of the design's page."""
    monkeypatch.chdir(tmp_path)
    controller = str(written[0] / "controller.json")
    assert main(["retest", controller, changed(tmp_path, factor), "--out", "page.html"]) == 0
    lines = retest_file(controller, "now.npz", "again.html", verbose=True)
    assert ("the promise holds" in lines[0]) == holds and ("design again" in lines[0]) == (not holds)
    assert any("outside the box" in line for line in lines) == (not inside)
    sizes = dict(re.findall(r"(S_I|S_O) ([-.\d]+) dB", lines[1]))
    assert (max(map(float, sizes.values())) <= 6.01) or not holds
    page = (tmp_path / "page.html").read_text()
    assert "What has changed" in page and lines[0] in page and page.count("data:image/png;base64,") == 1
    if factor == 1.0:
        told = (written[0] / "report.html").read_text()
        for name, size in sizes.items():
            assert f"<td>{name}</td><td>{size}</td>" in told


@pytest.mark.slow
def test_what_is_no_sensitivity_is_no_retest_in_the_loop(written, tmp_path):
    """The machine, what is left of 1, and a file that ends below the crossing, which proves nothing."""
    hertz, low = np.geomspace(1.0, 4e3, 2000), np.geomspace(1.0, 5.0, 300)
    controller = load_controller(written[0] / "controller.json").linear
    loop, below = (
        controller.frequency_response(2 * np.pi * f)[0, 0] * held_response(PAIR, f) for f in (hertz, low)
    )
    for name, axis, values in (
        ("p", hertz, held_response(PAIR, hertz)),
        ("t", hertz, loop / (1 + loop)),
        ("low", low, 1 / (1 + below) * np.abs(1 + below).min()),
    ):
        np.savez(tmp_path / f"{name}.npz", **{"frequency (Hz)": axis, name: values})
        with pytest.raises(InputError, match=rf"^{name}\.npz\b"):
            retest_file(
                str(written[0] / "controller.json"), str(tmp_path / f"{name}.npz"), str(tmp_path / "no.html"), closed_loop=True
            )  # fmt: skip
    assert not (tmp_path / "no.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "frequency"), [(1.0, 1.0), (1.04, 0.96), (1.3, 1.0), (0.75, 1.0), (1.0, 0.7)]
)
def test_a_retest_in_the_loop_judges_machines_that_moved(written, tmp_path, gain, frequency):
    """Inside the box, 30 % stronger, 25 % weaker, and with the mode moved out of the box: peaks and gain are SciPy's."""
    controller = load_controller(written[0] / "controller.json")
    hertz = np.unique(np.concatenate([np.geomspace(1.0, 4e3, 2000), np.linspace(120, 260, 900)]))
    moved = modal_model(MASS, frequency**2 * STIFFNESS, [[1.0], [0.0]], [[0.0, 1.0]], damping_ratio=0.005)
    k = controller.linear.frequency_response(2 * np.pi * hertz)[0, 0]
    sensitivity = 1 / (1 + gain * k * held_response(moved, hertz))
    np.savez(tmp_path / "s.npz", **{"frequency (Hz)": hertz, "s": sensitivity})
    said = retest_file(
        str(written[0] / "controller.json"), str(tmp_path / "s.npz"), str(tmp_path / "page.html"), closed_loop=True, verbose=True
    )  # fmt: skip
    size = 20 * np.log10(np.abs(sensitivity).max())
    shown = {name: float(each) for name, each in re.findall(r"(S_I|S_O) ([-.\d]+) dB", said[1])}
    assert shown["S_O"] == pytest.approx(size, abs=0.006)
    assert ("the promise holds" in said[0]) == (max(shown.values()) <= 6.01)
    outside = [line for line in said if "outside the box" in line]
    if frequency == 1.0:
        assert bool(outside) == (abs(gain - 1) > 0.05)
        assert not outside or f"{100 * (gain - 1):+.2g} %" in outside[0]
    if (gain, frequency) == (1.04, 0.96):
        assert "the promise holds" in said[0]


@pytest.mark.slow
def test_noise_makes_no_machine_worse_than_six_decibels(written, tmp_path):
    """S by SciPy's hold, 10 % noise: no largest line decides; at 3 % what is clear is told, and the gain lies in its interval."""
    controller = load_controller(written[0] / "controller.json")
    hertz, said = np.geomspace(1.0, 4e3, 2000), {}
    k = controller.linear.frequency_response(2 * np.pi * hertz)[0, 0]
    for noise in (0.03, 0.1):
        for gain in (0.9, 1.0, 1.4):
            sensitivity = 1 / (1 + gain * k * held_response(PAIR, hertz))
            errors = np.random.default_rng(5).standard_normal((2, len(hertz)))
            seen = sensitivity * (1 + noise * (errors[0] + 1j * errors[1]) / np.sqrt(2))
            assert (noise, gain) != (0.1, 1.0) or 20 * np.log10(np.abs(seen).max()) > 6.01
            file = tmp_path / f"{noise}_{gain}.npz"
            np.savez(file, **{"frequency (Hz)": hertz, "s": seen})
            page = tmp_path / f"{file.stem}.html"
            lines = retest_file(str(written[0] / "controller.json"), str(file), str(page), closed_loop=True)
            size = 20 * np.log10(np.abs(sensitivity).max())
            low, high = map(float, re.search(r"S_O [\d.]+ dB \(([\d.]+) to ([\d.]+)\)", lines[1]).groups())
            assert low - 0.05 < size < high + 0.05
            said[noise, gain] = lines[0]
            change, spread = re.search(
                r"gain near .*?<td>([-+\d.e]+) ± ([\d.e-]+) %", page.read_text(), re.DOTALL
            ).groups()
            assert abs(float(change) - 100 * (gain - 1)) < 1.5 * float(spread)
    assert "the promise holds" in said[0.03, 0.9] and "does not hold" in said[0.03, 1.4]
    assert not any("does not hold" in line for (_, gain), line in said.items() if gain <= 1)
    assert any("not decided: at this noise" in line for line in said.values())


@pytest.mark.slow
def test_a_retest_takes_the_units_of_the_design_alone(written, tmp_path):
    hertz = np.geomspace(1.0, 4e3, 2000)
    columns = {"frequency (Hz)": hertz, "H (rad/(N m))": held_response(PAIR, hertz)}
    np.savez(tmp_path / "turned.npz", **columns)
    with pytest.raises(InputError, match=r"^turned\.npz\b.*kg m\^2.*kg"):
        retest_file(
            str(written[0] / "controller.json"), str(tmp_path / "turned.npz"), str(tmp_path / "no.html")
        )


def test_a_controller_without_its_observer_is_not_retested(tmp_path):
    (tmp_path / "my.toml").write_text(
        "[controller]\nrate_hz = 1e4\nbiquads = [[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]\n"
    )
    with pytest.raises(InputError, match=r"^my\.toml\b.*provenance"):
        retest_file(str(tmp_path / "my.toml"), changed(tmp_path, 1.0), str(tmp_path / "page.html"))


@pytest.mark.slow
def test_several_responses_are_all_served(written, tmp_path):
    """Loaded by 4 kg, the resonance lower: one controller keeps six decibels on both, and in the box around each."""
    np.savez(tmp_path / "free.npz", M=MASS, K=STIFFNESS, input=[1.0, 0], output=[[0.0, 1.0]])
    loaded = MASS + np.diag([0.0, 4.0])
    np.savez(tmp_path / "loaded.npz", M=loaded, K=STIFFNESS, input=[1.0, 0], output=[[0.0, 1.0]])
    files = [str(tmp_path / name) for name in ("free.npz", "loaded.npz")]
    said = design_file(files, str(tmp_path / "out"), RATE, verbose=True)
    held = json.loads((tmp_path / "out" / "controller.json").read_text())
    assert held["provenance"]["others"][0]["file"] == "loaded.npz"
    assert "loaded.npz" in (tmp_path / "out" / "report.html").read_text()
    linear = load_controller(tmp_path / "out" / "controller.json").linear
    hertz = np.concatenate([np.geomspace(0.5, 4e3, 3000), np.linspace(180, 245, 4000)])
    k = linear.frequency_response(2 * np.pi * hertz)[0, 0]
    for mass in (MASS, loaded):
        for factor in (0.95, 1.0, 1.05):
            for gain in (0.95, 1.05):
                machine = modal_model(
                    mass, factor**2 * STIFFNESS, [[1.0], [0.0]], [[0.0, gain]], damping_ratio=0.005
                )
                p = held_response(machine, hertz)
                assert 20 * np.log10(np.abs(1 / (1 + k * p)).max()) < 6.01  # S, and r to e
    alone = float(re.search(r"highest bandwidth first: [^,]*? ([\d.]+) Hz", "\n".join(written[1]))[1])
    both = float(re.search(r"highest bandwidth first: [^,]*? ([\d.]+) Hz", "\n".join(said))[1])
    assert both < alone


def test_responses_that_move_against_each_other_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", M=MASS, K=STIFFNESS, input=[1.0, 0], output=[[0.0, -1.0]])
    with pytest.raises(InputError, match=r"^other\.npz\b.*now\.npz\b"):
        design_file([changed(tmp_path, 1.0), str(tmp_path / "other.npz")], str(tmp_path / "out"), RATE)


CLOSED = """
#include "controller.h"
/* Two masses by symplectic steps of a tenth of a sample; the force is a sample late and limited. */
void run(long samples, const double *reference, double *position, double *force)
{
    controller_state s;
    const double known[1] = {0};
    double in[1] = {0}, out[1] = {0}, late = 0, x[2] = {0, 0}, v[2] = {0, 0};
    controller_start(&s, &controller_designed, in, known, out);
    for (long k = 0; k < samples; k++) {
        position[k] = x[1];
        in[0] = reference[k] - position[k];
        controller_step(&s, &controller_designed, in, known, out);
        force[k] = out[0];
        for (int i = 0; i < 10; i++) {
            double spring = 1.5e7 * (x[1] - x[0]) + 2 * 0.005 * 7.5 * 1414.2 * (v[1] - v[0]);
            v[0] += 1e-5 * (late + spring) / 30;
            v[1] -= 1e-5 * spring / 10;
            x[0] += 1e-5 * v[0];
            x[1] += 1e-5 * v[1];
        }
        late = out[0];
    }
}
"""


@pytest.mark.slow
def test_the_c_moves_the_machine_and_lets_go_of_its_limit(written, tmp_path):
    """A step that asks for more than 40 N: it arrives within a micrometre, and overshoots less than the step."""
    folder = written[0]
    files = {name: (folder / name).read_text() for name in ("controller.c", "controller.h")}
    library = compiled(files, tmp_path, CLOSED)
    samples = 10_000
    reference = np.full(samples, 1e-3)
    position, force = np.zeros(samples), np.zeros(samples)
    library.run(ctypes.c_long(samples), *map(pointer, (reference, position, force)))
    assert np.abs(force).max() == 40.0 and np.mean(np.abs(force) == 40.0) > 1e-3
    assert np.abs(position[-1] - 1e-3) < 1e-6
    assert position.max() < 2e-3


@pytest.mark.slow
def test_a_late_measurement_is_designed_for_and_each_sensor_gets_its_controller(
    tmp_path, capsys, monkeypatch
):
    """The template 150 us late, one sample and a half: six decibels hold on what was measured, by the loop's own equation."""
    hertz, size, phase = np.loadtxt(TEMPLATES / "frequency_response.csv", delimiter=",", skiprows=2).T
    measured = size * np.exp(1j * np.radians(phase) - 2j * np.pi * hertz * 1.5e-4)
    np.savez(tmp_path / "late.npz", **{"frequency (Hz)": hertz, "h (m/s^2/N)": measured})
    out = tmp_path / "out"
    arguments = ["--rate", "10000", "--out", str(out), "--mirrored-sensor", "--precision", "single"]
    arguments += ["--name", "axis", "--delay", "0", "--uncertainty", "none", "--verbose"]
    monkeypatch.setattr(
        promise, "equivalent_biquads", lambda controller: None
    )  # as where none are close enough
    assert main(["design", str(tmp_path / "late.npz"), *arguments]) == 0
    said = capsys.readouterr().out
    assert "the response is 150 us late" in said
    assert {"axis_1.c", "axis_2.h", "axis_2.json", "report.html"} <= {each.name for each in out.iterdir()}
    assert "typedef float axis_1_real;" in (out / "axis_1.h").read_text()
    held = json.loads((out / "axis_1.json").read_text())
    assert held["provenance"]["delay_samples_of_the_loop"] == pytest.approx(1.5, abs=0.01)
    turn = 2j * np.pi * hertz / RATE
    plant = -measured / (2 * np.pi * hertz) ** 2 * -np.expm1(-turn) / turn
    controller = load_controller(out / "axis_1.json")
    k = controller.linear.frequency_response(2 * np.pi * hertz)[0, 0]
    assert 20 * np.log10(np.abs(1 / (1 + k * plant)).max()) < 6.01  # S, and r to e
    assert controller.motion.lag == pytest.approx(2e-4, abs=1e-6)
    assert held["biquads"] is None and WITHOUT_BIQUADS in said


@pytest.mark.slow
def test_a_machine_that_has_no_safe_loop_is_told_so_and_nothing_is_written(tmp_path):
    file = str(TEMPLATES / "matrices.csv")
    with pytest.raises(InputError, match=r"(?s)^matrices\.csv\b.*100 Hz.*PID\b"):
        design_file(file, str(tmp_path / "out"), 100.0)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"files": "missing.csv"}, r"missing\.csv"),
        ({"rate": 1e15}, r"^rate\b"),
        ({"rate": 1.0}, r"^rate\b"),
        ({"rate": 0.0}, r"^rate\b"),
        ({"delay": 100_000}, r"^delay\b"),
        ({"limit": -5.0}, r"^limit\b"),
        ({"name": "1st"}, r"^name\b"),
        ({"noise_ratio": -2.0}, r"^noise_ratio\b"),
        ({"limits": [0.02, 2.0]}, r"^limits holds 2 numbers"),
        ({"uncertainty": "gain=1"}, r"^uncertainty\b.*gain"),
        ({"uncertainty": {"colour": 0.1}}, r"^uncertainty\b.*colour"),
        ({"uncertainty": "delay=1"}, r"^uncertainty: delay is 1 s.*at most 20 samples"),
        ({"force_unit": "A", "motor_constant": 2.0}, "motor_constant"),
        ({"response_unit": "count", "counts": 100.0}, "counts"),
        ({"response_unit": "V"}, "response_unit"),
        ({"force_unit": "rad"}, "force_unit"),
        ({"force_unit": "kN"}, "matrices"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_makes_no_sense_is_refused_by_its_name_and_nothing_is_written(tmp_path, wrong, said):
    given = {"files": str(TEMPLATES / "matrices.csv"), "folder": str(tmp_path / "out"), "rate": RATE}
    with pytest.raises(InputError, match=said):
        design_file(**given | wrong)
    assert not (tmp_path / "out").exists()


def test_a_folder_with_something_in_it_is_refused_first(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="a_folder_with_something"):
        design_file("missing.csv", str(tmp_path), RATE)


@pytest.mark.slow
def test_a_machine_that_turns_is_designed_in_the_drives_own_units(written, tmp_path):
    """The same numbers in rad and N m give the same controller; in counts and A it is that one between two gains."""
    np.savez(tmp_path / "turns.npz", M=MASS, K=STIFFNESS, input=[1.0, 0], output=[[0.0, 1.0]])
    counts, constant = 20_000 / (2 * np.pi), 0.8
    design_file(
        str(tmp_path / "turns.npz"), str(tmp_path / "out"), RATE, limit=40.0 / constant,
        counts=counts, motor_constant=constant, response_unit="rad", force_unit="N m", noise_share=1e4, noise_ratio=30.0,
    )  # fmt: skip
    assert "40 kg m^2" in (tmp_path / "out" / "report.html").read_text()
    turned, plain = (load_controller(each / "controller.json") for each in (tmp_path / "out", written[0]))
    assert turned.inputs == ("e (count)",) and turned.outputs == ("f (A)",)
    gains, series = turned.motion.feedforward, plain.motion.feedforward
    assert gains.acceleration * counts * constant == pytest.approx(40.0, rel=1e-9)
    assert series.acceleration == pytest.approx(40.0) and series.snap != 0
    rng = np.random.default_rng(0)
    moves = 1e-6 * rng.standard_normal((1, 400))
    assert constant * turned.run(counts * moves) == pytest.approx(plain.run(moves), rel=1e-6, abs=1e-9)
    large = np.full((1, 50), 1e-2)
    assert constant * turned.run(counts * large) == pytest.approx(plain.run(large), rel=1e-6, abs=1e-6)
    held = [json.loads((each / "controller.json").read_text()) for each in (tmp_path / "out", written[0])]
    sections = [each["biquads"]["feedback"] for each in held]
    turn = np.geomspace(1e-3, 3, 50)
    responses = [signal.sosfreqz(each, turn)[1] for each in sections]
    assert counts * constant * responses[0] == pytest.approx(responses[1], rel=1e-7)
    assert held[0]["provenance"]["mass_unit"] == "kg m^2"


def test_a_phase_and_a_frequency_in_rad_are_no_motion_of_the_machine():
    names = ["frequency (rad/s)", "magnitude (dB re 1 m/s^2/N)", "phase (rad)"]
    assert stated_units(names) == ("m/s^2", "N")
    assert stated_units(["omega (rad/s)", "magnitude", "phase (rad)"]) == ("", "")


@pytest.mark.parametrize(
    ("header", "units", "mass_unit"),
    [
        ("h ((rad/s^2)/(N m))", ("rad", "N m"), "kg m^2"),
        ("h (rad/Nm)", ("rad", "N m"), "kg m^2"),
        ("h (rad/s/A)", ("rad", "A"), "A/(rad/s^2)"),
        ("h (counts/V)", ("count", "V"), "V/(count/s^2)"),
        ("h (um/N)", ("m", "N"), "kg"),
    ],
)
def test_the_header_of_a_response_says_in_what_a_machine_moves(tmp_path, header, units, mass_unit):
    """An inertia of 2 in the units that the header says, prefixes taken out."""
    omega = 2 * np.pi * np.arange(20.0, 300.0)
    response = 0.5 / (1j * omega) ** 2 * (1 + 0.4 * omega**2 / (600.0**2 - omega**2 + 12j * omega))
    if "^2" in header:
        response = response * (1j * omega) ** 2
    elif "/s/" in header:
        response = response * 1j * omega
    factor = 1e6 if "um" in header else 1.0
    np.savez(tmp_path / "turns.npz", **{"frequency (Hz)": omega / (2 * np.pi), header: factor * response})
    file = load_machine(tmp_path / "turns.npz")
    machine = build_machine(file, modes_hz=[], fit_hz=(0.0, 0.0), mirrored_sensor=False)
    assert (file.units, machine.units, machine.mass_unit) == (units, units, mass_unit)
    assert machine.mass == pytest.approx(2.0, rel=1e-3)
