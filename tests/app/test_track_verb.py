"""`rotorfit track LOG`: the lines that programs read, as they were promised, and one line for each mistake."""

import json
import signal
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import rotorfit.tracking.replayed as replayed
from flights import steps
from logs import Csv
from rotorfit.app.cli import main
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.tracked import Alarm, Regime, Track, Tracked
from rotorfit.files.logs import read
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

pytestmark = pytest.mark.flights

LAW = "first_order_delay"
QUANTITIES = ["input", "damping", "delay", "lag", "zero", "steady_gain", "total_lag"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """12 s; yaw is not moved."""
    flight = simulate_flight(Truth(), steps(("x", "y", "z")), 12.0, seed=6)
    return Csv(flight).write(tmp_path_factory.mktemp("log"))


def lines(*words: str) -> list[dict[str, Any]]:
    """What `--jsonl` prints, line by line."""
    result = CliRunner().invoke(main, ["track", *words, "--jsonl"])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


@pytest.fixture(scope="module")
def told(log: tuple[str, ...]) -> list[dict[str, Any]]:
    return lines(*log, "--structure", LAW)


def test_a_state_comes_once_a_second_and_the_end_is_last(told: list[dict[str, Any]]) -> None:
    assert [line["type"] for line in told] == [*["state"] * (len(told) - 1), "end"]
    assert [line["time"] for line in told[:-2]] == [float(second) for second in range(5, 12)]
    assert told[-1]["time"] == told[-2]["time"] == pytest.approx(12.0, abs=0.2)
    assert told[-1]["alarms"] == 0
    assert told[-1]["regimes"] == [{"start": 0.0, "end": told[-1]["time"], "data": [0.0, told[-1]["time"]]}]
    assert told[-1]["models"] == []
    assert told[-1]["report"] is None


def test_a_state_has_the_promised_keys_and_null_where_nothing_is_known(told: list[dict[str, Any]]) -> None:
    for line in told[:-1]:
        assert list(line)[:4] == ["type", "time", "regime", "axes"]
        assert list(line["axes"]) == list(AXES)
        for axis in line["axes"].values():
            assert list(axis)[:9] == ["state", *QUANTITIES, "ci95"]
            assert {"wind", "wind_ci95"} <= set(axis)
            assert isinstance(axis["state"], str)
            assert all(axis[name] is None or isinstance(axis[name], float) for name in [*QUANTITIES, "wind"])
            assert set(axis["ci95"]) <= set(QUANTITIES)
            for ends in (*axis["ci95"].values(), axis["wind_ci95"]):
                assert len(ends) == 2
                assert all(end is None or isinstance(end, float) for end in ends)
            for name in QUANTITIES:
                if axis[name] is not None and None not in axis["ci95"][name]:
                    assert axis["ci95"][name][0] <= axis[name] <= axis["ci95"][name][1]
    last = told[-2]["axes"]
    assert last["x"]["watched_from"] is None  # 12 s are too short for an alarm
    assert last["x"]["state"] == "known"
    assert last["x"]["lag"] is None  # this law has none
    assert last["yaw"]["state"].startswith("not excited")
    assert {last["yaw"][name] for name in QUANTITIES} == {None}


def faked(monkeypatch: pytest.MonkeyPatch, alarm: Alarm, *revised: Alarm) -> None:
    """A tracker that raises one alarm, and perhaps revises it, whatever flies."""

    def tracked(flight: Flight, _structure: str, _rate: float, on_state: Any, *_others: Any) -> Track:
        states = Tracked(5.0, {}), Tracked(6.0, {}, (alarm,), 1), Tracked(7.0, {}, revised, 1)
        for state in states:
            on_state(state)
        return Track(states, (Regime(0.0, 5.5, None), Regime(5.5, flight.duration, None, (alarm, *revised)[-1])))

    monkeypatch.setattr(replayed, "tracked", tracked)


def test_an_alarm_comes_before_the_state_that_knows_of_it(
    log: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    alarm = Alarm(6.0, ("x", "y"), "limits", (5.2, 5.8), {"x.input": (0.78, 0.86)}, 0.9, 1e-8, "because")
    faked(monkeypatch, alarm)
    page = tmp_path / "track.html"
    told = lines(*log, "-o", str(tmp_path / "model.json"), "--report", str(page))

    assert [line["type"] for line in told] == ["state", "alarm", "state", "state", "end"]
    assert list(told[1])[:7] == ["type", "time", "axes", "cause", "since", "change", "confidence"]
    assert told[1]["axes"] == ["x", "y"]
    assert told[1]["change"] == {"x.input": [0.78, 0.86]}
    assert told[-1]["alarms"] == 1
    assert len(told[-1]["regimes"]) == 2
    assert told[-1]["models"] == []  # both were too short for one
    assert told[-1]["report"] == str(page)
    assert "6.00 s: limits" in page.read_text(encoding="utf-8")


def test_a_revised_alarm_is_one_alarm(log: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    first = Alarm(6.0, ("z",), "other", (5.2, 5.8), {}, 0.5, 1e-8, "because")
    faked(monkeypatch, first, replace(first, time=7.0, axes=("x", "y"), cause="limits", revises=6.0))
    page = tmp_path / "track.html"
    told = lines(*log, "--report", str(page))
    html = page.read_text(encoding="utf-8")

    assert [line["type"] for line in told] == ["state", "alarm", "state", "alarm", "state", "end"]
    assert [line["revises"] for line in told if line["type"] == "alarm"] == [None, 6.0]
    assert told[-1]["alarms"] == 1
    assert html.count('<span class="badge">alarm</span>') == 1
    assert "one alarm, at 6.00 s: limits." in html


@pytest.fixture(scope="module")
def written(log: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path, Path]:
    """What people are told, the model and the page."""
    folder = tmp_path_factory.mktemp("written")
    model, page = folder / "before.json", folder / "track.html"
    words = ["track", *log, "--structure", LAW, "-o", str(model), "--report", str(page)]
    return CliRunner().invoke(main, words), model, page


def test_people_get_words_a_model_and_a_page(written: tuple[Result, Path, Path]) -> None:
    result, model, page = written

    assert result.exit_code == 0, result.output
    assert "x    known: input" in result.stdout
    assert f"Report written to {page}." in result.stdout
    assert f"rotorfit validate {model} NEXT-FLIGHT.csv" in page.read_text(encoding="utf-8")
    assert json.loads(model.read_text(encoding="utf-8"))["axes"]["x"]["input"] > 0


def test_faults_of_the_data_are_told_and_kept_as_by_fit(tmp_path: Path) -> None:
    csv, model = Csv(simulate_flight(Truth(), steps(("x", "y")), 14.0, seed=6)), tmp_path / "model.json"
    csv.command[:, [0, 1]] = csv.command[:, [1, 0]]
    result = CliRunner().invoke(main, ["track", *csv.write(tmp_path), "--structure", LAW, "-o", str(model)])

    assert result.exit_code == 0, result.output
    assert "error axes_exchanged: " in result.stderr
    assert "axes_exchanged" in [one["code"] for one in json.loads(model.read_text(encoding="utf-8"))["findings"]]


def test_after_an_earlier_flight_its_numbers_come_first_and_gains_when_they_have_settled(
    written: tuple[Result, Path, Path], tmp_path: Path
) -> None:
    before, gains = written[1], tmp_path / "gains.toml"
    slow = Csv(simulate_flight(Truth(delay=(0.25,) * 4), steps(("x",)), 16.0, seed=8)).write(tmp_path)
    told = lines(*slow, "--structure", LAW, "--after", str(before), "--tune", str(gains))

    first = told[0]["axes"]["x"]
    assert first["from"] == "before.json"
    assert first["state"].endswith("(until then from before.json)")
    assert first["input"] == json.loads(before.read_text())["axes"]["x"]["input"]
    last = told[-2]["axes"]["x"]
    assert (last["from"], last["state"]) == (None, "known (contradicts before.json: delay)")
    assert last["against_earlier"]["delay"][0] == pytest.approx(0.1, abs=0.02)
    assert {line["cause"] for line in told if line["type"] == "alarm"} == {"another_vehicle"}
    published = [line for line in told if line["type"] == "gains"]
    assert list(published[0])[:4] == ["type", "time", "axes", "why"]
    assert published[0]["file"] == str(gains)
    assert tomllib.loads(gains.read_text())["axes"].keys() == {axis for line in published for axis in line["axes"]}
    assert tomllib.loads(gains.read_text())["axes"]["x"]["delay"] == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["LOG", "--tune", "gains.json"], "gains.json: gains are written as .toml"),
        (["--tune", "LOG"], "give such a name, or put --tune behind the LOG"),
        (["LOG", "--after", "LOG"], "is a log, not a model"),
        (["none.csv"], "none.csv"),
        (["LOG", "--card", "no-such-card"], "no-such-card"),
        (["LOG", "--structure", "best"], "no such structure: 'best'; structures are "),
        (["LOG", "--false-alarms-per-hour", "0"], "0 is not a number from 1e-06 to 60, such as 0.1"),
        (["LOG", "--false-alarms-per-hour", "-1"], "-1 is not a number from 1e-06 to 60, such as 0.1"),
        (["LOG", "--false-alarms-per-hour", "nan"], "nan is not a number from 1e-06 to 60, such as 0.1"),
        (["LOG", "--pace", "0"], "0 is not a number of 0.01 or more, such as 2"),
        (["LOG", "--pace", "inf"], "inf is not a number of 0.01 or more, such as 2"),
        (["LOG", "--for", "10"], "are for a --link; a LOG is a recording already, and LOG@0:60 is a part of it"),
        (["LOG", "--card", "--pace", "2"], "'--card': a value is missing before --pace"),
        (["LOG", "--card", "bebop2", "--card", "tello"], "'--card': 2 cards are given, and one serves all flights"),
        (["LOG", "--card"], "'--card' requires an argument"),
        (["LOG", "--report", "-o", "model.json"], "'--report': a value is missing before -o"),
        (["LOG", "--report", "LOG"], "exists and is a log: not overwritten"),
        (["LOG", "-o", "nowhere/model.json"], "make it first"),
        (["LOG", "-o", "/proc/model.json"], "/proc/model.json: cannot be written"),
        (["LOG", "--report", "track.pdf"], "track.pdf: a report is a page; name it track.html"),
        (["LOG", "--report", "/proc/track.html"], "/proc/track.html: cannot be written"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_tracked(words: list[str], said: str, log: tuple[str, ...]) -> None:
    before = Path(log[0]).read_bytes()
    given = [log[0] if word == "LOG" else word for word in words]
    if "--card" not in given:
        given += log[1:]
    result = CliRunner().invoke(main, ["track", *given])

    assert result.exit_code in (1, 2)
    assert said in result.output
    assert "Traceback" not in result.output
    error = [line for line in result.output.splitlines() if line and not line.startswith(("Usage:", "Try "))]
    assert len(error) == 1
    assert result.stdout == ""
    assert Path(log[0]).read_bytes() == before


def test_ctrl_c_ends_a_log_with_all_that_was_seen_written(log: tuple[str, ...], tmp_path: Path) -> None:
    model, page = tmp_path / "model.json", tmp_path / "track.html"
    words = ["track", *log, "--structure", LAW, "--pace", "3", "-o", str(model), "--report", str(page)]
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-um", "rotorfit", *words], stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        while " x    known" not in process.stdout.readline():  # in which second goes by rounding
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)

    assert process.returncode == 1
    assert "ended by Ctrl-C at" in err
    assert "Aborted" not in err
    assert " unit" in out
    assert f"Model written to {model}." in out
    assert json.loads(model.read_text(encoding="utf-8"))["axes"]["x"]["input"] > 0
    assert page.exists()


@pytest.mark.usefixtures("looks_here")
def test_a_card_that_is_not_the_recordings_own_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record, card = tmp_path / "flight.mcap", tmp_path / "card.toml"
    words = ["track", "--link", "sim", "--for", "6", "--pace", "1000", "--structure", LAW, "--record", str(record)]
    assert CliRunner().invoke(main, words).exit_code == 0
    card.write_text(read(record).attached["card"].replace('name = "', 'name = "Another ', 1), encoding="utf-8")
    faked(monkeypatch, Alarm(6.0, ("x",), "limits", (5.2, 5.8), {}, 0.9, 1e-8, "because"))

    for source in ([str(record)], ["--link", f"replay:{record}", "--pace", "1000"]):
        told = CliRunner().invoke(main, ["track", *source, "--card", str(card), "--structure", LAW])

        assert told.exit_code == 0, told.output
        assert "read with the card Another" in told.stderr
        assert "not with the one that the log carries" in told.stderr
    silent = CliRunner().invoke(main, ["track", str(record), "--structure", LAW])
    assert "the one that the log carries" not in silent.stderr
