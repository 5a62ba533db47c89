"""The rigid body and its autopilot against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.frames import yaw_from_quaternion
from rotorfit.simulation import rigid_body
from rotorfit.simulation.air import Wind
from rotorfit.simulation.flight_room import Conditions, FlightRoom, RoomFlight, fly_commands
from rotorfit.simulation.sensors import Mocap
from rotorfit.simulation.vehicle import Radio, Vehicle, builtin_vehicles, load_vehicle

VEHICLES = builtin_vehicles()
TIRELESS = {name: replace(one, battery=replace(one.battery, sag=0.0)) for name, one in VEHICLES.items()}
CALM = Conditions(mocap=Mocap(noise=0.0, turn_noise=0.0, latency=0.0, jitter=0.0))
SECOND = 1_000_000_000
TINY = 1e-9  # a command that asks for nothing and is not zero, so that no autopilot brakes


def held(vehicle: Vehicle, command: tuple[float, ...], duration: float, conditions: Conditions = CALM) -> RoomFlight:
    """One command, repeated at 10 Hz from the start on, without jitter or loss."""
    stamps = np.arange(0, round(duration * SECOND), SECOND // 10)
    conditions = replace(conditions, radio=Radio(0.02))
    return fly_commands(vehicle, conditions, stamps, np.tile(command, (stamps.size, 1)), duration, 1, (0, 0, 50, 0))


def heading(flight: RoomFlight) -> np.ndarray:
    return np.unwrap(yaw_from_quaternion(*flight.true_quaternion.T))


@pytest.mark.parametrize("name", VEHICLES)
def test_a_hover_in_calm_air_stays_where_it_is(name: str) -> None:
    tireless, real = (held(vehicles[name], (0.0, 0.0, 0.0, 0.0), 60.0) for vehicles in (TIRELESS, VEHICLES))

    assert np.abs(tireless.true_position - [0, 0, 50]).max() < 1e-9
    assert np.abs(heading(tireless)).max() < 1e-12
    assert np.abs(real.true_position - [0, 0, 50]).max() < 0.03  # what the autopilot learns of its battery comes late


def test_a_constant_tilt_reaches_the_speed_at_which_drag_holds_it() -> None:
    vehicle = VEHICLES["bebop2"]
    flight = held(vehicle, (0.1, TINY, 0.0, 0.0), 60.0)

    tilt = 0.1 * (vehicle.command.tilt or 0.0)
    assert flight.true_velocity[-1, 0] == pytest.approx(9.81 * np.tan(tilt) / vehicle.drag[0], rel=2e-3)
    qw, qx, qy, qz = flight.true_quaternion[-1]
    assert 2 * (qw * qy - qx * qz) == pytest.approx(np.sin(tilt), rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2, 3])
@pytest.mark.parametrize("name", VEHICLES)
def test_a_small_step_settles_at_the_linear_gain_after_the_linear_lag(name: str, axis: int) -> None:
    vehicle = TIRELESS[name]
    linear = vehicle.linear(Radio(0.02))
    gain, time = linear.gamma[2 * axis] / linear.gamma[2 * axis + 1], 1 / linear.gamma[2 * axis + 1]
    command = [TINY, TINY, 0.0, 0.0]
    command[axis] = 0.02
    flight = held(vehicle, tuple(command), 15 * time + 5)

    instant = flight.true_instant * 1e-9
    rate = np.gradient(heading(flight), instant) if axis == 3 else flight.true_velocity[:, axis]
    assert rate[-2] == pytest.approx(0.02 * gain, rel=3e-3)
    # The area between the step and the response, over the step, is the mean lag of the impulse response
    lag = np.trapezoid(1 - rate / rate[-2], instant)
    assert lag == pytest.approx(linear.delay[axis] + time, rel=5e-3, abs=2e-3)


def test_without_thrust_it_falls_freely_once_the_rotors_have_stopped() -> None:
    vehicle = load_vehicle("bebop2")
    still = replace(vehicle, drag=(0.0, 0.0, 0.0), rotors=replace(vehicle.rotors, thrust=(0.0, 1e-12)))
    flight = held(still, (0.0, 0.0, 0.0, 0.0), 2.0)

    t, lag = flight.true_instant * 1e-9, vehicle.rotors.time_constant
    fallen = 9.81 * (t**2 / 2 - lag * t + lag**2 * (1 - np.exp(-t / lag)))
    assert flight.true_position[:, 2] == pytest.approx(50 - fallen, abs=1e-4)


def test_a_tilted_vehicle_drifts_with_the_wind_and_a_braking_one_holds_against_it() -> None:
    vehicle, windy = TIRELESS["bebop2"], replace(CALM, wind=Wind(mean=(0.0, 2.0, 0.0)))

    free = held(vehicle, (TINY, TINY, 0.0, 0.0), 40.0, windy)
    assert free.true_velocity[-1] == pytest.approx([0.0, 2.0, 0.0], abs=1e-3)
    braking = held(vehicle, (0.0, 0.0, 0.0, 0.0), 40.0, windy)
    drag, gain = vehicle.drag[1], vehicle.loops.velocity
    assert braking.true_velocity[-1, 1] == pytest.approx(2.0 * drag / (gain + drag), rel=0.02)


def test_thrust_follows_the_nose_commands_are_in_the_heading_frame() -> None:
    vehicle, start = VEHICLES["m100"], (0.0, 0.0, 50.0, 0.7)
    stamps = np.arange(0, 8 * SECOND, SECOND // 10)
    flight = fly_commands(vehicle, CALM, stamps, np.tile([0.5, 0.2, 0.0, 0.0], (stamps.size, 1)), 8.0, 1, start)

    forward = np.array([np.cos(0.7), np.sin(0.7)])
    left = np.array([-np.sin(0.7), np.cos(0.7)])
    speed = flight.true_velocity[-1, :2]
    gain = vehicle.loops.velocity / (vehicle.loops.velocity + vehicle.drag[0])
    assert (speed @ forward, speed @ left) == pytest.approx((0.5 * gain, 0.2 * gain), rel=0.01)


def test_yaw_turns_counter_clockwise_at_the_commanded_rate_also_when_tilted() -> None:
    vehicle = VEHICLES["m100"]
    flight = held(vehicle, (1.0, 0.0, 0.0, 0.5), 20.0)

    rate = np.gradient(heading(flight), flight.true_instant * 1e-9)
    assert rate[-300:-1] == pytest.approx(0.5, rel=1e-3)


def test_thrusts_stay_within_their_limits_and_tilt_comes_before_yaw() -> None:
    par = rigid_body.parameters(VEHICLES["bebop2"], 0.0)[0]
    rng, out = np.random.default_rng(3), np.zeros(4)
    for collective, roll, pitch, yaw in rng.normal([5.0, 0.0, 0.0, 0.0], [4.0, 0.3, 0.3, 0.05], (2000, 4)):
        rigid_body._thrust_commands(par, collective, roll, pitch, yaw, out)

        assert out.min() >= par["least"] - 1e-12
        assert out.max() <= par["most"] + 1e-12
        moments = par["lever"] * np.array([out[0] - out[1] - out[2] + out[3], -out[0] - out[1] + out[2] + out[3]])
        wide = (abs(roll) + abs(pitch)) / (2 * par["lever"]) > par["most"] - par["least"]
        if not wide:
            assert moments == pytest.approx([roll, pitch], abs=1e-12)
            turned = par["torque_ratio"] * (out[0] - out[1] + out[2] - out[3])
            assert turned * yaw >= -1e-15
            assert abs(turned) <= abs(yaw) + 1e-12
        else:
            assert moments[0] * pitch == pytest.approx(moments[1] * roll, abs=1e-9)


@pytest.mark.parametrize("name", VEHICLES)
def test_halving_the_step_moves_a_calm_minute_by_less_than_a_millimetre(name: str) -> None:
    t = np.arange(0, 60, 0.01)
    wave = [
        0.1 * (np.sin(1.3 * t) + np.sin(t)),
        0.1 * (np.cos(1.3 * t) + np.cos(t)),
        0.3 * np.sin(t),
        0.5 * np.sin(0.7 * t),
    ]
    stamps = np.round(t * SECOND).astype(np.int64)
    coarse, fine = (
        fly_commands(VEHICLES[name], CALM, stamps, np.stack(wave, axis=1), 60.0, 1, (0, 0, 5, 0), max_step=step)
        for step in (rigid_body.MAX_STEP, rigid_body.MAX_STEP // 2)
    )

    assert np.abs(coarse.true_position - fine.true_position).max() < 1e-6  # a thousandth of what is promised


def test_a_full_stick_reversal_neither_tumbles_nor_breaks_the_speed_of_convergence() -> None:
    vehicle, t = VEHICLES["bebop2"], np.arange(0, 10, 0.02)
    stick = np.where(t % 2 < 1, 1.0, -1.0)
    commands = np.stack([stick, -stick, stick, stick], axis=1)
    stamps = np.round(t * SECOND).astype(np.int64)
    coarse, fine = (
        fly_commands(vehicle, CALM, stamps, commands, 10.0, 1, (0, 0, 50, 0), max_step=step)
        for step in (rigid_body.MAX_STEP, rigid_body.MAX_STEP // 2)
    )

    up = 1 - 2 * (coarse.true_quaternion[:, 1] ** 2 + coarse.true_quaternion[:, 2] ** 2)
    assert np.degrees(np.arccos(up)).max() < 60
    assert np.abs(coarse.true_position - fine.true_position).max() < 1e-3


def test_brakes_on_zero_stops_a_bebop_and_not_what_only_asks_for_level() -> None:
    room = {}
    for name, command in (("brakes", (0.0, 0.0, 0.0, 0.0)), ("level", (TINY, 0.0, 0.0, 0.0))):
        room[name] = FlightRoom(VEHICLES["bebop2"], CALM, 1, (0, 0, 20, 0))
        for k in range(100):
            room[name].send((0.3, 0.0, 0.0, 0.0) if k < 20 else command)
            room[name].advance((k + 1) * SECOND // 10)

    assert room["level"].truth().velocity[0] > 0.3
    assert abs(room["brakes"].truth().velocity[0]) < 1e-3


def test_without_commands_the_vehicle_hovers_after_its_time_out_and_lands_where_it_does() -> None:
    crazyflie = FlightRoom(VEHICLES["crazyflie"], CALM, 1)  # times out after 0.5 s, lands after 2 s
    crazyflie.send((0.5, 0.0, 0.0, 0.0))
    crazyflie.advance(SECOND // 2)
    assert crazyflie.truth().velocity[0] > 0.2
    crazyflie.advance(2 * SECOND)
    assert crazyflie.truth().mode == "flying"
    assert abs(crazyflie.truth().velocity[0]) < 0.05
    crazyflie.advance(15 * SECOND)
    assert crazyflie.truth().mode == "grounded"
    assert crazyflie.truth().position[2] == 0.0

    bebop = FlightRoom(VEHICLES["bebop2"], CALM, 1)
    bebop.send((0.5, 0.0, 0.0, 0.0))
    bebop.advance(60 * SECOND)
    assert bebop.truth().mode == "flying"
    assert abs(bebop.truth().velocity[0]) < 1e-3


def test_a_vehicle_takes_off_hovers_flies_and_lands_on_the_floor() -> None:
    vehicle = VEHICLES["bebop2"]
    room = FlightRoom(vehicle, replace(CALM, floor=0.3), 1, (1.0, 2.0, 0.3, 0.4), flying=False)
    room.advance(SECOND)
    assert room.truth().position == (1.0, 2.0, 0.3)
    room.send((0.5, 0.0, 0.0, 0.0))  # nobody hears it on the floor
    room.take_off()
    room.advance(8 * SECOND)
    height = room.truth().position[2] - 0.3
    assert room.truth().mode == "flying"
    assert vehicle.autopilot.take_off_height <= height < vehicle.autopilot.take_off_height + 0.4
    assert room.truth().position[:2] == pytest.approx((1.0, 2.0), abs=1e-6)
    room.land()
    room.advance(20 * SECOND)
    assert room.truth().mode == "grounded"
    assert room.truth().position == pytest.approx((1.0, 2.0, 0.3), abs=1e-6)
    room.take_off()
    room.advance(28 * SECOND)
    assert room.truth().mode == "flying"


def test_the_floor_stops_what_flies_into_it_and_lets_it_leave_again() -> None:
    room = FlightRoom(VEHICLES["bebop2"], CALM, 1, (0, 0, 0.5, 0))
    for k in range(60):
        room.send((0.1, 0.0, -0.5 if k < 40 else 0.5, 0.0))
        room.advance((k + 1) * SECOND // 10)
        if k == 39:
            assert room.truth().position[2] == 0.0
            assert room.truth().velocity == (0.0, 0.0, 0.0)

    assert room.truth().position[2] > 0.3


def test_an_empty_battery_lands_and_a_sagging_one_still_hovers() -> None:
    vehicle = VEHICLES["bebop2"]
    low = FlightRoom(vehicle, replace(CALM, charge=0.1), 1)
    low.advance(60 * SECOND)
    assert low.truth().mode == "flying"
    assert low.truth().position[2] == pytest.approx(1.5, abs=0.02)
    assert low.truth().charge == pytest.approx(0.1 - 60 / vehicle.battery.flight_time, rel=1e-3)
    low.advance(140 * SECOND)
    assert low.truth().mode == "grounded"
