"""What the likelihood sees of a flight: scored poses, blocks, commands, frame."""

from dataclasses import replace

import numpy as np
import pytest

from flights import by_hand, flown, steps, turned
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES
from rotorfit.core.laws import DELAY_RANGE, start_levels
from rotorfit.estimation.likelihood import stretches
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE, Record, record
from rotorfit.estimation.likelihood.fisher_scoring import approached, maximise
from rotorfit.estimation.likelihood.law_search import thinned_record
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.simulation.paper_vehicle import Truth


def whole(flight: Flight, axes: tuple[str, ...]) -> Record:
    rec = record(flight, axes)
    assert rec is not None
    return rec


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown(Truth(), steps(), 12.0)


def test_only_poses_whose_delayed_commands_are_known_for_every_delay_are_scored(flight: Flight) -> None:
    rec = whole(flight, ("z",))

    (segment,) = flight.segments
    assert rec.starts[0] == segment.start + DELAY_RANGE[1]
    assert rec.pose_time[0] >= segment.start + DELAY_RANGE[1]
    assert rec.pose_time[-1] <= segment.end + DELAY_RANGE[0]
    earlier = flight.pose_time[flight.pose_time < rec.pose_time[0]]
    assert earlier[-1] < segment.start + DELAY_RANGE[1]


@pytest.mark.parametrize("begun", [0.0, 0.3, 2.0])
def test_a_vehicle_at_rest_that_its_first_command_moves_was_commanded_nothing_before(begun: float) -> None:
    """Elsewhere, under way or in a hover in wind, the first command counts as held before."""
    t = np.arange(0.0, 8.0, 0.01)
    pose = np.zeros((t.size, 4))
    pose[:, 2] = np.where(t < begun, 0.0, 0.5 * (t - begun))
    rec = whole(by_hand(t, pose, t[::10], np.full((80, 4), 0.4)), ("z",))

    time, command, ((first, last),) = rec.switches
    assert command[first:last, 0].tolist() == ([0.0, 0.4] if begun == 0.3 else [0.4])
    assert (time[first:last] == 0.0).all()


def test_blocks_are_means_of_about_a_thirtieth_of_a_second(flight: Flight) -> None:
    rec = whole(flight, ("z",))

    assert rec.count.sum() == rec.pose_time.size
    assert np.median(rec.count) == round(120 / BLOCK_RATE)
    assert np.median(np.diff(rec.block_time)) == pytest.approx(1 / BLOCK_RATE, rel=0.02)
    b = 37
    mine = rec.block == b
    z = flight.position[np.isin(flight.pose_time, rec.pose_time[mine]), 2]
    first = flight.position[np.isin(flight.pose_time, rec.pose_time[rec.block == 0]), 2]
    assert rec.position[b, 0] == pytest.approx(z.mean() - first.mean(), abs=1e-15)
    assert rec.block_time[b] == pytest.approx(rec.pose_time[mine].mean(), abs=1e-12)


def test_poses_slower_than_the_blocks_stand_alone() -> None:
    rec = whole(flown(replace(Truth(), pose_rate=10.0, pose_jitter=0.002, stale_share=0.0), steps(), 12.0), ("z",))

    np.testing.assert_array_equal(rec.count, 1.0)
    np.testing.assert_array_equal(rec.block_time, rec.pose_time)


def test_each_segment_starts_anew_with_its_own_commands(flight: Flight) -> None:
    parts = (Segment(0.0, 5.0), Segment(6.0, flight.segments[0].end))
    rec = whole(replace(flight, segments=parts), ("z",))

    assert rec.starts.tolist() == [p.start + DELAY_RANGE[1] for p in parts]
    assert np.flatnonzero(rec.fresh).tolist() == [0, rec.block[rec.pose_range[1, 0]]]
    for (first, last), (begin, end), part in zip(rec.command_range, rec.pose_range, parts, strict=True):
        assert part.start <= rec.command_time[first] <= part.start + 0.025
        assert rec.command_time[last - 1] < part.end
        assert part.start < rec.pose_time[begin] <= rec.pose_time[end - 1] < part.end
        assert rec.position[rec.block[begin], 0] == 0.0
    assert not set(rec.block[: rec.pose_range[0, 1]]) & set(rec.block[rec.pose_range[1, 0] :])


def test_segments_too_short_to_score_are_left_out_and_a_flight_of_only_those_is_none(flight: Flight) -> None:
    short, long = Segment(0.0, 0.7), Segment(1.0, 8.0)

    rec = whole(replace(flight, segments=(short, long)), ("z",))
    assert rec.starts.tolist() == [1.0 + DELAY_RANGE[1]]
    assert record(replace(flight, segments=(short,)), ("z",)) is None


