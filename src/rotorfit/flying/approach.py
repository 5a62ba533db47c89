"""Approach: leads a roughly known vehicle to a plan's start, and lets it come to rest there.

    p' = v        v' = g u(t - T) - b v + c

with the believed input g, damping b and delay T of each axis, in the heading frame. Errors of the belief (wind, trim, a
wrong input or damping) go into c. A fading-memory filter with one triple pole estimates p, v and c from the measured
poses; they are predicted over T with the commands under way, and the command is

    u = (K (r - p) + D (r' - v) + r'' + b r' - c) / g

for a minimum-jerk reference r that goes to the start and rests there. The delay and its uncertainty bound the bandwidth
of filter and loop: a filter that is fast compared with the uncertainty of the delay oscillates.

Source: O. J. M. Smith, "Closer control of loops with dead time", Chemical Engineering Progress 53 (1957), 217-219, for
the prediction; N. Morrison, "Introduction to Sequential Smoothing and Prediction" (1969), for the filter.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES, Array, Indices
from rotorfit.planning.belief import DELAY
from rotorfit.planning.plan_control import Tracker, tracker_of, turned

UNMODELLED = 0.1
"""Lag of attitude loop and measurement that the believed delay may leave out [s]."""

BAND, RATIO, DOUBT = 0.35, 5.0, 0.8
"""Bandwidth of the loop times the effective delay; bandwidth of the filter over the loop's; bound on the filter's
bandwidth times the uncertainty of the delay. Chosen on simulated possible vehicles, `bench/bench_approach.py`."""

LEAST_DOUBT = 0.2
"""Least uncertainty of a delay that is assumed, since `UNMODELLED` lag may or may not be there [s]."""

SPEED, TURN = 0.2, 0.25
"""Average speed of the reference [m/s, rad/s]; its peak is 1.875 times that."""

SHARE = 4.0
"""Least ratio of the speed limit to the average speed of the reference."""

UNHURRIED, LONG_WAY = 20.0, 2.0
"""Least duration of the reference times the loop's bandwidth, for a distance of `LONG_WAY` [m, rad] or more; below it,
in proportion."""


@dataclass(frozen=True)
class Approach:
    """A path to the start and the loop that follows it; all in the order x, y, z, yaw.

    Attributes:
        tracker: The plan, the belief and full scale.
        period: Time between commands [s].
        origin: Initial pose, world, shape (4,) [m, rad].
        way: Displacement from there to the start, world, yaw the short way round, shape (4,) [m, rad].
        duration: Duration of the reference [s].
        stiffness: K, shape (4,) [1/s^2].
        damping: D, shape (4,) [1/s].
        filter_band: Bandwidth of the filter, shape (4,) [rad/s].
        lags: Assumed delay in periods: the belief, `UNMODELLED` and two standard deviations, shape (4,).
    """

    tracker: Tracker
    period: float
    origin: Array
    way: Array
    duration: float
    stiffness: Array
    damping: Array
    filter_band: Array
    lags: Indices


@dataclass(frozen=True)
class Guess:
    """The estimated state of the vehicle, world frame.

    Attributes:
        pose: Shape (4,) [m, rad].
        velocity: Shape (4,) [m/s, rad/s].
        push: Acceleration c that the belief does not explain, shape (4,) [m/s^2, rad/s^2].
        sent: The last commands, the newest first, heading frame, shape (N, 4).
    """

    pose: Array
    velocity: Array
    push: Array
    sent: Array


def approach(plan: Plan, pose: Array, velocity: Array) -> tuple[Approach, Guess]:
    """The approach, and the initial estimate of the vehicle.

    Args:
        plan: The plan to whose start it leads.
        pose: Initial pose, world, yaw unwrapped, shape (4,) [m, rad].
        velocity: Initial velocity, world, shape (4,) [m/s, rad/s].
    """
    tracker, period = tracker_of(plan), 1 / plan.rate
    believed = plan.belief.get("delay", (DELAY[0],) * 4)
    doubt = 2 * np.array([_delay_sd(plan, axis) for axis in AXES])
    delay = np.array(believed, float) + UNMODELLED + doubt
    band = BAND / (doubt + 0.4 * delay + 0.05)
    b = tracker.gamma[1::2]
    damping = np.maximum(0.0, 2 * band - b)
    way = np.array(plan.space.start) - pose
    way[3] = math.remainder(way[3], math.tau)
    filter_band = np.minimum(RATIO * band, DOUBT / (np.maximum(doubt, LEAST_DOUBT) + 0.1))
    lags = np.maximum(1, np.round(delay / period)).astype(np.int64)
    loop = Approach(
        tracker,
        period,
        pose.copy(),
        way,
        _duration(plan, way, band),
        band * (b + damping) / 2,
        damping,
        filter_band,
        lags,
    )
    return loop, Guess(pose.copy(), velocity.copy(), np.zeros(4), np.zeros((int(lags.max()), 4)))


def _delay_sd(plan: Plan, axis: str) -> float:
    """Standard deviation of the believed delay [s]."""
    known = plan.belief.get("covariance", {})
    return float(math.sqrt(known[axis][2][2])) if axis in known else DELAY[1]


def _duration(plan: Plan, way: Array, band: Array) -> float:
    """Duration of the reference [s]."""
    flat, up, turn = math.hypot(way[0], way[1]), abs(way[2]), abs(way[3])
    fast = min(SPEED, plan.space.speed / SHARE), min(SPEED, plan.space.climb / SHARE), TURN
    by_speed = max(way / speed for way, speed in zip((flat, up, turn), fast, strict=True))
    by_band = max(UNHURRIED / w * min(1.0, abs(part) / LONG_WAY) for part, w in zip(way, band, strict=True))
    return float(max(by_speed, by_band, 1.0))


def measured(loop: Approach, guess: Guess, pose: Array, since: float) -> Guess:
    """The estimate after a pose.

    Args:
        loop: The approach.
        guess: The estimate before.
        pose: World, yaw unwrapped, shape (4,) [m, rad].
        since: Time since the pose before it [s].
    """
    fade = np.exp(-loop.filter_band * since)
    off = pose - guess.pose
    return replace(
        guess,
        pose=guess.pose + (1 - fade**3) * off,
        velocity=guess.velocity + 1.5 * (1 - fade) ** 2 * (1 + fade) / since * off,
        push=guess.push + (1 - fade) ** 3 / since**2 * off,
    )


def led(loop: Approach, guess: Guess, t: float) -> tuple[Guess, Array]:
    """The estimate one period later, and the command at a time since the beginning [s], heading frame, shape (4,)."""
    yaw, gamma = guess.pose[3], loop.tracker.gamma
    ahead, speed = _ahead(loop, guess, loop.lags)
    position, velocity, acceleration = _reference(loop, t)
    asked = loop.stiffness * turned(position - ahead, -yaw) + loop.damping * turned(velocity - speed, -yaw)
    asked += turned(acceleration - guess.push, -yaw) + gamma[1::2] * turned(velocity, -yaw)
    scale = loop.tracker.full_scale
    command = np.minimum(np.maximum(asked / gamma[::2], -scale), scale)
    pose, speed = _ahead(loop, guess, np.ones(4, np.int64))
    return Guess(pose, speed, guess.push, np.vstack([command, guess.sent[:-1]])), command


def _reference(loop: Approach, t: float) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the reference, world, each of shape (4,)."""
    s, d = min(t / loop.duration, 1.0), loop.duration
    position = s**3 * (10 - 15 * s + 6 * s**2)
    velocity, acceleration = 30 * s**2 * (1 - s) ** 2 / d, 60 * s * (1 - s) * (1 - 2 * s) / d**2
    return loop.origin + position * loop.way, velocity * loop.way, acceleration * loop.way


