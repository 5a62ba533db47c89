"""Flights over real middleware against fake vehicles, which run the virtual flight room on the wall clock.

Slow, and of the wall clock: `pytest -m slow tests/flying/test_links_live.py -s` prints what was reached. What a flight
needs beyond rotorfit is installed where that is possible; else the flight is skipped, and says why.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from rotorfit.app.live.ros_topics import DIAGNOSTICS, PREFIX, TOPICS
from rotorfit.app.workflows import fit_logs
from rotorfit.core.flight_plan import AxisExcitation, Plan, Sines, Space
from rotorfit.core.frames import AXES
from rotorfit.core.results import Fit
from rotorfit.files.cards import builtin_cards
from rotorfit.files.log_span import parse_log
from rotorfit.files.logs import read
from rotorfit.files.plans import save_plan
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.sim import SimLink
from rotorfit.flying.preflight import preflight, refuse
from rotorfit.flying.recorder import card_as_recorded, record
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.sensors import Mocap
from rotorfit.simulation.vehicle import load_vehicle

pytestmark = pytest.mark.slow

FAKES = Path(__file__).parents[1] / "fakes"
DEBIAN = "/usr/lib/python3/dist-packages"
ROS1 = tuple(
    f"python3-{name}" for name in ("rospy", "rosmaster", "geometry-msgs", "nav-msgs", "std-msgs", "diagnostic-msgs")
)
STANDARD = {DIAGNOSTICS: "diagnostic_msgs/DiagnosticArray", **{f"{PREFIX}/{name}": k for name, k in TOPICS.items()}}
DURATION = 45.0
SPACE = Space((-6.0, -6.0, 0.4), (6.0, 6.0, 4.0), (0.0, 0.0, 1.5, 0.0), 2.0, 1.2)
PARTS = ("input", "damping", "delay")
AMPLITUDES = {"bebop2": (0.12, 0.12, 0.25, 0.25), "tello": (0.35, 0.35, 0.3, 0.4), "m100": (0.35, 0.35, 0.3, 0.6)}

# A program of this interpreter with Debian's packages behind its own, never before: they would shadow numpy
WITH_DEBIAN = (
    f"import sys, runpy; sys.path.append({DEBIAN!r}); sys.argv = sys.argv[1:]; sys.path.insert(0, {str(FAKES)!r}); "
    "runpy.run_path(sys.argv[0], run_name='__main__')"
)


@dataclass(frozen=True)
class Live:
    """What a flight over middleware left."""

    told: Mapping[str, Any]
    log: Path
    arrived: list[tuple[int, tuple[float, ...]]]


def plan_of(card: Mapping[str, Any], vehicle: str, seed: int, duration: float = DURATION, height: float = 1.5) -> Plan:
    """Sines on all four axes at once, of different frequencies, so that no axis looks like another."""
    rng = np.random.default_rng(seed)
    excitations = []
    for number, axis in enumerate(AXES):
        frequency = np.array([1.3, 2.3, 3.7, 5.3]) + 0.2 * number
        amplitude = AMPLITUDES[vehicle][number] * np.array([0.3, 0.3, 0.25, 0.15])
        signal = Sines(tuple(amplitude), tuple(frequency), tuple(rng.uniform(0, 2 * np.pi, 4)))
        excitations.append(AxisExcitation(axis, "command", 0.0, duration, signal))
    space = replace(SPACE, start=(0.0, 0.0, height, 0.0))
    return Plan("live", "multisine", card, 100.0, duration, 2.0, tuple(excitations), None, space)


def with_limits(card: str, vehicle: str) -> dict[str, Any]:
    """A built-in card with the limits of a vehicle of the flight room."""
    return {**builtin_cards()[card].raw, "limits": load_vehicle(vehicle).card()["limits"]}


@contextmanager
def process(*words: str, ready: str = "", **environment: str) -> Iterator["subprocess.Popen[str]"]:
    """A process that is asked to end afterwards; waits until it prints `ready`."""
    started = subprocess.Popen(words, env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True)
    try:
        assert started.stdout is not None
        while ready and (line := started.stdout.readline().strip()) != ready:
            assert line or started.poll() is None, f"{words} ended with {started.returncode}"
        yield started
    finally:
        started.send_signal(signal.SIGTERM)
        try:
            started.wait(10)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()


def fake_words(name: str, *options: str) -> tuple[str, ...]:
    return (sys.executable, "-c", WITH_DEBIAN, str(FAKES / f"{name}.py"), *options)


def fly_words(folder: Path, plan: Plan, link: str, *options: str) -> list[str]:
    """The command line that flies a plan, which is written first."""
    save_plan(plan, folder / "plan.toml")
    words = [sys.executable, "-m", "rotorfit", "fly", str(folder / "plan.toml"), "--link", link]
    return [*words, "-o", str(folder / "flight.mcap"), "--yes", "--json", *options]


def fly_live(
    folder: Path, plan: Plan, link: str, fake: tuple[str, ...], *options: str, **environment: str
) -> Live:  # fmt: skip
    """The flight by the command line, with the fake vehicle and rotorfit each in a process of its own."""
    arrivals, log = folder / "arrivals.json", folder / "flight.mcap"
    words = fly_words(folder, plan, link, *(options or ("--no-land",)))
    with process(*fake, "--arrivals", str(arrivals), ready="ready", **environment):
        done = subprocess.run(
            words, env={**os.environ, **environment}, capture_output=True, text=True, timeout=150, check=False
        )
    assert done.returncode == 0, done.stderr
    return Live(json.loads(done.stdout), log, [(at, tuple(one)) for at, one in json.loads(arrivals.read_text())])


def fly_direct(folder: Path, plan: Plan, vehicle: str, mocap: Mocap) -> Path:
    """The same plan in the flight room without anything between, in simulated time, with the fake's sensors."""
    own = load_vehicle(vehicle)
    plan = replace(plan, card=own.card())
    link = SimLink(FlightRoom(own, Conditions(mocap=mocap), 77, plan.space.start))
    log = folder / "direct.mcap"
    refuse(preflight(plan, link))
    card = tomli_w.dumps(card_as_recorded(plan.card))
    assert fly(plan, link, record(log, {"card": card}), land=False).reason == "completed"
    return log


