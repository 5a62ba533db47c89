"""Flights of velocity-commanded vehicles that the law leaves something out of, by an integration of their own."""

import math
from functools import cache

import numpy as np

from flights import by_hand
from rotorfit.core.flight_data import Flight
from rotorfit.core.limits import GRAVITY

POINTS = {"x": (4.5, 1.5, 0.18), "y": (4.7, 1.8, 0.17)}
"""Input, damping and delay of a vehicle that takes fractions of 3 m/s."""

BOUND = GRAVITY * math.tan(math.radians(20))
"""Acceleration at a tilt of 20 degrees [m/s^2]."""

STEP = 0.01


@cache
def flown(
    size: float,
    bound: float = math.inf,
    wind: float = 0.0,
    duration: float = 60.0,
    jerk: float = math.inf,
    drag: float = 0.0,
) -> Flight:
    """Steps of x and y, in gusts, by a vehicle that turns.

    Args:
        size: Of the largest step.
        bound: Largest acceleration [m/s^2].
        wind: Standard deviation of the gusts [m/s^2].
        duration: Of the flight [s].
        jerk: Largest change of the acceleration [m/s^3].
        drag: Coefficient of the square of the speed [1/m].
    """
    rng = np.random.default_rng(1)
    time = np.arange(0.0, duration, STEP)
    command = np.zeros((len(time), 4))
    for k in (0, 1):
        level = size * rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.0, 200)
        command[:, k] = level[np.searchsorted(np.cumsum(rng.uniform(0.4, 1.8, 200)), time)]
    points = [(g, b, round(tau / STEP)) for g, b, tau in POINTS.values()]
    damping = np.array([b for _, b, _ in points])
    yaw = 1.5 * np.sin(0.4 * time)
    velocity, position, given, gust = np.zeros((len(time), 2)), np.zeros((len(time), 2)), np.zeros(2), np.zeros(2)
    for i in range(1, len(time)):
        c, s = math.cos(yaw[i]), math.sin(yaw[i])
        turn = np.array([[c, -s], [s, c]])
        wanted = np.array([g * command[max(i - 1 - late, 0), k] for k, (g, _, late) in enumerate(points)])
        moved = velocity[i - 1] @ turn
        wanted -= damping * moved
        wanted *= min(1.0, bound / max(float(np.hypot(*wanted)), 1e-9))
        change = turn @ (wanted - drag * np.hypot(*moved) * moved) - given
        given = given + change * min(1.0, jerk * STEP / max(float(np.hypot(*change)), 1e-9))
        gust += -gust * STEP + wind * math.sqrt(2 * STEP) * rng.standard_normal(2)
        velocity[i] = velocity[i - 1] + STEP * (given + gust)
        position[i] = position[i - 1] + STEP * (velocity[i] + velocity[i - 1]) / 2
    pose = np.column_stack([position, np.zeros(len(time)), yaw])[::3]
    pose[:, :2] += 0.002 * rng.standard_normal((len(pose), 2))
    return by_hand(time[::3], pose, time, command)


@cache
def looped(longest: float, duration: float = 60.0) -> Flight:
    """Steps of x, of up to so many seconds, by a velocity loop with an integral part behind a lag, in gusts.

    Its final speed is the command.
    """
    rng = np.random.default_rng(1)
    time = np.arange(0.0, duration, STEP)
    level = rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.0, 200)
    command = np.zeros((len(time), 4))
    command[:, 0] = level[np.searchsorted(np.cumsum(rng.uniform(0.8, longest, 200)), time)]
    velocity = position = integral = tilt = gust = 0.0
    pose = np.zeros((len(time), 4))
    for i in range(1, len(time)):
        error = command[max(i - 11, 0), 0] - velocity
        integral += STEP * 0.45 * error
        tilt += STEP * (1.2 * error + integral - tilt) / 0.15
        gust += -gust * STEP + 0.05 * math.sqrt(2 * STEP) * rng.standard_normal()
        velocity += STEP * (tilt + gust)
        position += STEP * velocity
        pose[i, 0] = position
    pose[:, 0] += 0.002 * rng.standard_normal(len(time))
    return by_hand(time[::3], pose[::3], time, command)


INNER = {"steady_gain": 2.8 / 3.1, "total_lag": 0.055 + (1 + 1.6 / 14 * 0.3) / 3.1}
"""Of `looped_inside`."""


@cache
def looped_inside(turn: float = 0.0, duration: float = 40.0) -> Flight:
    """Steps of x and y, by a velocity loop around an attitude loop of the second order, in gusts.

    The loop is 2.8 (u - v) in the world, the attitude has 14 rad/s and a damping ratio of 0.8, drag is 0.3 1/s, and the
    delay 0.055 s.

    Args:
        turn: Amplitude of the heading [rad].
        duration: Of the flight [s].
    """
    rng, step = np.random.default_rng(3), 0.001
    time = np.arange(0.0, duration, step)
    command = np.zeros((len(time), 4))
    for k in range(2):
        level = 0.6 * rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.2, 200)
        command[:, k] = level[np.searchsorted(np.cumsum(rng.uniform(0.5, 2.5, 200)), time)]
    yaw = turn * np.sin(0.5 * time)
    asked = np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * command[:, :1]
    asked += np.stack([-np.sin(yaw), np.cos(yaw)], axis=1) * command[:, 1:2]
    shocks = 0.15 * math.sqrt(2 * step / 0.8) * rng.standard_normal(asked.shape)
    position = np.zeros(asked.shape)
    velocity, tilt, rate, gust = (np.zeros(2) for _ in range(4))
    for i in range(55, len(time)):
        rate = rate + step * (14.0**2 * (2.8 * (asked[i - 55] - velocity) - tilt) - 2 * 0.8 * 14.0 * rate)
        tilt = tilt + step * rate
        gust += -gust * step / 0.8 + shocks[i]
        velocity = velocity + step * (tilt - 0.3 * velocity + gust)
        position[i] = position[i - 1] + step * velocity
    pose = np.column_stack([position, np.zeros(len(time)), yaw])[::10]
    pose[:, :2] += 0.0006 * rng.standard_normal((len(pose), 2))
    return by_hand(time[::10], pose, time, command)
