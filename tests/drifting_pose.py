"""Flights of an exact first-order z in slow wind, whose pose drifts as that of visual odometry does."""

import itertools

import numpy as np

from flights import by_hand
from rotorfit.core.flight_data import Flight

G, B, DELAY = 2.7, 2.5, 0.12
STEP = 0.01


def drifting(
    seed: int, duration: float = 30.0, walk: float = 0.008, noise: float = 0.004, wind: float = 0.12
) -> Flight:
    """A flight with commands that change about every 1.3 s, and three gaps of 0.5 s.

    Args:
        seed: Of commands, wind, drift and noise.
        duration: [s].
        walk: Random walk of the measured height [m/sqrt(s)].
        noise: Of the measured height [m].
        wind: Standard deviation of an acceleration with a memory of 4 s [m/s^2].
    """
    rng, count = np.random.default_rng(seed), round(duration / STEP)
    switch = np.cumsum(rng.uniform(0.4, 2.2, count))
    level = np.append(0.0, rng.uniform(0.15, 0.5, count) * rng.choice([-1, 1], count))
    command_time = np.arange(0.0, duration, 1 / 30)
    command = np.zeros((command_time.size, 4))
    command[:, 2] = level[np.searchsorted(switch, command_time, side="right")]
    due = np.searchsorted(command_time + DELAY, STEP * (np.arange(count) + 0.5), side="right") - 1
    gust, keep = wind * rng.standard_normal(count), np.exp(-STEP / 4)
    velocity, height, w, fade = 0.0, np.zeros(count + 1), gust[0], np.exp(-B * STEP)
    for i in range(count):
        demand = (G * command[due[i], 2] if due[i] >= 0 else 0.0) + w
        final = demand / B
        height[i + 1] = height[i] + final * STEP + (velocity - final) * (1 - fade) / B
        velocity = final + (velocity - final) * fade
        w = keep * w + np.sqrt(1 - keep**2) * gust[i]
    pose = np.zeros((count // 2, 4))
    steps = walk * np.sqrt(2 * STEP) * rng.standard_normal(len(pose))
    pose[:, 2] = height[1::2][: len(pose)] + np.cumsum(steps) + noise * rng.standard_normal(len(pose))
    parts = np.linspace(0.0, duration, 5)
    segments = [(float(low), float(high) - 0.5) for low, high in itertools.pairwise(parts)]
    return by_hand(STEP * (1 + 2 * np.arange(len(pose))), pose, command_time, command, segments)
