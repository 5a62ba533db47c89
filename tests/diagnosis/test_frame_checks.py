"""Directions: where commands lead, whatever the world is turned by, with errors that hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flights import flown, steps, turned
from rotorfit.core.card import Channel
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import heading_from_world
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis.frame_checks import directions, frame_findings
from rotorfit.diagnosis.recording import recording_of
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.simulation.paper_vehicle import Controller, Truth

TRUTH = replace(Truth(), stale_share=0.0)
BOTH = ["x", "y"]

UPRIGHT = Log(
    Path("upright"),
    "simulated",
    "",
    {"/pose": Table("/pose", {f"pose.orientation.{part}": np.array([part == "w"]) for part in "wxyz"})},
    {},
)
"""Where the flights' card looks for the quaternion, whose lean alone is read from the log here."""


def flight(seed: int = 4, controller: Controller | None = None, axes: tuple[str, ...] = ("x", "y", "yaw")) -> Flight:
    return flown(TRUTH, steps(axes, 0.2, seed=seed), 40.0, seed, controller=controller)


def off(flight: Flight, degrees: float) -> Flight:
    """Yaw as a rigid body tells it that was defined that much off."""
    return replace(flight, yaw=flight.yaw + np.radians(degrees))


def codes(flight: Flight) -> list[str]:
    return [finding.code for finding in frame_findings(recording_of(UPRIGHT, flight))]


def test_a_world_that_is_turned_turns_no_direction() -> None:
    first, second = (directions(f, motion_from_flight(f), BOTH, 1) for f in (flight(), turned(flight(), 2.0)))

    assert first.angle == pytest.approx(second.angle, abs=1e-6)
    assert first.explained == pytest.approx(second.explained, abs=1e-6)


@pytest.mark.parametrize("controller", [None, Controller(1.0, 1.6)], ids=["open", "closed"])
def test_the_angle_is_found_within_its_standard_errors(controller: Controller | None) -> None:
    deviations = []
    for seed in range(8):
        spoiled = off(flight(seed, controller), 30.0)
        found = directions(spoiled, motion_from_flight(spoiled), BOTH, 1)
        deviations += [(found.angle[axis] + np.radians(30.0)) / found.stderr[axis] for axis in BOTH]

    assert np.abs(deviations).max() < 5.0
    assert np.sqrt(np.mean(np.square(deviations))) < 2.5


def test_with_one_axis_commanded_its_own_direction_is_told() -> None:
    told = flight(axes=("x",))

    assert codes(told) == []
    assert codes(off(told, 25.0)) == ["yaw_offset"]
    assert codes(off(told, 180.0)) == []  # a flipped sign looks the same: the fit tells


def test_a_quaternion_gets_the_offset_that_a_card_can_give_it() -> None:
    spoiled = off(flight(), 40.0)
    pose = {axis: spoiled.card.pose[axis] for axis in "xyz"} | {
        f"q{part}": Channel(f"pose.orientation.{part}") for part in "wxyz"
    }
    (told,) = frame_findings(recording_of(UPRIGHT, replace(spoiled, card=replace(spoiled.card, pose=pose))))

    assert told.code == "yaw_offset"
    degrees = float(told.remedy.partition("value = ")[2].partition(",")[0])
    assert degrees == pytest.approx(-40.0, abs=5.0)


def test_the_circle_that_sine_and_cosine_fly_is_not_taken_for_a_turned_yaw() -> None:
    for seed in range(4):
        circling = flown(TRUTH, duration=60.0, seed=seed)
        assert "yaw_offset" not in codes(circling)


def test_commands_that_nobody_followed_have_no_direction() -> None:
    other = steps(("x", "y"), 0.2, seed=77)
    strange = replace(flight(), command=other(flight().command_time))

    assert codes(strange) == []


def test_a_heading_that_is_counted_the_other_way_round_is_told_with_little_turning() -> None:
    """By twice the heading off: it is no matter of degrees, nor of the world's frame."""
    little = flown(TRUTH, steps(("x", "y", "yaw"), (0.2, 0.2, 0.2, 0.1), seed=4), 60.0, 4)
    assert np.radians(3) < np.std(little.yaw) < np.radians(20)
    told = list(frame_findings(recording_of(UPRIGHT, replace(little, yaw=-little.yaw))))

    assert codes(little) == []
    assert [one.code for one in told] == ["mirrored_pose"]
    assert "scale = -1" in told[0].remedy


def test_a_wrong_frame_is_told_in_strong_wind_too_where_turned_directions_explain_a_part() -> None:
    truth = replace(TRUTH, wind_sigma=(0.35, 0.35, 0.02, 0.008))
    windy = flown(truth, steps(("x", "y", "yaw"), (0.2, 0.2, 0.2, 0.12), seed=4), 60.0, 4)
    world = windy.command.copy()
    world[:, :2] = heading_from_world(world[:, :2], -np.interp(windy.command_time, windy.pose_time, windy.yaw))

    assert codes(windy) == []
    assert codes(replace(windy, command=world)) == ["command_frame"]


def test_a_vehicle_that_never_turned_cannot_tell_frames_and_one_that_did_can() -> None:
    still, turning = flight(axes=("x", "y")), flight()
    for one, expected in ((still, []), (turning, ["command_frame"])):
        yaw = np.interp(one.command_time, one.pose_time, one.yaw)
        world = one.command.copy()
        world[:, :2] = heading_from_world(world[:, :2], -yaw)
        assert codes(replace(one, command=world)) == expected
