"""Files of one flight: joined by a plus, or because only together they hold what the card names."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flights import steps
from rotorfit.app.cli import main
from rotorfit.app.workflows import fit_logs, training_flights
from rotorfit.core.errors import CardError, LogError
from rotorfit.core.log import Log
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import parse_log
from rotorfit.files.logs import read
from rotorfit.files.logs.several import join_logs, parts_of
from rotorfit.files.models import load
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.several_files import bound, flights_of
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight
from twin_logs import RAW, Skew, card_of, in_two_files, log_of, written

pytestmark = pytest.mark.flights

COMMAND = {"t": np.arange(3.0), "u_x": np.ones(3), "u_y": np.ones(3), "u_z": np.ones(3), "u_yaw": np.ones(3)}
POSE = {"t": np.arange(4.0), "x": np.ones(4), "y": np.ones(4), "z": np.ones(4), "yaw": np.ones(4)}
RAW_COMMAND = {"time": "own:t", "x": "u_x", "y": "u_y", "z": "u_z"}
RAW_POSE = {"time": "mocap:t"} | {axis: axis for axis in ("x", "y", "z", "yaw")}
CARD = card_from_mapping(RAW, "test")
LAW = "first_order_delay"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], str]:
    """A flight in three CSV files, and its card."""
    folder = tmp_path_factory.mktemp("files")
    flight = simulate_flight(Truth(), steps(seed=1), 10.0, 1)
    paths = written(folder, in_two_files(flight, Skew(0.25)))
    card = folder / "card.toml"
    card.write_text(
        '[command]\ntime = "t"\nx = "u_x"\ny = "u_y"\nz = "u_z"\nyaw = "u_yaw"\n'
        '[pose]\ntime = "t"\nx = "x"\ny = "y"\nz = "z"\nyaw = "yaw"\n'
    )
    return paths, str(card)


@pytest.fixture(scope="module")
def apart(files: tuple[list[str], str]) -> Path:
    """A model of yaw from commands and poses, given to the command line as two logs."""
    (commands, _, mocap), card = files
    model = Path(card).with_name("model.json")
    words = ["fit", commands, mocap, "--card", card, "--axes", "yaw", "--structure", LAW, "-o", str(model)]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    return model


def test_a_plus_joins_and_a_file_of_that_name_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "b.csv"):
        Path(name).write_text("t,v\n0,1\n1,2\n")

    log = read("a.csv+b.csv")
    assert (str(log.path), log.format, list(log.tables)) == ("a.csv+b.csv", "csv+csv", ["a", "b"])
    assert log.sha256 == "+".join(read(name).sha256 for name in ("a.csv", "b.csv"))
    assert log.file_of == {"a": "a.csv", "b": "b.csv"}
    assert parse_log("a.csv+b.csv@1:2").path == "a.csv+b.csv"
    with pytest.raises(LogError, match=r"^c.csv: no such file"):
        read("a.csv+c.csv")
    Path("a.csv+b.csv").write_text("t,w\n0,1\n1,2\n")
    assert list(read("a.csv+b.csv").tables) == ["a.csv+b"]
    assert parts_of("a+") == ("a+",)


def test_tables_of_one_name_are_told_apart_by_their_files() -> None:
    log = join_logs([log_of("one.bag", {"/cmd": COMMAND, "/tf": POSE}), log_of("two.bag", {"/tf": POSE})])

    assert list(log.tables) == ["/cmd", "one/tf", "two/tf"]
    assert {name: table.name for name, table in log.tables.items()} == {name: name for name in log.tables}
    assert set(log.file_of.values()) == {"one.bag", "two.bag"}
    assert log.notes == ("in more than one file, so a card must say from which: one/tf, two/tf",)


def test_files_of_a_recorder_that_follow_each_other_are_one_recording() -> None:
    def part(name: str, start: int, **more: dict) -> Log:
        cmd, pose = ({"log_time": start + np.arange(len(table["t"]))} | table for table in (COMMAND, POSE))
        return log_of(name, {"/cmd": cmd, "/pose": pose} | more)

    first, second = part("a_0.bag", 0), part("a_1.bag", 10, **{"/late": {"log_time": np.array([12])}})

    log = join_logs([first, second])

    assert list(log.tables) == ["/cmd", "/pose", "/late"]
    assert log.tables["/pose"].columns["log_time"].tolist() == [0, 1, 2, 3, 10, 11, 12, 13]
    assert (log.format, log.file_of) == (first.format, {})
    assert log.notes == ("one recording in 2 files that follow each other: a_0.bag, a_1.bag",)
    at_once = join_logs([first, part("b.bag", 1)])
    assert list(at_once.tables) == ["a_0/cmd", "a_0/pose", "b/cmd", "b/pose"]
    late = [{"/late": {"log_time": np.array([start]), field: np.ones(1)}} for start, field in ((2, "v"), (22, "w"))]
    others = join_logs([part("a.bag", 0, **late[0]), part("b.bag", 10), part("c.bag", 20, **late[1])])
    assert "a/late" in others.tables  # another topic of the same name


def test_a_card_may_name_the_same_column_in_two_files() -> None:
    log = join_logs([log_of("c.csv", {"c": COMMAND}), log_of("m.csv", {"m": POSE})])
    card = bound(CARD, log)

    assert (card.command_time.source, card.pose_time.source) == ("c:t", "m:t")
    assert {channel.source for channel in card.pose.values()} == {"m:x", "m:y", "m:z", "m:yaw"}
    assert card.raw is CARD.raw
    assert bound(CARD, log_of("c.csv", {"c": COMMAND})) == CARD


def test_logs_that_only_together_hold_what_the_card_names_are_one_flight() -> None:
    command, pose = log_of("c.csv", {"c": COMMAND}), log_of("m.csv", {"m": POSE})
    whole = log_of("w.bag", {"c": COMMAND, "m": POSE})
    pose_columns = {key: f"m:{name}" for key, name in RAW["pose"].items()}
    card = card_from_mapping({"command": {"time": "c:t", "x": "c:u_x"}, "pose": pose_columns}, "test")

    assert [(place, str(log.path)) for place, log in flights_of([pose, command], CARD)] == [(0, "m.csv+c.csv")]
    assert "taken as one flight" in flights_of([pose, command], CARD)[0][1].notes[0]
    found = flights_of([command, whole, pose], card)
    assert [(place, str(log.path)) for place, log in found] == [(0, "c.csv+m.csv"), (1, "w.bag")]
    assert [log for _, log in flights_of([command, pose], None)] == [command, pose]


def test_logs_that_cannot_be_told_apart_are_an_error_that_offers_a_plus() -> None:
    logs = [log_of(f"{n}.csv", {n: COMMAND if n[0] == "c" else POSE}) for n in ("c1", "m1", "c2", "m2")]
    with pytest.raises(CardError, match=r"by a plus, as c1.csv\+m1.csv"):
        flights_of(logs, CARD)


def test_logs_that_lack_a_column_even_together_stay_apart() -> None:
    logs = [log_of("a.csv", {"a": COMMAND}), log_of("b.csv", {"b": COMMAND})]
    assert [log for _, log in flights_of(logs, CARD)] == logs


def test_fit_takes_two_files_as_one_flight_and_the_model_finds_them_again(
    files: tuple[list[str], str], apart: Path
) -> None:
    (commands, odometry, mocap), card = files
    model = load(apart)
    text = Path(card).read_text() + '[velocity]\nframe = "heading"\ntime = "odometry:t"\nx = "v_x"\nyaw = "r"\n'
    Path(card).with_name("more.toml").write_text(text)
    path = f"{commands}+{odometry}+{mocap}"
    told = fit_logs([parse_log(path)], str(Path(card).with_name("more.toml")), axes=("yaw",), structure=LAW).model

    assert model.flights[0].path == f"{commands}+{mocap}"
    assert any("taken as one flight" in note.text for note in model.flights[0].notes)
    found = {finding.code for finding in model.findings}
    assert "clock_includes_delay" in found
    assert "delay_not_identifiable" not in found
    low, high = model.axes["yaw"].combinations["offset_plus_delay"].ci95
    assert low is not None
    assert high is not None
    assert high - low < 0.1
    assert model.axes["yaw"].delay is None
    assert told.flights[0].path == path
    flights, left_out = training_flights(told)
    assert [flight.path for flight in flights] == [path]
    assert left_out == ()


@pytest.mark.parametrize("kind", ["csv", "ulog"])
def test_rows_without_commands_are_of_another_stream_in_a_file_of_rows_and_end_a_command_in_messages(
    kind: str,
) -> None:
    """The vehicle's velocity comes thrice as often as the commands, in the same table."""
    t = np.arange(3000) / 150
    commanded = np.arange(3000) % 3 == 1
    own = {"t": t, "v": np.cos(t)} | {f"u_{axis}": np.where(commanded, np.sin(t), np.nan) for axis in ("x", "y", "z")}
    seen = {"t": t, **{axis: np.sin(t) for axis in ("x", "y", "z", "yaw")}}
    both = log_of("a+b", {"own": own, "mocap": seen})
    log = replace(both, format=f"{kind}+csv", file_of={"own": "a", "mocap": "b"})

    flight = flight_from_log(log, bound(card_of(velocity=False, command=RAW_COMMAND, pose=RAW_POSE, clock="one"), log))

    assert len(flight.segments) == (1 if kind == "csv" else 1000)
    assert {note.code: note.count for note in flight.notes}["nan_commands"] == 2000


