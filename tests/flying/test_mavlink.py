"""The MAVLink link: messages through pymavlink's buffers without sockets, and a fake autopilot on the loopback."""

import math
import os
import select
import socket
import time
from collections import deque
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from link_room import StubRoom
from rotorfit.core.errors import LinkError
from rotorfit.core.frames import yaw_from_quaternion
from rotorfit.core.log import Sample
from rotorfit.files.cards import builtin_cards, card_from_mapping, load_card
from rotorfit.flying.links import link as wall_clock
from rotorfit.flying.links import mavlink, mavlink_listener
from rotorfit.flying.links.card_window import obedience
from rotorfit.flying.links.mavlink_listener import MavlinkListener, _field
from rotorfit.flying.links.mavlink_messages import (
    AUTOPILOTS,
    Poses,
    SenderClock,
    between,
    mavlink_commands,
    moved,
    setpoint,
)

pymavlink = pytest.importorskip("pymavlink", reason="pip install 'rotorfit[mavlink]'")

from fake_autopilot import Autopilot  # noqa: E402
from pymavlink.dialects.v20 import common  # noqa: E402

MS, SECOND = 1_000_000, 1_000_000_000
CARD = builtin_cards()["mavlink"]
SELECT = select.select


class Wire:
    """One end of two: what the other end sent is parsed by pymavlink, byte by byte, without a socket."""

    def __init__(self, system: int, component: int) -> None:
        self.mav = common.MAVLink(self, system, component)
        self.other: Wire | None = None
        self.incoming: list[Any] = []
        self.open = True

    def write(self, data: bytes) -> None:
        assert self.other is not None
        self.other.incoming += self.other.mav.parse_buffer(bytes(data)) or []

    def recv_msg(self) -> Any:
        return self.incoming.pop(0) if self.incoming else None

    def close(self) -> None:
        self.open = False


