"""Command events: how often an axis is told something, and what a single event is worth."""

from dataclasses import replace

import numpy as np
import pytest

from clean_flights import clean_flights
from flights import by_hand, fit_as_flown, flown, steps
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.assessment.constancy import ONE, TWICE, command_events, widening
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.simulation.paper_vehicle import Truth


def commanded(u: Array, rate: float = 20.0) -> Flight:
    """Poses stand still; z is commanded."""
    t = np.arange(u.size) / rate
    command = np.zeros((u.size, 4))
    command[:, 2] = u
    return by_hand(t, np.zeros((u.size, 4)), t, command)


def pulses(*starts: float, size: float = 1.0, width: float = 0.2) -> Array:
    t = np.arange(0.0, 30.0, 0.05)
    return np.asarray(sum(size * ((t >= start) & (t < start + width)) for start in starts), float)


def test_a_tap_is_one_event_a_held_step_two_and_taps_add_up_over_flights() -> None:
    assert command_events([commanded(pulses(6.4))], "z") == 1.0
    assert command_events([commanded(pulses(6.4, width=5.0))], "z") == 2.0
    assert command_events([commanded(pulses(3.0, 9.0, 15.0))], "z") == pytest.approx(3.0)
    assert command_events([commanded(pulses(3.0)), commanded(pulses(3.0, 9.0))], "z") == pytest.approx(3.0)
    assert command_events([commanded(np.full(600, 0.3))], "z") == 0.0


def test_small_corrections_beside_one_tap_count_for_little() -> None:
    rng = np.random.default_rng(0)

    assert command_events([commanded(pulses(6.4) + 0.01 * rng.standard_normal(600))], "z") < 1.1


def test_intervals_over_few_events_are_those_of_student() -> None:
    assert widening(1.0) == float("inf")
    assert widening(2.0) == pytest.approx(12.706 / 1.96, rel=1e-3)
    assert widening(4.0) < TWICE < widening(3.0)
    assert widening(50.0) < 1.03


def test_one_tap_and_three_give_numbers_with_a_warning() -> None:
    found = {}
    for starts in ((6.4,), (6.4, 12.0, 20.0)):

        def taps(t: Array, starts: tuple[float, ...] = starts) -> Array:
            out = np.zeros((*t.shape, 4))
            out[..., 2] = sum(0.5 * ((t >= start) & (t < start + 0.4)) for start in starts)
            return out

        done = fit_as_flown([flown(replace(Truth(), wind_sigma=(0.01,) * 4), taps, 35.0, 1)], axes=("z",))
        (told,) = [one for one in findings_of_fit(done) if one.code == "few_command_events"]
        assert told.severity == "warning"
        assert done.model.axes["z"].predictor is not None
        found[len(starts)] = told

    assert "their width is unknown" in found[1].effect
    assert "times as wide" in found[3].effect


def test_clean_flights_have_events_enough() -> None:
    for _, _, _, flight in clean_flights(range(12)):
        for axis in flight.axes:
            if np.ptp(flight.command[:, AXES.index(axis)]) > 0:
                assert command_events([flight], axis) > 10 * ONE
    assert widening(command_events([flown(Truth(), steps(("z",)), 12.0)], "z")) < TWICE
