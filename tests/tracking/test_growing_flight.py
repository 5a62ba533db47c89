"""A stream of samples as the flight so far: faults of radios, clocks and sensors neither end it nor raise an alarm."""

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from streams import CARD, SECOND, flown, frozen, jumped, mixed, reset

from rotorfit.core.flight_data import Flight
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Alarm
from rotorfit.files.cards import card_from_mapping
from rotorfit.tracking import growing_flight
from rotorfit.tracking.flight_so_far import FlightSoFar
from rotorfit.tracking.growing_flight import GrowingFlight

TAKEN_OFF, SINKS, DURATION = 4.0, 51.0, 59.0
"""Of the flight that is shared: the vehicle climbs, and sinks, by itself [s]."""


def grown(samples: Sequence[Sample]) -> tuple[Flight, list[Alarm]]:
    growing, alarms = GrowingFlight(CARD), []
    for sample in samples:
        growing.add(sample)
        alarms += growing.alarms()
    flight = growing.flight()
    assert flight is not None
    return flight, alarms


@cache
def begun(seconds: float) -> tuple[Sample, ...]:
    """The first seconds of the flight that is shared: what happens in them needs no landing."""
    first = flown()[0].received
    return tuple(one for one in flown() if one.received - first < seconds * SECOND)


@cache
def usual(seconds: float = 99.0) -> tuple[Flight, list[Alarm]]:
    """The flight that is shared, without a fault."""
    return grown(begun(seconds))


def counts(flight: Flight) -> dict[str, int]:
    return {note.code: note.count for note in flight.notes}


def test_nothing_is_learnt_on_the_ground_nor_while_the_vehicle_takes_off_or_lands_by_itself() -> None:
    flight, alarms = usual()

    assert not alarms
    assert len(flight.segments) == 1
    assert TAKEN_OFF + 1.5 < flight.segments[0].start < 9.0
    assert 45.0 < flight.segments[0].end <= SINKS


@pytest.mark.parametrize("seed", [2, 7, 8, 10, 15])  # each fault is in one of them
def test_faults_of_the_stream_are_no_alarm_and_leave_a_sound_flight(seed: int) -> None:
    flight, alarms = grown(mixed(flown(), seed))

    assert not alarms
    assert (np.diff(flight.pose_time) > 0).all()
    assert (np.diff(flight.command_time) > 0).all()
    assert all(np.isfinite(part).all() for part in (flight.position, flight.yaw, flight.command))
    assert all(a.end <= b.start for a, b in zip(flight.segments, flight.segments[1:], strict=False))
    assert flight.duration > 15.0
    # every pose that counts is one of the vehicle's
    assert np.abs(flight.position).max() < 4.0


def test_a_frozen_pose_is_one_alarm_at_once_however_long_it_lasts() -> None:
    _, alarms = grown(frozen(begun(28.0), 20.0, 6.0))

    assert [alarm.cause for alarm in alarms] == ["pose_frozen"]
    assert 20.4 < alarms[0].time < 20.8
    assert alarms[0].since[0] == pytest.approx(20.0, abs=0.02)


def test_a_pose_that_repeats_itself_on_the_ground_is_no_alarm() -> None:
    """A sensor without noise says the same of a vehicle that stands, whatever is asked of it."""
    still = tuple(
        replace(one, values=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)) if one.stream == "pose" else
        replace(one, values=(0.3, 0.0, 0.0, 0.0))
        for one in flown()[: len(flown()) // 30]
    )  # fmt: skip
    growing = GrowingFlight(CARD)
    for one in still:
        growing.add(one)

    assert growing.alarms() == ()
    assert growing.flight() is None


def test_a_pose_that_jumps_is_an_alarm_at_once_and_cuts_the_flight() -> None:
    flight, alarms = grown(jumped(begun(24.0), 20.0, (1.0, 0.0, 0.0)))

    assert [(alarm.cause, alarm.turned) for alarm in alarms] == [("pose_jumped", False)]
    assert 20.0 <= alarms[0].time < 20.1
    assert "1.0" in alarms[0].why
    assert any(abs(a.end - b.start) < 1e-6 and 19.99 < b.start < 20.1
               for a, b in zip(flight.segments, flight.segments[1:], strict=False))  # fmt: skip


