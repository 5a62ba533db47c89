"""The prediction protocol: one implementation for validation, comparison, report, benchmark and the choice of a mode.

The first 2 s of each segment are given to the causal filter; starts follow every 0.5 s. At a start the state comes
from the filter on data up to that instant; from then on only the commands are known.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.flight_data import LONGEST_GAP, Flight, Segment
from rotorfit.core.frames import AXES, Array, Indices, Mask, heading_from_world
from rotorfit.core.laws import DAMPING, FIRST_ORDER_DELAY, Structure, law_of
from rotorfit.core.results import AxisScore, Horizon, StartErrors
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.filter_bank import bank_levels
from rotorfit.dynamics.free_runs import STATE as RUN
from rotorfit.dynamics.free_runs import free_runs
from rotorfit.dynamics.kinematics import MeasuredSegment, seen_in
from rotorfit.dynamics.predictor import Forecast
from rotorfit.dynamics.start_state import StartState, start_state_from_rows

SETTLING = 2.0
"""Time at the beginning of a segment for the filter to settle before the first start [s]."""

START_EVERY = 0.5
"""Time between starts [s]."""

FIT_HORIZON = 1.0
"""Horizon of `fit_percent` [s]."""

LEAST_SCORES = 5
"""Least number of predictions for a score."""

LEAST_FILTER_DAMPING = 1e-3
"""Lower bound of the damping in the filter, for unstable models [1/s]; the prediction itself has none."""

ORIGIN_TIME = 0.2
"""Length of the beginning of a segment over which its first velocity is measured [s]; quadratic drag can only be
linearised about a velocity."""

EDGE = 1e-9


@dataclass(frozen=True)
class AxisDynamics:
    """One axis of a model for prediction.

    Attributes:
        input: g [m/s^2 or rad/s^2 per command]; 0 for an axis without a model, which only the disturbance filter
            tracks.
        damping: b [1/s].
        delay: tau [s].
        levels: q, r, alpha, kappa of the disturbance, in the order of `LEVELS`.
        trim_variance: Prior variance of the trim of a new flight [unit^2/s^4].
        structure: Its law.
        extra: Further parameters of the law by name.
    """

    input: float
    damping: float
    delay: float
    levels: tuple[float, float, float, float]
    trim_variance: float
    structure: Structure = FIRST_ORDER_DELAY
    extra: Mapping[str, float] = field(default_factory=dict)

    @property
    def law(self) -> Array:
        """Vector of the general law, shape (LAW_SIZE,)."""
        return law_of(self.structure, self.input, self.damping, self.delay, self.extra)


UNMODELLED = AxisDynamics(0.0, 1.0, 0.0, (0.1, 1e-7, 2.5, 0.64), 1e-6)
"""An axis without a model: its velocity is tracked and decays."""


@dataclass(frozen=True)
class Predictions:
    """Predictions from the starts of one segment, for N poses, S starts, and at most E predicted poses per start.

    Attributes:
        time: Stamps of the poses, shape (N,) [s].
        pose: Measured x, y, z, yaw, shape (N, 4) [m, rad].
        reference: Their velocity from a centred local cubic, shape (N, 4) [m/s, rad/s]; NaN without a result.
        start: Shape (S,) [s].
        first: Index of the first predicted pose of each start, shape (S,).
        last: One past the last, shape (S,).
        predicted: World position and velocity, (S, E, 2, 4); NaN beyond `last`.
        begin: The filter's position and velocity at the last pose before the start, shape (S, 2, 4).
        heading: Heading used by the horizontal prediction, shape (S, E) [rad].
        period: Median step of the poses [s].
        holes: Number of gaps across which nothing is scored, up to each pose, shape (N,).
        alone: Axes with only a measured velocity: their positions prove nothing.
        states: States at the starts, of x and y, and of z and yaw; None where neither was requested.
    """

    time: Array
    pose: Array
    reference: Array
    start: Array
    first: Indices
    last: Indices
    predicted: Array
    begin: Array
    heading: Array
    period: float
    holes: Indices
    alone: tuple[str, ...] = ()
    states: tuple[StartState | None, StartState | None] = (None, None)


def predict_flight(
    flight: Flight, dynamics: Mapping[str, AxisDynamics], longest: float, axes: Sequence[str] = AXES, adapt: bool = True
) -> tuple[Predictions, ...]:
    """Predicts from every start of every segment that is long enough.

    Args:
        flight: Commands and poses.
        dynamics: Axis name to its dynamics; a missing axis is `UNMODELLED`, a missing yaw is taken from measurements.
        longest: Longest horizon [s].
        axes: The requested axes; predictions of the others may be NaN.
        adapt: Whether the filter adapts its levels to the past of this flight; else those of the dynamics are kept.
    """
    return tuple(predictions(flight, dynamics, longest, axes, adapt, most=None))


STARTS = 128
"""Starts per piece: at 120 Hz and 5 s ahead its predictions take 5 MB; those of half an hour would take 140 MB."""


def predictions(
    flight: Flight,
    dynamics: Mapping[str, AxisDynamics],
    longest: float,
    axes: Sequence[str] = AXES,
    adapt: bool = True,
    most: int | None = STARTS,
) -> Iterator[Predictions]:
    """As `predict_flight`, in pieces of at most `most` starts, so that memory does not grow with the flight.

    Args:
        flight: Commands and poses.
        dynamics: As for `predict_flight`.
        longest: Longest horizon [s].
        axes: The requested axes.
        adapt: As for `predict_flight`.
        most: Starts per piece; None for all of a segment.
    """
    for segment in flight.segments:
        yield from _segment_predictions(flight, segment, dynamics, longest, axes, adapt, most)


PLANE, SIDE = [0, 1], [2, 3]
"""Indices in `AXES` of the axes that the filter takes together: x and y; z and yaw."""

Pair = Callable[[Indices, Indices, Array], tuple[Array, Array, StartState | None]]
"""Predicts two axes from some starts: index of the first pose and one past the last (S,), heading on the way (S, E).

