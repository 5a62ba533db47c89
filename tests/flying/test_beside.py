"""A tracker beside a flight: it knows the vehicle at the end, is never waited for, and changes nothing that is sent."""

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from flying import CARD, Watched, plan_of, room_link
from models import model_of
from rotorfit.app.cli import main
from rotorfit.app.cli.flying import _check_tracking, _show_last
from rotorfit.app.live.beside import FAR, asked_of, tracked_beside
from rotorfit.core.log import Sample
from rotorfit.exports.gains import read_gains
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs import read
from rotorfit.files.models import save
from rotorfit.files.plans import save_plan
from rotorfit.flying.beside import RECORD, ROOM, STREAMS, Beside, title_of
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.recorder import record


def rotorfit(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture
def echo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module in the place of the tracker's, which takes seconds to start: at the end it tells what it heard."""
    text = """
import json, sys
from rotorfit.flying.beside import RECORD
data = sys.stdin.buffer.read().split(b"\\n", 1)[1]
heard = [RECORD.unpack_from(data, at) for at in range(0, len(data), RECORD.size)]
print(json.dumps({"time": 0.0, "words": "", "summary": json.dumps(heard), "alarms": [], "lines": []}))
"""
    (tmp_path / "echo_of_samples.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    return "echo_of_samples"


def test_it_follows_the_flight_and_what_is_sent_is_the_same_without_it(tmp_path: Path) -> None:
    plan, sent = replace(plan_of(6.0), rate=50.0), []
    for wanted in (False, True):
        link = Watched(room_link())
        with tracked_beside(asked_of(plan.card) if wanted else None) as beside:
            fly(plan, link, record(tmp_path / f"{wanted}.mcap", {}, beside), land=False)
        sent.append(link.sent)

    assert sent[0] == sent[1]
    assert beside is not None
    assert beside.lost == 0
    assert beside.words.startswith("x ")


def test_alarms_become_events_of_the_recording(echo: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Beside(echo, {})
    monkeypatch.setattr(beside, "news", iter([iter(["ALARM x: payload: because"]), *[iter([])] * 99]).__next__)
    recorder = record(tmp_path / "flight.mcap", {}, beside)
    recorder.command(5, (0.1, 0.0, 0.0, 0.0))
    recorder.command(6, (0.1, 0.0, 0.0, 0.0))
    recorder.close()
    beside.close()

    assert [one.text for one in read(tmp_path / "flight.mcap").events] == ["ALARM x: payload: because"]


def test_the_title_of_an_alarm_ends_before_its_reasons() -> None:
    assert title_of("9.0 s  ALARM z: payload: weight against thrust changed: by 0.3 m/s^2") == "9.0 s  ALARM z: payload"


def test_a_tracker_that_is_gone_is_never_waited_for() -> None:
    beside = Beside(FAR, asked_of(plan_of().card))
    beside._process.kill()
    beside._process.wait()
    begun = time.monotonic()
    for number in range(2 * ROOM // RECORD.size):
        beside.take(Sample("pose", number, number, (0.0,) * 7))

    assert time.monotonic() - begun < 5.0
    assert beside.lost > 0
    beside.close()


def test_samples_arrive_with_the_errors_of_their_stamps(echo: str) -> None:
    beside = Beside(echo, {}, paced=True)
    beside.take(Sample("pose", 1, 2, (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0), error=0.03))
    beside.take(Sample("obeys", 3, 4, (1.0,)))
    beside.close()

    assert [one[1:4] for one in json.loads(beside.summary)] == [[1, 2, 0.03], [3, 4, 0.0]]


def test_the_tracker_ends_without_a_trace_where_nobody_reads_it_any_more() -> None:
    far = subprocess.Popen(
        [sys.executable, "-m", FAR], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert far.stdout
    far.stdout.close()
    samples = [
        RECORD.pack(STREAMS.index(name), n * 20_000_000, n * 20_000_000, 0.0, *values)
        for n in range(1, 400)
        for name, values in (("pose", (0.001 * n, 0, 1, 0, 0, 0, 1)), ("command", (0.1, *[0] * 6)))
    ]
    first = json.dumps(asked_of(plan_of().card)).encode() + b"\n"
    said = far.communicate(first + b"".join(samples), timeout=60)[1]

    assert far.returncode == 0, said.decode()
    assert b"Traceback" not in said
    assert b"Broken pipe" not in said


def test_the_end_of_a_simulated_flight_is_that_of_track_and_has_every_alarm_and_gain(tmp_path: Path) -> None:
    """Simulated time waits for the tracker, so that it has seen all of the flight."""
    plan, output, gains, model = (tmp_path / one for one in ("plan.toml", "flight.mcap", "gains.toml", "model.json"))
    save_plan(plan_of(16.0), plan)
    save(model_of({"x": (9.0, 0.4, 0.4)}, CARD), model)
    words = ("fly", plan, "--link", "sim", "--seed", 3, "-o", output, "--track", "--after", model, "--tune", gains)
    result = rotorfit(*words)

    assert result.exit_code == 0, result.output
    assert re.search(r"At (?:1[6-9]|2[01])\.\d s, 95 % intervals of the vehicle as it flew:", result.stderr)
    assert "x against the earlier model: " in result.stderr
    assert f" They are in {gains}." in result.stderr
    assert re.search(r"^\d+\.\d\d s  ALARM x: another vehicle: .*; x \w+.* times .* to ", result.stderr, re.MULTILINE)
    assert any(" s  ALARM x: another vehicle: " in one.text for one in read(output).events)
    held = read_gains(gains)
    assert held["model"]["flights"][0]["path"] == str(output)
    assert held["axes"]
    for axis in held["axes"]:
        assert re.search(rf"^\d+\.\d s  GAINS {axis}: bandwidth ", result.stderr, re.MULTILINE)


def test_a_tracker_that_takes_too_long_is_told_by_the_second_that_it_had_reached(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rotorfit.flying.beside.PATIENCE", 0.0)
    beside = Beside(FAR, asked_of(plan_of().card))
    beside.close()
    _show_last(beside)

    assert "tracker: ended before its last fit; it had told nothing yet" in capsys.readouterr().err


def test_a_model_of_another_card_is_told_and_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    another = f"model.json is of another card, Tello, than the flight, {CARD.name}\n"
    for name, told in ((CARD.name, ""), ("Tello", another)):
        save(model_of(card=card_from_mapping({**CARD.raw, "name": name}, "here")), tmp_path / "model.json")
        _check_tracking(CARD.raw, tmp_path / "model.json", None)
        assert capsys.readouterr().err == told


def test_what_the_tracker_could_not_use_is_refused_before_the_flight(tmp_path: Path) -> None:
    plan, taken = tmp_path / "plan.toml", tmp_path / "taken.toml"
    save_plan(plan_of(8.0), plan)
    taken.write_text("what = 'something else'\n")
    for words, said in (
        (("--after", plan), "--after and --tune are for --track"),
        (("--track", "--after", plan), "is a plan, not a model"),
        (("--track", "--tune", taken), "taken.toml"),
    ):
        result = rotorfit("fly", plan, "--link", "sim", "-o", tmp_path / "flight.mcap", *words)
        assert result.exit_code != 0
        assert said in result.stderr
        assert not (tmp_path / "flight.mcap").exists()
    assert taken.read_text() == "what = 'something else'\n"
