"""Clocks that drift or step inside one recording: put right by when the messages arrived."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clean_flights import clean_flights
from flights import CARD, steps
from rotorfit.core.card import Card, Channel
from rotorfit.core.frames import Array
from rotorfit.core.log import Log
from rotorfit.core.model import STRUCTURE
from rotorfit.diagnosis.card_choice import card_of
from rotorfit.diagnosis.clock_checks import clock_findings
from rotorfit.diagnosis.recording import recording_of
from rotorfit.estimation.fitting import fit
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.clocks.sender_drift import correction, on_the_recorders_clock
from rotorfit.simulation.paper_vehicle import Truth, as_log, simulate_flight

NS = 1e9
EARLY_BY = {
    "s01": (6.216, 11.949),
    "s02": (4.756, 8.645),
    "s03": (4.620, 9.071),
    "s04": (5.433, 11.337),
    "s05": (6.035, 11.347),
    "s06": (5.037, 10.005),
}
"""Recorded flight to how early its poses are stamped, in the mean and at the end [ms], as measured beside it."""


def stamped(error: Array, time: Array, travel: Array) -> tuple[Array, Array]:
    """Stamps of a clock that is behind by `error`, and arrivals [ns]."""
    return np.round((time - error) * NS).astype(np.int64), np.round((time + travel) * NS).astype(np.int64)


def arrivals_of(seed: int, rate: float, duration: float, scale: float) -> tuple[Array, Array]:
    """True times of messages, and how long each travels: a least time, an exponential tail, and order kept."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, duration, 1 / rate)
    travel = 0.0005 + rng.exponential(scale, time.size)
    return time, np.maximum.accumulate(time + travel) - time


@pytest.mark.parametrize("drift", [2e-4, -2e-4, 5e-4])
@pytest.mark.parametrize("scale", [0.001, 0.005])
def test_a_drift_is_taken_off_to_a_fraction_of_the_travel(drift: float, scale: float) -> None:
    time, travel = arrivals_of(1, 50.0, 60.0, scale)
    error = drift * time

    found = correction(*stamped(error, time, travel))

    assert found is not None
    assert found.drift == pytest.approx(drift, abs=1e-5)
    np.testing.assert_allclose(found.error - error, np.mean(found.error - error), atol=0.001)
    assert found.half_width < 3 * scale


@pytest.mark.parametrize("size", [0.1, -0.1])
def test_a_step_is_a_step_and_no_drift(size: float) -> None:
    time, travel = arrivals_of(2, 100.0, 60.0, 0.002)
    error = np.where(time > 20, size, 0.0)

    found = correction(*stamped(error, time, travel))

    assert found is not None
    assert found.drift == 0.0
    assert found.steps == pytest.approx([size], abs=0.001)
    np.testing.assert_allclose(np.ptp(found.error), abs(size), atol=0.001)
    np.testing.assert_allclose(found.error - error, np.mean(found.error - error), atol=0.001)


def test_a_slower_route_and_a_stretch_of_late_messages_are_no_error_of_the_clock() -> None:
    time, travel = arrivals_of(3, 100.0, 60.0, 0.002)

    assert correction(*stamped(0 * time, time, travel + np.where(time > 30, 0.1, 0.0))) is None
    assert correction(*stamped(0 * time, time, travel + np.where(abs(time - 30) < 5, 0.05, 0.0))) is None


def test_clocks_that_agree_are_left_alone_however_late_their_messages_are() -> None:
    rng = np.random.default_rng(0)
    corrected = 0
    for seed in range(200):
        time, travel = arrivals_of(seed, float(rng.choice([15, 50, 120])), rng.uniform(20, 90), rng.uniform(0, 0.02))
        corrected += correction(*stamped(0 * time + 0.003, time, travel)) is not None

    assert corrected <= 1


def with_clock(log: Log, table: str, change: Array) -> Log:
    """The log with the sender's stamps of a table changed [s]."""
    columns = log.tables[table].columns
    moved = columns["header.stamp"] + np.round(change * NS).astype(np.int64)
    new = replace(log.tables[table], columns={**columns, "header.stamp": moved})
    return replace(log, tables={**log.tables, table: new})


