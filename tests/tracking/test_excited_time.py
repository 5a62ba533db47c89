"""Excited time: what hovers is not counted, and makes nothing forgotten."""

import numpy as np
import pytest
from test_growing_flight import CARD

from flights import by_hand
from rotorfit.core.log import Sample
from rotorfit.tracking.excited_time import LONGEST, QUIET, excited_since, excited_time
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.regimes import fading


def commands(moving: float, hovering: float, after: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Two commands a second that change, then none, then such again."""
    time = np.arange(0.0, moving + hovering + after, 0.5)
    moves = (time < moving) | (time >= moving + hovering)
    return time, np.where(moves, np.arange(time.size), 0.0)[:, None]


def test_a_hover_counts_for_as_long_as_the_last_command_is_answered() -> None:
    time, command = commands(60.0, 400.0)

    assert excited_time(time, command, 0.0, 460.0) == pytest.approx(60.0 + QUIET - 0.5)
    assert excited_time(time, command, 100.0, 460.0) == 0.0


def test_what_came_before_a_hover_is_looked_back_over() -> None:
    time, command = commands(200.0, 400.0, 200.0)

    assert excited_since(time, command, 0.0, 600.0) == 0.0
    assert excited_since(time, command, 0.0, 800.0) == pytest.approx(100.0 + QUIET, abs=1.0)
    assert excited_since(*commands(400.0, 0.0), 0.0, 400.0) == pytest.approx(400.0 - LONGEST, abs=0.5)


def test_a_tracker_that_is_killed_in_a_hover_remembers_the_flight_before_it() -> None:
    growing, (time, command) = GrowingFlight(CARD), commands(60.0, 400.0)
    for t, (u,) in zip(time.tolist(), command.tolist(), strict=True):
        growing.add(Sample("command", round(1e9 * t), round(1e9 * t), (0.01 * u, 0.0, 0.0, 0.0)))
        pose = (t, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)
        growing.add(Sample("pose", round(1e9 * t), round(1e9 * t), pose))

    memory = growing.memory()
    assert memory["commands_time"][0] < 1.0
    assert memory["poses_time"][0] < 1.0


def test_a_regime_is_fitted_before_seconds_of_an_axis_that_is_rarely_commanded_are_forgotten() -> None:
    time = np.arange(200.0, 1100.0, 0.5)
    command = np.zeros((time.size, 4))
    command[:, 0], command[:, 3] = np.arange(time.size) % 2, (time // 60) % 2
    flight = by_hand(time, np.zeros((time.size, 4)), time, command)
    bounds = [(0.0, None), (700.0, None)]

    assert fading(flight, bounds, 0.0, [("x",)]) == []
    assert fading(flight, bounds, 0.0, [("x",), ("yaw",)]) == [0.0]
