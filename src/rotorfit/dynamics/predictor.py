"""Prediction: the model's own causal filter up to an instant, from there only the commands.

Two axes go together: x and y through the heading, or z and yaw side by side under a heading of zero.
"""

from typing import Any

import numba
import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DAMPING, ORDER, TRIM
from rotorfit.dynamics.disturbance import propagate, rotate
from rotorfit.dynamics.filter_bank import bank_tables, judge, move, probe, row_size, start_bank, state_of_bank, take
from rotorfit.dynamics.general_response import advance, demands, longest_step
from rotorfit.dynamics.general_step import MEAN, START, lag_series
from rotorfit.dynamics.response import transition

_WHAT, _WHOSE = np.array([MEAN, TRIM, TRIM, START, START]), np.array([0, 0, 1, 0, 1])
"""Columns of the driven response: the motion, two unit trims, two unit start velocities."""

START_VELOCITY_VARIANCE = 10.0
"""Prior variance of the vehicle's velocity at the first pose, which decays with its own damping [m^2/s^2]."""


@numba.njit(cache=True)
def _move(p: Array, v: Array, drive: Array, damping: Array, c: float, s: float, dt: float) -> None:
    """Moves C world states p, v (C, 2) by dt under heading-frame drives (C, 2); the heading has cosine c and sine s."""
    f0, k0, h0, _, _, _ = transition(damping[0], dt)
    f1, k1, h1, _, _, _ = transition(damping[1], dt)
    for j in range(p.shape[0]):
        vx = c * v[j, 0] + s * v[j, 1]
        vy = c * v[j, 1] - s * v[j, 0]
        px = k0 * vx + h0 * drive[j, 0]
        py = k1 * vy + h1 * drive[j, 1]
        vx = f0 * vx + k0 * drive[j, 0]
        vy = f1 * vy + k1 * drive[j, 1]
        p[j, 0] += c * px - s * py
        p[j, 1] += s * px + c * py
        v[j, 0] = c * vx - s * vy
        v[j, 1] = s * vx + c * vy


@numba.njit(cache=True)
def _drive_until(
    t: float,
    t_end: float,
    yaw: float,
    yaw_end: float,
    k: Any,
    command_time: Array,
    command: Array,
    gain: Array,
    damping: Array,
    delay: Array,
    p: Array,
    v: Array,
    drive: Array,
) -> None:
    """Moves states from t to t_end through every switch on the way; the first state is driven by g u plus its drive."""
    t_start, span = t, max(t_end - t, 1e-12)
    while t < t_end:
        t_next, switch = t_end, -1
        for j in range(2):
            if k[j] + 1 < command_time.size and command_time[k[j] + 1] + delay[j] <= t_next:
                t_next, switch = command_time[k[j] + 1] + delay[j], j
        psi = yaw + (yaw_end - yaw) * (0.5 * (t + t_next) - t_start) / span
        if t_next > t:
            _move(p, v, drive, damping, np.cos(psi), np.sin(psi), t_next - t)
            t = t_next
        if switch >= 0:
            drive[0, switch] += gain[switch] * (command[k[switch] + 1, switch] - command[k[switch], switch])
            k[switch] += 1


@numba.njit(cache=True)
def _settle(law: Array, v: Array, drive: Array, trim: Array, yaw: float, q: Array) -> None:
    """Fills the lagged parts (2, C) as after long holding the command in force, at world velocities v (2, C)."""
    c, s = np.cos(yaw), np.sin(yaw)
    for j in range(v.shape[1]):
        along = (c * v[0, j] + s * v[1, j], c * v[1, j] - s * v[0, j])
        for a in range(2):
            q[a, j] = drive[a, j]
            if law[a, ORDER] == 2:
                q[a, j] += trim[a, j] - law[a, DAMPING] * along[a]


@numba.njit(cache=True)
def _one_column(law: Array, p: Array, v: Array) -> Any:
    """A single column, the motion: what it is, its position and velocity (2, 1) from p, v (1, 2), demand and trim."""
    position, speed, trim = np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 1))
    for a in range(2):
        position[a, 0], speed[a, 0], trim[a, 0] = p[0, a], v[0, a], law[a, TRIM]
    return np.full(1, MEAN), position, speed, np.zeros((2, 1)), trim


