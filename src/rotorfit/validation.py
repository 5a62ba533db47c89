"""Model + other flights -> Validation: prediction errors beside naive baselines, and what the residuals say."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rotorfit.disturbance import LEVELS
from rotorfit.errors import FlightError
from rotorfit.flight import Flight
from rotorfit.forecast import (
    HORIZONS,
    AxisScore,
    Dynamics,
    Horizon,
    coast_prediction,
    hold_velocity,
    predict_flight,
    score_predictions,
)
from rotorfit.frames import AXES, Array, heading_from_world
from rotorfit.likelihood import Point, response
from rotorfit.maximum import maximise
from rotorfit.model import Model, Predictor
from rotorfit.modes import start_point
from rotorfit.record import record
from rotorfit.structure import FIRST_ORDER_DELAY, Structure, structure_named

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class FlightScores:
    """Prediction errors on one flight.

    Attributes:
        path: Of its log.
        span: Seconds of its common window.
        axes: Axis name to errors; None in place of every number of an axis that has no model.
        heading: `predicted` by the model's own yaw, or `measured` where it has none.
        fitted: Whether the model was fitted to part of this very stretch: then the scores prove nothing.
    """

    path: str
    span: tuple[float, float]
    axes: Mapping[str, AxisScore]
    heading: str
    fitted: bool = False


@dataclass(frozen=True)
class Validation:
    """Prediction errors of a model and of the naive baselines on the same flights.

    Attributes:
        flights: Of the model, one each.
        baselines: `hold` (the world velocity of the start is kept) and `paper` (the paper's coefficients on the model's
            training flights, from the same filtered states), each one each flight.
    """

    flights: tuple[FlightScores, ...]
    baselines: Mapping[str, tuple[FlightScores, ...]]


def dynamics_from_model(model: Model) -> dict[str, Dynamics]:
    """What prediction needs of the axes of a model; those without a predictor but with known noise are tracked only."""
    out = {}
    for name, axis in model.axes.items():
        if not axis.noise or (name == "yaw" and axis.predictor is None):
            continue
        point = axis.predictor
        out[name] = Dynamics(
            input=point.input if point else 0.0,
            damping=point.damping if point else 1.0,
            delay=point.delay if point else 0.0,
            levels=tuple(axis.noise[level] for level in LEVELS),  # type: ignore[arg-type]
            trim_variance=axis.noise["trim_variance"],
            structure=structure_named(axis.structure) if point else FIRST_ORDER_DELAY,
            extra=point.extra if point else {},
        )
    return out


def validate(
    model: Model, flights: Sequence[Flight], horizons: Sequence[float] = HORIZONS, progress: Progress | None = None
) -> Validation:
    """Scores a model on flights, by the one prediction protocol.

    Args:
        model: The model.
        flights: Flights that it was not fitted to, for a proof; others for comparison.
        horizons: [s].
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        FlightError: If no flight is given or a horizon is not positive.
    """
    if not flights:
        raise FlightError("no flight to validate on: give at least one log")
    if not horizons or min(horizons) <= 0:
        raise FlightError(f"horizons must be positive seconds, not {', '.join(f'{h:g}' for h in horizons)}")
    scores: dict[str, list[FlightScores]] = {"model": [], "hold": [], "paper": []}
    for number, flight in enumerate(flights):
        if progress:
            progress(number / len(flights), flight.path)
        for name, result in _score_flight(model, flight, horizons).items():
            scores[name].append(result)
    return Validation(tuple(scores["model"]), {name: tuple(scores[name]) for name in ("hold", "paper")})


def _score_flight(model: Model, flight: Flight, horizons: Sequence[float]) -> dict[str, FlightScores]:
    """Scores of the model and of both baselines on one flight."""
    dynamics = dynamics_from_model(model)
    parts = predict_flight(flight, dynamics, max(horizons))
    paper_input = np.array([g if (g := model.paper[2 * k]) is not None else np.nan for k in range(4)])
    paper_damping = np.array([b if (b := model.paper[2 * k + 1]) is not None else np.nan for k in range(4)])
    coasted = [
        coast_prediction(flight, part, np.nan_to_num(paper_input), np.nan_to_num(paper_damping)) for part in parts
    ]
    known = {axis: model.axes[axis].predictor is not None for axis in AXES}
    papered = {axis: bool(np.isfinite(paper_input[k])) for k, axis in enumerate(AXES)}
    heading = "predicted" if known["yaw"] else "measured"

    def scored(predicted: Sequence[Array], wanted: Mapping[str, bool]) -> FlightScores:
        axes = score_predictions(parts, predicted, horizons)
        empty = AxisScore({f"{h:g}": Horizon(None, None, 0) for h in horizons}, None)
        scores = {a: axes[a] if wanted[a] else empty for a in AXES}
        return FlightScores(flight.path, flight.span, scores, heading, _was_fitted(model, flight))

    return {
        "model": scored([part.predicted for part in parts], known),
        "hold": scored([hold_velocity(part) for part in parts], dict.fromkeys(AXES, True)),
        "paper": scored(coasted, papered),
    }


def _was_fitted(model: Model, flight: Flight) -> bool:
    """Whether the same log, over a stretch that overlaps, served the fit."""
    return any(
        source.sha256 == flight.sha256 and min(source.span[1], flight.span[1]) > max(source.span[0], flight.span[0])
        for source in model.flights
    )


def to_mapping(validation: Validation) -> dict[str, Any]:
    """The validation as plain JSON types."""
    return {
        "flights": [asdict(flight) for flight in validation.flights],
        "baselines": {
            name: {"flights": [asdict(flight) for flight in flights]} for name, flights in validation.baselines.items()
        },
    }


@dataclass(frozen=True)
class Residuals:
    """One-step innovations of an axis on one flight, standardised: white and of unit variance where the model is right.

    Attributes:
        axis: Name.
        time: Block times, shape (B,) [s].
        innovation: Shape (B,).
        response: Position as the commands explain it, less its start, in the frame of the axis, shape (B,) [m or rad].
    """

    axis: str
    time: Array
    innovation: Array
    response: Array


def residuals(model: Model, flight: Flight) -> dict[str, Residuals]:
    """Innovations of every axis with a predictor, with the flight's own trim and start."""
    known = [axis for axis in AXES if model.axes[axis].predictor]
    plane = ("x", "y")
    rec = record(flight, plane) if any(axis in known for axis in plane) else None
    together = rec is not None and not rec.held and all(model.axes[axis].noise for axis in plane)
    groups = [plane, *((axis,) for axis in known if axis not in plane)] if together else [(axis,) for axis in known]
    out: dict[str, Residuals] = {}
    for group in groups:
        out |= _group_residuals(model, flight, group)
    return out


