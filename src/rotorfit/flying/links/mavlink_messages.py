"""The contents of MAVLink messages: setpoints, commands, poses and clocks. No socket, no pymavlink.

Source: MAVLink common message set, mavlink.io/en/messages/common.html (names and numbers); PX4 user guide, "Offboard
Mode"; ArduPilot developer guide, "Copter Commands in Guided Mode".
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import linear_regression, median
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Sample
from rotorfit.flying.links.card_fields import CommandFields, command_fields, enu_from_ned, raw_values

SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"

FIELDS = ("vx", "vy", "vz", "yaw_rate")

BODY_NED = 8
"""MAV_FRAME_BODY_NED: velocities forward, right, down; PX4 (1.13 and later) and ArduPilot turn them by the heading."""

VELOCITY_AND_YAW_RATE = 0b0101_1100_0111
"""Type mask that ignores position, acceleration and yaw."""

ARM, TAKE_OFF, LAND, SET_MODE, MESSAGE_INTERVAL = 400, 22, 21, 176, 511
"""MAV_CMD_COMPONENT_ARM_DISARM, _NAV_TAKEOFF, _NAV_LAND, _DO_SET_MODE, _SET_MESSAGE_INTERVAL."""

ACCEPTED, TEMPORARILY_REJECTED, IN_PROGRESS = 0, 1, 5

RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress")

STREAMS = {
    "LOCAL_POSITION_NED": (32, 50.0),
    "ATTITUDE_QUATERNION": (31, 50.0),
    "SYS_STATUS": (1, 4.0),
    "EXTENDED_SYS_STATE": (245, 2.0),
}
"""Message to its number and the rate asked for [Hz]."""

TAKE_OFF_HEIGHT = 1.5
"""Take-off height, which ArduPilot requires [m]."""

ATTITUDES_KEPT, POSITIONS_KEPT = 50, 50

RECENT, SLOWER = 11, 1.5
"""Number of messages whose intervals are the usual ones, and how many times longer those of attitudes are where they
are slower than positions."""

OVERTAKING = 200_000_000
"""How far messages may overtake each other [ns]; a stamp that lies further back is of a clock that went back."""


@dataclass(frozen=True)
class AutopilotProtocol:
    """How an autopilot is flown from outside.

    Attributes:
        name: Name for the user.
        mode: Its `custom_mode` under our commands, as `mode_of` reads it, and for MAV_CMD_DO_SET_MODE.
        mode_name: Name of the mode for the user.
        steps: Steps of a take-off, in order; names of `command_parameters`.
        streams: Whether setpoints must be sent before the mode is entered.
        fail_safe: What it does when commands stop.
        goes_on: How long it keeps executing the last command before that, by default [s].
        parameter: Parameter that sets this time.
    """

    name: str
    mode: tuple[int, ...]
    mode_name: str
    steps: tuple[str, ...]
    streams: bool
    fail_safe: str
    goes_on: float
    parameter: str


AUTOPILOTS = {
    12: AutopilotProtocol(
        "PX4",
        (6, 0),
        "OFFBOARD",
        ("arm", "take_off"),
        True,
        "PX4 leaves OFFBOARD when setpoints come at less than 2 Hz for COM_OF_LOSS_T (1 s by default), and does what "
        "COM_OBL_RC_ACT says (default: Position mode, which holds with a remote control). Set it to Land or Hold.",
        1.0,
        "COM_OF_LOSS_T",
    ),
    3: AutopilotProtocol(
        "ArduPilot",
        (4,),
        "GUIDED",
        ("mode", "arm", "take_off"),
        False,
        "ArduPilot Copter stops and hovers GUID_TIMEOUT (3 s by default) after the last velocity in GUIDED; it does "
        "not land by itself.",
        3.0,
        "GUID_TIMEOUT",
    ),
}
"""MAV_AUTOPILOT to how it is flown."""

PX4_LOITER = (4, 3)
"""Main mode AUTO, sub-mode LOITER: where PX4 goes when its take-off is complete."""

FLOWN = (2, 3, 4, 13, 14, 15, 29, 35, 43)
"""MAV_TYPEs that are flown: with four rotors, coaxial, helicopter, with six, eight, three, twelve, ten, any number.

