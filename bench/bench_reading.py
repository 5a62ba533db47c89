"""How fast are logs read, against the readers of others on the same file in the same run?

    python bench/bench_reading.py [FOLDER]

Writes files of about 200 MB to FOLDER (a temporary one unless named; files that are there are used again) and reads
the poses and the commands. Every reading is a process of its own: seconds by the best of several, after imports; peak
memory as Linux counts it from the start of the reading. One function per format gives the rows of the table.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

RUNS = 2
MEGABYTES = 200
WANTED = ("/vrpn/drone/pose", "/cmd_vel")
START = 1_700_000_000_000_000_000
POSE, TWIST, ODOMETRY = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry"
IMAGE = "sensor_msgs/msg/Image"


@dataclass(frozen=True)
class Row:
    """One file read in two ways.

    Attributes:
        what: The file and what is asked of it.
        other: Whose reader it is compared with.
        messages: Messages asked for.
        ours: Seconds of `rotorfit.sources.read`.
        unhashed: The same without the SHA-256 of the file, which others do not take.
        theirs: Seconds of the other.
        memory: Peak memory of our reading above that of the imports [MiB].
        kept: Size of the columns that it gives [MiB].
    """

    what: str
    other: str
    messages: int
    ours: float
    unhashed: float
    theirs: float
    memory: float
    kept: float


OURS = """
from rotorfit.sources import read
import rosbags.typesys, backports.zstd, lz4.frame, sqlite3, hashlib, threading, importlib
for name in ("rosbag1", "rosbag2", "mcap"):
    importlib.import_module(f"rotorfit.sources.{name}")
rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS1_NOETIC)
rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_HUMBLE)
def work():
    log = read(path, tables)
    columns = [column for table in log.tables.values() for column in table.columns.values()]
    return sum(len(table.columns["log_time"]) for table in log.tables.values()), sum(c.nbytes for c in columns)
"""

UNHASHED = (
    OURS
    + """
import rotorfit.sources
rotorfit.sources._sha256 = lambda path, stop: ""
"""
)

ROSBAGS = """
from pathlib import Path
from rosbags.highlevel import AnyReader
def work():
    count = 0
    with AnyReader([Path(path)]) as reader:
        asked = [c for c in reader.connections if tables is None or c.topic in tables]
        for connection, _, data in reader.messages(asked):
            message = reader.deserialize(data, connection.msgtype)
            count += 1
    return count, 0
"""

MEASURE = r"""
import json, re, sys, time
from pathlib import Path
path, tables = json.loads(sys.argv[1])
{setup}
def memory(what):
    return int(re.search(what + r":\s+(\d+)", Path("/proc/self/status").read_text())[1])
