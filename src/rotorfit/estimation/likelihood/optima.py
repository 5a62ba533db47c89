"""Search for optima of the likelihood from several starts, and selection of one of them.

In closed loop the likelihood of a wrong model can be far above that of the right one: a controller's command carries
information about the motion, so a model that uses the command as a measurement (no delay, huge damping) explains every
small motion and predicts nothing. The selected optimum is therefore the one that predicts the training flights best
over 1 s; the likelihood decides between optima that predict equally well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array, Mask
from rotorfit.core.laws import FIRST_ORDER_DELAY, level_range, start_levels
from rotorfit.dynamics.protocol import AxisDynamics, hold_velocity, horizon_errors, predict_flight
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE, Record, measured_by
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, climb, maximise
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.trims import LEAST, trims_of

STARTS = ((0.15, 1.0), (0.02, 4.0), (0.05, 0.5), (0.25, 0.5), (0.35, 2.0), (0.5, 1.0))
"""Delay [s] and damping [1/s] of the starts."""

SAME_DELAY = 0.01

SAME_LOG_DAMPING = 0.3
"""Optima closer than this in log damping, and than `SAME_DELAY` in delay [s], count as one."""

START_BLOCKS = 6
"""Number of blocks from which the velocity at the start of a segment is estimated."""

FINISH = 15
"""Passes with free levels for an optimum from a later start: enough to judge it."""

NOISELESS = 0.1
"""Logarithm by which the noise of the poses may exceed its lower bound and count as none."""

SMOOTH = 1e-4
"""Expected gain in log-likelihood below which a climb at the levels of the start ends: there the likelihood is flat."""

BACKWARDS = np.log(8.0)
"""Logarithm of the damping above which a model has no memory: its velocity is proportional to the command."""

ALIKE = 0.05
"""Relative difference of prediction errors below which optima predict equally well."""

EXCERPT = 60.0
"""Length of the stretch of a flight that is searched for optima [s]; the selected one is then climbed on all of it."""

JUDGE_HORIZON = 1.0
"""Horizon of the predictions by which optima are judged [s]."""


@dataclass(frozen=True)
class CandidateOptimum:
    """An optimum with its prediction errors.

    Attributes:
        optimum: The optimum of the likelihood.
        starts: Number of starts from which it was reached; 0 if it was composed from other optima.
        prediction: RMSE of 1 s velocity predictions on the training flights, shape (K,) [m/s or rad/s].
        held: The same of predictions by constant velocity.
    """

    optimum: Optimum
    starts: int
    prediction: Array
    held: Array


def start_point(records: Sequence[Record], delay: float, damping: float, levels: Array) -> Point:
    """A start: given delay [s], damping [1/s] and levels (K, L), a typical gain, zero trims, measured velocities."""
    K = levels.shape[0]
    return Point(
        gain=np.full(K, 2.0 * max(damping, 1.0)),
        log_damping=np.full(K, np.log(damping)),
        delay=np.full(K, delay),
        trim=np.zeros((len(records), K)),
        start=np.concatenate([_start_velocity(rec) for rec in records]),
        levels=levels,
        measured=measured_by(records),
    )


def _start_velocity(rec: Record) -> Array:
    """Mean velocity over the first blocks of each segment, shape (S, K) [m/s or rad/s]."""
    first = np.flatnonzero(rec.fresh)
    if rec.rate is not None:
        rates = np.flatnonzero(rec.rate)
        at = np.searchsorted(rates, first)[:, None] + np.arange(START_BLOCKS)
        return rec.position[rates[np.minimum(at, rates.size - 1)]].mean(axis=1)  # type: ignore[no-any-return]
    last = np.minimum(first + START_BLOCKS, np.append(first[1:], rec.count.size) - 1)
    elapsed = np.maximum(rec.block_time[last] - rec.block_time[first], 1e-3)
    return (rec.position[last] - rec.position[first]) / elapsed[:, None]  # type: ignore[no-any-return]


def search(records: Sequence[Record], flights: Sequence[Flight], free: Mask) -> tuple[CandidateOptimum, ...]:
    """Climbs from every start and collects the distinct optima, the selected one first.

    The climb from the first start also estimates the disturbance levels; the others start with those levels held, and
    every new optimum is then climbed further with free levels. Where the poses have no noise, as of a simulation, every
    slope of the likelihood is a cliff, and climbs end on ledges: one more is made at the levels of the start to its
    end, on a surface that is smooth, and then with free levels.

    Args:
        records: The flights as input of the likelihood.
        flights: The same flights, for the predictions by which optima are judged.
        free: True for the free parameters, shape (n + L K,).
    """
    K = len(records[0].axes)
    levels = begin = np.tile(start_levels(measured_by(records)), (K, 1))
    held_levels = free.copy()
    held_levels[-levels.size :] = False
    optima: list[Optimum] = []
    starts: list[int] = []
    for number, (delay, damping) in enumerate(STARTS):
        point = start_point(records, delay, damping, levels)
        point = without_gain(point, ~free[:K])
        if number:
            point = maximise(records, point, held_levels, tolerance=1.0, most=30).point
        if _counted(point, optima, starts):
            continue
        rise = climb if number == 0 else maximise  # later starts have levels with moderate poles already
        climbed = rise(records, point, free, tolerance=0.3, most=60 if number == 0 else FINISH)
        if not _counted(climbed.point, optima, starts):
            optima.append(climbed)
            starts.append(1)
        if number == 0:
            levels = climbed.point.levels
    if any(map(_is_noiseless, optima)):
        point = without_gain(start_point(records, *STARTS[0], begin), ~free[:K])
        point = maximise(records, point, held_levels, tolerance=SMOOTH, most=60).point
        climbed = maximise(records, point, free, tolerance=0.3, most=60)
        if not _counted(climbed.point, optima, starts):
            optima.append(climbed)
            starts.append(1)
    predictions = [prediction_error(flights, records[0].axes, optimum) for optimum in optima]
    found = [CandidateOptimum(o, n, *p) for o, n, p in zip(optima, starts, predictions, strict=True)]
    return _ranked([*found, *_crossed(records, flights, free, found)])


def _counted(point: Point, optima: Sequence[Optimum], starts: list[int]) -> bool:
    """Whether a point is at one of the optima, for which one more start is then counted."""
    same = _same(point, [optimum.point for optimum in optima])
    if same is not None:
        starts[same] += 1
    return same is not None


def _is_noiseless(optimum: Optimum) -> bool:
    """Whether poses of an axis have no noise at an optimum."""
    point = optimum.point
    return bool((point.levels[:, 1] < level_range(point.measured)[1, 0] + NOISELESS).any())


def _crossed(
    records: Sequence[Record], flights: Sequence[Flight], free: Mask, found: Sequence[CandidateOptimum]
) -> tuple[CandidateOptimum, ...]:
    """An optimum climbed from the best optimum of each axis, combined; empty where it was found before.

    A start that is right for one axis of a pair can be wrong for the other, and then no climb is right for both.
    """
    best = [_best_on(found, k) for k in range(len(records[0].axes))]
    if len(set(best)) < 2:
        return ()
    points = [found[i].optimum.point for i in best]
    point = replace(
        points[0],
        gain=np.stack([p.gain[k] for k, p in enumerate(points)]),
        log_damping=np.stack([p.log_damping[k] for k, p in enumerate(points)]),
        delay=np.stack([p.delay[k] for k, p in enumerate(points)]),
        levels=np.stack([p.levels[k] for k, p in enumerate(points)]),
        trim=np.stack([p.trim[:, k] for k, p in enumerate(points)], axis=1),
    )
    climbed = climb(records, point, free, tolerance=0.3, most=FINISH)
    if _same(climbed.point, [f.optimum.point for f in found]) is not None:
        return ()
    return (CandidateOptimum(climbed, 0, *prediction_error(flights, records[0].axes, climbed)),)


def _best_on(found: Sequence[CandidateOptimum], k: int) -> int:
    """Index of the optimum that predicts axis k best; inverse loops are left out."""
    error = np.array([np.inf if is_inverse_loop(f.optimum, k) else f.prediction[k] for f in found])
    return int(np.argmin(np.where(np.isfinite(error), error, np.inf)))


def without_gain(point: Point, axes: Mask) -> Point:
    """The point with zero gain, a damping of 1 1/s and zero delay on these axes, shape (K,)."""
    return replace(
        point,
        gain=np.where(axes, 0.0, point.gain),
        log_damping=np.where(axes, 0.0, point.log_damping),
        delay=np.where(axes, 0.0, point.delay),
    )


def _same(point: Point, others: Sequence[Point]) -> int | None:
    axes = range(point.gain.size)
    return next((i for i, other in enumerate(others) if all(are_same(point, other, k) for k in axes)), None)


def are_same(point: Point, other: Point, k: int) -> bool:
    """Whether two optima count as one on axis k."""
    near = abs(point.log_damping[k] - other.log_damping[k]) < SAME_LOG_DAMPING
    return bool(near and abs(point.delay[k] - other.delay[k]) < SAME_DELAY)


def is_inverse_loop(optimum: Optimum, k: int) -> bool:
    """Whether an optimum is the inverse of a feedback loop: large damping, negative gain, negative delay.

    Such a model infers the motion from commands that respond to it later, so it explains the motion and even predicts
    it, but it is never the vehicle's.
    """
    point = optimum.point
    return bool(point.gain[k] < 0 and point.delay[k] < 0 and point.log_damping[k] > BACKWARDS)


def _ranked(found: Sequence[CandidateOptimum]) -> tuple[CandidateOptimum, ...]:
    """The selected optimum first, the likeliest of those that predict best; then the others by prediction error."""
    error = np.array([np.sqrt(np.mean((f.prediction / np.maximum(found[0].prediction, 1e-12)) ** 2)) for f in found])
    error[~np.isfinite(error)] = np.inf
    backwards = np.array([any(is_inverse_loop(f.optimum, k) for k in range(f.prediction.size)) for f in found])
    error[backwards] = np.inf
    alike = error <= np.min(error) * (1 + ALIKE) if np.isfinite(error).any() else np.ones(len(found), bool)
    likelihood = np.array([f.optimum.score.log_likelihood for f in found])
    best = int(np.argmax(np.where(alike, likelihood, -np.inf)))
    rest = sorted((i for i in range(len(found)) if i != best), key=lambda i: error[i])
    return tuple(found[i] for i in (best, *rest))


def prediction_error(flights: Sequence[Flight], axes: Sequence[str], optimum: Optimum) -> tuple[Array, Array]:
    """RMSE of 1 s velocity predictions on the training flights, by an optimum and by constant velocity.

    Args:
        flights: The flights.
        axes: Axes of the optimum.
        optimum: The optimum.

    Returns:
        RMSE of the optimum and of constant velocity, both of shape (K,) [m/s or rad/s]; NaN if flights are too short.
    """
    dynamics = dynamics_of(axes, optimum)
    squares, count = np.zeros((2, len(axes))), np.zeros(len(axes))
    for flight in flights:
        parts = predict_flight(thinned(flight), dynamics, JUDGE_HORIZON, axes, adapt=False)
        for row, predicted in enumerate(([p.predicted for p in parts], [hold_velocity(p) for p in parts])):
            errors = horizon_errors(parts, predicted, JUDGE_HORIZON)
            for k, axis in enumerate(axes):
                rmse = errors[axis].velocity_rmse
                if rmse is not None:
                    squares[row, k] += errors[axis].n * rmse**2
                    count[k] += errors[axis].n if row == 0 else 0
    with np.errstate(invalid="ignore", divide="ignore"):
        own, held = np.sqrt(squares / count)
    return own, held


def excerpt(flight: Flight, axes: Sequence[str]) -> Flight:
    """The stretch of `EXCERPT` of a long flight with the strongest commands of the axes: enough to find the optima.

    Commands count while poses show what they do.
    """
    start, end = flight.segments[0].start, flight.segments[-1].end
    if end - start <= EXCERPT:
        return flight
    t, seen = flight.command_time, flight.pose_time
    u = flight.command[:, [AXES.index(axis) for axis in axes]]
    u = (u - u.mean(axis=0))[np.maximum(np.searchsorted(t, seen, side="right") - 1, 0)]
    ends = np.array([(part.start, part.end) for part in flight.segments])
    place = np.maximum(np.searchsorted(ends[:, 0], seen, side="right") - 1, 0)
    flown = (seen >= ends[place, 0]) & (seen <= ends[place, 1])
    energy = np.concatenate([[0.0], np.cumsum(flown * np.sum(u**2, axis=1))])
    begins = np.append(np.arange(start, end - EXCERPT, EXCERPT / 6), end - EXCERPT)
    inside = energy[np.searchsorted(seen, begins + EXCERPT, side="right")] - energy[np.searchsorted(seen, begins)]
    best = float(begins[int(np.argmax(inside))])
    return between(flight, best, best + EXCERPT)


def between(flight: Flight, low: float, high: float) -> Flight:
    """The part of a flight between two times [s], from the command in force at the first of them."""
    t = flight.command_time
    low = float(t[max(int(np.searchsorted(t, low, side="right")) - 1, 0)])
    commands, poses = (
        slice(int(np.searchsorted(stamps, low)), int(np.searchsorted(stamps, high, side="right")))
        for stamps in (t, flight.pose_time)
    )
    return replace(
        flight,
        span=(max(low, flight.span[0]), min(high, flight.span[1])),
        command_time=t[commands],
        command=flight.command[commands],
        pose_time=flight.pose_time[poses],
        position=flight.position[poses],
        yaw=flight.yaw[poses],
        reference=None if flight.reference is None else flight.reference[commands],
        velocity=flight.velocity and flight.velocity.between(low, high),
        segments=tuple(
            Segment(max(part.start, low), min(part.end, high))
            for part in flight.segments
            if part.start < high and part.end > low
        ),
    )


def thinned(flight: Flight) -> Flight:
    """The flight with poses and velocities thinned, but not below the rate of the blocks: enough for predictions."""
    every = max(1, int(flight.pose_time.size / max(flight.duration, 1e-9) / BLOCK_RATE))
    velocity = flight.velocity
    if velocity is not None:
        often = max(1, int(velocity.time.size / max(flight.duration, 1e-9) / BLOCK_RATE))
        velocity = replace(velocity, time=velocity.time[::often], value=velocity.value[::often])
    return replace(
        flight,
        pose_time=flight.pose_time[::every],
        position=flight.position[::every],
        yaw=flight.yaw[::every],
        velocity=velocity,
    )


def dynamics_of(axes: Sequence[str], optimum: Optimum) -> Mapping[str, AxisDynamics]:
    """The dynamics of an optimum for the predictions by which it is judged, by axis.

    Each trim has the mean square that it has under a flat prior: what is judged is the motion, so a trim may be as
    large as the optimum can make it. The published model knows more about the trims of new flights (`trims`).
    """
    point, (trim, spread) = optimum.point, trims_of(optimum)
    variance = np.mean(trim**2 + spread, axis=0) + LEAST
    return {
        axis: AxisDynamics(
            input=float(point.gain[k]),
            damping=float(np.exp(point.log_damping[k])),
            delay=float(point.delay[k]),
            levels=tuple(float(level) for level in np.exp(point.levels[k, :4])),  # type: ignore[arg-type]
            trim_variance=float(variance[k]),
            structure=point.structures[k] if point.structures else FIRST_ORDER_DELAY,
            extra=point.extra_values(k),
        )
        for k, axis in enumerate(axes)
    }


def without_input(records: Sequence[Record], optimum: Optimum, axes: Sequence[int]) -> Optimum:
    """The maximum of the likelihood with zero gain on the axes with these indices."""
    K = optimum.point.gain.size
    idle = np.isin(np.arange(K), axes)
    free = optimum.free.copy()
    free[: 3 * K] &= ~np.tile(idle, 3)
    return maximise(records, without_gain(optimum.point, idle), free, tolerance=0.05)
