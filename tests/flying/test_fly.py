import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_recorder import FullDisk

from flying import BEBOP, HOVER, SECOND, SPACE, Slow, Watched, flown, plan_of, recording, room_link
from rotorfit.app.workflows import fit_logs, load_flight
from rotorfit.core.flight_plan import Flown
from rotorfit.core.log import Sample
from rotorfit.core.model import STRUCTURE
from rotorfit.diagnosis.survey import survey_logs
from rotorfit.files.log_span import LogSpan
from rotorfit.files.logs import read
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.sim import SimLink
from rotorfit.flying.recorder import Recorder
from rotorfit.simulation.air import Wind
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.sensors import Mocap, Swap

pytestmark = pytest.mark.flights

NOISY = Conditions()


def readable(path: Path) -> list[str]:
    """The log of a flight that ended early: `info` and what `fit` begins with read it; returns the events."""
    flight = load_flight(LogSpan(str(path), (None, None)))
    assert flight.command_time.size > 50
    (survey,) = survey_logs([str(path)])
    assert survey.problem is None
    return [text for _, text in survey.events]


def hover_first(link: Watched, fault: float) -> None:
    """From the fault on nothing but hover was sent first, and several times."""
    after = [(t, command) for t, command in link.sent if t >= fault]
    assert after[0][1] == HOVER
    assert sum(command == HOVER for _, command in after) >= 10
    assert after[-1][1] == HOVER


def ended(link: Watched, path: Path, reason: str, **options: object) -> tuple[Flown, float]:
    """Flies; the flight ends for that reason, at the time returned, in hover, then lands."""
    result = flown(link, path, **options)
    assert result.reason == reason
    assert result.text in readable(path)[-2]
    moving = [t for t, command in link.sent if command != HOVER]
    first = next(t for t, command in link.sent if command == HOVER and t >= result.duration - 1)
    assert moving
    hover_first(link, first)
    assert link.acts == ["land"]
    return result, first


# A flight that goes well


def test_a_flight_is_completed_recorded_and_fitted_to_the_truth(tmp_path: Path) -> None:
    link, path = Watched(room_link()), tmp_path / "log.mcap"
    result = flown(link, path, plan_of(40.0))

    assert (result.reason, result.text, result.landed, result.notes) == ("completed", "completed", True, ())
    assert result.duration == pytest.approx(40.0)
    assert result.jitter.max == 0.0
    assert result.late == result.outliers == 0
    assert result.commands == len(link.sent)
    events = readable(path)
    assert events[0] == "plan begins"
    assert events[-2:] == ["end: completed", "landing"]
    log = read(path)
    assert log.notes == ()
    sent = np.array([command for _, command in link.sent])
    recorded = log.tables["/rotorfit/command"].columns
    assert recorded["twist.linear.x"].tobytes() == np.ascontiguousarray(sent[:, 0]).tobytes()
    assert result.poses == len(log.tables["/rotorfit/pose"].columns["log_time"])
    fit = fit_logs([LogSpan(str(path), (None, None))], axes=("x", "y"), structure=STRUCTURE)
    truth = BEBOP.linear()
    for place, axis in enumerate(("x", "y")):
        found = fit.model.axes[axis]
        assert found.input == pytest.approx(truth.gamma[2 * place], rel=0.01)
        assert found.damping == pytest.approx(truth.gamma[2 * place + 1], abs=0.03)
        assert found.delay == pytest.approx(truth.delay[place], abs=0.01)


def test_the_same_seed_gives_the_same_flight(tmp_path: Path) -> None:
    links = [Watched(room_link(NOISY, 7)) for _ in range(2)]
    for number, link in enumerate(links):
        flown(link, tmp_path / f"{number}.mcap", plan_of(5.0))

    assert links[0].sent == links[1].sent


