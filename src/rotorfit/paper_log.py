"""A flight of the paper's vehicle as a log: in memory, and as a bag."""

import hashlib
import struct
from pathlib import Path

import numpy as np

from rotorfit.errors import LogError
from rotorfit.log import Log, Table
from rotorfit.paper_vehicle import SimulatedFlight

LOG_LATENESS = 1_000_000  # ns: a message is logged up to this long after its stamp


LOG_EPOCH = 1_577_836_800 * 10**9  # ns: 2020-01-01, added to the stamps of a log so that they look like real ones


def as_log(flight: SimulatedFlight) -> Log:
    """The flight as a log in memory: `/cmd_vel` (TwistStamped) and `/pose` (PoseStamped), columns as a bag has them."""
    names = {
        "/cmd_vel": [f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"],
        "/pose": [*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw")],
    }
    numbers = {
        "/cmd_vel": np.insert(flight.command, [3, 3], 0.0, axis=1),
        "/pose": np.column_stack([flight.pose[:, :3], np.roll(flight.quaternion, -1, axis=1)]),
    }
    rng, digest, tables = np.random.default_rng(flight.seed), hashlib.sha256(), {}
    for topic, stamp in (("/cmd_vel", flight.command_stamp), ("/pose", flight.pose_stamp)):
        late = rng.integers(0, LOG_LATENESS, stamp.size)
        columns = {"header.stamp": LOG_EPOCH + stamp, "log_time": LOG_EPOCH + stamp + late}
        fields = dict(zip(names[topic], np.ascontiguousarray(numbers[topic].T), strict=True))
        tables[topic] = Table(topic, columns | fields)
        digest.update(b"".join(column.tobytes() for column in tables[topic].columns.values()))
    return Log(Path(f"simulated-{flight.seed}"), "simulated", digest.hexdigest(), tables, skipped={})


def write_bag(flight: SimulatedFlight, path: Path) -> None:
    """Writes the same as a ROS 1 bag; the same flight gives the same bytes. A message is its fields, little-endian.

    Raises:
        LogError: The file exists already; nothing is written over a log.
    """
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    if path.exists():
        raise LogError(f"{path} exists already and a log is never overwritten: remove it or choose another name")
    store, tables, messages = get_typestore(Stores.ROS1_NOETIC), as_log(flight).tables, []
    with Writer(path) as bag:
        for topic, kind in (("/cmd_vel", "TwistStamped"), ("/pose", "PoseStamped")):
            connection = bag.add_connection(topic, f"geometry_msgs/msg/{kind}", typestore=store)
            stamps, log_times, *fields = (column.tolist() for column in tables[topic].columns.values())
            layout = struct.Struct(f"<4I5s{len(fields)}d")  # header: sequence, stamp, frame; then the numbers
            for sequence, (stamp, log_time, *row) in enumerate(zip(stamps, log_times, *fields, strict=True)):
                header = (sequence, *divmod(stamp, 10**9), 5, b"world")
                messages.append((log_time, connection, layout.pack(*header, *row)))
        for log_time, connection, message in sorted(messages, key=lambda entry: entry[0]):
            bag.write(connection, log_time, message)
