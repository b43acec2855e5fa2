"""The command ``report``: one page for what can be read, one clear line for what cannot, questions for what is missing."""

import re

import numpy as np
import pytest

from stillwork.__main__ import main
from stillwork.machine.report import Missing, report_file

HERTZ = np.arange(5.0, 500.0)
RESPONSE = 1 - 0.5 * HERTZ**2 / (120.0**2 - HERTZ**2 + 2j * 0.01 * 120 * HERTZ)


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def csv(**columns):
    """Columns of equal length as text."""
    rows = np.column_stack(list(columns.values()))
    return "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())])


def npz(**arrays):
    with open("made.npz", "wb") as file:
        np.savez(file, **arrays)
    return open("made.npz", "rb").read()


def record(n=600, **columns):
    t = np.arange(n) / 100.0
    return {"time": t, "a (m/s^2)": np.sin(t**2), **columns}


def response(hertz=HERTZ, unit="m/s^2/N"):
    return {"frequency": hertz, f"real ({unit})": RESPONSE.real, f"imag ({unit})": RESPONSE.imag}


PULSE = np.exp(-(((np.arange(512) - 20) / 2.0) ** 2))
HITS = {"time": np.arange(512) / 1000, "force 1 (N)": PULSE, "force 2 (N)": PULSE}
RINGS = np.exp(-np.arange(512) / 30) * np.sin(np.arange(512) / 2)
PAIR = {"M": np.diag([8.0, 2.0]), "K": np.array([[1e6, -1e6], [-1e6, 1e6]]), "input": [1.0, 0.0]}

BROKEN = {
    "an empty file": ("a.csv", lambda: "", "a.csv is empty"),
    "a model": ("a.toml", lambda: "mass = 1.0\n", "is a model, not a measurement"),
    "a gap in values": ("a.csv", lambda: csv(**record(b=np.where(np.arange(600) == 9, np.nan, 1.0))), "not finite"),
    "a dead channel": ("a.csv", lambda: csv(**record(b=np.ones(600))), "b stands at 1 throughout"),
    "no rate": ("a.csv", lambda: csv(**{"a (g)": RINGS}), "neither time nor sample rate; .* give --sample-rate HZ"),
    "no unit": ("a.csv", lambda: csv(**record(b=RINGS[np.arange(600) % 512])), "unit of b .*; give --unit UNIT"),
    "a response without units": ("a.csv", lambda: csv(f=HERTZ, real=RESPONSE.real, imag=RESPONSE.imag), "--response-unit UNIT"),
    "a matrix of responses": ("a.npz", lambda: npz(frequency=HERTZ, h=np.ones((2, 1)) * RESPONSE[None, None]), r"h\[1,1\].*; give --response NAME"),
    "a force that never ends": ("a.csv", lambda: csv(**{"time": HITS["time"], "force (N)": np.sin(np.arange(512)), "a (g)": RINGS}), "which is no hit"),
    "matrices without a force": ("a.npz", lambda: npz(M=PAIR["M"], K=PAIR["K"]), "input is missing"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_gives_one_clear_line_and_no_page(tmp_path, capsys, name):
    file, content, message = BROKEN[name]
    content = content()
    (tmp_path / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["report", file, "--out", "page.html"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and told.startswith("stillwork: ")
    assert re.search(message, told) and "Traceback" not in told and "Error" not in told
    assert not (tmp_path / "page.html").exists()


def page_of(file, **said):
    """The page's text without its pictures, and how many there are."""
    lines = report_file(str(file), "page.html", **said)
    text = open("page.html", encoding="utf-8").read()
    pictures = re.findall(r'src="data:image/png;base64,[A-Za-z0-9+/=]{4000,}"', text)
    assert "$" not in re.sub(r'src="[^"]*"', "", text)
    return lines, text, len(pictures)


@pytest.mark.slow
def test_a_record_gets_its_spectra_and_its_coherence(tmp_path):
    rng = np.random.default_rng(0)
    shaken = rng.normal(size=4000)
    columns = {"time": np.arange(4000) / 500, "drive (V)": shaken, "plate (g)": 0.5 * shaken}
    (tmp_path / "a.csv").write_text(csv(**columns))
    lines, text, pictures = page_of("a.csv")
    assert lines == [
        "a record: 500 Hz, 8 s, 2 channels",
        f"rms: drive (V) {shaken.std():.4g} V, plate (g) {0.5 * 9.80665 * shaken.std():.4g} m/s^2",
        "written: page.html",
    ]
    assert pictures == 2
    rms = re.search(r"plate \(g\)</td><td>m/s\^2</td><td>([\d.]+)", text)
    assert float(rms[1]) == pytest.approx(0.5 * 9.80665 * shaken.std(), rel=1e-3)
    with pytest.raises(ValueError, match=r"page\.html\b"):
        report_file("a.csv", "page.html")


@pytest.mark.slow
def test_densities_get_their_root_mean_squares(tmp_path):
    """1/f^2 in position between 5 and 499 Hz by the integral in closed form, as (mm)^2/Hz."""
    hertz = np.geomspace(5.0, 499.0, 2000)
    (tmp_path / "a.csv").write_text(csv(**{"frequency": hertz, "floor (mm^2/Hz)": 1 / hertz**2}))
    _, text, pictures = page_of("a.csv")
    found = [
        float(each) for each in re.search(r"floor.*?</td><td>(.*?)</td></tr>", text)[1].split("</td><td>")
    ]
    exact = [
        (2 * np.pi) ** 2 * np.sqrt((499.0**3 - 5.0**3) / 3),
        2 * np.pi * np.sqrt(494.0),
        np.sqrt(1 / 5 - 1 / 499),
    ]
    assert found == pytest.approx(1e-3 * np.array(exact), rel=2e-3) and pictures == 1


@pytest.mark.slow
def test_what_is_missing_is_asked(tmp_path, monkeypatch, capsys):
    (tmp_path / "a.csv").write_text(csv(**{"a": RINGS}))
    with pytest.raises(Missing, match="--sample-rate"):
        report_file("a.csv")
    answers = iter(["1000", "mg"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: (print(question), next(answers))[1])
    assert main(["report", "a.csv"]) == 0
    said = capsys.readouterr().out
    assert "the rate in Hz" in said and "the unit of a" in said and "written: a.csv.html" in said
