"""The disturbance as the filter sees it, against a Kalman filter as textbooks write it."""

import numpy as np
from scipy.linalg import expm

from rotorfit.dynamics.disturbance import START_POSITION_VARIANCE, distinct_steps, stationary
from rotorfit.dynamics.disturbance_state import disturbance_states

Array = np.ndarray

LEVELS = np.array([0.3, 4e-6, 3.0, 0.4])


def plain_filter(time: Array, residual: Array, noise: Array) -> tuple[Array, Array]:
    """Means and covariances; each step by exponentials (C. F. Van Loan, IEEE Trans. Autom. Control 23 (1978))."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -0.25 * LEVELS[3] * LEVELS[2] ** 2, -LEVELS[2]]])
    power = np.diag([0.0, 0.0, LEVELS[0]])
    m, P = np.zeros(3), np.diag([START_POSITION_VARIANCE, *stationary(LEVELS)])
    H, means, covariances = np.array([[1.0, 0.0, 0.0]]), [], []
    for i, z in enumerate(residual):
        if i:
            both = expm(np.block([[-A, power], [np.zeros((3, 3)), A.T]]) * (time[i] - time[i - 1]))
            F = both[3:, 3:].T
            m, P = F @ m, F @ P @ F.T + F @ both[:3, 3:]
        K = P @ H.T / (H @ P @ H.T + noise[i])
        m = m + (K @ (z - H @ m)[:, None])[:, 0]
        I_KH = np.eye(3) - K @ H
        P = I_KH @ P @ I_KH.T + noise[i] * K @ K.T
        means.append(m)
        covariances.append(P)
    return np.array(means), np.array(covariances)


def test_it_is_the_kalman_filter_over_irregular_samples_of_changing_noise() -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.choice([0.01, 0.02, 0.3], 80, p=[0.5, 0.45, 0.05]))
    residual, noise = np.cumsum(rng.normal(0, 0.01, 80)), rng.choice([1e-6, 1e-4], 80)

    steps, step = distinct_steps(time)
    means, covariances = disturbance_states(steps, step, residual, noise, LEVELS)
    expected, spread = plain_filter(time, residual, noise)

    np.testing.assert_allclose(means, expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(covariances, spread, rtol=1e-4, atol=1e-9)


def test_it_finds_a_disturbance_of_its_own_law_and_says_how_well() -> None:
    """White acceleration through the law of s, seen with noise: errors are as large as the covariance says."""
    rng, dt, N = np.random.default_rng(2), 0.02, 20_000
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -0.25 * LEVELS[3] * LEVELS[2] ** 2, -LEVELS[2]]])
    both = expm(np.block([[-A, np.diag([0.0, 0.0, LEVELS[0]])], [np.zeros((3, 3)), A.T]]) * dt)
    F = both[3:, 3:].T
    root = np.linalg.cholesky(F @ both[:3, 3:] + 1e-18 * np.eye(3))
    state = np.array([0.0, *rng.normal(0, np.sqrt(stationary(LEVELS)))])
    states = []
    for kick in rng.standard_normal((N, 3)):
        states.append(state)
        state = F @ state + root @ kick
    true = np.array(states)
    seen = true[:, 0] + rng.normal(0, 0.002, N)

    steps, step = distinct_steps(dt * np.arange(N))
    means, covariances = disturbance_states(steps, step, seen, np.full(N, 4e-6), LEVELS)
    off = (means - true)[500:, 1:] / np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)[500:, 1:])
    np.testing.assert_allclose(off.std(axis=0), 1.0, atol=0.1)
