"""Model + other flights -> Validation: prediction errors beside naive baselines, and tests of the residuals."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from rotorfit.assessment.frequency.comparison import findings_of_responses, response_mapping, response_test
from rotorfit.assessment.mismatch import findings_of_mismatch
from rotorfit.assessment.paired import paired_test
from rotorfit.assessment.whiteness import REACH, findings_of_residuals, residual_tests
from rotorfit.core import parallel
from rotorfit.core.error_bands import BandScore
from rotorfit.core.errors import FlightError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
from rotorfit.core.laws import FIRST_ORDER_DELAY, LEVELS_OF, Structure, structure_named
from rotorfit.core.model import COEFFICIENTS, Model, Predictor, predictor_of
from rotorfit.core.progress import Progress
from rotorfit.core.residuals import Innovations, ResidualTests
from rotorfit.core.results import HORIZONS, AxisScore, FlightScores, Horizon, StartErrors, Validation
from rotorfit.dynamics.error_bands import Stated, band_scores, stated
from rotorfit.dynamics.protocol import (
    AxisDynamics,
    Errors,
    free_run_prediction,
    hold_velocity,
    joined,
    judged,
    predictions,
    scores_of,
)
from rotorfit.estimation.grouping import without_held_axes
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import whiten
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.flights.distinct import check_distinct, check_flights

BASELINES = ("hold", "paper", "coast")
"""See `Validation`. Either of the last two can be the better use of the paper's coefficients."""


def dynamics_from_model(model: Model, flight: Flight | None = None) -> dict[str, AxisDynamics]:
    """Dynamics that predictions need, for the axes of a model; axes with noise but no predictor are only tracked.

    Args:
        model: The model.
        flight: The flight to predict; None for one with a position of every axis.

    Raises:
        FlightError: An axis has a position where the model knows only the noise of a velocity, or the other way round.
    """
    out, alone = {}, flight.velocity_only if flight else ()
    for name, axis in model.axes.items():
        if not axis.noise or (name == "yaw" and axis.predictor is None):
            continue
        point = axis.predictor
        levels = LEVELS_OF["velocity" if name in alone else "position"]
        if not set(levels) <= set(axis.noise):
            here, there = ("velocity", "position") if name in alone else ("position", "velocity")
            raise FlightError(
                f"{flight.path if flight else 'the flight'}: {name} is measured by its {here}, and the model knows the "
                f"noise of its {there} only: use the card that it was fitted with, or fit again"
            )
        out[name] = AxisDynamics(
            input=point.input if point else 0.0,
            damping=point.damping if point else 1.0,
            delay=point.delay if point else 0.0,
            levels=tuple(axis.noise[level] for level in levels),  # type: ignore[arg-type]
            trim_variance=axis.noise["trim_variance"],
            structure=structure_named(axis.structure) if point else FIRST_ORDER_DELAY,
            extra=point.extra if point else {},
        )
    return out


