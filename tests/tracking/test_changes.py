"""The test for a change: silent in noise of any colour, and found where coefficients move; then the room's changes."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.limits import GRAVITY
from rotorfit.core.tracked import Alarm
from rotorfit.tracking.change_watch import GLANCE
from rotorfit.tracking.changes import (
    Contrast,
    at_once,
    calm,
    contrast,
    earliest,
    in_any_air,
    likeliest,
    looked_together,
    looks,
    pushes,
)
from rotorfit.tracking.following import SHORT, Following
from rotorfit.tracking.instant import changed_when
from rotorfit.tracking.refits import applied, refitted
from rotorfit.tracking.replayed import growing, until
from rotorfit.tracking.scores import FADES, GUST_POWERS, WINDOWS, Scores, scores_of
from tracked_flights import LAW, alarms, changing_flight, known_flight, of_a_pilot

pytestmark = pytest.mark.flights

Array = np.ndarray


@pytest.fixture(scope="module")
def scores() -> Scores:
    """Those of z, 30 s."""
    followed = refitted(known_flight(), ("z",), LAW, 30.0)
    return scores_of([(list(followed.estimates.items()), {})])[0]


def looked_at(scores: Scores) -> list[Contrast]:
    """The contrasts of a look at one likelihood."""
    return looked_together([scores])[0][scores.names]


def least(scores: Scores) -> float:
    """The smallest p-value of a look, times how many were looked at."""
    return min((one.p_value for one in looked_at(scores)), default=1.0) * looks(scores)


@pytest.mark.parametrize("colour", [0.0, 0.5])
def test_noise_alone_alarms_no_more_often_than_was_promised(scores: Scores, colour: float) -> None:
    rng, found = np.random.default_rng(7), []
    for _ in range(100):
        noise = rng.standard_normal(scores.time.size)
        for i in range(1, noise.size):
            noise[i] += colour * noise[i - 1]
        found.append(least(replace(scores, innovation=noise)))

    assert sum(p < 0.05 for p in found) <= 12  # 5 are promised at the most
    assert min(found) > 1e-4


def test_coefficients_that_move_are_found_with_their_sign_and_their_time(scores: Scores) -> None:
    begun = float(scores.time[-1]) - 6.0
    moved = scores.names.index("z.input")
    innovation = np.random.default_rng(3).standard_normal(scores.time.size)
    innovation[scores.time >= begun] -= scores.tested[scores.time >= begun, moved]  # by 0.3 of the logarithm, downwards
    changed = replace(scores, innovation=innovation)
    first = min(looked_at(changed), key=lambda one: one.p_value)
    best = likeliest(changed, first, looked_at(changed))
    _, (low, high) = changed_when(changed, begun - 3.0)

    assert first.p_value * looks(changed) < 1e-6
    assert low <= begun <= high
    assert best.shift[moved] == pytest.approx(-1.0, abs=0.4)


def test_a_change_in_a_pause_of_the_log_is_dated_within_it_and_the_air_before_it_is_that_of_the_flight(
    scores: Scores,
) -> None:
    begun, moved = float(scores.time[-1]) - 4.0, scores.names.index("z.input")
    after = scores.time >= begun
    innovation = np.random.default_rng(3).standard_normal(scores.time.size) - scores.tested[:, moved] * after
    paused = replace(scores, time=scores.time + 60.0 * after, innovation=innovation)
    first = min(looked_at(paused), key=lambda one: one.p_value)
    _, (low, high) = changed_when(paused, earliest(paused, first))

    assert begun - 2.0 < low < begun + 2.0
    assert begun + 58.0 < high < begun + 62.0
    assert calm(paused, low, first.since, first.p_value)


def test_a_push_is_as_rare_as_under_the_strengths_that_the_air_allows(scores: Scores) -> None:
    """Under stronger gusts the same push explains less: here the whitened rows shrink by the root of the power."""
    innovation = np.random.default_rng(3).standard_normal(scores.time.size)
    late, trim = scores.time >= float(scores.time[-1]) - 1.5, scores.names.index("z.trim")
    pushed = replace(scores, innovation=innovation + 2.5 * scores.tested[:, trim] * late, jolts=scores.jolts[:, :0])
    under = []
    for root in (1.0, *np.sqrt(GUST_POWERS)):
        shrunk = {name: getattr(pushed, name) / root for name in ("tested", "free")}
        noise = innovation + (pushed.innovation - innovation) / root
        under.append(replace(pushed, innovation=noise, **shrunk))

    def average(air: Array) -> float:
        return in_any_air(scores.names, [[replace(each, air=air)] for each in under], SHORT)

    calm, doubtful, strong = (average(-np.abs(np.arange(8) - k) * by) for k, by in ((0, 50.0), (0, 1.0), (7, 50.0)))
    one = next(each for each in looked_at(pushed) if pushes(scores.names, each))
    assert calm < 1e-6 * doubtful < 1e-6 * strong
    assert pushes(scores.names, one)
    assert not pushes(scores.names, replace(one, shift=np.where(np.arange(one.shift.size) == trim, 0.0, 1.0)))


FRONT = 24.0
"""When the wind comes up, or the height is pushed [s]."""


@functools.cache
def seen_after(wind: float, push: float, after: float) -> tuple[float, float]:
    """The least p-value of x and y, and that of a push of z in any air, some time after `FRONT` [s].

    Args:
        wind: Acceleration of x by wind that comes up within half a second; half as much of y, gusts besides [m/s^2].
        push: First acceleration of z, which fades [m/s^2].
        after: The time [s].
    """
    flight, rng = known_flight(), np.random.default_rng(1)
    learnt = [refitted(until(flight, FRONT), axes, LAW, FRONT) for axes in (("x", "y"), ("z",))]
    t, gust, velocity, moved = flight.pose_time, np.zeros(2), np.zeros(3), np.zeros_like(flight.position)
    for i, h in enumerate(np.diff(t), 1):
        gust += -h * gust + np.sqrt(2 * h) * rng.standard_normal(2)
        risen = wind * np.clip((t[i] - FRONT) / 0.5, 0, 1) * (1 + 0.6 * gust) * (1.0, 0.5)
        pushed = push * np.exp(-(t[i] - FRONT) / FADES) * (t[i] >= FRONT)
        velocity += h * (np.append(risen, pushed) - (0.2, 0.2, 2.0) * velocity)
        moved[i] = moved[i - 1] + h * velocity
    flight = until(replace(flight, position=flight.position + moved), FRONT + after)
    parts = [(list(applied(one, flight).estimates.items()), {}) for one in learnt]
    level, height = scores_of(parts)
    under = [scores_of(parts, gusts=k) for k in range(1 + len(GUST_POWERS))]
    found = looked_together([level, height])[0][level.names]
    return min((one.p_value for one in found), default=1.0), in_any_air(height.names, under, WINDOWS)


@pytest.mark.parametrize("after", [0.75, 1.0])
def test_wind_that_comes_up_at_once_is_no_change_and_may_push_the_height(after: float) -> None:
    """The strength of its gusts is heard in a window of x and y, and by z, before three calm seconds have passed."""
    level, height = seen_after(0.8, 0.6, after)

    assert level > 1e-3
    assert height > 1e-4


def test_a_push_in_calm_air_is_a_change() -> None:
    assert seen_after(0.0, 0.6, 0.75)[1] < 1e-9


def test_an_answer_to_first_commands_is_no_jolt_but_a_jolt_before_any_command_is(scores: Scores) -> None:
    """An axis that has hardly been commanded obeys coefficients that nobody knows yet."""
    noise, at = np.random.default_rng(5).standard_normal(scores.time.size), float(scores.time[-1]) - 1.5
    trim, begun = scores.names.index("z.trim"), (scores.time > at)[:, None]
    answers = scores.tested * (np.arange(len(scores.names)) != trim)
    first = replace(scores, tested=np.where(begun, answers, 0.0) + (scores.tested - answers))
    never, push = replace(scores, tested=scores.tested - answers), scores.pushed(at, np.array([FADES]))[0]

    def jolt(scores: Scores, innovation: Array) -> float:
        found = looked_at(replace(scores, innovation=innovation))
        return min((one.p_value for one in found if one.jolt), default=1.0)

    assert jolt(first, noise + 5.0 * answers[:, scores.names.index("z.input")] * begun[:, 0]) > 1e-3
    assert jolt(never, noise + 2.0 * push) < 1e-8


def test_a_gap_in_the_poses_a_moment_ago_is_no_jolt(scores: Scores) -> None:
    now = float(scores.time[-1])
    kept = (scores.time < now - 4.0) | (scores.time > now - 0.5)
    part = {name: getattr(scores, name)[kept] for name in ("time", "innovation", "tested", "free", "jolts", "density")}

    assert looked_at(replace(scores, **part)) == []


def test_a_wrong_pose_that_came_last_is_no_jolt(scores: Scores) -> None:
    innovation = np.random.default_rng(7).standard_normal(scores.time.size)

    def surest(blocks: int) -> float:
        off = 15.0 * (np.arange(innovation.size)[::-1] < blocks)
        return min(
            (one.p_value for one in looked_at(replace(scores, innovation=innovation + off)) if one.jolt), default=1.0
        )

    assert surest(1) == 1.0
    assert surest(8) < 1e-9


def test_a_factor_on_the_gains_of_all_axes_is_found_where_each_alone_shows_little(scores: Scores) -> None:
    rng, now = np.random.default_rng(13), float(scores.time[-1])

    def answering(axis: str) -> Scores:
        names = tuple(name.replace("z.", f"{axis}.") for name in scores.names)
        return replace(scores, names=names, jolts=scores.jolts[:, :0])

    rarest = []
    for _ in range(10):
        each = []
        for one in (answering("z"), answering("yaw")):
            less = one.tested[:, [name.endswith(".input") for name in one.names]][:, 0] * (one.time > now - 4.0)
            each.append(replace(one, innovation=rng.standard_normal(one.time.size) - less))
        looked = [looked_together(scored, (4.0,))[0] for scored in (each, [each[0]], [each[1]])]
        rarest.append([min(one.p_value for of in look.values() for one in of) for look in looked])
    both, *alone = np.median(rarest, axis=0)

    assert both < 0.01 * min(alone)


def test_an_axis_that_stays_tells_of_it_by_no_more_than_chance(scores: Scores) -> None:
    """Its window since the change counts, however small, not the one that stands out; or the jolt that is nearest."""
    rng, told = np.random.default_rng(5), []
    for _ in range(40):
        noise = replace(scores, innovation=rng.standard_normal(scores.time.size))
        change = contrast(noise, float(scores.time[-1]) - 1.5)
        assert change is not None
        near, far = (replace(change, since=change.since + late, jolt=True) for late in (0.1, 0.3))
        stands_out = replace(far, statistic=1e3, p_value=1e-9)
        same = at_once(noise, [stands_out, near, *looked_at(noise)], change)
        assert same is not None
        assert (same.since, same.statistic, same.jolt) == (change.since, change.statistic, False)
        assert at_once(noise, [stands_out, near], replace(change, jolt=True)) is near
        told.append(change.statistic / change.directions)

    assert 0.4 < np.mean(told) < 1.4


@pytest.mark.parametrize(
    ("cause", "vehicle", "named", "axes"),
    [
        ("limits", "bebop2", "limits", {"x", "y"}),
        ("delay", "bebop2", "delay", {"x", "y", "z", "yaw"}),  # at least those that tell it by then
        ("picked_up", "tello", "payload", {"z"}),
        ("picked_up", "bebop2", "payload", {"x", "y", "z"}),  # drag over mass: x and y have another damping
    ],
)
def test_a_change_of_the_room_is_found_and_named(cause: str, vehicle: str, named: str, axes: set[str]) -> None:
    first, alarm = alarms(cause, vehicle, at=30.0)

    assert alarm.revises == first.time
    assert 30.0 < alarm.raised == first.time <= 34.0
    assert alarm.time == first.time + 1.0
    assert alarm.cause == named
    assert {"x", "y"} & axes <= set(alarm.axes) <= axes
    assert alarm.since[0] - 1.5 <= 30.0 <= alarm.since[1] + 1.5
    assert alarm.confidence > 0.5
    assert {name.split(".")[0] for name in alarm.change} == ({"z"} if named == "payload" else set(alarm.axes))
    if named == "delay":
        assert all(low < 0.05 < high + 0.01 for low, high in alarm.change.values())
    if named == "payload":
        low, high = alarm.change["z.trim"]
        assert low < GRAVITY / 1.15 - GRAVITY < high
    if named == "limits":
        low, high = alarm.change["x.input"]
        assert low < np.tan(np.radians(15)) / np.tan(np.radians(10)) < high


def test_wind_that_rises_is_no_changed_vehicle() -> None:
    assert alarms("wind", "bebop2", at=30.0) == []


def test_a_vehicle_that_brakes_where_its_pilot_lets_go_is_no_changed_vehicle() -> None:
    assert of_a_pilot(700_000, 20.0) == ()


def test_a_delay_that_axes_share_is_found_where_each_answers_in_a_few_seconds_only(scores: Scores) -> None:
    def answering(axis: str, seconds: set[int]) -> Scores:
        heard = np.isin(np.floor(scores.time), list(seconds)) | (scores.time > now - 4.0)
        return replace(
            scores,
            names=tuple(name.replace("z.", f"{axis}.") for name in scores.names),
            tested=scores.tested * heard[:, None],
            jolts=scores.jolts[:, :0],
        )

    def rarest(late: float, count: int) -> list[tuple[float, float]]:
        """Smallest p-values of a look at both axes, and at each alone, with a step of the delay 4 s before the end."""
        rng, least = np.random.default_rng(11), []
        for _ in range(count):
            each = []
            for one in axes:
                step = one.tested[:, one.names.index(f"{one.names[0].split('.')[0]}.delay")] * (one.time > now - 4.0)
                each.append(replace(one, innovation=rng.standard_normal(one.time.size) + late * step))
            both = looked_together(each, (4.0,))[0].values()
            alone = [looked_together([one], (4.0,))[0][one.names] for one in each]
            least.append(tuple(min((one.p_value for look in of for one in look), default=1.0) for of in (both, alone)))
        return least

    now = float(scores.time[-1])
    axes = [answering("z", {3, 9, 14, 15, 21}), answering("yaw", {5, 6, 11, 17, 23})]
    nothing, later = rarest(0.0, 100), rarest(3.0, 20)

    assert sum(together < 0.01 for together, _ in nothing) <= 4
    assert np.median([together for together, _ in later]) < 0.01 * np.median([alone for _, alone in later])


@pytest.mark.parametrize(
    "touches",
    [pytest.param((0.5, 1.4), marks=pytest.mark.slow), (0.2, 2.4), pytest.param((0.2, 4.9), marks=pytest.mark.slow)],
)
def test_a_revision_waits_while_the_vehicle_may_have_touched_down(touches: tuple[float, float]) -> None:
    """Else the alarm would keep its first guess of the cause, and no size. A vehicle that takes up a payload sinks."""
    first, last = alarms("picked_up", "tello", at=30.0, touches=touches)
    _, undisturbed = alarms("picked_up", "tello", at=30.0)

    assert last.revises == first.time
    assert first.time + touches[1] <= last.time <= first.time + touches[1] + 0.35
    assert replace(last, time=undisturbed.time) == undisturbed


def test_a_payload_under_which_the_vehicle_sinks_as_if_to_touch_down_is_found_afterwards() -> None:
    """For 3 s nothing is tested, but learnt: the payload would be taken for what the vehicle always was."""
    flight = changing_flight("picked_up", "bebop2", 30.0, 36.0)
    following, found = Following(LAW), list[Alarm]()
    for part, now in growing(flight, 22.0, GLANCE):
        state = following.follow(part, now, 30.1 < now < 33.0)
        found += state.alarms if state else ()

    first, *_ = found
    assert first.cause == "payload"
    assert 33.0 <= first.time <= 33.5
    assert first.since[0] - 0.5 < 30.0 < first.since[1] + 0.5
