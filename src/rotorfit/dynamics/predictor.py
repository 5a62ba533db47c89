"""Prediction: the model's own causal filter up to an instant, from then on only the commands.

Two axes are processed together: x and y through the heading, or z and yaw in parallel under a heading of zero.
"""

from typing import Any

import numpy as np

from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import DELAY, TRIM
from rotorfit.dynamics.compiled import inner, kernel
from rotorfit.dynamics.filter_bank import (
    bank_tables,
    empty_sum,
    judge,
    move,
    probe,
    row_size,
    start_bank,
    sum_bank,
    take,
)
from rotorfit.dynamics.general_response import advance, demands, longest_step, settle
from rotorfit.dynamics.general_step import COLUMNS, MEAN, START, STATE, P, Q, T, V, lag_series

_WHAT, _WHOSE = np.array([MEAN, TRIM, TRIM, START, START]), np.array([0, 0, 1, 0, 1])
"""Columns of the driven response: the motion, two unit trims, two unit start velocities."""

START_VELOCITY_VARIANCE = 10.0
"""Prior variance of the vehicle's velocity at the first pose, which decays with the vehicle's damping [m^2/s^2]."""


@inner()
def fade(z: Array, row: int, column: int, table: Array, g: int, k: int, c: float, s: float) -> None:
    """Propagates the disturbance z[row, column] (6,) of class g by step k of a table; c and s are for half the turn."""
    n, v, w = z[row, column, 0], z[row, column, 1], z[row, column, 2]
    N, V, W = z[row, column, 3], z[row, column, 4], z[row, column, 5]
    if s != 0.0:
        n, N = c * n + s * N, c * N - s * n
        v, V = c * v + s * V, c * V - s * v
        w, W = c * w + s * W, c * W - s * w
    n += table[k, 0, 0, g] * v + table[k, 0, 1, g] * w
    v, w = table[k, 0, 2, g] * v + table[k, 0, 3, g] * w, table[k, 0, 4, g] * v + table[k, 0, 5, g] * w
    N += table[k, 1, 0, g] * V + table[k, 1, 1, g] * W
    V, W = table[k, 1, 2, g] * V + table[k, 1, 3, g] * W, table[k, 1, 4, g] * V + table[k, 1, 5, g] * W
    if s != 0.0:
        n, N = c * n + s * N, c * N - s * n
        v, V = c * v + s * V, c * V - s * v
        w, W = c * w + s * W, c * W - s * w
    z[row, column, 0], z[row, column, 1], z[row, column, 2] = n, v, w
    z[row, column, 3], z[row, column, 4], z[row, column, 5] = N, V, W


@inner()
def _in_force(t: float, law: Array, command_time: Array, command: Array, k: Any, u: Array) -> None:
    """Fills the index and value of the command acting on each axis at t, both shape (2,)."""
    for j in range(2):
        k[j] = 0
        while k[j] + 1 < command_time.size and command_time[k[j] + 1] + law[j, DELAY] <= t:
            k[j] += 1
        u[j] = command[k[j], j]


@inner(fastmath={"contract"})
def _run_free(
    command_time: Array,
    command: Array,
    pose_time: Array,
    before: int,
    last: int,
    yaw: float,
    future_yaw: Array,
    law: Array,
    series: Array,
    free: Any,
    parts: Array,
    table: Array,
    step: Any,
    out: Array,
    row: int,
) -> None:
    """Predicts the poses after `before` up to `last` from the driven state and the disturbance, into out[row].

    The parts (A, 1, 6) of the disturbance decay with their own transitions, and sum up.
    """
    z, k, u, what, whose, S = free
    t, psi = pose_time[before], yaw
    longest = longest_step(law)
    z[T], z[T + COLUMNS] = law[0, TRIM], law[1, TRIM]
    demands(law, what, whose, u, z)
    for m in range(before + 1, last):
        t_next, psi_next = pose_time[m], future_yaw[row, m - before - 1]
        advance(
            t, t_next, psi, psi_next, k, command_time.size, command_time, command, law, series, longest, what, whose,
            z, u, S,
        )  # fmt: skip
        half = 0.5 * (psi_next - psi)
        c, s = np.cos(half), np.sin(half)
        for g in range(parts.shape[0]):
            for j in range(parts.shape[1]):
                fade(parts, g, j, table, g, step[m], c, s)
        _add(parts, z, np.cos(psi_next), np.sin(psi_next), out, row, m - before - 1)
        t, psi = t_next, psi_next


