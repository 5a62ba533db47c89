import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from flying import BEBOP, CARD, SECOND, SPACE, Watched, plan_of, room_link
from rotorfit.core.errors import LinkError, PlanError
from rotorfit.core.flight_plan import AxisExcitation, Feedback, Plan, Sines, Steps
from rotorfit.core.log import Sample
from rotorfit.core.plain import plain_toml
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.links.link import Silence
from rotorfit.flying.mission import attached_to
from rotorfit.flying.preflight import Ready, preflight, refuse
from rotorfit.planning.belief import belief_from_card, belief_mapping
from rotorfit.planning.run_on import run_on
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
    assert [check.name for check in ready.checks] == [
        "link",
        "pose",
        "box",
        "start",
        "rest",
        "battery",
        "card",
        "numbers",
        "commands",
        "plan",
    ]
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


def test_a_battery_of_which_nobody_tells_is_said() -> None:
    link = Watched(room_link())
    link.samples = lambda _, samples: [sample for sample in samples if sample.stream == "pose"]

    (text,) = (check.text for check in preflight(plan_of(), link).checks if check.name == "battery")
    assert text == "unknown: no battery report within 1 s; check it yourself"


def test_what_the_vehicle_says_meanwhile_is_told_once() -> None:
    link = Watched(room_link())
    link.samples = lambda _, samples: [*samples, Sample("said", 0, link.now, (), "PX4 says: low battery")]

    assert preflight(plan_of(), link).notes == ("PX4 says: low battery",)


def test_how_far_the_vehicle_runs_on_without_commands_is_told_and_that_room_is_kept() -> None:
    plan = believed()
    link = Watched(room_link())

    def told(silence: Silence, live: bool = False) -> tuple[bool, str]:
        link.silence, link.live = silence, live
        (check,) = (check for check in preflight(plan, link, CARD).checks if check.name == "commands")
        return check.ok, check.text

    short, long = run_on(plan, 0.5), run_on(plan, 9.0)
    assert told(Silence(0.5)) == (
        True,
        "when they stop at the worst instant, the vehicle follows the last command for 0.5 s and comes to rest "
        f"{short.sideways:.1f} m sideways and 0.0 m up or down from there, inside of the box",
    )
    assert long.sideways > 3 * short.sideways
    ok, text = told(Silence(9.0, "GUID_TIMEOUT"), live=True)
    assert not ok
    assert f"{long.outside:.1f} m outside of the box (at {long.instant:.1f} s); GUID_TIMEOUT of the autopilot" in text
    assert told(Silence(15.0), live=True)[0]  # nothing can be set, so it is told
    assert "commands" not in [check.name for check in preflight(plan, SilentNobody(link), CARD).checks]


class SilentNobody(Watched):
    """A link that does not know what its vehicle does."""

    def __init__(self, link: Watched) -> None:
        super().__init__(link)
        self.silence = Silence()


def test_slow_poses_and_a_vehicle_that_drifts_are_told() -> None:
    slow = preflight(plan_of(), Watched(room_link(Conditions(mocap=Mocap(rate=5.0)))))
    assert wrong(slow) == {"pose": "5 a second, 0 % repeated; at least 8 a second are needed"}

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


def test_what_the_stamps_of_poses_may_be_off_by_is_told_and_recorded() -> None:
    link = Watched(room_link())
    link.samples = lambda _, samples: [replace(one, error=0.03) for one in samples]
    ready = preflight(plan_of(), link)
    card = plain_toml(attached_to(plan_of(), ready, "mavlink")["card"])

    assert next(check for check in ready.checks if check.name == "pose").text.endswith(" repeated, when to 30.0 ms")
    assert card["pose"]["time"] == {"from": "/rotorfit/pose:header.stamp", "error": 0.03}
    assert card_from_mapping(card, "as recorded").pose_time.error == 0.03


FEEDBACK = Feedback(("x", "y", "z", "yaw"))
GAMMA = plan_of().belief["gamma"]


def with_gamma(plan: Plan, *gamma: float) -> Plan:
    return replace(plan, belief={**plan.belief, "gamma": list(gamma)})


