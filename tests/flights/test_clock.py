"""Clocks: units of stamps, order, repeats, jitter, gaps, and two clocks against each other."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorfit.core.card import Channel
from rotorfit.core.errors import CardError
from rotorfit.core.log import Log, Table
from rotorfit.flights.stamps import (
    MISSING_STAMP,
    degrees_for_radians,
    drift,
    fresh,
    held,
    increasing,
    median_period,
    rate,
    relation,
    stamps_of,
)

EPOCH = 1_700_000_000_123_456_789


def log_of(**columns: object) -> Log:
    table = Table("table", {name: np.asarray(values) for name, values in columns.items()})
    return Log(Path("flight.log"), "csv", "0" * 64, {"table": table}, {})


def periodic(count: int, period: float, start: float = 0.0) -> np.ndarray:
    return np.round((start + period * np.arange(count)) * 1e9).astype(np.int64)


@pytest.mark.parametrize("name", ["header.stamp", "log_time", "pose.header.stamp"])
def test_whole_stamps_of_messages_are_nanoseconds_to_the_last_digit(name: str) -> None:
    log = log_of(**{name: np.array([EPOCH, EPOCH + 1])})

    assert stamps_of(log, Channel(name)).tolist() == [EPOCH, EPOCH + 1]
    assert stamps_of(log_of(**{name: np.array([3, 5])}), Channel(name)).tolist() == [3, 5]


def test_other_whole_numbers_are_nanoseconds_beyond_1e15_and_seconds_below() -> None:
    assert stamps_of(log_of(t=np.array([EPOCH])), Channel("t")).tolist() == [EPOCH]
    assert stamps_of(log_of(t=np.array([7], dtype=np.uint8)), Channel("t")).tolist() == [7_000_000_000]


def test_floats_are_seconds_to_the_resolution_of_float64() -> None:
    stamps = stamps_of(log_of(t=np.array([[0.5], [1.7e9 + 0.25]])), Channel("t"))

    assert stamps.tolist() == [500_000_000, 1_700_000_000_250_000_000]


@pytest.mark.parametrize(("unit", "factor"), [("s", 10**9), ("ms", 10**6), ("us", 1000), ("ns", 1)])
def test_a_unit_overrides_and_scale_and_offset_come_before_it(unit: str, factor: int) -> None:
    log = log_of(**{"header.stamp": np.array([1, 2]), "t": np.array([1.0, 2.0])})

    assert stamps_of(log, Channel("header.stamp", offset=3, unit=unit)).tolist() == [4 * factor, 5 * factor]
    assert stamps_of(log, Channel("t", scale=2, offset=1, unit=unit)).tolist() == [3 * factor, 5 * factor]


def test_a_stamp_that_is_no_number_is_marked() -> None:
    stamps = stamps_of(log_of(t=[1.0, np.nan, np.inf, 2.0, 1e300, 3.0]), Channel("t"))

    assert stamps[[0, 3, 5]].tolist() == [10**9, 2 * 10**9, 3 * 10**9]
    assert np.all(stamps[[1, 2, 4]] == MISSING_STAMP)


@pytest.mark.parametrize("values", [[1.7e18, 1.8e18], np.array([10**14])])
def test_stamps_too_large_for_seconds_ask_for_their_unit(values: object) -> None:
    with pytest.raises(CardError, match='unit = "ns"'):
        stamps_of(log_of(t=values), Channel("t"))


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_the_unit_that_is_proposed_makes_stamps_since_1970(unit: str, factor: float) -> None:
    with pytest.raises(CardError, match=f'unit = "{unit}", which would be 1.7e\\+09 s'):
        stamps_of(log_of(t=np.array([1.7e9, 1.7e9 + 1]) * factor), Channel("t"))


def test_increasing_keeps_what_is_later_than_all_before() -> None:
    stamps = np.array([5, 7, 7, 6, 8, 2, 9])

    assert stamps[increasing(stamps)].tolist() == [5, 7, 8, 9]


def test_fresh_keeps_the_first_of_a_run_and_sees_each_column() -> None:
    rows = np.array([[0, 0], [0, 0], [0, 1], [0, 1], [0, 0]], dtype=float)

    assert fresh(rows).tolist() == [True, False, True, False, True]


@given(st.lists(st.integers(-5, 5), max_size=30), st.integers(0, 30))
def test_order_and_freshness_look_back_only(values: list[int], cut: int) -> None:
    stamps = np.array(values, dtype=np.int64)
    rows = stamps[:, None].astype(float)

    assert increasing(stamps)[:cut].tolist() == increasing(stamps[:cut]).tolist()
    assert fresh(rows)[:cut].tolist() == fresh(rows[:cut]).tolist()


def test_rate_counts_gaps_repeats_reversals_and_missing_stamps() -> None:
    stamps = periodic(100, 0.01)
    stamps[50:] += 500_000_000
    stamps[10] = stamps[9]
    stamps[20] = stamps[5]
    stamps[30] = MISSING_STAMP

    found = rate(stamps)

    assert (found.count, found.repeated, found.reversed, found.missing, found.gaps) == (100, 1, 1, 1, 1)
    assert found.period == pytest.approx(0.01)
    assert found.longest_gap == pytest.approx(0.51)
    assert found.duration == pytest.approx(1.49)


def test_rate_of_a_jittered_clock_gives_percentiles() -> None:
    rng = np.random.default_rng(1)
    stamps = np.cumsum(rng.integers(9_000_000, 11_000_001, 20_000))

    found = rate(stamps)

    assert found.jitter == pytest.approx((-0.0009, 0.0009), abs=5e-5)
    assert found.gaps == 0


def test_steps_of_exactly_three_rounded_periods_are_no_gaps() -> None:
    stamps = np.delete(periodic(1000, 1 / 120), np.r_[100:102, 300:302, 500:502])

    assert rate(stamps).gaps == 0
    assert rate(np.delete(stamps, [600, 601, 602])).gaps == 1


@pytest.mark.parametrize("stamps", [[], [3], [3, 3, 3], [MISSING_STAMP]])
def test_rate_is_undefined_below_two_stamps(stamps: list[int]) -> None:
    found = rate(np.array(stamps, dtype=np.int64))

    assert (found.period, found.jitter, found.longest_gap) == (None, None, None)
    assert median_period(np.array(stamps[:1], dtype=np.int64)) is None


def test_relation_of_two_streams() -> None:
    first, second = periodic(101, 0.1), periodic(101, 0.1, start=4.0)

    found = relation(first, second)

    assert (found.start_offset, found.end_offset, found.overlap) == pytest.approx((4.0, 4.0, 6.0))
    assert relation(first, periodic(2, 1, start=50.0)).overlap == 0.0


def test_drift_is_found_under_delays_of_transport() -> None:
    rng = np.random.default_rng(2)
    sent = periodic(5000, 0.01, start=1.7e9)
    late = np.round(rng.exponential(0.002, 5000) * 1e9).astype(np.int64)
    received = sent + np.round((sent - sent[0]) * 50e-6).astype(np.int64) + 300_000_000 + late
    received[7] = MISSING_STAMP

    found = drift(sent, received)

    assert found is not None
    assert found.drift == pytest.approx(50e-6, abs=1e-5)
    assert found.offset == pytest.approx(0.3026, abs=5e-4)
    assert drift(sent[:7], received[:7]) is None
    assert drift(np.zeros(9, dtype=np.int64), sent[:9]) is None


def test_a_value_is_held_until_the_next() -> None:
    clock, values = np.array([30, 10, 20]), np.array([3.0, 1.0, 2.0])

    np.testing.assert_array_equal(held(clock, values, np.array([5, 10, 19, 20, 99])), [np.nan, 1, 1, 2, 3])


def wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("frequency", [10, 30, 120])
@pytest.mark.parametrize("turning", [0.2, 1.0, 3.0])
def test_degrees_are_told_from_radians(frequency: int, turning: float) -> None:
    stamps = periodic(60 * frequency, 1 / frequency)
    rng = np.random.default_rng(3)
    yaw = turning * stamps / 1e9 + np.sin(stamps / 1e9) + 0.003 * rng.standard_normal(len(stamps))

    assert degrees_for_radians(stamps, np.degrees(wrapped(yaw)))
    assert degrees_for_radians(stamps, np.degrees(yaw) % 360)
    assert degrees_for_radians(stamps, np.degrees(2.5 * np.sin(turning * stamps / 1e9)))
    assert not degrees_for_radians(stamps, yaw)
    assert not degrees_for_radians(stamps, wrapped(yaw))
    assert not degrees_for_radians(stamps, yaw % (2 * np.pi))


def test_a_body_that_a_mocap_system_flips_is_not_in_degrees() -> None:
    stamps = periodic(1200, 1 / 120)
    yaw = np.where(np.arange(1200) % 40 == 0, 3.0, -0.2)

    assert not degrees_for_radians(stamps, yaw)
