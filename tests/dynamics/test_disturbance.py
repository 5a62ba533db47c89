"""The disturbance filter: discretisation against the matrix exponential, likelihood against a dense covariance."""

import itertools

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve, expm, solve_continuous_lyapunov

from rotorfit.dynamics.disturbance import (
    START_POSITION_VARIANCE,
    STEP_GRAIN,
    discretize,
    distinct_steps,
    stationary,
)
from whole_filters import whiten_axis, whiten_plane

Array = np.ndarray

LEVELS_X = np.array([0.05, 4e-6, 3.0, 0.4])
LEVELS_Y = np.array([0.8, 1e-6, 9.0, 0.99])


def drift(damping: float, stiffness: float) -> Array:
    """The generator of (n, s, s')."""
    return np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -stiffness, -damping]])


def stiffness_of(levels: Array) -> float:
    return 0.25 * float(levels[3] * levels[2] ** 2)


# Discretisation


def van_loan(A: Array, dt: float) -> tuple[Array, Array]:
    """Transition and covariance for a unit power into the last state, by exponentials of steps that are short enough.

    Source: C. F. Van Loan, IEEE Trans. Autom. Control 23 (1978), pp. 395-404; doubled, as its covariance loses digits
    where exp(-A t) grows.
    """
    doublings = max(0, int(np.ceil(np.log2(max(float(np.abs(A).sum()) * dt, 1e-12)))) + 1)
    h = dt / 2**doublings
    block = np.zeros((6, 6))
    block[:3, :3], block[3:, 3:], block[2, 5] = -A, A.T, 1.0
    exponential = expm(block * h)
    F = exponential[3:, 3:].T
    Q = F @ exponential[:3, 3:]
    for _ in range(doublings):
        Q = Q + F @ Q @ F.T
        F = F @ F
    return F, Q


def discretized(damping: float, stiffness: float, dt: float) -> tuple[Array, Array]:
    F, Q = np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    discretize(damping, stiffness, dt, F, Q)
    return F, Q


@pytest.mark.parametrize("dt", [1e-4, 1 / 120, 1 / 30, 0.2, 2.0, 30.0])
@pytest.mark.parametrize("damping", [1e-3, 0.1, 1.0, 7.0, 60.0, 160.0])
@pytest.mark.parametrize("overlap", [1e-6, 1e-3, 0.3, 1.0])
def test_transition_and_covariance_agree_with_van_loan(damping: float, overlap: float, dt: float) -> None:
    stiffness = 0.25 * overlap * damping**2
    F, Q = discretized(damping, stiffness, dt)

    expected_F, expected_Q = van_loan(drift(damping, stiffness), dt)
    scale = np.sqrt(np.diag(expected_Q))
    unit = np.outer(scale, 1 / scale)  # a state of one standard deviation moves that many of the other
    np.testing.assert_allclose(F / unit, expected_F / unit, rtol=0, atol=1e-8 * np.abs(expected_F / unit).max())
    np.testing.assert_allclose(Q / np.outer(scale, scale), expected_Q / np.outer(scale, scale), rtol=0, atol=5e-7)


