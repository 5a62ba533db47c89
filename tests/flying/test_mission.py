import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flying import BEBOP, CARD, SECOND, SPACE, Watched, flown, plan_of, room_link
from rotorfit.app.cli import main
from rotorfit.app.terminal.cockpit import ended_early
from rotorfit.core.errors import LinkError, VehicleError
from rotorfit.core.flight_plan import Flown, Jitter, Plan
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs import read
from rotorfit.files.plans import load_plan, plan_from_text, save_plan
from rotorfit.flying.links import LINKS, LinkKind
from rotorfit.flying.links.link import Link
from rotorfit.flying.links.opening import open_link, open_listener, simulated_at
from rotorfit.flying.links.sim import _scene
from rotorfit.planning.belief import belief_from_card, belief_mapping
from rotorfit.tracking.tracker import Tracker

pytestmark = pytest.mark.flights


def rotorfit(*words: object, stdin: str | None = None) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words], input=stdin)


def saved(folder: Path, plan: Plan | None = None) -> Path:
    path = folder / "plan.toml"
    save_plan(plan or plan_of(8.0), path)
    return path


# rotorfit fly


def test_fly_shows_the_preflight_flies_and_says_what_to_do_next(tmp_path: Path) -> None:
    plan, output = saved(tmp_path), tmp_path / "flight.mcap"
    result = rotorfit("fly", plan, "--link", "sim", "-o", output)

    assert result.exit_code == 0, result.output
    assert "  ok   pose: 119 a second" in result.stdout
    assert (
        "If the link is lost: Simulated: the vehicle follows the last command for 0.5 s, then hovers." in result.stdout
    )
    assert "Flown: completed." in result.stdout
    assert "commands late" not in result.stdout  # simulated time is never late
    assert result.stdout.endswith(f"Next: rotorfit fit {output} -o model.json\n")
    attached = read(output).attached
    assert plan_from_text(attached["plan"], "attached") == load_plan(plan)
    assert attached["link"] == "sim"
    fitted = rotorfit("fit", output, "--axes", "x")
    assert fitted.exit_code == 0, fitted.output


def test_fly_as_json_holds_everything_and_nothing_else(tmp_path: Path) -> None:
    output = tmp_path / "flight.mcap"
    result = rotorfit(
        "fly", saved(tmp_path), "--link", "sim:bebop2,gusts=0.1,mass=1.3@500", "-o", output, "--seed", 3, "--json"
    )
    assert re.search(r"sim:.*: ended at \d+ s, before the change mass=1.3@500: the flight is without it", result.stderr)

    told = json.loads(result.stdout)
    assert (told["reason"], told["path"], told["landed"]) == ("completed", str(output), True)
    assert (told["jitter"], told["late"]) == (None, None)
    assert all(check["ok"] for check in told["preflight"])