@pytest.mark.parametrize("degrees", [10.0, 15.0, -20.0])
def test_a_heading_that_is_reset_is_an_alarm_and_no_motion(degrees: float) -> None:
    _, alarms = grown(reset(begun(24.0), 20.0, np.radians(degrees)))

    assert [(alarm.cause, alarm.turned) for alarm in alarms] == [("pose_jumped", True)]
    assert 20.0 <= alarms[0].time < 20.1
    assert "x and y are learnt anew" in alarms[0].why


def test_a_single_wild_pose_is_left_out() -> None:
    samples = list(begun(20.0))
    at = next(i for i, one in enumerate(samples) if one.stream == "pose" and i > 4000)
    samples[at] = replace(samples[at], values=(9.0, 9.0, 9.0, *samples[at].values[3:]))
    flight, alarms = grown(samples)

    assert not alarms
    assert counts(flight)["wild_poses"] == 1
    assert len(flight.segments) == 1


@pytest.mark.parametrize("degrees", [4.0, 8.0, 12.0, 40.0])
def test_a_single_wild_heading_is_no_jump_be_it_seen_or_not(degrees: float) -> None:
    samples = list(begun(22.0))
    poses = [i for i, one in enumerate(samples) if one.stream == "pose"]
    for at in poses[1000:4000:150]:
        (samples[at],) = reset(samples[at : at + 1], 0.0, np.radians(degrees))
    flight, alarms = grown(samples)

    assert not alarms
    assert len(flight.segments) == 1


def test_what_a_stalled_link_delivers_at_once_is_late_and_no_other_clock() -> None:
    samples, begin, end = begun(28.0), 20 * SECOND, int(22.5 * SECOND)
    first = samples[0].received
    held = [
        replace(one, received=first + end) if begin < one.received - first < end and one.stream == "pose" else one
        for one in samples
    ]
    flight, alarms = grown(sorted(held, key=lambda one: one.received))

    whole, _ = usual(28.0)
    assert not alarms
    later = flight.pose_time > 23.0
    np.testing.assert_array_equal(flight.pose_time[later], whole.pose_time[whole.pose_time > 23.0])
    assert later.sum() > 500
    assert 0 < counts(flight)["strange_stamps"] < 200


@pytest.mark.parametrize("stream", ["pose", "command"])
@pytest.mark.parametrize("at", [0, 4000])
def test_without_arrivals_a_stamp_far_ahead_costs_one_sample(stream: str, at: int) -> None:
    plain = [replace(one, received=0) for one in flown()[:6000]]
    at = next(i for i in range(at, len(plain)) if plain[i].stream == stream)
    wild = replace(plain[at], stamp=plain[at].stamp + 3600 * SECOND)
    flight, alarms = grown([*plain[:at], wild, *plain[at + 1 :]])

    assert not alarms
    assert flight.span[1] == pytest.approx((plain[-1].stamp - plain[0].stamp) / SECOND, abs=0.05)
    assert len(flight.segments) == 1
    assert counts(flight)["strange_stamps"] <= (1 if at > 3 else 2)  # the very first two only differ


def test_without_arrivals_a_pause_of_the_link_costs_nothing() -> None:
    plain = [replace(one, received=0, stamp=one.stamp + 10 * SECOND * (i >= 4000)) for i, one in enumerate(begun(24.0))]
    flight, alarms = grown(plain)
    whole, _ = usual(24.0)

    assert not alarms
    assert flight.pose_time.size == whole.pose_time.size
    assert "strange_stamps" not in counts(flight)


def test_without_arrivals_a_command_in_a_pause_of_the_poses_acts() -> None:
    plain = [replace(one, received=0) for one in begun(24.0)]
    begin, end = plain[4000].stamp, plain[4000].stamp + 10 * SECOND
    (last,) = [one for one in plain if one.stream == "command" and one.stamp < begin][-1:]
    paused = [one for one in plain if one.stamp < begin]
    paused += [replace(last, stamp=begin + 5 * SECOND, values=(0.5, 0.0, 0.0, 0.0))]
    paused += [replace(one, stamp=one.stamp + end - begin) for one in plain if one.stamp > begin]
    flight, _ = grown(paused)

    assert "strange_stamps" not in counts(flight)
    assert 0.5 in flight.command[:, 0]


