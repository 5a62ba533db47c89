"""What a plan commands: signals with ramps, the reference with its derivatives, feedback on the measured pose."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import (
    AxisExcitation,
    Chirp,
    Feedback,
    Plan,
    Signal,
    Sines,
    Space,
    Steps,
    Target,
    command_at,
    reference_at,
)
from rotorfit.files.cards import load_card
from rotorfit.planning.plan_control import begin, observed, steered, step, tracker_of

GAMMA = (3.7, 0.18, 3.9, 0.36, 2.5, 2.2, 4.4, 2.7)
ROOM = Space((-3.0, -2.0, 0.3), (3.0, 2.0, 3.0), (0.0, 0.0, 1.5, 0.0), 2.0, 1.0)
HOLD = Feedback(("x", "y", "z", "yaw"), filter_time=0.0)
SINES = Sines((0.3, 0.2), (1.0, 2.3), (0.4, 0.0))


def plan_of(
    *signals: tuple[str, Signal], target: Target = "command", feedback: Feedback | None = None, ramp: float = 2.0
) -> Plan:
    flown = tuple(AxisExcitation(axis, target, 1.0, 20.0, signal) for axis, signal in signals)
    card = load_card("rotorfit-demo").raw
    return Plan("test", "sines", card, 50.0, 22.0, ramp, flown, feedback, ROOM, belief={"gamma": list(GAMMA)})


def test_signals_start_and_end_at_zero_and_are_themselves_between_the_ramps() -> None:
    plan = plan_of(("x", Sines((0.3,), (1.0,), (np.pi / 2,))))
    t = np.array([0.5, 1.0, 3.0, 10.0, 19.0, 21.0, 21.5])
    wanted = [0, 0, 0.3 * np.cos(2.0), 0.3 * np.cos(9.0), 0.3 * np.cos(18.0), 0, 0]
    np.testing.assert_allclose(command_at(plan, t)[:, 0], wanted, atol=1e-12)
    assert not command_at(plan, t)[:, 1:].any()


def test_a_ramp_grows_without_a_jump() -> None:
    command = command_at(plan_of(("z", Steps((0.0,), (0.4,)))), np.arange(0.0, 22.0, 0.001))[:, 2]
    assert np.max(np.abs(np.diff(command))) < 0.4 * 1.9 / 2.0 * 0.001
    assert np.max(command) == 0.4


@pytest.mark.parametrize("signal", [SINES, Chirp(0.4, (0.5, 6.0), 20.0)])
def test_the_derivatives_of_the_reference_are_those_of_its_position(signal: Signal) -> None:
    t = np.arange(0.0, 22.0, 1e-3)
    position, velocity, acceleration = reference_at(plan_of(("y", signal), target="position"), t)
    scale = np.max(np.abs(acceleration))
    np.testing.assert_allclose(np.gradient(position, t, axis=0)[2:-2], velocity[2:-2], atol=1e-5 * scale + 1e-5)
    np.testing.assert_allclose(np.gradient(velocity, t, axis=0)[2:-2], acceleration[2:-2], atol=2e-3 * scale)
    assert not position[:, [0, 2, 3]].any()


def test_feedback_on_a_double_integrator_follows_the_closed_form() -> None:
    plan = replace(plan_of(feedback=HOLD), belief={"gamma": [2.0, 0.0] * 4})
    tracker, dt = tracker_of(plan), 0.0005
    position, velocity = np.array([0.3, -0.2, 0.1, 0.2]), np.zeros(4)
    state, path = replace(begin(position), origin=np.zeros(4)), []
    for n in range(8000):
        path.append(position)
        state, command = step(tracker, state, n * dt, position)
        c, s = np.cos(position[3]), np.sin(position[3])
        force = 2.0 * np.array([c * command[0] - s * command[1], s * command[0] + c * command[1], *command[2:]])
        position, velocity = position + dt * velocity + 0.5 * dt**2 * force, velocity + dt * force
    t = np.arange(8000) * dt
    root = np.sqrt(0.6 - 0.25)
    closed = np.exp(-0.5 * t) * (np.cos(root * t) + 0.5 / root * np.sin(root * t))
    np.testing.assert_allclose(np.array(path), np.multiply.outer(closed, path[0]), atol=3e-4)
    assert state.saturated == 0


def test_feedback_tracks_a_position_reference_of_a_damped_vehicle() -> None:
    plan = plan_of(("x", SINES), ("z", SINES), target="position", feedback=HOLD)
    tracker, dt = tracker_of(plan), 0.002
    state = begin(np.array([1.0, -0.5, 1.5, 0.0]))
    position, velocity, gamma = state.pose, np.zeros(4), np.array(GAMMA)
    for n in range(5000):
        state, command = step(tracker, state, n * dt, position)
        force = gamma[::2] * command - gamma[1::2] * velocity
        position, velocity = position + dt * velocity + 0.5 * dt**2 * force, velocity + dt * force
    reference = reference_at(plan, np.array([5000 * dt]))[0][0]
    assert np.max(np.abs(reference)) > 0.1
    np.testing.assert_allclose(position - [1.0, -0.5, 1.5, 0.0], reference, atol=2e-3)


def test_forward_is_that_of_the_heading_at_the_start() -> None:
    plan = plan_of(("x", SINES), target="position", feedback=HOLD)
    state = begin(np.array([0.0, 0.0, 1.5, np.pi / 2]))
    along_x = steered(tracker_of(plan), begin(np.zeros(4)), 5.0)[1]
    np.testing.assert_allclose(steered(tracker_of(plan), state, 5.0)[1], along_x, atol=1e-12)


def test_full_scale_bounds_the_command_and_is_counted() -> None:
    tracker = tracker_of(plan_of(("x", Steps((0.0,), (1.7,)))))
    state = begin(np.zeros(4))
    for t in (0.0, 10.0, 11.0):
        state, command = steered(tracker, state, t)
    assert command[0] == 1.0
    assert state.saturated == 2


def test_axes_without_feedback_are_left_alone() -> None:
    tracker = tracker_of(plan_of(feedback=replace(HOLD, axes=("z",))))
    state = replace(begin(np.full(4, 0.3)), origin=np.zeros(4))
    command = steered(tracker, state, 0.0)[1]
    assert command[2] < 0
    assert not command[[0, 1, 3]].any()


def test_yaw_is_unwrapped_across_the_half_turn() -> None:
    tracker = tracker_of(plan_of(feedback=HOLD))
    state = begin(np.array([0.0, 0.0, 1.5, 3.1]))
    state = observed(tracker, state, 0.1, np.array([0.0, 0.0, 1.5, -3.1]))
    assert state.pose[3] == pytest.approx(2 * np.pi - 3.1)
    assert state.velocity[3] == pytest.approx((2 * np.pi - 6.2) / 0.1)


def test_a_pose_that_is_not_later_is_left_out() -> None:
    tracker = tracker_of(plan_of(feedback=HOLD))
    state = observed(tracker, begin(np.zeros(4)), 0.1, np.ones(4))
    assert observed(tracker, state, 0.1, np.zeros(4)) is state


def test_feedback_without_a_belief_is_an_error() -> None:
    with pytest.raises(PlanError, match="plan test: feedback needs the gamma"):
        tracker_of(replace(plan_of(feedback=HOLD), belief={}))
