"""Faults of the data in flight: told once commands of x or y can show them, and of the time between two jumps."""

import numpy as np
import pytest

from flights import by_hand
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.tracking import faults

OFF = Finding("yaw_offset", "warning", "x acts 20 degrees off", "x and y are wrong", "turn it", "x")
SHORT = Finding("short_data", "warning", "8 s", "little is known", "fly longer", None)


def flight(quiet: float, duration: float) -> Flight:
    """Commands of z from the start, of x and y after a while [s]."""
    time = np.arange(0.0, duration, 0.1)
    command = np.zeros((time.size, 4))
    command[:, 2] = np.arange(time.size) % 2
    command[:, :2] = np.where(time > quiet, np.arange(time.size) % 2, 0)[:, None]
    return by_hand(time, np.zeros((time.size, 4)), time, command)


@pytest.fixture(autouse=True)
def told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "faults_of", lambda _part: (OFF, SHORT))


def test_a_frame_is_checked_by_the_time_in_which_x_or_y_is_commanded() -> None:
    assert faults.checked(flight(12.0, 20.0), (), 20.0) is None
    assert faults.checked(flight(12.0, 25.0), (), 25.0) == (OFF,)
    assert faults.checked(flight(0.0, 10.0), (), 10.0) is None


def test_a_fault_is_not_forgotten_while_x_and_y_are_quiet() -> None:
    time = np.arange(0.0, 500.0, 0.1)
    command = np.zeros((time.size, 4))
    command[:, 2] = np.arange(time.size) % 2
    command[time < 40.0, :2] = (np.arange(400) % 2)[:, None]

    assert faults.checked(by_hand(time, np.zeros((time.size, 4)), time, command), (), 500.0) == (OFF,)


def test_a_part_between_jumps_tells_no_frame_too_early_and_no_length_of_the_flight() -> None:
    assert faults.faults_after(flight(0.0, 30.0), (10.0, 25.0), -np.inf) == ()
    assert faults.faults_after(flight(0.0, 30.0), (10.0, 25.0), 10.0) == (OFF,)
    assert faults.faults_after(flight(0.0, 30.0), (), -np.inf) == (OFF, SHORT)
