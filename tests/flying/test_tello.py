"""The Tello link against a fake Tello on the loopback network."""

import math
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from fake_tello import Tello

from link_room import StubRoom
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.files.cards import builtin_cards, load_card
from rotorfit.flying.links import tello
from rotorfit.flying.links.card_fields import pose_fields
from rotorfit.flying.links.link import wall_clock

CARD = builtin_cards()["tello"]
HOST = f"127.1.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"  # of this process alone
TENTH = 100_000_000


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("", 0))
        return int(one.getsockname()[1])


@contextmanager
def running(step: Callable[[], None]) -> Iterator[None]:
    done = threading.Event()

    def run() -> None:
        while not done.is_set():
            step()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> StubRoom:
    monkeypatch.setattr(tello, "PATIENCE", 0.2)
    monkeypatch.setattr(tello, "SILENCE", 0.3)
    stub = StubRoom()
    stub.now = lambda: wall_clock()  # type: ignore[method-assign]
    stub.waiting = [Sample("pose", 0, 0, (0.5, -0.3, 1.2, math.cos(0.4), 0.0, 0.0, math.sin(0.4)))]
    return stub


def test_commands_poses_battery_and_actions_reach_their_ends(room: StubRoom) -> None:
    port = free_port()
    drone = Tello(room, HOST, port)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"{HOST}:{port}", load_card("tello"))
        link.act("take_off")
        link.send((0.5, 0.25, -0.1, 0.2))
        samples = link.receive(link.now + 3 * TENTH)
        link.act("land")
        link.receive(link.now + TENTH)
        link.act("close")
        link.act("close")

    assert room.asked == ["take_off", "land"]
    assert room.commands == [pytest.approx((0.5, 0.25, -0.1, 0.2))]
    pose = next(sample for sample in samples if sample.stream == "pose")
    assert pose.values[:3] == pytest.approx((0.5, -0.3, 1.2))
    assert 2 * math.atan2(pose.values[6], pose.values[3]) == pytest.approx(0.8, abs=math.radians(0.51))
    assert pose.stamp == pose.received
    assert next(sample for sample in samples if sample.stream == "battery").values == (1.0,)
    assert "mdirection 0" in drone.heard
    with pytest.raises(LinkError, match="closed"):
        link.send((0.0, 0.0, 0.0, 0.0))


def test_a_tello_without_pads_gives_no_pose(room: StubRoom) -> None:
    port = free_port()
    drone = Tello(room, HOST, port, pads=False)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"{HOST}:{port}", load_card("tello"))
        streams = {sample.stream for sample in link.receive(link.now + 3 * TENTH)}
        link.act("close")

    assert streams == {"battery"}


def test_positions_over_another_pad_are_left_out_and_it_is_told_once(room: StubRoom) -> None:
    """They are relative to that pad: the fence would be somewhere else."""
    port = free_port()
    drone = Tello(room, HOST, port)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"{HOST}:{port}", load_card("tello"))
        link.receive(link.now + TENTH)
        drone.pad = 2
        changed = link.receive(link.now + 2 * TENTH)
        elsewhere = link.receive(link.now + 2 * TENTH)
        drone.pad = 1
        back = link.receive(link.now + 3 * TENTH)
        link.act("close")

    told = [sample.text for sample in changed if sample.text]
    assert told == ["mission pad 2 is below, not 1: positions over it are left out"]
    assert {sample.stream for sample in elsewhere} == {"battery"}
    assert "pose" in {sample.stream for sample in back}


def test_a_lost_link_is_an_error_at_the_next_command(room: StubRoom) -> None:
    port = free_port()
    drone = Tello(room, HOST, port)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"{HOST}:{port}", load_card("tello"))
        drone.deaf = True
        link.receive(link.now + 5 * TENTH)
        for command in ((0.3, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)):
            with pytest.raises(LinkError, match=r"no state .* the link is lost"):
                link.send(command)
        link.receive(link.now + TENTH)
        link.act("close")

    assert room.commands == [(0.0, 0.0, 0.0, 0.0)]  # hover is sent all the same


def test_a_late_answer_to_the_take_off_is_none_to_the_landing(room: StubRoom) -> None:
    port = free_port()
    drone = Tello(room, HOST, port)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"{HOST}:{port}", load_card("tello"))
        drone.mute.update({"takeoff", "land"})
        link.act("take_off")
        link.act("land")
        link.receive(link.now + TENTH)
        drone.socket.sendto(b"ok", link._talk.getsockname())  # it has climbed
        link.receive(link.now + TENTH)
        assert link.undone
        drone.mute.clear()
        link.receive(link.now + 8 * TENTH)
        assert not link.undone
        link.act("close")


