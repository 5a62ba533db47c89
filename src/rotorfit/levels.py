"""Levels of disturbance and noise: what they are by what was measured, where they are searched, where they start."""

import functools
from typing import Literal

import numpy as np

from rotorfit.frames import Array

Measured = Literal["position", "velocity", "both"]
"""What the blocks of a record hold."""

LEVELS_OF: dict[Measured, tuple[str, ...]] = {
    "position": ("wind_power", "pose_variance", "wind_damping", "wind_overlap"),
    "velocity": ("wind_power", "velocity_variance", "wind_damping", "wind_overlap"),
    "both": ("wind_power", "pose_variance", "wind_damping", "wind_overlap", "velocity_variance"),
}
"""Names of the L levels: q [unit^2/s^5], r [unit^2], alpha [1/s], kappa in (0, 1], and r_v [unit^2/s^2], the variance
of one velocity besides its rounding."""

LEVEL_RANGE = np.log(np.array([[1e-9, 1e4], [1e-12, 1e-2], [0.05, 200.0], [1e-3, 1.0]]))
"""Logarithmic bounds of the disturbance levels q, r, alpha, kappa."""

START_LEVELS = np.log(np.array([0.1, 1e-7, 2.5, 0.64]))
"""Where the levels start."""

VELOCITY_RANGE = np.log(np.array([1e-9, 1.0]))
"""Logarithmic bounds of the variance of a velocity [m^2/s^2]."""

START_VELOCITY = np.log(1e-3)
"""Where it starts."""


@functools.cache
def level_range(measured: Measured) -> Array:
    """Logarithmic bounds of the L levels in the order of `LEVELS_OF`, shape (L, 2)."""
    if measured == "both":
        return np.vstack([LEVEL_RANGE, VELOCITY_RANGE])
    out: Array = LEVEL_RANGE.copy()
    if measured == "velocity":
        out[1] = VELOCITY_RANGE
    return out


def start_levels(measured: Measured) -> Array:
    """Where the L levels start, shape (L,)."""
    if measured == "both":
        return np.append(START_LEVELS, START_VELOCITY)
    out: Array = START_LEVELS.copy()
    if measured == "velocity":
        out[1] = START_VELOCITY
    return out