def transport(live: Live) -> tuple[float, float, float, int]:
    """From sending a command to its arrival at the vehicle: mean, median, 99th percentile [ms]; how many were lost."""
    table = read(live.log).tables["/rotorfit/command"].columns
    names = ("twist.linear.x", "twist.linear.y", "twist.linear.z", "twist.angular.z")
    sent = np.column_stack([table[name] for name in names])
    times = np.asarray(table["log_time"], np.int64)
    at = np.array([one for one, _ in live.arrived], np.int64)
    values = np.array([one for _, one in live.arrived])
    first = np.searchsorted(times, at - 200_000_000)
    way = []
    for moment, value, begin in zip(at, values, first, strict=True):
        last = np.searchsorted(times, moment, "right")
        same = np.flatnonzero(np.abs(sent[begin:last] - value).max(axis=1) < 0.006) if last > begin else []
        if len(same) and np.abs(value).max() > 0:
            way.append((moment - times[begin + same[-1]]) / 1e6)
    return float(np.mean(way)), float(np.median(way)), float(np.quantile(way, 0.99)), len(times) - len(at)


def told(live: Live, name: str) -> None:
    log = read(live.log)
    commands, poses = (log.tables[f"/rotorfit/{one}"].columns for one in ("command", "pose"))
    span = np.ptp(np.asarray(commands["log_time"], np.int64)) / 1e9
    age = (np.asarray(poses["log_time"], np.int64) - np.asarray(poses["header.stamp"], np.int64)) / 1e6
    jitter = live.told["jitter"]
    mean, p50, p99, lost = transport(live)
    print(f"\n{name}: {live.told['reason']}: {live.told['text']}")
    late = ", ".join(f"{name} {1e3 * value:.2f} ms" for name, value in jitter.items())
    print(f"  commands {len(commands['log_time']) / span:.1f}/s, late by {late}; notes {live.told['notes']}")
    print(f"  command to vehicle mean {mean:.2f} ms, p50 {p50:.2f} ms, p99 {p99:.2f} ms, {lost} not arrived")
    print(f"  {len(age)} poses, {len(age) / span:.1f}/s, stamp to arrival p50 {np.median(age):.1f} ms, "
          f"p99 {np.quantile(age, 0.99):.1f} ms")  # fmt: skip