@numba.njit(cache=True, fastmath={"contract"})
def _run_free(
    command_time: Array,
    command: Array,
    pose_time: Array,
    before: int,
    last: int,
    yaw: float,
    future_yaw: Array,
    gain: Array,
    damping: Array,
    delay: Array,
    k: Any,
    p: Array,
    v: Array,
    drive: Array,
    z: Array,
    F: Array,
    step: Any,
    out: Array,
    law: Any,
    lagged: Any,
) -> None:
    """Predicts the poses after `before` up to `last` from the driven state p, v (1, 2) and the disturbance z (A, 6).

    The parts of the disturbance fade each in its own way F (A, 2, U, 3, 3), and add up. Under a general law
    (2, LAW_SIZE) its lagged part (2, 1) goes with the state, else both are None.
    """
    t, psi = pose_time[before], yaw
    if law is not None:
        column, position, speed, wanted, trim = _one_column(law, p, v)
        u, S, way = np.zeros(2), np.zeros((2, 3, 12)), np.zeros((2, 1))
        series, longest = lag_series(law), longest_step(law)
        for j in range(2):
            u[j] = command[k[j], j]
        demands(law, column, column, u, wanted)
    for m in range(before + 1, last):
        t_next, psi_next = pose_time[m], future_yaw[m - before - 1]
        if law is None:
            _drive_until(t, t_next, psi, psi_next, k, command_time, command, gain, damping, delay, p, v, drive)
        else:
            advance(
                t, t_next, psi, psi_next, k, command_time.size, command_time, command, law, series, longest, column,
                column, position, speed, lagged, wanted, trim, u, S, way,
            )  # fmt: skip
            for j in range(2):
                p[0, j], v[0, j] = position[j, 0], speed[j, 0]
        half = 0.5 * (psi_next - psi)
        c, s = np.cos(half), np.sin(half)
        for g in range(z.shape[0]):
            rotate(z[g], c, s)
            propagate(z[g], F[g, 0, step[m]], F[g, 1, step[m]])
            rotate(z[g], c, s)
        c, s = np.cos(psi_next), np.sin(psi_next)
        for j in range(2):
            forward, left = z[:, j].sum(), z[:, 3 + j].sum()
            at = (p if j == 0 else v)[0]
            out[m - before - 1, 2 * j] = at[0] + c * forward - s * left
            out[m - before - 1, 2 * j + 1] = at[1] + s * forward + c * left
        t, psi = t_next, psi_next


