"""The disturbance of one axis as filtered up to every sample: mean and covariance of (n, s, s')."""

from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array
from rotorfit.dynamics.disturbance import axis_start, step_tables


@kernel()
def disturbance_states(steps: Array, step: Any, residual: Array, noise: Array, levels: Array) -> Any:
    """Filters the motion that the commands leave unexplained.

    Args:
        steps: Distinct steps between the samples, shape (U,) [s].
        step: Index of the step that leads to each sample, shape (B,).
        residual: Measured minus driven position, shape (B,).
        noise: Variance of each measurement, shape (B,).
        levels: q, r, alpha, kappa, not as logarithms, shape (4,); r is ignored.

    Returns:
        Means (B, 3) and covariances (B, 3, 3) of n, s and s' after each sample.

    Source: R. E. Kalman, J. Basic Eng. 82 (1960), pp. 35-45.
    """
    B = residual.size
    means, covariances = np.empty((B, 3)), np.empty((B, 3, 3))
    F, Q = step_tables(steps, levels[2], levels[3])
    m, P, M = np.zeros(3), np.zeros((3, 3)), np.empty((3, 3))
    axis_start(P, levels)
    for i in range(B):
        if i:
            step_state(m, P, F[step[i]], Q[step[i]], levels[0], M)
        take_position(m, P, residual[i], noise[i])
        means[i], covariances[i] = m, P
    return means, covariances


@inner()
def step_state(m: Array, P: Array, F: Array, Q: Array, power: float, M: Array) -> None:
    """Propagates mean (3,) and covariance (3, 3) by a step, in place; Q is the upper triangle for a unit power."""
    a, b, c = m[0], m[1], m[2]
    for r in range(3):
        m[r] = F[r, 0] * a + F[r, 1] * b + F[r, 2] * c
        for k in range(3):
            M[r, k] = F[r, 0] * P[0, k] + F[r, 1] * P[1, k] + F[r, 2] * P[2, k]
    for r in range(3):
        for k in range(3):
            P[r, k] = M[r, 0] * F[k, 0] + M[r, 1] * F[k, 1] + M[r, 2] * F[k, 2]
            P[r, k] += power * Q[min(r, k), max(r, k)]


@inner()
def take_position(m: Array, P: Array, residual: float, noise: float) -> None:
    """Updates mean and covariance with a measured position, in place."""
    variance = P[0, 0] + noise
    off = residual - m[0]
    g0, g1, g2 = P[0, 0] / variance, P[1, 0] / variance, P[2, 0] / variance
    for r in range(3):
        gain = g0 if r == 0 else (g1 if r == 1 else g2)
        m[r] += gain * off
        P[r, 0] -= gain * g0 * variance
        P[r, 1] -= gain * g1 * variance
        P[r, 2] -= gain * g2 * variance
