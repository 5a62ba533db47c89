"""One step of the motion under the general law of `core.laws`: the demand, the linear step, the kicks.

The linear part of the law, including the lag, is stepped in closed form. Quadratic drag and the damping across the axes
act as kicks on the velocity, half before and half after each linear step (Strang splitting, with second-order error in
a step of a few milliseconds). A column is the motion itself or its derivative by one parameter; all columns take the
same steps.

Source: G. Strang, SIAM J. Numer. Anal. 5 (1968), pp. 506-517, for the splitting.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array
from rotorfit.core.laws import (
    ASYMMETRY,
    CROSS_DAMPING,
    CROSS_INPUT,
    DAMPING,
    DEAD,
    GAIN,
    KICKS,
    LAG,
    LEVEL,
    LIMIT,
    ORDER,
    SHARE,
    SPEED,
    WORLD,
)
from rotorfit.dynamics.response import transition

MEAN, START, NOTHING = -1, -2, -3
"""Kinds of columns besides the derivative by an element of the law: the motion, its derivative by the start velocity,
or nothing."""

COLUMNS = 32
"""Largest number of columns propagated together."""

P, V, Q, W, T = 0, 2 * COLUMNS, 4 * COLUMNS, 6 * COLUMNS, 8 * COLUMNS
"""Offsets of the columns in an array of `STATE` numbers, for axis 0 and then axis 1: world position, world velocity,
lagged demand (see `lags_in_world`; second order: acceleration), demand, trim. A single array with constant offsets
shows the compiler that nothing overlaps, so that it vectorises over four columns."""

ASKED = 10 * COLUMNS
"""Offset of the demand before a limit cuts it."""

STATE = 12 * COLUMNS

_TERMS = 12

_SERIES_REACH = 0.5

_INVERSE_FACTORIAL = np.array([1.0 / float(np.prod(np.arange(1, n + 1, dtype=float))) for n in range(_TERMS + 4)])


@inner()
def demand(law: Array, a: int, u: float, other: float) -> float:
    """Acceleration w demanded by the commands of axis a and of the other axis."""
    size = min(max(abs(u) - law[a, DEAD], 0.0), law[a, LEVEL])
    signed = size if u >= 0 else -size
    return law[a, GAIN] * (signed + law[a, ASYMMETRY] * size) + law[a, CROSS_INPUT] * other  # type: ignore[no-any-return]


@inner()
def demand_slope(law: Array, a: int, place: int, u: float, other: float) -> float:
    """Derivative of the demand by an element of the law."""
    over = abs(u) - law[a, DEAD]
    size = min(max(over, 0.0), law[a, LEVEL])
    sign = 1.0 if u >= 0 else -1.0
    if place == GAIN:
        return size * (sign + law[a, ASYMMETRY])  # type: ignore[no-any-return]
    if place == ASYMMETRY:
        return law[a, GAIN] * size  # type: ignore[no-any-return]
    if place == LEVEL and over > law[a, LEVEL]:
        return law[a, GAIN] * (sign + law[a, ASYMMETRY])  # type: ignore[no-any-return]
    if place == DEAD and 0.0 < over < law[a, LEVEL]:
        return -law[a, GAIN] * (sign + law[a, ASYMMETRY])  # type: ignore[no-any-return]
    return other if place == CROSS_INPUT else 0.0


def demand_slopes(law: Array, place: Sequence[int], command: Array) -> Array:
    """Derivative of the demand of each axis by an element of its law, for many commands of the axis alone.

    Args:
        law: Vectors of the law by axis, shape (K, LAW_SIZE).
        place: The element for each axis; `NOTHING` for none. By `GAIN` it is the command as the law shapes it.
        command: Shape (M, K).

    Returns:
        Shape (M, K).
    """
    out: Array = np.zeros(command.shape)
    _fill_demand_slopes(law, np.array(place), np.ascontiguousarray(command), out)
    return out


@kernel()
def _fill_demand_slopes(law: Array, place: Any, command: Array, out: Array) -> None:
    """The compiled loop."""
    for a in range(law.shape[0]):
        for m in range(command.shape[0]):
            out[m, a] = demand_slope(law, a, place[a], command[m, a], 0.0)


def lag_series(law: Array) -> Array:
    """Power series of the response to an impulse into v'' where v'' = -A v' - B v, by axis: shape (K, 2, 2, terms).

    The first and second integrals of the response, each with its derivative by B; `impulse` derives all else.
    """
    out: Array = np.zeros((len(law), 2, 2, _TERMS))
    if np.any(law[:, ORDER]):
        _fill_lag_series(law, np.zeros((2, _TERMS)), out)
    return out


@kernel()
def _fill_lag_series(law: Array, raw: Array, out: Array) -> None:
    """Fills the series; `raw` is work space filled with zeros."""
    for a in range(law.shape[0]):
        if law[a, ORDER] == 0:
            continue
        A, B = _lag_rates(law, a)
        raw[0, 0], raw[0, 1] = 1.0, -A
        for i in range(2, _TERMS):
            raw[0, i] = -A * raw[0, i - 1] - B * raw[0, i - 2]
            raw[1, i] = -raw[0, i - 2] - A * raw[1, i - 1] - B * raw[1, i - 2]
        for order in range(2):
            for i in range(_TERMS):
                for d in range(2):
                    out[a, order, d, i] = raw[d, i] * _INVERSE_FACTORIAL[i + order + 2]


@inner()
def _lag_rates(law: Array, a: int) -> Any:
    """A and B of v'' = -A v' - B v, the free motion of an axis with a lag."""
    rate, slow = 1.0 / law[a, LAG], law[a, DAMPING]
    return (rate + slow if law[a, ORDER] == 1 else rate), rate * slow