@numba.njit(cache=True, fastmath={"contract"})
def predict(
    command_time: Array,
    command: Array,
    pose_time: Array,
    pose: Array,
    yaw: Array,
    steps: Array,
    step: Any,
    gain: Array,
    damping: Array,
    delay: Array,
    filter_damping: Array,
    levels: Array,
    trim_variance: Array,
    first: Any,
    last: Any,
    future_yaw: Array,
    law: Any = None,
    origin: Any = None,
    velocity: Any = None,
    tracked: Any = None,
    alone: Any = None,
) -> Any:
    """Predicts one segment from many starts.

    Args:
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        pose_time: Shape (N,) [s]; all at or after the first command plus the delay.
        pose: World, shape (N, 2).
        yaw: Measured heading, shape (N,) [rad].
        steps: Distinct steps between the poses, shape (U,) [s].
        step: Which of them leads to each pose, shape (N,).
        gain: g, shape (2,).
        damping: b, shape (2,) [1/s].
        delay: tau, shape (2,) [s].
        filter_damping: b while the filter tracks, shape (2,) [1/s]; not negative, because a driven response that grows
            by itself cannot be told from the disturbance after a minute.
        levels: q, r, alpha, kappa of the members of the bank, class by class, shape (A, G, 2, 4).
        trim_variance: Prior variance of the trim, shape (2,).
        first: Index of the first pose after each start, shape (S,).
        last: One past the last pose to predict from each start, shape (S,).
        future_yaw: Heading at the predicted poses, shape (S, E) [rad].
        law: Numbers of the general law of both axes, shape (2, LAW_SIZE), in place of gain, damping and delay; None
            for the default law.
        origin: With a general law, the world velocity at the first pose about which the driven response is taken,
            shape (2,): what the data add to it and to the trim is estimated linearly.
        velocity: World velocities at the stamps, shape (N, 2), for the axes of which nothing else is measured; None
            where both have poses.
        tracked: With velocities, whether what tracks each axis was measured at a stamp, shape (N, 2).
        alone: With velocities, whether they track the axis, shape (2,); its level r is then that of a velocity.

    Returns:
        Predicted world position and velocity at the poses, shape (S, E, 4), NaN beyond `last`; the filter's position
        and velocity at the last pose before each start, shape (S, 4); and rows for `start_state_from_rows`.
    """
    S, E = future_yaw.shape
    out = np.full((S, E, 4), np.nan)
    begin = np.empty((S, 4))
    p, v, drive = np.zeros((5, 2)), np.zeros((5, 2)), np.zeros((5, 2))
    drive[1, 0] = drive[2, 1] = v[3, 0] = v[4, 1] = 1.0
    k = np.zeros(2, np.int64)
    for j in range(2):
        while k[j] + 1 < command_time.size and command_time[k[j] + 1] + delay[j] <= pose_time[0]:
            k[j] += 1
        drive[0, j] = gain[j] * command[k[j], j]
    if law is not None:
        position, speed, lagged, wanted, trim, way = (
            np.zeros((2, 5)), np.zeros((2, 5)), np.zeros((2, 5)), np.zeros((2, 5)), np.zeros((2, 5)), np.zeros((2, 5)),
        )  # fmt: skip
        u, work, series, longest = np.zeros(2), np.zeros((2, 3, 12)), lag_series(law), longest_step(law)
        for a in range(2):
            u[a] = command[k[a], a]
            v[0, a] = origin[a]
            trim[a, 1 + a] = 1.0
            for j in range(5):
                speed[a, j] = v[j, a]
        demands(law, _WHAT, _WHOSE, u, wanted)
        _settle(law, speed, wanted, trim, yaw[0], lagged)
    F, Q = bank_tables(steps, levels)
    states = np.empty((S, row_size(levels.shape[0])))
    bank = start_bank(levels, np.append(trim_variance, np.full(2, START_VELOCITY_VARIANCE)))
    measured = np.empty(5)
    s = 0
    for i in range(pose_time.size):
        if i:
            if law is None:
                _drive_until(
                    pose_time[i - 1], pose_time[i], yaw[i - 1], yaw[i], k, command_time, command, gain,
                    filter_damping, delay, p, v, drive,
                )  # fmt: skip
            else:
                advance(
                    pose_time[i - 1], pose_time[i], yaw[i - 1], yaw[i], k, command_time.size, command_time, command,
                    law, series, longest, _WHAT, _WHOSE, position, speed, lagged, wanted, trim, u, work, way,
                )  # fmt: skip
                for j in range(5):
                    for a in range(2):
                        p[j, a], v[j, a] = position[a, j], speed[a, j]
            move(bank, levels, F, Q, step[i], yaw[i] - yaw[i - 1], pose_time[i] - pose_time[i - 1])
        c, sn = np.cos(yaw[i]), np.sin(yaw[i])
        for a in range(2):
            rate = False
            if velocity is not None:
                if not tracked[i, a]:
                    continue
                rate = alone[a]
            for j in range(5):
                x = p[j, 0] if j else pose[i, 0] - pose[0, 0] - p[0, 0]
                y = p[j, 1] if j else pose[i, 1] - pose[0, 1] - p[0, 1]
                if velocity is not None:  # noqa: SIM102  numba leaves out what None decides, one test at a time
                    if rate:
                        x = v[j, 0] if j else velocity[i, 0] - v[0, 0]
                        y = v[j, 1] if j else velocity[i, 1] - v[0, 1]
                measured[j] = c * x + sn * y if a == 0 else c * y - sn * x
            judge(bank, a, rate, measured, pose_time[i])
            take(bank, levels, a, rate, measured)
        probe(bank, pose_time[i])
        while s < S and first[s] == i + 1:
            known, add, z, states[s] = state_of_bank(bank, levels, p, v, c, sn)
            q, w, d, kk = np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)), k.copy()
            for a in range(2):
                q[0, a] = pose[0, a] + p[0, a] + add[a]
                w[0, a] = v[0, a] + add[2 + a]
                d[0, a] = drive[0, a] + known[a, a]
            for j in range(2):
                forward, left = z[:, j].sum(), z[:, 3 + j].sum()
                at = (q if j == 0 else w)[0]
                begin[s, 2 * j] = at[0] + c * forward - sn * left
                begin[s, 2 * j + 1] = at[1] + sn * forward + c * left
            if law is None:
                _run_free(
                    command_time, command, pose_time, i, last[s], yaw[i], future_yaw[s], gain, damping, delay, kk, q, w,
                    d, z, F, step, out[s], None, None,
                )  # fmt: skip
            else:
                known_law, known_lag = law.copy(), np.zeros((2, 1))
                for a in range(2):
                    known_law[a, TRIM] = known[a, a]
                    known_lag[a, 0] = lagged[a, 0] + known[a] @ lagged[a, 1:]
                _run_free(
                    command_time, command, pose_time, i, last[s], yaw[i], future_yaw[s], gain, damping, delay, kk, q, w,
                    d, z, F, step, out[s], known_law, known_lag,
                )  # fmt: skip
            s += 1
    return out, begin, states


