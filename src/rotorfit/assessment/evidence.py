"""Evidence: everything that a report, a figure or the studio shows of a model and its validation, computed once.

Predictions, residuals and their tests are computed only here; reports, figures and the studio only show them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorfit.assessment.case import Case, paired_cases
from rotorfit.assessment.frequency.comparison import response_test
from rotorfit.assessment.innovations import parameter_covariance, residual_tests_of_flight, residuals, was_fitted
from rotorfit.assessment.rows import CoefficientRow, HorizonErrors, coefficient_rows, scores_of
from rotorfit.assessment.validation import dynamics_from_model, paper_dynamics
from rotorfit.assessment.whiteness import LEAST_BLOCKS, autocorrelation, cross_correlation
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Mask, heading_from_world
from rotorfit.core.frequency_response import ResponseComparison
from rotorfit.core.laws import structure_named
from rotorfit.core.model import STRUCTURE, Model, Predictor, with_findings
from rotorfit.core.physics import PhysicsRow, implied_limits, physics_rows
from rotorfit.core.residuals import Correlogram, ResidualTests
from rotorfit.core.results import PairedTest
from rotorfit.dynamics.kinematics import motion_from_flight, smoothed
from rotorfit.dynamics.protocol import START_EVERY, Predictions, predict_flight
from rotorfit.estimation.regression.paper import modelled_acceleration

LAGS = 2.0
"""Longest lag of the residuals' autocorrelation [s]."""

DRAWN = (STRUCTURE, "first_order_delay_lag", "first_order_delay_world_lag")
"""Laws whose acceleration is drawn beside the measured one."""


@dataclass(frozen=True)
class FlightMotion:
    """Measured and modelled motion of one flight at its N poses.

    Attributes:
        path: Path of its log.
        duration: Time under commands [s].
        moved: The axes that the flight commands with anything but zero.
        axes: Those of them that have a predictor.
        time: Stamps, shape (N,) [s].
        velocity: `measured`, `model` and, if requested, `paper` to velocities in the heading frame, shape (N, 4) [m/s,
            rad/s]; NaN where there is none. The modelled one is joined from predictions: at every pose, the one that
            started 0.5 to 1 s before.
        acceleration: `measured` and `model` to accelerations in the world frame, shape (N, 4) [m/s^2, rad/s^2]: the
            paper's eq. (6) with the command that acts, delayed and smoothed by the lag of a law that has one, and the
            measured velocity; NaN under other laws.
    """

    path: str
    duration: float
    moved: tuple[str, ...]
    axes: tuple[str, ...]
    time: Array
    velocity: Mapping[str, Array]
    acceleration: Mapping[str, Array]


@dataclass(frozen=True)
class Evidence:
    """A model with all the evidence for and against it.

    Attributes:
        case: The model, with what its validation found about it, and its flights.
        coefficients: Rows of the table of coefficients.
        physics: Rows of the table of physical quantities.
        limits: What the model implies for the card's limits, one sentence each.
        scores: Errors over the flights that were not fitted.
        tested_on: Paths of the flights whose residuals are tested: those of the validation, otherwise of the training.
        tests: For each flight, a mapping from axis to the tests of its residuals.
        autocorrelation: Axis to the autocorrelation of the residuals over these flights.
        command_correlation: Axis to the correlation of the residuals with past commands.
        responses: For each flight, a mapping from axis to its frequency response beside the model's.
        validation: Motion of the flights of the validation.
        training: Motion of the flights of the fit; empty if not requested.
        against: Index of another compared model to the paired test against it.
    """

    case: Case
    coefficients: tuple[CoefficientRow, ...]
    physics: tuple[PhysicsRow, ...]
    limits: tuple[str, ...]
    scores: tuple[HorizonErrors, ...]
    tested_on: tuple[str, ...]
    tests: tuple[Mapping[str, ResidualTests], ...]
    autocorrelation: Mapping[str, Correlogram]
    command_correlation: Mapping[str, Correlogram]
    responses: tuple[Mapping[str, ResponseComparison], ...]
    validation: tuple[FlightMotion, ...]
    training: tuple[FlightMotion, ...] = ()
    against: Mapping[int, PairedTest] = field(default_factory=dict)


