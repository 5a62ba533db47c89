"""Peers that freeze and processes that are killed, by the wall clock: hover first, and a recording that is readable."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_links_live import fake_words, fly_words, free_port, master, plan_of, process, with_limits  # noqa: F401

from rotorfit.files.logs import read

pytestmark = pytest.mark.slow

TOPIC = "/vicon/bebop/bebop"


@contextmanager
def flying(folder: Path, kind: str, environment: dict[str, str]) -> Iterator[tuple["subprocess.Popen[str]", ...]]:
    """The process of a flight over a link, and that of its vehicle, once commands are sent."""
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
    with process(*fake_words(*fake), ready="ready", **environment) as peer:
        flight = subprocess.Popen(
            fly_words(folder, plan, link, "--no-land"), env={**os.environ, **environment},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            deadline = time.monotonic() + 60
            while not log.exists() and time.monotonic() < deadline and flight.poll() is None:
                time.sleep(0.05)
            time.sleep(3.0)
            yield flight, peer
        finally:
            peer.send_signal(signal.SIGCONT)
            flight.kill()
            flight.communicate()


@pytest.mark.parametrize("kind", ["mavlink", "tello", "ros1"])
def test_a_frozen_peer_ends_the_flight_in_hover(kind: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    environment = request.getfixturevalue("master") if kind == "ros1" else {}
    with flying(tmp_path, kind, environment) as (flight, peer):
        peer.send_signal(signal.SIGSTOP)
        frozen = time.time_ns()
        out, err = flight.communicate(timeout=40)

    assert (flight.returncode, out) == (1, "")
    assert len(err.strip().splitlines()) == 1
    assert "the pose is lost" in err or "the link" in err
    table = read(tmp_path / "flight.mcap").tables["/rotorfit/command"].columns
    sent = np.column_stack([table[f"twist.{part}"] for part in ("linear.x", "linear.y", "linear.z", "angular.z")])
    at = np.asarray(table["log_time"], np.int64)
    moving = np.abs(sent).max(axis=1) > 0
    print(f"\n{kind}: last moving command {(at[moving][-1] - frozen) / 1e6:.0f} ms after it froze: {err.strip()}")
    assert moving[at < frozen].any()
    assert at[moving][-1] - frozen < 1_000_000_000
    assert not moving[-1]


@pytest.mark.parametrize("kind", ["mavlink", "tello"])
def test_a_flight_that_is_killed_leaves_a_recording_that_is_less_than_a_second_old(kind: str, tmp_path: Path) -> None:
    with flying(tmp_path, kind, {}) as (flight, _):
        flight.send_signal(signal.SIGKILL)
        killed = time.time_ns()
        flight.wait()

    log = read(tmp_path / "flight.mcap")
    ages = {
        name: (killed - int(np.max(log.tables[f"/rotorfit/{name}"].columns["log_time"]))) / 1e9
        for name in ("command", "pose")
    }
    print(f"\n{kind}: age of the last command and pose on the disk at kill -9: {ages}", file=sys.stderr)
    assert max(ages.values()) < 1.0
    assert len(log.tables["/rotorfit/command"].columns["log_time"]) > 100


@pytest.mark.parametrize(("kind", "told"), [("mavlink", "is in use by another program"), ("ros1", "too; end it first")])
def test_a_second_flight_on_the_port_or_topic_of_the_first_is_refused_and_does_not_disturb_it(
    kind: str, told: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    environment = request.getfixturevalue("master") if kind == "ros1" else {}
    with flying(tmp_path, kind, environment) as (flight, _):
        words = [*flight.args]  # type: ignore[misc]
        words[words.index("-o") + 1] = str(tmp_path / "second.mcap")
        second = subprocess.run(
            words, env={**os.environ, **environment}, capture_output=True, text=True, timeout=60, check=False
        )
        time.sleep(1.0)
        still = flight.poll()

    assert second.returncode == 1
    assert told in second.stderr
    assert len(second.stderr.strip().splitlines()) == 1
    assert still is None
