"""The published designs of chapter 3: which observer and which application give which bandwidth."""

from dataclasses import dataclass, replace
from functools import lru_cache

from experiments.motion.machines import published_noise, stage, stage_mass
from stillwork.base.checks import InputError, require_choice
from stillwork.control.applications import Application, compensator
from stillwork.control.bandwidth import SIX_DB, Bandwidth, Loop, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.pid import Pid, PidFamily
from stillwork.estimation.observer import NoiseIntensities, Observer, kalman_observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel

RETAINED = 4  # rigid body and three flexible modes
COMPENSATED = 3  # flexible modes 4 to 6; the eighth mode is unknown to the observer
NOISE_MODEL = 0.03  # Q_nu of section 3.2.2


@dataclass(frozen=True)
class Design:
    """One row of the bandwidth table."""

    application: Application | None = None  # None: no observer
    noise_model: float | None = None  # Q_nu
    constraints: tuple[str, ...] = ("input_sensitivity", "output_sensitivity")
    notches: bool = False  # in the controller, at the first three flexible modes


DAMPING = 0.035  # increase of the damping ratio: from 0.005 to the published 0.04

DESIGNS = {
    "PID": Design(constraints=("input_sensitivity",)),
    "PID with notches": Design(constraints=("input_sensitivity",), notches=True),
    "MC, two constraints": Design(Application(compensate=True), NOISE_MODEL),
    "MC": Design(Application(compensate=True), NOISE_MODEL, (*Design.constraints, "true_tracking")),
    "AD, no band-pass": Design(Application(damping=DAMPING)),
    "AD": Design(Application(damping=DAMPING, selectivity=2.0)),
    "MC and AD, no band-pass": Design(Application(compensate=True, damping=DAMPING), NOISE_MODEL),
    "MC and AD": Design(Application(compensate=True, damping=DAMPING, selectivity=2.0), 1e3),
}

PRINTED_HZ = {  # Table 3.5 and the text of chapter 3; of "MC, two constraints" the text prints 73, too
    "PID": 37.0,
    "PID with notches": 43.0,
    "MC": 46.0,
    "MC and AD, no band-pass": 59.0,
    "AD, no band-pass": 65.0,
    "MC, two constraints": 72.0,
    "AD": 77.0,
    "MC and AD": 83.0,
}


def stage_observer(
    position: int,
    noise: NoiseIntensities | None = None,
    noise_model: float | None = None,
    plant: ModalModel | None = None,
) -> Observer:
    """Observer of the stage for the measured mass `position` (1 to 7), reduced as in section 3.1."""
    if plant is None:
        return _published_observer(position, noise, noise_model)
    return kalman_observer(_reduced(plant, position), noise or published_noise(), noise_model)


def _reduced(plant: ModalModel, position: int) -> ModalModel:
    return truncate(plant.at([0], [position - 1]), RETAINED, COMPENSATED)


@lru_cache(maxsize=8)  # a mass each: an explorer varies the noise alone
def _published_model(position: int) -> ModalModel:
    return _reduced(stage(), position)


@lru_cache(maxsize=128)  # studies vary what is done with the estimates, or the loops, far more often
def _published_observer(position: int, noise: NoiseIntensities | None, noise_model: float | None) -> Observer:
    return kalman_observer(_published_model(position), noise or published_noise(), noise_model)


def stage_compensator(
    position: int, design: Design, noise: NoiseIntensities | None = None, plant: ModalModel | None = None
) -> StateModel | None:
    """Compensator of a design for one measured mass; None without observer."""
    if design.application is None:
        return None
    return compensator(stage_observer(position, noise, design.noise_model, plant), design.application)


def stage_loops(
    design: Design, noise: NoiseIntensities | None = None, plant: ModalModel | None = None, **grid
) -> list[Loop]:
    """The seven loops of the stage under one design; `grid` goes to `make_loop`."""
    machine = stage() if plant is None else plant
    noise = noise or published_noise()  # read once for all masses
    return [
        make_loop(machine.at([0], [k - 1]), stage_compensator(k, design, noise, plant), **grid)
        for k in range(1, len(machine.output_shapes) + 1)
    ]


def stage_bandwidth(
    name: str | Design,
    noise: NoiseIntensities | None = None,
    damping_ratio: float | None = None,
    limit: float = SIX_DB,
    refine: bool = True,
    **grid,
) -> Bandwidth:
    """Achievable bandwidth of a published design (a name in `DESIGNS`) or of one's own."""
    design = DESIGNS[name] if isinstance(name, str) else name
    plant = None if damping_ratio is None else stage(damping_ratio)
    return maximise_bandwidth(
        stage_loops(design, noise, plant, **grid),
        controllers(design),
        [PeakConstraint(function, limit) for function in design.constraints],
        refine=refine,
    )


def design_controller(name: str, redesign: str = "own limit") -> Pid:
    """Controller of a design at the largest f_bw that it allows, its ``own limit``, or at the ``printed`` bandwidth."""
    require_choice("redesign", redesign, ("own limit", "printed"))
    if redesign == "own limit":
        return stage_bandwidth(name).controller
    return controllers(DESIGNS[name])(PRINTED_HZ[name])


def controllers(design: Design) -> PidFamily:
    """The controllers (3.1) of a design, by f_bw; with its notches, at the retained modes."""
    return PidFamily(stage_mass(), tuple(stage().frequencies[1:RETAINED]) if design.notches else ())


def quick_limit(setting: Design) -> tuple[list[Loop], Bandwidth] | None:
    """The seven loops of a design and its largest bandwidth, searched quicker on a coarser grid; None: there is none."""
    loops = stage_loops(setting, points=300, around=15)
    limits, family = [PeakConstraint(function) for function in setting.constraints], PidFamily(stage_mass())
    try:
        return loops, maximise_bandwidth(loops, family, limits, 20.0, 110.0, scan=46, tolerance_hz=0.02)
    except InputError:  # no feasible bandwidth is a result here
        return None


COMPENSATIONS = {  # what keeps the integral action of MC: Q_nu, and the corner of a high-pass (Hz)
    "noise model": (NOISE_MODEL, None),
    "high-pass": (None, 1.0),
    "nothing": (None, None),
}
TARGET = 0.04  # desired damping ratio, section 3.3.2
SIX = {"6 dB": SIX_DB, "2": 2.0}


@lru_cache(maxsize=128)  # combinations that differ in the loop or the mass share the search
def limit(name: str, six: str, compensation: str, stage_damping: float) -> tuple[list[Loop], Bandwidth]:
    """The seven loops of a design and the largest bandwidth that they allow."""
    design = as_read(DESIGNS[name], compensation, stage_damping)
    found = stage_bandwidth(design, damping_ratio=stage_damping, limit=SIX[six])
    return stage_loops(design, plant=stage(stage_damping)), found


def as_read(design: Design, compensation: str, stage_damping: float) -> Design:
    """A design with another way of keeping the integral action, and damped up to the desired ratio."""
    used, noise_model = design.application, design.noise_model
    if used is not None and used.damping:  # up to the desired ratio, from that of the stage
        used = replace(used, damping=TARGET - stage_damping)
    if noise_model == NOISE_MODEL:  # printed for MC with the noise model, which is one way of two
        noise_model, high_pass_hz = COMPENSATIONS[compensation]
        used = replace(used, high_pass_hz=high_pass_hz)
    return replace(design, application=used, noise_model=noise_model)
