"""Where the vehicle is in its motion: velocity, what the air does to it, and where it will be in a second.

The driven motion of the law from the start of the segment, and beside it a filter of what the commands do not explain:
position, velocity and acceleration n, s, s' of the disturbance (see `dynamics.disturbance`). What acts on the vehicle
is then c + b s + s', the trim with it: through a drag b, air that moves at (c + b s + s') / b.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Indices, heading_from_world, world_from_heading
from rotorfit.core.laws import DAMPING, FIRST_ORDER_DELAY, TRIM, law_of
from rotorfit.core.limits import meaning_of
from rotorfit.core.tracked import Air
from rotorfit.dynamics.disturbance import discretize, distinct_steps, stationary
from rotorfit.dynamics.disturbance_state import disturbance_states
from rotorfit.dynamics.predictor import free_run
from rotorfit.estimation.identifiability import NORMAL
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.extra_parameters import structure_at
from rotorfit.estimation.likelihood.likelihood import inverted

AHEAD = 1.0
"""How far the prediction goes [s]."""


@dataclass(frozen=True)
class AxisMotion:
    """One axis at the last pose.

    Attributes:
        velocity: World x, y, z or the rate of yaw [m/s, rad/s].
        wind: Acceleration that the commands do not explain; x and y in the world [m/s^2, rad/s^2].
        wind_error: Its standard error.
        gusts: Standard deviation of the disturbance's velocity [m/s, rad/s].
        ahead: Velocity a second later if the last command holds.
        ahead_error: Its standard error.
    """

    velocity: float
    wind: float
    wind_error: float
    gusts: float
    ahead: float
    ahead_error: float


State = tuple[Array, Array, Array]
"""Levels of an axis, means (B, 3) and covariances (B, 3, 3) of n, s and s' at the poses."""

SAMPLES = 30.0
"""Poses a second that the filter takes [1/s]: as many as the likelihood's blocks."""

STILL = (0.0, 1.0, 0.0)
"""Input, damping and delay of an axis that is not told: it only keeps the other company."""


def motion_now(
    flight: Flight, estimates: Mapping[str, Estimate], wider: Mapping[str, float] = MappingProxyType({})
) -> tuple[dict[str, AxisMotion], Air | None]:
    """The motion at the last pose of the axes that are told; none where the last segment is too short. And the wind.

    Args:
        flight: So far.
        estimates: Axis name to its estimate.
        wider: Axis name to how much wider the damping's interval is than the information says; 1 without.
    """
    out: dict[str, AxisMotion] = {}
    air = None
    for pair in (("x", "y"), ("z", "yaw")):
        known = {axis: estimates[axis] for axis in pair if axis in estimates and axis not in flight.velocity_only}
        if known:
            motion, wind = _of_pair(flight, pair, known, wider)
            out, air = out | motion, air or wind
    return out, air


