"""The prediction protocol: starts, horizons, what is scored and what is not, causality, baselines."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from flights import by_hand, flown, steps, turned
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, heading_from_world
from rotorfit.dynamics.protocol import (
    START_EVERY,
    UNMODELLED,
    AxisDynamics,
    Predictions,
    free_run_prediction,
    hold_velocity,
    horizon_errors,
    joined,
    judged,
    predict_flight,
    predictions,
    score_predictions,
    scores_of,
)
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

Array = np.ndarray

QUIET = (1e-3, 2.5e-7, 3.0, 0.8)
KNOWN: Mapping[str, AxisDynamics] = {
    axis: AxisDynamics(
        GAMMA_B[2 * k], GAMMA_B[2 * k + 1], 0.15, QUIET if axis != "yaw" else (1e-4, 1e-6, 3.0, 0.8), 1e-5
    )
    for k, axis in enumerate(AXES)
}
"""The simulator's vehicle B."""

VELOCITY = np.array([0.3, -0.2, 0.1, 0.0])


def straight(duration: float = 12.0, keep: Array | None = None, yaw: float = 0.7) -> Flight:
    """Constant velocity, no command."""
    t = np.arange(0.0, duration, 0.01)
    t = t if keep is None else t[keep[: t.size]]
    return by_hand(t, VELOCITY * t[:, None] + [0.0, 0.0, 1.0, yaw], np.arange(0, duration, 0.02), np.zeros((600, 4)))


def flight_of(seed: int = 3, duration: float = 20.0) -> Flight:
    return flown(Truth(), steps(seed=seed), duration, seed, initial_yaw=0.5)


def only(parts: tuple[Predictions, ...]) -> Predictions:
    (part,) = parts
    return part


# Starts


def test_starts_come_every_half_second_after_two_seconds_of_each_segment() -> None:
    flight = flight_of()
    cut = replace(flight, segments=(Segment(0.0, 7.0), Segment(8.3, 19.0)))

    first, second = predict_flight(cut, KNOWN, 1.0)
    np.testing.assert_allclose(first.start, np.arange(2.0, 7.0, START_EVERY))
    np.testing.assert_allclose(second.start, np.arange(10.3, 19.0, START_EVERY))
    assert second.time[0] >= 8.3
    assert second.time[-1] <= 19.0


def test_a_segment_that_ends_before_the_filter_has_settled_is_not_predicted() -> None:
    cut = replace(flight_of(), segments=(Segment(0.0, 1.9), Segment(8.0, 9.5)))

    assert predict_flight(cut, KNOWN, 1.0) == ()


def test_a_start_knows_the_poses_up_to_it_and_the_next_is_the_first_predicted() -> None:
    part = only(predict_flight(flight_of(), KNOWN, 1.0))

    assert (part.time[part.first - 1] <= part.start).all()
    assert (part.time[part.first] > part.start).all()
    assert (part.time[part.last - 1] <= part.start + 1.0 + 1e-9).all()


def test_pieces_are_the_whole() -> None:
    """And their errors together are those of the whole: what a long flight is judged by."""
    flight, horizons = flight_of(), (0.5, 1.0)
    whole = only(predict_flight(flight, KNOWN, 1.0))
    pieces = list(predictions(flight, KNOWN, 1.0, most=7))

    assert len(pieces) == -(-whole.start.size // 7)
    for name in ("start", "first", "last", "begin"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in pieces]), getattr(whole, name))
    np.testing.assert_array_equal(np.concatenate([p.predicted for p in pieces]), whole.predicted)
    one, other = (scores_of(joined([judged(p, p.predicted, horizons) for p in parts], horizons)) for parts in (
        [whole], pieces
    ))  # fmt: skip
    for axis in AXES:
        assert other[axis].fit_percent == pytest.approx(one[axis].fit_percent, rel=1e-12)
        for key, score in one[axis].horizons.items():
            assert vars(other[axis].horizons[key]) == pytest.approx(vars(score), rel=1e-12)


# Causality


def test_later_poses_change_no_prediction_of_z_and_yaw() -> None:
    flight, cut = flight_of(), 10.0
    late = flight.pose_time > cut
    other = replace(flight, position=flight.position + late[:, None] * 3.0, yaw=flight.yaw + late * 1.0)

    one, two = only(predict_flight(flight, KNOWN, 5.0)), only(predict_flight(other, KNOWN, 5.0))
    early = one.start <= cut
    np.testing.assert_array_equal(one.predicted[early], two.predicted[early])
    np.testing.assert_array_equal(one.begin[early], two.begin[early])
    assert (one.predicted[~early, 0] != two.predicted[~early, 0]).any()


