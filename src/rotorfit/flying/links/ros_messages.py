"""Common to both versions of ROS: topics and fields of the card, take-off and landing, filling and reading messages."""

from collections.abc import Callable, Sequence
from functools import reduce
from operator import attrgetter
from typing import Any

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flights.columns import split_source
from rotorfit.flying.links.card_fields import (
    CommandFields,
    PoseFields,
    command_fields,
    command_values,
    pose_fields,
    pose_values,
    raw_values,
    velocity_values,
)
from rotorfit.flying.links.card_window import Obedience
from rotorfit.flying.links.link import wall_clock

PATIENCE = 5.0
"""How long a driver may take to be found on the graph [s]."""

ACTIONS = ("take_off", "land")

TWIST_FIELDS = tuple(f"{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")

_STAMPED = "twist."

_POSES = {
    "PoseStamped": ("pose.position", "pose.orientation"),
    "TransformStamped": ("transform.translation", "transform.rotation"),
    "Odometry": ("pose.pose.position", "pose.pose.orientation"),
}
"""Message type to its fields of position and attitude, for poses that no card describes."""

FAIL_SAFE = (
    "What your driver does when commands stop is not in the card (key fail_safe). "
    "Assume that the vehicle keeps flying the last command: have a second way to land it."
)


def ros_commands(card: Card) -> CommandFields:
    """Topic and fields of a card's commands.

    Raises:
        LinkError: They are not fields of a Twist or TwistStamped on a topic.
    """
    fields = command_fields(card)
    names = [str(channel.source) for channel in fields.channels.values()]
    stamped = is_stamped(fields)
    known = all(name.removeprefix(_STAMPED) in TWIST_FIELDS and name.startswith(_STAMPED) == stamped for name in names)
    if not fields.table.startswith("/") or not known:
        raise LinkError(
            f"card {card.name}: '{fields.table}:{names[0]}' is not a field of a Twist or TwistStamped on a topic, "
            "such as '/bebop/cmd_vel:linear.x' or '/cmd_vel:twist.linear.x'; name a card of your driver with --card"
        )
    return fields


def is_stamped(fields: CommandFields) -> bool:
    """Whether the commands go out as TwistStamped."""
    return any(str(channel.source).startswith(_STAMPED) for channel in fields.channels.values())


def ros_poses(card: Card) -> PoseFields:
    """Topic and fields of a card's pose.

    Raises:
        LinkError: It is not on a topic.
    """
    fields = pose_fields(card)
    if not fields.table.startswith("/"):
        raise LinkError(f"card {card.name}: the pose is in {fields.table!r}, which is not a topic; it starts with /")
    return fields


def poses_of_type(topic: str, kind: str) -> PoseFields:
    """Fields of a pose by its message's type, world z up.

    Args:
        topic: Where it is published.
        kind: Type with or without its package, such as `geometry_msgs/PoseStamped`.

    Raises:
        LinkError: Another type.
    """
    name = kind.rpartition("/")[2]
    if name not in _POSES:
        raise LinkError(f"{topic} is a {kind}; poses come as {', '.join(_POSES)}; write a card for anything else")
    position, attitude = _POSES[name]
    channels = {axis: Channel(f"{position}.{axis}") for axis in "xyz"}
    channels |= {f"q{part}": Channel(f"{attitude}.{part}") for part in "wxyz"}
    return PoseFields(topic, True, "ENU", channels, {})


def action_topic(fields: CommandFields, action: str) -> str:
    """Topic of std_msgs/Empty that takes off or lands: beside the commands, `/bebop/cmd_vel` -> `/bebop/takeoff`.

    Source: "Sending commands" of the documentation of bebop_autonomy and of ardrone_autonomy.
    """
    return fields.table.rpartition("/")[0] + {"take_off": "/takeoff", "land": "/land"}[action]


def fill(message: Any, fields: CommandFields, command: Sequence[float]) -> Any:
    """Writes a command into an empty Twist or TwistStamped and returns it."""
    for name, raw in raw_values(fields, command).items():
        *path, last = name.split(".")
        setattr(reduce(getattr, path, message), last, raw)
    return message


def pose_samples(message: Any, fields: PoseFields, stamp_of: Callable[[Any], int]) -> list[Sample]:
    """The pose in a message, and the velocity if the card names it in the same one; only finite ones.

    Args:
        message: The message as received.
        fields: The fields that the card names.
        stamp_of: Message to the stamp of its header [ns]; 0 if the sender left it out.
    """
    received = wall_clock()
    stamp = stamp_of(message) if fields.stamped else 0
    values = pose_values(fields, lambda name: float(attrgetter(name)(message)))
    samples = [] if values is None else [Sample("pose", stamp or received, received, values)]
    beside = fields.velocity and fields.velocity_table == fields.table
    return [*samples, *velocity_samples(message, fields, stamp_of)] if beside else samples


def velocity_samples(message: Any, fields: PoseFields, stamp_of: Callable[[Any], int]) -> list[Sample]:
    """The velocity in a message, if it is finite. Arguments as for `pose_samples`."""
    received = wall_clock()
    stamp = stamp_of(message) if hasattr(message, "header") else 0
    values = velocity_values(fields, lambda name: float(attrgetter(name)(message)))
    return [] if values is None else [Sample("velocity", stamp or received, received, values)]


def command_samples(message: Any, fields: CommandFields, stamp_of: Callable[[Any], int]) -> list[Sample]:
    """The command in a message that somebody else sent, if it is finite. Arguments as for `pose_samples`."""
    received = wall_clock()
    stamp = stamp_of(message) if is_stamped(fields) else 0
    values = command_values(fields, lambda name: float(attrgetter(name)(message)))
    return [] if values is None else [Sample("command", stamp or received, received, values)]


def action_samples(action: str, obedience: Obedience) -> list[Sample]:
    """The effect of somebody's order to take off or land: after an order to land, commands are not obeyed."""
    return obedience.reported(action == "take_off", wall_clock())


def window_samples(message: Any, topic: str, obedience: Obedience) -> list[Sample]:
    """The effect of a message on the card's window."""
    return obedience.heard(topic, lambda name: float(attrgetter(name)(message)), wall_clock())


def check_window(message: Any, topic: str, obedience: Obedience) -> None:
    """Refuses a message type without the fields of the card's window, or with text in them.

    Args:
        message: An empty message of the topic's type.
        topic: Name of the topic.
        obedience: The card's window.

    Raises:
        LinkError: A field is missing, or is text.
    """
    for one in obedience.conditions[topic]:
        name = split_source(one.channel.source)[1]
        try:
            float(attrgetter(name)(message))
        except (AttributeError, TypeError, ValueError):
            raise LinkError(f"{topic} has no number {name!r} for [window]; name a card that fits with --card") from None


def check_pose(message: Any, fields: PoseFields) -> None:
    """Refuses a message type without the fields of the card's pose.

    Args:
        message: An empty message of the topic's type.
        fields: The fields that the card names.

    Raises:
        LinkError: A field is missing.
    """
    for channel in fields.channels.values():
        try:
            if isinstance(channel.source, str):
                attrgetter(channel.source)(message)
        except AttributeError:
            raise LinkError(
                f"{fields.table} is a {type(message).__name__} and has no field {channel.source!r}; "
                "name a card that fits with --card"
            ) from None
