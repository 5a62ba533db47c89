"""The API of the studio: from a log to a model that is proved; what is refused; what another page has changed."""

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from flights import CARD
from models import model_of
from rotorfit.app.loopback.gate import SANDBOX
from rotorfit.app.web.card_lines import card_from_text
from rotorfit.app.web.routes import Studio
from rotorfit.app.web.wire import command_unit
from rotorfit.app.web.workspace import Workspace, WorkspaceError
from rotorfit.app.workflows import fit_logs
from rotorfit.core.card import Channel
from rotorfit.core.errors import RotorfitError
from rotorfit.core.frames import AXES, heading_from_world
from rotorfit.dynamics.kinematics import local_polynomial
from rotorfit.exports import export
from rotorfit.exports.formats import FORMATS
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import LogSpan
from rotorfit.files.logs import read
from rotorfit.files.models import load, save
from rotorfit.flights.assemble import flight_from_log
from studio_room import added, bag, client_of, fits_here, opened, session_of, settled

pytestmark = pytest.mark.flights


def drafted(page: TestClient) -> str:
    """A log and the card that was drafted for it."""
    log = added(page)
    assert page.put("/api/card", json={"draft": log, "seen": session_of(page)["card_revision"]}).status_code == 200
    return log


def ranges(page: TestClient, log: str, *parts: tuple[str, float | None, float | None], seen: int | None = None) -> Any:
    now = next(one["revision"] for one in session_of(page)["uploads"] if one["id"] == log)
    body = {
        "ranges": [{"role": role, "start": start, "end": end} for role, start, end in parts],
        "seen": now if seen is None else seen,
    }
    return page.put(f"/api/logs/{log}/ranges", json=body)