def agree(live: Live, direct: Path) -> None:
    """Prints coefficients side by side; every pair of 95 % intervals must overlap.

    A delay over middleware truly holds the way there as well, so its interval may end that much lower.
    """
    # by the law of three coefficients: with a lag, this flight does not tell those of z and yaw apart
    fits: list[Fit] = [fit_logs([parse_log(str(one))], structure="first_order_delay") for one in (live.log, direct)]
    way, apart = transport(live)[0] / 1e3, list[str]()
    for axis in AXES:
        over, plain = (each.model.axes[axis] for each in fits)
        for part in PARTS:
            (a, b), (low, high) = over.ci95[part], plain.ci95[part]
            assert None not in (a, b, low, high), f"{axis}.{part}: {over.status[part]}, {plain.status[part]}"
            name, least = f"{axis}.{part}", a - way if part == "delay" else a
            verdict = "" if least <= high and low <= b else "APART"
            apart += [name] if verdict else []
            # where the flight refutes the law, the value is withheld and the interval is not
            values = [np.nan if value is None else value for value in (getattr(over, part), getattr(plain, part))]
            one, other = (
                f"live {values[0]:8.4f} [{a:8.4f}, {b:8.4f}]",
                f"direct {values[1]:8.4f} [{low:8.4f}, {high:8.4f}]",
            )
            print(f"  {name:12s} {one}   {other} {verdict}")
    assert apart == []


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


# ROS 1


@contextmanager
def a_master() -> Iterator[dict[str, str]]:
    """The environment of a master that is running."""
    if not (shutil.which("rosmaster") and Path(DEBIAN, "rospy").is_dir() and Path(DEBIAN, "diagnostic_msgs").is_dir()):
        if os.geteuid() or not shutil.which("apt-get"):
            pytest.skip(f"ROS 1 is not here, and this is no root on Debian; install {' '.join(ROS1)}")
        words = ["apt-get", "install", "-y", "--no-install-recommends", *ROS1]
        if subprocess.run(words, capture_output=True, check=False).returncode:
            pytest.skip(f"ROS 1 is not here, and `{' '.join(words)}` failed")
    found = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.append({DEBIAN!r}); import rospy, nav_msgs, diagnostic_msgs.msg"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if found.returncode:
        pytest.skip(f"Debian's rospy does not load in this Python: {found.stderr.strip().splitlines()[-1]}")
    port = free_port()
    environment = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    with process("/usr/bin/rosmaster", "--core", "-p", str(port), **environment):
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            with socket.socket() as one:
                if one.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        yield environment


@pytest.fixture(scope="module")
def master() -> Iterator[dict[str, str]]:
    with a_master() as environment:
        yield environment


@pytest.mark.parametrize(
    ("kind", "card", "topic"),
    [
        ("TransformStamped", "bebop2-drone-dev", "/vicon/bebop/bebop"),
        ("Odometry", "bebop2-odometry", "/bebop/odom"),
        ("PoseStamped", "bebop2-posestamped", "/rigid_body_1/pose"),
    ],
)
def test_a_flight_over_ros_1_identifies_what_a_direct_one_does(
    tmp_path: Path, master: dict[str, str], kind: str, card: str, topic: str
) -> None:
    raw = with_limits("bebop2-drone-dev" if kind == "PoseStamped" else card, "bebop2")
    if kind == "PoseStamped":
        raw = {**raw, "pose": builtin_cards()["bebop2-optitrack"].raw["pose"]}
    plan = plan_of(raw, "bebop2", 1)

    live = fly_live(tmp_path, plan, "ros1", fake_words("fake_bebop", "--kind", kind, "--topic", topic), **master)

    told(live, f"ros1, {kind}")
    assert live.told["reason"] == "completed"
    agree(live, fly_direct(tmp_path, plan, "bebop2", Mocap()))


