"""The command `design`: what it writes controls the machine of the file, by python-control, and by the C itself."""

import json
import re

import numpy as np
import pytest
from scipy import signal

from motion.true_machines import error_law
from stillwork.__main__ import main
from stillwork.base.checks import InputError
from stillwork.control.digital import load_controller
from stillwork.control.machine_loops import pid_family
from stillwork.identification.machine import Machine, build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.lti.discretisation import tustin
from stillwork.lti.modal import modal_model
from stillwork.machine import promise
from stillwork.machine.design import WITHOUT_BIQUADS, design_file
from stillwork.machine.desk import read_machine
from stillwork.machine.machine_designs import crossing, improvements, search_designs
from stillwork.machine.retest import retest_file
from workbook import paths

TEMPLATES = paths.data("motion", "your_machine")
RATE = 1e4
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
    """12 s of CPU, in the fixture that the tests below share: one whole design, as the command makes it."""
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
    assert held["provenance"]["uncertainty"]["frequency"] == [0.0, 0.05]
    page = (folder / "report.html").read_text()
    assert "&lt;pair&gt;.npz" in page and "<pair>" not in page


@pytest.mark.slow
def test_the_biquads_are_the_whole_controller(written):
    """By SciPy alone: as sections of r - y they respond as the matrices do."""
    held = json.loads((written[0] / "controller.json").read_text())
    (a, b, c, d), sections = error_law(held["state_space"]), held["biquads"]
    z = np.exp(1j * np.geomspace(1e-3, 3.1, 200))
    k = np.array([(c @ np.linalg.solve(each * np.eye(len(a)) - a, b) + d)[0, 0] for each in z])
    feedback = signal.sosfreqz(sections["feedback"], np.angle(z))[1]
    assert feedback == pytest.approx(k, rel=1e-8) and sections["reference"] is None


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
def test_what_would_help_is_what_a_search_of_the_changed_file_finds(tmp_path, untuned):
    """With a sensor at the force, twice the damping, and without delay, in files of their own."""
    made = search_designs(Machine((PAIR,), 40.0, "pair"), rate=5e3, delay=2.0, uncertainty="none")
    found = {words: (use, float(hertz)) for words, use, hertz in improvements([made.machine], made, 2.0)}
    for words, output, damping, delay in (
        ("the sensor where the force acts", [1.0, 0.0], 0.005, 2.0),
        ("twice the damping of its modes", [0.0, 1.0], 0.01, 2.0),
        ("no delay", [0.0, 1.0], 0.005, 0.0),
    ):
        np.savez(tmp_path / "m.npz", M=MASS, K=STIFFNESS, input=[1.0, 0.0], output=[output])
        file = load_machine(tmp_path / "m.npz", damping_ratio=damping)
        machine = build_machine(file, modes_hz=[], fit_hz=(0.0, 0.0))
        other = search_designs(machine, rate=5e3, delay=delay, uncertainty="none")
        if words in found:
            assert found[words] == (other.ranking[0], pytest.approx(bandwidth(other), rel=5e-3))
        else:
            assert bandwidth(other) < 1.015 * bandwidth(made)
    assert found