def test_yaw_and_z_are_scored_whatever_the_heading_and_x_with_y_only_as_one_where_it_turns(flight: Flight) -> None:
    assert np.ptp(flight.yaw) > np.radians(30)

    assert whole(flight, ("z",)).held
    assert whole(flight, ("yaw",)).held
    assert not whole(flight, ("x", "y")).held
    assert whole(replace(flight, yaw=0.05 * np.sin(flight.pose_time)), ("x", "y")).held


def test_the_pair_is_in_the_world_and_one_of_them_along_the_mean_heading() -> None:
    t = np.arange(0, 6, 0.01)
    pose = np.column_stack([np.sin(t), np.cos(2 * t), 0 * t, 0 * t])
    still = by_hand(t, pose, t[::10], np.zeros((60, 4)))
    other = turned(still, 1.1)

    pair, turned_pair = whole(still, ("x", "y")), whole(other, ("x", "y"))
    assert turned_pair.heading == pytest.approx(1.1)
    c, s = np.cos(1.1), np.sin(1.1)
    np.testing.assert_allclose(turned_pair.position, pair.position @ np.array([[c, s], [-s, c]]), atol=1e-12)
    for axis, k in (("x", 0), ("y", 1)):
        np.testing.assert_allclose(whole(other, (axis,)).position[:, 0], pair.position[:, k], atol=1e-12)


def test_one_axis_of_a_pair_keeps_its_own_commands(flight: Flight) -> None:
    pair = whole(flight, ("x", "y"))

    for k, axis in enumerate(("x", "y")):
        only = pair.only(k)
        assert only.axes == (axis,)
        np.testing.assert_array_equal(only.command[:, 0], flight.command[:, AXES.index(axis)])
        assert only.position is pair.position


def test_at_an_infinite_rate_every_pose_is_a_block_of_its_own() -> None:
    flight = flown(Truth(), steps(("z",)), 10.0, 1)

    every = record(flight, ("z",), np.inf)
    assert every is not None
    assert (every.count == 1).all()
    np.testing.assert_array_equal(every.block_time, every.pose_time)


def test_a_long_record_is_searched_in_stretches_with_the_commands_that_act_in_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rec = whole(flown(Truth(), steps(), 60.0), ("x", "y"))
    everything = thinned_record(rec)
    monkeypatch.setattr(stretches, "SEARCHED", 12.0)
    monkeypatch.setattr(stretches, "STRETCH", 3.0)
    some = thinned_record(rec)

    assert everything.starts.size == 1
    assert some.starts.size == some.fresh.sum() == len(some.pose_range) == len(some.command_range) == 4
    for number, (first, last) in enumerate(some.pose_range):
        assert 2.5 < some.block_time[last - 1] - some.block_time[first] < 3.0
        same = np.isin(everything.block_time, some.block_time[first:last])
        moved = everything.position[same]
        np.testing.assert_array_equal(some.position[first:last], moved - moved[0])
        low, high = some.command_range[number]
        assert some.command_time[low] <= max(some.starts[number] - DELAY_RANGE[1], some.command_time[0])
        assert some.command_time[high - 1] <= some.block_time[last - 1] - DELAY_RANGE[0]


def test_stretches_of_a_record_keep_its_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    rec = whole(flown(Truth(), steps(), 60.0), ("x", "y"))
    assert stretches.stretches(rec) is rec
    monkeypatch.setattr(stretches, "SEARCHED", 12.0)
    monkeypatch.setattr(stretches, "STRETCH", 3.0)
    some = stretches.stretches(rec)

    np.testing.assert_array_equal(np.bincount(some.block), some.count)
    np.testing.assert_allclose(np.bincount(some.block, some.pose_time) / some.count, some.block_time, rtol=1e-12)
    assert np.isin(some.pose_time, rec.pose_time).all()
    assert some.pose_range[:, 0].tolist() == [0, *some.pose_range[:-1, 1]]
    assert some.pose_range[-1, 1] == some.pose_time.size
    np.testing.assert_array_equal(some.starts, some.pose_time[some.pose_range[:, 0]])


def test_a_climb_over_a_long_flight_may_begin_on_stretches_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    records = [whole(flown(Truth(), steps(("z",)), 60.0), ("z",))]
    start = start_point(records, 0.3, 4.0, start_levels("position")[None])
    free = free_of(records, [True])
    assert approached(records, start, free) is start
    monkeypatch.setattr(stretches, "SEARCHED", 24.0)
    monkeypatch.setattr(stretches, "STRETCH", 8.0)
    begun, top = approached(records, start, free), maximise(records, start, free)

    np.testing.assert_array_equal(begun.start, start.start)
    error = np.sqrt(np.diag(top.covariance))[:3]
    assert (np.abs(begun.flat() - top.point.flat())[:3] < 6 * error).all()
    assert (np.abs(start.flat() - top.point.flat())[:3] > 6 * error).all()
