"""Model + flight -> Residuals: what the model leaves of a flight unexplained, and tests of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.assessment.whiteness import REACH, residual_tests
from rotorfit.core import parallel
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
from rotorfit.core.laws import FIRST_ORDER_DELAY, LEVELS_OF, Structure, structure_named
from rotorfit.core.model import COEFFICIENTS, NORMAL, Model, Predictor, predictor_of
from rotorfit.core.residuals import Innovations, ResidualTests
from rotorfit.estimation.clock_placement import answer_placed, delays, placed_by, with_own
from rotorfit.estimation.clock_uncertainty import clock_half_width, lateness
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.likelihood import whiten
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.flights.distinct import passes


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
        out |= _residuals_of(model, flight, rec, _explained(model, flight, rec, own_levels))
    return out


def residual_tests_of_flight(model: Model, flight: Flight) -> dict[str, ResidualTests]:
    """Tests of the innovations of the axes that a flight commands and the model knows."""
    every = parallel.each(lambda rec: _tests_of_record(model, flight, rec), _records(model, flight), flight.duration)
    return {axis: tests for some in every for axis, tests in some.items()}


def _tests_of_record(model: Model, flight: Flight, rec: Record) -> dict[str, ResidualTests]:
    """`residual_tests_of_flight` for the axes of one record."""
    found: dict[str, ResidualTests] = {}
    fitted = was_fitted(model, flight)
    own, at_fitted = (_explained(model, flight, rec, levels) for levels in (True, False))
    for axis, each in _residuals_of(model, flight, rec, own).items():
        if axis not in flight.moved:
            continue
        covariance = parameter_covariance(model, axis, [flight]) * (not fitted)
        training = sum(s.span[1] - s.span[0] for s in model.flights if axis in s.axes)
        share = flight.duration / training if training > 0 and not fitted else 0.0
        innovation = at_fitted.score.innovations[0][:, rec.axes.index(axis)]
        tests = residual_tests(each.innovations, innovation, covariance, share)
        if tests:
            found[axis] = _relative(tests, predictor_of(model, axis).input)
    return found


def _relative(tests: ResidualTests, gain: float) -> ResidualTests:
    """The tests with the step of the input as a share of the model's."""
    step = tests.own_step
    return replace(tests, own_step={**step, "input": step["input"] / gain}) if step else tests


def parameter_covariance(model: Model, axis: str, flights: Sequence[Flight] = ()) -> Array:
    """Covariance of input, log damping, delay and the n further parameters of an axis, in the estimator's coordinates.

    Args:
        model: As fitted.
        axis: Its name.
        flights: Others, which the model is to explain: what their stamps leave unknown is added to the delay's.

    Returns:
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
    delay = COEFFICIENTS.index("delay")
    if out[delay, delay]:  # a logger is late or early, never right in the mean: a third of the squares, not a twelfth
        out[delay, delay] += (clock_half_width(flights, axis) / NORMAL) ** 2
        out[delay, delay] += sum(end**2 for end in lateness(flights, axis)) / 3
    return out * np.outer(scale, scale)


def was_fitted(model: Model, flight: Flight) -> bool:
    """Whether an overlapping stretch of the same log was used in the fit, or the same poses in another file."""
    return any(
        min(source.span[1], flight.span[1]) > max(source.span[0], flight.span[0])
        if source.sha256 == flight.sha256
        else passes(flight, source.landmarks)
        for source in model.flights
    )


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


def _expected(model: Model, rec: Record) -> Point:
    """The model's coefficients and levels, without trim, and with the velocities that the flight starts with."""
    points = _points(model, rec)
    levels = np.log([[model.axes[axis].noise[level] for level in LEVELS_OF[rec.measured]] for axis in rec.axes])
    start = replace(
        start_point([rec], 0.0, 1.0, levels),
        gain=np.array([point.input for point in points]),
        log_damping=np.log([max(point.damping, 1e-3) for point in points]),
        delay=np.array([point.delay for point in points]),
    )
    return _with_structures(start, [model.axes[axis].structure for axis in rec.axes], points)


def _explained(model: Model, flight: Flight, rec: Record, own_levels: bool) -> Optimum:
    """The model's coefficients with the flight's own trim and start, and with its own levels if requested.

    Where clocks do not tell the delays, these are the flight's own, too.
    """
    expected = _expected(model, rec)
    return with_own(rec, expected, delays(rec, expected) if unclocked(model, flight) else (), own_levels)


def placed(model: Model, flight: Flight) -> Flight:
    """The flight; moved to where it answers as the model says where clocks do not tell its delay, or the model's."""
    if not unclocked(model, flight):
        return flight

    def expected(moved: Flight) -> Iterator[tuple[Record, Point]]:
        commanded = (rec for rec in _records(model, moved) if set(rec.axes) & set(moved.moved))
        return ((rec, _expected(model, rec)) for rec in commanded)

    return placed_by(flight, expected)


def unclocked(model: Model, flight: Flight) -> bool:
    """Whether the delays of model and flight cannot be compared, as only answers to commands relate the clocks."""
    return answer_placed([flight]) or any(finding.code == "clock_includes_delay" for finding in model.findings)


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
            _sensitivity(rec, rows[:, :, k], best, k),
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


def _sensitivity(rec: Record, rows: Array, best: Optimum, k: int) -> Array:
    """Whitened sensitivities to the parameters of `parameter_covariance`, minus what the flight's own absorb, (B, P).

    Args:
        rec: The flight.
        rows: Whitened sensitivities of the axis, d/d(g, log b, tau, further parameters, c, v0), K columns each.
        best: Its free parameters are the flight's own: trim and start, and the delays where clocks do not tell them.
        k: Index of the axis among the K.
    """
    K, point = len(rec.axes), best.point
    starts = [rows[:, -K:] * (rec.segment == number)[:, None] for number in range(rec.starts.size)]
    own = rows[:, [point.place(name, k) for name in (*COEFFICIENTS, *point.extra_values(k))]]
    others = np.hstack([rows[:, np.flatnonzero(best.free[: point.coefficients])], rows[:, -2 * K : -K], *starts])
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
