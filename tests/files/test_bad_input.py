"""Bad input on the command line: one line that helps, exit 1, nothing on standard output, nothing written."""

import json
import math
import os
import tomllib
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from rotorfit.app.cli import main
from rotorfit.app.workflows import load_flight
from rotorfit.core.errors import CardError, RotorfitError
from rotorfit.diagnosis.card_choice import proposal
from rotorfit.diagnosis.survey import survey
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import WHOLE, LogSpan
from rotorfit.files.logs import read
from rotorfit.files.plans import load_plan
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight, write_bag
from rotorfit.simulation.vehicle import load_vehicle

COMMANDS = ("cmd_linx", "cmd_liny", "cmd_linz", "cmd_angz")
CARD = """
[command]
time = "time"
x = "cmd_linx"

[pose]
time = "time"
x = "x"
y = "y"
z = "z"
yaw = "yaw"
"""


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def columns(duration: float = 20.0) -> dict[str, np.ndarray]:
    """A flight as the card `bebop2-joystick` has it, with everything in order."""
    t = np.arange(0, duration, 1 / 30)
    u = np.sign(np.sin(t))
    commands = {name: scale * u for name, scale in zip(COMMANDS, (0.1, 0.1, 0.5, 0.5), strict=True)}
    pose = {"x": np.sin(t / 2), "y": np.cos(t / 2), "z": 1 + 0.1 * np.sin(t), "yaw": 0.5 * np.sin(t / 3)}
    return {"time": t, **commands, **pose}


def csv(folder: Path, series: dict[str, np.ndarray]) -> Path:
    path = folder / "flight.csv"
    rows = [",".join(series), *(",".join(map(repr, row)) for row in np.column_stack(list(series.values())).tolist())]
    path.write_text("\n".join(rows) + "\n")
    return path


def changed(folder: Path, **series: object) -> list[object]:
    """The flight with some columns replaced, by a value or by new ones."""
    whole = columns()
    return [
        csv(folder, whole | {name: np.broadcast_to(values, whole["time"].shape) for name, values in series.items()})
    ]


def without(folder: Path, *names: str) -> list[object]:
    return [csv(folder, {name: values for name, values in columns().items() if name not in names})]


def bytes_of(content: bytes, folder: Path) -> list[object]:
    path = folder / "flight.log"
    path.write_bytes(content)
    return [path]


def with_card(card: str, folder: Path) -> list[object]:
    path = folder / "card.toml"
    path.write_text(card)
    return [csv(folder, columns()), "--card", path]


def bag(folder: Path) -> Path:
    path = folder / "flight.bag"
    write_bag(simulate_flight(Truth(), partial(two_sines, axes=("x",)), 6.0, 3), path)
    return path


def bag_with(old: str, new: str, folder: Path) -> list[object]:
    """A simulated bag and its card, in which a name has been changed."""
    text = run("cards", "rotorfit-demo").stdout
    assert old in text
    card = folder / "card.toml"
    card.write_text(text.replace(old, new))
    return [bag(folder), "--card", card]


def start_of_a_bag(folder: Path) -> list[object]:
    path = bag(folder)
    path.write_bytes(path.read_bytes()[:600])
    return [path]


def header_row(folder: Path) -> list[object]:
    return bytes_of(",".join(f"column_{k}" for k in range(100)).encode()[:600], folder)


def short(folder: Path) -> list[object]:
    return [csv(folder, columns(1.0))]


def degrees(folder: Path) -> list[object]:
    t = columns()["time"]
    return changed(folder, yaw=(180 + 60 * t) % 360 - 180)


