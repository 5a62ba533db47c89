"""Samples in, states out: the same as from the recorded flight, whatever the order they come in."""

import json
import re
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from streams import jumped
from tracking_samples import samples_of

from flights import CARD
from rotorfit.core.errors import CardError, LogError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Alarm, Tracked
from rotorfit.estimation.likelihood.optima import between
from rotorfit.tracking import growing_flight
from rotorfit.tracking.following import Following
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.regimes import regimes_of
from rotorfit.tracking.replayed import until
from rotorfit.tracking.tracker import Tracker
from tracked_flights import LAW, known, known_flight

pytestmark = pytest.mark.flights


def state_of(samples: list[Sample]) -> Tracked:
    tracker = Tracker(CARD, LAW, origin=0)
    for sample in samples:
        tracker.update(sample)
    return tracker.state()


@pytest.fixture(scope="module")
def live() -> Tracked:
    return state_of(samples_of(known_flight()))


def test_a_live_stream_tells_what_the_log_tells(live: Tracked) -> None:
    recorded = next(state for state in known()[1].states if state.time == 13.0)

    assert live.time == pytest.approx(13.0, abs=0.05)
    for axis in AXES:
        assert live.axes[axis].knowledge == recorded.axes[axis].knowledge
        for name, value in recorded.axes[axis].values.items():
            if value is not None:
                low, high = recorded.axes[axis].ci95[name]
                assert low is not None
                assert high is not None
                assert live.axes[axis].values[name] == pytest.approx(value, abs=0.25 * (high - low))


def test_doubled_late_and_broken_samples_change_nothing(live: Tracked) -> None:
    samples, out = samples_of(known_flight()), []
    for k, sample in enumerate(samples):
        out.append(sample)
        if k % 7 == 0:
            out.append(sample)
        if k % 50 == 49:
            out.append(samples[k - 20])
        if k % 100 == 0 and sample.stream == "pose":  # a command that is no number ends the one before
            out.append(Sample(sample.stream, sample.stamp + 1, sample.stamp, (float("nan"),) * len(sample.values)))
        if k % 100 == 50:
            out.append(Sample("said", sample.stamp, sample.stamp, (), "battery is low"))

    for axis, known_ in state_of(out).axes.items():
        for name, (low, high) in live.axes[axis].ci95.items():
            assert known_.values[name] == pytest.approx(live.axes[axis].values[name], abs=0.25 * (high - low))


@pytest.mark.parametrize(
    ("stream", "values", "told"),
    [
        ("poze", (0.0,) * 7, "no stream 'poze'; a sample is one of pose, velocity, command"),
        ("pose", (0.0,) * 3, "a sample of 'pose' has 7 values, not 3"),
        ("command", (0.0,) * 2, "a sample of 'command' has 4 values, not 2"),
        ("command", (0.0, "1", 0.0, 0.0), "a sample of 'command' has the value '1'; give numbers, NaN where one is"),
        ("pose", (None,) * 7, "a sample of 'pose' has the value None; give numbers, NaN where one is unknown"),
    ],
)
def test_what_no_link_sends_is_refused(stream: str, values: tuple[Any, ...], told: str) -> None:
    with pytest.raises(LogError, match=told):
        Tracker(CARD).update(Sample(stream, 1, 1, values))  # type: ignore[arg-type]


def test_a_card_whose_commands_are_along_the_world_is_refused() -> None:
    with pytest.raises(CardError, match="turn them by the heading"):
        Tracker(replace(CARD, command_frame="world"))


def test_a_tracker_that_has_taken_samples_recalls_nothing() -> None:
    tracker, memory = Tracker(CARD), Tracker(CARD).memory()
    for one in samples_of(known_flight())[:3]:
        tracker.update(one)

    with pytest.raises(ValueError, match="recall into a new one"):
        tracker.recall(memory)


