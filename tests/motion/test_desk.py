"""The desk's modules, run by node, against this library's own loops and against SciPy; its page and its files."""

import json
import re

import numpy as np
import pytest
from scipy import signal

from stillwork import control, lti
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.bandwidth import make_loop
from stillwork.control.digital import error_driven, load_controller, runnable
from stillwork.control.machine_loops import HELD, OF_ERROR, observing_compensator, on_measurement
from stillwork.control.pid import Notch, Pid
from stillwork.control.uncertainty import Uncertainty, make_box
from stillwork.estimation.observer import NoiseIntensities
from stillwork.identification.frequency_response import Identified
from stillwork.identification.machine import Machine
from stillwork.identification.machine_files import load_machine
from stillwork.lti.discretisation import prewarped
from stillwork.lti.state_space import constant
from stillwork.machine.desk import desk_file, entry
from workbook import paths

DESIGNS = 60
CLOSE = 1e-9
ROUNDING = 1e-11  # relative, of a magnitude of 1 beside the point -1
TURN = 2 * np.pi
INTENSITIES = {"disturbance": 8e-4, "sensor": 1.41e-9, "drift": 1.92e-4}


def values(results):
    assert not [each for each in results if "error" in each]
    return [each["value"] for each in results]


def number(pair):
    return np.array(pair["re"]) + 1j * np.array(pair["im"])


