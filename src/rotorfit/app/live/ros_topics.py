"""ROS topics of the tracked state, for either version: diagnostics, velocity, wind, and all of it as JSON. No commands.

The message types are part of every installation, so nothing has to be built to read them. Unknown values are NaN, or
have no message.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, Protocol

from rotorfit.core.errors import LinkError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Sample
from rotorfit.core.tracked import QUANTITIES, Alarm, Tracked, TrackedAxis
from rotorfit.flying.links import LINKS

PREFIX = "/rotorfit"

DIAGNOSTICS = "/diagnostics"
"""Topic where tools expect diagnostics, whatever the prefix."""

TOPICS = {
    "tracked": "std_msgs/String",
    "alarm": "std_msgs/String",
    "gains": "std_msgs/String",
    "velocity": "geometry_msgs/TwistStamped",
    "disturbance": "geometry_msgs/AccelStamped",
    "wind": "geometry_msgs/Vector3Stamped",
}
"""Topic below the prefix to its type."""

LEVELS = {"known": "OK", "learning": "WARN", "not_identifiable": "WARN", "holding": "STALE", "not_excited": "STALE"}
"""`TrackedAxis.knowledge` to the level of the axis' diagnostics."""

ALARMING = 30.0
"""How long the vehicle's diagnostics are an error after an alarm [s]; then they are a warning."""

SECOND = 1_000_000_000


class _Graph(Protocol):
    """A publishing node of either version."""

    def advertise(self, topic: str, kind: str) -> None:
        """Announces a topic."""

    def message(self, kind: str) -> Any:
        """An empty message of a type such as `std_msgs/String`."""

    def stamp(self, message: Any, at: int) -> None:
        """Sets the stamp of a message's header [ns]."""

    def publish(self, topic: str, message: Any) -> None:
        """Publishes a message."""

    def close(self) -> None:
        """Publishes no more."""


class _Ros1:
    def __init__(self) -> None:
        self._ros = import_module("rotorfit.flying.links.ros1")
        self._rospy = self._ros.node()
        self._publishers: dict[str, Any] = {}

    def advertise(self, topic: str, kind: str) -> None:
        self._publishers[topic] = self._rospy.Publisher(topic, self._ros.message_class(kind), queue_size=10)

    def message(self, kind: str) -> Any:
        return self._ros.message_class(kind)()

    def stamp(self, message: Any, at: int) -> None:
        message.header.stamp = self._rospy.Time(*divmod(at, SECOND))

    def publish(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)

    def close(self) -> None:
        for publisher in self._publishers.values():
            publisher.unregister()


class _Ros2:
    """A node in a context of its own, which a link that breaks and is reopened does not affect."""

    def __init__(self) -> None:
        self._ros = import_module("rotorfit.flying.links.ros2")
        self._rclpy = import_module("rclpy")
        self._context = import_module("rclpy.context").Context()
        self._rclpy.init(context=self._context)
        self._node = self._rclpy.create_node("rotorfit_track", context=self._context)
        self._publishers: dict[str, Any] = {}

    def advertise(self, topic: str, kind: str) -> None:
        self._publishers[topic] = self._node.create_publisher(self._class(kind), topic, 10)

    def message(self, kind: str) -> Any:
        return self._class(kind)()

    def stamp(self, message: Any, at: int) -> None:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, SECOND)

    def publish(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)

    def close(self) -> None:
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)

    def _class(self, kind: str) -> Any:
        return self._ros.message_class(kind.replace("/", "/msg/"))


_GRAPHS: Mapping[str, type[_Ros1] | type[_Ros2]] = {"ros1": _Ros1, "ros2": _Ros2}


