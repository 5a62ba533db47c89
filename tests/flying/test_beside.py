"""A tracker beside a flight: it knows the vehicle at the end, is never waited for, and changes nothing that is sent."""

import time
from dataclasses import replace
from pathlib import Path

import pytest

from flying import Watched, plan_of, room_link
from rotorfit.files.logs import read
from rotorfit.flying.beside import ROOM, Beside, title_of, tracked_beside
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.recorder import record


def test_it_follows_the_flight_and_what_is_sent_is_the_same_without_it(tmp_path: Path) -> None:
    plan, sent = replace(plan_of(8.0), rate=50.0), []
    for wanted in (False, True):
        link = Watched(room_link())
        with tracked_beside(plan.card, wanted) as beside:
            fly(plan, link, record(tmp_path / f"{wanted}.mcap", {}, beside), land=False)
        sent.append(link.sent)

    assert sent[0] == sent[1]
    assert beside is not None
    assert beside.lost == 0
    assert beside.words.startswith("x ")


def test_alarms_become_events_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Beside(plan_of().card)
    monkeypatch.setattr(beside, "news", iter([iter(["ALARM x: payload: because"]), *[iter([])] * 99]).__next__)
    recorder = record(tmp_path / "flight.mcap", {}, beside)
    recorder.command(5, (0.1, 0.0, 0.0, 0.0))
    recorder.command(6, (0.1, 0.0, 0.0, 0.0))
    recorder.close()
    beside.close()

    assert [one.text for one in read(tmp_path / "flight.mcap").events] == ["ALARM x: payload: because"]


def test_the_title_of_an_alarm_ends_before_its_reasons() -> None:
    assert title_of("ALARM z: payload: weight against thrust changed: by 0.3 m/s^2") == "ALARM z: payload"


def test_a_tracker_that_is_gone_is_never_waited_for() -> None:
    beside = Beside(plan_of().card)
    beside._process.kill()
    beside._process.wait()
    begun = time.monotonic()
    for number in range(2 * ROOM // 73):
        beside.take("pose", number, number, (0.0,) * 7)

    assert time.monotonic() - begun < 5.0
    assert beside.lost > 0
    beside.close()
