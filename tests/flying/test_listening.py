"""Links that listen: commands of others are heard, and nothing is sent but what is needed to be heard."""

import math
import sys
import time
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from itertools import pairwise
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.files.cards import builtin_cards, card_from_mapping
from rotorfit.flying.links.link import wall_clock
from rotorfit.flying.links.opening import open_listener
from rotorfit.flying.listening import Heard, Listening

SECOND = 1_000_000_000
BEBOP = builtin_cards()["bebop2"]


def twist(**parts: float) -> SimpleNamespace:
    linear = SimpleNamespace(**{axis: parts.get(axis, 0.0) for axis in "xyz"})
    return SimpleNamespace(linear=linear, angular=SimpleNamespace(x=0.0, y=0.0, z=parts.get("yaw", 0.0)))


def state(mode: int = 0, name: str = "") -> SimpleNamespace:
    return SimpleNamespace(mode=mode, name=name)


class Graph:
    """A ROS graph of either version that remembers who subscribes, and that nobody publishes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.heard: dict[str, Callable[..., None]] = {}
        self.published: list[str] = []
        self.begun: list[dict[str, Any]] = []
        self.extra: dict[str, Any] = {}
        for name, module in {**self.ros1(), **self.ros2()}.items():
            monkeypatch.setitem(sys.modules, name, module)

    def pose(self) -> SimpleNamespace:
        header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0, to_nsec=lambda: 0))
        at, turn = SimpleNamespace(x=1.0, y=2.0, z=3.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        part = SimpleNamespace(position=at, orientation=turn, translation=at, rotation=turn)
        return SimpleNamespace(header=header, pose=part, transform=part)

    def kind(self, name: str) -> Any:
        return {"Twist": twist, "Empty": SimpleNamespace, "State": state}.get(name.rpartition("/")[2], self.pose)

    def subscribe(self, topic: str, _kind: Any, callback: Any, *extra: Any, **_: Any) -> Any:
        self.heard[topic] = lambda message: callback(message, *extra)
        return SimpleNamespace(unregister=lambda: None)

    def publish(self, topic: str, *_: Any, **__: Any) -> Any:
        self.published.append(topic)
        raise AssertionError("a listener publishes nothing")

    def ros1(self) -> dict[str, ModuleType]:
        rospy, graph, lib = ModuleType("rospy"), ModuleType("rosgraph"), ModuleType("roslib.message")
        rospy.__spec__ = ModuleSpec("rospy", None)
        rospy.core = SimpleNamespace(is_initialized=lambda: True)  # type: ignore[attr-defined]
        topic = self.topic()
        rospy.get_published_topics = lambda: [  # type: ignore[attr-defined]
            [topic, "geometry_msgs/TransformStamped"], ["/state", "other_msgs/State"]
        ]  # fmt: skip
        rospy.Subscriber, rospy.Publisher = self.subscribe, self.publish  # type: ignore[attr-defined]
        graph.is_master_online = lambda: True  # type: ignore[attr-defined]
        lib.get_message_class = self.kind  # type: ignore[attr-defined]
        return {"rospy": rospy, "rosgraph": graph, "roslib": ModuleType("roslib"), "roslib.message": lib}

    def ros2(self) -> dict[str, ModuleType]:
        rclpy, qos, signals = ModuleType("rclpy"), ModuleType("rclpy.qos"), ModuleType("rclpy.signals")
        signals.SignalHandlerOptions = SimpleNamespace(NO="ours stay")  # type: ignore[attr-defined]
        topic = self.topic()
        node = SimpleNamespace(
            get_topic_names_and_types=lambda: [
                (topic, ["geometry_msgs/msg/TransformStamped"]),
                ("/state", ["other_msgs/msg/State"]),
            ],
            create_subscription=lambda kind, name, callback, _: self.subscribe(name, kind, callback),
            create_publisher=self.publish,
            destroy_node=lambda: None,
        )
        rclpy.shutdown, rclpy.create_node = (lambda: None), lambda _: node  # type: ignore[attr-defined]
        rclpy.init = lambda **options: self.begun.append(options)  # type: ignore[attr-defined]
        rclpy.spin_once = lambda _node, **_: None  # type: ignore[attr-defined]
        qos.qos_profile_sensor_data = SimpleNamespace(reliability=1, durability=1)  # type: ignore[attr-defined]
        qos.QoSProfile = SimpleNamespace  # type: ignore[attr-defined]
        out = {"rclpy": rclpy, "rclpy.qos": qos, "rclpy.signals": signals}
        kinds = {"geometry_msgs": ("Twist", "TransformStamped"), "std_msgs": ("Empty",), "other_msgs": ("State",)}
        for package, names in kinds.items():
            out[f"{package}.msg"] = ModuleType(f"{package}.msg")
            for name in names:
                setattr(out[f"{package}.msg"], name, self.kind(name))
        return out

    @staticmethod
    def topic() -> str:
        return str(BEBOP.pose["x"].source).partition(":")[0]


@pytest.mark.parametrize("name", ["ros1", "ros2"])
def test_a_listener_on_ros_hears_commands_poses_and_landings_and_publishes_nothing(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph = Graph(monkeypatch)
    link = open_listener(name, BEBOP)
    assert graph.begun == ([{"signal_handler_options": "ours stay"}] if name == "ros2" else [])
    graph.heard["/bebop/cmd_vel"](twist(x=0.25, y=-0.5, z=1.0, yaw=0.1))
    graph.heard[graph.topic()](graph.pose())
    graph.heard["/bebop/land"](None)
    samples = link.receive(link.now)

    assert [one.stream for one in samples] == ["command", "pose", "obeys"]
    assert samples[0].values == (0.25, -0.5, 1.0, 0.1)
    assert samples[2].values == (0.0,)
    with pytest.raises(LinkError):
        link.send((0.0, 0.0, 0.0, 0.0))
    with pytest.raises(LinkError):
        link.act("land")
    assert not graph.published


def with_window(*conditions: dict[str, Any]) -> Card:
    return card_from_mapping({**BEBOP.raw, "window": list(conditions)}, "bebop2")


@pytest.mark.parametrize("name", ["ros1", "ros2"])
def test_the_window_of_the_card_is_watched_on_ros(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = Graph(monkeypatch)
    missing = {"when": "/elsewhere:mode", "optional": True}
    link = open_listener(name, with_window({"when": "/state:mode", "equals": [4, 5]}, missing))
    for mode in (3, 4, 5, 3):
        graph.heard["/state"](state(mode))
    graph.heard["/state"](state(4))
    graph.heard["/bebop/land"](None)

    assert [one.values for one in link.receive(link.now)] == [(0.0,), (1.0,), (0.0,), (1.0,), (0.0,)]
    assert "/elsewhere" not in graph.heard


@pytest.mark.parametrize("name", ["ros1", "ros2"])
@pytest.mark.parametrize("field", ["name", "nothing"])
def test_a_window_of_what_is_no_number_is_refused(name: str, field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Graph(monkeypatch)
    with pytest.raises(LinkError, match=rf"/state has no number '{field}' for \[window\]"):
        open_listener(name, with_window({"when": f"/state:{field}"}))


def test_a_tello_cannot_be_shared() -> None:
    with pytest.raises(LinkError, match="one controller alone"):
        open_listener("tello", builtin_cards()["tello"])


class Scripted:
    """A link that gives a pose every tenth of a second, is silent at times, and takes no commands."""

    live = False

    def __init__(self, silent: Callable[[float], bool]) -> None:
        self.now, self.silent = 0, silent

    def receive(self, until: int) -> list[Sample]:
        self.now = until
        pose = Sample("pose", until, until, (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0))
        return [] if self.silent(until / SECOND) else [pose]

    def send(self, _command: Any) -> None:
        raise AssertionError("a listener sends nothing")

    def act(self, _action: Any) -> None:
        pass


def heard(listening: Listening) -> tuple[list[Heard], list[str]]:
    batches = list(listening)
    return batches, [one.news for one in batches if one.news]


def test_a_peer_that_goes_and_comes_back_is_waited_for() -> None:
    listening = Listening(lambda: Scripted(lambda t: 5 < t < 9), 10.0, 20.0, 1e6)  # type: ignore[arg-type,return-value]
    batches, news = heard(listening)

    assert len(news) == 2
    assert news[1] == "poses come again"
    assert not listening.lost
    assert batches[-1].now == pytest.approx(20 * SECOND, abs=SECOND)


def test_one_that_stays_away_ends_it() -> None:
    listening = Listening(lambda: Scripted(lambda t: t > 5), 4.0, None, 1e6)  # type: ignore[arg-type,return-value]
    heard(listening)

    assert listening.lost
    assert "no pose for 4 s" in listening.ended


def test_the_operator_ends_it() -> None:
    pressed = iter(["", "", "Ctrl-C"])
    listening = Listening(lambda: Scripted(lambda _: False), 4.0, None, 1e6, lambda: next(pressed))  # type: ignore[arg-type,return-value]
    batches, _ = heard(listening)

    assert (len(batches), listening.ended, listening.lost) == (3, "Ctrl-C", False)


class Breaking(Scripted):
    """A live link whose connection breaks once, on the clock of the process."""

    live = True
    opened = 0

    def __init__(self) -> None:
        super().__init__(lambda _: False)
        Breaking.opened += 1
        self.calls, self.now = 0, wall_clock()

    def receive(self, _until: int) -> list[Sample]:
        self.calls += 1
        time.sleep(0.005)
        if Breaking.opened == 1 and self.calls > 2:
            raise LinkError("the other end closed the connection")
        return super().receive(wall_clock())


def test_a_connection_that_breaks_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rotorfit.flying.listening.RETRY", 0.01)
    Breaking.opened = 0
    pressed = iter([""] * 8 + ["Ctrl-C"] * 100)
    listening = Listening(Breaking, 4.0, None, 1.0, lambda: next(pressed))  # type: ignore[arg-type]
    _, news = heard(listening)

    assert Breaking.opened == 2
    assert "waiting for it" in news[0]
    assert "the link is back" in news[1:]


class Steady(Scripted):
    """A live link that never breaks."""

    live = True

    def receive(self, _until: int) -> list[Sample]:
        time.sleep(0.005)
        return super().receive(wall_clock())


def test_what_came_while_nobody_took_it_is_handed_over_after_the_operator_has_ended_it() -> None:
    listening = Listening(lambda: Steady(lambda _: False), 4.0, None, 1.0, lambda: "Ctrl-C")  # type: ignore[arg-type,return-value]
    batches = iter(listening)
    next(batches)
    time.sleep(0.5)
    began = wall_clock()
    stamps = [sample.stamp for batch in batches for sample in batch.samples]

    assert listening.ended == "Ctrl-C"
    assert sum(stamp < began for stamp in stamps) > 10
    assert stamps[-1] - began < 0.2 * SECOND


class Faulty(Breaking):
    """A live link with a bug."""

    def receive(self, _until: int) -> list[Sample]:
        raise ZeroDivisionError


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # it is what is wanted
def test_a_bug_in_the_thread_that_listens_ends_it_and_is_not_waited_for() -> None:
    with pytest.raises(RuntimeError, match="has failed"):
        heard(Listening(Faulty, 4.0, None, 1.0))


def test_the_simulated_pilot_stays_in_its_place_and_excites_every_axis() -> None:
    from rotorfit.files.cards import card_from_mapping
    from rotorfit.simulation.vehicle import load_vehicle

    vehicle = load_vehicle("bebop2")
    link = open_listener("sim,gusts=0.2", card_from_mapping(vehicle.card(), "bebop2"))
    samples = link.receive(link.now + 70 * SECOND)
    poses = np.array([one.values[:3] for one in samples if one.stream == "pose"])
    commands = np.array([one.values for one in samples if one.stream == "command"])

    assert (np.ptp(poses, axis=0) < 3.0).all()
    assert poses[:, 2].min() > 0.3
    assert (commands.std(axis=0) > 0.05).all()
    with pytest.raises(LinkError):
        link.send((0.0, 0.0, 0.0, 0.0))


def test_a_log_is_heard_with_its_commands(tmp_path: Any) -> None:
    from flying import CARD, flown, plan_of, room_link

    path = tmp_path / "flight.mcap"
    flown(room_link(), path, plan_of(4.0), land=False)
    from rotorfit.diagnosis.card_choice import card_of
    from rotorfit.files.logs import read

    link = open_listener(f"replay:{path}", card_of(read(path)))
    samples = link.receive(link.now + 60 * SECOND)

    assert {one.stream for one in samples} == {"pose", "command"}
    assert all(a.received <= b.received for a, b in pairwise(samples))
    assert CARD.command.keys() == {"x", "y", "z", "yaw"}
    assert math.isclose(sum(one.stream == "command" for one in samples), 200, abs_tol=60)
