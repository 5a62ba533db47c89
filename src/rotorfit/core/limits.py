"""Settings: what a command of 1 asks of the vehicle, according to its card, and how gains scale with the limits.

| meaning of the channel | a command of 1 asks for | expectation |
|---|---|---|
| fraction of the tilt limit t | that tilt | acceleration 9.81 tan(t) |
| tilt in rad | one radian, small tilts | acceleration 9.81 m/s^2 per rad |
| fraction of a speed or rate limit | that speed or rate | equal to the steady one |
| speed in m/s, rate in rad/s | one unit of it | steady gain 1 |

Source: at constant height the thrust m g / cos(t) has the horizontal part m g tan(t).
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from rotorfit.core.card import LIMIT_UNITS, Card, Channel
from rotorfit.core.errors import CardError, nearest

Asked = Literal["tilt", "velocity", "vertical_speed", "yaw_rate"]

GRAVITY = 9.81
"""[m/s^2]"""

_FROM_LIMIT: Mapping[str, Asked] = {
    "tilt": "tilt",
    "vertical_speed": "vertical_speed",
    "yaw_rate": "yaw_rate",
    "speed": "velocity",
}

_FROM_UNIT: Mapping[str, str] = {
    **dict.fromkeys(("rad", "deg"), "tilt"),
    **dict.fromkeys(("m/s", "cm/s"), "velocity"),
    **dict.fromkeys(("rad/s", "deg/s"), "yaw_rate"),
}

_POSSIBLE: Mapping[str, tuple[str, ...]] = {
    "x": ("tilt", "velocity"),
    "y": ("tilt", "velocity"),
    "z": ("vertical_speed", "velocity"),
    "yaw": ("yaw_rate",),
}

_SPEEDS = ("velocity", "vertical_speed")


@dataclass(frozen=True)
class Meaning:
    """What the commands of one axis ask for.

    Attributes:
        asked: `tilt`, `velocity`, `vertical_speed` or `yaw_rate`; None where the card does not say.
        limit: The limit that corresponds to a command of 1, a key of `Card.limits`; None for commands in SI.
        setting: Value of that limit [rad, m/s or rad/s]; None where the card does not give it.
        reason: Why `asked` is None.
    """

    asked: Asked | None
    limit: str | None = None
    setting: float | None = None
    reason: str | None = None


@dataclass(frozen=True)
class Figure:
    """A number with its 95 % interval; an unknown value and an open end are None."""

    value: float | None
    ci95: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True)
class Quantity:
    """A physical quantity of an axis compared with the value expected from the card, SI.

    Attributes:
        measured: At full command, or per unit of a command in SI; None where it is unknown.
        unit: As text, such as `m/s^2`, or `m/s^2 per rad`.
        expected: From the card's meaning and limits.
        ratio: Measured over expected.
        implied_limit: Setting of the limit at which the expected value would equal the measured one [rad, m/s or
            rad/s].
        reason: Why a value above is None.
    """

    measured: Figure | None
    unit: str
    expected: float | None = None
    ratio: Figure | None = None
    implied_limit: Figure | None = None
    reason: str | None = None


@dataclass(frozen=True)
class Conversion:
    """Conversion of a model to other limits after the fit.

    Attributes:
        limits: The `[limits]` of the card under which its flights were flown, as given in that card.
        factor: Axis name to the factor by which its gains were multiplied since the fit.
    """

    limits: Mapping[str, Any]
    factor: Mapping[str, float]


def meaning_of(card: Card, axis: str) -> Meaning:
    """What the commands of an axis ask for.

    Where the card gives no `meaning`, its `full_scale` or `unit` implies it. A contradiction is reported as a reason.
    """
    channel = card.command.get(axis)
    if channel is None:
        return Meaning(None, reason=f"the card has no command for {axis}")
    asked = channel.meaning or _FROM_LIMIT.get(channel.full_scale or "") or _FROM_UNIT.get(channel.unit or "")
    if asked is None:
        return Meaning(None, reason=f"the card does not say what a command on {axis} means: give the channel a meaning")
    if asked not in _POSSIBLE[axis]:
        return Meaning(None, reason=f"the card says that {axis} means {asked}, which does not move {axis}")
    if trouble := _contradiction(channel, asked):
        return Meaning(None, reason=f"the card contradicts itself on {axis}: {trouble}")
    known: Asked = next(name for name in _FROM_LIMIT.values() if name == asked)
    limit = channel.full_scale
    return Meaning(known, limit, card.limits.get(limit) if limit else None)


def _contradiction(channel: Channel, asked: str) -> str | None:
    """The contradiction in a channel that means `asked`; None if there is none."""
    if channel.full_scale and channel.unit:
        return f"full_scale makes it a fraction of the limit {channel.full_scale}, unit a value in {channel.unit}"
    alike = _SPEEDS if asked in _SPEEDS else (asked,)
    if channel.full_scale and _FROM_LIMIT[channel.full_scale] not in alike:
        return f"meaning {asked!r}, but a fraction of {channel.full_scale!r}"
    if channel.unit and _FROM_UNIT.get(channel.unit) not in alike:
        return f"meaning {asked!r}, but the unit {channel.unit!r}"
    return None


def expectation(meaning: Meaning) -> float | None:
    """The value that a command of 1 is expected to reach; None where the card does not tell.

    Returns:
        For a tilt the acceleration [m/s^2, or m/s^2 per rad]; else the steady speed or rate [m/s, rad/s, or 1].
    """
    if meaning.asked is None or (meaning.limit and meaning.setting is None):
        return None
    if meaning.setting is None:
        return GRAVITY if meaning.asked == "tilt" else 1.0
    return GRAVITY * math.tan(meaning.setting) if meaning.asked == "tilt" else meaning.setting


def limit_that_gives(meaning: Meaning, reached: float) -> float:
    """The setting of the limit at which a command of 1 is expected to reach this value: inverts `expectation`."""
    return math.atan(reached / GRAVITY) if meaning.asked == "tilt" else reached


def gain_factor(limit: str, before: float, after: float) -> float:
    """Factor on the gains when a limit changes: tan(t') / tan(t) for the tilt, the ratio for speeds and rates.

    Args:
        limit: A key of `Card.limits`.
        before: The old setting [rad, m/s or rad/s].
        after: The new one.
    """
    return math.tan(after) / math.tan(before) if limit == "tilt" else after / before


def limits_from_text(text: str) -> dict[str, Any]:
    """Parses limits from `tilt=20deg,vertical_speed=2,yaw_rate=100deg/s` into the form of `[limits]` in a card.

    A number without a unit is SI. The card checks units and magnitudes.

    Raises:
        CardError: Wrong syntax, a limit given twice, or an unknown limit (the nearest is named).
    """
    limits: dict[str, Any] = {}
    for part in text.split(","):
        name, equals, rest = (word.strip() for word in part.partition("="))
        number = re.fullmatch(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z/]*)", rest)
        if not equals or not number:
            raise CardError(f"limits {text!r}: {part!r} is not NAME=NUMBER with a unit, such as tilt=20deg")
        if name not in LIMIT_UNITS:
            raise CardError(
                f"limits {text!r}: no limit {name!r}{nearest(name, LIMIT_UNITS)}, known are {', '.join(LIMIT_UNITS)}"
            )
        if name in limits:
            raise CardError(f"limits {text!r}: {name} is given twice")
        value = float(number[1])
        limits[name] = {"value": value, "unit": number[2]} if number[2] else value
    return limits


def limit_text(limit: str, value: float) -> str:
    """A limit for people, angles in degrees: `20 deg`, `1.2 m/s`, `100 deg/s`."""
    unit, factor = PEOPLE[limit]
    return f"{factor * value:.3g} {unit}"


PEOPLE: Mapping[str, tuple[str, float]] = {
    "tilt": ("deg", 180 / math.pi),
    "vertical_speed": ("m/s", 1.0),
    "yaw_rate": ("deg/s", 180 / math.pi),
    "speed": ("m/s", 1.0),
}
"""Unit in which people state a limit, and the factor from SI."""


def disagreement(one: Card, other: Card, whose: tuple[str, str] = ("the plan's card", "the vehicle's")) -> str:
    """Describes where two cards interpret the same command differently; empty where they agree as far as both tell.

    Args:
        one: Card of a plan or a log.
        other: Card of the vehicle as it is set, or of a model.
        whose: How to name the two.
    """
    first, second = whose
    for axis in one.command:
        mine, theirs = meaning_of(one, axis), meaning_of(other, axis)
        if mine.limit and axis not in other.command:
            return f"there is a command on {axis} by {first}, but none by {second}"
        if mine.asked and theirs.asked and mine.asked != theirs.asked:
            return f"a command on {axis} asks for {mine.asked} by {first}, for {theirs.asked} by {second}"
        if bool(mine.limit) != bool(theirs.limit):
            with_limit, without = whose if mine.limit else whose[::-1]
            return f"a command on {axis} is a fraction of a limit by {with_limit}, but not by {without}"
        reached, reaches = expectation(mine), expectation(theirs)
        if reached is not None and reaches is not None and abs(reached - reaches) > 0.01 * abs(reaches):
            return f"a command of 1 on {axis} reaches {reached:.3g} by {first}, {reaches:.3g} by {second}"
    return ""


COMMAND_UNITS = {"tilt": "rad", "velocity": "m/s", "vertical_speed": "m/s", "yaw_rate": "rad/s"}
"""SI unit of what a command asks for."""

LIMIT_OF = {"tilt": "tilt", "velocity": "speed", "vertical_speed": "vertical_speed", "yaw_rate": "yaw_rate"}


@dataclass(frozen=True)
class CommandMeaning:
    """What the command of an axis means, for the exports.

    Attributes:
        text: In words, with its limit where the card has one, and how the log holds it where that is another number.
        unit: `fraction`, an SI unit, or `unit of command`.
        limit: Largest magnitude; None where the card does not tell.
    """

    text: str
    unit: str
    limit: float | None


def command_of(card: Card, axis: str, physical: bool = False) -> CommandMeaning:
    """What the command of an axis means by a card; with `physical`, in SI even where the card has fractions."""
    meaning: Meaning = meaning_of(card, axis)
    held = recorded_as(card, axis)
    if meaning.asked is None:
        text = f"as sent, by the card {card.name}; what it asks for is not known"
        return CommandMeaning(f"{text}{held}", "unit of command", None)
    if meaning.limit and not physical:
        size = f" ({limit_text(meaning.limit, meaning.setting)})" if meaning.setting else ""
        return CommandMeaning(f"fraction of the {meaning.limit} limit{size}, from -1 to 1{held}", "fraction", 1.0)
    if meaning.limit:
        held = recorded_as(card, axis, meaning.setting or math.nan)
    limit = card.limits.get(meaning.limit or LIMIT_OF[meaning.asked])
    unit = COMMAND_UNITS[meaning.asked]
    ends = f", from {-limit:.4g} to {limit:.4g}" if limit else ", limits not known"
    return CommandMeaning(f"{meaning.asked} asked for [{unit}]{ends}{held}", unit, limit)


WORLD_COMMANDS = (
    "The vehicle itself takes commands of x and y in the world frame: turn those of this file by yaw before they are "
    "sent."
)
"""What a user of a model or of gains must know where the card's commands do not turn with the vehicle."""


def recorded_as(card: Card, axis: str, unit: float = 1.0) -> str:
    """How the log holds the command of an axis, as a clause; empty where it holds the very number.

    Args:
        card: Defines the channel.
        axis: Name of the axis.
        unit: Size of the command's unit in that of the card.
    """
    channel = card.command.get(axis)
    if channel is None or not isinstance(channel.source, str):
        return ""
    factor, offset = 1 / (unit * channel.factor * channel.scale), -channel.offset / channel.scale
    if factor == 1 and offset == 0:
        return ""
    return f"; {channel.source} of the log is it times {factor:.6g}" + f" plus {offset:.6g}" * bool(offset)
