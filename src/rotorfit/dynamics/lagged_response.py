"""The exact response under a linear law with a lag, with every sensitivity that the likelihood needs.

`general_response` handles every law; this module covers the linear laws with a lag: of one axis with a lag on the
input, T q' = w - q, or of second order with a zero, T v'' + v' + b v = w + Z w'; and of x with y, both with a lag on
the input. Their motion is the sum of the responses to input, trim and start velocity, so few numbers need to be
propagated.
"""

from typing import Any

import numpy as np

from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import DAMPING, DELAY, GAIN, LAG, ORDER, TRIM, ZERO
from rotorfit.dynamics.compiled import inner, kernel
from rotorfit.dynamics.general_response import WARM_UP, longest_step
from rotorfit.dynamics.general_step import lag_series
from rotorfit.dynamics.response import transition


def lagged_axis_response(
    starts: Array,
    pose_range: Indices,
    command_range: Indices,
    pose_time: Array,
    block: Indices,
    command_time: Array,
    command: Array,
    weight: Array,
    law: Array,
    velocity: Array,
) -> Array:
    """Block means of the position response of one axis with a lag, and its sensitivities.

    Args:
        starts: Start of each segment, shape (S,) [s].
        pose_range: First and one past the last pose of each segment, shape (S, 2).
        command_range: The same for the commands, shape (S, 2).
        pose_time: Shape (N,) [s].
        block: Block of each pose, shape (N,).
        command_time: Shape (M,) [s].
        command: Shape (M,).
        weight: One over the number of poses of each block, shape (B,).
        law: Vector of the law of the axis, shape (1, LAW_SIZE), linear and with a lag.
        velocity: Velocity at the start of each segment, shape (S,) [unit/s].

    Returns:
        Shape (B, 8, 1): the position, and its derivatives by g, b, tau, T, Z, c and the velocity at the start of the
        block's own segment.
    """
    out: Array = np.zeros((weight.size, 8, 1))
    _lagged_axis_response(
        starts, pose_range, command_range, pose_time, block, command_time, np.ascontiguousarray(command), weight, law,
        np.ascontiguousarray(velocity), lag_series(law)[0], out,
    )  # fmt: skip
    return out


