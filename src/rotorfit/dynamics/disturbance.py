"""The slow disturbance and the pose noise: a Kalman filter that whitens.

The motion that the commands do not explain is, on each axis of the heading frame,

    n' = s,   s'' = -alpha s' - kappa alpha^2 / 4 s + sqrt(q) xi,   y = n + e,   e ~ N(0, r)

a velocity coloured by two real poles: wind with a memory that acts through drag. The poles sum to -alpha; they are
equal where the overlap kappa is 1 and far apart where it is small, so that they cannot swap labels. They belong to the
disturbance alone (the Box-Jenkins form), so its four levels share no parameter with the response and the information
matrix is block diagonal. The position starts unknown, s and s' start in their stationary state.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices

LEVELS = ("wind_power", "pose_variance", "wind_damping", "wind_overlap")
"""q [unit^2/s^5], r [unit^2], alpha [1/s], kappa in (0, 1]: the order in every array of disturbance levels."""

STEP_GRAIN = 1e-5
"""Steps of the disturbance filter are rounded to this [s]: a residual motion of 0.1 m/s travels 1 um in that time. The
response to the commands is not rounded."""

LARGEST_SPEED = 10.0
"""Bound on the initial standard deviation of s [m/s]: with poles near 0 the filter would lose precision."""

START_POSITION_VARIANCE = 1.0

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)

_NODE = 0.5 * (_NODES + 1)

_NODE_WEIGHT = 0.5 * _WEIGHTS

_TERMS = 14

_INVERSE_FACTORIAL = np.array([1.0 / float(np.prod(np.arange(1, n + 1, dtype=float))) for n in range(_TERMS + 3)])


@inner()
def _impulse_response(series: Array, t: float) -> Any:
    """n, s and s' at time t after a unit impulse into s'; `series` holds the derivatives of s' at 0."""
    n = s = d = 0.0
    for i in range(_TERMS - 1, -1, -1):
        n = n * t + series[i] * _INVERSE_FACTORIAL[i + 2]
        s = s * t + series[i] * _INVERSE_FACTORIAL[i + 1]
        d = d * t + series[i] * _INVERSE_FACTORIAL[i]
    return n * t * t, s * t, d


@kernel()
def discretize(damping: float, stiffness: float, dt: float, F: Array, Q: Array) -> None:
    """Fills the transition F (3, 3) and the covariance Q (3, 3) of (n, s, s') over dt for a unit q.

    A power series in dt, which has no singular case (equal poles, poles at 0, complex poles), over a sufficiently short
    step, followed by doubling.
    """
    doublings, step = 0, dt
    while step * max(damping, np.sqrt(stiffness)) > 1.0:
        step *= 0.5
        doublings += 1
    series = np.empty(_TERMS)
    series[0], series[1] = 1.0, -damping
    for i in range(2, _TERMS):
        series[i] = -damping * series[i - 1] - stiffness * series[i - 2]
    n, s, d = _impulse_response(series, step)
    F[0, 0], F[0, 1], F[0, 2] = 1.0, s + damping * n, n
    F[1, 0], F[1, 1], F[1, 2] = 0.0, d + damping * s, s
    F[2, 0], F[2, 1], F[2, 2] = 0.0, -stiffness * s, d
    q00 = q01 = q02 = q11 = q12 = q22 = 0.0
    for i in range(4):
        n, s, d = _impulse_response(series, _NODE[i] * step)
        scale = _NODE_WEIGHT[i] * step
        q00 += scale * n * n
        q01 += scale * n * s
        q02 += scale * n * d
        q11 += scale * s * s
        q12 += scale * s * d
        q22 += scale * d * d
    for _ in range(doublings):  # Q <- Q + F Q F^T, then F <- F F
        f01, f02, f11, f12, f21, f22 = F[0, 1], F[0, 2], F[1, 1], F[1, 2], F[2, 1], F[2, 2]
        a00, a01, a02 = q00 + f01 * q01 + f02 * q02, q01 + f01 * q11 + f02 * q12, q02 + f01 * q12 + f02 * q22
        a11, a12 = f11 * q11 + f12 * q12, f11 * q12 + f12 * q22
        a21, a22 = f21 * q11 + f22 * q12, f21 * q12 + f22 * q22
        q00 += a00 + a01 * f01 + a02 * f02
        q01 += a01 * f11 + a02 * f12
        q02 += a01 * f21 + a02 * f22
        q11 += a11 * f11 + a12 * f12
        q12 += a11 * f21 + a12 * f22
        q22 += a21 * f21 + a22 * f22
        F[0, 1], F[0, 2] = f01 + f01 * f11 + f02 * f21, f02 + f01 * f12 + f02 * f22
        F[1, 1], F[1, 2] = f11 * f11 + f12 * f21, f11 * f12 + f12 * f22
        F[2, 1], F[2, 2] = f21 * f11 + f22 * f21, f21 * f12 + f22 * f22
    Q[0, 0], Q[0, 1], Q[0, 2] = q00, q01, q02
    Q[1, 0], Q[1, 1], Q[1, 2] = q01, q11, q12
    Q[2, 0], Q[2, 1], Q[2, 2] = q02, q12, q22