def drawn(seed: int):
    """A machine, a loop of it with an observer or without, its PID, and the same as the desk has them."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    hertz = np.sort(rng.uniform(50, 1500, count))
    mass = float(np.exp(rng.uniform(-2, 4)))
    shapes = rng.uniform(0.3, 1.5, (2, count)) * rng.choice([-1, 1], (2, count))
    model = lti.ModalModel(
        np.append(0.0, TURN * hertz),
        np.append(0.0, rng.uniform(0.002, 0.03, count)),
        np.append(1.0, shapes[0])[:, None] / np.sqrt(mass),
        np.append(1.0, shapes[1])[None, :] / np.sqrt(mass),
        np.array([[1e-9 * float(rng.choice([0, 1])) / mass]]),
        drag=float(rng.choice([0.0, rng.uniform(0.1, 30)])),
    )
    rate, delay = float(rng.uniform(5, 40) * hertz[-1]), float(rng.uniform(0, 2.5))
    bandwidth = float(hertz[0] * np.exp(rng.uniform(-3, 0.3)))
    notched = rng.choice(hertz, rng.integers(0, count + 1), replace=False)
    notches = tuple(Notch(float(prewarped(TURN * f, 1 / rate)), 0.01, 0.2) for f in notched)
    w = TURN * bandwidth
    pid = Pid(mass * w**2 / 3, w / 9, w / 3, 3 * w, 0.7, notches)
    blocks = [pid_block(pid)]
    blocks += [
        {"kind": "notch", "frequency_hz": f, "skew": 1.0, "depth": 0.01, "width": 0.2} for f in notched
    ]
    blocks += [{"kind": "sampling", "rate_hz": rate}, {"kind": "delay", "delay_us": 1e6 * delay / rate}]
    compensator = None
    if seed % 2:
        compensate, damping = [(True, 0.0), (False, 0.05), (True, 0.05)][seed // 2 % 3]
        retained = int(rng.integers(2, count + 2))
        selectivity = float(rng.choice([0.25, 0.5, 0.505, 1.0, 2.0, 16.0]))
        chosen = Application(
            compensate=compensate, damping=damping, selectivity=selectivity if damping else None
        )
        noise = NoiseIntensities((INTENSITIES["disturbance"] * mass) ** 2, INTENSITIES["sensor"] ** 2)
        drift = INTENSITIES["drift"] * mass**2 if compensate else None
        compensator = observing_compensator(model, chosen, retained, noise, drift, 1 / rate, delay)
        own = {"compensate": compensate, "damping": damping, "selectivity": selectivity, "retained": retained}
        blocks.append({"kind": "observer"} | own | INTENSITIES)
    loop = make_loop(model, compensator, low_hz=bandwidth / 30, sample_time=1 / rate, delay=delay)
    return Machine((model,), mass, "drawn"), loop, pid, {"blocks": blocks, "limit": None}


def pid_block(pid):
    rates = {
        "integrator_hz": pid.integrator,
        "differentiator_hz": pid.differentiator,
        "low_pass_hz": pid.low_pass,
    }
    hertz = {name: rate / TURN for name, rate in rates.items()}
    return {"kind": "pid", "gain": pid.gain, "damping": pid.low_pass_damping} | hertz


@pytest.mark.slow
def test_every_function_of_a_loop_is_that_of_the_library(node):
    """PID, notches, hold, fractional delay, MC and AD of random machines, and how many poles are unstable."""
    designs = [drawn(seed) for seed in range(DESIGNS)]
    grids = [np.geomspace(loop.omega[0], 0.49 * TURN / loop.sample_time, 60) for _, loop, _, _ in designs]
    calls = [
        ("here", "responses", entry(machine, {}), design, grid)
        for (machine, _, _, design), grid in zip(designs, grids, strict=True)
    ]
    unstable = []
    for (_, loop, pid, _), grid, found in zip(designs, grids, values(node(calls)), strict=True):
        wanted, functions = loop.at(pid, grid), found["functions"]
        np.testing.assert_allclose(number(found["plant"]), wanted.plant, rtol=CLOSE)
        np.testing.assert_allclose(number(found["controller"]), wanted.controller, rtol=CLOSE)
        np.testing.assert_allclose(number(functions["loop"]), wanted.loop, rtol=CLOSE)
        np.testing.assert_allclose(number(functions["output_loop"]), wanted.output_loop, rtol=CLOSE)
        for name in HELD:
            np.testing.assert_allclose(functions[name], np.abs(getattr(wanted, name)), rtol=CLOSE)
        process = np.abs(wanted.plant * wanted.output_sensitivity)
        np.testing.assert_allclose(functions["process"], process, rtol=CLOSE)
        closed = np.abs(1 - wanted.output_sensitivity)  # of a controller of the error
        np.testing.assert_allclose(functions["closed"], closed, rtol=1e-7, atol=1e-9)
        unstable.append(int(np.sum(loop.poles(pid).real > 0)))
        assert found["unstable"] == unstable[-1]
        if not unstable[-1]:
            np.testing.assert_allclose(found["bandwidth"], loop.crossing_hz(pid), rtol=1e-3)
    assert 6 < np.count_nonzero(unstable) < DESIGNS - 6  # both kinds were seen


# Numbers of a block, and its numerator and denominator in s; `at` makes a frequency of Hz, where Tustin's rule takes it.
BLOCKS = {
    "gain": (("value",), lambda at, g: ([g], [1])),
    "lead": (("zero_hz", "pole_hz"), lambda at, z, p: ([1 / TURN / z, 1], [1 / TURN / p, 1])),
    "lag": (("zero_hz", "pole_hz"), lambda at, z, p: ([1, TURN * z], [1, TURN * p])),
    "integrator": (("zero_hz",), lambda at, z: ([1, TURN * z], [1, 0])),
    "low_pass_1": (("corner_hz",), lambda at, c: ([TURN * c], [1, TURN * c])),
    "low_pass_2": (
        ("corner_hz", "damping"),
        lambda at, c, z: ([(TURN * c) ** 2], [1, 2 * z * TURN * c, (TURN * c) ** 2]),
    ),
    "notch": (
        ("frequency_hz", "skew", "depth", "width"),
        lambda at, f, skew, depth, width: (
            [at(f) ** -2, 2 * depth / at(f), 1],
            [at(skew * f) ** -2, 2 * width / at(skew * f), 1],
        ),
    ),
}


@pytest.mark.slow
def test_every_block_responds_as_scipy_says(node):
    """Random ones in a row, continuous and by Tustin's rule; the biquads respond as their blocks do."""
    rng = np.random.default_rng(31)
    omega, calls, wanted = TURN * np.geomspace(0.3, 1900, 50), [], []
    for sample_time in [0.0, 1 / 4000] * (DESIGNS // 2):
        blocks, response = [], np.ones(len(omega), complex)

        def at(hertz, h=sample_time):
            return 2 / h * np.tan(TURN * hertz * h / 2) if h else TURN * hertz

        for kind in rng.choice(list(BLOCKS), rng.integers(1, 5), replace=False):
            names, polynomials = BLOCKS[kind]
            numbers = [np.exp(rng.uniform(0, 6)) if "hz" in name else rng.uniform(0.5, 1.5) for name in names]
            blocks.append({"kind": str(kind)} | dict(zip(names, map(float, numbers), strict=True)))
            above, below = polynomials(at, *numbers)
            if sample_time:
                zpk = signal.bilinear_zpk(*signal.tf2zpk(above, below), 1 / sample_time)
                response *= signal.freqz_zpk(*zpk, omega * sample_time)[1]
            else:
                response *= signal.freqs(above, below, omega)[1]
        sampling = [{"kind": "sampling", "rate_hz": 1 / sample_time}] if sample_time else []
        calls.append(("here", "chain", {"blocks": blocks + sampling}, omega))
        wanted.append((response, sample_time))
    for found, (response, sample_time) in zip(values(node(calls)), wanted, strict=True):
        np.testing.assert_allclose(number(found["response"]), response, rtol=CLOSE)
        if sample_time:
            own = signal.sosfreqz(found["biquads"], omega * sample_time)[1]
            np.testing.assert_allclose(own, response, rtol=1e-7)  # near z = 1 coefficients have lost digits
            np.testing.assert_allclose(number(found["sampled"]), own, rtol=CLOSE)


@pytest.mark.slow
def test_the_box_is_searched_as_the_library_searches_it(node):
    """Also where the box passes the point -1: a peak of size M is lost to rounding M times as much as one of size 1."""
    calls, wanted = [], []
    for seed in (0, 1, 5):
        machine, loop, _, design = drawn(seed)
        spread = Uncertainty(
            frequency=0.05, residue=0.1, damping=0.1 * (seed % 2), gain=0.05, mass=0.02, delay=2e-6,
            friction=4.0 * (seed % 3),
        )  # fmt: skip
        spread = spread._of_modes(machine.sensors[0])
        box = make_box(loop, spread, fine=False)
        own = entry(machine, {})
        own["model"]["uncertainty"] = {
            name: np.asarray(getattr(spread, name)).tolist() for name in own["model"]["uncertainty"]
        }
        others = [each for each in design["blocks"] if each["kind"] not in ("pid", "notch")]
        for share in (1 / 40, 1 / 4):  # of the first resonance
            pid = control.PidFamily(machine.mass)(share * machine.resonances_hz[0])
            shaped = design | {"blocks": [pid_block(pid), *others]}
            calls.append(("here", "box", own, shaped, box.omega))
            wanted.append([box.worst(loop, pid, [each], every=True, exact=False)[0][0] for each in OF_ERROR])
    found = values(node(calls))
    for each, worst in zip(found, wanted, strict=True):
        for name, size in zip(HELD, worst, strict=True):
            np.testing.assert_allclose(
                each[name]["size"], size, rtol=max(CLOSE, ROUNDING * max(worst))
            )  # of one denominator
    assert min(map(max, wanted)) < 2 and max(map(max, wanted)) > 1e3  # boxes that hold, and that do not


@pytest.mark.slow
def test_the_measurement_stands_for_the_plant(node):
    """In its band the measured response with hold, delay and the model's aliases, below it the model."""
    machine, loop, pid, design = drawn(4)
    model = machine.sensors[0]
    first = model.frequencies[1] / TURN
    hertz = np.linspace(first / 5, 0.4 / loop.sample_time, 900)
    accelerance = -((TURN * hertz) ** 2) * model.frequency_response(TURN * hertz)[0, 0] * (1 + 0.01j)
    measured = Identified(TURN * hertz, accelerance, np.ones(len(hertz)))
    band = (float(hertz[10]), float(hertz[-1]))
    wanted = on_measurement(loop, measured, 1.0, band)
    own = entry(machine, {}) | {
        "measured": {"hz": hertz, "re": accelerance.real, "im": accelerance.imag},
        "band_hz": band,
    }
    [found] = values(node([("here", "measured", own, design)]))
    inside = np.array(found["omega"]) >= TURN * band[0] * (1 - 1e-12)
    plant = number(found["plant"])[inside]
    np.testing.assert_allclose(plant, wanted.plant_response[-len(plant) :], rtol=CLOSE)
    below = np.array(found["omega"])[~inside]
    np.testing.assert_allclose(number(found["plant"])[~inside], loop.plant_at(below), rtol=CLOSE)
    functions = wanted.at(pid, None)
    for name in HELD:
        size = np.abs(getattr(functions, name))[-len(plant) :]
        np.testing.assert_allclose(np.array(found["functions"][name])[inside], size, rtol=1e-8)
    assert found["turns"] == control.machine_loops.encirclement_difference(wanted, pid)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 8])
