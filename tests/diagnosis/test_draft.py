"""Drafts of cards: they load and give a flight, or say what they lack."""

import itertools
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark import ParameterSet
from test_builtin_cards import COMMAND, T, followed, motion
from test_survey import csv_log, loaded, log_of, message_log

from flights import flown, steps
from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import CardError
from rotorfit.core.frames import Array, heading_from_world, world_from_heading
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis import card_choice
from rotorfit.diagnosis.card_draft import draft_card, write_draft
from rotorfit.diagnosis.command_response import answers_of
from rotorfit.diagnosis.doctor import findings_of_flight
from rotorfit.diagnosis.recognition import commands_in
from rotorfit.files.cards import builtin_card_text, card_from_mapping, load_card
from rotorfit.files.logs import read
from rotorfit.files.logs.several import join_logs
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import clocks
from rotorfit.flights.several_files import bound
from rotorfit.simulation.paper_vehicle import Truth

# Drafts


@pytest.mark.parametrize(
    ("pose", "prefix", "stamped"),
    [
        ("/vicon/drone/drone", "transform.", True),
        ("/vrpn_client_node/bebop/pose", "pose.", True),
        ("/odom", "pose.pose.", False),
        ("/mocap/pose", "", True),
    ],
)
def test_a_draft_for_ros_messages_loads_and_gives_the_flight(
    pose: str, prefix: str, stamped: bool, tmp_path: Path
) -> None:
    log = message_log(pose, prefix, stamped)
    text = draft_card(log)

    card = loaded(text, tmp_path)
    flight = flight_from_log(log, card)

    assert "INCOMPLETE" not in text
    assert card.pose_time.source == f"{pose}:{'header.stamp' if stamped else 'log_time'}"
    assert card.command["yaw"].source == "/drone/cmd_vel:angular.z"
    assert flight.duration == pytest.approx(19.98, abs=0.03)
    np.testing.assert_allclose(np.ptp(flight.yaw), 2 * flight.pose_time[-1] / 9, atol=0.02)


@pytest.mark.parametrize(
    "names",
    [
        {},
        {"time": "t", "x": "px", "y": "py", "z": "pz", "yaw": "psi"},
        {"time": "timestamp", "cmd_x": "vx_cmd", "cmd_y": "vy_cmd", "cmd_z": "vz_cmd", "cmd_yaw": "yaw_rate_cmd"},
        {"cmd_x": "u_x", "cmd_y": "u_y", "cmd_z": "u_z", "cmd_yaw": "u_psi", "x": "pos_x", "y": "pos_y", "z": "pos_z"},
        {"cmd_x": "ux", "cmd_y": "uy", "cmd_z": "uz", "cmd_yaw": "uyaw", "x": "x_pos", "y": "y_pos", "z": "z_pos"},
        {"cmd_x": "cmdPitch", "cmd_y": "cmdRoll", "cmd_z": "cmd_climb", "cmd_yaw": "cmd_yaw_rate", "yaw": "Heading"},
        {"cmd_x": "cmd_fwd", "cmd_y": "cmd_left", "cmd_z": "cmd_up", "cmd_yaw": "cmd_turn"},
        {"cmd_x": "pcmd_pitch", "cmd_y": "pcmd_roll", "cmd_z": "pcmd_gaz", "cmd_yaw": "pcmd_yaw"},
        {"cmd_x": "pitch [%]", "cmd_y": "roll [%]", "cmd_z": "gaz [%]", "cmd_yaw": "yaw_rate [%]"},
        {"cmd_x": "pitch_pct", "cmd_y": "roll_pct", "cmd_z": "throttle_pct", "cmd_yaw": "yaw_pct"},
        {"cmd_x": "vx_ref", "cmd_y": "vy_ref", "cmd_z": "vz_ref", "cmd_yaw": "yaw_rate_ref", "time": "Time"},
        {"cmd_x": "cmd_vel.linear.x", "cmd_y": "cmd_vel.linear.y", "cmd_z": "cmd_vel.linear.z"}
        | {"cmd_yaw": "cmd_vel.angular.z", "x": "pose.position.x", "y": "pose.position.y", "z": "pose.position.z"},
        {"cmd_x": "ctrltarget.vx", "cmd_y": "ctrltarget.vy", "cmd_z": "ctrltarget.vz", "cmd_yaw": "ctrltarget.yaw"}
        | {"x": "stateEstimate.x", "y": "stateEstimate.y", "z": "stateEstimate.z", "yaw": "stabilizer.yaw"},
        {"x": "kalman.stateX", "y": "kalman.stateY", "z": "kalman.stateZ", "yaw": "yaw_est", "time": "TimeStamp"},
        {"x": "lighthouse.x", "y": "lighthouse.y", "z": "lighthouse.z", "yaw": "stateEstimate.yaw", "time": "t_sec"},
        {"cmd_x": "fb", "cmd_y": "lr", "cmd_z": "ud", "cmd_yaw": "yv", "time": "unix_time"},
        {"cmd_x": "rc_fb", "cmd_y": "rc_lr", "cmd_z": "rc_ud", "cmd_yaw": "rc_yaw", "time": "monotonic"},
        {"cmd_x": "forward_backward_velocity", "cmd_y": "left_right_velocity", "cmd_z": "up_down_velocity"}
        | {"cmd_yaw": "yaw_velocity", "time": "host_time"},
        {"cmd_x": "vx", "cmd_y": "vy", "cmd_z": "vz", "cmd_yaw": "yawrate", "time": "ts"},
        {"cmd_x": "vx_set", "cmd_y": "vy_set", "cmd_z": "vz_set", "cmd_yaw": "yawrate_set"}
        | {"x": "px_m", "y": "py_m", "z": "pz_m", "yaw": "heading_deg"},
        *(
            {f"cmd_{axis}": f"v{axis}_{word}" for axis in "xyz"} | {"cmd_yaw": f"yawspeed_{word}"}
            for word in ("cmd", "sp", "des", "u", "goal", "demand", "commanded", "reference", "setpoint")
        ),
        {f"cmd_{axis}": f"targetV{axis}" for axis in "xyz"} | {"cmd_yaw": "target_omega_z"},
        *({"time": name} for name in ("epoch", "datetime", "rostime", "clock")),
    ],
)
def test_a_draft_for_a_table_of_ones_own_finds_what_the_names_say(names: dict, tmp_path: Path) -> None:
    log = csv_log(**names)
    text = draft_card(log)

    card = loaded(text, tmp_path)

    assert "INCOMPLETE" not in text
    assert card.command_time.source == card.pose_time.source == names.get("time", "time")
    assert {axis: one.source for axis, one in card.command.items()} == {
        axis: names.get(f"cmd_{axis}", f"cmd_{axis}") for axis in ("x", "y", "z", "yaw")
    }
    assert {axis: card.pose[axis].source for axis in ("x", "y", "z", "yaw")} == {
        axis: names.get(axis, axis) for axis in ("x", "y", "z", "yaw")
    }
    assert flight_from_log(log, card).duration == pytest.approx(29.98, abs=0.1)


def test_setpoints_of_a_position_are_a_reference_beside_commands(tmp_path: Path) -> None:
    log = csv_log(cmd_x="vx_set", cmd_y="vy_set", cmd_z="vz_set", cmd_yaw="yawrate_set")
    setpoints = {f"{axis}_set": np.zeros(1500) for axis in ("x", "y", "z", "yaw")}

    card = loaded(draft_card(log_of(flight={**log.tables["flight"].columns, **setpoints})), tmp_path)

    assert [channel.source for channel in card.command.values()] == ["vx_set", "vy_set", "vz_set", "yawrate_set"]
    assert {axis: channel.source for axis, channel in card.reference.items()} == {
        axis: f"{axis}_set" for axis in ("x", "y", "z", "yaw")
    }


def test_velocities_beside_a_position_are_commands_only_if_the_vehicle_does_not_follow_at_once(tmp_path: Path) -> None:
    true = raised(1.0)
    measured = {f"v{axis}": np.gradient(true[axis], T) for axis in "xyz"} | {"yawrate": np.gradient(true["yaw"], T)}
    told = {f"v{axis}": COMMAND[axis] for axis in "xyz"} | {"yawrate": COMMAND["yaw"]}

    commanded = draft_card(log_of(flight={"time": T, **true, **told}))
    of_the_vehicle = draft_card(log_of(flight={"time": T, **true, **measured}))

    assert "# EDIT: nothing else looks like commands" in commanded
    assert "[velocity]" not in commanded
    assert loaded(commanded, tmp_path).command["yaw"].source == "yawrate"
    assert "INCOMPLETE: nothing was recognised for [command] x, y, z or yaw." in of_the_vehicle
    assert "[velocity]" in of_the_vehicle


def test_a_turn_rate_or_a_velocity_of_a_filter_is_neither_a_command_nor_a_position() -> None:
    names = {f"cmd_{axis}": f"a{axis}" for axis in "xyz"} | {axis: f"kalman.stateP{axis.upper()}" for axis in "xyz"}
    text = draft_card(csv_log(**names, cmd_yaw="yaw_velocity"))

    assert "INCOMPLETE: nothing was recognised for [command] x, y, z or yaw; [pose] x; [pose] y; [pose] z" in text


def test_units_come_from_names_and_from_values(tmp_path: Path) -> None:
    log = csv_log(x="x_mm", y="y_mm", z="z_cm", time="time_ms")
    columns = dict(log.tables["flight"].columns)
    columns["time_ms"] = np.round(columns["time_ms"] * 1000).astype(np.int64)
    columns["yaw"] = np.degrees(3 * columns["yaw"])
    named = loaded(draft_card(log_of(flight=columns)), tmp_path)
    columns["time"] = columns.pop("time_ms")
    unnamed = loaded(draft_card(log_of(flight=columns)), tmp_path)

    assert (named.pose["x"].unit, named.pose["z"].unit, named.pose_time.unit) == ("mm", "cm", "ms")
    assert (unnamed.pose_time.unit, unnamed.pose["yaw"].unit, named.pose["yaw"].unit) == ("ms", "deg", "deg")
    assert flight_from_log(log_of(flight=columns), unnamed).duration == pytest.approx(29.98, abs=0.1)


def test_quaternions_of_a_csv_are_found(tmp_path: Path) -> None:
    log = csv_log(yaw="")
    columns = dict(log.tables["flight"].columns)
    t = columns["time"]
    columns |= {"qx": 0 * t, "qy": 0 * t, "qz": np.sin(t / 9), "qw": np.cos(t / 9)}

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)

    assert [card.pose[f"q{part}"].source for part in "wxyz"] == ["qw", "qx", "qy", "qz"]