@pytest.mark.slow
def test_the_blocks_of_the_design_come_back_on_the_desk(written, node):
    """Its loop there is the one that the numbers in the file close."""
    folder = written[0]
    machine = read_machine(folder.parent / "<pair>.npz")
    text = (folder / "controller.json").read_text(encoding="utf-8")
    [found] = node([("files.js", "designOfController", text, machine)])
    design, omega = found["value"]["design"], 2 * np.pi * np.geomspace(1.0, 4900.0, 60)
    kinds = [each["kind"] for each in design["blocks"]]
    assert design["limit"] == 40 and "observer" in kinds
    [again] = node([("here", "responses", machine, design, omega)])
    plant = np.array(again["value"]["plant"]["re"]) + 1j * np.array(again["value"]["plant"]["im"])
    controller = load_controller(folder / "controller.json").linear.frequency_response(omega)[0, 0]
    # Samples of own delay are in the written controller; the desk counts them with the machine's.
    own = sum(each["samples"] for each in design["blocks"] if each["kind"] == "wait")
    sensitivity = 1 / np.abs(1 + controller * plant * np.exp(1j * omega / RATE * own))
    np.testing.assert_allclose(again["value"]["functions"]["output_sensitivity"], sensitivity, rtol=1e-7)


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
@pytest.mark.parametrize(("factor", "holds", "inside"), [(1.0, True, True), (0.6, False, False)])
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
def test_a_retest_names_a_mode_whose_part_has_changed_and_refuses_another_machine(written, tmp_path):
    """The sensor on the other mass: the same resonance, seen from its other side; and a machine ten times as heavy."""
    controller = str(written[0] / "controller.json")
    for name, factor, output in (("moved", 1.0, [[1.0, 0.0]]), ("heavy", 10.0, [[0.0, 1.0]])):
        np.savez(
            tmp_path / f"{name}.npz", M=factor * MASS, K=factor * STIFFNESS, input=[1.0, 0], output=output
        )
    said = retest_file(controller, str(tmp_path / "moved.npz"), str(tmp_path / "moved.html"))
    hertz = PAIR.frequencies[1] / (2 * np.pi)
    assert said[0].endswith(f"not in the box: part of the mode at {hertz:.4g} Hz") and len(said) == 3
    parts = [
        np.linalg.solve(MASS, np.eye(2))[k, 0] * MASS.sum() - 1 for k in (1, 0)
    ]  # M^-1 is the sum over all modes
    page = (tmp_path / "moved.html").read_text()
    assert f"{parts[0]:.3g} {parts[1]:.3g}" in re.sub(r"\s*<[^>]+>\s*", " ", page).replace("  ", " ")
    with pytest.raises(
        InputError, match=r"heavy.npz is of another machine or in another unit.*give response_unit"
    ):
        retest_file(controller, str(tmp_path / "heavy.npz"), str(tmp_path / "heavy.html"))


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "frequency"), [(1.04, 0.96), (1.3, 1.0), (1.0, 0.7)])
def test_a_retest_in_the_loop_judges_machines_that_moved(written, tmp_path, gain, frequency):
    """Inside the box, 30 % stronger, and with the mode moved out of the box: peaks and gain are SciPy's."""
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
def test_several_responses_are_all_served(written, tmp_path, untuned):
    """Loaded by 4 kg, the resonance lower: one controller keeps six decibels on both, which the free one's own does not."""
    loaded = MASS + np.diag([0.0, 4.0])
    np.savez(tmp_path / "loaded.npz", M=loaded, K=STIFFNESS, input=[1.0, 0], output=[[0.0, 1.0]])
    files, out = [changed(tmp_path, 1.0), str(tmp_path / "loaded.npz")], tmp_path / "out"
    design_file(files, str(out), RATE, uncertainty="none")
    hertz, peaks = np.concatenate([np.geomspace(0.5, 4e3, 3000), np.linspace(180, 245, 4000)]), []
    for folder in (written[0], out):
        linear = load_controller(folder / "controller.json").linear
        k = linear.frequency_response(2 * np.pi * hertz)[0, 0]
        for mass in (MASS, loaded):
            machine = modal_model(mass, STIFFNESS, [[1.0], [0.0]], [[0.0, 1.0]], damping_ratio=0.005)
            peaks.append(
                20 * np.log10(np.abs(1 / (1 + k * held_response(machine, hertz))).max())
            )  # S, and r to e
    assert peaks[1] > 6.01 > max(peaks[2:])
    held = json.loads((out / "controller.json").read_text())
    assert held["provenance"]["others"][0]["file"] == "loaded.npz"


