"""The disturbance of x and y has its levels along the axes of the heading frame, wherever the heading points."""

import numpy as np
import pytest

from rotorfit.core.frames import Array, world_from_heading
from rotorfit.core.laws import FIRST_ORDER_DELAY, TRIM, law_of
from rotorfit.dynamics.motion_filter import GUSTS, LATER, LATER_ERROR, VELOCITY, WIND, WIND_ERROR, motion_filter

TIME = np.arange(200) / 30.0
COMMAND_TIME, COMMAND = np.array([0.0, 2.0, 4.0]), np.array([[0.1, 0, 0, 0], [-0.1, 0.2, 0, 0], [0, 0, 0, 0.0]])
LEVELS = np.array([[0.4, 1e-6, 1.5, 0.8], [4.0, 2e-6, 2.5, 0.6]])
DAMPINGS = (0.2, 0.6)
START = np.array([0.3, -0.2])


def path() -> Array:
    """A smooth random path in the world, shape (N, 3) [m]."""
    rng = np.random.default_rng(3)
    return np.column_stack([np.cumsum(np.cumsum(rng.normal(0.0, 2e-3, (TIME.size, 2)), axis=0), axis=0), 0 * TIME])


def told(position: Array, yaw: Array, start: Array, levels: Array = LEVELS, dampings: Array = DAMPINGS) -> Array:
    """The motion at the end of a path; the commands act along the heading."""
    law = np.array([law_of(FIRST_ORDER_DELAY, 3.0, b, 0.1, {}) for b in dampings])
    law[:, TRIM] = 0.3, -0.1
    known = np.ones(2, bool)
    running = motion_filter(0.0, position[0, :2], start, float(yaw[0]), COMMAND_TIME, COMMAND, law, levels, known, True)
    running.follow(TIME, position, yaw, COMMAND_TIME, COMMAND)
    return running.motion(COMMAND_TIME, COMMAND)


def test_a_turned_world_changes_nothing_along_the_heading() -> None:
    yaw, turn = 0.4 * np.sin(TIME), 1.9
    position = path()
    turned = position.copy()
    turned[:, :2] = world_from_heading(position[:, :2], np.full(TIME.size, turn))

    plain = told(position, yaw, START)
    other = told(turned, yaw + turn, world_from_heading(START[None], np.array([turn]))[0])
    for column in (WIND, WIND_ERROR, GUSTS):
        assert other[:, column] == pytest.approx(plain[:, column], rel=1e-9)
    for column in (VELOCITY, LATER):
        there = world_from_heading(plain[None, :, column], np.array([turn]))[0]
        assert other[:, column] == pytest.approx(there, rel=1e-9)
    assert plain[1, WIND_ERROR] > 1.5 * plain[0, WIND_ERROR]  # a filter along the world's axes would exchange them


def test_where_both_axes_are_alike_the_heading_does_not_matter() -> None:
    """It turns by 4 rad; under equal levels and dampings, the disturbance in the world is the same as without."""
    levels, dampings = np.tile(LEVELS[1], (2, 1)), (0.6, 0.6)
    still, position = np.zeros(TIME.size), path()
    yaw = 0.6 * TIME
    law = np.array([law_of(FIRST_ORDER_DELAY, 3.0, b, 0.1, {}) for b in dampings])
    states = []
    for heading in (still, yaw):
        running = motion_filter(
            0.0, position[0, :2], START, 0.0, COMMAND_TIME, 0 * COMMAND, law, levels, np.ones(2, bool), True
        )
        states.append(running.follow(TIME, position, heading, COMMAND_TIME, 0 * COMMAND))
        errors = running.motion(COMMAND_TIME, 0 * COMMAND)[:, [WIND_ERROR, LATER_ERROR]]

    assert states[1] == pytest.approx(states[0], rel=1e-9, abs=1e-12)
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)
