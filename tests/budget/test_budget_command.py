"""`stillwork budget`: what its page says, followed, comes true; and what it refuses."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from experiments.budget.machine import machine as notebooks_machine
from stillwork.__main__ import main
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_toml
from stillwork.control.budget import error_budget, tone_response
from stillwork.control.digital import DigitalController
from stillwork.control.pid import PidFamily
from stillwork.lti.discretisation import tustin
from stillwork.machine import budget
from stillwork.machine.budget_tables import machine_of, measured_at, open_machine, sources_of
from stillwork.machine.inspect import inspect_file
from stillwork.machine.isolate import isolate_file, read_isolator
from stillwork.machine.machine_toml import MACHINES, new_machine
from workbook import paths


@pytest.fixture
def files(tmp_path, monkeypatch):
    """The templates; without the page's picture, which is half of a run and painted once, at the command line."""
    monkeypatch.setattr(budget, "picture", lambda *_: "")
    for name in MACHINES:
        new_machine(str(tmp_path / f"{name}.toml"), name)
    return {name: tmp_path / f"{name}.toml" for name in MACHINES}


def change(file, *pairs):
    text = file.read_text()
    for old, fresh in pairs:
        assert old in text
        text = text.replace(old, fresh)
    file.write_text(text)
    return str(file)


def findings(*arguments, **options):
    """All findings, without the answer before them."""
    return budget.budget_file(*arguments, verbose=True, **options)[3:]


def rms(lines):
    return float(re.search(r"rms ([\d.e+]+) nm", lines[0])[1])


TEXTS = {  # of a number in the template of the wafer-like stage
    "suspension frequency": "suspension_hz = 4.0",
    "passive damping": "suspension_damping = 0.05",
    "skyhook": "skyhook_damping = 0.6",
    "frame mass": "frame_mass_kg = 180.0",
    "delay": "delay_samples = 1.0",
    "damping of the stage's modes": "modes_damping = 0.01",
    "bandwidth": "bandwidth_hz = 80.0",
    "stage mass": "stage_mass_kg = 20.0",
    "remainder of the feedforward": "feedforward_db = 20.0",
}
SCAN = '\n[sources.scan]\nplace = "setpoint"\nmove = "20 mm"\nmove_s = 0.2\nrest_s = 0.1\n'


@pytest.mark.parametrize(
    "more",
    [
        SCAN,  # its feedforward assumes the stage's mass: 2 % more would save, 10 % more does not
        SCAN + "feedforward_mass_kg = 20.0\n",
        '[sources.pump]\nplace = "frame force"\ntone_hz = 4.2\namplitude = "1 N"\n',  # beside the suspension
    ],
)
def test_each_change_is_what_the_changed_file_gives(more, files, tmp_path):
    """Every number 10 % off either way, and the sensor at half its level, written into the file."""
    text = files["wafer-stage"].read_text() + more

    def total(changed):
        file = tmp_path / "changed.toml"
        file.write_text(changed)
        machine = machine_of(read_toml(file))
        sources = sources_of(read_toml(file), "", tmp_path, 1e4, machine.stage_mass)
        return 1e9 * float(error_budget(machine.network(), sources, (0.5, 2000.0)).rms[0])

    files["wafer-stage"].write_text(text)
    said = "\n".join(findings(str(files["wafer-stage"]), out=str(tmp_path / "out")))
    now = total(text)
    for name, old in TEXTS.items():
        field, value = old.split(" = ")
        row = re.search(rf"\d\. {name}(, whose [\w ]+,)? (10 % [^;\n]*)", said)
        for way, ratio in (("lower", 0.9), ("higher", 1.1)):
            fresh = float(value) - 20 * np.log10(ratio) if field == "feedforward_db" else float(value) * ratio
            change_nm = total(text.replace(old, f"{field} = {fresh}", 1)) - now
            found = re.search(rf"10 % {way} (saves|costs) ([\d.e+]*)", row[2]) if row else None
            if found:
                told = float(found[2]) * (-1 if found[1] == "saves" else 1)
                assert told == pytest.approx(change_nm, rel=6e-3)
            elif name != "delay" or way == "lower":
                assert abs(change_nm) <= 1e-3 * now
    assert ("whose feedforward follows" in said) == (more == SCAN)
    assert ("whose feedforward stays" in said) == ("feedforward_mass" in more)
    saved = re.search(r"stage sensor at half its level saves ([\d.]+) nm", said)
    halved = now - total(text.replace("0.3 nm/sqrt(Hz)", "0.15 nm/sqrt(Hz)"))
    assert float(saved[1]) == pytest.approx(halved, rel=6e-3) if saved else halved <= 1e-3 * now


