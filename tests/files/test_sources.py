"""Reading logs: every format through one set of cases, then what is particular to each. Damage: see test_log.py."""

import json
import shutil
import sqlite3
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import lz4.frame
import numpy as np
import polars as pl
import pytest
import scipy.io
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from autopilot_logs import (
    FLASH_FMT,
    ULOG_HEADER,
    flash_format,
    flash_record,
    ulog_data,
    ulog_format,
    ulog_subscription,
)
from rotorfit.core.log import Log
from rotorfit.files.logs import FORMATS, read
from rotorfit.files.logs.batches import messages_of
from rotorfit.files.logs.content import DamageError
from rotorfit.files.logs.ros_messages import Topic, decoded, types_of

pytestmark = pytest.mark.flights

POSE, TWIST, IMAGE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Image"
TOPICS = {"/drone/pose": POSE, "/cmd_vel": TWIST, "/camera": IMAGE}
NOETIC, JAZZY = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class Recording:
    """Poses and commands as every writer gets them: stamps [ns], rows of x y z qx qy qz qw, rows of x y z yaw."""

    pose_time: np.ndarray
    pose: np.ndarray
    command_time: np.ndarray
    command: np.ndarray


def recording(poses: int = 60, commands: int = 17) -> Recording:
    rng = np.random.default_rng(3)
    start = 1_700_000_000_000_000_123
    time, pose = start + np.cumsum(rng.integers(7_000_000, 9_000_000, poses)), rng.normal(size=(poses, 7))
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    return Recording(
        time,
        pose,
        start + 5 + np.cumsum(rng.integers(60_000_000, 70_000_000, commands)),
        rng.normal(size=(commands, 4)),
    )


POSE_FIELDS = [*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw")]
TWIST_FIELDS = ["twist.linear.x", "twist.linear.y", "twist.linear.z", "twist.angular.z"]


def stamped(store: Typestore, typename: str, stamp: int, values: np.ndarray) -> object:
    types = store.types
    seq = {"seq": 7} if store is NOETIC else {}
    time = types["builtin_interfaces/msg/Time"](sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="map", **seq)
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    if typename == POSE:
        point = types["geometry_msgs/msg/Point"](*values[:3])
        return types[POSE](header, types["geometry_msgs/msg/Pose"](point, quaternion(*values[3:])))
    turn = vector(0.0, 0.0, values[3])
    return types[TWIST](header, types["geometry_msgs/msg/Twist"](vector(*values[:3]), turn))


def image(store: Typestore) -> object:
    header = stamped(store, POSE, 10**9, np.zeros(7)).header
    return store.types[IMAGE](header, 2, 2, "mono8", 0, 2, np.arange(4, dtype=np.uint8))


def messages(rec: Recording, store: Typestore) -> list[tuple[int, str, bytes]]:
    """Time of recording, topic and bytes, in order; recorded 1 ms after the stamp, with one image among them."""
    dump = store.serialize_ros1 if store is NOETIC else store.serialize_cdr
    rows = [(t, "/drone/pose", stamped(store, POSE, t, v)) for t, v in zip(rec.pose_time, rec.pose, strict=True)]
    rows += [(t, "/cmd_vel", stamped(store, TWIST, t, v)) for t, v in zip(rec.command_time, rec.command, strict=True)]
    rows += [(t + 1, "/camera", image(store)) for t in rec.pose_time[:1]]
    rows.sort(key=lambda row: row[0])
    return [(int(t) + 1_000_000, topic, bytes(dump(message, TOPICS[topic]))) for t, topic, message in rows]


def write_rosbag1(path: Path, rec: Recording, compression: str = "") -> Path:
    writer = Writer1(path)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=NOETIC) for topic, kind in TOPICS.items()}
        for time, topic, data in messages(rec, NOETIC):
            writer.write(connections[topic], time, data)
    return path


def write_rosbag2(path: Path, rec: Recording, plugin: str = "SQLITE3", compression: str = "NONE") -> Path:
    writer = Writer2(path, version=9, storage_plugin=StoragePlugin[plugin])
    writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=JAZZY) for topic, kind in TOPICS.items()}
        for time, topic, data in messages(rec, JAZZY):
            writer.write(connections[topic], time, data)
    return path


def write_storage(path: Path, rec: Recording, plugin: str = "SQLITE3", compression: str = "NONE") -> Path:
    folder = write_rosbag2(path.with_name(f"{path.name}_folder"), rec, plugin, compression)
    (storage,) = (file for file in folder.iterdir() if file.name != "metadata.yaml")
    return Path(shutil.move(storage, path))