def test_without_a_model_of_yaw_the_measured_heading_is_used_and_only_that_of_the_future() -> None:
    flight, cut = flight_of(), 10.0
    late = flight.pose_time > cut
    without = {axis: known for axis, known in KNOWN.items() if axis != "yaw"}
    moved = replace(flight, position=flight.position + late[:, None] * 3.0)
    twisted = replace(flight, yaw=flight.yaw + late * 1.0)

    one, same, other = (only(predict_flight(f, without, 5.0)) for f in (flight, moved, twisted))
    early = one.start <= cut
    np.testing.assert_array_equal(one.predicted[early][:, :, :, :3], same.predicted[early][:, :, :, :3])
    np.testing.assert_array_equal(
        one.heading[early], one.pose[:, 3][one.first[early, None] + np.arange(600)[: one.heading.shape[1]]]
    )
    assert (one.predicted[early, :, 0, 0] != other.predicted[early, :, 0, 0]).any()


def test_later_commands_change_no_prediction_before_they_act() -> None:
    flight, cut = flight_of(), 10.0
    other = replace(flight, command=flight.command + (flight.command_time > cut)[:, None] * 0.5)

    one, two = only(predict_flight(flight, KNOWN, 1.0)), only(predict_flight(other, KNOWN, 1.0))
    before = one.start + 1.0 <= cut + 0.15
    np.testing.assert_array_equal(one.predicted[before], two.predicted[before])


# What is predicted


def test_with_the_true_model_a_quiet_flight_is_predicted_to_a_centimetre() -> None:
    flight = flight_of()
    part = only(predict_flight(flight, KNOWN, 1.0))

    errors = horizon_errors((part,), [part.predicted], 1.0)
    for axis in AXES:
        assert errors[axis].velocity_rmse is not None
        assert errors[axis].velocity_rmse < 0.02


def test_an_axis_without_a_model_is_tracked_and_its_velocity_fades() -> None:
    flight = straight()
    part = only(predict_flight(flight, {}, 5.0))

    np.testing.assert_allclose(part.begin[:, 0, :3], flight.position[part.first - 1], atol=2e-3)
    np.testing.assert_allclose(part.begin[:, 1, :3], np.tile(VELOCITY[:3], (part.start.size, 1)), atol=0.03)
    long = part.last - part.first == part.predicted.shape[1]
    assert (np.abs(part.predicted[long, -1, 1, :3]) < 0.7 * np.abs(VELOCITY[:3])).all()
    assert UNMODELLED.input == 0.0


def test_turning_the_world_turns_the_predictions_and_changes_no_score() -> None:
    flight, angle = flight_of(), 2.1
    parts, other = (predict_flight(f, KNOWN, 1.0) for f in (flight, turned(flight, angle)))

    one, two = (score_predictions(p, [part.predicted for part in p], (1.0,)) for p in (parts, other))
    for axis in AXES:
        a, b = one[axis].horizons["1"], two[axis].horizons["1"]
        assert a.velocity_rmse == pytest.approx(b.velocity_rmse, rel=1e-6)
        assert a.position_rmse == pytest.approx(b.position_rmse, rel=1e-6)


def test_only_wanted_axes_are_predicted() -> None:
    part = only(predict_flight(flight_of(), KNOWN, 1.0, ("z",)))

    assert np.isnan(part.predicted[..., :2]).all()
    assert np.isfinite(part.predicted[0, 0, :, 2]).all()


@pytest.mark.parametrize("axes", [("x", "y"), ("z", "yaw")])
def test_a_flight_that_begins_in_motion_is_predicted_as_well_as_one_that_began_at_rest(axes: tuple[str, str]) -> None:
    """The vehicle's velocity at the first pose decays with its own damping, not with that of the wind."""
    squares = np.zeros((2, 2))
    for seed in range(1, 13):
        for i, span in enumerate(((None, None), (20.0, None))):
            flight = flown(Truth(), steps(seed=seed), 26.0, seed, span=span)
            part = only(predict_flight(flight, KNOWN, 1.0))
            for s in np.flatnonzero((part.start > 22 - 1e-9) & (part.start < 24)):
                run = slice(part.first[s], part.last[s])
                error = part.predicted[s, : part.last[s] - part.first[s], 1] - part.reference[run]
                squares[i] += np.nanmean(error**2, axis=0)[[AXES.index(axis) for axis in axes]]

    ratio = np.sqrt(squares[1] / squares[0])
    assert (ratio < 1.15).all(), ratio