def validate(
    model: Model, flights: Sequence[Flight], horizons: Sequence[float] = HORIZONS, progress: Progress | None = None
) -> Validation:
    """Scores a model on flights by the one prediction protocol.

    Args:
        model: The model.
        flights: Flights to which it was not fitted, for a validation; others for comparison.
        horizons: Prediction horizons [s].
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        TypeError: `flights` holds something else than flights.
        FlightError: No flight is given, one is given twice, a horizon is not positive, or as for `dynamics_from_model`.
    """
    check_flights(flights)
    if not flights:
        raise FlightError("no flight to validate on: give at least one log")
    if not horizons or min(horizons) <= 0:
        raise FlightError(f"horizons must be positive seconds, not {', '.join(f'{h:g}' for h in horizons)}")
    check_distinct(flights)
    flights = without_held_axes(flights)
    scores: dict[str, list[FlightScores]] = {name: [] for name in ("model", *BASELINES)}
    errors: dict[str, list[Mapping[str, StartErrors]]] = {name: [] for name in scores}
    tests, bands = [], []
    for number, flight in enumerate(flights):

        def report(share: float, number: int = number, path: str = flight.path) -> None:
            if progress:
                progress((number + share) / len(flights), path)

        scored, held = _score_flight(model, flight, horizons, report)
        for name, (score, by_horizon) in scored.items():
            scores[name].append(score)
            errors[name].append(by_horizon)
        bands.append({axis: held[axis] for axis in AXES if model.axes[axis].predictor})
        tests.append(residual_tests_of_flight(model, flight))
    responses = response_test(model, flights)
    misread = [tuple(findings_of_mismatch(model, flight)) for flight in flights]
    touched = [_touched(each) for each in misread]  # of these axes a flight says nothing about the model
    counted = tuple(() if each.fitted else each.moved for each in scores["model"])
    found = [
        finding
        for flight, axes, wrong in zip(flights, tests, touched, strict=True)
        for axis, each in axes.items()
        if not wrong & {axis, None}
        for finding in findings_of_residuals(axis, each, flight.path)
    ]
    found += findings_of_responses(
        [
            {axis: each for axis, each in axes.items() if not wrong & {axis, None}}
            for axes, wrong in zip(responses, touched, strict=True)
        ]
    )
    found = [*(one for each in misread for one in each), *sorted(found, key=lambda finding: finding.severity == "info")]
    return Validation(
        flights=tuple(scores["model"]),
        baselines={name: tuple(scores[name]) for name in BASELINES},
        errors={name: tuple(each) for name, each in errors.items()},
        paired=tuple(paired_test(("model", name), errors["model"], errors[name], counted) for name in BASELINES),
        residuals=tuple(tests),
        findings=tuple(found),
        responses=responses,
        bands=tuple(bands),
    )


def _touched(misread: Sequence[Finding]) -> set[str | None]:
    """The axes that findings spoil, or None for all: x and y share a filter."""
    axes = {finding.axis for finding in misread}
    return axes | {"x", "y"} if axes & {"x", "y"} else axes


def paper_dynamics(model: Model, flight: Flight | None = None) -> dict[str, AxisDynamics]:
    """Dynamics that predictions with the paper's coefficients need: the law without delay, with a filter of its own.

    They are those of a model by method `paper` of the same flights. Axes without coefficients from the regression are
    only tracked, and yaw is taken as measured.

    Args:
        model: The model.
        flight: As for `dynamics_from_model`.
    """
    axes = {}
    for k, (name, axis) in enumerate(model.axes.items()):
        g, b = model.paper[2 * k : 2 * k + 2]
        point = None if g is None or b is None else Predictor(g, b, 0.0)
        noise = model.paper_noise.get(name, axis.noise)
        axes[name] = replace(axis, predictor=point, noise=noise, structure=FIRST_ORDER_DELAY.name)
    return dynamics_from_model(replace(model, axes=axes), flight)


