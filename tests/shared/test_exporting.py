"""The command `export`: C from a file into a new folder, all of it or nothing."""

import json

import numpy as np
import pytest

from stillwork.__main__ import main
from stillwork.base.checks import InputError
from stillwork.control.digital import DigitalController
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.recursive_least_squares import RecursiveLeastSquares
from stillwork.lti.state_space import StateModel
from stillwork.machine.c_code import adaptation_code, controller_code, least_squares_code
from stillwork.machine.export import write_folder

LAG = DigitalController(
    StateModel(np.array([[0.9]]), np.array([[0.1]]), np.array([[1.0]]), np.zeros((1, 1)), 1e-3), ("e (m)",), ("f (N)",)
)  # fmt: skip


def read(folder):
    return {file.name: file.read_text() for file in folder.iterdir()}


def test_a_controller_is_written_as_the_library_gives_it(tmp_path, capsys):
    (tmp_path / "lag.json").write_text(json.dumps(LAG.as_dict()))
    out = tmp_path / "new" / "c"
    arguments = [str(tmp_path / "lag.json"), "--out", str(out), "--name", "lag", "--precision", "single"]
    assert main(["export", *arguments]) == 0
    assert read(out) == controller_code(LAG, "lag", "single")
    assert "lag.h, lag.c" in capsys.readouterr().out
    assert [each.name for each in out.parent.iterdir()] == ["c"]  # nothing lies beside it


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (
            "[FeRls]\ninitial_covariance = [1.0, 2.0, 3.0]\nforgetting = 0.999\nactuators = 2\nregressors = 3\n",
            adaptation_code(FeRls([1.0, 2.0, 3.0], 0.999), 2, 3, "controller"),
        ),
        (
            "[FeLms]\nstep_size = 0.01\nactuators = 2\nregressors = 3\n",
            adaptation_code(FeLms(0.01), 2, 3, "controller"),
        ),
        (
            "[RecursiveLeastSquares]\nforgetting = 0.99\nfeatures = 3\noutputs = 1\n",
            least_squares_code(RecursiveLeastSquares(forgetting=0.99), 3, 1, "controller"),
        ),
    ],
)
def test_estimators_are_written_as_the_library_gives_them(tmp_path, text, wanted):
    (tmp_path / "a.toml").write_text(text)
    assert main(["export", str(tmp_path / "a.toml"), "--out", str(tmp_path / "out")]) == 0
    assert read(tmp_path / "out") == wanted


BAD = {
    "[FeRls]\nactuators = 2\nregressors = 3\n": "initial_covariance",
    "[FeLms]\nactuators = 2\nregressors = 3\nstepsize = 0.1\n": "did you mean 'step_size'?",
    "[FeRsl]\nactuators = 2\n": "did you mean 'FeRls'?",
    "": "table is None; use one of",
    "[controller]\nrate_hz = 1\nbiquads = [[1, 2]]\n": "a.toml: biquads has shape",
}


@pytest.mark.parametrize("text", BAD)
def test_files_that_describe_nothing_say_why_and_leave_nothing(tmp_path, capsys, text):
    (tmp_path / "a.toml").write_text(text)
    assert main(["export", str(tmp_path / "a.toml"), "--out", str(tmp_path / "out")]) == 2
    assert BAD[text] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_nothing_is_overwritten_and_nothing_half_written(tmp_path):
    out = tmp_path / "out"
    write_folder(out, {"a.c": "1"})
    with pytest.raises(InputError, match="nothing_is_overwritten"):
        write_folder(out, {"a.c": "2"})
    assert read(out) == {"a.c": "1"}
    with pytest.raises(AttributeError):
        write_folder(tmp_path / "half", {"a.c": "1", "b.c": None})
    assert [each.name for each in tmp_path.iterdir()] == ["out"]
