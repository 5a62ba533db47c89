"""The disturbance filter with an additional measurement of the vehicle's own velocity.

State and noise are those of `disturbance`: n, s, s' on each axis of the heading frame. A block of poses measures n, a
block of velocities measures s, each with its own noise:

    y = n + e,  e ~ N(0, r);        w = s + d + e,  e ~ N(0, r_v)

d is the bias of the velocity, constant in the heading frame during a segment. Where only the velocity is measured, it
cannot be separated from the trim and is left out.
"""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array
from rotorfit.dynamics.disturbance import START_POSITION_VARIANCE, stationary, step_tables

BIAS_VARIANCE = 0.1
"""Prior variance of the bias of a velocity [m^2/s^2 or rad^2/s^2]."""


@inner()
def _turn(vector: Array, K: int, c: float, s: float) -> None:
    """Rotates the frame of a state (4 K,) by the angle of cosine c and sine s, in place.

    The state is n, s, s' of each axis in turn, then the bias of each, which does not rotate.
    """
    if K == 2:
        for i in range(3):
            x, y = vector[i], vector[3 + i]
            vector[i] = c * x + s * y
            vector[3 + i] = c * y - s * x


@inner()
def _advance(vector: Array, F: Array) -> None:
    """Propagates a state (4 K,) one step by the transitions F (K, 3, 3), in place."""
    for a in range(F.shape[0]):
        n, s, w = vector[3 * a], vector[3 * a + 1], vector[3 * a + 2]
        vector[3 * a] = n + F[a, 0, 1] * s + F[a, 0, 2] * w
        vector[3 * a + 1] = F[a, 1, 1] * s + F[a, 1, 2] * w
        vector[3 * a + 2] = F[a, 2, 1] * s + F[a, 2, 2] * w


@inner()
def _begin(P: Array, levels: Array, bias: float) -> None:
    """Fills the prior covariance P (4 K, 4 K) before the first block; `bias` is the variance of d."""
    K = levels.shape[0]
    P[:] = 0.0
    for a in range(K):
        P[3 * a, 3 * a] = START_POSITION_VARIANCE
        P[3 * a + 1, 3 * a + 1], P[3 * a + 2, 3 * a + 2] = stationary(levels[a])
        P[3 * K + a, 3 * K + a] = bias


@inner()
def _spread(P: Array, F: Array, Q: Array, levels: Array, c: float, s: float) -> None:
    """Propagates the covariance P (4 K, 4 K) one step, in place: half the turn, the step with noise, the other half."""
    K, D = F.shape[0], P.shape[0]
    for i in range(D):
        _turn(P[:, i], K, c, s)
        _advance(P[:, i], F)
    for i in range(D):
        _turn(P[i], K, c, s)
        _advance(P[i], F)
    for a in range(K):
        for i in range(3):
            for j in range(3):
                P[3 * a + i, 3 * a + j] += levels[a, 0] * Q[a, i, j]
    for i in range(D):
        _turn(P[:, i], K, c, s)
    for i in range(D):
        _turn(P[i], K, c, s)


@inner()
def _take(P: Array, at: int, beside: int, noise: float, gain: Array) -> float:
    """Updates P with a measurement of state `at`, plus state `beside` unless negative; fills the gain, returns S."""
    D = P.shape[0]
    for i in range(D):
        gain[i] = P[i, at]
        if beside >= 0:
            gain[i] += P[i, beside]
    S = gain[at] + noise
    if beside >= 0:
        S += gain[beside]
    for i in range(D):
        for j in range(D):
            P[i, j] -= gain[i] * gain[j] / S
    for i in range(D):
        gain[i] /= S
    return S  # type: ignore[no-any-return]


@kernel()
def whiten_fused(
    steps: Array, step: Any, count: Array, fresh: Any, rate: Any, yaw: Array, columns: Array, levels: Array,
    noise: Array, bias: float, coloured: bool = False,
) -> Any:  # fmt: skip
    """Filters columns to innovations, or innovations back to data.

    Args:
        steps: Distinct steps between blocks, shape (U,) [s].
        step: Index of the step that leads to each block, shape (B,).
        count: Samples in each block, shape (B,).
        fresh: True where a segment starts, shape (B,).
        rate: True for blocks of velocities, shape (B,).
        yaw: Heading at the blocks, shape (B,) [rad]; ignored for one axis.
        columns: Data and sensitivities, world frame where K is 2, shape (B, C, K).
        levels: q, r, alpha, kappa of each axis, shape (K, 4); r is ignored.
        noise: Variance of one pose and of one velocity, shape (K, 2).
        bias: Prior variance of the bias of the velocity; 0 without one.
        coloured: Whether the columns are innovations to be converted to data.

    Returns:
        Innovations over their standard deviation, forward then left where K is 2, shape (B, C, K), or the data with
        these innovations; and the innovation variances, shape (B, K).
    """
    B, C, K = columns.shape
    D, out, variance = 4 * K, np.empty((B, C, K)), np.empty((B, K))
    F, Q = np.empty((steps.size, K, 3, 3)), np.empty((steps.size, K, 3, 3))
    for a in range(K):
        F[:, a], Q[:, a] = step_tables(steps, levels[a, 2], levels[a, 3])
    P, state, gain = np.zeros((D, D)), np.zeros((C, D)), np.empty(D)
    for i in range(B):
        if fresh[i]:
            state[:] = 0.0
            _begin(P, levels, bias)
        else:
            half = 0.5 * (yaw[i] - yaw[i - 1]) if K == 2 else 0.0
            c, s = np.cos(half), np.sin(half)
            _spread(P, F[step[i]], Q[step[i]], levels, c, s)
            for j in range(C):
                _turn(state[j], K, c, s)
                _advance(state[j], F[step[i]])
                _turn(state[j], K, c, s)
        c, s = (np.cos(yaw[i]), np.sin(yaw[i])) if K == 2 else (1.0, 0.0)
        for a in range(K):
            at, beside = (3 * a + 1, 3 * K + a) if rate[i] else (3 * a, -1)
            S = _take(P, at, beside, noise[a, 1 if rate[i] else 0] / count[i], gain)
            root = np.sqrt(S)
            variance[i, a] = S
            for j in range(C):
                expected = state[j, at] + (state[j, beside] if beside >= 0 else 0.0)
                if coloured:
                    innovation = columns[i, j, a] * root
                    out[i, j, a] = expected + innovation
                else:
                    along = columns[i, j, a]
                    if K == 2:
                        x, y = columns[i, j, 0], columns[i, j, 1]
                        along = c * x + s * y if a == 0 else c * y - s * x
                    innovation = along - expected
                    out[i, j, a] = innovation / root
                for m in range(D):
                    state[j, m] += gain[m] * innovation
        if coloured and K == 2:
            for j in range(C):
                x, y = out[i, j, 0], out[i, j, 1]
                out[i, j, 0], out[i, j, 1] = c * x - s * y, s * x + c * y
    return out, variance
