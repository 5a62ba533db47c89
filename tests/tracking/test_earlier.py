"""The model of an earlier flight is said as such until the flight tells, and compared with what it tells."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from models import VEHICLE, model_of
from rotorfit.control.tuning import tune
from rotorfit.core.errors import CardError
from rotorfit.core.limits import disagreement
from rotorfit.core.model import COEFFICIENTS, Model, unknown_axis
from rotorfit.core.tracked import Track, Tracked, TrackedAxis
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.models import from_mapping, save, to_mapping
from rotorfit.tracking.earlier import (
    SHARE,
    Earlier,
    another_vehicle,
    compared,
    limits_of_earlier,
    told_after,
    until_known,
)
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import growing, tracked, until
from rotorfit.tracking.tracker import Tracker
from tracked_flights import LAW, known, known_flight

pytestmark = pytest.mark.flights

NAME = "model.json"


def own() -> Model:
    """What the known flight tells."""
    model = known()[1].regimes[0].model
    assert model is not None
    return model


def scaled(model: Model, axis: str, factor: float) -> Model:
    """The model of a vehicle that answers more to commands on one axis."""
    one = model.axes[axis]
    assert one.input is not None
    low, high = one.ci95["input"]
    assert low is not None
    assert high is not None
    gain = one.combinations["steady_gain"]
    ends = (gain.ci95[0] or 0.0) * factor, (gain.ci95[1] or 0.0) * factor
    other = replace(
        one,
        input=factor * one.input,
        ci95={**one.ci95, "input": (factor * low, factor * high)},
        combinations={**one.combinations, "steady_gain": replace(gain, value=factor * gain.value, ci95=ends)},
    )
    return replace(model, axes={**model.axes, axis: other})


def test_a_tracker_states_the_earlier_model_at_once_and_never_as_learnt(tmp_path: Path) -> None:
    model = own()
    state = Tracker(model.card, LAW, after=Earlier(model, NAME)).state()

    for axis, one in state.axes.items():
        assert one.knowledge == "learning"
        assert one.state == "learning (until then from model.json)"
        assert one.to_mapping()["from"] == NAME
        assert one.values["damping"] == model.axes[axis].damping
        assert one.ci95["damping"] == model.axes[axis].ci95["damping"]
        assert one.ci95_flight == {}
    assert Tracker(model.card, LAW, after=model).state().axes["x"].earlier == "the earlier model"
    path = tmp_path / "first.json"
    save(model, path)
    assert Tracker(model.card, LAW, after=str(path)).state().axes["x"].earlier == "first.json"
    with pytest.raises(TypeError, match="path of a model file, got int"):
        Tracker(model.card, LAW, after=3)  # type: ignore[arg-type]


def test_what_the_flight_tells_takes_its_place() -> None:
    earlier, told = Earlier(own(), NAME), known()[1].states[-1].axes["x"]

    assert until_known(told, earlier, "x") == told
    little = replace(told, values={**told.values, "damping": None, "delay": None})
    assert until_known(little, earlier, "x").earlier == NAME
    untold = Earlier(model_of({"y": VEHICLE["y"]}), NAME)
    assert until_known(TrackedAxis(), untold, "x") == TrackedAxis()


def test_only_what_the_flight_tells_in_their_place_is_compared() -> None:
    """A steady gain alone is no comparison as long as the numbers are those of the earlier model."""
    earlier, told = Earlier(own(), NAME), known()[1].states[-1].axes["x"]
    little = replace(told, values={**told.values, "input": None, "delay": None})

    assert compared(little, earlier, "x") != ()
    assert told_after(little, earlier, "x", alone=False).earlier == NAME
    assert told_after(little, earlier, "x", alone=False).against == {}
    assert told_after(little, earlier, "x", alone=True).against.keys() == {"steady_gain", "total_lag"}
    assert set(COEFFICIENTS) <= told_after(told, earlier, "x", alone=False).against.keys()


def test_nothing_told_without_the_damping_is_compared() -> None:
    """It belongs to one optimum of several: a yaw that was only held had 24.5, and 0.4 half a minute later.

    Steady gain and total lag may be anything while the damping is near 0: on 4 of 60 flights of the same vehicle p was
    below 0.001, with the damping told on none below 0.4.
    """
    earlier, told = Earlier(scaled(own(), "x", 70.0), NAME), known()[1].states[-1].axes["x"]
    alone = replace(told, values={**told.values, "damping": None})

    assert "x.input" in {one.name for one in compared(told, earlier, "x")}
    assert compared(alone, earlier, "x") == ()


def test_numbers_that_this_flight_contradicts_are_not_shown() -> None:
    """It tells the input, but not yet the damping: 1.4 times what the earlier model says, with disjoint intervals."""
    told = known()[1].states[-1].axes["x"]
    little = replace(told, state="not identifiable", values={**told.values, "damping": None})
    earlier = Earlier(scaled(own(), "x", 1.0 / 1.4), NAME)
    shown = told_after(little, earlier, "x", alone=False)

    assert (shown.earlier, shown.values) == ("", little.values)
    assert shown.state == "not identifiable (contradicts model.json: input)"
    assert shown.to_mapping()["contradicts_earlier"] == ["input"]
    assert 1.2 < shown.to_mapping()["against_earlier"]["input"][0] < 1.6
    assert told_after(told, earlier, "x", alone=False).contradicts == ("input",)
    assert told_after(little, Earlier(own(), NAME), "x", alone=False).earlier == NAME
    other_law = replace(little, structure="first_order")
    assert told_after(other_law, earlier, "x", alone=False).earlier == NAME
    unknown = replace(told, values={**told.values, "input": None, "damping": None})
    assert told_after(unknown, earlier, "x", alone=False).earlier == NAME  # its steady gain may be anything yet


def test_once_another_vehicle_was_told_no_axis_shows_the_earlier_model() -> None:
    following = Following(LAW, 0.1, Earlier(own(), NAME))
    part, now = next(growing(known_flight(), 5.0))
    assert {one.earlier for one in following.look(part, now).axes.values()} == {NAME}
    following = Following(LAW, 0.1, Earlier(own(), NAME))
    following.recall({**following.memory(), "unlike": ["yaw"]})

    assert {one.earlier for one in following.look(part, now).axes.values()} == {""}


def test_once_this_flight_has_told_an_axis_the_earlier_model_does_not_come_back() -> None:
    """It was shown as the vehicle of the moment where numbers of this flight were taken back, as they disagreed."""
    following = Following(LAW, 0.1, Earlier(own(), NAME))
    part, now = until(known_flight(), 16.0), 16.0
    told = following.look(part, now).axes
    before = following.memory()

    assert before["told_itself"] == sorted(axis for axis, one in told.items() if one.earlier == "") != []
    part, now = next(growing(known_flight(), 5.0))
    following = Following(LAW, 0.1, Earlier(own(), NAME))
    following.recall({**following.memory(), "told_itself": ["x"]})
    again = following.look(part, now).axes
    assert (again["x"].earlier, again["x"].values["delay"], again["y"].earlier) == ("", None, NAME)


def test_what_was_contradicted_stays_so_until_it_agrees_clearly() -> None:
    """About one limit the state would go to and fro with every refit."""
    told = known()[1].states[-1].axes["x"]
    value = told.values["input"] or 0.0
    told = replace(told, ci95={**told.ci95, "input": (0.9 * value, 1.1 * value)})

    def names(times: float, *before: str) -> tuple[str, ...]:
        return told_after(told, Earlier(scaled(own(), "x", times), NAME), "x", True, before).contradicts

    assert names(1.4) == ("input",)
    assert names(1.4, "input") == ("input",)
    between = next(times for times in np.arange(1.4, 1.0, -0.01) if not names(times))
    assert names(between, "input") == ("input",)
    assert names(between, "delay") == ()
    assert names(1.05, "input") == ()


def test_once_this_flight_has_contradicted_an_axis_the_earlier_model_does_not_come_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = []

    def contradicted_once(out, _earlier, axis, alone, _before):  # type: ignore[no-untyped-def]
        seen.append((axis, alone))
        return replace(out, contradicts=("input",)) if len(seen) == 1 else out

    monkeypatch.setattr("rotorfit.tracking.beside_earlier.told_after", contradicted_once)
    following = Following(LAW, 0.1, Earlier(own(), NAME))
    for part, now in itertools.islice(growing(known_flight(), 5.0), 2):
        following.look(part, now)

    first = seen[0][0]
    assert (first, False) in seen
    assert seen[4:].count((first, True)) == 1


def test_the_same_vehicle_is_no_other_and_another_is_told_once_with_its_ratio() -> None:
    flight = replace(until(known_flight(), 16.0), axes=("x", "y"))
    same, other = (tracked(flight, LAW, 0.1, earlier=Earlier(one, NAME)) for one in (own(), scaled(own(), "x", 1.25)))

    assert same.alarms == ()
    axis = same.states[-1].axes["x"]
    assert set(COEFFICIENTS) <= axis.against.keys()
    same_as_before = {name: 0.0 if name in ("delay", "total_lag") else 1.0 for name in axis.against}
    assert all(low <= same_as_before[name] <= high for name, (_, low, high) in axis.against.items())

    (alarm,) = other.alarms
    assert (alarm.cause, alarm.axes) == ("another_vehicle", ("x",))
    low, high = alarm.change["x.input"]
    assert low < 0.8 < high
    assert "another vehicle than model.json" in alarm.why
    assert len(other.regimes) == 1
    later = [one for state in other.states if state.time >= alarm.time for one in state.axes.values()]
    assert all(one.earlier == "" for one in later)  # it is not what this vehicle was


def test_pictures_show_what_this_flight_told_and_frames_say_what_it_did_not() -> None:
    axis = until_known(TrackedAxis(), Earlier(own(), NAME), "x")
    track = Track((Tracked(5.0, {"x": axis}), Tracked(6.0, {"x": known()[1].states[-1].axes["x"]})), ())

    assert np.isnan(track.timeline("x", "input").value).tolist() == [True, False]
    assert track.to_frame()["earlier"].to_list() == [NAME, None]


def test_a_difference_of_five_standard_errors_is_told_but_raises_no_alarm() -> None:
    """Flights of one vehicle differ so now and then; the threshold is what the promise leaves."""
    model = own()
    told = known()[1].states[-1].axes["x"]
    low, high = (np.log(end) for end in model.axes["x"].ci95["input"])
    sd = np.hypot(high - low, np.subtract(*np.log(told.ci95["input"]))) / (2 * 1.96)
    (one,) = [
        each
        for each in compared(told, Earlier(scaled(model, "x", float(np.exp(5 * sd))), NAME), "x")
        if each.name == "x.input"
    ]

    assert one.change[2] < 1.0
    assert one.p_value > SHARE * 0.1 * 30.0 / 3600.0
    assert another_vehicle([one], Earlier(model, NAME), 9.0).p_value == one.p_value


def test_after_a_change_nothing_of_the_earlier_model_is_said() -> None:
    following = Following(LAW, 0.1, Earlier(own(), NAME))
    regimes = {"since": dict.fromkeys(VEHICLE, 6.0), "changed": {"x": 6.0}, "bounds": [(0.0, None)]}
    following.recall({**regimes, "next_look": 7.0})
    part, now = next(growing(known_flight(), 7.0))
    state = following.look(part, now)

    assert state.axes["x"].values["input"] is None
    assert state.axes["x"].earlier == ""
    assert state.axes["y"].earlier == NAME


def test_a_model_whose_commands_mean_something_else_is_refused() -> None:
    raw = own().card.raw
    card = card_from_mapping({**raw, "limits": {**raw["limits"], "tilt": 0.7}}, "another")
    with pytest.raises(CardError, match=r"model\.json: a command of 1 on x reaches .*convert it"):
        Tracker(card, LAW, after=Earlier(own(), NAME))


def test_an_earlier_model_whose_card_lacks_an_axis_is_used_for_the_others() -> None:
    command = {axis: one for axis, one in own().card.raw["command"].items() if axis != "yaw"}
    card = card_from_mapping({**own().card.raw, "command": command}, "three axes")
    known_of_three = replace(own(), card=card, axes={**own().axes, "yaw": unknown_axis("not_excited")})
    state = Tracker(own().card, LAW, after=Earlier(known_of_three, NAME)).state()

    assert [axis for axis, one in state.axes.items() if one.earlier == NAME] == ["x", "y", "z"]
    told = disagreement(own().card, card, ("the log's card", "the model's"))
    assert told == "there is a command on yaw by the log's card, but none by the model's"


def test_an_earlier_model_says_beforehand_of_which_axes_it_tells_nothing_or_too_little() -> None:
    model = own()
    assert list(limits_of_earlier(Earlier(model, NAME), model.card)) == []
    bare = replace(model.axes["z"], delay=None, combinations={})
    poor = replace(model, axes={**model.axes, "x": unknown_axis("not_excited"), "z": bare})

    nothing, few = limits_of_earlier(Earlier(poor, NAME), model.card)
    assert nothing == "model.json knows nothing of x: all numbers there are from this flight"
    assert few.startswith("model.json tells too little of z to be compared with this flight: ")


def test_the_state_holds_the_model_that_tune_and_files_take() -> None:
    state: Tracked = known()[1].states[-2]
    model = state.model
    assert model is not None

    assert from_mapping(to_mapping(model), "here").axes["x"].input == model.axes["x"].input
    assert set(tune(model).axes) == set(VEHICLE)
    assert known()[1].states[-1].landed
    assert not state.landed
    still = [one.model for one in known()[1].states]
    assert len({id(one) for one in still}) < len(still) / 2  # the same until there is another fit
