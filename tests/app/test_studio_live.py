"""The studio follows a vehicle: states reach its live page, the recording becomes a log, and mistakes are one line."""

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

from rotorfit.app.loopback.gate import FRAMED
from rotorfit.app.web import following
from rotorfit.app.web.routes import Studio
from rotorfit.core.log import Sample
from rotorfit.flying.recorder import record
from studio_room import client_of, opened, session_of

SIM = {"link": "sim,gusts=0.2", "card": ""}


@pytest.fixture
def one_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vehicles are followed under one law: the average of several takes most of the time, and is not what is proved."""

    def started(words: list[str], **options: Any) -> subprocess.Popen[str]:
        return subprocess.Popen([*words, "--structure", "first_order_delay"], **options)

    monkeypatch.setattr(following, "subprocess", SimpleNamespace(**{**vars(subprocess), "Popen": started}))


def until(found: Callable[[], Any], seconds: float = 120.0) -> Any:
    end = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < end
        time.sleep(0.1)
    return value


@pytest.mark.usefixtures("one_law")
def test_a_simulated_vehicle_is_followed_and_becomes_a_log(studio: Studio, page: TestClient) -> None:
    assert session_of(page)["live"] is None
    assert page.post("/api/live", json=SIM).status_code == 200
    assert session_of(page)["live"]["running"]
    assert page.post("/api/live", json=SIM).status_code == 409
    until(lambda: studio.follower.feed._count)
    assert page.request("DELETE", "/api/live", json={}).status_code == 200
    until(lambda: not session_of(page)["live"]["running"])

    events = page.get("/live/events").text.splitlines()  # ends, because nothing more will come
    states = [json.loads(line.removeprefix("data: ")) for line in events if line.startswith("data: {")]
    assert f'data: "{SIM["link"]}"' in events
    assert {state["type"] for state in states} == {"state"}
    assert set(states[-1]["axes"]) == {"x", "y", "z", "yaw"}
    assert events[-2] == "data: over"
    said = session_of(page)["live"]["said"]
    assert any("the simulated pilot" in line for line in said)
    assert any("ended on this page" in line for line in said)
    assert [log["name"] for log in session_of(page)["uploads"]] == ["live-1.mcap"]


def heard(path: Path) -> None:
    """A recording as a tracker leaves it that was killed while it listened."""
    recorder = record(path, {})
    for n in range(100):
        stamp = 20_000_000 * n
        recorder.command(stamp, (0.1, 0, 0, 0))
        recorder.sample(Sample("pose", stamp, stamp, (0.01 * n, 0, 1, 1, 0, 0, 0)))
    recorder.close()
    path.write_bytes(path.read_bytes()[:-50])


@pytest.mark.usefixtures("one_law")
def test_a_recording_outlives_a_studio_that_is_closed_while_it_follows(tmp_path: Path) -> None:
    with opened(tmp_path / "room") as studio:
        assert client_of(studio).post("/api/live", json=SIM).status_code == 200
        until(lambda: studio.follower.feed._count)
    with opened(tmp_path / "room") as studio:
        (log,) = session_of(client_of(studio))["uploads"]
        assert client_of(studio).get(f"/api/logs/{log['id']}").status_code == 200
        assert studio.workspace.recordings() == []


def test_a_studio_takes_in_what_a_killed_one_recorded_and_sets_aside_what_cannot_be_read(tmp_path: Path) -> None:
    with opened(tmp_path / "room") as studio:
        heard(studio.workspace.recording())
        studio.workspace.recording().write_bytes(b"\x89MCAP0\r\n")
    for told in (True, False):
        with opened(tmp_path / "room") as studio:
            now = session_of(client_of(studio))
            assert [one["name"] for one in now["uploads"]] == ["live-1.mcap"]
            assert ("live-2.mcap" in now["told"]) is told
            assert studio.workspace.recording().name == "live-2.mcap"
    assert (tmp_path / "room" / "set-aside" / "1" / "live-2.mcap").exists()


def test_a_recording_waits_while_the_session_has_no_room(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    place = studio.workspace.recording()
    heard(place)
    with monkeypatch.context() as patched:
        patched.setattr("rotorfit.app.web.workspace.MOST_LOGS", 0)
        assert str(place) in studio._taken_in(place)
    assert place.exists()
    assert studio._taken_in(place) == "what was heard is the log live-1.mcap"
    assert not place.exists()


def test_a_vehicle_that_cannot_be_listened_to_says_so_and_leaves_no_log(page: TestClient) -> None:
    assert page.post("/api/live", json={"link": "sim:zeppelin", "card": ""}).status_code == 200
    until(lambda: not session_of(page)["live"]["running"])

    assert "zeppelin" in session_of(page)["live"]["said"][-1]
    assert session_of(page)["uploads"] == []


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"link": "pigeon", "card": ""}, "no link 'pigeon'"),
        ({"link": "tello", "card": ""}, "one controller alone"),
        ({"link": "replay:/etc/passwd", "card": ""}, "a log is not live"),
        ({"link": "--help", "card": ""}, "no link"),
        ({"link": "ros2", "card": "no-such-card"}, "no-such-card"),
        ({"link": "ros2", "card": "session"}, "there is no card yet"),
        ({"link": "ros2"}, "lacks 'card'"),
    ],
)
def test_what_cannot_be_followed_is_refused_in_one_line(page: TestClient, asked: dict[str, str], said: str) -> None:
    answer = page.post("/api/live", json=asked)

    assert answer.status_code == 422
    assert said in answer.json()["error"]
    assert session_of(page)["live"] is None


def test_the_live_page_may_be_framed_by_the_studio_alone_and_loads_its_own_files(page: TestClient) -> None:
    answer = page.get("/live/")

    assert answer.headers["content-security-policy"] == FRAMED
    assert answer.headers["x-frame-options"] == "SAMEORIGIN"
    assert {page.get(f"/live/page/{name}").status_code for name in ("live.js", "live.css", "uPlot.min.css")} == {200}
    assert page.get("/live/page/live.html").status_code == 404