CASES: dict[str, tuple[Callable[[Path], list[object]], str]] = {
    "missing file": (lambda folder: [folder / "flight.bag"], "no such file; check the path"),
    "folder that is no bag": (lambda folder: [folder], "no ROS 2 bag"),
    "unknown format": (partial(bytes_of, bytes(range(256)) * 8), "of no known format"),
    "empty file": (partial(bytes_of, b""), "the file is empty"),
    "600 bytes of names": (header_row, "a header row and no rows below it"),
    "600 bytes of a bag": (start_of_a_bag, "the bag holds no messages"),
    "table that is not there": (partial(bag_with, "/pose:", "/poses:"), "no table '/poses'; nearest: '/pose'"),
    "column that is not there": (
        partial(with_card, CARD.replace('"cmd_linx"', '"cmd_lin_x"')),
        "no column 'cmd_lin_x' in 'flight'; nearest: 'cmd_linx'",
    ),
    "card with an unknown key": (
        partial(with_card, CARD + "\n[limits]\ntilr = 0.2\n"),
        "unknown key 'tilr'; nearest: 'tilt'",
    ),
    "card that is no TOML": (partial(with_card, "name = "), "not readable as TOML"),
    "card that does not exist": (
        lambda folder: [csv(folder, columns()), "--card", "bebop3"],
        "no card 'bebop3'",
    ),
    "no card fits": (
        partial(without, names="x") if False else lambda folder: without(folder, "x"),
        "--draft-card FILE",
    ),
    "pose without commands": (
        lambda folder: [*without(folder, *COMMANDS), "--card", "bebop2-joystick"],
        "no column 'cmd_lin",
    ),
    "commands that are never numbers": (
        lambda folder: changed(folder, **dict.fromkeys(COMMANDS, np.nan)),
        "no command is complete",
    ),
    "commands without pose": (
        lambda folder: [*without(folder, "x", "y", "z", "yaw"), "--card", "bebop2-joystick"],
        "no column 'x'",
    ),
    "pose that is never a number": (
        lambda folder: changed(folder, x=np.nan),
        "no pose is complete (x always missing)",
    ),
    "constant pose": (lambda folder: changed(folder, x=1.0, y=2.0, z=3.0, yaw=0.0), "the pose never changes"),
    "NaN everywhere": (
        lambda folder: changed(folder, **dict.fromkeys(columns(), np.nan)),
        "no command is complete",
    ),
    "reversed time": (lambda folder: changed(folder, time=columns()["time"][::-1]), "runs backwards"),
    "time that stands still": (lambda folder: changed(folder, time=5.0), "stands still"),
    "one second": (short, "at least 2 s are needed"),
    "degrees for radians": (degrees, 'degrees taken for radians? Write yaw = { from = "yaw", unit = "deg" }'),
    "span outside the flight": (
        lambda folder: [csv(folder, columns()), "--span", "100:200"],
        "span 100:200 holds nothing of the common window",
    ),
    "malformed span behind the log": (
        lambda folder: [f"{csv(folder, columns())}@9:5"],
        "ends before it starts",
    ),
}


def check_refused(result: Result, message: str) -> None:
    """One line on standard error that holds the message, and nothing on standard output."""
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit)
    assert result.stdout == ""
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    assert result.stderr.endswith("\n")
    assert message in result.stderr


@pytest.mark.parametrize("case", CASES)
def test_a_fit_refuses_in_one_line_and_writes_nothing(case: str, tmp_path: Path) -> None:
    make, message = CASES[case]
    arguments, output = make(tmp_path), tmp_path / "model.json"

    check_refused(run("fit", *arguments, "--json", "-o", output), message)
    check_refused(run("fit", *arguments), message)
    assert not output.exists()


@pytest.mark.parametrize("case", ["missing file", "empty file", "constant pose", "reversed time", "one second"])
def test_the_second_of_two_logs_is_checked_like_the_first(case: str, tmp_path: Path) -> None:
    make, message = CASES[case]
    (tmp_path / "good").mkdir()

    check_refused(run("fit", csv(tmp_path / "good", columns()), *make(tmp_path), "--json"), message)


@pytest.mark.parametrize(
    "case", ["missing file", "unknown format", "empty file", "600 bytes of names", "600 bytes of a bag"]
)
def test_info_refuses_what_it_cannot_read(case: str, tmp_path: Path) -> None:
    make, message = CASES[case]

    check_refused(run("info", *make(tmp_path), "--json"), message)


@pytest.mark.parametrize(
    "case", ["constant pose", "reversed time", "one second", "degrees for radians", "NaN everywhere"]
)
def test_info_of_a_log_without_a_usable_flight_says_why(case: str, tmp_path: Path) -> None:
    make, message = CASES[case]

    result = run("info", *make(tmp_path), "--json")

    assert (result.exit_code, result.stderr) == (0, "")
    (log,) = json.loads(result.stdout)["logs"]
    assert log["flight"] is None
    assert message in log["problem"] or message in log["path"]


def test_the_600_bytes_of_format_records_are_refused(real_flights: Path) -> None:
    path = real_flights / "arducopter" / "format-only_600_bytes.bin"

    check_refused(run("info", path), "defines 5 messages and holds none of them")
    check_refused(run("fit", path, "--json"), "defines 5 messages and holds none of them")


# Names and texts from strangers

STRANGE = (
    *("bell\x07", "delete\x7f", "escape\x1b[31m", "zero\x00", "line\nbreak", "next\x85line", "\u2028", "\u202eleft"),
    '"]',
)