def test_a_change_that_makes_the_loop_unstable_is_named(files, tmp_path):
    file = files["wafer-stage"]
    text, low, high = file.read_text(), 80.0, 2000.0
    while high > 1.02 * low:
        hertz = float(np.sqrt(low * high))
        file.write_text(text.replace("bandwidth_hz = 80.0", f"bandwidth_hz = {hertz}"))
        try:
            machine_of(read_toml(file)).network()
            low = hertz
        except InputError:
            high = hertz
    file.write_text(text.replace("bandwidth_hz = 80.0", f"bandwidth_hz = {low}"))
    said = "\n".join(findings(str(file), out=str(tmp_path / "out")))
    assert re.search(r"bandwidth 10 % lower saves [\d.e+]+ nm \(10 % higher is unstable\)", said)


def test_the_level_that_is_said_to_matter_doubles_the_power(files, tmp_path):
    file = files["microscope-stage"]
    lines = findings(str(file), out=str(tmp_path / "1"))
    level = re.search(r"isolator drive: no source given; ([\d.e-]+) N", "\n".join(lines))[1]
    file.write_text(
        file.read_text() + f'\n[sources.coils]\nplace = "isolator drive"\nwhite = "{level} N/sqrt(Hz)"\n'
    )
    louder = rms(findings(str(file), out=str(tmp_path / "2")))
    assert louder**2 == pytest.approx(2 * rms(lines) ** 2, rel=0.1)  # two digits of the level


def test_a_floor_of_ones_own_takes_the_place_of_the_files(files, tmp_path):
    f = np.linspace(0.5, 400, 800)
    np.savetxt(
        tmp_path / "floor.csv",
        np.c_[f, 1e-5 * np.ones(800)],
        delimiter=",",
        header="frequency,z (m/s^2/sqrt(Hz))",
        comments="",
    )
    entries = read_toml(files["wafer-stage"])
    machine = machine_of(entries)
    (floor,) = [
        s for s in sources_of(entries, str(tmp_path / "floor.csv"), tmp_path, 1e4) if s.places == ("floor",)
    ]
    network = machine.network()
    budget = error_budget(network, [floor], (0.5, 400.0))
    path = np.abs(network.paths(f)[0, 0]) ** 2 * 1e-10
    assert budget.powers[0, 0] == pytest.approx(np.trapezoid(path, f), rel=0.03, abs=0)  # half a hertz apart
    time = np.arange(8000) / 400
    record = np.random.default_rng(0).standard_normal(8000) * 1e-3
    np.savetxt(
        tmp_path / "record.csv", np.c_[time, record], delimiter=",", header="time,z (m/s^2)", comments=""
    )
    lines = findings(str(files["wafer-stage"]), floor=str(tmp_path / "record.csv"), out=str(tmp_path / "r"))
    assert "95 % interval from the records' length" in lines[0] and "floor ends at 0.8 Hz" in lines[1]


def test_a_design_takes_the_place_of_stage_and_controller(files, tmp_path):
    """A PID written as `design` writes it, on the stage of the file without its modes: the same machine twice."""
    text = change(
        files["wafer-stage"],
        ("modes_hz = [450.0, 700.0]", "modes_hz = []"),
        ("modes_share = [0.15, -0.1]", "modes_share = []"),
    )
    entries = read_toml(text)
    model = {
        "frequencies_rad_s": [0.0],
        "damping": [0.0],
        "residues": [1 / 20],
        "compliance": 0.0,
        "drag_1_s": 0.0,
    }
    about = {"model": model, "provenance": {"delay_samples_of_the_loop": 1.0}}
    law = tustin(PidFamily(20.0)(80.0).state_space(), 1e-4)
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "c.json").write_text(
        json.dumps(DigitalController(law, ("e (m)",), ("f (N)",), about=about).as_dict())
    )
    # The same law from counts to amperes, of a sensor of 2e8 counts a metre and a motor of 1.5 N/A.
    drive = replace(law, b=law.b / 2e8, c=law.c / 1.5, d=law.d / 3e8)
    about["provenance"] |= {"encoder_counts": 2e8, "motor_constant": 1.5}
    (tmp_path / "drive.json").write_text(
        json.dumps(DigitalController(drive, ("e (count)",), ("f (A)",), about=about).as_dict())
    )
    sources = sources_of(entries, "", tmp_path, 1e4)
    totals = [
        error_budget(machine_of(entries, where).network(), sources, (0.5, 2000.0)).rms[0]
        for where in ("", *(str(tmp_path / name) for name in ("made", "made/c.json", "drive.json")))
    ]
    np.testing.assert_allclose(totals[1:], totals[0], rtol=1e-6)
    (tmp_path / "drive.json").unlink()
    with pytest.raises(InputError, match="holds 0 controllers"):
        machine_of(entries, str(tmp_path))


