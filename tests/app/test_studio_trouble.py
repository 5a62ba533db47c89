"""The studio in trouble: full disks, kills, two windows, many logs, damaged sessions, logs that do not match."""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

from rotorfit.app.web.routes import Studio
from rotorfit.app.web.workspace import MOST_LOGS, Workspace, WorkspaceError
from rotorfit.core.log import Sample
from rotorfit.files.cards import builtin_card_text
from rotorfit.flying.recorder import record
from studio_requests import Hostile
from studio_room import added, bag, client_of, fits_here, opened, session_of, settled

TESTS = Path(__file__).resolve().parents[1]
DEEP = "a." * 3000 + "b = 1\n"
SMALL = b"time,x,y\n" + b"".join(b"%d,%d,1\n" % (i, i % 3) for i in range(30))
CARD = builtin_card_text("rotorfit-demo")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "workspace"


@contextmanager
def full_disk() -> Iterator[None]:
    """No file of this process, or of one that it starts, takes another byte."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def carrying(path: Path, card: str) -> bytes:
    """A recording with a card attached."""
    recorder = record(path, {"card": card})
    for k in range(20):
        recorder.command(10**7 * k, (0.0, 0.0, 0.0, 0.0))
        recorder.sample(Sample("pose", 10**7 * k, 10**7 * k, (0.01 * k, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)))
    recorder.close()
    return path.read_bytes()


# What cannot be shown


@pytest.mark.parametrize("card", [DEEP, "a = " + "[" * 5000, "a = " + "9" * 5000, "= no TOML", "a = nan"])
def test_a_log_that_carries_no_card_gets_a_draft_and_the_session_lives_on(
    folder: Path, tmp_path: Path, card: str
) -> None:
    with opened(folder) as studio:
        page = client_of(studio)
        log = added(page, "deep.mcap", carrying(tmp_path / "deep.mcap", card))
        assert page.put("/api/card", json={"draft": log, "seen": 0}).status_code == 200
        now = session_of(page)
        assert "[command]" in now["card"]
        assert now["raw"] is not None
    with opened(folder) as studio:
        assert session_of(client_of(studio))["card"] == now["card"]


@pytest.mark.parametrize("card", [DEEP, "x = \ud800", "\x00", "command = 5\npose = []", "[pose]\nx = [[[1]]]"])
def test_a_card_that_cannot_be_shown_is_kept_as_text_and_said(folder: Path, card: str) -> None:
    with opened(folder) as studio:
        body = json.dumps({"text": card, "seen": 0})
        assert client_of(studio).put("/api/card", content=body).status_code == 200
    with opened(folder) as studio:
        page = client_of(studio)
        now = session_of(page)
        assert now["card"] == card
        assert "\n" not in now["problem"]
        assert page.get("/api/card.toml").status_code == 200
        assert page.put("/api/card", json={"builtin": "rotorfit-demo", "seen": 1}).status_code == 200
        assert session_of(page)["problem"] is None


@pytest.mark.parametrize("text", [b"{", b"", b"[" * 100_000, b'{"version": ' + b"9" * 5000 + b"}", b"\xff\xfe", b"[1]"])
def test_a_session_that_is_no_session_is_set_aside_with_its_logs(folder: Path, text: bytes) -> None:
    with opened(folder) as studio:
        added(client_of(studio), "mine.csv", SMALL)
    (folder / "session.json").write_bytes(text)
    set_aside(folder)


FIT = {"id": "1", "settings": {}, "logs": [], "status": "done", "text": ""}


@pytest.mark.parametrize(
    ("entry", "wrong"),
    [
        ("", {"version": "one"}),
        ("", {"card": None}),
        ("", {"revision": 1e400}),
        ("", {"uploads": {}}),
        ("", {"fits": [FIT, FIT]}),
        ("", {"fits": [{**FIT, "status": "odd"}]}),
        ("uploads", {"id": "../.."}),
        ("uploads", {"file": "../../passwd"}),
        ("uploads", {"ranges": [{"role": "train", "start": "0"}]}),
    ],
)
def test_a_session_with_a_wrong_part_is_set_aside_with_its_logs(folder: Path, entry: str, wrong: Any) -> None:
    with opened(folder) as studio:
        added(client_of(studio), "mine.csv", SMALL)
    session = json.loads((folder / "session.json").read_text())
    (session[entry][0] if entry else session).update(wrong)
    (folder / "session.json").write_text(json.dumps(session))
    set_aside(folder)


def set_aside(folder: Path) -> None:
    """Opens a damaged session twice."""
    for again in (False, True):
        with opened(folder) as studio:
            page = client_of(studio)
            now = session_of(page)
            assert now["uploads"] == ([] if not again else now["uploads"])
            assert ("damaged" in now["told"]) is not again
            if not again:
                added(page, "new.csv", SMALL)
    assert (folder / "set-aside" / "1" / "logs" / "1" / "mine.csv").read_bytes() == SMALL
    assert (folder / "set-aside" / "1" / "session.json").exists()
    assert [one["name"] for one in json.loads((folder / "session.json").read_text())["uploads"]] == ["new.csv"]


def test_the_session_of_a_newer_studio_is_left_alone(folder: Path) -> None:
    Workspace(folder).close()
    newer = {**json.loads((folder / "session.json").read_text()), "version": 2, "wings": 4}
    (folder / "session.json").write_text(json.dumps(newer))

    with pytest.raises(WorkspaceError, match=r"version 2.*newer"):
        Workspace(folder)
    assert json.loads((folder / "session.json").read_text()) == newer


# Two windows


def test_the_first_draft_of_two_windows_is_no_conflict(page: TestClient) -> None:
    logs = [added(page, f"{seed}.bag", bag(seed)) for seed in (1, 2)]

    with ThreadPoolExecutor() as pool:
        answers = list(pool.map(lambda log: page.put("/api/card", json={"draft": log, "seen": 0}), logs))

    assert [answer.status_code for answer in answers] == [200, 200]
    now = session_of(page)
    assert now["card_revision"] == 1
    assert page.put("/api/card", json={"text": "# mine", "seen": 0}).status_code == 409
    assert page.put("/api/card", json={"draft": "99", "seen": 1}).status_code == 422
    assert session_of(page)["card"] == now["card"]


def test_two_windows_at_once_lose_nothing(studio: Studio, page: TestClient) -> None:
    first = added(page, "first.csv", SMALL)
    other = client_of(studio)

    def window(client: TestClient, name: str) -> list[str]:
        kept = []
        for i in range(8):
            added(client, f"{name}{i}.csv", SMALL)
            seen = session_of(client)
            card = client.put("/api/card", json={"text": f"# {name}{i}\n", "seen": seen["card_revision"]})
            part = {"role": "train", "start": i, "end": None}
            body = {"ranges": [part], "seen": seen["uploads"][0]["revision"]}
            ranges = client.put(f"/api/logs/{first}/ranges", json=body)
            assert {card.status_code, ranges.status_code} <= {200, 409}
            kept += [f"# {name}{i}\n"] if card.status_code == 200 else []
        return kept

    with ThreadPoolExecutor() as pool:
        kept = [text for each in pool.map(window, (page, other), ("a", "b")) for text in each]

    now = session_of(page)
    assert {one["name"] for one in now["uploads"]} == {"first.csv", *(f"{n}{i}.csv" for n in "ab" for i in range(8))}
    assert len({one["id"] for one in now["uploads"]}) == 17
    assert now["card_revision"] == len(kept)
    assert now["card"] in kept
    assert json.loads((studio.workspace.folder / "session.json").read_text())["card"] == now["card"]


def test_fifty_logs_are_kept_and_one_more_is_refused(folder: Path) -> None:
    with opened(folder) as studio:
        page = client_of(studio)
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda i: added(page, f"{i}.csv", SMALL), range(MOST_LOGS)))
        refusal = page.post("/api/logs?name=more.csv", content=SMALL)
        assert refusal.status_code == 422
        assert "more.csv: a session holds at most 50 logs" in refusal.json()["error"]
    with opened(folder) as studio:
        page = client_of(studio)
        now = session_of(page)
        assert len({one["name"] for one in now["uploads"]}) == MOST_LOGS
        assert {one.name for one in (folder / "logs").iterdir()} == {one["id"] for one in now["uploads"]}
        for one in now["uploads"][:3]:
            assert page.get(f"/api/logs/{one['id']}").json()["tables"][0]["count"] == 30


# A full disk


def test_a_full_disk_refuses_every_change_in_one_line_and_loses_none(studio: Studio, page: TestClient) -> None:
    log = added(page)
    assert page.put("/api/card", json={"text": CARD, "seen": 0}).status_code == 200
    before, names = session_of(page), sorted(studio.workspace.folder.rglob("*"))

    with full_disk():
        answers = [
            page.post("/api/logs?name=new.csv", content=SMALL),
            page.put("/api/card", json={"text": "# new", "seen": 1}),
            page.put(f"/api/logs/{log}/ranges", json={"ranges": [], "seen": 0}),
            page.post("/api/fits", json={}),
            page.post("/api/fits", json={}),
        ]
        shown = page.get(f"/api/logs/{log}/flight")

    for answer in answers:
        assert answer.status_code == 507
        assert "check the room on the disk" in answer.json()["error"]
    assert shown.status_code == 200
    assert session_of(page) == before
    studio.workspace._sweep()
    assert sorted(studio.workspace.folder.rglob("*")) == names
    added(page, "new.csv", SMALL)
    assert page.put("/api/card", json={"text": "# new", "seen": 1}).status_code == 200
    assert len(json.loads((studio.workspace.folder / "session.json").read_text())["uploads"]) == 2


def test_what_is_removed_from_a_full_disk_makes_its_own_room(
    studio: Studio, page: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, kept = added(page, "large.bag"), added(page, "small.csv", SMALL)
    place = studio.workspace.folder / "logs" / log
    write = studio.workspace._write

    def refused_while_it_is_there(session: Any) -> None:
        if place.exists():
            raise OSError(28, "No space left on device")
        write(session)

    monkeypatch.setattr(studio.workspace, "_write", refused_while_it_is_there)

    assert page.delete(f"/api/logs/{log}").status_code == 200
    assert [one["id"] for one in session_of(page)["uploads"]] == [kept]
    assert not place.exists()


def test_a_fit_that_a_full_disk_stops_is_told_and_can_be_removed(
    studio: Studio, page: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    added(page)
    page.put("/api/card", json={"text": CARD, "seen": 0})

    def no_room(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("rotorfit.app.web.runner.write_whole", no_room)
        assert page.post("/api/fits", json={}).status_code == 507
    (fit,) = session_of(page)["fits"]
    assert (fit["status"], fit["text"]) == ("failed", "the fit could not be started: No space left on device")
    assert page.delete("/api/fits/1").status_code == 200
    monkeypatch.setattr("rotorfit.app.web.runner.sys", SimpleNamespace(executable="true"))
    assert page.post("/api/fits", json={}).json() == {"id": "2"}
    settled(studio)
    assert session_of(page)["fits"][0]["status"] == "failed"


def test_a_fit_that_ends_on_a_full_disk_is_not_called_running_for_ever(studio: Studio) -> None:
    fit = studio.workspace.begin_fit({"kind": "fit"}, ())

    with full_disk():
        studio.workspace.end_fit(fit.id, "done", "proved")

    assert studio.workspace.fit(fit.id).status == "done"
    studio.workspace.set_card(lambda _: "# next", 0)
    assert json.loads((studio.workspace.folder / "session.json").read_text())["fits"][0]["status"] == "done"


def test_a_studio_opens_on_a_full_disk_and_shows_what_is_there(folder: Path) -> None:
    with opened(folder) as studio:
        added(client_of(studio), "mine.csv", SMALL)
    with full_disk(), opened(folder) as studio:
        assert [one["name"] for one in session_of(client_of(studio))["uploads"]] == ["mine.csv"]


# Kills


def killed(folder: Path, times: int) -> dict[str, int]:
    command = [sys.executable, str(TESTS / "studio_killed.py"), str(folder), str(times), "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    told: dict[str, int] = json.loads(done.stdout)
    return told


@pytest.mark.flights
def test_a_studio_that_is_killed_while_it_writes_keeps_what_it_acknowledged(folder: Path) -> None:
    assert killed(folder, 4)["acknowledged"] > 0


@pytest.mark.slow
def test_a_hundred_kills_lose_nothing_that_was_acknowledged(folder: Path) -> None:
    told = killed(folder, 100)
    assert told["acknowledged"] > 100
    assert told["killed_inside"] > 30


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.5, 2.0, 3.0, 3.5, 4.0, 5.0])
def test_a_worker_that_is_killed_at_any_moment_leaves_the_earlier_fit_whole(
    studio: Studio, page: TestClient, seconds: float
) -> None:
    import time

    added(page)
    page.put("/api/card", json={"text": CARD, "seen": 0})
    page.post("/api/fits", json={"method": "paper"})
    settled(studio)
    before = {name: page.get(f"/api/fits/1/{name}").content for name in ("model.json", "result.json", "report.html")}
    page.post("/api/fits", json={"method": "paper"})
    running = studio.runner.running
    assert running is not None
    time.sleep(seconds)
    if studio.runner.running is not None:
        os.kill(running.pid, signal.SIGKILL)
    settled(studio)

    assert {name: page.get(f"/api/fits/1/{name}").content for name in before} == before
    assert session_of(page)["fits"][1]["status"] in ("failed", "done")


# Logs that do not match


@pytest.mark.flights
def test_a_log_for_validation_that_does_not_match_is_named_and_the_others_go_on(
    studio: Studio, page: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits_here(monkeypatch)
    for name, content in (("train.bag", bag(1)), ("odd.csv", SMALL), ("proof.bag", bag(2)), ("twice.bag", bag(2))):
        added(page, name, content)
    page.put("/api/card", json={"text": CARD, "seen": 0})
    for asked in ({"axes": ["x"], "method": "paper"}, {"compare": ["1"]}):
        assert page.post("/api/fits", json=asked).status_code == 200
        settled(studio)

    for fit in session_of(page)["fits"]:
        assert fit["status"] == "done", fit
        assert "; left out: odd.csv: " in fit["text"]
        assert "proof.bag and twice.bag hold" in fit["text"]
        first, second = page.get(f"/api/fits/{fit['id']}/result.json").json()["left_out"]
        assert first.startswith("odd.csv: ")
        assert "twice.bag" in second
    flights = page.get("/api/fits/1/result.json").json()["flights"]
    assert [(one["role"], one["path"]) for one in flights] == [("validation", "proof.bag"), ("training", "train.bag")]


# Hostile requests


@pytest.mark.flights
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of columns of extreme numbers
@pytest.mark.parametrize("seed", [1, 5])
def test_no_request_ends_in_a_trace_or_spoils_the_session(
    studio: Studio, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rotorfit.app.web.runner.sys", SimpleNamespace(executable="true"))  # fits that end at once
    page = Hostile(studio, seed)
    for _ in range(60):
        page.once()


@pytest.mark.parametrize("number", ["1e308", "-1e308", "1e20"])
def test_positions_beyond_all_measure_count_as_absent(page: TestClient, number: str) -> None:
    rows = [f"{0.02 * i:.2f},{0.1 * (i % 7)},0,1,0,{(i // 20) % 2},0,0,0" for i in range(300)]
    rows[70] = f"1.40,{number},0,1,0,0,0,0,0"
    text = "\n".join(["time,x,y,z,yaw,cmd_x,cmd_y,cmd_z,cmd_yaw", *rows]) + "\n"
    log = added(page, "far.csv", text.encode())

    assert page.put("/api/card", json={"draft": log, "seen": 0}).status_code == 200
    told = page.get(f"/api/logs/{log}/flight").json()
    assert page.get(f"/api/logs/{log}/findings").status_code == 200
    assert any("1 of 300 rows hold no pose (blank, NaN or beyond 1e+12)" in note for note in told["notes"]), told