def test_a_landing_is_asked_for_until_it_is_answered_with_ok(room: StubRoom) -> None:
    port = free_port()
    drone = Tello(room, HOST, port)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"{HOST}:{port}", load_card("tello"))
        drone.says["land"] = "error Not joystick"
        link.act("land")
        said = [sample.text for sample in link.receive(link.now + 5 * TENTH) if sample.stream == "said"]
        assert link.undone == "tello: it has not answered `land` with ok"
        drone.says.clear()
        link.receive(link.now + 5 * TENTH)
        assert link.undone == ""
        asked = drone.heard.count("land")
        link.receive(link.now + 5 * TENTH)
        link.act("close")

    assert said[0] == "Tello answers land: error Not joystick"
    assert drone.heard.count("land") == asked >= 3


def test_nobody_there_is_one_line_that_says_what_to_try(room: StubRoom) -> None:
    assert room.asked == []
    with pytest.raises(LinkError, match=r"no answer from .*join its network"):
        tello.open_link(f"{HOST}:{free_port()}", load_card("tello"))


def test_a_host_may_be_given_by_its_name(room: StubRoom, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its packets come from the address behind the name."""
    monkeypatch.setattr(socket, "gethostbyname", {"drone.local": HOST}.__getitem__)
    port = free_port()
    drone = Tello(room, HOST, port)
    with drone.socket, running(drone.step):
        link = tello.open_link(f"drone.local:{port}", CARD)
        link.act("close")
    assert "command" in drone.heard


@pytest.mark.parametrize(("address", "told"), [("127.0.0.1:99999", "no port"), ("no.such.host.invalid", "no host")])
def test_what_is_no_host_or_port_is_one_line(address: str, told: str) -> None:
    with pytest.raises(LinkError, match=told):
        tello.open_link(address, CARD)


def test_a_port_that_is_taken_is_said() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        with pytest.raises(LinkError, match="is taken"):
            tello.open_link(f"{HOST}:{other.getsockname()[1]}", load_card("tello"))


def test_sticks_are_whole_numbers_with_the_signs_of_the_sdk() -> None:
    fields = tello.tello_commands(CARD)

    sticks = tello.sticks_of(fields, (0.504, 0.25, 1.0, -0.1))
    assert list(sticks.values()) == [-25, 50, 100, 10]
    assert tello.as_commanded(fields, sticks) == pytest.approx((0.5, 0.25, 1.0, -0.1))
    assert list(tello.sticks_of(fields, (0.0, 0.0, 0.0, 0.0)).values()) == [0, 0, 0, 0]


def test_more_than_full_stick_is_refused_not_clipped() -> None:
    with pytest.raises(LinkError, match="beyond full stick"):
        tello.sticks_of(tello.tello_commands(CARD), (1.02, 0.0, 0.0, 0.0))


def test_a_card_of_something_else_is_refused() -> None:
    with pytest.raises(LinkError, match="use --card tello"):
        tello.tello_commands(builtin_cards()["bebop2"])


def test_a_state_packet_is_read_field_by_field() -> None:
    state = tello.state_from_text("mid:3;x:12;y:-7;z:95;mpry:1,-2,30;bat:84;baro:163.98;\r\n")

    assert state["mpry[2]"] == 30
    pose = tello.samples(state, pose_fields(CARD), 5)[1].values
    assert pose[:3] == pytest.approx((0.12, -0.07, 0.95))
    assert 2 * math.atan2(pose[6], pose[3]) == pytest.approx(-math.radians(30))


@pytest.mark.parametrize("text", ["", "ok", ";;;:::", "mid:x;bat:", "\ufffd\ufffd:1", "bat:nan", "error Motor stop"])
def test_what_is_no_state_packet_is_nothing(text: str) -> None:
    assert tello.state_from_text(text) == {}


def test_a_damaged_pad_gives_no_pose_but_the_battery() -> None:
    state = tello.state_from_text("mid:3;x:12;y:;z:95;mpry:1,-2;bat:84;")

    assert [sample.stream for sample in tello.samples(state, pose_fields(CARD), 5)] == ["battery"]
