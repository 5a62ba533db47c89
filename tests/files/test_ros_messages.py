"""ROS topics and messages from the card, without ROS; the ROS 2 link on a graph that is made up."""

import importlib.util
import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from rotorfit.core.errors import LinkError
from rotorfit.files.cards import builtin_cards, card_from_mapping, load_card
from rotorfit.flying.links import ros1, ros2
from rotorfit.flying.links.card_fields import PoseFields
from rotorfit.flying.links.link import wall_clock
from rotorfit.flying.links.opening import open_link
from rotorfit.flying.links.ros_messages import (
    action_topic,
    check_pose,
    fill,
    is_stamped,
    pose_samples,
    poses_of_type,
    ros_commands,
    ros_poses,
)


def pose_in(message: SimpleNamespace, fields: PoseFields) -> tuple[float, ...]:
    return pose_samples(message, fields, lambda _: 5)[0].values


def vector(**fields: float) -> SimpleNamespace:
    return SimpleNamespace(**({"x": 0.0, "y": 0.0, "z": 0.0} | fields))


def twist() -> Any:
    return SimpleNamespace(linear=vector(), angular=vector())


def twist_stamped() -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0)), twist=twist())


def pose_stamped(x: float = 1.0) -> Any:
    pose = SimpleNamespace(position=vector(x=x, y=2.0, z=3.0), orientation=vector(w=1.0))
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=7)), pose=pose)


def test_commands_of_bebop_autonomy_are_a_twist_with_take_off_and_landing_beside_it() -> None:
    fields = ros_commands(builtin_cards()["bebop2"])
    message = fill(twist(), fields, (0.1, 0.2, -0.3, 0.4))

    assert (fields.table, is_stamped(fields)) == ("/bebop/cmd_vel", False)
    assert vars(message.linear) == {"x": 0.1, "y": 0.2, "z": -0.3}
    assert vars(message.angular) == {"x": 0.0, "y": 0.0, "z": 0.4}
    assert [action_topic(fields, action) for action in ("take_off", "land")] == ["/bebop/takeoff", "/bebop/land"]


def test_columns_that_begin_with_twist_are_a_twist_stamped() -> None:
    fields = ros_commands(builtin_cards()["bebop2-optitrack"])

    assert is_stamped(fields)
    assert fill(twist_stamped(), fields, (0.1, 0.2, -0.3, 0.4)).twist.angular.z == 0.4


@pytest.mark.parametrize("card", ["tello", "bebop2-wsu", "bebop2-joystick"])
def test_cards_whose_columns_are_no_topics_are_refused(card: str) -> None:
    with pytest.raises(LinkError, match=r"Twist|all channels in one message"):
        ros_commands(builtin_cards()[card])


def test_a_field_that_a_twist_does_not_have_is_refused() -> None:
    raw = builtin_cards()["bebop2"].raw
    raw = {**raw, "command": {"time": "/c:log_time", "x": "/c:linear.forward"}}

    with pytest.raises(LinkError, match="not a field of a Twist"):
        ros_commands(card_from_mapping(raw, "test"))