@pytest.mark.parametrize(
    ("old", "fresh", "message"),
    [
        (
            'white = "0.3 nm/sqrt(Hz)"',
            'white = "0.3 nm"',
            r"^stage sensor: unit is 'nm', but 'stage sensor' needs m/sqrt",
        ),
        ('place = "stage drive"', 'place = "stage drve"', r"^amplifier: place.*did you mean 'stage drive'"),
        ('criterion = "VC-C"', "", "^floor: holds no kind"),
        (
            "skyhook_damping = 0.6",
            "skyhook_damping = 600.0",
            "^the closed loop is unstable.*without the skyhook",
        ),
        ("modes_share = [0.15, -0.1]", "modes_share = [-6e6, -0.1]", "^the closed loop is unstable.*signs$"),
        ('quantiser = "2 mN"', 'move = "2 mm"', "^DAC: move is not for the place 'stage drive'; give file"),
    ],
)
def test_bad_files_are_refused_by_name(old, fresh, message, files, tmp_path):
    with pytest.raises(InputError, match=message):
        findings(change(files["wafer-stage"], (old, fresh)), out=str(tmp_path / "out"))


def add(file, *lines):
    file.write_text(file.read_text() + "\n" + "\n".join(lines) + "\n")
    entries = read_toml(file)
    machine = machine_of(entries)
    return machine.network(), sources_of(entries, "", file.parent, 1e4, machine.stage_mass)


def scan(file, **more):
    fields = [f"{name} = {value!r}".replace("'", '"') for name, value in more.items()]
    return add(file, "[sources.scan]", 'place = "setpoint"', *fields)


def test_a_move_is_the_setpoint_that_a_file_holds_and_its_feedforward_takes_the_stages_mass(files, tmp_path):
    network, sources = scan(files["wafer-stage"], move="20 mm", move_s=0.2, rest_s=0.1)
    way = np.clip(np.arange(1500) / 1000, 0, 1)
    there = 0.02 * way**4 * (35 - 84 * way + 70 * way**2 - 20 * way**3)
    period = np.concatenate([there, 0.02 - there])
    np.savetxt(
        tmp_path / "scan.csv", np.c_[np.arange(3000) / 5000, period * 1e3], delimiter=",",
        header="time,x (mm)", comments="",
    )  # fmt: skip
    _, held = scan(files["telescope-mirror"], setpoint="scan.csv", feedforward_mass_kg=20.0)
    totals = [error_budget(network, [one[-1]], (0.5, 2000.0)).rms[0] for one in (sources, held)]
    assert totals[1] == pytest.approx(totals[0], rel=1e-6) and totals[0] > 1e-9
    lines = findings(str(files["wafer-stage"]), out=str(tmp_path / "out"))
    (said,) = [line for line in lines if line.startswith("while it moves")]
    waveform = tone_response(network, sources[-1], np.linspace(0, 0.6, 5000, endpoint=False), (0.5, 2000.0))[
        0
    ]
    numbers = [float(n) * 1e-9 for n in re.findall(r"([\d.e+]+) nm", said)]
    assert (
        numbers[:2] == pytest.approx([waveform.std(), np.abs(waveform).max()], rel=6e-3) and len(numbers) == 3
    )
    assert any("scan: half the error that its feedforward leaves" in line for line in lines)


