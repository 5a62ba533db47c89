"""The whole product without a drone: six simulated logs, two methods, a proof on other flights, a report."""

import filecmp
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rotorfit.errors import LogError
from rotorfit.forecast import CURVE
from rotorfit.frames import AXES
from rotorfit.model import COEFFICIENTS, Interval, Model
from rotorfit.model_file import save
from rotorfit.paper_vehicle import SimulatedFlight, Truth, demo_flights, write_bag
from rotorfit.pipeline import (
    MODEL_MARK,
    REPORT_MARK,
    WHOLE,
    LogSpan,
    check_destination,
    fit_logs,
    validate_logs,
)
from rotorfit.validation import Validation, to_mapping

Progress = Callable[[float, str], None]

CARD = "rotorfit-demo"
HORIZON = "1"
"""Horizon of the scores that the demo shows, a key of `AxisScore.horizons` [s]."""


@dataclass(frozen=True)
class Recovered:
    """One coefficient: what was simulated and what came back.

    Attributes:
        name: Such as `x.damping`.
        truth: What the simulator flew.
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
class Score:
    """Error of 1 s predictions of the velocity of one axis on a validation flight that moves it [m/s or rad/s].

    Attributes:
        axis: Name.
        path: Of the log.
        ml: Of the likelihood's model.
        paper: Of the paper's coefficients.
        hold: Of keeping the velocity of the start.
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
        truth: What was simulated.
        ml: Model by the likelihood.
        paper: Model by the paper's method, from the same flights.
        validation: Of `ml` on the three flights that were not fitted.
        written: Files, the six logs first.
    """

    truth: Truth
    ml: Model
    paper: Model
    validation: Validation
    written: tuple[Path, ...]


def demo(directory: Path, progress: Progress | None = None) -> Demo:
    """Simulates six flights, fits both methods to three of them, validates on the others, writes everything.

    The logs are read back as those of a stranger are. Bags of an earlier run of the same version stay as they are.

    Args:
        directory: Where the logs, `model.json`, `paper.json` and `report.html` go; made where it is not there.
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        LogError: A file in the directory would have to be overwritten that the demo has not written.
    """
    from rotorfit.report import write_report

    say = progress or (lambda _fraction, _text: None)
    directory.mkdir(parents=True, exist_ok=True)
    model, paper, report = directory / "model.json", directory / "paper.json", directory / "report.html"
    for path, mark in ((model, MODEL_MARK), (paper, MODEL_MARK), (report, REPORT_MARK)):
        check_destination(path, mark)
    say(0.0, "simulating six flights")
    bags = _write_bags(demo_flights(), directory)
    logs = {name: LogSpan(str(path), WHOLE) for name, path in bags.items()}
    train = [log for name, log in logs.items() if name.startswith("train")]
    others = [log for name, log in logs.items() if name.startswith("validate")]
    fitted = fit_logs(train, CARD, "ml", progress=lambda fraction, text: say(0.2 + 0.5 * fraction, text))
    say(0.7, "the paper's method")
    regressed = fit_logs(train, CARD, "paper")
    validation, flights = validate_logs(
        fitted.model, others, horizons=CURVE, progress=lambda fraction, text: say(0.8 + 0.1 * fraction, text)
    )
    save(fitted.model, model)
    save(regressed.model, paper)
    say(0.9, "the report")
    write_report(fitted.model, fitted.flights, validation, flights, report)
    return Demo(Truth(), fitted.model, regressed.model, validation, (*bags.values(), model, paper, report))


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


def scores(demo: Demo) -> tuple[Score, ...]:
    """Errors of 1 s predictions, of each axis on the flight that moves it."""
    methods: Mapping[str, Any] = {"ml": demo.validation.flights, **demo.validation.baselines}
    rows = []
    for number, flight in enumerate(demo.validation.flights):
        flown = Path(flight.path).stem.removeprefix("validate_")
        for axis in ("x", "y") if flown == "xy" else (flown,):
            errors = {name: each[number].axes[axis].horizons[HORIZON].velocity_rmse for name, each in methods.items()}
            rows.append(Score(axis, flight.path, **errors))
    return tuple(rows)


def demo_mapping(demo: Demo) -> dict[str, Any]:
    """The demo's results as plain JSON types."""
    return {
        "coefficients": [asdict(row) for row in recovered(demo)],
        "validation": to_mapping(demo.validation),
        "written": [str(path) for path in demo.written],
    }


def _write_bags(flights: Mapping[str, SimulatedFlight], directory: Path) -> dict[str, Path]:
    """Writes the flights as bags; one that is there stays if it is the same, else nothing is written at all."""
    paths = {name: directory / f"{name}.bag" for name in flights}
    with TemporaryDirectory(dir=directory) as folder:
        fresh = {name: Path(folder, path.name) for name, path in paths.items()}
        for name, flight in flights.items():
            write_bag(flight, fresh[name])
        for name, path in paths.items():
            if path.exists() and not (path.is_file() and filecmp.cmp(path, fresh[name], shallow=False)):
                raise LogError(f"{path}: exists and is not this demo's log: not overwritten; choose another folder")
        for name, path in paths.items():
            if not path.exists():
                fresh[name].rename(path)
    return paths