@pytest.mark.parametrize("kind", ["drift", "step back", "step on"])
def test_the_delay_of_a_flight_whose_pose_clock_is_wrong_is_that_of_the_right_one_and_wider(kind: str) -> None:
    truth = replace(Truth(), stale_share=0.0)
    log = as_log(simulate_flight(truth, steps(("z",), seed=4), 60.0, 4))
    time = (log.tables["/pose"].columns["header.stamp"] - log.tables["/pose"].columns["header.stamp"][0]) / NS
    change = {"drift": -4e-4 * time, "step back": -0.1 * (time > 25), "step on": 0.1 * (time > 25)}[kind]
    right = fit([flight_from_log(log, CARD)], axes=("z",), structure=STRUCTURE).model.axes["z"]
    flight = flight_from_log(with_clock(log, "/pose", change), CARD)
    wrong = fit([flight], axes=("z",), structure=STRUCTURE).model.axes["z"]

    assert flight.stamp_error > 0
    assert any(note.code == "pose_clock_corrected" for note in flight.notes)
    assert wrong.delay == pytest.approx(right.delay, abs=0.001)
    assert wrong.input == pytest.approx(right.input, rel=0.01)
    width = [ends[1] - ends[0] for ends in (right.ci95["delay"], wrong.ci95["delay"])]
    assert width[0] < width[1] < 2 * width[0]


def by_the_recorder(log: Log) -> tuple[Log, Card]:
    """The log with commands stamped by the recorder only, and its card."""
    table = log.tables["/cmd_vel"]
    columns = {name: values for name, values in table.columns.items() if name != "header.stamp"}
    columns["log_time"] = table.columns.get("log_time", table.columns["header.stamp"])
    card = replace(CARD, command_time=Channel("/cmd_vel:log_time"))
    return replace(log, tables={**log.tables, "/cmd_vel": replace(table, columns=columns)}), card


@pytest.mark.parametrize("ahead", [0.03, -0.03])
def test_poses_that_arrive_before_they_are_sent_are_moved_where_the_recorder_stamps_the_commands(ahead: float) -> None:
    log = as_log(simulate_flight(replace(Truth(), stale_share=0.0), steps(("z",), seed=4), 60.0, 4))
    recorded, card = by_the_recorder(log)
    right = fit([flight_from_log(recorded, card)], axes=("z",), structure=STRUCTURE).model.axes["z"]
    count = len(log.tables["/pose"].columns["header.stamp"])

    flight = flight_from_log(with_clock(recorded, "/pose", np.full(count, ahead)), card)
    moved = fit([flight], axes=("z",), structure=STRUCTURE).model.axes["z"]

    told = [note.text for note in flight.notes if note.code == "pose_clock_corrected"]
    if ahead > 0:
        assert "is ahead by" in told[0]
        assert moved.delay == pytest.approx(right.delay, abs=0.01)
        assert moved.ci95["delay"][0] < right.delay < moved.ci95["delay"][1]
    else:
        assert not told  # late stamps may be a long way


def test_a_corrected_clock_is_an_info_with_its_step_and_without_a_drift() -> None:
    log = as_log(simulate_flight(Truth(), steps(("z",), seed=4), 60.0, 4))
    time = (log.tables["/pose"].columns["header.stamp"] - log.tables["/pose"].columns["header.stamp"][0]) / NS
    log = with_clock(log, "/pose", 0.1 * (time > 25))
    flight = flight_from_log(log, CARD)

    found = [one for one in clock_findings(recording_of(log, flight)) if one.code == "clock_drift"]
    assert [one.severity for one in found] == ["info"]
    assert "steps by -100 ms" in found[0].evidence
    assert "us/s" not in found[0].evidence


def test_no_clock_of_forty_clean_flights_is_corrected() -> None:
    assert [flight.stamp_error for _, _, _, flight in clean_flights(range(40))] == [0.0] * 40


@pytest.mark.parametrize("name", EARLY_BY)
def test_poses_of_a_real_autopilot_come_out_on_time(real_flights: Path, name: str) -> None:
    log = read(real_flights / "arducopter-sitl" / f"{name}.mcap")
    moved, notes, unknown = on_the_recorders_clock(log, card_of(log))

    stamps = log.tables["/rotorfit/pose"].columns["header.stamp"]
    commands = log.tables["/rotorfit/command"].columns["header.stamp"]
    flown = (stamps >= commands[0]) & (stamps <= commands[-1])
    early = (moved.retimed["/rotorfit/pose", "header.stamp"] - stamps)[flown] / 1e6
    assert np.mean(early) == pytest.approx(EARLY_BY[name][0], abs=0.3)
    assert early[-1] == pytest.approx(EARLY_BY[name][1], abs=0.6)
    assert unknown < 0.004
    assert [note.code for note in notes] == ["pose_clock_corrected"]