def test_what_leaves_the_desk_runs_as_the_library_runs_it(node, tmp_path, seed):
    """The step of the desk, and of its controller.json in the loop with the library's plant, is that of the library."""
    machine, loop, pid, design = drawn(seed)
    if loop.compensator.a.shape[0] == 0:
        compensator = constant(np.zeros((2, 2)), loop.sample_time)
    else:
        compensator = loop.compensator
    ours = error_driven(runnable(pid, compensator, np.inf, {}))
    samples = 80
    own = entry(machine, {})
    ramp = np.linspace(0.0, 1.0, samples) ** 2 / loop.sample_time**2
    step, scan, text = values(
        node(
            [
                ("here", "step", own, design, samples),
                ("here", "scan", own, design, 0.5 * ramp * loop.sample_time**2, ramp),
                ("here", "controller", own, design),
            ]
        )
    )
    (tmp_path / "controller.json").write_text(text, encoding="utf-8")
    exported = load_controller(tmp_path / "controller.json")
    scale = np.abs(run_loop(loop, ours, samples)).max()
    for position in (step["position"], run_loop(loop, exported, samples)):
        np.testing.assert_allclose(position, run_loop(loop, ours, samples), atol=1e-7 * scale)
    # With a mass fed forward, of which the observer is not to take notice.
    known = machine.mass * ramp
    moved = run_loop(loop, ours, samples, 0.5 * ramp * loop.sample_time**2, known)
    np.testing.assert_allclose(scan["position"], moved, atol=1e-7 * np.abs(moved).max())
    assert exported.motion.feedforward.acceleration == machine.mass and exported.inputs == ("e (m)",)
    assert exported.motion.lag == pytest.approx((loop.delay + 0.5) * loop.sample_time)


