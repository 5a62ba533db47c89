"""ROS 2: Twist or TwistStamped out, any stamped pose in; topics and fields come from the card.

Needs rclpy: a shell in which a ROS 2 installation is sourced.
"""

import importlib
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flying.links.card_fields import CommandFields, PoseFields
from rotorfit.flying.links.card_window import Obedience, obedience
from rotorfit.flying.links.link import Action, Silence, seconds_until, wall_clock
from rotorfit.flying.links.ros_messages import (
    ACTIONS,
    FAIL_SAFE,
    PATIENCE,
    action_samples,
    action_topic,
    check_pose,
    check_window,
    command_samples,
    fill,
    is_stamped,
    pose_samples,
    poses_of_type,
    ros_commands,
    ros_poses,
    velocity_samples,
    window_samples,
)

_SECOND = 1_000_000_000

HEARD = 50
"""Depth of the queue for the commands of others: they come in bursts over a radio."""


def open_link(address: str, card: Card) -> "Ros2Link":
    """Connects to the driver that a card describes.

    Args:
        address: Must be empty: the graph is that of ROS_DOMAIN_ID, the topics are in the card.
        card: Names the topics and fields.

    Raises:
        LinkError: No driver that listens, no pose topic, or a card that fits neither.
        ModuleNotFoundError: No rclpy.
    """
    if address:
        raise LinkError(f"ros2 takes no address ({address!r}); set ROS_DOMAIN_ID, and name topics in the card")
    return Ros2Link(ros_commands(card), ros_poses(card), card.fail_safe or FAIL_SAFE, card.hold)


def open_poses(address: str) -> "Ros2Link":
    """Listens to a pose topic, of PoseStamped, TransformStamped or Odometry, for a vehicle that another link commands.

    Raises:
        LinkError: No such topic, another type.
        ModuleNotFoundError: No rclpy.
    """
    return Ros2Link(None, address, "This link only listens.")


def open_listener(address: str, card: Card) -> "Ros2Link":
    """Listens to poses, and to the commands that somebody else sends.

    Args:
        address: Must be empty, as for `open_link`.
        card: Names the topics and fields.

    Raises:
        LinkError: No pose topic, a card that does not fit.
        ModuleNotFoundError: No rclpy.
    """
    if address:
        raise LinkError(f"ros2 takes no address ({address!r}); set ROS_DOMAIN_ID, and name topics in the card")
    return Ros2Link(None, ros_poses(card), "This link only listens.", heard=ros_commands(card), window=obedience(card))


