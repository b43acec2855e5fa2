"""Controllers on their way out: to files and back, to SciPy and python-control, which answer as they do."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from stillwork.base.checks import InputError
from stillwork.control.digital import (
    DigitalController,
    anti_windup,
    error_driven,
    from_biquads,
    load_controller,
    observed_controller,
)
from stillwork.control.feedforward import Feedforward, Motion
from stillwork.control.pid import Notch, Pid
from stillwork.control.setpoint import MoveLimits
from stillwork.lti.discretisation import tustin
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel

SAMPLE_TIME = 1e-4
PID = Pid(1e4, 12.0, 120.0, 1200.0, notches=(Notch(2000.0),))
MODEL = tustin(PID.state_space(), SAMPLE_TIME)
INPUTS = np.random.default_rng(3).standard_normal((1, 3000))
LIMITED = DigitalController(
    MODEL,
    ("e (m)",),
    ("f (N)",),
    low=[-np.inf],
    high=[3e4],
    anti_windup=anti_windup(MODEL, 0.01),
    delay=1,
    about={"gains": {"gain": 1e4}},
)


@pytest.mark.parametrize(
    "sections",
    [
        signal.butter(5, 0.1, output="sos"),
        signal.iirnotch(0.002, 30.0),
        signal.ellip(6, 1, 60, [0.01, 0.03], "band", output="sos"),
        [[0.5, 0.25, 0.0, 1.0, 0.0, 0.0], [1.0, -0.2, 0.1, 1.0, -1.8, 0.81]],
    ],
)
def test_biquads_filter_as_scipy_does(sections):
    if isinstance(sections, tuple):
        sections = np.hstack(sections)[None]
    sections = np.array(sections)
    wanted = signal.sosfilt(sections, INPUTS[0])
    model = from_biquads(sections, SAMPLE_TIME)
    assert simulate(model, INPUTS)[0] == pytest.approx(wanted, abs=1e-8 * np.abs(wanted).max())


def test_an_observed_controller_is_the_block_diagram():
    """By substitution at one frequency: e = r - y + y_flex, v = C e + u_d, (u_d, y_flex) = O(f, y)."""
    rng = np.random.default_rng(0)
    other = StateModel(
        np.diag([0.5, 0.8]), rng.standard_normal((2, 2)), rng.standard_normal((2, 2)), np.array([[0.0, 0.3], [0.0, 0.2]]), SAMPLE_TIME
    )  # fmt: skip
    omega = np.array([900.0])
    (o_uf, o_uy), (o_yf, o_yy) = other.frequency_response(omega)[..., 0]
    c = MODEL.frequency_response(omega)[0, 0, 0]
    found = observed_controller(MODEL, other).frequency_response(omega)[0, :, 0]
    assert found == pytest.approx([c, -c + c * o_yy + o_uy, c * o_yf + o_uf], rel=1e-9)


def test_a_file_gives_the_controller_back(tmp_path):
    file = tmp_path / "controller.json"
    file.write_text(json.dumps(LIMITED.as_dict(), allow_nan=False))
    again = load_controller(file)
    assert again.as_dict() == LIMITED.as_dict()
    assert np.array_equal(again.run(INPUTS), LIMITED.run(INPUTS))
    assert again.low[0] == -np.inf and again.about == {"gains": {"gain": 1e4}}


def test_a_motion_comes_back_from_its_files(tmp_path):
    """From JSON and from TOML, whose lag is by default that of the delay and the hold; it says what it does not know."""
    motion = Motion(Feedforward(acceleration=12.5, coulomb=1.0), 2.5e-4, MoveLimits(0.2, 3.0, 300.0))
    controller = replace(LIMITED, low=[-3e4], delay=2, motion=motion)
    (tmp_path / "a.json").write_text(json.dumps(controller.as_dict(), allow_nan=False))
    assert load_controller(tmp_path / "a.json").motion == motion
    table = """[controller]
rate_hz = 10000
biquads = [[2.0, -1.0, 0.0, 1.0, 0.0, 0.0]]
delay_samples = 2
[controller.motion.feedforward]
acceleration = 12.5
coulomb = 1.0
[controller.motion.limits]
velocity = 0.2
acceleration = 3.0
jerk = 300.0
"""
    (tmp_path / "a.toml").write_text(table)
    assert load_controller(tmp_path / "a.toml").motion == motion
    (tmp_path / "a.toml").write_text(table.replace("coulomb", "columb"))
    with pytest.raises(InputError, match="did you mean 'coulomb'"):
        load_controller(tmp_path / "a.toml")
    with pytest.raises(InputError, match=r"^motion\b.*2 inputs"):
        DigitalController(
            StateModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.ones((1, 2)), 1e-3),
            ("r", "y"), ("f",), motion=motion,
        )  # fmt: skip
    with pytest.raises(InputError, match=r"^controller\b"):
        error_driven(LIMITED)


@pytest.mark.slow
def test_a_table_gives_a_controller(tmp_path):
    file = tmp_path / "pid.toml"
    rows = {name: getattr(MODEL, name).tolist() for name in "abcd"}
    text = "\n".join(f"{name} = {value}" for name, value in rows.items())
    file.write_text(f"[controller]\nrate_hz = 10000\n{text}\nlow = -5\nhigh = [5]\ntracking_time_s = 0.01\n")
    found = load_controller(file)
    wanted = DigitalController(MODEL, ("e",), ("f",), -5.0, 5.0, anti_windup(MODEL, 0.01))
    assert np.array_equal(found.run(INPUTS), wanted.run(INPUTS))
    assert found.inputs == ("input 1",)


def test_an_output_that_follows_from_itself_is_refused():
    model = StateModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.ones((1, 2)), SAMPLE_TIME)
    with pytest.raises(InputError, match=r"^model\b.*output"):
        DigitalController(model, ("e",), ("f",))
