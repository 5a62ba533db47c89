import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying import SECOND, plan_of
from rotorfit.core.limits import GRAVITY
from rotorfit.core.log import Sample
from rotorfit.flying.guard import FILTER, SERVO, Limits, Watch, judged, limits_of, observed, room_left, stop_point

BOX = Limits(
    lower=(-2.0, -2.0, 0.5), upper=(2.0, 2.0, 3.0), speed=3.0, climb=2.0,
    reaction=(0.3, 0.3, 0.4), deceleration=(2.0, 1.5, math.inf), duration=60.0,
)  # fmt: skip


def pose(t: float, x: float = 0.0, y: float = 0.0, z: float = 1.5, yaw: float = 0.0) -> Sample:
    stamp = round(t * SECOND)
    return Sample("pose", stamp, stamp, (x, y, z, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))


def watched(*samples: Sample, limits: Limits = BOX) -> Watch:
    watch = Watch()
    for sample in samples:
        watch, _ = observed(watch, sample, limits)
    return watch


def verdict(watch: Watch, t: float, flown: float = 1.0, moving: float = 1.0, limits: Limits = BOX) -> str | None:
    told = judged(watch, limits, round(t * SECOND), flown, moving)
    return told and told.code


def moving_at(x: float, y: float, z: float, vx: float, vy: float, vz: float) -> Watch:
    return replace(watched(pose(10.0, x, y, z)), velocity=(vx, vy, vz, 0.0))


inside = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.5, 3))
speeds = st.tuples(*[st.floats(-2, 2)] * 3)


@given(inside, speeds)
def test_what_the_fence_lets_pass_can_still_stop_inside(place: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    """By a second method: a vehicle that keeps its velocity until the order acts, then brakes, in steps of 1 ms."""
    if judged(moving_at(*place, *velocity), BOX, 10 * SECOND, 1.0, 1.0) is not None:
        return
    for k in range(3):
        at, v = place[k], velocity[k]
        for step in range(4000):
            if step * 1e-3 >= BOX.reaction[k]:
                v = math.copysign(max(0.0, abs(v) - BOX.deceleration[k] * 1e-3), v)
            at += v * 1e-3
            assert BOX.lower[k] - 0.005 <= at <= BOX.upper[k] + 0.005


@given(st.integers(0, 2**32 - 1), st.floats(0, 0.003), st.floats(0, 0.5), st.floats(25, 200))
def test_a_vehicle_at_rest_in_the_middle_is_left_alone(seed: int, noise: float, stale: float, rate: float) -> None:
    rng, watch, last = np.random.default_rng(seed), Watch(), pose(0.0)
    for number in range(1, 300):
        t = number / rate
        shown = pose(t, *noise * rng.standard_normal(2), 1.5 + noise * rng.standard_normal())
        last = replace(last, stamp=shown.stamp, received=shown.received) if rng.random() < stale else shown
        watch, _ = observed(watch, last, BOX)
        assert verdict(watch, t + 0.5 / rate, flown=t, moving=t) in (None, "pose_frozen" if noise == 0 else None)


def test_a_vehicle_that_flies_at_a_wall_is_stopped_in_time_by_the_measured_velocity() -> None:
    watch, x, v, ordered, t = Watch(), 0.0, 1.2, None, 0.0
    while v > 0:
        t += 0.01
        if ordered is not None and t > ordered + BOX.reaction[0] - FILTER:
            v -= BOX.deceleration[0] * 0.01
        x += v * 0.01
        watch, _ = observed(watch, pose(t, x), BOX)
        if ordered is None and verdict(watch, t) == "fence":
            ordered = t
    assert ordered is not None
    assert 1.6 < x < 2.0


@pytest.mark.parametrize("wall", [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)])
def test_beyond_each_wall_is_beyond(wall: tuple[int, int]) -> None:
    axis, side = wall
    place = [0.0, 0.0, 1.5]
    place[axis] = (BOX.upper if side > 0 else BOX.lower)[axis] + side * 0.01
    told = judged(moving_at(*place, 0.0, 0.0, 0.0), BOX, 10 * SECOND, 1.0, 1.0)
    assert told is not None
    assert told.code == "fence"
    assert f"{'xyz'[axis]} is {place[axis]:.2f} m" in told.text


def test_the_pose_grows_older_towards_the_wall() -> None:
    watch = moving_at(1.0, 0.0, 1.5, 1.0, 0.0, 0.0)

    assert room_left(watch, BOX, 10 * SECOND) == pytest.approx(2.0 - (1.0 + 0.3 + 0.25))
    assert stop_point(watch, BOX, round(10.2 * SECOND)) == pytest.approx((1.75, 0.0, 1.5))
    assert stop_point(Watch(), BOX, 0) is None


def test_one_jumped_pose_is_left_out_and_ends_nothing() -> None:
    flight = [pose(0.01 * k, 0.001 * k) for k in range(100)]
    flight[50] = pose(0.5, 1.8, 1.5, 2.0, 3.0)
    watch = Watch()
    for sample in flight:
        watch, believed = observed(watch, sample, BOX)
        assert believed == (sample is not flight[50])
        assert verdict(watch, sample.stamp / SECOND) is None
        assert abs(watch.velocity[0]) < 0.11
    assert watch.outliers == 1