def _of_pair(
    flight: Flight, pair: tuple[str, str], known: Mapping[str, Estimate], wider: Mapping[str, float]
) -> tuple[dict[str, AxisMotion], Air | None]:
    """Two axes that predict together, at the last pose."""
    first = next(iter(known.values()))
    begin = float(first.records[-1].starts[-1])
    start = _start(pair, known)
    if flight.pose_time[-1] - begin > LOOKS_BACK:
        begin = float(flight.pose_time[-1]) - LOOKS_BACK
        start = _measured(flight, pair, begin)
    i = int(np.searchsorted(flight.pose_time, begin))
    time, heading = flight.pose_time[i:], flight.yaw[i:]
    if time.size < LEAST:
        return {}, None
    keep = np.unique(np.searchsorted(time, np.arange(time[0], time[-1], 1 / SAMPLES)))
    keep = np.append(keep[keep < time.size - 1], time.size - 1)
    time, heading = time[keep], heading[keep]
    column, level = [AXES.index(axis) for axis in pair], pair == ("z", "yaw")
    turn = np.zeros(time.size) if level else heading
    pose = np.column_stack([flight.position, flight.yaw])[i:][keep][:, column]
    laws = np.array([_law(known.get(axis)) for axis in pair])
    driven = free_run(
        flight.command_time, np.ascontiguousarray(flight.command[:, column]), laws, pose[0], start,
        np.concatenate([[begin], time, [time[-1] + AHEAD]]), np.concatenate([turn[:1], turn, turn[-1:]]),
    )  # fmt: skip
    steps, step = distinct_steps(time)
    found = {axis: _disturbed(known[axis], steps, step, pose[:, k] - driven[1:-1, k]) for k, axis in enumerate(pair)
             if axis in known}  # fmt: skip
    moved = {axis: _at_last(laws[pair.index(axis)], state, driven[:, 2 + pair.index(axis)])
             for axis, state in found.items()}  # fmt: skip
    if level:
        return moved, None
    drag = all(meaning_of(flight.card, axis).asked == "tilt" for axis in pair)
    air = None
    if drag and len(found) == 2:
        errors = [wider.get(axis, 1.0) * _damping_error(known[axis]) for axis in pair]
        air = _air(time, heading, laws, [found[axis] for axis in pair], errors)
    return _with_heading(moved, laws, found, float(heading[-1])), air


def _damping_error(estimate: Estimate) -> float:
    """Standard error of the logarithm of the damping."""
    optimum, k = estimate.optimum, estimate.place
    at = optimum.point.place("damping", k)
    return float(np.sqrt(inverted(optimum.score.information, optimum.free)[at, at]))


def _air(
    time: Array, heading: Array, laws: Array, states: Sequence[State], damping_error: Sequence[float]
) -> Air | None:
    """The mean wind, from the drag that the law's damping is where commands are tilts; None before `AVERAGED` seconds.

    (c + s') / b + s of each axis of the heading frame, turned into the world. What acts is measured, so that all of
    this goes by 1 / b: how far b is known tells how far the wind is.
    """
    settled = time > time[0] + AVERAGED / 2
    if time[-1] - time[0] < AVERAGED:
        return None
    s, change = (np.column_stack([means[settled, i] for _, means, _ in states]) for i in (1, 2))
    damping, turn = laws[:, DAMPING], heading[settled]
    pushed = (heading_from_world(change, turn) + laws[:, TRIM]) / damping + heading_from_world(s, turn)
    wind = world_from_heading(pushed, turn)
    mean, part = wind.mean(axis=0), np.floor((time[settled] - time[settled][0]) / ALIKE).astype(int)
    parts = np.column_stack([np.bincount(part, w) / np.bincount(part) for w in wind.T])
    covariance = np.diag(parts.var(axis=0, ddof=1) / len(parts))
    for k, error in enumerate(damping_error):
        slope = world_from_heading(pushed * (np.arange(2) == k), turn).mean(axis=0)
        covariance += np.outer(slope, slope) * error**2
    speed = float(np.hypot(*mean))
    ahead, across = mean / speed, np.array([-mean[1], mean[0]]) / speed
    off, turned = (float(np.sqrt(direction @ covariance @ direction)) for direction in (ahead, across))
    angle = float(np.arctan2(mean[1], mean[0]))
    wide = NORMAL * min(turned / speed, np.pi / NORMAL)
    return Air(speed, (max(speed - NORMAL * off, 0.0), speed + NORMAL * off), angle, (angle - wide, angle + wide))


AVERAGED, ALIKE = 10.0, 3.0
"""The mean wind is told after so long; over the second, gusts are taken as one [s]."""


LOOKS_BACK, SLOPE = 40.0, 0.3
"""The motion is followed from at most so long ago [s]; the velocity there is measured over `SLOPE` [s], and what is
wrong with it is the disturbance's."""


