"""The prediction protocol: one implementation for validation, comparison, report, benchmark and the choice of a mode.

Each segment of a flight first gives 2 s to the causal filter; starts follow every 0.5 s. At a start the state comes
from the filter on data up to that instant; from there only the commands are known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorfit.core.flight_data import LONGEST_GAP, Flight, Segment
from rotorfit.core.frames import AXES, Array, Indices, Mask, heading_from_world
from rotorfit.core.laws import DAMPING, FIRST_ORDER_DELAY, Structure, law_of
from rotorfit.core.results import AxisScore, Horizon, StartErrors
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.filter_bank import StartState, bank_levels, start_state_from_rows
from rotorfit.dynamics.kinematics import seen_in
from rotorfit.dynamics.predictor import free_run, predict

SETTLING = 2.0
"""Time that a segment gives to the filter before the first start [s]."""

START_EVERY = 0.5
"""Time between starts [s]."""

FIT_HORIZON = 1.0
"""Horizon of `fit_percent` [s]."""

LEAST_SCORES = 5
"""Fewer predictions than this give no score."""

LEAST_FILTER_DAMPING = 1e-3
"""Damping below which the filter does not go, where a model is unstable [1/s]; the prediction itself does."""

ORIGIN_TIME = 0.2
"""Over so much of a segment its first velocity is measured [s]; quadratic drag is linear only about some velocity."""

EDGE = 1e-9


@dataclass(frozen=True)
class AxisDynamics:
    """One axis as prediction needs it.

    Attributes:
        input: g; 0 where the axis has no model, then only the disturbance filter tracks it.
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
        """Numbers of the general law, shape (LAW_SIZE,)."""
        return law_of(self.structure, self.input, self.damping, self.delay, self.extra)


UNMODELLED = AxisDynamics(0.0, 1.0, 0.0, (0.1, 1e-7, 2.5, 0.64), 1e-6)
"""An axis of which nothing is known: its velocity is tracked and fades."""