@numba.njit(cache=True)
def free_run(
    command_time: Array,
    command: Array,
    gain: Array,
    damping: Array,
    delay: Array,
    position: Array,
    velocity: Array,
    time: Array,
    yaw: Array,
    law: Any = None,
) -> Array:
    """Motion of two axes from a known state under held commands, without trim and disturbance.

    Args:
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        gain: g, shape (2,).
        damping: b, shape (2,) [1/s]; may be negative.
        delay: tau, shape (2,) [s].
        position: World, at the first time, shape (2,).
        velocity: World, at the first time, shape (2,).
        time: Increasing, shape (N,) [s].
        yaw: Heading at those times, shape (N,) [rad].
        law: Numbers of the general law of both axes, shape (2, LAW_SIZE), in place of gain, damping and delay; its lag
            starts as after long holding the command in force. None for the default law.

    Returns:
        Position and velocity, shape (N, 4).
    """
    out = np.empty((time.size, 4))
    p, v, drive = position.copy().reshape(1, 2), velocity.copy().reshape(1, 2), np.zeros((1, 2))
    k = np.zeros(2, np.int64)
    for j in range(2):
        while k[j] + 1 < command_time.size and command_time[k[j] + 1] + delay[j] <= time[0]:
            k[j] += 1
        drive[0, j] = gain[j] * command[k[j], j]
    if law is not None:
        column, place, speed, wanted, trim = _one_column(law, p, v)
        u, S, way, lagged = np.zeros(2), np.zeros((2, 3, 12)), np.zeros((2, 1)), np.zeros((2, 1))
        series, longest = lag_series(law), longest_step(law)
        for j in range(2):
            u[j] = command[k[j], j]
        demands(law, column, column, u, wanted)
        _settle(law, speed, wanted, trim, yaw[0], lagged)
    for i in range(time.size):
        before = max(i - 1, 0)
        if law is None:
            _drive_until(
                time[before], time[i], yaw[before], yaw[i], k, command_time, command, gain, damping, delay, p, v, drive
            )
        else:
            advance(
                time[before], time[i], yaw[before], yaw[i], k, command_time.size, command_time, command, law, series,
                longest, column, column, place, speed, lagged, wanted, trim, u, S, way,
            )  # fmt: skip
            for j in range(2):
                p[0, j], v[0, j] = place[j, 0], speed[j, 0]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = p[0, 0], p[0, 1], v[0, 0], v[0, 1]
    return out