def test_a_periodic_file_is_its_tone_and_noise_may_come_from_a_file_or_as_a_power(files, tmp_path):
    t = np.arange(4000) / 4000
    ripple = np.c_[t, 3.0 * np.sin(2 * np.pi * 24 * t)]
    np.savetxt(tmp_path / "ripple.csv", ripple, delimiter=",", header="time,f (mN)", comments="")
    f = np.arange(1.0, 3000.0)
    np.savetxt(
        tmp_path / "sensor.csv", np.c_[f, 0.3 * np.ones_like(f)], delimiter=",",
        header="frequency,s (nm/sqrt(Hz))", comments="",
    )  # fmt: skip
    network, sources = add(
        files["wafer-stage"],
        '[sources.a]\nplace = "stage drive"\nperiodic = "ripple.csv"',
        '[sources.b]\nplace = "stage drive"\ntone_hz = 24.0\namplitude = "3 mN"',
        '[sources.c]\nplace = "stage sensor"\nfile = "sensor.csv"',
        '[sources.d]\nplace = "stage sensor"\nwhite = "0.09 nm^2/Hz"',
        '[sources.e]\nplace = "stage sensor"\nwhite = "300 pm/√Hz"',
    )
    found = dict(
        zip("abcde", error_budget(network, sources[-5:], (1.0, 2000.0)).rms_by_source[:, 0], strict=True)
    )
    assert found["a"] == pytest.approx(found["b"], rel=1e-6)
    np.testing.assert_allclose([found["c"], found["d"]], found["e"], rtol=1e-5)


def test_a_stage_elsewhere_has_its_own_error(files, tmp_path):
    """One position is the file's own shares, the other has modes that the loop does not bear."""
    file = files["wafer-stage"]
    text = file.read_text().replace(
        "[controller]",
        "[machine.modes_share_at]\nhere = [0.15, -0.1]\nthere = [-60.0, -0.1]\n[controller]",
        1,
    )
    file.write_text(text)
    lines = findings(str(file), out=str(tmp_path / "out"))
    (said,) = [line for line in lines if line.startswith("over the stage's positions")]
    assert f"here {rms(lines):g} nm" in said and "there the closed loop is unstable" in said


def test_the_bandwidth_that_an_unstable_loop_is_offered_is_stable(files, tmp_path):
    file = files["wafer-stage"]
    with pytest.raises(InputError) as refused:
        findings(change(file, ("bandwidth_hz = 80.0", "bandwidth_hz = 2000.0")), out=str(tmp_path / "out"))
    hertz = re.search(r"bandwidth of (\d+) Hz", str(refused.value))[1]
    change(file, ("bandwidth_hz = 2000.0", f"bandwidth_hz = {hertz}.0"))
    assert rms(findings(str(file), out=str(tmp_path / "out"))) > 0


SENSORS = "".join(
    f'\n[sources."{kind} sensor"]\nplace = "{kind} sensor"\nwhite = "1e-5 m/s^2/sqrt(Hz)"\n'
    for kind in ("frame", "floor")
)


def test_a_method_that_the_machine_lacks_leaves_what_is_said_with_its_sensors_noise(files, tmp_path):
    """A sensor whose method is not there moves nothing, so that both may stand in the file."""
    file = files["microscope-stage"]
    change(file, ('"VC-A"', '"VC-G"'), ("20 uN", "0.2 uN"), ("0.1 mN/", "1 uN/"))
    lines = "\n".join(findings(str(file), out=str(tmp_path / "1")))
    said = {
        name: float(
            re.search(rf"not present: {name}, acting above [\d.]+ Hz, would leave ([\d.e+]+) nm", lines)[1]
        )
        for name in ("a skyhook of 0.6", "a feedforward of 20 dB", "both")
    }
    assert "assumed: 1e-05 m/s^2/sqrt(Hz) at the frame sensor" in lines
    file.write_text(file.read_text() + SENSORS)
    assert "assumed" not in "\n".join(findings(str(file), out=str(tmp_path / "given")))
    change(file, ("skyhook_damping = 0.0", "skyhook_damping = 0.6"))
    assert rms(findings(str(file), out=str(tmp_path / "2"))) == said["a skyhook of 0.6"]
    change(file, ("feedforward_db = 0.0", "feedforward_db = 20.0"))
    bought = findings(str(file), out=str(tmp_path / "3"))
    assert rms(bought) == said["both"]
    assert "not present" not in "\n".join(bought)
    change(file, ("skyhook_damping = 0.6", "skyhook_damping = 0.0"))
    assert rms(findings(str(file), out=str(tmp_path / "4"))) == said["a feedforward of 20 dB"]


