"""Built-in cards: each reads a log of the columns that it names, and says where it comes from."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.card import Channel
from rotorfit.core.frames import UNIT_SCALE, Array, heading_from_world, world_from_heading
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis.card_choice import proposal
from rotorfit.diagnosis.command_response import answers_of
from rotorfit.files.cards import builtin_card_text, builtin_cards, card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import fitting_cards

T = np.arange(0.0, 30.0, 0.05)
COMMAND = {
    "x": np.sin(1.3 * T) + 0.5 * np.sign(np.sin(0.7 * T)),
    "y": np.cos(1.1 * T),
    "z": 0.5 * np.sin(0.9 * T + 1),
    "yaw": 0.6 * np.cos(0.4 * T),
}


def followed(command: Array) -> Array:
    """Velocity of a vehicle that follows its command with a time constant of 0.3 s."""
    velocity = np.zeros(T.size)
    for k in range(1, T.size):
        velocity[k] = velocity[k - 1] + 0.05 / 0.3 * (command[k - 1] - velocity[k - 1])
    return velocity


def motion(world: bool) -> dict[str, Array]:
    """Pose of a vehicle that follows `COMMAND` along the world or its heading, z up, yaw counter-clockwise."""
    velocity = {axis: followed(series) for axis, series in COMMAND.items()}
    yaw = 0.4 + np.cumsum(velocity["yaw"]) * 0.05
    across = np.stack([velocity["x"], velocity["y"]], axis=1)
    place = np.cumsum(across if world else world_from_heading(across, yaw), axis=0) * 0.05
    return {"x": place[:, 0], "y": place[:, 1], "z": 2 + np.cumsum(velocity["z"]) * 0.05, "yaw": yaw}


def raw(channel: Channel, values: Array) -> Array:
    """What the log holds where the card is to read these values."""
    return (values / UNIT_SCALE.get(channel.unit or "m", 1.0) - channel.offset) / channel.scale


def log_for(name: str) -> Log:
    """A log of the columns that a card names, of a vehicle that does what it is told."""
    card = builtin_cards()[name]
    true = motion(card.command_frame == "world")
    pose, velocity = true, {axis: np.gradient(series, T) for axis, series in true.items()}
    if card.frame == "NED":
        pose = {"x": true["y"], "y": true["x"], "z": -true["z"], "yaw": np.pi / 2 - true["yaw"]}
    if card.velocity_frame == "heading":
        across = heading_from_world(np.stack([velocity["x"], velocity["y"]], axis=1), true["yaw"])
        velocity |= {"x": across[:, 0], "y": across[:, 1]}
    elif card.frame == "NED":
        velocity = {"x": velocity["y"], "y": velocity["x"], "z": -velocity["z"], "yaw": -velocity["yaw"]}
    half = pose["yaw"] / 2
    pose |= {"qw": np.cos(half), "qx": 0 * half, "qy": 0 * half, "qz": np.sin(half)}
    tables: dict[str, dict[str, Array]] = {}

    def put(channel: Channel, values: Array) -> None:
        if isinstance(channel.source, str):
            table, _, column = channel.source.rpartition(":") if ":" in channel.source else ("only", "", channel.source)
            tables.setdefault(table.replace("*", "one"), {})[column] = values

    for axis, channel in card.command.items():
        put(channel, raw(channel, COMMAND[axis]))
    for axis, channel in card.pose.items():
        put(channel, raw(channel, pose[axis]))
    for axis, channel in card.velocity.items():
        put(channel, raw(channel, velocity[axis]))
    for channel in (*card.reference.values(), *card.resets):
        put(channel, np.zeros(T.size))
    for part in card.window:
        put(part.channel, np.full(T.size, (*part.equals, *part.opens, 1.0)[0]))
    times = [one for one in (card.command_time, card.pose_time) if isinstance(one.source, str)]
    for table, columns in tables.items():
        for time in times:
            own, _, column = str(time.source).rpartition(":")
            if own.replace("*", "one") == table or not own or column in ("TimeUS", "TimeMS", "timestamp"):
                stamp = column in ("log_time", "header.stamp")
                columns[column] = np.round(T * 1e9).astype(np.int64) if stamp else raw(time, T)
        if not columns.keys() & {
            "log_time",
            "header.stamp",
            "TimeUS",
            "TimeMS",
            "timestamp",
            *(t.source for t in times),
        }:
            columns["log_time"] = np.round(T * 1e9).astype(np.int64)
    built = {table: Table(table, columns) for table, columns in tables.items()}
    return Log(Path("flight.bag"), "rosbag1", "0" * 64, built, {})


@pytest.mark.parametrize("name", builtin_cards())
def test_every_card_reads_a_flight_of_the_columns_that_it_names(name: str) -> None:
    log, card = log_for(name), builtin_cards()[name]

    assert name in fitting_cards(log)
    flight = flight_from_log(log, card)

    assert flight.duration > 29
    true = motion(card.command_frame == "world")
    inside = flight.pose_time < 29
    for k, axis in enumerate("xyz"):
        place = np.interp(flight.pose_time[inside], T, true[axis])
        start = place[0] if axis in card.velocity_only else 0.0  # a velocity alone tells where from its start
        np.testing.assert_allclose(flight.position[inside, k], place - start, atol=0.02)
    heading = card_from_mapping(
        {**card.raw, "command": {k: v for k, v in card.raw["command"].items() if k != "frame"}}, name
    )
    told = answers_of(flight_from_log(log, heading))
    assert told.frame == (card.command_frame if {"x", "y"} & card.command.keys() else None)
    assert {axis: (answer.axis, answer.sign) for axis, answer in told.of.items()} == {
        axis: (axis, 1) for axis in card.command
    }


@pytest.mark.parametrize("name", builtin_cards())
def test_every_card_says_where_it_comes_from(name: str) -> None:
    comment = builtin_card_text(name).split("name = ")[0]

    assert len(comment) > 50
    assert comment.startswith("# ")
    assert set(builtin_cards()[name].over) <= set(builtin_cards())


def test_of_two_cards_that_fit_the_one_that_is_put_over_the_other_is_proposed() -> None:
    mocap, own = log_for("bebop2-vrpn"), log_for("bebop2-odometry")
    both = Log(mocap.path, mocap.format, mocap.sha256, {**own.tables, **mocap.tables}, {})

    assert set(fitting_cards(both)) == {"bebop2-vrpn", "bebop2-odometry"}
    assert proposal(both).name == "bebop2-vrpn"
    assert proposal(both).why == "before bebop2-odometry (bebop2-vrpn goes before it where both fit)"
    assert proposal(own).why == "the only one whose columns are all there"


@pytest.mark.parametrize("name", ["ardrone-optitrack", "ardrone-vicon"])
def test_a_twist_and_motion_capture_alone_are_no_ardrone(name: str) -> None:
    log = log_for(name)
    without = {table: one for table, one in log.tables.items() if table != "/ardrone/navdata"}

    assert name not in fitting_cards(replace(log, tables=without))
