"""ROS 1: Twist or TwistStamped out, any stamped pose in; topics and fields come from the card.

Needs rospy and the message packages: the Debian packages python3-rospy, python3-geometry-msgs, python3-nav-msgs and
python3-std-msgs, or a sourced ROS 1 installation. The master is the one in ROS_MASTER_URI.
"""

import importlib.util
import os
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
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

DEBIAN = "/usr/lib/python3/dist-packages"


def open_link(address: str, card: Card) -> "Ros1Link":
    """Connects to the driver that a card describes.

    Args:
        address: Must be empty: the master is in ROS_MASTER_URI, the topics are in the card.
        card: Names the topics and fields.

    Raises:
        LinkError: No master, no driver that listens, no pose topic, or a card that fits neither.
        ModuleNotFoundError: No rospy.
    """
    if address:
        raise LinkError(f"ros1 takes no address ({address!r}); set ROS_MASTER_URI, and name topics in the card")
    commands, poses = ros_commands(card), ros_poses(card)
    return Ros1Link(node(), commands, poses, card.fail_safe or FAIL_SAFE, card.hold)


def open_poses(address: str) -> "Ros1Link":
    """Listens to a pose topic, for a vehicle that another link commands.

    Args:
        address: The topic, of PoseStamped, TransformStamped or Odometry, world z up.

    Raises:
        LinkError: No master, no such topic, another type.
        ModuleNotFoundError: No rospy.
    """
    rospy = node()
    return Ros1Link(rospy, None, poses_of_type(address, _topic_type(rospy, address)), "This link only listens.")


def open_listener(address: str, card: Card) -> "Ros1Link":
    """Listens to poses, and to the commands that somebody else sends.

    Args:
        address: Must be empty, as for `open_link`.
        card: Names the topics and fields.

    Raises:
        LinkError: No master, no pose topic, a card that does not fit.
        ModuleNotFoundError: No rospy.
    """
    if address:
        raise LinkError(f"ros1 takes no address ({address!r}); set ROS_MASTER_URI, and name topics in the card")
    commands, poses = ros_commands(card), ros_poses(card)
    return Ros1Link(node(), None, poses, "This link only listens.", heard=commands, window=obedience(card))


