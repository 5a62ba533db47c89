"""The exact response of eq. (5) to held, delayed commands, with every sensitivity that the likelihood needs.

Between two switching times the input is constant and the motion is known in closed form, so there is no numerical
integration and the response is continuous in the delay. With f, k, h the transition of velocity and position over dt,

    v(t + dt) = f v + k a,   p(t + dt) = p + k v + h a,   f = exp(-b dt), k = (1 - f) / b, h = (dt - k) / b,

the sensitivities with respect to the damping b follow from df/db, dk/db, dh/db, and the one with respect to the delay
is a velocity impulse (u_old - u_new) at every switch. At the start of a segment the velocity is a free parameter;
the position belongs to the disturbance filter, which leaves it free.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices

VANISHING = 1e-200
"""Size below which a state that decays counts as zero; in any unit, it is far below the rounding of what it acts on."""

VANISH_EVERY = 32
"""Number of poses after which decaying states are compared with `VANISHING`."""


@kernel(inline="always")
def transition(b: float, dt: float) -> Any:
    """Transition over dt at damping b and its derivative with respect to b: f, k, h, df, dk, dh."""
    x = b * dt
    if abs(x) < 0.02:
        h = 0.5 + x * (-1 / 6 + x * (1 / 24 + x * (-1 / 120 + x / 720)))
        dh = -1 / 6 + x * (1 / 12 + x * (-1 / 40 + x * (1 / 180 - x / 1008)))
        h *= dt * dt
        dh *= dt * dt * dt
        k = dt - b * h
        f = 1.0 - b * k
    elif abs(x) < 0.5:
        h = 0.5 + x * (-1 / 6 + x * (1 / 24 + x * (-1 / 120 + x * (1 / 720 + x * (-1 / 5040 + x / 40320)))))
        dh = -1 / 6 + x * (1 / 12 + x * (-1 / 40 + x * (1 / 180 + x * (-1 / 1008 + x * (1 / 6720 - x / 51840)))))
        h *= dt * dt
        dh *= dt * dt * dt
        k = dt - b * h
        f = 1.0 - b * k
    else:
        f = np.exp(-x)
        k = (1.0 - f) / b
        h = (dt - k) / b
        dh = -((dt * f - k) / b + h) / b
    dk = -h - b * dh
    df = -k - b * dk
    return f, k, h, df, dk, dh


@inner(inline="always")
def vanished(x: float) -> float:
    """A decaying state, or zero where nothing is left of it.

    After minutes of decay a number is denormal, and processors compute with such numbers many times as slowly.
    """
    return 0.0 if abs(x) < VANISHING else x


def axis_response(
    starts: Array,
    pose_range: Indices,
    command_range: Indices,
    pose_time: Array,
    block: Indices,
    command_time: Array,
    command: Array,
    weight: Array,
    gain: float,
    trim: float,
    damping: float,
    delay: float,
    velocity: Array,
) -> Array:
    """Block means of the position response of one axis, and its sensitivities.

    Args:
        starts: Start of each segment, shape (S,) [s].
        pose_range: First and one past the last pose of each segment, shape (S, 2).
        command_range: The same for the commands, shape (S, 2).
        pose_time: Shape (N,) [s].
        block: Block of each pose, shape (N,).
        command_time: Shape (M,) [s].
        command: Shape (M,).
        weight: One over the number of poses of each block, shape (B,).
        gain: g [unit/s^2 per command].
        trim: Constant acceleration c [unit/s^2].
        damping: b [1/s], positive.
        delay: tau [s].
        velocity: Velocity at the start of each segment, shape (S,) [unit/s].

    Returns:
        Shape (B, 5, 1): derivatives of the position by g (the response to a unit gain), c, b, tau and v0, the
        velocity at the start of the block's own segment. The position itself is g, c, v0 times the first, second and
        last.

    Source: paper, eq. (4), with u(t - tau) and a constant added.
    """
    out: Array = np.zeros((weight.size, 5, 1))
    _axis_response(
        starts, pose_range, command_range, pose_time, block, command_time, np.ascontiguousarray(command), weight,
        float(gain), float(trim), float(damping), float(delay), np.ascontiguousarray(velocity), out,
    )  # fmt: skip
    return out


@kernel(fastmath={"contract"})
def _axis_response(
    starts: Array, pose_range: Any, command_range: Any, pose_time: Array, block: Any, command_time: Array,
    command: Array, weight: Array, gain: float, trim: float, damping: float, delay: float, velocity: Array, out: Array,
) -> None:  # fmt: skip
    """The compiled loop; `out` is filled with zeros."""
    for s in range(starts.size):
        t = starts[s]
        k, last = command_range[s, 0], command_range[s, 1]
        while k + 1 < last and command_time[k + 1] + delay <= t:
            k += 1
        u = command[k]
        gp = gv = cp = cv = bp = bv = tp = tv = sp = 0.0
        sv = 1.0
        for i in range(pose_range[s, 0], pose_range[s, 1]):
            while t < pose_time[i]:
                switch = k + 1 < last and command_time[k + 1] + delay <= pose_time[i]
                t_next = command_time[k + 1] + delay if switch else pose_time[i]
                f, kk, h, df, dk, dh = transition(damping, t_next - t)
                v, a = gain * gv + trim * cv + velocity[s] * sv, gain * u + trim
                bp += kk * bv + dk * v + dh * a
                bv = f * bv + df * v + dk * a
                gp += kk * gv + h * u
                gv = f * gv + kk * u
                cp += kk * cv + h
                cv = f * cv + kk
                tp += kk * tv
                tv *= f
                sp += kk * sv
                sv *= f
                t = t_next
                if switch:
                    tv += gain * (u - command[k + 1])
                    k += 1
                    u = command[k]
            if i % VANISH_EVERY == 0:
                gv, bv, tv, sv = vanished(gv), vanished(bv), vanished(tv), vanished(sv)
            w = weight[block[i]]
            out[block[i], 0, 0] += w * gp
            out[block[i], 1, 0] += w * cp
            out[block[i], 2, 0] += w * bp
            out[block[i], 3, 0] += w * tp
            out[block[i], 4, 0] += w * sp