def evidence_of(cases: Sequence[Case]) -> tuple[Evidence, ...]:
    """The evidence for one model, or for several on the same flights.

    Args:
        cases: The models with their validations. If there are several, the motion of the training flights is left out.

    Raises:
        FlightError: A flight has a position where a model knows only the noise of a velocity, or the other way round.
    """
    tests = paired_cases(cases)
    return tuple(
        replace(_evidence_of(case, len(cases) == 1), against={j: test for (i, j), test in tests.items() if i == number})
        for number, case in enumerate(cases)
    )


def _evidence_of(case: Case, with_training: bool) -> Evidence:
    about_model = (each for each in case.validation.findings if each not in case.validation.misread)
    model = with_findings(case.model, (*case.model.findings, *about_model))
    shown = case.flights or case.training
    tests = case.validation.residuals
    if not case.flights:
        tests = tuple(residual_tests_of_flight(model, flight) for flight in case.training)
    white, free = correlograms(model, shown)
    return Evidence(
        case=replace(case, model=model),
        coefficients=coefficient_rows(model),
        physics=tuple(physics_rows(model)),
        limits=tuple(implied_limits(model)),
        scores=scores_of(case.validation, case.flights),
        tested_on=tuple(flight.path for flight in shown),
        tests=tests,
        autocorrelation=white,
        command_correlation=free,
        responses=case.validation.responses or response_test(model, shown),
        validation=tuple(motion_of_flight(model, flight, model.method != "paper") for flight in case.flights),
        training=tuple(motion_of_flight(model, flight) for flight in case.training if with_training),
    )


def correlograms(model: Model, flights: Sequence[Flight]) -> tuple[dict[str, Correlogram], dict[str, Correlogram]]:
    """Autocorrelation of the innovations, and their correlation with past commands, for each axis.

    Pooled over the flights that command the axis, with the disturbance levels of each flight; `Validation.residuals`
    has the results of the single flights.

    Source: see `whiteness`.
    """
    every = [(flight.moved, residuals(model, flight, own_levels=True)) for flight in flights]
    parts = {
        axis: [found[axis].innovations for moved, found in every if axis in moved and axis in found] for axis in AXES
    }
    parts = {axis: [p for p in found if p.time.size >= LEAST_BLOCKS] for axis, found in parts.items()}
    white, free = {}, {}
    for axis, found in parts.items():
        if found:
            covariance = parameter_covariance(model, axis, [f for f in flights if not was_fitted(model, f)])
            white[axis] = _pooled_lags([autocorrelation(p.time, p.innovation, LAGS) for p in found])
            free[axis] = _pooled_lags([cross_correlation(p, covariance) for p in found])
    return white, free


def _pooled_lags(parts: Sequence[Correlogram]) -> Correlogram:
    """Mean of correlograms up to the shortest, each weighted by the precision that its bands imply."""
    n = min(part.lag.size for part in parts)
    band = np.stack([part.band[:n] for part in parts])
    weight = np.divide(1.0, band**2, out=np.zeros_like(band), where=band > 0)
    total = weight.sum(axis=0)
    value = np.sum(weight * [part.value[:n] for part in parts], axis=0)
    lag = np.median([part.lag[:n] for part in parts], axis=0)
    known = total > 0
    return Correlogram(lag[known], value[known] / total[known], 1 / np.sqrt(total[known]))


def motion_of_flight(model: Model, flight: Flight, with_paper: bool = False) -> FlightMotion:
    """Measured and modelled motion of one flight.

    Args:
        model: The model.
        flight: Any flight of the vehicle.
        with_paper: Whether to predict with the paper's coefficients as well.

    Raises:
        FlightError: The flight has a position where the model knows only the noise of a velocity, or the other way
            round.
    """
    axes = tuple(axis for axis in flight.moved if model.axes[axis].predictor)
    velocity, acceleration = _velocities(model, flight, with_paper), _accelerations(model, flight)
    return FlightMotion(flight.path, flight.duration, flight.moved, axes, flight.pose_time, velocity, acceleration)


