"""Flights under laws that the simulator does not know, integrated by Runge and Kutta from pose to pose and switch."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flights import by_hand
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array

G, B, DELAY, LAG = 3.0, 1.2, 0.12, 0.15
SLOW_LAG = 0.3  # of the second order: its poles are complex
ZERO = 0.25
LIMIT = 0.7
COUPLED_INPUT = np.array([[G, 0.5], [-0.4, 2.5]])
COUPLED_DAMPING = np.array([[B, 0.15], [-0.2, 0.8]])

Law = Callable[[Any, Any, Any, Any], tuple[Any, Any]]
"""v, q, u and the wind, each (K,) or a number for one axis, to v' and q'; q is what a lag remembers."""


def bounded(u: Array, level: float) -> Array:
    return np.sign(u) * np.minimum(np.abs(u), level)


def without_middle(u: Array, width: float) -> Array:
    return np.sign(u) * np.maximum(np.abs(u) - width, 0.0)


WORLD_LAG = "first_order_delay_world_lag"

LAWS: dict[str, Law] = {
    "first_order": lambda v, q, u, w: (G * u - B * v + w, 0 * q),
    "first_order_delay": lambda v, q, u, w: (G * u - B * v + w, 0 * q),
    "first_order_lag": lambda v, q, u, w: (q - B * v + w, (G * u - q) / LAG),
    "first_order_delay_lag": lambda v, q, u, w: (q - B * v + w, (G * u - q) / LAG),
    WORLD_LAG: lambda v, q, u, w: (q - B * v + w, (G * u - q) / LAG),
    "quadratic_drag": lambda v, q, u, w: (G * u - 0.4 * v - 1.5 * np.abs(v) * v + w, 0 * q),
    "climb_descent": lambda v, q, u, w: (np.where(u > 0, 3.6, 2.4) * u - B * v + w, 0 * q),
    "saturation": lambda v, q, u, w: (G * bounded(u, 0.35) - B * v + w, 0 * q),
    "limited_acceleration": lambda v, q, u, w: (q, (bounded(G * u - B * v, LIMIT) + w - q) / LAG),
    "dead_zone": lambda v, q, u, w: (G * without_middle(u, 0.08) - B * v + w, 0 * q),
    "second_order": lambda v, q, u, w: (q, (G * u - B * v + w - q) / SLOW_LAG),
    "second_order_zero": lambda v, q, u, w: (  # q is the acceleration less what the zero adds, so u' is not needed
        q + G * ZERO / SLOW_LAG * u,
        (G * (1 - ZERO / SLOW_LAG) * u - B * v + w - q) / SLOW_LAG,
    ),
    "coupled": lambda v, q, u, w: (
        COUPLED_INPUT @ u - COUPLED_DAMPING @ v + w,
        0 * q,
    ),
}
"""As they are written on paper, with the numbers of `TRUTH`."""

TRUTH: dict[str, dict[str, float]] = {
    "first_order": {"input": G, "damping": B},
    "first_order_delay": {"input": G, "damping": B, "delay": DELAY},
    "first_order_lag": {"input": G, "damping": B, "lag": LAG},
    "first_order_delay_lag": {"input": G, "damping": B, "delay": DELAY, "lag": LAG, "delay_plus_lag": DELAY + LAG},
    WORLD_LAG: {"input": G, "damping": B, "delay": DELAY, "lag": LAG},
    "quadratic_drag": {"input": G, "delay": DELAY, "quadratic_drag": 1.5, "damping_at_rest": 0.4},
    "climb_descent": {"input": G, "damping": B, "delay": DELAY, "asymmetry": 0.2, "input_up": 3.6, "input_down": 2.4},
    "saturation": {"input": G, "damping": B, "delay": DELAY, "level": 0.35},
    "limited_acceleration": {
        "input": G,
        "damping": B,
        "delay": DELAY,
        "lag": LAG,
        "acceleration_limit": LIMIT,
        "steady_gain": G / B,
        "total_lag": DELAY + 1 / B,
    },
    "dead_zone": {"input": G, "damping": B, "delay": DELAY, "dead_zone": 0.08},
    "second_order": {"input": G, "damping": B, "delay": DELAY, "lag": SLOW_LAG, "natural_frequency": 2.0},
    "second_order_zero": {
        "input": G,
        "damping": B,
        "delay": DELAY,
        "lag": SLOW_LAG,
        "zero": ZERO,
        "natural_frequency": 2.0,
        "total_lag": DELAY + 1 / B - ZERO,
        "steady_gain": G / B,
    },
    "coupled": {"input": G, "damping": B, "delay": DELAY, "cross_input": 0.5, "cross_damping": 0.15},
}
"""Coefficients, further parameters and combinations of the first axis."""


def delay_of(name: str) -> float:
    return TRUTH[name].get("delay", 0.0)


def flown_by(
    name: str,
    axes: Sequence[str] = ("z",),
    duration: float = 25.0,
    seed: int = 1,
    wind: float = 0.0,
    noise: float = 0.0,
    turn: float = 0.0,
    amplitude: float = 0.5,
    straight: float = 0.0,
) -> Flight:
    """A flight under a law, from rest, with commands of all sizes that change about every 0.5 s.

    Args:
        name: In `LAWS`.
        axes: That move.
        duration: [s].
        seed: Of commands, wind and noise.
        wind: Standard deviation of an acceleration with a memory of 1 s, held for 0.1 s at a time [m/s^2].
        noise: Of the measured pose [m].
        turn: Amplitude of a slow turn of the heading [rad].
        amplitude: Largest command.
        straight: Time before the heading turns [s].
    """
    rng, K = np.random.default_rng(seed), len(axes)
    command_time = np.cumsum(np.append(0.0, rng.uniform(0.2, 0.8, int(2 * duration))))
    command_time = command_time[command_time < duration]
    command = rng.uniform(-amplitude, amplitude, (command_time.size, K))
    command[:4] = 0.0
    pose_time = np.arange(0.0, duration, 1 / 100) + 0.003
    gust_time = np.arange(0.0, duration + 0.1, 0.1)
    gust = np.zeros((gust_time.size, K))
    for i in range(1, gust_time.size):
        gust[i] = np.exp(-0.1) * gust[i - 1] + wind * np.sqrt(1 - np.exp(-0.2)) * rng.standard_normal(K)
    heading = lambda t: turn * np.sin(0.5 * np.maximum(np.asarray(t) - straight, 0.0))  # noqa: E731
    position = _integrated(
        LAWS[name], pose_time, command_time + delay_of(name), command, gust_time, gust, heading, name == WORLD_LAG
    )
    pose, whole = np.zeros((pose_time.size, 4)), np.zeros((command_time.size, 4))
    column = [AXES.index(axis) for axis in axes]
    pose[:, 3] = heading(pose_time)
    pose[:, column] = position
    whole[:, column] = command
    pose[:, :3] += noise * rng.standard_normal((pose_time.size, 3))
    return by_hand(pose_time, pose, command_time, whole)


def _integrated(
    law: Law,
    pose_time: Array,
    switch: Array,
    command: Array,
    gust_time: Array,
    gust: Array,
    heading: Callable[[Array], Array],
    in_space: bool,
) -> Array:
    """World positions at the poses, (N, K); `in_space` is whether q of x and y keeps its direction when they turn."""
    K = command.shape[1]

    def slope(t: float, v: Any, q: Any, u: Any, w: Any) -> tuple[Any, Any]:
        if K == 1:
            return law(v, q, u, w)
        c, s = np.cos(heading(t)), np.sin(heading(t))
        R = np.array([[c, -s], [s, c]])
        frame = R if in_space else np.eye(2)
        dv, dq = law(R.T @ v, frame.T @ q, u, R.T @ w)
        return R @ dv, frame @ dq

    # One axis in plain numbers: ten times as fast as arrays of one.
    of_axes = (lambda values: values) if K > 1 else (lambda values: values[:, 0].tolist())
    switches = switch[switch > 0], gust_time if gust.any() else [], pose_time
    times = np.unique(np.concatenate([[0.0], *switches]))
    times = times[times <= pose_time[-1]]
    u = of_axes(command[np.maximum(np.searchsorted(switch, times + 1e-9) - 1, 0)])
    w = of_axes(gust[np.searchsorted(gust_time, times + 1e-9) - 1])
    r = v = q = np.zeros(K) if K > 1 else 0.0
    out = [r]
    for i, (t, end) in enumerate(itertools.pairwise(times.tolist())):
        h, held = end - t, (u[i], w[i])
        dv1, dq1 = slope(t, v, q, *held)
        v2 = v + h / 2 * dv1
        dv2, dq2 = slope(t + h / 2, v2, q + h / 2 * dq1, *held)
        v3 = v + h / 2 * dv2
        dv3, dq3 = slope(t + h / 2, v3, q + h / 2 * dq2, *held)
        v4 = v + h * dv3
        dv4, dq4 = slope(end, v4, q + h * dq3, *held)
        r = r + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + h / 6 * (dv1 + 2 * dv2 + 2 * dv3 + dv4)
        q = q + h / 6 * (dq1 + 2 * dq2 + 2 * dq3 + dq4)
        out.append(r)
    return np.array(out).reshape(-1, K)[np.searchsorted(times, pose_time)]