class Ros1Link:
    """A vehicle on a ROS 1 graph; implements `links.Link`."""

    def __init__(
        self,
        rospy: Any,
        commands: CommandFields | None,
        poses: PoseFields,
        fail_safe: str,
        hold: float | None = None,
        heard: CommandFields | None = None,
        window: Obedience | None = None,
    ) -> None:
        self.fail_safe, self.silence, self.undone = fail_safe, Silence(hold), ""
        self._window = window or Obedience({})
        self.live = True
        self._rospy = rospy
        self._commands, self._heard = commands, heard
        self._poses = poses
        self._inbox: deque[Sample] = deque()
        self._open = True
        self._subscribers = [self._subscriber(poses.table, self._on_pose)]
        if poses.velocity and poses.velocity_table != poses.table:
            self._subscribers.append(self._subscriber(poses.velocity_table, self._on_velocity))
        if heard:
            self._subscribers.append(
                rospy.Subscriber(heard.table, _twist(heard), self._on_command, queue_size=100, tcp_nodelay=True)
            )
            empty = message_class("std_msgs/Empty")
            self._subscribers += [
                rospy.Subscriber(action_topic(heard, action), empty, self._on_action, action) for action in ACTIONS
            ]
            self._inbox.extend(self._window.begun(wall_clock()))
            self._subscribers += self._watching()
        if commands:
            _check_alone(rospy, commands.table)
        self._publishers = self._advertise(commands) if commands else {}
        if commands:
            self._await_driver(commands.table)

    @property
    def now(self) -> int:
        """The wall clock [ns]."""
        return wall_clock()

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Publishes a command; see `links.Link`."""
        publisher = self._publishers.get("command")
        if not self._open or self._commands is None or publisher is None:
            raise LinkError("ros1: the link is closed, or was opened for poses only")
        if self._rospy.is_shutdown() or not publisher.get_num_connections():
            raise LinkError(f"ros1: nobody listens to {self._commands.table} any more; is the driver still running?")
        message = fill(publisher.data_class(), self._commands, command)
        if is_stamped(self._commands):
            message.header.stamp = self._rospy.Time(*divmod(wall_clock(), 1_000_000_000))
        publisher.publish(message)
        return command

    def receive(self, until: int) -> list[Sample]:
        """What has come since the last call; see `links.Link`."""
        time.sleep(seconds_until(until))
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def act(self, action: Action) -> None:
        """Publishes std_msgs/Empty on `takeoff` or `land` beside the commands, or closes; see `links.Link`."""
        if action == "close":
            self._close()
            return
        publisher = self._publishers.get(action)
        if not self._open or publisher is None:
            raise LinkError(f"ros1: cannot {action.replace('_', ' ')}: the link is closed, or only listens")
        if not publisher.get_num_connections():
            raise LinkError(
                f"ros1: nobody listens to {publisher.resolved_name}; {action.replace('_', ' ')} by other means"
            )
        publisher.publish(publisher.data_class())

    def _close(self) -> None:
        if self._open:
            self._open = False
            for one in (*self._subscribers, *self._publishers.values()):
                one.unregister()

    def _subscriber(self, topic: str, callback: Any) -> Any:
        kind = _topic_type(self._rospy, topic)
        message = message_class(kind)
        if topic == self._poses.table:
            check_pose(message(), self._poses)
        # without tcp_nodelay the sender's kernel holds small messages back, up to 40 ms
        return self._rospy.Subscriber(topic, message, callback, queue_size=100, tcp_nodelay=True)

    def _watching(self) -> Iterator[Any]:
        """Subscriptions for the card's window; optional conditions that nobody publishes are left out."""
        for topic, conditions in self._window.conditions.items():
            known = dict(self._rospy.get_published_topics())
            if topic not in known and all(one.optional for one in conditions):
                continue
            kind = message_class(_topic_type(self._rospy, topic))
            check_window(kind(), topic, self._window)
            yield self._rospy.Subscriber(topic, kind, self._on_window, topic, queue_size=100, tcp_nodelay=True)

    def _advertise(self, commands: CommandFields) -> dict[str, Any]:
        kinds = {commands.table: ("command", _twist(commands))}
        kinds |= {action_topic(commands, action): (action, message_class("std_msgs/Empty")) for action in ACTIONS}
        return {
            name: self._rospy.Publisher(topic, kind, queue_size=1, tcp_nodelay=True)
            for topic, (name, kind) in kinds.items()
        }

    def _await_driver(self, topic: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not self._publishers["command"].get_num_connections():
            if time.monotonic() > deadline:
                self._close()
                raise LinkError(
                    f"ros1: nobody listens to {topic}; start the driver, or correct the topic in the card's [command]"
                )
            time.sleep(0.02)
        # takeoff and land connect a moment later than the commands; a vehicle without them is flown from the air
        while time.monotonic() < deadline and not all(one.get_num_connections() for one in self._publishers.values()):
            time.sleep(0.02)

    def _on_pose(self, message: Any) -> None:
        self._inbox.extend(pose_samples(message, self._poses, _stamp))

    def _on_command(self, message: Any) -> None:
        if self._heard:
            self._inbox.extend(command_samples(message, self._heard, _stamp))

    def _on_action(self, _message: Any, action: str) -> None:
        self._inbox.extend(action_samples(action, self._window))

    def _on_window(self, message: Any, topic: str) -> None:
        self._inbox.extend(window_samples(message, topic, self._window))

    def _on_velocity(self, message: Any) -> None:
        self._inbox.extend(velocity_samples(message, self._poses, _stamp))


def _twist(commands: CommandFields) -> Any:
    """The class of the messages that carry a card's commands."""
    return message_class("geometry_msgs/TwistStamped" if is_stamped(commands) else "geometry_msgs/Twist")


def _stamp(message: Any) -> int:
    """The stamp of a message's header [ns]."""
    return int(message.header.stamp.to_nsec())


def node() -> Any:
    """The module rospy, with this process as a node.

    Raises:
        LinkError: There is no master.
        ModuleNotFoundError: rospy is not installed.
    """
    rospy = _rospy()
    master = os.environ.get("ROS_MASTER_URI", "")
    try:
        online = importlib.import_module("rosgraph").is_master_online()
    except ValueError as error:
        raise LinkError(f"ros1: {error}; set ROS_MASTER_URI to one such as http://localhost:11311") from error
    if not online:
        raise LinkError(f"ros1: no master at {master or 'ROS_MASTER_URI (not set)'}; start roscore, or set it")
    if not rospy.core.is_initialized():
        # signals stay with `fly`, whose Ctrl-C means hover first
        rospy.init_node("rotorfit", anonymous=True, disable_signals=True)
    return rospy


def _rospy() -> Any:
    """The module rospy; Debian's is also found from a virtual environment.

    Raises:
        ModuleNotFoundError: It is not installed.
    """
    if not importlib.util.find_spec("rospy") and Path(DEBIAN, "rospy").is_dir():
        sys.path.append(DEBIAN)  # last, so that nothing of the environment is shadowed
        importlib.invalidate_caches()
    return importlib.import_module("rospy")


def message_class(kind: str) -> Any:
    """The class of a message type such as `geometry_msgs/Twist`.

    Raises:
        LinkError: Its package is not installed.
    """
    found = importlib.import_module("roslib.message").get_message_class(kind)
    if found is None:
        package = kind.split("/")[0]
        raise LinkError(f"ros1: no message {kind}; install its package (Debian: python3-{package.replace('_', '-')})")
    return found


def _check_alone(rospy: Any, topic: str) -> None:
    """Raises `LinkError` if another node publishes on the topic of the commands."""
    publishers = dict(importlib.import_module("rosgraph").Master(rospy.get_name()).getSystemState()[0])
    if others := sorted(set(publishers.get(rospy.resolve_name(topic), ())) - {rospy.get_name()}):
        raise LinkError(
            f"ros1: {', '.join(others)} sends on {topic} too; end it first (`rosnode cleanup` forgets what has crashed)"
        )


def _topic_type(rospy: Any, topic: str) -> str:
    """Type of a published topic; waits a while for it.

    Raises:
        LinkError: Nobody publishes it; the message names the topics that look like poses.
    """
    deadline = time.monotonic() + PATIENCE
    while True:
        types = dict(rospy.get_published_topics())
        if topic in types:
            return str(types[topic])
        if time.monotonic() > deadline:
            break
        time.sleep(0.1)
    poses = [name for name, kind in types.items() if kind.endswith(("PoseStamped", "TransformStamped", "Odometry"))]
    raise LinkError(f"ros1: nobody publishes {topic}; poses on this graph: {', '.join(sorted(poses)) or 'none'}")
