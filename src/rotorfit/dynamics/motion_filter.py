"""The motion of two axes from pose to pose: the driven motion of the law, plus the disturbance.

It does sample by sample what the likelihood's filter does with a whole flight: same response, transitions and update.
Two axes are processed together: x and y through the heading, or z and yaw in parallel under a heading of zero. The
disturbance of x and y has its levels along the axes of the heading frame, so its state rotates with the heading.
Source: paper, eqs. (4) and (5), for the driven motion; R. E. Kalman, J. Basic Eng. 82 (1960), pp. 35-45.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.core.laws import DAMPING, TRIM
from rotorfit.dynamics.disturbance import STEP_GRAIN, axis_start, discretize, stationary
from rotorfit.dynamics.general_response import advance, command_in_force, demands, longest_step, settle
from rotorfit.dynamics.general_step import COLUMNS, MEAN, STATE, T, V, lag_series
from rotorfit.dynamics.general_step import P as POSITION

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
        mean: Mean of n, s and s' of the first axis, then of the second, in the heading frame where x and y are both
            filtered, shape (2, 6).
        covariance: Their covariance, shape (2, 6, 6).
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
            For each pose and axis of the world n, s, s', and driven position and velocity, shape (N, 2, 5).
        """
        return _follow(  # type: ignore[no-any-return]
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
        return _motion(  # type: ignore[no-any-return]
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
    mean, covariance = np.zeros((2, 6)), np.zeros((2, 6, 6))
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
        z[:, POSITION + at], z[:, V + at], z[:, T + at] = position[a], velocity[a], law[a, TRIM]
        axis_start(covariance[0, 3 * a : 3 * a + 3, 3 * a : 3 * a + 3], levels[a])
    command_in_force(begin, 0, command_time.size, command_time, own, law, k[0], u[0])
    demands(law, what, whose, u[0], z[0])
    settle(law, z[0], 1, yaw)
    z[1], k[1], u[1], covariance[1] = z[0], k[0], u[0], covariance[0]


@inner()
def _moved(
    t: float, until: float, psi: float, yaw: float, command_time: Array, command: Array, law: Array, series: Array,
    z: Array, k: Any, u: Array, what: Any, whose: Any, S: Array,
) -> None:  # fmt: skip
    """Propagates the driven state; the last three arguments are the column of the mean, and room to work."""
    advance(
        t, until, psi, yaw, k, command_time.size, command_time, command, law, series, longest_step(law), what, whose, z,
        u, S,
    )  # fmt: skip


@inner()
def _turn(m: Array, P: Array, angle: float) -> None:
    """Rotates the frame of mean (6,) and covariance (6, 6) by an angle, in place."""
    if angle == 0.0:
        return
    c, s = np.cos(angle), np.sin(angle)
    for j in range(3):
        m[j], m[3 + j] = c * m[j] + s * m[3 + j], c * m[3 + j] - s * m[j]
        for k in range(6):
            P[j, k], P[3 + j, k] = c * P[j, k] + s * P[3 + j, k], c * P[3 + j, k] - s * P[j, k]
    for j in range(3):
        for k in range(6):
            P[k, j], P[k, 3 + j] = c * P[k, j] + s * P[k, 3 + j], c * P[k, 3 + j] - s * P[k, j]


@inner()
def _discretized(levels: Array, dt: float, F: Array, D: Array) -> None:
    """Fills the transitions F and unit-power covariances D of both axes, each (2, 3, 3), over a step."""
    for a in range(2):
        discretize(levels[a, 2], 0.25 * levels[a, 3] * levels[a, 2] * levels[a, 2], dt, F[a], D[a])


@inner()
def _stepped(m: Array, P: Array, levels: Array, F: Array, D: Array, M: Array) -> None:
    """Propagates mean (6,) and covariance (6, 6) by the step of `_discretized`, in place; M is room to work."""
    for a in range(2):
        for j in range(3):
            i = 3 * a + j
            M[i, 6] = F[a, j, 0] * m[3 * a] + F[a, j, 1] * m[3 * a + 1] + F[a, j, 2] * m[3 * a + 2]
            for k in range(6):
                M[i, k] = F[a, j, 0] * P[3 * a, k] + F[a, j, 1] * P[3 * a + 1, k] + F[a, j, 2] * P[3 * a + 2, k]
    for i in range(6):
        m[i] = M[i, 6]
        for b in range(2):
            for k in range(3):
                P[i, 3 * b + k] = M[i, 3 * b] * F[b, k, 0] + M[i, 3 * b + 1] * F[b, k, 1] + M[i, 3 * b + 2] * F[b, k, 2]
    for a in range(2):
        for j in range(3):
            for k in range(3):
                P[3 * a + j, 3 * a + k] += levels[a, 0] * D[a, min(j, k), max(j, k)]


@inner()
def _take(m: Array, P: Array, a: int, residual: float, noise: float, gain: Array) -> None:
    """Updates mean (6,) and covariance (6, 6) with a measured position of axis a, in place."""
    at = 3 * a
    variance, off = P[at, at] + noise, residual - m[at]
    for i in range(6):
        gain[i] = P[i, at] / variance
    for i in range(6):
        m[i] += gain[i] * off
        for k in range(6):
            P[i, k] -= gain[i] * gain[k] * variance


@kernel()
def _follow(
    time: Array, position: Array, yaw: Array, command_time: Array, command: Array, law: Array, series: Array,
    levels: Array, known: Any, turns: bool, z: Array, k: Any, u: Array, mean: Array, covariance: Array, clock: Array,
    grid: Array,
) -> Array:  # fmt: skip
    """See `MotionFilter.follow`."""
    own = command[:, :2] if turns else command[:, 2:]
    F, D, M, gain = np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), np.empty((6, 7)), np.empty(6)
    what, whose, S = np.full(1, MEAN), np.zeros(1, np.int64), np.zeros((2, 3, 12))
    out, both, done = np.zeros((time.size, 2, 5)), turns and known[0] and known[1], -1.0
    kept, kept_k, kept_u, kept_m, kept_P, then = z[0], k[0], u[0], mean[0], covariance[0], clock[0]
    now, now_k, now_u, m, P, at = z[1], k[1], u[1], mean[1], covariance[1], clock[1]  # slices cost more than their use
    for i in range(time.size):
        t, heading, begun = time[i], yaw[i] if turns else 0.0, then[2] > 0.0
        _copy(kept, kept_k, kept_u, kept_m, kept_P, now, now_k, now_u, m, P)
        _moved(then[0], t, then[1], heading, command_time, own, law, series, now, now_k, now_u, what, whose, S)
        if begun:
            dt = np.rint((t - then[0]) / STEP_GRAIN) * STEP_GRAIN
            half = 0.5 * (heading - then[1]) if both else 0.0
            if dt != done:
                _discretized(levels, dt, F, D)
                done = dt
            _turn(m, P, half)
            _stepped(m, P, levels, F, D, M)
            _turn(m, P, half)
        c, s = (np.cos(heading), np.sin(heading)) if both else (1.0, 0.0)
        off_x = (position[i, 0] if turns else position[i, 2]) - now[POSITION]
        off_y = (position[i, 1] if turns else yaw[i]) - now[POSITION + COLUMNS]
        if known[0]:
            _take(m, P, 0, c * off_x + s * off_y, levels[0, 1], gain)
        if known[1]:
            _take(m, P, 1, c * off_y - s * off_x, levels[1, 1], gain)
        for j in range(3):
            out[i, 0, j], out[i, 1, j] = c * m[j] - s * m[3 + j], s * m[j] + c * m[3 + j]
        for a in range(2):
            out[i, a, 3], out[i, a, 4] = now[POSITION + COLUMNS * a], now[V + COLUMNS * a]
        at[0], at[1], at[2] = t, heading, 1.0
        if not begun:
            grid[0] = t
        if t >= grid[0] + grid[1] / SAMPLES:
            _copy(now, now_k, now_u, m, P, kept, kept_k, kept_u, kept_m, kept_P)
            then[0], then[1], then[2] = t, heading, 1.0
            while grid[0] + grid[1] / SAMPLES <= t:
                grid[1] += 1.0
    return out


@inner()
def _copy(
    z: Array, k: Any, u: Array, m: Array, P: Array, to_z: Array, to_k: Any, to_u: Array, to_m: Array, to_P: Array
) -> None:
    """Copies the state of a filter."""
    for n in range(z.size):
        to_z[n] = z[n]
    for a in range(2):
        to_k[a], to_u[a] = k[a], u[a]
    for i in range(6):
        to_m[i] = m[i]
        for j in range(6):
            to_P[i, j] = P[i, j]


@kernel()
def _motion(
    command_time: Array, command: Array, law: Array, series: Array, levels: Array, known: Any, turns: bool, z: Array,
    k: Any, u: Array, mean: Array, covariance: Array, clock: Array,
) -> Array:  # fmt: skip
    """See `MotionFilter.motion`."""
    own = command[:, :2] if turns else command[:, 2:]
    later, out = z.copy(), np.full((2, 6), np.nan)
    until, what, whose, S = clock[0] + AHEAD, np.full(1, MEAN), np.zeros(1, np.int64), np.zeros((2, 3, 12))
    _moved(
        clock[0], until, clock[1], clock[1], command_time, own, law, series, later, k.copy(), u.copy(), what, whose, S
    )  # fmt: skip
    F, D, M = np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), np.empty((6, 7))
    both = turns and known[0] and known[1]
    for a in range(2):  # in the heading frame, in which dampings and trims are defined
        i, b = 3 * a, law[a, DAMPING]
        variance = b * b * covariance[i + 1, i + 1] + 2 * b * covariance[i + 1, i + 2] + covariance[i + 2, i + 2]
        out[a, WIND], out[a, WIND_ERROR] = b * mean[i + 1] + mean[i + 2] + law[a, TRIM], variance**0.5
        out[a, GUSTS] = stationary(levels[a])[0] ** 0.5
    m, C, back = mean.copy(), covariance.copy(), -clock[1] if both else 0.0
    _turn(m, C, back)
    for a in range(2):
        out[a, VELOCITY] = z[V + COLUMNS * a] + m[3 * a + 1]
    m, C = mean.copy(), covariance.copy()
    _discretized(levels, AHEAD, F, D)
    _stepped(m, C, levels, F, D, M)
    _turn(m, C, back)
    for a in range(2):
        i = 3 * a + 1
        out[a, LATER], out[a, LATER_ERROR] = later[V + COLUMNS * a] + m[i], C[i, i] ** 0.5
        if not known[a]:
            out[a] = np.nan
    return out