Path("/proc/self/clear_refs").write_text("5")  # the peak starts from here
before = memory("VmRSS")
start = time.perf_counter()
count, kept = work()
seconds = time.perf_counter() - start
print(json.dumps(dict(count=count, seconds=seconds, memory=(memory("VmHWM") - before) / 1024, kept=kept / 2**20)))
"""


def measured(setup: str, path: Path, tables: tuple[str, ...] | None, runs: int = RUNS) -> dict[str, Any]:
    """The best of several readings, each in a process of its own, after imports."""
    code, given = MEASURE.format(setup=setup), json.dumps([str(path), tables])
    results = [
        json.loads(subprocess.run([sys.executable, "-c", code, given], check=True, capture_output=True).stdout)
        for _ in range(runs)
    ]
    return min(results, key=lambda result: float(result["seconds"]))


def row(what: str, other: str, setup: str, path: Path, tables: tuple[str, ...] | None) -> Row:
    """Reads a file in both ways; both must give as many messages."""
    ours, unhashed, theirs = (measured(code, path, tables) for code in (OURS, UNHASHED, setup))
    assert ours["count"] == theirs["count"], f"{what}: {ours['count']} messages, {other} gives {theirs['count']}"
    seconds = (result["seconds"] for result in (ours, unhashed, theirs))
    return Row(what, other, ours["count"], *seconds, ours["memory"], ours["kept"])


def messages(ros1: bool, images: bool) -> Iterator[tuple[int, str, str, bytes]]:
    """Time, topic, type and bytes: per 10 ms a pose and an odometry, per 30 ms a command, and images where wanted."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types, dump = store.types, store.serialize_ros1 if ros1 else store.serialize_cdr
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](0x01020304, 0x05060708),
        frame_id="world",
        **{"seq": 1} if ros1 else {},
    )
    vector, mark = types["geometry_msgs/msg/Vector3"], 1.234567890123e-77
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](mark, 0.5, 1.0), turn)
    twist = types["geometry_msgs/msg/Twist"](vector(mark, 0.0, 0.0), vector(0.0, 0.0, 0.1))
    spread = np.zeros(36)
    odometry = types[ODOMETRY](
        header,
        "base",
        types["geometry_msgs/msg/PoseWithCovariance"](pose, spread),
        types["geometry_msgs/msg/TwistWithCovariance"](twist, spread),
    )
    pixels = np.random.default_rng(1).integers(0, 256, 640 * 480, np.uint8)
    image = types[IMAGE](header, 480, 640, "mono8", 0, 640, pixels)
    made = {POSE: types[POSE](header, pose), TWIST: types[TWIST](header, twist), ODOMETRY: odometry, IMAGE: image}
    plain = {kind: bytearray(dump(message, kind)) for kind, message in made.items()}
    stamp, value = bytes.fromhex("0403020108070605"), np.float64(mark).tobytes()
    places = {kind: (data.index(stamp), data.find(value)) for kind, data in plain.items()}
    topics = {
        POSE: (WANTED[0], 1),
        ODOMETRY: ("/odom", 1),
        TWIST: (WANTED[1], 3),
        IMAGE: ("/camera", 3 if images else 0),
    }
    size, step = 0, 0
    while size < MEGABYTES * 1e6:
        time = START + step * 10_000_000
        for kind, (topic, every) in topics.items():
            if every and step % every == 0:
                data, (at, number) = plain[kind], places[kind]
                data[at : at + 8] = int(time // 10**9).to_bytes(4, "little") + int(time % 10**9).to_bytes(4, "little")
                if number >= 0:
                    data[number : number + 8] = np.float64(step).tobytes()
                yield time + 1_000_000, topic, kind, bytes(data)
                size += len(data)
        step += 1


def rosbag1_file(folder: Path, images: bool, packed: str = "") -> Path:
    """A ROS 1 bag of chunks as `rosbag record` writes them (768 KiB)."""
    from rosbags.rosbag1 import Writer

    path = folder / f"{'images' if images else 'numbers'}{packed}.bag"
    if not path.exists():
        writer = Writer(path)
        writer.chunk_threshold = 768 << 10
        if packed:
            writer.set_compression(Writer.CompressionFormat[packed])
        _write(writer, messages(ros1=True, images=images), ros1=True)
    return path


def rosbag2_file(folder: Path, plugin: str, images: bool, packed: bool = False) -> Path:
    """A ROS 2 bag: a folder with an SQLite or an MCAP file, the latter with packed chunks where wanted."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    path = folder / f"{'images' if images else 'numbers'}_{plugin.lower()}{'_zstd' if packed else ''}"
    if not path.exists():
        writer = Writer(path, version=9, storage_plugin=StoragePlugin[plugin])
        if packed:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        _write(writer, messages(ros1=False, images=images), ros1=False)
    return path


def _write(writer: Any, rows: Iterator[tuple[int, str, str, bytes]], ros1: bool) -> None:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    connections: dict[str, Any] = {}
    with writer:
        for time, topic, kind, data in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, data)


def bags(folder: Path) -> Iterator[Row]:
    """Bags against the deserialiser of rosbags."""
    files = [
        ("ROS 1", rosbag1_file(folder, images=False)),
        ("ROS 1, lz4", rosbag1_file(folder, images=False, packed="LZ4")),
        ("ROS 2, SQLite", rosbag2_file(folder, "SQLITE3", images=False)),
        ("ROS 2, MCAP", rosbag2_file(folder, "MCAP", images=False)),
        ("ROS 2, MCAP, zstd", rosbag2_file(folder, "MCAP", images=False, packed=True)),
    ]
    for name, path in files:
        yield row(f"{name}: poses and commands", "rosbags", ROSBAGS, path, WANTED)
        yield row(f"{name}: everything", "rosbags", ROSBAGS, path, None)
    files = [
        ("ROS 1 with images", rosbag1_file(folder, images=True)),
        ("ROS 2, SQLite, with images", rosbag2_file(folder, "SQLITE3", images=True)),
        ("ROS 2, MCAP, with images", rosbag2_file(folder, "MCAP", images=True)),
    ]
    for name, path in files:
        yield row(f"{name}: poses and commands", "rosbags", ROSBAGS, path, WANTED)


def shown(one: Row) -> str:
    ours, theirs = (one.messages / seconds / 1000 for seconds in (one.ours, one.theirs))
    return (
        f"| {one.what} | {one.messages} | {ours:.0f} | {theirs:.0f} ({one.other}) | {one.theirs / one.ours:.1f} "
        f"| {one.theirs / one.unhashed:.1f} | {one.memory:.0f} | {one.kept:.0f} |"
    )


def main() -> None:
    print("| file | messages | thousand/s | of the other | ratio | without SHA-256 | peak MiB | columns MiB |")
    print("|---|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as temporary:
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for one in bags(folder):
            print(shown(one), flush=True)


if __name__ == "__main__":
    main()