def _score_flight(
    model: Model, flight: Flight, horizons: Sequence[float], report: Callable[[float], None]
) -> tuple[dict[str, tuple[FlightScores, dict[str, StartErrors]]], dict[str, dict[str, BandScore]]]:
    """Scores of the model's predictions and of all baselines on one flight, with the errors behind them; the bands.

    The predictions of half an hour take hundreds of megabytes: they are scored and dropped piece by piece.

    Args:
        model: The model.
        flight: The flight.
        horizons: Prediction horizons [s].
        report: Called with the completed share.
    """
    coefficients = np.array([np.nan if g is None else g for g in model.paper])
    coasting = np.nan_to_num(coefficients.reshape(4, 2).T)
    errors: dict[str, list[Errors]] = {name: [] for name in ("model", *BASELINES)}
    bands: dict[float, list[Stated]] = {horizon: [] for horizon in horizons}
    (begin, end), longest = flight.span, max(horizons)

    def of_regression(dynamics: Mapping[str, AxisDynamics]) -> list[Errors]:
        return [judged(part, part.predicted, horizons) for part in predictions(flight, dynamics, longest)]

    report(0.0)
    paper = paper_dynamics(model, flight)
    regressed = parallel.each(of_regression, [paper], flight.duration)
    for part in predictions(flight, dynamics_from_model(model, flight), longest):
        errors["model"].append(judged(part, part.predicted, horizons))
        errors["hold"].append(judged(part, hold_velocity(part), horizons))
        errors["coast"].append(judged(part, free_run_prediction(flight, part, *coasting), horizons))
        for horizon, each in bands.items():
            each.append(stated(part, horizon))
        report(0.5 * (part.start[-1] - begin) / (end - begin))
    errors["paper"] = next(regressed)
    report(0.8)

    known = np.array([model.axes[axis].predictor is not None for axis in AXES])
    wanted = dict.fromkeys(errors, np.isfinite(coefficients[::2])) | {"model": known, "hold": np.ones(4, bool)}
    turning = dict.fromkeys(errors, bool(known[AXES.index("yaw")])) | {"paper": "yaw" in paper}
    empty = AxisScore({f"{h:g}": Horizon(None, None, 0) for h in horizons}, None)
    out = {}
    for name, pieces in errors.items():
        every = joined(pieces, horizons)
        axes = {a: score if wanted[name][k] else empty for k, (a, score) in enumerate(scores_of(every).items())}
        heading: Literal["predicted", "measured"] = "predicted" if turning[name] else "measured"
        scores = FlightScores(flight.path, flight.span, axes, heading, _was_fitted(model, flight), flight.moved)
        out[name] = scores, {f"{h:g}": _known_errors(each, wanted[name]) for h, each in every.starts.items()}
    return out, band_scores(bands)


def horizon_scores(model: Model, flight: Flight, horizon: float) -> tuple[Mapping[str, Horizon], Mapping[str, Horizon]]:
    """Errors at one horizon [s] of the model and of holding the velocity; the same numbers as from `validate`."""
    judge, own, held = (horizon,), [], []
    for part in predictions(flight, dynamics_from_model(model, flight), horizon):
        own.append(judged(part, part.predicted, judge))
        held.append(judged(part, hold_velocity(part), judge))
    errors, hold = (
        {axis: score.horizons[f"{horizon:g}"] for axis, score in scores_of(joined(each, judge)).items()}
        for each in (own, held)
    )
    nothing = Horizon(None, None, 0)
    return {axis: one if model.axes[axis].predictor else nothing for axis, one in errors.items()}, hold


def _known_errors(errors: StartErrors, wanted: Array) -> StartErrors:
    """Replaces the errors of axes without a model by NaN."""
    velocity, position = (np.where(wanted, values, np.nan) for values in (errors.velocity, errors.position))
    return replace(errors, velocity=velocity, position=position)


def residual_tests_of_flight(model: Model, flight: Flight) -> dict[str, ResidualTests]:
    """Tests of the innovations of the axes that a flight commands and the model knows."""
    every = parallel.each(lambda rec: _tests_of_record(model, flight, rec), _records(model, flight), flight.duration)
    return {axis: tests for some in every for axis, tests in some.items()}


def _tests_of_record(model: Model, flight: Flight, rec: Record) -> dict[str, ResidualTests]:
    """`residual_tests_of_flight` for the axes of one record."""
    found: dict[str, ResidualTests] = {}
    fitted = _was_fitted(model, flight)
    own, at_fitted = _explained(model, rec, own_levels=True), _explained(model, rec, own_levels=False)
    for axis, each in _residuals_of(model, flight, rec, own).items():
        if axis not in flight.moved:
            continue
        covariance = parameter_covariance(model, axis) * (not fitted)
        training = sum(s.span[1] - s.span[0] for s in model.flights if axis in s.axes)
        share = flight.duration / training if training > 0 and not fitted else 0.0
        innovation = at_fitted.score.innovations[0][:, rec.axes.index(axis)]
        tests = residual_tests(each.innovations, innovation, covariance, share)
        found |= {axis: tests} if tests else {}
    return found


