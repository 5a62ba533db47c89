"""What limits add to the acceleration, against closed forms."""

import numpy as np
import pytest

from rotorfit.core.laws import FIRST_ORDER_DELAY, STRUCTURES, law_of
from rotorfit.dynamics.limited_motion import limited_motion

STEP = 0.001
LAW = law_of(FIRST_ORDER_DELAY, 4.0, 2.0, 0.0, {})
TIME = np.arange(0.0, 3.0, STEP)
STILL = np.zeros(TIME.size)


def test_a_step_is_bounded_until_the_velocity_has_come_up_to_it() -> None:
    asked, added, moved = limited_motion(STEP, np.ones((TIME.size, 1)), STILL, LAW[None], np.zeros(1), acceleration=1.0)

    until = (4.0 - 1.0) / (1.0 * 2.0)  # asked for falls by A b from 4 to A
    expected = np.where(until > TIME, 4.0 - 2.0 * TIME, np.exp(-2.0 * (TIME - until)))
    np.testing.assert_allclose(asked, expected, atol=0.005)
    np.testing.assert_allclose(added[:, 0], -np.maximum(expected - 1.0, 0.0), atol=0.005)
    np.testing.assert_allclose(moved[:, 0], (4.0 - expected) / 2.0, atol=0.005)


def test_without_limits_nothing_is_added() -> None:
    asked, added, _ = limited_motion(STEP, np.ones((TIME.size, 1)), STILL, LAW[None], np.zeros(1))

    np.testing.assert_allclose(asked, 4.0 * np.exp(-2.0 * TIME), atol=0.005)
    np.testing.assert_allclose(added, 0.0, atol=1e-12)


def test_an_acceleration_follows_a_step_at_the_largest_jerk() -> None:
    command = (TIME >= 0.1)[:, None].astype(float)

    asked, added, _ = limited_motion(STEP, command, STILL, LAW[None], np.zeros(1), jerk=2.0)

    given, rising = asked + added[:, 0], (TIME > 0.11) & (TIME < 0.8)
    np.testing.assert_allclose(given[rising], 2.0 * (TIME[rising] - 0.1), atol=0.005)
    assert np.abs(np.diff(given)).max() <= 2.0 * STEP * (1 + 1e-9)


def test_a_lag_delays_what_is_asked_for() -> None:
    lagged = law_of(STRUCTURES["first_order_delay_lag"], 4.0, 2.0, 0.0, {"lag": 0.5})
    command = (TIME >= 0.1)[:, None].astype(float)

    asked, _, _ = limited_motion(STEP, command, STILL, lagged[None], np.zeros(1))

    since = np.maximum(TIME - 0.1, 0.0)
    np.testing.assert_allclose(asked, 4.0 * since * 2.0 * np.exp(-2.0 * since), atol=0.01)  # equal poles: 1 / T = b


def test_two_axes_share_one_bound_and_turn_with_the_heading() -> None:
    command, yaw = np.ones((3, 2)), np.full(3, np.pi / 2)
    laws, world = np.stack([LAW, LAW]), np.array([-1.0, 2.0])  # in the heading frame 2 forward, 1 left

    asked, added, moved = limited_motion(STEP, command, yaw, laws, world, acceleration=1.0)

    wanted = np.array([4.0 - 2.0 * 2.0, 4.0 - 2.0 * 1.0])
    assert asked[0] == pytest.approx(2.0)
    np.testing.assert_allclose(added[0], -wanted / 2, atol=1e-12)
    np.testing.assert_allclose(moved[0], [2.0, 1.0], atol=1e-12)


def test_a_limited_acceleration_keeps_its_direction_in_the_world_while_the_vehicle_turns() -> None:
    laws, yaw = np.stack([LAW, LAW]), np.array([0.0, np.pi / 2])
    command = np.array([[1.0, 0.0], [0.0, 0.0]])

    _, added, _ = limited_motion(STEP, command, yaw, laws, np.zeros(2), jerk=1e-9)

    np.testing.assert_allclose(added[0], 0.0, atol=1e-12)  # it begins as asked for: forward along the world's x
    np.testing.assert_allclose(added[1], [0.0, -4.0], atol=0.01)  # now to the right, where nothing is asked for