def test_a_draft_takes_a_pose_from_one_sensor_and_names_what_else_is_there(tmp_path: Path) -> None:
    names = {axis: f"pos_{axis}" for axis in "xyz"} | {"yaw": "yaw_mocap"}
    columns = dict(csv_log(**names).tables["flight"].columns)
    columns |= {"z": columns["pos_z"] + 0.1, "yaw": columns["yaw_mocap"] + 0.1}

    text = draft_card(log_of(flight=columns))

    card = loaded(text, tmp_path)
    assert {axis: card.pose[axis].source for axis in names} == names
    assert "# EDIT if one of these is right: z, yaw" in text
    assert "named unlike the others" not in text


def test_a_draft_marks_an_axis_that_only_another_sensor_has(tmp_path: Path) -> None:
    text = draft_card(csv_log(x="x_mocap", y="y_mocap", yaw="yaw_mocap"))

    assert loaded(text, tmp_path).pose["x"].source == "x_mocap"
    assert 'z = "z"  # EDIT: named unlike the others, and perhaps of another sensor' in text


@pytest.mark.parametrize(
    "names",
    [
        ("pos_e", "pos_n", "pos_u"),
        ("pe", "pn", "pu"),
        ("e_pos", "n_pos", "u_pos"),
        ("east", "north", "up"),
        ("east", "north", "alt"),
    ],
)
def test_a_draft_knows_east_north_up(names: tuple, tmp_path: Path) -> None:
    text = draft_card(csv_log(**dict(zip("xyz", names, strict=True))))

    card = loaded(text, tmp_path)
    assert [card.pose[axis].source for axis in "xyz"] == list(names)
    assert card.frame == "ENU"


@pytest.mark.parametrize(
    ("z", "yaw"), [("throttle", "rudder"), ("stick_up", "stick_ccw"), ("stick_up", "stick_yaw_rate_cw")]
)
def test_a_draft_knows_throttle_and_rudder_beside_sticks_and_a_turn_by_its_sense(
    z: str, yaw: str, tmp_path: Path
) -> None:
    names = {"cmd_x": "stick_fwd", "cmd_y": "stick_left", "cmd_z": z, "cmd_yaw": yaw}

    card = loaded(draft_card(csv_log(**names)), tmp_path)
    assert [card.command[axis].source for axis in ("x", "y", "z", "yaw")] == list(names.values())


@pytest.mark.parametrize(
    "names", [("pos_n", "pos_e", "pos_d"), ("pn", "pe", "pd"), ("n_pos", "e_pos", "d_pos"), ("north", "east", "down")]
)
def test_a_draft_knows_north_east_down(names: tuple, tmp_path: Path) -> None:
    text = draft_card(csv_log(**dict(zip("xyz", names, strict=True))))

    card = loaded(text, tmp_path)
    assert [card.pose[axis].source for axis in "xyz"] == list(names)
    assert 'frame = "NED"  # of the pose, by its names' in text


@pytest.mark.parametrize("names", [("q0", "q1", "q2", "q3"), ("q1", "q2", "q3", "q4"), ("q_0", "q_1", "q_2", "q_3")])
def test_a_draft_knows_numbered_parts_of_a_quaternion(names: tuple, tmp_path: Path) -> None:
    columns = dict(csv_log(yaw="").tables["flight"].columns)
    t = columns["time"]
    columns |= dict(zip(names, (np.cos(t / 9), 0 * t, 0 * t, np.sin(t / 9)), strict=True))

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)

    assert [card.pose[f"q{part}"].source for part in "wxyz"] == list(names)


def test_the_order_of_numbered_parts_is_told_as_guessed_unless_the_motion_bears_it_out() -> None:
    true = turning()
    half = true["yaw"] / 2
    pose = true | {"q0": np.cos(half), "q1": 0 * T, "q2": 0 * T, "q3": np.sin(half)}
    del pose["yaw"]
    commands = {f"cmd_{axis}": COMMAND[axis] for axis in "xyz"}

    guessed = draft_card(log_of(flight={"time": T, **pose, **commands}))
    told = draft_card(log_of(flight={"time": T, **pose, **commands, "cmd_yaw": COMMAND["yaw"]}))

    assert "# w, x, y, z; EDIT: this order is a guess" in guessed
    assert "this order is a guess" not in told


def test_a_draft_reads_the_tables_of_rostopic_and_of_plotjuggler(tmp_path: Path) -> None:
    true, ns = turning(), np.round(1e9 * (T + 1.7e9)).astype(np.int64)
    half = true["yaw"] / 2
    pose = {f"pose.position.{axis}": true[axis] for axis in "xyz"}
    pose |= {f"pose.orientation.{part}": 0 * T for part in "xy"}
    pose |= {"pose.orientation.w": np.cos(half), "pose.orientation.z": np.sin(half)}
    twist = {f"linear.{axis}": COMMAND[axis] for axis in "xyz"} | {"angular.z": COMMAND["yaw"]}
    seen = {"%time": ns + 5_000_000, "field.header.stamp": ns, **{f"field.{name}": one for name, one in pose.items()}}
    told = {"%time": ns, **{f"field.{name}": one for name, one in twist.items()}}
    echoed = join_logs([log_of("cmd.csv", cmd=told), log_of("pose.csv", pose=seen)])
    slashed = {f"/vrpn_client_node/drone/pose/{name.replace('.', '/')}": one for name, one in pose.items()}
    slashed |= {f"/drone/cmd_vel/{name.replace('.', '/')}": one for name, one in twist.items()}
    juggled = log_of("table.csv", table={"__time": T + 1.7e9, **slashed})

    first, second = loaded(draft_card(echoed), tmp_path), loaded(draft_card(juggled), tmp_path)

    assert (first.command_time.source, first.command_time.unit) == ("%time", "ns")
    assert (first.pose_time.source, first.pose_time.unit) == ("field.header.stamp", "ns")
    assert first.command["x"].source == "field.linear.x"
    assert first.pose["qw"].source == "field.pose.orientation.w"
    assert (second.command_time.source, second.pose_time.source) == ("__time", "__time")
    assert second.command["yaw"].source == "/drone/cmd_vel/angular/z"
    assert second.pose["x"].source == "/vrpn_client_node/drone/pose/pose/position/x"


def test_poses_and_commands_with_clocks_of_their_own_names_and_vectors_are_drafted(tmp_path: Path) -> None:
    true, fine = turning(), np.arange(0.0, T[-1], 0.02)
    told = np.stack([np.interp(fine, T, COMMAND[axis]) for axis in ("x", "y", "z", "yaw")], axis=1)
    seen = np.stack([true[axis] for axis in "xyz"], axis=1)
    columns = {"pose.time": T, "pose.position": seen, "pose.yaw": true["yaw"], "cmd.time": fine, "cmd.vel": told}

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)

    assert (card.command_time.source, card.pose_time.source) == ("cmd.time", "pose.time")
    assert [card.pose[axis].source for axis in "xyz"] == [f"pose.position[{i}]" for i in range(3)]
    assert [card.command[axis].source for axis in ("x", "y", "z", "yaw")] == [f"cmd.vel[{i}]" for i in range(4)]


def test_a_clock_of_all_rows_comes_before_that_of_one_sensor(tmp_path: Path) -> None:
    """Which began elsewhere: by it the poses would come 0.4 s late."""
    true = {f"mocap_{axis}": one for axis, one in turning().items()} | {"mocap_time": T + 0.4}
    columns = {"t": T, **true, **{f"cmd_{axis}": one for axis, one in COMMAND.items()}}

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)

    assert (card.command_time.source, card.pose_time.source) == ("t", "t")


@pytest.mark.parametrize(
    ("word", "sent", "taken"),
    [
        ("pose.", "cmd.stamp", "pose.stamp"),
        ("", "cmd.stamp", "pose.stamp"),
        ("", "t_cmd", "t"),
        ("", "time_sent", "time"),
        ("", "t", "t_pose"),
    ],
)
def test_rows_of_poses_and_of_commands_have_clocks_of_their_own(
    word: str, sent: str, taken: str, tmp_path: Path
) -> None:
    """As of JSON Lines of two kinds: each row is blank where the other's columns are."""
    true, fine = turning(), np.arange(0.01, T[-1], 0.05)
    told = {f"cmd.{axis}": np.interp(fine, T, COMMAND[axis]) for axis in ("x", "y", "z", "yaw")} | {sent: fine}
    seen = {f"{word}{axis}": true[axis] for axis in ("x", "y", "z", "yaw")} | {taken: T}
    place = np.argsort(np.concatenate([fine, T]), kind="stable")
    columns = {name: np.concatenate([one, np.full(T.size, np.nan)])[place] for name, one in told.items()}
    columns |= {name: np.concatenate([np.full(fine.size, np.nan), one])[place] for name, one in seen.items()}

    card = loaded(draft_card(log := log_of(flight=columns)), tmp_path)

    assert (card.command_time.source, card.pose_time.source) == (sent, taken)
    assert flight_from_log(log, card).duration == pytest.approx(T[-1], abs=0.2)


def test_commands_named_right_down_and_cw_are_turned(tmp_path: Path) -> None:
    still = {axis: np.zeros(T.size) for axis in ("x", "y", "z", "yaw")}  # no motion tells a sign
    sticks = {"cmd_fwd": COMMAND["x"], "cmd_right": COMMAND["y"], "cmd_down": COMMAND["z"], "cmd_cw": COMMAND["yaw"]}

    card = loaded(draft_card(log_of(flight={"time": T} | still | sticks)), tmp_path)

    assert {axis: card.command[axis].source for axis in card.command} == dict(
        zip(("x", "y", "z", "yaw"), sticks, strict=True)
    )
    assert [card.command[axis].scale for axis in ("x", "y", "z", "yaw")] == [1.0, -1.0, -1.0, -1.0]


def test_series_side_by_side_of_unlike_lengths_have_clocks_of_their_own(tmp_path: Path) -> None:
    """The longer one fills every row, and only the other has blanks that tell a clock from a measurement."""
    true, sent = turning(), np.arange(0.01, T[-1], 0.05)
    columns = {"t_pose": T} | {axis: true[axis] for axis in ("x", "y", "z", "yaw")}
    short = {"t_cmd": sent} | {f"cmd_{axis}": np.interp(sent, T, COMMAND[axis]) for axis in ("x", "y", "z", "yaw")}
    columns |= {name: np.concatenate([one, np.full(T.size - sent.size, np.nan)]) for name, one in short.items()}

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)

    assert (card.command_time.source, card.pose_time.source) == ("t_cmd", "t_pose")