def parameter_covariance(model: Model, axis: str) -> Array:
    """Covariance of input, log damping, delay and the n further parameters of an axis, in the estimator's coordinates.

    Shape (3 + n, 3 + n); zero where the model has none.
    """
    point = predictor_of(model, axis)
    extras = _law(model.axes[axis].structure, point).extras
    names, known = (*COEFFICIENTS, *(extra.name for extra in extras)), list(model.covariance_names)
    further = [1 / point.extra[extra.name] if extra.logarithmic else 1.0 for extra in extras]
    scale = np.array([1.0, 1 / max(point.damping, 1e-3), 1.0, *further])
    out = np.zeros((len(names), len(names)))
    told = [(i, known.index(name)) for i, each in enumerate(names) if (name := f"{axis}.{each}") in known]
    for i, at in told:
        for j, beside in told:
            out[i, j] = model.covariance[at, beside]
    return out * np.outer(scale, scale)


def _was_fitted(model: Model, flight: Flight) -> bool:
    """Whether an overlapping stretch of the same log was used in the fit."""
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
        "paired": [asdict(test) for test in validation.paired],
        "residuals": [
            {"path": flight.path, "axes": {axis: asdict(tests) for axis, tests in axes.items()}}
            for flight, axes in zip(validation.flights, validation.residuals, strict=True)
        ],
        "frequency_response": [
            {"path": flight.path, "axes": {axis: response_mapping(each) for axis, each in axes.items()}}
            for flight, axes in zip(validation.flights, validation.responses, strict=False)
        ],
        "bands": [
            {
                "path": flight.path,
                "axes": {
                    axis: {key: asdict(score) for key, score in horizons.items()} for axis, horizons in axes.items()
                },
            }
            for flight, axes in zip(validation.flights, validation.bands, strict=False)
        ],
        "findings": [asdict(finding) for finding in validation.findings],
    }


@dataclass(frozen=True)
class Residuals:
    """One-step innovations of an axis on one flight, standardised: white and of unit variance if the model is right.

    Attributes:
        axis: Name of the axis.
        time: Block times, shape (B,) [s].
        innovation: Shape (B,).
        response: Position as the commands explain it, relative to its start, in the frame of the axis, shape (B,) [m or
            rad].
        past: See `Innovations`.
        sensitivity: See `Innovations`.
    """

    axis: str
    time: Array
    innovation: Array
    response: Array
    past: Array
    sensitivity: Array

    @property
    def innovations(self) -> Innovations:
        """The part that the tests need."""
        return Innovations(self.time, self.innovation, self.past, self.sensitivity)


def residuals(model: Model, flight: Flight, own_levels: bool = False) -> dict[str, Residuals]:
    """Innovations of every axis with a predictor, with the flight's own trim and start.

    Axes whose measured quantity has no noise in the model are left out.

    Args:
        model: The model.
        flight: Any flight of the vehicle.
        own_levels: Whether to fit the disturbance levels to this flight instead of taking those of the model.
    """
    out: dict[str, Residuals] = {}
    for rec in _records(model, flight):
        out |= _residuals_of(model, flight, rec, _explained(model, rec, own_levels))
    return out


def _records(model: Model, flight: Flight) -> Iterator[Record]:
    """The flight for each group of axes with a predictor: x and y together where the vehicle turns."""
    if not flight.velocity_only:  # with poses, the velocity adds nothing independent about the model
        flight = replace(flight, velocity=None)
    known = [axis for axis in AXES if model.axes[axis].predictor]
    plane = ("x", "y")
    rec = record(flight, plane) if any(axis in known for axis in plane) else None
    together = rec is not None and not rec.held and all(model.axes[axis].noise for axis in plane)
    groups = [plane, *((axis,) for axis in known if axis not in plane)] if together else [(axis,) for axis in known]
    for group in groups:
        rec = rec if together and group == plane else record(flight, group)
        if rec and all(set(LEVELS_OF[rec.measured]) <= set(model.axes[axis].noise) for axis in group):
            yield rec


def _points(model: Model, rec: Record) -> list[Predictor]:
    return [model.axes[axis].predictor or Predictor(0.0, 1.0, 0.0) for axis in rec.axes]