def test_seed_wind_take_off_and_landing_reach_the_vehicle(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.mcap" for number in range(4)]
    plan = saved(tmp_path)
    for path, link, seed in zip(paths, ["sim", "sim", "sim", "sim,wind=1"], [1, 1, 2, 1], strict=True):
        done = rotorfit("fly", plan, "--link", link, "-o", path, "--seed", seed, "--take-off", "--no-land", "--json")
        assert done.exit_code == 0, done.stderr
        assert not json.loads(done.stdout)["landed"]
    poses = [read(path).tables["/rotorfit/pose"].columns["pose.position.x"].tobytes() for path in paths]
    assert poses[0] == poses[1]
    assert len(set(poses)) == 3
    assert next(event.text for event in read(paths[0]).events) == "take-off begins"


def test_a_flight_that_ends_early_is_one_line_with_the_path_of_the_log(tmp_path: Path) -> None:
    tight = replace(SPACE, speed=0.1)
    plan, output = saved(tmp_path, replace(plan_of(8.0, amplitude=1.0), space=tight)), tmp_path / "flight.mcap"
    result = rotorfit("fly", plan, "--link", "sim", "-o", output)

    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith("Error: ended early, after ")
    assert line.endswith(f"too fast: 0.10 m/s, the limit is 0.1 m/s; the vehicle lands; the log so far: {output}")
    assert read(output).events[-1].text == "landing"


@pytest.mark.parametrize("words", [[], ["--json"]])
def test_a_flight_that_ends_early_tells_that_the_vehicle_does_not_land(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    link = Watched(room_link())
    monkeypatch.setattr(link, "act", refusing_to_land)
    monkeypatch.setattr("rotorfit.flying.mission.open_link", lambda *_: link)
    plan = saved(tmp_path, replace(plan_of(8.0, amplitude=1.0), space=replace(SPACE, speed=0.1)))
    result = rotorfit("fly", plan, "--link", "sim", "-o", tmp_path / "flight.mcap", *words)

    assert result.exit_code == 1
    *notes, line = result.stderr.splitlines()
    assert notes == ["it is denied", "the link did not take the order to land: land by other means"]
    assert "; the vehicle does not land; the log so far: " in line
    if words:
        told = json.loads(result.stdout)
        assert (told["reason"], told["landed"], told["notes"]) == ("speed", False, notes)


def refusing_to_land(action: str) -> None:
    if action == "land":
        raise LinkError("it is denied")


def test_what_must_not_be_flown_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    wild = replace(plan_of(8.0, amplitude=2.0), belief=belief_mapping(belief_from_card(CARD)))
    plan = saved(tmp_path, replace(wild, feedback=None, space=replace(SPACE, start=(2.0, 0.0, 2.9, 0.0))))
    result = rotorfit("fly", plan, "--link", "sim", "-o", tmp_path / "flight.mcap", "--json")

    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.startswith("Error: not flown: plan: the likeliest vehicle would be stopped")
    assert not (tmp_path / "flight.mcap").exists()


@pytest.mark.parametrize(
    ("output", "why"),
    [
        ("plan.toml", "exists, and a recording is never overwritten"),
        ("nowhere/flight.mcap", "there is no folder"),
        ("flight.bag", "flight.bag: a recording is an MCAP file; name it flight.mcap"),
        ("/proc/flight.mcap", "/proc/flight.mcap: cannot be written"),
    ],
)
def test_a_place_that_cannot_be_written_is_told_before_the_link_is_opened(
    tmp_path: Path, output: str, why: str
) -> None:
    result = rotorfit("fly", saved(tmp_path), "--link", "no such link", "-o", tmp_path / output)

    assert result.exit_code == 1
    assert why in result.stderr


def test_before_a_real_vehicle_moves_it_is_asked_and_the_link_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = Watched(room_link())
    link.live = True  # simulated time all the same
    monkeypatch.setattr("rotorfit.flying.mission.open_link", lambda *_: link)
    plan, output = saved(tmp_path), tmp_path / "flight.mcap"

    refused = rotorfit("fly", plan, "--link", "sim", "-o", output, stdin="n\n")
    assert refused.exit_code == 1
    assert "A real vehicle will move. Fly? [y/N]" in refused.stderr
    assert link.sent == []
    assert link.acts == ["close"]
    assert not output.exists()
    assert rotorfit("fly", plan, "--link", "sim", "-o", output, stdin="y\n").exit_code == 0
    assert link.acts[1:] == ["land", "close"]
    other = Watched(room_link())
    other.live = True
    monkeypatch.setattr("rotorfit.flying.mission.open_link", lambda *_: other)
    assert rotorfit("fly", plan, "--link", "sim", "-o", tmp_path / "other.mcap", "--yes").exit_code == 0


def test_a_full_disk_in_a_real_process_is_one_line_and_leaves_a_readable_log(tmp_path: Path) -> None:
    """A file may not grow beyond 300 kB: the system refuses as a full disk does."""
    program = (
        "import resource, signal, sys, time\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))\n"
        "from rotorfit.flying.links.sim import SimLink\n"
        "receive = SimLink.receive\n"
        "SimLink.receive = lambda self, until: (time.sleep(0.0005), receive(self, until))[1]\n"
        "from rotorfit.app.cli import main\n"
        "main()\n"
    )
    output = tmp_path / "flight.mcap"
    plan = saved(tmp_path, plan_of(60.0))
    done = subprocess.run(
        [sys.executable, "-c", program, "fly", plan, "--link", "sim", "-o", output],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}, timeout=60,
    )  # fmt: skip

    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"{output}: File too large; free some room on the disk; what was written is readable" in line
    assert output.stat().st_size <= 300_000
    assert len(read(output).tables["/rotorfit/command"].columns["log_time"]) > 300


def test_an_approach_that_fails_ends_before_the_plan_began(tmp_path: Path) -> None:
    flown = Flown(
        "start", "the start was not reached", 0.0, Jitter(0.0, 0.0, 0.0), 0, 9, 9, 0, True, tmp_path / "f.mcap"
    )

    assert ended_early(flown).startswith(
        "ended early, before the plan began: the start was not reached; the vehicle lands; "
    )
    assert ended_early(replace(flown, duration=1.04)).startswith("ended early, after 1.0 s of the plan: ")


def piped(folder: Path, lines: int, *words: object) -> tuple[int, str, Path]:
    """`rotorfit fly | head -n LINES`: exit code and stderr of fly, and where it records."""
    output = folder / "flight.mcap"
    code = "from rotorfit.app.cli import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "fly", saved(folder), "--link", "sim", "-o", output, *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    ) as flight:  # fmt: skip
        assert flight.stdout is not None
        assert flight.stderr is not None
        for _ in range(lines):
            flight.stdout.readline()
        flight.stdout.close()
        told = flight.stderr.read()
        return flight.wait(60), told, output


def test_a_pipe_that_is_closed_before_the_preflight_was_read_keeps_the_vehicle_from_moving(tmp_path: Path) -> None:
    code, told, output = piped(tmp_path, 0)

    assert code == 1
    assert told.startswith("Error: not flown: nobody reads the output (a closed pipe)")
    assert len(told.splitlines()) == 1
    assert not output.exists()


def test_a_pipe_that_is_closed_in_flight_ends_nothing_and_the_end_is_told_on_stderr(tmp_path: Path) -> None:
    code, told, output = piped(tmp_path, 0, "--json")  # its only output comes at the end

    assert (code, told) == (0, f"Nobody reads the output any more. Flown: completed; the log: {output}\n")
    assert len(read(output).tables["/rotorfit/command"].columns["log_time"]) > 300


# Links by name


def test_an_unknown_link_lists_the_known_ones() -> None:
    with pytest.raises(LinkError, match=f"no link 'ros'; links are {', '.join(LINKS)}"):
        open_link("ros:11311", CARD)


def test_a_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LINKS, "odd", LinkKind("odd", "not_there_at_all"))
    monkeypatch.setitem(sys.modules, "rotorfit.flying.links.mavlink", None)

    with pytest.raises(
        LinkError, match=r"needs the Python package rotorfit.flying.links.mavlink: pip install 'rotorfit\[mav"
    ):
        open_link("mavlink", CARD)
    with pytest.raises(LinkError, match="link odd needs the Python package not_there_at_all: pip install not_there"):
        open_link("odd", CARD)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("bebop2,wnd=1", "no option 'wnd'; nearest: 'wind'; options are wind, gusts"),
        ("bebop2,wind", "'wind' is not one of"),
        ("bebop2,gusts=strong", "'gusts=strong' is not one of"),
        ("bebop2,gusts=-1", "not negative"),
        ("bebop2,wind=inf", "finite"),
        ("bebop2,start=1/2", "'start=1/2' is not start=X/Y/Z/YAW"),
        ("bebop2,seed=one", "'seed=one' is not start="),
        ("bebop2,flying=maybe", "flying=yes or no"),
        ("bebop2,start=0/0/-1/0", "the start is at -1 m, below the floor of the flight room at 0 m"),
        ("bebop2,mass=1.3@1e300", "is no change"),
    ],
)
def test_options_of_the_room_are_checked(address: str, why: str) -> None:
    with pytest.raises(LinkError, match=why):
        open_link(f"sim:{address}", CARD)


