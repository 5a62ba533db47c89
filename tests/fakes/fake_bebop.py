"""A fake Bebop 2 on ROS 1: the topics of bebop_autonomy, and a pose as PoseStamped, TransformStamped or Odometry."""

import threading
import time
from typing import Any

import rospy
from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
from live_room import LiveRoom, arguments, run_until_told
from nav_msgs.msg import Odometry
from std_msgs.msg import Empty

from rotorfit.simulation.sensors import Mocap

MOCAP = Mocap()
KINDS = {"PoseStamped": PoseStamped, "TransformStamped": TransformStamped, "Odometry": Odometry}


def fill(message: Any, pose: tuple[float, ...], wall: int) -> Any:
    """Writes a pose into a message of one of the KINDS."""
    message.header.stamp = rospy.Time(*divmod(wall, 1_000_000_000))
    message.header.frame_id = "world"
    place, turn = {
        "PoseStamped": lambda: (message.pose.position, message.pose.orientation),
        "TransformStamped": lambda: (message.transform.translation, message.transform.rotation),
        "Odometry": lambda: (message.pose.pose.position, message.pose.pose.orientation),
    }[type(message).__name__.rpartition("__")[2]]()
    place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z = pose
    return message


class Node:
    """Callbacks run in threads of rospy; one lock keeps the room whole."""

    def __init__(self, room: LiveRoom, kind: str, topic: str, slow: float = 0.0) -> None:
        self._room, self._kind, self._slow = room, KINDS[kind], slow
        self._lock = threading.Lock()
        self._poses = rospy.Publisher(topic, self._kind, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber("/bebop/cmd_vel", Twist, self._command, queue_size=1, tcp_nodelay=True)
        rospy.Subscriber("/bebop/takeoff", Empty, lambda _: self._locked(room.take_off))
        rospy.Subscriber("/bebop/land", Empty, lambda _: self._locked(room.land))

    def step(self) -> None:
        with self._lock:
            samples = self._room.samples()
        for sample in samples:
            if sample.stream == "pose":
                self._poses.publish(fill(self._kind(), sample.values, self._room.wall(sample.stamp)))
        time.sleep(0.002)

    def _command(self, twist: Twist) -> None:
        time.sleep(self._slow)
        values = (twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z)
        self._locked(lambda: self._room.send(values))

    def _locked(self, act: Any) -> None:
        with self._lock:
            act()


def main() -> None:
    parser, make = arguments("bebop2", MOCAP)
    parser.add_argument("--kind", default="PoseStamped", choices=KINDS)
    parser.add_argument("--topic", default="/rigid_body_1/pose")
    parser.add_argument("--slow", type=float, default=0.0, help="time that the driver takes for each command [s]")
    options = parser.parse_args()
    rospy.init_node("fake_bebop", disable_signals=True)
    room = make(options)
    run_until_told(Node(room, options.kind, options.topic, options.slow).step, room, options.arrivals)


if __name__ == "__main__":
    main()
