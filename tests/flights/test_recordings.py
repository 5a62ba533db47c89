"""Several recordings in one file."""

from dataclasses import replace

import numpy as np
import pytest
from test_flight import card_with, commands, counts, error_of, flight_of, log_of, poses, rows

from rotorfit.core.card import Card
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log


def appended(first: dict, second: dict) -> dict:
    return {name: np.r_[first[name], second[name]] for name in first}


@pytest.mark.parametrize("longer_first", [True, False])
def test_the_longest_recording_is_taken_and_not_spliced(longer_first: bool) -> None:
    short = rows(commands(), slice(80)), rows(poses(), slice(500))
    long = commands(), poses()
    first, second = (long, short) if longer_first else (short, long)
    alone = flight_of(*long)

    flight = flight_of(appended(first[0], second[0]), appended(first[1], second[1]))

    assert counts(flight)["clock_restarts"] == 2
    assert not {code for code in counts(flight) if "reversed" in code or "sorted" in code}
    np.testing.assert_array_equal(flight.position, alone.position)
    np.testing.assert_array_equal(flight.command, alone.command)


def test_recordings_of_commands_and_poses_that_do_not_match_are_refused() -> None:
    said = error_of(log_of(appended(commands(), commands()), poses()))

    assert "among the commands 1 times and among the poses 0 times" in said
    assert "split" in said


def test_poses_of_an_earlier_recording_without_commands_are_dropped() -> None:
    flight = flight_of(commands(), appended(rows(poses(), slice(500)), poses()))

    assert "clock_restarts" not in counts(flight)
    assert flight.duration == pytest.approx(flight_of(commands(), poses()).duration)


def test_a_clock_that_is_set_back_does_not_end_the_recording() -> None:
    tables = commands(), poses()
    for table in tables:
        table["t"] = np.where(table["t"] < 5, table["t"], table["t"] - 2)

    assert "clock_restarts" not in counts(flight_from_log(log_of(*tables), card_with()))


def test_tables_beside_the_poses_are_cut_with_them() -> None:
    def beside(pose: dict) -> dict:
        return {name: pose[name] for name in ("t", "z", "yaw")}

    short, long = (rows(commands(), slice(80)), rows(poses(), slice(500))), (commands(), poses())
    long[1]["z"] = long[1]["z"] + 1
    pose, cmd = appended(short[1], long[1]), appended(short[0], long[0])
    card = card_with(pose={"z": "beside:z", "yaw": "beside:yaw"})

    flight = flight_from_log(log_of(cmd, pose, beside=beside(pose)), card)

    assert np.min(flight.position[:, 2]) > 1.5


def test_commands_and_poses_with_clocks_of_their_own_in_one_table_are_cut_together() -> None:
    short, long = (rows(commands(), slice(80)), rows(poses(), slice(500))), (commands(), poses())
    short[0]["x"] = -short[0]["x"]
    cmd, pose = appended(short[0], long[0]), appended(short[1], long[1])
    columns = {f"cmd_{name}": values for name, values in cmd.items()} | {f"p_{name}": one for name, one in pose.items()}
    raw = {
        "command": {"time": "cmd_t", **{name: f"cmd_{name}" for name in cmd if name != "t"}},
        "pose": {"time": "p_t", **{name: f"p_{name}" for name in pose if name != "t"}},
    }

    log = replace(log_of(cmd, pose), tables={"flight": Table("flight", columns)})
    flight = flight_from_log(log, card_from_mapping(raw, "test"))

    np.testing.assert_array_equal(flight.position, flight_of(*long).position)
    np.testing.assert_array_equal(flight.command, flight_of(*long).command)


def joined(*tables: dict) -> dict:
    """Tables one below the other, blank where one lacks a column."""
    names = dict.fromkeys(name for table in tables for name in table)
    return {name: np.concatenate([t.get(name, np.full(t["t"].size, np.nan)) for t in tables]) for name in names}


def in_one_table(columns: dict) -> tuple[Log, Card]:
    raw = {
        "command": {"time": "t", **{name[4:]: name for name in columns if name.startswith("cmd_")}},
        "pose": {"time": "t", **{name: name for name in ("x", "y", "z", "yaw")}},
    }
    log = replace(log_of(commands(), poses()), tables={"flight": Table("flight", columns)})
    return log, card_from_mapping(raw, "test")


@pytest.mark.parametrize("commands_first", [True, False])
def test_commands_and_poses_joined_end_to_end_are_sorted(commands_first: bool) -> None:
    cmd, pose = commands(start=100.0), poses(start=99.0)
    sent = {name if name == "t" else f"cmd_{name}": values for name, values in cmd.items()}

    flight = flight_from_log(*in_one_table(joined(sent, pose) if commands_first else joined(pose, sent)))

    assert counts(flight)["rows_sorted"] == cmd["t"].size + pose["t"].size
    assert "clock_restarts" not in counts(flight)
    np.testing.assert_array_equal(flight.position, flight_of(cmd, pose).position)
    np.testing.assert_array_equal(flight.command, flight_of(cmd, pose).command)


def test_two_flights_joined_end_to_end_are_not_mixed() -> None:
    cmd, pose = commands(), poses(start=0.0)
    sent = {name if name == "t" else f"cmd_{name}": values for name, values in cmd.items()}

    for tables in ((pose, sent, pose, sent), (pose, pose, sent, sent)):
        assert "no command is complete" in error_of(*in_one_table(joined(*tables)))
