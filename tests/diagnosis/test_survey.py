"""Surveys: what is in a log, and what the flight excites."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest

from rotorfit.app.terminal import show
from rotorfit.app.terminal.contents import _percent, survey_view
from rotorfit.core.errors import CardError
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis.card_draft import draft_card
from rotorfit.diagnosis.survey import excitation, survey
from rotorfit.files.cards import load_card
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log


def log_of(name: str = "flight.csv", **tables: dict) -> Log:
    named = {key: Table(key, {n: np.asarray(v) for n, v in columns.items()}) for key, columns in tables.items()}
    return Log(Path(name), "csv", "0" * 64, named, {"/image": "pixels"}, ("cut short",))


def message_log(pose: str = "/vicon/drone/drone", pose_prefix: str = "transform.", stamped: bool = True) -> Log:
    """A Twist without header and a pose, as a ROS bag gives them."""
    t = np.arange(2000) / 100
    u = np.arange(300) / 15
    point, attitude = ("translation", "rotation") if pose_prefix == "transform." else ("position", "orientation")
    stamps = np.round((1.7e9 + t) * 1e9).astype(np.int64)
    poses = {
        "log_time": stamps + 2_000_000,
        "header.stamp": stamps if stamped else np.zeros(2000, dtype=np.int64),
        f"{pose_prefix}{point}.x": np.sin(t),
        f"{pose_prefix}{point}.y": np.cos(t),
        f"{pose_prefix}{point}.z": 1 + 0.1 * np.sin(t),
        f"{pose_prefix}{attitude}.x": np.zeros(2000),
        f"{pose_prefix}{attitude}.y": np.zeros(2000),
        f"{pose_prefix}{attitude}.z": np.sin(t / 9),
        f"{pose_prefix}{attitude}.w": np.cos(t / 9),
    }
    twist = {
        "log_time": np.round((1.7e9 + u) * 1e9).astype(np.int64),
        "linear.x": np.sin(u),
        "linear.y": np.cos(u),
        "linear.z": np.zeros(300),
        "angular.x": np.zeros(300),
        "angular.y": np.zeros(300),
        "angular.z": np.zeros(300),
    }
    estimate = {"log_time": stamps, "twist.linear.x": t, "twist.linear.y": t, "twist.linear.z": t}
    return log_of("flight.bag", **{pose: poses, "/drone/cmd_vel": twist, "/velocity": estimate})


def loaded(text: str, tmp_path: Path) -> object:
    path = tmp_path / "draft.toml"
    path.write_text(text, encoding="utf-8")
    return load_card(str(path))


def csv_log(**names: str) -> Log:
    """A CSV of one's own, columns renamed from plain names."""
    t = np.arange(1500) / 50
    plain = {
        "time": t,
        "cmd_x": np.sign(np.sin(t)),
        "cmd_y": np.zeros(1500),
        "cmd_z": 0.5 * np.sin(t),
        "cmd_yaw": np.full(1500, 0.2),
        "x": np.sin(t),
        "y": np.cos(t),
        "z": np.ones(1500),
        "yaw": np.sin(t / 5),
    }
    return log_of(flight={names.get(name, name): values for name, values in plain.items() if names.get(name) != ""})


# What is inside


def test_tables_are_listed_with_columns_counts_rates_and_gaps() -> None:
    found = survey(message_log())

    pose, twist, _ = found.tables
    assert (pose.name, pose.count, pose.time) == ("/vicon/drone/drone", 2000, "header.stamp")
    assert pose.rate is not None
    assert pose.rate.period == pytest.approx(0.01, abs=1e-6)
    assert "transform.rotation.w" in pose.columns
    assert (twist.time, twist.count) == ("log_time", 300)
    assert (found.path, found.format, found.skipped, found.notes) == (
        "flight.bag",
        "csv",
        {"/image": "pixels"},
        ("cut short",),
    )