def run_loop(loop, controller, samples, reference=None, known=None):
    """Positions of the sampled plant under a step of the reference, or another, its controller of the error sample by sample."""
    plant, model = loop.sampled_plant, controller.model
    x, z = np.zeros(len(plant.a)), np.zeros(len(model.a))
    reference = np.ones(samples) if reference is None else reference
    known = np.zeros(samples) if known is None else known
    positions = []
    for r, u in zip(reference, known, strict=True):
        y = (plant.c @ x).item()
        given = np.array([r - y])
        force = model.c @ z + model.d[:, :1] @ given + u
        into = np.concatenate([given, force - u]) if controller.fed_back else given
        z = model.a @ z + model.b @ into
        x = plant.a @ x + plant.b[:, 0] * force.item()
        positions.append(y)
    return np.array(positions)


@pytest.mark.slow
def test_the_best_of_a_structure_keeps_six_decibels_in_the_whole_box(node):
    machine, loop, _, design = drawn(2)
    own = entry(machine, {"frequency": 0.05, "gain": 0.05})
    rate = 1 / loop.sample_time
    first = machine.resonances_hz[0] / 30
    design["blocks"] = [pid_block(control.PidFamily(machine.mass)(first)), *design["blocks"][-2:]]
    [found] = values(node([("here", "best", own, design, 4)]))
    block = found["design"]["blocks"][0]
    assert found["holds"] and block["integrator_hz"] * 15.1 > found["bandwidth"] > 1.3 * first
    rates = {name: TURN * block[f"{name}_hz"] for name in ("integrator", "differentiator", "low_pass")}
    best = Pid(block["gain"], **rates, low_pass_damping=block["damping"])
    assert loop.sample_time == 1 / rate and loop.is_stable(best)
    spread = Uncertainty(frequency=0.05, gain=0.05)._of_modes(machine.sensors[0])
    sizes = [size for size, _ in make_box(loop, spread).worst(loop, best, OF_ERROR, every=True)]
    assert 5.5 < 20 * np.log10(max(sizes)) < 6.05


