"""The motion at the last pose: velocity, wind, and the velocity predicted a second ahead.

The law is integrated from the start of the segment, and a filter estimates what the commands do not explain: position,
velocity and acceleration n, s, s' of the disturbance (see `dynamics.disturbance`). With the trim c, the unexplained
acceleration is c + b s + s'; where the damping b is the drag of the air, the wind blows at (c + b s + s') / b.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world, world_from_heading
from rotorfit.core.laws import DAMPING, FIRST_ORDER_DELAY, TRIM, law_of
from rotorfit.core.model import NORMAL, Interval
from rotorfit.core.tracked import Air
from rotorfit.dynamics.motion_filter import SAMPLES, MotionFilter, motion_filter
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.extra_parameters import structure_at
from rotorfit.tracking.drag import is_drag
from rotorfit.tracking.wind_error import Doubt, coefficient_doubt, trim_error


@dataclass(frozen=True)
class AxisNow:
    """One axis at the last pose.

    Attributes:
        velocity: World x, y, z or the rate of yaw [m/s, rad/s].
        wind: Acceleration that the commands do not explain, including the trim; x and y in the heading frame, if both
            are known [m/s^2, rad/s^2].
        wind_error: Its standard error under the coefficients as estimated [m/s^2, rad/s^2].
        gusts: Standard deviation of the disturbance's velocity [m/s, rad/s].
        ahead: Velocity a second later if the last command holds, in the frame of `velocity` [m/s, rad/s].
        ahead_error: Its standard error [m/s, rad/s].
    """

    velocity: float
    wind: float
    wind_error: float
    gusts: float
    ahead: float
    ahead_error: float


Pair = tuple[str, str]
PAIRS: tuple[Pair, ...] = (("x", "y"), ("z", "yaw"))
"""Axes that share a filter."""

ALONG = 0.1
"""Largest angle between the heading and the world's x at which x or y alone has a motion [rad]: beyond it, the force on
it lies along both axes of the world."""

STILL = (0.0, 1.0, 0.0)
"""Input, damping and delay that stand in for an axis without an estimate, to complete its pair."""


@dataclass(frozen=True)
class Course:
    """The filter of two axes at the last pose of a flight, ready to be continued.

    Attributes:
        axes: The axes of the pair that have an estimate.
        filter: The filter with its state.
        in_force: Times of the commands that `filter.k` points at [s], shape (2, 2).
    """

    axes: tuple[str, ...]
    filter: MotionFilter
    in_force: Array


def courses(
    flight: Flight, estimates: Mapping[str, Estimate], damping: Mapping[str, Interval]
) -> tuple[dict[str, AxisNow], Air | None, tuple[Course, ...]]:
    """The motion of each estimated axis at the last pose, the mean wind, and the filters behind both.

    Args:
        flight: The flight so far.
        estimates: Axis name to its estimate.
        damping: Axis name to the 95 % interval of its damping [1/s]; without closed intervals for x and y there is no
            mean wind.

    Returns:
        Axis name to its motion, without the axes of which the last segment is too short; the mean wind, or None; a
        filter for each pair of axes.
    """
    out: dict[str, AxisNow] = {}
    air, found = None, []
    for pair in PAIRS:
        known = {axis: estimates[axis] for axis in pair if axis in estimates and axis not in flight.velocity_only}
        if pair == PAIRS[0] and len(known) == 1 and abs(np.angle(np.exp(1j * flight.yaw[-1]))) > ALONG:
            continue  # alone it was fitted along the heading, and this filter's axes are those of the world
        if known and (filtered := _filtered(flight, pair, known, damping)):
            running, wind = filtered
            force = flight.command_time[running.k]
            motion = running.motion(flight.command_time, flight.command)
            out |= {axis: AxisNow(*motion[pair.index(axis)].tolist()) for axis in known}
            found.append(Course(tuple(known), running, force))
            air = air or wind
    return out, air, tuple(found)


def doubts_of(
    flight: Flight,
    estimates: Mapping[str, Estimate],
    widened: Mapping[str, Mapping[str, float]],
    moving: Mapping[str, AxisNow],
) -> dict[str, Doubt]:
    """Axis name to the errors of its motion due to its coefficients, of every estimated axis that has a motion.

    Args:
        flight: The flight so far.
        estimates: Axis name to its estimate.
        widened: Axis name to what `coefficient_doubt` takes.
        moving: Axis name to its motion.
    """
    turn = float(flight.yaw[-1])
    along = {axis: np.array([one.velocity, one.ahead]) for axis, one in moving.items()}
    if {"x", "y"} <= along.keys():
        in_heading = heading_from_world(np.column_stack([along["x"], along["y"]]), np.full(2, turn))
        along |= dict(zip(("x", "y"), in_heading.T, strict=True))
    out = {
        axis: coefficient_doubt(flight, axis, one, widened[axis], (along[axis][0], along[axis][1]))
        for axis, one in estimates.items()
        if axis in moving
    }
    if {"x", "y"} <= out.keys():  # the prediction is in the world, the wind along the heading
        parts = world_from_heading(np.diag([out["x"].ahead, out["y"].ahead]), np.full(2, turn))
        for axis, each in zip(("x", "y"), parts.T, strict=True):
            out[axis] = replace(out[axis], ahead=float(np.hypot(*each)))
    return out


def _filtered(
    flight: Flight, pair: Pair, known: Mapping[str, Estimate], damping: Mapping[str, Interval]
) -> tuple[MotionFilter, Air | None] | None:
    """The filter of a pair of axes at the last pose, and the mean wind; None if there are too few poses."""
    first = next(iter(known.values()))
    begin = float(first.records[-1].starts[-1])
    start = _start(flight, pair, known, begin)
    if flight.pose_time[-1] - begin > LOOKS_BACK:
        begin = float(flight.pose_time[-1]) - LOOKS_BACK
        start = _measured(flight, pair, begin)
    i = int(np.searchsorted(flight.pose_time, begin))
    time, heading = flight.pose_time[i:], flight.yaw[i:]
    if time.size < LEAST:
        return None
    keep = np.unique(np.searchsorted(time, np.arange(time[0], time[-1], 1 / SAMPLES)))
    keep = np.append(keep[keep < time.size - 1], time.size - 1)
    time, heading, position = time[keep], heading[keep], flight.position[i:][keep]
    turns, commands = pair == ("x", "y"), (flight.command_time, flight.command)
    laws = np.array([_law(known.get(axis)) for axis in pair])
    levels = np.array([_levels(known.get(axis)) for axis in pair])
    first_pose = position[0, :2] if turns else np.array([position[0, 2], heading[0]])
    told = np.array([axis in known for axis in pair])
    running = motion_filter(begin, first_pose, start, float(heading[0]), *commands, laws, levels, told, turns)
    states = running.follow(time, position, heading, *commands)
    if not (turns and all(told) and all(is_drag(flight.card, axis) for axis in pair)):
        return running, None
    factors = [_factors(law[DAMPING], *damping.get(axis, (None, None))) for axis, law in zip(pair, laws, strict=True)]
    trims = np.array([trim_error(known[axis]) for axis in pair])
    return running, _air(time, heading, laws, states, [one for one in factors if one], trims)


def _factors(damping: float, low: float | None, high: float | None) -> tuple[float, float] | None:
    """Smallest and largest factor on the wind that an interval of the damping allows; None if an end is open."""
    if low is None or high is None or low <= 0:
        return None
    return min(damping / high, 1.0), max(damping / low, 1.0)


def _air(
    time: Array, heading: Array, laws: Array, states: Array, factors: Sequence[tuple[float, float]], trims: Array
) -> Air | None:
    """The mean wind, for commands that are tilts, so that the damping is the air's drag; None before `AVERAGED` s.

    It is (c + s') / b + s of each axis of the heading frame, rotated into the world. The acceleration is measured, so
    the wind scales with 1 / b: the interval of b sets that of the wind, which reaches further up than down. The scatter
    of the gusts and the errors `trims` of c [m/s^2] add to it; in still air they are all that is left. There the speed
    is a distance in two directions: its interval begins above 0 only where 0 lies outside of the 95 % region of both
    components.
    """
    settled = time > time[0] + AVERAGED / 2
    if time[-1] - time[0] < AVERAGED or len(factors) < 2:
        return None
    s, change = (states[settled][:, :, i] for i in (1, 2))
    damping, turn = laws[:, DAMPING], heading[settled]
    pushed = (heading_from_world(change, turn) + laws[:, TRIM]) / damping + heading_from_world(s, turn)
    wind = world_from_heading(pushed, turn)
    mean, part = wind.mean(axis=0), np.floor((time[settled] - time[settled][0]) / ALIKE).astype(int)
    part = np.unique(part, return_inverse=True)[1]  # a part without a pose has no mean
    if part[-1] < 1:
        return None
    parts = np.column_stack([np.bincount(part, w) / np.bincount(part) for w in wind.T])
    of_axes = [world_from_heading(pushed * (np.arange(2) == k), turn).mean(axis=0) for k in range(2)]
    missed = [world_from_heading(np.tile(one, (turn.size, 1)), turn).mean(axis=0) for one in np.diag(trims / damping)]
    scatter = np.diag(parts.var(axis=0, ddof=1) / len(parts)) + np.transpose(missed) @ missed

    def reach(along: Array) -> tuple[float, float]:
        """How far the interval reaches below and above the mean along a direction."""
        ends = np.array(
            [[share @ along * (factor - 1.0) for factor in two] for share, two in zip(of_axes, factors, strict=True)]
        )
        even = NORMAL**2 * float(along @ scatter @ along)
        below, above = np.minimum(ends.min(axis=1), 0.0), np.maximum(ends.max(axis=1), 0.0)
        return float(np.sqrt(even + below @ below)), float(np.sqrt(even + above @ above))

    speed = float(np.hypot(*mean))
    below, above = reach(mean / speed)
    right, left = (min(one / speed, np.pi) for one in reach(np.array([-mean[1], mean[0]]) / speed))
    angle = float(np.arctan2(mean[1], mean[0]))
    blows = speed**2 > PLANE**2 * float(mean @ scatter @ mean) / speed**2
    low = max(speed - below, 0.0) if blows else 0.0
    return Air(speed, (low, speed + above), angle, (angle - right, angle + left))


PLANE = float(np.sqrt(-2 * np.log(0.05)))
"""Radius of the 95 % region of two independent normal values of standard deviation 1."""

AVERAGED, ALIKE = 10.0, 3.0
"""Time before a mean wind is given; time within which gusts count as one independent sample [s]."""


LOOKS_BACK, SLOPE = 40.0, 0.3
"""How far back the filter starts at most; time over which the velocity there is measured [s]. The disturbance absorbs
the error of that velocity."""


def _measured(flight: Flight, pair: Pair, time: float) -> Array:
    """World velocity of a pair around a time, from the poses, shape (2,) [m/s, rad/s]."""
    low, high = np.searchsorted(flight.pose_time, [time - SLOPE / 2, time + SLOPE / 2])
    low = min(int(low), flight.pose_time.size - 2)
    high = max(min(int(high), flight.pose_time.size - 1), low + 1)
    moved = np.append(flight.position[high] - flight.position[low], flight.yaw[high] - flight.yaw[low])
    elapsed = flight.pose_time[high] - flight.pose_time[low]
    return np.asarray(moved[[AXES.index(axis) for axis in pair]] / elapsed)


LEAST = 10
"""Fewest poses for the filter."""


def _law(estimate: Estimate | None) -> Array:
    """Parameters of the law of an axis, including its trim; without an estimate, those of an axis at rest."""
    if estimate is None:
        return law_of(FIRST_ORDER_DELAY, *STILL, {})
    point, k = estimate.optimum.point, estimate.place
    structure = structure_at(estimate.optimum, k)
    out = law_of(structure, point.gain[k], np.exp(point.log_damping[k]), point.delay[k], point.extra_values(k))
    out[TRIM] = point.trim[-1, k]
    return out


def _levels(estimate: Estimate | None) -> Array:
    """Levels q, r, alpha, kappa of the disturbance of an axis, shape (4,)."""
    return np.ones(4) if estimate is None else np.exp(estimate.optimum.point.levels[estimate.place, :4])


def _start(flight: Flight, pair: Pair, known: Mapping[str, Estimate], begin: float) -> Array:
    """World velocity of a pair at the start of the last segment of its first axis, shape (2,) [m/s, rad/s]."""
    if any(one.records[-1].starts[-1] != begin for one in known.values()):
        return _measured(flight, pair, begin)  # an axis that was fitted only where it is commanded begins elsewhere
    out = np.zeros(2)
    for k, axis in enumerate(pair):
        if axis in known:
            one = known[axis]
            out[k] = one.optimum.point.start[-1, one.place]
    first = next(iter(known.values()))
    if pair == ("x", "y") and first.optimum.point.gain.size == 1:  # along and across the heading that was held
        out = world_from_heading(out[None], np.array([first.records[-1].heading]))[0]
    return out