@pytest.mark.parametrize(("rate", "poses"), [(200.0, 30.0), (10.0, 240.0), (100.0, 20.0)])
def test_commands_and_poses_may_come_at_any_rates(tmp_path: Path, rate: float, poses: float) -> None:
    link = Watched(room_link(Conditions(mocap=Mocap(rate=poses))))
    result = flown(link, tmp_path / "log.mcap", plan_of(5.0, rate=rate))

    assert result.reason == "completed"
    assert load_flight(LogSpan(str(tmp_path / "log.mcap"), (None, None))).command_time.size == pytest.approx(
        5 * rate, abs=1
    )


def test_without_feedback_the_signals_are_sent_as_planned(tmp_path: Path) -> None:
    from rotorfit.core.flight_plan import command_at

    link, plan = Watched(room_link()), plan_of(5.0, feedback=False, amplitude=0.2)
    assert flown(link, tmp_path / "log.mcap", plan).reason == "completed"

    wanted = command_at(plan, np.arange(250) / plan.rate)
    assert np.array([command for _, command in link.sent[:250]]).tolist() == wanted.tolist()


def test_commands_stand_in_the_window_only_while_the_plan_is_flown(tmp_path: Path) -> None:
    link = Watched(room_link(start=(0.8, -0.5, 1.2, 0.5)))
    flown(link, tmp_path / "log.mcap", plan_of(6.0))

    flight = load_flight(LogSpan(str(tmp_path / "log.mcap"), (None, None)))
    assert flight.command_time.size == 300
    assert len(link.sent) > 450


def test_a_start_that_is_not_near_is_approached_slowly_first(tmp_path: Path) -> None:
    link = room_link(start=(1.5, -1.0, 1.0, 2.0))
    result = flown(Watched(link), tmp_path / "log.mcap", plan_of(3.0))

    assert result.reason == "completed"
    assert readable(tmp_path / "log.mcap")[:2] == ["approach begins", "plan begins"]
    log = read(tmp_path / "log.mcap")
    begun = next(event.time for event in log.events if event.text == "plan begins")
    pose = log.tables["/rotorfit/pose"].columns
    way = np.stack([pose[f"pose.position.{axis}"] for axis in "xyz"])[:, pose["log_time"] < begun]
    assert np.linalg.norm(way[:, -1] - np.array(SPACE.start[:3])) < 0.3
    speed = np.linalg.norm(np.diff(way[:, ::12]), axis=0) / 0.1
    assert np.max(speed) < 0.7


def test_without_feedback_and_belief_a_far_start_is_no_flight(tmp_path: Path) -> None:
    plan = replace(plan_of(3.0, feedback=False), belief={})
    link = Watched(room_link(start=(1.5, 0.0, 1.5, 0.0)))
    result = flown(link, tmp_path / "log.mcap", plan)

    assert result.reason == "start"
    assert "1.50 m from the plan's start" in result.text
    assert all(command == HOVER for _, command in link.sent)


def test_it_takes_off_and_lands_where_asked(tmp_path: Path) -> None:
    inner = room_link(flying=False)
    link = Watched(inner)
    result = flown(link, tmp_path / "log.mcap", plan_of(3.0), take_off=True)

    assert result.reason == "completed"
    assert link.acts == ["take_off", "land"]
    assert readable(tmp_path / "log.mcap")[0] == "take-off begins"
    assert inner._room.truth().mode in ("landing", "grounded")


def test_a_vehicle_that_does_not_take_off_is_said(tmp_path: Path) -> None:
    link = Watched(room_link(flying=False))
    link.act = lambda action: link.acts.append(action)  # type: ignore[method-assign]
    result = flown(link, tmp_path / "log.mcap", take_off=True)

    assert result.reason == "take_off"
    assert result.text == "the vehicle has not taken off within 15 s"


def test_it_hovers_on_where_landing_is_not_asked_for(tmp_path: Path) -> None:
    inner = room_link()
    link = Watched(inner)
    result = flown(link, tmp_path / "log.mcap", plan_of(3.0), land=False)

    assert not result.landed
    assert link.acts == []
    assert inner._room.truth().mode == "flying"