@kernel(fastmath={"contract"})
def _lagged_axis_response(
    starts: Array, pose_range: Any, command_range: Any, pose_time: Array, block: Any, command_time: Array,
    command: Array, weight: Array, law: Array, velocity: Array, series: Array, out: Array,
) -> None:  # fmt: skip
    """The compiled loop; `out` is filled with zeros."""
    gain, trim, damping, delay = law[0, GAIN], law[0, TRIM], law[0, DAMPING], law[0, DELAY]
    rate, second, lead = 1.0 / law[0, LAG], law[0, ORDER] == 2, law[0, ZERO] / law[0, LAG]
    longest = longest_step(law)
    for s in range(starts.size):
        t, begin = starts[s] - WARM_UP, starts[s]
        k, last = command_range[s, 0], command_range[s, 1]
        while k + 1 < last and command_time[k + 1] + delay <= t:
            k += 1
        u = command[k]
        # position, velocity and third state (lagged demand, or acceleration of a second order) for: a unit gain,
        # a unit trim, a unit start velocity, and the derivatives by damping, delay, lag and zero
        gp = gv = cp = cv = cq = sp = sv = sq = 0.0
        bp = bv = bq = tp = tv = tq = lp = lv = lq = zp = zv = zq = 0.0
        gq = u
        i, end = pose_range[s, 0], pose_range[s, 1]
        v0, c0 = 0.0, 0.0
        warming = True
        while i < end:
            stop = begin if warming else pose_time[i]
            while t < stop:
                switch = k + 1 < last and command_time[k + 1] + delay <= stop
                t_next = command_time[k + 1] + delay if switch else stop
                while t < t_next:
                    dt = min(t_next - t, longest)
                    v = gain * gv + c0 * cv + v0 * sv
                    q = gain * gq + c0 * cq + v0 * sq
                    w = gain * u
                    G, J, H, GA, JA, JB, HB = _impulse(series, rate, damping, second, dt)
                    if second:
                        B = rate * damping
                        D, GB = 1.0 - rate * G - B * J, JA
                        DA, DB, HA = -G - rate * GA - B * JA, GA, JB
                        p_v, p_w, v_v, v_w, q_v, q_w = G + rate * J, rate * H, D + rate * G, rate * J, -B * G, rate * G
                        # by the damping, and by the rate of the lag
                        D1, G1, J1, H1 = rate * DB, rate * GB, rate * JB, rate * HB
                        D2, G2, J2, H2 = DA + damping * DB, GA + damping * GB, JA + damping * JB, HA + damping * HB
                        drive = w + c0
                        bp += p_v * bv + J * bq + (G1 + rate * J1) * v + J1 * q + rate * H1 * drive
                        bv, bq = (
                            v_v * bv + G * bq + (D1 + rate * G1) * v + G1 * q + rate * J1 * drive,
                            q_v * bv + D * bq - (B * G1 + rate * G) * v + D1 * q + rate * G1 * drive,
                        )
                        scale = -rate * rate
                        lp += p_v * lv + J * lq + scale * ((G2 + rate * J2 + J) * v + J2 * q + (rate * H2 + H) * drive)
                        lv, lq = (
                            v_v * lv + G * lq + scale * ((D2 + rate * G2 + G) * v + G2 * q + (rate * J2 + J) * drive),
                            q_v * lv + D * lq
                            + scale * (-(B * G2 + damping * G) * v + D2 * q + (rate * G2 + G) * drive),
                        )  # fmt: skip
                        gp += p_v * gv + J * gq + p_w * u
                        gv, gq = v_v * gv + G * gq + v_w * u, q_v * gv + D * gq + q_w * u
                        cp += p_v * cv + J * cq + p_w
                        cv, cq = v_v * cv + G * cq + v_w, q_v * cv + D * cq + q_w
                        sp += p_v * sv + J * sq
                        sv, sq = v_v * sv + G * sq, q_v * sv + D * sq
                        tp += p_v * tv + J * tq
                        tv, tq = v_v * tv + G * tq, q_v * tv + D * tq
                        zp += p_v * zv + J * zq
                        zv, zq = v_v * zv + G * zq, q_v * zv + D * zq
                    else:
                        f, kk, h, df, dk, dh = transition(damping, dt)
                        fade = np.exp(-rate * dt)
                        GB = JA
                        over = q - w  # what the lag still has to deliver
                        J1, G1 = JA + rate * JB, GA + rate * GB
                        bp += kk * bv + dk * v + J1 * over + dh * (w + c0)
                        bv = f * bv + df * v + G1 * over + dk * (w + c0)
                        scale = -rate * rate * over
                        lp += kk * lv + J * lq + scale * (JA + damping * JB)
                        lv = f * lv + G * lq + scale * (GA + damping * GB)
                        lq = fade * lq - scale * dt * fade
                        gp += kk * gv + J * (gq - u) + h * u
                        gv = f * gv + G * (gq - u) + kk * u
                        gq = fade * (gq - u) + u
                        cp += kk * cv + h
                        cv = f * cv + kk
                        sp += kk * sv
                        sv = f * sv
                        tp += kk * tv + J * tq
                        tv = f * tv + G * tq
                        tq = fade * tq
                    t += dt
                    if t_next - t < 1e-12:
                        t = t_next
                if switch:
                    change = command[k + 1] - u
                    if second:
                        gq += lead * change
                        lq -= lead * rate * gain * change
                        zq += rate * gain * change
                    tq -= (1.0 - lead) * rate * gain * change
                    tv -= lead * gain * change
                    k += 1
                    u = command[k]
            if warming:  # the velocity is a parameter from here on; an acceleration responds to the change of velocity
                warming = False
                v0, c0 = velocity[s], trim
                if second:
                    change = v0 - gain * gv
                    gq += damping * gv
                    bq += damping * bv - change
                    tq += damping * tv
                    lq += damping * lv
                    zq += damping * zv
                    cq, sq = 1.0, -damping
                gp = bp = tp = lp = zp = cp = 0.0
                gv = bv = tv = lv = zv = cv = 0.0
                sp, sv = 0.0, 1.0
                if not second:
                    cq = sq = 0.0
                continue
            w_block, b = weight[block[i]], block[i]
            out[b, 0, 0] += w_block * (gain * gp + trim * cp + v0 * sp)
            out[b, 1, 0] += w_block * gp
            out[b, 2, 0] += w_block * bp
            out[b, 3, 0] += w_block * tp
            out[b, 4, 0] += w_block * lp
            out[b, 5, 0] += w_block * zp
            out[b, 6, 0] += w_block * cp
            out[b, 7, 0] += w_block * sp
            i += 1