Numbers of modes mean something else on other vehicles: GUIDED of ArduPilot Copter is ACRO of Plane.
"""

ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED of a heartbeat's base mode."""

ON_GROUND, IN_AIR = 1, 2
"""MAV_LANDED_STATE_ON_GROUND, _IN_AIR."""

STEP_NAMES = {"arm": "arm", "take_off": "take off", "land": "land"}
"""Step of `command_parameters` to words; the other one, `mode`, has the name of the mode."""


def mode_of(autopilot: AutopilotProtocol, custom_mode: int) -> tuple[int, ...]:
    """`custom_mode` of a heartbeat: for PX4 main mode and sub-mode, its third and fourth byte; else the number."""
    return (custom_mode >> 16 & 0xFF, custom_mode >> 24) if autopilot.name == "PX4" else (custom_mode,)


def mavlink_commands(card: Card) -> CommandFields:
    """The velocity fields of a card's commands.

    Raises:
        LinkError: The card names other messages or fields, or its commands are not velocities in SI units.
    """
    fields = command_fields(card)
    if fields.table != SETPOINT or not {channel.source for channel in fields.channels.values()} <= set(FIELDS):
        raise LinkError(f"card {card.name}: its commands are not velocities of {SETPOINT}; use --card mavlink")
    tilted = [axis for axis in AXES if axis in card.command and card.command[axis].meaning == "tilt"]
    if tilted:
        raise LinkError(f"card {card.name}: {tilted[0]} means tilt; over MAVLink commands are velocities")
    return fields


def setpoint(fields: CommandFields, command: Sequence[float], boot_ms: int, target: tuple[int, int]) -> tuple[Any, ...]:
    """Arguments of SET_POSITION_TARGET_LOCAL_NED for forward, left, up, counter-clockwise.

    Args:
        fields: Where the commands go.
        command: The command, in the unit of the card's commands.
        boot_ms: Our own time since start [ms].
        target: System and component of the autopilot.
    """
    raw = raw_values(fields, command)
    vx, vy, vz, rate = (raw.get(name, 0.0) for name in FIELDS)
    nothing = (0.0, 0.0, 0.0)
    return (boot_ms, *target, BODY_NED, VELOCITY_AND_YAW_RATE, *nothing, vx, vy, vz, *nothing, 0.0, rate)


def command_parameters(step: str, autopilot: AutopilotProtocol) -> tuple[int, tuple[float, ...]]:
    """MAV_CMD and its seven parameters for a step: `mode`, `arm`, `take_off` or `land`.

    Take-off on ArduPilot climbs to `TAKE_OFF_HEIGHT` above home; PX4 is given no height (NaN) and climbs to its own
    MIS_TAKEOFF_ALT, because it would read the number as one above the sea.
    """
    nan = math.nan
    if step == "mode":
        return SET_MODE, (1.0, *map(float, autopilot.mode), *(0.0,) * (6 - len(autopilot.mode)))
    if step == "arm":
        return ARM, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if step == "land":
        return LAND, (0.0, 0.0, 0.0, nan if autopilot.name == "PX4" else 0.0, 0.0, 0.0, 0.0)
    if autopilot.name == "PX4":
        return TAKE_OFF, (nan, nan, nan, nan, nan, nan, nan)
    return TAKE_OFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, TAKE_OFF_HEIGHT)


FASTEST_DRIFT = 0.5e-3
"""Largest drift of one clock against another [s/s]: twice that of a simulated autopilot."""

REMEMBERED, LIKE_THE_BEST = 30_000_000_000, 1_000_000
"""How long an exchange counts, and how much longer than the shortest its round trip may be [ns]."""