def distinct_steps(time: Array) -> tuple[Array, Indices]:
    """Steps between stamps, rounded to `STEP_GRAIN` so that few are distinct.

    Args:
        time: Increasing, shape (B,) [s].

    Returns:
        The distinct steps, shape (U,) [s], and the index of the step that leads to each stamp, shape (B,).
    """
    grains = np.rint(np.diff(time, prepend=time[:1]) / STEP_GRAIN)
    values, index = np.unique(grains, return_inverse=True)
    return values * STEP_GRAIN, index.astype(np.int64)


@kernel()
def step_tables(steps: Array, damping: float, overlap: float) -> Any:
    """Transition and unit-power covariance of every distinct step: two arrays (U, 3, 3)."""
    F, Q = np.zeros((steps.size, 3, 3)), np.zeros((steps.size, 3, 3))
    fill_step_tables(steps, damping, overlap, F, Q)
    return F, Q


@kernel()
def fill_step_tables(steps: Array, damping: float, overlap: float, F: Array, Q: Array) -> None:
    """Fills the tables of `step_tables`, (U, 3, 3) each."""
    for i in range(steps.size):
        discretize(damping, 0.25 * overlap * damping * damping, steps[i], F[i], Q[i])


@kernel()
def stationary(levels: Array) -> Any:
    """Stationary variances of s, bounded by `LARGEST_SPEED`, and of s', which are uncorrelated, at levels (4,)."""
    variance = levels[0] / (2 * levels[2])
    return min(variance / (0.25 * levels[3] * levels[2] * levels[2]), LARGEST_SPEED**2), variance


@inner()
def rotate(vector: Array, c: float, s: float) -> None:
    """Rotates the frame of a (6,) state (n, s, s' of x, then of y) by the angle of cosine c and sine s, in place."""
    for k in range(3):
        x, y = vector[k], vector[3 + k]
        vector[k] = c * x + s * y
        vector[3 + k] = c * y - s * x


@inner()
def propagate(vector: Array, fx: Array, fy: Array) -> None:
    """Propagates a (6,) state one step by the transitions (3, 3) of x and y, in place."""
    for a in range(2):
        F = fx if a == 0 else fy
        n, s, w = vector[3 * a], vector[3 * a + 1], vector[3 * a + 2]
        vector[3 * a] = n + F[0, 1] * s + F[0, 2] * w
        vector[3 * a + 1] = F[1, 1] * s + F[1, 2] * w
        vector[3 * a + 2] = F[2, 1] * s + F[2, 2] * w


@inner()
def _turn_covariance(P: Array, m: int, c: float, s: float) -> None:
    """Rotates the frame of a covariance held as blocks: P[m, 0] of x, 1 of y, 2 of x with y, each (3, 3), in place."""
    cc, ss, cs = c * c, s * s, c * s
    for i in range(3):
        for j in range(i, 3):
            a, b, x, y = P[m, 0, i, j], P[m, 1, i, j], P[m, 2, i, j], P[m, 2, j, i]
            P[m, 0, i, j] = P[m, 0, j, i] = cc * a + ss * b + cs * (x + y)
            P[m, 1, i, j] = P[m, 1, j, i] = ss * a + cc * b - cs * (x + y)
            P[m, 2, i, j] = cc * x - ss * y + cs * (b - a)
            P[m, 2, j, i] = cc * y - ss * x + cs * (b - a)