def test_a_name_like_that_of_a_clock_of_commands_is_none_where_every_row_has_a_value() -> None:
    """It may be a thrust, or the time that a computation took."""
    true = turning()
    columns = {f"cmd_{axis}": COMMAND[axis] for axis in ("x", "y", "z", "yaw")}
    columns |= {axis: true[axis] for axis in ("x", "y", "z", "yaw")} | {"loop_time": T, "t_cmd": T + 0.1}

    found = draft_card(log_of(flight=columns))

    assert found.count('time = "loop_time"') == 2
    assert "t_cmd" not in found.partition("# All columns")[0]


def test_commands_named_as_velocities_come_before_setpoints_of_a_position(tmp_path: Path) -> None:
    names = {f"cmd_{axis}": f"cmd_v{axis}" for axis in "xyz"} | {"cmd_yaw": "cmd_yaw_rate"}
    columns = dict(csv_log(**names).tables["flight"].columns)
    setpoints = {f"cmd_{axis}": columns[axis] + 0.1 for axis in ("x", "y", "z", "yaw")}

    card = loaded(draft_card(log_of(flight=columns | setpoints)), tmp_path)
    del columns["cmd_vz"]
    hover = draft_card(log_of(flight=columns | setpoints))

    assert [one.source for one in card.command.values()] == ["cmd_vx", "cmd_vy", "cmd_vz", "cmd_yaw_rate"]
    assert 'z = "cmd_z"  # EDIT: named unlike x and y; a height instead of a velocity?' in hover


def test_references_of_a_position_are_not_taken_for_commands() -> None:
    names = {f"cmd_{axis}": f"{axis}_ref" for axis in ("x", "y", "z")}
    text = draft_card(csv_log(**names, cmd_yaw=""))

    assert "INCOMPLETE: nothing was recognised for [command] x, y, z or yaw" in text


def test_a_written_draft_says_what_it_lacks(tmp_path: Path) -> None:
    assert write_draft(csv_log(), tmp_path / "whole.toml") == ()
    log = csv_log(cmd_x="a", cmd_y="b", cmd_z="c", cmd_yaw="")
    assert write_draft(log, tmp_path / "poses.toml") == ("[command] x, y, z or yaw",)
    assert write_draft(csv_log(z="height", yaw=""), tmp_path / "plane.toml") == ("[pose] z", "[pose] yaw or quaternion")


def test_a_draft_says_of_which_axes_it_has_no_command(tmp_path: Path) -> None:
    log = csv_log(cmd_x="cmd_x", cmd_y="ride", cmd_z="dive", cmd_yaw="")

    assert write_draft(log, tmp_path / "x.toml") == ("[command] y, z, yaw (if the log has them)",)
    text = (tmp_path / "x.toml").read_text()
    assert "# No command was recognised for y, z, yaw. Name what the log has, or they get no model." in text
    assert "INCOMPLETE" not in text


def test_a_draft_knows_sticks_motion_capture_and_counters_by_their_short_names(tmp_path: Path) -> None:
    names = {"cmd_x": "stick_fwd", "cmd_y": "stick_right", "cmd_z": "stick_thr", "cmd_yaw": "stick_rot"}
    log = csv_log(**names, x="mc_east", y="mc_north", z="mc_up", yaw="mc_hdg")
    card = loaded(draft_card(log), tmp_path)

    assert {axis: str(one.source) for axis, one in card.command.items()} == {a[4:]: n for a, n in names.items()}
    assert [str(card.pose[axis].source) for axis in ("x", "y", "z", "yaw")] == [
        "mc_east",
        "mc_north",
        "mc_up",
        "mc_hdg",
    ]


def test_what_is_to_the_right_is_turned_where_the_motion_does_not_tell() -> None:
    still = np.zeros(50)
    log = log_of(sent={"t": np.arange(50) / 10, "stick_fwd": still, "stick_right": still, "stick_left_right": still})

    assert commands_in(log).channels["y"] == Channel("stick_right", scale=-1)


def test_a_column_that_counts_milliseconds_is_a_clock_where_there_is_no_other() -> None:
    count = np.arange(50) * 20.0
    age = np.where(np.arange(50) % 7, 3.0, 9.0)

    assert list(clocks(Table("a", {"age_ms": age, "tx_ms": count}))) == ["tx_ms"]
    assert list(clocks(Table("a", {"tx_ms": count, "time": count / 1e3}))) == ["time"]


def test_a_draft_that_lacks_essentials_says_which_and_lists_the_columns(tmp_path: Path) -> None:
    log = log_of(run={"Time": np.arange(50.0) / 10, "SS": np.zeros((6, 50)), "U": np.zeros((4, 50))})
    text = draft_card(log)

    assert "# INCOMPLETE: nothing was recognised for [command] x, y, z or yaw; [pose] x; [pose] y" in text
    assert '# x = "TABLE:COLUMN"  # EDIT' in text
    assert "#   SS (6 x 50)" in text
    with pytest.raises(CardError, match="no axis is commanded"):
        loaded(text, tmp_path)


def test_a_draft_for_a_log_that_a_built_in_card_fits_is_that_card(tmp_path: Path) -> None:
    text = draft_card(csv_log(cmd_x="cmd_linx", cmd_y="cmd_liny", cmd_z="cmd_linz", cmd_yaw="cmd_angz"))

    assert text.startswith("# A copy of the built-in card bebop2-joystick")
    assert loaded(text, tmp_path) == load_card("bebop2-joystick")


def test_a_draft_may_be_fresh_where_a_built_in_card_fits() -> None:
    text = draft_card(csv_log(cmd_x="cmd_linx", cmd_y="cmd_liny", cmd_z="cmd_linz", cmd_yaw="cmd_angz"), fresh=True)

    assert text.startswith("# Drafted from the names in")
    assert 'x = "cmd_linx"' in text


def test_names_with_quotes_and_backslashes_survive_the_draft(tmp_path: Path) -> None:
    log = message_log(pose='/a"b\\c/pose', pose_prefix="pose.")

    assert loaded(draft_card(log), tmp_path).pose["x"].source == '/a"b\\c/pose:pose.position.x'


# Files


