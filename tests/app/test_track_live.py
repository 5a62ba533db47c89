"""`rotorfit track --link`: what is said, written and served; that it ends well, and goes on after it was killed."""

import asyncio
import fcntl
import hashlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np
import pytest
from click.testing import CliRunner, Result
from streams import CARD, SECOND, flown

from rotorfit import flight
from rotorfit.app.cli import main
from rotorfit.app.cli.tracking import _reporting
from rotorfit.app.live.feed import KEPT, Feed
from rotorfit.app.live.outlets import Recording
from rotorfit.app.live.page_server import LivePage
from rotorfit.app.live.session import track_link
from rotorfit.app.workflows import training_flights
from rotorfit.core.errors import LinkOverError
from rotorfit.core.finding import Finding
from rotorfit.core.log import Sample
from rotorfit.core.model import Model
from rotorfit.core.tracked import Alarm, Tracked, TrackedAxis
from rotorfit.diagnosis.card_choice import card_of
from rotorfit.files.logs import read
from rotorfit.files.models import load
from rotorfit.flying.listening import Listening
from rotorfit.flying.recorder import Recorder
from rotorfit.tracking.flight_so_far import UNRECORDED
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.tracker import Tracker

QUICK = ("--pace", "1000", "--structure", "first_order_delay")
ALARM = Alarm(3.0, ("x",), "payload", (1.0, 2.0), {"x.input": (0.8, 0.9)}, 0.9, 1e-9, "because")


def run(*words: str) -> Result:
    return CliRunner().invoke(main, ["track", *words])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "one of the two"),
        (("log.mcap", "--link", "sim"), "one of the two"),
        (("bebop2", "log.mcap"), "one LOG, not 2; a card is named by --card"),
        (("log.mcap", "--for", "3"), "for a --link"),
        (("--link", "tello"), "one controller alone"),
        (("--link", "ros2"), "--card"),
        (("--link", "pigeon"), "no link 'pigeon'"),
        (("--link", "sim", "--card", "tello"), "the card given is not one of Parrot Bebop 2: a command on x"),
        (("--link", "sim:tello", "--card", "tello"), "what a command of 1 on x reaches; leave --card out"),
        (("--link", "sim,mass=2"), "'mass=2' is no change: mass is a factor from 0.1 to 10"),
        (("--link", "sim,load=2"), "no option 'load'; options are wind, gusts, mass"),
        (
            ("--link", "pigeon", "--record", "flight.csv"),
            "flight.csv: a recording is an MCAP file; name it flight.mcap",
        ),
        (("--link", "pigeon", "--record", "/proc/flight.mcap"), "/proc/flight.mcap: cannot be written"),
        (("--link", "pigeon", "--report", "track.pdf"), "track.pdf: a report is a page; name it track.html"),
        (("--link", "pigeon", "--state", "/proc/state"), "/proc/state: cannot be written"),
        (("--link", "sim,mas=2@3"), "no option 'mas'; nearest: 'mass'; options are"),
        (("--link", "sim,seed=-3"), "'seed=-3' is not start=X/Y/Z/YAW"),
        (("--link", "replay"), "replay needs a file: --link replay:flight.mcap"),
        (("--link", "sim", "--page", "abc"), "abc is not a whole number from 0 to 65535"),
        (("--link", "sim,mass=0@2"), "'mass=0@2' is no change: mass is a factor from 0.1 to 10"),
    ],
)
def test_what_cannot_be_is_one_line(words: tuple[str, ...], said: str) -> None:
    result = run(*words)

    assert result.exit_code in (1, 2)
    assert said in result.output.strip().splitlines()[-1]