FILES = {
    "pairs.csv": "frequency (Hz),real (m/s^2/N),imaginary (m/s^2/N)\n{}",
    "polar.csv": "# comment\nfrequency (Hz);magnitude (dB re 1 mm/s/N);phase (deg)\n{}",
    "names.csv": "freq_rad_s,Gain dB re 1 g/N,CH1 Phase in Grad\n{}",
    "omega.csv": "omega\tmagnitude (rad/(N m))\tphase (rad)\n{}",
    "numpy.csv": "# hammer 7\n# Freq [Hz], Mag [g/N], Phase [deg]\n{}",
    "blanks.csv": "# f Mag Phase\n# Hz g/N deg\n{}",
    "brackets.csv": "Freq,Re(H1(2,1)),Imag H1(2,1)\n{}",
    "bare.csv": "X-Axis,Real,Imag\n{}",
    "notes.csv": "Model,SDS\nPoints,60\n\nFrequency,CH1 Amplitude,CH1 Phase\nHz,g/lbf,Deg.\n{}",
}


@pytest.mark.slow
def test_a_table_is_read_as_the_library_reads_it(node, tmp_path):
    hertz = np.linspace(5, 300, 60)
    rng = np.random.default_rng(5)
    size, angle = rng.uniform(0.5, 2, 60), rng.uniform(-0.4, 0.4, 60)
    columns = {
        "pairs.csv": (",", [hertz, size * np.cos(angle), size * np.sin(angle)]),
        "polar.csv": (";", [hertz, 20 * np.log10(size), np.degrees(angle)]),
        "names.csv": (",", [TURN * hertz, 20 * np.log10(size), np.degrees(angle)]),
        "omega.csv": ("\t", [TURN * hertz, size, angle]),
        "numpy.csv": (",", [hertz, size, np.degrees(angle)]),
        "blanks.csv": ("\t", [hertz, size, np.degrees(angle)]),
        "brackets.csv": (",", [hertz, size * np.cos(angle), size * np.sin(angle)]),
        "bare.csv": (",", [hertz, size * np.cos(angle), size * np.sin(angle)]),
        "notes.csv": (",", [hertz, size, np.degrees(angle)]),
    }
    for name, (mark, table) in columns.items():
        rows = "\n".join(mark.join(repr(float(x)) for x in row) for row in zip(*table, strict=True))
        (tmp_path / name).write_text(FILES[name].format(rows), encoding="utf-8")
    names = [*columns, paths.root() / "data" / "motion" / "your_machine" / "frequency_response.csv"]
    calls = [
        ("files.js", "machineOfTable", (tmp_path / name).read_text(encoding="utf-8"), "x") for name in names
    ]
    for name, found in zip(names, values(node(calls)), strict=True):
        wanted = load_machine(tmp_path / name)
        np.testing.assert_allclose(
            TURN * np.array(found["measured"]["hz"]), wanted.accelerance.omega, rtol=1e-12
        )
        ours = number(found["measured"])
        sign = np.sign(np.median(ours.real / wanted.accelerance.response.real))
        np.testing.assert_allclose(sign * ours, wanted.accelerance.response, rtol=CLOSE)
        assert (found["units"]["position"], found["units"]["drive"]) == wanted.units