def mcap_record(kind: int, *parts: bytes) -> bytes:
    content = b"".join(parts)
    return struct.pack("<BQ", kind, len(content)) + content


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def write_mcap_ros1(path: Path, rec: Recording, packed: bool = False) -> Path:
    """An MCAP with messages as ROS 1 writes them, which rosbags does not write: no index, one chunk or none."""
    records = b""
    for number, (topic, kind) in enumerate(TOPICS.items()):
        name, (definition, _) = kind.replace("/msg/", "/"), NOETIC.generate_msgdef(kind)
        records += mcap_record(3, struct.pack("<H", number + 1), text(name), text("ros1msg"), text(definition))
        records += mcap_record(4, struct.pack("<HH", number, number + 1), text(topic), text("ros1"), text(""))
    for time, topic, data in messages(rec, NOETIC):
        records += mcap_record(5, struct.pack("<HIQQ", [*TOPICS].index(topic), 0, time, time), data)
    if packed:
        block = lz4.frame.compress(records)
        head = struct.pack("<QQQI", 0, 0, len(records), 0) + text("lz4") + struct.pack("<Q", len(block))
        records = mcap_record(6, head, block)
    magic = b"\x89MCAP0\r\n"
    end = mcap_record(15, bytes(4)) + mcap_record(2, bytes(20)) + magic
    path.write_bytes(magic + mcap_record(1, text("ros1"), text("test")) + records + end)
    return path


def plain_columns(rec: Recording) -> dict[str, np.ndarray]:
    return {
        "t_pose": rec.pose_time,
        **{f"p{index}": rec.pose[:, index] for index in range(7)},
        "t_command": rec.command_time,
        **{f"u{index}": rec.command[:, index] for index in range(4)},
    }


def write_csv(path: Path, rec: Recording, separator: str = ",", comma: bool = False, end: str = "\n") -> Path:
    columns = plain_columns(rec)
    lines = [separator.join(columns)]
    for row in range(len(rec.pose_time)):
        cells = [str(values[row]) if row < len(values) else "" for values in columns.values()]
        lines.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    path.write_text(end.join([*lines, ""]), newline="")
    return path


def write_mat(path: Path, rec: Recording, packed: bool = False) -> Path:
    columns = {**plain_columns(rec), "pose": rec.pose.T, "note": "a text", "log": {"u": rec.command}}
    with path.open("wb") as file:
        scipy.io.savemat(file, columns, do_compression=packed)
    return path


def write_mat73(path: Path, rec: Recording, user_block: int = 512) -> Path:
    with h5py.File(path, "w", userblock_size=user_block) as file:
        for name, values in {**plain_columns(rec), "pose": rec.pose.T}.items():
            file[name] = np.atleast_2d(values).T if values.ndim == 1 else values.T
            file[name].attrs["MATLAB_class"] = np.bytes_("int64" if name.startswith("t_") else "double")
        file["note"] = np.array([[97], [98]], np.uint16)
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["log/u"] = rec.command.T
    if user_block:
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def write_jsonl(path: Path, rec: Recording) -> Path:
    columns = {name: values.tolist() for name, values in plain_columns(rec).items()}
    for row in range(len(rec.pose_time)):
        cells = {name: values[row] for name, values in columns.items() if row < len(values)}
        with path.open("a") as file:
            file.write(json.dumps({**cells, "mode": "hover"}) + "\n")
    return path


def write_parquet(path: Path, rec: Recording) -> Path:
    columns = plain_columns(rec)
    cells = {name: [*values.tolist(), *[None] * (len(rec.pose_time) - len(values))] for name, values in columns.items()}
    pl.DataFrame({**cells, "mode": ["hover"] * len(rec.pose_time)}).write_parquet(path)
    return path


def in_order(rec: Recording) -> list[tuple[int, str, np.ndarray]]:
    """Poses and commands in the order of their stamps."""
    rows = [(int(t), "pose", values) for t, values in zip(rec.pose_time, rec.pose, strict=True)]
    rows += [(int(t), "cmd", values) for t, values in zip(rec.command_time, rec.command, strict=True)]
    return sorted(rows, key=lambda row: row[0])


POSE_NAMES, COMMAND_NAMES = [f"p{index}" for index in range(7)], [f"u{index}" for index in range(4)]