def test_the_plan_begins_when_the_vehicle_obeys_and_not_before(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.undone = "it is not in OFFBOARD"

    def obeying_from_2_s(since: float, samples: list[Sample]) -> list[Sample]:
        link.undone = "" if since > 2.0 else link.undone
        return samples

    link.samples = obeying_from_2_s
    result = flown(link, tmp_path / "log.mcap", plan_of(3.0))

    assert result.reason == "completed"
    assert not any(any(command) for since, command in link.sent if since < 2.0)
    assert readable(tmp_path / "log.mcap")[:2] == ["hover begins", "plan begins"]


def test_a_vehicle_that_does_not_obey_is_given_up_in_hover(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.undone = "it says that it is on the ground"
    result = flown(link, tmp_path / "log.mcap", plan_of(3.0))

    assert (result.reason, result.duration) == ("not_obeyed", 0.0)
    assert result.text == "the vehicle does not obey commands: it says that it is on the ground"
    assert not any(any(command) for _, command in link.sent)


def test_a_landing_that_the_vehicle_does_not_take_is_told(tmp_path: Path) -> None:
    link = Watched(room_link())

    def deaf_to_landing(_since: float, samples: list[Sample]) -> list[Sample]:
        link.undone = "it did not land: denied" if link.acts else ""
        return samples

    link.samples = deaf_to_landing
    result = flown(link, tmp_path / "log.mcap", plan_of(3.0))

    assert (result.reason, result.landed) == ("completed", False)
    assert result.notes[-1].endswith("it did not land: denied): land by other means")


# Faults


@pytest.mark.parametrize(
    ("jump", "reason"), [(0.1, "completed"), (30.0, "completed"), (-0.1, "completed"), (-30.0, "pose_frozen")]
)
def test_a_jump_of_the_clock_of_the_poses_ends_in_hover_or_not_at_all(jump: float, reason: str, tmp_path: Path) -> None:
    def jumping(since: float, samples: list[Sample]) -> list[Sample]:
        off = round(jump * SECOND) if since > 3.0 else 0
        return [replace(one, stamp=one.stamp + off) for one in samples]

    link = Watched(room_link())
    link.samples = jumping
    result = flown(link, tmp_path / "log.mcap", plan_of(6.0))

    assert result.reason == reason
    assert max(abs(value) for _, command in link.sent for value in command) <= 1.0
    if reason != "completed":
        hover_first(link, 3.0 + 1.05)


def test_a_pose_that_is_lost_for_half_a_second_ends_in_hover(tmp_path: Path) -> None:
    link = Watched(room_link(Conditions(mocap=Mocap(drop_outs=((4.0, 99.0),)))))
    result, first = ended(link, tmp_path / "log.mcap", "pose_lost")

    assert result.text == "the pose is lost: none for 0.52 s"
    assert first == pytest.approx(4.5, abs=0.05)


def test_a_pose_that_is_away_for_less_ends_nothing(tmp_path: Path) -> None:
    link = Watched(room_link(Conditions(mocap=Mocap(drop_outs=((4.0, 4.4),)))))

    assert flown(link, tmp_path / "log.mcap").reason == "completed"


def test_a_frozen_pose_ends_in_hover(tmp_path: Path) -> None:
    link, held = Watched(room_link()), []

    def freeze(t: float, samples: list[Sample]) -> list[Sample]:
        poses = [sample for sample in samples if sample.stream == "pose"]
        if t < 4:
            held[:] = poses[-1:] or held
            return samples
        return [replace(pose, values=held[0].values) for pose in poses]

    link.samples = freeze
    result, first = ended(link, tmp_path / "log.mcap", "pose_frozen")
    assert "it has repeated for 1.0" in result.text
    assert first == pytest.approx(5.0, abs=0.05)


def test_one_swapped_frame_ends_nothing_and_a_lasting_swap_does(tmp_path: Path) -> None:
    once = Conditions(mocap=Mocap(swaps=(Swap(4.0, 4.005, turn=2.0, offset=(1.0, 0.5, 0.0)),)))
    lasting = Conditions(mocap=Mocap(swaps=(Swap(4.0, 9.0, turn=2.0, offset=(1.0, 0.5, 0.0)),)))

    result = flown(Watched(room_link(once)), tmp_path / "once.mcap")
    assert (result.reason, result.outliers) == ("completed", 1)
    result, first = ended(Watched(room_link(lasting)), tmp_path / "lasting.mcap", "pose_jumps")
    assert "are markers swapped?" in result.text
    assert first == pytest.approx(4.05, abs=0.03)


def test_a_lost_link_is_sent_hover_all_the_same(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.dead_from = 4.0
    result = flown(link, tmp_path / "log.mcap")

    assert result.reason == "link_lost"
    assert result.text == "the radio is gone"
    assert not result.landed
    broken = next(k for k, (t, _) in enumerate(link.sent) if t >= 4.0)
    assert [command for _, command in link.sent[broken + 1 :]] == [HOVER] * 51
    assert "the link did not take the order to land: land by other means" in result.notes
    assert "end: the radio is gone" in readable(tmp_path / "log.mcap")


def test_a_gust_towards_the_fence_ends_in_hover_inside_the_box(tmp_path: Path) -> None:
    gust = Conditions(wind=Wind(steps=((4.0, (0.0, 6.0, 0.0)), (5.0, (0.0, -6.0, 0.0)))))
    plan = replace(plan_of(20.0), space=replace(SPACE, lower=(-1.5, -1.2, 0.3), upper=(1.5, 1.2, 3.0)))
    inner = room_link(gust)
    result, _ = ended(Watched(inner), tmp_path / "log.mcap", "fence", plan=plan)

    assert "y is " in result.text
    assert "the wall is at 1.2 m" in result.text
    pose = read(tmp_path / "log.mcap").tables["/rotorfit/pose"].columns
    assert np.max(pose["pose.position.y"]) < 1.2 + 0.15


@pytest.mark.parametrize("brakes", [True, False])
def test_a_vehicle_that_coasts_is_braked_actively_after_the_first_hover(tmp_path: Path, brakes: bool) -> None:
    vehicle = replace(BEBOP, autopilot=replace(BEBOP.autopilot, brakes_on_zero=False))
    room = FlightRoom(vehicle, Conditions(), 1)
    link = Watched(SimLink(room))
    plan = plan_of(12.0, feedback=False, amplitude=1.0)
    plan = replace(plan, belief={**plan.belief, "brakes_on_zero": brakes})

    def speed() -> float:
        return math.hypot(*room.truth().velocity[:2])

    fast = []

    def abort() -> str:
        fast.extend([link.since] if speed() > 0.7 else [])
        return "Ctrl-C" if fast else ""

    result = flown(link, tmp_path / "log.mcap", plan, abort=abort, land=False)
    assert result.reason == "operator"
    hover_first(link, fast[0] - 0.001)
    assert speed() > 0.5 if brakes else speed() < 0.15


def test_a_loop_that_is_held_up_for_long_ends_in_hover(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.oversleep = {4.0: 0.7}
    result, first = ended(link, tmp_path / "log.mcap", "starved")

    assert result.text == "the loop was held up for 0.70 s: is the computer overloaded?"
    assert first == pytest.approx(4.72, abs=0.05)
    assert result.late == 1


def test_a_loop_that_is_held_up_again_and_again_ends_in_hover(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.oversleep = {2 + 0.2 * k: 0.07 for k in range(40)}
    result, _ = ended(link, tmp_path / "log.mcap", "starved")

    assert result.text == "20 commands came more than 3 periods late: is the computer overloaded?"
    assert result.jitter.max == pytest.approx(0.07, abs=1e-6)


def test_a_link_that_takes_fewer_commands_is_told(tmp_path: Path) -> None:
    result = flown(Slow(room_link(), 0.032), tmp_path / "log.mcap", plan_of(3.0))

    assert result.reason == "completed"
    assert "the link took 32 commands a second, 50 were planned" in result.notes


def test_a_link_that_takes_less_than_half_of_the_commands_ends_in_hover(tmp_path: Path) -> None:
    link = Slow(room_link(), 0.052)
    result = flown(link, tmp_path / "log.mcap")

    assert result.reason == "starved"
    assert result.text == "the link takes 25 of 50 commands a second: lower `rate` in the plan"
    assert [command for _, command in link.sent[:-5] if command != HOVER]
    assert all(command == HOVER for _, command in link.sent[-5:])
    assert link.acts == ["land"]


def test_now_and_then_a_late_command_is_counted_and_ends_nothing(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.oversleep = {4.0: 0.07, 6.0: 0.07}
    result = flown(link, tmp_path / "log.mcap")

    assert (result.reason, result.late) == ("completed", 2)


def test_a_full_disk_ends_in_hover_and_the_log_so_far_is_readable(tmp_path: Path) -> None:
    path, plan, link = tmp_path / "log.mcap", plan_of(60.0), Watched(room_link())
    whole = recording(tmp_path / "other.mcap", plan)
    whole.close()
    import tomli_w

    from rotorfit.flying.recorder import card_as_recorded

    told = {"card": tomli_w.dumps(card_as_recorded(plan.card))}
    recorder = Recorder(FullDisk(path, 400_000), path, told)  # type: ignore[arg-type]

    def slow(_: float, samples: list[Sample]) -> list[Sample]:
        time.sleep(0.001)  # so that simulated time does not outrun the disk by too much
        return samples

    link.samples = slow
    result = fly(plan, link, recorder)

    assert result.reason == "disk"
    assert result.text == f"{path}: No space left on device; free some room on the disk; what was written is readable"
    hover_first(link, result.duration + 0.03)
    assert link.acts == ["land"]
    readable_up_to = load_flight(LogSpan(str(path), (None, None)))
    assert readable_up_to.duration > 5


def test_a_low_battery_ends_in_hover(tmp_path: Path) -> None:
    link = Watched(room_link())
    link.samples = lambda t, samples: [*samples, Sample("battery", 0, link.now, (0.9 if t < 4 else 0.1,))]
    result, _ = ended(link, tmp_path / "log.mcap", "battery")

    assert result.text == "the battery: 10% left, the limit is 15%"


def test_the_operator_ends_in_hover(tmp_path: Path) -> None:
    link = Watched(room_link())
    result, first = ended(link, tmp_path / "log.mcap", "operator", abort=lambda: "Ctrl-C" if link.since > 4 else "")

    assert result.text == "ended by the operator: Ctrl-C"
    assert first == pytest.approx(4.02, abs=0.03)


def test_an_error_of_our_own_still_ends_in_hover_and_a_readable_log(tmp_path: Path) -> None:
    link = Watched(room_link())

    def broken(_: object) -> None:
        if link.since > 4:
            raise ZeroDivisionError("a bug")

    with pytest.raises(ZeroDivisionError, match="a bug"):
        flown(link, tmp_path / "log.mcap", progress=broken)
    hover_first(link, 4.3)
    assert link.acts == ["land"]
    assert "end: an error in rotorfit itself" in readable(tmp_path / "log.mcap")


def test_an_error_of_a_driver_keeps_its_trace_and_the_vehicle_lands(tmp_path: Path) -> None:
    """Not of a kind that a link may raise, and again at every hover."""
    link = Watched(room_link())
    send = link.send

    def broken(command: Sequence[float]) -> Sequence[float]:
        if link.since > 4:
            raise ZeroDivisionError("a bug")
        return send(command)

    link.send = broken  # type: ignore[method-assign]
    with pytest.raises(ZeroDivisionError, match="a bug"):
        flown(link, tmp_path / "log.mcap")
    assert link.acts == ["land"]
    assert {"end: an error in rotorfit itself", "landing"} <= set(readable(tmp_path / "log.mcap"))


def test_a_command_that_is_no_number_is_never_sent(tmp_path: Path) -> None:
    plan = plan_of()
    plan = replace(plan, belief={**plan.belief, "gamma": [float("nan")] * 8})
    link = Watched(room_link())

    result = flown(link, tmp_path / "log.mcap", plan)

    assert (result.reason, result.landed) == ("command", True)
    assert result.text == "a command of nan on x was not sent: 1 is the largest"
    assert all(command == HOVER for _, command in link.sent)


# Real processes


def started(path: Path) -> "subprocess.Popen[str]":
    tests = Path(__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tests), *sys.path])}
    process = subprocess.Popen(
        [sys.executable, str(tests / "flying.py"), str(path)], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    return process


def test_kill_9_in_flight_costs_less_than_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    process = started(path)
    time.sleep(4.0)
    process.send_signal(signal.SIGKILL)
    killed = time.time()
    assert process.wait() == -signal.SIGKILL

    assert killed - path.stat().st_mtime < 1.0
    log = read(path)
    stamps = log.tables["/rotorfit/command"].columns["log_time"]
    assert (stamps[-1] - stamps[0]) / SECOND > 3.0
    assert log.damage[0].startswith(("the file was never closed", "damaged at byte"))
    assert fit_logs([LogSpan(str(path), (None, None))], axes=("x",)).flights[0].duration > 2.5


def test_ctrl_c_in_flight_ends_in_hover(tmp_path: Path) -> None:
    process = started(tmp_path / "log.mcap")
    time.sleep(3.5)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=20)

    result = json.loads(out)
    assert process.returncode == 0
    assert result["reason"] == "operator"
    assert result["text"] == "ended by the operator: Ctrl-C"
    commands = [command for _, command in result["sent"]]
    moving = max(k for k, command in enumerate(commands) if max(map(abs, command)) > 0.02)
    assert HOVER in commands
    assert commands[moving + 1 :].count(HOVER) >= 10
    assert readable(tmp_path / "log.mcap")[-1] == "end: ended by the operator: Ctrl-C"


def test_the_space_bar_ends_the_flight_and_the_terminal_is_put_back() -> None:
    pty = pytest.importorskip("pty")
    import termios

    from rotorfit.flying.operator import operator_abort

    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    old = sys.stdin
    try:
        with os.fdopen(slave, "r", closefd=False) as terminal:
            sys.stdin = terminal
            with operator_abort() as abort:
                assert abort() == ""
                os.write(master, b"x")
                time.sleep(0.05)
                assert abort() == ""
                os.write(master, b" ")
                time.sleep(0.05)
                assert abort() == "the space bar"
                assert abort() == "the space bar"
            assert termios.tcgetattr(slave) == before
            with operator_abort():
                os.close(master)  # the terminal is closed: nothing to put back, and the results are still to be written
    finally:
        sys.stdin = old
        os.close(slave)


def test_signals_are_taken_only_while_a_flight_lasts() -> None:
    from rotorfit.flying.operator import operator_abort

    before = signal.getsignal(signal.SIGINT)
    with operator_abort() as abort:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        assert abort() == "SIGTERM"
    assert signal.getsignal(signal.SIGINT) is before
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_priority_and_garbage_are_as_before_after_a_flight_and_a_refusal_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import gc

    from rotorfit.flying import operator as realtime

    before = os.sched_getscheduler(0), sys.getswitchinterval(), gc.isenabled()
    with realtime.hurried(True) as note:
        assert not gc.isenabled()
        assert (note == "") == (os.sched_getscheduler(0) == os.SCHED_FIFO)
    assert (os.sched_getscheduler(0), sys.getswitchinterval(), gc.isenabled()) == before
    monkeypatch.setattr(realtime, "_schedule", lambda *_: False)
    with realtime.hurried(True) as note:
        assert note.startswith("no real-time priority: on a busy computer commands may come late")
    with realtime.hurried(False) as note:
        assert note == ""
        assert gc.isenabled() == before[2]
