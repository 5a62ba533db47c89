"""From the bandwidth to gains: poles where they are wanted, and the optimal law of the whole delayed system."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from rotorfit.control.control_law import SLOW, law_of_bandwidth, linear_system, motion_matrices, optimal_gains
from rotorfit.control.margins import closed_loop, spectral_radius
from rotorfit.planning.axis_information import AxisBelief

PERIOD = 0.02


@pytest.mark.parametrize("damping", [0.18, 2.5])
def test_lqr_is_the_optimum_of_the_system_that_holds_the_commands_under_way(damping: float) -> None:
    vehicle, n, w = AxisBelief(3.7, damping, 8 * PERIOD), 8, 2.0
    step, push = motion_matrices(damping, PERIOD)
    A, B = np.zeros((2 + n, 2 + n)), np.zeros((2 + n, 1))
    A[:2, :2], A[:2, 2 + n - 1] = step[:2, :2], vehicle.gain * push[:2]  # the oldest command acts
    A[3:, 2:-1], B[2] = np.eye(n - 1), 1.0
    Q = np.zeros((2 + n, 2 + n))
    Q[0, 0] = w**4
    P = solve_discrete_are(A, B, Q, vehicle.gain**2 * np.eye(1))
    best = np.linalg.solve(vehicle.gain**2 + B.T @ P @ B, B.T @ P @ A)[0]

    K, D = optimal_gains(vehicle, w, PERIOD)
    ahead, _ = motion_matrices(damping, n * PERIOD)
    wish = np.array([K, D, 0.0]) / vehicle.gain
    ours = [*(wish @ ahead)[:2]]
    for j in range(n):
        left, _ = motion_matrices(damping, j * PERIOD)
        ours.append(vehicle.gain * wish @ left @ push)
    np.testing.assert_allclose(ours, best, rtol=1e-6)


@pytest.mark.parametrize("damping", [0.18, 5.0])
def test_a_predictor_around_its_own_vehicle_has_the_poles_that_were_asked_for(damping: float) -> None:
    vehicle, w, filter_time = AxisBelief(3.7, damping, 0.173), 1.5, 0.05
    law = law_of_bandwidth("predictor", vehicle, w, PERIOD, 0.015, filter_time)

    found = np.linalg.eigvals(closed_loop(law, vehicle))

    for pole in (-1 / filter_time, -SLOW * w):  # the observer's: the delay does not move them
        assert np.abs(found - np.exp(pole * PERIOD)).min() < 1e-5
    dominant = np.sort(np.abs(found[np.abs(found) > 1e-3]))[-2]  # after the disturbance's comes that of the error
    assert -np.log(dominant) / PERIOD == pytest.approx(w, rel=0.15)


@pytest.mark.parametrize("kind", ["predictor", "linearising"])
def test_a_vehicle_that_damps_itself_is_not_pushed_along(kind: str) -> None:
    law = law_of_bandwidth(kind, AxisBelief(9.0, 5.0, 0.1), 1.0, PERIOD, 0.015, 0.03)  # type: ignore[arg-type]

    assert law.rate <= SLOW * 1.0  # of the integral's own pole, no more
    assert law.stiffness > 0.0


def test_integral_and_error_of_feedback_linearisation_have_their_poles() -> None:
    vehicle, w = AxisBelief(3.7, 0.3, 0.0), 0.5
    law = law_of_bandwidth("linearising", vehicle, w, 0.002, 0.0, 0.002)

    poles = np.roots([1.0, vehicle.damping + law.rate, law.stiffness, law.integral])

    np.testing.assert_allclose(np.sort(poles.real), [-w, -w, -SLOW * w], atol=1e-5)
    assert spectral_radius(law, vehicle) < 1


def test_a_law_remembers_as_many_commands_as_asked() -> None:
    law = law_of_bandwidth("lqr", AxisBelief(3.7, 0.3, 0.1), 1.0, PERIOD, 0.0, 0.03)

    short, long = linear_system(law), linear_system(law, 12)

    assert len(short[0]) < len(long[0]) == 15
    np.testing.assert_allclose(short[1], long[1][: len(short[1])])