@dataclass(frozen=True)
class Predictions:
    """All predictions in one segment. N poses, S starts, E predicted poses at the most.

    Attributes:
        time: Stamps of the poses, shape (N,) [s].
        pose: Measured x, y, z, yaw, shape (N, 4).
        reference: Their velocity from a centred local cubic, shape (N, 4); NaN where there is none.
        start: Shape (S,) [s].
        first: Index of the first predicted pose of each start, shape (S,).
        last: One past the last, shape (S,).
        predicted: World position and velocity, (S, E, 2, 4); NaN beyond `last`.
        begin: The filter's position and velocity at the last pose before the start, shape (S, 2, 4).
        heading: Heading that the horizontal prediction used, shape (S, E).
        alone: Axes of which only the velocity is measured: their positions prove nothing.
        states: At the starts, of x and y, and of z and yaw; None where neither was wanted.
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
    alone: tuple[str, ...] = ()
    states: tuple[StartState | None, StartState | None] = (None, None)


def predict_flight(
    flight: Flight, dynamics: Mapping[str, AxisDynamics], longest: float, axes: Sequence[str] = AXES, adapt: bool = True
) -> tuple[Predictions, ...]:
    """Predicts from every start of every segment that is long enough.

    Args:
        flight: Commands and poses.
        dynamics: Axis name to its dynamics; a missing axis is `UNMODELLED`, a missing yaw is taken as measured.
        longest: Horizon up to which to predict [s].
        axes: Those that are wanted; the others' predictions are left NaN.
        adapt: Whether the filter learns the levels of this flight from its past; else those of the dynamics stay.
    """
    parts = (_predict_segment(flight, segment, dynamics, longest, axes, adapt) for segment in flight.segments)
    return tuple(part for part in parts if part is not None)


def _predict_segment(
    flight: Flight,
    segment: Segment,
    dynamics: Mapping[str, AxisDynamics],
    longest: float,
    wanted: Sequence[str],
    adapt: bool,
) -> Predictions | None:
    """Predicts from every start of one segment; z and yaw first, since x and y need the heading that yaw predicts.

    None where the segment has no start with a pose before and behind it. The poses of the longest delay at its
    beginning are left out: what was commanded before it still acts there.
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
        return None
    used = (flight.command_time >= segment.start - EDGE) & (flight.command_time <= segment.end + EDGE)
    reach = np.arange(int((last - first).max()))
    index = np.minimum(first[:, None] + reach, t.size - 1)

    def run(pair: Sequence[int], yaw: Array, future: Array) -> tuple[Array, Array, StartState | None]:
        """Filters two axes through the segment and predicts them from every start.

        Args:
            pair: Places of the two in `AXES`: x and y, which the heading turns into each other, or z and yaw.
            yaw: Heading at the poses, which the filter sees, shape (N,) [rad]; 0 for z and yaw.
            future: Heading on the way of each prediction, shape (S, E) [rad]: measured or predicted, never both.

        Returns:
            Position and velocity of the two at the poses after each start, shape (S, E, 4), and at the start, (S, 4),
            and the state there; NaN and None where neither is wanted.
        """
        chosen = [axes[i] for i in pair]
        if not any(AXES[i] in wanted for i in pair):
            return np.full((*index.shape, 4), np.nan), np.full((start.size, 4), np.nan), None
        levels = np.array([axis.levels for axis in chosen]) + seen.rounding[pair, None] * [0.0, 1.0, 0.0, 0.0]
        members = bank_levels(levels, adapt)
        law = np.array([axis.law for axis in chosen])
        filter_law = law.copy()
        filter_law[:, DAMPING] = np.maximum(law[:, DAMPING], LEAST_FILTER_DAMPING)
        velocity, tracked, alone = seen.velocity_of(pair)
        out, begin, rows = predict(
            flight.command_time[used],
            np.ascontiguousarray(flight.command[used][:, pair]),
            t,
            np.ascontiguousarray(pose[:, pair]),
            yaw,
            *distinct_steps(t),
            law,
            filter_law,
            _origin(chosen, t, pose[:, pair]),
            members,
            np.array([axis.trim_variance for axis in chosen]),
            first,
            last,
            future,
            velocity,
            tracked,
            alone,
        )
        return out, begin, start_state_from_rows(rows, members, np.array([axis.damping for axis in chosen]))

    side, side_begin, side_state = run([2, 3], np.zeros(t.size), np.zeros(index.shape))
    heading = np.nan_to_num(side[:, :, 1]) if "yaw" in dynamics and "yaw" in wanted else pose[:, 3][index]
    plane, plane_begin, plane_state = run([0, 1], np.ascontiguousarray(pose[:, 3]), np.ascontiguousarray(heading))
    return Predictions(
        time=t,
        pose=pose,
        reference=seen.reference,
        start=start,
        first=first,
        last=last,
        predicted=np.stack(
            [np.concatenate([plane[..., k : k + 2], side[..., k : k + 2]], axis=-1) for k in (0, 2)], axis=2
        ),
        begin=np.stack(
            [np.concatenate([plane_begin[:, k : k + 2], side_begin[:, k : k + 2]], axis=-1) for k in (0, 2)], axis=1
        ),
        heading=heading,
        alone=flight.velocity_only,
        states=(plane_state, side_state),
    )


def _origin(axes: Sequence[AxisDynamics], t: Array, pose: Array) -> Array:
    """The velocity at the start about which the laws of two axes are linear, shape (2,): that of the first poses."""
    if not any(axis.structure.kicks % 2 for axis in axes):
        return np.zeros(2)
    i = min(int(np.searchsorted(t, t[0] + ORIGIN_TIME)), t.size - 1)
    return np.asarray((pose[i] - pose[0]) / max(t[i] - t[0], EDGE))


