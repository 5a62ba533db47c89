"""MAVLink, listening: an autopilot's poses, and the velocities that somebody else commands. Nothing is commanded here.

The link sends only what it needs to receive anything: a heartbeat once a second, TIMESYNC (for the autopilot's clock),
and MAV_CMD_SET_MESSAGE_INTERVAL for attitude, position, the target that the autopilot follows, and whether it flies.

Commands come from two sources. SET_POSITION_TARGET_LOCAL_NED of another system, if a router forwards it to us, is what
was sent. Until one has arrived, POSITION_TARGET_LOCAL_NED counts: the autopilot's own report of its target, which PX4
has already smoothed and limited.

Source: MAVLink common message set, mavlink.io/en/messages/common.html.
"""

import math
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flying.links.card_fields import CommandFields, command_values
from rotorfit.flying.links.card_window import Obedience, obedience
from rotorfit.flying.links.link import Action, wall_clock
from rotorfit.flying.links.mavlink import SILENCE, MavlinkLink, connect
from rotorfit.flying.links.mavlink_messages import ARMED, FIELDS, IN_AIR, SETPOINT, STREAMS, mavlink_commands

ECHO = "POSITION_TARGET_LOCAL_NED"

WORLD, TURNED = (1, 7), (8, 9, 12)
"""MAV_FRAMEs whose velocities are along north, east, down (LOCAL_NED, LOCAL_OFFSET_NED), and along the heading
(BODY_NED, BODY_OFFSET_NED, BODY_FRD)."""

NO_POSITION, NO_VELOCITY, NO_YAW_RATE = (0b1, 0b10, 0b100), 0b11_1000, 0b1000_0000_0000
"""Bits of the type mask: ignore x, y, z; ignore the velocities; ignore the yaw rate."""


def open_listener(address: str, card: Card) -> "MavlinkListener":
    """Waits for an autopilot that somebody else flies.

    Args:
        address: As for the link `mavlink`.
        card: What the velocities mean; the built-in one is `mavlink`.

    Raises:
        LinkError: As for the link `mavlink`.
        ModuleNotFoundError: No pymavlink.
    """
    stream = bool(address) and not address.startswith("udp")
    link = MavlinkListener(connect(address), mavlink_commands(card), stream, obedience(card))
    link.greet(address)
    return link


