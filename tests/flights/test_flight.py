"""Flights: the common window, segments, frames, and every repair by its count."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, FlightError, RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import world_from_heading
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.logs import read
from rotorfit.flights.assemble import ACTS_AFTER, flight_from_log

CARD = {
    "command": {"time": "cmd:t", "x": "cmd:x", "y": "cmd:y", "z": "cmd:z", "yaw": "cmd:yaw"},
    "pose": {"time": "pose:t", "x": "pose:x", "y": "pose:y", "z": "pose:z", "yaw": "pose:yaw"},
}


def card_with(**changes: Mapping) -> Card:
    """The plain card with some keys of its sections changed; None takes a key out."""
    raw = json.loads(json.dumps(CARD))
    for section, keys in changes.items():
        if isinstance(keys, Mapping):
            raw[section] = {k: v for k, v in (raw.get(section, {}) | keys).items() if v is not None}
        else:
            raw[section] = keys
    return card_from_mapping(raw, "test")


def commands(duration: float = 10.0, period: float = 0.05, start: float = 0.0) -> dict:
    t = start + period * np.arange(round(duration / period))
    return {"t": t, "x": np.sin(t), "y": np.cos(2 * t), "z": 0.1 * np.sin(3 * t), "yaw": 0.5 * np.cos(t)}


def poses(duration: float = 12.0, period: float = 0.01, start: float = -1.0) -> dict:
    t = start + period * np.arange(round(duration / period))
    return {"t": t, "x": 2 * np.sin(t), "y": t**2 / 50, "z": 1 + 0.1 * np.cos(t), "yaw": 0.3 * np.sin(0.7 * t)}


def log_of(cmd: dict, pose: dict, **others: dict) -> Log:
    tables = {"cmd": cmd, "pose": pose} | others
    named = {name: Table(name, {key: np.asarray(v) for key, v in cols.items()}) for name, cols in tables.items()}
    return Log(Path("flight.log"), "csv", "0" * 64, named, {})


def flight_of(cmd: dict | None = None, pose: dict | None = None, card: Card | None = None, **kwargs: object) -> Flight:
    log = log_of(commands() if cmd is None else cmd, poses() if pose is None else pose)
    return flight_from_log(log, card or card_with(), **kwargs)


def counts(flight: Flight) -> dict[str, int]:
    for note in flight.notes:
        assert str(note.count) in note.text or note.code == "axis_never_commanded"
        assert "\n" not in note.text
    return {note.code: note.count for note in flight.notes}


def rows(table: dict, index: object) -> dict:
    return {name: values[index] for name, values in table.items()}


def acting(flight: Flight, at: np.ndarray) -> np.ndarray:
    """The command that acts at each of some times, shape (N, 4)."""
    return flight.command[np.searchsorted(flight.command_time, at, side="right") - 1]


def error_of(log: Log, card: Card | None = None, **kwargs: object) -> str:
    with pytest.raises(RotorfitError) as error:
        flight_from_log(log, card or card_with(), **kwargs)
    assert "\n" not in str(error.value)
    assert "flight.log" in str(error.value)
    return str(error.value)


# The common window, spans, segments


def test_time_starts_at_the_first_command_and_ends_with_the_last_hold() -> None:
    flight = flight_of(commands(10.0, 0.05, start=100.0), poses(14.0, 0.01, start=98.0))

    assert flight.command_time[0] == 0.0
    assert flight.span == pytest.approx((0.0, 9.95 + 3 * 0.05))
    assert [(part.start, part.end) for part in flight.segments] == [pytest.approx((0.0, 10.1))]
    assert flight.pose_time[0] >= 0
    assert flight.pose_time[-1] == pytest.approx(10.1)
    assert flight.duration == pytest.approx(10.1)
    assert flight.axes == ("x", "y", "z", "yaw")


def test_the_window_ends_with_the_last_pose_where_that_is_earlier() -> None:
    flight = flight_of(pose=poses(8.0, 0.01, start=-1.0))

    assert flight.span[1] == flight.pose_time[-1] == pytest.approx(6.99)
    assert flight.segments[-1].end == pytest.approx(6.99)


def test_commands_and_poses_keep_their_own_stamps_and_values() -> None:
    cmd, pose = commands(), poses()

    flight = flight_of(cmd, pose)

    np.testing.assert_allclose(flight.command_time, cmd["t"], atol=1e-9)
    np.testing.assert_array_equal(flight.command, np.stack([cmd[axis] for axis in ("x", "y", "z", "yaw")], axis=1))
    inside = np.round(pose["t"], 6) >= 0
    inside &= np.round(pose["t"], 6) <= flight.span[1]
    np.testing.assert_array_equal(flight.position[:, 1], pose["y"][inside])
    np.testing.assert_allclose(flight.yaw, pose["yaw"][inside], atol=1e-12)


def test_a_hold_without_end_ends_with_the_poses() -> None:
    assert flight_of(card=card_with(command={"hold": 1e30})).span[1] == pytest.approx(10.99)


def test_a_card_may_state_the_hold() -> None:
    flight = flight_of(card=card_with(command={"hold": 0.5}))

    assert flight.span[1] == pytest.approx(9.95 + 0.5)


def test_a_gap_in_the_commands_longer_than_the_hold_starts_a_segment() -> None:
    cmd = commands()
    kept = np.r_[0:60, 68:120, 122:200]

    flight = flight_of(rows(cmd, kept))

    found = [(round(part.start, 6), round(part.end, 6)) for part in flight.segments]
    assert found == [(0.0, 2.95 + 0.15), (3.4, 9.95 + 0.15)]
    assert counts(flight)["command_gaps"] == 1
    told = {note.code: note.text for note in flight.notes}["command_gaps"]
    assert told == "1 gap in the commands, up to 0.300 s beyond the hold, split it"


def test_gaps_of_exactly_three_rounded_periods_do_not_split() -> None:
    cmd = commands(20.0, 1 / 120, start=1e3 / 7)

    flight = flight_of(
        rows(cmd, np.delete(np.arange(2400), np.r_[100:102, 700:702, 1500:1502])), poses(30, 0.01, 140.0)
    )

    assert len(flight.segments) == 1


def test_a_gap_in_the_pose_does_not_split() -> None:
    flight = flight_of(pose=rows(poses(), np.r_[0:300, 600:1200]))

    assert len(flight.segments) == 1


def test_the_rate_of_the_poses_counts_fresh_ones_while_commands_are_known() -> None:
    command, pose = commands(period=0.05), poses(period=0.02)
    held = {name: values if name == "t" else np.repeat(values[::2], 2) for name, values in pose.items()}
    gap = (command["t"] < 3) | (command["t"] > 6)

    assert flight_of(command, pose).pose_rate == pytest.approx(50.0, rel=0.01)
    assert flight_of(command, held).pose_rate == pytest.approx(25.0, rel=0.02)
    assert flight_of({name: values[gap] for name, values in command.items()}, pose).pose_rate == pytest.approx(50, 0.01)


def test_the_rate_of_the_poses_is_that_while_they_come() -> None:
    pose = poses(period=0.02)
    lost = (pose["t"] > 2) & (pose["t"] < 6)
    stands = {name: values if name == "t" else np.where(lost, values[0], values) for name, values in pose.items()}

    for seen in ({name: values[~lost] for name, values in pose.items()}, stands):
        assert flight_of(pose=seen).pose_rate == pytest.approx(50.0, rel=0.01)


def test_a_span_sees_nothing_outside_and_keeps_its_clock() -> None:
    whole, part = flight_of(), flight_of(span=(2.025, 7.0))

    assert part.span == (2.025, 7.0)
    assert part.command_time[0] == pytest.approx(2.05)
    assert part.segments[0].start == part.command_time[0]
    assert part.segments[-1].end == 7.0
    assert part.pose_time[0] >= 2.025
    assert part.pose_time[-1] <= 7.0
    inside = (whole.pose_time >= 2.025) & (whole.pose_time <= 7.0)
    np.testing.assert_array_equal(part.position, whole.position[inside])
    np.testing.assert_array_equal(part.pose_time, whole.pose_time[inside])


def test_what_happens_outside_a_span_changes_nothing_inside() -> None:
    pose = poses()
    wild = {name: values.copy() for name, values in pose.items()}
    wild["x"][:250] += 1e3
    wild["yaw"][:250] -= 30
    cmd = commands()
    loud = {name: values.copy() for name, values in cmd.items()}
    loud["x"][:20] = 99.0

    plain, other = flight_of(cmd, pose, span=(2.0, None)), flight_of(loud, wild, span=(2.0, None))

    assert (plain.span, plain.segments) == (other.span, other.segments)
    for name in ("command_time", "command", "pose_time", "position", "yaw"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name))


@pytest.mark.parametrize("span", [(None, 5.0), (5.0, None), (None, None)])
def test_either_side_of_a_span_may_be_empty(span: tuple) -> None:
    flight = flight_of(span=span)

    assert flight.span == pytest.approx((span[0] or 0.0, span[1] or 10.1))


def test_a_span_beyond_the_window_is_cut_with_a_note() -> None:
    flight = flight_of(span=(-3.0, 99.0))

    assert flight.span == pytest.approx((0.0, 10.1))
    assert "span_cut" in [note.code for note in flight.notes]


@pytest.mark.parametrize("span", [(5.0, 5.0), (7.0, 5.0), (11.0, None), (None, -1.0), (float("nan"), None)])
def test_an_empty_span_is_refused(span: tuple) -> None:
    assert "span" in error_of(log_of(commands(), poses()), span=span)


# Frames


def test_turning_the_world_turns_the_flight() -> None:
    angle, pose = 0.7, poses()
    c, s = np.cos(angle), np.sin(angle)
    turned = pose | {
        "x": c * pose["x"] - s * pose["y"],
        "y": s * pose["x"] + c * pose["y"],
        "yaw": pose["yaw"] + angle,
    }

    before, after = flight_of(pose=pose), flight_of(pose=turned)

    np.testing.assert_allclose(
        after.position[:, :2], world_from_heading(before.position[:, :2], np.full(len(before.yaw), angle)), atol=1e-12
    )
    np.testing.assert_allclose(after.yaw, before.yaw + angle, atol=1e-12)
    np.testing.assert_array_equal(after.command, before.command)
    np.testing.assert_array_equal(after.position[:, 2], before.position[:, 2])


def test_north_east_down_is_the_same_flight_as_east_north_up() -> None:
    pose = poses()
    ned = pose | {"x": pose["y"], "y": pose["x"], "z": -pose["z"], "yaw": np.pi / 2 - pose["yaw"]}

    enu_flight, ned_flight = flight_of(pose=pose), flight_of(pose=ned, card=card_with(frame="NED"))

    np.testing.assert_array_equal(ned_flight.position, enu_flight.position)
    np.testing.assert_allclose(ned_flight.yaw, enu_flight.yaw, atol=1e-12)
    np.testing.assert_array_equal(ned_flight.command, enu_flight.command)


def test_yaw_comes_from_a_quaternion_of_any_length_and_tilt() -> None:
    pose = poses()
    yaw, roll = pose.pop("yaw") * 12, 0.2 * np.sin(pose["t"])
    w, x, y, z = (
        np.cos(yaw / 2) * np.cos(roll / 2),
        np.cos(yaw / 2) * np.sin(roll / 2),
        np.sin(yaw / 2) * np.sin(roll / 2),
        np.sin(yaw / 2) * np.cos(roll / 2),
    )
    pose |= {f"q.{part}": 0.9 * value for part, value in zip("wxyz", (w, x, y, z), strict=True)}
    card = card_with(pose={"yaw": None, "quaternion": "pose:q"})

    flight = flight_of(pose=pose, card=card)

    turns = (flight.yaw - np.interp(flight.pose_time, pose["t"], yaw)) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-3)
    assert counts(flight)["yaw_unwrapped"] >= 1
    off = flight_of(pose=pose, card=card_with(pose={"yaw": None, "quaternion": "pose:q", "heading_offset": 0.5}))
    np.testing.assert_allclose(np.exp(1j * (off.yaw - flight.yaw)), np.exp(0.5j), atol=1e-9)


def test_a_quaternion_that_a_filter_does_not_normalise_is_one() -> None:
    pose = poses()
    half, length = pose.pop("yaw") * 6, np.linspace(1.0, 1.1, len(pose["t"]))
    pose |= {"q.w": length * np.cos(half), "q.x": 0 * half, "q.y": 0 * half, "q.z": length * np.sin(half)}

    flight = flight_of(pose=pose, card=card_with(pose={"yaw": None, "quaternion": "pose:q"}))

    assert np.ptp(flight.yaw) == pytest.approx(np.ptp(2 * half[(pose["t"] >= 0) & (pose["t"] <= 10)]), rel=0.01)


def test_four_columns_that_are_no_quaternion_are_refused() -> None:
    pose = poses()
    yaw = pose.pop("yaw") * 12
    pose |= {"q.w": np.cos(yaw / 2), "q.x": 0 * yaw, "q.y": 0 * yaw, "q.z": yaw}  # a rotation vector but for w

    with pytest.raises(FlightError, match=r"their length varies from 1\.02 to 3\.59"):
        flight_of(pose=pose, card=card_with(pose={"yaw": None, "quaternion": "pose:q"}))


def test_wrapped_yaw_is_unwrapped_and_counted() -> None:
    pose = poses()
    spin = 0.9 * pose["t"] + 3
    wrapped = (spin + np.pi) % (2 * np.pi) - np.pi

    flight = flight_of(pose=pose | {"yaw": wrapped})

    np.testing.assert_allclose(flight.yaw - flight.yaw[0], 0.9 * (flight.pose_time - flight.pose_time[0]), atol=1e-9)
    assert counts(flight)["yaw_unwrapped"] == np.sum(np.diff(wrapped[(pose["t"] > -0.005) & (pose["t"] < 10.105)]) < -3)


def test_world_commands_are_turned_by_the_measured_yaw_also_while_held() -> None:
    cmd, pose = commands(10.0, 1.0), poses()
    pose["yaw"] = 0.8 * pose["t"]
    card = card_with(command={"frame": "world", "hold": 1.0})

    flight = flight_of(cmd, pose, card=card)

    at = np.linspace(0.0, 9.8, 2000)
    world = np.stack([cmd["x"], cmd["y"]], axis=1)[np.floor(at).astype(int)]
    error = world_from_heading(acting(flight, at)[:, :2], 0.8 * (at + ACTS_AFTER)) - world
    assert np.max(np.abs(error)) < 1.5 * np.radians(0.5 + 0.8 * np.degrees(0.01))
    assert np.all(np.diff(flight.command_time) > 0)
    assert counts(flight)["world_commands"] == 10
    (turned,) = (note.text for note in flight.notes if note.code == "world_commands")
    assert f"; {len(flight.command_time) - 10} more were added" in turned
    np.testing.assert_array_equal(acting(flight, at)[:, 2], cmd["z"][np.floor(at).astype(int)])


def test_world_commands_under_constant_yaw_stay_as_many_and_move_both_axes() -> None:
    pose = poses() | {"yaw": np.full(1200, np.pi / 2)}
    card = card_with(command={"frame": "world", "y": None, "yaw": None})

    flight = flight_of(pose=pose, card=card)

    assert len(flight.command_time) == counts(flight)["world_commands"] == 200
    assert flight.axes == ("x", "y", "z")
    np.testing.assert_allclose(flight.command[:, 1], -commands()["x"], atol=1e-12)
    np.testing.assert_allclose(flight.command[:, 0], 0.0, atol=1e-12)


def test_axes_that_a_card_leaves_out_are_zero_and_not_commanded() -> None:
    flight = flight_of(card=card_with(command={"y": None, "yaw": None}))

    assert flight.axes == ("x", "z")
    assert not np.any(flight.command[:, [1, 3]])


# Repairs, each by its count


def test_a_clean_flight_has_no_notes_but_the_poses_outside() -> None:
    assert counts(flight_of()) == {"poses_outside": 189}


def test_stale_poses_are_dropped_and_the_first_of_a_run_stays() -> None:
    pose = poses()
    still = np.arange(1200) - np.arange(1200) % 3

    flight = flight_of(pose=rows(pose, still) | {"t": pose["t"]})

    assert counts(flight)["stale_poses"] == 800
    np.testing.assert_allclose(np.diff(flight.pose_time), 0.03, atol=1e-9)


def test_poses_in_rows_faster_than_they_come_are_up_to_a_row_late() -> None:
    pose, rng = poses(), np.random.default_rng(0)
    at = np.arange(1200)

    def late(shown: np.ndarray) -> float:
        return flight_of(pose=rows(pose, shown) | {"t": pose["t"]}).pose_lateness

    assert late(at - at % 3) == pytest.approx(0.01)
    slower = np.cumsum(np.append(0, 1 + 0.4 * rng.random(1200)))  # at a rate of their own, unsteady
    assert late(np.searchsorted(slower, at, side="right") - 1) == pytest.approx(0.01)
    assert late(np.maximum.accumulate(np.where(rng.random(1200) < 0.3, 0, at))) == 0.0  # lost at random
    assert late(np.maximum(at, 600)) == 0.0  # on the ground


@pytest.mark.parametrize(
    ("command", "pose", "late"),
    [
        (slice(None), slice(None), (0.05, 0.0)),
        (slice(2, None), slice(None), (0.05, 0.0)),  # rows of the poses: no command at first
        (slice(None), slice(2, None), (0.05, 0.05)),  # rows with the latest pose: none at first
        (slice(None), slice(None, -2), (0.05, 0.0)),  # cameras that lost the vehicle
        (slice(None), slice(None, 50), (0.0, 0.0)),
    ],
)
def test_what_shared_rows_say_of_their_stamps(command: slice, pose: slice, late: tuple[float, float]) -> None:
    cmd, seen = commands(), poses(10.0, 0.05, 0.0)
    table = {"t": cmd["t"]}
    for prefix, values, kept in (("c", cmd, command), ("p", seen, pose)):
        for name in ("x", "y", "z", "yaw"):
            table[prefix + name] = np.full(cmd["t"].size, np.nan)
            table[prefix + name][kept] = values[name][kept]
    axes = ("x", "y", "z", "yaw")
    card = card_with(
        command={"time": "rows:t", **{name: f"rows:c{name}" for name in axes}},
        pose={"time": "rows:t", **{name: f"rows:p{name}" for name in axes}},
    )
    flight = flight_from_log(log_of(commands(), poses(), rows=table), card)

    assert (flight.command_lateness, flight.pose_lateness) == pytest.approx(late)


def test_a_clock_is_coarse_where_samples_that_share_a_stamp_differ() -> None:
    cmd, pose = commands(), poses(period=0.02)
    often = np.arange(200).repeat(3)

    assert flight_of(pose=pose | {"t": np.floor(pose["t"] * 10) / 10}).stamp_step == pytest.approx(0.1)
    assert flight_of(rows(cmd, often)).stamp_step == 0.0  # copies, each with the stamp of the command


@pytest.mark.parametrize("times", [2, 4])
def test_a_pose_in_centimetres_that_is_sent_several_times_is_stale(times: int) -> None:
    pose = {name: values if name == "t" else np.round(values, 2) for name, values in poses(period=0.04).items()}
    again = {name: np.repeat(values, times) for name, values in pose.items()}
    again["t"] += np.tile(np.arange(times) * 0.04 / times, len(pose["t"]))

    flight = flight_of(pose=again)

    assert len(flight.pose_time) == pytest.approx(253, abs=10)


def test_a_pose_in_centimetres_repeats_genuinely() -> None:
    pose = {name: values if name == "t" else np.round(values, 2) for name, values in poses(period=0.002).items()}

    flight = flight_of(pose=pose)

    assert "stale_poses" not in counts(flight)
    assert len(flight.pose_time) == pytest.approx(5050, abs=50)


def test_a_pose_that_repeats_in_all_but_one_quantity_is_fresh() -> None:
    pose = poses() | {"x": np.zeros(1200), "y": np.zeros(1200), "z": np.ones(1200)}

    assert "stale_poses" not in counts(flight_of(pose=pose))


@pytest.mark.parametrize("what", ["command", "pose"])
@pytest.mark.parametrize(("row", "stamp"), [(100, 3700.0), (0, 3600.0), (0, -1.7e9), (-1, 2e9)])
def test_a_single_stray_stamp_costs_one_sample(what: str, row: int, stamp: float) -> None:
    tables = {"command": commands(), "pose": poses()}
    tables[what]["t"][row] = stamp

    flight = flight_of(tables["command"], tables["pose"])

    assert {code: count for code, count in counts(flight).items() if "stamps" in code} == {f"{what}_stamps_stray": 1}
    assert flight.duration == pytest.approx(10.1, abs=0.2)


@pytest.mark.parametrize("length", [86_400.0, 4294.967296])
def test_a_clock_that_starts_again_goes_on(length: float) -> None:
    tables = {"command": commands(start=length - 6.0), "pose": poses(start=length - 7.0)}
    for table in tables.values():
        table["t"] = np.where(table["t"] < length, table["t"], table["t"] - length)

    flight = flight_of(tables["command"], tables["pose"])

    assert counts(flight)["clock_continued"] > 0
    assert flight.duration == pytest.approx(10.1, abs=0.02)
    assert "command_stamps_reversed" not in counts(flight)


@pytest.mark.parametrize("what", ["command", "pose"])
@pytest.mark.parametrize("apart", [2, 6, 19])
def test_samples_that_are_written_out_of_order_are_sorted(what: str, apart: int) -> None:
    tables = {"command": commands(), "pose": poses()}
    straight = flight_of(tables["command"], tables["pose"])
    count = len(tables[what]["t"])
    late = np.argsort(np.arange(count) + np.random.default_rng(0).uniform(0, apart, count))
    tables[what] = rows(tables[what], late)

    flight = flight_of(tables["command"], tables["pose"])

    found = {code: count for code, count in counts(flight).items() if "stamps" in code}
    assert list(found) == [f"{what}_stamps_sorted"]
    for name in ("command_time", "command", "pose_time", "position", "yaw"):
        np.testing.assert_array_equal(getattr(flight, name), getattr(straight, name))


@pytest.mark.parametrize("back", [0.3, 0.9, 3.0])
def test_a_clock_that_was_set_back_costs_what_it_goes_over_again(back: float) -> None:
    pose = poses()
    pose["t"] = np.where(np.arange(1200) < 600, pose["t"], pose["t"] - back + 0.003)

    flight = flight_of(pose=pose)

    assert counts(flight)["pose_stamps_reversed"] == round(back / 0.01) - 1
    assert "pose_stamps_sorted" not in counts(flight)


@pytest.mark.parametrize("what", ["command", "pose"])
def test_stamps_that_repeat_or_are_far_back_are_dropped_with_their_counts(what: str) -> None:
    tables = {"command": commands(), "pose": poses()}
    stamps = tables[what]["t"]
    stamps[150] = stamps[149]
    stamps[160:163] = stamps[20]

    flight = flight_of(tables["command"], tables["pose"])

    assert counts(flight)[f"{what}_stamps_repeated"] == 1
    assert counts(flight)[f"{what}_stamps_reversed"] == 3
    assert np.all(np.diff(flight.command_time) > 0)
    assert np.all(np.diff(flight.pose_time) > 0)


def test_samples_that_are_no_numbers_are_absent() -> None:
    cmd, pose = commands(), poses()
    cmd["z"][50:60] = np.nan
    pose["yaw"][300:310] = np.inf
    pose["t"][400:402] = np.nan

    flight = flight_of(cmd, pose)

    found = counts(flight)
    assert (found["nan_commands"], found["nan_poses"], found["pose_stamps_missing"]) == (10, 10, 2)
    assert len(flight.segments) == 2
    assert np.all(np.isfinite(flight.position))


def test_a_lost_body_written_as_zero_quaternion_is_absent() -> None:
    pose = poses()
    pose |= {
        "q.w": np.cos(pose["yaw"] / 2),
        "q.x": 0 * pose["t"],
        "q.y": 0 * pose["t"],
        "q.z": np.sin(pose.pop("yaw") / 2),
    }
    for part in ("q.w", "q.z"):
        pose[part][500:520] = 0.0

    flight = flight_of(pose=pose, card=card_with(pose={"yaw": None, "quaternion": "pose:q"}))

    assert counts(flight)["nan_poses"] == 20


def test_an_axis_that_is_never_a_number_is_not_commanded() -> None:
    flight = flight_of(commands() | {"yaw": np.full(200, np.nan)})

    assert flight.axes == ("x", "y", "z")
    assert counts(flight)["axis_never_commanded"] == 200


@pytest.mark.parametrize("column", ["t", "x"])
def test_the_last_surplus_sample_goes(column: str) -> None:
    pose = poses()
    short = {name: values[:-1] for name, values in pose.items()}
    longer = short | {column: pose[column]}

    flight, exact = flight_of(pose=longer), flight_of(pose=short)

    assert counts(flight)["surplus_pose"] == 1
    np.testing.assert_array_equal(flight.position, exact.position)
    np.testing.assert_array_equal(flight.pose_time, exact.pose_time)


def test_lengths_that_differ_by_two_are_refused() -> None:
    pose = poses()

    with pytest.raises(CardError, match="time 1200, x 1198"):
        flight_of(pose=pose | {"x": pose["x"][:-2]})


def test_whole_numbers_of_any_type_are_read_as_float64() -> None:
    cmd = {name: np.round(100 * values).astype(np.int8) for name, values in commands().items()}
    cmd["t"] = np.arange(200) * 50
    pose = {name: np.round(1000 * values).astype(np.int16) for name, values in poses().items()} | {
        "z": np.full(1200, 1, dtype=np.uint8)
    }
    card = card_with(
        command={"time": {"from": "cmd:t", "unit": "ms"}},
        pose={
            "time": {"from": "pose:t", "unit": "ms"},
            "x": {"from": "pose:x", "unit": "mm"},
            "yaw": {"from": "pose:yaw", "scale": 0.001},
        },
    )

    flight = flight_of(cmd, pose, card)

    assert flight.position.dtype == flight.command.dtype == flight.yaw.dtype == np.float64
    assert np.max(np.abs(flight.position[:, 0])) == pytest.approx(2.0, abs=1e-3)
    assert flight.duration == pytest.approx(10.1)


def test_a_first_command_that_the_rest_disowns_is_dropped_and_time_starts_where_it_did() -> None:
    cmd = commands()
    cmd["yaw"] *= 0.1
    clean = flight_of(cmd)
    cmd["yaw"][0] = -3.4

    flight = flight_of(cmd)

    assert counts(flight)["garbage_first_command"] == 1
    assert "yaw = -3.4" in next(note.text for note in flight.notes if note.code == "garbage_first_command")
    assert flight.segments[0].start == flight.command_time[0] == pytest.approx(0.05)
    np.testing.assert_array_equal(flight.pose_time, clean.pose_time)
    np.testing.assert_array_equal(flight.command, clean.command[1:])


def test_steps_pulses_and_ramps_from_the_first_sample_are_no_garbage() -> None:
    cmd = commands()
    for start in (np.r_[np.ones(40), np.zeros(160)], np.r_[1.0, np.full(199, 0.9)], np.linspace(-3, 3, 200)):
        assert "garbage_first_command" not in counts(flight_of(cmd | {"x": start}))
    quiet_then_loud = np.r_[0.0, np.full(199, 0.3)]
    assert "garbage_first_command" not in counts(flight_of(cmd | {"z": quiet_then_loud}))


def test_commands_while_the_window_is_closed_are_gaps() -> None:
    cmd = commands()
    cmd["armed"] = (np.arange(200) >= 40) & ~((np.arange(200) >= 100) & (np.arange(200) < 102))

    flight = flight_of(cmd, card=card_with(window={"when": "cmd:armed"}))

    found = [(round(part.start, 6), round(part.end, 6)) for part in flight.segments]
    assert found == [(0.0, 3.0), (3.1, 8.1)]
    assert counts(flight)["commands_outside_window"] == 42


def test_the_window_may_stand_in_a_table_with_a_clock_of_the_same_name() -> None:
    mode = {"t": np.array([1.0, 4.0]), "velocity_control": np.array([1, 0])}
    log = log_of(commands(), poses(), mode=mode)

    flight = flight_from_log(log, card_with(window={"when": "mode:velocity_control"}))

    assert flight.command_time[0] == 0.0
    assert flight.segments[-1].end == pytest.approx(3.0)
    assert len(flight.command_time) == 60


def test_a_window_without_a_clock_or_never_open_is_refused() -> None:
    log = log_of(commands(), poses(), mode={"on": np.ones(7), "t": np.arange(3.0)})

    assert "no time stamps for" in error_of(log, card_with(window={"when": "mode:on"}))
    shut = commands() | {"on": np.zeros(200)}
    assert "never open" in error_of(log_of(shut, poses()), card_with(window={"when": "cmd:on"}))


def test_what_was_lost_on_reading_stands_among_the_notes() -> None:
    log = replace(log_of(commands(), poses()), notes=("the last 1 chunk is damaged",))

    assert flight_from_log(log, card_with()).notes[0].text == "the last 1 chunk is damaged"


# What cannot be a flight


def without(table: dict, **changes: object) -> dict:
    return table | changes


@pytest.mark.parametrize(
    ("cmd", "pose", "says"),
    [
        (rows(commands(), slice(0)), poses(), "no commands"),
        (commands(), rows(poses(), slice(0)), "no poses"),
        (rows(commands(), slice(1)), poses(), "only one command"),
        (
            commands(),
            without(poses(), x=np.ones(1200), y=np.ones(1200), z=np.ones(1200), yaw=np.ones(1200)),
            "never changes",
        ),
        (commands(), without(poses(), x=np.full(1200, np.nan)), "(x always missing)"),
        ({name: np.full(200, np.nan) for name in commands()}, poses(), "no command is complete"),
        (without(commands(), t=np.full(200, np.nan)), poses(), "none of 200 commands has a stamp"),
        (without(commands(), t=commands()["t"][::-1]), poses(), "commands runs backwards"),
        (commands(), without(poses(), t=poses()["t"][::-1]), "poses runs backwards"),
        (commands(), without(poses(), t=np.r_[900.0, 900.01, poses()["t"][2:]]), "poses runs backwards"),
        (without(commands(), t=np.zeros(200)), poses(), "stands still"),
        (commands(1.0), poses(), "only 1."),
        (commands(), poses(1.5), "only 0."),
        (commands(start=1.7e9), poses(), "no time in common"),
        (commands(), without(poses(), t=poses()["t"] * 1000), "poses come every 10 s; add the unit"),
        (without(commands(), t=commands()["t"] * 1000), poses(), "commands come every 50 s; add the unit"),
        (commands(), without(poses(), yaw=np.degrees(poses()["t"] + 2) % 360), 'unit = "deg"'),
    ],
)
def test_what_is_no_flight_is_refused_in_one_line(cmd: dict, pose: dict, says: str) -> None:
    card = card_with()
    log = log_of(cmd, pose)

    with pytest.raises(FlightError) as error:
        flight_from_log(log, card)

    assert "\n" not in str(error.value)
    assert str(error.value).startswith("flight.log: ")
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("missing", "there", "told"),
    [
        ("cmd", "other", ""),
        ("pose", "other", ""),
        ("cmd", "cmd2", "; nearest: 'cmd2'"),
        ("pose", "poses", "; nearest: 'poses'"),
    ],
)
def test_a_log_without_the_commands_or_the_pose_names_a_table_only_if_it_is_near(
    missing: str, there: str, told: str
) -> None:
    log = log_of(commands(), poses(), **{there: {"x": np.zeros(3)}})
    log = replace(log, tables={name: table for name, table in log.tables.items() if name != missing})

    assert f"no table '{missing}'{told}" in error_of(log)
    assert bool(told) == ("nearest" in error_of(log))


# Laws under damage


def damaged(table: dict, seed: int, shuffled: int, duplicated: int, holes: int) -> dict:
    rng = np.random.default_rng(seed)
    count = len(table["t"])
    index = np.sort(np.r_[np.arange(count), rng.integers(0, count, duplicated)])
    for a in rng.integers(3, len(index), shuffled):
        b = a - rng.integers(1, 4)
        index[a], index[b] = index[b], index[a]
    if shuffled > count:
        rng.shuffle(index)
    table = {name: values[index].copy() for name, values in table.items()}
    for _ in range(holes):
        table[rng.choice(list(table))][rng.integers(0, len(index))] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
    return table


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    shuffled=st.sampled_from([0, 1, 20, 2000]),
    duplicated=st.sampled_from([0, 5, 300]),
    holes=st.sampled_from([0, 3, 200, 1000]),
    frame=st.sampled_from(["heading", "world"]),
)
def test_damaged_streams_give_an_ordered_flight_or_one_line(
    seed: int, shuffled: int, duplicated: int, holes: int, frame: str
) -> None:
    amounts = (shuffled, duplicated, holes)
    log = log_of(damaged(commands(), seed, *amounts), damaged(poses(), seed + 1, *amounts))

    try:
        flight = flight_from_log(log, card_with(command={"frame": frame}))
    except RotorfitError as error:
        assert "\n" not in str(error)  # noqa: PT017 - both outcomes are allowed
        return

    assert np.all(np.diff(flight.command_time) > 0)
    assert np.all(np.diff(flight.pose_time) > 0)
    assert len(flight.command_time) == len(flight.command)
    assert len(flight.pose_time) == len(flight.position) == len(flight.yaw)
    for values in (flight.command_time, flight.command, flight.pose_time, flight.position, flight.yaw):
        assert np.all(np.isfinite(values))
    ends = [time for part in flight.segments for time in (part.start, part.end)]
    assert ends == sorted(ends)
    assert ends[0] >= flight.span[0]
    assert ends[-1] <= flight.span[1]
    assert flight.duration >= 2.0 - 1e-9


@given(order=st.permutations(range(30)))
def test_a_wholly_shuffled_stream_never_runs_backwards(order: list[int]) -> None:
    cmd = rows(commands(3.0, 0.1), np.array(order))

    try:
        flight = flight_from_log(log_of(cmd, poses()), card_with())
    except FlightError:
        return

    assert np.all(np.diff(flight.command_time) > 0)


def test_the_log_is_not_changed() -> None:
    log = log_of(commands(), poses())
    before = {name: {key: values.copy() for key, values in table.columns.items()} for name, table in log.tables.items()}

    flight_from_log(log, card_with(command={"frame": "world"}))

    for name, table in log.tables.items():
        for key, values in table.columns.items():
            np.testing.assert_array_equal(values, before[name][key])


# Real flights


def real(real_flights: Path, folder: str, name: str, **kwargs: object) -> Flight:
    return flight_from_log(
        read(real_flights / folder / name), load_card(str(real_flights / folder / "card.toml")), **kwargs
    )


def test_bebop2_wsu_loses_its_garbage_start_and_nothing_else(real_flights: Path) -> None:
    for name, duration, stale in (("X", 168.2, 20), ("Z", 136.5, 0)):
        flight = real(real_flights, "bebop2-wsu", f"Training_CT_TestDay_{name}.mat")
        found = counts(flight)

        assert flight.duration == pytest.approx(duration, abs=0.1)
        assert found["garbage_first_command"] == 1
        assert found["surplus_command"] == found["surplus_pose"] == 1
        assert found.get("stale_poses", 0) == stale
        assert np.median(np.diff(flight.pose_time)) == pytest.approx(1 / 120, rel=1e-3)
        assert np.max(np.abs(flight.command[:, 3])) < 0.3
        assert np.max(np.abs(flight.command[:, :2])) == pytest.approx(0.06, abs=1e-6)
        assert len(flight.segments) <= 3


def test_bebop2_optitrack_drops_its_stale_frames_and_stops_with_its_commands(real_flights: Path) -> None:
    shares = {"pitch_trn": 0.319, "pitch_tst": 0.345, "vert_trn": 0.293, "vert_tst": 0.557}
    for name, share in shares.items():
        log = read(real_flights / "bebop2-optitrack" / f"monster_{name}.bag")
        flight = flight_from_log(log, load_card("bebop2-optitrack"))
        total = len(log.tables["/rigid_body_1/pose"].columns["header.stamp"])

        assert counts(flight)["stale_poses"] / total == pytest.approx(share, abs=0.001)
        assert flight.duration == pytest.approx(9.9, abs=0.05)
        assert np.median(np.diff(flight.command_time)) == pytest.approx(1 / 15, rel=1e-2)
        assert len(flight.segments) == 1


def test_dji_hexarotor_drops_the_last_measurement_and_unwraps(real_flights: Path) -> None:
    turned = 0
    for index in range(1, 7):
        flight = real(real_flights, "dji-hexarotor", f"Datos_Prueba{index}.mat")

        assert counts(flight)["surplus_pose"] == 1
        assert flight.duration == pytest.approx(50.0)
        assert np.max(np.abs(np.diff(flight.yaw))) < 0.3
        turned += counts(flight).get("yaw_unwrapped", 0)
    assert turned > 5


def test_bebop2_joystick_keeps_half_of_its_rows(real_flights: Path) -> None:
    flight = real(real_flights, "bebop2-joystick", "record_velocity.csv")

    assert counts(flight)["stale_poses"] == 1065
    assert flight.duration == pytest.approx(69.9, abs=0.1)
    assert len(flight.pose_time) == pytest.approx(1033)


def test_ardrone2_reads_matrices_by_row(real_flights: Path) -> None:
    for path in sorted((real_flights / "ardrone2-optitrack").glob("*.mat")):
        flight = flight_from_log(read(path), load_card("ardrone2-optitrack"))

        assert flight.duration == pytest.approx(11.95, abs=0.1)
        assert sum(bool(np.any(flight.command[:, k])) for k in range(4)) == 1


def test_radians_read_as_such_where_the_log_holds_degrees_are_refused(real_flights: Path) -> None:
    log = read(real_flights / "dji-hexarotor" / "Datos_Prueba2.mat")
    card = load_card("dji-hexarotor")
    degrees = replace(card, pose={**card.pose, "yaw": replace(card.pose["yaw"], scale=180 / np.pi)})

    with pytest.raises(FlightError, match='unit = "deg"'):
        flight_from_log(log, degrees)