def _group_residuals(model: Model, flight: Flight, group: tuple[str, ...]) -> dict[str, Residuals]:
    """Of one axis, or of x and y where the vehicle turns."""
    rec = record(flight, group)
    if rec is None:
        return {}
    points = [model.axes[axis].predictor or Predictor(0.0, 1.0, 0.0) for axis in group]
    levels = np.log([[model.axes[axis].noise[level] for level in LEVELS] for axis in group])
    start = replace(
        start_point([rec], 0.0, 1.0, levels),
        gain=np.array([point.input for point in points]),
        log_damping=np.log([max(point.damping, 1e-3) for point in points]),
        delay=np.array([point.delay for point in points]),
    )
    start = _with_structures(start, [structure_named(model.axes[axis].structure) for axis in group], points)
    free = np.zeros(start.flat().size, bool)
    free[start.coefficients : start.n] = True
    best = maximise([rec], start, free)
    explained = response(rec, best.point, 0, best.point.start)[0]
    if len(group) == 2:
        explained = heading_from_world(explained, rec.block_yaw)
    return {
        axis: Residuals(axis, rec.block_time, best.score.innovations[0][:, k], explained[:, k])
        for k, axis in enumerate(group)
        if model.axes[axis].predictor
    }


def _with_structures(point: Point, structures: Sequence[Structure], known: Sequence[Predictor]) -> Point:
    """The point under the structures of a model, with their further parameters; axes without numbers have none."""
    laws = tuple(
        s if set(p.extra) == {e.name for e in s.extras} else FIRST_ORDER_DELAY
        for s, p in zip(structures, known, strict=True)
    )
    extra = np.zeros((max(len(law.extras) for law in laws), len(laws)))
    for k, (law, one) in enumerate(zip(laws, known, strict=True)):
        extra[: len(law.extras), k] = [e.coordinate(one.extra[e.name]) for e in law.extras]
    return replace(point, structures=laws, extra=extra)