class Bench:
    """A link and a fake autopilot in one thread, on a clock that moves when somebody waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, ardupilot: bool = False, mode: str = "grounded") -> None:
        self.instant = 10 * SECOND
        ours, theirs = Wire(245, 191), Wire(1, 1)
        ours.other, theirs.other = theirs, ours
        self.wire = ours
        self.room = StubRoom(mode)
        self.autopilot = Autopilot(theirs, self.room, ardupilot)
        for module in (mavlink, mavlink_listener):
            monkeypatch.setattr(module, "wall_clock", lambda: self.instant)
        monkeypatch.setattr(mavlink, "seconds_until", lambda until: max(0.0, (until - self.instant) / 1e9))
        monkeypatch.setattr("select.select", self.wait)
        ours.fd, theirs.fd = 0, 1  # type: ignore[attr-defined]
        self.link = mavlink.MavlinkLink(ours, mavlink_commands(CARD))

    def wait(
        self, ends: tuple[int], _write: Any, _error: Any, seconds: float
    ) -> tuple[list[int], list[int], list[int]]:
        if ends == (1,) or self.wire.incoming:  # the autopilot always looks, the link waits
            return [*ends], [], []
        self.instant += round(1e9 * min(seconds, 0.01))
        self.room.instant = self.instant - 10 * SECOND
        self.autopilot.step(0.0)
        return ([0] if self.wire.incoming else []), [], []

    def fly(self, seconds: float, command: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> list[Sample]:
        samples: list[Sample] = []
        for _ in range(round(50 * seconds)):
            self.link.send(command)
            samples += self.link.receive(self.instant + 20 * MS)
        return samples


@pytest.fixture(params=[False, True], ids=["px4", "ardupilot"])
def bench(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch, request.param)


def test_take_off_flight_and_landing_as_the_autopilots_document_them(bench: Bench) -> None:
    bench.link.greet()
    bench.link.act("take_off")
    bench.fly(4.0)
    commands_before = len(bench.room.commands)
    bench.fly(1.0, (0.4, 0.3, 0.2, 0.1))
    bench.link.act("land")
    bench.fly(1.0)

    assert [one for one in bench.autopilot.requests if one != 511] == (
        [176, 400, 22, 21] if bench.autopilot.ardupilot else [400, 22, 176, 21]
    )
    assert bench.room.asked == ["take_off", "land"]
    assert len(bench.room.commands) > commands_before
    assert bench.room.commands[-1] == pytest.approx((0.4, 0.3, 0.2, 0.1))
    bench.link.act("close")
    bench.link.act("close")
    assert not bench.wire.open
    with pytest.raises(LinkError, match="closed"):
        bench.link.send((0.0, 0.0, 0.0, 0.0))


def test_a_vehicle_in_the_air_is_taken_over_with_the_first_command_not_before(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.link.receive(bench.instant + 2 * SECOND)  # a preflight
    assert bench.autopilot.requests.count(176) == 0
    assert bench.room.commands == []

    bench.fly(0.2, (0.1, 0.0, 0.0, 0.0))

    assert bench.autopilot.mode == ((4,) if bench.autopilot.ardupilot else (6, 0))
    assert len(bench.room.commands) >= 8  # of ten


def test_a_vehicle_on_the_ground_is_not_put_into_offboard(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, mode="grounded")
    bench.link.greet()
    bench.fly(4.0)

    assert bench.autopilot.mode == (3, 0)


def test_a_pilot_who_takes_over_keeps_the_vehicle(bench: Bench) -> None:
    bench.link.greet()
    bench.link.act("take_off")
    bench.fly(5.0)
    bench.autopilot.mode = (5,) if bench.autopilot.ardupilot else (3, 0)

    with pytest.raises(LinkError, match=r"the vehicle left (OFFBOARD|GUIDED)"):
        bench.fly(2.0)
    assert bench.autopilot.requests.count(176) == 1


@pytest.mark.parametrize(("result", "said", "seconds"), [(2, "denied", 2.0), (1, "temporarily rejected", 8.0)])
def test_a_refusal_is_an_error_that_names_the_step(bench: Bench, result: int, said: str, seconds: float) -> None:
    """One that is temporary is an error when it has come to every try."""
    bench.autopilot.refuse[400] = result
    bench.link.greet()
    bench.link.act("take_off")

    with pytest.raises(LinkError, match=rf"(PX4|ArduPilot) did not arm: {said}"):
        bench.fly(seconds)
    assert bench.room.asked == []


def test_an_answer_to_another_ground_station_is_not_ours(bench: Bench) -> None:
    bench.autopilot.mute.add(400)
    bench.link.greet()
    bench.link.act("take_off")
    bench.fly(0.5)
    bench.autopilot.connection.mav.command_ack_send(400, 0, target_system=255, target_component=190)
    bench.fly(0.5)
    assert bench.room.asked == []  # as arming, which comes first, has no answer yet
    bench.autopilot.mute.clear()
    bench.fly(1.0)
    bench.autopilot.connection.mav.command_ack_send(22, 2, target_system=255, target_component=190)
    bench.fly(2.0)
    assert bench.room.asked == ["take_off"]


@pytest.mark.parametrize("what", ["is disarmed", "is on the ground"])
def test_a_vehicle_that_cannot_fly_any_more_is_sent_no_more_commands(bench: Bench, what: str) -> None:
    """By its kill switch, or after a crash; armed again it would obey the plan at once."""
    bench.link.greet()
    bench.link.act("take_off")
    bench.fly(5.0)
    if what == "is disarmed":
        bench.autopilot.killed = True
    else:
        bench.room.flight_mode = "grounded"
    with pytest.raises(LinkError, match=rf"says that the vehicle {what}; it is sent no more commands"):
        bench.fly(2.0)
    sent = len(bench.room.commands)
    for command in ((0.1, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)):
        with pytest.raises(LinkError, match="no more commands"):
            bench.link.send(command)
    assert len(bench.room.commands) == sent


def test_one_message_that_it_is_on_the_ground_ends_nothing(bench: Bench) -> None:
    bench.link.greet()
    bench.link.act("take_off")
    bench.fly(5.0)
    bench.autopilot.connection.mav.extended_sys_state_send(0, 1)
    bench.fly(3.0)


def test_a_step_that_is_put_off_is_asked_for_again(bench: Bench) -> None:
    bench.autopilot.refuse[400] = 1
    bench.link.greet()
    bench.link.act("take_off")
    bench.fly(3.0)
    assert bench.autopilot.requests.count(400) >= 3
    bench.autopilot.refuse.clear()
    bench.fly(2.0)
    assert bench.room.asked == ["take_off"]


def test_a_step_that_is_in_progress_is_waited_for(bench: Bench) -> None:
    bench.autopilot.refuse[400] = 5
    bench.link.greet()
    bench.link.act("take_off")
    for _ in range(12):
        bench.fly(0.6)
        bench.autopilot.connection.mav.command_ack_send(400, 5)
    bench.autopilot.armed = True
    bench.autopilot.connection.mav.command_ack_send(400, 0)
    bench.fly(2.0)
    assert bench.autopilot.requests.count(400) == 1
    assert bench.room.asked == ["take_off"]


def test_a_refusal_is_told_in_the_autopilots_own_words(bench: Bench) -> None:
    bench.autopilot.refuse[400] = 2
    bench.link.greet()
    long = "PreArm: the compass is not healthy and its offsets are too large to be believed"
    bench.autopilot.says += [(6, "Initialising"), (4, "EKF3 IMU0 stopped aiding"), (2, long)]
    bench.link.act("take_off")

    with pytest.raises(LinkError) as told:
        bench.fly(2.0)
    assert f"did not arm: denied; it says: EKF3 IMU0 stopped aiding; {long}" in str(told.value)
    assert "Initialising" not in str(told.value)


def test_what_the_autopilot_says_and_a_step_of_its_clock_come_with_the_samples(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.autopilot.says.append((3, "EKF variance"))
    first = bench.fly(2.0)
    bench.autopilot.clock += SECOND // 10
    texts = [sample.text for sample in first + bench.fly(1.0) if sample.stream == "said"]

    assert texts[0].endswith(" says: EKF variance")
    assert texts[1].startswith("the autopilot's clock stepped by +0.1")


def test_how_long_the_vehicle_goes_on_is_read_of_its_own_setting(bench: Bench) -> None:
    bench.autopilot.goes_on = 0.75
    bench.link.greet()
    name = "GUID_TIMEOUT" if bench.autopilot.ardupilot else "COM_OF_LOSS_T"
    assert (bench.link.silence.goes_on or 0) >= 1.0  # as it comes, until it has answered
    bench.fly(0.5)

    assert (bench.link.silence.goes_on, bench.link.silence.parameter) == (0.75, name)


def test_silence_is_a_lost_link(bench: Bench) -> None:
    bench.link.greet()
    bench.fly(1.0)
    bench.autopilot.deaf = True

    with pytest.raises(LinkError, match="no heartbeat for 3 s"):
        bench.fly(5.0)


def test_hover_and_landing_are_sent_over_a_link_that_hears_nothing_any_more(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.fly(3.0, (0.4, 0.0, 0.0, 0.0))
    bench.autopilot.deaf = True
    bench.link.receive(bench.instant + 4 * SECOND)

    for command in ((0.4, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)):
        with pytest.raises(LinkError, match="no heartbeat for 3 s"):
            bench.link.send(command)
    bench.link.act("land")
    bench.link.receive(bench.instant + SECOND)
    assert bench.room.asked == ["land"]


def test_the_link_says_what_keeps_the_vehicle_from_obeying(bench: Bench) -> None:
    name, mode = ("ArduPilot", "GUIDED") if bench.autopilot.ardupilot else ("PX4", "OFFBOARD")
    bench.link.greet()
    bench.link.receive(bench.instant + SECOND)
    assert bench.link.undone == f"{name} says that it is on the ground"
    bench.room.flight_mode = "flying"
    bench.link.receive(bench.instant + SECOND)
    assert bench.link.undone == f"{name} is not in {mode}"
    bench.fly(3.0)
    assert bench.link.undone == ""


def test_messages_that_do_not_come_are_asked_for_again(bench: Bench) -> None:
    bench.link.greet()
    bench.fly(1.0)
    once = bench.autopilot.requests.count(511)
    bench.fly(6.0)
    assert bench.autopilot.requests.count(511) > once  # of a room that shows neither pose nor battery
    bench.room.waiting += [Sample("battery", 0, 0, (0.9,)), Sample("pose", 0, 0, (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0))]
    bench.fly(1.0)
    done = bench.autopilot.requests.count(511)
    bench.fly(4.0)
    assert bench.autopilot.requests.count(511) == done


def test_streams_that_come_before_they_were_asked_for_are_asked_for_all_the_same(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.fly(1.0)
    assert bench.autopilot.requests.count(511) == len(mavlink.STREAMS)


def test_the_parameter_is_asked_for_until_it_comes(bench: Bench) -> None:
    bench.autopilot.goes_on = 0.0  # no answer that counts
    bench.link.greet()
    bench.fly(3.0)
    bench.autopilot.goes_on = 0.75
    bench.fly(3.0)
    assert bench.link.silence.goes_on == 0.75


def test_a_refused_mode_is_not_asked_for_again_and_hover_may_be_sent(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.autopilot.refuse[176] = 2
    bench.link.greet()
    with pytest.raises(LinkError, match="denied"):
        bench.fly(4.0)
    asked = bench.autopilot.requests.count(176)

    bench.autopilot.refuse.clear()
    bench.fly(3.0)
    assert bench.autopilot.requests.count(176) == asked == 1
    with pytest.raises(LinkError, match="denied"):
        bench.link.send((0.1, 0.0, 0.0, 0.0))
    with pytest.raises(LinkError, match="has not flown under our commands"):
        bench.link.act("land")


def test_a_vehicle_whose_answer_to_the_take_off_was_lost_is_landed_all_the_same(bench: Bench) -> None:
    bench.link.greet()
    bench.autopilot.silent_about.add(22)
    bench.link.act("take_off")
    with pytest.raises(LinkError, match="did not take off: no answer"):
        bench.link.receive(bench.instant + 8 * SECOND)
    bench.link.act("land")
    bench.link.receive(bench.instant + SECOND)

    assert bench.room.asked[-1] == "land"


@pytest.mark.parametrize("answer", [2, None])
def test_a_landing_that_is_refused_or_not_answered_stays_undone(bench: Bench, answer: int | None) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.fly(3.0)
    if answer is None:
        bench.autopilot.mute.add(21)
    else:
        bench.autopilot.refuse[21] = answer
    bench.link.act("land")
    with pytest.raises(LinkError, match=r"did not land: (denied|no answer)"):
        bench.link.receive(bench.instant + 8 * SECOND)

    bench.link.receive(bench.instant + SECOND)  # once is enough
    assert "did not land" in bench.link.undone


def test_commands_that_reach_the_autopilot_late_are_a_lost_link_but_for_the_hover_after_it(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.fly(2.0)
    waiting, write, step = deque[tuple[int, bytes]](), bench.wire.write, bench.autopilot.step
    delay = 0.0

    def carried(wait: float) -> None:
        while waiting and waiting[0][0] + delay * SECOND <= bench.instant:
            write(waiting.popleft()[1])
        step(wait)

    bench.wire.write = lambda data: waiting.append((bench.instant, data))  # type: ignore[method-assign]
    bench.autopilot.step = carried  # type: ignore[method-assign]
    delay = 0.4
    bench.fly(2.0)
    delay = 0.6
    with pytest.raises(LinkError, match=r"an answer took 0\.6 s: the link is slower than the plan; lower `rate`"):
        bench.fly(2.0)
    bench.link.send((0.0, 0.0, 0.0, 0.0))


def test_an_answer_that_lay_waiting_while_the_operator_was_asked_is_not_late(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, ardupilot=True, mode="flying")
    bench.link.greet()
    bench.link.receive(bench.instant + SECOND // 4)
    bench.link._synced = 0
    bench.link._keep_alive()
    bench.autopilot.step(0.0)  # answers
    bench.instant += 5 * SECOND
    bench.room.instant += 5 * SECOND
    bench.autopilot.step(0.0)  # a heartbeat, and no answer to what is asked from here on
    monkeypatch.setattr(bench.autopilot, "step", lambda _: None)

    bench.link.receive(bench.instant)

    assert bench.link._trip > SECOND
    bench.link.send((0.0, 0.0, 0.0, 0.0))


def test_an_autopilot_that_hears_nothing_any_more_is_a_lost_link_though_its_poses_come(bench: Bench) -> None:
    bench.room.flight_mode = "flying"
    bench.link.greet()
    bench.fly(2.0)
    bench.wire.write = lambda _: None  # type: ignore[method-assign]

    # PX4 leaves its mode without commands, ArduPilot stays in its own
    with pytest.raises(LinkError, match=r"left OFFBOARD|no answer for 3 s: what is sent does not reach the autopilot"):
        bench.fly(5.0)


def test_a_line_that_takes_nothing_is_waited_for_once_and_a_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mavlink, "BLOCKED", 0.05)
    waits: list[float] = []
    monkeypatch.setattr(mavlink.select, "select", lambda *ends: waits.append(ends[3]) or SELECT(*ends))
    end, line = os.pipe()
    os.set_blocking(line, False)
    outlet = mavlink._Outlet(line)
    try:
        with pytest.raises(TimeoutError, match=r"takes nothing for 0\.05 s"):
            outlet.write(bytes(1_000_000))
        with pytest.raises(TimeoutError):
            outlet.write(b"hover")
        assert waits[-2:] == [0.05, 0.0]
        os.read(end, 100_000)
        outlet.write(b"hover")
    finally:
        os.close(end)
        os.close(line)


def test_a_connection_that_the_other_end_closes_is_a_lost_link(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        link = mavlink.MavlinkLink(mavlink.connect(f"tcp:127.0.0.1:{server.getsockname()[1]}"), mavlink_commands(CARD))
        other, _ = server.accept()
        other.close()
        with pytest.raises(LinkError, match="the other end closed the connection"):
            link.receive(link.now + SECOND)
        link.act("close")

    assert capsys.readouterr().out == ""


def test_a_cable_that_is_pulled_is_a_lost_link_not_a_trace(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object) -> None:
        raise OSError(5, "Input/output error")

    bench.link.greet()
    monkeypatch.setattr(bench.wire, "write", gone)
    with pytest.raises(LinkError, match=r"cannot send .*; the link is lost"):
        bench.link.send((0.0, 0.0, 0.0, 0.0))
    bench.wire.incoming.append(None)
    monkeypatch.setattr(bench.wire, "recv_msg", gone)
    with pytest.raises(LinkError, match=r"cannot receive .*; the link is lost"):
        bench.link.receive(bench.instant)


def test_nobody_there_is_one_line(bench: Bench) -> None:
    bench.autopilot.deaf = True

    with pytest.raises(LinkError, match=r"no heartbeat on udpin:127\.0\.0\.1:7; check address"):
        bench.link.greet("udpin:127.0.0.1:7")
    assert not bench.wire.open


def test_a_line_that_breaks_while_greeting_is_closed(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """`track` tries again every second: a port that stays open would stay locked."""

    def gone(*_: object, **__: object) -> None:
        raise OSError("refused")

    bench.autopilot.deaf = True
    bench.wire.incoming.append(None)
    monkeypatch.setattr(bench.wire, "recv_msg", gone)
    with pytest.raises(LinkError, match="the link is lost"):
        bench.link.greet("tcp:127.0.0.1:7")
    assert not bench.wire.open


def test_a_vehicle_that_is_no_multirotor_is_refused(bench: Bench) -> None:
    """Mode 4 is GUIDED of Copter, ACRO of Plane and HOLD of Rover."""
    bench.autopilot.vehicle_type = 1
    with pytest.raises(LinkError, match=r"system 1 is a vehicle of MAV_TYPE 1, no multirotor or helicopter; check"):
        bench.link.greet()
    assert bench.autopilot.requests == []


@pytest.mark.parametrize(("kind", "autopilot"), [(5, 3), (2, 0)])
def test_a_stranger_on_the_line_is_not_taken_for_the_vehicle(bench: Bench, kind: int, autopilot: int) -> None:
    """An antenna tracker of ArduPilot; something with an autopilot of another make."""
    tracker = common.MAVLink(SimpleNamespace(write=lambda data: bench.wire.incoming.extend(parsed(data))), 7, 1)
    tracker.heartbeat_send(kind, autopilot, 0, 4, 4)
    bench.link.greet()
    bench.fly(0.1)

    assert bench.link._target == (1, 1)


def test_another_vehicle_on_the_line_is_told_once(bench: Bench) -> None:
    bench.link.greet()
    other = common.MAVLink(SimpleNamespace(write=lambda data: bench.wire.incoming.extend(parsed(data))), 2, 1)
    texts = list[str]()
    for _ in range(3):
        other.heartbeat_send(2, 12, 128, 0, 4)
        texts += [one.text for one in bench.link.receive(bench.instant + SECOND) if one.text]

    assert texts == [
        "two vehicles are heard: this is system 1, the first that was heard, not system 2; give each a port of its own"
    ]


def parsed(data: bytes) -> list[Any]:
    return common.MAVLink(None).parse_buffer(bytes(data)) or []


def test_poses_come_back_in_our_frame_on_our_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, mode="flying")
    bench.link.greet()
    yaw = 0.7
    found: list[Sample] = []
    start = bench.instant
    for step in range(100):
        taken = bench.room.instant
        quaternion = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
        bench.room.waiting.append(Sample("pose", taken, taken, (1.0, 2.0, 0.5 + 0.01 * step, *quaternion)))
        bench.room.waiting.append(Sample("battery", taken, taken, (0.8,)))
        found += bench.link.receive(bench.instant + 20 * MS)

    poses = [sample for sample in found if sample.stream == "pose"]
    assert len(poses) > 90
    assert poses[-1].values[:2] == pytest.approx((1.0, 2.0))
    assert float(yaw_from_quaternion(*np.array(poses[-1].values[3:]))) == pytest.approx(yaw)
    for pose in poses:  # stamped when it was measured, to the millisecond that MAVLink has
        assert pose.stamp - start == pytest.approx(round((pose.values[2] - 0.5) / 0.01) * 20 * MS, abs=11 * MS)
        assert pose.stamp <= pose.received
    assert np.ptp(np.diff([pose.stamp for pose in poses])) <= 11 * MS
    assert next(sample for sample in found if sample.stream == "battery").values == (0.8,)


def test_setpoints_go_through_the_wire_unchanged() -> None:
    ours, theirs = Wire(245, 191), Wire(1, 1)
    ours.other = theirs

    ours.mav.set_position_target_local_ned_send(*setpoint(mavlink_commands(CARD), (0.4, 0.3, 0.2, 0.1), 7, (1, 1)))
    message = theirs.recv_msg()

    assert (message.vx, message.vy, message.vz, message.yaw_rate) == pytest.approx((0.4, -0.3, -0.2, -0.1))
    assert (message.coordinate_frame, message.type_mask, message.time_boot_ms) == (8, 1479, 7)
    assert (message.target_system, message.target_component) == (1, 1)


def test_tilts_and_other_cards_are_refused() -> None:
    raw = {**CARD.raw, "command": {**CARD.raw["command"], "x": {**CARD.raw["command"]["x"], "meaning": "tilt"}}}

    with pytest.raises(LinkError, match="x means tilt"):
        mavlink_commands(card_from_mapping(raw, "tilted"))
    with pytest.raises(LinkError, match="use --card mavlink"):
        mavlink_commands(builtin_cards()["bebop2"])


def test_a_senders_clock_is_found_from_the_least_delayed_message() -> None:
    clock, rng = SenderClock(), np.random.default_rng(1)
    true_offset = 5 * SECOND
    stamps = [k * 20 * MS for k in range(200)]

    ours = [clock.ours(stamp, stamp + true_offset + 2 * MS + round(rng.exponential(3 * MS))) for stamp in stamps]

    assert ours[-1] - stamps[-1] - true_offset == pytest.approx(2 * MS, abs=0.5 * MS)  # it may drift


def exchanges(drift: float, step_at: float = math.inf, step: int = 0, seconds: float = 60.0) -> tuple[list[int], int]:
    """Errors of stamps [ns] by a clock that drifts and steps, asked five times a second over a jittered radio."""
    clock, rng = SenderClock(), np.random.default_rng(2)
    errors, told, asked = [], 0, 0

    def theirs(ours: int) -> int:
        return round((1 - drift) * ours) + 3 * SECOND + (step if ours >= step_at * SECOND else 0)

    for now in range(0, round(seconds * SECOND), 20 * MS):
        if now - asked >= SECOND // 5:
            asked = now
            there, back = (MS + round(rng.exponential(2 * MS)) for _ in range(2))
            told += abs(clock.exchanged(now, theirs(now + there), now + there + back)) // MS
        stamp = now - 8 * MS
        errors.append(clock.ours(theirs(stamp) // MS * MS, now) - stamp)
    return errors, told


@pytest.mark.parametrize("drift", [0.25e-3, -0.25e-3])
def test_a_clock_that_drifts_is_followed(drift: float) -> None:
    errors, told = exchanges(drift)

    assert told == 0
    assert max(map(abs, errors[250:])) < 2 * MS
    assert abs(np.mean(errors[-500:])) < MS  # which the stamps themselves are cut to


@pytest.mark.parametrize("step", [100 * MS, -100 * MS])
def test_a_clock_that_steps_is_told_and_followed(step: int) -> None:
    errors, told = exchanges(0.1e-3, 30.0, step)

    assert told == pytest.approx(100, abs=4)
    assert max(map(abs, errors[31 * 50 :])) < 3 * MS


def test_an_exchange_of_stamps_removes_the_least_delay_too() -> None:
    clock = SenderClock()
    clock.exchanged(sent=100 * MS, theirs=1102 * MS, received=104 * MS)  # their clock is a second ahead, 2 ms each way
    clock.exchanged(sent=200 * MS, theirs=1202 * MS, received=240 * MS)  # a slow answer does not count

    assert clock.ours(1300 * MS, 310 * MS) == 300 * MS
    assert clock.ours(1400 * MS, 399 * MS) == 399 * MS  # never later than it arrived


def test_a_pose_says_how_well_its_instant_is_known() -> None:
    """To half of the shortest round trip: all of it may be in one way."""
    poses = Poses()
    for sent, trip in ((100, 60), (300, 40), (500, 90)):
        poses.clock.exchanged(sent=sent * MS, theirs=(sent + trip // 2) * MS, received=(sent + trip) * MS)
    poses.take(turned(600, 0.2), 640 * MS)
    place = message("LOCAL_POSITION_NED", 610, x=1.0, y=0.0, z=-1.0, vx=0.3, vy=0.0, vz=-0.1)
    found = poses.take(place, 650 * MS) + poses.take(turned(620, 0.4), 660 * MS)

    assert [sample.error for sample in found] == [0.02, 0.02]
    whole = SimpleNamespace(
        get_type=lambda: "ODOMETRY", time_usec=700_000, frame_id=1, x=1.0, y=2.0, z=-3.0, q=[1.0, 0.0, 0.0, 0.0]
    )
    assert poses.take(whole, 750 * MS)[0].error == 0.02


def test_a_clock_that_nothing_tells_is_said_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.autopilot, "_on_timesync", lambda _: None)
    bench.room.flight_mode = "flying"
    bench.link.greet()
    samples = [one for _ in range(30) for one in bench.link.receive(bench.instant + SECOND // 10)]

    (told,) = [sample for sample in samples if sample.text]
    assert "does not answer TIMESYNC: its poses are timed by the least delayed arrival, and the delay" in told.text
    assert told.received - bench.link._start <= SECOND  # within the preflight


def message(kind: str, ms: int, **fields: float) -> Any:
    return SimpleNamespace(get_type=lambda: kind, time_boot_ms=ms, **fields)


def turned(ms: int, yaw: float) -> Any:
    return message("ATTITUDE", ms, roll=0.0, pitch=0.0, yaw=yaw, yawspeed=0.5)


def test_the_attitude_is_interpolated_to_the_instant_of_the_position() -> None:
    poses = Poses()
    place = message("LOCAL_POSITION_NED", 115, x=1.0, y=0.0, z=-1.0, vx=0.3, vy=0.0, vz=-0.1)

    early = poses.take(turned(100, 0.2), 100) + poses.take(place, 115)
    late = poses.take(turned(120, 0.4), 120)

    assert early == []
    assert [sample.stream for sample in late] == ["pose", "velocity"]
    heading = math.pi / 2 - float(yaw_from_quaternion(*np.array(late[0].values[3:])))
    assert heading == pytest.approx(0.35, abs=1e-4)
    assert late[1].values == pytest.approx((0.3 * math.cos(0.35), 0.3 * math.sin(0.35), 0.1, -0.5), abs=1e-4)


@pytest.mark.parametrize("later", [0, 10])
def test_slow_attitudes_make_one_pose_each_at_their_own_instant(later: int) -> None:
    """Fifty positions a second, five attitudes: none between them is made up."""
    poses, found = Poses(), list[Sample]()
    for ms in range(0, 3000, 20):
        t = ms / 1e3
        found += poses.take(message("LOCAL_POSITION_NED", ms, x=t**2, y=0.0, z=-1.0, vx=2 * t, vy=0.0, vz=0.0), ms * MS)
        if ms % 200 == 0:
            found += poses.take(turned(ms + later, t), ms * MS)

    assert poses.turns_slowly
    whole = [sample for sample in found if sample.stream == "pose"]
    assert len(whole) == 15
    for k, pose in enumerate(whole):
        assert pose.values[1] == pytest.approx((0.2 * k + later / 1e3) ** 2, abs=1e-9)  # north
        heading = math.pi / 2 - float(yaw_from_quaternion(*np.array(pose.values[3:])))
        assert heading == pytest.approx(0.2 * k, abs=1e-6)  # as it was told


@pytest.mark.parametrize("seed", range(3))
def test_on_a_link_that_loses_much_poses_do_not_go_back_in_time(seed: int) -> None:
    """Ten of each a second: at times one kind comes slower, at times the other."""
    rng, poses, stamps = np.random.default_rng(seed), Poses(), list[int]()
    for ms in range(0, 60_000, 100):
        for sent in (message("LOCAL_POSITION_NED", ms, x=0, y=0, z=-1, vx=0, vy=0, vz=0), turned(ms + 13, 0.0)):
            if rng.random() > 0.3:
                stamps += [sample.stamp for sample in poses.take(sent, (ms + 20) * MS) if sample.stream == "pose"]

    assert len(stamps) > 300
    assert np.all(np.diff(stamps[20:]) > 0)  # before, the clock of the sender settles


def test_attitudes_as_fast_as_positions_make_a_pose_of_each_position() -> None:
    poses, found = Poses(), 0
    for ms in range(0, 3000, 20):
        late = 4 * (ms // 20 % 3)
        found += len(poses.take(turned(ms + late, 0.2), ms * MS))
        place = message("LOCAL_POSITION_NED", ms + 8 - late, x=1.0, y=0.0, z=-1.0, vx=0.3, vy=0.0, vz=-0.1)
        found += len(poses.take(place, ms * MS))

    assert not poses.turns_slowly
    assert found >= 2 * 147


def test_between_two_positions_the_vehicle_moves_by_its_velocity_or_straight() -> None:
    def at(t: float, known: float = 1.0) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
        return round(1e9 * t), (t**3, 2.0, 0.0), (3 * t**2 * known, 0.0, 0.0)

    place, velocity = moved(at(1.0), at(1.2), round(1.15e9))
    assert place == pytest.approx((1.15**3, 2.0, 0.0))
    assert velocity[0] == pytest.approx(3 * 1.15**2, rel=0.01)
    straight, _ = moved(at(1.0, math.nan), at(1.2, math.nan), round(1.15e9))
    assert straight == pytest.approx((1.0 + 0.75 * (1.2**3 - 1.0), 2.0, 0.0))


def test_slow_attitudes_are_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, mode="flying")
    bench.link.greet()
    mav, texts = bench.autopilot.connection.mav, list[str]()
    for k in range(100):
        mav.local_position_ned_send(20 * k, 1.0, 2.0, -1.0, 0.0, 0.0, 0.0)
        if k % 7 == 0:
            mav.attitude_send(20 * k, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
        texts += [one.text for one in bench.link.receive(bench.instant + 20 * MS) if one.text]

    assert texts == [
        "attitudes come 7 times a second, positions 50 times: there is one pose for each attitude; ask the autopilot "
        "for more (ArduPilot: SRx_EXTRA1)"
    ]


def test_poses_go_on_at_once_where_the_senders_clock_goes_back() -> None:
    poses = Poses()

    def at(ms: int) -> list[Sample]:
        place = message("LOCAL_POSITION_NED", ms, x=1.0, y=0.0, z=-1.0, vx=0.3, vy=0.0, vz=-0.1)
        return poses.take(place, 0) + poses.take(turned(ms, 0.2), 0)

    before = [len(at(40_000 + 20 * k)) for k in range(60)]
    after = [len(at(10_000 + 20 * k)) for k in range(60)]

    assert before[1:] == [2] * 59
    assert after[1:] == [2] * 59


def test_a_message_that_another_one_overtook_costs_nothing() -> None:
    poses = Poses()
    place = message("LOCAL_POSITION_NED", 115, x=1.0, y=0.0, z=-1.0, vx=0.3, vy=0.0, vz=-0.1)
    for ms in (100, 120, 140):
        poses.take(turned(ms, 0.2), ms)

    assert len(poses.take(place, 145)) == 2


def test_whole_odometry_replaces_position_and_attitude() -> None:
    poses = Poses()
    whole = SimpleNamespace(
        get_type=lambda: "ODOMETRY", time_usec=100_000, frame_id=1, x=1.0, y=2.0, z=-3.0, q=[1.0, 0.0, 0.0, 0.0]
    )

    assert [sample.values[:3] for sample in poses.take(whole, 1)] == [(2.0, 1.0, 3.0)]
    assert poses.take(turned(120, 0.4), 2) == []


def test_numbers_that_are_not_finite_are_no_pose() -> None:
    poses = Poses()
    place = message("LOCAL_POSITION_NED", 115, x=math.nan, y=0.0, z=-1.0, vx=0.3, vy=0.0, vz=-0.1)

    assert poses.take(turned(100, 0.2), 1) + poses.take(place, 2) + poses.take(turned(120, 0.4), 3) == []


def test_quaternions_of_opposite_sign_are_the_same_attitude() -> None:
    assert between((1.0, 0.0, 0.0, 0.0), (-1.0, 0.0, 0.0, 0.0), 0.5) == pytest.approx((1.0, 0.0, 0.0, 0.0))


def test_a_port_that_cannot_be_opened_is_one_line() -> None:
    with pytest.raises(LinkError, match=r"cannot open udpin:no-such-host.invalid:1"):
        mavlink.open_link("udpin:no-such-host.invalid:1", load_card("mavlink"))


@pytest.mark.parametrize(
    "address",
    ["/dev/ttyS0:57600", "/dev/ttyS0,fast", "udp://:14540", "udpin:0.0.0.0", "serial:/dev/ttyS0:57600", "foo", "COM3"],
)
def test_what_is_no_address_is_told_the_forms_of_one(address: str) -> None:
    with pytest.raises(LinkError, match=rf"{address} is no address; give udpin:HOST:PORT .* \(/dev/ttyUSB0,57600; 115"):
        mavlink.connect(address)


def test_a_port_that_nobody_serves_prints_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("time.sleep", lambda _seconds: None)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

    with pytest.raises(LinkError, match="Connection refused"):
        mavlink.connect(f"tcp:127.0.0.1:{port}")
    assert capsys.readouterr().out == ""


def test_two_flights_do_not_share_a_port() -> None:
    first = mavlink.connect("udpin:127.0.0.1:0")
    port = first.port.getsockname()[1]
    try:
        with pytest.raises(LinkError, match=f"udpin:127.0.0.1:{port} is in use by another program"):
            mavlink.open_link(f"udpin:127.0.0.1:{port}", load_card("mavlink"))
    finally:
        first.close()


def test_two_flights_do_not_share_a_serial_line() -> None:
    pytest.importorskip("serial", reason="pip install pyserial")
    here, there = os.openpty()
    line = os.ttyname(there)
    first = mavlink.connect(line)
    try:
        with pytest.raises(LinkError, match=f"{line} is in use by another program"):
            mavlink.connect(line)
    finally:
        first.close()
        os.close(here)
        os.close(there)


def test_every_autopilot_says_what_it_does_without_us() -> None:
    assert all("s" in one.fail_safe and len(one.fail_safe) > 40 for one in AUTOPILOTS.values())


def test_the_wall_clock_runs_with_time_and_shows_the_time_of_day() -> None:
    first = wall_clock.wall_clock()

    assert abs(first - time.time_ns()) < SECOND
    assert wall_clock.wall_clock() >= first
    assert wall_clock.seconds_until(first) == 0.0


class Overheard(Bench):
    """The same vehicle, flown by another companion computer, and a listener beside."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, mode: str = "flying") -> None:
        super().__init__(monkeypatch, mode=mode)
        self.sent: list[str] = []
        write = self.wire.write

        def remembered(data: bytes) -> None:
            parser = common.MAVLink(None)
            self.sent += [one.get_type() for one in parser.parse_buffer(bytes(data)) or []]
            write(data)

        monkeypatch.setattr(self.wire, "write", remembered)
        self.link = MavlinkListener(self.wire, mavlink_commands(CARD))
        self.pilot = common.MAVLink(SimpleNamespace(write=self.forwarded), 255, 190)

    def forwarded(self, data: bytes) -> None:
        self.wire.incoming += self.wire.mav.parse_buffer(bytes(data)) or []

    def hear(self, seconds: float) -> list[Sample]:
        return self.link.receive(self.instant + round(seconds * SECOND))