@inner()
def lags_in_world(law: Array) -> bool:
    """Whether the lagged demand of x and y keeps its direction in the world when the vehicle turns.

    Not beside a second order whose acceleration turns with the heading.
    """
    if law.shape[0] == 1 or law[0, WORLD] + law[1, WORLD] == 0:
        return False
    return bool((law[0, ORDER] < 2 or law[0, WORLD] > 0) and (law[1, ORDER] < 2 or law[1, WORLD] > 0))


@inner(inline="always", fastmath={"contract"})
def impulse(series: Array, a: int, A: float, B: float, dt: float) -> Any:
    """The response G of v'' = -A v' - B v to an impulse into v'', its integrals J and H, and derivatives.

    The series serves a short step, which is then doubled as often as needed. With D the derivative of G,
    G + A J + B H = t and D + A G + B J = 1; the derivative of each by A equals the derivative by B of the next in the
    sequence H, J, G, D.

    Args:
        series: From `lag_series`.
        a: Index of the axis.
        A: Sum of the two poles [1/s].
        B: Their product [1/s^2].
        dt: The step [s].

    Returns:
        G, J, H, dG/dA, dJ/dA (which is dG/dB), dJ/dB (which is dH/dA), dH/dB.

    Source: C. Moler, C. Van Loan, SIAM Rev. 45 (2003), pp. 3-49, method 3: scaling and squaring.
    """
    fastest, doublings = max(abs(A), np.sqrt(abs(B))), 0
    while dt * fastest > _SERIES_REACH:
        dt *= 0.5
        doublings += 1
    reach = dt * fastest
    terms = 6 if reach < 0.03 else (8 if reach < 0.12 else _TERMS)  # truncated by less than 1e-12, derivatives 3e-9
    J = H = JB = HB = 0.0
    for n in range(terms - 1, -1, -1):
        J, JB = J * dt + series[a, 0, 0, n], JB * dt + series[a, 0, 1, n]
        H, HB = H * dt + series[a, 1, 0, n], HB * dt + series[a, 1, 1, n]
    square = dt * dt
    J, JB, H, HB = J * square, JB * square, H * square * dt, HB * square * dt
    for _ in range(doublings):
        G, GB = dt - A * J - B * H, -H - A * JB - B * HB
        J, H, JB, HB = (
            2.0 * J + G * G - B * J * J,
            2.0 * H + dt * J + J * G - B * J * H,
            2.0 * (JB + G * GB - B * J * JB) - J * J,
            2.0 * HB + (dt + G) * JB + J * GB - H * J - B * (HB * J + H * JB),
        )
        dt *= 2.0
    G, JA = dt - A * J - B * H, -H - A * JB - B * HB
    return G, J, H, -J - A * JA - B * JB, JA, JB, HB


