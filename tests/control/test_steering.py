"""A controller at work: what it foresees, what it learns, what it does at full scale."""

from dataclasses import replace

import numpy as np
import pytest

from models import model_of
from rotorfit.control.control_law import AxisLaw, law_of_bandwidth
from rotorfit.control.controller import (
    AxisControllers,
    ReferencePath,
    at_rest,
    commanded,
    observe,
    predict_motion,
)
from rotorfit.core.frames import AXES
from rotorfit.dynamics.trajectory import simulate
from rotorfit.planning.axis_information import AxisBelief

VEHICLE = {"x": (3.7, 0.18, 0.17), "y": (3.5, 0.4, 0.15), "z": (2.5, 2.2, 0.08), "yaw": (4.4, 2.7, 0.21)}
PERIOD = 0.02
HOVER = ReferencePath("steps", 1.0, 1.0, centre=(0.0, 0.0, 0.0, 0.0))


def controller_for(kind: str = "predictor", bandwidth: float = 1.5) -> AxisControllers:
    laws: dict[str, AxisLaw] = {
        axis: law_of_bandwidth(kind, AxisBelief(*VEHICLE[axis]), bandwidth, PERIOD, 0.015, 0.03)  # type: ignore[arg-type]
        for axis in AXES
    }
    return AxisControllers(laws, np.ones(4))


def test_the_state_moves_as_the_model_simulates_even_while_turning() -> None:
    rng = np.random.default_rng(1)
    sent, command = np.arange(64) * PERIOD, rng.uniform(-1, 1, (64, 4))
    begin, end = 0.5, 0.5 + 32 * PERIOD
    pose, velocity = np.array([0.3, -0.2, 1.0, 0.7]), np.array([0.4, 0.1, -0.2, 0.5])
    controller = controller_for()
    known = replace(at_rest(pose, begin), sent=sent, command=command)
    known.state[1] = velocity

    path = simulate(model_of(VEHICLE), sent, command, np.array([begin, end]), pose, velocity)
    still = simulate(model_of({"yaw": VEHICLE["yaw"]}), sent, command, np.array([begin, end]), pose, velocity)
    found = predict_motion(controller, known, end, float(path.pose[-1, 3]))

    np.testing.assert_allclose(found[0, 2:], path.pose[-1, 2:], atol=1e-10)
    np.testing.assert_allclose(found[1, 2:], path.velocity[-1, 2:], atol=1e-10)
    np.testing.assert_allclose(found[0, :2], path.pose[-1, :2], atol=0.01)
    assert np.abs(still.pose[-1, :2] - path.pose[-1, :2]).max() > 0.05


def test_the_observer_finds_a_steady_push_and_the_command_answers_it() -> None:
    controller, steering = controller_for(), at_rest(np.zeros(4))
    gain, damping, delay = VEHICLE["x"]
    p = v = 0.0
    fine, held = 0.001, [0.0] * round(delay / 0.001)
    for k in range(1, 1500):
        for i in range(20):
            v += fine * (gain * held[(k - 1) * 20 + i] + 0.5 - damping * v)
            p += fine * v
        steering = observe(controller, steering, k * PERIOD, np.array([p, 0.0, 0.0, 0.0]), HOVER)
        steering, command = commanded(controller, steering, k * PERIOD, ReferencePath("circle", 1.0, 1e-9))
        held += [float(command[0])] * 20

    assert steering.state[2, 0] == pytest.approx(0.5, abs=0.01)
    assert gain * steering.command[-1, 0] == pytest.approx(-0.5, abs=0.01)


def test_commands_stay_within_full_scale_and_are_counted() -> None:
    controller, steering = controller_for("linearising", 3.0), at_rest(np.zeros(4))
    steering = observe(controller, steering, PERIOD, np.array([5.0, 0.0, 0.0, 0.0]), HOVER)
    steering, command = commanded(controller, steering, PERIOD, HOVER)

    assert command[0] == -1.0
    assert steering.saturated == 1
    assert steering.bounded.tolist() == [True, False, False, False]


@pytest.mark.parametrize("heading", [0.0, np.pi / 4, np.pi / 2, -2.0])
def test_the_integral_waits_along_the_axis_of_which_nothing_more_can_be_asked(heading: float) -> None:
    controller = controller_for("linearising", 3.0)
    ahead, aside = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    there = np.array([*(5.0 * ahead + 0.02 * aside), 0.0, heading])
    hover = ReferencePath("steps", 1.0, 1.0, centre=(0.0, 0.0, 0.0, heading))
    steering = observe(controller, at_rest(np.array([0.0, 0.0, 0.0, heading])), PERIOD, there, hover)
    steering, command = commanded(controller, steering, PERIOD, hover)
    before = steering.error[2, :2]
    assert command[0] == -1.0
    assert abs(command[1]) < 1.0
    gained = observe(controller, steering, 2 * PERIOD, there, hover).error[2, :2] - before

    assert ahead @ gained == pytest.approx(0.0, abs=1e-12)
    assert aside @ gained == pytest.approx(-0.02 * PERIOD)


def test_the_filter_of_an_axis_turns_with_the_vehicle() -> None:
    laws = dict(controller_for("linearising", 1.5).laws)
    laws["x"], laws["y"] = (replace(laws[axis], filter_time=time) for axis, time in (("x", 0.25), ("y", 0.03)))
    controller, off = AxisControllers(laws, np.ones(4)), 0.05

    def rate_ahead(heading: float) -> float:
        ahead = np.array([np.cos(heading), np.sin(heading)])
        hover = ReferencePath("steps", 1.0, 1.0, centre=(0.0, 0.0, 0.0, heading))
        there = np.array([*(off * ahead), 0.0, heading])
        steering = observe(controller, at_rest(np.array([0.0, 0.0, 0.0, heading])), PERIOD, there, hover)
        return float(ahead @ steering.error[1, :2])

    assert rate_ahead(0.0) == pytest.approx(-off / (0.25 + PERIOD))
    assert rate_ahead(np.pi / 2) == pytest.approx(rate_ahead(0.0))


def test_an_old_pose_is_left_out_and_the_heading_is_unwrapped() -> None:
    controller, steering = controller_for(), at_rest(np.array([0.0, 0.0, 1.0, 3.1]))
    later = observe(controller, steering, PERIOD, np.array([0.0, 0.0, 1.0, -3.1]), HOVER)

    assert later.pose[3] == pytest.approx(2 * np.pi - 3.1)
    assert observe(controller, later, 0.5 * PERIOD, np.zeros(4), HOVER) is later


def test_forward_is_where_the_vehicle_looks() -> None:
    controller = controller_for("linearising", 0.5)
    there = ReferencePath("steps", 1.0, 1.0, centre=(0.0, 1.0, 0.0, np.pi / 2))
    steering = observe(
        controller, at_rest(np.array([0.0, 0.0, 0.0, np.pi / 2])), PERIOD, np.array([0, 0, 0, np.pi / 2]), there
    )

    _, command = commanded(controller, steering, PERIOD, there)

    assert command[0] > 0.1
    assert command[1] == pytest.approx(0.0, abs=1e-12)


def test_an_axis_without_a_law_is_told_nothing() -> None:
    whole = controller_for()
    controller = AxisControllers({"x": whole.laws["x"]}, np.ones(4))
    steering = observe(controller, at_rest(np.zeros(4)), PERIOD, np.array([0.1, 0.1, 0.1, 0.1]), HOVER)

    _, command = commanded(controller, steering, PERIOD, HOVER)

    assert command[0] < 0
    assert command[1:].tolist() == [0.0, 0.0, 0.0]