def test_a_memory_that_lacks_something_is_refused_before_the_process_beside_gets_it() -> None:
    memory = Tracker(CARD).memory()
    told = json.loads(str(memory["following"]))
    del told["since"]

    with Tracker(CARD, live=True) as tracker, pytest.raises(KeyError, match="since"):
        tracker.recall({**memory, "following": np.array(json.dumps(told))})


def test_a_recalled_tracker_tells_the_changes_of_the_flight() -> None:
    alarm, before = Alarm(3.0, ("x",), "limits", (2.0, 2.5), {}, 0.9, 1e-9, "because"), Tracker(CARD)
    for one in samples_of(known_flight())[:30]:
        before.update(one)
    memory = before.memory()
    told = json.loads(str(memory["following"]))
    told |= {"bounds": [[0.0, None], [2.0, asdict(alarm)]], "unlike": ["z"]}
    tracker = Tracker(CARD)
    tracker.recall({**memory, "following": np.array(json.dumps(told))})

    assert (tracker.changes, tracker.another) == ([alarm], True)
    assert (Tracker(CARD).changes, Tracker(CARD).another) == ([], False)


@pytest.mark.parametrize("live", [False, True])
def test_a_tracker_that_is_finished_again_says_the_same(live: bool) -> None:
    tracker = Tracker(CARD, LAW, origin=0, live=live)
    for one in samples_of(known_flight()):
        if one.stamp < 7e9:
            tracker.update(one)

    assert tracker.finish() is tracker.finish()


def test_a_landing_that_is_not_ours_is_no_wind() -> None:
    """The table after a flight tells the wind in which it was flown, as from the recording."""
    growing, samples = GrowingFlight(CARD, origin=0), samples_of(known_flight())
    for one in samples:
        growing.add(one)
    end, last = growing.now, next(one for one in reversed(samples) if one.stream == "pose")
    growing.add(Sample("obeys", last.stamp, last.stamp, (0.0,)))
    for n in range(1, 150):
        x, y, z, *turned = last.values
        stamp = last.stamp + 20_000_000 * n
        growing.add(Sample("pose", stamp, stamp, (x, y, z - 0.01 * n, *turned)))
    flight = growing.flight()
    assert flight is not None
    flight = replace(flight, axes=("z",))

    landed, _ = Following(LAW).finish(flight, growing.now)
    ours, _ = Following(LAW).finish(until(flight, end), end)

    assert landed.time == pytest.approx(end + 3.0, abs=0.1)
    assert ours.axes["z"].wind is not None
    assert landed.axes == ours.axes


def test_nothing_is_told_before_5_s() -> None:
    few = state_of([one for one in samples_of(known_flight()) if one.stamp < 4.9e9])

    assert {axis.knowledge for axis in few.axes.values()} == {"learning"}
    assert {value for axis in few.axes.values() for value in axis.values.values()} == {None}
    assert all(not axis.ci95 for axis in few.axes.values())


def test_a_tracker_that_saw_nothing_ends_without_regimes() -> None:
    state, regimes = Tracker(CARD).finish()

    assert state.time == 0.0
    assert regimes == ()
    assert state.alarms == ()


@pytest.mark.parametrize("at", [4.96, 4.97, 4.98, 4.99])
def test_an_alarm_of_the_pose_is_told_whether_or_not_a_look_falls_on_it(at: float) -> None:
    tracker, told = Tracker(CARD, LAW, origin=0), []
    for k in range(520):
        stamp, x = 10_000_000 * k, 0.002 * k + (1.0 if k >= round(100 * at) else 0.0)
        before = tracker.state()
        tracker.update(Sample("command", stamp - 1, stamp, (0.1 + 0.01 * (k % 2), 0.0, 0.0, 0.0)))
        tracker.update(Sample("pose", stamp, stamp, (x, 0.0, 1.5, 1.0, 0.0, 0.0, 0.0)))
        told += [alarm.cause for alarm in tracker.state().alarms] if tracker.state() is not before else []

    assert told == ["pose_jumped"]


