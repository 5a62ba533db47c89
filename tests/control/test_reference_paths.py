"""Reference paths: derivatives that fit, speeds that were asked for, steps that nobody knows of before."""

import numpy as np
import pytest

from rotorfit.control.controller import HOLD, SHAPES, WAIT, ReferencePath, Shape, within
from rotorfit.core.errors import PlanError
from rotorfit.planning.request import space_of_room


@pytest.mark.parametrize("shape", ["circle", "lemniscate"])
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(shape: Shape) -> None:
    step = 1e-3
    time = np.arange(0.0, 30.0, step)
    position, velocity, acceleration = ReferencePath(shape, 1.2, 0.9).at(time)

    np.testing.assert_allclose(np.gradient(position, step, axis=0)[1:-1], velocity[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(velocity, step, axis=0)[1:-1], acceleration[1:-1], atol=1e-5)


@pytest.mark.parametrize("shape", ["circle", "lemniscate"])
def test_the_speed_is_reached_and_not_exceeded(shape: Shape) -> None:
    speed = np.linalg.norm(ReferencePath(shape, 1.2, 0.9).at(np.arange(0.0, 40.0, 0.001))[1][:, :3], axis=1)

    assert speed.max() == pytest.approx(0.9, rel=1e-4)
    assert not speed[: int(WAIT / 0.001)].any()


@pytest.mark.parametrize("shape", SHAPES)
def test_a_path_begins_where_it_says(shape: Shape) -> None:
    path = ReferencePath(shape, 1.0, 0.5, centre=(2.0, -1.0, 1.0, 0.3))

    np.testing.assert_allclose(path.at(np.zeros(1))[0][0], path.start)
    assert path.start[2:] == (1.0, 0.3)


def test_a_step_is_not_known_before_it_is_there_and_a_circle_is() -> None:
    now, later = np.array([WAIT + HOLD - 0.1]), np.array([WAIT + HOLD + 0.1])
    steps, circle = ReferencePath("steps", 1.0, 1.0), ReferencePath("circle", 1.0, 1.0)

    np.testing.assert_allclose(steps.known(later, now)[0], steps.at(now)[0])
    assert steps.known(later, later)[0][0, 1] == 1.0
    np.testing.assert_allclose(circle.known(later, now)[0], circle.at(later)[0])


def test_a_path_that_does_not_fit_is_refused() -> None:
    space = space_of_room("4x4x3")

    within(ReferencePath("circle", 1.0, 1.0), space)
    with pytest.raises(PlanError, match=r"leaves the space by 0.30 m"):
        within(ReferencePath("circle", 2.0, 1.0), space)
    with pytest.raises(PlanError, match=r"at up to 1.80 m/s"):
        within(ReferencePath("circle", 1.0, 1.8), space)
