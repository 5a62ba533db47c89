"""Cards: what is read from TOML, what is refused, and which column a channel finds."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.card import Card, Channel, Condition
from rotorfit.core.errors import CardError
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis.card_choice import card_of
from rotorfit.files.cards import builtin_cards, card_from_mapping, load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import column, fitting_cards

TEXT = """
name = "test"
frame = "NED"
[command]
frame = "world"
hold = 0.3
time = "/cmd:header.stamp"
x = { from = "/cmd:linear.x", meaning = "tilt", full_scale = "tilt", scale = -1 }
z = "/cmd:linear.z"
[pose]
time = { from = "/pose:header.stamp", offset = -20, unit = "ms" }
x = { from = "/pose:x", unit = "mm" }
y = "/pose:y"
z = 1
quaternion = "/pose:orientation"
[velocity]
frame = "heading"
x = { from = "/v:x", unit = "cm/s" }
[reference]
x = "/pose:x_goal"
[window]
when = "/mode:flying"
[limits]
tilt = { value = 10, unit = "deg" }
vertical_speed = { value = 150, unit = "cm/s" }
yaw_rate = 1.5
speed = 3
"""


def raw() -> dict:
    return tomllib.loads(TEXT)


def log_of(**tables: dict) -> Log:
    named = {
        name: Table(name, {key: np.asarray(value) for key, value in cols.items()}) for name, cols in tables.items()
    }
    return Log(Path("flight.log"), "csv", "0" * 64, named, {"image": "pixels"})


def one_line(error: pytest.ExceptionInfo[CardError]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


def test_every_key_of_the_format_is_read() -> None:
    card = card_from_mapping(raw(), "test.toml")

    assert (card.name, card.frame, card.command_frame, card.hold) == ("test", "NED", "world", 0.3)
    assert card.command == {
        "x": Channel("/cmd:linear.x", scale=-1.0, meaning="tilt", full_scale="tilt"),
        "z": Channel("/cmd:linear.z"),
    }
    assert card.pose_time == Channel("/pose:header.stamp", offset=-20.0, unit="ms")
    assert card.pose["x"] == Channel("/pose:x", unit="mm")
    assert card.pose["z"] == Channel(1.0)
    assert [card.pose[f"q{part}"].source for part in "wxyz"] == [f"/pose:orientation.{part}" for part in "wxyz"]
    assert (card.velocity_frame, card.velocity["x"]) == ("heading", Channel("/v:x", unit="cm/s"))
    assert card.reference == {"x": Channel("/pose:x_goal")}
    assert card.window == (Condition(Channel("/mode:flying")),)
    assert card.limits == pytest.approx(
        {"tilt": np.radians(10), "vertical_speed": 1.5, "yaw_rate": 1.5, "speed": 3.0}, rel=1e-12
    )


def test_frames_hold_and_optional_sections_have_defaults() -> None:
    text = raw()
    del text["frame"], text["command"]["frame"], text["command"]["hold"]
    for section in ("velocity", "reference", "window", "limits", "name"):
        del text[section]

    card = card_from_mapping(text, "mine")

    assert (card.name, card.frame, card.command_frame, card.hold, card.window) == ("mine", "ENU", "heading", None, ())
    assert not card.velocity
    assert not card.reference
    assert not card.limits


def test_a_card_comes_back_from_the_json_of_its_raw() -> None:
    for name, card in builtin_cards().items():
        assert card_from_mapping(json.loads(json.dumps(card.raw)), name) == card
    card = card_from_mapping(raw(), "test")
    assert card_from_mapping(json.loads(json.dumps(card.raw)), "test") == card


def test_four_names_of_a_quaternion_are_w_x_y_z() -> None:
    text = raw()
    text["pose"]["quaternion"] = ["Q[3]", "Q[0]", "Q[1]", "Q[2]"]

    card = card_from_mapping(text, "test")

    assert [card.pose[f"q{part}"].source for part in "wxyz"] == ["Q[3]", "Q[0]", "Q[1]", "Q[2]"]


@pytest.mark.parametrize(
    ("value", "angle"), [(0.5, 0.5), ({"value": 90, "unit": "deg"}, np.pi / 2), ({"value": -1}, -1)]
)
def test_the_heading_of_a_quaternion_may_be_off(value: object, angle: float) -> None:
    text = raw()
    text["pose"]["heading_offset"] = value

    assert card_from_mapping(text, "test").heading_offset == pytest.approx(angle)
    del text["pose"]["quaternion"]
    text["pose"]["yaw"] = "/pose:yaw"
    with pytest.raises(CardError, match="heading_offset is for a quaternion; give yaw an offset"):
        card_from_mapping(text, "test")


@pytest.mark.parametrize(
    ("place", "key", "nearest"),
    [
        ((), "comand", "command"),
        (("command",), "tme", "time"),
        (("command", "x"), "form", "from"),
        (("command", "x"), "full_scal", "full_scale"),
        (("pose",), "quaternions", "quaternion"),
        (("pose", "x"), "Unit", "unit"),
        (("velocity",), "fram", "frame"),
        (("reference",), "yow", "yaw"),
        (("window",), "wen", "when"),
        (("limits",), "yawrate", "yaw_rate"),
        (("limits", "tilt"), "val", "value"),
    ],
)
def test_an_unknown_key_is_refused_with_its_place_and_the_nearest(place: tuple, key: str, nearest: str) -> None:
    text = raw()
    section = text
    for step in place:
        section = section[step]
    section[key] = 1

    with pytest.raises(CardError) as error:
        card_from_mapping(text, "my.toml")

    message = one_line(error)
    assert "my.toml" in message
    assert repr(key) in message
    assert repr(nearest) in message
    assert all(step in message for step in place)


MISSING = object()


@pytest.mark.parametrize(
    ("place", "value", "says"),
    [
        (("command",), MISSING, "[command] is missing"),
        (("pose",), MISSING, "[pose] is missing"),
        (("command", "time"), MISSING, "time is missing"),
        (("pose", "time"), MISSING, "time is missing"),
        (("pose", "x"), MISSING, "x is missing"),
        (("pose", "quaternion"), MISSING, "yaw is missing; name its column, or a quaternion"),
        (("pose", "yaw"), "/pose:yaw", "yaw or quaternion"),
        (("command", "x", "from"), MISSING, "from is missing"),
        (("window", "when"), MISSING, "when is missing"),
        (("limits", "tilt", "value"), MISSING, "'value' is missing"),
        (("command",), "cmd", "section"),
        (("command", "x"), [None], "column's name or a number"),
        (("command", "x"), True, "column's name or a number"),
        (("command", "x"), "", "column's name or a number"),
        (("command", "x", "scale"), "-1", "finite number"),
        (("command", "x", "scale"), float("nan"), "finite number"),
        (("command", "x", "meaning"), "tlit", "nearest: 'tilt'"),
        (("command", "x", "full_scale"), "tilts", "nearest: 'tilt'"),
        (("command", "x", "unit"), "degree", "nearest: 'deg"),
        (("command", "hold"), 0, "positive"),
        (("command", "frame"), "body", "heading, world"),
        (("command", "time"), 3, "not the constant 3"),
        (("pose", "time", "unit"), "m", "s, ms, us, ns"),
        (("pose", "x", "unit"), "deg", "m, cm, mm"),
        (("pose", "quaternion"), ["a", "b"], "four names"),
        (("pose", "heading_offset"), "50", "heading_offset: must be a finite number"),
        (("pose", "heading_offset"), {"value": 1, "unit": "m"}, "rad, deg"),
        (("pose", "quaternion"), ["a", "b", "c", 1], "text"),
        (("limits", "tilt", "unit"), "m/s", "rad, deg"),
        (("limits", "speed"), -1, "positive"),
        (("frame",), "enu", "nearest: 'ENU'"),
        (("name",), 3, "text"),
        (("window", "when"), 1, "not the constant 1"),
        (("command", "z"), "/cmd:linear.x", "[command]: x and z both read '/cmd:linear.x'; each needs a column"),
        (("command", "z"), "/cmd:header.stamp", "[command]: time and z both read"),
        (("pose", "y"), {"from": "/pose:y", "scale": 0}, "scale: must not be 0"),
        (("pose", "y"), {"from": "/pose:x", "scale": -1}, "[pose]: x and y both read '/pose:x'"),
        (("velocity", "y"), "/v:x", "[velocity]: x and y both read"),
        (("over",), "x\n" * 1000, "over: must be a list of names, not 'x\\nx"),
    ],
)
def test_what_is_missing_or_wrong_is_refused_in_one_line(place: tuple, value: object, says: str) -> None:
    text = raw()
    section = text
    for step in place[:-1]:
        section = section[step]
    if value is MISSING:
        del section[place[-1]]
    else:
        section[place[-1]] = value

    with pytest.raises(CardError) as error:
        card_from_mapping(text, "my.toml")

    assert says in one_line(error)
    assert "my.toml" in str(error.value)


def test_a_column_that_is_command_and_pose_is_refused_when_the_log_is_read() -> None:
    """In two files both may be called x; in one table they are the same column."""
    card = card_from_mapping(
        {
            "command": {"time": "t", "x": "x", "y": "uy"},
            "pose": {"time": "t", "x": "x", "y": "y", "z": 1, "yaw": 0},
        },
        "mine",
    )
    log = log_of(all={name: np.arange(100.0) for name in ("t", "x", "y", "uy")})

    with pytest.raises(CardError) as error:
        flight_from_log(log, card)

    assert one_line(error) == "flight.log: [command] x and [pose] x both read 'x'; each needs a column of its own"


def test_a_card_that_commands_no_axis_is_refused() -> None:
    text = raw()
    del text["command"]["x"], text["command"]["z"]

    with pytest.raises(CardError, match="no axis is commanded"):
        card_from_mapping(text, "my.toml")


def test_a_card_is_loaded_by_built_in_name_and_by_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(TEXT, encoding="utf-8")

    assert load_card("bebop2").name.startswith("Parrot Bebop 2")
    assert load_card(str(path)) == card_from_mapping(raw(), str(path))


def test_a_card_that_cannot_be_loaded_is_one_line(tmp_path: Path) -> None:
    broken, binary = tmp_path / "broken.toml", tmp_path / "binary.toml"
    broken.write_text("[command\nx = ", encoding="utf-8")
    binary.write_bytes(b"\xff\xfe\x00\x9f")

    with pytest.raises(CardError, match="nearest: 'bebop2-wsu'") as unknown:
        load_card("bebop2-wus")
    with pytest.raises(CardError, match=r"broken\.toml") as not_toml:
        load_card(str(broken))
    with pytest.raises(CardError, match=r"binary\.toml") as not_text:
        load_card(str(binary))
    with pytest.raises(CardError, match="neither a file"):
        load_card(str(tmp_path))

    for error in (unknown, not_toml, not_text):
        one_line(error)


def test_shipped_cards_read_the_real_sets_as_their_own_cards_do(real_flights: Path) -> None:
    def essence(card: Card) -> tuple:
        plain = {axis: (one.source, one.scale, one.offset, one.unit) for axis, one in card.command.items()}
        return plain, card.pose, card.command_time, card.pose_time, card.frame, card.command_frame, card.limits

    for name in ("bebop2-wsu", "bebop2-optitrack", "dji-hexarotor", "bebop2-joystick", "ardrone2-optitrack"):
        assert essence(load_card(name)) == essence(load_card(str(real_flights / name / "card.toml")))


def test_the_error_of_a_clock_is_stated_for_commands_and_poses_alone() -> None:
    raw = {
        "command": {"time": {"from": "t", "error": 0.002}, "x": "ux"},
        "pose": {"time": {"from": "s", "unit": "ms", "error": 0.03}, "x": "x", "y": "y", "z": "z", "yaw": "yaw"},
    }
    card = card_from_mapping(raw, "test")
    assert (card.command_time.error, card.pose_time.error) == (0.002, 0.03)

    for section, key in (("command", "x"), ("pose", "z")):
        wrong = {**raw, section: {**raw[section], key: {"from": "u", "error": 0.1}}}
        with pytest.raises(CardError, match=rf"\[{section}\] {key}: unknown key 'error'"):
            card_from_mapping(wrong, "test")
    with pytest.raises(CardError, match=r"\[pose\] time.error: must be positive, not -1"):
        card_from_mapping({**raw, "pose": {**raw["pose"], "time": {"from": "s", "error": -1}}}, "test")


def test_scale_comes_before_offset_and_unit_after_both() -> None:
    log = log_of(only={"x": [1, 2]})

    values = column(log, Channel("x", scale=-2, offset=1, unit="cm"))

    np.testing.assert_allclose(values, [-0.01, -0.03], rtol=1e-15)
    assert values.dtype == np.float64


def test_a_source_is_split_at_its_first_colon() -> None:
    log = log_of(**{"/a": {"b:c": [1.0, 2.0]}, "/d": {"e": [3.0]}})

    np.testing.assert_array_equal(column(log, Channel("/a:b:c")), [1.0, 2.0])


def test_a_lone_table_needs_no_name_and_may_have_colons_in_its_columns() -> None:
    log = log_of(only={"x": [1.0], "a:b": [2.0]})

    assert column(log, Channel("x")) == column(log, Channel("only:x")) == 1.0
    assert column(log, Channel("a:b")) == 2.0


def test_an_exact_name_wins_over_a_row() -> None:
    log = log_of(only={"M": np.arange(6.0).reshape(2, 3), "M[1]": [7.0, 8.0, 9.0]})

    np.testing.assert_array_equal(column(log, Channel("M[1]"), 3), [7.0, 8.0, 9.0])
    np.testing.assert_array_equal(column(log, Channel("M[0]"), 3), [0.0, 1.0, 2.0])


@pytest.mark.parametrize("count", [4, 5, 6])
def test_the_time_axis_of_a_matrix_is_the_one_as_long_as_its_time_give_or_take_one(count: int) -> None:
    matrix = np.arange(10).reshape(2, 5)
    log = log_of(only={"rows": matrix, "columns": matrix.T, "wide": np.arange(100).reshape(5, 20)})

    np.testing.assert_array_equal(column(log, Channel("rows[1]"), count), matrix[1])
    np.testing.assert_array_equal(column(log, Channel("columns[1]"), count), matrix[1])
    np.testing.assert_array_equal(column(log, Channel("wide[1]"), count), np.arange(1, 100, 20))


def test_a_constant_is_as_long_as_its_time() -> None:
    np.testing.assert_array_equal(column(log_of(), Channel(2.0, unit="deg"), 3), np.full(3, np.radians(2)))


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("/pose/rigid:x", "nearest: '/rigid/pose'"),
        ("/rigid/pose:pos.x", "nearest: 'position.x'"),
        ("position.x", "write '/rigid/pose:position.x'"),
        ("/rigid/pose:M[2]", "row 2 of 2"),
        ("/rigid/pose:M", "name a row"),
        ("/rigid/pose:N[0]", "as long as its time (5)"),
        ("/rigid/pose:label", "holds no numbers"),
        ("image:x", "not decoded: pixels"),
    ],
)
def test_what_is_not_there_is_named_with_the_nearest(source: str, says: str) -> None:
    pose = {"position.x": np.zeros(5), "M": np.zeros((2, 5)), "N": np.zeros((9, 12)), "label": list("abcde")}
    log = log_of(**{"/rigid/pose": pose, "/cmd": {"x": [0.0]}})

    with pytest.raises(CardError) as error:
        column(log, Channel(source), 5)

    assert says in one_line(error)
    assert "flight.log" in str(error.value)


@pytest.mark.parametrize("source", ["/pose/rigid:x", "/rigid/pose:x"])
def test_a_card_that_does_not_fit_is_answered_with_how_to_find_or_draft_another(source: str) -> None:
    log = log_of(**{"/rigid/pose": {"position.x": np.zeros(5)}, "/cmd": {"x": [0.0]}})

    with pytest.raises(CardError) as error:
        column(log, Channel(source), 5)

    assert one_line(error).endswith(
        "(`rotorfit info flight.log` lists what is there and names the built-in card that fits; "
        "`rotorfit info flight.log --draft-card FILE` drafts one)"
    )


def joystick() -> dict:
    names = ("time", "cmd_linx", "cmd_liny", "cmd_linz", "cmd_angz", "x", "y", "z", "yaw")
    return {name: np.zeros(5) for name in names}


def test_the_one_card_whose_columns_are_all_there_is_found() -> None:
    assert card_of(log_of(flight=joystick())) == load_card("bebop2-joystick")


def test_no_fitting_card_offers_a_draft_and_several_ask_for_one() -> None:
    columns = joystick()
    del columns["yaw"]
    neither = log_of(flight=columns)
    both = {name: np.zeros((6, 9)) for name in ("CI", "SS", "dControlSig", "X_opt")} | {
        "Time": np.zeros((10, 1)),
        "TIME": np.zeros((1, 9)),
    }

    with pytest.raises(CardError, match="--draft-card") as none:
        card_of(neither)
    with pytest.raises(CardError, match=r"several built-in cards fit .*--card") as several:
        card_of(log_of(flight=both))

    assert one_line(none)
    assert one_line(several)
    assert list(fitting_cards(log_of(flight=both))) == ["ardrone2-optitrack", "bebop2-wsu"]