ENOUGH, LONG_ENOUGH = 5, 3_000_000_000
"""Least number of exchanges, and time between first and last [ns], for an estimate of the drift."""

STEP = 2_000_000
"""Difference of exchanges, beyond half their round trip and the drift, from which a clock has stepped [ns]."""


class SenderClock:
    """Converts the sender's stamps (time since its start) to our clock, and follows the drift between the two.

    A TIMESYNC exchange is accurate to half its round trip. The quick ones of the last half minute count: a straight
    line through them or, while they are few, the one with the smallest possible error now. One that contradicts them
    means that the clock has stepped, and estimation starts anew. Before the first exchange the least delayed message
    sets the offset, which is accurate to its delay.
    """

    def __init__(self) -> None:
        self._least: tuple[int, int] | None = None  # when it arrived, offset
        self._exchanges: deque[tuple[int, int, int]] = deque()  # middle by our clock, round trip, offset

    def ours(self, theirs: int, received: int) -> int:
        """A stamp of the sender on our clock [ns], never later than its arrival."""
        if self._exchanges:
            return min(theirs + self._offset(received), received)
        offset = received - theirs
        if self._least is not None:
            since, before = self._least
            offset = min(offset, before + round(FASTEST_DRIFT * (received - since)))
        self._least = received, offset
        return theirs + offset

    @property
    def error(self) -> float:
        """Half the 95 % interval of the offset [s]: the shortest round trip may be all in one way; 0 if unknown."""
        return 0.5e-9 * min((trip for _, trip, _ in self._exchanges), default=0)

    def exchanged(self, sent: int, theirs: int, received: int) -> int:
        """Takes an answer to TIMESYNC.

        Args:
            sent: When we asked, by our clock [ns].
            theirs: What the sender's clock showed [ns].
            received: When the answer arrived, by our clock [ns].

        Returns:
            By how much the sender's clock has stepped since the exchange before [ns]; 0 if it has not.
        """
        trip, middle = received - sent, (sent + received) // 2
        if trip < 0:
            return 0
        offset, step = middle - theirs, 0
        if self._exchanges:
            last = self._exchanges[-1]
            expected, drifted = self._offset(middle), round(FASTEST_DRIFT * (middle - last[0]))
            sure = min(one[1] for one in self._exchanges) // 2
            if abs(offset - expected) > trip // 2 + sure + drifted + STEP:
                step = expected - offset
                self._exchanges.clear()
        self._exchanges.append((middle, trip, offset))
        while middle - self._exchanges[0][0] > REMEMBERED:
            self._exchanges.popleft()
        return step

    def _offset(self, now: int) -> int:
        """The offset to add to the sender's stamps at a time [ns]."""
        best = min(trip for _, trip, _ in self._exchanges)
        quick = [one for one in self._exchanges if one[1] <= best + LIKE_THE_BEST]
        if len(quick) < ENOUGH or quick[-1][0] - quick[0][0] < LONG_ENOUGH:
            return min(self._exchanges, key=lambda one: one[1] / 2 + FASTEST_DRIFT * (now - one[0]))[2]
        start, _, base = quick[0]
        slope, rest = linear_regression([at - start for at, _, _ in quick], [offset - base for *_, offset in quick])
        return base + round(rest + max(-FASTEST_DRIFT, min(FASTEST_DRIFT, slope)) * (now - start))