def test_a_vehicle_that_nobody_knows_or_another_card_is_refused() -> None:
    with pytest.raises(VehicleError, match="no vehicle 'bebop3'"):
        open_link("sim:bebop3", CARD)
    with pytest.raises(LinkError, match=r"the plan's card is not one of .*: a command"):
        open_link("sim:tello", CARD)


def test_the_room_starts_where_the_plan_does() -> None:
    link = open_link("sim,start=1/-1/2/0.5,seed=1", CARD)
    (*_, last) = [one for one in link.receive(link.now + SECOND) if one.stream == "pose"]

    assert np.allclose(last.values[:3], (1.0, -1.0, 2.0), atol=0.02)
    assert 2 * np.arctan2(last.values[6], last.values[3]) == pytest.approx(0.5, abs=0.02)
    assert link.receive(link.now - 5) == []


def test_what_a_flight_says_of_the_room_gives_way_to_what_the_user_said() -> None:
    said = simulated_at("sim,seed=7", (1.0, -0.1, 2.0, 0.5), 3, False)

    assert said == "sim,seed=7,start=1.0/-0.1/2.0/0.5,seed=3,flying=no"
    assert _scene(said.split(",")[1:]) == ((1.0, -0.1, 2.0, 0.5), 7, False)
    assert simulated_at("ros1", (1.0, -0.1, 2.0, 0.5), 3) == "ros1"


# A log played back