def test_a_draft_of_a_log_with_strange_names_loads_as_a_card(tmp_path: Path) -> None:
    log, card = tmp_path / "flight.parquet", tmp_path / "card.toml"
    known = columns()
    x = known.pop("x")
    strange = {f"{name}{end}": values for name in STRANGE for end, values in (("", x), ("2", np.zeros(600)))}
    pl.DataFrame(known | strange).write_parquet(log)

    told, drafted = run("info", log), run("info", log, "--draft-card", card, "--fresh")

    assert (told.exit_code, drafted.exit_code) == (0, 0)
    assert all(character.isprintable() for line in told.stdout.split("\n") for character in line)
    raw = tomllib.loads(card.read_text(encoding="utf-8").replace('# x = "TABLE:COLUMN"', 'x = "TABLE:COLUMN"'))
    assert raw["pose"]["x"] == "TABLE:COLUMN"
    recorded = read(log)
    for name in STRANGE:
        raw["pose"]["x"] = name
        flight = load_flight(LogSpan(str(log), WHOLE), card_from_mapping(raw, "mended"), recorded)
        np.testing.assert_allclose(np.ptp(flight.position[:, 0]), np.ptp(x), rtol=0.01)


def test_a_file_whose_name_is_no_text_is_read_and_named(tmp_path: Path) -> None:
    log, model, card = (tmp_path / os.fsdecode(name) for name in (b"\xff\n\x1b[31m.csv", b"\xff.json", b"\xff.toml"))
    csv(tmp_path, columns()).rename(log)

    for arguments in (
        ["info", log],
        ["info", log, "--json"],
        ["info", log, "--draft-card", card, "--fresh"],
        ["fit", log, "--method", "paper", "-o", model],
        ["fit", log, "--method", "paper", "--json"],
        ["validate", model, log],
    ):
        result = run(*arguments)
        assert result.exit_code == 0, result.output
        assert "\x1b" not in result.output
    check_refused(run("info", f"{log}x"), "\\x1b[31m.csvx: no such file")


DEEP = {
    "3,000 dots": "a." * 3000 + "a = 1",
    "brackets": "[command]\nx = " + "[" * 5000 + "]" * 5000,
    "5,000 digits": CARD.replace('x = "cmd_linx"', "x = " + "9" * 5000),
    "400 digits": CARD.replace('x = "cmd_linx"', "x = " + "9" * 400),
    "a name of a page": "a" * 5000 + " = 1",
    "a value of a page": 'frame = "' + "x" * 100_000 + '"\n' + CARD,
    "names that are no list": "over = 5\n" + CARD,
}


@pytest.mark.parametrize("case", DEEP)
def test_a_text_that_no_card_is_ends_in_one_line_wherever_it_stands(case: str, tmp_path: Path) -> None:
    text, log = DEEP[case], csv(tmp_path, columns())
    file = tmp_path / "card.toml"
    file.write_text(text)
    carrying = replace(read(log), attached={"card": text, "plan": text})

    refused = [run("fit", log, "--card", file), run("info", log, "--card", file)]
    for result in refused:
        check_refused(result, "card")
        assert len(result.stderr) < 2100
    with pytest.raises(CardError):
        proposal(carrying)
    assert survey(carrying).flight is None
    for load in (load_plan, load_vehicle):
        with pytest.raises(RotorfitError):
            load(str(file))


def test_any_value_in_the_place_of_any_other_of_a_card_is_one_line() -> None:
    whole = tomllib.loads((Path(__file__).parent / "version_0_1" / "card-complete.toml").read_text())
    strange: list[Any] = [None, True, -1, 1e308, math.nan, "", "a\0b", [], [[]], [{}], {}, {"a": {}}, {"from": []}]
    strange += [date(2020, 1, 1), "é" * 300]
    count = 0
    for place in places(whole):
        for value in strange:
            raw = deepcopy(whole)
            at: Any = raw
            for key in place[:-1]:
                at = at[key]
            at[place[-1]] = value
            try:
                card_from_mapping(raw, "changed")
            except CardError:
                count += 1
    assert count > 300