def pose_at(heading: float) -> Sample:
    """A pose whose heading is that from north, clockwise."""
    half = (np.pi / 2 - heading) / 2
    return Sample("pose", 0, 0, (1.0, 2.0, 3.0, math.cos(half), 0.0, 0.0, math.sin(half)))


def test_a_listener_sends_nothing_but_what_it_needs_to_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Overheard(monkeypatch)
    bench.link.greet()
    bench.hear(3.0)

    assert set(bench.sent) == {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG"}
    assert set(bench.autopilot.requests) == {511}  # MAV_CMD_SET_MESSAGE_INTERVAL
    assert not bench.room.commands
    for action in ("take_off", "land"):
        with pytest.raises(LinkError):
            bench.link.act(action)  # type: ignore[arg-type]
    with pytest.raises(LinkError):
        bench.link.send((0.0, 0.0, 0.0, 0.0))


def test_a_listener_hears_what_another_system_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Overheard(monkeypatch)
    bench.link.greet()
    fields = mavlink_commands(CARD)
    bench.pilot.set_position_target_local_ned_send(*setpoint(fields, (0.5, -0.25, 1.0, 0.1), 1000, (1, 1)))
    (command,) = [one for one in bench.hear(0.1) if one.stream == "command"]

    assert command.values == pytest.approx((0.5, -0.25, 1.0, 0.1))


def test_a_listener_turns_velocities_along_the_world_to_the_heading(monkeypatch: pytest.MonkeyPatch) -> None:
    """The autopilot's echo of what it follows is along north and east; the vehicle looks east."""
    bench = Overheard(monkeypatch)
    bench.link.greet()
    bench.room.waiting.append(pose_at(np.pi / 2))
    bench.hear(0.1)
    bench.autopilot.connection.mav.position_target_local_ned_send(5, 1, 1479, 0, 0, 0, 0.5, 2.0, -1.0, 0, 0, 0, 0, -0.3)
    (command,) = [one for one in bench.hear(0.1) if one.stream == "command"]

    assert command.values == pytest.approx((2.0, 0.5, 1.0, 0.3), abs=1e-6)


@pytest.mark.parametrize("mask", [0b1101_1100_0000, 0b1101_1110_0011, 0b1101_1111_1000])
def test_a_setpoint_of_a_position_is_no_velocity_command(monkeypatch: pytest.MonkeyPatch, mask: int) -> None:
    """With velocities beside it, of the height alone, and without velocities."""
    bench = Overheard(monkeypatch)
    bench.autopilot.mode = (6, 0)
    monkeypatch.setattr(bench.autopilot, "_fly", lambda: None)  # it stays in OFFBOARD
    bench.link.greet()
    bench.hear(1.0)
    velocity, place = (0, 1, 1, 8, 1479, 0, 0, 0, 0.5, 0, 0, 0, 0, 0, 0, 0), (0, 1, 1, 1, mask, 1, 2, -3, *[0.0] * 8)
    told = []
    for setpoint_ in (velocity, place, velocity):
        bench.pilot.set_position_target_local_ned_send(*setpoint_)
        told += [(one.stream, one.values[0]) for one in bench.hear(0.1) if one.stream in ("command", "obeys")]

    assert told == [("command", 0.5), ("obeys", 0.0), ("obeys", 1.0), ("command", 0.5)]


def test_a_listener_says_when_the_vehicle_does_not_obey(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Overheard(monkeypatch)
    bench.link.greet()
    bench.hear(1.0)
    bench.room.flight_mode = "landing"
    told = [one.values for one in bench.hear(1.0) if one.stream == "obeys"]

    assert told == [(0.0,)]


def test_a_listener_keeps_to_the_window_of_the_card(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Overheard(monkeypatch)
    raw = {**CARD.raw, "window": [{"when": "HEARTBEAT:armed"}, {"when": "HEARTBEAT:custom_mode", "equals": 6 << 16}]}
    window = obedience(card_from_mapping(raw, "mavlink"))
    bench.link = MavlinkListener(bench.wire, mavlink_commands(CARD), window=window)
    told = []
    for base, mode in ((0, 6), (128, 6), (128, 3), (129, 6)):
        heartbeat = common.MAVLink_heartbeat_message(2, 12, base, mode << 16, 3, 3)
        told += [one.values for one in window.heard("HEARTBEAT", partial(_field, heartbeat), 1)]

    assert [one.values for one in bench.link._inbox] == [(0.0,)]  # nothing is learnt before the first heartbeat
    assert told == [(1.0,), (0.0,), (1.0,)]


def test_a_vehicle_that_was_started_anew_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Overheard(monkeypatch)
    bench.link.greet()
    bench.hear(1.0)
    bench.autopilot.deaf = True
    bench.hear(5.0)
    bench.autopilot.deaf, bench.autopilot.requests = False, []
    bench.hear(2.0)

    assert set(bench.autopilot.requests) == {511}
