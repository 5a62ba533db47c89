"""The paper's regression: exact where it must be, and wrong in the ways that are known."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from rotorfit.core.card import Card, Channel
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES
from rotorfit.dynamics.kinematics import local_polynomial, motion_from_flight
from rotorfit.estimation.regression.paper import alpha, modelled_acceleration, paper_regression

STAMP = Channel("time")
CARD = Card("by hand", "ENU", "heading", None, STAMP, {}, STAMP, {})
GAMMA = np.array([4.33, 0.23, 4.12, 0.41, 4.42, 3.13, 5.92, 2.70])
"""The paper's, with a yaw damping that is physics (set B's)."""
RATE = 120

Command = Callable[[np.ndarray], np.ndarray]


def sines(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Command:
    """The paper's inputs (7): shape (N,) -> (N, 4)."""

    def command(t: np.ndarray) -> np.ndarray:
        s, c = np.sin(1.3 * t) + np.sin(t), np.cos(1.3 * t) + np.cos(t)
        return np.stack([x * s, y * c, z * s, yaw * s], axis=-1)

    return command


def flight_of(
    time: np.ndarray, pose: np.ndarray, command_time: np.ndarray, command: np.ndarray, axes: tuple[str, ...] = AXES
) -> Flight:
    segment = Segment(max(time[0], command_time[0]), time[-1])
    span = (segment.start, segment.end)
    return Flight("", "", CARD, span, axes, command_time, command, time, pose[:, :3], pose[:, 3], (segment,))


def integrate(gamma: np.ndarray, command: Command, duration: float, yaw: float = 0.0) -> Flight:
    """Eq. (5) by Runge-Kutta of order 4, the command known exactly at every pose."""
    h, n = 1 / RATE, int(duration * RATE)
    u = command(np.arange(2 * n + 1) * h / 2)

    def rate(q: np.ndarray, now: np.ndarray) -> np.ndarray:
        c, s = np.cos(q[3]), np.sin(q[3])
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        return np.concatenate([q[4:], turn @ (gamma[0::2] * now - gamma[1::2] * (turn.T @ q[4:]))])

    q = np.zeros((n + 1, 8))
    q[0] = [0.5, -1.0, 1.2, yaw, 0.1, -0.05, 0.0, 0.0]
    for i in range(n):
        k1 = rate(q[i], u[2 * i])
        k2 = rate(q[i] + h / 2 * k1, u[2 * i + 1])
        k3 = rate(q[i] + h / 2 * k2, u[2 * i + 1])
        k4 = rate(q[i] + h * k3, u[2 * i + 2])
        q[i + 1] = q[i] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    time = np.arange(n + 1) * h
    return flight_of(time, q[:, :4], time, u[::2])