def test_a_state_file_keeps_positions_to_the_last_digit() -> None:
    growing, again = GrowingFlight(CARD), GrowingFlight(CARD)
    away = np.array([4.5e5, 5.3e6, 0.0, 0.0, 0.0, 0.0, 0.0])
    for one in flown()[:4000]:
        growing.add(replace(one, values=tuple(np.add(one.values, away).tolist())) if one.stream == "pose" else one)
    again.recall(growing.memory())

    rows, recalled = growing.rows[1], again.rows[1]
    np.testing.assert_array_equal(recalled.values, rows.values[-len(recalled.values) :])


def test_commands_of_another_clock_are_timed_by_their_arrival() -> None:
    there = [replace(one, stamp=one.stamp + 10**15) if one.stream == "command" else one for one in begun(24.0)]
    flight, alarms = grown(there)
    plain, _ = usual(24.0)

    assert not alarms
    heard = plain.command_time[-flight.command_time.size :]  # without those until the clock is seen to be another one
    assert flight.command_time == pytest.approx(heard - heard[0], abs=1e-6)
    assert plain.command_time[0] == 0.0


def test_that_another_clock_is_not_used_is_told_once() -> None:
    growing = GrowingFlight(CARD)
    for one in flown()[:3000]:
        growing.add(replace(one, stamp=one.stamp - 10**13) if one.stream == "pose" else one)
    (told,) = growing.remarks()

    assert "the clock of the poses is another one: from here on they are timed by their arrival" in told


def test_a_step_of_the_poses_clock_is_removed_and_told_also_over_a_restart() -> None:
    at = flown()[0].stamp + 14 * SECOND
    back = [
        replace(one, stamp=one.stamp - 60_000_000) if one.stream == "pose" and one.stamp > at else one
        for one in begun(24.0)
    ]
    growing, again = GrowingFlight(CARD), GrowingFlight(CARD)
    for one in back[:5000]:
        growing.add(one)
    (told,) = growing.remarks()
    again.recall(growing.memory())
    for one in back[5000:]:
        again.add(one)
    flight, (whole, _) = again.flight(), usual(24.0)

    assert "the clock of the poses was set back by 60 ms" in told
    assert not growing.remarks()
    assert flight is not None
    assert counts(flight)["pose_clock_steps"] == 1
    assert not again.alarms()
    np.testing.assert_allclose(flight.pose_time, whole.pose_time, atol=0.002)
    np.testing.assert_array_equal(flight.position, whole.position)


def test_commands_that_were_not_heard_are_not_guessed() -> None:
    """The card says that a command holds for half a second; who sends 50 a second has not held one for 0.3 s."""
    begin = flown()[0].received
    heard = [one for one in begun(24.0) if one.stream != "command" or not 20.0 < (one.received - begin) / SECOND < 20.3]
    flight, alarms = grown(heard)

    assert not alarms
    assert len(flight.segments) == 2
    assert flight.segments[1].start - flight.segments[0].end == pytest.approx(0.22, abs=0.05)


def test_poses_repeated_in_faster_rows_may_be_a_row_late_here_and_beside_and_after_a_restart() -> None:
    growing, beside, again = GrowingFlight(CARD), FlightSoFar(CARD), GrowingFlight(CARD)
    latest: dict[str, Sample] = {}
    frames = 0
    for sample in flown()[:6000]:
        if sample.stream == "pose":
            frames += 1
            if frames % 2 or "pose" not in latest:
                latest["pose"] = sample
            sample = replace(sample, values=latest["pose"].values)
        growing.add(sample)
    beside.take(growing.news())
    again.recall(growing.memory())
    flights = growing.flight(), beside.flight(), again.flight()

    assert [flight and flight.pose_lateness for flight in flights] == [pytest.approx(1 / 120, rel=0.02)] * 3
    assert grown(flown()[:6000])[0].pose_lateness == 0.0  # frames that are lost at random


def test_what_a_link_does_not_know_of_its_stamps_goes_to_the_flight_here_and_beside() -> None:
    time = {"from": CARD.raw["command"]["time"], "error": 0.04}
    card = card_from_mapping({**CARD.raw, "command": {**CARD.raw["command"], "time": time}}, "stated")
    growing, beside = GrowingFlight(card), FlightSoFar(card)
    for sample in flown()[:4000]:
        growing.add(replace(sample, error=0.03 * (sample.stream == "pose")))
    beside.take(growing.news())
    flights = growing.flight(), beside.flight(), grown(flown()[:4000])[0]

    assert [flight and flight.shared_error for flight in flights] == [0.05, 0.05, 0.0]