def test_poses_of_the_cards_are_read_from_their_messages() -> None:
    cards = builtin_cards()
    odometry = SimpleNamespace(pose=pose_stamped(), twist=SimpleNamespace(twist=twist()))
    odometry.twist.twist.linear.x = 0.5
    transform = SimpleNamespace(transform=SimpleNamespace(translation=vector(x=4.0), rotation=vector(w=1.0)))

    assert pose_in(pose_stamped(), ros_poses(cards["bebop2-optitrack"])) == (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    assert pose_in(odometry, ros_poses(cards["bebop2-odometry"])) == (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    assert pose_in(transform, ros_poses(cards["bebop2-drone-dev"])) == (4.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    pose, velocity = pose_samples(odometry, ros_poses(cards["bebop2-odometry"]), lambda _: 5)
    assert (pose.stream, velocity.stream) == ("pose", "velocity")
    assert velocity.values[:3] == (0.5, 0.0, 0.0)
    assert ros_poses(cards["bebop2-drone-dev"]).table == "/vicon/bebop/bebop"


def test_a_message_without_the_cards_fields_is_refused_by_name() -> None:
    with pytest.raises(LinkError, match=r"/vicon/bebop2/bebop2 is a SimpleNamespace and has no field 'transform"):
        check_pose(pose_stamped(), ros_poses(builtin_cards()["bebop2"]))


@pytest.mark.parametrize("kind", ["geometry_msgs/PoseStamped", "geometry_msgs/msg/PoseStamped", "PoseStamped"])
def test_a_pose_without_a_card_is_read_by_its_type(kind: str) -> None:
    assert pose_in(pose_stamped(), poses_of_type("/pose", kind)) == (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)


def test_another_type_of_pose_is_refused() -> None:
    with pytest.raises(LinkError, match="PoseStamped, TransformStamped, Odometry"):
        poses_of_type("/pose", "geometry_msgs/Pose2D")


# ROS 1 and 2 without their libraries


def test_without_rclpy_one_line_says_what_to_source() -> None:
    if importlib.util.find_spec("rclpy"):
        pytest.skip("rclpy is here")
    with pytest.raises(LinkError, match=r"needs the Python package rclpy.*source /opt/ros"):
        open_link("ros2", load_card("bebop2"))


def test_without_rospy_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rospy", None)
    monkeypatch.setattr(ros1.importlib.util, "find_spec", lambda _: object())
    with pytest.raises(LinkError, match=r"needs the Python package rospy.*python3-rospy"):
        open_link("ros1", load_card("bebop2"))


def test_an_address_is_refused_where_the_environment_names_the_graph() -> None:
    with pytest.raises(LinkError, match="ROS_MASTER_URI"):
        open_link("ros1:http://host:11311", load_card("bebop2"))
    with pytest.raises(LinkError, match="ROS_DOMAIN_ID"):
        open_link("ros2:7", load_card("bebop2"))


class Graph(ModuleType):
    """A made-up rclpy: one publisher of poses, as many listeners as `listeners` says."""

    def __init__(self) -> None:
        super().__init__("rclpy")
        self.listeners = 1
        self.sent: list[tuple[str, Any]] = []
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.running = False

    def init(self, signal_handler_options: str) -> None:
        assert signal_handler_options == "none of its own"  # Ctrl-C stays ours
        self.running = True

    def shutdown(self) -> None:
        assert self.running
        self.running = False

    def create_node(self, _name: str) -> "Graph":
        return self

    def destroy_node(self) -> None: ...

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [("/rigid_body_1/pose", ["geometry_msgs/msg/PoseStamped"])]

    def create_subscription(self, _kind: Any, topic: str, callback: Any, _quality: Any) -> None:
        self.callbacks[topic] = callback

    def create_publisher(self, _kind: Any, topic: str, _depth: int) -> Any:
        return SimpleNamespace(
            topic_name=topic,
            get_subscription_count=lambda: self.listeners,
            publish=lambda message: self.sent.append((topic, message)),
        )

    def spin_once(self, _node: Any, timeout_sec: float) -> None:
        end = wall_clock() + round(1e9 * timeout_sec)
        for callback in self.callbacks.values():
            callback(pose_stamped())
        while wall_clock() < end:
            pass


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    made = Graph()
    monkeypatch.setitem(sys.modules, "rclpy", made)
    monkeypatch.setitem(sys.modules, "rclpy.qos", SimpleNamespace(qos_profile_sensor_data=None))  # type: ignore[arg-type]
    signals = SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO="none of its own"))
    monkeypatch.setitem(sys.modules, "rclpy.signals", signals)  # type: ignore[arg-type]
    geometry = SimpleNamespace(Twist=twist, TwistStamped=twist_stamped, PoseStamped=pose_stamped)
    monkeypatch.setitem(sys.modules, "geometry_msgs.msg", geometry)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "std_msgs.msg", SimpleNamespace(Empty=SimpleNamespace))  # type: ignore[arg-type]
    monkeypatch.setattr(ros2, "PATIENCE", 0.1)
    return made


def test_ros2_sends_receives_acts_and_closes_once(graph: Graph) -> None:
    link = open_link("ros2", load_card("bebop2-optitrack"))
    link.act("take_off")
    link.send((0.1, 0.0, 0.0, 0.0))
    samples = link.receive(link.now + 1_000_000)
    link.act("close")
    link.act("close")

    assert [topic for topic, _ in graph.sent] == ["/data_logger/takeoff", "/data_logger/cmd_vel"]
    assert graph.sent[1][1].twist.linear.x == 0.1
    assert graph.sent[1][1].header.stamp.sec > 1_700_000_000
    assert (samples[0].stamp, samples[0].values[:3]) == (5_000_000_007, (1.0, 2.0, 3.0))
    assert not graph.running


def test_ros2_says_when_the_driver_is_gone(graph: Graph) -> None:
    link = open_link("ros2", load_card("bebop2-optitrack"))
    graph.listeners = 0

    with pytest.raises(LinkError, match="nobody listens to /data_logger/cmd_vel any more"):
        link.send((0.1, 0.0, 0.0, 0.0))
    link.act("close")


def test_ros2_says_when_nobody_listens_or_publishes_and_leaves_nothing_running(graph: Graph) -> None:
    graph.listeners = 0
    with pytest.raises(LinkError, match="nobody listens to /data_logger/cmd_vel; start the driver"):
        open_link("ros2", load_card("bebop2-optitrack"))
    graph.listeners = 1
    with pytest.raises(LinkError, match="nobody publishes /vicon/bebop2/bebop2"):
        open_link("ros2", load_card("bebop2"))

    assert not graph.running