def test_a_density_that_states_another_unit_than_the_one_given_is_refused(tmp_path):
    file = tmp_path / "noise.npz"
    np.savez(file, **{"frequency": np.array([1.0, 10.0]), "x (mN/sqrt(Hz))": np.ones(2)})
    with pytest.raises(InputError, match=r"mN/sqrt\(Hz\)"):
        measured_at("noise", file, "N/sqrt(Hz)", "stage force")


def test_one_file_serves_both_commands_each_its_own_tables(tmp_path):
    """Each refuses what it does not know in its own tables and at the top, and leaves those of the other alone."""
    new_machine(str(tmp_path / "m.toml"), "small-isolator")
    text = (tmp_path / "m.toml").read_text()

    def both(old, fresh):
        assert old in text
        file = tmp_path / "changed.toml"
        file.write_text(text.replace(old, fresh, 1))
        said = []
        for read in (lambda: open_machine(str(file)).machine, lambda: read_isolator(str(file), 1000.0)):
            try:
                read()
                said.append("")
            except InputError as error:
                said.append(str(error))
        return said

    assert both("[noise]", "[noise]") == ["", ""]
    own, other = both("suspension_hz", "suspension_hertz")
    assert "'suspension_hertz'; did you mean 'suspension_hz'" in own
    assert "'suspension_hz' is missing; did you mean 'suspension_hertz'" in other  # it reads this line, too
    own, other = both("skyhook_damping", "skyhook_dampin")
    assert "'skyhook_dampin'; did you mean 'skyhook_damping'" in own and not other
    other, own = both("actuator_pole_hz", "actuator_pol_hz")
    assert "'actuator_pol_hz'; did you mean 'actuator_pole_hz'" in own and not other
    for one, wrong in (
        ("\n[isolator]", "\n[isolater]"),
        ("[controller]", "[controler]"),
        ("band_hz", "bands_hz"),
    ):
        named = re.sub(r"[\n\[\]]", "", wrong)
        assert all(f"unknown name {named!r}" in each for each in both(one, wrong))
    taken, isolator = (
        open_machine(str(tmp_path / "m.toml")).machine,
        read_isolator(str(tmp_path / "m.toml"), 1e3)[0],
    )
    assert taken.frame_mass + taken.stage_mass == pytest.approx(isolator.mass.item())
    assert taken.suspension[:2] == pytest.approx([isolator.stiffness.item(), isolator.damping.item()])


@pytest.mark.parametrize(
    ("command", "table"),
    [
        ("budget", "machine"),
        ("budget", "controller"),
        ("budget", "sources"),
        ("isolate", "isolator"),
        ("design", "decoupling"),
    ],
)
def test_a_file_without_the_table_that_a_command_needs_is_refused_with_its_cure(
    command, table, tmp_path, capsys
):
    new_machine(str(tmp_path / "m.toml"))
    kept = re.sub(
        rf"^\[{table}\b.*?(?=^\[(?!{table}\b)|\Z)", "", (tmp_path / "m.toml").read_text(), flags=re.M | re.S
    )
    (tmp_path / "m.toml").write_text(kept)
    more = {
        "budget": [],
        "isolate": ["f.csv", "--rate", "1e3", "--out", "o"],
        "design": ["--rate", "1e3", "--out", "o"],
    }
    assert main([command, str(tmp_path / "m.toml"), *more[command]]) == 2
    said = capsys.readouterr().err
    assert f"m.toml: no table [{table}], which {command} reads" in said and "stillwork new FILE.toml" in said


def test_inspect_lists_each_command_that_a_machines_file_has_the_tables_of(tmp_path):
    seen = np.ones((2, 2, 40), dtype=complex)
    np.savez(
        tmp_path / "h.npz",
        **{
            "frequency (Hz)": np.arange(1.0, 41.0),
            **{f"h{o}{i} (m/s^2/N)": seen[o - 1, i - 1] for o in (1, 2) for i in (1, 2)},
        },
    )
    new_machine(str(tmp_path / "m.toml"), "small-isolator")
    text = (tmp_path / "m.toml").read_text()
    (tmp_path / "m.toml").write_text(text + '[decoupling]\nresponse = "h.npz"\n')
    said = inspect_file(str(tmp_path / "m.toml"))
    assert all(f"stillwork {each} {tmp_path / 'm.toml'}" in said for each in ("budget", "isolate", "design"))
    assert "modes at 20.13 Hz" in said and "of 2 outputs and 2 inputs" in said
    (tmp_path / "m.toml").write_text(text.replace("suspension_hz", "suspension_hertz"))
    assert "not usable for an error budget: m.toml: machine: unknown name 'suspension_hertz'" in inspect_file(
        str(tmp_path / "m.toml")
    )


