"""The motion of two axes from pose to pose: the driven motion of the law, plus the disturbance.

It does sample by sample what the likelihood's filter does with a whole flight: same response, transitions and update.
Two axes are processed together: x and y through the heading, or z and yaw in parallel under a heading of zero.
Source: paper, eqs. (4) and (5), for the driven motion; R. E. Kalman, J. Basic Eng. 82 (1960), pp. 35-45.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.core.laws import DAMPING, TRIM
from rotorfit.dynamics.compiled import inner, kernel
from rotorfit.dynamics.disturbance import STEP_GRAIN, axis_start, discretize, stationary
from rotorfit.dynamics.disturbance_state import step_state, take_position
from rotorfit.dynamics.general_response import advance, command_in_force, demands, longest_step, settle
from rotorfit.dynamics.general_step import COLUMNS, MEAN, STATE, P, T, V, lag_series

SAMPLES = 30.0
"""Rate of the poses that the filter keeps [Hz]: that of the likelihood's blocks. A pose between two of them is
processed, too, but discarded when the next comes."""

AHEAD = 1.0
"""Prediction horizon [s]."""

VELOCITY, WIND, WIND_ERROR, GUSTS, LATER, LATER_ERROR = range(6)
"""Columns of the result of `MotionFilter.motion`."""


@dataclass(frozen=True)
class MotionFilter:
    """State of a filter, updated in place.

    In arrays with a leading 2, row 0 is at the last pose kept and row 1 at the last pose.

    Attributes:
        law: Vectors of the general law of both axes, including the trims, shape (2, LAW_SIZE).
        series: From `lag_series`.
        levels: q, r, alpha, kappa of both axes, shape (2, 4).
        known: Whether each axis is filtered; otherwise it only accompanies the other, shape (2,).
        turns: Whether the axes are x and y, which rotate with the heading.
        z: Driven state, shape (2, STATE).
        k: Index of the command in force on each axis, shape (2, 2).
        u: Value of that command, shape (2, 2).
        mean: Mean of n, s and s' of each axis, shape (2, 2, 3).
        covariance: Their covariance, shape (2, 2, 3, 3).
        clock: Time, heading, and whether a pose has been processed, shape (2, 3).
        grid: Time of the first pose, and number of the next pose to keep, shape (2,).
    """

    law: Array
    series: Array
    levels: Array
    known: Mask
    turns: bool
    z: Array
    k: Indices
    u: Array
    mean: Array
    covariance: Array
    clock: Array
    grid: Array

    @property
    def time(self) -> float:
        """Stamp of the last pose [s]; before the first pose, the start."""
        return float(self.clock[1, 0])

    def follow(self, time: Array, position: Array, yaw: Array, command_time: Array, command: Array) -> Array:
        """Processes poses.

        Args:
            time: Later than the last, shape (N,) [s].
            position: World, shape (N, 3) [m].
            yaw: Unwrapped, shape (N,) [rad].
            command_time: All commands from the one that index 0 in `k` refers to, shape (M,) [s].
            command: Shape (M, 4).

        Returns:
            For each pose and axis n, s, s', and driven position and velocity, shape (N, 2, 5).
        """
        return _follow(
            time, position, yaw, command_time, command, self.law, self.series, self.levels, self.known, self.turns,
            self.z, self.k, self.u, self.mean, self.covariance, self.clock, self.grid,
        )  # fmt: skip

    def motion(self, command_time: Array, command: Array) -> Array:
        """The motion at the last pose, shape (2, 6); for each axis:

        its world velocity; the wind as an acceleration, and its standard error (for x and y along the heading where
        both are filtered); the standard deviation of the disturbance's velocity; the velocity `AHEAD` later if the last
        command holds, and its standard error. NaN for an axis that is not filtered.

        Args:
            command_time: As for `follow`.
            command: As for `follow`.
        """
        return _motion(
            command_time, command, self.law, self.series, self.levels, self.known, self.turns, self.z[1], self.k[1],
            self.u[1], self.mean[1], self.covariance[1], self.clock[1],
        )  # fmt: skip


def motion_filter(
    begin: float, position: Array, velocity: Array, yaw: float, command_time: Array, command: Array, law: Array,
    levels: Array, known: Mask, turns: bool,
) -> MotionFilter:  # fmt: skip
    """A filter before its first pose.

    Args:
        begin: Start time [s].
        position: Initial position of the driven motion, shape (2,).
        velocity: Initial world velocity, shape (2,).
        yaw: Initial heading [rad].
        command_time: Shape (M,) [s].
        command: Shape (M, 4).
        law: See `MotionFilter`.
        levels: See `MotionFilter`.
        known: See `MotionFilter`.
        turns: See `MotionFilter`.
    """
    z, k, u, heading = np.zeros((2, STATE)), np.zeros((2, 2), np.int64), np.zeros((2, 2)), yaw if turns else 0.0
    mean, covariance = np.zeros((2, 2, 3)), np.zeros((2, 2, 3, 3))
    _begin(begin, position, velocity, heading, command_time, command, law, levels, turns, z, k, u, covariance)
    clock, grid = np.tile([begin, heading, 0.0], (2, 1)), np.zeros(2)
    return MotionFilter(law, lag_series(law), levels, known, turns, z, k, u, mean, covariance, clock, grid)


@kernel()
def _begin(
    begin: float, position: Array, velocity: Array, yaw: float, command_time: Array, command: Array, law: Array,
    levels: Array, turns: bool, z: Array, k: Any, u: Array, covariance: Array,
) -> None:  # fmt: skip
    """Fills the state before the first pose; a lag starts in its steady state under the command in force."""
    own = command[:, :2] if turns else command[:, 2:]
    what, whose = np.full(1, MEAN), np.zeros(1, np.int64)
    for a in range(2):
        at = COLUMNS * a
        z[:, P + at], z[:, V + at], z[:, T + at] = position[a], velocity[a], law[a, TRIM]
        axis_start(covariance[0, a], levels[a])
    command_in_force(begin, 0, command_time.size, command_time, own, law, k[0], u[0])
    demands(law, what, whose, u[0], z[0])
    settle(law, z[0], 1, yaw)
    z[1], k[1], u[1], covariance[1] = z[0], k[0], u[0], covariance[0]


@inner()
def _moved(
    t: float, until: float, psi: float, yaw: float, command_time: Array, command: Array, law: Array, series: Array,
    z: Array, k: Any, u: Array,
) -> None:  # fmt: skip
    """Propagates the driven state."""
    what, whose, S = np.full(1, MEAN), np.zeros(1, np.int64), np.zeros((2, 3, 12))
    advance(
        t, until, psi, yaw, k, command_time.size, command_time, command, law, series, longest_step(law), what, whose, z,
        u, S,
    )  # fmt: skip


@kernel()
def _follow(
    time: Array, position: Array, yaw: Array, command_time: Array, command: Array, law: Array, series: Array,
    levels: Array, known: Any, turns: bool, z: Array, k: Any, u: Array, mean: Array, covariance: Array, clock: Array,
    grid: Array,
) -> Array:  # fmt: skip
    """See `MotionFilter.follow`."""
    own = command[:, :2] if turns else command[:, 2:]
    F, D, M, out = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3)), np.zeros((time.size, 2, 5))
    for i in range(time.size):
        t, heading, begun = time[i], yaw[i] if turns else 0.0, clock[0, 2] > 0.0
        z[1], k[1], u[1], mean[1], covariance[1] = z[0], k[0], u[0], mean[0], covariance[0]
        _moved(clock[0, 0], t, clock[0, 1], heading, command_time, own, law, series, z[1], k[1], u[1])
        dt = np.rint((t - clock[0, 0]) / STEP_GRAIN) * STEP_GRAIN
        for a in range(2):
            at, m = COLUMNS * a, mean[1, a]
            driven = z[1, P + at]
            if known[a]:
                level = levels[a]
                if begun:
                    discretize(level[2], 0.25 * level[3] * level[2] * level[2], dt, F, D)
                    step_state(m, covariance[1, a], F, D, level[0], M)
                seen = position[i, a] if turns else (position[i, 2] if a == 0 else yaw[i])
                take_position(m, covariance[1, a], seen - driven, level[1])
            for j in range(3):
                out[i, a, j] = m[j]
            out[i, a, 3], out[i, a, 4] = driven, z[1, V + at]
        clock[1, 0], clock[1, 1], clock[1, 2] = t, heading, 1.0
        if not begun:
            grid[0] = t
        if t >= grid[0] + grid[1] / SAMPLES:
            z[0], k[0], u[0], mean[0], covariance[0], clock[0] = z[1], k[1], u[1], mean[1], covariance[1], clock[1]
            while grid[0] + grid[1] / SAMPLES <= t:
                grid[1] += 1.0
    return out


@kernel()
def _motion(
    command_time: Array, command: Array, law: Array, series: Array, levels: Array, known: Any, turns: bool, z: Array,
    k: Any, u: Array, mean: Array, covariance: Array, clock: Array,
) -> Array:  # fmt: skip
    """See `MotionFilter.motion`."""
    own = command[:, :2] if turns else command[:, 2:]
    later, out = z.copy(), np.full((2, 6), np.nan)
    until = clock[0] + AHEAD
    _moved(clock[0], until, clock[1], clock[1], command_time, own, law, series, later, k.copy(), u.copy())
    F, D, M = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    both = turns and known[0] and known[1]
    c, s = (np.cos(clock[1]), np.sin(clock[1])) if both else (1.0, 0.0)
    for a in range(2):
        if not known[a]:
            continue
        at, level, b = COLUMNS * a, levels[a], law[a, DAMPING]
        push = variance = 0.0
        for j in range(2):  # in the heading frame, in which dampings and trims are defined
            if j != a and not both:
                continue
            share, m, C = (c if j == a else (s if a == 0 else -s)), mean[j], covariance[j]
            push += share * (b * m[1] + m[2])
            variance += share * share * (b * b * C[1, 1] + 2 * b * C[1, 2] + C[2, 2])
        out[a, VELOCITY], out[a, WIND], out[a, WIND_ERROR] = z[V + at] + mean[a, 1], push + law[a, TRIM], variance**0.5
        out[a, GUSTS] = stationary(level)[0] ** 0.5
        discretize(level[2], 0.25 * level[3] * level[2] * level[2], AHEAD, F, D)
        m, C = mean[a].copy(), covariance[a].copy()
        step_state(m, C, F, D, level[0], M)
        out[a, LATER], out[a, LATER_ERROR] = later[V + at] + m[1], C[1, 1] ** 0.5
    return out
