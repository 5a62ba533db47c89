"""Approach: leads a vehicle that is known only roughly to a plan's start, and lets it come to rest there.

    p' = v        v' = g u(t - T) - b v + c

with the believed input g, damping b and delay T of each axis, in the heading frame. What the belief gets wrong (wind,
trim, an input or damping that is off) goes into c. A fading-memory filter with one triple pole finds p, v and c from
the measured poses; they are led ahead by T under the commands that are on their way, and the command is

    u = (K (r - p) + D (r' - v) + r'' + b r' - c) / g

for a reference r that goes to the start and rests there (least jerk). How fast filter and loop may be follows from the
delay and from how far it may be off: a filter that is faster than the doubt about the delay swings.

Source: O. J. M. Smith, "Closer control of loops with dead time", Chemical Engineering Progress 53 (1957), 217-219, for
the prediction; N. Morrison, "Introduction to Sequential Smoothing and Prediction" (1969), for the filter.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES, Array, Indices
from rotorfit.planning.belief import DELAY
from rotorfit.planning.plan_control import Tracker, tracker_of

UNMODELLED = 0.1
"""Lag of attitude loop and measurement that the believed delay may leave out [s]."""

BAND, RATIO, DOUBT = 0.35, 5.0, 0.8
"""Of the loop, over the delay that matters; of the filter, over the loop's; and at most over the doubt about the delay.

Chosen on simulated vehicles that are believed possible, `bench/bench_approach.py`.
"""

LEAST_DOUBT = 0.2
"""About a delay, however well it is believed to be known: the lag may be there or not [s]."""

SPEED, TURN = 0.2, 0.25
"""Of the reference, on average [m/s, rad/s]; its peak is 1.875 times that."""

SHARE = 4.0
"""The speed limit is so many times that of the reference, on average."""

UNHURRIED, LONG_WAY = 20.0, 2.0
"""Over the loop's band, the time that a way takes which is so long or longer [m, rad]."""


@dataclass(frozen=True)
class Approach:
    """A way to the start and the loop that follows it; all in the order x, y, z, yaw.

    Attributes:
        tracker: The plan, the belief and full scale.
        period: Between commands [s].
        origin: Pose at the beginning, world, shape (4,) [m, rad].
        way: From there to the start, yaw the short way round, shape (4,).
        duration: Of the reference [s].
        stiffness: K, shape (4,) [1/s^2].
        damping: D, shape (4,) [1/s].
        filter_band: Of the filter, shape (4,) [rad/s].
        lags: Believed delay in periods, shape (4,).
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
    """What is thought of the vehicle now, world.

    Attributes:
        pose: Shape (4,) [m, rad].
        velocity: Shape (4,) [m/s, rad/s].
        push: What the belief does not explain, shape (4,) [m/s^2, rad/s^2].
        sent: Commands, the newest first, shape (N, 4), heading frame.
    """

    pose: Array
    velocity: Array
    push: Array
    sent: Array


def approach(plan: Plan, pose: Array, velocity: Array) -> tuple[Approach, Guess]:
    """The approach from a pose, shape (4,), at a velocity, world, shape (4,); and what is thought at its beginning."""
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
    """How far the believed delay may be off, one standard deviation [s]."""
    known = plan.belief.get("covariance", {})
    return float(math.sqrt(known[axis][2][2])) if axis in known else DELAY[1]


def _duration(plan: Plan, way: Array, band: Array) -> float:
    """How long the reference is on its way [s]."""
    flat, up, turn = math.hypot(way[0], way[1]), abs(way[2]), abs(way[3])
    fast = min(SPEED, plan.space.speed / SHARE), min(SPEED, plan.space.climb / SHARE), TURN
    by_speed = max(way / speed for way, speed in zip((flat, up, turn), fast, strict=True))
    by_band = max(UNHURRIED / w * min(1.0, abs(part) / LONG_WAY) for part, w in zip(way, band, strict=True))
    return float(max(by_speed, by_band, 1.0))


def measured(loop: Approach, guess: Guess, pose: Array, since: float) -> Guess:
    """Takes in a pose, world, yaw unwrapped, shape (4,), so long after the one before it [s]."""
    fade = np.exp(-loop.filter_band * since)
    off = pose - guess.pose
    return replace(
        guess,
        pose=guess.pose + (1 - fade**3) * off,
        velocity=guess.velocity + 1.5 * (1 - fade) ** 2 * (1 + fade) / since * off,
        push=guess.push + (1 - fade) ** 3 / since**2 * off,
    )


def led(loop: Approach, guess: Guess, t: float) -> tuple[Guess, Array]:
    """The command at a time from the beginning [s], shape (4,); and what is thought at the next one."""
    yaw, gamma = guess.pose[3], loop.tracker.gamma
    ahead, speed = _ahead(loop, guess, loop.lags)
    position, velocity, acceleration = _reference(loop, t)
    asked = loop.stiffness * _turned(position - ahead, -yaw) + loop.damping * _turned(velocity - speed, -yaw)
    asked += _turned(acceleration - guess.push, -yaw) + gamma[1::2] * _turned(velocity, -yaw)
    scale = loop.tracker.full_scale
    command = np.minimum(np.maximum(asked / gamma[::2], -scale), scale)
    pose, speed = _ahead(loop, guess, np.ones(4, np.int64))
    return Guess(pose, speed, guess.push, np.vstack([command, guess.sent[:-1]])), command


def _reference(loop: Approach, t: float) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration that are wanted, world, each of shape (4,)."""
    s, d = min(t / loop.duration, 1.0), loop.duration
    position = s**3 * (10 - 15 * s + 6 * s**2)
    velocity, acceleration = 30 * s**2 * (1 - s) ** 2 / d, 60 * s * (1 - s) * (1 - 2 * s) / d**2
    return loop.origin + position * loop.way, velocity * loop.way, acceleration * loop.way