@inner()
def _add(parts: Array, z: Array, c: float, s: float, out: Array, row: int, place: int) -> None:
    """Fills world position and velocity, out[row, place]: the driven state plus the disturbance."""
    for j in range(2):
        forward = left = 0.0
        for g in range(parts.shape[0]):
            forward += parts[g, 0, j]
            left += parts[g, 0, 3 + j]
        at = P if j == 0 else V
        out[row, place, 2 * j] = z[at] + c * forward - s * left
        out[row, place, 2 * j + 1] = z[at + COLUMNS] + s * forward + c * left


class Forecast:
    """Two axes of one segment, filtered up to the latest start.

    Args:
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        pose_time: Shape (N,) [s]; all at or after the first command plus the delay.
        pose: World, shape (N, 2).
        yaw: Measured heading, shape (N,) [rad].
        steps: Distinct steps between the poses, shape (U,) [s].
        step: Index of the step that leads to each pose, shape (N,).
        law: Vectors of the general law of both axes, shape (2, LAW_SIZE).
        filter_law: The same for the filter: its damping is positive, because a driven response that grows by itself
            cannot be separated from the disturbance after a minute.
        origin: World velocity at the first pose about which the driven response is linearised, shape (2,); deviations
            from it and the trim are estimated linearly.
        levels: q, r, alpha, kappa of the members of the bank, class by class, shape (A, G, 2, 4).
        trim_variance: Prior variance of the trim, shape (2,).
        velocity: World velocities at the stamps, shape (N, 2), used for axes without any other measurement.
        tracked: Whether the measurement that tracks each axis exists at a stamp, shape (N, 2).
        alone: Whether velocities track the axis, shape (2,); its level r is then that of a velocity.
    """

    def __init__(
        self,
        command_time: Array,
        command: Array,
        pose_time: Array,
        pose: Array,
        yaw: Array,
        steps: Array,
        step: Any,
        law: Array,
        filter_law: Array,
        origin: Array,
        levels: Array,
        trim_variance: Array,
        velocity: Array,
        tracked: Any,
        alone: Any,
    ) -> None:
        prior = np.concatenate([trim_variance, np.full(2, START_VELOCITY_VARIANCE)])
        self._classes = len(levels)
        self._given = (
            command_time, command, pose_time, pose, yaw, step, law, lag_series(law), filter_law,
            lag_series(filter_law), origin, levels, velocity, tracked, alone,
        )  # fmt: skip
        self._kept = (
            np.zeros(1, np.int64), law.copy(), bank_tables(steps, levels), start_bank(levels, prior),
            empty_sum(levels), _columns(_WHAT, _WHOSE), _columns(_WHAT[:1], _WHOSE[:1]), np.empty(5),
        )  # fmt: skip

    def starts(self, first: Indices, last: Indices, future_yaw: Array) -> tuple[Array, Array, Array]:
        """Predicts from the next starts.

        Args:
            first: Index of the first pose after each start, increasing from call to call, shape (S,).
            last: One past the last pose to predict from each start, shape (S,).
            future_yaw: Heading at the predicted poses, shape (S, E) [rad].

        Returns:
            Predicted world position and velocity at the poses, shape (S, E, 4), NaN beyond `last`; the filter's
            position and velocity at the last pose before each start, shape (S, 4); and rows for
            `start_state_from_rows`, shape (S, `row_size(A)`).
        """
        S, E = future_yaw.shape
        out, begin, states = np.full((S, E, 4), np.nan), np.empty((S, 1, 4)), np.zeros((S, row_size(self._classes)))
        _predict(*self._given, first, last, future_yaw, *self._kept, out, begin, states)
        return out, begin[:, 0], states


def _columns(what: Indices, whose: Indices) -> tuple[Array, Indices, Array, Indices, Indices, Array]:
    """Driven columns of two axes: their state, the commands in force (index and value), what, whose, and work space."""
    return np.zeros(STATE), np.zeros(2, np.int64), np.zeros(2), what.copy(), whose.copy(), np.zeros((2, 3, 12))


