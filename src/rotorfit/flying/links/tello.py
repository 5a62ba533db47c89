"""Ryze Tello over UDP: the text protocol of its SDK, four sticks out, the state packet in.

Source: Ryze, "Tello SDK 2.0 User Guide" (2018) and "Mission Pad User Guide" (2018): commands to 192.168.10.1:8889,
state to port 8890 of whoever sent `command`; `rc a b c d` in -100..100 is left/right, forward/back, up/down, yaw; a
Tello lands by itself when it hears no command for 15 s; a pad's position is in cm, mid is -1 or -2 without a pad.
"""

import math
import select
import socket
import time
from collections.abc import Mapping, Sequence

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Sample
from rotorfit.flying.links.card_fields import (
    CommandFields,
    PoseFields,
    command_fields,
    pose_fields,
    pose_values,
    raw_values,
)
from rotorfit.flying.links.link import Action, Silence, seconds_until, wall_clock

HOST, COMMAND_PORT, STATE_PORT = "192.168.10.1", 8889, 8890

STICKS = ("a", "b", "c", "d")

FULL_STICK = 100

SILENCE = 1.0
"""Time without a state packet, which comes at 10 Hz, after which the link is lost [s]."""

PATIENCE, TRIES = 1.0, 5

LANDS = 15.0
"""Time after the last command after which a Tello lands; until then it may keep flying [s]."""

FAIL_SAFE = (
    "A Tello lands 15 s after the last command (Tello SDK 2.0). Nothing says that its sticks return to zero before: "
    "assume that it flies on, and keep its space clear beyond the fence."
)


def open_link(address: str, card: Card) -> "TelloLink":
    """Puts a Tello into SDK mode and looks for mission pads below it.

    Args:
        address: HOST or HOST:STATE_PORT; empty for 192.168.10.1, which a Tello has on its own network.
        card: What the sticks and the state packet mean; the built-in one is `tello`.

    Raises:
        LinkError: Nobody answers, the port of the state is taken, or the card is not that of a Tello.
    """
    host, _, port = address.partition(":")
    if port and not (port.isdecimal() and int(port) < 1 << 16):
        raise LinkError(f"tello:{address}: {port!r} is no port; write tello, tello:HOST or tello:HOST:STATE_PORT")
    link = TelloLink(card, host or HOST, int(port or STATE_PORT))
    link.greet()
    return link