def test_responses_that_move_against_each_other_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", M=MASS, K=STIFFNESS, input=[1.0, 0], output=[[0.0, -1.0]])
    with pytest.raises(InputError, match=r"^other\.npz\b.*now\.npz\b"):
        design_file([changed(tmp_path, 1.0), str(tmp_path / "other.npz")], str(tmp_path / "out"), RATE)


@pytest.mark.slow
def test_a_late_measurement_is_designed_for(tmp_path, capsys, monkeypatch, untuned):
    """The template 150 us late, one sample and a half: six decibels hold on what was measured, by the loop's own equation."""
    hertz, size, phase = np.loadtxt(TEMPLATES / "frequency_response.csv", delimiter=",", skiprows=2).T
    measured = size * np.exp(1j * np.radians(phase) - 2j * np.pi * hertz * 1.5e-4)
    np.savez(tmp_path / "late.npz", **{"frequency (Hz)": hertz, "h (m/s^2/N)": measured})
    out = tmp_path / "out"
    arguments = ["--rate", "10000", "--out", str(out), "--precision", "single"]
    arguments += ["--name", "axis", "--delay", "0", "--uncertainty", "none", "--verbose"]
    monkeypatch.setattr(
        promise, "equivalent_biquads", lambda controller: None
    )  # as where none are close enough
    assert main(["design", str(tmp_path / "late.npz"), *arguments]) == 0
    said = capsys.readouterr().out
    assert "the response is 150 us late" in said
    assert {"axis.c", "axis.h", "axis.json", "report.html"} <= {each.name for each in out.iterdir()}
    assert "typedef float axis_real;" in (out / "axis.h").read_text()
    held = json.loads((out / "axis.json").read_text())
    assert held["provenance"]["delay_samples_of_the_loop"] == pytest.approx(1.5, abs=0.01)
    turn = 2j * np.pi * hertz / RATE
    plant = -measured / (2 * np.pi * hertz) ** 2 * -np.expm1(-turn) / turn
    controller = load_controller(out / "axis.json")
    k = controller.linear.frequency_response(2 * np.pi * hertz)[0, 0]
    assert 20 * np.log10(np.abs(1 / (1 + k * plant)).max()) < 6.01  # S, and r to e
    assert controller.motion.lag == pytest.approx(2e-4, abs=1e-6)
    assert held["biquads"] is None and WITHOUT_BIQUADS in said


@pytest.mark.slow
def test_a_machine_that_has_no_safe_loop_is_told_so_and_nothing_is_written(tmp_path, untuned):
    file = str(TEMPLATES / "matrices.csv")
    with pytest.raises(InputError, match=r"(?s)^matrices\.csv\b.*100 Hz.*PID\b"):
        design_file(file, str(tmp_path / "out"), 100.0)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rate": 1.0}, r"^rate\b"),
        ({"delay": 100_000}, r"^delay\b"),
        ({"name": "1st"}, r"^name\b"),
        ({"limits": [0.02, 2.0]}, r"^limits holds 2 numbers"),
        (
            {"limit": 20.0, "limits": [0.2, 2.0, 100.0]},
            r"^limits\b.* sum to up to 24, the output is limited to 20",
        ),
        ({"uncertainty": "gain=1"}, r"^uncertainty\b.*gain"),
        ({"uncertainty": "delay=1"}, r"^uncertainty: delay is 1 s.*at most 20 samples"),
        ({"force_unit": "A", "motor_constant": 2.0}, "motor_constant"),
        ({"response_unit": "count", "counts": 100.0}, "counts"),
        ({"force_unit": "kN"}, "matrices"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_makes_no_sense_is_refused_by_its_name_and_nothing_is_written(tmp_path, wrong, said):
    given = {"files": str(TEMPLATES / "matrices.csv"), "folder": str(tmp_path / "out"), "rate": RATE}
    with pytest.raises(InputError, match=said):
        design_file(**given | wrong)
    assert not (tmp_path / "out").exists()