@inner()
def linear_step(law: Array, series: Array, a: int, dt: float, S: Array) -> None:
    """Fills the linear step of axis a and its derivatives by the linear damping and by the rate of the lag.

    S[a] has shape (3, 12): each row has four coefficients each for the gain in p and the new v and q, as functions of
    v, q, the demand and the trim.

    For G, D, J and H see `impulse`.
    """
    order, beta = law[a, ORDER], law[a, DAMPING] * (1.0 - law[a, SHARE])
    if order < 2:
        f, k, h, df, dk, dh = transition(beta, dt)
        S[a, 0, 0], S[a, 0, 2], S[a, 0, 3], S[a, 0, 4], S[a, 0, 6], S[a, 0, 7] = k, h, h, f, k, k
        S[a, 1, 0], S[a, 1, 2], S[a, 1, 3], S[a, 1, 4], S[a, 1, 6], S[a, 1, 7] = dk, dh, dh, df, dk, dk
    if order == 0:
        S[a, 0, 10] = 1.0  # without a lag the lagged demand is the demand
        return
    rate = 1.0 / law[a, LAG]
    A, B = _lag_rates(law, a)
    G, J, H, GA, JA, JB, HB = impulse(series, a, A, B, dt)
    GB = JA
    if order == 1:
        S[a, 0, 1], S[a, 0, 5] = J, G
        S[a, 1, 1], S[a, 1, 5] = JA + rate * JB, GA + rate * GB
        S[a, 2, 1], S[a, 2, 5] = JA + beta * JB, GA + beta * GB
        fade = np.exp(-rate * dt)
        S[a, 0, 9], S[a, 0, 10] = fade, 1.0 - fade
        S[a, 2, 2], S[a, 2, 6], S[a, 2, 9], S[a, 2, 10] = 0.0, 0.0, -dt * fade, dt * fade
        for d in range(3):
            S[a, d, 2] -= S[a, d, 1]
            S[a, d, 6] -= S[a, d, 5]
        return
    D, HA, DB = 1.0 - A * G - B * J, JB, GA
    DA = -G - A * GA - B * JA
    S[a, 0, 0], S[a, 0, 1], S[a, 0, 2] = G + rate * J, J, rate * H
    S[a, 0, 4], S[a, 0, 5], S[a, 0, 6] = D + rate * G, G, rate * J
    S[a, 0, 8], S[a, 0, 9], S[a, 0, 10] = -B * G, D, rate * G
    for d, dA, dB in ((1, 0.0, rate), (2, 1.0, beta)):
        D1, G1, J1, H1 = dA * DA + dB * DB, dA * GA + dB * GB, dA * JA + dB * JB, dA * HA + dB * HB
        S[a, d, 0], S[a, d, 1], S[a, d, 2] = G1 + rate * J1 + dA * J, J1, rate * H1 + dA * H
        S[a, d, 4], S[a, d, 5], S[a, d, 6] = D1 + rate * G1 + dA * G, G1, rate * J1 + dA * J
        S[a, d, 8], S[a, d, 9], S[a, d, 10] = -B * G1 - dB * G, D1, rate * G1 + dA * G
    for d in range(3):
        S[a, d, 3], S[a, d, 7], S[a, d, 11] = S[a, d, 2], S[a, d, 6], S[a, d, 10]


@inner(fastmath={"contract"})
def _turn_velocities(z: Array, C: int, c: float, s: float) -> None:
    """Rotates the frame of the velocities of all columns, in place."""
    for j in range(C):
        x, y = z[V + j], z[V + COLUMNS + j]
        z[V + j], z[V + COLUMNS + j] = c * x + s * y, c * y - s * x


@inner()
def _kick(law: Array, what: Any, whose: Any, z: Array, c: float, s: float, dt: float) -> None:
    """Applies quadratic drag and cross damping for dt to the velocities of all columns; c and s are of the heading."""
    K, C = law.shape[0], what.size
    if K == 2:
        _turn_velocities(z, C, c, s)
    for a in range(K):
        if int(law[a, KICKS]) & 1 == 0:
            continue
        b, share, speed, own = law[a, DAMPING], law[a, SHARE], law[a, SPEED], V + COLUMNS * a
        before = z[own]
        spent = dt * abs(before)
        left = 1.0 / (1.0 + b * share / speed * spent)
        z[own] = before * left
        for j in range(1, C):
            z[own + j] *= left * left
            if whose[j] == a and (what[j] == DAMPING or what[j] == SHARE):
                z[own + j] -= spent * before * left * left * (share if what[j] == DAMPING else b) / speed
    if K == 2 and int(law[0, KICKS]) & 2:
        first, second = law[0, CROSS_DAMPING] * dt, law[1, CROSS_DAMPING] * dt
        x, y = z[V], z[V + COLUMNS]
        for j in range(C):
            vx, vy = z[V + j], z[V + COLUMNS + j]
            z[V + j] = vx - first * vy + 0.5 * first * second * vx
            z[V + COLUMNS + j] = vy - second * vx + 0.5 * first * second * vy
            if what[j] == CROSS_DAMPING and whose[j] == 0:
                z[V + j] += dt * (0.5 * second * x - y)
                z[V + COLUMNS + j] += dt * 0.5 * second * y
            elif what[j] == CROSS_DAMPING and whose[j] == 1:
                z[V + j] += dt * 0.5 * first * x
                z[V + COLUMNS + j] += dt * (0.5 * first * y - x)
    if K == 2:
        _turn_velocities(z, C, c, -s)


