"""A recorded flight as if live: what is told when, that it holds, and that the end is what the whole flight tells."""

from dataclasses import replace

import numpy as np
import pytest

from flights import STILL, flown, steps, truth_of
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.fitting import fit
from rotorfit.tracking.replayed import growing, tracked, until
from tracked_flights import LAW, LENGTH, QUIET_FROM, TRUTH, known, rested

pytestmark = pytest.mark.flights


def test_at_each_second_only_what_had_come_is_looked_at() -> None:
    flight, track = known()
    times = [state.time for state in track.states]

    assert times == [*np.arange(5.0, LENGTH), pytest.approx(LENGTH, abs=0.1)]
    for part, now in growing(flight, 5.0):
        assert max(part.pose_time[-1], part.command_time[-1], part.segments[-1].end, part.span[1]) <= now
    assert until(flight, 12.5).pose_time.size == np.searchsorted(flight.pose_time, 12.5, side="right")


def test_landing_is_the_fit_of_the_whole_flight_and_the_second_before_is_near() -> None:
    flight, track = known()
    batch = fit([flight], structure=LAW).model.axes
    before, landed = track.states[-2].axes, track.states[-1].axes

    for axis in flight.axes:
        for name in COEFFICIENTS:
            error = batch[axis].stderr[name]
            assert error is not None
            assert landed[axis].values[name] == pytest.approx(getattr(batch[axis], name), abs=1e-3 * error)
            assert before[axis].values[name] == pytest.approx(getattr(batch[axis], name), abs=0.5 * error)
    assert len(track.regimes) == 1
    assert track.regimes[0].model is not None
    assert track.regimes[0].model.axes["x"].input == pytest.approx(batch["x"].input)


@pytest.mark.parametrize("moment", [10.0, 20.0, LENGTH])
def test_intervals_hold_the_truth_at_any_moment_and_are_worth_having(moment: float) -> None:
    _, track = known()
    state = min(track.states, key=lambda one: abs(one.time - moment))
    held, shares = [], []
    for axis, one in state.axes.items():
        for name, true in truth_of(TRUTH, axis).items():
            low, high = one.ci95[name]
            held.append((low is None or low <= true) and (high is None or true <= high))
        value, (low, high) = one.values["input"], one.ci95["input"]
        assert value is not None
        assert low is not None
        assert high is not None
        shares.append((high - low) / value)

    assert len(held) == 12
    assert sum(held) >= 10  # of 95 % intervals; fewer in one of fifty such flights
    assert np.median(shares) < 0.4


def test_nothing_changed_and_nothing_is_raised() -> None:
    assert known()[1].alarms == ()
    assert rested()[1].alarms == ()


def test_without_commands_the_last_values_hold_and_no_interval_narrows() -> None:
    _, track = rested()
    holding = [state for state in track.states[:-1] if state.time > QUIET_FROM + 6.0]
    first = holding[0].axes

    assert len(holding) > 10
    for axis in first:
        for state in holding:
            one = state.axes[axis]
            assert one.knowledge == "holding"
            assert one.state.startswith("holding (no excitation for ")
            assert one.values == first[axis].values
            assert one.ci95 == first[axis].ci95
    words = [state.axes["x"].state for state in holding]
    assert len(set(words)) == len(words)  # they count the seconds


def test_an_axis_is_watched_from_the_first_test_that_could_raise_an_alarm_about_it() -> None:
    flight = flown(STILL, steps(("x", "y", "z"), seed=6), 20.0)
    track = tracked(flight, "first_order_delay")
    watched = {axis: one.watched for axis, one in track.states[-1].axes.items()}

    assert watched["yaw"] is None  # no command moves it
    assert all(12.0 < watched[axis] < 20.0 for axis in ("x", "y", "z"))
    assert all(one.axes["x"].watched is None for one in track.states if one.time < watched["x"])


def test_an_axis_is_not_watched_while_hard_commands_of_x_and_y_leave_it_untested() -> None:
    track = tracked(flown(STILL, steps(amplitude=(0.6, 0.6, 0.2, 0.2), seed=6), 16.0), "first_order_delay")
    axes = track.states[-1].axes

    assert axes["x"].untested == 0
    assert axes["z"].untested > 0.5
    assert axes["z"].untested_in_all > 0.5
    assert axes["x"].watched is not None
    assert axes["z"].watched is None


def test_a_pose_that_jumps_is_told_and_no_motion_leads_across() -> None:
    whole, undisturbed = known()
    flight = until(whole, 14.0)
    late = flight.pose_time > 10.0
    track = tracked(replace(flight, position=flight.position + late[:, None] * [1.0, 0.0, 0.0]), LAW)
    told = [(alarm.cause, alarm.axes, alarm.since) for state in track.states for alarm in state.alarms]

    assert [(cause, axes) for cause, axes, _ in told] == [("pose_jumped", AXES)]
    assert told[0][2][0] <= 10.0 <= told[0][2][1]
    before = next(state for state in undisturbed.states if state.time == 14.0)
    assert track.states[-1].axes["x"].values["input"] == pytest.approx(before.axes["x"].values["input"], rel=0.1)


def test_single_wild_poses_are_left_out_as_of_a_link_and_counted() -> None:
    flight, track = known()
    rng = np.random.default_rng(1)
    at = rng.choice(np.arange(200, flight.pose_time.size - 200), 12, replace=False)
    position = flight.position.copy()
    position[at] += rng.normal(0.0, 1.5, (12, 3))
    wild = tracked(replace(flight, position=position), LAW)
    model = wild.regimes[0].model
    assert model is not None

    assert [note.count for note in model.flights[0].notes if note.code == "wild_poses"] == [12]
    assert not any(state.alarms for state in wild.states)
    for axis in flight.axes:
        for name in COEFFICIENTS:
            (low, high), value = track.states[-1].axes[axis].ci95[name], wild.states[-1].axes[axis].values[name]
            assert low is not None
            assert high is not None
            assert value == pytest.approx(track.states[-1].axes[axis].values[name], abs=0.05 * (high - low))


def landed_on_the_way() -> Flight:
    """A flight that sinks onto a ground at about 22 s, stands, and takes off at 28 s."""
    moving = steps(seed=5)

    def commanded(t: Array) -> Array:
        asked = np.where(((t < 19.0) | (t > 29.0))[:, None], moving(t), 0.0)
        asked[:, 2] += np.where((t > 19.0) & (t < 22.0), -0.4, 0.0) + np.where((t > 28.0) & (t < 29.0), 0.4, 0.0)
        return asked

    flight = flown(TRUTH, commanded, 36.0, seed=5)
    time, rng = flight.pose_time, np.random.default_rng(5)
    stands = (time > 21.9) & (time < 28.0)
    down, up = (int(np.flatnonzero(stands)[k]) for k in (0, -1))
    position, yaw = flight.position.copy(), flight.yaw.copy()
    for each in (position, yaw):
        each[up:] += each[down] - each[up]
        each[stands] = each[down] + rng.normal(0, 0.0005, each[stands].shape)
    return replace(flight, position=position, yaw=yaw)


def test_of_a_log_a_landing_on_the_way_is_no_change_and_does_not_spoil_what_is_learnt() -> None:
    track = tracked(landed_on_the_way(), LAW, 0.1)

    assert track.alarms == ()
    assert len(track.regimes) == 1
    for name, true in truth_of(TRUTH, "z").items():
        low, high = track.states[-1].axes["z"].ci95[name]
        assert low is not None
        assert high is not None
        assert low < true < high
