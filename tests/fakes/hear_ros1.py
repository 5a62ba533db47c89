"""Somebody on ROS 1 who reads what a tracker publishes, and asks the master what else its node does."""

import json
import signal
import sys
import time
from typing import Any

import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped, TwistStamped
from std_msgs.msg import String


def main() -> None:
    over: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: over.append(number))
    rospy.init_node("hearer", disable_signals=True)
    heard: dict[str, Any] = {"levels": {}, "states": 0, "speeds": 0, "pushes": 0, "publishes": {}}

    def diagnosed(message: DiagnosticArray) -> None:
        for one in message.status:
            heard["levels"][one.name] = max(one.level, heard["levels"].get(one.name, 0))

    def counted(name: str) -> Any:
        return lambda _: heard.__setitem__(name, heard[name] + 1)

    rospy.Subscriber("/diagnostics", DiagnosticArray, diagnosed)
    rospy.Subscriber("/rotorfit/tracked", String, counted("states"))
    rospy.Subscriber("/rotorfit/velocity", TwistStamped, counted("speeds"))
    rospy.Subscriber("/rotorfit/disturbance", AccelStamped, counted("pushes"))
    print("ready", flush=True)
    master = rosgraph.Master("/hearer")
    while not over:
        publishers, types = dict(master.getSystemState()[0]), dict(master.getTopicTypes())
        for node in publishers.get("/diagnostics", []):
            told = {topic: types[topic] for topic, nodes in publishers.items() if node in nodes}
            heard["publishes"] |= told
        time.sleep(0.2)
    print(json.dumps(heard), flush=True)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