class TelloLink:
    """A Tello; implements `links.Link`. All of it runs in the caller's thread."""

    def __init__(self, card: Card, host: str, state_port: int) -> None:
        self.live = True
        self.fail_safe, self.silence = card.fail_safe or FAIL_SAFE, Silence(card.hold or LANDS)
        self._commands, self._poses = tello_commands(card), pose_fields(card)
        self._drone, self._state_port = (_address(host), COMMAND_PORT), state_port
        self._talk, self._state = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._inbox: list[Sample] = []
        self._replies: list[str] = []
        self._pads: list[float] = []  # numbers of the mission pads that were seen, in order
        self._asked, self._asked_at = "", 0  # `takeoff` or `land` until it is answered with ok, and when it was sent
        self._open_questions: list[str] = []  # what was sent and not answered yet, in order
        self._heard = wall_clock()
        self._open = True
        try:
            self._state.bind(("", state_port))
        except OSError as error:
            self._close()
            raise LinkError(f"tello: port {state_port} is taken ({error.strerror}); end the other program") from error

    @property
    def now(self) -> int:
        """The wall clock [ns]."""
        return wall_clock()

    def greet(self) -> None:
        """Enters SDK mode, and enables the detection of mission pads by the downward camera, at 20 Hz.

        A Tello other than the EDU refuses the detection; it flies all the same, without a position.

        Raises:
            LinkError: There is no answer to `command`, or no state.
        """
        if not self._ask("command"):
            self._close()
            raise LinkError(f"tello: no answer from {self._drone[0]}; join its network (TELLO-...) and switch it on")
        if self._ask("mon"):
            self._ask("mdirection 0")
        self.receive(wall_clock() + int(1e9 * SILENCE))
        if self._silent():
            self._close()
            raise LinkError(
                f"tello: it answers but sends no state to UDP port {self._state_port}; let the firewall pass it"
            )

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Sets the sticks, in whole per cent; see `links.Link`."""
        sticks = sticks_of(self._commands, command)
        silent = self._silent()
        if not (silent and any(command)):
            self._say("rc " + " ".join(map(str, sticks.values())))
        if silent:
            raise LinkError(f"tello: no state from {self._drone[0]} for {SILENCE:g} s; the link is lost")
        return as_commanded(self._commands, sticks)

    def receive(self, until: int) -> list[Sample]:
        """What has arrived since the last call; see `links.Link`."""
        while self._open:
            left = seconds_until(until)
            ready, _, _ = select.select((self._talk, self._state), (), (), min(left, PATIENCE) if self._asked else left)
            if not ready and seconds_until(until) <= 0:
                break
            for one in ready:
                self._take(one)
            self._follow()
        arrived, self._inbox = self._inbox, []
        return arrived

    def act(self, action: Action) -> None:
        """`takeoff`, `land`, or closes; see `links.Link`."""
        if action == "close":
            self._close()
            return
        self._replies.clear()
        self._question({"take_off": "takeoff", "land": "land"}[action])

    def _question(self, word: str) -> None:
        self._asked, self._asked_at = word, wall_clock()
        self._open_questions.append(word)
        self._say(word)

    @property
    def undone(self) -> str:
        """Whether `land` was answered; see `links.Link`."""
        return "tello: it has not answered `land` with ok" if self._asked == "land" else ""

    def _follow(self) -> None:
        """Reads the answers to `takeoff` and `land`, and repeats `land`, which does no harm, until it is answered.

        Answers come in the order of the questions: that to `takeoff`, once the Tello has climbed, is none to `land`.
        """
        for reply in self._replies:
            word = self._open_questions.pop(0) if self._open_questions else ""
            if reply.lower() != "ok" and word:
                now = wall_clock()
                self._inbox.append(Sample("said", now, now, (), f"Tello answers {word}: {reply}"))
            elif word == self._asked:
                self._asked = ""
        self._replies.clear()
        if self._asked == "land" and wall_clock() - self._asked_at > 1e9 * PATIENCE:
            self._question("land")

    def _silent(self) -> bool:
        return wall_clock() - self._heard > 1e9 * SILENCE

    def _say(self, text: str) -> None:
        if not self._open:
            raise LinkError("tello: the link is closed")
        try:
            self._talk.sendto(text.encode("ascii"), self._drone)
        except OSError as error:
            raise LinkError(f"tello: cannot send to {self._drone[0]}: {error.strerror}; join its network") from error

    def _ask(self, text: str) -> bool:
        """Repeats a command until there is an answer; whether that is `ok`."""
        for _ in range(TRIES):
            self._replies.clear()
            self._say(text)
            deadline = time.monotonic() + PATIENCE
            while not self._replies and time.monotonic() < deadline:
                ready, _, _ = select.select((self._talk,), (), (), deadline - time.monotonic())
                for one in ready:
                    self._take(one)
            if self._replies:
                return self._replies[0].lower() == "ok"
        return False

    def _take(self, one: socket.socket) -> None:
        """Reads one packet."""
        try:
            packet, sender = one.recvfrom(2048)
        except OSError:  # an earlier packet was not accepted: silence will show whether the link is lost
            return
        if sender[0] != self._drone[0]:
            return
        text = packet.decode("ascii", errors="replace").strip()
        if one is self._talk:
            self._replies.append(text)
        elif state := state_from_text(text):
            self._heard = wall_clock()
            self._inbox += samples(self._of_one_pad(state), self._poses, self._heard)

    def _of_one_pad(self, state: Mapping[str, float]) -> Mapping[str, float]:
        """A state as without a pad where it is not the first pad: positions are relative to the pad that is seen."""
        pad = state.get("mid", -1.0)
        new = pad > 0 and pad not in self._pads
        self._pads += [pad] if new else []
        if pad <= 0 or pad == self._pads[0]:
            return state
        if new:
            text = f"mission pad {pad:.0f} is below, not {self._pads[0]:.0f}: positions over it are left out"
            self._inbox.append(Sample("said", self._heard, self._heard, (), text))
        return {**state, "mid": -1.0}

    def _close(self) -> None:
        self._open = False
        self._talk.close()
        self._state.close()


def _address(host: str) -> str:
    """The address of a host, as its packets carry it.

    Raises:
        LinkError: There is no such host.
    """
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise LinkError(f"tello: no host {host} ({error}); join its network") from error


def tello_commands(card: Card) -> CommandFields:
    """The sticks of a card's axes.

    Raises:
        LinkError: The card names a field other than `rc:a` to `rc:d`.
    """
    fields = command_fields(card)
    if fields.table != "rc" or not {channel.source for channel in fields.channels.values()} <= set(STICKS):
        raise LinkError(f"card {card.name}: its commands are not the sticks rc:a to rc:d of a Tello; use --card tello")
    return fields


def sticks_of(fields: CommandFields, command: Sequence[float]) -> dict[str, int]:
    """The sticks a to d for forward, left, up, counter-clockwise in the unit of the card: whole numbers in -100..100.

    Raises:
        LinkError: The command exceeds full stick.
    """
    raw = raw_values(fields, command)
    sticks = {stick: round(raw.get(stick, 0.0)) for stick in STICKS}
    most = max(map(abs, sticks.values()))
    if most > FULL_STICK:
        raise LinkError(f"tello: a command of {most} % is beyond full stick; plan smaller amplitudes")
    return sticks


def as_commanded(fields: CommandFields, sticks: Mapping[str, int]) -> tuple[float, ...]:
    """Forward, left, up, counter-clockwise in the unit of the card that the sticks say."""
    channels = (fields.channels.get(axis) for axis in AXES)
    return tuple(channel.in_si(float(sticks[str(channel.source)])) if channel else 0.0 for channel in channels)


def state_from_text(text: str) -> dict[str, float]:
    """Fields of a state packet, `mpry` as `mpry[0]` to `mpry[2]`; fields that are not numbers are left out.

    Returns:
        Name to value; empty if the text is not a state packet.
    """
    state: dict[str, float] = {}
    for part in text.split(";"):
        name, colon, value = part.strip().partition(":")
        numbers = [_number(one) for one in value.split(",")] if colon else []
        if len(numbers) == 1:
            state[name] = numbers[0]
        else:
            state |= {f"{name}[{place}]": number for place, number in enumerate(numbers)}
    state = {name: value for name, value in state.items() if math.isfinite(value)}
    return state if "bat" in state else {}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def samples(state: Mapping[str, float], poses: PoseFields, received: int) -> list[Sample]:
    """Battery, and the pose while a mission pad is seen. A Tello sends no stamps: the stamp is the time of arrival."""
    found = [Sample("battery", received, received, (state["bat"] / 100,))]
    if state.get("mid", -1.0) > 0:
        pose = pose_values(poses, lambda name: state.get(name, math.nan))
        if pose is not None:
            found.append(Sample("pose", received, received, pose))
    return found