@inner(inline="always", fastmath={"contract"})
def _impulse(series: Array, rate: float, damping: float, second: bool, dt: float) -> Any:
    """The response G of the velocity to an impulse of the third state, its integrals J and H, and derivatives.

    Returns:
        G, J, H, dG/dA, dJ/dA (which is dG/dB), dJ/dB (which is dH/dA), dH/dB; see `general_step.linear_step`.
    """
    A, B = (rate if second else rate + damping), rate * damping
    reach = dt * max(A, np.sqrt(B))
    terms = 6 if reach < 0.03 else (8 if reach < 0.12 else 12)  # relative truncation error below 1e-12
    J = H = JB = HB = 0.0
    for n in range(terms - 1, -1, -1):
        J = J * dt + series[0, 0, n]
        JB = JB * dt + series[0, 1, n]
        H = H * dt + series[1, 0, n]
        HB = HB * dt + series[1, 1, n]
    square = dt * dt
    J, JB = J * square, JB * square
    H, HB = H * square * dt, HB * square * dt
    G = dt - A * J - B * H
    JA = -H - A * JB - B * HB
    GA = -J - A * JA - B * JB
    return G, J, H, GA, JA, JB, HB


def lagged_plane_response(
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
    """Block means of the horizontal world response of two axes with a lag on the input, and its sensitivities.

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
        law: Vectors of the law of x and y, shape (2, LAW_SIZE), both linear and of order 1.
        velocity: World velocity at the start of each segment, shape (S, 2) [m/s].

    Returns:
        Shape (B, 13, 2), world components: the position, and its derivatives by g, b, tau, T, c of x and y in turn, and
        by the world velocity at the start of the block's own segment.

    Source: paper, eq. (5), with u(t - tau) behind a lag and a constant added; exact for a heading that is constant
    between events.
    """
    out: Array = np.zeros((weight.size, 1 + _WIDTH, 2))
    _lagged_plane_response(
        starts, pose_range, command_range, pose_time, block, command_time, np.ascontiguousarray(command), weight,
        np.ascontiguousarray(yaw), law, np.ascontiguousarray(velocity), lag_series(law), np.zeros(8 * _SLOT),
        np.zeros((2, 4)), np.zeros(2, np.int64), out,
    )  # fmt: skip
    return out


_WIDTH, _SLOT = 12, 16
"""Number of columns of `lagged_plane_response` besides the position, and of numbers between two of their variables,
which are, of x and then of y: position, velocity, and what a step adds to position and to velocity by itself. Columns:
g, b, tau, T, c of x and y in turn, start velocity."""

_U, _GAIN, _DELAY, _LAG = range(4)
"""Per axis, the command in force, and the lagged demand of the columns that have one."""


@kernel(fastmath={"contract"})
def _lagged_plane_response(
    starts: Array, pose_range: Any, command_range: Any, pose_time: Array, block: Any, command_time: Array,
    command: Array, weight: Array, yaw: Array, law: Array, velocity: Array, series: Array, z: Array, q: Array, k: Any,
    out: Array,
) -> None:  # fmt: skip
    """The compiled loop; `out` is filled with zeros, `z`, `q` and `k` are work space."""
    longest = longest_step(law)
    for s in range(starts.size):
        for n in range(8 * _SLOT):
            z[n] = 0.0
        first, end, last = pose_range[s, 0], pose_range[s, 1], command_range[s, 1]
        t = starts[s] - WARM_UP
        for a in range(2):
            k[a] = command_range[s, 0]
            while k[a] + 1 < last and command_time[k[a] + 1] + law[a, DELAY] <= t:
                k[a] += 1
            u = command[k[a], a]
            q[a, _U], q[a, _GAIN], q[a, _DELAY], q[a, _LAG] = u, u, 0.0, 0.0
        _advance_plane(t, starts[s], yaw[first], yaw[first], last, command_time, command, law, series, longest, 0.0,
                       velocity[s], z, q, k)  # fmt: skip
        t = starts[s]
        for n in range(8 * _SLOT):  # trim and start velocity count from here on
            z[n] = 0.0
        z[2 * _SLOT + 10] = z[3 * _SLOT + 11] = 1.0
        heading = yaw[first]
        for i in range(first, end):
            if t < pose_time[i]:
                _advance_plane(t, pose_time[i], heading, yaw[i], last, command_time, command, law, series, longest, 1.0,
                               velocity[s], z, q, k)  # fmt: skip
                t = pose_time[i]
            heading = yaw[i]
            b, w = block[i], weight[block[i]]
            for a in range(2):
                at = a * _SLOT
                out[b, 0, a] += w * _moved(law, velocity[s], z, at)
                for j in range(_WIDTH):
                    out[b, 1 + j, a] += w * z[at + j]


@inner(inline="always", fastmath={"contract"})
def _moved(law: Array, velocity: Array, z: Array, at: int) -> float:
    """The motion itself, from the columns at `at` by what is linear in it."""
    return (  # type: ignore[no-any-return]
        law[0, GAIN] * z[at] + law[1, GAIN] * z[at + 1] + law[0, TRIM] * z[at + 8] + law[1, TRIM] * z[at + 9]
        + velocity[0] * z[at + 10] + velocity[1] * z[at + 11]
    )  # fmt: skip


@inner(fastmath={"contract"})
def _advance_plane(
    t: float, t_end: float, yaw: float, yaw_end: float, last: int, command_time: Array, command: Array, law: Array,
    series: Array, longest: float, live: float, velocity: Array, z: Array, q: Array, k: Any,
) -> None:  # fmt: skip
    """Propagates all columns from t to t_end through every switch in between; `live` is 0 where there is no trim."""
    begin, span = t, max(t_end - t, 1e-12)
    while t < t_end:
        t_next, switch = t_end, 2  # 2 means no switch
        for a in range(2):
            if k[a] + 1 < last and command_time[k[a] + 1] + law[a, DELAY] <= t_next:
                t_next, switch = command_time[k[a] + 1] + law[a, DELAY], a
        if t_next > t:
            pieces = int(np.ceil((t_next - t) / longest - 1e-9)) if longest < t_next - t else 1
            psi = yaw + (yaw_end - yaw) * (0.5 * (t + t_next) - begin) / span
            c, s = np.cos(psi), np.sin(psi)
            for _ in range(pieces):
                _drive(law, series, (t_next - t) / pieces, c, s, live, velocity, z, q)
            t = t_next
        if switch < 2:
            new = command[k[switch] + 1, switch]
            q[switch, _DELAY] -= law[switch, GAIN] / law[switch, LAG] * (new - q[switch, _U])
            q[switch, _U] = new
            k[switch] += 1


@inner(fastmath={"contract"})
def _drive(
    law: Array, series: Array, dt: float, c: float, s: float, live: float, velocity: Array, z: Array, q: Array
) -> None:
    """Propagates all columns by dt under a heading with cosine c and sine s."""
    x, y = _moved(law, velocity, z, 2 * _SLOT), _moved(law, velocity, z, 3 * _SLOT)
    f0 = f1 = k0 = k1 = 0.0
    for a in range(2):
        gain, damping, rate, trim = law[a, GAIN], law[a, DAMPING], 1.0 / law[a, LAG], live * law[a, TRIM]
        v = c * x + s * y if a == 0 else c * y - s * x
        G, J, _, GA, JA, JB, _ = _impulse(series[a], rate, damping, False, dt)
        f, kk, h, df, dk, dh = transition(damping, dt)
        fade, u = np.exp(-rate * dt), q[a, _U]
        behind = q[a, _GAIN] - u  # what the lag still has to deliver, of a unit gain
        drive, scale = gain * u + trim, -rate * rate * gain * behind
        at = (4 + a) * _SLOT
        z[at + a] = J * behind + h * u
        z[at + 2 + a] = dk * v + (JA + rate * JB) * gain * behind + dh * drive
        z[at + 4 + a] = J * q[a, _DELAY]
        z[at + 6 + a] = J * q[a, _LAG] + scale * (JA + damping * JB)
        z[at + 8 + a] = h * live
        at += 2 * _SLOT
        z[at + a] = G * behind + kk * u
        z[at + 2 + a] = df * v + (GA + rate * JA) * gain * behind + dk * drive
        z[at + 4 + a] = G * q[a, _DELAY]
        z[at + 6 + a] = G * q[a, _LAG] + scale * (GA + damping * JA)
        z[at + 8 + a] = kk * live
        q[a, _GAIN] = fade * behind + u
        q[a, _DELAY] *= fade
        q[a, _LAG] = fade * q[a, _LAG] - scale * dt * fade
        if a == 0:
            f0, k0 = f, kk
        else:
            f1, k1 = f, kk
    for j in range(_WIDTH):
        vx, vy = c * z[2 * _SLOT + j] + s * z[3 * _SLOT + j], c * z[3 * _SLOT + j] - s * z[2 * _SLOT + j]
        px, py = k0 * vx + z[4 * _SLOT + j], k1 * vy + z[5 * _SLOT + j]
        vx, vy = f0 * vx + z[6 * _SLOT + j], f1 * vy + z[7 * _SLOT + j]
        z[j] += c * px - s * py
        z[_SLOT + j] += s * px + c * py
        z[2 * _SLOT + j], z[3 * _SLOT + j] = c * vx - s * vy, s * vx + c * vy