def test_a_draft_is_written_to_a_new_file_only(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    write_draft(csv_log(), path)
    edited = path.read_text() + "# edited"
    path.write_text(edited)

    with pytest.raises(CardError, match="exists already"):
        write_draft(csv_log(), path)
    assert path.read_text() == edited


def test_the_text_of_a_built_in_card_loads_as_that_card(tmp_path: Path) -> None:
    assert loaded(builtin_card_text("bebop2"), tmp_path) == load_card("bebop2")


def test_an_unknown_built_in_card_is_refused_with_the_nearest() -> None:
    with pytest.raises(CardError, match="nearest: 'bebop2-wsu'"):
        builtin_card_text("bebop-wsu")


# Real flights


def test_drafts_by_names_alone_give_the_flights_of_the_real_cards(
    real_flights: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    files = {
        "bebop2-joystick": "record_velocity.csv",
        "bebop2-optitrack": "monster_pitch_trn.bag",
        "dji-hexarotor": "Datos_Prueba3.mat",
    }
    for folder, file in files.items():
        log = read(real_flights / folder / file)
        expected = flight_from_log(log, load_card(folder))
        with monkeypatch.context() as patch:
            patch.setattr(card_choice, "fitting_cards", lambda _: {})
            found = flight_from_log(log, loaded(draft_card(log), tmp_path))

        np.testing.assert_array_equal(found.position, expected.position)
        np.testing.assert_array_equal(found.command, expected.command)
        assert found.segments == expected.segments


# By the motion


def test_a_draft_exchanges_and_turns_commands_as_the_motion_says(tmp_path: Path) -> None:
    """The columns are called after the wrong axes, and two point the other way."""
    columns = {"time": T, **motion(world=False), "u_x": COMMAND["y"], "u_y": -COMMAND["x"]}
    log = log_of(flight=columns | {"u_z": -COMMAND["z"], "u_yaw": COMMAND["yaw"]})

    text = draft_card(log)
    card = loaded(text, tmp_path)

    assert {axis: (one.source, one.scale) for axis, one in card.command.items()} == {
        "x": ("u_y", -1), "y": ("u_x", 1), "z": ("u_z", -1), "yaw": ("u_yaw", 1),
    }  # fmt: skip
    assert card.command_frame == "heading"
    assert "+ moves the vehicle left, though named like x" in text
    assert "Signs were checked against the motion." in text
    flight = flight_from_log(log, card)
    np.testing.assert_allclose(flight.command[:, 0], np.interp(flight.command_time, T, COMMAND["x"]), atol=1e-9)


def test_a_draft_reads_a_compass_as_clockwise_from_north(tmp_path: Path) -> None:
    true = turning()
    compass = (90 - np.degrees(true["yaw"])) % 360
    columns = {"time": T, **{axis: true[axis] for axis in "xyz"}, "heading_deg": compass}
    log = log_of(flight=columns | {f"cmd_{axis}": series for axis, series in COMMAND.items()})

    card = loaded(draft_card(log), tmp_path)

    assert (card.pose["yaw"].scale, card.pose["yaw"].offset, card.command_frame) == (-1, 90, "heading")
    assert {one.scale for one in card.command.values()} == {1}
    turned = np.unwrap(flight_from_log(log, card).yaw)
    np.testing.assert_allclose(turned - turned[0], np.unwrap(true["yaw"])[: turned.size] - true["yaw"][0], atol=1e-6)


def fixes(at: tuple[float, float], east: Array, north: Array) -> dict[str, Array]:
    """Longitude and latitude in degrees, on a sphere: within 0.6 % of the ellipsoid here."""
    degree = np.radians(6378137.0)
    return {"lon": at[1] + east / degree / np.cos(np.radians(at[0])), "lat": at[0] + north / degree}


@pytest.mark.parametrize("ahead", [None, 0.0, 1.4, 2.5])
@pytest.mark.parametrize("size", [1.0, 1e7])
def test_a_log_in_degrees_of_the_globe_with_velocities_to_north_and_east_is_drafted(
    ahead: float | None, size: float, tmp_path: Path
) -> None:
    """With a heading that turns, and with one that is held, in which the motion does not tell the frame."""
    true = motion(world=True)
    yaw = true["yaw"] if ahead is None else np.full(T.size, ahead)
    columns = {
        "utc": np.round((1.788e9 + T) * 1e9).astype(np.int64),
        **{name: np.round(size * values, 9) for name, values in fixes((47.4, 8.5), true["x"], true["y"]).items()},
        "alt": 450 + true["z"],
        "heading": np.degrees(np.pi / 2 - yaw) % 360,
        "cmd_vn": COMMAND["y"],
        "cmd_ve": COMMAND["x"],
        "cmd_climb": COMMAND["z"],
        **({"cmd_yawrate": -np.degrees(COMMAND["yaw"])} if ahead is None else {}),
    }
    log = log_of(flight=columns)
    card = loaded(text := draft_card(log), tmp_path)

    assert {axis: one.source for axis, one in card.command.items() if axis != "yaw"} == {
        "x": "cmd_ve",
        "y": "cmd_vn",
        "z": "cmd_climb",
    }
    assert card.command_frame == "world"
    assert all(one.scale > 0 for axis, one in card.command.items() if axis != "yaw")
    assert (card.pose["yaw"].unit, card.pose["yaw"].scale, card.pose["yaw"].offset) == ("deg", -1, 90)
    assert "INCOMPLETE" not in text
    flight = flight_from_log(log, card)
    np.testing.assert_allclose(np.ptp(flight.position[:, 0]), np.ptp(true["x"]), rtol=0.006)
    np.testing.assert_allclose(np.ptp(flight.position[:, 1]), np.ptp(true["y"]), rtol=0.006)
    assert np.max(np.abs(flight.position[0, :2])) < 0.2


def test_latitude_and_longitude_are_no_position_where_there_is_one_in_metres(tmp_path: Path) -> None:
    true = motion(world=False)
    columns = {"time": T, **true, **fixes((-33.0, 151.0), true["x"], true["y"]), "alt": 3 + true["z"]}
    columns |= {f"cmd_{axis}": COMMAND[axis] for axis in ("x", "y", "z", "yaw")}

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)
    assert [card.pose[axis].source for axis in "xyz"] == ["x", "y", "z"]


@pytest.mark.parametrize("names", [("cmd_v_n", "cmd_v_e", "cmd_v_d"), ("vel_north_sp", "vel_east_sp", "vel_down_sp")])
def test_a_command_named_down_is_turned_beside_those_to_north_and_east(names: tuple[str, ...], tmp_path: Path) -> None:
    true = motion(world=True)
    columns = {"time": T, "east": true["x"], "north": true["y"], "up": true["z"], "yaw": true["yaw"]}
    columns |= dict(zip(names, (COMMAND["y"], COMMAND["x"], -COMMAND["z"]), strict=True))

    card = loaded(draft_card(log_of(flight=columns)), tmp_path)
    assert {axis: (one.source, one.scale) for axis, one in card.command.items()} == {
        "x": (names[1], 1),
        "y": (names[0], 1),
        "z": (names[2], -1),
    }


@pytest.mark.parametrize("frame", ["ENU", "NED"])
def test_degrees_of_the_globe_that_a_card_takes_for_metres_are_told_with_lines_that_are_right(frame: str) -> None:
    true = motion(world=False)
    columns = {"time": T, **fixes((47.4, 8.5), true["x"], true["y"]), "alt": true["z"], "yaw": true["yaw"]}
    columns |= {f"u_{axis}": COMMAND[axis] for axis in ("x", "y", "z", "yaw")}
    x, y = ("lon", "lat") if frame == "ENU" else ("lat", "lon")
    raw = {"name": "n", "frame": frame, "command": {"time": "time", **{axis: f"u_{axis}" for axis in ("x", "y", "z")}}}
    raw |= {"pose": {"time": "time", "x": x, "y": y, "z": "alt", "yaw": "yaw"}}
    log = log_of(flight=columns)

    flight = flight_from_log(log, card_from_mapping(raw, "n"))
    (told,) = [one for one in findings_of_flight(log, flight) if one.code == "unit_mistake"]
    assert "degrees of longitude and latitude" in told.evidence
    lines = told.remedy.removeprefix("write ").partition(" in [pose]")[0].replace(" and ", "\n")
    raw["pose"] |= tomllib.loads(lines)
    mended = flight_from_log(log, card_from_mapping(raw, "n"))
    np.testing.assert_allclose(np.ptp(mended.position[:, 0]), np.ptp(true["x"]), rtol=0.006)
    np.testing.assert_allclose(np.ptp(mended.position[:, 1]), np.ptp(true["y"]), rtol=0.006)
    assert not [one for one in findings_of_flight(log, mended) if one.code == "unit_mistake"]


def test_a_heading_from_east_is_no_compass_also_where_that_reading_hides_the_frame_of_the_commands(
    tmp_path: Path,
) -> None:
    """Read as a compass, this flight exchanges x and y, and tells neither the world nor the heading (seed 13)."""
    flight = flown(Truth(), steps(("x", "y", "z", "yaw"), seed=13), 40.0, 13)
    at = np.radians(-163)
    turn = np.array([[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]])
    east, north = turn @ flight.position[:, :2].T
    held = flight.command[np.searchsorted(flight.command_time, flight.pose_time, side="right") - 1]
    columns = {"time": flight.pose_time, "mocap_east": east, "mocap_north": north, "mocap_up": flight.position[:, 2]}
    columns |= {"heading_deg": np.degrees(flight.yaw + at)}
    sticks = dict(zip(("stick_forward", "stick_left", "stick_up", "stick_turn"), held.T, strict=True))

    card = loaded(draft_card(log_of(flight=columns | sticks)), tmp_path)

    assert (card.pose["yaw"].scale, card.pose["yaw"].offset) == (1, 0)
    assert [card.command[axis].source for axis in ("x", "y", "z", "yaw")] == list(sticks)
    assert {channel.scale for channel in card.command.values()} == {1}


EAST_NORTH_UP: dict[str, Callable] = {
    "north_east_alt": lambda true: {"north": true["y"], "east": true["x"], "alt": true["z"]},
    "above_the_start": lambda true: {"north": true["y"], "east": true["x"], "alt": true["z"] - true["z"][0] - 0.3},
    "enu": lambda true: {"pos_e": true["x"], "pos_n": true["y"], "pos_u": true["z"]},
    "ned": lambda true: {"pos_n": true["y"], "pos_e": true["x"], "pos_d": -true["z"]},
    "z_without_a_name": lambda true: {"north": true["y"], "east": true["x"], "z": true["z"]},
}

HEADINGS: dict[str, Callable] = {
    "compass": lambda yaw: {"hdg": np.degrees(np.pi / 2 - yaw) % 360},
    "heading_from_east": lambda yaw: {"heading_deg": np.degrees(yaw)},
    "yaw_from_north": lambda yaw: {"yaw": np.pi / 2 - yaw},
    "quaternion_of_ned": lambda yaw: quaternion(np.pi / 2 - yaw),
    "quaternion_of_enu": lambda yaw: quaternion(yaw),
}

COMMANDS = {
    "sticks": {"stick_fwd": ("x", 1), "stick_right": ("y", -1), "stick_climb": ("z", 1), "stick_yaw": ("yaw", -1)},
    "right_up": {"vx_cmd": ("x", 1), "vy_cmd": ("y", -1), "vz_cmd": ("z", 1), "yawrate_cmd": ("yaw", -1)},
    "right_down": {"vx_cmd": ("x", 1), "vy_cmd": ("y", -1), "vz_cmd": ("z", -1), "yawrate_cmd": ("yaw", -1)},
}


def quaternion(yaw: np.ndarray) -> dict:
    return {"qw": np.cos(yaw / 2), "qx": 0 * yaw, "qy": 0 * yaw, "qz": np.sin(yaw / 2)}


def assert_right_handed(columns: dict, true: dict, tmp_path: Path) -> None:
    """The draft reads the pose as it was and the commands as they act, whichever way the columns count."""
    log = log_of(flight={"time": T, **columns})
    flight = flight_from_log(log, loaded(draft_card(log), tmp_path))

    seen, sent = (lambda series: np.interp(flight.pose_time, T, series)), flight.command_time
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(np.diff(flight.position[:, k]), np.diff(seen(true[axis])), atol=1e-6)
    turned = np.exp(1j * (flight.yaw - seen(true["yaw"])))
    np.testing.assert_allclose(turned, 1, atol=1e-5)
    told = np.column_stack([np.interp(sent, T, COMMAND[axis]) for axis in ("x", "y", "z", "yaw")])
    np.testing.assert_allclose(flight.command, told, atol=1e-9)


def combinations() -> Iterator[ParameterSet]:
    """All of them; every pair is among those that are not slow."""
    for i, j, k in itertools.product(range(len(EAST_NORTH_UP)), range(len(HEADINGS)), range(len(COMMANDS))):
        names = list(EAST_NORTH_UP)[i], list(HEADINGS)[j], list(COMMANDS)[k]
        yield pytest.param(*names, marks=pytest.mark.slow if (i + j + k) % len(COMMANDS) else ())


@pytest.mark.parametrize(("position", "heading", "commands"), tuple(combinations()))
def test_a_pose_with_directions_in_its_names_is_not_mirrored(
    position: str, heading: str, commands: str, tmp_path: Path
) -> None:
    true = turning()
    told = {name: sign * COMMAND[axis] for name, (axis, sign) in COMMANDS[commands].items()}

    assert_right_handed(EAST_NORTH_UP[position](true) | HEADINGS[heading](true["yaw"]) | told, true, tmp_path)


@pytest.mark.parametrize("commands", COMMANDS)
def test_a_heading_named_like_a_compass_is_turned_before_a_position(commands: str, tmp_path: Path) -> None:
    true = turning()
    told = {name: sign * COMMAND[axis] for name, (axis, sign) in COMMANDS[commands].items()}

    assert_right_handed({axis: true[axis] for axis in "xyz"} | HEADINGS["compass"](true["yaw"]) | told, true, tmp_path)


def test_a_draft_says_where_the_motion_stands_against_a_name() -> None:
    true = turning()
    pose = EAST_NORTH_UP["enu"](true) | HEADINGS["heading_from_east"](true["yaw"])
    told = {"stick_fwd": COMMAND["x"], "stick_right": COMMAND["y"], "stick_climb": COMMAND["z"]}

    text = draft_card(log_of(flight={"time": T, **pose, **told, "stick_yaw": COMMAND["yaw"]}))

    assert "yaw grows counter-clockwise from east, where x points, though named like a compass, by the motion" in text
    assert "delay and time constant together 0.3 s, though its name says the other way" in text


@pytest.mark.parametrize(("unit", "step"), [("ms", 1), ("us", 1000), ("ns", 1_000_000)])
@pytest.mark.parametrize("since_1970", [False, True])
def test_a_draft_of_a_log_at_a_kilohertz_finds_the_unit_of_its_clock(
    unit: str, step: int, since_1970: bool, tmp_path: Path
) -> None:
    true, names = turning(), {f"cmd_{axis}": series for axis, series in COMMAND.items()}
    fine = np.arange(0.0, 12.0, 0.001)
    columns = {name: np.interp(fine, T, series) for name, series in (true | names).items()}
    start = 1_700_000_000 if since_1970 else 5
    log = log_of(flight=columns | {"time": (np.arange(fine.size) + 1000 * start) * step})

    card = loaded(draft_card(log), tmp_path)

    assert card.pose_time.unit == unit
    assert flight_from_log(log, card).duration == pytest.approx(12.0, abs=0.1)


def test_colons_in_the_names_of_columns_are_no_tables(tmp_path: Path) -> None:
    names = {"time": "log:time", **{axis: f"drone:{axis}" for axis in ("x", "y", "z", "yaw")}}
    log = csv_log(**names, **{f"cmd_{axis}": f"cmd:{axis}" for axis in ("x", "y", "z", "yaw")})

    card = loaded(draft_card(log), tmp_path)

    assert card.command["x"].source == "cmd:x"
    assert flight_from_log(log, card).duration == pytest.approx(29.98, abs=0.1)


def test_a_draft_says_world_where_commands_do_not_turn_with_the_vehicle(tmp_path: Path) -> None:
    columns = {"time": T, **motion(world=True), **{f"cmd_{axis}": series for axis, series in COMMAND.items()}}

    text = draft_card(log_of(flight=columns))
    card = loaded(text, tmp_path)

    assert 'yaw = "yaw"  # EDIT: radians, or degrees and frame = "heading" in [command]' in text
    assert card.command_frame == "world"
    assert {axis: (one.source, one.scale) for axis, one in card.command.items()} == {
        axis: (f"cmd_{axis}", 1) for axis in COMMAND
    }


def test_what_does_not_move_is_marked_to_be_checked() -> None:
    columns = {"time": T, **motion(world=False), **{f"cmd_{axis}": series for axis, series in COMMAND.items()}}

    text = draft_card(log_of(flight=columns | {"cmd_z": np.zeros(T.size)}))

    assert 'z = "cmd_z"  # does not move in this log: EDIT, sign unknown' in text


def test_what_the_other_commands_hold_is_neither_turned_nor_moved_to_another_axis(tmp_path: Path) -> None:
    columns = {"time": T, **motion(world=False), **{f"cmd_{axis}": series for axis, series in COMMAND.items()}}

    text = draft_card(log_of(flight=columns | {"cmd_z": -COMMAND["z"], "cmd_yaw": COMMAND["z"]}))

    channels = loaded(text, tmp_path).command
    for axis in ("z", "yaw"):
        assert (channels[axis].source, channels[axis].scale) == (f"cmd_{axis}", 1)
        (line,) = (line for line in text.splitlines() if line.startswith(f'{axis} = "cmd_{axis}"'))
        assert "EDIT: the motion does not tell the sign: 100 % of this command is in the others" in line


def test_a_draft_takes_the_heading_of_another_table_and_names_states_and_references() -> None:
    true = motion(world=False)
    half = true["yaw"] / 2
    tables = {
        "local_position": {"timestamp": T, **{axis: true[axis] for axis in "xyz"}},
        "attitude": {"timestamp": T, "q": np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)},
        "velocity_setpoint": {"timestamp": T, "velocity": np.stack([COMMAND[axis] for axis in "xyz"], axis=1)}
        | {"yawspeed": COMMAND["yaw"], "x": true["x"]},
        "state": {"timestamp": T, "armed": (T > 1).astype(np.uint8)},
    }

    text = draft_card(log_of(**tables))

    assert 'x = "velocity_setpoint:velocity[0]"  # + moves the vehicle forward: ' in text
    assert 'quaternion = ["attitude:q[0]", "attitude:q[1]", "attitude:q[2]", "attitude:q[3]"]' in text
    assert '[reference]\nx = "velocity_setpoint:x"' in text
    assert '[[window]]  # commands count while this holds\nwhen = "state:armed"' in text
    assert "INCOMPLETE" not in text