@pytest.mark.parametrize("bad", [pose(0.0, 1.8, 1.5, 2.0), pose(0.0, yaw=3.0), pose(0.0, float("nan"))])
def test_several_poses_that_cannot_be_true_end_the_flight(bad: Sample) -> None:
    watch = watched(*[pose(0.01 * k, 1e-4 * k) for k in range(50)])
    told = []
    for k in range(50, 60):
        values = (bad.values[0] + 1e-4 * k, *bad.values[1:])
        watch, _ = observed(
            watch, replace(bad, stamp=k * SECOND // 100, received=k * SECOND // 100, values=values), BOX
        )
        told.append(verdict(watch, k / 100))
    assert told[:4] == [None] * 4
    assert told[4] == "pose_jumps"


@pytest.mark.parametrize("by", [{"yaw": 1.7}, {"yaw": 3.1}, {"x": 1.5}])
def test_a_jump_that_lasts_ends_the_flight_at_ten_poses_a_second_too(by: dict[str, float]) -> None:
    watch = watched(*[pose(0.1 * k, 1e-3 * k) for k in range(30)])
    told = []
    for k in range(30, 36):
        watch, _ = observed(watch, pose(0.1 * k, by.get("x", 0.0) + 1e-3 * k, yaw=by.get("yaw", 0.0)), BOX)
        told.append(verdict(watch, 0.1 * k))
    assert told[4] == "pose_jumps"


def test_swaps_that_come_back_again_and_again_end_the_flight_too() -> None:
    watch, ended = Watch(), None
    for k in range(60):
        watch, _ = observed(watch, pose(0.01 * k, 1.5 * (k % 2) + 1e-4 * k), BOX)
        ended = ended or verdict(watch, 0.01 * k)
    assert ended == "pose_jumps"


def test_a_turn_through_half_a_circle_is_no_jump() -> None:
    watch = watched(*[pose(0.01 * k, yaw=math.remainder(0.02 * k, math.tau)) for k in range(400)])

    assert watch.outliers == 0
    assert watch.pose is not None
    assert watch.pose[3] == pytest.approx(7.98)
    assert watch.velocity[3] == pytest.approx(2.0, rel=0.01)


def test_a_pose_that_stays_away_is_lost_after_half_a_second() -> None:
    watch = watched(*[pose(0.01 * k, 1e-5 * k) for k in range(100)])

    assert verdict(watch, 0.99 + 0.49) is None
    assert verdict(watch, 0.99 + 0.51) == "pose_lost"
    assert verdict(Watch(), 1.0) == "pose_lost"
    assert verdict(Watch(), 0.4) is None


def test_when_everything_stays_away_it_is_the_link() -> None:
    watch = watched(*[pose(0.01 * k, 1e-5 * k) for k in range(100)], Sample("battery", 0, 0, (0.9,)))

    told = judged(watch, BOX, 2 * SECOND, 2.0, 2.0)
    assert told is not None
    assert told.code == "link_lost"
    assert told.text == "the link: nothing has come for 1.01 s"


def test_a_pose_that_repeats_is_frozen_only_while_the_vehicle_is_asked_to_move() -> None:
    still = [pose(0.01 * k) for k in range(200)]
    watch = watched(pose(-0.01, 0.5), *still)

    assert verdict(watch, 1.99, moving=1.5) == "pose_frozen"
    assert verdict(watch, 1.99, moving=0.5) is None


def test_a_clock_of_the_poses_that_jumps_back_is_named() -> None:
    watch = watched(*[pose(0.01 * k, 1e-5 * k) for k in range(100)])
    for k in range(100, 205):
        watch, believed = observed(watch, replace(pose(0.01 * k, 1e-5 * k), stamp=(k - 3000) * SECOND // 100), BOX)
        assert not believed

    told = judged(watch, BOX, watch.heard, 2.0, 2.0)
    assert told is not None
    assert told.code == "pose_frozen"
    assert told.text == "the clock of the poses jumped back by 28.95 s: none is newer for 1.05 s"


def test_speed_climb_battery_and_duration_each_have_their_limit() -> None:
    fine = moving_at(0.0, 0.0, 1.5, 0.0, 0.0, 0.0)
    wide = replace(BOX, lower=(-99.0,) * 3, upper=(99.0,) * 3)

    assert verdict(fine, 10.0) is None
    assert verdict(replace(fine, velocity=(2.2, 2.2, 0.0, 0.0)), 10.0, limits=wide) == "speed"
    assert verdict(replace(fine, velocity=(0.0, 0.0, -2.1, 0.0)), 10.0, limits=wide) == "climb"
    assert verdict(replace(fine, battery=0.1), 10.0) == "battery"
    assert verdict(fine, 10.0, flown=121.0) == "too_long"


def test_braking_follows_the_belief() -> None:
    plan = plan_of()
    believed = replace(plan, belief={"gamma": [4.0, 0.2, 5.0, 0.4, 4.0, 2.0, 5.0, 3.0], "delay": [0.2, 0.1, 0.3, 0.1]})
    limits = limits_of(believed)

    assert limits.deceleration == (2.0, 2.0, math.inf)  # turned, it brakes along the world's y as along its own x
    assert limits.reaction == pytest.approx((0.2 + FILTER, 0.2 + FILTER, 0.3 + 0.5 + FILTER))
    assert SERVO < 2.0
    unknown = limits_of(replace(plan, belief={}))
    tilt = plan.card["limits"]["tilt"]
    assert unknown.deceleration == pytest.approx((GRAVITY * math.tan(tilt) / 2,) * 2 + (math.inf,))