def test_a_log_is_played_back_as_it_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    flown(Watched(room_link(start=(0.5, 0.0, 1.5, 0.3))), path, plan_of(4.0))
    link, log = open_link(f"replay:{path}", CARD), read(path)
    pose = log.tables["/rotorfit/pose"].columns

    began, samples = link.now, []
    while len(samples) < len(pose["log_time"]):
        link.send([1.0, 0.0, 0.0, 0.0])
        samples += link.receive(link.now + SECOND // 50)
    with pytest.raises(LinkError, match=f"replay: {path} is over"):
        link.receive(link.now + 1)
    assert [one.stamp for one in samples] == pose["header.stamp"].tolist()
    assert [one.received for one in samples] == pose["log_time"].tolist()
    assert [one.values[0] for one in samples] == pose["pose.position.x"].tolist()
    assert [one.values[6] for one in samples] == pose["pose.orientation.z"].tolist()
    assert began < samples[0].received
    assert not link.live


def test_a_plan_rehearsed_on_a_log_ends_with_it(tmp_path: Path) -> None:
    first, again = tmp_path / "first.mcap", tmp_path / "again.mcap"
    flown(Watched(room_link()), first, plan_of(4.0))
    result = rotorfit("fly", saved(tmp_path, plan_of(20.0)), "--link", f"replay:{first}", "-o", again)

    assert result.exit_code == 1
    assert f"replay: {first} is over" in result.stderr
    assert len(read(again).tables["/rotorfit/pose"].columns["log_time"]) > 400


def test_a_log_of_others_is_played_back_in_the_world_frame(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{0.01 * k:.2f},0,0,0,0,{k},2,{-3},0.5" for k in range(10)]
    path.write_text("\n".join(["t,ux,uy,uz,ur,n,e,d,yaw", *rows]) + "\n")
    raw = {
        "frame": "NED",
        "command": {"time": "t", "x": "ux"},
        "pose": {"time": "t", "x": "n", "y": "e", "z": "d", "yaw": "yaw"},
    }
    samples = open_link(f"replay:{path}", card_from_mapping(raw, "csv")).receive(10 * SECOND)
    x, y, z, qw, _, _, qz = samples[3].values
    assert (x, y, z) == (2.0, 3.0, 3.0)
    assert 2 * np.arctan2(qz, qw) == pytest.approx(np.pi / 2 - 0.5)
    with pytest.raises(LinkError, match="replay needs a file: --link replay:"):
        open_link("replay", CARD)


# The line while it flies


def test_the_status_line_goes_to_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import time

    from rotorfit.app.terminal.cockpit import status_line
    from rotorfit.core.flight_plan import Status

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    with status_line() as told:
        assert told is None
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    with status_line() as told:
        assert told is not None
        told(Status("plan", 3.21, 60.0, (1.0, -0.5, 1.5, 0.0), 0.87, 0.66))
        time.sleep(0.5)
    line = "plan 3.2 of 60 s: x +1.00 y -0.50 z 1.50 m, 0.87 m to the fence, battery 66%  (Ctrl-C or space"
    assert line in shown.getvalue()
    assert shown.getvalue().endswith("\r\033[K")


def test_commands_of_the_bebop_reach_it_in_its_own_unit() -> None:
    def speed(command: Sequence[float]) -> tuple[float, ...]:
        link = open_link("sim,seed=1", CARD)
        for _ in range(100):
            link.send(command)
            link.receive(link.now + SECOND // 50)
        return link._room.truth().velocity  # type: ignore[attr-defined, no-any-return]

    assert speed((0.1, 0.0, 0.0, 0.0))[0] > 0.3
    assert speed((0.0, 0.1, 0.0, 0.0))[1] > 0.3
    assert speed((0.0, 0.0, 0.5, 0.0))[2] == pytest.approx(0.5 * BEBOP.command.vertical_speed, rel=0.2)


def test_a_heading_that_the_card_turns_is_turned_once_and_in_logs_alone(tmp_path: Path) -> None:
    """Played back to fly or to be heard, and in a tracker that hears it; a live link would fly with another heading."""
    path, time = tmp_path / "log.csv", 0.02 * np.arange(300)
    heading = 0.3 * np.sin(time)
    numbers = [time, np.sin(3 * time), 0.1 * time, 0 * time, 1 + 0 * time, np.cos(heading / 2), np.sin(heading / 2)]
    rows = [",".join(f"{value:.9f}" for value in row) for row in np.stack(numbers, axis=1)]
    path.write_text("\n".join(["t,u,x,y,z,w,k,i,j", *(f"{row},0,0" for row in rows)]) + "\n")
    pose = {"time": "t", "x": "x", "y": "y", "z": "z", "quaternion": ["w", "i", "j", "k"], "heading_offset": 0.5}
    raw = {"command": {"time": "t", "yaw": "u"}, "pose": pose}
    card = card_from_mapping(raw, "turned")

    def heard(link: Link) -> list[Sample]:
        return link.receive(link.now + 60 * SECOND)

    for link in (open_link(f"replay:{path}", card), open_listener(f"replay:{path}", card)):
        told = [2 * math.atan2(one.values[6], one.values[3]) for one in heard(link) if one.stream == "pose"]
        assert told[:5] == pytest.approx(heading[:5] + 0.5, abs=1e-3)
    tracker = Tracker(card, origin=0)
    for sample in heard(open_listener(f"replay:{path}", card)):
        tracker.update(sample)
    flight = tracker.flight()
    assert flight is not None
    assert max(abs(flight.yaw - 0.5)) < 0.31
    with pytest.raises(LinkError, match="turn the rigid body's axes in the motion capture software"):
        open_listener("mavlink", card)
