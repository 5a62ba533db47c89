"""The whole workflow without a drone: plan, fly, fit by two methods, validate on other flights, report.

The truth shown beside the estimates is that of the paper's law with a delay, so only this law is fitted.
"""

import filecmp
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rotorfit.app.workflows import MODEL_MARK, REPORT_MARK, check_destination, fit_logs, validate_logs
from rotorfit.assessment.validation import to_mapping
from rotorfit.core.errors import LogError
from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, STRUCTURE, Interval, Model
from rotorfit.core.progress import Progress
from rotorfit.core.results import CURVE, Validation
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import WHOLE, LogSpan
from rotorfit.files.logs.mcap_records import MAGIC
from rotorfit.files.models import save
from rotorfit.files.plans import PLAN_MARK, load_plan, save_plan
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.opening import open_link, simulated_at
from rotorfit.flying.mission import attached_to
from rotorfit.flying.preflight import preflight, refuse
from rotorfit.flying.recorder import record
from rotorfit.planning.belief import belief_from_card
from rotorfit.planning.plan_flight import plan_flight
from rotorfit.planning.request import space_of_room
from rotorfit.simulation.vehicle import Linear, load_vehicle

VEHICLE, AIR, ROOM = "bebop2", "gusts=0.2", "6x6x4"
"""Vehicle, air, and room [m]."""

FLIGHTS: Mapping[str, tuple[str, tuple[str, ...], float, float | None]] = {
    "train_xy": ("two_sines", ("x", "y"), 100.0, None),
    "train_z": ("two_sines", ("z",), 60.0, 3.0),
    "train_yaw": ("two_sines", ("yaw",), 60.0, None),
    "validate_xy": ("multisine", ("x", "y"), 60.0, 0.3),
    "validate_z": ("multisine", ("z",), 60.0, None),
    "validate_yaw": ("multisine", ("yaw",), 60.0, None),
}
"""Design, axes, duration [s] and amplitude; None for as large as fits, at most the full one.

To fit: the paper's two sines, x with y, z, yaw (paper, section 4); z at three times the paper's amplitude, because at
0.1 two slow sines leave its delay unknown. For the proof: signals of another kind. Seeds are 1 to 6, of plans and
flights alike.
"""

HORIZON = "1"
"""Horizon of the scores that the demo shows, a key of `AxisScore.horizons` [s]."""


@dataclass(frozen=True)
class Recovered:
    """One coefficient: what was simulated and what came back.

    Attributes:
        name: `AXIS.COEFFICIENT`, such as `x.damping`.
        truth: The value of the simulated vehicle.
        ml: The likelihood's estimate; None where it gives none.
        ci95: Its 95 % interval.
        paper: The paper's estimate; None for the delay, which the paper leaves out.
    """

    name: str
    truth: float
    ml: float | None
    ci95: Interval
    paper: float | None


@dataclass(frozen=True)
class VelocityError:
    """Error of 1 s predictions of the velocity of one axis on a validation flight that moves it [m/s or rad/s].

    Attributes:
        axis: Name of the axis.
        path: Path of the log.
        ml: Error of the likelihood's model.
        paper: Error of the paper's coefficients.
        hold: Error of holding the initial velocity.
    """

    axis: str
    path: str
    ml: float | None
    paper: float | None
    hold: float | None


@dataclass(frozen=True)
class Demo:
    """What the demo did.

    Attributes:
        truth: The coefficients that the vehicle's parameters imply for small, slow motion.
        ml: Model by the likelihood.
        paper: Model by the paper's method, from the same flights.
        validation: Validation of `ml` on the three flights that were not fitted.
        written: Files: six plans, six logs, the rest.
    """

    truth: Linear
    ml: Model
    paper: Model
    validation: Validation
    written: tuple[Path, ...]