@pytest.mark.parametrize("dt", [1 / 30, 1.0])
@pytest.mark.parametrize(("damping", "stiffness"), [(4.0, 4.0), (0.0, 0.0), (3.0, 0.0)], ids=["equal", "zero", "one 0"])
def test_equal_poles_and_poles_at_zero_are_no_special_case(damping: float, stiffness: float, dt: float) -> None:
    nearly = discretized(damping * (1 + 1e-9), stiffness * (1 - 1e-9), dt)

    for exact, near in zip(discretized(damping, stiffness, dt), nearly, strict=True):
        assert np.isfinite(exact).all()
        np.testing.assert_allclose(exact, near, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        discretized(damping, stiffness, dt)[0], expm(drift(damping, stiffness) * dt), rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize("levels", [LEVELS_X, LEVELS_Y])
def test_the_covariance_is_that_of_a_random_walk_with_the_stated_power(levels: Array) -> None:
    """Over a short step: q dt into s', q dt^3 / 3 into s, q dt^5 / 20 into n."""
    dt = 1e-4
    _, Q = discretized(levels[2], stiffness_of(levels), dt)

    np.testing.assert_allclose(np.diag(Q), [dt**5 / 20, dt**3 / 3, dt], rtol=2e-3)


@pytest.mark.parametrize("levels", [LEVELS_X, LEVELS_Y, np.array([1.0, 1e-6, 0.5, 0.5])])
def test_the_stationary_state_solves_the_lyapunov_equation(levels: Array) -> None:
    A = drift(levels[2], stiffness_of(levels))[1:, 1:]

    expected = solve_continuous_lyapunov(A, np.diag([0.0, -levels[0]]))
    variances = stationary(levels)
    np.testing.assert_allclose(np.diag(expected), variances, rtol=1e-10)
    assert abs(expected[0, 1]) < 1e-12 * np.sqrt(variances[0] * variances[1])


def test_two_half_steps_are_one_whole_step() -> None:
    half, whole = discretized(3.0, 0.9, 0.4), discretized(3.0, 0.9, 0.8)

    np.testing.assert_allclose(whole[0], half[0] @ half[0], rtol=1e-9)
    np.testing.assert_allclose(whole[1], half[1] + half[0] @ half[1] @ half[0].T, rtol=1e-6)


# Steps


def test_steps_are_rounded_to_the_grain_and_lead_back_to_the_stamps() -> None:
    time = np.sort(np.random.default_rng(0).random(300) * 10)
    steps, step = distinct_steps(time)

    assert step.shape == time.shape
    assert steps[step[0]] == 0.0
    np.testing.assert_allclose(steps[step[1:]], np.diff(time), rtol=0, atol=0.5000001 * STEP_GRAIN)
    np.testing.assert_array_equal(steps, np.unique(steps))


def test_a_regular_clock_has_few_steps() -> None:
    assert distinct_steps(np.round(np.arange(5000) / 120, 9))[0].size <= 3  # 0, and 8.33 ms rounded up or down


# Whitening against a dense covariance


def stamps(n: int, seed: int = 3) -> Array:
    """Irregular, on the grain, with a hole."""
    steps = np.random.default_rng(seed).integers(800, 6000, n).astype(float)
    steps[n // 2] = 90_000.0
    out: Array = np.cumsum(steps) * STEP_GRAIN
    return out


def dense_axis(time: Array, count: Array, levels: Array) -> Array:
    """Covariance of the observations of one segment, from the state's covariance between all pairs of instants."""
    A, B = drift(levels[2], stiffness_of(levels)), time.size
    P = np.zeros((3, 3))
    P[0, 0] = START_POSITION_VARIANCE
    P[1, 1], P[2, 2] = stationary(levels)
    C = np.zeros((B, B))
    moves = [van_loan(A, dt) for dt in np.diff(time)]
    for i in range(B):
        if i:
            F, Q = moves[i - 1]
            P = F @ P @ F.T + levels[0] * Q
        C[i, i] = P[0, 0]
        cross = P
        for j in range(i + 1, B):
            cross = moves[j - 1][0] @ cross
            C[i, j] = C[j, i] = cross[0, 0]
    out: Array = C + np.diag(levels[1] / count)
    return out


def gaussian(C: Array, e: Array) -> float:
    """Log density of e ~ N(0, C)."""
    factor = cho_factor(C, lower=True)
    log_determinant = 2 * np.log(np.diag(factor[0])).sum()
    return float(-0.5 * (e @ cho_solve(factor, e) + log_determinant + e.size * np.log(2 * np.pi)))


def of_innovations(out: Array, variance: Array) -> float:
    """Log density from what a whitening filter gives of one column."""
    return float(-0.5 * (out.ravel() @ out.ravel() + np.log(variance).sum() + out.size * np.log(2 * np.pi)))


def whitened_axis(time: Array, count: Array, fresh: Array, columns: Array, levels: Array) -> tuple[Array, Array]:
    steps, step = distinct_steps(time)
    out, _, variance = whiten_axis(steps, step, count, fresh, columns, levels[None], 0)
    return out, variance[0]


def first_only(B: int) -> Array:
    fresh = np.zeros(B, bool)
    fresh[0] = True
    return fresh


@pytest.mark.parametrize("levels", [LEVELS_X, LEVELS_Y, np.array([1e-3, 1e-3, 40.0, 0.02])])
def test_whitening_one_axis_gives_the_likelihood_of_the_dense_covariance(levels: Array) -> None:
    time, rng = stamps(40), np.random.default_rng(5)
    count = rng.integers(1, 5, time.size).astype(float)
    y = np.cumsum(0.01 * rng.standard_normal(time.size))

    likelihood = of_innovations(*whitened_axis(time, count, first_only(time.size), y[:, None], levels))
    expected = gaussian(dense_axis(time, count, levels), y)
    assert abs(likelihood - expected) < 1e-8 * abs(expected)


def test_segments_are_independent() -> None:
    time, rng = stamps(40), np.random.default_rng(5)
    count, y = np.ones(40), rng.standard_normal((40, 1))
    fresh = first_only(40)
    fresh[17] = True

    both, _ = whitened_axis(time, count, fresh, y, LEVELS_X)
    second, _ = whitened_axis(time[17:], count[17:], first_only(23), y[17:], LEVELS_X)
    np.testing.assert_allclose(both[17:], second, rtol=1e-12)


def test_columns_pass_linearly_and_none_sees_another() -> None:
    time, rng = stamps(30), np.random.default_rng(6)
    a, b = rng.standard_normal((2, 30))
    columns = np.stack([a, b, 2 * a - 3 * b], axis=1)

    out, _ = whitened_axis(time, np.ones(30), first_only(30), columns, LEVELS_X)
    alone, _ = whitened_axis(time, np.ones(30), first_only(30), a[:, None], LEVELS_X)
    np.testing.assert_allclose(out[:, 2], 2 * out[:, 0] - 3 * out[:, 1], rtol=0, atol=1e-10 * np.abs(out).max())
    np.testing.assert_array_equal(out[:, 0], alone[:, 0])


def test_innovations_of_the_filters_own_process_are_white_and_of_unit_variance() -> None:
    time, rng = stamps(60), np.random.default_rng(7)
    root = np.linalg.cholesky(dense_axis(time, np.ones(60), LEVELS_X))
    y = root @ rng.standard_normal((60, 4000))

    out, _ = whitened_axis(time, np.ones(60), first_only(60), y, LEVELS_X)
    covariance = out @ out.T / out.shape[1]
    assert np.abs(covariance - np.eye(60)).max() < 6 / np.sqrt(out.shape[1])


# The plane


def whitened_plane(time: Array, count: Array, yaw: Array, columns: Array, levels: Array) -> tuple[Array, Array]:
    steps, step = distinct_steps(time)
    turned = np.ascontiguousarray(columns.transpose(0, 2, 1))
    out, _, variance = whiten_plane(steps, step, count, first_only(time.size), yaw, turned, levels[None], 0)
    return out.transpose(0, 2, 1), variance[0]


def plane_data(B: int = 30) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(8)
    time = stamps(B)
    yaw = 0.3 + 0.7 * np.sin(1.3 * time) + 2 * time
    return time, rng.integers(1, 5, B).astype(float), yaw, rng.standard_normal((B, 3, 2)).cumsum(axis=0)


def dense_plane(time: Array, count: Array, yaw: Array, levels: Array) -> Array:
    """Covariance of (forward, left) of all blocks in turn: half the turn, the step, the other half."""
    B = time.size
    generators = [drift(level[2], stiffness_of(level)) for level in levels]

    def turn(angle: float) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        return np.kron(np.array([[c, s], [-s, c]]), np.eye(3))

    moves = [np.eye(6)]
    P = np.zeros((6, 6))
    for a in range(2):
        P[3 * a, 3 * a] = START_POSITION_VARIANCE
        P[3 * a + 1, 3 * a + 1], P[3 * a + 2, 3 * a + 2] = stationary(levels[a])
    states = [P]
    for i in range(1, B):
        half = turn(0.5 * (yaw[i] - yaw[i - 1]))
        F, Q = np.zeros((6, 6)), np.zeros((6, 6))
        for a in range(2):
            block = slice(3 * a, 3 * a + 3)
            F[block, block], own = van_loan(generators[a], time[i] - time[i - 1])
            Q[block, block] = levels[a, 0] * own
        moves.append(half @ F @ half)
        P = half @ (F @ (half @ P @ half.T) @ F.T + Q) @ half.T
        states.append(P)
    C = np.zeros((2 * B, 2 * B))
    pick = np.zeros((2, 6))
    pick[0, 0] = pick[1, 3] = 1.0
    for i in range(B):
        cross = states[i]
        for j in range(i, B):
            cross = moves[j] @ cross if j > i else cross
            block = pick @ cross @ pick.T
            C[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = block
            C[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block.T
        C[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += np.diag(levels[:, 1] / count[i])
    return C


def test_whitening_the_plane_gives_the_likelihood_of_the_dense_covariance() -> None:
    time, count, yaw, columns = plane_data()
    levels = np.stack([LEVELS_X, LEVELS_Y])
    out, variance = whitened_plane(time, count, yaw, columns[:, :1], levels)

    c, s, (x, y) = np.cos(yaw), np.sin(yaw), columns[:, 0].T
    heading = np.stack([c * x + s * y, c * y - s * x], axis=1)
    expected = gaussian(dense_plane(time, count, yaw, levels), heading.ravel())
    assert abs(of_innovations(out, variance) - expected) < 1e-8 * abs(expected)


def test_at_heading_zero_the_plane_is_two_axes() -> None:
    time, count, yaw, columns = plane_data()
    levels = np.stack([LEVELS_X, LEVELS_Y])
    out, variance = whitened_plane(time, count, 0 * yaw, columns, levels)

    for a, level in enumerate(levels):
        alone, alone_variance = whitened_axis(time, count, first_only(time.size), columns[:, :, a], level)
        np.testing.assert_allclose(out[:, :, a], alone, rtol=0, atol=1e-10 * np.abs(alone).max())
        np.testing.assert_allclose(np.log(variance[:, a]), np.log(alone_variance), rtol=0, atol=1e-10)


def test_with_the_same_levels_on_both_axes_no_turn_of_the_heading_changes_the_likelihood() -> None:
    time, count, yaw, columns = plane_data()
    levels = np.stack([LEVELS_X, LEVELS_X])

    still, turning = (
        of_innovations(*whitened_plane(time, count, heading, columns[:, :1], levels)) for heading in (0 * yaw, yaw)
    )
    assert abs(still - turning) < 1e-9 * abs(still)


def test_turning_the_world_turns_no_innovation() -> None:
    time, count, yaw, columns = plane_data()
    levels, angle = np.stack([LEVELS_X, LEVELS_Y]), 2.2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    out, variance = whitened_plane(time, count, yaw, columns, levels)
    turned, turned_variance = whitened_plane(time, count, yaw + angle, columns @ turn.T, levels)
    np.testing.assert_allclose(turned, out, rtol=0, atol=1e-9 * np.abs(out).max())
    np.testing.assert_allclose(np.log(turned_variance), np.log(variance), rtol=0, atol=1e-10)


def test_a_half_turn_of_the_heading_leaves_each_axis_to_itself() -> None:
    time, count, yaw, columns = plane_data()
    levels = np.stack([LEVELS_X, LEVELS_Y])
    half = np.full_like(yaw, np.pi)

    out, _ = whitened_plane(time, count, half, columns, levels)
    straight, _ = whitened_plane(time, count, 0 * yaw, columns, levels)
    np.testing.assert_allclose(out, -straight, rtol=0, atol=1e-9 * np.abs(out).max())


def test_long_records_stay_finite_at_the_corners_of_the_searched_levels() -> None:
    from rotorfit.core.laws import LEVEL_RANGE

    time = np.arange(1, 2001) / 30
    y = np.sin(time)[:, None]

    for corner in itertools.product(*np.exp(LEVEL_RANGE)):
        out, variance = whitened_axis(time, np.full(2000, 4.0), first_only(2000), y, np.array(corner))
        assert np.isfinite(out).all(), corner
        assert np.isfinite(variance).all(), corner
        assert (variance > 0).all(), corner
