"""The simulator against closed forms, an independent integrator, and its own stated figures."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.errors import LogError
from rotorfit.core.frames import Array, world_from_heading
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import (
    GAMMA_A,
    GAMMA_B,
    HOVER_HEIGHT,
    Controller,
    Excitation,
    SimulatedFlight,
    Truth,
    as_log,
    noise_free,
    simulate_flight,
    write_bag,
)

STILL = noise_free(Truth())
DELAYS = (0.05, 0.11, 0.15, 0.262)
XY = partial(two_sines, axes=("x", "y"))


def constant(*command: float) -> Excitation:
    return lambda t: np.tile(np.array(command, float), (t.size, 1))


def seconds(stamps: np.ndarray) -> Array:
    return stamps.astype(float) * 1e-9


def test_at_rest_without_command_or_wind_nothing_moves() -> None:
    flight = simulate_flight(STILL, constant(0, 0, 0, 0), 5.0, seed=0)

    np.testing.assert_array_equal(flight.pose, np.tile([0.0, 0.0, HOVER_HEIGHT, 0.0], (600, 1)))
    np.testing.assert_array_equal(flight.velocity, 0.0)


@pytest.mark.parametrize("axis", range(4))
def test_a_constant_command_ends_at_the_speed_input_over_damping(axis: int) -> None:
    command = np.zeros(4)
    command[axis] = 0.1

    flight = simulate_flight(replace(STILL, gamma=GAMMA_A), constant(*command), 40.0, seed=0)

    expected = np.zeros(4)
    expected[axis] = 0.1 * GAMMA_A[2 * axis] / GAMMA_A[2 * axis + 1]
    np.testing.assert_allclose(flight.velocity[-1], expected, atol=1e-9)


def _step_response(truth: Truth, axis: int, since: Array) -> tuple[Array, Array]:
    """Position and velocity of one axis after a unit step at 0, by the closed form."""
    g, b, s = truth.gamma[2 * axis], truth.gamma[2 * axis + 1], np.maximum(since, 0.0)
    return g / b * (s + np.expm1(-b * s) / b), -g / b * np.expm1(-b * s)


@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 3)])
def test_a_step_is_answered_by_the_closed_form_after_the_delay_of_each_axis(axes: tuple[int, ...]) -> None:
    truth = replace(STILL, delay=DELAYS, command_jitter=0.0)
    command = [0.2 if axis in axes else 0.0 for axis in range(4)]

    flight = simulate_flight(truth, constant(*command), 10.0, seed=0)

    for axis in axes:
        position, velocity = _step_response(truth, axis, seconds(flight.pose_stamp) - DELAYS[axis])
        np.testing.assert_allclose(flight.true_pose[:, axis] - flight.true_pose[0, axis], 0.2 * position, atol=1e-11)
        np.testing.assert_allclose(flight.velocity[:, axis], 0.2 * velocity, atol=1e-11)


def test_held_commands_switch_exactly_at_their_jittered_stamps_plus_the_delay() -> None:
    truth = replace(STILL, delay=DELAYS)
    flight = simulate_flight(truth, two_sines, 20.0, seed=3)

    sent = seconds(flight.command_stamp)
    for axis in (2, 3):
        steps = np.diff(flight.command[:, axis], prepend=0.0)
        since = seconds(flight.pose_stamp)[:, None] - sent - truth.delay[axis]
        position, velocity = _step_response(truth, axis, since)
        np.testing.assert_allclose(flight.true_pose[:, axis] - flight.true_pose[0, axis], position @ steps, atol=1e-10)
        np.testing.assert_allclose(flight.velocity[:, axis], velocity @ steps, atol=1e-10)


def test_turning_heading_and_smooth_commands_agree_with_another_integrator() -> None:
    from scipy.integrate import solve_ivp

    truth = replace(STILL, trim=(0.05, -0.03, 0.02, 0.01))
    tau, gain, damping = truth.delay[0], np.array(GAMMA_B[::2]), np.array(GAMMA_B[1::2])

    def rates(t: float, state: Array) -> Array:
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(state[3]), -np.sin(state[3])], [np.sin(state[3]), np.cos(state[3])]]
        command = two_sines(np.array([t - tau]))[0] * (t > tau)
        push = turn @ (gain * command - damping * (turn.T @ state[4:]) + np.array(truth.trim))
        return np.concatenate([state[4:], push])

    flight = simulate_flight(truth, two_sines, 20.0, seed=1, held=False, initial_yaw=0.7)

    t = seconds(flight.pose_stamp)
    tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
    hover = solve_ivp(rates, (0.0, tau), [0, 0, HOVER_HEIGHT, 0.7, 0, 0, 0, 0], t_eval=[tau], **tight)
    after = t > tau
    reference = solve_ivp(rates, (tau + 1e-12, 20.0), hover.y[:, -1], t_eval=t[after], **tight).y.T
    assert np.ptp(flight.true_pose[:, 3]) > 2.0
    np.testing.assert_allclose(flight.true_pose[after], reference[:, :4], atol=1e-9)
    np.testing.assert_allclose(flight.velocity[after], reference[:, 4:], atol=1e-9)


@pytest.mark.parametrize("held", [True, False])
def test_halving_the_integration_step_changes_nothing(held: bool) -> None:
    truth = replace(Truth(), delay=DELAYS)

    coarse, fine = (
        simulate_flight(truth, two_sines, 60.0, seed=5, held=held, max_step=step) for step in (0.002, 0.001)
    )

    np.testing.assert_allclose(coarse.true_pose, fine.true_pose, rtol=0, atol=1e-9)
    np.testing.assert_allclose(coarse.velocity, fine.velocity, rtol=0, atol=1e-9)


def test_turning_the_start_turns_the_flight() -> None:
    angle = 2.1
    straight, turned = (simulate_flight(STILL, two_sines, 30.0, seed=2, initial_yaw=yaw) for yaw in (0.0, angle))

    everywhere = np.full(straight.pose_stamp.size, angle)
    expected = world_from_heading(straight.true_pose[:, :2], everywhere)
    np.testing.assert_allclose(turned.true_pose[:, :2], expected, atol=1e-11)
    np.testing.assert_allclose(turned.true_pose[:, 3], straight.true_pose[:, 3] + angle, atol=1e-12)


def test_trim_pushes_in_the_heading_frame() -> None:
    truth = replace(STILL, gamma=GAMMA_A, trim=(0.1, 0.0, 0.0, 0.0))

    flight = simulate_flight(truth, constant(0, 0, 0, 0), 40.0, seed=0, initial_yaw=np.pi / 2)

    np.testing.assert_allclose(flight.velocity[-1], [0.0, 0.1 / GAMMA_A[1], 0.0, 0.0], atol=1e-9)


def test_acceleration_is_equation_5_plus_wind_in_the_world() -> None:
    truth = replace(Truth(), trim=(0.02, 0.01, 0.0, 0.0))
    flight = simulate_flight(truth, two_sines, 20.0, seed=4, held=False)

    t, yaw = seconds(flight.pose_stamp), flight.true_pose[:, 3]
    gain, damping = np.array(GAMMA_B[::2]), np.array(GAMMA_B[1::2])
    command = two_sines(t - 0.15) * (t > 0.15)[:, None]
    velocity = np.column_stack([world_from_heading(flight.velocity[:, :2], -yaw), flight.velocity[:, 2:]])
    push = gain * command - damping * velocity + np.array(truth.trim)
    push[:, :2] = world_from_heading(push[:, :2], yaw)
    np.testing.assert_allclose(flight.acceleration, push + flight.wind, atol=1e-12)


def test_wind_has_the_stated_sigma_and_correlation_time() -> None:
    truth = replace(
        Truth(), wind_sigma=(0.05, 0.1, 0.07, 0.02), wind_time=(1.0, 2.0, 0.5, 1.5), pose_rate=10.0, pose_jitter=0.0
    )
    wind = simulate_flight(truth, constant(0, 0, 0, 0), 5000.0, seed=6).wind

    for axis in range(4):
        sigma, lag = truth.wind_sigma[axis], round(truth.wind_time[axis] * 10)
        correlation = np.mean(wind[lag:, axis] * wind[:-lag, axis]) / sigma**2
        assert np.std(wind[:, axis]) == pytest.approx(sigma, rel=0.05)
        assert np.mean(wind[:, axis]) == pytest.approx(0.0, abs=0.15 * sigma)
        assert correlation == pytest.approx(np.exp(-1), abs=0.08)
    np.testing.assert_allclose(np.corrcoef(wind.T), np.eye(4), atol=0.1)


def test_wind_starts_in_its_stationary_state() -> None:
    first = [simulate_flight(Truth(), XY, 0.1, seed=seed).wind[0, 0] for seed in range(400)]

    assert np.std(first) == pytest.approx(Truth().wind_sigma[0], rel=0.12)


def test_mocap_errs_and_repeats_as_stated() -> None:
    flight = simulate_flight(Truth(), two_sines, 200.0, seed=7)
    error = (flight.pose - flight.true_pose)[~flight.stale]

    np.testing.assert_allclose(error.std(axis=0), Truth().mocap_noise, rtol=0.03)
    np.testing.assert_allclose(error.mean(axis=0) / Truth().mocap_noise, 0.0, atol=0.03)
    assert np.abs(np.mean(error[1:] * error[:-1], axis=0) / np.var(error, axis=0)).max() < 0.03  # white
    assert flight.stale.mean() == pytest.approx(Truth().stale_share, abs=0.006)
    assert not flight.stale[0]
    repeats = np.all(flight.pose[1:] == flight.pose[:-1], axis=1)
    np.testing.assert_array_equal(repeats, flight.stale[1:])


def test_stamps_are_regular_up_to_the_stated_jitter() -> None:
    flight = simulate_flight(Truth(), XY, 100.0, seed=8)

    for stamps, rate, jitter in (
        (flight.pose_stamp, 120.0, Truth().pose_jitter),
        (flight.command_stamp, 50.0, Truth().command_jitter),
    ):
        late = seconds(stamps) - np.arange(100 * rate) / rate
        assert stamps.dtype == np.int64
        assert np.all(np.diff(stamps) > 0)
        assert late.min() > -1e-9
        assert 0.99 * jitter < late.max() < jitter + 1e-9


def test_the_seed_decides_everything() -> None:
    one, same, other = (simulate_flight(Truth(), XY, 5.0, seed=seed) for seed in (9, 9, 10))

    for field in ("command_stamp", "command", "pose_stamp", "pose", "stale", "true_pose", "wind"):
        np.testing.assert_array_equal(getattr(one, field), getattr(same, field))
    for field in ("command_stamp", "pose_stamp", "pose", "wind"):
        assert not np.array_equal(getattr(one, field), getattr(other, field))


def test_another_vehicle_meets_the_same_wind_and_errors() -> None:
    one = simulate_flight(Truth(), XY, 5.0, seed=9)
    other = simulate_flight(replace(Truth(), gamma=GAMMA_A, delay=DELAYS), two_sines, 5.0, seed=9)

    np.testing.assert_array_equal(one.wind, other.wind)
    np.testing.assert_array_equal(one.stale, other.stale)
    fresh = ~one.stale
    np.testing.assert_allclose((one.pose - one.true_pose)[fresh], (other.pose - other.true_pose)[fresh], atol=1e-14)


def test_smooth_commands_are_logged_at_the_stamps_of_the_poses() -> None:
    flight = simulate_flight(STILL, two_sines, 5.0, seed=1, held=False)

    np.testing.assert_array_equal(flight.command_stamp, flight.pose_stamp)
    np.testing.assert_array_equal(flight.command, two_sines(seconds(flight.pose_stamp)))


def _commands_of_a_controller(flight: SimulatedFlight, controller: Controller, dither: Array) -> Array:
    """The controller again, in plain Python, from nothing but the recorded poses."""
    start, speed, before, at, expected = np.array([0, 0, HOVER_HEIGHT, 0.0]), np.zeros(4), None, 0.0, []
    seen = start
    poses = list(zip(seconds(flight.pose_stamp), flight.pose, strict=True))
    for sent, extra in zip(seconds(flight.command_stamp), dither, strict=True):
        while poses and poses[0][0] <= sent:
            now, pose = poses.pop(0)
            before, seen, since, at = seen, pose, now - at, now
            speed = (speed * controller.filter_time + (seen - before)) / (controller.filter_time + since)
        force = controller.stiffness * (start - seen) - controller.damping * speed
        force[:2] = world_from_heading(force[None, :2], -seen[3:])[0]
        expected.append(extra + force / np.array(flight.truth.gamma[::2]))
    return np.array(expected)


def test_the_controller_sees_the_measured_poses_up_to_now_and_nothing_else() -> None:
    controller = Controller()
    flight = simulate_flight(Truth(), two_sines, 10.0, seed=11, controller=controller)

    expected = _commands_of_a_controller(flight, controller, two_sines(seconds(flight.command_stamp)))
    np.testing.assert_allclose(flight.command, expected, atol=1e-12)


@pytest.mark.parametrize("gamma", [GAMMA_A, GAMMA_B])
def test_the_controller_holds_the_room_that_an_open_loop_leaves(gamma: tuple[float, ...]) -> None:
    windy = replace(Truth(), gamma=gamma, wind_sigma=(0.1, 0.1, 0.1, 0.05))

    held = simulate_flight(windy, XY, 200.0, seed=12, controller=Controller())
    free = simulate_flight(windy, XY, 200.0, seed=12)

    assert np.abs(held.true_pose[:, :2]).max() < 1.0 < np.abs(free.true_pose[:, :2]).max()
    assert np.abs(held.command).max() < 1.0


def test_a_controller_needs_held_commands() -> None:
    with pytest.raises(ValueError, match="needs held commands"):
        simulate_flight(Truth(), XY, 1.0, seed=0, held=False, controller=Controller())


WRONG = (
    {"gamma": (1.0, 2.0)}, {"delay": (0.1, 0.1)}, {"delay": (-0.1, 0.1, 0.1, 0.1)}, {"wind_time": (0.0, 1.0, 1.0, 1.0)},
    {"stale_share": 1.0}, {"pose_rate": 0.0}, {"command_jitter": 0.011},
)  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_a_truth_that_no_flight_can_have_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"must|has 8 values"):
        replace(Truth(), **wrong)


def test_the_log_holds_the_recorded_columns_in_wall_clock_stamps() -> None:
    flight = simulate_flight(Truth(), two_sines, 3.0, seed=13)
    log = as_log(flight)

    command, pose = log.tables["/cmd_vel"].columns, log.tables["/pose"].columns
    for columns, stamps in ((command, flight.command_stamp), (pose, flight.pose_stamp)):
        lateness = columns["log_time"] - columns["header.stamp"]
        assert columns["header.stamp"].dtype == columns["log_time"].dtype == np.int64
        np.testing.assert_array_equal(np.diff(columns["header.stamp"]), np.diff(stamps))
        assert 0 <= lateness.min() <= lateness.max() < 1_000_000
    assert command["header.stamp"][0] - flight.command_stamp[0] == pose["header.stamp"][0] - flight.pose_stamp[0]
    names = ["twist.linear.x", "twist.linear.y", "twist.linear.z", "twist.angular.z"]
    np.testing.assert_array_equal(np.stack([command[name] for name in names], axis=1), flight.command)
    position = np.stack([pose[f"pose.position.{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(position, flight.pose[:, :3])
    yaw = 2 * np.arctan2(pose["pose.orientation.z"], pose["pose.orientation.w"])
    np.testing.assert_allclose(np.unwrap(yaw), flight.pose[:, 3], atol=1e-14)


def test_the_log_becomes_a_flight_that_has_lost_the_stale_poses_and_nothing_else() -> None:
    simulated = simulate_flight(Truth(), two_sines, 10.0, seed=13)
    flight = flight_from_log(as_log(simulated), load_card("rotorfit-demo"))

    since = seconds(simulated.pose_stamp - simulated.command_stamp[0])
    kept = ~simulated.stale & (since >= 0) & (since <= flight.span[1])
    assert {note.code: note.count for note in flight.notes}["stale_poses"] == simulated.stale.sum()
    np.testing.assert_allclose(flight.pose_time, since[kept], atol=1e-12)
    np.testing.assert_array_equal(flight.position, simulated.pose[kept, :3])
    np.testing.assert_allclose(flight.yaw, simulated.pose[kept, 3], atol=1e-14)
    np.testing.assert_array_equal(flight.command, simulated.command)


def test_the_digest_of_the_log_tells_flights_apart() -> None:
    one, same, other = (as_log(simulate_flight(Truth(), XY, 1.0, seed=seed)).sha256 for seed in (1, 1, 2))

    assert one == same != other


def test_the_bag_holds_what_the_log_holds(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    flight = simulate_flight(Truth(), two_sines, 3.0, seed=14)
    write_bag(flight, tmp_path / "flight.bag")

    expected = {topic: dict(table.columns) for topic, table in as_log(flight).tables.items()}
    found: dict[str, list[list[float]]] = {"/cmd_vel": [], "/pose": []}
    with AnyReader([tmp_path / "flight.bag"]) as bag:
        kinds = {connection.topic: connection.msgtype for connection in bag.connections}
        for connection, log_time, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            row = [stamp, log_time]
            for name in list(expected[connection.topic])[2:]:
                part, group, axis = name.split(".")
                row.append(getattr(getattr(getattr(message, part), group), axis))
            found[connection.topic].append(row)
    assert kinds == {"/cmd_vel": "geometry_msgs/msg/TwistStamped", "/pose": "geometry_msgs/msg/PoseStamped"}
    for topic, rows in found.items():
        for name, values in zip(expected[topic], zip(*rows, strict=True), strict=True):
            np.testing.assert_array_equal(np.array(values), expected[topic][name], err_msg=f"{topic}:{name}")


def test_the_same_flight_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one.bag", "two.bag"):
        write_bag(simulate_flight(Truth(), XY, 1.0, seed=15), tmp_path / name)

    assert (tmp_path / "one.bag").read_bytes() == (tmp_path / "two.bag").read_bytes()


def test_a_bag_is_never_written_over_a_file(tmp_path: Path) -> None:
    (tmp_path / "log.bag").write_text("precious")

    with pytest.raises(LogError, match=r"log\.bag exists already"):
        write_bag(simulate_flight(Truth(), XY, 1.0, seed=0), tmp_path / "log.bag")
    assert (tmp_path / "log.bag").read_text() == "precious"
