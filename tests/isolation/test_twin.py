"""Twins from TOML: what is read, what is refused, and that anyone's rig can be given."""

import tomllib

import numpy as np
import pytest

from experiments.isolation.twin import load_twin, twin_from_table
from stillwork.base.checks import InputError
from workbook import paths


def table(name="rigid_body"):
    return tomllib.loads(paths.data("isolation", f"{name}.toml").read_text(encoding="utf-8"))


def changed(path, value, name="rigid_body"):
    """Table with one value replaced, or removed where `value` is None."""
    whole = table(name)
    part = whole
    *parents, last = path.split(".")
    for parent in parents:
        part = part[parent]
    if value is None:
        del part[last]
    else:
        part[last] = value
    return whole


@pytest.mark.parametrize("name", ["rigid_body", "fitted"])
def test_shipped_twins_have_the_published_sizes(name):
    twin = load_twin(name)
    assert (twin.actuators, twin.outputs, twin.sensors, twin.regressors) == (6, 6, 3, 9)
    assert twin.feedforward.path.suspension == [1.4, 290.0, 60e3]


def test_a_model_of_ones_own(tmp_path):
    source = paths.data("isolation", "rigid_body.toml").read_text(encoding="utf-8")
    own = tmp_path / "own.toml"
    own.write_text(source.replace("mass = 5.4 ", "mass = 6 "), encoding="utf-8")
    assert load_twin(own).rig.mass == 6.0
    assert load_twin(str(own)).rig.mass == 6.0


def test_actuators_and_sensors_may_sit_elsewhere_than_the_struts():
    whole = table()
    turned = np.roll(whole["struts"]["directions"], 2, axis=0).tolist()
    whole["actuators"] = {"positions": whole["struts"]["positions"], "directions": turned}
    twin = twin_from_table(whole)
    assert twin.plant.actuation != pytest.approx(load_twin("rigid_body").plant.actuation)
    assert twin.plant.observation == pytest.approx(load_twin("rigid_body").plant.observation)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("body.mass", None, "^body: 'mass'"),
        ("body.mas", 5.4, "^body:.*'mas'.*'mass'"),
        ("body.inertia", [[1.0, 0.0], [0.0, 1.0]], r"\binertia\b"),
        ("struts.positions", [[0.0, 0.0, 0.0]], r"\bdirections\b"),
        ("instruments.sample_rate", 0.0, r"\bsample_rate\b"),
        ("instruments.parasitic_hz", 3000.0, r"\bparasitic_hz\b"),
        ("instruments.mains_hz", [50.0], r"\bfloor_mains\b"),
        ("skyhook", 225.0, r"^skyhook\b"),
        ("feedforward.shaping.highpass_hz", 400.0, r"\blowpass_hz\b"),
        ("feedforward.path.actuator_pole_hz", None, r"^feedforward\.path: 'actuator_pole_hz'"),
        ("plnt", {}, "^model:.*'plnt'"),
    ],
)
def test_bad_models_are_refused_by_name(path, value, message):
    with pytest.raises(InputError, match=message):
        twin_from_table(changed(path, value))