def test_a_tracker_beside_a_flight_over_ros_1_publishes_what_it_knows_and_nothing_else(
    tmp_path: Path, master: dict[str, str]
) -> None:
    raw = with_limits("bebop2-drone-dev", "bebop2")
    (tmp_path / "card.toml").write_text(tomli_w.dumps(raw), encoding="utf-8")
    fake = fake_words("fake_bebop", "--kind", "TransformStamped", "--topic", "/vicon/bebop/bebop")
    words = [sys.executable, "-m", "rotorfit", "track", "--link", "ros1", "--card", str(tmp_path / "card.toml")]
    words += ["--structure", "first_order_delay", "--publish", "ros1", "--patience", "8", "--for", "60", "--jsonl"]
    environment = {**os.environ, **master}

    with (
        process(*fake, "--arrivals", str(tmp_path / "arrivals.json"), ready="ready", **master),
        process(*fake_words("hear_ros1"), ready="ready", **master) as hearer,
        (tmp_path / "states").open("w") as out,  # a pipe that nobody reads is full after 14 states
        subprocess.Popen(words, env=environment, stdout=out) as tracker,
    ):
        own = fly_words(tmp_path, plan_of(raw, "bebop2", 5, 25.0), "ros1", "--no-land")
        flown = subprocess.run(own, env=environment, capture_output=True, text=True, timeout=150, check=False)
        assert flown.returncode == 0, flown.stderr
        time.sleep(2.0)
        tracker.send_signal(signal.SIGINT)
        assert tracker.wait(60) == 0
        states = [json.loads(line) for line in (tmp_path / "states").read_text(encoding="utf-8").splitlines()]
        hearer.send_signal(signal.SIGTERM)
        assert hearer.stdout is not None
        heard = json.loads(hearer.stdout.readline())

    print(f"\nros1, tracked: {len(states)} lines, heard {heard}")
    known = states[-2]["axes"]
    assert [known[axis]["state"].split()[0] in ("known", "holding") for axis in ("x", "y")] == [True, True]
    assert heard["publishes"].pop("/rosout") == "rosgraph_msgs/Log"  # every node has it
    assert heard["publishes"] == STANDARD
    assert 8 <= heard["states"] == heard["speeds"] == heard["pushes"] < len(states)  # the last line is the end
    assert heard["levels"].keys() == {f"rotorfit: {name}" for name in ("vehicle", *AXES)}
    assert heard["levels"]["rotorfit: vehicle"] == 0


# MAVLink and Tello


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_flight_over_mavlink_identifies_what_a_direct_one_does(tmp_path: Path, autopilot: str) -> None:
    pytest.importorskip("pymavlink", reason="pip install 'rotorfit[mavlink]'")
    from fake_autopilot import MOCAP

    plan = plan_of(with_limits("mavlink", "m100"), "m100", 2)
    port = free_port()
    options = ("--vehicle", "m100", "--address", f"udpout:127.0.0.1:{port}")
    fake = fake_words("fake_autopilot", *options, *(["--ardupilot"] if autopilot == "ardupilot" else []))

    live = fly_live(tmp_path, plan, f"mavlink:udpin:127.0.0.1:{port}", fake)

    told(live, f"mavlink, {autopilot}")
    assert live.told["reason"] == "completed"
    agree(live, fly_direct(tmp_path, plan, "m100", MOCAP))


def test_a_flight_over_udp_to_a_tello_identifies_what_a_direct_one_does(tmp_path: Path) -> None:
    from fake_tello import MOCAP

    plan = plan_of(with_limits("tello", "tello"), "tello", 3)
    port = free_port()
    host = f"127.2.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    fake = fake_words("fake_tello", "--vehicle", "tello", "--host", host, "--state-port", str(port))

    live = fly_live(tmp_path, plan, f"tello:{host}:{port}", fake)

    told(live, "tello")
    assert live.told["reason"] == "completed"
    agree(live, fly_direct(tmp_path, plan, "tello", MOCAP))


# Take-off, landing, and drivers that die


def height_of(log: Path) -> np.ndarray[Any, Any]:
    return np.asarray(read(log).tables["/rotorfit/pose"].columns["pose.position.z"], float)


WHOLE = ["completed", "from the floor", "into the air", "down again", "landing"]


def course(live: Live) -> list[str]:
    """What of a flight from the floor to the floor was seen."""
    height = height_of(live.log)
    seen = {
        "completed": live.told["reason"] == "completed",
        "from the floor": height[:3].max() < 0.1,
        "into the air": height.max() > 0.7,
        "down again": height[-1] < height.max() - 0.5,  # on its way down when the recording ends
        "landing": live.told["landed"],
    }
    return [what for what, so in seen.items() if so]