def _explained(model: Model, rec: Record, own_levels: bool) -> Optimum:
    """The model's coefficients with the flight's own trim and start, and with its own levels if requested."""
    points = _points(model, rec)
    levels = np.log([[model.axes[axis].noise[level] for level in LEVELS_OF[rec.measured]] for axis in rec.axes])
    start = replace(
        start_point([rec], 0.0, 1.0, levels),
        gain=np.array([point.input for point in points]),
        log_damping=np.log([max(point.damping, 1e-3) for point in points]),
        delay=np.array([point.delay for point in points]),
    )
    start = _with_structures(start, [model.axes[axis].structure for axis in rec.axes], points)
    free = np.zeros(start.flat().size, bool)
    free[start.coefficients : None if own_levels else start.n] = True
    return maximise([rec], start, free)


def _residuals_of(model: Model, flight: Flight, rec: Record, best: Optimum) -> dict[str, Residuals]:
    """Residuals of one axis, or of x and y where the vehicle turns."""
    explained, sensitivity = response(rec, best.point, 0, best.point.start)
    rows = whiten(rec, sensitivity, best.point.levels)[0]
    if len(rec.axes) == 2:
        explained = heading_from_world(explained, rec.block_yaw)
    return {
        axis: Residuals(
            axis,
            rec.block_time,
            best.score.innovations[0][:, k],
            explained[:, k],
            _past(flight, AXES.index(axis), rec.block_time),
            _sensitivity(rec, rows[:, :, k], best.point, k),
        )
        for k, axis in enumerate(rec.axes)
        if model.axes[axis].predictor
    }


def _past(flight: Flight, k: int, time: Array) -> Array:
    """The command held 1, 2, ... blocks before, up to a second back; before a segment, the segment's first."""
    step = float(np.median(np.diff(time)))
    lags = step * np.arange(1, max(1, round(REACH / step)) + 1)
    segment = np.searchsorted([part.start for part in flight.segments], time, side="right") - 1
    first = np.searchsorted(flight.command_time, [part.start for part in flight.segments])[segment]
    out = np.empty((time.size, lags.size))
    for column, lag in zip(out.T, lags, strict=True):  # one by one: together, half an hour takes 50 MB
        held = np.searchsorted(flight.command_time, time - lag, side="right") - 1
        column[:] = flight.command[np.maximum(held, first), k]
    return out


def _sensitivity(rec: Record, rows: Array, point: Point, k: int) -> Array:
    """Whitened sensitivities to the parameters of `parameter_covariance`, minus what trim and start can absorb, (B, P).

    Args:
        rec: The flight.
        rows: Whitened sensitivities of the axis, d/d(g, log b, tau, further parameters, c, v0), K columns each.
        point: Its laws are those of the axes.
        k: Index of the axis among the K.
    """
    K = len(rec.axes)
    starts = [rows[:, -K:] * (rec.segment == number)[:, None] for number in range(rec.starts.size)]
    own = rows[:, [point.place(name, k) for name in (*COEFFICIENTS, *point.extra_values(k))]]
    others = np.hstack([rows[:, -2 * K : -K], *starts])
    return np.asarray(own - others @ np.linalg.lstsq(others, own)[0])


def _law(structure: str, known: Predictor) -> Structure:
    """The law of an axis; the first-order law with a delay where it has no numbers."""
    law = structure_named(structure)
    return law if set(known.extra) == {extra.name for extra in law.extras} else FIRST_ORDER_DELAY


def _with_structures(point: Point, structures: Sequence[str], known: Sequence[Predictor]) -> Point:
    """The point with the structures of a model and their further parameters; axes without numbers have none."""
    laws = tuple(_law(s, p) for s, p in zip(structures, known, strict=True))
    extra = np.zeros((max(len(law.extras) for law in laws), len(laws)))
    for k, (law, one) in enumerate(zip(laws, known, strict=True)):
        extra[: len(law.extras), k] = [e.coordinate(one.extra[e.name]) for e in law.extras]
    return replace(point, structures=laws, extra=extra)