DISARMING = {
    "gamma nan": (lambda plan: with_gamma(plan, *[math.nan] * 8), "must be a finite number"),
    "gamma 0": (lambda plan: with_gamma(plan, 0.0, *GAMMA[1:]), "an input of 0 on x is implausible"),
    "gamma huge": (lambda plan: with_gamma(plan, 1e9, *GAMMA[1:]), "an input of 1e+09 on x is implausible"),
    "delay": (lambda plan: replace(plan, belief={**plan.belief, "delay": [-9.0] * 4}), "delay: must be from 0 to 5 s"),
    "duration": (lambda plan: replace(plan, duration=1e9), "duration: 1e+09 exceeds the limit 1800"),
    "ramp": (lambda plan: replace(plan, ramp=1e308), "ramp: 1e+308 exceeds the limit 20"),
    "lower": (lambda plan: replace(plan, space=replace(SPACE, lower=(-1e308, -3.0, 0.3))), "1e+308 exceeds the"),
    "upper": (lambda plan: replace(plan, space=replace(SPACE, upper=(3.0, 3.0, math.inf))), "must be a list of finite"),
    "speed": (lambda plan: replace(plan, space=replace(SPACE, speed=1e9)), "speed: 1e+09 exceeds the limit 30"),
    "climb": (lambda plan: replace(plan, space=replace(SPACE, climb=math.nan)), "climb: must be a finite number"),
    "stiffness": (
        lambda plan: replace(plan, feedback=replace(FEEDBACK, stiffness=(1e6,) * 4)),
        "stiffness: 1e+06 exceeds the limit 100",
    ),
    "filter": (lambda plan: replace(plan, feedback=replace(FEEDBACK, filter_time=1e9)), "filter_time: 1e+09 exceeds"),
    "rate": (lambda plan: replace(plan, rate=math.nan), "rate: must be a finite number"),
    "leaving": (lambda plan: replace(plan, predicted={"leaving": math.nan}), "must be a finite number"),
    "allowed": (lambda plan: replace(plan, predicted={"allowed": 9.0}), "allowed: must be a share from 0 to 1"),
    "amplitude": (
        lambda plan: replace(plan, excitations=(AxisExcitation("x", "command", 0, 9, Sines((1e9,), (1.0,), (0.0,))),)),
        "amplitude: 1e+09 exceeds the limit 100",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "told"), DISARMING.values(), ids=DISARMING)
def test_a_plan_that_would_disarm_a_guard_is_refused_in_memory_as_in_a_file(
    change: Callable[[Plan], Plan], told: str
) -> None:
    link = Watched(room_link())
    with pytest.raises(PlanError) as refused:
        preflight(change(believed()), link)

    assert told in str(refused.value)
    assert "\n" not in str(refused.value)
    assert link.sent == []


ODD = {
    "a speed from which it cannot stop in the box": (
        lambda plan: replace(plan, space=replace(SPACE, speed=20.0)), "speed 20 m/s: stopping from there takes",
    ),
    "a climb from which it cannot stop": (
        lambda plan: replace(plan, space=replace(SPACE, climb=20.0)), "climb 20 m/s: stopping from there takes",
    ),
    "commands far beyond full scale": (
        lambda plan: replace(plan, excitations=(AxisExcitation("x", "command", 0.0, 9.0, Steps((0.0,), (50.0,))),)),
        "a command of 50 on x is far beyond full scale, 1",
    ),
    "a reference outside of the box": (
        lambda plan: replace(
            plan, excitations=(AxisExcitation("x", "position", 0.0, 20.0, Sines((50.0,), (0.3,), (0.0,))),)
        ),
        "references of",
    ),
    "a belief that the card contradicts": (
        lambda plan: with_gamma(plan, 100.0, *GAMMA[1:]), "a full tilt on x is believed to do",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "told"), ODD.values(), ids=ODD)
def test_numbers_that_neither_room_nor_vehicle_allow_are_refused(change: Callable[[Plan], Plan], told: str) -> None:
    plan = change(believed())
    plan = replace(plan, belief={name: value for name, value in plan.belief.items() if name != "covariance"})

    assert told in wrong(preflight(plan, room_link()))["numbers"]