def command_and_velocity(flight: Flight) -> tuple[Array, Array, Array]:
    """Commands and measured velocities side by side, to reveal a wrong sign or axis.

    Returns:
        Stamps of the poses, shape (N,) [s]; the commands in effect then, shape (N, 4), NaN where unknown or where the
        axis is not commanded; the measured velocities, heading frame, shape (N, 4) [m/s, rad/s].
    """
    t = flight.pose_time
    command = np.column_stack([_held(flight, t, k) for k in range(len(AXES))])
    command[:, [axis not in flight.axes for axis in AXES]] = np.nan
    return t, command, _measured(flight)


def _measured(flight: Flight) -> Array:
    """Velocities at the poses, heading frame, shape (N, 4)."""
    t, pose = flight.pose_time, np.column_stack([flight.position, flight.yaw])
    velocity = smoothed(t, pose, t).velocity
    velocity[:, :2] = heading_from_world(velocity[:, :2], flight.yaw)
    return velocity


def _velocities(model: Model, flight: Flight, with_paper: bool) -> dict[str, Array]:
    """Measured and predicted velocities at the poses, heading frame, each (N, 4)."""
    t, pose, known = flight.pose_time, np.column_stack([flight.position, flight.yaw]), _known(model)
    lines = {"measured": smoothed(t, pose, t).velocity}
    told = {"measured": np.ones(4, bool), "model": known}
    parts = predict_flight(flight, dynamics_from_model(model, flight), 2 * START_EVERY) if known.any() else ()
    paper = np.array([np.nan if g is None else g for g in model.paper])
    if with_paper and np.isfinite(paper).any():
        regressed = predict_flight(flight, paper_dynamics(model, flight), 2 * START_EVERY)
        lines["paper"] = _stitched(t, regressed, [part.predicted for part in regressed])
        told["paper"] = np.isfinite(paper[0::2])
    lines["model"] = _stitched(t, parts, [part.predicted for part in parts])
    for name, line in lines.items():
        line[:, :2] = heading_from_world(line[:, :2], flight.yaw)
        line[:, ~told[name]] = np.nan
    return lines


def _known(model: Model) -> Mask:
    """Which axes have a predictor, shape (4,)."""
    return np.array([model.axes[axis].predictor is not None for axis in AXES])


def _stitched(time: Array, parts: Sequence[Predictions], predicted: Sequence[Array]) -> Array:
    """Velocity at each pose as predicted from the start 0.5 to 1 s before it, world frame, (N, 4)."""
    out = np.full((time.size, 4), np.nan)
    for part, values in zip(parts, predicted, strict=True):
        offset = int(np.searchsorted(time, part.time[0]))
        low = np.searchsorted(part.time, part.start + START_EVERY, side="right")
        high = np.searchsorted(part.time, part.start + 2 * START_EVERY, side="right")
        for s, (begin, end) in enumerate(zip(low, np.minimum(high, part.last), strict=True)):
            if begin < end:
                out[offset + begin : offset + end] = values[s, begin - part.first[s] : end - part.first[s], 1]
    return out