def places(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where a value stands in sections and lists."""
    for key, part in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*place, key)
        if isinstance(part, dict | list):
            yield from places(part, (*place, key))


# Models


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("", "not a model file"),
        ("{", "not a model file"),
        ('{"format": "rotorfit-model", "ver', "a model file that is cut short or damaged"),
        ("[1, 2]", "not a rotorfit model"),
        ('{"format": "rotorfit-model", "version": 2}', "model version 2"),
        ('{"format": "rotorfit-model", "version": 1}', "damaged model file"),
    ],
)
@pytest.mark.parametrize("verb", ["validate", "report"])
def test_what_is_no_model_is_refused(verb: str, content: str | None, message: str, tmp_path: Path) -> None:
    model, page = tmp_path / "model.json", tmp_path / "report.html"
    if content is not None:
        model.write_text(content)

    more = ["-o", page] if verb == "report" else []
    check_refused(run(verb, model, csv(tmp_path, columns()), *more, "--json"), message)
    assert not page.exists()


def test_a_log_in_the_place_of_the_model_is_refused(tmp_path: Path) -> None:
    log = csv(tmp_path, columns())

    check_refused(run("validate", log, log), "is a log, not a model")
    check_refused(run("compare", log, log), "no model among")


def test_a_comparison_without_a_log_is_refused(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    assert run("fit", csv(tmp_path, columns()), "--method", "paper", "-o", model).exit_code == 0

    check_refused(run("compare", model, "--json"), "give at least one log")


def test_a_validation_refuses_a_bad_log(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    assert run("fit", csv(tmp_path, columns()), "--method", "paper", "-o", model).exit_code == 0

    check_refused(run("validate", model, *changed(tmp_path, yaw=np.nan), "--json"), "yaw always missing")
    check_refused(run("validate", model, tmp_path / "none.csv"), "no such file")


# Destinations


def test_nothing_is_written_over_a_log(tmp_path: Path) -> None:
    log = csv(tmp_path, columns())
    before = log.read_bytes()

    check_refused(run("fit", log, "--method", "paper", "-o", log, "--json"), "not overwritten")
    check_refused(run("report", log, log, "-o", log), "not overwritten")
    check_refused(run("info", log, "--draft-card", log), "not overwritten")
    assert log.read_bytes() == before


def test_a_folder_that_is_not_there_is_noticed_before_the_work(tmp_path: Path) -> None:
    output = tmp_path / "none" / "model.json"

    check_refused(run("fit", "missing.bag", "-o", output), f"there is no folder {output.parent}")


def test_a_demo_folder_that_is_a_file_is_wrong_usage(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("text")

    assert run("demo", path).exit_code == 2
    assert path.read_text() == "text"


def test_a_file_that_may_not_be_read_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def locked(path: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    log = csv(tmp_path, columns())
    monkeypatch.setattr(Path, "open", locked)

    check_refused(run("info", log), "Permission denied")
    check_refused(run("compare", log, log), "Permission denied; check the path")


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    arguments = ["fit", csv(tmp_path, columns()), "--method", "paper", "-o", tmp_path / "model.json", "--json"]
    monkeypatch.setattr(os, "fsync", full)

    check_refused(run(*arguments), "No space left on device")


# Usage and bugs


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["fit"],
        ["validate", "model.json"],
        ["report", "model.json", "flight.bag"],
        ["fit", "flight.bag", "--colour"],
        ["fit", "flight.bag", "--method", "magic"],
        ["fit", "flight.bag", "--axes", "x,w"],
        ["fit", "flight.bag", "--axes", ""],
        ["fit", "flight.bag", "--span", "10"],
        ["fit", "flight.bag", "--span", "20:10"],
        ["fit", "flight.bag", "--span", "a:b"],
        ["validate", "model.json", "flight.bag", "--horizons", "1,-2"],
        ["validate", "model.json", "flight.bag", "--horizons", "soon"],
        ["validate", "model.json", "flight.bag", "--horizons", "inf"],
        ["info", "a.bag", "b.bag", "--draft-card", "card.toml"],
        ["cards", "one", "two"],
        ["plan", "--card", "bebop2", "--duration", "nan"],
        ["plan", "--card", "bebop2", "--duration", "1e9"],
        ["tune", "model.json", "--seed", "-5"],
        ["fly", "plan.toml", "--link", "sim", "-o", "flight.mcap", "--seed", "-5"],
        ["fit", "flight.bag", "--card", "--json"],
        ["fit", "flight.bag", "-o", "--json"],
    ],
)
def test_wrong_usage_ends_with_2(arguments: list[str]) -> None:
    result = run(*arguments)

    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Usage: " in result.stderr


def test_a_bug_keeps_its_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("rotorfit.app.workflows.fit", broken)

    result = run("fit", csv(tmp_path, columns()))

    assert isinstance(result.exception, ZeroDivisionError)