def test_yaw_goes_on_over_the_turn() -> None:
    growing = GrowingFlight(CARD)
    for number in range(2000):
        t, angle = number * SECOND // 100, 0.01 * number
        growing.add(Sample("command", t, t, (0.0, 0.0, 0.0, 0.5)))
        growing.add(Sample("pose", t, t, (0.0, 0.0, 1.0, np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2))))
    flight = growing.flight()

    assert flight is not None
    assert not growing.alarms()
    assert flight.yaw[-1] - flight.yaw[0] == pytest.approx(20.0, abs=0.05)


def test_what_the_vehicle_says_of_itself_closes_the_flight() -> None:
    samples = [*flown()[:6000], Sample("obeys", 0, 0, (0.0,)), *flown()[6000:7000]]
    flight, _ = grown(samples)
    end = (flown()[6000].stamp - flown()[0].stamp) / 1e9

    assert flight.segments[-1].end == pytest.approx(end, abs=0.05)


def test_nothing_is_learnt_while_the_window_is_closed_from_the_start_or_in_flight() -> None:
    samples, shut, open_ = flown()[:8000], Sample("obeys", 0, 0, (0.0,)), Sample("obeys", 0, 0, (1.0,))
    flight, _ = grown(
        [shut, *samples[:2000], open_, *samples[2000:6000], shut, *samples[6000:7000], open_, *samples[7000:]]
    )
    begin = next(one.stamp for one in samples[2000:] if one.stream == "command")  # second 0, as in a log
    times = [(samples[place].stamp - begin) / 1e9 for place in (6000, 7000)]

    first, second = flight.segments
    assert 0.0 <= first.start < 1.0
    assert first.end == pytest.approx(times[0], abs=0.05)
    assert times[1] <= second.start + 0.02
    assert second.start < times[1] + 1.0


def test_second_0_is_the_first_command_however_long_the_vehicle_was_seen_before() -> None:
    plain = [*flown()[:6000], *(replace(one, values=(0.1,) * 4) for one in flown()[:200] if one.stream == "command")]
    idle = [replace(one, stamp=one.stamp - 60 * SECOND, received=one.received - 60 * SECOND) for one in plain]
    seen = [one for one in idle if one.stream == "pose"]
    flight, _ = grown([*seen, *plain])
    whole, _ = grown(plain)

    np.testing.assert_array_equal(flight.command_time, whole.command_time)
    np.testing.assert_array_equal(flight.pose_time, whole.pose_time)
    assert flight.span[0] == flight.command_time[0] == 0.0


def test_it_goes_on_from_its_memory() -> None:
    samples = begun(32.0)
    at = len(samples) // 2
    first = GrowingFlight(CARD)
    for one in samples[:at]:
        first.add(one)
    second = GrowingFlight(CARD)
    memory = first.memory()
    del memory["pose_lateness"]  # as version 0.1 wrote it at first
    second.recall(memory)
    for one in samples[at:]:
        first.add(one)
        second.add(one)
    a, b = first.flight(), second.flight()

    assert a is not None
    assert b is not None
    assert np.array_equal(a.pose_time, b.pose_time)
    assert a.notes == b.notes
    assert a.segments[0].start == b.segments[0].start
    assert a.segments[-1].end == pytest.approx(b.segments[-1].end, abs=1.5)


def test_a_day_takes_no_more_memory_than_what_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """40 minutes of 1 Hz, of which 50 s are kept: as of half a day of 15 minutes kept, all is forgotten 48 times."""
    monkeypatch.setattr(growing_flight, "KEPT", 50.0)
    tracemalloc.start()
    growing, sizes = GrowingFlight(CARD), []
    for second in range(2400):
        t = second * SECOND
        growing.add(Sample("command", t, t, (0.1 * (second % 3), 0.0, 0.0, 0.0)))
        growing.add(Sample("pose", t, t, (0.3 * (second % 7), 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)))
        if second % 100 == 99:
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()

    assert max(sizes[2:]) < 1.1 * sizes[1]  # by then all that is kept has been forgotten once
    flight = growing.flight()
    assert flight is not None
    assert flight.pose_time[0] >= 2400 - 52.0
