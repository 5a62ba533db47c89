"""The virtual flight room: batch and steps agree, sensors and radio err as stated, the estimator finds the truth."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import Sines, value
from rotorfit.core.log import Sample
from rotorfit.core.model import STRUCTURE
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.flight_room import Conditions, FlightRoom, RoomFlight, fly_commands, log_of_room_flight
from rotorfit.simulation.sensors import Mocap, SenderClock, Swap
from rotorfit.simulation.vehicle import Radio, Vehicle, builtin_vehicles, load_vehicle

SECOND = 1_000_000_000
BEBOP = load_vehicle("bebop2")
PERFECT = Mocap(noise=0.0, turn_noise=0.0, latency=0.0, jitter=0.0)
ROUGH = Conditions(
    wind=Wind(mean=(0.3, -0.2, 0.0), gusts=Gusts((0.3, 0.3, 0.1)), steps=((5.0, (0.5, 0.0, 0.0)),)),
    mocap=Mocap(stale=0.2, lost=0.05, drop_outs=((3.0, 3.5),), swaps=(Swap(6.0, 6.2, turn=1.0),)),
    radio=Radio(0.03, 0.02, 0.1),
    mocap_clock=SenderClock(3.5, 2e-5),
    vehicle_clock=SenderClock(-100.0, -1e-4),
    charge=0.8,
)
"""Everything that can go wrong."""


def waves(t: np.ndarray, size: np.ndarray | float = 0.15) -> np.ndarray:
    """Four different sums of four sines, shape (N, 4)."""
    frequency = (0.5, 1.0, 1.6, 2.3)
    phase = [tuple(a + 1.3 * a * k * k for k in range(4)) for a in (0.3, 1.0, 2.0, 0.7)]
    return np.stack([value(Sines((0.25,) * 4, frequency, p), t) for p in phase], axis=1) * size


def flown(conditions: Conditions, duration: float = 20.0, seed: int = 1, vehicle: Vehicle = BEBOP) -> RoomFlight:
    t = np.arange(0, duration, 0.02)
    return fly_commands(vehicle, conditions, np.round(t * SECOND).astype(np.int64), waves(t), duration, seed)


def column(samples: list[Sample], stream: str, name: str) -> np.ndarray:
    return np.array([getattr(sample, name) for sample in samples if sample.stream == stream])


def yaw(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


# Steps and batch


@pytest.mark.parametrize("steps", ["100 Hz", "uneven"])
@pytest.mark.parametrize("name", builtin_vehicles())
def test_stepping_equals_the_batch_bit_for_bit(name: str, steps: str) -> None:
    vehicle, duration = builtin_vehicles()[name], 23 * SECOND
    rng = np.random.default_rng(8)
    stamps = np.arange(0, duration, SECOND // 50)
    commands = 0.3 * rng.uniform(-1, 1, (stamps.size, 4))
    batch = fly_commands(vehicle, ROUGH, stamps, commands, duration * 1e-9, 4)

    room, samples = FlightRoom(vehicle, ROUGH, 4), []
    ends = np.arange(SECOND // 100, duration + 1, SECOND // 100)
    if steps == "uneven":
        ends = np.unique(np.concatenate([stamps[1:], rng.integers(0, duration, 3000), [duration]]))
    sent = 0
    for end in (0, *ends.tolist()):
        samples += room.advance(end)
        if sent < stamps.size and end == stamps[sent]:
            room.send(commands[sent].tolist())
            sent += 1

    assert sent == stamps.size
    np.testing.assert_array_equal(column(samples, "pose", "values"), batch.pose)
    np.testing.assert_array_equal(column(samples, "pose", "stamp"), batch.pose_stamp)
    np.testing.assert_array_equal(column(samples, "pose", "received"), batch.pose_received)
    np.testing.assert_array_equal(column(samples, "velocity", "values"), batch.velocity)
    np.testing.assert_array_equal(column(samples, "velocity", "stamp"), batch.velocity_stamp)
    np.testing.assert_array_equal(column(samples, "battery", "values")[:, 0], batch.battery)
    assert (np.diff([sample.received for sample in samples]) >= 0).all()


def test_looking_at_the_truth_changes_nothing() -> None:
    looked, plain = FlightRoom(BEBOP, ROUGH, 2), FlightRoom(BEBOP, ROUGH, 2)
    for k in range(1, 500):
        for room in (looked, plain):
            room.send((0.1, 0.2, 0.0, 0.3))
            room.advance(k * 7_000_001)
        looked.truth()

    assert looked.truth() == plain.truth()
    assert looked.advance(4 * SECOND) == plain.advance(4 * SECOND)


def test_the_truth_at_a_pose_is_the_truth_of_the_room_then() -> None:
    flight = flown(replace(ROUGH, mocap=replace(ROUGH.mocap, stale=0.0, lost=0.0)), 5.0)
    room = FlightRoom(BEBOP, flight.conditions, 1)
    for k, stamp in enumerate(flight.command_stamp.tolist()):
        room.advance(stamp)
        room.send(flight.command[k].tolist())
    room.advance(5 * SECOND)  # the truth of the last frame needs the commands up to it, not the steps

    last = int(flight.true_instant[-1])
    again = FlightRoom(BEBOP, flight.conditions, 1)
    for k, stamp in enumerate(flight.command_stamp.tolist()):
        if stamp <= last:
            again.advance(stamp)
            again.send(flight.command[k].tolist())
    again.advance(last)
    assert again.truth().position == tuple(flight.true_position[-1])
    assert again.truth().quaternion == tuple(flight.true_quaternion[-1])


def test_the_seed_is_everything() -> None:
    first, again, other = flown(ROUGH), flown(ROUGH), flown(ROUGH, seed=2)

    np.testing.assert_array_equal(first.pose, again.pose)
    assert log_of_room_flight(first).sha256 == log_of_room_flight(again).sha256
    assert not np.array_equal(first.pose[:500], other.pose[:500])


def test_noise_does_not_hang_on_what_the_vehicle_does() -> None:
    t = np.arange(0, 10, 0.02)
    stamps = np.round(t * SECOND).astype(np.int64)
    conditions = Conditions()
    still, moved = (fly_commands(BEBOP, conditions, stamps, waves(t, size), 10.0, 3) for size in (0.0, 0.2))

    errors = [flight.pose[:, :3] - flight.true_position for flight in (still, moved)]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)
    np.testing.assert_array_equal(still.pose_received, moved.pose_received)


# Sensors


def test_a_perfect_mocap_shows_the_truth() -> None:
    flight = flown(Conditions(mocap=PERFECT))

    np.testing.assert_allclose(flight.pose[:, :3], flight.true_position, atol=0)
    np.testing.assert_allclose(flight.pose[:, 3:], flight.true_quaternion, atol=1e-15)
    np.testing.assert_array_equal(flight.pose_stamp, flight.true_instant)
    np.testing.assert_array_equal(np.diff(flight.true_instant[::120]), SECOND)


def test_mocap_errs_by_its_noise_and_arrives_by_its_latency_and_jitter() -> None:
    mocap = Mocap(noise=0.002, turn_noise=0.01, latency=0.010, jitter=0.002)
    flight = flown(Conditions(mocap=mocap), 100.0)

    error = flight.pose[:, :3] - flight.true_position
    assert error.std(axis=0) == pytest.approx(0.002, rel=0.03)
    turn = np.unwrap(yaw(flight.pose[:, 3:]) - yaw(flight.true_quaternion))
    assert turn.std() == pytest.approx(0.01, rel=0.03)
    late = (flight.pose_received - flight.true_instant) * 1e-9
    assert late.min() == pytest.approx(0.010, abs=1e-5)
    assert late.mean() == pytest.approx(0.012, abs=2e-4)
    assert late.std() == pytest.approx(0.002, rel=0.05)
    assert (np.diff(flight.pose_received) >= 0).all()


def test_stale_frames_repeat_the_frame_before_under_a_fresh_stamp() -> None:
    flight = flown(Conditions(mocap=Mocap(stale=0.3)), 60.0)

    repeats = (np.diff(flight.pose, axis=0) == 0).all(axis=1)
    assert repeats.mean() == pytest.approx(0.3, abs=0.02)
    assert (np.diff(flight.pose_stamp) > 0).all()


def test_lost_frames_and_drop_outs_leave_holes() -> None:
    mocap = Mocap(lost=0.2, drop_outs=((3.0, 3.5), (7.0, 7.25)))
    flight = flown(Conditions(mocap=mocap), 20.0)

    time = flight.true_instant * 1e-9
    for start, end in mocap.drop_outs:
        assert not ((time >= start) & (time < end)).any()
    assert time.size == pytest.approx(0.8 * 120 * 19.25, rel=0.03)


def test_a_marker_swap_turns_and_moves_the_pose_for_its_frames_only() -> None:
    swap = Swap(4.0, 4.1, turn=1.5, offset=(0.2, 0.0, 0.0))
    flight = flown(Conditions(mocap=replace(PERFECT, swaps=(swap,))))

    time = flight.true_instant * 1e-9
    inside = (time >= 4.0) & (time < 4.1)
    assert inside.sum() == 12
    shift = flight.pose[:, :3] - flight.true_position
    turn = np.angle(np.exp(1j * (yaw(flight.pose[:, 3:]) - yaw(flight.true_quaternion))))
    assert shift[inside] == pytest.approx(np.tile([0.2, 0, 0], (12, 1)))
    assert turn[inside] == pytest.approx(1.5)
    assert np.abs(shift[~inside]).max() == 0.0
    assert np.abs(turn[~inside]).max() < 1e-12


def test_clocks_have_offset_and_drift() -> None:
    flight = flown(Conditions(mocap_clock=SenderClock(2.5, 1e-4), vehicle_clock=SenderClock(-7.0)), 30.0)

    np.testing.assert_allclose(flight.pose_stamp, flight.true_instant * 1.0001 + 2.5e9, atol=0.6)
    assert flight.velocity_stamp[0] == -7 * SECOND
    assert (flight.velocity_received - flight.velocity_stamp == 7 * SECOND + 50_000_000).all()


def test_onboard_velocity_is_that_in_the_heading_frame_with_its_noise_and_a_bias_of_the_flight() -> None:
    flight = flown(Conditions(mocap=PERFECT), 60.0)
    taken = flight.velocity_stamp  # this vehicle's clock is right
    nearest = np.searchsorted(flight.true_instant, taken).clip(max=flight.true_instant.size - 1)

    world, turn = flight.true_velocity[nearest], yaw(flight.true_quaternion[nearest])
    forward = np.cos(turn) * world[:, 0] + np.sin(turn) * world[:, 1]
    left = np.cos(turn) * world[:, 1] - np.sin(turn) * world[:, 0]
    error = flight.velocity[:, :3] - np.stack([forward, left, world[:, 2]], axis=1)
    assert error.std(axis=0) == pytest.approx(BEBOP.odometry.noise, rel=0.06)
    biases = [flown(Conditions(), 3.0, seed).velocity[:, :3].mean(axis=0) for seed in (1, 2)]
    assert not np.allclose(biases[0], biases[1], atol=1e-4)


def test_the_battery_empties_as_its_flight_time_says() -> None:
    flight = flown(Conditions(), 60.0)

    assert flight.battery[0] == 1.0
    assert flight.battery[0] - flight.battery[-1] == pytest.approx(59 / BEBOP.battery.flight_time, rel=0.02)


# Radio


def test_commands_arrive_late_by_latency_and_jitter_and_some_never() -> None:
    room = FlightRoom(BEBOP, Conditions(radio=Radio(0.030, 0.010, 0.25)), 6)
    sent = np.arange(20_000) * SECOND // 50
    room._send(sent, np.tile([0.01, 0.0, 0.0, 0.0], (sent.size, 1)))

    arrival = room._event[0][: room._events]
    assert room._events == pytest.approx(15_000, abs=250)  # four standard deviations
    assert (np.diff(arrival) >= 0).all()
    late = (arrival - sent[np.searchsorted(sent, arrival - 30_000_000, side="right") - 1]) * 1e-9
    assert late.min() == pytest.approx(0.030, abs=1e-4)
    alone = late[late < 0.05]  # those that were not overtaken by the next one's sending
    assert np.median(alone) == pytest.approx(0.030 + 0.010 * np.log(2), abs=1e-3)


def test_a_later_radio_only_shifts_the_answer() -> None:
    first, later = (flown(Conditions(mocap=PERFECT, radio=Radio(late)), 10.0) for late in (0.0, 0.1))

    np.testing.assert_allclose(later.true_position[12:], first.true_position[:-12], atol=2e-5)


def test_commands_beyond_the_limits_are_cut() -> None:
    far, full = FlightRoom(BEBOP, Conditions(), 1, (0, 0, 9, 0)), FlightRoom(BEBOP, Conditions(), 1, (0, 0, 9, 0))
    for room, size in ((far, 5.0), (full, 1.0)):
        room.send((size, -size, size, -size))
        room.advance(SECOND // 3)

    assert far.truth() == full.truth()


# What is refused


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="below the floor"):
        FlightRoom(BEBOP, Conditions(floor=2.0), 1)
    with pytest.raises(ValueError, match="does not divide"):
        FlightRoom(BEBOP, Conditions(), 1, max_step=3_000_000)
    room = FlightRoom(BEBOP, Conditions(), 1)
    for command in ((0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 0.0)):
        with pytest.raises(ValueError, match="four finite numbers"):
            room.send(command)
    room.advance(SECOND)
    with pytest.raises(ValueError, match="backwards"):
        room.advance(SECOND // 2)
    with pytest.raises(ValueError, match="in order"):
        fly_commands(BEBOP, Conditions(), np.array([2, 1]), np.zeros((2, 4)), 1.0, 1)
    for wrong in ({"rate": 0.0}, {"noise": -1.0}, {"stale": 1.0}):
        with pytest.raises(ValueError, match="mocap"):
            Mocap(**wrong)  # type: ignore[arg-type]


# The estimator finds the truth


def as_flight(flight: RoomFlight) -> Flight:
    return flight_from_log(log_of_room_flight(flight), card_from_mapping(flight.vehicle.card(), "room"))


def test_the_log_of_the_room_holds_what_was_flown() -> None:
    flight = flown(Conditions(mocap=PERFECT))
    read = as_flight(flight)

    assert read.command.shape[1] == 4
    np.testing.assert_allclose(read.command[:100], flight.command[:100])
    np.testing.assert_allclose(read.position[:100], flight.pose[:100, :3])
    np.testing.assert_allclose(read.yaw, np.unwrap(yaw(flight.pose[:, 3:]))[: read.yaw.size], atol=1e-12)


def test_a_noise_free_flight_gives_back_the_linear_truth_of_a_bebop() -> None:
    t = np.arange(0, 60, 0.02)
    commands = waves(t, np.array([0.15, 0.15, 0.3, 0.3]))
    conditions = Conditions(mocap=PERFECT, radio=Radio(0.045))
    stamps = np.round(t * SECOND).astype(np.int64)
    flight = as_flight(fly_commands(BEBOP, conditions, stamps, commands, 60.0, 1, (0, 0, 3, 0)))
    axes = fit([flight], structure=STRUCTURE).model.axes  # what is asked is what the law without a lag makes of it

    truth = BEBOP.linear(Radio(0.045))
    for k, axis in enumerate(("x", "y", "z", "yaw")):
        found, g, d, delay = axes[axis], truth.gamma[2 * k], truth.gamma[2 * k + 1], truth.delay[k]
        assert found.input == pytest.approx(g, rel=0.02)
        assert found.damping == pytest.approx(d, rel=0.03)
        assert found.delay == pytest.approx(delay, abs=0.003)


@pytest.mark.parametrize(
    "name", ["crazyflie", pytest.param("m100", marks=pytest.mark.slow), pytest.param("tello", marks=pytest.mark.slow)]
)
def test_slow_motion_of_a_velocity_servo_gives_back_its_first_order_equivalent(name: str) -> None:
    vehicle, radio = builtin_vehicles()[name], Radio(0.02)
    t = np.arange(0, 200, 0.05)
    size = 0.4 * vehicle.limits()[0] / vehicle.full_scale()[0]
    commands = np.zeros((t.size, 4))  # a slow start too: a sudden one excites what no first-order model has
    commands[:, 0] = size * np.minimum(1, t / 10) * value(Sines((0.3,) * 3, (0.1, 0.22, 0.37), (0.0,) * 3), t)
    conditions = Conditions(mocap=replace(PERFECT, noise=0.001), radio=radio)
    flight = fly_commands(vehicle, conditions, np.round(t * SECOND).astype(np.int64), commands, 200.0, 1, (0, 0, 3, 0))
    found, truth = (
        fit([as_flight(flight)], axes=("x",), structure=STRUCTURE).model.axes["x"].predictor,
        vehicle.linear(radio),
    )

    assert found is not None
    assert found.input / found.damping == pytest.approx(truth.gamma[0] / truth.gamma[1], rel=0.01)
    lag = truth.delay[0] + 1 / truth.gamma[1]
    assert found.delay + 1 / found.damping == pytest.approx(lag, rel=0.01)
    assert found.damping == pytest.approx(truth.gamma[1], rel=0.03)
