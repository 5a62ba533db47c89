"""Motions of two axes from many starts under the commands alone, side by side.

Runs that overlap in time have the same steps between poses and the same commands in force; they differ in their state
and heading. The state of all runs lies in one array, in slots of one number each, and every step is taken by all active
runs in the vector registers.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import CROSS_DAMPING, DAMPING, DELAY, KICKS, LAG, LIMIT, ORDER, SHARE, SPEED, ZERO
from rotorfit.dynamics.general_response import longest_step
from rotorfit.dynamics.general_step import demand, lag_series, lags_in_world, linear_step

RUNS = 32
"""Width of a slot, and largest number of runs side by side."""

_VECTOR = 4
"""Runs are stepped in multiples of this: those before and after the active ones are computed in vain."""

_PX, _PY, _VX, _VY, _QX, _QY, _TX, _TY = (RUNS * i for i in range(8))
# Position and velocity (world), lagged demand (see `lags_in_world`) or acceleration, trim (heading frame).

_YAW, _TURN, _C, _S, _HALF_C, _HALF_S = (RUNS * i for i in range(8, 14))
# Heading before a step, its change, cosine and sine of the heading, and of half the change.

_OUT = RUNS * 14

STATE = 8
"""Numbers of a run: world position and velocity of both axes, lagged demand (see `lags_in_world`) or acceleration, trim
(heading frame)."""

_TWO_OVER_PI = 2.0 / np.pi

_HALF_PI_HEAD = float.fromhex("0x1.921fb54p+0")

_HALF_PI_REST = np.pi / 2 - _HALF_PI_HEAD + 6.123233995736766e-17
# The first has so few digits that its product with any number of quarter turns below 2^25 is exact.


def free_runs(
    command_time: Array,
    command: Array,
    law: Array,
    pose_time: Array,
    first: Indices,
    last: Indices,
    in_force: Indices,
    state: Array,
    yaw: Array,
    future_yaw: Array,
    parts: Array,
    table: Array,
    step: Indices,
) -> Array:
    """Position and velocity at the poses after each start.

    Args:
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        law: Vectors of the general law of both axes, shape (2, LAW_SIZE).
        pose_time: Shape (N,) [s].
        first: Index of the first pose after each start, increasing, shape (S,); a run begins at the pose before.
        last: One past the last, shape (S,).
        in_force: Index of the command in force at the beginning of each run, for both axes, shape (S, 2).
        state: See `STATE`, shape (S, STATE).
        yaw: Heading at the beginning, shape (S,) [rad].
        future_yaw: Heading at the poses, shape (S, E) [rad].
        parts: Disturbance n, s, s' of both axes at the beginning, as contributions of A classes, shape (S, A, 6).
        table: Their transitions, see `filter_bank.bank_tables`, shape (U, 24, A).
        step: Index of the step that leads to each pose, shape (N,).

    Returns:
        World position and velocity, shape (S, E, 4); NaN beyond `last`.
    """
    out = np.full((*future_yaw.shape, 4), np.nan)
    turns = bool(np.any(yaw) or np.any(future_yaw))
    _free_runs(
        command_time, command, law, lag_series(law), pose_time, first, last, in_force, state, yaw, future_yaw, turns,
        parts, table, step, np.zeros(_OUT + 4 * RUNS), np.zeros((parts.shape[1], 6 * RUNS)), np.zeros(2, np.int64),
        np.zeros((2, 3, 12)), np.zeros(2), out,
    )  # fmt: skip
    return out


@kernel(fastmath={"contract"})
def _free_runs(
    command_time: Array, command: Array, law: Array, series: Array, pose_time: Array, first: Any, last: Any,
    in_force: Any, state: Array, yaw: Array, future_yaw: Array, turns: bool, parts: Array, table: Array, step: Any,
    w: Array, winds: Array, k: Any, S: Array, demanded: Array, out: Array,
) -> None:  # fmt: skip
    """The compiled loop; the arguments from `w` to `demanded` are work space filled with zeros."""
    longest = longest_step(law)
    for j in range(RUNS):
        w[_C + j] = w[_HALF_C + j] = 1.0
    for begin in range(0, first.size, RUNS):
        end = min(begin + RUNS, first.size)
        low = high = begin
        m = first[begin]
        while low < end:
            if low == high:
                m = first[low]
                for a in range(2):
                    k[a] = in_force[low, a]
                _demands(law, command, k, demanded)
            while high < end and first[high] <= m:
                _admit(state, yaw, parts, high, high - begin, turns, w, winds)
                high += 1
            one, past = (low - begin) // _VECTOR * _VECTOR, -((begin - high) // _VECTOR) * _VECTOR
            for i in range(low, high):
                w[_TURN + i - begin] = future_yaw[i, m - first[i]] - w[_YAW + i - begin]
            _advance(
                pose_time[m - 1], pose_time[m], k, command_time, command, law, series, longest, turns, w, S, demanded,
                one, past,
            )  # fmt: skip
            for i in range(low, high):
                w[_YAW + i - begin] = future_yaw[i, m - first[i]]
            if turns:
                _headings(w, one, past)
            for g in range(parts.shape[1]):
                _fade(winds, g, w, table, step[m], one, past)
            _sum(w, winds, one, past)
            for i in range(low, high):
                for n in range(4):
                    out[i, m - first[i], n] = w[_OUT + RUNS * n + i - begin]
            m += 1
            while low < high and last[low] <= m:
                low += 1


@inner()
def _admit(state: Array, yaw: Array, parts: Array, i: int, j: int, turns: bool, w: Array, winds: Array) -> None:
    """Copies run i into place j."""
    for n in range(STATE):
        w[RUNS * n + j] = state[i, n]
    for g in range(parts.shape[1]):
        for n in range(6):
            winds[g, RUNS * n + j] = parts[i, g, n]
    w[_YAW + j] = yaw[i] if turns else 0.0


@inner()
def _demands(law: Array, command: Array, k: Any, out: Array) -> None:
    """Fills the accelerations demanded by the commands in force."""
    x, y = command[k[0], 0], command[k[1], 1]
    out[0], out[1] = demand(law, 0, x, y), demand(law, 1, y, x)


@inner(fastmath={"contract"})
def cosine_sine(x: float) -> Any:
    """Cosine and sine to the last digits; unlike the library's, they vectorise.

    Taylor series about the next quarter turn, of which the angle is at most pi / 4 away.
    """
    quarter = np.floor(x * _TWO_OVER_PI + 0.5)
    r = (x - quarter * _HALF_PI_HEAD) - quarter * _HALF_PI_REST
    z = r * r
    s = 1.0 - z * (1.0 / 210.0) * (1.0 - z * (1.0 / 272.0))
    s = 1.0 - z * (1.0 / 72.0) * (1.0 - z * (1.0 / 110.0) * (1.0 - z * (1.0 / 156.0) * s))
    s = r - r * z * (1.0 / 6.0) * (1.0 - z * (1.0 / 20.0) * (1.0 - z * (1.0 / 42.0) * s))
    c = 1.0 - z * (1.0 / 182.0) * (1.0 - z * (1.0 / 240.0) * (1.0 - z * (1.0 / 306.0)))
    c = 1.0 - z * (1.0 / 56.0) * (1.0 - z * (1.0 / 90.0) * (1.0 - z * (1.0 / 132.0) * c))
    c = 1.0 - z * 0.5 * (1.0 - z * (1.0 / 12.0) * (1.0 - z * (1.0 / 30.0) * c))
    place = np.int64(quarter) & 3
    a, b = (s, c) if place & 1 else (c, s)
    return (-a if (place + 1) & 2 else a), (-b if place & 2 else b)


@inner(fastmath={"contract"})
def _headings(w: Array, one: int, past: int) -> None:
    """Fills cosine and sine of the heading after a step, and of half its change."""
    for j in range(max(one, 0), past):
        w[_C + j], w[_S + j] = cosine_sine(w[_YAW + j])
        w[_HALF_C + j], w[_HALF_S + j] = cosine_sine(0.5 * w[_TURN + j])


@inner(fastmath={"contract"})
def _headings_between(w: Array, share: float, one: int, past: int) -> None:
    """Fills cosine and sine of the heading after a share of a step."""
    for j in range(max(one, 0), past):
        w[_C + j], w[_S + j] = cosine_sine(w[_YAW + j] + share * w[_TURN + j])


@inner()
def _advance(
    t: float, t_end: float, k: Any, command_time: Array, command: Array, law: Array, series: Array, longest: float,
    turns: bool, w: Array, S: Array, demanded: Array, one: int, past: int,
) -> None:  # fmt: skip
    """Propagates the runs from t to t_end through every switch in between; see `general_response.advance`."""
    begin, span = t, max(t_end - t, 1e-12)
    kicked = int(law[0, KICKS]) & 3 > 0 or int(law[1, KICKS]) & 3 > 0
    limited = int(law[0, KICKS]) & 4 > 0 or int(law[1, KICKS]) & 4 > 0
    spin = 1.0 if lags_in_world(law) else 0.0
    while t < t_end:
        t_next, switch = t_end, 2
        for a in range(2):
            if k[a] + 1 < command_time.size and command_time[k[a] + 1] + law[a, DELAY] <= t_next:
                t_next, switch = command_time[k[a] + 1] + law[a, DELAY], a
        if t_next > t:
            pieces = int(np.ceil((t_next - t) / longest - 1e-9)) if longest < t_next - t else 1
            dt = (t_next - t) / pieces
            if turns:
                _headings_between(w, (0.5 * (t + t_next) - begin) / span, one, past)
            for a in range(2):
                linear_step(law, series, a, dt, S)
            for _ in range(pieces):
                if kicked:
                    _kick(law, w, 0.5 * dt, one, past)
                _move(law, w, S, demanded[0], demanded[1], dt if limited else 0.0, spin, one, past)
                if kicked:
                    _kick(law, w, 0.5 * dt, one, past)
            t = t_next
        if switch < 2:
            x, y = demanded[0], demanded[1]
            k[switch] += 1
            _demands(law, command, k, demanded)
            x, y = _jump(law, 0, demanded[0] - x, spin), _jump(law, 1, demanded[1] - y, spin)
            if spin and turns and (x != 0.0 or y != 0.0):
                _headings_between(w, (t - begin) / span, one, past)
            for j in range(max(one, 0), past):
                qc, qs = 1.0 + spin * (w[_C + j] - 1.0), spin * w[_S + j]
                w[_QX + j] += qc * x - qs * y
                w[_QY + j] += qs * x + qc * y


@inner()
def _jump(law: Array, a: int, change: float, spin: float) -> float:
    """By how much the lagged demand of an axis, or its acceleration, jumps with the demand."""
    if law[a, ORDER] == 2:
        return law[a, ZERO] / law[a, LAG] * change  # type: ignore[no-any-return]
    return change * spin if law[a, ORDER] == 0 else 0.0


@inner(fastmath={"contract"})
def _move(
    law: Array, w: Array, S: Array, wx: float, wy: float, limit_step: float, spin: float, one: int, past: int
) -> None:
    """The linear step `S` (2, 3, 12) of all runs under the demands wx and wy; see `general_step.linear_step`.

    `spin` is 1 where the lagged demand is in the world frame, else 0; `limit_step` is the step where an axis has a
    limit, see `general_step`, else 0.
    """
    xpv, xpq, xpc, xvv, xvq, xvc = S[0, 0, 0], S[0, 0, 1], S[0, 0, 3], S[0, 0, 4], S[0, 0, 5], S[0, 0, 7]
    xqv, xqq, xqc = S[0, 0, 8], S[0, 0, 9], S[0, 0, 11]
    xpw, xvw, xqw = S[0, 0, 2], S[0, 0, 6], S[0, 0, 10]
    ypv, ypq, ypc, yvv, yvq, yvc = S[1, 0, 0], S[1, 0, 1], S[1, 0, 3], S[1, 0, 4], S[1, 0, 5], S[1, 0, 7]
    yqv, yqq, yqc = S[1, 0, 8], S[1, 0, 9], S[1, 0, 11]
    ypw, yvw, yqw = S[1, 0, 2], S[1, 0, 6], S[1, 0, 10]
    bx, by, most_x, most_y = law[0, DAMPING], law[1, DAMPING], law[0, LIMIT], law[1, LIMIT]
    bent_x, bent_y = int(law[0, KICKS]) & 4 > 0, int(law[1, KICKS]) & 4 > 0
    for j in range(max(one, 0), past):
        vx, vy, qx, qy, tx, ty = w[_VX + j], w[_VY + j], w[_QX + j], w[_QY + j], w[_TX + j], w[_TY + j]
        c, s = w[_C + j], w[_S + j]
        qc, qs = 1.0 + spin * (c - 1.0), spin * s
        vx, vy = c * vx + s * vy, c * vy - s * vx
        qx, qy = qc * qx + qs * qy, qc * qy - qs * qx
        ux, uy = wx, wy
        if limit_step:
            mx, my = bx * (vx + 0.5 * limit_step * qx), by * (vy + 0.5 * limit_step * qy)
            dx, dy = wx - mx, wy - my
            share = 1.0 / max(1.0, np.sqrt((dx / most_x) ** 2 + (dy / most_y) ** 2))
            ux, uy = mx + (share if bent_x else 1.0) * dx, my + (share if bent_y else 1.0) * dy
        px, py = xpv * vx + xpq * qx + xpw * ux + xpc * tx, ypv * vy + ypq * qy + ypw * uy + ypc * ty
        lx, ly = xqv * vx + xqq * qx + xqw * ux + xqc * tx, yqv * vy + yqq * qy + yqw * uy + yqc * ty
        w[_QX + j], w[_QY + j] = qc * lx - qs * ly, qs * lx + qc * ly
        vx, vy = xvv * vx + xvq * qx + xvw * ux + xvc * tx, yvv * vy + yvq * qy + yvw * uy + yvc * ty
        w[_PX + j] += c * px - s * py
        w[_PY + j] += s * px + c * py
        w[_VX + j], w[_VY + j] = c * vx - s * vy, s * vx + c * vy


@inner(fastmath={"contract"})
def _kick(law: Array, w: Array, dt: float, one: int, past: int) -> None:
    """Applies quadratic drag and cross damping for dt to the velocities of all runs; see `general_step`."""
    across = int(law[0, KICKS]) & 2 > 0
    first, second = (law[0, CROSS_DAMPING] * dt, law[1, CROSS_DAMPING] * dt) if across else (0.0, 0.0)
    own = 1.0 + 0.5 * first * second
    dx, dy = _drag(law, 0) * dt, _drag(law, 1) * dt
    for j in range(max(one, 0), past):
        vx, vy, c, s = w[_VX + j], w[_VY + j], w[_C + j], w[_S + j]
        vx, vy = c * vx + s * vy, c * vy - s * vx
        vx, vy = vx / (1.0 + dx * abs(vx)), vy / (1.0 + dy * abs(vy))
        vx, vy = own * vx - first * vy, own * vy - second * vx
        w[_VX + j], w[_VY + j] = c * vx - s * vy, s * vx + c * vy


@inner()
def _drag(law: Array, a: int) -> float:
    """Quadratic drag of an axis: deceleration over the squared velocity."""
    return law[a, DAMPING] * law[a, SHARE] / law[a, SPEED] if int(law[a, KICKS]) & 1 else 0.0


@inner(fastmath={"contract"})
def _fade(z: Array, g: int, w: Array, table: Array, k: int, one: int, past: int) -> None:
    """Propagates the disturbances z[g] (6 * RUNS,) of class g of all runs by step k of the table."""
    x01, x02, x11 = table[k, 0, g], table[k, 1, g], table[k, 2, g]
    x12, x21, x22 = table[k, 3, g], table[k, 4, g], table[k, 5, g]
    y01, y02, y11 = table[k, 12, g], table[k, 13, g], table[k, 14, g]
    y12, y21, y22 = table[k, 15, g], table[k, 16, g], table[k, 17, g]
    for j in range(max(one, 0), past):
        c, s = w[_HALF_C + j], w[_HALF_S + j]
        n, v, a = z[g, j], z[g, RUNS + j], z[g, 2 * RUNS + j]
        N, V, A = z[g, 3 * RUNS + j], z[g, 4 * RUNS + j], z[g, 5 * RUNS + j]
        n, v, a, N, V, A = c * n + s * N, c * v + s * V, c * a + s * A, c * N - s * n, c * V - s * v, c * A - s * a
        n, v, a = n + x01 * v + x02 * a, x11 * v + x12 * a, x21 * v + x22 * a
        N, V, A = N + y01 * V + y02 * A, y11 * V + y12 * A, y21 * V + y22 * A
        z[g, j], z[g, RUNS + j], z[g, 2 * RUNS + j] = c * n + s * N, c * v + s * V, c * a + s * A
        z[g, 3 * RUNS + j], z[g, 4 * RUNS + j], z[g, 5 * RUNS + j] = c * N - s * n, c * V - s * v, c * A - s * a


@inner(fastmath={"contract"})
def _sum(w: Array, z: Array, one: int, past: int) -> None:
    """Fills world position and velocity of all runs: the driven motion plus the disturbance."""
    for j in range(max(one, 0), past):
        w[_OUT + j], w[_OUT + RUNS + j] = w[_PX + j], w[_PY + j]
        w[_OUT + 2 * RUNS + j], w[_OUT + 3 * RUNS + j] = w[_VX + j], w[_VY + j]
    for g in range(z.shape[0]):
        for j in range(max(one, 0), past):
            c, s = w[_C + j], w[_S + j]
            w[_OUT + j] += c * z[g, j] - s * z[g, 3 * RUNS + j]
            w[_OUT + RUNS + j] += s * z[g, j] + c * z[g, 3 * RUNS + j]
            w[_OUT + 2 * RUNS + j] += c * z[g, RUNS + j] - s * z[g, 4 * RUNS + j]
            w[_OUT + 3 * RUNS + j] += s * z[g, RUNS + j] + c * z[g, 4 * RUNS + j]
