"""Steps between refits lead to where the batch estimator stands, and never say more than it does."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from flights import flown, steps, truth_of
from other_laws import WORLD_LAG, flown_by
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import AVERAGED
from rotorfit.core.model import COEFFICIENTS, Evidence, Interval, Predictor, Weighed, weighed
from rotorfit.core.tracked import Alarm, Tracked, revised
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.optima import between
from rotorfit.files.models import load, save, to_mapping
from rotorfit.simulation.paper_vehicle import Controller, Truth
from rotorfit.tracking import change_watch
from rotorfit.tracking import following as following_module
from rotorfit.tracking.change_watch import GLANCE, ChangeWatch
from rotorfit.tracking.following import Following
from rotorfit.tracking.groups import Group, recent_groups
from rotorfit.tracking.learnt import after_change
from rotorfit.tracking.refits import (
    REFIT,
    REFIT_SETTLED,
    REFIT_UNKNOWN,
    GroupEstimate,
    axis_report,
    doubt_of,
    group_estimate,
    growth,
    read_backwards,
    refitted,
    renewed,
    stepped,
)
from rotorfit.tracking.regimes import SETTLES
from rotorfit.tracking.replayed import growing, until
from tracked_flights import LAW, TRUTH, known, known_flight

pytestmark = pytest.mark.flights


@pytest.fixture(scope="module")
def early() -> GroupEstimate:
    return refitted(until(known_flight(), 18.0), ("z",), LAW, 18.0)


def test_steps_on_newer_data_come_to_the_batch_fit_of_them(early: GroupEstimate) -> None:
    flight = known_flight()
    whole = axis_report(refitted(flight, ("z",), LAW, 30.0), "z")
    moved = early
    for now in (21.0, 24.0, 27.0, 30.5, 30.5):
        moved = stepped(moved, until(flight, now), now)
    told = axis_report(moved, "z")

    for name, value in whole.values.items():
        if value is not None:
            low, high = whole.ci95_flight[name]
            assert low is not None
            assert high is not None
            assert told.values[name] == pytest.approx(value, abs=0.05 * (high - low))
            near, far = told.ci95_flight[name]
            assert near is not None
            assert far is not None
            assert far - near == pytest.approx(high - low, rel=0.25)


@pytest.mark.parametrize(
    ("unknown", "ends"),
    [
        ({"pose_lateness": 0.033}, (0.033, 0.0)),
        ({"command_lateness": 0.04}, (0.0, 0.04)),
        ({"shared_error": 0.03}, None),
    ],
)
def test_what_stamps_leave_unknown_does_not_shrink_as_the_flight_goes_on(
    early: GroupEstimate, unknown: dict[str, float], ends: tuple[float, float] | None
) -> None:
    flight = replace(known_flight(), **unknown)
    late, known = refitted(until(flight, 18.0), ("z",), LAW, 18.0), early
    for now in (21.0, 24.0, 27.0, 30.5):
        late, known = (stepped(one, until(flight, now), now) for one in (late, known))
    told, stamped = axis_report(late, "z"), axis_report(known, "z")

    for name in ("delay", "total_lag"):
        for wide, narrow in (
            (told.ci95[name], stamped.ci95[name]),
            (told.ci95_flight[name], stamped.ci95_flight[name]),
        ):
            assert None not in wide + narrow
            below, above = narrow[0] - wide[0], wide[1] - narrow[1]  # type: ignore[operator]
            if ends:
                assert (below, above) == pytest.approx(ends, abs=2e-4)
            else:
                assert wide[1] - wide[0] > 0.06  # type: ignore[operator]
    assert told.ci95["input"] == pytest.approx(stamped.ci95["input"])


def test_a_segment_that_begins_is_seen_though_no_step_is_taken(early: GroupEstimate) -> None:
    """Else the information would be of another number of start velocities than there are."""
    flight = replace(until(known_flight(), 20.0), segments=(Segment(0.0, 18.0), Segment(18.5, 20.0)))
    held = stepped(replace(early, stepped=31.0), flight, 31.1)
    optimum = held.estimates["z"].optimum

    assert optimum.point.start.size == 2
    assert len(optimum.free) == len(optimum.score.information)


def test_start_velocities_of_new_segments_are_all_that_moves_without_commands(early: GroupEstimate) -> None:
    flight = replace(until(known_flight(), 20.0), segments=(Segment(12.0, 18.0), Segment(18.5, 20.0)))
    before, after = early.estimates["z"].optimum.point, renewed(early, flight).estimates["z"].optimum.point

    assert after.flat()[: before.coefficients].tolist() == before.flat()[: before.coefficients].tolist()
    assert after.trim.tolist() == before.trim.tolist()
    assert after.start.size == 2


def test_no_step_is_taken_on_a_flight_that_tells_less_than_the_last_refit_knew(early: GroupEstimate) -> None:
    """As after a hover, when what was excited has slid out of the time that is looked back over."""
    held = stepped(early, between(known_flight(), 24.0, 30.0), 31.0)
    before, after = axis_report(early, "z"), axis_report(held, "z")

    assert after.values == before.values
    assert after.ci95 == before.ci95
    assert held.stepped == 31.0


def test_the_interval_of_the_vehicle_is_no_narrower_than_that_of_this_flight(early: GroupEstimate) -> None:
    told = axis_report(early, "z")

    for name, (low, high) in told.ci95_flight.items():
        least, most = told.ci95[name]
        assert low is None or least is None or least <= low + 1e-12
        assert high is None or most is None or most >= high - 1e-12


@pytest.mark.parametrize(("off", "share"), [(0.3, 1.0), (1.5, 0.9**0.5), (3.0, 0.9**0.5)])
def test_an_interval_never_widens_between_refits_nor_shrinks_by_more_than_the_excited_time_allows(
    early: GroupEstimate, off: float, share: float
) -> None:
    half = {name: replace(one, error=off * one.error) for name, one in early.half["z"].items()}
    (low, high), now = axis_report(early, "z").ci95_flight["input"], replace(early, half={"z": half}, stepped=20.0)
    least, most = axis_report(now, "z").ci95_flight["input"]

    assert low is not None
    assert high is not None
    assert least is not None
    assert most is not None
    assert np.log(most / least) == pytest.approx(share * np.log(high / low))


def test_what_more_data_cannot_tell_stays_in_the_interval() -> None:
    """An error of all stamps, and the way between two laws that are still possible."""
    flight = replace(until(known_flight(), 18.0), shared_error=0.03)
    fitted = replace(refitted(flight, ("z",), LAW, 18.0), stepped=1e9)
    tiny = {name: replace(one, error=1e9 * one.error) for name, one in fitted.half["z"].items()}
    low, high = axis_report(replace(fitted, half={"z": tiny}), "z").ci95_flight["delay"]
    assert low is not None
    assert high is not None
    assert 0.5 * (high - low) == pytest.approx(0.03, rel=1e-6)

    z = fitted.fit.model.axes["z"]
    both = replace(fitted.fit.model, axes={"z": replace(z, laws=2 * (weighed(LAW, z.predictor, (), np.eye(0)),))})
    told = axis_report(replace(fitted, half={"z": tiny}, fit=replace(fitted.fit, model=both)), "z")
    assert told.ci95_flight["delay"] == pytest.approx(z.ci95_flight["delay"])


def test_of_an_axis_that_is_not_followed_nothing_is_said(early: GroupEstimate) -> None:
    told = axis_report(early, "x")

    assert set(told.values.values()) == {None}
    assert told.ci95 == told.ci95_flight == {}


@pytest.mark.parametrize(
    ("delay", "input_status", "backwards"),
    [
        ((-0.07, -0.03), "not_identifiable", True),  # commands that follow the motion
        ((-0.07, -0.03), "ok", False),  # clocks that disagree
        ((-0.07, 0.01), "not_identifiable", False),
        ((-0.07, None), "not_identifiable", False),
    ],
)
def test_an_answer_before_its_command_is_feedback_unless_the_input_is_told(
    delay: Interval, input_status: str, backwards: bool
) -> None:
    assert read_backwards({"delay": delay}, {"input": input_status, "delay": "ok"}) is backwards


def test_a_gap_while_nothing_steps_leaves_the_estimate_told() -> None:
    flight = known_flight()
    followed = refitted(until(flight, 12.0), ("z",), LAW, 12.0)
    whole = until(flight, 20.0)
    apart = replace(whole, segments=(Segment(whole.segments[0].start, 12.0), Segment(12.5, 20.0)))
    now = axis_report(renewed(followed, apart), "z")

    low, high = axis_report(followed, "z").ci95["input"]
    assert low is not None
    assert high is not None
    assert low < now.values["input"] < high  # type: ignore[operator]


def test_an_estimate_that_has_seen_all_that_it_looks_back_over_still_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """A longer flight stands for hours: the estimate looks back over 8 s of 20."""
    monkeypatch.setattr("rotorfit.tracking.groups.LONGEST", 8.0)
    monkeypatch.setattr("rotorfit.tracking.refits.LONGEST", 8.0)
    monkeypatch.setattr("rotorfit.tracking.excited_time.LONGEST", 8.0)
    following, told = Following(LAW), []
    for part, now in growing(replace(until(known_flight(), 20.0), axes=("z",)), following.next_look):
        told.append((now, following.look(part, now).axes["z"].values["input"]))

    late = [value for now, value in told if now > 13.0]
    assert len(set(late)) >= 3


def test_an_axis_of_which_a_refit_left_a_coefficient_open_waits_for_the_next_one() -> None:
    """In gusts the damping is open below, and steps would follow it down within the half widths of the refit."""
    gusty = replace(TRUTH, wind_sigma=(0.3,) * 4)
    flight = flown(gusty, steps(("x",), 0.05, seed=3), 24.0, seed=3)
    early = refitted(until(flight, 12.0), ("x",), LAW, 11.0)
    assert early.half["x"]["damping"].flight[0] is None

    later = stepped(early, until(flight, 24.0), 23.0)
    before, now = (one.estimates["x"].optimum.point for one in (early, later))
    np.testing.assert_array_equal(now.flat()[: now.coefficients], before.flat()[: before.coefficients])
    assert axis_report(later, "x") == axis_report(early, "x")


def test_of_a_long_regime_only_the_end_is_tested_by_the_estimate_of_all_of_it(
    early: GroupEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A longer flight, with a pause in it, stands for hours: 12 s of 30 are tested."""
    monkeypatch.setattr("rotorfit.tracking.groups.TESTED", 12.0)
    whole = known_flight()
    flight = replace(whole, segments=(Segment(whole.segments[0].start, 12.0), Segment(12.5, 29.9)))
    (tested,) = recent_groups({("z",): Group(("z",), 0.0, early)}, flight, 29.9)

    (record,) = tested.estimates["z"].records
    assert 29.9 - 1.1 * 12.0 <= record.block_time[0] <= 29.9 - 12.0
    before, now = early.estimates["z"].optimum.point, tested.estimates["z"].optimum.point
    assert (now.gain, now.log_damping, now.delay) == (before.gain, before.log_damping, before.delay)