def test_take_off_and_landing_over_ros_1(tmp_path: Path, master: dict[str, str]) -> None:
    plan = plan_of(with_limits("bebop2-drone-dev", "bebop2"), "bebop2", 4, 8.0, 1.0)
    fake = fake_words("fake_bebop", "--kind", "TransformStamped", "--topic", "/vicon/bebop/bebop", "--grounded")

    live = fly_live(tmp_path, plan, "ros1", fake, "--take-off", "--land", **master)

    assert course(live) == WHOLE


def test_a_flight_that_stays_in_the_air_is_none_from_floor_to_floor(tmp_path: Path) -> None:
    """The other tests of take-off and landing can fail."""
    plan = plan_of(with_limits("bebop2-drone-dev", "bebop2"), "bebop2", 4, 8.0, 1.0)
    log = fly_direct(tmp_path, plan, "bebop2", Mocap())

    assert course(Live({"reason": "completed", "landed": False}, log, [])) == ["completed", "into the air"]


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_take_off_and_landing_over_mavlink(tmp_path: Path, autopilot: str) -> None:
    pytest.importorskip("pymavlink", reason="pip install 'rotorfit[mavlink]'")
    plan = plan_of(with_limits("mavlink", "m100"), "m100", 5, 8.0, 1.2)
    port = free_port()
    options = ("--vehicle", "m100", "--grounded", "--address", f"udpout:127.0.0.1:{port}")
    fake = fake_words("fake_autopilot", *options, *(["--ardupilot"] if autopilot == "ardupilot" else []))

    live = fly_live(tmp_path, plan, f"mavlink:udpin:127.0.0.1:{port}", fake, "--take-off", "--land")

    assert course(live) == WHOLE


def test_take_off_and_landing_of_a_tello(tmp_path: Path) -> None:
    plan = plan_of(with_limits("tello", "tello"), "tello", 6, 8.0, 0.8)
    port = free_port()
    host = f"127.3.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    fake = fake_words("fake_tello", "--vehicle", "tello", "--grounded", "--host", host, "--state-port", str(port))

    live = fly_live(tmp_path, plan, f"tello:{host}:{port}", fake, "--take-off", "--land")

    assert course(live) == WHOLE


def test_a_tello_without_a_pad_takes_its_poses_from_ros_1(tmp_path: Path, master: dict[str, str]) -> None:
    """Two vehicles, of course: the fakes share no room. What is shown is that both links run in one flight."""
    plan = plan_of(with_limits("tello", "tello"), "tello", 7, 5.0, 1.5)
    port = free_port()
    host = f"127.4.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
    other = fake_words("fake_bebop", "--kind", "PoseStamped", "--topic", "/vicon/tello")
    fake = fake_words("fake_tello", "--vehicle", "tello", "--host", host, "--state-port", str(port))
    options = ("--poses", "ros1:/vicon/tello", "--no-land")

    with process(*other, ready="ready", **master):
        live = fly_live(tmp_path, plan, f"tello:{host}:{port}", fake, *options, **master)

    assert live.told["reason"] == "completed"
    assert len(live.arrived) > 450
    assert live.told["poses"] > 550  # 120 a second, by ROS


def test_a_driver_that_dies_is_a_lost_link_and_the_log_is_readable(tmp_path: Path, master: dict[str, str]) -> None:
    plan = plan_of(with_limits("bebop2-drone-dev", "bebop2"), "bebop2", 8, 30.0)
    fake = fake_words("fake_bebop", "--kind", "TransformStamped", "--topic", "/vicon/bebop/bebop")

    with process(*fake, ready="ready", **master) as driver:
        flight = subprocess.Popen(
            fly_words(tmp_path, plan, "ros1"), env={**os.environ, **master},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        time.sleep(12)
        driver.kill()
        out, err = flight.communicate(timeout=30)

    assert flight.returncode == 1
    assert "nobody listens to /bebop/cmd_vel any more" in err
    assert err.strip().splitlines()[:-1] == json.loads(out)["notes"]
    assert len(height_of(tmp_path / "flight.mcap")) > 200