def test_matrices_are_listed_with_their_shape_and_a_table_without_clock_has_no_rate() -> None:
    found = survey(log_of(only={"SS": np.zeros((6, 50)), "k": np.zeros((1, 1))}))

    assert found.tables[0].columns == ("SS (6 x 50)", "k")
    assert (found.tables[0].count, found.tables[0].time, found.tables[0].rate) == (50, None, None)


def test_a_log_that_no_card_fits_says_how_to_go_on() -> None:
    found = survey(message_log())

    assert (found.card, found.flight, found.fitting) == (None, None, ())
    assert found.problem is not None
    assert "--draft-card" in found.problem


def test_a_log_with_a_card_but_no_flight_says_why() -> None:
    names = ("time", "cmd_linx", "cmd_liny", "cmd_linz", "cmd_angz", "x", "y", "z", "yaw")
    columns = {name: np.zeros(100) for name in names} | {"time": np.arange(100) / 10}

    found = survey(log_of(flight=columns))

    assert found.fitting == ("bebop2-joystick",)
    assert (found.card, found.flight) == (load_card("bebop2-joystick").name, None)
    assert found.problem is not None
    assert "never changes" in found.problem


def test_a_card_that_was_asked_for_must_fit() -> None:
    with pytest.raises(CardError, match="nearest"):
        survey(message_log(), load_card("bebop2"))


def test_rows_without_a_stamp_start_no_stream(tmp_path: Path) -> None:
    log = csv_log()
    log.tables["flight"].columns["time"][[0, 700]] = np.nan

    found = survey(log, loaded(draft_card(csv_log()), tmp_path)).flight

    assert found is not None
    assert found.clocks.start_offset == 0.0
    assert found.clocks.overlap == pytest.approx(29.96)


def test_the_flight_of_a_fitting_card_is_surveyed(tmp_path: Path) -> None:
    log = message_log()
    found = survey(log, loaded(draft_card(log), tmp_path)).flight

    assert found is not None
    assert found.duration == pytest.approx(19.99, abs=0.02)
    assert found.command.period == pytest.approx(1 / 15, rel=1e-4)
    assert found.pose.count == 2000
    assert found.stale_share == 0.0
    assert found.clocks.start_offset == pytest.approx(0.0, abs=1e-6)
    assert list(found.recorder) == ["pose"]
    assert found.recorder["pose"].offset == pytest.approx(0.002)
    assert [axis.axis for axis in found.axes] == ["x", "y", "z", "yaw"]


def test_a_survey_holds_plain_values_only() -> None:
    def check(value: object) -> None:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            for field in dataclasses.fields(value):
                check(getattr(value, field.name))
        elif isinstance(value, dict):
            for one in value.values():
                check(one)
        elif isinstance(value, tuple):
            for one in value:
                check(one)
        else:
            assert value is None or type(value) in (str, int, float, bool), repr(value)
            assert value == value, "NaN"

    check(survey(message_log()))
    check(survey(csv_log(cmd_x="cmd_linx", cmd_y="cmd_liny", cmd_z="cmd_linz", cmd_yaw="cmd_angz")))


# Excitation


def heading_draft(log: Log) -> str:
    """The draft without what the motion says of the frame: this log's commands and motion have nothing in common."""
    return draft_card(log).replace('frame = "world"', 'frame = "heading"')


def test_excitation_weighs_values_by_how_long_they_act(tmp_path: Path) -> None:
    log = csv_log()
    flight = flight_from_log(log, loaded(heading_draft(log), tmp_path))

    x, y, z, yaw = excitation(flight)

    assert (x.low, x.high, x.levels) == (-1.0, 1.0, 3)
    assert x.extreme_share == pytest.approx(1.0, abs=0.01)
    assert x.nonzero_share == pytest.approx(1.0, abs=0.01)
    assert (y.nonzero_share, y.rms, y.extreme_share, y.bandwidth) == (0.0, 0.0, 0.0, None)
    assert z.rms == pytest.approx(0.5 / np.sqrt(2), rel=0.05)
    assert z.bandwidth == pytest.approx(1 / (2 * np.pi), abs=0.05)
    assert (yaw.rms, yaw.bandwidth) == (pytest.approx(0.2), None)
    assert x.bandwidth is not None
    assert x.bandwidth > 3 * z.bandwidth