def test_two_machines_in_one_file_are_refused(tmp_path):
    """The mechanics stand once: where [isolator] states them too, both tables must mean the same machine."""
    new_machine(str(tmp_path / "m.toml"), "small-isolator")
    text = (tmp_path / "m.toml").read_text()
    alike = "[isolator]\nmass = 5.0\ndamping = 60.0\nstiffness = 8e4\n"
    (tmp_path / "m.toml").write_text(text.replace("[isolator]", alike))
    assert open_machine(str(tmp_path / "m.toml")).machine.frame_mass == 4.0
    for old, fresh, name in (
        ("8e4", "9e4", "stiffness"),
        ("= 5.0", "= 4.0", "mass"),
        ("60.0", "30.0", "damping"),
    ):
        (tmp_path / "m.toml").write_text(text.replace("[isolator]", alike.replace(old, fresh)))
        for read in (open_machine, lambda file: read_isolator(file, 1e3)):
            with pytest.raises(InputError, match=rf"{name} is .* in \[isolator\], but .* by \[machine\]"):
                read(str(tmp_path / "m.toml"))


def test_the_shipped_machine_is_read_by_the_commands_and_is_that_of_the_notebooks():
    file = str(paths.data("budget", "machine.toml"))
    taken, isolator = open_machine(file).machine, read_isolator(file, 5e3)[0]
    assert np.ravel([isolator.mass, isolator.stiffness, isolator.damping]) == pytest.approx(
        [taken.frame_mass + taken.stage_mass, *taken.suspension[:2]]
    )
    theirs = notebooks_machine(skyhook=True, feedforward=True)
    networks = taken.network(), theirs.network()
    np.testing.assert_allclose(*(each.paths(np.geomspace(1, 3e3, 50)) for each in networks), rtol=1e-6)


@pytest.mark.slow
def test_a_written_isolator_leaves_in_the_budget_what_its_c_left_on_the_record(tmp_path):
    """Of a stage that weighs nothing: the frame's motion over frequency against the C that ran through the record."""
    new_machine(str(tmp_path / "m.toml"), "small-isolator")
    change(
        tmp_path / "m.toml",
        ("stage_mass_kg = 1.0", "stage_mass_kg = 0.001"),
        ("delay_samples = 1.0", "delay_samples = 0.5"),
    )
    slab, out = paths.data("isolation", "slab_footfall/slab_vertical.csv"), tmp_path / "iso"
    isolate_file(str(tmp_path / "m.toml"), str(slab), str(out), 1000.0)
    about = json.loads((out / "isolator.json").read_text())
    (left,), ((passive,),) = about["replay"]["minutes"]["frozen"], about["replay"]["minutes"]["without"]
    found = {}
    for rate in (1000.0, 4000.0):  # of the stage's loop; the isolator's own is 1000 Hz
        change(
            tmp_path / "m.toml",
            ("rate_hz = 10000.0" if rate == 1000.0 else "rate_hz = 1000.0", f"rate_hz = {rate}"),
        )
        file = open_machine(str(tmp_path / "m.toml"), str(slab), isolate=str(out))
        own = [
            source for source in file.sources if source.places[0] in ("floor", "floor sensor", "frame sensor")
        ]
        assert len(own) == 3
        found[rate] = error_budget(file.machine.network(), own, tuple(about["judged_hz"])).rms[1]
    assert found[1000.0] == pytest.approx(left[0], rel=0.15) and left[0] < 0.02 * passive
    # At another rate Tustin's rule warps the filters otherwise.
    assert abs(found[4000.0] - left[0]) < 0.0015 * passive, (found, left, passive)
    about["isolator"]["floor"] = [[1.0, 0.0]]
    (out / "isolator.json").write_text(json.dumps(about))
    with pytest.raises(InputError, match="1 axes and 2 floor sensors; a budget is along one axis"):
        _ = open_machine(str(tmp_path / "m.toml"), isolate=str(out)).machine