@pytest.mark.parametrize(("kind", "up"), [("motive", "y"), ("vicon", "z")])
def test_the_body_of_motion_capture_is_found_beside_the_log_of_the_commands(kind: str, up: str) -> None:
    parts = [f"position.{axis}" for axis in "xyz"] + [f"rotation.{part}" for part in "wxyz"]
    body = replace(log_of("take.csv", take={"time": T, **{f"drone.{part}": 0 * T + 1 for part in parts}}), format=kind)
    commands = log_of("own.csv", own={"time": T, **{f"cmd_{axis}": series for axis, series in COMMAND.items()}})

    for logs in ([commands, body], [body, commands]):
        text = draft_card(join_logs(logs))

        assert "INCOMPLETE" not in text
        assert f'\nz = "drone.position.{up}"' in text
        assert ("# Motive has y up" in text) == (kind == "motive")


def test_position_and_quaternion_of_motion_capture_are_of_one_body_and_a_rotation_vector_is_no_quaternion() -> None:
    body = [f"{kind}.{part}" for kind, parts in (("rotation", "xyz"), ("quaternion", "wxyz")) for part in parts]
    names = [f"m1.position.{axis}" for axis in "xyz"]
    names += [f"drone.{part}" for part in (*body, *(f"position.{axis}" for axis in "xyz"))]
    log = replace(log_of("take.csv", take={"time": T, **dict.fromkeys(names, 0 * T + 1)}), format="vicon")

    text = draft_card(log)

    assert '\nz = "drone.position.z"' in text
    assert '\nquaternion = "drone.quaternion"' in text


@pytest.mark.parametrize("several", [False, True])
def test_a_draft_for_two_files_reads_those_of_the_next_flight(several: bool, tmp_path: Path) -> None:
    """Where another file has the columns of a pose, too, the name of its file is needed, but for its numbers."""
    true = turning()
    command = {"t": T, **{f"cmd_{axis}": series for axis, series in COMMAND.items()}, "armed": (T > 1).astype(int)}
    pose = {"t": T, **{axis: true[axis] for axis in ("x", "y", "z", "yaw")}}

    def of(day: str) -> Log:
        sheets = {f"sent-{day}": command, f"{day}_mocap": pose} | ({f"{day}_onboard": pose} if several else {})
        return join_logs([log_of(f"{name}.csv", **{name: sheet}) for name, sheet in sheets.items()])

    text = draft_card(of("2024-05-01"))

    card = loaded(text, tmp_path)
    assert "2024" not in "".join(line for line in text.splitlines() if " = " in line and not line.startswith("name"))
    assert '\nwhen = "armed"' in text
    assert card.pose["x"].source == ("*_mocap:x" if several else "x")
    one = card_from_mapping({**card.raw, "clock": "one"}, "drafted")  # where the clocks lie is not what is asked here
    flights = [flight_from_log(of(day), one) for day in ("2024-05-01", "2024-06-12_3")]
    np.testing.assert_array_equal(flights[0].position, flights[1].position)
    assert flights[0].duration > 20


def test_a_draft_that_lacks_essentials_keeps_the_names_of_its_files() -> None:
    pose = {"t": T, **{axis: turning()[axis] for axis in "xyz"}}

    text = draft_card(join_logs([log_of("a.csv", a={"t": T, "cmd_x": COMMAND["x"]}), log_of("b.csv", b=pose)]))

    assert "INCOMPLETE" in text
    assert 'x = "a:cmd_x"' in text
    assert 'x = "b:x"' in text


def bodies_of(kind: str, **bodies: dict) -> Log:
    """An export of motion capture with several bodies, beside the log of the commands."""
    columns = {f"{body}.{part}": series for body, parts in bodies.items() for part, series in parts.items()}
    take = replace(log_of("take.csv", take={"time": T, **columns}), format=kind)
    return join_logs(
        [log_of("own.csv", own={"time": T, **{f"cmd_{axis}": one for axis, one in COMMAND.items()}}), take]
    )


def body(true: dict, up: str = "z") -> dict:
    half = true["yaw"] / 2
    names = dict(zip("xyz", "zxy" if up == "y" else "xyz", strict=True))
    turned = dict.fromkeys("wxyz", 0 * T) | {"w": np.cos(half), up: np.sin(half)}
    places = {f"position.{name}": true[axis] for axis, name in names.items()}
    return places | {f"rotation.{part}": series for part, series in turned.items()}