@inner()
def _limit(law: Array, what: Any, whose: Any, z: Array, c: float, s: float, dt: float) -> None:
    """Replaces the demands by what a limit leaves of them over a step, in all columns, and keeps them in `ASKED`.

    The velocities that count are those of the middle of the step. Two axes with limits have one together: within the
    ellipse of both.
    """
    K, C = law.shape[0], what.size
    size, v0, v1, d0, d1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(C):
        x, y = z[V + j], z[V + COLUMNS + j]
        if K == 2:
            x, y = c * x + s * y, c * y - s * x
        x, y = x + 0.5 * dt * z[Q + j], y + 0.5 * dt * z[Q + COLUMNS + j]
        if j == 0:
            v0, v1 = x, y
            d0 = z[W] - law[0, DAMPING] * x
            size = (d0 / law[0, LIMIT]) ** 2
            if K == 2:
                d1 = z[W + COLUMNS] - law[1, DAMPING] * y
                size += (d1 / law[1, LIMIT]) ** 2
        for a in range(K):
            z[ASKED + COLUMNS * a + j] = z[W + COLUMNS * a + j]
        if size <= 1.0:
            continue
        share = 1.0 / np.sqrt(size)
        by0 = v0 if whose[j] == 0 and what[j] == DAMPING else 0.0
        by1 = v1 if whose[j] == 1 and what[j] == DAMPING else 0.0
        left0, left1 = law[0, DAMPING] * x + by0, law[K - 1, DAMPING] * y + by1
        e0, e1 = z[W + j] - left0, z[W + COLUMNS + j] - left1
        grow = 0.0  # of the size, over twice itself
        if j > 0:
            grow = _growth(law, 0, d0, e0, whose[j] == 0 and what[j] == LIMIT)
            if K == 2:
                grow += _growth(law, 1, d1, e1, whose[j] == 1 and what[j] == LIMIT)
            grow /= size
        if int(law[0, KICKS]) & 4:
            z[W + j] = share * (e0 - d0 * grow) + left0
        if K == 2 and int(law[1, KICKS]) & 4:
            z[W + COLUMNS + j] = share * (e1 - d1 * grow) + left1


@inner()
def _growth(law: Array, a: int, asked: float, change: float, by_limit: bool) -> float:
    """Half the change of the square of what axis a asks for over its limit."""
    most = law[a, LIMIT]
    return asked * (change - (asked / most if by_limit else 0.0)) / (most * most)  # type: ignore[no-any-return]


@inner(fastmath={"contract"})
def _move_line(z: Array, S: Array, C: int) -> None:
    """The linear step of one axis, all columns."""
    pv, pq, pw, pc = S[0, 0, 0], S[0, 0, 1], S[0, 0, 2], S[0, 0, 3]
    vv, vq, vw, vc = S[0, 0, 4], S[0, 0, 5], S[0, 0, 6], S[0, 0, 7]
    qv, qq, qw, qc = S[0, 0, 8], S[0, 0, 9], S[0, 0, 10], S[0, 0, 11]
    for j in range(C):
        v, q, w, t = z[V + j], z[Q + j], z[W + j], z[T + j]
        z[P + j] += pv * v + pq * q + pw * w + pc * t
        z[V + j] = vv * v + vq * q + vw * w + vc * t
        z[Q + j] = qv * v + qq * q + qw * w + qc * t