def test_info_shows_two_files_as_one_flight(files: tuple[list[str], str]) -> None:
    (commands, _, mocap), card = files
    for logs in ([f"{commands}+{mocap}"], [commands, mocap]):
        result = CliRunner().invoke(main, ["info", *logs, "--card", card, "--json"])
        assert result.exit_code == 0, result.output
        (log,) = json.loads(result.stdout)["logs"]
        assert log["path"] == f"{commands}+{mocap}"
        assert any(note["code"] == "clocks" for note in log["flight"]["notes"])


def test_without_a_card_info_and_fit_say_to_join_commands_and_poses_by_a_plus(files: tuple[list[str], str]) -> None:
    (commands, _, mocap), _ = files
    for words in (["info", commands, mocap], ["fit", mocap, commands]):
        said = " ".join(CliRunner().invoke(main, words).output.split())
        assert f"rotorfit info {commands}+{mocap} --draft-card FILE" in said.replace(" +", "+")


def test_onboard_motion_in_a_third_file_is_on_no_known_clock() -> None:
    vehicle, room = in_two_files(simulate_flight(Truth(), steps(seed=1), 14.0, 1), Skew(0.25))
    third = log_of("odometry.csv", {"odometry": vehicle.tables["odometry"].columns})
    first = log_of("commands.csv", {"commands": vehicle.tables["commands"].columns})

    clocks = flight_from_log(join_logs([first, third, room]), card_of()).clocks
    assert clocks is not None
    assert clocks.includes_delay


def test_fit_and_report_show_a_flight_whose_clocks_hold_the_delay(
    files: tuple[list[str], str], apart: Path, tmp_path: Path
) -> None:
    (commands, _, mocap), _ = files
    page = tmp_path / "report.html"

    result = CliRunner().invoke(main, ["report", str(apart), f"{commands}+{mocap}", "-o", str(page)])

    assert result.exit_code == 0, result.output
    assert "offset and delay together" in page.read_text()
