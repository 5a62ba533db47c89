"""How fast are logs read, compared with other readers on the same file in the same run?

    python bench/bench_reading.py [--megabytes 60] [--runs 3] [--folder FOLDER] [LOG...]

Bags against rosbags, ULog against pyulog, DataFlash against pymavlink: everything, and two of the tables. Writes the
files to FOLDER (a temporary one by default; existing files are reused); autopilot logs given as LOG are read in
addition. Every reading is a process of its own, timed after imports. The readers take turns, and a ratio is the median
over neighbouring runs, so that the load of the machine, which is printed, affects both equally; the second ratio is of
processor time, all threads together. Peak memory is as Linux counts it from the start of the reading. Finally, 512
bytes of each ULog are set to zero at eight places (seed 0), and the lost messages are counted.
Needs `pip install pyulog pymavlink`.
"""

import argparse
import contextlib
import io
import json
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from autopilot_logs import (
    ULOG_SYNC,
    flash,
    flash_format,
    flash_record,
    ulog,
    ulog_data,
    ulog_format,
    ulog_record,
    ulog_subscription,
)

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
        ours: Seconds of `rotorfit.read`, the best.
        theirs: Seconds of the other, the best.
        ratio: Seconds of the other for one of ours.
        unhashed: The same without the SHA-256 of the file, which others do not take.
        processor: The same again in processor time.
        memory: Peak memory of our reading above that of the imports [MiB].
        kept: Size of the columns that it gives [MiB].
    """

    what: str
    other: str
    messages: int
    ours: float
    theirs: float
    ratio: float
    unhashed: float
    processor: float
    memory: float
    kept: float


OURS = """
from rotorfit.files.logs import read
import rosbags.typesys, backports.zstd, lz4.frame, sqlite3, hashlib, threading, importlib
for name in ("rosbag1", "rosbag2", "mcap", "ulog", "dataflash"):
    importlib.import_module(f"rotorfit.files.logs.{name}")
rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS1_NOETIC)
rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_HUMBLE)
def work():
    log = read(path, tables)
    columns = [column for table in log.tables.values() for column in table.columns.values()]
    count = sum(len(next(iter(table.columns.values()))) for table in log.tables.values())
    return count, sum(column.nbytes for column in columns)
"""

UNHASHED = (
    OURS
    + """
import rotorfit.files.logs
rotorfit.files.logs._sha256 = lambda *_: ""
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

PYULOG = """
from pyulog import ULog
def work():
    log = ULog(path, message_name_filter_list=tables, disable_str_exceptions=True)
    return sum(len(data.data["timestamp"]) for data in log.data_list), 0
"""

PYMAVLINK = """
from pymavlink.DFReader import DFReader_binary
def work():
    log, count = DFReader_binary(path), 0
    while (message := log.recv_match(type=tables) if tables else log.recv_msg()) is not None:
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
start, began = time.perf_counter(), time.process_time()
count, kept = work()
seconds, processor = time.perf_counter() - start, time.process_time() - began
print(json.dumps(dict(count=count, seconds=seconds, processor=processor,
    memory=(memory("VmHWM") - before) / 1024, kept=kept / 2**20)))
"""


def measured(setup: str, path: Path, tables: tuple[str, ...] | None) -> dict[str, Any]:
    """One reading in a process of its own, after imports."""
    command = [sys.executable, "-c", MEASURE.format(setup=setup), json.dumps([str(path), tables])]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return found


def row(what: str, other: str, setup: str, path: Path, tables: tuple[str, ...] | None, runs: int) -> Row:
    """Reads a file in both ways, in turns."""
    turns = [[measured(code, path, tables) for code in (OURS, setup, UNHASHED)] for _ in range(runs)]
    seconds = [[one["seconds"] for one in turn] for turn in turns]
    processor = [[one["processor"] for one in turn] for turn in turns]
    ours, theirs = turns[0][:2]
    if ours["count"] != theirs["count"]:  # pymavlink gives what describes the log, too
        what = f"{what} ({other} gives {theirs['count']} messages)"
    return Row(
        what,
        other,
        ours["count"],
        min(turn[0] for turn in seconds),
        min(turn[1] for turn in seconds),
        median(turn[1] / turn[0] for turn in seconds),
        median(turn[1] / turn[2] for turn in seconds),
        median(turn[1] / turn[0] for turn in processor),
        ours["memory"],
        ours["kept"],
    )