@inner(fastmath={"contract"})
def _move_plane(z: Array, S: Array, c: float, s: float, qc: float, qs: float, C: int) -> None:
    """The linear step of two axes under a heading, all columns; qc and qs turn the lagged demands into its frame."""
    xpv, xpq, xpw, xpc = S[0, 0, 0], S[0, 0, 1], S[0, 0, 2], S[0, 0, 3]
    xvv, xvq, xvw, xvc = S[0, 0, 4], S[0, 0, 5], S[0, 0, 6], S[0, 0, 7]
    xqv, xqq, xqw, xqc = S[0, 0, 8], S[0, 0, 9], S[0, 0, 10], S[0, 0, 11]
    ypv, ypq, ypw, ypc = S[1, 0, 0], S[1, 0, 1], S[1, 0, 2], S[1, 0, 3]
    yvv, yvq, yvw, yvc = S[1, 0, 4], S[1, 0, 5], S[1, 0, 6], S[1, 0, 7]
    yqv, yqq, yqw, yqc = S[1, 0, 8], S[1, 0, 9], S[1, 0, 10], S[1, 0, 11]
    for j in range(C):
        vx, vy, qx, qy = z[V + j], z[V + COLUMNS + j], z[Q + j], z[Q + COLUMNS + j]
        wx, wy, tx, ty = z[W + j], z[W + COLUMNS + j], z[T + j], z[T + COLUMNS + j]
        vx, vy = c * vx + s * vy, c * vy - s * vx
        qx, qy = qc * qx + qs * qy, qc * qy - qs * qx
        px = xpv * vx + xpq * qx + xpw * wx + xpc * tx
        py = ypv * vy + ypq * qy + ypw * wy + ypc * ty
        lx = xqv * vx + xqq * qx + xqw * wx + xqc * tx
        ly = yqv * vy + yqq * qy + yqw * wy + yqc * ty
        z[Q + j], z[Q + COLUMNS + j] = qc * lx - qs * ly, qs * lx + qc * ly
        vx = xvv * vx + xvq * qx + xvw * wx + xvc * tx
        vy = yvv * vy + yvq * qy + yvw * wy + yvc * ty
        z[P + j] += c * px - s * py
        z[P + COLUMNS + j] += s * px + c * py
        z[V + j], z[V + COLUMNS + j] = c * vx - s * vy, s * vx + c * vy


@inner(fastmath={"contract"})
def move(law: Array, what: Any, whose: Any, z: Array, S: Array, c: float, s: float, dt: float, kicked: bool) -> None:
    """Propagates all columns by dt; `S` (K, 3, 12) holds the linear step, the heading has cosine c and sine s."""
    K, C = law.shape[0], what.size
    if kicked:
        _kick(law, what, whose, z, c, s, 0.5 * dt)
    limited = int(law[0, KICKS]) & 4 > 0 or int(law[K - 1, KICKS]) & 4 > 0
    if limited:
        _limit(law, what, whose, z, c, s, dt)
    v0, v1 = z[V], z[V + COLUMNS]
    if K == 2:
        v0, v1 = c * v0 + s * v1, c * v1 - s * v0
    q0, w0, t0, q1, w1, t1 = z[Q], z[W], z[T], z[Q + COLUMNS], z[W + COLUMNS], z[T + COLUMNS]
    qc, qs = (c, s) if lags_in_world(law) else (1.0, 0.0)
    if K == 1:
        _move_line(z, S, C)
    else:
        q0, q1 = qc * q0 + qs * q1, qc * q1 - qs * q0
        _move_plane(z, S, c, s, qc, qs, C)
    for j in range(1, C):
        if not (what[j] == DAMPING or what[j] == SHARE or what[j] == LAG):
            continue
        a = whose[j]
        d, scale = 1, 1.0 - law[a, SHARE]
        if what[j] == SHARE:
            scale = -law[a, DAMPING]
        elif what[j] == LAG:
            d, scale = 2, -1.0 / law[a, LAG] ** 2
        v, q, w, t = (v0, q0, w0, t0) if a == 0 else (v1, q1, w1, t1)
        p = scale * (S[a, d, 0] * v + S[a, d, 1] * q + S[a, d, 2] * w + S[a, d, 3] * t)
        along = scale * (S[a, d, 4] * v + S[a, d, 5] * q + S[a, d, 6] * w + S[a, d, 7] * t)
        lagged = scale * (S[a, d, 8] * v + S[a, d, 9] * q + S[a, d, 10] * w + S[a, d, 11] * t)
        z[Q + j] += lagged * (qc if a == 0 else -qs)
        if K == 2:
            z[Q + COLUMNS + j] += lagged * (qs if a == 0 else qc)
        x, y = (c, s) if a == 0 else (-s, c)
        z[P + j] += x * p
        z[V + j] += x * along
        if K == 2:
            z[P + COLUMNS + j] += y * p
            z[V + COLUMNS + j] += y * along
    if limited:
        for a in range(K):
            for j in range(C):
                z[W + COLUMNS * a + j] = z[ASKED + COLUMNS * a + j]
    if kicked:
        _kick(law, what, whose, z, c, s, 0.5 * dt)