class Poses:
    """Combines positions and attitudes of one sender into poses; the attitude is interpolated to the position's time.

    A position waits for the next attitude: with the last one instead, the yaw would lag by half its period. Where
    attitudes are slower, there is one pose for each, and the position is interpolated: attitudes interpolated to every
    position would be measurements that nobody made, of a turn that straight lines between few points make smaller.
    """

    def __init__(self) -> None:
        self._clock = SenderClock()
        self._attitudes: deque[tuple[int, tuple[float, ...], float]] = deque(maxlen=ATTITUDES_KEPT)
        self._positions: deque[tuple[int, tuple[float, ...], tuple[float, ...]]] = deque(maxlen=POSITIONS_KEPT)
        self._recent = {kind: deque[int](maxlen=RECENT) for kind in ("position", "attitude")}  # their stamps
        self._last = -1  # stamp of the last pose, by the sender's clock
        self._whole = False

    @property
    def rates(self) -> dict[str, float]:
        """Usual number of positions and attitudes a second; of a kind that has not come twice there is none."""
        steps = {kind: [b - a for a, b in pairwise(stamps)] for kind, stamps in self._recent.items()}
        return {kind: 1e9 / max(median(found), 1) for kind, found in steps.items() if found}

    @property
    def turns_slowly(self) -> bool:
        """Whether attitudes come slower than positions."""
        rates = self.rates
        return len(rates) == 2 and rates["position"] > SLOWER * rates["attitude"]

    @property
    def clock(self) -> SenderClock:
        """The clock that converts the sender's stamps."""
        return self._clock

    def take(self, message: Any, received: int) -> list[Sample]:
        """Poses and velocities that a message completes; ODOMETRY, if it is received, replaces the other messages."""
        kind = message.get_type()
        if kind == "ODOMETRY":
            return self._odometry(message, received)
        if self._whole:
            return []
        stamp = message.time_boot_ms * 1_000_000
        if self._attitudes and stamp < self._attitudes[-1][0] - OVERTAKING:
            self._attitudes.clear()
            self._positions.clear()
            for stamps in self._recent.values():
                stamps.clear()
            self._last = -1
        self._recent["position" if kind == "LOCAL_POSITION_NED" else "attitude"].append(stamp)
        if kind == "LOCAL_POSITION_NED":
            position, velocity = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
            self._positions.append((stamp, position, velocity))
        else:
            if kind == "ATTITUDE_QUATERNION":
                quaternion = (message.q1, message.q2, message.q3, message.q4)
            else:
                quaternion = quaternion_from_euler(message.roll, message.pitch, message.yaw)
            self._attitudes.append((stamp, quaternion, message.yawspeed))
        return self._at_attitudes(received) if self.turns_slowly else self._at_positions(received)

    def _at_attitudes(self, received: int) -> list[Sample]:
        """A pose for each attitude between two positions."""
        samples: list[Sample] = []
        for stamp, quaternion, yaw_rate in [one for one in self._attitudes if one[0] > self._last]:
            if not self._positions or self._positions[-1][0] < stamp:
                break
            while len(self._positions) > 1 and self._positions[1][0] < stamp:
                self._positions.popleft()
            self._last = stamp
            if len(self._positions) > 1 and self._positions[0][0] <= stamp:
                position, velocity = moved(self._positions[0], self._positions[1], stamp)
                samples += self._samples(stamp, received, position, quaternion, velocity, yaw_rate)
        return samples

    def _at_positions(self, received: int) -> list[Sample]:
        """A pose for each position between two attitudes."""
        samples: list[Sample] = []
        while self._positions and len(self._attitudes) > 1 and self._attitudes[-1][0] >= self._positions[0][0]:
            stamp, position, velocity = self._positions.popleft()
            later = next(place for place, one in enumerate(self._attitudes) if one[0] >= stamp)
            if later == 0 or stamp <= self._last:  # older than all attitudes; or there was a pose for a later attitude
                continue
            self._last = stamp
            before, after = self._attitudes[later - 1], self._attitudes[later]
            share = (stamp - before[0]) / max(after[0] - before[0], 1)
            quaternion = between(before[1], after[1], share)
            samples += self._samples(stamp, received, position, quaternion, velocity, after[2])
        return samples

    def _samples(self, stamp: int, received: int, *measured: Any) -> list[Sample]:
        """What was measured, on our clock, with its uncertainty."""
        found = _samples(self._clock.ours(stamp, received), received, *measured)
        return [replace(one, error=self._clock.error) for one in found]

    def _odometry(self, message: Any, received: int) -> list[Sample]:
        """In MAV_FRAME_LOCAL_NED (1), or LOCAL_FRD (20), whose x is some other fixed direction; no velocity."""
        values = (message.x, message.y, message.z, *message.q)
        if message.frame_id not in (1, 20) or not all(map(math.isfinite, values)):
            return []
        self._whole = True
        ours = self._clock.ours(message.time_usec * 1000, received)
        pose = enu_from_ned(values[:3], values[3:])
        return [Sample("pose", ours, received, pose, error=self._clock.error)]