def _ahead(loop: Approach, guess: Guess, periods: Indices) -> tuple[Array, Array]:
    """Pose and velocity, world, so many periods ahead on each axis, under the commands that act until then.

    The heading is taken for constant meanwhile. Of an axis with the lag n, the command of n - k periods ago acts in the
    period k from now.
    """
    yaw, h = guess.pose[3], loop.period
    gain, b = loop.tracker.gamma[::2], np.maximum(loop.tracker.gamma[1::2], 1e-3)
    k = np.arange(int(periods.max()))[:, None]
    acts = k < periods
    left = np.asarray(
        np.where(acts, (periods - k) * h, h), np.float64
    )  # from the begin of each period to the end of all
    row = np.clip(loop.lags - k - 1, 0, len(guess.sent) - 1)
    force = gain * np.take_along_axis(guess.sent, row, axis=0) * acts
    horizon = np.asarray(periods * h, np.float64)
    v0, c0 = _turned(guess.velocity, -yaw), _turned(guess.push, -yaw)
    speed = np.exp(-b * horizon) * v0 + _slowed(b, horizon) * c0
    speed += np.sum(force * (_slowed(b, left) - _slowed(b, left - h)), axis=0)
    moved = _slowed(b, horizon) * v0 + _way(b, horizon) * c0
    moved += np.sum(force * (_way(b, left) - _way(b, left - h)), axis=0)
    return guess.pose + _turned(moved, yaw), _turned(speed, yaw)


def _slowed(b: Array, t: Array) -> Array:
    """Speed after a time under a constant acceleration of 1, from rest."""
    return np.asarray(-np.expm1(-b * t) / b)


def _way(b: Array, t: Array) -> Array:
    """Way after a time under a constant acceleration of 1, from rest."""
    return np.asarray((t - _slowed(b, t)) / b)


def _turned(four: Array, angle: float) -> Array:
    """x and y turned counter-clockwise by an angle; z and yaw as they are."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * four[0] - s * four[1], s * four[0] + c * four[1], four[2], four[3]])
