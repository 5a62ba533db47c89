"""A card applied to a live link: which field of which message carries a command, and which fields hold the pose.

Reading under a card is (raw * scale + offset), then the unit. Sending is the inverse, so a log of the flight, read
under that card, holds what was commanded.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import LinkError
from rotorfit.core.frames import AXES
from rotorfit.flights.columns import split_source

STAMP = "header.stamp"

_QUATERNION = ("qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class CommandFields:
    """Where the commands go.

    Attributes:
        table: Topic or message that holds all of them.
        channels: Axis to its channel; the channel's source is the name of the field alone.
    """

    table: str
    channels: Mapping[str, Channel]


@dataclass(frozen=True)
class PoseFields:
    """Where the pose comes from.

    Attributes:
        table: Topic or message that holds all of it.
        stamped: Whether the message carries its sender's stamp in `header.stamp`.
        frame: `ENU`, or `NED`, which is converted.
        channels: `x`, `y`, `z` and `yaw` or `qw`, `qx`, `qy`, `qz`, as in the card; sources are field names or numbers.
        velocity: `x`, `y`, `z` and perhaps `yaw` of the vehicle's own velocity in the heading frame; empty without.
        velocity_table: Topic or message of that velocity; may be the pose's.
    """

    table: str
    stamped: bool
    frame: str
    channels: Mapping[str, Channel]
    velocity: Mapping[str, Channel]
    velocity_table: str = ""


def command_fields(card: Card) -> CommandFields:
    """Message and fields of a card's commands.

    Raises:
        LinkError: The commands are along the world's axes, in several messages, in none, or constant.
    """
    if card.command_frame == "world":
        raise LinkError(
            f"card {card.name}: its commands are along the world axes, but rotorfit flies forward, left, up; "
            'use a driver that takes those, and frame = "heading"'
        )
    table, channels = _of_one_table(card.command, f"card {card.name}, [command]")
    return CommandFields(table, channels)


def pose_fields(card: Card) -> PoseFields:
    """Message and fields of a card's pose, and of its velocity in the heading frame.

    Raises:
        LinkError: The pose, or the velocity, is in several messages or in none.
    """
    table, channels = _of_one_table(card.pose, f"card {card.name}, [pose]")
    velocity_table, velocity = "", dict[str, Channel]()
    if card.velocity_frame == "heading" and {"x", "y", "z"} <= card.velocity.keys():
        velocity_table, velocity = _of_one_table(card.velocity, f"card {card.name}, [velocity]")
    stamped = split_source(card.pose_time.source)[1] == STAMP
    return PoseFields(table, stamped, card.frame, channels, velocity, velocity_table)


def _of_one_table(channels: Mapping[str, Channel], place: str) -> tuple[str, dict[str, Channel]]:
    """The message that all channels name, and the channels with the field names alone."""
    tables: dict[str, str] = {}
    fields: dict[str, Channel] = {}
    for axis, channel in channels.items():
        name = channel.source
        if isinstance(name, str):
            table, name = split_source(name)
            tables[table] = axis
        fields[axis] = Channel(name, channel.scale, channel.offset, channel.unit)
    if len(tables) != 1 or "" in tables:
        named = ", ".join(f"{axis} in {table or 'no message'}" for table, axis in tables.items()) or "numbers only"
        raise LinkError(f"{place}: a link needs all channels in one message, as in '/topic:field'; here: {named}")
    return next(iter(tables)), fields


def raw_values(fields: CommandFields, command: Sequence[float]) -> dict[str, float]:
    """Field to raw value for a command: value / unit, minus the offset, over the scale.

    Args:
        fields: Where the commands go.
        command: Forward, left, up, counter-clockwise, in the unit of the card's commands.

    Returns:
        A value for the field of each axis that the card commands.

    Raises:
        LinkError: A command on an axis that the card does not command is not zero.
    """
    values = dict(zip(AXES, command, strict=True))
    astray = [axis for axis, value in values.items() if value and axis not in fields.channels]
    if astray:
        raise LinkError(f"a command on {astray[0]}, which the card does not command; add it to [command]")
    return {str(channel.source): channel.raw(values[axis]) for axis, channel in fields.channels.items()}


def channel_value(channel: Channel, read: Callable[[str], float]) -> float:
    """The value of a channel in SI units.

    Args:
        channel: The channel.
        read: Name of a source to its raw value.
    """
    return channel.in_si(read(channel.source) if isinstance(channel.source, str) else channel.source)


def command_values(fields: CommandFields, read: Callable[[str], float]) -> tuple[float, ...] | None:
    """Forward, left, up, counter-clockwise of one message, after the card's scale; None if one is not finite.

    Args:
        fields: Where the commands are.
        read: Field name to its raw value in the message.
    """
    values = {axis: channel_value(channel, read) for axis, channel in fields.channels.items()}
    if not all(map(math.isfinite, values.values())):
        return None
    return tuple(values.get(axis, 0.0) for axis in AXES)


def pose_values(fields: PoseFields, read: Callable[[str], float]) -> tuple[float, ...] | None:
    """x, y, z [m], then the quaternion w, x, y, z, world z up, of one message; None if one is not finite.

    Args:
        fields: Where the pose comes from.
        read: Field name to its raw value in the message.
    """
    values = {axis: channel_value(channel, read) for axis, channel in fields.channels.items()}
    if not all(map(math.isfinite, values.values())):
        return None
    quaternion: tuple[float, ...]
    if "yaw" in values:
        quaternion = (math.cos(values["yaw"] / 2), 0.0, 0.0, math.sin(values["yaw"] / 2))
    else:
        quaternion = tuple(values[part] for part in _QUATERNION)
    position = (values["x"], values["y"], values["z"])
    return enu_from_ned(position, quaternion) if fields.frame == "NED" else (*position, *quaternion)


def velocity_values(fields: PoseFields, read: Callable[[str], float]) -> tuple[float, ...] | None:
    """Forward, left, up [m/s] and yaw rate [rad/s], NaN if the card has none; None if a speed is not finite.

    Args:
        fields: Where the velocity comes from.
        read: Field name to its raw value in the message.
    """
    values = {axis: channel_value(channel, read) for axis, channel in fields.velocity.items()}
    if not all(math.isfinite(values[axis]) for axis in ("x", "y", "z")):
        return None
    return (values["x"], values["y"], values["z"], values.get("yaw", math.nan))


def enu_from_ned(position: Sequence[float], quaternion: Sequence[float]) -> tuple[float, ...]:
    """Position and attitude from north-east-down, body forward-right-down, to east-north-up, body forward-left-up.

    Args:
        position: North, east, down [m].
        quaternion: w, x, y, z: from the body to the world.

    Returns:
        East, north, up [m], then w, x, y, z.

    Source: q' = p q r with p a half turn about (1, 1, 0) / sqrt(2), which exchanges the worlds, and r a half turn about
    the body's x axis, which exchanges the bodies.
    """
    north, east, down = position
    w, x, y, z = quaternion
    half = math.sqrt(0.5)
    return (east, north, -down, half * (w + z), half * (x + y), half * (x - y), half * (w - z))
