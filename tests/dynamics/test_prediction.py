"""The causal filter and the motion that follows from it: exactness, causality, agreement with a dense smoother."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flights import STILL, flown, steps
from rotorfit.core.flight_data import Flight
from rotorfit.core.laws import FIRST_ORDER_DELAY, law_of
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.predictor import Forecast, free_run
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

Array = np.ndarray

TINY = np.array([[1e-10, 1e-12, 2.0, 0.5]] * 2)


def predicted(
    flight: Flight,
    starts: list[float],
    horizon: float,
    pair: tuple[int, int] = (0, 1),
    levels: Array = TINY,
    gamma: tuple[float, ...] = GAMMA_B,
    delay: float = 0.15,
    trim_variance: float = 1e-8,
) -> tuple[Array, Array, Array, Array]:
    """Predictions (S, E, 4) and start states (S, 4), with the index of the first and one past the last pose."""
    seen = flight.pose_time >= delay
    t, pose = flight.pose_time[seen], np.column_stack([flight.position, flight.yaw])[seen]
    first = np.searchsorted(t, np.array(starts), side="right")
    last = np.searchsorted(t, np.array(starts) + horizon, side="right")
    yaw = pose[:, 3] if pair == (0, 1) else np.zeros(t.size)
    index = np.minimum(first[:, None] + np.arange((last - first).max()), t.size - 1)
    gain, damping = np.array(gamma)[::2][list(pair)], np.array(gamma)[1::2][list(pair)]
    law = np.array([law_of(FIRST_ORDER_DELAY, *each, delay, {}) for each in zip(gain, damping, strict=True)])
    forecast = Forecast(
        flight.command_time,
        np.ascontiguousarray(flight.command[:, list(pair)]),
        t,
        np.ascontiguousarray(pose[:, list(pair)]),
        np.ascontiguousarray(yaw),
        *distinct_steps(t),
        law,
        law,
        np.zeros(2),
        levels[None, None],
        np.full(2, trim_variance),
        np.empty((0, 2)),
        np.ones((t.size, 2), bool),
        np.zeros(2, bool),
    )
    out, begin, _ = forecast.starts(first, last, np.ascontiguousarray(yaw[index]))
    return out, begin, first, last


@pytest.mark.parametrize(("pair", "tolerance"), [((0, 1), 1e-4), ((2, 3), 5e-6)])
def test_without_noise_the_prediction_is_the_flight(pair: tuple[int, int], tolerance: float) -> None:
    """5 s ahead; x and y turn through radians on the way, their heading straight between the poses."""
    flight = flown(STILL, steps(), 20.0, initial_yaw=0.5)
    seen = flight.pose_time >= 0.15
    pose = np.column_stack([flight.position, flight.yaw])[seen][:, list(pair)]

    quiet = np.array([[1e-6, 1e-10, 2.0, 0.5]] * 2)
    out, begin, first, last = predicted(flight, [4.0, 7.3, 12.0], 5.0, pair, quiet, trim_variance=1e-12)
    for s in range(3):
        run = out[s, : last[s] - first[s]]
        np.testing.assert_allclose(run[:, :2], pose[first[s] : last[s]], rtol=0, atol=tolerance)
        np.testing.assert_allclose(begin[s, :2], pose[first[s] - 1], rtol=0, atol=1e-6)
        velocity = np.gradient(run[:, :2], flight.pose_time[seen][first[s] : last[s]], axis=0)
        np.testing.assert_allclose(run[5:-5, 2:], velocity[5:-5], rtol=0, atol=0.02)


def test_beyond_the_horizon_nothing_is_predicted() -> None:
    flight = flown(STILL, steps(), 10.0)

    out, _, first, last = predicted(flight, [3.0, 8.0], 5.0)
    assert last[1] - first[1] < last[0] - first[0]
    assert np.isfinite(out[1, : last[1] - first[1]]).all()
    assert np.isnan(out[1, last[1] - first[1] :]).all()


def test_later_poses_change_no_start_and_no_prediction() -> None:
    flight = flown(Truth(), steps(), 12.0)
    other = replace(flight, position=flight.position + (flight.pose_time > 6.0)[:, None] * 0.5)
    levels = np.array([[0.01, 3e-7, 2.0, 0.5]] * 2)

    one, two = (predicted(f, [4.0, 6.0], 3.0, levels=levels, trim_variance=1e-3) for f in (flight, other))
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])


def test_the_trim_of_the_flight_is_learned_before_the_start() -> None:
    truth = replace(STILL, trim=(0.1, -0.05, 0.0, 0.0))
    flight = flown(truth, steps(), 20.0)

    knowing, _, first, last = predicted(flight, [10.0], 5.0, levels=TINY * [1e4, 1e4, 1, 1], trim_variance=0.01)
    unaware, *_ = predicted(flight, [10.0], 5.0, levels=TINY * [1e4, 1e4, 1, 1], trim_variance=1e-12)
    end = flight.position[flight.pose_time >= 0.15][last[0] - 1, :2]
    errors = [np.abs(out[0, last[0] - first[0] - 1, :2] - end).max() for out in (knowing, unaware)]
    assert errors[0] < 0.02 < 0.1 < errors[1]


def dense_end(flight: Flight, levels: Array, trim_variance: float, start: float, horizon: float) -> Array:
    """Mean of the position at the horizon given the poses up to the start, from one big Gaussian: z, heading 0."""
    from rotorfit.dynamics.predictor import START_VELOCITY_VARIANCE
    from rotorfit.dynamics.response import axis_response

    seen = (flight.pose_time >= 0.15) & (flight.pose_time <= start + horizon)
    t, z = flight.pose_time[seen], flight.position[seen, 2]
    B = t.size
    columns = axis_response(
        t[:1], np.array([[0, B]]), np.array([[0, flight.command_time.size]]), t, np.arange(B), flight.command_time,
        np.ascontiguousarray(flight.command[:, 2]), np.ones(B), GAMMA_B[4], 0.0, GAMMA_B[5], 0.15, np.zeros(1),
    )[:, :, 0]  # fmt: skip
    q, r, alpha, kappa = levels
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -0.25 * kappa * alpha**2, -alpha]])
    variance = q / (2 * alpha)
    P0 = np.diag([1.0, variance / (0.25 * kappa * alpha**2), variance])
    nodes = [np.eye(3)]
    from scipy.linalg import expm

    P, blocks, moves = P0, [P0], []
    for dt in np.diff(t):
        M = np.zeros((6, 6))
        M[:3, :3], M[3:, 3:], M[2, 5] = -A, A.T, 1.0
        E = expm(M * dt)
        F = E[3:, 3:].T
        P = F @ P @ F.T + q * F @ E[:3, 3:]
        moves.append(F)
        blocks.append(P)
        nodes.append(F @ nodes[-1])
    C = np.zeros((B, B))
    for i in range(B):
        cross = blocks[i]
        for j in range(i, B):
            cross = moves[j - 1] @ cross if j > i else cross
            C[i, j] = C[j, i] = cross[0, 0]
    C += trim_variance * np.outer(columns[:, 1], columns[:, 1])
    C += START_VELOCITY_VARIANCE * np.outer(columns[:, 4], columns[:, 4])
    e = z - z[0] - GAMMA_B[4] * columns[:, 0]
    past = t <= start
    weights = np.linalg.solve(C[np.ix_(past, past)] + r * np.eye(past.sum()), e[past])
    return np.array(z[0] + GAMMA_B[4] * columns[-1, 0] + C[-1, past] @ weights)


def test_the_filter_with_its_trim_gives_the_mean_of_the_dense_gaussian() -> None:
    flight = flown(replace(Truth(), pose_rate=20.0, pose_jitter=0.003, stale_share=0.0), steps(), 5.0)
    levels = np.array([0.02, 4e-7, 3.0, 0.5])

    out, *_ = predicted(flight, [3.0], 1.0, (2, 3), np.stack([levels, levels]), trim_variance=0.003)
    found = out[0][np.isfinite(out[0, :, 0])][-1, 0]
    assert found == pytest.approx(float(dense_end(flight, levels, 0.003, 3.0, 1.0)), abs=2e-5)


# Coasting


def coasted(damping: Array, time: Array, yaw_rate: float = 0.0) -> Array:
    command_time, command = np.array([0.0, 0.5, 1.1]), np.array([[0.2, -0.1], [-0.3, 0.2], [0.1, 0.3]])
    law = np.array([law_of(FIRST_ORDER_DELAY, 3.0 + k, damping[k], (0.2, 0.05)[k], {}) for k in range(2)])
    out: Array = free_run(
        command_time, command, law, np.array([1.0, -2.0]), np.array([0.3, 0.1]), time, yaw_rate * time
    )
    return out


def integrated(damping: Array, time: Array, yaw_rate: float) -> Array:
    """The same by another integrator, from event to event."""
    sent, u = np.array([0.0, 0.5, 1.1]), np.array([[0.2, -0.1], [-0.3, 0.2], [0.1, 0.3]])
    events = np.unique(np.concatenate([time, sent + 0.2, sent + 0.05]))
    events = events[(events >= time[0]) & (events <= time[-1])]
    state, out = np.array([1.0, -2.0, 0.3, 0.1]), [[1.0, -2.0, 0.3, 0.1]]
    for low, high in pairwise(events.tolist()):
        middle = 0.5 * (low + high)
        acting = np.array([u[max(np.searchsorted(sent + d, middle) - 1, 0), k] for k, d in enumerate((0.2, 0.05))])

        def rate(t: float, x: Array, acting: Array = acting) -> Array:
            c, s = np.cos(yaw_rate * t), np.sin(yaw_rate * t)
            R = np.array([[c, -s], [s, c]])
            return np.concatenate([x[2:], R @ (np.array([3.0, 4.0]) * acting - damping * (R.T @ x[2:]))])

        state = solve_ivp(rate, (low, high), state, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        if high in time:
            out.append(state.tolist())
    return np.array(out)


@pytest.mark.parametrize("damping", [(0.2, 2.0), (0.0, 40.0)])
def test_coasting_agrees_with_another_integrator(damping: tuple[float, float]) -> None:
    time = np.array([0.0, 0.1, 0.4, 1.3, 3.0])

    np.testing.assert_allclose(
        coasted(np.array(damping), time), integrated(np.array(damping), time, 0.0), rtol=1e-6, atol=1e-8
    )


def test_coasting_through_a_turn_agrees_with_another_integrator() -> None:
    time = np.linspace(0.0, 3.0, 1201)
    damping = np.array([0.2, 2.0])

    np.testing.assert_allclose(coasted(damping, time, 1.5), integrated(damping, time, 1.5), rtol=0, atol=2e-6)


@pytest.mark.parametrize("step", [0.01, 0.5, 3.0])
def test_coasting_with_negative_damping_does_not_depend_on_the_step(step: float) -> None:
    """Of the paper's method, whose damping may be negative: -0.38 for its own yaw, -2 at worst."""
    damping = np.array([-0.38, -2.0])
    time = np.arange(0.0, 6.0 + 1e-9, step)

    np.testing.assert_allclose(
        coasted(damping, time)[-1], integrated(damping, np.array([0.0, 6.0]), 0.0)[-1], rtol=1e-6
    )
