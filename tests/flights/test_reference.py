"""What a position controller was told: read by the card, on its own clock, held onto the commands."""

from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log

TIME = np.arange(0, 10.0, 0.05)
GOAL_TIME = np.array([0.5, 2.0, 7.0])
GOAL = np.array([1.0, -2.0, 3.0])


def log_with(**columns: np.ndarray) -> Log:
    tables = {
        "cmd": {"t": TIME, "x": np.sin(TIME), "goal_y": np.cos(TIME)},
        "pose": {"t": TIME, **{name: np.sin(TIME + i) for i, name in enumerate(("x", "y", "z"))}, "yaw": 0.1 * TIME},
        "goal": {"t": GOAL_TIME, "x": GOAL} | columns,
    }
    named = {name: Table(name, {key: np.asarray(v) for key, v in found.items()}) for name, found in tables.items()}
    return Log(Path("flight.log"), "csv", "0" * 64, named, {})


def card_with(frame: str = "ENU", **reference: object) -> Card:
    raw = {
        "frame": frame,
        "command": {"time": "cmd:t", "x": "cmd:x"},
        "pose": {"time": "pose:t", "x": "pose:x", "y": "pose:y", "z": "pose:z", "yaw": "pose:yaw"},
    }
    return card_from_mapping(raw | ({"reference": reference} if reference else {}), "test")


def test_a_card_without_a_reference_gives_none() -> None:
    assert flight_from_log(log_with(), card_with()).reference is None


def test_each_column_is_held_onto_the_commands_from_its_own_clock_and_unknown_before_its_first_value() -> None:
    flight = flight_from_log(log_with(), card_with(x="goal:x", y="cmd:goal_y", z=1.5))

    assert flight.reference is not None
    t = flight.command_time
    np.testing.assert_array_equal(np.isnan(flight.reference[:, 0]), t < 0.5 - 1e-9)
    np.testing.assert_array_equal(flight.reference[t > 7.001, 0], 3.0)
    np.testing.assert_allclose(flight.reference[:, 1], np.cos(t), atol=1e-9)
    np.testing.assert_array_equal(flight.reference[:, 2], 1.5)
    assert np.isnan(flight.reference[:, 3]).all()


def test_a_reference_in_ned_is_turned_with_the_pose() -> None:
    flight = flight_from_log(log_with(), card_with("NED", x="cmd:goal_y", z=-2.0))

    assert flight.reference is not None
    np.testing.assert_allclose(flight.reference[:, 1], np.cos(flight.command_time), atol=1e-9)
    np.testing.assert_array_equal(flight.reference[:, 2], 2.0)


def test_a_reference_that_nothing_tells_the_time_of_is_an_error_of_the_card() -> None:
    with pytest.raises(CardError, match="reference"):
        flight_from_log(log_with(x=np.arange(7.0)), card_with(x="goal:x"))