class RosTopics:
    """Publishes states and alarms.

    Args:
        where: `ros1` or `ros2`, optionally with a prefix: `ros2:/bebop/model`.
        vehicle: Name of the tracked vehicle, for the diagnostics.

    Raises:
        LinkError: It is neither of them, the prefix is invalid, this shell has no such ROS, or there is no master.
    """

    def __init__(self, where: str, vehicle: str) -> None:
        name, _, prefix = where.partition(":")
        self._prefix, self._vehicle = prefix or PREFIX, vehicle
        if name not in _GRAPHS or not re.fullmatch(r"(/[A-Za-z]\w*)+", self._prefix, re.ASCII):
            raise LinkError(f"--publish {where}: give ros1 or ros2, perhaps with a prefix: ros2:{PREFIX}")
        self._alarm: Alarm | None = None
        try:
            self._graph: _Graph = _GRAPHS[name]()
        except ModuleNotFoundError as error:
            raise LinkError(f"--publish {name} needs the Python package {error.name}: {LINKS[name].install}") from error
        try:
            self._graph.advertise(DIAGNOSTICS, "diagnostic_msgs/DiagnosticArray")
            for topic, kind in TOPICS.items():
                self._graph.advertise(f"{self._prefix}/{topic}", kind)
        except LinkError:
            self._graph.close()
            raise

    def heard(self, _samples: Sequence[Sample], _now: int) -> None:
        """Does nothing: samples have topics already."""

    def state(self, state: Tracked, now: int, held: int) -> None:
        """Publishes a state and its alarms; what it measures is stamped when it held, for a look may take seconds."""
        for alarm in state.alarms:
            self._alarm = alarm
            self._json("alarm", alarm.to_mapping())
        self._json("tracked", state.to_mapping())
        self._diagnose(state, now)
        axes = [state.axes.get(axis, TrackedAxis()) for axis in AXES]
        self._six("velocity", "twist", "world", [axis.velocity for axis in axes], held)
        self._six("disturbance", "accel", "heading", [axis.wind for axis in axes], held)
        if state.air:
            x, y = (state.air.speed * part(state.air.direction) for part in (math.cos, math.sin))
            message = self._stamped("wind", "world", held)
            message.vector.x, message.vector.y, message.vector.z = x, y, 0.0
            self._graph.publish(f"{self._prefix}/wind", message)

    def gains(self, message: Mapping[str, Any], _now: int) -> None:
        """Publishes new gains as JSON, which no controller can mistake for a command."""
        self._json("gains", message)

    def close(self) -> None:
        """Publishes no more."""
        self._graph.close()

    def _json(self, topic: str, mapping: Mapping[str, Any]) -> None:
        message = self._graph.message("std_msgs/String")
        message.data = json.dumps(mapping, allow_nan=False)
        self._graph.publish(f"{self._prefix}/{topic}", message)

    def _stamped(self, topic: str, frame: str, held: int) -> Any:
        message = self._graph.message(TOPICS[topic])
        self._graph.stamp(message, held)
        message.header.frame_id = frame
        return message

    def _six(self, topic: str, field: str, frame: str, values: Sequence[float | None], held: int) -> None:
        """Publishes linear x, y, z and the rate about z; the other rates are unknown."""
        message = self._stamped(topic, frame, held)
        part = getattr(message, field)
        x, y, z, yaw = (math.nan if value is None else value for value in values)
        part.linear.x, part.linear.y, part.linear.z = x, y, z
        part.angular.x, part.angular.y, part.angular.z = math.nan, math.nan, yaw
        self._graph.publish(f"{self._prefix}/{topic}", message)

    def _diagnose(self, state: Tracked, now: int) -> None:
        message = self._graph.message("diagnostic_msgs/DiagnosticArray")
        self._graph.stamp(message, now)
        message.status = [self._of_vehicle(state)]
        message.status += [self._of_axis(name, axis) for name, axis in state.axes.items()]
        self._graph.publish(DIAGNOSTICS, message)

    def _of_vehicle(self, state: Tracked) -> Any:
        alarm = self._alarm
        values = {"time": f"{state.time:.6g}", "regime": str(state.regime + 1)}
        if state.air:
            values |= {"wind speed": f"{state.air.speed:.6g}", "wind direction": f"{state.air.direction:.6g}"}
        if alarm is None:
            return self._status("vehicle", "OK", state.blind or "as it began", values)
        level = "ERROR" if state.time - alarm.raised <= ALARMING else "WARN"
        text = f"changed at {alarm.since[0]:.1f} to {alarm.since[1]:.1f} s: {alarm.named} on {', '.join(alarm.axes)}"
        text += f"; {state.blind}" if state.blind else ""
        values |= {"cause": alarm.cause, "confidence": f"{alarm.confidence:.3g}", "why": alarm.why}
        return self._status("vehicle", level, text, values)

    def _of_axis(self, name: str, axis: TrackedAxis) -> Any:
        values: dict[str, str] = {}
        for quantity in QUANTITIES:
            ends = axis.ci95.get(quantity, (None, None))
            numbers = {"": axis.values.get(quantity), " low": ends[0], " high": ends[1]}
            values |= {f"{quantity}{end}": _text(value) for end, value in numbers.items()}
        values |= {"disturbance": _text(axis.wind), "velocity": _text(axis.velocity), "law": axis.structure}
        values |= {"watched from": _text(axis.watched), "untested": _text(axis.untested)}
        return self._status(name, LEVELS[axis.knowledge], axis.state, values)

    def _status(self, name: str, level: str, text: str, values: Mapping[str, str]) -> Any:
        status = self._graph.message("diagnostic_msgs/DiagnosticStatus")
        status.level = getattr(type(status), level)  # a number in ROS 1, a byte in ROS 2
        status.name, status.message, status.hardware_id = f"rotorfit: {name}", text, self._vehicle
        for key, value in values.items():
            pair = self._graph.message("diagnostic_msgs/KeyValue")
            pair.key, pair.value = key, value
            status.values.append(pair)
        return status


def _text(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.6g}"