def _measured(flight: Flight, pair: tuple[str, str], time: float) -> Array:
    """World velocity of a pair as the poses show it."""
    pose = np.column_stack([flight.position, flight.yaw])[:, [AXES.index(axis) for axis in pair]]
    low, high = np.searchsorted(flight.pose_time, [time - SLOPE / 2, time + SLOPE / 2])
    low = min(int(low), flight.pose_time.size - 2)
    high = max(min(int(high), flight.pose_time.size - 1), low + 1)
    return np.asarray((pose[high] - pose[low]) / (flight.pose_time[high] - flight.pose_time[low]))


LEAST = 10
"""Poses below which the filter has seen nothing."""


def _law(estimate: Estimate | None) -> Array:
    """Numbers of the law of an axis, its trim with them; of one that is not told, of an axis that rests."""
    if estimate is None:
        return law_of(FIRST_ORDER_DELAY, *STILL, {})
    point, k = estimate.optimum.point, estimate.place
    structure = structure_at(estimate.optimum, k)
    out = law_of(structure, point.gain[k], np.exp(point.log_damping[k]), point.delay[k], point.extra_values(k))
    out[TRIM] = point.trim[-1, k]
    return out


def _start(pair: tuple[str, str], known: Mapping[str, Estimate]) -> Array:
    """World velocity of a pair at the start of the last segment."""
    out = np.zeros(2)
    for k, axis in enumerate(pair):
        if axis in known:
            one = known[axis]
            out[k] = one.optimum.point.start[-1, one.place]
    first = next(iter(known.values()))
    if pair == ("x", "y") and first.optimum.point.gain.size == 1:  # along and across the heading that was held
        out = world_from_heading(out[None], np.array([first.records[-1].heading]))[0]
    return out


def _disturbed(estimate: Estimate, steps: Array, step: Indices, residual: Array) -> State:
    """The disturbance of an axis at the poses."""
    levels = np.exp(estimate.optimum.point.levels[estimate.place, :4])
    means, covariances = disturbance_states(steps, step, residual, np.full(residual.size, levels[1]), levels)
    return levels, means, covariances


def _at_last(law: Array, state: State, driven: Array) -> AxisMotion:
    """The motion of an axis from the driven velocity at the last pose and a second later, and the disturbance."""
    levels, mean, covariance = state[0], state[1][-1], state[2][-1]
    b = law[DAMPING]
    pull = np.array([0.0, b, 1.0])
    F, Q = np.zeros((3, 3)), np.zeros((3, 3))
    discretize(levels[2], 0.25 * levels[3] * levels[2] ** 2, AHEAD, F, Q)
    later = F @ covariance @ F.T + levels[0] * Q
    return AxisMotion(
        velocity=float(driven[-2] + mean[1]),
        wind=float(pull @ mean + law[TRIM]),
        wind_error=float(np.sqrt(pull @ covariance @ pull)),
        gusts=float(np.sqrt(stationary(levels)[0])),
        ahead=float(driven[-1] + (F @ mean)[1]),
        ahead_error=float(np.sqrt(later[1, 1])),
    )


def _with_heading(
    moved: Mapping[str, AxisMotion], laws: Array, states: Mapping[str, State], heading: float
) -> dict[str, AxisMotion]:
    """The wind of x and y in the heading frame, where their dampings and trims stand; they were followed in the world.

    One axis alone keeps its wind as along the heading that was held.
    """
    if len(moved) < 2:
        return dict(moved)
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, s], [-s, c]])
    mean = turn @ np.array([states[axis][1][-1] for axis in ("x", "y")])
    out = {}
    for k, axis in enumerate(("x", "y")):
        pull = np.array([0.0, laws[k, DAMPING], 1.0])
        variance = sum(
            turn[k, j] ** 2 * float(pull @ states[other][2][-1] @ pull) for j, other in enumerate(("x", "y"))
        )
        out[axis] = replace(
            moved[axis], wind=float(pull @ mean[k] + laws[k, TRIM]), wind_error=float(np.sqrt(variance))
        )
    return out