def _ahead(loop: Approach, guess: Guess, periods: Indices) -> tuple[Array, Array]:
    """Pose and velocity, world, a number of periods ahead on each axis, under the commands that act until then.

    The heading is taken as constant meanwhile. On an axis with a lag of n periods, the command sent n - k periods ago
    acts in the k-th period from now.
    """
    yaw, h = guess.pose[3], loop.period
    gain, b = loop.tracker.gamma[::2], np.maximum(loop.tracker.gamma[1::2], 1e-3)
    k = np.arange(int(periods.max()))[:, None]
    acts = k < periods
    left = np.asarray(
        np.where(acts, (periods - k) * h, h), np.float64
    )  # from the start of each period to the end of the last
    row = np.clip(loop.lags - k - 1, 0, len(guess.sent) - 1)
    force = gain * np.take_along_axis(guess.sent, row, axis=0) * acts
    horizon = np.asarray(periods * h, np.float64)
    v0, c0 = turned(guess.velocity, -yaw), turned(guess.push, -yaw)
    speed = np.exp(-b * horizon) * v0 + _slowed(b, horizon) * c0
    speed += np.sum(force * (_slowed(b, left) - _slowed(b, left - h)), axis=0)
    moved = _slowed(b, horizon) * v0 + _way(b, horizon) * c0
    moved += np.sum(force * (_way(b, left) - _way(b, left - h)), axis=0)
    return guess.pose + turned(moved, yaw), turned(speed, yaw)


def _slowed(b: Array, t: Array) -> Array:
    """Speed after a time under a constant acceleration of 1, from rest."""
    return np.asarray(-np.expm1(-b * t) / b)


def _way(b: Array, t: Array) -> Array:
    """Distance after a time under a constant acceleration of 1, from rest."""
    return np.asarray((t - _slowed(b, t)) / b)