class MavlinkListener(MavlinkLink):
    """A vehicle with an autopilot that somebody else flies; implements `links.Link`, and takes no commands."""

    _streams = STREAMS | {ECHO: (85, 50.0)}

    def __init__(
        self, connection: Any, heard: CommandFields, stream: bool = False, window: Obedience | None = None
    ) -> None:
        super().__init__(connection, None)
        self._fields, self._stream = heard, stream
        self._heading: float | None = None
        self._window = window or Obedience({})
        self._forwarded, self._landed = False, 0
        self._by_velocity = True  # whether the last setpoint, forwarded or echoed, commands velocities alone
        self._inbox += self._window.begun(wall_clock())

    def act(self, action: Action) -> None:
        """Closes; anything else is refused."""
        if action != "close":
            raise LinkError(f"mavlink: a listener does not {action.replace('_', ' ')}")
        super().act(action)

    def receive(self, until: int) -> list[Sample]:
        """What has arrived since the last call; see `links.Link`.

        Raises:
            LinkError: The connection broke. That cannot happen over UDP: a silent vehicle may come back.
        """
        samples = super().receive(until)
        if self._stream and self._known_since and wall_clock() - self._heard > SILENCE:
            raise LinkError(f"mavlink: no heartbeat for {SILENCE / 1e9:g} s; the link is lost")
        return samples

    @property
    def _known_since(self) -> int:
        return self._heard if self._autopilot else 0

    def _take(self, message: Any, received: int) -> None:
        """Takes one message, of the autopilot or of whoever commands it."""
        kind, silent_since = message.get_type(), self._known_since
        super()._take(message, received)
        if kind == "HEARTBEAT" and silent_since and self._heard == received and received - silent_since > SILENCE:
            self._missing, self._requested_times = dict(self._streams), 0
            self._request()  # it may have been started anew
        if kind in ("HEARTBEAT", "EXTENDED_SYS_STATE") and self._is_target(message):
            self._landed = getattr(message, "landed_state", self._landed)
            self._tell_obedience(received)
        if kind in self._window.conditions and self._is_target(message):
            self._inbox += self._window.heard(kind, lambda name: _field(message, name), received)
        if kind in ("ATTITUDE_QUATERNION", "ATTITUDE") and self._is_target(message):
            self._heading = _heading(message)
        elif kind == SETPOINT and self._autopilot and message.target_system in (0, self._target[0]):
            self._forwarded, self._by_velocity = True, _is_velocity(message)
            self._tell_obedience(received)
            if self._by_velocity:
                self._inbox += self._command_heard(message, received, received)
        elif kind == ECHO and not self._forwarded and self._is_target(message):
            self._by_velocity = _is_velocity(message)
            self._tell_obedience(received)
            stamp = self._poses.clock.ours(message.time_boot_ms * 1_000_000, received)
            if self._by_velocity:
                self._inbox += self._command_heard(message, stamp, received)

    def _tell_obedience(self, received: int) -> None:
        """Updates whether the vehicle obeys the received velocities: in the air, in the mode for external commands.

        It does not where a position is commanded as well: then velocities are no more than a help to reach it.
        """
        theirs = self._in_our_mode or not self._forwarded
        obeys = self._landed in (0, IN_AIR) and theirs and self._by_velocity
        self._inbox += self._window.reported(obeys, received)

    def _is_target(self, message: Any) -> bool:
        return self._autopilot is not None and (message.get_srcSystem(), message.get_srcComponent()) == self._target

    def _command_heard(self, message: Any, stamp: int, received: int) -> list[Sample]:
        """The command in a setpoint; none if it has no velocity, or one in the world before the heading is known."""
        if message.type_mask & NO_VELOCITY == NO_VELOCITY:
            return []
        vx, vy, rate = message.vx, message.vy, 0.0 if message.type_mask & NO_YAW_RATE else message.yaw_rate
        if message.coordinate_frame in WORLD:
            if self._heading is None:
                return []
            c, s = math.cos(self._heading), math.sin(self._heading)
            vx, vy = c * vx + s * vy, c * vy - s * vx
        elif message.coordinate_frame not in TURNED:
            return []
        raw = dict(zip(FIELDS, (vx, vy, message.vz, 0.0 if math.isnan(rate) else rate), strict=True))
        values = command_values(self._fields, raw.__getitem__)
        return [] if values is None else [Sample("command", stamp, received, values)]


def _is_velocity(message: Any) -> bool:
    """Whether a setpoint commands all velocities, and no position; NaN counts as ignored, as for the autopilots."""
    places = zip(NO_POSITION, (message.x, message.y, message.z), strict=True)
    placed = any(not message.type_mask & bit and not math.isnan(value) for bit, value in places)
    moved = all(map(math.isfinite, (message.vx, message.vy, message.vz))) and not message.type_mask & NO_VELOCITY
    return moved and not placed and message.coordinate_frame in (*WORLD, *TURNED)


def _field(message: Any, name: str) -> float:
    """A field for the card's window, NaN where there is none; `armed` of a heartbeat is a bit of its base mode."""
    if name == "armed" and message.get_type() == "HEARTBEAT":
        return float(bool(message.base_mode & ARMED))
    try:
        return float(getattr(message, name, math.nan))
    except (TypeError, ValueError):  # a text, or several numbers
        return math.nan


def _heading(message: Any) -> float:
    """From north, clockwise seen from above [rad]."""
    if message.get_type() == "ATTITUDE":
        return float(message.yaw)
    w, x, y, z = message.q1, message.q2, message.q3, message.q4
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