def test_a_regime_that_is_forgotten_has_the_model_of_its_own_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The yaw's gain is three times as large from 15 s on; at the end, 30 s, nothing before is remembered."""
    monkeypatch.setattr(growing_flight, "KEPT", 15.0)
    tracker = Tracker(CARD, LAW, origin=0)
    for one in samples_of(known_flight(), 30.0):
        *others, yaw = one.values
        more = one.stream == "command" and one.stamp > 15e9
        tracker.update(replace(one, values=(*others, 3.0 * yaw)) if more else one)
    _, (first, last) = tracker.finish()

    assert first.remembered == pytest.approx(15.0, abs=0.1)
    assert first.data == pytest.approx((1.0, 15.0), abs=0.6)
    assert re.fullmatch(r"seconds before 15\.0 were .* at the end: model from 1\.0 to 15\.\d s", first.forgotten)
    assert first.model is not None
    assert last.model is not None
    assert all(one.status["input"] == "ok" for one in first.model.axes.values())
    assert first.model.axes["yaw"].input == pytest.approx(3.0 * (last.model.axes["yaw"].input or 0.0), rel=0.1)
    assert first.model.axes["x"].input != last.model.axes["x"].input  # seconds after it do not stand in for its own


def test_a_regime_without_a_kept_model_says_that_its_seconds_are_forgotten() -> None:
    flight = known_flight()
    alarm = Alarm(8.0, ("yaw",), "limits", (7.0, 8.0), {}, 0.9, 1e-9, "because")
    late = between(flight, 20.0, 30.0)
    (first, last), _ = regimes_of(late, [(0.0, None), (7.5, alarm)], [AXES], LAW, 30.0)

    assert (first.model, first.data) == (None, None)
    assert first.forgotten == "seconds before 20.0 were no longer remembered at the end: no model"
    assert last.model is not None
    assert last.forgotten == "seconds before 20.0 were no longer remembered at the end: model from 20.0 to 30.0 s"
    (whole,), _ = regimes_of(flight, [(0.0, None)], [AXES], LAW, 30.0)
    assert whole.forgotten == ""


def test_the_state_that_follows_an_alarm_of_the_pose_is_of_that_moment() -> None:
    tracker, told = Tracker(CARD, LAW, origin=0), []
    for one in jumped(samples_of(known_flight(), 6.0), 5.6, (1.0, 0.0, 0.0)):
        tracker.update(one)
        told += tracker.news()
    (at,) = (state for state in told if state.alarms)

    assert at.time == pytest.approx(at.alarms[0].time, abs=0.03)
    assert [state.time for state in told] == sorted({state.time for state in told})


class Late:
    """Looks that are made when they are asked for and answered when released, as by a process that is busy."""

    def __init__(self, looks: Any) -> None:
        self._looks, self.released = looks, True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._looks, name)

    def answers(self) -> list[Any]:
        return list(self._looks.answers()) if self.released else []


def test_an_alarm_of_the_pose_is_told_at_once_and_once_though_looks_are_late() -> None:
    tracker, samples = Tracker(CARD, LAW, origin=0), samples_of(known_flight())
    tracker._looks = late = Late(tracker._looks)  # type: ignore[assignment]
    for sample in samples:
        tracker.update(sample)
    tracker.news()
    late.released = False
    last, pose = samples[-1].stamp, next(one for one in reversed(samples) if one.stream == "pose")
    for k in range(1, 40):
        x, *rest = pose.values
        there = (x + 3.0 + 0.001 * k, *rest)
        tracker.update(replace(pose, stamp=last + 8_000_000 * k, received=0, values=there))
    early = [alarm.cause for state in tracker.news() for alarm in state.alarms]
    late.released = True
    tracker.update(replace(pose, stamp=last + 8_000_000 * 40, received=0, values=there))
    after = [alarm.cause for state in tracker.news() for alarm in state.alarms]

    assert early == ["pose_jumped"]
    assert after == []
