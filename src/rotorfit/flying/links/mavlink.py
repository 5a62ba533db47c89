"""MAVLink: body velocities to PX4 in OFFBOARD or ArduPilot Copter in GUIDED; local position and attitude back.

Needs pymavlink (LGPL): pip install 'rotorfit[mavlink]'. The address is pymavlink's: `udpin:0.0.0.0:14540` (default),
`tcp:HOST:PORT`, `/dev/ttyUSB0,57600`.

Source: PX4 user guide, "Offboard Mode": setpoints for a second before the mode is entered, and at 2 Hz or more in it.
ArduPilot developer guide, "Copter Commands in Guided Mode": velocities hold for 3 s.
"""

import errno
import fcntl
import importlib
import os
import re
import select
import socket
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flying.links.card_fields import CommandFields
from rotorfit.flying.links.link import Action, Silence, seconds_until, wall_clock
from rotorfit.flying.links.mavlink_messages import (
    ACCEPTED,
    ARMED,
    AUTOPILOTS,
    FLOWN,
    IN_AIR,
    IN_PROGRESS,
    MESSAGE_INTERVAL,
    ON_GROUND,
    PX4_LOITER,
    RESULTS,
    STEP_NAMES,
    STREAMS,
    TEMPORARILY_REJECTED,
    AutopilotProtocol,
    Poses,
    SpokenTexts,
    battery,
    command_parameters,
    mavlink_commands,
    mode_of,
    setpoint,
)

DEFAULT_ADDRESS = "udpin:0.0.0.0:14540"

ADDRESS = (
    r"(?:(?:udp|udpin|udpout|udpbcast|tcp|tcpin):)?[^:/,]+:\d+|/[^:,]+(?:,\d+)?|(?:uds|unix|mcast|wss?|wsserver):.+"
)
"""Forms of an address that pymavlink takes for what was meant; it tries a file's name or a host where it is another."""

SYSTEM, COMPONENT = 245, 191  # MAV_COMP_ID_ONBOARD_COMPUTER

SECOND = 1_000_000_000

PATIENCE, SILENCE = 10 * SECOND, 3 * SECOND
"""How long the first heartbeat may take, and how long later ones (1 Hz) may be missing [ns]."""

STREAMED, STREAM_PERIOD = int(1.2 * SECOND), SECOND // 20
"""How long setpoints are sent before the mode is requested, and the period of those that are not obeyed yet [ns]."""

TRIES, REQUESTS_OF_MESSAGES = 5, 15
"""How often a step is asked for, and the messages that have not come [tries]."""

SYNC_PERIOD = SECOND // 5
"""Time between two requests for the autopilot's clock [ns]."""

EXPLAINING = SECOND // 2
"""How long to wait for the reason after the autopilot has refused a step [ns]."""

TEXTS = 5
"""Number of its last texts that explain a refusal."""

BLOCKED = 0.4
"""How long a serial line or TCP may take nothing [s]."""

WAITING = 256
"""Number of bytes that may wait in a TCP connection: four commands, as many as the kernel lets wait for a serial
line."""

UNANSWERED = 5
"""Number of requests for the clock without any answer after which that is told; within the preflight."""

BEHIND, REQUESTS = SECOND // 2, 50
"""Time that a request for the clock and its answer may take in flight [ns], and how many requests are remembered."""

_ATTITUDES = ("ATTITUDE_QUATERNION", "ATTITUDE", "LOCAL_POSITION_NED", "ODOMETRY")


def open_link(address: str, card: Card) -> "MavlinkLink":
    """Waits for an autopilot.

    Args:
        address: See `ADDRESS`; empty for `udpin:0.0.0.0:14540`, where PX4 looks for companion computers.
        card: What the velocities mean; the built-in one is `mavlink`.

    Raises:
        LinkError: No such port, no heartbeat, neither PX4 nor ArduPilot, no multirotor, or a card that does not fit.
        ModuleNotFoundError: No pymavlink.
    """
    link = MavlinkLink(connect(address), mavlink_commands(card))
    link.greet(address)
    return link


def open_poses(address: str) -> "MavlinkLink":
    """Listens to an autopilot's position, for a vehicle that another link commands.

    Raises:
        LinkError: As `open_link`.
        ModuleNotFoundError: No pymavlink.
    """
    link = MavlinkLink(connect(address), None)
    link.greet(address)
    return link