def test_what_rest_explains_is_judged_by_the_flight_before_the_change() -> None:
    """Else the changed vehicle is learnt with the other one, and explains itself, as after a landing."""
    pauses, moving = ((8.0, 11.0), (18.0, 21.0)), steps(seed=5)

    def commanded(t: Array) -> Array:
        return np.where(np.any([(a < t) & (t < b) for a, b in pauses], axis=0)[:, None], 0.0, moving(t))

    flight = flown(TRUTH, commanded, 26.0, seed=5)
    less = np.where(flight.command_time > 20.0, 1.25, 1.0)[:, None]
    flight = replace(flight, command=flight.command / less, axes=("x", "y"))
    following = Following(LAW)
    following.look(until(flight, 20.0), 20.0)
    seen = change_watch._Suspicion(("x.input", "y.input"), before=20.0, threshold=0.0)  # as if nothing were seen then
    changes = ChangeWatch(LAW, 0.1)
    changes.test(following.learnt, until(flight, 20.25), 20.25, standing=True)
    group = changes._at_rest(following.learnt.groups, flight, 26.0, seen)

    assert group is not None
    assert group.answers is not None
    assert changes._sinking is not None
    held = changes._holding(following.learnt, group)
    assert group == held.groups[group.axes] == changes._sinking.groups[group.axes]
    assert group.fitted is not None
    assert max(part.segments[-1].end for part in group.fitted.fit.flights) <= 20.0
    low, high = axis_report(group.fitted, "x").ci95["input"]
    assert low is not None
    assert high is not None
    assert low < truth_of(TRUTH, "x")["input"] < high


