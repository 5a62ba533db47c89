"""The clock of a sender: its steps are removed as where a log is read; nothing that a radio does is taken for one."""

from collections.abc import Sequence

import numpy as np
import pytest

from rotorfit.core.log import Sample
from rotorfit.flights.clocks.sender_drift import correction
from rotorfit.tracking.sender_clock import SenderClock

SECOND, PERIOD = 1_000_000_000, 1 / 120


def received(stamps: np.ndarray, arrivals: np.ndarray) -> list[Sample]:
    """Poses by their stamps and arrivals [s], in the order of arrival."""
    order = np.argsort(arrivals, kind="stable")
    times = [tuple(round(1e9 * (1000 + one[k])) for one in (stamps, arrivals)) for k in order]
    return [Sample("pose", *time, (0.0,) * 7) for time in times]


def through(samples: Sequence[Sample]) -> tuple[list[tuple[int | None, Sample]], list[float]]:
    clock = SenderClock()
    return [timed for sample in samples for timed in clock.take(sample)], clock.steps


def sent(seconds: float = 20.0, seed: int = 1, period: float = PERIOD) -> tuple[np.ndarray, np.ndarray]:
    """Times at which poses are measured, and arrive after some 9 ms [s]."""
    time = np.arange(0.0, seconds, period)
    return time, time + 0.008 + np.random.default_rng(seed).exponential(0.001, time.size)


@pytest.mark.parametrize("period", [PERIOD, 0.02, 0.1])
@pytest.mark.parametrize("size", [-30.0, -0.5, -0.06, -0.03, 0.03, 0.3, 30.0])
def test_a_step_costs_no_sample_and_moves_none_and_is_that_of_the_log(size: float, period: float) -> None:
    time, arrivals = sent(period=period)
    samples = received(np.where(time > 10.0, time + size, time), arrivals)
    timed, steps = through(samples)
    log = correction(*(np.array([getattr(one, name) for one in samples]) for name in ("stamp", "received")))

    assert len(timed) == len(samples)
    off = [np.nan if at is None else at / 1e9 - 1000 - true for (at, _), true in zip(timed, time, strict=True)]
    assert np.abs(off).max() < 0.003
    assert steps == pytest.approx([size], abs=0.003)
    assert log is not None
    assert steps == pytest.approx([-one for one in log.steps], abs=0.003)


def test_two_steps_are_two() -> None:
    time, arrivals = sent()
    _, steps = through(received(time - 0.06 * (time > 5.0) + 0.2 * (time > 12.0), arrivals))

    assert steps == pytest.approx([-0.06, 0.2], abs=0.003)


def bursts(time: np.ndarray, arrivals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A radio that sleeps: what is sent meanwhile arrives at once, up to 0.3 s later."""
    wakes = np.cumsum(rng.uniform(0.02, 0.3, 2000))
    return wakes[np.searchsorted(wakes, arrivals)] + 1e-4 * np.arange(time.size) * PERIOD


def queued(_time: np.ndarray, arrivals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A queue that fills for seconds and empties at once."""
    begin = rng.uniform(3.0, 15.0)
    inside = (arrivals > begin) & (arrivals < begin + 3.0)
    return np.where(inside, arrivals + np.minimum(0.3 * (arrivals - begin), 0.25), arrivals)


def overtaking(_time: np.ndarray, arrivals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Some come up to 0.3 s later, out of order."""
    return arrivals + np.where(rng.random(arrivals.size) < 0.05, rng.uniform(0, 0.3, arrivals.size), 0.0)


def one_late(_time: np.ndarray, arrivals: np.ndarray, _rng: np.random.Generator) -> np.ndarray:
    return arrivals + np.where(np.arange(arrivals.size) == 900, 0.06, 0.0)


def drifting(time: np.ndarray, arrivals: np.ndarray, _rng: np.random.Generator) -> np.ndarray:
    """By a clock that goes 100 us/s wrong."""
    return arrivals + 1e-4 * time


@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("radio", [bursts, queued, overtaking, one_late, drifting])
def test_what_a_radio_does_is_no_step_and_waits_for_nothing(radio: object, lost: float) -> None:
    assert callable(radio)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        time, arrivals = sent(seed=seed)
        arrivals = radio(time, arrivals, rng)
        there = rng.random(time.size) >= lost
        dropped = rng.uniform(3.0, 19.0, (5, 1))  # some are lost in a row
        there &= ~np.any((time > dropped) & (time < dropped + 5 * lost * 0.1), axis=0)
        samples = received(time[there], arrivals[there])
        timed, steps = through(samples)

        assert not steps
        assert [at for at, _ in timed] == [one.stamp for one in samples[: len(timed)]]
        assert len(timed) > len(samples) - 10


def test_a_queue_that_drops_what_it_held_since_the_start_is_no_step() -> None:
    time, arrivals = sent()
    full = time < 6.0
    there = full | (time > 6.14)

    timed, steps = through(received(time[there], (arrivals + 0.14 * full)[there]))

    assert not steps
    assert [at for at, _ in timed] == [one.stamp for _, one in timed]


def test_a_clock_that_is_set_on_by_less_than_the_samples_are_late_is_a_step_after_a_minute() -> None:
    time, arrivals = sent(80.0)

    _, steps = through(received(time + 0.1 * (time > 70.0), arrivals + 0.3))

    assert steps == pytest.approx([0.1], abs=0.003)
