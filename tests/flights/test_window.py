"""Windows: conditions of a card, commands that nobody gives or answers, an estimator's own steps, other tables."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log, standing
from rotorfit.flights.columns import card_for, fitting_cards
from rotorfit.flights.command_window import idle_ends

T = np.arange(0.0, 40.0, 0.1)
"""Commands and poses come ten times a second."""


def log_of(commands: Mapping[str, Array] | None = None, **tables: Mapping[str, Array]) -> Log:
    cmd = {"t": T, "x": np.sin(T), "z": np.cos(T), "yaw": np.sin(T / 2)} | dict(commands or {})
    pose = {"t": T, "x": np.sin(T), "y": np.cos(T), "z": 1 + 0.9 * np.sin(T - 0.2), "yaw": 0.1 * T}
    named = {"cmd": cmd, "pose": pose, **tables}
    built = {name: Table(name, {key: np.asarray(v) for key, v in found.items()}) for name, found in named.items()}
    return Log(Path("flight.ulg"), "ulog", "0" * 64, built, {})


def card_of(*windows: dict, **sections: dict) -> Card:
    raw: dict = {
        "command": {"time": "cmd:t", "x": "cmd:x", "z": "cmd:z"} | sections.get("command", {}),
        "pose": {"time": "pose:t", "x": "pose:x", "y": "pose:y", "z": "pose:z", "yaw": "pose:yaw"}
        | sections.get("pose", {}),
    }
    return card_from_mapping(raw | ({"window": list(windows)} if windows else {}), "test")


def counts(flight: Flight) -> dict[str, int]:
    return {note.code: note.count for note in flight.notes}


# Conditions


@pytest.mark.parametrize(
    ("condition", "state"),
    [
        ({"when": "state:on"}, (T >= 10) & (T < 30)),
        ({"when": "state:on", "equals": 4}, np.where((T >= 10) & (T < 30), 4, 5)),
        ({"when": "state:on", "equals": [4, 14]}, np.where((T >= 10) & (T < 30), np.where(T < 20, 4, 14), 0)),
        ({"when": "state:on", "above": 0.3}, np.where((T >= 10) & (T < 30), 1.0, 0.1)),
        ({"when": "state:on", "above": -1}, np.where((T >= 10) & (T < 30), 0.0, np.nan)),
    ],
)
def test_a_condition_opens_and_closes_the_window(condition: dict, state: Array) -> None:
    flight = flight_from_log(log_of(state={"t": T, "on": state}), card_of(condition))

    assert flight.duration == pytest.approx(20.0, abs=0.11)
    assert counts(flight)["commands_outside_window"] == 200
    note = next(note for note in flight.notes if note.code == "commands_outside_window")
    assert "state:on" in note.text


def test_events_begin_and_end_the_window_and_others_are_not_heard() -> None:
    events = {"t": np.array([2.0, 10.0, 15.0, 30.0, 35.0]), "id": np.array([10, 28, 7, 18, 99])}
    condition = {"when": "EV:id", "opens": 28, "closes": [11, 18]}

    flight = flight_from_log(log_of(EV=events), card_of(condition))

    assert flight.duration == pytest.approx(20.0, abs=0.11)


def test_the_first_event_says_what_was_before_it_and_no_event_says_nothing() -> None:
    condition = {"when": "EV:id", "opens": 28, "closes": 18}
    landed = {"t": np.array([20.0, 21.0]), "id": np.array([18, 3])}
    silent = {"t": np.array([20.0, 21.0]), "id": np.array([3, 3])}

    assert flight_from_log(log_of(EV=landed), card_of(condition)).duration == pytest.approx(20.0, abs=0.11)
    assert flight_from_log(log_of(EV=silent), card_of(condition)).duration == pytest.approx(40.0, abs=0.4)


def test_all_conditions_must_hold_and_several_openings_give_several_segments() -> None:
    state = {"t": T, "armed": T < 35, "mode": np.where((T >= 5) & (T < 15) | (T >= 20), 14, 0)}
    card = card_of({"when": "state:armed"}, {"when": "state:mode", "equals": 14})

    flight = flight_from_log(log_of(state=state), card)

    assert [round(part.end - part.start, 1) for part in flight.segments] == [10.0, 15.0]
    assert [note.count for note in flight.notes if note.code == "commands_outside_window"] == [50, 100]


def test_a_condition_that_never_holds_is_named() -> None:
    with pytest.raises(FlightError, match=r"never open: .*state:mode is not 14"):
        flight_from_log(log_of(state={"t": T, "mode": np.zeros(T.size)}), card_of({"when": "state:mode", "equals": 14}))


def test_only_an_optional_condition_may_lack_its_column() -> None:
    optional = card_of({"when": "land:landed", "equals": 0, "optional": True})

    assert card_for(log_of(), optional).window == ()
    assert flight_from_log(log_of(), optional).duration > 39
    with pytest.raises(CardError):
        flight_from_log(log_of(), card_of({"when": "land:landed", "equals": 0}))


@pytest.mark.parametrize(
    ("window", "says"),
    [
        ({"equals": 3}, "when is missing"),
        ({"when": "a:b", "equals": 3, "above": 1}, "one of equals"),
        ({"when": "a:b", "opens": 3}, "opens and closes go together"),
        ({"when": "a:b", "optional": "yes"}, "not one of True, False"),
        ({"when": "a:b", "equal": 3}, "nearest: 'equals'"),
    ],
)
def test_what_is_wrong_with_a_window_is_one_line(window: dict, says: str) -> None:
    with pytest.raises(CardError, match=says) as error:
        card_of(window)

    assert "\n" not in str(error.value)


# Found without a card that says so


def test_set_points_that_are_no_number_close_the_window() -> None:
    x = np.where((T < 10) | (T >= 30), np.nan, np.sin(T))

    flight = flight_from_log(log_of({"x": x}), card_of())

    assert flight.duration == pytest.approx(20.0, abs=0.11)  # not a hold longer
    assert counts(flight)["nan_commands"] == 200


def test_an_axis_that_is_seldom_commanded_does_not_cost_the_others() -> None:
    card = card_of(command={"yaw": "cmd:yaw"})
    seldom = np.where(T < 35, np.nan, 0.1)

    flight = flight_from_log(log_of({"yaw": seldom}), card)

    assert flight.axes == ("x", "z")
    assert counts(flight)["axis_never_commanded"] == 350
    assert flight.duration > 39
    assert flight_from_log(log_of(), card).axes == ("x", "z", "yaw")


def test_a_controller_that_does_not_run_is_told_by_its_frozen_commands() -> None:
    noise = np.random.default_rng(0).normal(size=T.size)
    frozen = {axis: np.where((T < 5) | (T >= 32), 0.0, noise) for axis in ("x", "z")}

    flight = flight_from_log(log_of(frozen), card_of())

    assert counts(flight)["idle_commands"] == 129
    assert flight.duration == pytest.approx(27.1, abs=0.3)


def test_steps_and_short_pauses_are_no_idle_controller() -> None:
    stamps = np.round(T * 1e9).astype(np.int64)
    steps = np.repeat(np.round(np.sin(T))[:, None], 4, axis=1)
    noise = np.repeat(np.random.default_rng(0).normal(size=(T.size, 1)), 4, axis=1)
    pause = np.where(T[:, None] < 2.5, 0.0, noise)
    middle = np.where((T[:, None] > 15) & (T[:, None] < 15.5), 0.0, noise)

    for values in (steps, noise, pause, middle, np.zeros((T.size, 4))):
        assert not np.any(idle_ends(stamps, values))


def test_commands_on_the_ground_are_told_by_a_height_that_does_not_follow() -> None:
    stamps = np.round(T * 1e9).astype(np.int64)
    height = np.clip(T - 5, 0, 1) + 0.01 * np.sin(7 * T) - np.clip(T - 33, 0, 1)
    climb = np.where(T < 6, 0.8, np.where(T > 33, -0.8, 0.3 * np.sin(T)))

    ground = standing(stamps, climb, stamps, height)

    assert np.all(ground[T < 5])
    assert np.all(ground[T > 34.3])
    assert not np.any(ground[(T > 5.2) & (T < 33.8)])


def test_a_vehicle_in_the_air_is_never_on_the_ground() -> None:
    stamps = np.round(T * 1e9).astype(np.int64)
    hover = 0.02 * np.sin(T)
    sine = 0.5 * np.sin(T)

    assert not np.any(standing(stamps, np.sin(T), stamps, hover))  # holds its height: nothing asks for a climb
    assert not np.any(standing(stamps, np.cos(T), stamps, sine))
    assert not np.any(standing(stamps, np.zeros(T.size), stamps, hover))
    assert not np.any(standing(stamps, np.full(T.size, 0.5), stamps, 3 + hover - np.minimum(T, 2)))  # was higher before


# An estimator's own steps


def test_a_counter_that_moves_splits_the_flight_there() -> None:
    log = log_of()
    pose = {**log.tables["pose"].columns, "resets": (np.asarray(T) >= 20).astype(np.uint8)}
    pose["x"] = pose["x"] + 3.0 * (T >= 20)
    log = log_of(pose=pose)

    flight = flight_from_log(log, card_of(pose={"resets": ["pose:resets"]}))

    assert counts(flight)["pose_resets"] == 1
    assert len(flight.segments) == 2
    assert flight.segments[0].end <= 20.0 <= flight.segments[1].start + 0.1


# Columns of other tables, other names, patterns


def test_commands_of_another_table_are_held_and_poses_drawn() -> None:
    slow = np.arange(0.05, 39.0, 0.25)
    climb = {"t": slow, "rate": np.floor(slow)}
    attitude = {"t": slow, "yaw": np.angle(np.exp(1j * slow)), "z": 2 * slow}
    log = log_of(climb=climb, att=attitude)
    card = card_of(command={"z": "climb:rate"}, pose={"yaw": "att:yaw", "z": "att:z"})

    flight = flight_from_log(log, card)

    inside = (flight.pose_time > 0.2) & (flight.pose_time < 38.5)
    origin = 0.1  # the first row at which every command is known
    np.testing.assert_allclose(flight.yaw[inside], flight.pose_time[inside] + origin, atol=1e-6)
    np.testing.assert_allclose(flight.position[inside, 2], 2 * (flight.pose_time[inside] + origin), atol=1e-6)
    held = np.searchsorted(slow - 0.025, flight.command_time + origin + 1e-9, side="right") - 1
    np.testing.assert_array_equal(flight.command[:, 2], np.floor(slow)[held])
    assert counts(flight).keys() >= {"joined_command", "joined_pose"}


@pytest.mark.parametrize("parts", [slice(0, 4), slice(0, 1)])
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_quaternion_of_another_table_that_is_none_costs_its_neighbourhood_only(parts: slice, value: float) -> None:
    half = 0.15 * T
    q = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    q[parts, 150] = value
    attitude = {"t": T, **dict(zip(("q.w", "q.x", "q.y", "q.z"), q, strict=True))}
    pose = {"yaw": None, "quaternion": "att:q"}
    raw = {axis: f"pose:{axis}" for axis in ("x", "y", "z")} | {"time": "pose:t", "quaternion": pose["quaternion"]}
    card = card_from_mapping({"command": {"time": "cmd:t", "x": "cmd:x", "z": "cmd:z"}, "pose": raw}, "test")

    flight = flight_from_log(log_of(att=attitude), card)

    assert flight.duration > 39.0
    wrong = value == 0.0 and parts == slice(0, 1)  # w = 0 is half a turn: a quaternion like any other
    away = np.abs(flight.pose_time - T[150]) > (0.3 if wrong else 0.0)
    np.testing.assert_allclose(np.cos(flight.yaw[away]), np.cos(0.3 * flight.pose_time[away]), atol=2e-3)


def test_blank_cells_of_a_file_of_rows_are_no_values_of_a_state() -> None:
    rows = np.sort(np.concatenate([T, T + 0.03, T[::5] + 0.06]))
    at = {"cmd": np.isin(rows, T), "pose": np.isin(rows, T + 0.03), "state": np.isin(rows, T[::5] + 0.06)}
    series = {"cx": ("cmd", np.sin(rows)), "cz": ("cmd", np.cos(rows)), "x": ("pose", np.sin(rows))}
    series |= {"y": ("pose", np.cos(rows)), "z": ("pose", 1 + 0.9 * np.sin(rows - 0.2)), "yaw": ("pose", 0.1 * rows)}
    series |= {"armed": ("state", 1.0 + 0 * rows), "resets": ("state", 0 * rows), "goal": ("state", 1.5 + 0 * rows)}
    columns = {name: np.where(at[what], values, np.nan) for name, (what, values) in series.items()}
    log = Log(Path("flight.csv"), "csv", "0" * 64, {"flight": Table("flight", {"t": rows, **columns})}, {})
    raw = {
        "command": {"time": "t", "x": "cx", "z": "cz"},
        "pose": {"time": "t", "x": "x", "y": "y", "z": "z", "yaw": "yaw", "resets": "resets"},
        "window": [{"when": "armed"}],
        "reference": {"x": "goal"},
    }

    flight = flight_from_log(log, card_from_mapping(raw, "test"))

    assert len(flight.segments) == 1
    assert flight.duration > 39.0
    assert "pose_resets" not in counts(flight)
    assert flight.reference is not None
    np.testing.assert_array_equal(flight.reference[:, 0], 1.5)


def test_a_state_beside_the_commands_of_a_file_of_rows_is_unknown_where_it_is_blank() -> None:
    log = log_of()
    columns = {f"c{name}": values for name, values in log.tables["cmd"].columns.items() if name != "t"}
    columns |= dict(log.tables["pose"].columns) | {"mode": np.where((T > 10) & (T < 30), np.nan, 1.0)}
    rows = Log(Path("flight.csv"), "csv", "0" * 64, {"flight": Table("flight", columns)}, {})
    raw = {
        "command": {"time": "t", "x": "cx", "z": "cz"},
        "pose": {"time": "t", "x": "x", "y": "y", "z": "z", "yaw": "yaw"},
        "window": [{"when": "mode"}],
    }

    flight = flight_from_log(rows, card_from_mapping(raw, "test"))

    assert len(flight.segments) == 2
    assert flight.duration == pytest.approx(20.0, abs=0.3)


def test_messages_of_one_step_belong_together_though_one_is_written_after_the_other() -> None:
    east = {"t": T + 40e-6, "v": np.cos(T)}

    flight = flight_from_log(log_of(east=east), card_of(command={"y": "east:v"}))

    np.testing.assert_allclose(flight.command[:, 1], np.cos(flight.command_time), atol=1e-3)


def test_what_stopped_coming_in_another_table_is_no_command() -> None:
    until = T[T < 25]

    flight = flight_from_log(log_of(climb={"t": until, "rate": np.cos(until)}), card_of(command={"z": "climb:rate"}))

    assert flight.duration == pytest.approx(25.2, abs=0.3)


def test_a_card_knows_the_names_of_several_versions() -> None:
    card = card_of(pose={"yaw": ["pose:heading", {"from": "pose:course", "unit": "deg"}, "pose:yaw"]})
    pose = dict(log_of().tables["pose"].columns)
    old = log_of(pose={name: values for name, values in pose.items() if name != "yaw"} | {"course": pose["yaw"]})

    assert card_for(log_of(), card).pose["yaw"].source == "pose:yaw"
    np.testing.assert_allclose(flight_from_log(old, card).yaw, np.radians(flight_from_log(log_of(), card).yaw))


def test_a_pattern_stands_for_the_one_table_that_it_describes() -> None:
    tables = {name: dict(log_of().tables["pose"].columns) for name in ("/vicon/a/a", "/vicon/b/b")}
    names = {"time": "t", "x": "x", "y": "y", "z": "z", "yaw": "yaw"}
    card = card_of(pose={key: f"/vicon/*/*:{name}" for key, name in names.items()})

    one = flight_from_log(log_of(**{"/vicon/a/a": tables["/vicon/a/a"]}), card)

    np.testing.assert_array_equal(one.position, flight_from_log(log_of(), card_of()).position)
    with pytest.raises(CardError, match=r"no table '/vicon/\*/\*'"):
        flight_from_log(log_of(**tables), card)
    assert fitting_cards(log_of(**tables)) == {}
