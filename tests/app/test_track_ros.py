"""`rotorfit track --publish`: all that leaves on ROS, by name and type; what a diagnostics tool sees; no commands."""

import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from rotorfit.app.cli import main
from rotorfit.app.live.ros_topics import ALARMING, RosTopics
from rotorfit.core.errors import LinkError
from rotorfit.core.tracked import Air, Alarm, Tracked, TrackedAxis
from rotorfit.tracking.tracker import Tracker

NOW, HELD = 9_000_000_000, 7_000_000_123
ALARM = Alarm(3.0, ("x",), "payload", (1.0, 2.0), {"x.input": (0.8, 0.9)}, 0.9, 1e-9, "because")
STANDARD = {
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/rotorfit/tracked": "std_msgs/String",
    "/rotorfit/alarm": "std_msgs/String",
    "/rotorfit/gains": "std_msgs/String",
    "/rotorfit/velocity": "geometry_msgs/TwistStamped",
    "/rotorfit/disturbance": "geometry_msgs/AccelStamped",
    "/rotorfit/wind": "geometry_msgs/Vector3Stamped",
}
"""All that may leave."""


def six() -> SimpleNamespace:
    return SimpleNamespace(linear=SimpleNamespace(), angular=SimpleNamespace())


def header() -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")


class Status(SimpleNamespace):
    OK, WARN, ERROR, STALE = b"\0", b"\1", b"\2", b"\3"  # as in ROS 2; in ROS 1 they are numbers


MADE: dict[str, Callable[[], Any]] = {
    "DiagnosticArray": lambda: SimpleNamespace(header=header(), status=[]),
    "DiagnosticStatus": lambda: Status(values=[]),
    "KeyValue": SimpleNamespace,
    "String": SimpleNamespace,
    "TwistStamped": lambda: SimpleNamespace(header=header(), twist=six()),
    "AccelStamped": lambda: SimpleNamespace(header=header(), accel=six()),
    "Vector3Stamped": lambda: SimpleNamespace(header=header(), vector=SimpleNamespace()),
}


