"""The exact horizontal response with every sensitivity that the likelihood needs, coupled through the measured yaw.

Each axis has a first-order law with a delay, with or without a lag on its input; `general_response` handles every other
law. The motion is the sum of the responses to inputs, trims and start velocity. These and the derivatives by the delays
step alike, so that the compiler vectorises over them; no number of theirs is written alone but at a switch, because a
vector that is read just after waits for it.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import DAMPING, DELAY, FIRST_ORDER_DELAY, GAIN, LAG, ORDER, TRIM, law_of
from rotorfit.dynamics.general_response import WARM_UP
from rotorfit.dynamics.general_step import impulse, lag_series, lags_in_world
from rotorfit.dynamics.response import VANISH_EVERY, transition, vanished

_SLOT = 8
"""Number of columns that step alike. Each of their variables is a slot of an array `z`."""

_G, _TAU, _C, _V = range(0, _SLOT, 2)
"""Columns of x that step alike: derivatives by input, delay, trim and start velocity; each is followed by that of y."""

_P, _S, _Q, _D, _T = range(0, 10 * _SLOT, 2 * _SLOT)
"""Their variables, of x and then of y: world position, velocity and lagged demand; along the heading, demand and trim.

For the frame of the lagged demand see `general_step.lags_in_world`. Without a lag it is the demand."""

_REST = (0.0, 0.0, 0.0, 0.0)
"""A column that the motion drives, the derivative by a damping or by a lag, at its start: world position and velocity,
x and y each."""


def horizontal_response(
    starts: Array,
    pose_range: Indices,
    command_range: Indices,
    pose_time: Array,
    block: Indices,
    command_time: Array,
    command: Array,
    weight: Array,
    yaw: Array,
    law: Array,
    velocity: Array,
) -> Array:
    """Block means of the horizontal world response, and its sensitivities.

    Args:
        starts: Start of each segment, shape (S,) [s].
        pose_range: First and one past the last pose of each segment, shape (S, 2).
        command_range: The same for the commands, shape (S, 2).
        pose_time: Shape (N,) [s].
        block: Block of each pose, shape (N,).
        command_time: Shape (M,) [s].
        command: Forward and left, shape (M, 2).
        weight: One over the number of poses of each block, shape (B,).
        yaw: Heading at the poses, shape (N,) [rad]; linear in between.
        law: Vectors of the law of x and y, shape (2, LAW_SIZE): linear, without a lag or with one on the input.
        velocity: World velocity at the start of each segment, shape (S, 2) [m/s].

    Returns:
        Shape (B, 13, 2), world components: the position, and its derivatives by g, b, tau, T, c of x and y in turn, and
        by the world velocity at the start of the block's own segment.

    Source: paper, eq. (5), with u(t - tau) behind a lag and a constant added; exact for a heading that is constant
    between events.
    """
    out: Array = np.zeros((weight.size, 2, 13))
    _horizontal_response(
        starts, pose_range, command_range, pose_time, block, command_time, np.ascontiguousarray(command), weight,
        np.ascontiguousarray(yaw), law, np.ascontiguousarray(velocity), lag_series(law), np.zeros(10 * _SLOT),
        np.zeros(2, np.int64), _SLOT, out,
    )  # fmt: skip
    return out.transpose(0, 2, 1)


def plane_response(
    starts: Array,
    pose_range: Indices,
    command_range: Indices,
    pose_time: Array,
    block: Indices,
    command_time: Array,
    command: Array,
    weight: Array,
    yaw: Array,
    gain: Array,
    trim: Array,
    damping: Array,
    delay: Array,
    velocity: Array,
) -> Array:
    """Block means of the horizontal world response under the first-order law with a delay, and its sensitivities.

    Args:
        starts: As for `horizontal_response`, like all arguments that are not described here.
        pose_range: Shape (S, 2).
        command_range: Shape (S, 2).
        pose_time: Shape (N,) [s].
        block: Shape (N,).
        command_time: Shape (M,) [s].
        command: Shape (M, 2).
        weight: Shape (B,).
        yaw: Shape (N,) [rad].
        gain: g of x and y, shape (2,) [m/s^2 per command].
        trim: Constant acceleration in the heading frame, shape (2,) [m/s^2].
        damping: b of x and y, shape (2,) [1/s].
        delay: tau of x and y, shape (2,) [s].
        velocity: Shape (S, 2) [m/s].

    Returns:
        Shape (B, 10, 2), world components: derivatives by g, c, b, tau of x and y in turn, and by v0, the world
        velocity at the start of the block's own segment. The position itself is the sum of g, c and v0 times theirs.

    Source: paper, eq. (5), with u(t - tau) and a constant added; exact for a heading that is constant between events.
    """
    laws = [
        law_of(FIRST_ORDER_DELAY, g, b, tau, {}, c) for g, b, tau, c in zip(gain, damping, delay, trim, strict=True)
    ]
    out = horizontal_response(
        starts, pose_range, command_range, pose_time, block, command_time, command, weight, yaw, np.array(laws),
        velocity,
    )  # fmt: skip
    return out[:, [1, 2, 9, 10, 3, 4, 5, 6, 11, 12]]


@kernel(fastmath={"contract"})
def _horizontal_response(
    starts: Array, pose_range: Any, command_range: Any, pose_time: Array, block: Any, command_time: Array,
    command: Array, weight: Array, yaw: Array, law: Array, velocity: Array, series: Array, z: Array, k: Any, width: int,
    out: Array,
) -> None:  # fmt: skip
    """The compiled loop; `out` (B, 2, 13) is filled with zeros; `z` and `k` are work space.

    `width` is `_SLOT`, not as a constant, so that loops are vectorised rather than unrolled.
    """
    lagged, world = law[0, ORDER] + law[1, ORDER] > 0, lags_in_world(law)
    for s in range(starts.size):
        for n in range(10 * _SLOT):
            z[n] = 0.0
        i, end, last = pose_range[s, 0], pose_range[s, 1], command_range[s, 1]
        t = starts[s] - WARM_UP if lagged else starts[s]
        for a in range(2):
            k[a] = command_range[s, 0]
            while k[a] + 1 < last and command_time[k[a] + 1] + law[a, DELAY] <= t:
                k[a] += 1
            z[_D + _SLOT * a + _G + a] = command[k[a], a]
        qc, qs = (np.cos(yaw[i]), np.sin(yaw[i])) if world else (1.0, 0.0)
        for a in range(2):
            x, y = z[_D + _G + a], z[_D + _SLOT + _G + a]
            z[_Q + _G + a], z[_Q + _SLOT + _G + a] = qc * x - qs * y, qs * x + qc * y
        b0 = b1 = l0 = l1 = _REST  # derivatives by the dampings and by the lags
        left0 = left1 = 0.0, 0.0  # and of the lagged demand by the lags
        heading, warming = yaw[i], True
        while i < end:
            stop = starts[s] if warming else pose_time[i]
            turn = 0.0 if stop <= t else (yaw[i] - heading) / (stop - t)
            while t < stop:
                t_next, switch = stop, 2  # 2 means no switch
                for a in range(2):
                    if k[a] + 1 < last and command_time[k[a] + 1] + law[a, DELAY] <= t_next:
                        t_next, switch = command_time[k[a] + 1] + law[a, DELAY], a
                if t_next > t:
                    psi = yaw[i] + turn * (0.5 * (t + t_next) - stop)
                    c, sn = np.cos(psi), np.sin(psi)
                    qc, qs = (c, sn) if world else (1.0, 0.0)
                    dt = t_next - t
                    x, y = _moved(law, velocity, s, z, _S), _moved(law, velocity, s, z, _S + _SLOT)
                    f0, k0, h0, df0, dk0, dh0 = transition(law[0, DAMPING], dt)
                    f1, k1, h1, df1, dk1, dh1 = transition(law[1, DAMPING], dt)
                    G0, J0, GA0, JA0, JB0, fade0 = _lag_step(law, series, 0, dt)
                    G1, J1, GA1, JA1, JB1, fade1 = _lag_step(law, series, 1, dt)
                    r0, r1 = _behind(law, z, qc, qs)
                    pb, vb = _slowed(law, 0, z, c * x + sn * y, df0, dk0, dh0, GA0, JA0, JB0, r0)
                    b0 = _carried(b0, c, sn, k0, f0, k1, f1, pb, vb, 0.0, 0.0)
                    pb, vb = _slowed(law, 1, z, c * y - sn * x, df1, dk1, dh1, GA1, JA1, JB1, r1)
                    b1 = _carried(b1, c, sn, k0, f0, k1, f1, 0.0, 0.0, pb, vb)
                    if lagged:
                        q0, q1 = qc * left0[0] + qs * left0[1], qc * left0[1] - qs * left0[0]
                        pl, vl, q0 = _late(law, 0, q0, r0, dt, G0, J0, GA0, JA0, JB0, fade0)
                        l0 = _carried(l0, c, sn, k0, f0, k1, f1, pl, vl, J1 * q1, G1 * q1)
                        q1 *= fade1
                        left0 = qc * q0 - qs * q1, qs * q0 + qc * q1
                        q0, q1 = qc * left1[0] + qs * left1[1], qc * left1[1] - qs * left1[0]
                        pl, vl, q1 = _late(law, 1, q1, r1, dt, G1, J1, GA1, JA1, JB1, fade1)
                        l1 = _carried(l1, c, sn, k0, f0, k1, f1, J0 * q0, G0 * q0, pl, vl)
                        q0 *= fade0
                        left1 = qc * q0 - qs * q1, qs * q0 + qc * q1
                        for j in range(width):
                            vx, vy = _turned(z, _S + j, c, sn)
                            qx, qy = _turned(z, _Q + j, qc, qs)
                            dx, dy = z[_D + j], z[_D + _SLOT + j]
                            qx, qy = qx - dx, qy - dy
                            wx, wy = dx + z[_T + j], dy + z[_T + _SLOT + j]
                            px, py = k0 * vx + J0 * qx + h0 * wx, k1 * vy + J1 * qy + h1 * wy
                            vx, vy = f0 * vx + G0 * qx + k0 * wx, f1 * vy + G1 * qy + k1 * wy
                            qx, qy = dx + fade0 * qx, dy + fade1 * qy
                            z[_P + j] += c * px - sn * py
                            z[_P + _SLOT + j] += sn * px + c * py
                            z[_S + j], z[_S + _SLOT + j] = c * vx - sn * vy, sn * vx + c * vy
                            z[_Q + j], z[_Q + _SLOT + j] = qc * qx - qs * qy, qs * qx + qc * qy
                    else:
                        for j in range(width):
                            vx, vy = _turned(z, _S + j, c, sn)
                            wx, wy = z[_D + j] + z[_T + j], z[_D + _SLOT + j] + z[_T + _SLOT + j]
                            px, py = k0 * vx + h0 * wx, k1 * vy + h1 * wy
                            vx, vy = f0 * vx + k0 * wx, f1 * vy + k1 * wy
                            z[_P + j] += c * px - sn * py
                            z[_P + _SLOT + j] += sn * px + c * py
                            z[_S + j], z[_S + _SLOT + j] = c * vx - sn * vy, sn * vx + c * vy
                    t = t_next
                if switch < 2:
                    _switch(law, switch, command[k[switch] + 1, switch], yaw[i] + turn * (t - stop), turn, z)
                    k[switch] += 1
            if warming:  # position, velocity and trim count from here on
                warming = False
                for n in range(2 * _SLOT):
                    z[_P + n] = z[_S + n] = 0.0
                b0 = b1 = l0 = l1 = _REST
                for a in range(2):
                    z[_S + _SLOT * a + _V + a] = z[_T + _SLOT * a + _C + a] = 1.0
                continue
            heading = yaw[i]
            if i % VANISH_EVERY == 0:
                for n in range(_S, 10 * _SLOT):
                    z[n] = vanished(z[n])
                b0, b1, l0, l1 = _settled(b0), _settled(b1), _settled(l0), _settled(l1)
                left0 = vanished(left0[0]), vanished(left0[1])
                left1 = vanished(left1[0]), vanished(left1[1])
            b, w = block[i], weight[block[i]]
            for a in range(2):
                at = _P + _SLOT * a
                out[b, a, 0] += w * _moved(law, velocity, s, z, at)
                for j in range(2):
                    out[b, a, 1 + j] += w * z[at + _G + j]
                    out[b, a, 3 + j] += w * (b0[a] if j == 0 else b1[a])
                    out[b, a, 5 + j] += w * z[at + _TAU + j]
                    out[b, a, 7 + j] += w * (l0[a] if j == 0 else l1[a])
                    out[b, a, 9 + j] += w * z[at + _C + j]
                    out[b, a, 11 + j] += w * z[at + _V + j]
            i += 1


@inner(inline="always", fastmath={"contract"})
def _moved(law: Array, velocity: Array, part: int, z: Array, at: int) -> float:
    """The motion itself, from the columns at `at` by what is linear in it."""
    return (  # type: ignore[no-any-return]
        law[0, GAIN] * z[at + _G] + law[1, GAIN] * z[at + _G + 1]
        + law[0, TRIM] * z[at + _C] + law[1, TRIM] * z[at + _C + 1]
        + velocity[part, 0] * z[at + _V] + velocity[part, 1] * z[at + _V + 1]
    )  # fmt: skip


@inner(inline="always")
def _settled(column: Any) -> Any:
    """A column that the motion drives, without a velocity that has decayed to nothing."""
    return column[0], column[1], vanished(column[2]), vanished(column[3])


@inner(inline="always", fastmath={"contract"})
def _switch(law: Array, a: int, new: float, yaw: float, turn: float, z: Array) -> None:
    """Switches the command of axis a: an impulse into the derivative by the delay, or into its lagged demand.

    Without a lag the lagged demand jumps, in a direction that turns with the time of the switch.
    """
    own = (_SLOT + 1) * a
    c, s = np.cos(yaw), np.sin(yaw)
    qc, qs = (c, s) if lags_in_world(law) else (1.0, 0.0)
    qx, qy = (qc, qs) if a == 0 else (-qs, qc)
    change = z[_D + _G + own] - new
    by_delay = law[a, GAIN] * change
    if law[a, ORDER] == 1:
        z[_Q + _TAU + a] += by_delay / law[a, LAG] * qx
        z[_Q + _SLOT + _TAU + a] += by_delay / law[a, LAG] * qy
    else:
        z[_S + _TAU + a] += by_delay * (c if a == 0 else -s)
        z[_S + _SLOT + _TAU + a] += by_delay * (s if a == 0 else c)
        z[_Q + _G + a] -= change * qx
        z[_Q + _SLOT + _G + a] -= change * qy
        if lags_in_world(law):
            z[_Q + _TAU + a] += by_delay * turn * qy
            z[_Q + _SLOT + _TAU + a] -= by_delay * turn * qx
    z[_D + _G + own] = new


@inner(inline="always", fastmath={"contract"})
def _turned(z: Array, at: int, c: float, s: float) -> Any:
    """A world vector of a column, along the heading and across it."""
    return c * z[at] + s * z[at + _SLOT], c * z[at + _SLOT] - s * z[at]


@inner(inline="always", fastmath={"contract"})
def _behind(law: Array, z: Array, c: float, s: float) -> Any:
    """By how much the lagged demand of both axes exceeds the demand."""
    x, y = law[0, GAIN] * z[_Q + _G], law[0, GAIN] * z[_Q + _SLOT + _G]
    x, y = x + law[1, GAIN] * z[_Q + _G + 1], y + law[1, GAIN] * z[_Q + _SLOT + _G + 1]
    demand_x, demand_y = law[0, GAIN] * z[_D + _G], law[1, GAIN] * z[_D + _SLOT + _G + 1]
    return c * x + s * y - demand_x, c * y - s * x - demand_y


@inner(inline="always", fastmath={"contract"})
def _lag_step(law: Array, series: Array, a: int, dt: float) -> Any:
    """G, J, dG/dA, dJ/dA, dJ/dB of `impulse`, and what the lag still delivers after dt; all 0 without a lag."""
    if law[a, ORDER] == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    rate = 1.0 / law[a, LAG]
    G, J, _, GA, JA, JB, _ = impulse(series, a, rate + law[a, DAMPING], rate * law[a, DAMPING], dt)
    return G, J, GA, JA, JB, np.exp(-rate * dt)


@inner(inline="always", fastmath={"contract"})
def _slowed(
    law: Array, a: int, z: Array, v: float, df: float, dk: float, dh: float, GA: float, JA: float, JB: float,
    behind: float,
) -> Any:  # fmt: skip
    """What a step adds to position and velocity, along axis a, of its derivatives by damping.

    Args:
        law: Shape (2, LAW_SIZE).
        a: Index of the axis.
        z: The columns that step alike.
        v: Velocity along the axis.
        df: From `transition`, like dk and dh.
        dk: Likewise.
        dh: Likewise.
        GA: From `_lag_step`, like JA and JB.
        JA: Likewise.
        JB: Likewise.
        behind: From `_behind`.
    """
    own = (_SLOT + 1) * a
    drive = law[a, GAIN] * z[_D + own + _G] + law[a, TRIM] * z[_T + own + _C]
    if law[a, ORDER] == 0:
        return dk * v + dh * drive, df * v + dk * drive
    rate = 1.0 / law[a, LAG]
    return dk * v + dh * drive + (JA + rate * JB) * behind, df * v + dk * drive + (GA + rate * JA) * behind


@inner(inline="always", fastmath={"contract"})
def _late(
    law: Array, a: int, left: float, behind: float, dt: float, G: float, J: float, GA: float, JA: float, JB: float,
    fade: float,
) -> Any:  # fmt: skip
    """What a step adds to position and velocity, along axis a, of its derivatives by the axis's lag.

    Args:
        law: Shape (2, LAW_SIZE).
        a: Index of the axis.
        left: Derivative of its lagged demand.
        behind: From `_behind`.
        dt: The step.
        G: From `_lag_step`, like J, GA, JA, JB and fade.
        J: Likewise.
        GA: Likewise.
        JA: Likewise.
        JB: Likewise.
        fade: Likewise.

    Returns:
        Position and velocity, and `left` after the step.
    """
    if law[a, ORDER] == 0:
        return 0.0, 0.0, 0.0
    damping, change = law[a, DAMPING], -(law[a, LAG] ** -2.0) * behind
    return J * left + change * (JA + damping * JB), G * left + change * (GA + damping * JA), fade * (left - change * dt)


@inner(inline="always", fastmath={"contract"})
def _carried(
    column: Any, c: float, s: float, k0: float, f0: float, k1: float, f1: float, px: float, vx: float, py: float,
    vy: float,
) -> Any:  # fmt: skip
    """A column after a step, with what the step adds to its position and velocity along x and along y."""
    along, across = c * column[2] + s * column[3], c * column[3] - s * column[2]
    px, vx, py, vy = px + k0 * along, vx + f0 * along, py + k1 * across, vy + f1 * across
    return column[0] + c * px - s * py, column[1] + s * px + c * py, c * vx - s * vy, s * vx + c * vy
