import math
from dataclasses import replace

import pytest

from flying import BEBOP, CARD, SECOND, SPACE, Watched, plan_of, room_link
from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import Plan
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.preflight import Ready, preflight, refuse
from rotorfit.planning.belief import belief_from_card, belief_mapping
from rotorfit.simulation.flight_room import Conditions
from rotorfit.simulation.sensors import Mocap, SenderClock


def wrong(ready: Ready) -> dict[str, str]:
    return {check.name: check.text for check in ready.checks if not check.ok}


def believed(amplitude: float = 0.5) -> Plan:
    return replace(plan_of(20.0, amplitude=amplitude), belief=belief_mapping(belief_from_card(CARD)))


def test_a_vehicle_that_hovers_at_the_start_may_fly_and_nothing_was_sent() -> None:
    link = Watched(room_link())
    ready = preflight(believed(), link, CARD)

    assert wrong(ready) == {}
    assert [check.name for check in ready.checks] == ["link", "pose", "box", "start", "rest", "battery", "card", "plan"]
    assert (ready.pose_clock, ready.notes) == ("header.stamp", ())
    assert link.sent == []
    assert link.acts == []
    refuse(ready)


def test_everything_that_is_wrong_is_told_in_one_line() -> None:
    link = Watched(room_link(start=(2.0, 0.0, 3.5, 0.0)))
    link.samples = lambda _, samples: [
        *[sample for sample in samples if sample.stream == "pose"], Sample("battery", 0, link.now, (0.2,))
    ]  # fmt: skip
    plan = replace(plan_of(feedback=False), belief={})
    with pytest.raises(LinkError) as told:
        refuse(preflight(plan, link))

    text = str(told.value)
    assert "\n" not in text
    assert text.startswith("not flown: box: the vehicle is at (2.00, ")
    assert "outside of the box (-3.00, -3.00, 0.30) to (3.00, 3.00, 3.00); start: 2.83 m and 0 deg from" in text
    assert "the plan's start; bring" in text
    assert text.endswith("battery: 20% left; at least 30% are needed")


def test_a_dead_link_and_a_dark_room_are_told() -> None:
    dark = Watched(room_link(Conditions(mocap=Mocap(drop_outs=((0.0, 99.0),)))))
    assert wrong(preflight(plan_of(), dark)) == {"pose": "none came; is the motion capture on, and the body in sight?"}
    dead = Watched(room_link())
    dead.samples = lambda *_: []
    assert wrong(preflight(plan_of(), dead))["link"] == "0 samples came in 1 s"
    gone = Watched(room_link())
    gone.dead_from = 0.5
    with pytest.raises(LinkError, match="the radio is gone"):
        preflight(plan_of(), gone)


def test_slow_poses_and_a_vehicle_that_drifts_are_told() -> None:
    slow = preflight(plan_of(), Watched(room_link(Conditions(mocap=Mocap(rate=5.0)))))
    assert wrong(slow) == {"pose": "5 a second, 0% of them repeat; at least 8 a second are needed"}

    def drifting(_: float, samples: list[Sample]) -> list[Sample]:
        return [
            replace(one, values=(one.values[0] + 0.6 * (one.received - link.began) / SECOND, *one.values[1:]))
            for one in samples if one.stream == "pose"
        ]  # fmt: skip

    link = Watched(room_link())
    link.samples = drifting
    told = wrong(preflight(plan_of(), link))["rest"]
    assert told.endswith("over the ground, not below 0.3 m/s: bring it to rest; does the wind carry it away?")


def test_a_far_start_is_refused_only_where_nothing_can_lead_there() -> None:
    far = (1.0, 1.0, 1.5, 0.0)
    assert wrong(preflight(plan_of(), room_link(start=far))) == {}
    (start,) = wrong(preflight(replace(plan_of(feedback=False), belief={}), room_link(start=far))).values()
    assert start == "1.41 m and 0 deg from the plan's start; bring it within 0.3 m and 20 deg, or plan with feedback"


def test_before_a_take_off_the_floor_is_no_wall() -> None:
    ready = preflight(plan_of(), room_link(flying=False), take_off=True)

    assert wrong(ready) == {}
    (box,) = (check.text for check in ready.checks if check.name == "box")
    assert box.endswith("m to the nearest side or top of the box, which it enters from below")
    assert "box" in wrong(preflight(plan_of(), room_link(flying=False)))
    beside = wrong(preflight(plan_of(), room_link(start=(5.0, 0.0, 0.0, 0.0), flying=False), take_off=True))
    assert beside["box"].endswith("outside of the box (-3.00, -3.00, 0.30) to (3.00, 3.00, 3.00) or the room below it")


def test_a_vehicle_that_is_set_otherwise_than_planned_is_told() -> None:
    raw = BEBOP.card()
    tilted = card_from_mapping({**raw, "limits": {**raw["limits"], "tilt": math.radians(10)}}, "other")

    assert wrong(preflight(plan_of(), room_link(), tilted)) == {
        "card": "a command of 1 on x reaches 3.88 by the plan's card, 1.73 by the vehicle's"
    }


def test_a_plan_that_the_guard_would_end_is_refused_beforehand() -> None:
    plan = believed(2.0)
    plan = replace(plan, feedback=None, space=replace(SPACE, lower=(-1.0, -1.0, 0.3), upper=(1.0, 1.0, 3.0)))

    (text,) = wrong(preflight(plan, room_link())).values()
    assert text.startswith("the likeliest vehicle would be stopped after ")
    assert "by the fence: " in text
    edited = replace(believed(), predicted={"leaving": 0.4, "allowed": 0.05})
    assert wrong(preflight(edited, room_link())) == {
        "plan": "40% of the vehicles that are believed possible leave its space; plan it again"
    }


@pytest.mark.parametrize("offset", [-3.0, 0.5, 1e4])
def test_poses_of_another_clock_are_timed_by_their_arrival(offset: float) -> None:
    ready = preflight(plan_of(), room_link(Conditions(mocap_clock=SenderClock(offset=offset))))

    assert ready.pose_clock == "log_time"
    assert ready.notes[0].startswith(f"the poses' clock is {offset - 0.008:+.3f}"[:28])
    assert (
        preflight(plan_of(), room_link(Conditions(mocap_clock=SenderClock(offset=-0.01)))).pose_clock == "header.stamp"
    )