def hold(
    gamma: np.ndarray,
    command: Command,
    duration: float,
    period: int,
    delay: float = 0.0,
    wind: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
) -> Flight:
    """A flight at yaw 0 under commands held for `period` / 600 s: exact steps of 1/600 s, poses at 120 Hz.

    `wind` is the standard deviation [m/s^2] of a disturbance with a correlation time of 1 s, `noise` that of the pose.
    """
    rng, h, n = np.random.default_rng(seed), 1 / 600, int(duration * 600)
    switch = np.arange(0, n, period)
    sent = command(switch * h)
    act = np.maximum(np.arange(n) - round(delay / h), 0)
    force = gamma[0::2] * np.where((np.arange(n) >= round(delay / h))[:, None], sent[act // period], 0.0)
    rest = np.exp(-h)
    force += lfilter([wind * np.sqrt(1 - rest**2)], [1, -rest], rng.normal(size=(n, 4)), axis=0)
    position = np.zeros((n, 4))
    for i, b in enumerate(gamma[1::2]):
        f, k = np.exp(-b * h), -np.expm1(-b * h) / b
        velocity = lfilter([0, k], [1, -f], force[:, i])
        position[:, i] = np.cumsum(np.append(0.0, (k * velocity + (h - k) / b * force[:, i])[:-1]))
    time = np.arange(0, n, 5) * h
    pose = position[::5] + noise * rng.normal(size=(len(time), 4))
    return flight_of(time, pose * [1, 1, 1, 0], switch * h, sent * [1, 1, 1, 0], ("x", "y", "z"))


@pytest.fixture(scope="module")
def plane() -> Flight:
    """x and y together while yaw, non-zero from the start, turns through half a circle and back."""
    both = sines(x=0.1, y=0.1)

    def command(t: np.ndarray) -> np.ndarray:
        u = both(t)
        u[:, 3] = 0.3 * np.sin(0.4 * t)
        return u

    return integrate(GAMMA, command, 60.0, yaw=0.7)


@pytest.fixture(scope="module")
def vertical() -> Flight:
    return integrate(GAMMA, sines(z=0.1), 30.0)


@pytest.fixture(scope="module")
def turning() -> Flight:
    return integrate(GAMMA, sines(yaw=0.6), 30.0)


def test_noise_free_plane_flight_with_turning_yaw_is_recovered_to_1e_6(plane: Flight) -> None:
    assert np.ptp(plane.yaw) > 3.0
    fit = paper_regression([plane], half_width=0.1, degree=5)
    np.testing.assert_allclose(fit.gamma[:4], GAMMA[:4], rtol=1e-6)
    np.testing.assert_allclose(fit.gamma[6:], GAMMA[6:], rtol=1e-6)
    assert np.isnan(fit.gamma[4:6]).all()


def test_noise_free_vertical_flight_is_recovered_to_1e_6(vertical: Flight) -> None:
    fit = paper_regression([vertical], half_width=0.1, degree=5)
    np.testing.assert_allclose(fit.gamma[4:6], GAMMA[4:6], rtol=1e-6)


def test_noise_free_yaw_flight_is_recovered_to_1e_6(turning: Flight) -> None:
    fit = paper_regression([turning], half_width=0.1, degree=5)
    np.testing.assert_allclose(fit.gamma[6:], GAMMA[6:], rtol=1e-6)


def test_smoothing_of_the_default_window_costs_less_than_3e_5(plane: Flight, vertical: Flight) -> None:
    """The default window trades exactness, which only noise-free poses can show, for less noise.

    What a quintic over +-T loses of an acceleration at omega is (omega T)^4 / 792.
    """
    fit = paper_regression([plane, vertical])
    np.testing.assert_allclose(fit.gamma, GAMMA, rtol=3e-5)
    assert np.abs(fit.gamma / GAMMA - 1).max() > 1e-6


def test_jittered_poses_with_holes_are_recovered_as_well(vertical: Flight) -> None:
    rng = np.random.default_rng(0)
    keep = rng.random(len(vertical.pose_time)) > 0.45
    keep[1200:1260] = False
    thinned = dataclasses.replace(
        vertical, pose_time=vertical.pose_time[keep], position=vertical.position[keep], yaw=vertical.yaw[keep]
    )
    fit = paper_regression([thinned], half_width=0.1, degree=5)
    np.testing.assert_allclose(fit.gamma[4:6], GAMMA[4:6], rtol=3e-6)


@pytest.mark.parametrize(("period", "damping_bias"), [(12, -0.0042), (30, -0.021)])
def test_held_commands_bias_the_damping_because_only_the_output_is_smoothed(period: int, damping_bias: float) -> None:
    """Without any noise, g2 comes out 0.4 % too small at 50 Hz commands and 2.1 % at 20 Hz; g1 0.03 % and 0.13 %.

    Differentiation smooths the output, not the input: the window averages the answer to the staircase of commands, and
    the regression puts the staircase itself, sampled at the poses, beside it. On a common clock the poses catch the
    steps too young: of 12 poses per 5 steps of 20 ms, the held command is 9.17 ms old on average, not 10 ms (at 20 Hz
    20.8, not 25 ms). That acts like a command that comes 0.83 ms (4.2 ms) early, and each millisecond of timing costs
    omega^2 / 1000, about 0.0013, of g2. Commands whose steps fall just behind the poses turn the sign of the bias;
    commands smoothed like the output leave none.
    """
    truth = hold(GAMMA, sines(x=0.1, y=0.1), 60.0, period)
    fit = paper_regression([truth], half_width=0.2, degree=5)
    bias = fit.gamma / GAMMA - 1
    assert bias[1] == pytest.approx(damping_bias, rel=0.15)
    assert -0.1 * abs(damping_bias) < bias[0] < 0

    behind = dataclasses.replace(truth, command_time=truth.command_time + 1 / 1200)
    assert paper_regression([behind], half_width=0.2, degree=5).gamma[1] > GAMMA[1]

    motion = fit.motions[0]
    fine = np.arange(0, 60, 1 / 2400) + 1 / 4800
    stairs = truth.command[np.searchsorted(truth.command_time, fine) - 1]
    smooth = dataclasses.replace(motion, command=local_polynomial(fine, stairs, motion.time, 0.2, 3).value)
    regressors, world = alpha(smooth), motion.acceleration
    stacked = np.concatenate([regressors[:, 0:4], regressors[:, 4:8]])
    gamma = np.linalg.lstsq(stacked, np.concatenate([world[:, 0], world[:, 1]]), rcond=None)[0]
    np.testing.assert_allclose(gamma, GAMMA[:4], rtol=1e-4)


@pytest.mark.parametrize("half_width", [0.1, 0.25, 0.4])
def test_a_delay_of_150_ms_takes_most_of_the_damping_whatever_the_window(half_width: float) -> None:
    """The trap: the paper's method gives g2 about 0.047 where the truth is 0.23, and calls itself certain of it."""
    flight = hold(GAMMA, sines(x=0.1, y=0.1), 100.0, 12, delay=0.15, noise=5e-4)
    fit = paper_regression([flight], half_width=half_width)
    assert 0.02 < fit.gamma[1] < 0.07
    assert fit.gamma[1] + 5 * fit.stderr[1] < GAMMA[1]
    assert fit.r_squared["x"] > 0.75


def test_standard_errors_match_the_scatter_under_wind_and_the_textbook_ones_do_not() -> None:
    flights = [hold(GAMMA, sines(x=0.1, z=0.1), 60.0, 12, wind=0.03, noise=5e-4, seed=seed) for seed in range(40)]
    fits = [paper_regression([flight], ("x", "z")) for flight in flights]
    used = [0, 1, 4, 5]
    scatter = np.std([fit.gamma[used] for fit in fits], axis=0, ddof=1)
    stated = np.sqrt(np.mean([fit.stderr[used] ** 2 for fit in fits], axis=0))
    textbook = np.sqrt(np.mean([np.diag(fit.covariance_ols)[used] for fit in fits], axis=0))
    np.testing.assert_allclose(scatter / stated, 1.0, atol=0.35)
    assert (scatter > 5 * textbook).all()


def test_covariance_is_newey_wests_double_sum_over_the_stamps_of_each_flight(vertical: Flight) -> None:
    rng = np.random.default_rng(1)
    keep = rng.random(len(vertical.pose_time)) > 0.6
    keep[1000:1200] = False
    position = vertical.position + 1e-3 * rng.normal(size=vertical.position.shape)
    noisy = dataclasses.replace(
        vertical, pose_time=vertical.pose_time[keep], position=position[keep], yaw=vertical.yaw[keep]
    )
    other = hold(GAMMA, sines(z=0.1), 20.0, 12, wind=0.05, noise=1e-3)

    fit = paper_regression([noisy, other], ("z",))

    designs = [alpha(motion)[:, 8:10] for motion in fit.motions]
    bread = np.linalg.inv(sum(x.T @ x for x in designs))
    middle = np.zeros((2, 2))
    for x, motion in zip(designs, fit.motions, strict=True):
        score = x * (motion.acceleration[:, 2] - x @ fit.gamma[4:6])[:, None]
        distance = np.abs(motion.time[:, None] - motion.time[None, :])
        middle += score.T @ np.maximum(1 - distance / fit.lag["z"], 0) @ score
    np.testing.assert_allclose(fit.covariance[4:6, 4:6], bread @ middle @ bread, rtol=1e-6)
    np.testing.assert_allclose(fit.stderr[4:6], np.sqrt(np.diag(fit.covariance)[4:6]))
    assert 2 * fit.half_width <= fit.lag["z"] <= 30.0 / 4


def test_turning_the_world_does_not_change_gamma(plane: Flight) -> None:
    c, s = np.cos(2.0), np.sin(2.0)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = dataclasses.replace(plane, position=plane.position @ turn.T + [3.0, -7.0, 1.0], yaw=plane.yaw + 2.0)
    one, two = paper_regression([plane]), paper_regression([turned])
    np.testing.assert_allclose(two.gamma, one.gamma, rtol=1e-9)
    np.testing.assert_allclose(two.stderr, one.stderr, rtol=1e-4)
    assert two.r_squared["x"] == pytest.approx(one.r_squared["x"], abs=1e-9)


def test_scaling_the_commands_scales_the_input_gains_only(plane: Flight, vertical: Flight) -> None:
    flights = [plane, vertical]
    scaled = [dataclasses.replace(flight, command=8.0 * flight.command) for flight in flights]
    one, two = paper_regression(flights), paper_regression(scaled)
    np.testing.assert_allclose(8 * two.gamma[0::2], one.gamma[0::2], rtol=1e-9)
    np.testing.assert_allclose(two.gamma[1::2], one.gamma[1::2], rtol=1e-9)
    np.testing.assert_allclose(8 * two.stderr[0::2], one.stderr[0::2], rtol=1e-6)


def test_three_training_flights_give_together_what_they_give_one_by_one(vertical: Flight, turning: Flight) -> None:
    wind = {"wind": 0.03, "noise": 5e-4}
    plane = hold(GAMMA, sines(x=0.1, y=0.1), 40.0, 12, **wind)
    joint = paper_regression([plane, vertical, turning])
    for flight, which in ((plane, slice(0, 4)), (vertical, slice(4, 6)), (turning, slice(6, 8))):
        alone = paper_regression([flight])
        np.testing.assert_allclose(joint.gamma[which], alone.gamma[which], rtol=1e-10)
        np.testing.assert_allclose(joint.stderr[which], alone.stderr[which], rtol=1e-6)
    assert set(joint.status.values()) == {"ok"}
    assert joint.reason == {}


def test_two_flights_of_one_axis_lie_between_what_each_gives_alone() -> None:
    flights = [hold(GAMMA, sines(z=0.1), 40.0, 12, wind=0.05, noise=5e-4, seed=seed) for seed in (0, 1)]
    alone = np.array([paper_regression([flight], ("z",)).gamma[4:6] for flight in flights])
    joint = paper_regression(flights, ("z",))
    assert (joint.gamma[4:6] > alone.min(axis=0)).all()
    assert (joint.gamma[4:6] < alone.max(axis=0)).all()
    assert joint.rows["z"] == sum(len(motion.time) for motion in joint.motions)


def test_x_is_the_same_with_and_without_the_columns_of_y(plane: Flight) -> None:
    """y is not commanded, but it moves and yaw turns: eq. (8) loses the columns of y and keeps its rows."""
    rng = np.random.default_rng(4)
    position = plane.position + 1e-3 * rng.normal(size=plane.position.shape)
    blind = dataclasses.replace(plane, position=position, command=plane.command * [1, 0, 1, 1], axes=("x", "yaw"))

    fit = paper_regression([blind])

    regressors, world = alpha(fit.motions[0]), fit.motions[0].acceleration
    stacked = np.concatenate([regressors[:, [0, 1, 3]], regressors[:, [4, 5, 7]]])
    with_damping_of_y = np.linalg.lstsq(stacked, np.concatenate([world[:, 0], world[:, 1]]), rcond=None)[0]
    np.testing.assert_allclose(fit.gamma[:2], with_damping_of_y[:2], rtol=1e-9)
    assert np.isnan(fit.gamma[2:4]).all()
    assert fit.status["y"] == "not_excited"
    assert "no flight has a command" in fit.reason["y"]
    assert fit.r_squared["x"] > 0.9


def test_measured_and_modelled_acceleration_are_the_papers_figure_4(plane: Flight, vertical: Flight) -> None:
    """World axes, one trace a flight; a model fitted on one flight can be shown on another."""
    fit = paper_regression([plane], half_width=0.1)
    motion, modelled = fit.motions[0], fit.modelled[0]
    np.testing.assert_allclose(modelled[:, [0, 1, 3]], motion.acceleration[:, [0, 1, 3]], atol=1e-5)
    assert np.isnan(modelled[:, 2]).all()
    # Eq. (6) row by row: alpha_1..alpha_4 make world x, alpha_5..alpha_8 world y.
    np.testing.assert_allclose(alpha(motion)[:, 0:4] @ fit.gamma[:4], modelled[:, 0], atol=1e-12)
    np.testing.assert_allclose(alpha(motion)[:, 4:8] @ fit.gamma[:4], modelled[:, 1], atol=1e-12)

    unseen = motion_from_flight(vertical, 0.1)
    np.testing.assert_allclose(modelled_acceleration(unseen, GAMMA), unseen.acceleration, atol=1e-5)


def test_modelled_acceleration_shows_what_the_one_known_axis_of_the_plane_contributes(plane: Flight) -> None:
    motion = motion_from_flight(plane)
    only_x = np.where(np.arange(8) < 2, GAMMA, np.nan)
    none = modelled_acceleration(motion, np.full(8, np.nan))
    along = GAMMA[0] * motion.command[:, 0] - GAMMA[1] * motion.velocity[:, 0]
    np.testing.assert_allclose(modelled_acceleration(motion, only_x)[:, 0], along * np.cos(motion.yaw), atol=1e-12)
    np.testing.assert_allclose(modelled_acceleration(motion, only_x)[:, 1], along * np.sin(motion.yaw), atol=1e-12)
    assert np.isnan(none).all()


def test_a_command_holds_from_its_stamp_until_the_next(vertical: Flight) -> None:
    stamps = np.array([0.0, 1.0, 2.5, 20.0])
    command = np.zeros((4, 4))
    command[:, 2] = [1.0, 2.0, 3.0, 4.0]
    motion = motion_from_flight(dataclasses.replace(vertical, command_time=stamps, command=command))
    expected = 1.0 + (motion.time >= 1.0) + (motion.time >= 2.5) + (motion.time >= 20.0)
    np.testing.assert_array_equal(motion.command[:, 2], expected)


def test_poses_outside_the_segments_are_not_looked_at(vertical: Flight) -> None:
    segments = (Segment(5.0, 12.0), Segment(14.0, 25.0))
    outside = np.ones(len(vertical.pose_time), dtype=bool)
    for segment in segments:
        outside &= (vertical.pose_time < segment.start) | (vertical.pose_time > segment.end)
    position = vertical.position.copy()
    position[outside] = 1e6
    cut = dataclasses.replace(vertical, segments=segments)

    fit = paper_regression([dataclasses.replace(cut, position=position)], half_width=0.1)

    np.testing.assert_allclose(fit.gamma[4:6], GAMMA[4:6], rtol=1e-6)
    time = fit.motions[0].time
    assert time.min() >= 5.1 - 1e-9
    assert time.max() <= 24.9 + 1e-9
    assert not np.any((time > 11.9 + 1e-9) & (time < 14.1 - 1e-9))


def test_axes_that_are_not_excited_give_no_numbers_and_a_reason(vertical: Flight) -> None:
    fit = paper_regression([dataclasses.replace(vertical, axes=("x", "z"))], ("x", "y", "z"))
    assert fit.status == {"x": "not_excited", "y": "not_excited", "z": "ok"}
    assert "zero" in fit.reason["x"]
    assert "no flight has a command" in fit.reason["y"]
    assert np.isnan(fit.gamma[[0, 1, 2, 3, 6, 7]]).all()
    assert np.isnan(fit.stderr[:4]).all()
    assert set(fit.r_squared) == {"z"}


def test_a_spike_in_the_first_command_does_not_make_yaw_look_excited(vertical: Flight) -> None:
    command = vertical.command.copy()
    command[:20, 3] = -1.16
    fit = paper_regression([dataclasses.replace(vertical, command=command)])
    assert fit.status["yaw"] == "not_excited"


def test_a_flight_of_one_second_is_too_short(vertical: Flight) -> None:
    fit = paper_regression([dataclasses.replace(vertical, segments=(Segment(3.0, 4.0),))], ("z",))
    assert fit.status == {"z": "too_short"}
    assert "0.5 s of poses" in fit.reason["z"]
    assert np.isnan(fit.gamma).all()


def test_a_vehicle_that_does_not_move_is_not_identifiable(vertical: Flight) -> None:
    still = dataclasses.replace(vertical, position=np.ones_like(vertical.position))
    fit = paper_regression([still], ("z",))
    assert fit.status == {"z": "not_identifiable"}
    assert "did not move" in fit.reason["z"]
    assert np.isnan(fit.covariance).all()


def test_a_still_y_does_not_take_x_with_it() -> None:
    flight = hold(GAMMA, sines(x=0.1, y=0.1), 30.0, 12)
    still = dataclasses.replace(flight, position=flight.position * [1, 0, 1])
    fit = paper_regression([still], ("x", "y"))
    assert fit.status == {"x": "ok", "y": "not_identifiable"}
    np.testing.assert_array_equal(fit.gamma[:2], paper_regression([still], ("x",)).gamma[:2])


def test_slow_poses_get_a_wider_window(vertical: Flight) -> None:
    slow = dataclasses.replace(
        vertical, pose_time=vertical.pose_time[::12], position=vertical.position[::12], yaw=vertical.yaw[::12]
    )
    fit = paper_regression([slow], ("z",))
    assert fit.status == {"z": "ok"}
    assert fit.motions[0].time[0] == pytest.approx(0.5)
    np.testing.assert_allclose(fit.gamma[4:6], GAMMA[4:6], rtol=1e-3)


def test_the_real_x_flight_has_negative_damping(real_flights: Path) -> None:
    """First half of bebop2-wsu X: 7.6 and -0.18. In the raw signs, which the card turns, the gain is -7.6."""
    from rotorfit.files.cards import load_card
    from rotorfit.files.logs import read
    from rotorfit.flights.assemble import flight_from_log

    folder = real_flights / "bebop2-wsu"
    log = read(folder / "Training_CT_TestDay_X.mat")
    flight = flight_from_log(log, load_card(folder / "card.toml"), span=(0.0, 82.4))

    fit = paper_regression([flight])

    assert fit.gamma[0] == pytest.approx(7.6, abs=0.2)
    assert fit.gamma[1] == pytest.approx(-0.18, abs=0.02)
    assert fit.gamma[1] + 1.96 * fit.stderr[1] < 0