class Ros2Link:
    """A vehicle on a ROS 2 graph; implements `links.Link`. All of it runs in the caller's thread."""

    def __init__(
        self,
        commands: CommandFields | None,
        poses: PoseFields | str,
        fail_safe: str,
        hold: float | None = None,
        heard: CommandFields | None = None,
        window: Obedience | None = None,
    ) -> None:
        self.fail_safe, self.silence, self.undone = fail_safe, Silence(hold), ""
        self._window = window or Obedience({})
        self.live = True
        self._rclpy = importlib.import_module("rclpy")
        # its own handlers would close the graph at Ctrl-C, before the vehicle hovers and the results are written
        self._rclpy.init(signal_handler_options=importlib.import_module("rclpy.signals").SignalHandlerOptions.NO)
        self._node = self._rclpy.create_node("rotorfit")
        self._open = True
        self._inbox: list[Sample] = []
        try:
            self._poses = poses_of_type(poses, self._topic_type(poses)) if isinstance(poses, str) else poses
            self._commands, self._heard = commands, heard
            self._publishers = self._advertise(commands) if commands else {}
            self._subscribe()
        except LinkError:
            self._close()
            raise

    @property
    def now(self) -> int:
        """The wall clock [ns]."""
        return wall_clock()

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Publishes a command; see `links.Link`."""
        if not self._open or self._commands is None:
            raise LinkError("ros2: the link is closed, or was opened for poses only")
        kind, publisher = self._publishers["command"]
        if not publisher.get_subscription_count():
            raise LinkError(f"ros2: nobody listens to {self._commands.table} any more; is the driver still running?")
        message = fill(kind(), self._commands, command)
        if is_stamped(self._commands):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(wall_clock(), _SECOND)
        publisher.publish(message)
        return command

    def receive(self, until: int) -> list[Sample]:
        """What has come since the last call; see `links.Link`."""
        while self._open and (left := seconds_until(until)) > 0:
            self._rclpy.spin_once(self._node, timeout_sec=left)
        arrived, self._inbox = self._inbox, []
        return arrived

    def act(self, action: Action) -> None:
        """Publishes std_msgs/Empty on `takeoff` or `land` beside the commands, or closes; see `links.Link`."""
        if action == "close":
            self._close()
            return
        if not self._open or action not in self._publishers:
            raise LinkError(f"ros2: cannot {action.replace('_', ' ')}: the link is closed, or only listens")
        kind, publisher = self._publishers[action]
        if not publisher.get_subscription_count():
            raise LinkError(f"ros2: nobody listens to {publisher.topic_name}; {action.replace('_', ' ')} otherwise")
        publisher.publish(kind())

    def _close(self) -> None:
        if self._open:
            self._open = False
            self._node.destroy_node()
            self._rclpy.shutdown()

    def _subscribe(self) -> None:
        kind = message_class(self._topic_type(self._poses.table))
        check_pose(kind(), self._poses)
        # best effort also receives from reliable publishers, and a lost pose must not be sent again late
        quality = importlib.import_module("rclpy.qos").qos_profile_sensor_data
        self._node.create_subscription(kind, self._poses.table, self._on_pose, quality)
        if self._poses.velocity and self._poses.velocity_table != self._poses.table:
            kind = message_class(self._topic_type(self._poses.velocity_table))
            self._node.create_subscription(kind, self._poses.velocity_table, self._on_velocity, quality)

        if self._heard:
            depth = importlib.import_module("rclpy.qos").QoSProfile(
                depth=HEARD, reliability=quality.reliability, durability=quality.durability
            )
            self._node.create_subscription(_twist(self._heard), self._heard.table, self._on_command, depth)
            empty = message_class("std_msgs/msg/Empty")
            for action in ACTIONS:
                self._node.create_subscription(
                    empty, action_topic(self._heard, action), partial(self._on_action, action), depth
                )
            self._inbox += self._window.begun(wall_clock())
            for topic, conditions in self._window.conditions.items():
                known = dict(self._node.get_topic_names_and_types())
                if topic not in known and all(one.optional for one in conditions):
                    continue
                kind = message_class(self._topic_type(topic))
                check_window(kind(), topic, self._window)
                self._node.create_subscription(kind, topic, partial(self._on_window, topic), depth)

    def _advertise(self, commands: CommandFields) -> dict[str, tuple[Any, Any]]:
        twist = _twist(commands)
        empty = message_class("std_msgs/msg/Empty")
        topics = {"command": (twist, commands.table)}
        topics |= {action: (empty, action_topic(commands, action)) for action in ACTIONS}
        publishers = {
            name: (kind, self._node.create_publisher(kind, topic, 1)) for name, (kind, topic) in topics.items()
        }
        deadline = time.monotonic() + PATIENCE
        while not publishers["command"][1].get_subscription_count():
            if time.monotonic() > deadline:
                raise LinkError(
                    f"ros2: nobody listens to {commands.table}; start the driver, or correct the card's [command]"
                )
            self._rclpy.spin_once(self._node, timeout_sec=0.05)
        return publishers

    def _topic_type(self, topic: str) -> str:
        deadline = time.monotonic() + PATIENCE
        while True:
            types = dict(self._node.get_topic_names_and_types())
            if topic in types:
                return str(types[topic][0])
            if time.monotonic() > deadline:
                raise LinkError(f"ros2: nobody publishes {topic}; `ros2 topic list` shows what there is")
            self._rclpy.spin_once(self._node, timeout_sec=0.05)

    def _on_pose(self, message: Any) -> None:
        self._inbox.extend(pose_samples(message, self._poses, _stamp))

    def _on_command(self, message: Any) -> None:
        if self._heard:
            self._inbox.extend(command_samples(message, self._heard, _stamp))

    def _on_action(self, action: str, _message: Any) -> None:
        self._inbox.extend(action_samples(action, self._window))

    def _on_window(self, topic: str, message: Any) -> None:
        self._inbox.extend(window_samples(message, topic, self._window))

    def _on_velocity(self, message: Any) -> None:
        self._inbox.extend(velocity_samples(message, self._poses, _stamp))


def _twist(commands: CommandFields) -> Any:
    """The class of the messages that carry a card's commands."""
    return message_class("geometry_msgs/msg/TwistStamped" if is_stamped(commands) else "geometry_msgs/msg/Twist")


def _stamp(message: Any) -> int:
    """The stamp of a message's header [ns]."""
    return int(message.header.stamp.sec) * _SECOND + int(message.header.stamp.nanosec)


def message_class(kind: str) -> Any:
    """The class of a message type such as `geometry_msgs/msg/Twist`.

    Raises:
        LinkError: Its package is not in this shell.
    """
    package, _, name = kind.partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name.rpartition("/")[2])
    except ImportError as err:
        raise LinkError(f"ros2: no message {kind} ({err}); source the workspace that has it") from err