@kernel(fastmath={"contract"})
def _predict(
    command_time: Array, command: Array, pose_time: Array, pose: Array, yaw: Array, step: Any, law: Array,
    series: Array, filter_law: Array, filter_series: Array, origin: Array, levels: Array, velocity: Array, tracked: Any,
    alone: Any, first: Any, last: Any, future_yaw: Array, filtered: Any, known_law: Array, table: Array,
    bank: Any, both: Any, tracking: Any, free: Any, measured: Any, out: Array, begin: Array, states: Array,
) -> None:  # fmt: skip
    """The loop over the starts, and over the poses up to each; `filtered` (1,) counts these across calls.

    The arguments after `future_yaw` are work space kept across calls, or outputs.
    """
    z, k, u, what, whose, S = tracking
    known, add, parts = both.known, both.add, both.parts
    run, run_k, run_u = free[0], free[1], free[2]
    longest = longest_step(filter_law)
    if not filtered[0]:
        _in_force(pose_time[0], law, command_time, command, k, u)
        for a in range(2):
            own = COLUMNS * a
            z[V + own] = origin[a]
            z[T + own + 1 + a] = 1.0
            z[V + own + 3 + a] = 1.0
        demands(filter_law, what, whose, u, z)
        settle(filter_law, z, what.size, yaw[0])
    for s in range(first.size):
        while filtered[0] < first[s]:
            i = filtered[0]
            filtered[0] += 1
            if i:
                advance(
                    pose_time[i - 1], pose_time[i], yaw[i - 1], yaw[i], k, command_time.size, command_time, command,
                    filter_law, filter_series, longest, what, whose, z, u, S,
                )  # fmt: skip
                move(bank, table, step[i], yaw[i] - yaw[i - 1], pose_time[i] - pose_time[i - 1])
            c, sn = np.cos(yaw[i]), np.sin(yaw[i])
            for a in range(2):
                if not tracked[i, a]:
                    continue
                for j in range(5):
                    at = (V if alone[a] else P) + j
                    x, y = z[at], z[at + COLUMNS]
                    if j == 0 and alone[a]:
                        x, y = velocity[i, 0] - x, velocity[i, 1] - y
                    elif j == 0:
                        x, y = pose[i, 0] - pose[0, 0] - x, pose[i, 1] - pose[0, 1] - y
                    measured[j] = c * x + sn * y if a == 0 else c * y - sn * x
                judge(bank, a, alone[a], measured, pose_time[i])
                take(bank, a, alone[a], measured)
            probe(bank, pose_time[i])
        i = filtered[0] - 1
        c, sn = np.cos(yaw[i]), np.sin(yaw[i])
        sum_bank(bank, levels, z, c, sn, both, states, s)
        for a in range(2):
            own = COLUMNS * a
            run[P + own] = pose[0, a] + z[P + own] + add[a]
            run[V + own] = z[V + own] + add[2 + a]
            run[Q + own] = z[Q + own]
            for j in range(4):
                run[Q + own] += known[a, j] * z[Q + own + 1 + j]
            known_law[a, TRIM] = known[a, a]
            run_k[a] = k[a]
            run_u[a] = u[a]
        for j in range(begin.shape[1]):
            _add(parts, run, c, sn, begin, s, j)
        _run_free(
            command_time, command, pose_time, i, last[s], yaw[i], future_yaw, known_law, series, free, parts, table,
            step, out, s,
        )  # fmt: skip


def free_run(
    command_time: Array, command: Array, law: Array, position: Array, velocity: Array, time: Array, yaw: Array
) -> Array:
    """Motion of two axes from a known state under held commands, without trim and disturbance.

    Args:
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        law: Vectors of the general law of both axes, shape (2, LAW_SIZE); a lag starts in its steady state under the
            command in force. The damping may be negative.
        position: World, at the first time, shape (2,).
        velocity: World, at the first time, shape (2,).
        time: Increasing, shape (N,) [s].
        yaw: Heading at those times, shape (N,) [rad].

    Returns:
        World position and velocity, shape (N, 4).
    """
    out: Array = np.empty((len(time), 4))
    position, velocity, time, yaw = (np.ascontiguousarray(one) for one in (position, velocity, time, yaw))
    _free_run(
        command_time, np.ascontiguousarray(command), law, lag_series(law), position, velocity, time, yaw,
        _columns(_WHAT[:1], _WHOSE[:1]), out,
    )  # fmt: skip
    return out


@kernel()
def _free_run(
    command_time: Array, command: Array, law: Array, series: Array, position: Array, velocity: Array, time: Array,
    yaw: Array, free: Any, out: Array,
) -> None:  # fmt: skip
    """The compiled loop; `free` is work space."""
    z, k, u, what, whose, S = free
    longest = longest_step(law)
    for a in range(2):
        own = COLUMNS * a
        z[P + own], z[V + own], z[T + own] = position[a], velocity[a], law[a, TRIM]
    _in_force(time[0], law, command_time, command, k, u)
    demands(law, what, whose, u, z)
    settle(law, z, what.size, yaw[0])
    for i in range(time.size):
        before = max(i - 1, 0)
        advance(
            time[before], time[i], yaw[before], yaw[i], k, command_time.size, command_time, command, law, series,
            longest, what, whose, z, u, S,
        )  # fmt: skip
        for a in range(2):
            out[i, a], out[i, 2 + a] = z[P + COLUMNS * a], z[V + COLUMNS * a]