@inner()
def _step_block(P: Array, m: int, b: int, F: Array, g: int, first: int, second: int, k: int) -> None:
    """P[m, b] <- F P[m, b] G^T for the transitions F and G of (n, s, s') of two axes, in place."""
    for j in range(3):
        s, d = P[m, b, 1, j], P[m, b, 2, j]
        P[m, b, 0, j] += F[g, first, k, 0, 1] * s + F[g, first, k, 0, 2] * d
        P[m, b, 1, j] = F[g, first, k, 1, 1] * s + F[g, first, k, 1, 2] * d
        P[m, b, 2, j] = F[g, first, k, 2, 1] * s + F[g, first, k, 2, 2] * d
    for i in range(3):
        s, d = P[m, b, i, 1], P[m, b, i, 2]
        P[m, b, i, 0] += F[g, second, k, 0, 1] * s + F[g, second, k, 0, 2] * d
        P[m, b, i, 1] = F[g, second, k, 1, 1] * s + F[g, second, k, 1, 2] * d
        P[m, b, i, 2] = F[g, second, k, 2, 1] * s + F[g, second, k, 2, 2] * d


@kernel()
def axis_start(P: Array, levels: Array) -> None:
    """Fills the prior covariance P (3, 3) of one axis before the first pose; levels have shape (4,)."""
    P[:] = 0.0
    P[0, 0] = START_POSITION_VARIANCE
    P[1, 1], P[2, 2] = stationary(levels)


@inner()
def start_covariance(P: Array, levels: Array) -> None:
    """Fills the blocks P (3, 3, 3) with the prior covariance before the first pose."""
    P[:] = 0.0
    for a in range(2):
        axis_start(P[a], levels[a])


@inner()
def predict_covariance(
    P: Array, m: int, F: Array, Q: Array, g: int, k: int, qx: float, qy: float, c: float, s: float
) -> None:
    """Propagates the blocks P[m] one step: half the turn, the step with its driving noise, the other half; in place.

    Whole arrays with indices are passed, here and below: slicing counts references, which took most of the time of a
    filter.

    Args:
        P: Blocks, shape (M, 3, 3, 3).
        m: Index of the blocks.
        F: Transitions of the two axes, shape (A, 2, U, 3, 3).
        Q: Covariances for a unit power, same shape.
        g: Index into A.
        k: Index into U.
        qx: Power along x.
        qy: Power along y.
        c: Cosine of half the turn.
        s: Its sine.
    """
    if s != 0.0:
        _turn_covariance(P, m, c, s)
    for b in range(3):  # a single call: numba would compile again for each literal argument
        _step_block(P, m, b, F, g, b % 2, (b + 1) // 2, k)
    for a in range(2):
        power = qx if a == 0 else qy
        for i in range(3):
            for j in range(i, 3):
                P[m, a, i, j] += power * Q[g, a, k, i, j]
                P[m, a, j, i] = P[m, a, i, j]
    if s != 0.0:
        _turn_covariance(P, m, c, s)


@inner()
def update_covariance(P: Array, m: int, axis: int, noise: float, gain: Array) -> Any:
    """Updates the blocks P[m] with a measured position of one axis; fills the gain (6,), returns the variance."""
    S = P[m, axis, 0, 0] + noise
    for i in range(3):
        gain[3 * axis + i] = P[m, axis, i, 0] / S
        gain[3 * (1 - axis) + i] = (P[m, 2, 0, i] if axis == 0 else P[m, 2, i, 0]) / S
    _take_off(P, m, gain, S)
    return S


@inner()
def _take_off(P: Array, m: int, gain: Array, S: float) -> None:
    """Subtracts the update by a measurement of variance S with this gain from the blocks P[m]."""
    for i in range(3):
        for j in range(3):
            P[m, 0, i, j] -= gain[i] * gain[j] * S
            P[m, 1, i, j] -= gain[3 + i] * gain[3 + j] * S
            P[m, 2, i, j] -= gain[i] * gain[3 + j] * S
