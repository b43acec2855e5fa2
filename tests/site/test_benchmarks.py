"""The page of benchmarks: its ratios are those of the committed tables, and it names no place on a machine."""

import csv

from workbook import paths
from workbook.timings import benchmarks


def test_ratios_are_those_of_the_committed_times():
    updates, response, *_, kalman, unknowns, filters = benchmarks()
    with paths.data("isolation", "update_times/update_times.csv").open(encoding="utf-8") as file:
        median = {row["form"]: float(row["median_us"]) for row in csv.DictReader(file)}
    found = dict(updates["rows"])
    assert found["FeRLS of this library"] == [(median["recursion"], 1.0)]
    assert found["padasip FilterRLS, one an actuator"] == [
        (median["padasip"], median["padasip"] / median["recursion"])
    ]
    with paths.data("worstcase", "update_times/update_times.csv").open(encoding="utf-8") as file:
        exact = {
            row["unknowns"]: float(row["exact (us)"]) / float(row["RLS (us)"]) for row in csv.DictReader(file)
        }
    ratios = [ratio for _, ratio in dict(unknowns["rows"])["min-max, exact update"]]
    assert unknowns["headings"] == ["5", "20", "100"]
    assert ratios == [exact[size] for size in unknowns["headings"]]
    assert {ratio for _, ((_, ratio),) in filters["rows"]} >= {1.0}
    with paths.data("motion", "times/times.csv").open(encoding="utf-8") as file:
        times = {row["what"]: float(row["median_ms"]) for row in csv.DictReader(file)}
    mine, peer = times["modal residues"], times["control.frequency_response"]
    assert dict(response["rows"])["python-control"] == [(peer, peer / mine)]
    assert dict(kalman["rows"])["filterpy"][0][0] == times["Kalman step, filterpy"]
