"""Looks in a process beside: the same states, none lost, nothing left behind, and a failure that is told."""

import pytest
from streams import CARD, flown

from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Tracked
from rotorfit.tracking.looks_beside import LooksBeside
from rotorfit.tracking.tracker import Tracker
from tracked_flights import LAW

pytestmark = pytest.mark.flights

LAST = 9.0
"""So much of the flight is given to trackers here [s]."""


def samples() -> list[Sample]:
    flight = flown(ground=False)
    return [one for one in flight if one.received < flight[0].received + LAST * 1e9]


def states_of(tracker: Tracker) -> list[Tracked]:
    told = []
    for sample in samples():
        tracker.update(sample)
        told += tracker.news()
    last, _ = tracker.finish()
    return [*told, *tracker.news(), last]


def test_looks_beside_tell_what_looks_here_tell() -> None:
    here, beside = states_of(Tracker(CARD, LAW)), states_of(Tracker(CARD, LAW, live=True, paced=True))

    assert [state.time for state in beside] == [state.time for state in here]
    for one, other in zip(beside, here, strict=True):
        for axis, known in one.axes.items():
            assert known.state == other.axes[axis].state
            told = {name: value for name, value in known.values.items() if value is not None}
            there = {name: value for name, value in other.axes[axis].values.items() if value is not None}
            assert told == pytest.approx(there, rel=1e-4)  # what compiles rounds otherwise than what loads


def test_a_machine_that_is_behind_leaves_looks_out_and_goes_on_where_the_flight_is() -> None:
    told = states_of(Tracker(CARD, LAW, live=True))

    assert 1 < len(told) < LAST
    assert told[-1].time == pytest.approx(LAST, abs=0.1)
    assert told[-1].axes["x"].values["input"] is not None


def test_what_fails_beside_is_told_with_its_trace_and_leaves_no_process() -> None:
    with (
        pytest.raises(RuntimeError, match=r"(?s)Traceback.*no such structure"),
        Tracker(CARD, "none", live=True) as one,
    ):
        states_of(one)

    assert process_of(one).poll() is not None


def test_a_process_that_was_killed_is_one_line() -> None:
    with Tracker(CARD, LAW, live=True) as tracker:
        process_of(tracker).kill()
        with pytest.raises(LinkError, match="ended from outside"):
            states_of(tracker)


def test_a_tracker_that_saw_nothing_ends_without_regimes() -> None:
    assert Tracker(CARD, live=True).finish()[1] == ()


def process_of(tracker: Tracker):  # type: ignore[no-untyped-def]
    assert isinstance(tracker._looks, LooksBeside)
    return tracker._looks._process