def _accelerations(model: Model, flight: Flight) -> dict[str, Array]:
    """Measured and modelled accelerations at the poses, world frame, each (N, 4).

    Source: paper, eq. (6) and Figure 4, with u(t - delay), smoothed by the lag where the law has one; other laws have
    no line.
    """
    motion = motion_from_flight(flight)
    points = [model.axes[axis].predictor for axis in AXES]
    acting = [_acting(flight, motion.time, k, point) for k, point in enumerate(points)]
    if points[0] and points[1] and any(structure_named(model.axes[axis].structure).world for axis in "xy"):
        acting[:2] = _acting_in_world(flight, motion.time, points[0], points[1])
    gamma = np.array([value for p in points for value in ((p.input, p.damping) if p else (np.nan, np.nan))])
    lines = {"measured": motion.acceleration}
    if _known(model).any():
        lines["model"] = modelled_acceleration(replace(motion, command=np.column_stack(acting)), gamma)
        lines["model"][:, ~_known(model)] = np.nan
        drawn = [model.axes[axis].structure in DRAWN for axis in AXES]
        drawn[:2] = [all(drawn[:2])] * 2  # the world's x and y depend on both
        lines["model"][:, ~np.array(drawn)] = np.nan
    at, out = np.searchsorted(flight.pose_time, motion.time), {}
    for name, values in lines.items():
        out[name] = np.full((flight.pose_time.size, 4), np.nan)
        out[name][at] = values
    return out


def _acting(flight: Flight, time: Array, k: int, point: Predictor | None) -> Array:
    """The command that acts on axis k at some times, delayed, and smoothed by a lag from rest in each segment.

    Args:
        flight: The flight.
        time: Shape (N,) [s].
        k: Index of the axis.
        point: Its predictor; None for an axis without one, which gets zeros.

    Returns:
        Shape (N,) [unit of the command]; NaN outside the segments.

    Source: T q' = u(t - delay) - q, solved exactly from one command to the next.
    """
    if point is None:
        return np.zeros(time.size)
    held, lag = _held(flight, time - point.delay, k), point.extra.get("lag", 0.0)
    if not lag:
        return held
    begun = np.searchsorted(flight.command_time, [part.start for part in flight.segments])
    kept = np.exp(-np.diff(flight.command_time, prepend=flight.command_time[0]) / lag)
    kept[begun] = 0.0
    command, smoothed_until = flight.command[:, k], np.zeros(flight.command_time.size)  # at the stamp of each command
    for i in range(1, smoothed_until.size):
        if kept[i]:
            smoothed_until[i] = command[i - 1] + (smoothed_until[i - 1] - command[i - 1]) * kept[i]
    row = np.maximum(np.searchsorted(flight.command_time, time - point.delay, side="right") - 1, 0)
    since = np.maximum(time - point.delay - flight.command_time[row], 0.0)
    return np.asarray(held + (smoothed_until[row] - held) * np.exp(-since / lag))


def _acting_in_world(flight: Flight, time: Array, x: Predictor, y: Predictor) -> list[Array]:
    """`_acting` of x and y, whose lagged acceleration keeps its direction in the world, from one pose to the next.

    Args:
        flight: The flight.
        time: Increasing, shape (N,) [s].
        x: Predictor of x.
        y: Predictor of y.

    Returns:
        Commands of x and y, each of shape (N,) [unit of the command]; NaN outside the segments.

    Source: T q' = g u(t - delay) - q, q turned back by what the heading turns.
    """
    gain, both = np.array([x.input, y.input]), (x, y)
    demand = gain * np.column_stack([_held(flight, time - point.delay, k) for k, point in enumerate(both)])
    lag = np.array([max(point.extra.get("lag", 0.0), 1e-9) for point in both])
    yaw, keep = np.interp(time, flight.pose_time, flight.yaw), np.exp(-np.diff(time, prepend=time[0])[:, None] / lag)
    out = demand.copy()
    for i in range(1, time.size):
        if np.isfinite(out[i - 1]).all():
            before = heading_from_world(out[i - 1], yaw[i] - yaw[i - 1])
            out[i] += (before - demand[i]) * keep[i]
    return list((out / gain).T)


def _held(flight: Flight, time: Array, k: int) -> Array:
    """The command in effect at each time; NaN outside the segments."""
    index = np.searchsorted(flight.command_time, time, side="right") - 1
    inside = np.any([(time >= part.start) & (time <= part.end) for part in flight.segments], axis=0)
    return np.where(inside & (index >= 0), flight.command[np.maximum(index, 0), k], np.nan)