class MavlinkLink:
    """A vehicle with an autopilot that speaks MAVLink; implements `links.Link`. Runs in the caller's thread."""

    _streams: Mapping[str, tuple[int, float]] = STREAMS

    def __init__(self, connection: Any, commands: CommandFields | None) -> None:
        self.live = True
        self._connection = connection
        self._commands = commands
        self._poses = Poses()
        self._inbox: list[Sample] = []
        self._start = wall_clock()
        self._autopilot: AutopilotProtocol | None = None
        self._stranger = ""  # who else sends heartbeats
        self._others: set[tuple[int, int]] = set()  # other vehicles that were told
        self._target = (0, 0)
        self._texts, self._spoken = SpokenTexts(), deque[tuple[int, str]](maxlen=TEXTS)
        self._refused: tuple[int, str] | None = None  # when, and what
        self._declined, self._untold = "", False  # the same with the reason, and whether it is still to be raised
        self._goes_on: float | None = None  # as the autopilot is set
        self._heard = self._beaten = self._synced = 0
        self._missing = dict(self._streams)  # messages that have not come yet
        self._requested = self._requested_times = 0  # when they were last asked for, and how often
        self._requests = deque[int](maxlen=REQUESTS)  # for the autopilot's clock, when they were made
        self._slow_told = False  # whether it was told that attitudes are slow
        self._answers = False  # whether a request for the clock was answered, or it was told that none is
        self._echoed = self._trip = 0  # when the last answer came, and how long it took [ns]
        self._steps: deque[str] = deque()  # what we ask for, in order; the first is waiting for its answer
        self._asked, self._tries, self._said = 0, 0, "no answer"
        self._first_setpoint = self._last_setpoint = 0
        self._sending = False
        self._engaged = self._climbing = self._landing = self._in_our_mode = False
        self._ours = False  # it has flown under our commands, or taken off by them
        self._on_ground = False
        self._engagements = 0
        self._trouble = ""
        self._open = True

    @property
    def now(self) -> int:
        """The wall clock [ns]."""
        return wall_clock()

    @property
    def fail_safe(self) -> str:
        """What this autopilot does when commands stop."""
        return self._autopilot.fail_safe if self._autopilot else ""

    @property
    def silence(self) -> Silence:
        """How long it keeps executing the last command before that: by its parameter, or else by default."""
        known = self._autopilot
        return Silence(self._goes_on or known.goes_on, known.parameter) if known else Silence()

    @property
    def undone(self) -> str:
        """What the vehicle was asked to do and does not; see `links.Link`."""
        known = self._known
        if self._declined:
            return self._declined
        if self._refused:
            return self._refused[1]
        if self._steps:
            return f"{known.name} has not answered the request to {self._step_name(self._steps[0])}"
        if self._landing or self._engaged:
            return ""
        if self._climbing:
            return f"{known.name} does not say that its take-off is over"
        return f"{known.name} {'says that it is on the ground' if self._on_ground else f'is not in {known.mode_name}'}"

    def greet(self, address: str = "") -> None:
        """Waits for a heartbeat, then requests the messages that are needed.

        Args:
            address: Where it listens, as for `open_link`.

        Raises:
            LinkError: No heartbeat came, or only of what is neither PX4 nor ArduPilot, or no multirotor.
        """
        begun = wall_clock()
        try:
            while self._autopilot is None and wall_clock() - begun < (SILENCE if self._stranger else PATIENCE):
                self.receive(wall_clock() + SECOND // 10)
        except LinkError:
            self._close()
            raise
        if self._autopilot is None:
            self._close()
            silent = f"mavlink: no heartbeat on {address or DEFAULT_ADDRESS}"
            raise LinkError(self._stranger or f"{silent}; check address, baud rate and the port's mode")
        self._request()

    def _request(self) -> None:
        """Requests what has not come yet."""
        self._requested, self._requested_times = wall_clock(), self._requested_times + 1
        if self._commands is not None and self._goes_on is None:
            self._say("param_request_read", *self._target, self._known.parameter.encode(), -1)
        for message, rate in self._missing.values():
            self._command(MESSAGE_INTERVAL, (message, 1e6 / rate, 0.0, 0.0, 0.0, 0.0, 0.0))

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Sends a velocity; see `links.Link`. The first one in the air also requests the flight mode."""
        self._check()
        if self._commands is None:
            raise LinkError("mavlink: the link was opened for poses only")
        moves = any(command)
        if not moves and self._silent:
            self._set(self._commands, command)
        self._check_heard()
        self._tell_refusal()
        if self._declined and moves:
            raise LinkError(self._declined)
        if self._landing or (self._climbing and self._known.name == "ArduPilot"):
            if moves:
                raise LinkError(f"mavlink: not sent: {self.undone or 'the vehicle lands'}")
            return command  # ArduPilot would take it for the end of the take-off, and both for the end of a landing
        if not self._sending:  # answers to earlier requests may have waited for us
            self._sending, self._trip, self._echoed = True, 0, wall_clock() if self._echoed else 0
            self._requests.clear()
        self._check_way()
        self._set(self._commands, command)
        if not self._engaged and (not self._known.streams or wall_clock() - self._first_setpoint > STREAMED):
            self._engage(wall_clock())
        return command

    def _set(self, commands: CommandFields, command: Sequence[float]) -> None:
        self._last_setpoint = wall_clock()
        self._first_setpoint = self._first_setpoint or self._last_setpoint
        boot = (self._last_setpoint - self._start) // 1_000_000
        self._say("set_position_target_local_ned", *setpoint(commands, command, boot, self._target))

    def receive(self, until: int) -> list[Sample]:
        """What has come since the last call; see `links.Link`."""
        while self._open:
            self._keep_alive()
            ready, _, _ = select.select((self._connection.fd,), (), (), min(seconds_until(until), 0.2))
            if not (ready and self._heard_all()) and seconds_until(until) <= 0:
                break
        self._tell_refusal()
        arrived, self._inbox = self._inbox, []
        return arrived

    def act(self, action: Action) -> None:
        """Arms and takes off, lands, or closes; see `links.Link`."""
        if action == "close":
            self._close()
            return
        self._check()
        self._steps.clear()
        if action == "take_off":
            self._check_heard()
            self._climbing, self._landing, self._engaged = True, False, False
            self._ask(*self._known.steps)
        elif self._ours:
            self._landing = True
            self._ask("land")
        else:
            raise LinkError("mavlink: the vehicle has not flown under our commands")

    @property
    def _known(self) -> AutopilotProtocol:
        """The autopilot, after `greet`."""
        if self._autopilot is None:
            raise LinkError("mavlink: no heartbeat yet")
        return self._autopilot

    def _check(self) -> None:
        if not self._open:
            raise LinkError("mavlink: the link is closed")
        if self._trouble:
            raise LinkError(self._trouble)

    @property
    def _silent(self) -> bool:
        return wall_clock() - self._heard > SILENCE

    def _check_heard(self) -> None:
        if self._silent:
            raise LinkError(f"mavlink: no heartbeat for {SILENCE / SECOND:g} s; the link is lost")

    def _tell_refusal(self) -> None:
        """Raises once if the autopilot has refused a step; the hover that follows must be sent."""
        if self._untold:
            self._untold = False
            raise LinkError(self._declined)

    def _check_way(self) -> None:
        """Raises if commands arrive late or not at all, as requests for the clock do, which go the same way.

        It does so once, because the hover that follows must be sent.
        """
        echoed, trip = self._echoed, self._trip
        silent = echoed and wall_clock() - echoed > SILENCE
        if not silent and trip <= BEHIND:
            return
        self._echoed = self._trip = 0
        if silent:
            raise LinkError(f"mavlink: no answer for {SILENCE / SECOND:g} s: what is sent does not reach the autopilot")
        raise LinkError(
            f"mavlink: an answer took {trip / SECOND:.1f} s: the link is slower than the plan; lower `rate` in the plan"
        )

    def _take(self, message: Any, received: int) -> None:
        """Takes one message of any sender; only the autopilot's count."""
        kind = message.get_type()
        source = (message.get_srcSystem(), message.get_srcComponent())
        if kind == "HEARTBEAT" and self._autopilot is None and message.autopilot != 8:  # 8: no autopilot, but a camera
            self._meet(message, source)
        if kind == "HEARTBEAT" and self._autopilot is not None:
            self._tell_others(message, source, received)
        if self._autopilot is None or source != self._target:
            return
        if self._requested_times > 1:  # before, it may come at another rate than that asked for
            self._missing.pop(kind, None)
        if kind == "HEARTBEAT":
            self._heard = received
            self._watch_mode(mode_of(self._known, message.custom_mode))
            if not message.base_mode & ARMED:
                self._end_if_flown("is disarmed")
        elif kind in _ATTITUDES:
            self._inbox += self._poses.take(message, received)
            self._tell_slow_attitude(received)
        elif kind in ("SYS_STATUS", "BATTERY_STATUS"):
            left = battery(message)
            self._inbox += [] if left is None else [Sample("battery", received, received, (left,))]
        elif kind == "COMMAND_ACK" and _is_ours(message):
            self._answered(message.command, message.result)
        elif kind == "EXTENDED_SYS_STATE":
            still, self._on_ground = self._on_ground, message.landed_state == ON_GROUND
            if self._on_ground and still:  # one alone may be a mistake of its landing detector
                self._end_if_flown("is on the ground")
            if self._known.name == "ArduPilot" and not self._steps and message.landed_state == IN_AIR:
                self._climbing = False
        elif kind == "TIMESYNC" and message.tc1 > 0 and message.ts1 in self._requests:
            self._answers, self._echoed, self._trip = True, received, received - message.ts1
            step = self._poses.clock.exchanged(message.ts1, message.tc1, received)
            if step:
                self._tell(
                    f"the autopilot's clock stepped by {step / 1e9:+.3f} s: poses before that are mistimed", received
                )
        elif kind == "PARAM_VALUE" and message.param_id == self._known.parameter and message.param_value > 0:
            self._goes_on = float(message.param_value)
        elif kind == "STATUSTEXT" and (text := self._texts.take(message)):
            self._spoken.append((received, text))
            self._tell(f"{self._known.name} says: {text}", received)

    def _tell(self, text: str, received: int) -> None:
        self._inbox.append(Sample("said", received, received, (), text))

    def _tell_others(self, heartbeat: Any, source: tuple[int, int], received: int) -> None:
        """Tells once of each other vehicle: the operator may look at that one."""
        flown = heartbeat.autopilot in AUTOPILOTS and heartbeat.type in FLOWN
        if flown and source != self._target and source not in self._others:
            self._others.add(source)
            self._tell(
                f"two vehicles are heard: this is system {self._target[0]}, the first that was heard, not system "
                f"{source[0]}; give each a port of its own",
                received,
            )

    def _tell_slow_attitude(self, received: int) -> None:
        """Tells once that there are fewer poses than positions."""
        if self._poses.turns_slowly and not self._slow_told:
            self._slow_told, rates = True, self._poses.rates
            self._tell(
                f"attitudes come {rates['attitude']:.0f} times a second, positions {rates['position']:.0f} times: "
                "there is one pose for each attitude; ask the autopilot for more (ArduPilot: SRx_EXTRA1)",
                received,
            )

    def _meet(self, heartbeat: Any, source: tuple[int, int]) -> None:
        """Takes a sender for the vehicle, if it can be flown: an antenna tracker on the same line has an autopilot."""
        if heartbeat.autopilot not in AUTOPILOTS:
            self._stranger = f"mavlink: autopilot {heartbeat.autopilot} (MAV_AUTOPILOT) is neither PX4 nor ArduPilot"
        elif heartbeat.type not in FLOWN:
            self._stranger = (
                f"mavlink: system {source[0]} is a vehicle of MAV_TYPE {heartbeat.type}, no multirotor or helicopter; "
                "check the address and the type of airframe that the autopilot is set to"
            )
        else:
            self._autopilot, self._target = AUTOPILOTS[heartbeat.autopilot], source

    def _watch_mode(self, mode: tuple[int, ...]) -> None:
        """Follows the flight mode; if a pilot or a fail-safe takes the vehicle out of ours, it is not taken back."""
        if self._climbing and self._known.name == "PX4" and mode == PX4_LOITER and not self._steps:
            self._climbing = False
        ours = self._in_our_mode = mode[:1] == self._known.mode[:1]
        if self._engaged and not ours and not self._landing:
            self._trouble = (
                f"mavlink: the vehicle left {self._known.mode_name} by itself or by its pilot; not taken back"
            )
        self._engaged = self._engaged or (ours and self._sending)
        self._ours = self._ours or self._engaged

    def _end_if_flown(self, state: str) -> None:
        """Ends our commands where a vehicle under them says that it cannot fly them: armed again, it would obey."""
        if self._engaged and not self._climbing and not self._landing:
            self._trouble = self._trouble or (
                f"mavlink: {self._known.name} says that the vehicle {state}; it is sent no more commands"
            )

    def _ask(self, *steps: str) -> None:
        self._declined, self._untold, self._refused = "", False, None
        self._steps.extend(steps)
        self._begin()

    def _engage(self, now: int) -> None:
        """Requests the flight mode once the vehicle is in the air, once a second, for a limited time."""
        if self._climbing or self._on_ground or self._in_our_mode or self._steps or now - self._asked < SECOND:
            return
        if self._refused or self._declined:
            return
        self._engagements += 1
        if self._engagements > TRIES:
            self._trouble = f"mavlink: {self._known.name} accepts {self._known.mode_name} but does not enter it"
        else:
            self._ask("mode")

    def _begin(self) -> None:
        """Sends the first step for the first time."""
        self._tries, self._said = 0, "no answer"
        self._repeat()

    def _repeat(self) -> None:
        """Sends the first step, or repeats it."""
        self._asked, self._tries = wall_clock(), self._tries + 1
        self._ours = self._ours or self._steps[0] == "take_off"  # it may climb although its answer is lost
        self._command(*command_parameters(self._steps[0], self._known))

    def _command(self, command: int, parameters: Sequence[float]) -> None:
        self._say("command_long", *self._target, command, max(self._tries - 1, 0), *parameters)

    def _say(self, message: str, *values: Any) -> None:
        try:
            getattr(self._connection.mav, f"{message}_send")(*values)
        except OSError as error:
            raise LinkError(f"mavlink: cannot send ({error}); the link is lost") from error

    def _heard_all(self) -> bool:
        """Takes every waiting message; whether there was one.

        Raises:
            LinkError: The connection broke, or the other end closed it.
        """
        took = False
        port = getattr(self._connection, "port", None)
        if isinstance(port, socket.socket) and port.type == socket.SOCK_STREAM and _is_over(port):
            raise LinkError("mavlink: the other end closed the connection")
        try:
            while (message := self._connection.recv_msg()) is not None:
                self._take(message, wall_clock())
                took = True
        except OSError as error:
            raise LinkError(f"mavlink: cannot receive ({error}); the link is lost") from error
        return took

    def _answered(self, command: int, result: int) -> None:
        if not self._steps or command_parameters(self._steps[0], self._known)[0] != command:
            return
        self._said = RESULTS[result] if result < len(RESULTS) else f"result {result}"
        if result == ACCEPTED:
            self._steps.popleft()
            if self._steps:
                self._begin()
        elif result == IN_PROGRESS:
            self._asked = wall_clock()  # asked again only when no more is heard of it
        elif result != TEMPORARILY_REJECTED:
            self._give_up(self._said)

    def _give_up(self, why: str) -> None:
        step = self._step_name(self._steps.popleft())
        self._steps.clear()
        self._refused = wall_clock(), f"mavlink: {self._known.name} did not {step}: {why}"

    def _step_name(self, step: str) -> str:
        return STEP_NAMES.get(step, f"enter {self._known.mode_name}")

    def _explained(self, refused: int, text: str) -> str:
        """A refusal, with the autopilot's own texts if there are any."""
        words = dict.fromkeys(text for at, text in self._spoken if at > refused - PATIENCE)
        return f"{text}; it says: {'; '.join(words)}" if words else f"{text}; its own messages say why (ground station)"

    def _keep_alive(self) -> None:
        """Sends our heartbeat and requests of the clock, and repeats a step that was not accepted yet."""
        now = wall_clock()
        if self._autopilot is not None and now - self._beaten >= SECOND:
            self._beaten = now
            self._say("heartbeat", 18, 8, 0, 0, 4)  # onboard controller, no autopilot, active
        if self._autopilot is not None and now - self._synced >= SYNC_PERIOD:
            self._synced = now
            self._requests.append(now)
            self._tell_clock(now)
            self._say("timesync", 0, now)
        wanted = self._missing or (self._commands is not None and self._goes_on is None)
        overdue = self._requested and wanted and now - self._requested >= 2 * SECOND
        if overdue and self._requested_times < REQUESTS_OF_MESSAGES:
            self._request()
        if self._refused is not None and now - self._refused[0] >= EXPLAINING:
            self._declined, self._untold, self._refused = self._explained(*self._refused), True, None
        # PX4 enters its mode only when setpoints have come for a second; in any other mode it does not obey them
        idle = self._heard and self._known.streams and not self._sending and not self._in_our_mode
        if idle and self._commands is not None and now - self._last_setpoint >= STREAM_PERIOD:
            self._set(self._commands, (0.0, 0.0, 0.0, 0.0))
        if self._steps and now - self._asked >= SECOND:
            if self._tries < TRIES:
                self._repeat()
            else:
                self._give_up(self._said)

    def _tell_clock(self, now: int) -> None:
        """Tells once that nothing relates the autopilot's clock to ours but the arrival of its messages."""
        if not self._answers and len(self._requests) >= UNANSWERED:
            self._answers = True
            self._tell(
                f"{self._known.name} does not answer TIMESYNC: its poses are timed by the least delayed arrival, and "
                "the delay that is fitted holds their way, which nothing tells",
                now,
            )

    def _close(self) -> None:
        if self._open:
            self._open = False
            self._connection.close()


def _is_ours(answer: Any) -> bool:
    """Whether an answer is for us, or for nobody in particular: a router forwards those for a ground station, too."""
    wanted, part = getattr(answer, "target_system", 0), getattr(answer, "target_component", 0)  # not in MAVLink 1
    return wanted in (0, SYSTEM) and part in (0, COMPONENT)


def _refuse_if_taken(address: str) -> None:
    """Refuses a UDP port that another program listens on: pymavlink would share it, and each would get a part.

    Raises:
        LinkError: Another program listens on it.
        OSError: There is no such host.
        ValueError: The address has no port.
    """
    kind, _, place = address.partition(":")
    if kind not in ("udp", "udpin"):
        return
    host, _, port = place.rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as alone:
        try:
            alone.bind((host, int(port)))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise LinkError(
                f"mavlink: {address} is in use by another program, maybe another flight; end it, or take another port"
            ) from error


def _is_over(stream: socket.socket) -> bool:
    """Whether the other end of a stream has closed it; pymavlink would print that, again and again.

    Raises:
        LinkError: The stream broke.
    """
    try:
        return stream.recv(1, socket.MSG_PEEK) == b""
    except BlockingIOError:
        return False
    except OSError as error:
        raise LinkError(f"mavlink: cannot receive ({error}); the link is lost") from error


class _Outlet:
    """Writes to a serial line or TCP, in the place of pymavlink, which waits without end or drops what is not taken.

    It waits until the line has room: in a long queue commands, and the hover that ends a flight, would grow old.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._patience = descriptor, BLOCKED

    def write(self, message: bytes) -> None:
        """Writes a message.

        Raises:
            OSError: The line is gone, or takes nothing; then the next message does not wait.
        """
        left = memoryview(message)
        while left:
            if not select.select((), (self._descriptor,), (), self._patience)[1]:
                self._patience = 0.0
                raise TimeoutError(f"it takes nothing for {BLOCKED:g} s")
            left = left[os.write(self._descriptor, left) :]
        self._patience = BLOCKED


def _unsaid(*_: object) -> None:
    """Takes what pymavlink would print among our lines of JSON; our errors say that a port fails or falls silent."""


def connect(address: str) -> Any:
    """Opens a port.

    Raises:
        LinkError: It has no form that an address has, or cannot be opened.
    """
    if address and not re.fullmatch(ADDRESS, address):
        raise LinkError(
            f"mavlink: {address} is no address; give udpin:HOST:PORT to listen (udpin:0.0.0.0:14540), udpout:HOST:PORT "
            "or tcp:HOST:PORT to call, or a serial port with its baud rate (/dev/ttyUSB0,57600; 115200 without one)"
        )
    os.environ.setdefault("MAVLINK20", "1")  # read by pymavlink when it is imported
    mavutil = importlib.import_module("pymavlink.mavutil")
    vars(mavutil)["print"] = _unsaid
    try:
        _refuse_if_taken(address or DEFAULT_ADDRESS)
        connection = mavutil.mavlink_connection(
            address or DEFAULT_ADDRESS, source_system=SYSTEM, source_component=COMPONENT, autoreconnect=False
        )
        try:
            if address.startswith("/"):
                fcntl.flock(connection.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if address.startswith("tcp:"):
                connection.port.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, WAITING)
                connection.port.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING)  # the kernel takes its least
        except OSError:
            connection.close()
            raise
        if address.startswith(("/", "tcp:")):
            connection.write = _Outlet(connection.fd).write
        return connection
    except BlockingIOError as error:
        raise LinkError(f"mavlink: {address} is in use by another program; end it first") from error
    except (OSError, ValueError, OverflowError) as error:  # the last: a port beyond 65535
        raise LinkError(f"mavlink: cannot open {address or DEFAULT_ADDRESS}: {error}") from error
