"""Faults of real links, by the wall clock: peers that freeze, poses, clocks, second flights, lines that are too slow,
processes that are killed. Hover first, and a recording that is readable."""

import json
import os
import re
import select
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_links_live import a_master, fake_words, fly_words, free_port, plan_of, process, with_limits

from rotorfit.app.workflows import load_flight
from rotorfit.diagnosis.survey import survey_logs
from rotorfit.files.log_span import parse_log
from rotorfit.files.logs import read

pytestmark = pytest.mark.slow

TOPIC = "/vicon/bebop/bebop"
LINKS = ("mavlink", "tello", "ros1")


@contextmanager
def flying(
    folder: Path, kind: str, *options: str, line: "Line | None" = None, own: dict[str, str] | None = None, **peers: str
) -> Iterator[tuple["subprocess.Popen[str]", ...]]:
    """The process of a flight at 50 commands a second, and that of its vehicle, four seconds into the recording.

    Args:
        folder: For the recording `flight.mcap` and the commands as they arrived, `arrivals.json`.
        kind: One of `LINKS`.
        options: Further options of the fake vehicle.
        line: Between a flight over MAVLink and its vehicle.
        own: Environment of the flight, beyond that of the vehicle.
        peers: Environment of the vehicle.
    """
    port, host = free_port(), f"127.5.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    card, vehicle, link, fake = {
        "mavlink": ("mavlink", "m100", f"mavlink:udpin:127.0.0.1:{port}", (
            "fake_autopilot", "--vehicle", "m100", "--address", f"udpout:127.0.0.1:{port}", "--ardupilot")),
        "tello": ("tello", "tello", f"tello:{host}:{port}", (
            "fake_tello", "--vehicle", "tello", "--host", host, "--state-port", str(port))),
        "ros1": ("bebop2-drone-dev", "bebop2", "ros1", ("fake_bebop", "--kind", "TransformStamped", "--topic", TOPIC)),
    }[kind]  # fmt: skip
    plan = replace(plan_of(with_limits(card, vehicle), vehicle, 8, 60.0), rate=50.0)
    log = folder / "flight.mcap"
    fake = (*fake, *options, "--arrivals", str(folder / "arrivals.json"))
    with process(*fake_words(*fake), ready="ready", **peers) as peer:
        if line:
            link = f"mavlink:{line.laid(port)}"
        flight = subprocess.Popen(
            fly_words(folder, plan, link, "--no-land"), env={**os.environ, **peers, **(own or {})},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            deadline = time.monotonic() + 60
            while not log.exists() and time.monotonic() < deadline and flight.poll() is None:
                time.sleep(0.05)
            time.sleep(4.0)  # a recording of less than two seconds of moving poses is refused
            assert flight.poll() is None, flight.communicate()
            yield flight, peer
        finally:
            peer.send_signal(signal.SIGCONT)
            flight.kill()
            flight.communicate()


@pytest.fixture
def peers(kind: str) -> Iterator[dict[str, str]]:
    """The environment of a link's processes: over ROS 1, where the master is, a new one, which knows no dead flight."""
    if kind == "mavlink":
        pytest.importorskip("pymavlink", reason="pip install 'rotorfit[mavlink]'")
    with a_master() if kind == "ros1" else nullcontext({}) as environment:
        yield environment


def sent(folder: Path) -> tuple["np.ndarray[Any, Any]", "np.ndarray[Any, Any]"]:
    """When commands were sent by the recording [ns], and whether they asked the vehicle to move."""
    table = read(folder / "flight.mcap").tables["/rotorfit/command"].columns
    parts = np.column_stack([table[f"twist.{part}"] for part in ("linear.x", "linear.y", "linear.z", "angular.z")])
    return np.asarray(table["log_time"], np.int64), np.abs(parts).max(axis=1) > 0


def ended_in_hover(folder: Path, flight: "subprocess.Popen[str]", fault: int) -> tuple[str, float]:
    """The flight ends by itself, in hover and readable; notes and its last line, and how long it moved on [s]."""
    out, err = flight.communicate(timeout=40)
    assert flight.returncode == 1, err
    assert err.strip().splitlines() == [*json.loads(out)["notes"], err.strip().splitlines()[-1]]
    at, moving = sent(folder)
    assert moving[at < fault].any()
    assert not moving[-1]
    assert load_flight(parse_log(str(folder / "flight.mcap"))).command_time.size > 50
    return err.strip(), (at[moving][-1] - fault) / 1e9


def told(kind: str, error: str, after: float) -> None:
    print(f"\n{kind}: last moving command {after:.2f} s after the fault: {error.partition('; the log')[0]}")


# Peers


@pytest.mark.parametrize("kind", LINKS)
def test_a_frozen_peer_ends_the_flight_in_hover(kind: str, tmp_path: Path, peers: dict[str, str]) -> None:
    with flying(tmp_path, kind, **peers) as (flight, peer):
        peer.send_signal(signal.SIGSTOP)
        error, after = ended_in_hover(tmp_path, flight, time.time_ns())

    told(kind, error, after)
    assert "the pose is lost" in error or "the link" in error
    assert after < 1.0


@pytest.mark.parametrize("kind", LINKS)
def test_poses_that_repeat_end_the_flight_in_hover(kind: str, tmp_path: Path, peers: dict[str, str]) -> None:
    with flying(tmp_path, kind, **peers) as (flight, peer):
        peer.send_signal(signal.SIGUSR1)
        error, after = ended_in_hover(tmp_path, flight, time.time_ns())

    told(kind, error, after)
    assert "the pose is frozen" in error
    assert after < 1.5


@pytest.mark.parametrize("kind", LINKS)
def test_poses_that_jump_end_the_flight_in_hover(kind: str, tmp_path: Path, peers: dict[str, str]) -> None:
    with flying(tmp_path, kind, **peers) as (flight, peer):
        peer.send_signal(signal.SIGUSR2)
        error, after = ended_in_hover(tmp_path, flight, time.time_ns())

    told(kind, error, after)
    assert "the pose jumps" in error or "too fast" in error
    assert after < 1.0


# Clocks


@pytest.fixture
def steps(tmp_path: Path) -> tuple[dict[str, str], Path]:
    """The environment of a process whose time of day is set as a file says; the file."""
    if not shutil.which("faketime"):
        pytest.skip("faketime is not here (Debian: apt-get install faketime)")
    words = ["faketime", "-m", "-f", "+0", "printenv", "LD_PRELOAD"]
    library = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    offset = tmp_path / "offset"
    offset.write_text("+0", encoding="utf-8")
    # The file is looked at once a second. Setting a clock leaves CLOCK_MONOTONIC alone; told so, Debian's libfaketime
    # makes time.sleep fail (EINVAL).
    sleep = "import select, time\ntime.sleep = lambda seconds: select.select((), (), (), seconds) and None\n"
    (tmp_path / "sitecustomize.py").write_text(sleep, encoding="utf-8")
    return {
        "PYTHONPATH": str(tmp_path), "LD_PRELOAD": library, "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "FAKETIME_TIMESTAMP_FILE": str(offset), "FAKETIME_CACHE_DURATION": "1", "FAKETIME_DISABLE_SHM": "1",
    }, offset  # fmt: skip


def set_by(offset: Path, step: str) -> None:
    """Sets the clock of the process that looks at the file, which must never be seen half written."""
    (new := offset.with_suffix(".new")).write_text(step, encoding="utf-8")
    new.replace(offset)


def flew_on(folder: Path, flight: "subprocess.Popen[str]") -> None:
    """The flight goes on as if nothing had been; Ctrl-C ends it; times of the recording neither stop nor jump."""
    time.sleep(3.0)
    assert flight.poll() is None, flight.communicate()
    flight.send_signal(signal.SIGINT)
    ended_in_hover(folder, flight, time.time_ns())
    log = read(folder / "flight.mcap")
    for name in ("command", "pose"):
        pace = np.diff(np.asarray(log.tables[f"/rotorfit/{name}"].columns["log_time"], np.int64))
        assert pace.min() >= 0
        assert pace.max() < 500_000_000


@pytest.mark.parametrize("step", ["+30", "-30"])
@pytest.mark.parametrize("kind", LINKS)
def test_a_step_of_our_own_time_of_day_is_not_felt(
    kind: str, step: str, tmp_path: Path, peers: dict[str, str], steps: tuple[dict[str, str], Path]
) -> None:
    environment, offset = steps
    with flying(tmp_path, kind, own=environment, **peers) as (flight, _):
        set_by(offset, step)
        flew_on(tmp_path, flight)


@pytest.mark.parametrize(("kind", "step"), [("mavlink", "+30"), ("mavlink", "-30"), ("tello", "-30")])
def test_a_step_of_the_senders_clock_is_followed(
    kind: str, step: str, tmp_path: Path, peers: dict[str, str], steps: tuple[dict[str, str], Path]
) -> None:
    environment, offset = steps
    with flying(tmp_path, kind, **peers, **environment) as (flight, _):
        set_by(offset, step)
        flew_on(tmp_path, flight)
    if kind == "mavlink":
        (survey,) = survey_logs([str(tmp_path / "flight.mcap")])
        found_steps = [
            float(found[1]) for _, text in survey.events if (found := re.search(r"clock stepped by (\S+) s", text))
        ]
        assert found_steps == [pytest.approx(float(step), abs=0.05)]


@pytest.mark.parametrize("kind", ["ros1"])
def test_poses_whose_clock_goes_on_by_half_a_minute_end_nothing(
    kind: str, tmp_path: Path, peers: dict[str, str]
) -> None:
    # without libfaketime: under it the poses of the fake paused for half a second at this step in 3 of 11 flights
    with flying(tmp_path, kind, **peers) as (flight, peer):
        peer.send_signal(signal.SIGHUP)
        flew_on(tmp_path, flight)

    flight_read = load_flight(parse_log(str(tmp_path / "flight.mcap")))
    assert any("the clock of" in note.text and "steps by -30" in note.text for note in flight_read.notes)


@pytest.mark.parametrize("kind", ["ros1"])
def test_poses_whose_clock_goes_back_end_the_flight_in_hover(
    kind: str, tmp_path: Path, peers: dict[str, str], steps: tuple[dict[str, str], Path]
) -> None:
    environment, offset = steps
    with flying(tmp_path, kind, **peers, **environment) as (flight, _):
        set_by(offset, "-30")
        error, after = ended_in_hover(tmp_path, flight, time.time_ns())

    told(kind, error, after)
    assert "the clock of the poses jumped back by" in error
    assert after < 4.0  # the step is felt within one or two, and the pose counts as frozen a second later


# Second flights


@pytest.mark.parametrize(
    ("kind", "why"),
    [("mavlink", "is in use by another program"), ("tello", "is taken"), ("ros1", "too; end it first")],
)
def test_a_second_flight_on_the_port_or_topic_of_the_first_is_refused_and_does_not_disturb_it(
    kind: str, why: str, tmp_path: Path, peers: dict[str, str]
) -> None:
    with flying(tmp_path, kind, **peers) as (flight, _):
        words = [*flight.args]  # type: ignore[misc]
        words[words.index("-o") + 1] = str(tmp_path / "second.mcap")
        second = subprocess.run(
            words, env={**os.environ, **peers}, capture_output=True, text=True, timeout=60, check=False
        )
        time.sleep(1.0)
        still = flight.poll()

    assert second.returncode == 1
    assert why in second.stderr
    assert len(second.stderr.strip().splitlines()) == 1
    assert still is None


# Lines that are slower than the plan


class Line:
    """A serial line or a TCP connection between a flight and a fake autopilot on UDP, that carries so much and no more.

    Attributes:
        rate: What it carries towards the vehicle [byte/s]; what comes from there it carries at once.
    """

    def __init__(self, kind: str) -> None:
        self.rate, self._kind, self._over = 1e6, kind, threading.Event()
        self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # as small as in a bridge to a serial line
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def laid(self, port: int) -> str:
        """Lays it to the vehicle that sends to a port; the address of its other end."""
        self._vehicle.bind(("127.0.0.1", port))
        if self._kind == "serial":
            self._end, self._ours = os.openpty()
            address = os.ttyname(self._ours)
        else:
            self._server.bind(("127.0.0.1", 0))
            self._server.listen()
            address = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        self._thread.start()
        return address

    def taken_up(self) -> None:
        self._over.set()
        self._thread.join()
        for one in (self._vehicle, self._server):
            one.close()
        if self._kind == "serial":
            os.close(self._end)
            os.close(self._ours)

    def _carry(self) -> None:
        if self._kind == "tcp":
            connection = self._server.accept()[0]
            self._end = connection.fileno()
        os.set_blocking(self._end, False)
        peer, due = None, time.monotonic()
        while not self._over.is_set():
            ready, _, _ = select.select((self._vehicle, self._end), (), (), 0.005)
            if self._vehicle in ready:
                packet, peer = self._vehicle.recvfrom(2048)
                with suppress(OSError):  # full, or the flight is over
                    os.write(self._end, packet)
            now = time.monotonic()
            if self._end in ready and peer and self.rate and now >= due:
                try:
                    part = os.read(self._end, 64)
                except OSError:  # the flight is over
                    part = b""
                if not part:
                    break
                self._vehicle.sendto(part, peer)
                due = max(due, now - 0.02) + len(part) / self.rate
            elif self._end in ready:
                time.sleep(0.001)


@pytest.fixture
def line(request: pytest.FixtureRequest) -> Iterator[Line]:
    pytest.importorskip("pymavlink", reason="pip install 'rotorfit[mavlink]'")
    pytest.importorskip("serial", reason="pip install 'rotorfit[mavlink]'")
    laid = Line(request.param)
    yield laid
    laid.taken_up()


@pytest.mark.parametrize("line", ["serial", "tcp"], indirect=True)
def test_a_line_that_takes_nothing_any_more_ends_the_flight(line: Line, tmp_path: Path) -> None:
    with flying(tmp_path, "mavlink", line=line) as (flight, _):
        line.rate = 0.0
        fault = time.time_ns()
        out, err = flight.communicate(timeout=30)

    told("mavlink", err, (sent(tmp_path)[0][-1] - fault) / 1e9)
    assert flight.returncode == 1
    assert err.strip().splitlines()[:-1] == json.loads(out)["notes"]
    assert load_flight(parse_log(str(tmp_path / "flight.mcap"))).command_time.size > 50


@pytest.mark.parametrize("line", ["serial", "tcp"], indirect=True)
def test_a_line_slower_than_the_plan_ends_the_flight_before_commands_are_old(line: Line, tmp_path: Path) -> None:
    with flying(tmp_path, "mavlink", line=line) as (flight, peer):
        line.rate = 1500.0  # of about 3300
        error, after = ended_in_hover(tmp_path, flight, time.time_ns())
        hover = sent(tmp_path)[0][sent(tmp_path)[1]][-1]
        time.sleep(3.0)
        peer.send_signal(signal.SIGTERM)
        peer.wait(10)
        arrived = json.loads((tmp_path / "arrivals.json").read_text(encoding="utf-8"))

    told("mavlink", error, after)
    late = max(at for at, command in arrived if any(command)) - hover
    print(f"  the vehicle had its last moving command {late / 1e9:.2f} s after it was sent")
    assert "lower `rate`" in error
    assert late < 2_000_000_000
    assert not any(arrived[-1][1])


@pytest.mark.parametrize("kind", ["ros1"])
def test_a_driver_slower_than_the_plan_gets_the_latest_commands(
    kind: str, tmp_path: Path, peers: dict[str, str]
) -> None:
    with flying(tmp_path, kind, "--slow", "0.05", **peers) as (flight, peer):
        flight.send_signal(signal.SIGINT)
        ended_in_hover(tmp_path, flight, time.time_ns())
        at, moving = sent(tmp_path)
        time.sleep(1.0)
        peer.send_signal(signal.SIGTERM)
        peer.wait(10)
        arrived = json.loads((tmp_path / "arrivals.json").read_text(encoding="utf-8"))

    late = max(at for at, command in arrived if any(command)) - at[moving][-1]
    print(
        f"\nros1: {len(arrived)} of {len(at)} commands taken, the last moving one {late / 1e9:.2f} s after it was sent"
    )
    assert len(arrived) < 0.6 * len(at)
    assert late < 300_000_000
    assert not any(arrived[-1][1])


# Flights that are killed


@pytest.mark.parametrize("kind", LINKS)
def test_a_flight_that_is_killed_leaves_a_recording_that_is_less_than_a_second_old(
    kind: str, tmp_path: Path, peers: dict[str, str]
) -> None:
    with flying(tmp_path, kind, **peers) as (flight, _):
        flight.send_signal(signal.SIGKILL)
        killed = time.time_ns()
        flight.wait()

    log = read(tmp_path / "flight.mcap")
    ages = {
        name: (killed - int(np.max(log.tables[f"/rotorfit/{name}"].columns["log_time"]))) / 1e9
        for name in ("command", "pose")
    }
    print(f"\n{kind}: age of the last command and pose on the disk at kill -9: {ages}")
    assert max(ages.values()) < 1.0
    assert len(log.tables["/rotorfit/command"].columns["log_time"]) > 100
