"""What a bound takes off the acceleration, against closed forms."""

import numpy as np
import pytest

from rotorfit.core.laws import FIRST_ORDER_DELAY, STRUCTURES, law_of
from rotorfit.dynamics.bounded_motion import bounded_motion

STEP = 0.001
LAW = law_of(FIRST_ORDER_DELAY, 4.0, 2.0, 0.0, {})


def test_a_step_is_bounded_until_the_velocity_has_come_up_to_it() -> None:
    time = np.arange(0.0, 3.0, STEP)
    command, still = np.ones((time.size, 1)), np.zeros(time.size)

    asked, taken = bounded_motion(STEP, command, still, LAW[None], np.zeros(1), np.array([1.0, np.inf]))

    until = (4.0 - 1.0) / (1.0 * 2.0)  # asked for falls by A b from 4 to A
    expected = np.where(time < until, 4.0 - 2.0 * time, np.exp(-2.0 * (time - until)))
    np.testing.assert_allclose(asked[0], expected, atol=0.005)
    np.testing.assert_allclose(taken[0, :, 0], -np.maximum(expected - 1.0, 0.0), atol=0.005)
    np.testing.assert_allclose(asked[1], 4.0 * np.exp(-2.0 * time), atol=0.005)
    assert not taken[1].any()


def test_a_lag_delays_what_is_asked_for() -> None:
    lagged = law_of(STRUCTURES["first_order_delay_lag"], 4.0, 2.0, 0.0, {"lag": 0.5})
    time = np.arange(0.0, 3.0, STEP)
    command = (time >= 0.1)[:, None].astype(float)

    asked, _ = bounded_motion(STEP, command, np.zeros(time.size), lagged[None], np.zeros(1), np.array([np.inf]))

    since = np.maximum(time - 0.1, 0.0)
    np.testing.assert_allclose(asked[0], 4.0 * since * 2.0 * np.exp(-2.0 * since), atol=0.01)  # equal poles: 1 / T = b


def test_two_axes_share_one_bound_and_turn_with_the_heading() -> None:
    command, yaw = np.ones((3, 2)), np.full(3, np.pi / 2)
    laws, world = np.stack([LAW, LAW]), np.array([-1.0, 2.0])  # in the heading frame 2 forward, 1 left

    asked, taken = bounded_motion(STEP, command, yaw, laws, world, np.array([1.0]))

    wanted = np.array([4.0 - 2.0 * 2.0, 4.0 - 2.0 * 1.0])
    assert asked[0, 0] == pytest.approx(2.0)
    np.testing.assert_allclose(taken[0, 0], -wanted / 2, atol=1e-12)