Returns position and velocity of the two axes at the poses after each start, shape (S, E, 4), and at the start, (S, 4),
and the state there; NaN and None where neither axis is requested."""


def _nothing(_first: Indices, _last: Indices, future: Array) -> tuple[Array, Array, None]:
    return np.full((*future.shape, 4), np.nan), np.full((len(future), 4), np.nan), None


def _segment_predictions(
    flight: Flight,
    segment: Segment,
    dynamics: Mapping[str, AxisDynamics],
    longest: float,
    wanted: Sequence[str],
    adapt: bool,
    most: int | None,
) -> Iterator[Predictions]:
    """Predicts from every start of one segment; z and yaw first, since x and y need the predicted heading.

    Yields nothing where no start has a pose before and after it. The poses within the longest delay after its beginning
    are left out: unknown earlier commands still act there.
    """
    axes = [dynamics.get(axis, UNMODELLED) for axis in AXES]
    begin = segment.start + max(0.0, *(axis.delay for axis in axes))
    seen = seen_in(flight, begin, segment.end)
    t, pose = seen.time, seen.pose
    start = np.arange(segment.start + SETTLING, segment.end - EDGE, START_EVERY)
    first = np.searchsorted(t, start, side="right")
    last = np.searchsorted(t, np.minimum(start + longest, segment.end) + EDGE, side="right")
    useful = (first > 0) & (last > first)
    start, first, last = start[useful], first[useful], last[useful]
    if not start.size:
        return
    commands = (flight.command_time >= segment.start - EDGE) & (flight.command_time <= segment.end + EDGE)
    side, plane = (
        _pair(flight, commands, seen, axes, pair, adapt) if any(AXES[i] in wanted for i in pair) else _nothing
        for pair in (SIDE, PLANE)
    )
    turns = "yaw" in dynamics and "yaw" in wanted
    reach = np.arange(int((last - first).max()))
    period, holes = float(np.median(np.diff(t))), np.append(0, np.cumsum(np.diff(t) > LONGEST_GAP))
    for low in range(0, start.size, most or start.size):
        some = slice(low, low + (most or start.size))
        index = np.minimum(first[some, None] + reach, t.size - 1)
        beside, beside_begin, beside_state = side(first[some], last[some], np.zeros(index.shape))
        heading = np.ascontiguousarray(np.nan_to_num(beside[:, :, 1]) if turns else pose[:, 3][index])
        ahead, ahead_begin, ahead_state = plane(first[some], last[some], heading)
        yield Predictions(
            time=t,
            pose=pose,
            reference=seen.reference,
            start=start[some],
            first=first[some],
            last=last[some],
            predicted=_of_four_axes(ahead, beside),
            begin=_of_four_axes(ahead_begin, beside_begin),
            heading=heading,
            period=period,
            holes=holes,
            alone=flight.velocity_only,
            states=(ahead_state, beside_state),
        )


def _pair(
    flight: Flight,
    commands: Mask,
    seen: MeasuredSegment,
    axes: Sequence[AxisDynamics],
    pair: Sequence[int],
    adapt: bool,
) -> Pair:
    """Predicts two axes from what was seen of a segment, and the commands in it.

    Args:
        flight: The flight.
        commands: Which of its commands, shape (M,).
        seen: Its poses.
        axes: Dynamics of the four axes.
        pair: `PLANE`, whose motion turns with the heading, or `SIDE`.
        adapt: As for `predict_flight`.
    """
    chosen = [axes[i] for i in pair]
    levels = np.array([axis.levels for axis in chosen]) + seen.rounding[pair, None] * [0.0, 1.0, 0.0, 0.0]
    members = bank_levels(levels, adapt)
    law = np.array([axis.law for axis in chosen])
    filter_law = law.copy()
    filter_law[:, DAMPING] = np.maximum(law[:, DAMPING], LEAST_FILTER_DAMPING)
    position = np.ascontiguousarray(seen.pose[:, pair])
    velocity, tracked, alone = seen.velocity_of(pair)
    forecast = Forecast(
        flight.command_time[commands],
        np.ascontiguousarray(flight.command[commands][:, pair]),
        seen.time,
        position,
        np.ascontiguousarray(seen.pose[:, 3]) if pair == PLANE else np.zeros(seen.time.size),
        *distinct_steps(seen.time),
        law,
        filter_law,
        _origin(chosen, seen.time, position),
        members,
        np.array([axis.trim_variance for axis in chosen]),
        velocity,
        tracked,
        alone,
    )
    damping = np.array([axis.damping for axis in chosen])

    def run(first: Indices, last: Indices, future: Array) -> tuple[Array, Array, StartState]:
        """See `Pair`."""
        out, at_start, rows = forecast.starts(first, last, future)
        return out, at_start, start_state_from_rows(rows, members, damping)

    return run


def _of_four_axes(plane: Array, side: Array) -> Array:
    """Position and velocity of both pairs, shapes (..., 4), as those of four axes, shape (..., 2, 4)."""
    parts = [np.concatenate([plane[..., k : k + 2], side[..., k : k + 2]], axis=-1) for k in (0, 2)]
    return np.stack(parts, axis=-2)


def _origin(axes: Sequence[AxisDynamics], t: Array, pose: Array) -> Array:
    """Velocity about which the laws of two axes are linearised, shape (2,): that of the first poses."""
    if not any(axis.structure.kicks & 5 for axis in axes):
        return np.zeros(2)
    i = min(int(np.searchsorted(t, t[0] + ORIGIN_TIME)), t.size - 1)
    return np.asarray((pose[i] - pose[0]) / max(t[i] - t[0], EDGE))


def hold_velocity(part: Predictions) -> Array:
    """The naive prediction: the world velocity at the start is kept; shape (S, E, 2, 4)."""
    index = np.minimum(part.first[:, None] + np.arange(part.predicted.shape[1]), part.time.size - 1)
    elapsed = part.time[index] - part.time[part.first - 1][:, None]
    velocity = np.broadcast_to(part.begin[:, None, 1], (*index.shape, 4))
    return np.stack([part.begin[:, None, 0] + velocity * elapsed[..., None], velocity], axis=2)


def free_run_prediction(flight: Flight, part: Predictions, input_: Array, damping: Array) -> Array:
    """Prediction by coefficients without delay and disturbance, from the same states; shape (S, E, 2, 4).

    Args:
        flight: Flight that provides the commands.
        part: Predictions that provide starts, states and headings.
        input_: g of the four axes, shape (4,).
        damping: b of the four axes, shape (4,) [1/s].
    """
    law = np.array([law_of(FIRST_ORDER_DELAY, *pair, 0.0, {}) for pair in zip(input_, damping, strict=True)])
    before = part.first - 1
    in_force = np.maximum(np.searchsorted(flight.command_time, part.time[before], side="right") - 1, 0)
    S, out = before.size, np.empty_like(part.predicted)
    nothing = np.empty((S, 0, 6)), np.empty((1, 24, 0)), np.zeros(part.time.size, np.int64)
    for first, turns in ((0, 1.0), (2, 0.0)):
        pair = slice(first, first + 2)
        state = np.zeros((S, RUN))
        state[:, :4] = part.begin[:, :, pair].reshape(S, 4)
        motion = free_runs(
            flight.command_time, np.ascontiguousarray(flight.command[:, pair]), law[pair], part.time, part.first,
            part.last, np.column_stack([in_force, in_force]), state, turns * part.pose[before, 3],
            turns * part.heading, *nothing,
        )  # fmt: skip
        out[..., pair] = motion.reshape(*motion.shape[:2], 2, 2)
    return out


@dataclass(frozen=True)
class Errors:
    """Errors of the predictions from some starts, x and y in the measured heading; far smaller than the predictions.

    Attributes:
        starts: Horizon [s] to the squared errors, start by start.
        steps: Number of predicted velocities up to `FIT_HORIZON`, shape (4,); the other attributes refer to them.
        squares: Sum of their squared errors, shape (4,).
        mean: Mean of the measured velocities there, shape (4,).
        spread: Sum of the squared deviations from that mean, shape (4,).
    """

    starts: Mapping[float, StartErrors]
    steps: Array
    squares: Array
    mean: Array
    spread: Array


def judged(part: Predictions, predicted: Array, horizons: Sequence[float]) -> Errors:
    """Errors at some horizons.

    Args:
        part: The measurements.
        predicted: The predictions for them, (S, E, 2, 4).
        horizons: Horizons [s].
    """
    begin, past = int(part.first[0]), int(part.last.max())
    c, s = np.cos(part.pose[begin:past, 3]), np.sin(part.pose[begin:past, 3])
    measured = part.reference[begin:past].copy()
    x, y = measured[:, 0].copy(), measured[:, 1].copy()
    measured[:, 0], measured[:, 1] = c * x + s * y, c * y - s * x
    place = part.first - begin
    counted = [_complete(part, horizon) for horizon in (FIT_HORIZON, *horizons)]
    ends = np.array([np.where(good, end - part.first, 0) for good, end in counted])
    sums = np.zeros((len(ends), part.start.size, 2, 4))
    moments = np.zeros((3, 4))
    _fill_squares(predicted, measured, c, s, place, ends, np.zeros((2, 4)), sums, moments)
    starts = {}
    for horizon, (good, end), (squares, steps) in zip(
        horizons, counted[1:], sums[1:].transpose(0, 2, 1, 3), strict=True
    ):
        run, last = np.flatnonzero(good), end[good] - 1
        off = predicted[run, last - part.first[good], 0] - part.pose[last]
        off[:, :2] = heading_from_world(off[:, :2], part.pose[last, 3])
        off[:, np.isin(AXES, part.alone)] = np.nan
        starts[horizon] = StartErrors(part.start[good], squares[good], steps[good], off**2)
    return Errors(starts, moments[0], sums[0, :, 0].sum(axis=0), moments[1], moments[2])


@kernel()
def _fill_squares(
    predicted: Array, measured: Array, c: Array, s: Array, place: Any, ends: Any, total: Array, sums: Array,
    moments: Array,
) -> None:  # fmt: skip
    """Sums the squared velocity errors of every start up to some steps, and counts the known ones.

    Args:
        predicted: Shape (S, E, 2, 4).
        measured: Velocity in the measured heading, shape (N, 4); NaN where unknown.
        c: Cosine of that heading, shape (N,).
        s: Its sine, shape (N,).
        place: Index of the first predicted pose of each start, shape (S,).
        ends: Number of steps to sum, shape (H, S); 0 for none.
        total: Work space, shape (2, 4).
        sums: Zeros; filled with sum and number, shape (H, S, 2, 4).
        moments: Zeros; filled for the first of the H, over all starts, with the number of known errors, and mean and
            sum of squared deviations of the measurements there, shape (3, 4).

    Source: B. P. Welford, Technometrics 4 (1962), pp. 419-420, for the deviations.
    """
    for i in range(place.size):
        last = 0
        for h in range(ends.shape[0]):
            last = max(last, ends[h, i])
        for n in range(2):
            for a in range(4):
                total[n, a] = 0.0
        for j in range(last):
            at = place[i] + j
            x, y = predicted[i, j, 1, 0], predicted[i, j, 1, 1]
            for a in range(4):
                value = predicted[i, j, 1, a]
                if a < 2:
                    value = c[at] * x + s[at] * y if a == 0 else c[at] * y - s[at] * x
                error = value - measured[at, a]
                if np.isfinite(error):
                    total[0, a] += error * error
                    total[1, a] += 1.0
                    if j < ends[0, i]:
                        moments[0, a] += 1.0
                        off = measured[at, a] - moments[1, a]
                        moments[1, a] += off / moments[0, a]
                        moments[2, a] += off * (measured[at, a] - moments[1, a])
            for h in range(ends.shape[0]):
                if ends[h, i] == j + 1:
                    for n in range(2):
                        for a in range(4):
                            sums[h, i, n, a] = total[n, a]


def joined(pieces: Sequence[Errors], horizons: Sequence[float]) -> Errors:
    """Merges the errors of several pieces.

    Args:
        pieces: With the same horizons.
        horizons: Those horizons [s].

    Source: T. F. Chan, G. H. Golub, R. J. LeVeque, Am. Stat. 37 (1983), pp. 242-247, for the deviations.
    """
    none = np.empty(0), *(np.empty((0, 4)) for _ in range(3))
    starts = {}
    for horizon in horizons:
        mine = [(e.start, e.velocity, e.steps, e.position) for e in (piece.starts[horizon] for piece in pieces)]
        starts[horizon] = StartErrors(*(np.concatenate(column) for column in zip(none, *mine, strict=True)))
    steps, squares, mean, spread = np.zeros((4, 4))
    for piece in pieces:
        total = np.maximum(steps + piece.steps, 1)
        apart = piece.mean - mean
        spread = spread + piece.spread + apart**2 * steps * piece.steps / total
        mean = mean + apart * piece.steps / total
        steps, squares = steps + piece.steps, squares + piece.squares
    return Errors(starts, steps, squares, mean, spread)


def scores_of(errors: Errors) -> dict[str, AxisScore]:
    """Axis name to the scores computed from errors."""
    return {
        axis: AxisScore({f"{h:g}": _horizon(starts, k) for h, starts in errors.starts.items()}, _fit_percent(errors, k))
        for k, axis in enumerate(AXES)
    }


def score_predictions(
    parts: Sequence[Predictions], predicted: Sequence[Array], horizons: Sequence[float]
) -> dict[str, AxisScore]:
    """Errors of predictions over all segments of a flight, x and y resolved in the measured heading.

    Args:
        parts: The measurements, segment by segment.
        predicted: The predictions for them, each (S, E, 2, 4).
        horizons: Horizons [s].

    Returns:
        Axis name to errors.
    """
    return scores_of(joined([judged(*pair, horizons) for pair in zip(parts, predicted, strict=True)], horizons))


def horizon_errors(parts: Sequence[Predictions], predicted: Sequence[Array], horizon: float) -> dict[str, Horizon]:
    """The errors at a single horizon [s], without `fit_percent`; axis name to errors."""
    errors = start_errors(parts, predicted, horizon)
    return {axis: _horizon(errors, k) for k, axis in enumerate(AXES)}


def start_errors(parts: Sequence[Predictions], predicted: Sequence[Array], horizon: float) -> StartErrors:
    """The squared errors behind the scores at one horizon, x and y resolved in the measured heading.

    Args:
        parts: The measurements, segment by segment.
        predicted: The predictions for them, each (S, E, 2, 4).
        horizon: Horizon [s].
    """
    pieces = [judged(*pair, (horizon,)) for pair in zip(parts, predicted, strict=True)]
    return joined(pieces, (horizon,)).starts[horizon]


def end_errors(part: Predictions, predicted: Array, horizon: float) -> Array:
    """Errors of position and velocity at the horizon itself, in the measured heading, shape (S, 2, 4).

    NaN for starts without poses up to there, or where nothing is measured.

    Args:
        part: The measurements of a segment.
        predicted: The predictions for them, (S, E, 2, 4).
        horizon: Horizon [s].
    """
    good, end = _complete(part, horizon)
    out, at = np.full((part.start.size, 2, 4), np.nan), end[good] - 1
    runs = predicted[good, at - part.first[good]]
    for i, measured in enumerate((part.pose, part.reference)):
        error = runs[:, i] - measured[at]
        error[:, :2] = heading_from_world(error[:, :2], part.pose[at, 3])
        out[good, i] = error
    out[:, 0, np.isin(AXES, part.alone)] = np.nan
    return out


def _complete(part: Predictions, horizon: float) -> tuple[Mask, Indices]:
    """Which starts have poses up to the horizon without a gap, and one past the last pose of each, shape (S,)."""
    target = part.start + horizon
    end = np.searchsorted(part.time, target + EDGE)  # one past the last pose within the horizon
    good = (
        (end > part.first)
        & (end <= part.last)
        & (part.time[end - 1] > target - 3 * part.period)
        & (part.holes[end - 1] == part.holes[part.first - 1])
    )
    return good, end


def _horizon(errors: StartErrors, k: int) -> Horizon:
    steps, position = float(errors.steps[:, k].sum()), errors.position[:, k]
    placed = not np.isnan(position).all()
    if position.size < LEAST_SCORES or not steps or (placed and not np.isfinite(position).all()):
        return Horizon(None, None, int(position.size))
    end = float(np.sqrt(np.mean(position))) if placed else None
    return Horizon(float(np.sqrt(errors.velocity[:, k].sum() / steps)), end, int(position.size))


def _fit_percent(errors: Errors, k: int) -> float | None:
    spread = float(np.sqrt(errors.spread[k]))
    return float(100 * (1 - np.sqrt(errors.squares[k]) / spread)) if spread > 0 else None