@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_a_lag_that_keeps_its_direction_is_no_change_when_the_vehicle_begins_to_turn(gain: float) -> None:
    """Until then it is the same law as one that turns with the vehicle; a gain that has changed is found under both."""
    plane, turns = ("x", "y"), 30.0
    flight = flown_by(WORLD_LAG, plane, 40.0, wind=0.01, noise=0.001, turn=4.0, straight=turns)
    flight = replace(flight, command=flight.command / np.where(flight.command_time > turns, gain, 1.0)[:, None])
    following, straight = Following(), refitted(until(flight, turns), plane, AVERAGED, turns)
    following.learnt = following.learnt.holding(Group(plane, 0.0, straight))
    told = [following.glance(until(flight, now), now) for now in np.arange(turns, 40.0, GLANCE)]
    found = [alarm.time for state in told if state for alarm in state.alarms]

    assert straight.fit.model.axes["x"].structure == "first_order_delay_lag"
    if gain != 1.0:
        assert found[0] < turns + 5.0
        return
    fitted = following.learnt.groups[plane].fitted
    assert not found
    assert fitted is not None
    assert fitted.fit.model.axes["x"].structure == WORLD_LAG


def test_an_axis_that_is_no_longer_known_says_until_when_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a refit finds another optimum as good as the one that was known."""
    told = following_module._knowledge

    def doubted(flight, axis, now, *fitted):  # type: ignore[no-untyped-def]
        back = axis == "z" and now > 20.0
        return ("not_identifiable", "not identifiable") if back else told(flight, axis, now, *fitted)

    monkeypatch.setattr(following_module, "_knowledge", doubted)
    following, states = Following(LAW), dict[float, str]()
    for part, now in growing(replace(until(known_flight(), 22.5), axes=("z",)), following.next_look):
        states[now] = following.look(part, now).axes["z"].state

    assert states[20.0] == "known"
    assert states[21.0] == states[22.0] == "not identifiable (known until 20 s, taken back)"


def test_a_revised_alarm_leaves_an_axis_that_it_does_not_name_as_it_was() -> None:
    flight, following = replace(known_flight(), axes=("z", "yaw")), Following(LAW)
    for part, now in growing(until(flight, 12.5), following.next_look):
        state = following.look(part, now)
    following._changes.watched.since = dict.fromkeys(("z", "yaw"), 10.0)
    before = following.learnt
    first = Alarm(12.5, ("z", "yaw"), "thrust", (11.0, 12.0), {}, 0.9, 1e-9, "because")
    following.learnt = after_change(before, before, first, 11.5)
    learning = following.look(until(flight, 13.0), 13.0).axes
    second = replace(first, time=13.5, axes=("z",), cause="payload", revises=12.5)
    following.learnt = after_change(following.learnt, before, second, 11.6)
    again = following.look(until(flight, 14.0), 14.0)

    assert state.axes["yaw"].knowledge == "known"
    assert learning["yaw"].state == learning["z"].state == "changed at 11.5 s, learning"
    assert (learning["yaw"].watched, learning["z"].watched) == (None, None)
    assert (again.axes["yaw"].watched, again.axes["z"].watched) == (10.0, None)  # a new regime is watched anew
    assert again.axes["yaw"].state == "known"
    assert again.axes["z"].state == "changed at 11.6 s, learning"
    assert (again.regime, again.regime_start) == (1, 11.6)


def test_models_of_regimes_whose_seconds_are_forgotten_are_remembered(early: GroupEstimate) -> None:
    following, again = Following(LAW), Following(LAW)
    kept = [[0.0, to_mapping(early.fit.model)], [7.0, None]]
    following.recall({**following.memory(), "kept": kept})
    again.recall(json.loads(json.dumps(following.memory())))

    assert json.loads(json.dumps(again.memory()["kept"])) == json.loads(json.dumps(kept))


def test_a_model_of_a_regime_knows_of_each_axis_what_all_the_flight_tells_in_which_it_did_not_change(
    tmp_path: Path,
) -> None:
    flight, following = known_flight(), Following(LAW)
    alarm, end = Alarm(16.0, ("z",), "payload", (14.0, 16.0), {}, 0.9, 1e-9, "because"), flight.segments[-1].end
    memory = following.memory()
    following.recall(
        {**memory, "since": {**memory["since"], "z": 15.0}, "changed": {"z": 15.0},
         "bounds": [(0.0, None), (15.0, asdict(alarm))], "next_look": end}
    )  # fmt: skip
    state, regimes = following.finish(flight, end)
    whole = fit([flight], structure=LAW).model

    for regime in regimes:
        model = regime.model
        assert model is not None
        for axis in ("x", "y", "yaw"):
            assert model.axes[axis].ci95["input"] == pytest.approx(whole.axes[axis].ci95["input"], rel=1e-6)
        (early, late), parts = model.flights, {0.0: (0.0, 14.0), 15.0: (16.0 + SETTLES, end)}
        assert (early.axes, late.axes) == (("x", "y", "yaw"), ("z",))
        assert early.span == pytest.approx((0.0, end), abs=0.1)
        assert late.span == pytest.approx(parts[regime.start], abs=0.1)
        assert [one is None for one in model.axes["x"].trim] == [False, True]
        assert [one is None for one in model.axes["z"].trim] == [True, False]
        save(model, tmp_path / "model.json")
        assert load(tmp_path / "model.json").axes["z"].input == model.axes["z"].input
    last = regimes[-1].model
    assert last is not None
    for axis, one in state.axes.items():
        assert {name: one.values[name] for name in COEFFICIENTS} == pytest.approx(
            {name: getattr(last.axes[axis], name) for name in COEFFICIENTS}
        )
    assert regimes[0].model.axes["z"].input != last.axes["z"].input


def test_other_axes_that_changed_at_the_same_instant_are_part_of_the_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """All gains change at 20 s; at first that of yaw alone is seen, and taken for a weak rotor, as in gusts."""
    told, calls = change_watch.diagnosed, list[int]()

    def at_first(*seen):  # type: ignore[no-untyped-def]
        calls.append(1)
        named = told(*seen)
        return named if len(calls) > 2 else replace(named, cause="thrust", axes=("yaw",), shifted=(), change={})

    monkeypatch.setattr(change_watch, "diagnosed", at_first)
    flight, following = flown(TRUTH, steps(seed=6), 25.0, seed=6), Following(LAW)
    flight = replace(flight, command=flight.command / np.where(flight.command_time > 20.0, 1.25, 1.0)[:, None])
    states = [following.follow(part, now) for part, now in growing(flight, 15.0, GLANCE)]
    alarms = [alarm for state in states if state for alarm in state.alarms]
    first, *again = alarms

    assert [(one.cause, one.axes) for one in alarms] == [("thrust", ("yaw",))] * 2 + [("limits", AXES)]
    assert [one.revises for one in again] == [first.time] * 2
    assert revised(alarms) == (again[-1],)
    assert following.learnt.bounds[1:] == [(following.learnt.bounds[1][0], again[-1])]
    for low, high in again[-1].change.values():
        assert low < 1.25 < high


def test_axes_that_were_told_of_stay_part_of_an_alarm_that_others_join(monkeypatch: pytest.MonkeyPatch) -> None:
    """All gains change at 20 s, and are seen on yaw at first, on x and z alone a moment later."""
    told, calls = change_watch.diagnosed, list[int]()

    def in_turn(*seen):  # type: ignore[no-untyped-def]
        calls.append(1)
        first = {"cause": "limits", "axes": ("yaw",), "confidence": 0.9, "change": {}}
        later = {"cause": "other", "axes": ("x", "z"), "confidence": 0.6}
        return replace(told(*seen), **(first if len(calls) <= 2 else later))

    monkeypatch.setattr(change_watch, "diagnosed", in_turn)
    flight, following = flown(TRUTH, steps(seed=6), 25.0, seed=6), Following(LAW)
    flight = replace(flight, command=flight.command / np.where(flight.command_time > 20.0, 1.25, 1.0)[:, None])
    states = [following.follow(part, now) for part, now in growing(flight, 15.0, GLANCE)]
    (last,) = revised([alarm for state in states if state for alarm in state.alarms])

    assert (last.cause, last.confidence) == ("limits", 0.9)
    assert set(last.axes) >= {"x", "z", "yaw"}
    assert following.learnt.changed.keys() == set(last.axes)


def test_an_axis_whose_change_is_too_small_to_alarm_joins_the_alarm_of_others() -> None:
    """x and y lose a third of their gains at 20 s, z a quarter, which it does not tell by itself."""
    less = np.array([0.65, 0.65, 0.75, 1.0])
    flight, following = flown(TRUTH, steps(seed=6), 33.0, seed=6), Following(LAW)
    command = flight.command / np.where(flight.command_time[:, None] > 20.0, less, 1.0)
    flight = replace(flight, command=command, axes=("x", "y", "z"))
    states = [state for part, now in growing(flight, 15.0, GLANCE) if (state := following.follow(part, now))]
    (last,) = revised([alarm for state in states for alarm in state.alarms])

    assert last.axes == ("x", "y", "z")
    assert states[-1].axes["z"].state.startswith("changed at ")


def test_a_revision_takes_the_place_of_the_alarm_of_its_time() -> None:
    first = Alarm(12.5, ("z",), "payload", (11.0, 12.0), {}, 0.9, 1e-9, "because")
    jump, other = replace(first, cause="pose_jumped"), replace(first, time=20.0)
    again = replace(first, time=13.5, revises=12.5)

    assert revised([jump, first, other, again]) == (jump, again, other)


def test_an_axis_that_is_only_held_is_given_no_numbers_before_the_fit_can_tell() -> None:
    """z is excited, x and y are held by a position controller, whose law a short fit can take for a vehicle."""
    still = replace(Truth(), wind_sigma=(0.05,) * 4)
    flight = flown(still, steps(("z",), 0.2), 8.5, seed=1, controller=Controller())
    following, states = Following(LAW), list[Tracked]()
    for part, now in growing(flight, following.next_look):
        states.append(following.look(part, now))

    for axis in ("x", "y"):
        assert states[-1].axes[axis].state == "learning (so far its commands only answer its motion)"
        assert all(value is None for state in states for value in state.axes[axis].values.values())
    assert states[-1].axes["z"].state == "known"


def test_a_refit_that_knows_axes_and_laws_stands_for_longer_while_its_values_stay_in_its_intervals() -> None:
    flight, following = replace(known_flight(), axes=("z",)), Following(LAW)
    for part, now in growing(until(flight, 12.5), following.next_look):
        following.look(part, now)
    (fitted,) = (group.fitted for axes, group in following.learnt.groups.items() if "z" in axes)
    assert fitted is not None
    optimum = fitted.estimates["z"].optimum
    left = replace(optimum, point=replace(optimum.point, delay=optimum.point.delay + 0.2))
    away = replace(fitted, estimates={"z": replace(fitted.estimates["z"], optimum=left)})

    assert growth(fitted) == REFIT_SETTLED
    assert growth(away) == REFIT
    assert growth(replace(fitted, estimates={})) == REFIT_UNKNOWN
    assert growth(under_laws(fitted, 0.9, 0.1)) == REFIT_SETTLED
    assert growth(under_laws(fitted, 0.6, 0.4)) == REFIT


def under_laws(fitted: GroupEstimate, *weights: float) -> GroupEstimate:
    """The estimate of z as if its refit had given several laws these weights."""
    model, predictor = fitted.fit.model, Predictor(1.0, 1.0, 0.1)
    laws = tuple(Weighed(LAW, weight, 0.0, predictor, {}, ()) for weight in weights)
    axes = {**model.axes, "z": replace(model.axes["z"], laws=laws)}
    return replace(fitted, fit=replace(fitted.fit, model=replace(model, axes=axes)))


def test_at_a_refit_a_lag_that_the_fit_does_not_know_is_not_told() -> None:
    """Its interval is closed, but too wide."""
    flight = until(flown_by("second_order_zero", duration=40.0, wind=0.5, noise=0.005), 20.0)
    found = fit([flight], axes=("z",), structure="second_order_zero")
    axis = found.model.axes["z"]
    told = axis_report(group_estimate(found, ("z",), 20.0), "z").values

    assert axis.extra["lag"] is None
    assert None not in axis.ci95["lag"]
    assert told["lag"] is None
    assert told["zero"] == axis.extra["zero"]


def test_what_the_last_refit_refuted_is_not_told() -> None:
    flight = flown_by("second_order_zero", wind=0.05, noise=0.001)
    found = fit([flight], axes=("z",), structure="second_order_zero")
    axis = found.model.axes["z"]
    denied = replace(axis, status={**axis.status, "zero": "refuted"}, extra={**axis.extra, "zero": None})
    judged = replace(found, model=replace(found.model, axes={**found.model.axes, "z": denied}))

    assert axis_report(group_estimate(found, ("z",), 30.0), "z").values["zero"] is not None
    assert axis_report(group_estimate(judged, ("z",), 30.0), "z").values["zero"] is None


def test_what_varies_with_time_is_no_doubt_about_the_law_but_maybe_the_change() -> None:
    axis = known()[1].states[-1].model.axes["x"]  # type: ignore[union-attr]
    found = [Evidence(test, "", 1e-6, {"input": sd}) for test, sd in (("time", 0.4), ("quarter", 0.2), ("size", 0.1))]

    assert doubt_of(replace(axis, evidence=tuple(found))) == {"input": pytest.approx(0.1)}


def turned_at(when: float, end: float) -> Flight:
    """x and z of the known flight up to an end, its heading 30 degrees off from an instant on [s]."""
    flight = until(known_flight(), end)
    late = flight.pose_time > when
    segments = tuple(Segment(*ends) for ends in ((0.0, when - 1e-9), (when, end)) if ends[1] > ends[0])
    return replace(flight, yaw=flight.yaw + np.radians(30.0) * late, axes=("x", "z"), segments=segments)


JUMP = Alarm(6.06, AXES, "pose_jumped", (5.98, 6.0), {}, 1.0, 0.0, "because", turned=True)


def test_where_the_heading_jumps_x_is_learnt_anew_and_the_wrong_frame_is_told() -> None:
    following, flight = Following(LAW), turned_at(6.0, 18.5)
    following.look(until(flight, 5.9), 5.9)
    at = following.follow(until(flight, 6.1), 6.1, alarms=(JUMP,))
    last = following.follow(until(flight, 18.0), 18.0)
    landed, (before, after) = following.finish(flight, 18.5)
    assert at
    assert last
    assert before.model
    assert after.model

    assert (at.time, at.alarms, at.regime, at.findings) == (6.1, (JUMP,), 1, None)
    assert [one.state.partition(",")[0] for one in at.axes.values()] == ["changed at 6.0 s", at.axes["z"].state]
    served = {axis: source.span for source in after.model.flights for axis in source.axes}
    assert served["x"] == pytest.approx((6.0, 18.5), abs=0.1)
    assert served["z"] == pytest.approx((0.0, 18.5), abs=0.1)
    for told in (last.findings or (), after.model.findings, landed.findings or ()):
        assert "yaw_offset" in {one.code for one in told}
    assert "yaw_offset" not in {one.code for one in before.model.findings}


def test_a_heading_that_is_off_from_the_start_is_told_as_of_a_log_and_kept_in_the_model() -> None:
    flight, following = turned_at(0.0, 14.0), Following(LAW)
    early, late = (following.look(until(flight, now), now) for now in (9.0, 13.0))
    landed, (regime,) = following.finish(flight, 14.0)
    assert regime.model

    assert early.findings is None
    assert late.faults["yaw_offset None 0"].startswith("warning yaw_offset: a command of x acts -")
    assert late.to_mapping()["findings"][0]["code"] == "yaw_offset"
    assert landed.faults.keys() >= late.faults.keys()
    assert f"{flight.path}: a command of x acts" in " ".join(one.evidence for one in regime.model.findings)


def test_a_revision_that_was_due_does_not_undo_what_a_jump_of_the_heading_began() -> None:
    following, part = Following(LAW), until(known_flight(), 4.0)
    following._changes._raised = following._changes._told = cast(Any, "an alarm of 3.0 s")
    following.follow(part, 3.5, alarms=(replace(JUMP, since=(3.36, 3.38)),))

    assert following.learnt.since == {"x": 3.38, "y": 3.38, "z": 0.0, "yaw": 0.0}
    assert (following._changes._raised, following._changes._told) == (None, None)