def test_a_design_that_waits_is_that_of_a_later_machine_and_is_read_back(node):
    machine, loop, _, design = drawn(1)
    late = [block | {"delay_us": block["delay_us"] + 2e6 * loop.sample_time} if block["kind"] == "delay" else block for block in design["blocks"]]  # fmt: skip
    waits = design | {"blocks": [*design["blocks"], {"kind": "wait", "samples": 2}]}
    grid, own = np.geomspace(loop.omega[0], 0.4 * TURN / loop.sample_time, 40), entry(machine, {})
    asked = [("here", "responses", own, each, grid) for each in (waits, design | {"blocks": late})]
    one, other, exported = values(node([*asked, ("here", "controller", own, waits)]))
    for name in ("input_sensitivity", "output_sensitivity"):
        np.testing.assert_allclose(one["functions"][name], other["functions"][name], rtol=1e-9)
    assert json.loads(exported)["controller"]["delay_samples"] == 2
    gains = {"gain": 1.0, "integrator": 2.0, "differentiator": 5.0, "low_pass": 50.0, "low_pass_damping": 0.7}
    text = {"format": "stillwork controller 1", "sample_time_s": 1e-3, "gains": gains}
    text |= {"provenance": {"settings": {"wait": 3.0}}}
    [read] = values(node([("files.js", "designOfController", json.dumps(text), None)]))
    assert {"kind": "wait", "samples": 3} in read["design"]["blocks"]


def test_the_page_is_one_file_that_asks_for_nothing(tmp_path):
    target = tmp_path / "desk.html"
    assert "an example of 10 kg" in desk_file(out=str(target))[0]
    text = target.read_text(encoding="utf-8")
    assert len(text.encode()) < 300_000 and "$" + "body" not in text
    assert not re.findall(r"""(?:src|href)=["'](?!data:)""", text.partition("<script>")[0])
    assert "default-src 'none'" in text and not re.search(
        r"fetch\(|XMLHttpRequest|WebSocket|sendBeacon", text
    )
    with pytest.raises(InputError, match="exists"):
        desk_file(out=str(target))


TYPED = {
    "1.5": 1.5,
    "1,5": 1.5,
    "0,125": 0.125,
    "\u22123": -3,
    "1\u202f000\u00a0000,5": 1000000.5,
    "2,5E-3": 0.0025,
    ".5": 0.5,
}
REFUSED = {
    "": "empty",
    "1e": "no number",
    "0x10": "no number",
    "Infinity": "no number",
    "1 00": "no number",
    "1,2,3": "no number",
    "1,500": "1.500 or 1500",
}


