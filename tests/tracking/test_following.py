"""Steps between refits lead to where the batch estimator stands, and never say more than it does."""

from dataclasses import replace

import pytest

from rotorfit.core.flight_data import Segment
from rotorfit.core.model import Interval
from rotorfit.tracking.following import Following
from rotorfit.tracking.refits import GroupEstimate, axis_report, read_backwards, refitted, renewed, stepped
from rotorfit.tracking.replayed import growing, until
from tracked_flights import LAW, known_flight

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


def test_a_segment_that_begins_is_seen_though_no_step_is_taken(early: GroupEstimate) -> None:
    """Else the information would be of another number of start velocities than there are."""
    flight = replace(until(known_flight(), 20.0), segments=(Segment(0.0, 18.0), Segment(18.5, 20.0)))
    held = stepped(replace(early, stepped=31.0), flight, 31.1)
    optimum = held.estimates["z"].optimum

    assert optimum.point.start.size == 2
    assert len(optimum.free) == len(optimum.score.information)


def test_the_interval_of_the_vehicle_is_no_narrower_than_that_of_this_flight(early: GroupEstimate) -> None:
    told = axis_report(early, "z")

    for name, (low, high) in told.ci95_flight.items():
        least, most = told.ci95[name]
        assert low is None or least is None or least <= low + 1e-12
        assert high is None or most is None or most >= high - 1e-12


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
    monkeypatch.setattr("rotorfit.tracking.following.LONGEST", 8.0)
    monkeypatch.setattr("rotorfit.tracking.refits.LONGEST", 8.0)
    following, told = Following(LAW), []
    for part, now in growing(until(known_flight(), 20.0), following.next_look):
        told.append((now, following.look(part, now).axes["z"].values["input"]))

    late = [value for now, value in told if now > 13.0]
    assert len(set(late)) >= 3
