"""Stamps of arrival: straightened where a regular sender shows through, and left alone where not."""

from dataclasses import replace

import numpy as np
import pytest

from flights import CARD, steps
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis.doctor import findings_of_flight
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.clocks.arrival import straightened
from rotorfit.flights.stamps import MISSING_STAMP, Stamps
from rotorfit.simulation.paper_vehicle import Truth, as_log, simulate_flight

START = 1_700_000_000 * 10**9


def arrivals(count: int, period: float, seed: int = 0, late: float = 0.03) -> tuple[np.ndarray, Stamps]:
    """When messages were sent [s], and when they came through a network that stalls [ns]."""
    rng = np.random.default_rng(seed)
    sent = period * np.arange(count)
    delay = np.where(rng.random(count) < 0.3, rng.exponential(late, count), 0) + rng.exponential(0.0005, count)
    came = np.maximum.accumulate(sent + delay)
    return sent, START + np.round(came * 1e9).astype(np.int64)


def stamps(time: np.ndarray) -> Stamps:
    return START + np.round(time * 1e9).astype(np.int64)


@pytest.mark.parametrize(("count", "period"), [(1000, 0.05), (3000, 0.01), (5000, 0.0083333)])
def test_arrivals_of_a_regular_sender_are_straightened(count: int, period: float) -> None:
    sent, came = arrivals(count, period)
    found = straightened(came)

    assert found is not None
    assert found.period == pytest.approx(period, rel=1e-5)
    error = (found.stamps - START) / 1e9 - sent
    assert np.std(error) < 1e-4
    assert 0 < np.mean(error) < 1e-3  # what even the promptest take stays
    assert found.mean == pytest.approx(np.mean((came - START) / 1e9 - sent), abs=1e-3)


def test_missing_stamps_stay_missing() -> None:
    _, came = arrivals(3000, 0.01)
    came[7] = MISSING_STAMP
    found = straightened(came)

    assert found is None or found.stamps[7] == MISSING_STAMP


@pytest.mark.parametrize("seed", range(20))
def test_a_sender_whose_intervals_vary_is_not_straightened(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 2000
    steps_of = (
        rng.exponential(0.02, n),
        np.where(rng.random(n) < 0.3, 0.001, 0.02),
        0.01 + rng.exponential(0.01, n) * (rng.random(n) < 0.3),
        np.where(rng.random(n) < 0.1, 0.002, rng.uniform(0.01, 0.04, n)),
    )
    assert [straightened(stamps(np.cumsum(each))) for each in steps_of] == [None] * 4


def test_regular_stamps_few_stamps_and_stamps_with_losses_stay() -> None:
    rng = np.random.default_rng(0)
    regular = 0.01 * np.arange(3000) + rng.uniform(0, 0.002, 3000)
    _, came = arrivals(3000, 0.05)

    assert straightened(stamps(regular)) is None
    assert straightened(came[:300]) is None
    assert straightened(came[rng.random(3000) > 0.05]) is None


# In a flight


def flown(table: str, arrive: bool, header: str | None) -> Log:
    """A flight whose poses or commands were stamped on arrival, with their header filled, constant, or absent."""
    log = as_log(simulate_flight(Truth(stale_share=0.0, pose_rate=50.0), steps(seed=1), 40.0, 1))
    columns = dict(log.tables[table].columns)
    sent = columns["header.stamp"]
    _, came = arrivals(len(sent), 0.02)
    columns["log_time"] = sent[0] + (came - START) if arrive else sent
    if header == "constant":
        columns["header.stamp"] = np.zeros_like(sent)
    if header is None:
        del columns["header.stamp"]
    return replace(log, tables={**log.tables, table: Table(table, columns)})


def by_recorder(table: str) -> object:
    key = {"/pose": "pose_time", "/cmd_vel": "command_time"}[table]
    return replace(CARD, **{key: replace(getattr(CARD, key), source=f"{table}:log_time")})


@pytest.mark.parametrize(("table", "what"), [("/pose", "pose"), ("/cmd_vel", "command")])
def test_stamps_of_the_recorder_are_straightened_where_no_header_was_filled(table: str, what: str) -> None:
    for header in (None, "constant"):
        flight = flight_from_log(flown(table, True, header), by_recorder(table))  # type: ignore[arg-type]
        (note,) = (note for note in flight.notes if note.code == f"{what}_stamps_straightened")
        assert note.count == len(flown(table, True, header).tables[table].columns["log_time"])
        time = flight.pose_time if what == "pose" else flight.command_time
        assert np.ptp(np.diff(time)) < 0.002
        late = float(note.text.partition("late by ")[2].partition(" ms")[0])
        assert 1e3 * flight.stamp_error == pytest.approx(late, abs=0.05)  # for what no clock shows
        found = findings_of_flight(flown(table, True, header), flight)
        assert not {"clock_drift", "stamp_jitter"} & {one.code for one in found}


def test_a_filled_header_is_left_alone_and_so_is_a_recorder_beside_it() -> None:
    log = flown("/pose", True, "filled")
    for card in (CARD, by_recorder("/pose")):
        flight = flight_from_log(log, card)  # type: ignore[arg-type]
        assert not any("straightened" in note.code for note in flight.notes)


def test_a_header_that_stands_still_gives_way_to_the_recorder() -> None:
    flight = flight_from_log(flown("/pose", False, "constant"), CARD)
    told = flight_from_log(flown("/pose", False, "filled"), CARD)

    assert "pose_header_unfilled" in {note.code for note in flight.notes}
    np.testing.assert_allclose(flight.pose_time, told.pose_time, atol=1e-6)