def test_a_link_is_followed_recorded_and_remembered(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    record, memory, model = (tmp_path / name for name in ("flight.mcap", "memory", "model.json"))
    words = ("--link", "sim", "--for", "12", "--jsonl", "--record", str(record), "--state", str(memory), *QUICK)
    result = run(*words, "-o", str(model))
    lines = [json.loads(line) for line in result.stdout.splitlines()]

    assert result.exit_code == 0, result.output
    assert {line["type"] for line in lines} == {"state", "end"}
    assert [round(line["time"]) for line in lines[:3]] == [round(lines[0]["time"]) + n for n in range(3)]
    assert lines[-1]["models"] == [str(model)]
    assert "simulated pilot" in result.stderr
    log = read(record)
    assert {"/rotorfit/command", "/rotorfit/pose"} <= log.tables.keys()
    assert b"/rotorfit/motion" in record.read_bytes()
    assert "card" in log.attached
    assert len(training_flights(load(model))[0]) == 1  # a report knows what it was fitted to
    assert CliRunner().invoke(main, ["fit", str(record), "--axes", "yaw", *QUICK[2:]]).exit_code == 0

    request.getfixturevalue("looks_here")
    again = run("--link", "sim", "--for", "3", "--jsonl", "--state", str(memory), *QUICK)
    first = json.loads(again.stdout.splitlines()[0])
    assert f"goes on from {memory}, as the same vehicle; another one, or another payload, needs a" in again.stderr
    assert first["time"] > 12.0
    assert first["axes"]["yaw"]["input"] is not None


def test_the_seconds_of_a_recording_are_those_of_its_tracker(tmp_path: Path) -> None:
    """Although the vehicle was seen for a minute, and the link heard for a while without a pose, before a command."""
    growing, recording = GrowingFlight(CARD), Recording(tmp_path / "flight.mcap", CARD, "sim")
    ago = round(60.007 * SECOND)
    idle = [replace(one, stamp=one.stamp - ago, received=one.received - ago) for one in flown()]
    for sample in (*(one for one in idle if one.stream == "pose"), *flown()[:6000]):
        recording.heard([sample], sample.received)
        growing.add(sample)
    recording.close()
    live, log = growing.flight(), flight(tmp_path / "flight.mcap")

    assert live is not None
    place = np.searchsorted(live.command_time, log.command_time - 1e-6)
    assert live.command_time[place] == pytest.approx(log.command_time, abs=1e-6)
    np.testing.assert_allclose(live.command[place], log.command)
    place = np.searchsorted(live.pose_time, log.pose_time[100:] - 1e-6)
    np.testing.assert_allclose(live.position[place], log.position[100:])


@pytest.mark.parametrize(
    ("late", "seconds", "clock"), [(1, 8.0, "header.stamp"), (5000, 8.0, "log_time"), (0, 0.5, "header.stamp")]
)
def test_the_clock_of_a_recording_is_that_of_its_tracker(late: int, seconds: float, clock: str, tmp_path: Path) -> None:
    """However late the first pose; another clock is another one from the start; a short one is written, too."""
    path = tmp_path / "flight.mcap"
    recording = Recording(path, CARD, "sim")
    begin, count = flown()[0].received, 0
    for one in flown():
        if one.received - begin < seconds * SECOND:
            count += one.stream == "pose"
            moved = one.stamp - 3 * SECOND * (count <= late)
            sent = replace(one, stamp=moved, received=one.received + SECOND // 100)
            recording.heard([sent if one.stream == "pose" else one], one.received)
    assert path.exists() == (seconds > 1)
    recording.close()

    time = card_of(read(path)).pose_time.source
    assert time == f"/rotorfit/pose:{clock}"
    assert len(read(path).tables["/rotorfit/pose"].columns["log_time"]) == count


def test_a_recording_says_how_well_the_stamps_of_its_poses_are_known(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "flight.mcap", CARD, "mavlink")
    for one in flown()[:3000]:
        recording.heard([replace(one, error=0.03)], one.received)
    recording.close()

    assert card_of(read(tmp_path / "flight.mcap")).pose_time.error == 0.03


@pytest.mark.parametrize("silent", [0.0, 4.0, 7.5])
@pytest.mark.parametrize(("off", "clock"), [(0.0, "header.stamp"), (-40.0, "log_time")])
def test_commands_are_recorded_as_they_arrive_and_timed_as_by_the_tracker(
    off: float, clock: str, silent: float, tmp_path: Path
) -> None:
    """Although they begin seconds after the poses, which begin the file; and a flight that ends soon after that."""
    recording, begin = Recording(tmp_path / "flight.mcap", CARD, "sim"), flown()[0].received
    for one in flown():
        late, since = one.stream == "command", (one.received - begin) / SECOND
        if since > 8.0 or (late and since < silent):
            continue
        moved = replace(one, stamp=one.stamp + round(off * SECOND), received=one.received + SECOND // 100)
        recording.heard([moved if late else one], one.received)
    recording.close()

    log = read(tmp_path / "flight.mcap")
    assert card_of(log).command_time.source == f"/rotorfit/command:{clock}"
    columns = log.tables["/rotorfit/command"].columns
    assert (columns["log_time"] - columns["header.stamp"]) / 1e9 == pytest.approx(0.01 - off, abs=1e-6)


class Played:
    """A link that plays samples."""

    live = False

    def __init__(self, samples: Sequence[Sample]) -> None:
        self.samples, self.now = list(samples), samples[0].received

    def receive(self, until: int) -> list[Sample]:
        if not self.samples:
            raise LinkOverError("played")
        self.now, count = until, sum(one.received <= until for one in self.samples)
        taken, self.samples = self.samples[:count], self.samples[count:]
        return taken


def test_a_fault_of_the_data_is_said_once() -> None:
    off = Finding("yaw_offset", "warning", "x acts 30 degrees off", "too small", "turn the heading")
    said, lines = list[str](), list[str]()
    out = SimpleNamespace(take=lambda _show, spare: lines.append(spare), stalled=False, fault="")
    report = _reporting(cast(Any, SimpleNamespace(jsonl=True, regaining=None, out=out)), [], said.append)
    for second in range(3):
        report(Tracked(11.0 + second, {}, findings=(off, replace(off, severity="info", code="other"))), 0)

    assert said == ["11.0 s  warning yaw_offset: x acts 30 degrees off; turn the heading"]


def test_a_step_of_the_poses_clock_is_said_and_recorded(tmp_path: Path) -> None:
    at, said = flown()[1500].stamp, list[str]()
    stepped = [replace(one, stamp=one.stamp + 40_000_000 * (one.stamp > at)) for one in flown()[:2200]]
    link = Played([now if now.stream == "pose" else was for now, was in zip(stepped, flown(), strict=False)])
    recording = Recording(tmp_path / "flight.mcap", CARD, "sim")
    listening = Listening(lambda: link, 60.0, pace=1e6)  # type: ignore[arg-type,return-value]
    track_link(Tracker(CARD, "first_order_delay"), listening, [recording], lambda _state, _now: None, said.append)

    assert sum("the clock of the poses was set on by 40 ms" in text for text in said) == 1
    assert [event.text for event in read(tmp_path / "flight.mcap").events] == [said[0]]


@pytest.mark.usefixtures("looks_here")
def test_a_recording_that_the_disk_ends_costs_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is said when it happens; table, models and memory come all the same, and models say what the file lacks."""
    record, memory, model = (tmp_path / name for name in ("flight.mcap", "memory", "model.json"))

    def full(recorder: Recorder) -> None:
        with recorder._file as file:
            while room := 300_000 - file.tell():
                file.write(recorder._queue.taken()[:room])
                time.sleep(0.01)
        recorder.fault = f"{recorder.path}: No space left on device"

    monkeypatch.setattr(Recorder, "_run", full)
    words = ("--link", "sim", "--for", "9", "--record", str(record), "--state", str(memory), *QUICK)
    result = run(*words, "-o", str(model))

    assert result.exit_code == 1
    assert result.stderr.count("No space left on device") == 2  # when it happened, and why the exit code is 1
    assert "steady gain" in result.stdout
    assert load(model).axes["yaw"].input is not None
    held, (first, rest) = flight(record), load(model).flights
    assert (first.path, first.sha256, first.span[1]) == (held.path, held.sha256, held.span[1])
    assert (rest.path, rest.sha256) == (UNRECORDED, "")
    assert 2.0 < first.span[1] < 9.0 - rest.span[1] + 0.1 < first.span[1] + 0.2
    assert "goes on from" in run("--link", "sim", "--for", "1", "--state", str(memory), *QUICK).stderr


@pytest.mark.usefixtures("looks_here")
def test_the_page_of_a_link_has_every_second_of_its_flight(tmp_path: Path) -> None:
    page = tmp_path / "track.html"
    result = run("--link", "sim,mass=1.3@40,wind=1", "--for", "8", "--report", str(page), *QUICK)
    assert "ended at 8 s, before the change mass=1.3@40: the flight is without it" in result.stderr

    assert result.exit_code == 0, result.output
    assert "fitting the flight once more" in result.stderr
    assert re.search(r"From [5-8] s on", page.read_text(encoding="utf-8"))


@pytest.mark.usefixtures("looks_here")
def test_a_result_that_cannot_be_written_costs_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_model: Model, _path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rotorfit.files.models.save", full)
    model, page = tmp_path / "model.json", tmp_path / "track.html"
    words = ("--link", "sim", "--for", "7", "-o", str(model), "--report", str(page), *QUICK)
    table, lines = run(*words), run(*words, "--jsonl")

    for result in (table, lines):
        assert result.exit_code == 1
        assert f"Error: {model}: No space left on device; check its folder" in result.stderr
    assert "steady gain" in table.stdout
    assert "Report written to" in table.stdout
    assert "No model" not in table.stdout
    end = json.loads(lines.stdout.splitlines()[-1])
    assert (end["type"], end["models"], end["report"]) == ("end", [], str(page))


@pytest.mark.usefixtures("looks_here")
def test_what_is_remembered_is_of_one_vehicle_and_of_one_tracker(tmp_path: Path) -> None:
    memory = tmp_path / "memory"
    words = ("--link", "sim", "--for", "3", "--state", str(memory), *QUICK)
    assert run(*words).exit_code == 0
    kept = memory.read_bytes()

    other = run("--link", "sim:tello", *words[2:])
    with socket.socket(socket.AF_UNIX) as held:
        held.bind("\0rotorfit-track-" + hashlib.sha256(str(memory).encode()).hexdigest())
        second = run(*words)

    assert other.exit_code == second.exit_code == 1
    assert "was learnt with the card Parrot Bebop 2" in other.stderr
    assert "another tracker remembers in this file" in second.stderr
    assert memory.read_bytes() == kept


@pytest.mark.usefixtures("looks_here")
def test_a_file_that_is_no_memory_is_named(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    path.write_text("hello")
    result = run("--link", "sim", "--for", "3", "--state", str(path), *QUICK)

    assert result.exit_code == 1
    assert "is not what `rotorfit track --state` wrote" in result.stderr


@pytest.mark.usefixtures("looks_here")
def test_ctrl_c_ends_it_with_everything_written(tmp_path: Path) -> None:
    record, memory = tmp_path / "flight.mcap", tmp_path / "memory"

    def struck() -> None:
        while not memory.exists():  # until the first look
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    striking = threading.Thread(target=struck, daemon=True)
    striking.start()
    kept = ("--record", str(record), "--state", str(memory))
    result = run("--link", "sim", "--jsonl", *kept, "--for", "60", *QUICK[2:], "--pace", "30")
    striking.join()

    assert result.exit_code == 0, result.output
    assert [json.loads(line)["type"] for line in result.stdout.splitlines()][-2:] == ["state", "end"]
    assert "Ctrl-C" in result.stderr
    assert not read(record).damage


@pytest.mark.slow
def test_ctrl_c_ends_a_process_with_everything_written(tmp_path: Path) -> None:
    """Once more what the test above proves, and `test_studio_live.py` of the process that the studio starts."""
    record = tmp_path / "flight.mcap"
    words = [sys.executable, "-m", "rotorfit", "track", "--link", "sim", "--jsonl", "--record", str(record)]
    with subprocess.Popen([*words, *QUICK[2:]], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)

    assert process.returncode == 0, err
    assert json.loads(out.splitlines()[-1])["type"] == "end"
    assert "Ctrl-C" in err
    assert not read(record).damage


@pytest.mark.skipif(not hasattr(fcntl, "F_SETPIPE_SZ"), reason="the size of a pipe is Linux's")
def test_a_reader_who_stalls_holds_up_neither_the_recording_nor_ctrl_c(tmp_path: Path) -> None:
    record, memory = tmp_path / "flight.mcap", tmp_path / "memory"
    kept = ("--jsonl", "--record", str(record), "--state", str(memory), "-o", str(tmp_path / "model.json"))
    words = [sys.executable, "-m", "rotorfit", "track", "--link", "sim", *kept, *QUICK[2:], "--pace", "1.5"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)  # two states fill it
        watch = threading.Timer(120.0, process.kill)
        watch.start()
        assert any("nobody reads the output: it waits, and what is recorded goes on" in said for said in process.stderr)
        stalled = _time_of(memory)
        while _time_of(memory) < stalled + 2.0:
            assert process.poll() is None
            time.sleep(0.1)
        watch.cancel()
        process.send_signal(signal.SIGINT)
        code, (_, err) = process.wait(60), process.communicate()

    assert code == 0, err
    assert "the last lines were not printed" in err
    fitted = training_flights(load(tmp_path / "model.json"))[0]
    assert len(fitted) == 1
    poses = read(record).tables["/rotorfit/pose"].columns["log_time"]
    assert (poses[-1] - poses[0]) / 1e9 > stalled + 1.0


def test_a_reader_who_goes_away_ends_nothing_and_the_end_comes_on_stderr(tmp_path: Path) -> None:
    record, model = tmp_path / "flight.mcap", tmp_path / "model.json"
    words = ["track", "--link", "sim", "--for", "10", "--jsonl", "--record", str(record), "-o", str(model), *QUICK]
    with subprocess.Popen(
        [sys.executable, "-m", "rotorfit", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.stdout.close()
        _, err = process.communicate(timeout=60)

    assert process.returncode == 0, err
    assert err.count("the output takes nothing any more (Broken pipe): alarms and the end come here") == 1
    assert json.loads(err.splitlines()[-1])["models"] == [str(model)]
    assert '"state"' not in err
    poses = read(record).tables["/rotorfit/pose"].columns["log_time"]
    assert (poses[-1] - poses[0]) / 1e9 > 9.0


def _time_of(memory: Path) -> float:
    """Second of the flight up to which a tracker remembers."""
    with np.load(memory) as kept:
        return float(kept["now"])


def test_after_a_kill_it_goes_on_within_a_second(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    kept = ("--link", "sim", "--jsonl", "--state", str(tmp_path / "memory"), "--record", str(tmp_path / "flight.mcap"))
    words = [sys.executable, "-m", "rotorfit", "track", *kept]
    last = 0.0
    with subprocess.Popen([*words, *QUICK[2:], "--pace", "4"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while last < 6.5:
            last = json.loads(process.stdout.readline())["time"]
        time.sleep(0.3)
        os.kill(process.pid, signal.SIGKILL)
    request.getfixturevalue("looks_here")
    model = tmp_path / "model.json"
    again = run(*kept, "--for", "3", "-o", str(model), *QUICK)
    first = json.loads(again.stdout.splitlines()[0])["time"]

    assert first >= last - 1.0  # the flight that is remembered may be ahead of the last look that was told
    assert "flight.mcap is kept; the recording goes on in" in again.stderr
    files = {str(tmp_path / name): flight(tmp_path / name) for name in ("flight.mcap", "flight-2.mcap")}
    named = [source for source in load(model).flights if source.path != UNRECORDED]  # what the kill lost
    assert {source.path for source in named} == files.keys()
    for source in named:
        whole = files[source.path]
        assert source.sha256 == whole.sha256
        assert whole.span[0] <= source.span[0] < source.span[1] <= whole.span[1] + 0.1


def test_the_page_shows_all_that_is_told_to_who_has_the_key_alone() -> None:
    said: list[str] = []
    page = LivePage(0, "sim,wind=1", said.append)
    try:
        page.gains({"type": "gains", "axes": {"x": {}}}, 0)
        page.state(Tracked(2.0, {"x": TrackedAxis()}, (ALARM,)), 0, 0)
        address = urlsplit(said[0].split()[-1])
        port = address.port or 0

        def asked(path: str, **headers: str) -> tuple[int, str, str]:
            connection = HTTPConnection("127.0.0.1", port, timeout=10)
            connection.request("GET", path, headers={"Host": f"127.0.0.1:{port}", **headers})
            answer = connection.getresponse()
            body = answer.read1(4000) if path == "/events" else answer.read()
            cookie = (answer.getheader("set-cookie") or "").partition(";")[0]
            if path == "/events" and answer.status == 200:
                while b'"state"' not in body:
                    body += answer.read1(4000)
            connection.close()
            return answer.status, body.decode(), cookie

        assert asked("/")[0] == 401
        assert asked("/events")[0] == 401
        status, _, cookie = asked(f"/?{address.query}")
        assert status == 200
        assert asked("/page/uPlot.iife.min.js", Cookie=cookie)[0] == 200
        assert asked("/page/other.py", Cookie=cookie)[0] == 404
        assert asked("/events", Cookie=cookie, **{"Sec-Fetch-Site": "cross-site"})[0] == 403
        status, body, _ = asked("/events", Cookie=cookie)
        assert status == 200
        assert 'data: "sim,wind=1"' in body
        assert '"type": "gains"' in body
        assert '"cause": "payload"' in body
        assert '"type": "state"' in body
    finally:
        page.close()


def test_a_page_that_is_opened_after_an_hour_has_the_alarms_of_the_beginning() -> None:
    async def opened(seen: int) -> list[str]:
        events = [event async for event in feed.events(seen)]
        return [line.removeprefix("data: ") for line in "".join(events).splitlines() if line.startswith("data: {")]

    feed = Feed()
    for line in (ALARM.to_mapping(), {"type": "gains"}, *({"type": "state", "time": n} for n in range(KEPT + 2))):
        feed.add(line)
    feed.over = True
    told, again = (list(map(json.loads, asyncio.run(opened(seen)))) for seen in (0, KEPT))

    assert [line["type"] for line in told[:3]] == ["alarm", "gains", "state"]
    assert [line["time"] for line in told[2:]] == list(range(2, KEPT + 2))
    assert [line["time"] for line in again] == [KEPT - 2, KEPT - 1, KEPT, KEPT + 1]  # a browser that was away


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        result = run("--link", "sim", f"--page={other.getsockname()[1]}", "--for", "1")

    assert result.exit_code == 1
    assert "choose another port" in result.stderr