def messages(ros1: bool, images: bool, megabytes: float) -> Iterator[tuple[int, str, str, bytes]]:
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
    while size < megabytes * 1e6:
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


def rosbag1_file(folder: Path, megabytes: float, images: bool, packed: str = "") -> Path:
    """A ROS 1 bag of chunks as `rosbag record` writes them (768 KiB)."""
    from rosbags.rosbag1 import Writer

    path = folder / f"{'images' if images else 'numbers'}{packed}.bag"
    if not path.exists():
        writer = Writer(path)
        writer.chunk_threshold = 768 << 10
        if packed:
            writer.set_compression(Writer.CompressionFormat[packed])
        _write(writer, messages(True, images, megabytes), ros1=True)
    return path


def rosbag2_file(folder: Path, megabytes: float, plugin: str, images: bool, packed: bool = False) -> Path:
    """A ROS 2 bag: a folder with an SQLite or an MCAP file, the latter with packed chunks where wanted."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    path = folder / f"{'images' if images else 'numbers'}_{plugin.lower()}{'_zstd' if packed else ''}"
    if not path.exists():
        writer = Writer(path, version=9, storage_plugin=StoragePlugin[plugin])
        if packed:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        _write(writer, messages(False, images, megabytes), ros1=False)
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


def bags(folder: Path, megabytes: float, runs: int) -> Iterator[Row]:
    """Bags against the deserialiser of rosbags."""
    files = [
        ("ROS 1", rosbag1_file(folder, megabytes, images=False)),
        ("ROS 1, lz4", rosbag1_file(folder, megabytes, images=False, packed="LZ4")),
        ("SQLite", rosbag2_file(folder, megabytes, "SQLITE3", images=False)),
        ("MCAP", rosbag2_file(folder, megabytes, "MCAP", images=False)),
        ("MCAP, zstd", rosbag2_file(folder, megabytes, "MCAP", images=False, packed=True)),
    ]
    for name, path in files:
        yield row(f"{name}: poses and commands", "rosbags", ROSBAGS, path, WANTED, runs)
        yield row(f"{name}: everything", "rosbags", ROSBAGS, path, None, runs)
    files = [
        ("ROS 1 with images", rosbag1_file(folder, megabytes, images=True)),
        ("SQLite with images", rosbag2_file(folder, megabytes, "SQLITE3", images=True)),
        ("MCAP with images", rosbag2_file(folder, megabytes, "MCAP", images=True)),
    ]
    for name, path in files:
        yield row(f"{name}: poses and commands", "rosbags", ROSBAGS, path, WANTED, runs)


def ulog_file(folder: Path, megabytes: float) -> Path:
    """IMU at 200 Hz, attitude at 50 Hz and position at 10 Hz."""
    kinds = {"sensor_combined": (13, 1), "vehicle_attitude": (12, 4), "vehicle_local_position": (40, 20)}
    records = [ulog_format(name, f"uint64_t timestamp;float[{width}] values;") for name, (width, _) in kinds.items()]
    records += [ulog_subscription(number, name) for number, name in enumerate(kinds)]
    for step in range(round(megabytes * 11_000)):
        records += [ulog_record("S", ULOG_SYNC)] * (step % 100 == 0)
        records += [
            ulog_data(number, f"Q{width}f", step * 5000, *[step] * width)
            for number, (width, every) in enumerate(kinds.values())
            if step % every == 0
        ]
    path = folder / "px4.ulg"
    path.write_bytes(ulog(records))
    return path


def dataflash_file(folder: Path, megabytes: float) -> Path:
    """IMU at 100 Hz, attitude and position at 10 Hz."""
    kinds = {"IMU": ("Qffffff", 1), "ATT": ("Qcccccc", 10), "PSCN": ("Qffffff", 10)}
    labels = "TimeUS," + ",".join("abcdef")
    records = [flash_format(number + 1, name, code, labels) for number, (name, (code, _)) in enumerate(kinds.items())]
    for step in range(round(megabytes * 23_000)):
        records += [
            flash_record(number + 1, code, step * 10_000, *[step % 999] * 6)
            for number, (code, every) in enumerate(kinds.values())
            if step % every == 0
        ]
    path = folder / "arducopter.bin"
    path.write_bytes(flash(records))
    return path


def is_ulog(path: Path) -> bool:
    return path.read_bytes()[:4] == b"ULog"


def autopilots(logs: list[Path], runs: int) -> Iterator[Row]:
    """Logs of autopilots against pyulog and pymavlink."""
    for path in logs:
        setup, other = (PYULOG, "pyulog") if is_ulog(path) else (PYMAVLINK, "pymavlink")
        two = ("vehicle_attitude", "vehicle_local_position") if is_ulog(path) else ("ATT", "IMU")
        what = f"{'ULog' if is_ulog(path) else 'DataFlash'}, {path.stat().st_size / 1e6:.1f} MB"
        yield row(f"{what}: {' and '.join(two)}", other, setup, path, two, runs)
        yield row(f"{what}: everything", other, setup, path, None, runs)


def losses(path: Path, folder: Path) -> str:
    """How many messages a hole of 512 bytes costs each reader of ULog, at eight places."""
    from pyulog import ULog

    from rotorfit.files.logs import read

    content, hole, rng = path.read_bytes(), folder / "hole.ulg", random.Random(0)
    counts: list[tuple[int, int]] = []
    for place in (None, *(rng.randrange(len(content) // 20, len(content) - 512) for _ in range(8))):
        data = bytearray(content)
        if place is not None:
            data[place : place + 512] = bytes(512)
        hole.write_bytes(data)
        with contextlib.redirect_stdout(io.StringIO()):
            theirs = sum(len(data.data["timestamp"]) for data in ULog(str(hole)).data_list)
        ours = sum(len(table.columns["timestamp"]) for table in read(hole).tables.values())
        counts.append((ours, theirs))
    lost = [[counts[0][k] - one[k] for one in counts[1:]] for k in (0, 1)]
    return f"{path.name}: a hole of 512 bytes costs {lost[0]} of {counts[0][0]} messages, pyulog {lost[1]}"


def shown(one: Row) -> str:
    ours, theirs = (one.messages / seconds / 1000 for seconds in (one.ours, one.theirs))
    return (
        f"| {one.what} | {one.messages:,} | {ours:.0f} | {theirs:.0f} ({one.other}) | {one.ratio:.1f} "
        f"| {one.unhashed:.1f} | {one.processor:.1f} | {one.memory:.0f} | {one.kept:.0f} |"
    )


def load() -> str:
    return f"{os.cpu_count()} cores, load {', '.join(f'{one:.1f}' for one in os.getloadavg())} (1, 5, 15 min)"


def main() -> None:
    options = argparse.ArgumentParser(description="Reading logs, against the readers of others.")
    options.add_argument("--megabytes", type=float, default=60.0)
    options.add_argument("--runs", type=int, default=3)
    options.add_argument("--folder", type=Path)
    options.add_argument("logs", nargs="*", type=Path)
    asked = options.parse_args()
    print(f"before: {load()}\n")
    print(
        "| file | messages | thousand/s | of the other | ratio | without SHA-256 | processor | peak MiB | columns MiB |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|", flush=True)
    with TemporaryDirectory() as temporary:
        folder = asked.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        logs = [ulog_file(folder, asked.megabytes), dataflash_file(folder, asked.megabytes / 6), *asked.logs]
        for one in autopilots(logs, asked.runs):
            print(shown(one), flush=True)
        for one in bags(folder, asked.megabytes, asked.runs):
            print(shown(one), flush=True)
        print(f"\nafter: {load()}\n")
        for path in filter(is_ulog, logs):
            print(losses(path, Path(temporary)))


if __name__ == "__main__":
    main()
