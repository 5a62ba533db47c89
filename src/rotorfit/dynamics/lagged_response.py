"""The exact response of one axis under a linear law with a lag, with every sensitivity that the likelihood needs.

`general_response` handles every law and two axes, `axis_response` the first-order law of one axis; this module covers
linear laws of one axis with a lag on the input, T q' = w - q, or of second order with a zero, T v'' + v' + b v = w +
Z w'. Their motion is the sum of the responses to input, trim and start velocity, so few numbers need to be propagated.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import DAMPING, DELAY, GAIN, LAG, ORDER, TRIM, ZERO
from rotorfit.dynamics.general_response import WARM_UP
from rotorfit.dynamics.general_step import impulse, lag_series
from rotorfit.dynamics.response import VANISH_EVERY, transition, vanished


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
        np.ascontiguousarray(velocity), lag_series(law), out,
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
    A, B = rate if second else rate + damping, rate * damping
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
                if t < t_next:
                    dt = t_next - t
                    v = gain * gv + c0 * cv + v0 * sv
                    q = gain * gq + c0 * cq + v0 * sq
                    w = gain * u
                    G, J, H, GA, JA, JB, HB = impulse(series, 0, A, B, dt)
                    if second:
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
            if i % VANISH_EVERY == 0:
                gv, gq, sv, sq, bv, bq = (
                    vanished(gv), vanished(gq), vanished(sv), vanished(sq), vanished(bv), vanished(bq)
                )  # fmt: skip
                tv, tq, lv, lq, zv, zq = (
                    vanished(tv), vanished(tq), vanished(lv), vanished(lq), vanished(zv), vanished(zq)
                )  # fmt: skip
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