def test_saturation_is_the_share_of_time_at_the_limits(tmp_path: Path) -> None:
    log = csv_log()
    t = log.tables["flight"].columns["time"]
    clipped = np.clip(2 * np.sin(t), -1, 1)
    log = dataclasses.replace(
        log, tables={"flight": Table("flight", {**log.tables["flight"].columns, "cmd_x": clipped})}
    )

    x = excitation(flight_from_log(log, loaded(heading_draft(log), tmp_path)))[0]

    assert x.extreme_share == pytest.approx(2 / 3, abs=0.03)
    assert x.levels > 100


def test_the_zero_of_a_command_to_one_side_is_no_end(tmp_path: Path) -> None:
    log = csv_log()
    t = log.tables["flight"].columns["time"]
    pushed = np.where((t > 10) & (t < 13), 30.0, 0.0)
    log = dataclasses.replace(
        log, tables={"flight": Table("flight", {**log.tables["flight"].columns, "cmd_x": pushed})}
    )

    x = excitation(flight_from_log(log, loaded(heading_draft(log), tmp_path)))[0]

    assert x.extreme_share == x.nonzero_share == pytest.approx(0.1, abs=0.01)


def test_a_share_that_is_little_is_not_shown_as_nothing() -> None:
    assert [_percent(share) for share in (0.0, 0.002, 0.3, 0.998, 1.0)] == ["0 %", "<1 %", "30 %", ">99 %", "100 %"]


def test_of_a_log_of_many_tables_those_are_shown_that_a_flight_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = message_log()
    more = {f"/sensor{k}": Table(f"/sensor{k}", {"log_time": np.arange(50), "data": np.ones(50)}) for k in range(20)}
    log = dataclasses.replace(log, tables={**log.tables, **more})
    card = loaded(draft_card(log), tmp_path)

    found = survey(log, card)
    show(survey_view(found))
    out = capsys.readouterr().out

    assert {one.name for one in found.tables if one.used} >= {"/vicon/drone/drone", "/drone/cmd_vel"}
    assert len(found.tables) == 23
    assert "/sensor0" not in out
    assert out.index("of flight in 1 segment") < out.index("/drone/cmd_vel: 300 samples")
    assert "more that no flight needs" in out


# Real flights


def test_real_flights_find_their_cards_and_say_what_was_excited(real_flights: Path) -> None:
    found = survey(read(real_flights / "bebop2-optitrack" / "monster_vert_tst.bag"))

    assert found.fitting == ("bebop2-optitrack",)
    assert found.flight is not None
    assert found.flight.stale_share == pytest.approx(0.557, abs=0.001)
    assert found.flight.command.period == pytest.approx(1 / 15, rel=1e-2)
    assert found.flight.clocks.start_offset == pytest.approx(-2.74, abs=0.01)
    assert [axis.axis for axis in found.flight.axes if axis.rms > 0] == ["z"]
    assert abs(found.flight.recorder["pose"].drift) < 1e-4


def test_each_real_set_is_fitted_by_its_own_card_alone(real_flights: Path) -> None:
    for name in ("bebop2-wsu", "bebop2-optitrack", "dji-hexarotor", "bebop2-joystick", "ardrone2-optitrack"):
        path = min(path for path in (real_flights / name).iterdir() if path.suffix != ".toml")
        assert survey(read(path)).fitting == (name,)


def test_a_log_of_thousands_of_columns_is_looked_through_in_seconds() -> None:
    t = np.arange(5.0)
    narrow, wide = (log_of(flight={"time": t, **{f"c{k}": t for k in range(n)}}) for n in (3, 3000))
    survey(narrow)  # compiles

    started = time.process_time()
    found = survey(wide)

    assert time.process_time() - started < 60  # minutes, where time went with the square of the columns
    assert len(found.tables[0].columns) == 3001
    assert found.tables[0].time == "time"
