"""Prediction: the model's own causal filter up to an instant, from then on only the commands.

Two axes are processed together: x and y through the heading, or z and yaw in parallel under a heading of zero.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import DELAY, TRIM
from rotorfit.dynamics.filter_bank import COLUMNS_FILTERED, bank_tables, judge, move, probe, start_bank, take
from rotorfit.dynamics.free_runs import STATE as RUN
from rotorfit.dynamics.free_runs import free_runs
from rotorfit.dynamics.general_response import advance, demands, longest_step, settle
from rotorfit.dynamics.general_step import COLUMNS, MEAN, START, STATE, P, Q, T, V, lag_series
from rotorfit.dynamics.response import VANISH_EVERY, vanished
from rotorfit.dynamics.start_state import empty_sum, row_size, sum_bank

_WHAT, _WHOSE = np.array([MEAN, TRIM, TRIM, START, START]), np.array([0, 0, 1, 0, 1])
"""Columns of the driven response: the motion, two unit trims, two unit start velocities."""

START_VELOCITY_VARIANCE = 10.0
"""Prior variance of the vehicle's velocity at the first pose, which decays with the vehicle's damping [m^2/s^2]."""


@inner()
def _in_force(t: float, law: Array, command_time: Array, command: Array, k: Any, u: Array) -> None:
    """Fills the index and value of the command acting on each axis at t, both shape (2,)."""
    for j in range(2):
        k[j] = 0
        while k[j] + 1 < command_time.size and command_time[k[j] + 1] + law[j, DELAY] <= t:
            k[j] += 1
        u[j] = command[k[j], j]


JUST_BEFORE = 1e-9
"""Time before a start at which the command counts that has been held until then [s]."""


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
            command_time, command, pose_time, pose, yaw, step, law, filter_law, lag_series(filter_law), origin, levels,
            velocity, tracked, alone,
        )  # fmt: skip
        self._table = bank_tables(steps, levels)
        self._kept = (
            np.zeros(1, np.int64), self._table, start_bank(levels, prior), empty_sum(levels), _columns(_WHAT, _WHOSE),
            np.empty(5),
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
        S = first.size
        state, in_force = np.empty((S, RUN)), np.empty((S, 2), np.int64)
        parts, rows = np.empty((S, self._classes, 6)), np.zeros((S, row_size(self._classes)))
        _filter(*self._given, first, *self._kept, state, in_force, parts, rows)
        command_time, command, pose_time, _, heading, step, law = self._given[:7]
        yaw = heading[first - 1]
        out = free_runs(
            command_time, command, law, pose_time, first, last, in_force, state, yaw, future_yaw, parts, self._table,
            step,
        )  # fmt: skip
        c, s, (n, v) = np.cos(yaw), np.sin(yaw), parts.sum(axis=1).reshape(-1, 2, 3).transpose(2, 0, 1)[:2]
        begin = state[:, :4].copy()
        for i, (forward, left) in enumerate((n.T, v.T)):
            begin[:, 2 * i] += c * forward - s * left
            begin[:, 2 * i + 1] += s * forward + c * left
        return out, begin, rows


def _columns(what: Indices, whose: Indices) -> tuple[Array, Indices, Array, Indices, Indices, Array]:
    """Driven columns of two axes: their state, the commands in force (index and value), what, whose, and work space."""
    return np.zeros(STATE), np.zeros(2, np.int64), np.zeros(2), what.copy(), whose.copy(), np.zeros((2, 3, 12))


@kernel(fastmath={"contract"})
def _filter(
    command_time: Array, command: Array, pose_time: Array, pose: Array, yaw: Array, step: Any, law: Array,
    filter_law: Array, filter_series: Array, origin: Array, levels: Array, velocity: Array, tracked: Any, alone: Any,
    first: Any, filtered: Any, table: Array, bank: Any, both: Any, tracking: Any, measured: Array, state: Array,
    in_force: Any, parts: Array, rows: Array,
) -> None:  # fmt: skip
    """The loop over the starts, and over the poses up to each; `filtered` (1,) counts these across calls.

    The arguments after `first` are work space kept across calls, or outputs: state, command in force and disturbance
    for `free_runs`, and rows as for `Forecast.starts`.
    """
    z, k, u, what, whose, S = tracking
    known, add = both.known, both.add
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
                if i % VANISH_EVERY == 0:  # the responses to start velocities, which decay
                    for n in range(z.size):
                        z[n] = vanished(z[n])
                    for j in range(COLUMNS_FILTERED):
                        for n in range(bank.winds.shape[1]):
                            bank.winds[j, n] = vanished(bank.winds[j, n])
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
        sum_bank(bank, levels, z, c, sn, both, parts, rows, s)
        for a in range(2):
            own = COLUMNS * a
            state[s, a] = pose[0, a] + z[P + own] + add[a]
            state[s, 2 + a] = z[V + own] + add[2 + a]
            state[s, 4 + a] = z[Q + own]
            for j in range(4):
                state[s, 4 + a] += known[a, j] * z[Q + own + 1 + j]
            state[s, 6 + a] = known[a, a]
            in_force[s, a] = k[a]


def free_run(
    command_time: Array, command: Array, law: Array, position: Array, velocity: Array, time: Array, yaw: Array
) -> Array:
    """Motion of two axes from a known state under held commands, without trim and disturbance.

    Args:
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        law: Vectors of the general law of both axes, shape (2, LAW_SIZE); a lag starts in its steady state under the
            command in force just before. The damping may be negative.
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
    _in_force(time[0] - JUST_BEFORE, law, command_time, command, k, u)
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