def _samples(
    stamp: int,
    received: int,
    position: Sequence[float],
    quaternion: Sequence[float],
    velocity: Sequence[float],
    yaw_rate: float,
) -> list[Sample]:
    if not all(map(math.isfinite, (*position, *quaternion))):
        return []
    samples = [Sample("pose", stamp, received, enu_from_ned(position, quaternion))]
    w, x, y, z = quaternion
    yaw = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    c, s = math.cos(yaw), math.sin(yaw)
    north, east, down = velocity
    if all(map(math.isfinite, (*velocity, yaw_rate))):
        values = (c * north + s * east, s * north - c * east, -down, -yaw_rate)
        samples.append(Sample("velocity", stamp, received, values))
    return samples


_Moving = tuple[int, tuple[float, ...], tuple[float, ...]]
"""Stamp [ns], position and velocity."""


def moved(before: _Moving, after: _Moving, stamp: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position and velocity at an instant between two: the cubic with their positions and velocities at its ends.

    Without velocities it is a straight line.
    """
    seconds = max(after[0] - before[0], 1) / 1e9
    s = (stamp - before[0]) / 1e9 / seconds
    position = []
    for p, q, v, w in zip(before[1], after[1], before[2], after[2], strict=True):
        slopes = (seconds * v, seconds * w) if math.isfinite(v + w) else (q - p, q - p)
        bend = (1 - s) * (slopes[0] - (q - p)) - s * (slopes[1] - (q - p))
        position.append(p + s * (q - p) + s * (1 - s) * bend)
    return tuple(position), tuple((1 - s) * v + s * w for v, w in zip(before[2], after[2], strict=True))


def quaternion_from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """w, x, y, z of the z-y-x Euler angles [rad]."""
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def between(first: Sequence[float], second: Sequence[float], share: float) -> tuple[float, ...]:
    """Normalised linear interpolation of two quaternions, the short way; accurate for the few degrees between them."""
    sign = 1.0 if sum(a * b for a, b in zip(first, second, strict=True)) >= 0 else -1.0
    mixed = [(1 - share) * a + share * sign * b for a, b in zip(first, second, strict=True)]
    size = math.hypot(*mixed)
    return tuple(one / size for one in mixed)


def battery(message: Any) -> float | None:
    """Charge, 0 to 1, from SYS_STATUS or BATTERY_STATUS; None if the autopilot does not know it (-1)."""
    return message.battery_remaining / 100 if message.battery_remaining >= 0 else None


WARNING = 4
"""MAV_SEVERITY_WARNING: texts of this severity, or a graver one, are passed on."""

_WHOLE = 50  # characters of a STATUSTEXT; a longer text comes in parts


class SpokenTexts:
    """Joins the parts of STATUSTEXT messages."""

    def __init__(self) -> None:
        self._parts: dict[int, str] = {}

    def take(self, message: Any) -> str:
        """The text that a message completes, if it is at least a warning; otherwise empty."""
        number, text = getattr(message, "id", 0), str(message.text).partition("\0")[0]
        whole = self._parts.pop(number, "") + text
        if number and len(text) == _WHOLE:
            self._parts = {number: whole}
            return ""
        printable = "".join(letter if letter.isprintable() else " " for letter in whole).strip()
        return printable if message.severity <= WARNING else ""