def demo(directory: Path, progress: Progress | None = None) -> Demo:
    """Plans and flies six flights, fits both methods to three of them, validates on the others, writes everything.

    The flights are flown by the loop that flies a real vehicle, in simulated time, and the logs are read back like any
    others. Plans and logs of an earlier run of the same version are kept.

    Args:
        directory: Where plans, logs, `model.json`, `paper.json` and `report.html` go; created if it does not exist.
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        LogError: A file that the demo has not written would have to be overwritten.
    """
    from rotorfit.assessment.case import Case
    from rotorfit.assessment.evidence import evidence_of
    from rotorfit.reporting import write_report

    say = progress or (lambda _fraction, _text: None)
    directory.mkdir(parents=True, exist_ok=True)
    model, paper, report = directory / "model.json", directory / "paper.json", directory / "report.html"
    marks = {model: MODEL_MARK, paper: MODEL_MARK, report: REPORT_MARK}
    for name in FLIGHTS:
        marks |= {directory / f"{name}.toml": PLAN_MARK, directory / f"{name}.mcap": MAGIC.lower()}
    for path, mark in marks.items():
        check_destination(path, mark)
    plans, recordings = _planned_and_flown(directory, lambda fraction, text: say(0.6 * fraction, text))
    logs = {name: LogSpan(str(path), WHOLE) for name, path in recordings.items()}
    train = [log for name, log in logs.items() if name.startswith("train")]
    others = [log for name, log in logs.items() if name.startswith("validate")]
    fitted = fit_logs(train, structure=STRUCTURE, progress=lambda fraction, text: say(0.6 + 0.2 * fraction, text))
    say(0.8, "the paper's method")
    regressed = fit_logs(train, method="paper")
    validation, flights = validate_logs(
        fitted.model, others, horizons=CURVE, progress=lambda fraction, text: say(0.8 + 0.1 * fraction, text)
    )
    save(fitted.model, model)
    save(regressed.model, paper)
    say(0.9, "the report")
    write_report(evidence_of([Case(str(model), fitted.model, fitted.flights, validation, flights)]), report)
    written = (*plans.values(), *recordings.values(), model, paper, report)
    return Demo(load_vehicle(VEHICLE).linear(), fitted.model, regressed.model, validation, written)


def recovered(demo: Demo) -> tuple[Recovered, ...]:
    """Every coefficient beside its truth, axis by axis."""
    rows = []
    for k, axis in enumerate(AXES):
        truth = dict(zip(COEFFICIENTS, (*demo.truth.gamma[2 * k : 2 * k + 2], demo.truth.delay[k]), strict=True))
        ml, paper = demo.ml.axes[axis], demo.paper.axes[axis]
        rows += [
            Recovered(f"{axis}.{name}", truth[name], getattr(ml, name), ml.ci95[name], getattr(paper, name))
            for name in COEFFICIENTS
        ]
    return tuple(rows)


def scores(demo: Demo) -> tuple[VelocityError, ...]:
    """Errors of 1 s predictions, of each axis on the flight that moves it."""
    baselines = {name: demo.validation.baselines[name] for name in ("hold", "paper")}
    methods: Mapping[str, Any] = {"ml": demo.validation.flights, **baselines}
    rows = []
    for number, flight in enumerate(demo.validation.flights):
        flown = Path(flight.path).stem.removeprefix("validate_")
        for axis in ("x", "y") if flown == "xy" else (flown,):
            errors = {name: each[number].axes[axis].horizons[HORIZON].velocity_rmse for name, each in methods.items()}
            rows.append(VelocityError(axis, flight.path, **errors))
    return tuple(rows)


def demo_mapping(demo: Demo) -> dict[str, Any]:
    """The demo's results as plain JSON types."""
    return {
        "coefficients": [asdict(row) for row in recovered(demo)],
        "validation": to_mapping(demo.validation),
        "written": [str(path) for path in demo.written],
    }


def _planned_and_flown(directory: Path, say: Progress) -> tuple[dict[str, Path], dict[str, Path]]:
    """Plan files and recordings; an existing file is kept if it is the same, otherwise nothing is written at all."""
    plans = {name: directory / f"{name}.toml" for name in FLIGHTS}
    logs = {name: directory / f"{name}.mcap" for name in FLIGHTS}
    with TemporaryDirectory(dir=directory) as folder:
        fresh = {path: Path(folder, path.name) for path in (*plans.values(), *logs.values())}
        for number, name in enumerate(FLIGHTS):
            say(number / len(FLIGHTS), f"planning and flying {name}")
            save_plan(_planned(name, number + 1), fresh[plans[name]])
            _flown(load_plan(fresh[plans[name]]), number + 1, fresh[logs[name]])
        for path, new in fresh.items():
            if path.exists() and not (path.is_file() and filecmp.cmp(path, new, shallow=False)):
                raise LogError(f"{path}: exists and is not of this demo: not overwritten; choose another folder")
        for path, new in fresh.items():
            if not path.exists():
                new.rename(path)
    return plans, logs


def _planned(name: str, seed: int) -> Plan:
    """A plan for the vehicle's card, which has its limits but none of its dynamics."""
    design, axes, duration, amplitude = FLIGHTS[name]
    card = card_from_mapping(load_vehicle(VEHICLE).card(), VEHICLE)
    space, belief = space_of_room(ROOM), belief_from_card(card)
    return plan_flight(card, space, design, axes, duration, belief, amplitude=amplitude, seed=seed)


def _flown(plan: Plan, seed: int, path: Path) -> None:
    """Preflight and flight in the virtual flight room."""
    name = f"sim:{VEHICLE},{AIR}"
    card = card_from_mapping(plan.card, f"of plan {plan.name}")
    link = open_link(simulated_at(name, plan.space.start, seed), card)
    ready = preflight(plan, link)
    refuse(ready)
    fly(plan, link, record(path, attached_to(plan, ready, name)), land=False)