def hold_velocity(part: Predictions) -> Array:
    """The naive prediction: the world velocity of the start is kept; shape (S, E, 2, 4)."""
    index = np.minimum(part.first[:, None] + np.arange(part.predicted.shape[1]), part.time.size - 1)
    elapsed = part.time[index] - part.time[part.first - 1][:, None]
    velocity = np.broadcast_to(part.begin[:, None, 1], (*index.shape, 4))
    return np.stack([part.begin[:, None, 0] + velocity * elapsed[..., None], velocity], axis=2)


def free_run_prediction(flight: Flight, part: Predictions, input_: Array, damping: Array) -> Array:
    """What coefficients without delay and disturbance predict from the same states; shape (S, E, 2, 4).

    Args:
        flight: Whose commands are used.
        part: Predictions whose starts, states and headings are taken.
        input_: g of the four axes, shape (4,).
        damping: b of the four axes, shape (4,) [1/s].
    """
    out = np.full_like(part.predicted, np.nan)
    law = np.array([law_of(FIRST_ORDER_DELAY, *pair, 0.0, {}) for pair in zip(input_, damping, strict=True)])
    pairs = ([0, 1], [2, 3])
    commands = [np.ascontiguousarray(flight.command[:, pair]) for pair in pairs]
    in_force = np.maximum(np.searchsorted(flight.command_time, part.time[part.first - 1], side="right") - 1, 0)
    for s, (first, last, k) in enumerate(zip(part.first, part.last, in_force, strict=True)):
        t = part.time[first - 1 : last]
        heading = np.concatenate([part.pose[first - 1 : first, 3], part.heading[s, : last - first]])
        for pair, command, yaw in zip(pairs, commands, (heading, np.zeros(t.size)), strict=True):
            motion = free_run(
                flight.command_time[k:],
                command[k:],
                law[pair],
                part.begin[s, 0, pair],
                part.begin[s, 1, pair],
                t,
                yaw,
            )
            out[s, : last - first, 0, pair] = motion[1:, :2].T
            out[s, : last - first, 1, pair] = motion[1:, 2:].T
    return out


def score_predictions(
    parts: Sequence[Predictions], predicted: Sequence[Array], horizons: Sequence[float]
) -> dict[str, AxisScore]:
    """Errors of predictions over all segments of a flight, x and y resolved in the measured heading.

    Args:
        parts: What was measured, segment by segment.
        predicted: What was predicted there, each (S, E, 2, 4).
        horizons: [s].

    Returns:
        Axis name to errors.
    """
    scores: list[dict[str, Horizon]] = [{} for _ in AXES]
    for h in horizons:
        errors = _all_errors(parts, predicted, h)
        for k, score in enumerate(scores):
            score[f"{h:g}"] = _horizon(errors, k)
    errors = _all_errors(parts, predicted, FIT_HORIZON)
    return {axis: AxisScore(scores[k], _fit_percent(errors, k)) for k, axis in enumerate(AXES)}


def horizon_errors(parts: Sequence[Predictions], predicted: Sequence[Array], horizon: float) -> dict[str, Horizon]:
    """The same at one horizon, without the rest; axis name to errors."""
    errors = _all_errors(parts, predicted, horizon)
    return {axis: _horizon(errors, k) for k, axis in enumerate(AXES)}


def start_errors(parts: Sequence[Predictions], predicted: Sequence[Array], horizon: float) -> StartErrors:
    """The squared errors behind the scores at one horizon, x and y resolved in the measured heading.

    Args:
        parts: What was measured, segment by segment.
        predicted: What was predicted there, each (S, E, 2, 4).
        horizon: [s].
    """
    starts, sums, counts, ends = [np.empty(0)], [np.empty((0, 4))], [np.empty((0, 4))], [np.empty((0, 4))]
    for part, values in zip(parts, predicted, strict=True):
        velocity, _, position = _errors(part, values, horizon)
        good, end = _complete(part, horizon)
        run = np.repeat(np.arange(len(position)), end[good] - part.first[good])
        known = np.isfinite(velocity)
        starts.append(part.start[good])
        for out, column in ((sums, np.where(known, velocity, 0.0) ** 2), (counts, known.astype(float))):
            out.append(np.stack([np.bincount(run, c, len(position)) for c in column.T], axis=1))
        ends.append(position**2)
    return StartErrors(*(np.concatenate(pieces) for pieces in (starts, sums, counts, ends)))