def test_a_typed_number_is_one_number_or_none(node):
    asked = [("state.js", "typedNumber", text) for text in [*TYPED, *REFUSED]]
    found = node(asked)
    assert [each.get("value") for each in found[: len(TYPED)]] == list(TYPED.values())
    for each, why in zip(found[len(TYPED) :], REFUSED.values(), strict=True):
        assert why in each["error"]


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [2, 1, 0])
def test_a_bare_measurement_is_judged_as_what_it_is_below_its_lines(node, rigid):
    """A rigid body, one with friction, and one on a suspension, either way round: poles outside as those of the model."""
    rng, calls, wanted = np.random.default_rng(rigid), [], []
    for seed in range(24):
        mass, sign = float(np.exp(rng.uniform(-2, 4))), 1 - 2 * (seed % 2)
        first, hertz = float(rng.uniform(2, 20)), float(rng.uniform(200, 400))
        model = lti.ModalModel(
            TURN * np.array([0.0 if rigid else 6 * first, hertz]),
            np.array([0.0 if rigid else 0.05, 0.01]),
            np.array([[1.0], [0.6]]) / np.sqrt(mass),
            np.array([[1.0, float(rng.choice([-0.6, 0.6]))]]) / np.sqrt(mass),
            np.array([[0.0]]),
            drag=TURN * 6 * first if rigid == 1 else 0.0,
        )
        lines = np.geomspace(first, 40 * hertz, 700)
        own = -((TURN * lines) ** 2) * model.frequency_response(TURN * lines)[0, 0]
        rate, bandwidth = 100 * hertz, float(np.exp(rng.uniform(np.log(3 * first), np.log(2 * hertz))))
        pid = control.PidFamily(mass)(bandwidth)
        loop = make_loop(model, low_hz=first / 30, sample_time=1 / rate, delay=0.5)
        machine = {
            "name": "bare",
            "units": {"position": "m", "drive": "N"},
            "notes": [],
            "delay_s": 0.0,
            "model": None,
            "measured": {"hz": lines, "re": sign * own.real, "im": sign * own.imag},
            "band_hz": [lines[0], lines[-1]],
            "uncertainty": {"gain": 1e-4, "delay": 0.0},
        }
        timing = [{"kind": "sampling", "rate_hz": rate}, {"kind": "delay", "delay_us": 0.5e6 / rate}]
        calls.append(("here", "alone", machine, {"blocks": [pid_block(pid), *timing], "limit": None}))
        wanted.append((sign < 0, int(np.sum(loop.poles(pid).real > 0)), mass))
    for found, (turned, unstable, mass) in zip(values(node(calls)), wanted, strict=True):
        assert (found["rigid"], found["turned"]) == (rigid, turned)
        assert found["unstable"] == found["box"] == unstable
        assert rigid != 2 or found["mass"] == pytest.approx(mass, rel=0.1)
    assert 3 < sum(unstable > 0 for _, unstable, _ in wanted) < 21


def on_springs(hertz, flexible):
    """A machine of 12 kg on springs as the page has it, and its response alone from a tenth of the suspension on."""
    w, z = TURN * np.array([hertz, *flexible]), np.array([0.02, 0.01, 0.008])
    shares = np.array([1.0, 0.5, -0.3]) / 12
    model = lti.ModalModel(
        w,
        z,
        np.sqrt(np.abs(shares))[:, None],
        (np.sign(shares) * np.sqrt(np.abs(shares)))[None],
        np.zeros((1, 1)),
    )
    whole = entry(Machine((model,), 12.0, "springs"), {"frequency": 0.05, "gain": 0.05})
    lines = np.arange(0.1 * hertz, 2 * flexible[-1], 0.02 * hertz)
    accelerance = -((TURN * lines) ** 2) * model.frequency_response(TURN * lines)[0, 0]
    measured = {"hz": lines.tolist(), "re": accelerance.real.tolist(), "im": accelerance.imag.tolist()}
    ends = {"band_hz": lines[[0, -1]].tolist(), "uncertainty": {"gain": 0.05, "delay": 0.0}}
    return whole, whole | ends | {"model": None, "measured": measured}


@pytest.mark.parametrize("hertz", [0.8, 2.0])
def test_a_first_design_is_stable_on_a_suspension(node, hertz):
    """Of a model, of its response alone, and of that however it is taken below its first line."""
    whole, alone = on_springs(hertz, [15 * hertz, 28 * hertz])
    calls = [("here", "first", whole), *(("here", "first", alone, below) for below in (None, 0, 1, 2))]
    found = values(node(calls))
    assert all(each["stable"] and not each["words"] for each in found)
    assert [each["rigid"] for each in found[1:]] == [0, 0, 1, 2]
    assert max(each["peak"] for each in found) < 10 ** (6.01 / 20)