def series(answer: Any) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and columns of a window."""
    assert answer.status_code == 200, answer.text
    n = int(answer.headers["x-points"])
    time = np.frombuffer(answer.content[: 8 * n], "<f8")
    return time, np.frombuffer(answer.content[8 * n :], "<f4").reshape(-1, n).T


# Logs


def test_a_log_is_kept_under_its_own_name_and_told(page: TestClient, studio: Studio) -> None:
    log = added(page, "first flight (1).bag")
    told = page.get(f"/api/logs/{log}").json()

    (upload,) = session_of(page)["uploads"]
    assert upload["name"] == "first flight (1).bag"
    assert upload["format"] == told["format"] == "rosbag1"
    assert studio.workspace.path_of(studio.workspace.upload(log)).read_bytes() == bag(1)
    assert [table["name"] for table in told["tables"]] == list(
        read(studio.workspace.path_of(studio.workspace.upload(log))).tables
    )


def test_the_first_log_trains_and_those_after_it_validate(page: TestClient) -> None:
    for name in ("a.bag", "b.bag", "c.bag"):
        added(page, name)

    roles = [[part["role"] for part in one["ranges"]] for one in session_of(page)["uploads"]]
    assert roles == [["train"], ["validate"], ["validate"]]


def test_a_bad_file_is_one_line_that_calls_it_as_the_user_does_and_leaves_nothing(
    page: TestClient, studio: Studio
) -> None:
    answer = page.post("/api/logs?name=holiday.jpg", content=b"\xff\xd8\xff\xe0 no log")

    assert answer.status_code == 422
    assert answer.json()["error"].startswith("holiday.jpg: of no known format")
    assert str(studio.workspace.folder) not in answer.text
    assert session_of(page)["uploads"] == []
    assert list((studio.workspace.folder / "logs").iterdir()) == []


def test_a_log_that_is_removed_is_gone_with_its_file(page: TestClient, studio: Studio) -> None:
    log = added(page)
    assert page.delete(f"/api/logs/{log}").status_code == 200

    assert session_of(page)["uploads"] == []
    assert list((studio.workspace.folder / "logs").iterdir()) == []
    assert "no such log" in page.get(f"/api/logs/{log}").json()["error"]


def test_columns_come_as_recorded_over_the_clock_of_their_table(page: TestClient, studio: Studio) -> None:
    log = added(page)
    table = max(page.get(f"/api/logs/{log}").json()["tables"], key=lambda one: one["count"])
    source = next(one["source"] for one in table["columns"] if one["name"].endswith("position.x"))

    time, values = series(page.get(f"/api/logs/{log}/column", params={"source": source, "width": 4096}))

    recorded = read(studio.workspace.path_of(studio.workspace.upload(log))).tables[table["name"]].columns
    np.testing.assert_allclose(values[:, 0], recorded[source.partition(":")[2]].astype(np.float32))
    assert time[0] >= 0
    assert np.all(np.diff(time) >= 0)


def test_an_unknown_column_names_the_nearest(page: TestClient) -> None:
    log = added(page)

    answer = page.get(f"/api/logs/{log}/column", params={"source": "/rotorfit/pose:pose.position.q"})

    assert answer.status_code == 422
    assert "nearest" in answer.json()["error"]


# Card


def test_a_draft_reads_the_log_and_the_plot_shows_the_flight_that_the_library_makes(
    page: TestClient, studio: Studio
) -> None:
    log = drafted(page)
    told = page.get(f"/api/logs/{log}/flight").json()
    time, values = series(page.get(f"/api/logs/{log}/motion?axis=y&width=4096"))

    raw = session_of(page)["raw"]
    path = studio.workspace.path_of(studio.workspace.upload(log))
    flight = flight_from_log(read(path), card_from_mapping(raw, "test"))
    t = flight.pose_time
    velocity = local_polynomial(t, flight.position, t, 0.125, 3, least=7).velocity
    np.testing.assert_allclose(time, t)
    np.testing.assert_allclose(values[:, 1], heading_from_world(velocity[:, :2], flight.yaw)[:, 1], atol=1e-5)
    held = flight.command[np.searchsorted(flight.command_time, t, side="right") - 1, 1]
    inside = (t >= flight.segments[0].start) & (t <= flight.segments[-1].end)
    np.testing.assert_allclose(values[inside, 0], held[inside], atol=1e-6)
    assert told["duration"] == pytest.approx(flight.duration)
    assert told["axes"] == list(flight.axes)


def test_a_turned_sign_turns_the_command_of_the_plot(page: TestClient) -> None:
    log = drafted(page)
    before = series(page.get(f"/api/logs/{log}/motion?axis=x"))[1][:, 0]
    raw, seen = session_of(page)["raw"], session_of(page)["card_revision"]
    own = raw["command"]["x"]
    value = {**(own if isinstance(own, dict) else {"from": own}), "scale": -1}

    edit = {"section": "command", "key": "x", "value": value}
    assert page.put("/api/card", json={"edits": [edit], "seen": seen}).status_code == 200

    np.testing.assert_allclose(series(page.get(f"/api/logs/{log}/motion?axis=x"))[1][:, 0], -before)


@pytest.mark.parametrize(("scale", "words"), [(1, "as sent"), (-1, "as sent, turned"), (0.01, "as sent, times 0.01")])
def test_a_command_of_no_said_meaning_is_as_sent_but_for_its_scale(scale: float, words: str) -> None:
    card = replace(CARD, command={**CARD.command, "x": Channel("cmd", scale=scale)})

    assert command_unit(card, "x") == words


def test_a_card_that_is_wrong_is_kept_as_typed_and_said_in_one_line(page: TestClient) -> None:
    log = drafted(page)
    text = session_of(page)["card"].replace("[pose]", "[pos]")
    page.put("/api/card", json={"text": text, "seen": session_of(page)["card_revision"]})

    now = session_of(page)
    assert now["card"] == text
    assert "unknown key 'pos'; nearest: 'pose'" in now["problem"]
    assert "unknown key" in page.get(f"/api/logs/{log}/flight").json()["error"]
    assert "unknown key" in page.post("/api/fits", json={}).json()["error"]
    assert session_of(page)["fits"] == []


@pytest.mark.parametrize("text", ["= broken", 'x = "', "a = 1979-05-27", "a = nan", "[command]\nx = inf"])
def test_text_that_is_no_card_at_all_does_no_harm(page: TestClient, text: str) -> None:
    page.put("/api/card", json={"text": text, "seen": 0})

    now = session_of(page)
    assert now["card"] == text
    assert now["problem"]
    assert "\n" not in now["problem"]


def test_who_changes_what_another_page_has_changed_meanwhile_is_refused(page: TestClient, studio: Studio) -> None:
    other = client_of(studio)
    log = drafted(page)
    seen = session_of(page)["card_revision"]

    theirs = {"text": "# theirs", "seen": seen}
    for _ in range(2):  # the second time as a page does that did not hear the answer
        assert other.put("/api/card", json=theirs).json() == {"card_revision": seen + 1}
    answer = page.put("/api/card", json={"text": "# mine", "seen": seen})
    assert answer.status_code == 409
    assert "another window" in answer.json()["error"]
    assert session_of(page)["card"] == "# theirs"

    assert ranges(other, log, ("train", 1, 5)).status_code == 200
    assert ranges(page, log, ("train", 2, 6), seen=0).status_code == 409
    assert session_of(page)["uploads"][0]["ranges"] == [{"role": "train", "start": 1.0, "end": 5.0}]


# Ranges


@pytest.mark.parametrize(
    "parts",
    [
        [("train", 5, 5)], [("train", 6, 5)], [("test", 0, 1)], [("train", "0", 1)], [("train", True, 2)],
        [("train", 0, 1)] * 51,
    ],
)  # fmt: skip
def test_ranges_that_cannot_be_meant_are_refused(page: TestClient, parts: list[Any]) -> None:
    log = added(page)

    assert ranges(page, log, *parts).status_code == 422
    assert session_of(page)["uploads"][0]["revision"] == 0


def test_a_range_outside_the_flight_is_refused_and_says_where_the_flight_is(page: TestClient) -> None:
    log = drafted(page)
    for start, end in ((200, 300), (200, None), (None, -5), (-9, -5)):
        answer = ranges(page, log, ("train", start, end))
        assert answer.status_code == 422
        assert re.search(r"flight\.bag: the range .* holds nothing of the flight, 0\.00 to 1\d\.\d\d s", answer.text)
    assert session_of(page)["uploads"][0]["revision"] == 0

    assert ranges(page, log, ("train", -5, 1000)).status_code == 200


# Fits


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Studio, TestClient]]:
    """A session with two fits that were proved, and a comparison."""
    with opened(tmp_path_factory.mktemp("fitted") / "workspace") as studio:
        page = client_of(studio)
        drafted(page)
        added(page, "proof.bag", bag(2))
        with pytest.MonkeyPatch.context() as patch:
            fits_here(patch)
            for method in ("ml", "paper"):
                asked = {"axes": ["x", "y"], "method": method, "structure": "first_order_delay"}
                assert page.post("/api/fits", json=asked).status_code == 200
                settled(studio)
            assert page.post("/api/fits", json={"compare": ["1", "2"]}).status_code == 200
            settled(studio)
        yield studio, page


def test_a_fit_gives_a_model_scores_and_a_report_that_runs_in_a_sandbox(fitted: tuple[Studio, TestClient]) -> None:
    studio, page = fitted
    first, *_ = session_of(page)["fits"]

    assert first["status"] == "done", first
    model = load(studio.workspace.folder / "fits" / "1" / "model.json")
    assert (
        page.get("/api/fits/1/model.json?download").content
        == (studio.workspace.folder / "fits" / "1" / "model.json").read_bytes()
    )
    result = page.get("/api/fits/1/result.json").json()
    x = next(part["rows"][0] for part in result["coefficients"] if part["axis"] == "x")
    assert x["term"] == "input gain"
    assert float(x["value"]) == pytest.approx(model.axes["x"].input, rel=1e-2)
    assert {one["role"] for one in result["flights"]} == {"training", "validation"}
    assert "logs/" not in page.get("/api/fits/1/result.json").text
    report = page.get("/api/fits/1/report.html")
    assert report.headers["content-security-policy"] == SANDBOX
    assert "<title>" in report.text
    assert "logs/" not in report.text
    assert "rotorfit plan --after model-1.json" in report.text
    download = page.get("/api/fits/1/report.html?download")
    assert download.headers["content-disposition"] == 'attachment; filename="report-1.html"'


def test_the_model_is_that_of_the_library_with_the_same_card_and_spans(fitted: tuple[Studio, TestClient]) -> None:
    studio, page = fitted
    first, _ = studio.workspace.session.uploads
    path = studio.workspace.path_of(first)

    alone = fit_logs([LogSpan(str(path), (None, None))], card_from_text(session_of(page)["card"]), "paper", ("x", "y"))

    model = load(studio.workspace.folder / "fits" / "2" / "model.json")
    assert model.gamma == alone.model.gamma
    assert model.paper == alone.model.paper
    assert model.flights[0].sha256 == alone.model.flights[0].sha256


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_export_is_the_one_of_the_library(fitted: tuple[Studio, TestClient], name: str) -> None:
    studio, page = fitted
    folder = studio.workspace.folder / "fits" / "1"
    path = folder / "model.json"
    trained, proof = (json.loads((folder / f"{file}.json").read_text()) for file in ("trained", "validation"))

    answer = page.get(f"/api/fits/1/exports/{name}")

    with suppress(RotorfitError):
        assert answer.text == export(path, name, name="model_1", trained=trained, validation=proof).text
        assert "speeds up to" in answer.text
        assert "x on logs/2/proof.bag: 0.5 s" in answer.text
        assert answer.headers["content-disposition"] == f'attachment; filename="model_1{FORMATS[name].suffix}"'
        return
    with pytest.raises(RotorfitError) as refusal:
        export(path, name, name="model_1")
    assert answer.status_code == 422
    said = " ".join(str(refusal.value).split()).replace("--predictor", "'also axes that are not identifiable'")
    assert answer.json()["error"] == said


def test_an_export_is_refused_in_the_words_of_the_page(page: TestClient, studio: Studio) -> None:
    model = model_of(dict.fromkeys(AXES, (3.7, 2.0, 0.1)))
    fit = studio.workspace.begin_fit({"kind": "fit"}, ())
    hidden = replace(model.axes["z"], delay=None, status={**model.axes["z"].status, "delay": "not_identifiable"})
    save(replace(model, axes={**model.axes, "z": hidden}), studio.workspace.fit_folder(fit) / "model.json")
    studio.workspace.end_fit(fit.id, "done", "")
    untold = page.get("/api/constants").json()["untold"]

    refusal = page.get("/api/fits/1/exports/gazebo")

    assert refusal.status_code == 422
    assert f"try '{untold}'" in refusal.json()["error"]
    assert "--" not in refusal.json()["error"]
    assert page.get("/api/fits/1/exports/gazebo?predictor").status_code == 200


@pytest.mark.parametrize("name", ["no-such", "..%2fmodel.json", "numpy.py.j2"])
def test_an_unknown_export_is_refused(fitted: tuple[Studio, TestClient], name: str) -> None:
    assert fitted[1].get(f"/api/fits/1/exports/{name}").status_code in (404, 422)


def test_models_are_compared_on_the_stretches_for_validation(fitted: tuple[Studio, TestClient]) -> None:
    _, page = fitted
    third = session_of(page)["fits"][2]
    assert third["status"] == "done", third
    found = page.get("/api/fits/3/result.json").json()

    assert found["columns"] == ["fit 1", "fit 2", "paper", "coast", "hold"]
    at_one = next(row for row in found["rows"] if row["axis"] == "x" and row["horizon"] == 1.0)
    assert at_one["velocity"][0] < at_one["velocity"][1] < at_one["velocity"][4]
    assert at_one["path"] == "proof.bag"
    pairs = {(one["first"], one["second"]) for one in found["paired"]}
    assert pairs == {("fit 2", "fit 1"), ("fit 1", "hold"), ("fit 1", "paper"), ("fit 2", "hold")}
    assert found["notes"] == ["fit 2 against paper is left out: they are the same predictions"]


def test_the_session_survives_the_studio(fitted: tuple[Studio, TestClient], tmp_path: Path) -> None:
    studio, page = fitted
    before = session_of(page)
    assert len(before["fits"]) == 3
    with pytest.raises(WorkspaceError, match="another studio"):
        Workspace(studio.workspace.folder)

    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "session.json").write_bytes((studio.workspace.folder / "session.json").read_bytes())
    with opened(copy) as again:
        after = session_of(client_of(again))
    assert {**after, "revision": 0} == {**before, "revision": 0}


def test_a_fit_that_is_killed_is_told_and_the_next_one_works(studio: Studio, page: TestClient) -> None:
    drafted(page)
    page.post("/api/fits", json={"axes": ["x"]})
    running = studio.runner.running
    assert running is not None
    assert page.post("/api/fits", json={}).status_code == 409
    os.kill(running.pid, signal.SIGKILL)
    settled(studio)

    (fit,) = session_of(page)["fits"]
    assert fit["status"] == "failed"
    assert "killed from outside (signal 9)" in fit["text"]
    assert page.get("/api/fits/1/model.json").status_code == 404
    page.post("/api/fits", json={"axes": ["x"], "method": "paper"})
    settled(studio)
    assert session_of(page)["fits"][1]["status"] == "done"


def test_a_fit_that_is_cancelled_stops_and_can_be_removed(studio: Studio, page: TestClient) -> None:
    drafted(page)
    page.post("/api/fits", json={})
    assert "cancel it first" in page.delete("/api/fits/1").json()["error"]
    assert page.post("/api/fits/1/cancel").status_code == 200
    settled(studio)

    assert session_of(page)["fits"][0]["status"] == "stopped"
    assert page.delete("/api/fits/1").status_code == 200
    assert list((studio.workspace.folder / "fits").iterdir()) == []


def test_a_fit_knows_what_has_changed_since(studio: Studio, page: TestClient) -> None:
    log = drafted(page)
    revision = session_of(page)["card_revision"]
    assert ranges(page, log, ("train", None, 9), ("validate", 9, None)).status_code == 200
    assert page.post("/api/fits", json={}).status_code == 200
    page.post("/api/fits/1/cancel")
    settled(studio)

    def fit() -> Any:
        return session_of(page)["fits"][0]

    def turned(scale: int) -> None:
        edit = {"section": "command", "key": "x", "value": {"scale": scale}}
        assert page.put("/api/card", json={"edits": [edit], "seen": session_of(page)["card_revision"]}).is_success

    assert fit()["logs"] == ["training: start to 9 s of flight.bag", "validation: 9 s to end of flight.bag"]
    assert fit()["settings"]["card_revision"] == revision
    assert fit()["changed"] == []
    before = session_of(page)["card"]
    turned(-1)
    assert fit()["changed"] == ["card"]
    ranges(page, log, ("train", None, None))
    assert fit()["changed"] == ["card", "ranges"]
    ranges(page, log, ("train", None, 9), ("validate", 9, None))
    page.put("/api/card", json={"text": before, "seen": session_of(page)["card_revision"]})
    assert fit()["changed"] == []


def test_a_fit_that_cannot_be_says_why_in_one_line(studio: Studio, page: TestClient) -> None:
    assert "no card" in page.post("/api/fits", json={}).json()["error"]
    log = drafted(page)
    ranges(page, log, ("validate", None, None))
    assert "for training" in page.post("/api/fits", json={}).json()["error"]
    ranges(page, log, ("train", 0, 1))
    for nothing in ([], 5, ["roll"]):
        assert "at least one axis" in page.post("/api/fits", json={"axes": nothing}).json()["error"]
    assert "method is one of" in page.post("/api/fits", json={"method": "magic"}).json()["error"]
    page.post("/api/fits", json={})
    settled(studio)

    (fit,) = session_of(page)["fits"]
    assert fit["status"] == "failed"
    assert "at least 2 s" in fit["text"]


def test_a_fit_calls_logs_as_the_user_does(studio: Studio, page: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    fits_here(monkeypatch)
    name = 'my "flight" <1>.bag'
    page.put("/api/card", json={"draft": added(page, name), "seen": 0})
    added(page, "the proof.bag", bag(2))
    for seconds, status in ((None, "done"), (1, "failed")):
        assert ranges(page, "1", ("train", 0, seconds)).status_code == 200
        assert page.post("/api/fits", json={"axes": ["x"], "method": "paper"}).status_code == 200
        settled(studio)
        assert session_of(page)["fits"][-1]["status"] == status

    assert session_of(page)["fits"][-1]["text"].startswith(f"{name}: ")
    result = page.get("/api/fits/1/result.json")
    assert [one["path"] for one in result.json()["flights"]] == ["the proof.bag", name]
    assert "Validate it" not in result.json()["summary"]
    for copied in ("my_flight", "the_proof", "logs/"):
        assert copied not in result.text


def test_the_worker_does_not_outlive_the_studio(tmp_path: Path) -> None:
    with opened(tmp_path / "workspace") as studio:
        page = client_of(studio)
        drafted(page)
        page.post("/api/fits", json={})
        assert studio.runner.running is not None
        process = studio.runner._process
        assert process is not None
        assert process.stdin is not None
        process.stdin.close()  # what the system does when the studio dies
        end = time.monotonic() + 20
        while process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
        assert process.poll() is not None


def test_a_session_whose_studio_died_says_that_its_fit_was_stopped(tmp_path: Path) -> None:
    with opened(tmp_path / "workspace") as studio:
        studio.workspace.begin_fit({"kind": "fit"}, ())
    with opened(tmp_path / "workspace") as studio:
        assert studio.workspace.session.fits[0].status == "stopped"


def test_a_folder_of_something_else_is_not_taken(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")

    with pytest.raises(WorkspaceError, match=r"thesis\.tex"):
        Workspace(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