def end_errors(part: Predictions, predicted: Array, horizon: float) -> Array:
    """Errors of position and velocity at the horizon itself, in the measured heading, shape (S, 2, 4).

    NaN for starts without poses up to there, or where nothing is measured.

    Args:
        part: What was measured in a segment.
        predicted: What was predicted there, (S, E, 2, 4).
        horizon: [s].
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


def _all_errors(parts: Sequence[Predictions], predicted: Sequence[Array], horizon: float) -> tuple[Array, Array, Array]:
    """Of all segments in a row; see `_errors`."""
    pieces = [_errors(part, values, horizon) for part, values in zip(parts, predicted, strict=True)]
    velocity, measured, position = (np.concatenate([p[i] for p in pieces] or [np.empty((0, 4))]) for i in range(3))
    return velocity, measured, position


def _complete(part: Predictions, horizon: float) -> tuple[Mask, Indices]:
    """Which starts have poses up to the horizon and no hole before it, and one past the last pose of each, (S,)."""
    time, period = part.time, float(np.median(np.diff(part.time)))
    target = part.start + horizon
    end = np.searchsorted(time, target + EDGE)  # one past the last pose within the horizon
    gaps = np.concatenate([[0], np.cumsum(np.diff(time) > LONGEST_GAP)])
    good = (
        (end > part.first)
        & (end <= part.last)
        & (time[end - 1] > target - 3 * period)
        & (gaps[end - 1] == gaps[part.first - 1])
    )
    return good, end


def _errors(part: Predictions, predicted: Array, horizon: float) -> tuple[Array, Array, Array]:
    """In the measured heading: errors of velocity and velocities of all steps (n, 4), errors of end points (m, 4)."""
    good, end = _complete(part, horizon)
    first, end, run = part.first[good], end[good], np.flatnonzero(good)
    if not first.size:
        return np.empty((0, 4)), np.empty((0, 4)), np.empty((0, 4))
    start, step = np.nonzero(np.arange(predicted.shape[1]) < (end - first)[:, None])
    at = first[start] + step
    velocity = predicted[run[start], step, 1] - part.reference[at]
    measured = part.reference[at].copy()
    position = predicted[run, end - first - 1, 0] - part.pose[end - 1]
    for vector, yaw in ((velocity, part.pose[at, 3]), (measured, part.pose[at, 3]), (position, part.pose[end - 1, 3])):
        vector[:, :2] = heading_from_world(vector[:, :2], yaw)
    position[:, np.isin(AXES, part.alone)] = np.nan
    return velocity, measured, position


def _horizon(errors: tuple[Array, Array, Array], k: int) -> Horizon:
    velocity, _, position = (e[:, k] for e in errors)
    velocity = velocity[np.isfinite(velocity)]
    placed = not np.isnan(position).all()
    if position.size < LEAST_SCORES or not velocity.size or (placed and not np.isfinite(position).all()):
        return Horizon(None, None, int(position.size))
    end = float(np.sqrt(np.mean(position**2))) if placed else None
    return Horizon(float(np.sqrt(np.mean(velocity**2))), end, int(position.size))


def _fit_percent(errors: tuple[Array, Array, Array], k: int) -> float | None:
    error, measured, _ = (e[:, k] for e in errors)
    good = np.isfinite(error)
    spread = float(np.linalg.norm(measured[good] - measured[good].mean())) if good.any() else 0.0
    return float(100 * (1 - np.linalg.norm(error[good]) / spread)) if spread > 0 else None