class Graph:
    """ROS of either version that remembers who publishes what; whatever else a node can do is not there."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.kinds: dict[str, str] = {}
        self.sent: list[tuple[str, Any]] = []
        self.closed: list[str] = []
        for name, module in {**self.ros1(), **self.ros2()}.items():
            monkeypatch.setitem(sys.modules, name, module)

    def publisher(self, kind: Any, topic: str, *_: Any, **__: Any) -> SimpleNamespace:
        self.kinds[topic] = kind.ros_name.replace("/msg/", "/")
        return SimpleNamespace(
            publish=lambda message: self.sent.append((topic, message)), unregister=lambda: self.closed.append(topic)
        )

    @staticmethod
    def made(kind: str) -> Any:
        make = MADE[kind.rpartition("/")[2]]
        return type(kind, (), {"ros_name": kind, "__new__": lambda _: make()})

    def ros1(self) -> dict[str, ModuleType]:
        rospy, graph, lib = ModuleType("rospy"), ModuleType("rosgraph"), ModuleType("roslib.message")
        rospy.__spec__ = SimpleNamespace(name="rospy")  # type: ignore[assignment]
        rospy.core = SimpleNamespace(is_initialized=lambda: True)  # type: ignore[attr-defined]
        rospy.Time = lambda sec, nanosec: SimpleNamespace(sec=sec, nanosec=nanosec)  # type: ignore[attr-defined]
        rospy.Publisher = lambda topic, kind, **_: self.publisher(kind, topic)  # type: ignore[attr-defined]
        graph.is_master_online = lambda: True  # type: ignore[attr-defined]
        lib.get_message_class = self.made  # type: ignore[attr-defined]
        return {"rospy": rospy, "rosgraph": graph, "roslib": ModuleType("roslib"), "roslib.message": lib}

    def ros2(self) -> dict[str, ModuleType]:
        rclpy, context = ModuleType("rclpy"), ModuleType("rclpy.context")
        node = SimpleNamespace(create_publisher=self.publisher, destroy_node=lambda: self.closed.append("node"))
        rclpy.init = lambda **_: None  # type: ignore[attr-defined]
        rclpy.shutdown = lambda **_: self.closed.append("context")  # type: ignore[attr-defined]
        rclpy.create_node = lambda _, **__: node  # type: ignore[attr-defined]
        context.Context = SimpleNamespace  # type: ignore[attr-defined]
        out = {"rclpy": rclpy, "rclpy.context": context}
        for kind in {*STANDARD.values(), "diagnostic_msgs/DiagnosticStatus", "diagnostic_msgs/KeyValue"}:
            package, _, name = kind.partition("/")
            module = out.setdefault(f"{package}.msg", ModuleType(f"{package}.msg"))
            setattr(module, name, self.made(f"{package}/msg/{name}"))
        return out

    def on(self, topic: str) -> list[Any]:
        return [message for where, message in self.sent if where == topic]

    def levels(self) -> dict[str, tuple[bytes, str]]:
        """Name to level and words, of the last diagnostics."""
        return {one.name: (one.level, one.message) for one in self.on("/diagnostics")[-1].status}


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    return Graph(monkeypatch)


def a_state(time: float, *alarms: Alarm) -> Tracked:
    values = {"input": 3.7, "damping": 0.2, "delay": None}
    known = TrackedAxis("known", "known", values, {"input": (3.6, 3.8)}, wind=0.1, velocity=1.5, watched=1.0)
    axes = {
        "x": known,
        "y": TrackedAxis("not_identifiable", "not identifiable"),
        "z": TrackedAxis("holding", "holding (no excitation for 12 s)", values),
        "yaw": TrackedAxis("not_excited", "not excited"),
    }
    return Tracked(time, axes, alarms, len(alarms), air=Air(2.0, (1.0, 3.0), math.pi / 2, (1.0, 2.0)))


@pytest.mark.parametrize("ros", ["ros1", "ros2"])
def test_what_is_known_leaves_on_standard_messages_and_nothing_else_does(ros: str, graph: Graph) -> None:
    topics = RosTopics(ros, "mavlink")
    topics.state(a_state(5.0, ALARM), NOW, HELD)
    topics.gains({"type": "gains"}, NOW)
    topics.close()

    assert graph.kinds == STANDARD
    assert {topic for topic, _ in graph.sent} == set(STANDARD)
    assert json.loads(graph.on("/rotorfit/tracked")[0].data)["type"] == "state"
    assert json.loads(graph.on("/rotorfit/alarm")[0].data)["cause"] == "payload"
    (velocity,), (push,), (wind,) = (graph.on(f"/rotorfit/{name}") for name in ("velocity", "disturbance", "wind"))
    assert velocity.twist.linear.x == 1.5
    assert math.isnan(velocity.twist.angular.z)
    assert (velocity.header.frame_id, push.header.frame_id, wind.header.frame_id) == ("world", "heading", "world")
    assert push.accel.linear.x == 0.1
    assert (wind.vector.x, wind.vector.y) == pytest.approx((0.0, 2.0))
    assert {(one.header.stamp.sec, one.header.stamp.nanosec) for one in (velocity, push, wind)} == {(7, 123)}
    assert graph.on("/diagnostics")[0].header.stamp.sec == 9  # which tools judge as stale
    (time,) = [one.value for one in graph.on("/diagnostics")[0].status[0].values if one.key == "time"]
    assert time == "5"
    assert set(graph.closed) == (set(STANDARD) if ros == "ros1" else {"node", "context"})


def test_diagnostics_say_what_is_known_of_each_axis(graph: Graph) -> None:
    RosTopics("ros2", "mavlink").state(a_state(5.0), NOW, HELD)

    assert graph.levels() == {
        "rotorfit: vehicle": (Status.OK, "not yet watched for changes: y, z, yaw"),
        "rotorfit: x": (Status.OK, "known"),
        "rotorfit: y": (Status.WARN, "not identifiable"),
        "rotorfit: z": (Status.STALE, "holding (no excitation for 12 s)"),
        "rotorfit: yaw": (Status.STALE, "not excited"),
    }
    x = graph.on("/diagnostics")[0].status[1]
    values = {pair.key: pair.value for pair in x.values}
    assert x.hardware_id == "mavlink"
    assert (values["input"], values["input low"], values["input high"]) == ("3.7", "3.6", "3.8")
    assert values["delay"] == "unknown"
    assert values["watched from"] == "1"


def test_an_alarm_is_an_error_for_a_while_and_a_warning_from_then_on(graph: Graph) -> None:
    topics = RosTopics("ros1", "sim")
    seen = []
    for state in (a_state(2.0), a_state(3.0, ALARM), a_state(3.0 + ALARMING), a_state(4.0 + ALARMING)):
        topics.state(state, NOW, HELD)
        seen.append(graph.levels()["rotorfit: vehicle"])

    assert [level for level, _ in seen] == [Status.OK, Status.ERROR, Status.ERROR, Status.WARN]
    assert seen[-1][1] == "changed at 1.0 to 2.0 s: payload on x; not yet watched for changes: y, z, yaw"
    assert len(graph.on("/rotorfit/alarm")) == 1


def test_a_revised_alarm_takes_the_place_of_the_first_and_is_no_new_error(graph: Graph) -> None:
    topics, revised = (
        RosTopics("ros2", "sim"),
        replace(ALARM, time=ALARM.time + 1.0, cause="thrust", revises=ALARM.time),
    )
    for state in (a_state(3.0, ALARM), a_state(4.0, revised), a_state(ALARM.time + ALARMING + 0.5)):
        topics.state(state, NOW, HELD)

    assert graph.levels()["rotorfit: vehicle"] == (
        Status.WARN,
        "changed at 1.0 to 2.0 s: thrust on x; not yet watched for changes: y, z, yaw",
    )
    assert [json.loads(one.data)["revises"] for one in graph.on("/rotorfit/alarm")] == [None, ALARM.time]


@pytest.mark.parametrize("where", ["ros3", "ros2:rotorfit", "ros2:/", "ros2:/a b", "ros1:/cmd/", ""])
def test_a_place_that_is_none_is_one_line(where: str, graph: Graph) -> None:
    with pytest.raises(LinkError, match="give ros1 or ros2, perhaps with a prefix: ros2:/rotorfit"):
        RosTopics(where, "sim")
    assert not graph.kinds


def test_a_prefix_is_kept_and_diagnostics_stay_where_tools_look(graph: Graph) -> None:
    RosTopics("ros2:/bebop/model", "sim")

    assert set(graph.kinds) == {name.replace("/rotorfit/", "/bebop/model/") for name in STANDARD}


def test_without_ros_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    result = CliRunner().invoke(main, ["track", "--link", "sim", "--for", "1", "--publish", "ros2"])

    assert result.exit_code == 1
    assert "--publish ros2 needs the Python package rclpy: run in a shell of a ROS 2 installation" in result.stderr


@pytest.mark.usefixtures("looks_here")
def test_a_simulated_vehicle_reaches_the_topics(graph: Graph) -> None:
    words = ["track", "--link", "sim", "--for", "7", "--pace", "1000", "--structure", "first_order_delay"]
    result = CliRunner().invoke(main, [*words, "--publish", "ros2"])

    assert result.exit_code == 0, result.output
    assert len(graph.on("/diagnostics")) >= 2
    assert {one.name for one in graph.on("/diagnostics")[-1].status} == {
        f"rotorfit: {name}" for name in ("vehicle", "x", "y", "z", "yaw")
    }


@pytest.mark.usefixtures("looks_here")
def test_what_a_late_look_tells_is_stamped_when_it_held(monkeypatch: pytest.MonkeyPatch, graph: Graph) -> None:
    """Looks here come two seconds after the samples that they describe."""
    news, ready = Tracker.news, list[Tracked]()

    def late(tracker: Tracker) -> list[Tracked]:
        ready.extend(news(tracker))
        now = tracker._growing.now
        found = [one for one in ready if now - one.time > 2.0 or tracker._end]
        ready[:] = [one for one in ready if one not in found]
        return found

    monkeypatch.setattr(Tracker, "news", late)
    words = ["track", "--link", "sim", "--for", "7", "--pace", "1000", "--structure", "first_order_delay", "--jsonl"]
    result = CliRunner().invoke(main, [*words, "--publish", "ros2"])

    assert result.exit_code == 0, result.output
    times = [json.loads(one.data)["time"] for one in graph.on("/rotorfit/tracked")]
    stamps = [one.header.stamp for one in graph.on("/rotorfit/velocity")]
    seconds = [one.sec + 1e-9 * one.nanosec for one in stamps]
    assert len(seconds) >= 3
    assert [one - seconds[0] for one in seconds] == pytest.approx([one - times[0] for one in times], abs=1e-6)