def test_of_several_bodies_a_draft_takes_the_one_that_answers_the_commands_and_names_the_others(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    still = {axis: 0.5 + rng.normal(0, 2e-4, T.size) for axis in "xyz"} | {"yaw": 0 * T}
    log = bodies_of("vicon", wand=body(still), vehicle=body(turning()))

    text = draft_card(log)

    assert loaded(text, tmp_path).pose["x"].source == "vehicle.position.x"
    assert "# EDIT if one of these is right: take:wand.position.x" in text
    assert "Signs were checked against the motion." in text


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_axes_of_motive_are_those_in_which_the_vehicle_obeys(up: str) -> None:
    text = draft_card(bodies_of("motive", drone=body(turning(), up)))

    assert f'\nz = "drone.position.{up}"' in text
    assert ("# Motive has y up" in text) == (up == "y")
    assert "EDIT" not in text.partition("[pose]")[2].partition("\n# [limits]")[0]


def test_a_card_whose_z_does_not_point_up_is_told_the_axis_that_does(tmp_path: Path) -> None:
    true = raised(1.0)
    half, rolled = true.pop("yaw") / 2, 0.02 * np.sin(3 * T)
    turned = dict(zip(("qw", "qx", "qy", "qz"), (np.cos(half), rolled, -rolled, np.sin(half)), strict=True))
    commands = {f"cmd_{axis}": series for axis, series in COMMAND.items()}
    log = log_of(flight={"time": T, **true, **turned, **commands})
    text = draft_card(log)
    right = next(line for line in text.splitlines() if line.startswith("quaternion"))
    pose = text.partition("[pose]")[2]
    wrong = pose.replace('x = "x"', 'x = "Z"').replace('y = "y"', 'y = "x"').replace('z = "z"', 'z = "y"')
    wrong = wrong.replace('"Z"', '"z"').replace(right, 'quaternion = ["qw", "qz", "qx", "qy"]')

    flight = flight_from_log(log, loaded(text.replace(pose, wrong), tmp_path))
    told = {one.code: one for one in findings_of_flight(log, flight)}

    assert "the command of z moves the vehicle along x" in told["axes_exchanged"].evidence
    assert 'x = "x", y = "y", z = "z", quaternion = ["qw", "qx", "qy", "qz"]' in told["axes_exchanged"].remedy
    assert "quaternion_order" not in told


@pytest.mark.parametrize(("unit", "line"), [("mm", 'unit = "mm" }  # unit as the file states it'), ("m", None)])
def test_a_length_is_in_the_unit_that_the_export_states_however_fast_the_motion(unit: str, line: str | None) -> None:
    columns = {f"drone.rotation.{part}": 0 * T + (part == "w") for part in "wxyz"}
    columns |= {f"drone.position.{axis}": 30 * np.sin(3 * T) for axis in "xyz"}
    columns |= {f"cmd_{axis}": series for axis, series in COMMAND.items()}
    log = replace(log_of("take.csv", take={"time": T, **columns}), format="vicon")
    log = replace(log, units={("take", f"drone.position.{axis}"): unit for axis in "xyz"})

    text = draft_card(log)

    assert ('x = { from = "drone.position.x", ' + line in text) if line else ('x = "drone.position.x"' in text)


def test_a_draft_takes_the_units_that_the_file_states(tmp_path: Path) -> None:
    true = turning()
    columns = {"t": 1000 * T, **{axis: 1000 * true[axis] for axis in "xyz"}, "yaw": np.degrees(true["yaw"])}
    columns |= {f"v{axis}": 100 * np.gradient(true[axis], T) for axis in "xyz"}
    columns |= {f"cmd_{axis}": series for axis, series in COMMAND.items()}
    units = dict.fromkeys("xyz", "mm") | dict.fromkeys(("vx", "vy", "vz"), "cm/s") | {"t": "ms", "yaw": "deg"}
    wrong = units | {"cmd_x": "s", "yaw": "deg/s"}

    for said, yaw in ((units, "as the file states it"), (wrong, "guessed")):
        log = replace(log_of(flight=columns), units={("flight", name): unit for name, unit in said.items()})
        text = draft_card(log)

        assert text.count('time = { from = "t", unit = "ms" }  # unit as the file states it') == 3
        assert 'x = { from = "x", unit = "mm" }  # unit as the file states it' in text
        assert 'y = { from = "vy", unit = "cm/s" }  # unit as the file states it' in text
        assert f'yaw = {{ from = "yaw", unit = "deg" }}  # unit {yaw}' in text
        assert flight_from_log(log, loaded(text, tmp_path)).duration == pytest.approx(T[-1], abs=0.1)


# The vehicle's own velocity


def velocities_of(true: dict, frame: str) -> dict:
    """Velocities of a motion, along the world's axes or forward and left."""
    velocity = {axis: np.gradient(true[axis], T) for axis in "xyz"}
    if frame == "heading":
        across = heading_from_world(np.stack([velocity["x"], velocity["y"]], axis=1), true["yaw"])
        velocity |= {"x": across[:, 0], "y": across[:, 1]}
    return velocity


def turning() -> dict:
    """A flight of half a minute that turns by more than a radian."""
    return motion(world=False)


@pytest.mark.parametrize("frame", ["heading", "world"])
def test_a_draft_of_a_log_without_position_takes_the_velocity_in_the_frame_that_the_motion_tells(
    frame: str, tmp_path: Path
) -> None:
    true = turning()
    columns = {"time": T, "yaw": true["yaw"], "z": true["z"]}
    columns |= {f"v{axis}": series for axis, series in velocities_of(true, frame).items()}
    log = log_of(flight=columns | {f"cmd_{axis}": series for axis, series in COMMAND.items()})

    text = draft_card(log)
    card = loaded(text, tmp_path)
    flight = flight_from_log(log, card)

    assert "INCOMPLETE" not in text
    assert card.velocity_only == ("x", "y")
    assert card.velocity_frame == frame
    assert 'x = "cmd_x"  # + moves the vehicle forward: ' in text
    expected = np.interp(flight.pose_time, T, true["x"]) - true["x"][0]
    np.testing.assert_allclose(flight.position[:, 0], expected, atol=0.03)


def test_the_frame_of_a_velocity_is_told_by_what_is_left_of_it_not_of_the_turning(tmp_path: Path) -> None:
    """Read in the wrong frame, the commands of x and y move yaw the most, which its own command explains."""
    rng = np.random.default_rng(4)
    command = {axis: np.repeat(rng.uniform(-1, 1, T.size // 10), 10) for axis in ("x", "y", "z", "yaw")}
    velocity = {axis: followed(series) for axis, series in command.items()}
    yaw = np.cumsum(velocity["yaw"]) * 0.05
    across = np.stack([velocity["x"], velocity["y"]], axis=1) + rng.normal(0, 0.1, (T.size, 2))
    across = world_from_heading(across, yaw)
    columns = {"time": T, "vx": across[:, 0], "vy": across[:, 1], "vz": velocity["z"], "yaw": yaw}
    log = log_of(flight=columns | {f"cmd_{axis}": series for axis, series in command.items()})

    card = loaded(draft_card(log), tmp_path)
    wrong = answers_of(flight_from_log(log, replace(card, velocity_frame="heading"))).of["x"]

    assert (card.command_frame, card.velocity_frame) == ("heading", "world")
    assert wrong.axis is None
    assert wrong.explained < 0.5


def test_a_velocity_is_of_one_sensor(tmp_path: Path) -> None:
    true = turning()
    columns = {"time": T, "yaw": true["yaw"], "vz": np.gradient(true["z"], T) + 0.1}
    columns |= {f"vel_{axis}": series for axis, series in velocities_of(true, "world").items()}
    log = log_of(flight=columns | {f"cmd_{axis}": series for axis, series in COMMAND.items()})

    card = loaded(draft_card(log), tmp_path)

    assert [one.source for one in card.velocity.values()] == ["vel_x", "vel_y", "vel_z"]


def test_a_draft_of_state_packets_of_a_tello_has_its_frame_and_its_decimetres(tmp_path: Path) -> None:
    true = turning()
    velocity = velocities_of(true, "world")
    columns = {"time": T, "pitch": 0 * T, "roll": 0 * T, "yaw": np.round(90 - np.degrees(true["yaw"]))}
    columns |= {"vgx": np.round(10 * velocity["y"]), "vgy": np.round(10 * velocity["x"])}
    columns |= {"vgz": np.round(-10 * velocity["z"]), "tof": 100 * true["z"]}
    log = log_of(flight=columns | {f"cmd_{axis}": 100 * series for axis, series in COMMAND.items()})

    text = draft_card(log)
    card = loaded(text, tmp_path)
    flight = flight_from_log(log, card)

    assert (card.frame, card.velocity_only) == ("NED", ("x", "y", "z"))
    expected = np.interp(flight.pose_time, T, true["x"]) - true["x"][0]
    np.testing.assert_allclose(flight.position[:, 0], expected, atol=0.2)
    assert 'yaw = "cmd_yaw"  # + turns the vehicle counter-clockwise: ' in text


@pytest.mark.parametrize("per_metre", [10, 100])
def test_velocities_forward_right_and_down_are_turned_in_the_unit_that_the_height_tells(
    per_metre: int, tmp_path: Path
) -> None:
    true = turning()
    velocity = velocities_of(true, "heading")
    columns = {"time": T, "yaw": np.round(-np.degrees(true["yaw"])), "h": np.round(100 * true["z"])}
    columns |= {"vgx": per_metre * velocity["x"], "vgy": -per_metre * velocity["y"], "vgz": -per_metre * velocity["z"]}
    sticks = {"stick_right": -COMMAND["y"], "stick_fwd": COMMAND["x"], "stick_up": COMMAND["z"]}
    log = log_of(flight=columns | sticks | {"stick_yaw": -COMMAND["yaw"]})

    card = loaded(draft_card(log), tmp_path)

    assert (card.frame, card.velocity_frame) == ("NED", "heading")
    assert [card.velocity[axis].scale for axis in "xyz"] == [1000 / per_metre / 10, *[-100 / per_metre] * 2]
    assert {axis: (one.source, one.scale) for axis, one in card.command.items()} == {
        "x": ("stick_fwd", 1), "y": ("stick_right", -1), "z": ("stick_up", 1), "yaw": ("stick_yaw", -1)
    }  # fmt: skip


@pytest.mark.parametrize(("side", "across"), [("left", 1), ("right", -1)])
@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_a_heading_that_is_zero_along_another_axis_is_found_by_commands_that_say_forward_and_left(
    turn: int, side: str, across: int, tmp_path: Path
) -> None:
    true = turning()
    columns = {"t": T, **{f"marker_{axis}": true[axis] for axis in "xyz"}}
    columns |= {"marker_yaw": np.degrees(true["yaw"]) - turn}
    sticks = {"forward": COMMAND["x"], side: across * COMMAND["y"], "up": COMMAND["z"], "turn": across * COMMAND["yaw"]}

    card = loaded(draft_card(log_of(flight=columns | sticks)), tmp_path)

    assert (card.pose["yaw"].offset - turn) % 360 == 0
    assert {axis: (one.source, one.scale) for axis, one in card.command.items()} == {
        "x": ("forward", 1), "y": (side, across), "z": ("up", 1), "yaw": ("turn", across)
    }  # fmt: skip


@pytest.mark.parametrize(
    "names",
    [
        ("pitch", "roll", "throttle", "rudder"), ("elevator", "aileron", "throttle", "rudder"),
        ("ch2_pitch", "ch1_roll", "ch3_throttle", "ch4_yaw"), ("rc_b", "rc_a", "rc_c", "rc_d"),
    ],
)  # fmt: skip
def test_sticks_are_recognised_by_their_names_alone_where_all_four_are_there(names: tuple[str, ...]) -> None:
    pose = {"time": T, **turning()}
    sticks = dict(zip(names, COMMAND.values(), strict=True))

    assert 'yaw = "yaw"' in draft_card(log_of(flight=pose | sticks))
    assert f'x = "{names[0]}"' in draft_card(log_of(flight=pose | sticks))
    if names[0] == "pitch":  # else it may be the attitude
        del sticks["rudder"]
        assert '"pitch"' not in draft_card(log_of(flight=pose | sticks))


@pytest.mark.parametrize("late", [0.0, 0.003])
def test_a_heading_in_degrees_is_found_where_rows_of_commands_share_the_stamps_of_those_of_poses(late: float) -> None:
    true, nothing = turning(), np.full(T.size, np.nan)
    order = np.argsort(np.concatenate([T, T + late]), kind="stable")
    columns = {"time": np.concatenate([T, T + late])}
    columns |= {f"cmd_{axis}": np.concatenate([COMMAND[axis], nothing]) for axis in COMMAND}
    pose = true | {"yaw": (90 - np.degrees(true["yaw"])) % 360}
    columns |= {axis: np.concatenate([nothing, pose[axis]]) for axis in ("x", "y", "z", "yaw")}

    text = draft_card(log_of(flight={name: values[order] for name, values in columns.items()}))

    assert 'unit = "deg"' in text


def test_a_draft_of_a_log_with_both_names_the_velocity_beside_the_position(tmp_path: Path) -> None:
    """That of an odometry is forward and left, and no Twist of commands."""
    true = turning()
    half = true["yaw"] / 2
    pose = {f"pose.pose.position.{axis}": true[axis] for axis in "xyz"}
    pose |= {"pose.pose.orientation.w": np.cos(half), "pose.pose.orientation.x": 0 * half}
    pose |= {"pose.pose.orientation.y": 0 * half, "pose.pose.orientation.z": np.sin(half)}
    twist = {f"twist.twist.linear.{axis}": series for axis, series in velocities_of(true, "heading").items()}
    told = {f"linear.{axis}": COMMAND[axis] for axis in "xyz"} | {"angular.z": COMMAND["yaw"]}
    stamp = {"log_time": np.round(T * 1e9).astype(np.int64)}
    log = log_of(**{"/bebop/odom": stamp | pose | twist, "/bebop/cmd_vel": stamp | told})

    text = draft_card(log)
    card = loaded(text, tmp_path)
    independent = loaded(text.replace("# independent", "independent"), tmp_path)

    assert "INCOMPLETE" not in text
    assert card.command["x"].source == "/bebop/cmd_vel:linear.x"
    assert {axis: one.source for axis, one in card.velocity.items()} == {
        axis: f"/bebop/odom:twist.twist.linear.{axis}" for axis in "xyz"
    }
    assert (card.velocity_frame, card.velocity_only, card.velocity_independent) == ("heading", (), False)
    assert flight_from_log(log, card).velocity is None
    assert flight_from_log(log, independent).velocity is not None


def test_the_twist_of_a_mocap_bridge_is_not_taken_for_the_commands(tmp_path: Path) -> None:
    """vrpn_client_ros publishes a TwistStamped of what it measures, at the rate of its poses."""
    log = message_log(pose="/vrpn_client_node/bebop/pose", pose_prefix="pose.")
    pose = log.tables["/vrpn_client_node/bebop/pose"].columns
    measured = {"log_time": pose["log_time"], "header.stamp": pose["header.stamp"]}
    t = np.arange(2000) / 100
    measured |= {f"twist.linear.{axis}": np.cos(t) for axis in "xyz"} | {"twist.angular.z": np.cos(t)}
    tables = {name: dict(table.columns) for name, table in log.tables.items() if name != "/velocity"}
    log = log_of("flight.bag", **tables, **{"/vrpn_client_node/bebop/twist": measured})

    card = loaded(draft_card(log), tmp_path)

    assert card.command["x"].source == "/drone/cmd_vel:linear.x"
    assert card.velocity["x"].source == "/vrpn_client_node/bebop/twist:twist.linear.x"


def test_commands_of_a_bag_without_a_pose_are_commands_and_the_pose_is_missed() -> None:
    """A bag with /tf and commands: the Twist, alone a table, is no velocity of the vehicle."""
    twist = {"log_time": np.round(T * 1e9).astype(np.int64)}
    twist |= {f"linear.{axis}": COMMAND[axis] for axis in "xyz"} | {"angular.z": COMMAND["yaw"]}
    log = log_of("flight.bag", **{"/bebop/cmd_vel": twist})

    text = draft_card(log)

    assert "INCOMPLETE: nothing was recognised for [pose] x; [pose] y; [pose] z; [pose] yaw or quaternion" in text
    assert "[velocity]" not in text
    with pytest.raises(CardError, match="holds commands but nothing that looks like a position"):
        card_choice.proposal(log)


# Commands of a Parrot


def parrot(sdk: str = "bebop", **more: np.ndarray) -> dict:
    """A flight with the commands as a Parrot's SDK takes them: per cent, to the right and clockwise positive."""
    names = ("theta", "phi", "gaz", "yaw") if sdk == "ardrone" else ("pitch", "roll", "gaz", "yaw")
    senses = (-1 if sdk == "ardrone" else 1, -1, 1, -1)
    true, sent = turning(), zip(names, senses, COMMAND.values(), strict=True)
    sticks = {name: np.round(100 * sense * series) for name, sense, series in sent}
    return {"time": T, **{axis: true[axis] for axis in "xyz"}, "heading": true["yaw"], **sticks, **more}


def assert_obeyed(text: str, names: tuple, scales: tuple, heading: str, tmp_path: Path) -> None:
    card = loaded(text, tmp_path)
    assert tuple((one.source, one.scale) for one in card.command.values()) == tuple(zip(names, scales, strict=True))
    assert card.pose["yaw"].source == heading
    assert not any("EDIT" in line for line in text.splitlines() if line.startswith(("x =", "y =", "z =", "yaw =")))


@pytest.mark.parametrize("sdk", ["bebop", "ardrone"])
def test_a_draft_knows_the_commands_of_a_parrot_by_gaz_and_their_signs(sdk: str, tmp_path: Path) -> None:
    columns = parrot(sdk)
    names, ahead = tuple(columns)[5:], -1 if sdk == "ardrone" else 1

    text = draft_card(log_of(flight=columns))
    still = draft_card(log_of(flight=columns | {name: np.ones(T.size) for name in names}))

    assert_obeyed(text, names, (ahead, -1, 1, -1), "heading", tmp_path)
    assert {one.scale for one in (loaded(still, tmp_path).command[axis] for axis in ("y", "yaw"))} == {-1}


def test_the_motion_stands_over_the_signs_of_a_parrot(tmp_path: Path) -> None:
    columns = parrot()
    columns |= {"pitch": -columns["pitch"], "roll": -columns["roll"]}

    text = draft_card(log_of(flight=columns))

    assert_obeyed(text, ("pitch", "roll", "gaz", "yaw"), (-1, 1, 1, -1), "heading", tmp_path)


def test_beside_gaz_yaw_is_the_heading_where_there_is_a_rate_and_asked_about_where_there_is_nothing_else(
    tmp_path: Path,
) -> None:
    columns = parrot()
    columns |= {"yaw_rate": columns.pop("yaw"), "yaw": columns.pop("heading")}

    with_rate = draft_card(log_of(flight=columns))
    del columns["yaw_rate"]
    alone = draft_card(log_of(flight=columns))

    assert_obeyed(with_rate, ("pitch", "roll", "gaz", "yaw_rate"), (1, -1, 1, -1), "yaw", tmp_path)
    assert set(loaded(alone, tmp_path).command) == {"x", "y", "z"}
    assert 'yaw = "yaw"  # EDIT: beside gaz it may be a command; then the heading is missing' in alone


def test_in_a_file_of_commands_of_a_parrot_yaw_is_one(tmp_path: Path) -> None:
    columns = parrot()
    pose = {"t": T, **{axis: columns[axis] for axis in "xyz"}, "yaw": columns["heading"]}
    sticks = {"t": T, **{name: columns[name] for name in ("roll", "pitch", "yaw", "gaz")}}

    log = join_logs([log_of("sticks.csv", sticks=sticks), log_of("mocap.csv", mocap=pose)])

    text = draft_card(log)

    card = bound(loaded(text, tmp_path), log)
    assert card.command["yaw"].source == "sticks:yaw"
    assert card.pose["yaw"].source == "mocap:yaw"


def test_a_quaternion_beside_gaz_is_the_heading(tmp_path: Path) -> None:
    columns = parrot()
    half = columns.pop("heading") / 2
    columns |= {"qw": np.cos(half), "qx": 0 * half, "qy": 0 * half, "qz": np.sin(half)}

    for left_out in ([], ["yaw"]):
        card = loaded(draft_card(log_of(flight={n: one for n, one in columns.items() if n not in left_out})), tmp_path)

        assert card.pose["qw"].source == "qw"
        assert set(card.command) == {"x", "y", "z", "yaw"} - set(left_out)


@pytest.mark.parametrize("without", ["gaz", "pitch"])
def test_angles_of_an_attitude_are_no_commands(without: str) -> None:
    columns = parrot()
    del columns[without]

    assert "nothing was recognised for [command] x, y, z or yaw" in draft_card(log_of(flight=columns))


# A pose that is not what it seems


def drafted(pose: dict, command: dict, tmp_path: Path) -> tuple[Card, str]:
    """The card that is drafted, and its text."""
    text = draft_card(log_of(flight={"time": T, **pose, **{f"cmd_{axis}": series for axis, series in command.items()}}))
    return loaded(text, tmp_path), text


def raised(by: float) -> dict:
    true = turning()
    return true | {"z": true["z"] - np.min(true["z"]) + by}


def as_ned(true: dict) -> dict:
    return {"x": true["y"], "y": true["x"], "z": -true["z"], "yaw": np.pi / 2 - true["yaw"]}


OVERTURNED = COMMAND | {axis: -COMMAND[axis] for axis in ("y", "z", "yaw")}


def test_a_draft_says_ned_where_that_turns_three_commands_at_once(tmp_path: Path) -> None:
    card, text = drafted(as_ned(raised(1.0)), COMMAND, tmp_path)

    assert card.frame == "NED"
    assert {one.scale for one in card.command.values()} == {1}
    assert 'frame = "NED"  # by the motion: in ENU, y, z, yaw would be turned' in text


def test_a_draft_turns_three_commands_where_ned_would_put_the_vehicle_below_the_floor(tmp_path: Path) -> None:
    card, text = drafted(raised(1.0), OVERTURNED, tmp_path)

    assert card.frame == "ENU"
    assert {axis: one.scale for axis, one in card.command.items()} == {"x": 1, "y": -1, "z": -1, "yaw": -1}
    assert "y, z, yaw are turned together: forward, right, down?" in text


def test_a_draft_asks_whether_a_vehicle_below_the_floor_is_one_whose_z_points_down(tmp_path: Path) -> None:
    """In forward, right, down all commands fit their pose, too: only the height tells."""
    _, text = drafted(as_ned(raised(1.0)), OVERTURNED, tmp_path)

    assert 'EDIT: z is below 0; if it points down: "NED", and scale = -1 for y, z, yaw' in text
    assert "EDIT: z is below 0" not in drafted(raised(1.0), COMMAND, tmp_path)[1]


@pytest.mark.parametrize(
    ("spoil", "axis", "channel"),
    [
        (lambda true: {"y": -true["y"]}, "y", Channel("y", scale=-1)),
        (lambda true: {"x": true["y"], "y": true["x"]}, "x", Channel("y")),
        (lambda true: {"yaw": -true["yaw"]}, "yaw", Channel("yaw", scale=-1)),
    ],
)
def test_a_draft_reads_a_mirrored_pose_as_the_motion_bears_out(
    spoil: Callable, axis: str, channel: Channel, tmp_path: Path
) -> None:
    true = raised(1.0)
    card, text = drafted(true | spoil(true), COMMAND, tmp_path)

    assert card.pose[axis] == channel
    assert "by the motion: EDIT if that is not so" in text
    assert (card.command_frame, {one.scale for one in card.command.values()}) == ("heading", {1})


def test_a_draft_turns_a_pose_whose_y_is_up(tmp_path: Path) -> None:
    """Motion capture often has it; a cyclic permutation needs no sign."""
    true = turning()
    half, none = true["yaw"] / 2, np.zeros_like(true["yaw"])
    pose = {"x": true["y"], "y": true["z"], "z": true["x"]}
    pose |= {"qw": np.cos(half), "qx": none, "qy": np.sin(half), "qz": none}
    card, text = drafted(pose, COMMAND, tmp_path)

    assert {axis: card.pose[axis].source for axis in "xyz"} == {"x": "z", "y": "x", "z": "y"}
    assert {part: card.pose[f"q{part}"].source for part in "wxyz"} == {"w": "qw", "x": "qz", "y": "qx", "z": "qy"}
    assert "y points up by the motion" in text
    assert card.command["z"] == Channel("cmd_z")


@pytest.mark.parametrize("names", [("q1", "q2", "q3", "q4"), ("qw", "qx", "qy", "qz")])
def test_a_draft_takes_w_last_where_only_that_gives_a_heading_that_obeys(names: tuple, tmp_path: Path) -> None:
    true = raised(1.0)
    half = true.pop("yaw") / 2
    rolled = 0.02 * np.sin(3 * T)
    parts = dict(zip(names, (rolled, -rolled, np.sin(half), np.cos(half)), strict=True))
    card, text = drafted(true | parts, COMMAND, tmp_path)

    assert [card.pose[f"q{part}"].source for part in "wxyz"] == [names[3], *names[:3]]
    assert "# w, x, y, z; by the motion: in the order of the names no command turns the vehicle" in text
    assert {one.scale for one in card.command.values()} == {1}


def test_a_card_with_a_quaternion_in_the_wrong_order_is_told_the_right_one(tmp_path: Path) -> None:
    true = raised(1.0)
    half = true.pop("yaw") / 2
    rolled = 0.02 * np.sin(3 * T)
    pose = true | {"qw": np.cos(half), "qx": rolled, "qy": -rolled, "qz": np.sin(half)}
    log = log_of(flight={"time": T, **pose, **{f"cmd_{axis}": series for axis, series in COMMAND.items()}})
    text = draft_card(log)
    wrong = loaded(text.replace('["qw", "qx", "qy", "qz"]', '["qx", "qy", "qz", "qw"]'), tmp_path)

    told = {one.code: one for one in findings_of_flight(log, flight_from_log(log, wrong))}
    assert told["quaternion_order"].severity == "error"
    assert 'quaternion = ["qw", "qx", "qy", "qz"]' in told["quaternion_order"].remedy
    right = findings_of_flight(log, flight_from_log(log, loaded(text, tmp_path)))
    assert "quaternion_order" not in {one.code for one in right}


@pytest.mark.parametrize(("heading", "lies"), [(0.1, False), (0.4, True), (1.5, True), (2.0, True)])
def test_a_draft_of_a_flight_without_turns_takes_w_last_where_the_vehicle_is_upright_and_obeys(
    heading: float, lies: bool, tmp_path: Path
) -> None:
    commands = {axis: series for axis, series in COMMAND.items() if axis != "yaw"}
    ahead = motion(world=True)
    c, s = np.cos(heading), np.sin(heading)
    true = {"x": c * ahead["x"] - s * ahead["y"], "y": s * ahead["x"] + c * ahead["y"], "z": 1 + ahead["z"]}
    half, rolled = 0.5 * heading + 0 * T, 0.02 * np.sin(3 * T)
    parts = dict(zip(("q1", "q2", "q3", "q4"), (rolled, -rolled, np.sin(half), np.cos(half)), strict=True))

    card, text = drafted(true | parts, commands, tmp_path)

    assert [card.pose[f"q{part}"].source for part in "wxyz"] == ["q4", "q1", "q2", "q3"]
    assert {one.scale for one in card.command.values()} == {1}
    assert ("the vehicle lies on its side" in text) == lies
    log = log_of(flight={"time": T, **true, **parts, **{f"cmd_{axis}": one for axis, one in commands.items()}})
    wrong = loaded(text.replace('["q4", "q1", "q2", "q3"]', '["q1", "q2", "q3", "q4"]'), tmp_path)
    told = {one.code for one in findings_of_flight(log, flight_from_log(log, wrong))}
    assert ("quaternion_order" in told) == lies


def test_a_body_that_is_defined_lying_on_its_side_is_no_wrong_order(tmp_path: Path) -> None:
    """As of a camera, which looks ahead along its z and whose x points to the right."""
    ahead, commands = motion(world=True), {axis: one for axis, one in COMMAND.items() if axis != "yaw"}
    true = {axis: ahead[axis] for axis in "xy"} | {"z": 1 + ahead["z"]}
    half, rolled = 0.1 * np.sin(0.3 * T), 0.02 * np.sin(3 * T)
    camera = dict(
        zip(("qw", "qx", "qy", "qz"), (np.cos(half), -np.cos(half), -np.sin(half), np.sin(half)), strict=True)
    )
    camera = {name: np.sqrt(0.5) * one + rolled * (name == "qx") for name, one in camera.items()}
    log = log_of(flight={"time": T, **true, **camera, **{f"cmd_{axis}": one for axis, one in commands.items()}})
    text = draft_card(log)

    assert 'quaternion = ["qw", "qx", "qy", "qz"]' in text
    found = findings_of_flight(log, flight_from_log(log, loaded(text, tmp_path)))
    assert "quaternion_order" not in {one.code for one in found}


def test_a_word_for_the_turn_counts_before_a_letter_that_may_be_right(tmp_path: Path) -> None:
    card = loaded(draft_card(csv_log(cmd_x="spF", cmd_y="spR", cmd_z="spD", cmd_yaw="spYawDegS")), tmp_path)

    assert {axis: channel.source for axis, channel in card.command.items()} == {"yaw": "spYawDegS"}


def test_a_draft_says_ned_where_the_height_is_named_down() -> None:
    text = draft_card(csv_log(x="north_mm", y="east_mm", z="down_mm"))

    assert 'frame = "NED"  # of the pose, by its names' in text


def test_a_draft_finds_degrees_that_are_not_wrapped_by_the_motion(tmp_path: Path) -> None:
    """So slow a turn that the numbers might be radians."""
    command = COMMAND | {"yaw": 0.2 * np.cos(0.2 * T)}
    velocity = {axis: followed(series) for axis, series in command.items()}
    yaw = 0.4 + np.cumsum(velocity["yaw"]) * 0.05
    place = np.cumsum(world_from_heading(np.stack([velocity["x"], velocity["y"]], axis=1), yaw), axis=0) * 0.05
    pose = {"x": place[:, 0], "y": place[:, 1], "z": 2 + np.cumsum(velocity["z"]) * 0.05, "yaw": np.degrees(yaw)}

    card, text = drafted(pose, command, tmp_path)

    assert card.pose["yaw"].unit == "deg"
    assert card.command_frame == "heading"
    assert "yaw is in degrees by the motion" in text


def test_a_draft_finds_degrees_of_a_heading_that_stays_near_zero(tmp_path: Path) -> None:
    """World commands would explain the motion as well; but no vehicle turns by so many radians."""
    true = raised(1.0)
    yaw = np.radians(30) * np.sin(0.5 * T)

    card, text = drafted(true | {"yaw": np.degrees(yaw)}, COMMAND, tmp_path)
    small, _ = drafted(true | {"yaw": yaw}, COMMAND, tmp_path)

    assert (card.pose["yaw"].unit, small.pose["yaw"].unit) == ("deg", None)
    assert "too much for any vehicle" in text


@pytest.mark.parametrize("heading", [0.5, 90.0])
def test_a_draft_takes_a_heading_that_nothing_turns_as_held_in_degrees(heading: float, tmp_path: Path) -> None:
    """In radians the commands would act along the world, of a vehicle that swings by itself."""
    command, yaw = COMMAND | {"yaw": 0 * T}, heading + np.sin(0.5 * T)
    velocity = {axis: followed(series) for axis, series in command.items()}
    across = world_from_heading(np.stack([velocity["x"], velocity["y"]], axis=1), np.radians(yaw))
    place = np.cumsum(across, axis=0) * 0.05
    pose = {"x": place[:, 0], "y": place[:, 1], "z": 2 + np.cumsum(velocity["z"]) * 0.05, "yaw": yaw}

    card, text = drafted(pose, command, tmp_path)

    assert (card.pose["yaw"].unit, card.command_frame) == ("deg", "heading")
    assert {axis: (one.source, one.scale) for axis, one in card.command.items()} == {
        axis: (f"cmd_{axis}", 1) for axis in COMMAND
    }
    assert 'EDIT: degrees, or radians and frame = "world" in [command]' in text
    log = log_of(flight={"time": T, **pose, **{f"cmd_{axis}": series for axis, series in command.items()}})
    for frame in ("heading", "world"):
        own = text.replace(', unit = "deg"', "").replace('frame = "heading"', f'frame = "{frame}"')
        told = findings_of_flight(log, flight_from_log(log, loaded(own, tmp_path)))
        assert any('unit = "deg"' in one.remedy for one in told)


def test_a_draft_names_the_unit_of_a_position_that_no_vehicle_flies_in_metres(tmp_path: Path) -> None:
    true = raised(1.0)
    for unit, scale in (("cm", 100), ("mm", 1000)):
        card, text = drafted(true | {axis: scale * true[axis] for axis in "xyz"}, COMMAND, tmp_path)

        assert {card.pose[axis].unit for axis in "xyz"} == {unit}
        assert 'EDIT: "cm" or "mm"' in text
    assert {drafted(true, COMMAND, tmp_path)[0].pose[axis].unit for axis in "xyz"} == {None}


def test_a_draft_of_a_flight_that_does_not_turn_says_that_a_turned_axis_may_be_a_mirrored_pose(tmp_path: Path) -> None:
    true = motion(world=True) | {"yaw": 0.001 * np.sin(T)}
    card, text = drafted(true | {"y": -true["y"]}, COMMAND | {"yaw": 0 * T}, tmp_path)

    assert card.command["y"].scale == -1
    assert "or the pose is mirrored, which a flight that hardly turns does not tell" in text
