"""Vehicles that change in flight: each change has its physical effect, none has any before its time."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rotorfit.core.errors import LinkError
from rotorfit.core.frames import yaw_from_quaternion
from rotorfit.core.limits import GRAVITY
from rotorfit.simulation import rigid_body
from rotorfit.simulation.air import Gusts, Rise, Wind
from rotorfit.simulation.change import GIVEN, Change, changed, changes_of
from rotorfit.simulation.flight_room import Conditions, FlightRoom, RoomFlight, fly_commands
from rotorfit.simulation.sensors import Mocap, Turn
from rotorfit.simulation.vehicle import Radio, Vehicle, load_vehicle

SECOND = 1_000_000_000
TINY = 1e-9  # a command that asks for nothing and is not zero, so that no autopilot brakes
PERFECT = Mocap(noise=0.0, turn_noise=0.0, latency=0.0, jitter=0.0)
CALM = Conditions(mocap=PERFECT, radio=Radio(0.02), floor=-1e4)
GUSTY = replace(CALM, wind=Wind(gusts=Gusts((1.0, 1.0, 0.5))), mocap=Mocap(), radio=Radio(0.03, 0.01, 0.05))


def tireless(name: str, learning: float = 0.2) -> Vehicle:
    vehicle = load_vehicle(name)
    lasting = replace(vehicle.battery, sag=0.0, flight_time=1e6)
    return replace(vehicle, battery=lasting, autopilot=replace(vehicle.autopilot, learning=learning))


BEBOP = tireless("bebop2")


def held(
    vehicle: Vehicle, command: tuple[float, ...], duration: float, conditions: Conditions = CALM, **more: Any
) -> RoomFlight:
    """One command, repeated at 50 Hz from the start on."""
    stamps = np.arange(0, round(duration * SECOND), SECOND // 50)
    conditions = replace(conditions, **more)
    return fly_commands(vehicle, conditions, stamps, np.tile(command, (stamps.size, 1)), duration, 1, (0, 0, 5, 0.3))


def time_of(flight: RoomFlight) -> np.ndarray:
    return flight.true_instant * 1e-9


def hover(*changes: Change, vehicle: Vehicle = BEBOP, duration: float = 15.0) -> RoomFlight:
    return held(vehicle, (TINY, TINY, 0.0, 0.0), duration, changes=changes)


# Nothing before, nothing without


@pytest.mark.parametrize("time", [6.0, 6.0013])
def test_a_flight_is_the_same_to_the_bit_until_it_changes(time: float) -> None:
    stamps = np.arange(0, 10 * SECOND, SECOND // 50)
    commands = np.random.default_rng(2).uniform(-0.4, 0.4, (stamps.size, 4))
    change = Change(time, mass=1.15, rotors=(0.9, 1, 1, 1), fade=0.05, latency=0.05, tilt=0.5, yaw_rate=1.0)
    plain, other = (
        fly_commands(BEBOP, replace(GUSTY, changes=changes), stamps, commands, 10.0, 4) for changes in ((), (change,))
    )

    before = plain.true_instant <= time * 1e9
    np.testing.assert_array_equal(other.pose[before], plain.pose[before])
    assert not np.array_equal(other.true_position[~before], plain.true_position[~before])


def test_a_change_of_nothing_changes_nothing_to_the_bit() -> None:
    plain, other = (held(BEBOP, (0.1, 0.2, 0.3, 0.4), 10.0, GUSTY, changes=them) for them in ((), (Change(5.0),)))

    np.testing.assert_array_equal(other.pose, plain.pose)


def test_steps_and_batch_agree_to_the_bit_about_a_vehicle_that_changes() -> None:
    conditions = replace(GUSTY, changes=(Change(2.0, mass=1.2, latency=0.03), Change(1.0, tilt=0.2, fade=0.1)))
    stamps = np.arange(0, 4 * SECOND, SECOND // 50)
    commands = np.random.default_rng(5).uniform(-1, 1, (stamps.size, 4))
    batch = fly_commands(BEBOP, conditions, stamps, commands, 4.0, 3)
    room, poses = FlightRoom(BEBOP, conditions, 3), []
    for stamp, command in zip(stamps.tolist(), commands.tolist(), strict=True):
        poses += room.advance(stamp)
        room.send(command)
    poses += room.advance(4 * SECOND)

    np.testing.assert_array_equal([one.values for one in poses if one.stream == "pose"], batch.pose)


# Payload


@pytest.mark.parametrize("factor", [1.15, 1 / 1.15])
def test_with_a_payload_the_hover_takes_as_much_more_thrust(factor: float) -> None:
    room = FlightRoom(BEBOP, replace(CALM, changes=(Change(5.0, mass=factor),)), 1, (0, 0, 5, 0))
    thrust = []
    for end in (4, 20):
        room.advance(end * SECOND)
        thrust.append(room._state[rigid_body.THRUST : rigid_body.THRUST + 4].sum())

    assert thrust == pytest.approx([0.5 * GRAVITY, 0.5 * GRAVITY * factor], rel=1e-6)
    assert room.truth().velocity == pytest.approx((0, 0, 0), abs=1e-6)


@pytest.mark.parametrize("learning", [0.2, 1.0])
def test_a_payload_that_is_learnt_leaves_a_dip_as_deep_as_the_learning_is_slow(learning: float) -> None:
    flight = hover(Change(5.0, mass=1.15), vehicle=tireless("bebop2", learning), duration=25.0)

    gain, drag = BEBOP.loops.climb, BEBOP.drag[2] / 1.15
    lost = GRAVITY * (1 - 1 / 1.15) * (learning + BEBOP.rotors.time_constant)
    dip = 5 - flight.true_position[-1, 2]
    assert lost / (gain + drag) < dip < lost / (gain / 1.15 + drag)  # the loop's gain after learning, and before


def test_a_payload_that_nobody_learns_makes_it_sink() -> None:
    flight = hover(Change(5.0, mass=1.15), vehicle=tireless("bebop2", np.inf), duration=25.0)

    gain, drag = BEBOP.loops.climb, BEBOP.drag[2]  # both act on the mass before
    assert flight.true_velocity[-1, 2] == pytest.approx(-0.15 * GRAVITY / (gain + drag), rel=1e-3)


def test_a_payload_leaves_the_tilts_acceleration_and_takes_from_the_drag() -> None:
    flight = held(BEBOP, (0.1, TINY, 0.0, 0.0), 80.0, changes=(Change(0.0, mass=1.15),))

    speed = flight.true_velocity[-1] @ [np.cos(0.3), np.sin(0.3), 0]
    assert speed == pytest.approx(GRAVITY * np.tan(0.0377) / (0.18 / 1.15), rel=2e-3)


# Rotors and battery


def test_a_weak_rotor_that_is_learnt_leaves_a_kick_and_no_bias() -> None:
    flight = hover(Change(5.0, rotors=(0.9, 1.0, 1.0, 1.0)))
    soon = np.flatnonzero(time_of(flight) > 7.0)[0]

    heading = np.unwrap(yaw_from_quaternion(*flight.true_quaternion.T))
    # front left turns clockwise: with less of its drag torque the nose turns clockwise; and the vehicle tips over it
    missing = 0.1 * 0.5 * GRAVITY / 4
    kick = BEBOP.rotors.torque_ratio * missing * 0.2 / (BEBOP.inertia[2] * BEBOP.loops.yaw)
    assert heading[-1] - 0.3 == pytest.approx(-kick, rel=0.1)
    c, s = np.cos(0.3), np.sin(0.3)
    velocity = flight.true_velocity[soon]
    assert velocity[0] * c + velocity[1] * s > 0.02
    assert velocity[1] * c - velocity[0] * s > 0.02
    quaternion = flight.true_quaternion[-1]
    assert np.abs(quaternion[1:3]).max() < 1e-6


def test_a_weak_rotor_that_nobody_learns_leaves_tilt_and_turn() -> None:
    flight = hover(Change(5.0, rotors=(0.9, 1.0, 1.0, 1.0)), vehicle=tireless("bebop2", np.inf), duration=30.0)

    heading = np.unwrap(yaw_from_quaternion(*flight.true_quaternion.T))
    rate = np.gradient(heading, time_of(flight))[-100:-1].mean()
    more = (1 / 0.9 - 1) * 0.5 * GRAVITY / 4  # what the rotor must be asked for beyond the others
    assert rate == pytest.approx(-BEBOP.rotors.torque_ratio * more / (BEBOP.inertia[2] * BEBOP.loops.yaw), rel=0.01)
    assert np.linalg.norm(flight.true_velocity[-1, :2]) > 0.1


def test_a_battery_gives_way_along_its_ramp_and_not_beyond() -> None:
    room = FlightRoom(BEBOP, replace(CALM, changes=(Change(5.0, fade=0.05, fade_time=60.0),)), 1, (0, 0, 5, 0))
    left = []
    for end in (5, 35, 65, 100):
        room.advance(end * SECOND + 1000)
        left.append(room._state[rigid_body.FADE])

    assert left == pytest.approx([1.0, 0.975, 0.95, 0.95], abs=1e-5)
    sinking = GRAVITY * 0.05 * 0.2 / (BEBOP.loops.climb + BEBOP.drag[2])  # rate of the loss times the time of learning
    assert 5 - room.truth().position[2] == pytest.approx(sinking, rel=0.1)
    assert room.truth().velocity[2] == pytest.approx(0.0, abs=1e-6)


# Limits, radio


@pytest.mark.parametrize("name", ["bebop2", "tello"])
def test_another_limit_makes_the_same_command_mean_more(name: str) -> None:
    vehicle = tireless(name)
    old = vehicle.limits()[0]
    change = Change(5.0, tilt=1.5 * old) if name == "bebop2" else Change(5.0, speed=1.5 * old)
    plain, other = (held(vehicle, (0.1, TINY, 0.0, 0.0), 80.0, changes=them) for them in ((), (change,)))

    assert np.linalg.norm(other.true_velocity[-1]) == pytest.approx(
        1.5 * np.linalg.norm(plain.true_velocity[-1]), rel=3e-3
    )
    factor = np.array(changed(vehicle, [change]).linear().gamma) / vehicle.linear().gamma
    assert factor == pytest.approx([1.5, 1, 1.5, 1, 1, 1, 1, 1])


def test_a_slower_radio_delays_what_is_sent_from_then_on() -> None:
    stamps = np.arange(0, 10 * SECOND, SECOND // 50)
    commands = np.tile([TINY, TINY, 0.0, 0.0], (stamps.size, 1))
    commands[stamps >= 6 * SECOND, 0] = 0.3
    plain, other = (
        fly_commands(BEBOP, replace(CALM, changes=them), stamps, commands, 10.0, 1)
        for them in ((), (Change(5.0, latency=0.05),))
    )

    np.testing.assert_allclose(other.true_position[6:], plain.true_position[:-6], atol=2e-5)  # 6 frames at 120 Hz
    assert changed(BEBOP, [Change(5.0, latency=0.05)]).linear().delay == pytest.approx(
        np.array(BEBOP.linear().delay) + 0.05
    )


def test_what_follows_multiplies_and_adds() -> None:
    twice = changed(BEBOP, [Change(1.0, mass=1.2, latency=0.02, tilt=0.2), Change(2.0, mass=0.5, latency=0.01)])

    assert (twice.mass, twice.drag[0]) == pytest.approx((0.3, 0.3))
    assert (twice.radio.latency, twice.command.tilt) == pytest.approx((0.07, 0.2))


# The pose alone


def test_a_turned_frame_turns_positions_and_headings_for_good() -> None:
    flight = held(BEBOP, (0.2, 0.1, 0.0, 0.1), 10.0, mocap=replace(PERFECT, turns=(Turn(5.0, 0.2),)))
    after = time_of(flight) >= 5.0

    turned = flight.true_position[:, 0] + 1j * flight.true_position[:, 1]
    seen = flight.pose[:, 0] + 1j * flight.pose[:, 1]
    np.testing.assert_allclose(seen[after], turned[after] * np.exp(0.2j), atol=1e-12)
    np.testing.assert_array_equal(seen[~after], turned[~after])
    angle = yaw_from_quaternion(*flight.pose[:, 3:].T) - yaw_from_quaternion(*flight.true_quaternion.T)
    assert np.angle(np.exp(1j * angle))[after] == pytest.approx(0.2)


def test_a_frozen_pose_repeats_the_last_one_under_fresh_stamps() -> None:
    flight = held(BEBOP, (0.2, 0.1, 0.0, 0.1), 10.0, GUSTY, mocap=Mocap(frozen=((4.0, 7.0),)))
    time = time_of(flight)
    inside = (time >= 4.0) & (time < 7.0)

    last = flight.pose[np.flatnonzero(inside)[0] - 1]
    np.testing.assert_array_equal(flight.pose[inside], np.tile(last, (inside.sum(), 1)))
    assert (np.diff(flight.pose_stamp) > 0).all()
    assert not np.array_equal(flight.pose[time >= 7.0][0], last)


# Wind


def test_wind_rises_along_a_line_and_stays() -> None:
    rise = Rise(20.0, 60.0, mean=(3.0, 0.0, 0.0), gusts=4.0)
    wind = Wind(mean=(0.5, 0.0, 0.0), gusts=Gusts((1.0, 1.0, 1.0)), rises=(rise,))
    base, risen = (
        held(BEBOP, (TINY, TINY, 0.0, 0.0), 100.0, wind=air).true_wind for air in (replace(wind, rises=()), wind)
    )
    share = np.clip((np.arange(len(base)) / 120 - 20) / 40, 0, 1)[:, None]

    gusts = base - [0.5, 0, 0]
    expected = [0.5, 0, 0] + share * np.array([3.0, 0, 0]) + gusts * (1 + 3 * share)
    np.testing.assert_allclose(risen, expected, atol=2e-3)  # lines between nodes of a product of lines


def test_the_true_wind_is_what_carries_the_vehicle() -> None:
    free = replace(BEBOP, drag=(0.3, 0.3, 0.3))  # alike along all axes, so that the tilt of the body does not matter
    flight = held(free, (TINY, TINY, 0.0, 0.0), 30.0, wind=Wind(mean=(1.0, 0, 0), gusts=Gusts((1.0, 1.0, 0.0))))
    time = time_of(flight)

    push = 0.3 * (flight.true_wind - flight.true_velocity)
    travelled = np.concatenate([[0.0], np.cumsum((push[1:, 0] + push[:-1, 0]) / 2 * np.diff(time))])
    assert flight.true_velocity[:, 0] == pytest.approx(travelled, abs=5e-3)


# What is refused


def test_what_no_vehicle_can_become_is_refused() -> None:
    for wrong in (
        {"time": -1.0}, {"mass": 0.0}, {"rotors": (1, 1, 1, 0)}, {"fade": 1.0}, {"fade_time": 0.0}, {"tilt": 0.0}
    ):  # fmt: skip
        with pytest.raises(ValueError, match="change"):
            Change(**({"time": 1.0} | wrong))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="rise"):
        Rise(2.0, 1.0)


def test_an_address_says_what_changes_and_when() -> None:
    found = changes_of(["mass=1.3@40", "rotors=0.9/1/1/1@5", "tilt=0.2@0"], "")

    assert found == (Change(40.0, mass=1.3), Change(5.0, rotors=(0.9, 1.0, 1.0, 1.0)), Change(0.0, tilt=0.2))


@pytest.mark.parametrize(
    ("option", "said"),
    [
        *(
            (f"mass={text}", "mass is a factor from 0.1 to 10, then @ and the second, as in mass=1.3@40")
            for text in ("1.3", "1.3@", "@4", "0@4", "-1@4", "nan@4", "1/2@4", "2@-1", "2@inf")
        ),
        ("rotors=0.9@4", "rotors is four factors from 0.01 to 2, then @ and the second, as in rotors=0.9/1/1/1@40"),
        ("rotors=0.9/1/1/-1@4", "rotors is four factors from 0.01 to 2"),
        ("tilt=9@4", "tilt is a limit in rad from 0.01 to 1.5"),
        ("latency=-0.1@4", "latency is a time in s from 0 to 5"),
        ("vertical_sped=1@4", "nothing called 'vertical_sped' can change; nearest: 'vertical_speed'; mass, rotors"),
        ("zzz=2@4", "nothing called 'zzz' can change; mass, rotors"),
    ],
)
def test_a_change_that_cannot_be_is_one_line_with_range_and_example(option: str, said: str) -> None:
    with pytest.raises(LinkError) as refused:
        changes_of([option], "bebop2")

    assert said in str(refused.value)
    assert repr(option) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", GIVEN)
def test_the_example_of_every_change_is_one(name: str) -> None:
    (found,) = changes_of([GIVEN[name].example], "")

    assert found.time == 40.0
    assert getattr(found, name) != getattr(Change(40.0), name)