# Baselines


def test_holding_the_velocity_is_exact_at_constant_velocity() -> None:
    flight = straight()
    parts = predict_flight(flight, {axis: replace(UNMODELLED, levels=(1e-6, 1e-8, 0.02, 1.0)) for axis in AXES}, 5.0)

    scores = score_predictions(parts, [hold_velocity(part) for part in parts], (1.0, 5.0))
    for axis in ("x", "y", "z"):
        for key in ("1", "5"):
            found = scores[axis].horizons[key]
            assert found.velocity_rmse == pytest.approx(0.0, abs=2e-3)
            assert found.position_rmse == pytest.approx(0.0, abs=1e-2)


def test_holding_starts_from_the_filters_state_and_goes_straight_on() -> None:
    part = only(predict_flight(flight_of(), KNOWN, 1.0))

    held = hold_velocity(part)
    s = 7
    elapsed = part.time[part.first[s] : part.last[s]] - part.time[part.first[s] - 1]
    expected = part.begin[s, 0] + elapsed[:, None] * part.begin[s, 1]
    np.testing.assert_allclose(held[s, : elapsed.size, 0], expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(held[s, : elapsed.size, 1], np.tile(part.begin[s, 1], (elapsed.size, 1)))


def test_coasting_with_the_true_coefficients_and_no_delay_is_the_true_response_of_the_commands_at_their_stamps() -> (
    None
):
    """A vehicle without delay, trim and wind: the baseline's own world."""
    flight = flown(replace(Truth(), delay=(0.0,) * 4, wind_sigma=(0.0,) * 4, mocap_noise=(1e-5,) * 4), steps(), 15.0)
    known = {axis: replace(d, delay=0.0, levels=(1e-5, 1e-10, 3.0, 0.8)) for axis, d in KNOWN.items()}
    parts = predict_flight(flight, known, 2.0)

    coasted = [free_run_prediction(flight, p, np.array(GAMMA_B[::2]), np.array(GAMMA_B[1::2])) for p in parts]
    errors = horizon_errors(parts, coasted, 2.0)
    for axis in AXES:
        assert errors[axis].position_rmse is not None
        assert errors[axis].position_rmse < 0.01


# Scores by hand


def by_hand_scores(part: Predictions, predicted: Array, horizon: float) -> tuple[Array, Array, int]:
    """Velocity and position RMSE and the number of predictions, the slow way; no holes in the pose."""
    velocity, position = [], []
    for s in range(part.start.size):
        until = part.start[s] + horizon
        steps = [i for i in range(part.first[s], part.last[s]) if part.time[i] <= until + 1e-9]
        if not steps or part.time[-1] < until - 3 * np.median(np.diff(part.time)):
            continue
        for i in steps:
            error = predicted[s, i - part.first[s], 1] - part.reference[i]
            error[:2] = heading_from_world(error[None, :2], part.pose[i : i + 1, 3])[0]
            velocity.append(error)
        end = predicted[s, steps[-1] - part.first[s], 0] - part.pose[steps[-1]]
        end[:2] = heading_from_world(end[None, :2], part.pose[steps[-1] : steps[-1] + 1, 3])[0]
        position.append(end)
    squares = np.array(velocity) ** 2
    return np.sqrt(np.nanmean(squares, axis=0)), np.sqrt(np.mean(np.array(position) ** 2, axis=0)), len(position)


@pytest.mark.parametrize("horizon", [0.5, 1.0, 5.0])
def test_scores_are_what_the_contract_says_the_slow_way(horizon: float) -> None:
    part = only(predict_flight(flight_of(), KNOWN, 5.0))

    velocity, position, n = by_hand_scores(part, part.predicted, horizon)
    for k, axis in enumerate(AXES):
        found = horizon_errors((part,), [part.predicted], horizon)[axis]
        assert found.n == n
        assert found.velocity_rmse == pytest.approx(velocity[k], rel=1e-12)
        assert found.position_rmse == pytest.approx(position[k], rel=1e-12)


def test_horizon_keys_are_short_and_the_fit_is_that_of_one_second() -> None:
    parts = predict_flight(flight_of(), KNOWN, 5.0)

    scores = score_predictions(parts, [part.predicted for part in parts], (0.5, 1.0, 2.5, 5.0))
    for axis in AXES:
        assert list(scores[axis].horizons) == ["0.5", "1", "2.5", "5"]
        assert scores[axis].fit_percent is not None
        assert 80 < scores[axis].fit_percent <= 100


def test_the_fit_percent_of_a_perfect_prediction_is_100_and_of_the_mean_0() -> None:
    part = only(predict_flight(flight_of(), KNOWN, 1.0))
    index = np.minimum(part.first[:, None] + np.arange(part.predicted.shape[1]), part.time.size - 1)
    truth = np.stack([part.pose[index], part.reference[index]], axis=2)

    perfect = score_predictions((part,), [truth], (1.0,))
    for axis in AXES:
        assert perfect[axis].fit_percent == pytest.approx(100.0)
        assert perfect[axis].horizons["1"].position_rmse == 0.0
    used = np.arange(part.predicted.shape[1]) < (part.last - part.first)[:, None]
    whole = used.sum(axis=1) > 110
    mean = truth.copy()
    mean[:, :, 1, 2] = np.nanmean(part.reference[index][whole][used[whole]][:, 2])
    assert score_predictions((part,), [mean], (1.0,))["z"].fit_percent == pytest.approx(0.0, abs=0.5)


def test_fewer_than_five_predictions_give_no_score_but_their_number() -> None:
    flight = flight_of()

    for duration, n in ((4.95, 4), (5.45, 5)):
        cut = replace(flight, segments=(Segment(0.0, duration),))
        parts = predict_flight(cut, KNOWN, 1.0)
        found = horizon_errors(parts, [part.predicted for part in parts], 1.0)["z"]
        assert found.n == n
        assert (found.velocity_rmse is None) == (n < 5)
        assert (found.position_rmse is None) == (n < 5)


def test_predictions_of_all_segments_count_together() -> None:
    flight = flight_of()
    cut = replace(flight, segments=(Segment(0.0, 5.2), Segment(6.0, 11.2)))

    parts = predict_flight(cut, KNOWN, 1.0)
    apart = [horizon_errors((part,), [part.predicted], 1.0)["z"].n for part in parts]
    assert horizon_errors(parts, [part.predicted for part in parts], 1.0)["z"].n == sum(apart) == 10


def test_no_score_crosses_a_hole_of_a_second_in_the_pose_and_shorter_ones_do_no_harm() -> None:
    flight = flight_of()
    for hole, crossed in ((1.1, False), (0.8, True)):
        gone = (flight.pose_time > 8.2) & (flight.pose_time < 8.2 + hole)
        holed = replace(
            flight, pose_time=flight.pose_time[~gone], position=flight.position[~gone], yaw=flight.yaw[~gone]
        )
        part = only(predict_flight(holed, KNOWN, 2.0))
        whole = only(predict_flight(flight, KNOWN, 2.0))
        n, everything = (horizon_errors((p,), [p.predicted], 2.0)["z"].n for p in (part, whole))
        target = whole.start + 2.0
        inside = (target > 8.24) & (target <= 8.21 + hole)  # no pose at the end point
        across = (whole.start < 8.2 + hole) & (target > 8.21 + hole)
        assert across.sum() >= 3
        assert everything - n == inside.sum() + (0 if crossed else across.sum())


def test_the_reference_is_a_local_cubic_that_follows_a_cubic_exactly() -> None:
    t = np.sort(np.random.default_rng(0).random(1500) * 12)
    z = 0.01 * t**3 - 0.1 * t**2 + 0.3 * t
    flight = by_hand(t, np.column_stack([z, 0 * z, 0 * z, 0 * z]), np.arange(0, 12, 0.02), np.zeros((600, 4)))

    part = only(predict_flight(flight, KNOWN, 1.0))
    inside = (part.time > 0.5) & (part.time < 11.5)
    expected = 0.03 * part.time**2 - 0.2 * part.time + 0.3
    np.testing.assert_allclose(part.reference[inside, 0], expected[inside], rtol=0, atol=1e-8)


def test_poses_at_ten_hertz_are_scored_too() -> None:
    flight = flown(replace(Truth(), pose_rate=10.0, pose_jitter=0.003, stale_share=0.0), steps(), 30.0)

    part = only(predict_flight(flight, KNOWN, 1.0))
    found = horizon_errors((part,), [part.predicted], 1.0)["x"]
    assert found.n > 45
    assert found.velocity_rmse is not None
    assert found.velocity_rmse < 0.03
