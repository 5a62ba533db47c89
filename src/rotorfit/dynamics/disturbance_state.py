"""The disturbance of one axis as the filter sees it at every sample: mean and covariance of (n, s, s')."""

from typing import Any

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.dynamics.compiled import kernel
from rotorfit.dynamics.disturbance import axis_start, step_tables


@kernel()
def disturbance_states(steps: Array, step: Any, residual: Array, noise: Array, levels: Array) -> Any:
    """Filters what the commands leave unexplained.

    Args:
        steps: Distinct steps between the samples, shape (U,) [s].
        step: Which of them leads to each sample, shape (B,).
        residual: Measured less driven position, shape (B,).
        noise: Variance of the measurement of each, shape (B,).
        levels: q, r, alpha, kappa, no logarithms, shape (4,); r is not looked at.

    Returns:
        Means (B, 3) and covariances (B, 3, 3) of n, s and s' after each sample.

    Source: R. E. Kalman, J. Basic Eng. 82 (1960), pp. 35-45.
    """
    B = residual.size
    means, covariances = np.empty((B, 3)), np.empty((B, 3, 3))
    F, Q = step_tables(steps, levels[2], levels[3])
    m, P, M = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    axis_start(P, levels)
    for i in range(B):
        if i:
            f, q = F[step[i]], Q[step[i]]
            a, b, c = m[0], m[1], m[2]
            for r in range(3):
                m[r] = f[r, 0] * a + f[r, 1] * b + f[r, 2] * c
                for k in range(3):
                    M[r, k] = f[r, 0] * P[0, k] + f[r, 1] * P[1, k] + f[r, 2] * P[2, k]
            for r in range(3):
                for k in range(3):
                    P[r, k] = M[r, 0] * f[k, 0] + M[r, 1] * f[k, 1] + M[r, 2] * f[k, 2]
                    P[r, k] += levels[0] * q[min(r, k), max(r, k)]
        variance = P[0, 0] + noise[i]
        off = residual[i] - m[0]
        gain = P[:, 0] / variance
        for r in range(3):
            m[r] += gain[r] * off
            for k in range(3):
                P[r, k] -= gain[r] * gain[k] * variance
        means[i], covariances[i] = m, P
    return means, covariances
