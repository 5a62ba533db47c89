"""The motion under the general law of `core.laws`, with every sensitivity that the likelihood needs.

Between two events (a switch of the delayed command, a pose) the command is constant, and `move` propagates all columns
at once from one to the next. The derivative with respect to the delay enters at the switches: an impulse into the
velocity, or into the lagged input where there is a lag. With a zero every switch is an impulse into the acceleration.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices
from rotorfit.core.laws import DAMPING, DELAY, DELAY_RANGE, KICKS, LAG, LIMIT, ORDER, TRIM, ZERO
from rotorfit.dynamics.general_step import (
    COLUMNS,
    MEAN,
    START,
    STATE,
    P,
    Q,
    T,
    V,
    W,
    demand,
    demand_slope,
    lag_series,
    lags_in_world,
    linear_step,
    move,
)
from rotorfit.dynamics.response import VANISH_EVERY, vanished

WARM_UP = DELAY_RANGE[1] - DELAY_RANGE[0]
"""Time before the first scored pose over which the lagged input is simulated [s]: the range of delays searched, so that
the first command of a segment is met at every delay."""

_DRAG_STEP = 0.005

_CROSS_STEP = 0.01

_LIMIT_STEP = 0.005


@inner()
def demands(law: Array, what: Any, whose: Any, u: Array, z: Array) -> None:
    """Fills the demand of the commands u (K,) in every column."""
    K, C = law.shape[0], what.size
    for a in range(K):
        other = u[1 - a] if K == 2 else 0.0
        for j in range(C):
            if what[j] == MEAN:
                z[W + COLUMNS * a + j] = demand(law, a, u[a], other)
            elif whose[j] == a and what[j] >= 0:
                z[W + COLUMNS * a + j] = demand_slope(law, a, what[j], u[a], other)
            else:
                z[W + COLUMNS * a + j] = 0.0


@inner()
def _into_lag(law: Array, z: Array, a: int, j: int, change: float, psi: float) -> None:
    """Adds to the lagged demand of axis a in column j."""
    if lags_in_world(law):
        z[Q + j] += change * (np.cos(psi) if a == 0 else -np.sin(psi))
        z[Q + COLUMNS + j] += change * (np.sin(psi) if a == 0 else np.cos(psi))
    else:
        z[Q + COLUMNS * a + j] += change


@inner()
def _led(law: Array, z: Array, C: int, sign: float, psi: float) -> None:
    """Takes what jumps with the demand out of the lagged demands before a switch (sign -1); puts it in after it (1).

    It is Z / T times the demand in the acceleration of a second order, and the demand of an axis without a lag.
    """
    for a in range(law.shape[0]):
        if law[a, ORDER] == 2 and law[a, ZERO] != 0.0:
            lead = sign * law[a, ZERO] / law[a, LAG]
            for j in range(C):
                z[Q + COLUMNS * a + j] += lead * z[W + COLUMNS * a + j]
        elif law[a, ORDER] == 0 and lags_in_world(law):
            for j in range(C):
                _into_lag(law, z, a, j, sign * z[W + COLUMNS * a + j], psi)


@inner()
def _along(z: Array, a: int, c: float, s: float) -> float:
    """Velocity along axis a of two under a heading."""
    return c * z[V] + s * z[V + COLUMNS] if a == 0 else c * z[V + COLUMNS] - s * z[V]  # type: ignore[no-any-return]


@inner()
def _limited(law: Array, z: Array, a: int, first: float, second: float, psi: float) -> float:
    """Acceleration that axis a asks for under the demands of both axes, within the limit."""
    if law.shape[0] == 1:
        return min(max(first - law[0, DAMPING] * z[V], -law[0, LIMIT]), law[0, LIMIT])  # type: ignore[no-any-return]
    c, s = np.cos(psi), np.sin(psi)
    x, y = first - law[0, DAMPING] * _along(z, 0, c, s), second - law[1, DAMPING] * _along(z, 1, c, s)
    return (x if a == 0 else y) / max(1.0, np.hypot(x / law[0, LIMIT], y / law[1, LIMIT]))  # type: ignore[no-any-return]


@inner()
def _switch(
    law: Array, what: Any, whose: Any, z: Array, u: Array, at: int, new: float, psi: float, turn: float
) -> None:
    """Switches the delayed command of axis `at` to `new` and applies the impulse to the derivative by its delay.

    Where the lagged demand jumps, its direction turns with the time of the switch.
    """
    K, C = law.shape[0], what.size
    before0, before1 = z[W], z[W + COLUMNS * (K - 1)]
    _led(law, z, C, -1.0, psi)
    u[at] = new
    demands(law, what, whose, u, z)
    _led(law, z, C, 1.0, psi)
    for j in range(1, C):
        a = whose[j]
        if what[j] >= 0 and law[a, ORDER] == 2 and (what[j] == LAG or what[j] == ZERO):
            jump = (z[W + COLUMNS * a] - (before0 if a == 0 else before1)) / law[a, LAG]
            z[Q + COLUMNS * a + j] += jump if what[j] == ZERO else -jump * law[a, ZERO] / law[a, LAG]
        if what[j] != DELAY or whose[j] != at:
            continue
        for a in range(K):
            before, after = before0 if a == 0 else before1, z[W + COLUMNS * a]
            if int(law[a, KICKS]) & 4:
                before = _limited(law, z, a, before0, before1, psi)
                after = _limited(law, z, a, z[W], z[W + COLUMNS * (K - 1)], psi)
            impulse = before - after
            if law[a, ORDER] > 0:
                lead = law[a, ZERO] / law[a, LAG]
                _into_lag(law, z, a, j, (1.0 - lead) * impulse / law[a, LAG], psi)
                impulse *= lead
            elif lags_in_world(law):
                _into_lag(law, z, a, j, -impulse * turn, psi + 0.5 * np.pi)
            if K == 1:
                z[V + j] += impulse
            elif a == 0:
                z[V + j] += np.cos(psi) * impulse
                z[V + COLUMNS + j] += np.sin(psi) * impulse
            else:
                z[V + j] -= np.sin(psi) * impulse
                z[V + COLUMNS + j] += np.cos(psi) * impulse


@inner()
def settle(law: Array, z: Array, C: int, yaw: float) -> None:
    """Fills the lagged parts of C columns with their steady values under the present command and world velocity."""
    c, s = np.cos(yaw), np.sin(yaw)
    for j in range(C):
        x, y = z[V + j], z[V + COLUMNS + j]
        for a in range(2):
            at = COLUMNS * a + j
            z[Q + at] = z[W + at]
            if law[a, ORDER] == 2:
                z[Q + at] += z[T + at] - law[a, DAMPING] * (c * x + s * y if a == 0 else c * y - s * x)
            if int(law[a, KICKS]) & 4 and j == 0:
                z[Q + at] = z[T + at] + _limited(law, z, a, z[W], z[W + COLUMNS], yaw)
        if lags_in_world(law):
            x, y = z[Q + j], z[Q + COLUMNS + j]
            z[Q + j], z[Q + COLUMNS + j] = c * x - s * y, s * x + c * y


@inner()
def longest_step(law: Array) -> float:
    """Longest admissible step [s]; longer stretches are subdivided."""
    longest = np.inf
    for a in range(law.shape[0]):
        if int(law[a, KICKS]) & 1:
            longest = min(longest, _DRAG_STEP)
        if int(law[a, KICKS]) & 2:
            longest = min(longest, _CROSS_STEP)
        if int(law[a, KICKS]) & 4:
            longest = min(longest, _LIMIT_STEP)
    return longest


@inner()
def advance(
    t: float, t_end: float, yaw: float, yaw_end: float, k: Any, last: int, command_time: Array, command: Array,
    law: Array, series: Array, longest: float, what: Any, whose: Any, z: Array, u: Array,
    S: Array,
) -> None:  # fmt: skip
    """Propagates all columns from t to t_end through every switch in between, in place.

    Args:
        t: Start [s].
        t_end: End [s].
        yaw: Heading at t [rad]; linear in between.
        yaw_end: Heading at t_end [rad].
        k: Index of the command in force on each axis, shape (K,); updated.
        last: One past the last command that may come into force.
        command_time: Shape (M,) [s].
        command: Shape (M, K).
        law: Vectors of the law by axis, shape (K, LAW_SIZE).
        series: From `lag_series`.
        longest: From `longest_step`.
        what: Index in the law of the parameter that each column is the derivative by, or `MEAN`, `START`, `NOTHING`,
            shape (C,); the mean comes first.
        whose: Axis of that parameter, shape (C,).
        z: State of the columns, see `P`, shape (STATE,).
        u: Command in force, shape (K,); updated.
        S: Work space, shape (K, 3, 12).
    """
    K = law.shape[0]
    begin, span = t, max(t_end - t, 1e-12)
    kicked = int(law[0, KICKS]) & 3 > 0 or int(law[K - 1, KICKS]) & 3 > 0
    while t < t_end:
        t_next, switch = t_end, K  # K means no switch
        for j in range(K):
            if k[j] + 1 < last and command_time[k[j] + 1] + law[j, DELAY] <= t_next:
                t_next, switch = command_time[k[j] + 1] + law[j, DELAY], j
        if t_next > t:
            pieces = int(np.ceil((t_next - t) / longest - 1e-9)) if longest < t_next - t else 1
            dt = (t_next - t) / pieces
            psi = yaw + (yaw_end - yaw) * (0.5 * (t + t_next) - begin) / span
            c, s = (np.cos(psi), np.sin(psi)) if K == 2 else (1.0, 0.0)
            for a in range(K):
                linear_step(law, series, a, dt, S)
            for _ in range(pieces):
                move(law, what, whose, z, S, c, s, dt, kicked)
            t = t_next
        if switch < K:
            psi = yaw + (yaw_end - yaw) * (t - begin) / span
            turn = (yaw_end - yaw) / span
            _switch(law, what, whose, z, u, switch, command[k[switch] + 1, switch], psi, turn)
            k[switch] += 1


@inner()
def command_in_force(
    t: float, first: int, last: int, command_time: Array, command: Array, law: Array, k: Any, u: Array
) -> None:
    """Fills the index and the value of the command in force at t on each axis, both shape (K,)."""
    for j in range(law.shape[0]):
        k[j] = first
        while k[j] + 1 < last and command_time[k[j] + 1] + law[j, DELAY] <= t:
            k[j] += 1
        u[j] = command[k[j], j]


def motion_response(
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
    what: Indices,
    whose: Indices,
    velocity: Array,
) -> Array:
    """Block means of the position under the general law, and its sensitivities.

    Args:
        starts: Start of each segment, shape (S,) [s].
        pose_range: First and one past the last pose of each segment, shape (S, 2).
        command_range: The same for the commands, shape (S, 2).
        pose_time: Shape (N,) [s].
        block: Block of each pose, shape (N,).
        command_time: Shape (M,) [s].
        command: Shape (M, K); two axes are forward and left.
        weight: One over the number of poses of each block, shape (B,).
        yaw: Heading at the poses, shape (N,) [rad]; linear in between; ignored for one axis.
        law: Vectors of the law by axis, shape (K, LAW_SIZE).
        what: Parameter of each column, see `advance`, shape (C,).
        whose: Axis of that parameter, shape (C,); for a start velocity, its world component.
        velocity: World velocity at the start of each segment, shape (S, K).

    Returns:
        Shape (B, C, K), world components where K is 2.
    """
    K = len(law)
    out: Array = np.zeros((weight.size, what.size, K))
    _motion_response(
        starts, pose_range, command_range, pose_time, block, command_time, command, weight, yaw, law, what, whose,
        velocity, lag_series(law), np.zeros(STATE), np.zeros(K), np.zeros((K, 3, 12)), np.zeros(K, np.int64), out,
    )  # fmt: skip
    return out


@kernel()
def _motion_response(
    starts: Array, pose_range: Any, command_range: Any, pose_time: Array, block: Any, command_time: Array,
    command: Array, weight: Array, yaw: Array, law: Array, what: Any, whose: Any, velocity: Array, series: Array,
    z: Array, u: Array, S: Array, k: Any, out: Array,
) -> None:  # fmt: skip
    """The compiled loop; the arguments after `series`, except `out`, are work space filled with zeros."""
    C, K = what.size, law.shape[0]
    longest = longest_step(law)
    lagged = max(law[0, ORDER], law[K - 1, ORDER]) > 0
    for s in range(starts.size):
        first, last = command_range[s, 0], command_range[s, 1]
        t = starts[s] - WARM_UP if lagged else starts[s]
        command_in_force(t, first, last, command_time, command, law, k, u)
        demands(law, what, whose, u, z)
        for n in range(2 * COLUMNS):
            z[V + n] = z[T + n] = 0.0
            z[Q + n] = z[W + n]
        i0 = pose_range[s, 0]
        heading = yaw[i0]
        if K == 2:
            settle(law, z, C, heading)
        if lagged:
            advance(
                t, starts[s], heading, heading, k, last, command_time, command, law, series, longest, what, whose, z,
                u, S,
            )  # fmt: skip
            t = starts[s]
        _begin(law, what, whose, z, velocity[s], heading)
        for n in range(2 * COLUMNS):
            z[P + n] = 0.0
        for i in range(i0, pose_range[s, 1]):
            if t < pose_time[i]:
                advance(
                    t, pose_time[i], heading, yaw[i], k, last, command_time, command, law, series, longest, what,
                    whose, z, u, S,
                )  # fmt: skip
                t = pose_time[i]
            heading = yaw[i]
            if i % VANISH_EVERY == 0:
                for n in range(V, W):
                    z[n] = vanished(z[n])
            w = weight[block[i]]
            for a in range(K):
                for j in range(C):
                    out[block[i], j, a] += w * z[P + COLUMNS * a + j]


@inner()
def _begin(law: Array, what: Any, whose: Any, z: Array, velocity: Array, yaw: float) -> None:
    """Sets the trims, and replaces the world velocity of the warm-up by that of the start.

    The acceleration of a second order takes the value that it would have, after its lag, at the new velocity and trim.
    """
    K, C = law.shape[0], what.size
    c, s = (np.cos(yaw), np.sin(yaw)) if K == 2 else (1.0, 0.0)
    for j in range(C):
        x, y = -z[V + j], -z[V + COLUMNS * (K - 1) + j]
        for a in range(K):
            mine = whose[j] == a
            z[T + COLUMNS * a + j] = law[a, TRIM] if what[j] == MEAN else (1.0 if what[j] == TRIM and mine else 0.0)
            z[V + COLUMNS * a + j] = velocity[a] if what[j] == MEAN else (1.0 if what[j] == START and mine else 0.0)
        x, y = x + z[V + j], y + z[V + COLUMNS * (K - 1) + j]
        for a in range(K):
            if law[a, ORDER] < 2:
                continue
            change = x if K == 1 else (c * x + s * y if a == 0 else c * y - s * x)
            _into_lag(law, z, a, j, z[T + COLUMNS * a + j] - law[a, DAMPING] * change, yaw)
            if what[j] == MEAN:
                for i in range(C):
                    if what[i] == DAMPING and whose[i] == a:
                        _into_lag(law, z, a, i, -change, yaw)