def write_ulog(path: Path, rec: Recording) -> Path:
    fields = {"pose": ["t_pose", *POSE_NAMES], "cmd": ["t_command", *COMMAND_NAMES]}
    content = ULOG_HEADER
    for number, (topic, names) in enumerate(fields.items()):
        kinds = ["int64_t", *["double"] * (len(names) - 1)]
        text = "".join(f"{kind} {name};" for kind, name in zip(kinds, names, strict=True))
        content += ulog_format(topic, f"uint64_t timestamp;{text}") + ulog_subscription(number, topic)
    for t, topic, values in in_order(rec):
        content += ulog_data([*fields].index(topic), f"Qq{len(values)}d", t // 1000, t, *values)
    path.write_bytes(content)
    return path


def write_dataflash(path: Path, rec: Recording) -> Path:
    codes = {"pose": "Qqddddddd", "cmd": "Qqdddd"}
    content = FLASH_FMT + flash_format(1, "pose", codes["pose"], ",".join(["TimeUS", "t_pose", *POSE_NAMES]))
    content += flash_format(2, "cmd", codes["cmd"], ",".join(["TimeUS", "t_command", *COMMAND_NAMES]))
    for t, name, values in in_order(rec):
        content += flash_record(1 + (name == "cmd"), codes[name], t // 1000, t, *values)
    path.write_bytes(content)
    return path


def write_dataflash_text(path: Path, rec: Recording) -> Path:
    lines = [
        "ArduCopter V3.1.3", "", "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format",
        f"FMT, 1, 75, pose, Qqddddddd, TimeUS,t_pose,{','.join(POSE_NAMES)}",
        f"FMT, 2, 51, cmd, Qqdddd, TimeUS,t_command,{','.join(COMMAND_NAMES)}",
        "FMT, 129, 23, PARM, Nf, Name,Value", "PARM, RATE_RLL_P, 0.15",
    ]  # fmt: skip
    lines += [f"{name}, {t // 1000}, {t}, {', '.join(map(str, values))}" for t, name, values in in_order(rec)]
    path.write_text("\r\n".join([*lines, ""]), newline="")
    return path


MOCAP_NAMES = {
    "clock.position.x": "t_pose",
    "clock.position.y": "t_command",
    **{f"drone.position.{axis}": f"p{index}" for index, axis in enumerate("xyz")},
    **{f"drone.rotation.{axis}": f"p{index + 3}" for index, axis in enumerate("xyzw")},
    **{f"cmd.position.{axis}": f"u{index}" for index, axis in enumerate("xyz")},
    "cmd.rotation.x": "u3",
}
"""Columns of mocap exports, in which the stamps and the commands are bodies too, to those of `plain_columns`."""


def mocap_rows(rec: Recording) -> list[str]:
    columns = plain_columns(rec)
    return [
        ",".join(str(columns[name][row]) if row < len(columns[name]) else "" for name in MOCAP_NAMES.values())
        for row in range(len(rec.pose_time))
    ]


def write_motive(path: Path, rec: Recording) -> Path:
    names, kinds, axes = zip(*(name.split(".") for name in MOCAP_NAMES), strict=True)
    first = "Format Version,1.23,Take Name,test,Capture Start Time,2024-01-02 03.04.05.678 PM,Rotation Type,Quaternion"
    header = [
        f"{first},Length Units,Meters,Coordinate Space,Global", "",
        ",".join(["", "Type", *["Rigid Body"] * len(names)]),
        ",".join(["", "Name", *names]), ",".join(["", "ID", *['"0"'] * len(names)]),
        ",".join(["", "", *(kind.title() for kind in kinds)]),
        ",".join(["Frame", "Time (Seconds)", *(axis.upper() for axis in axes)]),
    ]  # fmt: skip
    rows = [f"{frame},{frame / 100},{row}" for frame, row in enumerate(mocap_rows(rec))]
    path.write_text("\r\n".join([*header, *rows, ""]), newline="")
    return path


def write_vicon(path: Path, rec: Recording) -> Path:
    names, kinds, axes = zip(*(name.split(".") for name in MOCAP_NAMES), strict=True)
    titles = ["", "", *(f"Global Angle (Quaternion) {name}:{name}" for name in names)]
    letters = [f"{'R' if kind == 'rotation' else 'T'}{axis.upper()}" for kind, axis in zip(kinds, axes, strict=True)]
    units = ["mm" if kind == "position" else "" for kind in kinds]
    header = [
        "Objects",
        "100",
        ",".join(titles),
        ",".join(["Frame", "Sub Frame", *letters]),
        ",".join(["", "", *units]),
    ]
    rows = [f"{frame + 1},0,{row}" for frame, row in enumerate(mocap_rows(rec))]
    path.write_text("\r\n".join([*header, *rows, ""]), newline="")
    return path


WRITERS: dict[str, tuple[str, Callable[[Path, Recording], Path]]] = {
    "csv": ("csv", write_csv),
    "csv tab, crlf": ("csv", lambda path, rec: write_csv(path, rec, "\t", end="\r\n")),
    "csv semicolon, decimal comma": ("csv", lambda path, rec: write_csv(path, rec, ";", comma=True)),
    "mat": ("mat", write_mat),
    "mat compressed": ("mat", lambda path, rec: write_mat(path, rec, packed=True)),
    "mat73": ("mat73", write_mat73),
    "mat73 plain hdf5": ("mat73", lambda path, rec: write_mat73(path, rec, 0)),
    "rosbag1": ("rosbag1", write_rosbag1),
    "rosbag1 bz2": ("rosbag1", lambda path, rec: write_rosbag1(path, rec, "BZ2")),
    "rosbag1 lz4": ("rosbag1", lambda path, rec: write_rosbag1(path, rec, "LZ4")),
    "rosbag2 sqlite": ("rosbag2", write_rosbag2),
    "rosbag2 sqlite, packed messages": ("rosbag2", lambda path, rec: write_rosbag2(path, rec, compression="MESSAGE")),
    "rosbag2 sqlite, packed file": ("rosbag2", lambda path, rec: write_rosbag2(path, rec, compression="FILE")),
    "rosbag2 mcap": ("rosbag2", lambda path, rec: write_rosbag2(path, rec, "MCAP")),
    "rosbag2 mcap, packed file": ("rosbag2", lambda path, rec: write_rosbag2(path, rec, "MCAP", "FILE")),
    "lone db3": ("rosbag2", write_storage),
    "lone mcap": ("mcap", lambda path, rec: write_storage(path, rec, "MCAP")),
    "lone mcap, zstd chunks": ("mcap", lambda path, rec: write_storage(path, rec, "MCAP", "STORAGE")),
    "lone mcap, ros1": ("mcap", write_mcap_ros1),
    "ulog": ("ulog", write_ulog),
    "dataflash": ("dataflash", write_dataflash),
    "dataflash_text": ("dataflash_text", write_dataflash_text),
    "parquet": ("parquet", write_parquet),
    "jsonl": ("jsonl", write_jsonl),
    "motive": ("motive", write_motive),
    "vicon": ("vicon", write_vicon),
    "lone mcap, ros1, lz4 chunk": ("mcap", lambda path, rec: write_mcap_ros1(path, rec, packed=True)),
}
BAGS = [name for name, (kind, _) in WRITERS.items() if kind in ("rosbag1", "rosbag2", "mcap")]


def as_recording(log: Log) -> Recording:
    """What a log holds, whichever its format."""
    if "/drone/pose" in log.tables:
        pose, command = log.tables["/drone/pose"].columns, log.tables["/cmd_vel"].columns
        return Recording(
            pose["header.stamp"],
            np.stack([pose[name] for name in POSE_FIELDS], axis=1),
            command["header.stamp"],
            np.stack([command[name] for name in TWIST_FIELDS], axis=1),
        )
    assert list(log.tables) in ([log.path.stem], ["Objects"], ["pose", "cmd"])
    columns = {
        MOCAP_NAMES.get(label, label): values[~np.isnan(values)]
        for table in log.tables.values()
        for label, values in table.columns.items()
    }
    return Recording(
        columns["t_pose"],
        np.stack([columns[f"p{index}"] for index in range(7)], axis=1),
        columns["t_command"],
        np.stack([columns[f"u{index}"] for index in range(4)], axis=1),
    )


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_poses_and_commands_whatever_the_file_is_called(name: str, tmp_path: Path) -> None:
    kind, write = WRITERS[name]
    rec = recording()

    log = read(write(tmp_path / "flight.data", rec))
    got = as_recording(log)

    assert log.format == kind
    assert all("left out because" in note or note.startswith(("Motive captured", "Objects: 100")) for note in log.notes)
    sheet = name.startswith(("csv", "motive", "vicon", "parquet", "jsonl"))
    for values in (got.pose_time, got.command_time):
        assert values.dtype == np.int64 or sheet or name.startswith("mat")
    # A column with empty cells is float64, which holds nanoseconds of today to 256 ns.
    assert np.abs(got.command_time.astype(np.int64) - rec.command_time).max() <= (256 if sheet else 0)
    np.testing.assert_array_equal(got.pose_time, rec.pose_time)
    np.testing.assert_array_equal(got.pose, rec.pose)
    np.testing.assert_array_equal(got.command, rec.command)


@pytest.mark.parametrize("name", BAGS)
def test_bags_give_the_time_of_recording_and_say_what_they_skip(name: str, tmp_path: Path) -> None:
    rec = recording()
    path = WRITERS[name][1](tmp_path / "flight", rec)

    log = read(path)
    only = read(str(path), tables={"/cmd_vel", "/camera", "/nowhere"})

    assert log.tables["/drone/pose"].columns["log_time"].dtype == np.int64
    np.testing.assert_array_equal(log.tables["/drone/pose"].columns["log_time"], rec.pose_time + 1_000_000)
    assert log.skipped == {"/camera": f"not a table of numbers ({IMAGE}, 1 messages)"}
    assert set(only.tables) == {"/cmd_vel", "/camera"}
    assert only.tables["/camera"].columns["height"].tolist() == [2]
    assert only.skipped == {"/drone/pose": f"not asked for ({POSE}, 60 messages)"}


CUSTOM = """std_msgs/Header header
uint8 HOVER=3
bool armed
string mode
int8 code
float64[3] rates
uint16[] channels
float32[] ranges
Corner[2] corners
Corner[] found
my_msgs/Corner best   # trailing comment
duration ahead
uint64 last
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: my_msgs/Corner
string label
float32 u
float64 v
"""


def custom_store() -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(CUSTOM, "my_msgs/msg/State"))
    store.register({name: NOETIC.fielddefs[name] for name in NOETIC.fielddefs if name.startswith("builtin_interfaces")})
    return store


def custom_message(store: Typestore, row: int) -> object:
    types = store.types
    corner = types["my_msgs/msg/Corner"]
    header = types["std_msgs/msg/Header"](row, types["builtin_interfaces/msg/Time"](row, 5), "map" * (row % 3))
    ranges = np.arange(row % 2 + 1, dtype=np.float32)
    lists = [corner("a" * row, 1.0, 2.0), corner("", 3.0, 4.0)], [corner("x", 0.0, 0.0)] * (row % 4)
    ahead = types["builtin_interfaces/msg/Duration"](-1, 0)
    return types["my_msgs/msg/State"](
        header, row % 2 == 0, "HOVER" * (row % 2), -row, np.array([row, 0.5, -1.0]),
        np.array([row, 1500], np.uint16), ranges, *lists, corner("best", 0.25, row / 8), ahead, 2**63 + row,
    )  # fmt: skip


@pytest.mark.parametrize("encoding", ["ros1", "cdr", "cdr big-endian"])
def test_custom_types_are_decoded_from_the_definition_in_the_bag(encoding: str, tmp_path: Path) -> None:
    store, rows = custom_store(), np.arange(40)
    if encoding == "ros1":
        with Writer1(tmp_path / "log") as writer:
            connection = writer.add_connection("/state", "my_msgs/msg/State", msgdef=CUSTOM, md5sum="0" * 32)
            for row in rows:
                data = store.serialize_ros1(custom_message(store, int(row)), "my_msgs/msg/State")
                writer.write(connection, int(row), data)
    else:
        with Writer2(tmp_path / "log", version=9) as writer:
            connection = writer.add_connection("/state", "my_msgs/msg/State", msgdef=CUSTOM, rihs01="unknown")
            for row in rows:
                message = custom_message(store, int(row))
                data = store.serialize_cdr(message, "my_msgs/msg/State", little_endian="big" not in encoding)
                writer.write(connection, int(row), data)

    log = read(tmp_path / "log")
    columns = log.tables["/state"].columns

    assert set(columns) == {
        "log_time", "header.seq", "header.stamp", "armed", "code", "rates", "channels", "best.u", "best.v", "ahead",
        "last",
    }  # fmt: skip
    np.testing.assert_array_equal(columns["header.stamp"], rows * 10**9 + 5)
    np.testing.assert_array_equal(columns["armed"], rows % 2 == 0)
    np.testing.assert_array_equal(columns["code"], -rows)
    np.testing.assert_array_equal(columns["rates"], np.stack([rows, rows * 0 + 0.5, rows * 0 - 1], axis=1))
    np.testing.assert_array_equal(columns["channels"][:, 0], rows)
    np.testing.assert_array_equal(columns["best.v"], rows / 8)
    np.testing.assert_array_equal(columns["ahead"], -(10**9))
    np.testing.assert_array_equal(columns["last"] - np.uint64(2**63), rows)
    assert log.notes == ("/state: left out, of varying length: ranges",)


IDL = """================================================================================
IDL: my_msgs/msg/Speed
module my_msgs { module msg { @verbatim (language="comment", text="speed")
struct Speed { std_msgs::msg::Header header; double forward; @unit (value="m/s") float up; }; }; };
================================================================================
IDL: std_msgs/msg/Header
module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
"""


def test_idl_definitions_are_understood(tmp_path: Path) -> None:
    with Writer2(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/speed", "my_msgs/msg/Speed", msgdef=IDL, rihs01="unknown")
        writer.write(connection, 9, b"\0\1\0\0" + struct.pack("<iII4sdf", 3, 4, 4, b"map\0", 1.5, 0.25))

    columns = read(tmp_path / "bag").tables["/speed"].columns

    assert {name: values.tolist() for name, values in columns.items()} == {
        "log_time": [9], "header.stamp": [3 * 10**9 + 4], "forward": [1.5], "up": [0.25],
    }  # fmt: skip


def test_idl_constants_that_are_computed_are_refused_before_they_fill_the_memory() -> None:
    text = "module m { module msg { const long long X = 1 << 999999999999; struct A { double x; }; }; };"

    with pytest.raises(DamageError, match="computes constants"):
        types_of(Topic("/a", "m/msg/A", "cdr", text, "idl"))


def random_message(store: Typestore, typename: str, rng: np.random.Generator) -> object:
    """A message of any type with random content, lists of random length and strings of random length."""

    def value(kind: tuple) -> object:
        if kind[0] == Nodetype.NAME:
            return random_message(store, kind[1], rng)
        if kind[0] == Nodetype.BASE:
            number = kind[1][0]
            if number == "string":
                return "ü" * int(rng.integers(0, 6))
            return bool(rng.integers(2)) if number == "bool" else int(rng.integers(0, 100))
        inner, size = kind[1]
        count = size if kind[0] == Nodetype.ARRAY else int(rng.integers(0, 4))
        items = [value(inner) for _ in range(count)]
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return items
        return np.array(items, {"byte": "u1", "char": "u1"}.get(inner[1][0], inner[1][0]))

    return store.types[typename](*(value(kind) for _, kind in store.fielddefs[typename][1]))


def flat(store: Typestore, message: object, prefix: str = "") -> dict[str, object]:
    """Columns of one message as rosbags decodes it."""
    if message.__msgtype__.startswith("builtin_interfaces/"):
        return {prefix.rstrip("."): message.sec * 10**9 + message.nanosec}
    found: dict[str, object] = {}
    for name, _ in store.fielddefs[message.__msgtype__][1]:
        value = getattr(message, name)
        if hasattr(value, "__msgtype__"):
            found |= flat(store, value, f"{prefix}{name}.")
        elif not isinstance(value, str | list) and name != "structure_needs_at_least_one_member":
            found[f"{prefix}{name}"] = value
    return found


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_every_standard_type_decodes_as_rosbags_decodes_it(encoding: str) -> None:
    store = NOETIC if encoding == "ros1" else get_typestore(Stores.ROS2_HUMBLE)
    rng = np.random.default_rng(1)
    compared = 0
    for typename in store.fielddefs:
        if typename.startswith("builtin_interfaces"):
            continue
        written = [random_message(store, typename, rng) for _ in range(3)]
        dump = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
        load = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
        data = [bytes(dump(message, typename)) for message in written]
        topic = Topic("/topic", typename, encoding)

        got = decoded(topic, types_of(topic), messages_of(data))

        assert got.fault == "", typename
        assert got.rows.tolist() == [0, 1, 2]
        for row, message in enumerate(data):
            expected = flat(store, load(message, typename))
            assert set(got.columns) | got.uneven >= {name for name, v in expected.items() if np.size(v) <= 64}
            for name, values in got.columns.items():
                np.testing.assert_array_equal(values[row], expected[name], err_msg=f"{typename} {name}")
                compared += 1
    assert compared > 1000


def test_a_bag_of_ros2_before_iron_is_read_with_the_standard_definitions(tmp_path: Path) -> None:
    rec = recording()
    path = write_storage(tmp_path / "old.db3", rec)
    with sqlite3.connect(path) as database:
        database.executescript("DROP TABLE message_definitions; DROP TABLE schema; UPDATE topics SET id = id")
        database.execute("INSERT INTO topics VALUES (9, '/odd', 'my_msgs/msg/Odd', 'cdr', '', '')")
        database.execute("INSERT INTO messages VALUES (999, 9, 5, x'0001000000000000')")
    database.close()

    log = read(path)

    np.testing.assert_array_equal(as_recording(log).pose, rec.pose)
    assert "neither in the bag nor among the standard ones" in log.skipped["/odd"]


def test_a_split_bag_is_one_log_in_the_order_of_its_metadata(tmp_path: Path) -> None:
    rec = recording()
    folder = write_rosbag2(tmp_path / "split", rec)
    (folder / "split.db3").rename(folder / "split_1.db3")
    earlier = recording(poses=5, commands=3)
    write_storage(folder / "split_0.db3", earlier)
    shutil.rmtree(folder / "split_0.db3_folder")
    names = "  - split_0.db3\n  - elsewhere/split_1.db3\n"
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{names}")

    pose = as_recording(read(folder)).pose

    np.testing.assert_array_equal(pose, np.concatenate([earlier.pose, rec.pose]))


def mat_arrays(value: object, name: str) -> dict[str, np.ndarray]:
    """Arrays of numbers in what scipy reads, structures dotted."""
    if not isinstance(value, np.ndarray):
        return {}
    if value.dtype.names and type(value) is np.ndarray and value.size == 1:
        parts = (mat_arrays(value.flat[0][label], f"{name}.{label}") for label in value.dtype.names)
        return {label: array for part in parts for label, array in part.items()}
    return {name: np.atleast_1d(value.squeeze())} if value.dtype.kind in "biuf" else {}


def assert_as_scipy(path: Path) -> None:
    """Reads a MAT file and compares with scipy."""
    columns = read(path).tables[path.stem].columns
    with warnings.catch_warnings(action="ignore"):
        content = scipy.io.loadmat(path, mat_dtype=True)
    arrays = [mat_arrays(value, name) for name, value in content.items() if not name.startswith("__")]
    expected = {name: array for part in arrays for name, array in part.items()}

    assert set(columns) == set(expected)
    for name, values in columns.items():
        assert values.dtype == expected[name].dtype.newbyteorder("=") or not values.size
        np.testing.assert_array_equal(values, expected[name].reshape(values.shape))


MAT_CONTENT = {
    "log": {"t": np.arange(5.0), "inner": {"x": np.eye(2, 5), "far": {"y": np.float32([[1], [2]])}}, "empty": []},
    "text": "hover", "cell": np.array([1, "a"], "O"), "complex": np.array([1j, 2]), "cube": np.ones((2, 3, 4)),
    "dt": 0.1, "none": np.zeros((0, 0)), "flag": np.array([True, False]), "short": np.arange(3, dtype="i2"),
    "huge": np.array([2**63], "u8"), "s": np.zeros(2, [("a", "f8")]), "flat": np.ones((2, 1, 3)),
}  # fmt: skip


@pytest.mark.parametrize("packed", [False, True])
def test_mat_arrays_come_as_scipy_reads_them_and_the_rest_is_named(packed: bool, tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", MAT_CONTENT, do_compression=packed)

    log = read(tmp_path / "a.mat")

    assert set(log.tables["a"].columns) == {
        "log.t", "log.inner.x", "log.inner.far.y", "log.empty", "dt", "none", "flag", "short", "huge", "flat",
    }  # fmt: skip
    assert log.notes == ("variables left out because they are not arrays of numbers: text, cell, complex, cube, s",)
    arrays = {name: value for name, value in MAT_CONTENT.items() if name not in ("cube", "complex")}
    scipy.io.savemat(tmp_path / "b.mat", arrays, do_compression=packed)
    assert_as_scipy(tmp_path / "b.mat")


MATLAB_FILES = [*(f"test{name}_[567].*" for name in ("double", "matrix", "minus", "multi", "structnest"))]


@pytest.mark.parametrize("pattern", [*MATLAB_FILES, "testbool_8_*", "*_endian.mat"])
def test_files_that_matlab_wrote_come_as_scipy_reads_them(pattern: str) -> None:
    folder = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
    if not folder.is_dir():
        pytest.skip("this scipy comes without its test data")
    paths = sorted(folder.glob(pattern))

    assert paths
    for path in paths:
        assert_as_scipy(path)


def test_real_mat_files_come_as_scipy_reads_them(real_flights: Path) -> None:
    paths = sorted(real_flights.glob("*/*.mat"))

    assert len(paths) == 14
    for path in paths:
        assert_as_scipy(path)


def test_csv_keeps_whole_numbers_and_says_which_columns_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text('\ufeff"time, s",x [m], mode ,armed,n,x [m],\n1,0.5,"A, B",True,,7,\n2, .25,,False,3,8,\n')

    log = read(path)
    columns = log.tables["log"].columns

    assert {name: values.dtype.kind for name, values in columns.items()} == {
        "time, s": "i", "x [m]": "f", "armed": "b", "n": "f",
    }  # fmt: skip
    np.testing.assert_array_equal(columns["x [m]"], [0.5, 0.25])
    np.testing.assert_array_equal(columns["n"], [np.nan, 3])
    assert log.notes == (
        "columns left out because they hold text: mode",
        "columns left out because an earlier one has their name: x [m]",
    )


def test_a_csv_whose_numbers_turn_fractional_late_keeps_them(tmp_path: Path) -> None:
    values = [*range(3000), 0.5]
    (tmp_path / "a.csv").write_text("t,x\n" + "".join(f"{row},{value}\n" for row, value in enumerate(values)))

    np.testing.assert_array_equal(read(tmp_path / "a.csv").tables["a"].columns["x"], values)


def test_decimal_commas_are_understood_from_whichever_row_has_the_first(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t;x\n0;0\n1; 0,5\n2;-1,25\n")

    np.testing.assert_array_equal(read(tmp_path / "a.csv").tables["a"].columns["x"], [0, 0.5, -1.25])


def test_decimal_commas_are_understood_beside_dates_with_points(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t;x\n2025-03-01T10:00:00.000;0,5\n2025-03-01T10:00:00.250;-1,25\n")
    columns = read(tmp_path / "a.csv").tables["a"].columns

    np.testing.assert_array_equal(columns["x"], [0.5, -1.25])
    assert np.diff(columns["t"]).tolist() == [250_000_000]


def test_the_digest_is_that_of_the_file_and_of_a_folder_that_of_its_files_by_name(tmp_path: Path) -> None:
    from hashlib import sha256

    path = write_csv(tmp_path / "a.csv", recording())
    folder = write_rosbag2(tmp_path / "bag", recording())
    joined = b"".join((folder / name).read_bytes() for name in ("bag.db3", "metadata.yaml"))

    assert read(path).sha256 == sha256(path.read_bytes()).hexdigest()
    assert read(folder).sha256 == sha256(joined).hexdigest()


def test_importing_the_readers_imports_nothing_heavy() -> None:
    heavy = {"scipy", "polars", "rosbags", "h5py", "numba"}
    code = f"import sys, rotorfit.files.logs; print(sorted({heavy!r} & set(sys.modules)))"

    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


REAL = {
    "bebop2-wsu": ("*.mat", 2, {"Time", "CI", "SS"}),
    "dji-hexarotor": ("*.mat", 6, {"t", "xu", "yu", "zu", "psi", "vf_ref", "vl_ref", "ve_ref", "w_ref"}),
    "ardrone2-optitrack": ("*.mat", 6, {"TIME", "X_opt", "dControlSig"}),
    "bebop2-joystick": ("*.csv", 1, {"time", "x", "yaw", "cmd_linx", "cmd_angz"}),
    "tello": ("*.txt", 1, {"timestamp", "Ux", "vx", "tof"}),
    "bebop2-optitrack": ("*.bag", 4, {"log_time", "header.stamp", *POSE_FIELDS}),
}


@pytest.mark.parametrize("folder", REAL)
def test_real_flights_hold_the_columns_that_their_cards_name(folder: str, real_flights: Path) -> None:
    pattern, count, names = REAL[folder]
    paths = sorted((real_flights / folder).glob(pattern))

    assert len(paths) == count
    for path in paths:
        log = read(path)
        table = log.tables["/rigid_body_1/pose"] if folder == "bebop2-optitrack" else log.tables[path.stem]
        assert names <= set(table.columns)
        assert all(table.columns[name].size >= 100 for name in names)
        assert log.skipped == {}


def test_formats_are_named_once_and_importable() -> None:
    assert {kind for kind, _ in WRITERS.values()} == set(FORMATS)
