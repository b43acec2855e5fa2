"""The compute track: what is counted, and that the committed table is of this code."""

import numpy as np
import pandas as pd
import pytest

from contest import compute
from contest.plants import PLANTS
from contest.scores import ENTRANTS, Scan, recorded
from contest.table import COMPUTED, leaderboard
from stillwork.base.kernels import kernel


@kernel
def _scale_all(factor, vector):
    for i in range(len(vector)):
        vector[i] *= factor


@kernel
def _known(x, matrix, count):
    # Six operations on real numbers in `_known`, and one for each element of the vector in the other.
    total = 0.0
    for i in range(2 * count - 1):  # arithmetic of whole numbers
        total += x[i] / 3.0
    if abs(-total) > max(total, 1.0):
        total = 1.0
    _scale_all(np.sqrt(total), x)
    matrix -= total  # in place, an operation a number
    return total**2


def test_operations_are_those_on_real_numbers():
    counter, x, matrix = compute.Counter(), np.arange(5.0), np.ones((2, 3))
    alias = matrix
    assert counter.counting(_known)(x, matrix, 1) == 0.0
    assert counter.operations == 2 + 1 + 5 + 6 + 1
    assert (alias == 1.0).all() and matrix is alias


def test_what_cannot_be_counted_is_refused():
    @kernel
    def product(x):
        return x @ x

    @kernel
    def total(x):
        return x.sum()

    for each in (product, total):
        with pytest.raises(NotImplementedError, match="write it as a loop"):
            compute.Counter().counting(each)


@pytest.mark.parametrize("plant", ["stage", "plate"])
def test_the_kalman_filter_takes_what_its_products_take(plant):
    scan = Scan("estimate", plant, "none", "a test", 0)
    (model, _, _), record = scan.given(), recorded(scan)
    (n, inputs), outputs = model.b.shape, len(model.c)
    found = compute.operations_of(compute.begun("Kalman", scan), record.inputs[:3], record.measurements[:3])
    assert found == 2 * n * n + 2 * n * inputs + outputs * (2 * n + 1) + 2 * n * outputs


@pytest.mark.slow
@pytest.mark.parametrize("name", ENTRANTS)
def test_a_counted_run_is_the_compiled_one(name):
    """No kernel reads or writes beyond its arrays, of which compiled code is silent, and the count misses no statement."""
    for plant in ("stage", "plate"):
        scan = Scan("estimate", plant, "lost 20 %", "a test", 0)
        record, both = recorded(scan), [compute.begun(name, scan) for _ in range(2)]
        some = slice(60, 66)
        for each in both:
            each.run(record.inputs[:60], record.measurements[:60])
        compute.operations_of(both[0], record.inputs[some], record.measurements[some])
        both[1].run(record.inputs[some], record.measurements[some])
        for counted, compiled in zip(*(each.memory for each in both), strict=True):
            scale = np.nanmax(np.abs(compiled))
            np.testing.assert_allclose(counted, compiled, rtol=1e-9, atol=1e-12 * float(scale))


def test_the_committed_table_is_whole_and_of_this_code():
    table = pd.read_csv(COMPUTED)
    assert table[["plant", "entrant"]].apply(tuple, axis=1).tolist() == [
        (plant, name) for plant in PLANTS for name in ENTRANTS
    ]
    assert (table.loc[table["entrant"] == "Kalman", "ratio"] - 1).abs().max() < 0.1
    scan = Scan("estimate", "drive", compute.UNCERTAINTY, compute.DEVELOPMENT, 0)
    record, rows = recorded(scan), table[table["plant"] == "drive"].set_index("entrant")
    some = slice(compute.SETTLED, compute.SETTLED + compute.COUNTED)
    for name in ("Kalman", "structured H2", "extended Kalman", "unscented Kalman"):
        observer = compute.begun(name, scan)
        observer.run(record.inputs[: compute.SETTLED], record.measurements[: compute.SETTLED])
        found = compute.operations_of(observer, record.inputs[some], record.measurements[some])
        assert (found, observer.bytes) == (rows.loc[name, "operations"], rows.loc[name, "bytes"])


def test_of_a_file_operations_are_not_counted():
    found = {
        "standings": [{"observer": "mine", "mean rank": "3.0", "µs a sample": "240"}],
        "entered": {"mine": {}},
        "code": "",
        "public": [],
        "friedman": 0.1,
        "critical difference": 1.0,
    }
    recorded = pd.DataFrame(
        [("both sensors", "pushed", 0, 1, "mine", 0.5)],
        columns=["task", "part", "trained", "judged", "entrant", "error"],
    )
    assert "| mine | 240 µs | not counted |  |" in leaderboard(found, recorded, pd.read_csv(COMPUTED))
