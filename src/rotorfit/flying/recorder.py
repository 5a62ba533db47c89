"""Recorder: writes what a flight sends and receives to an MCAP file as it happens.

Messages are packed by the caller and written by a thread of the recorder, ten times a second: a slow disk does not stop
the loop, and a killed process loses no more than the last tenth of a second. There are no chunks, so whatever is on the
disk can be read from front to back.

Source: https://mcap.dev/spec for the file, OMG DDSI-RTPS 2.3, 10 (plain CDR, little endian) for the messages.
"""

import json
import os
import struct
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

from rotorfit.core.errors import LogError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Sample
from rotorfit.files.logs.mcap import ATTACHED, EVENTS
from rotorfit.files.logs.mcap_records import MAGIC
from rotorfit.flying.beside import Beside
from rotorfit.version import __version__

COMMAND, POSE, VELOCITY, BATTERY, WINDOW = (
    f"/rotorfit/{name}" for name in ("command", "pose", "velocity", "battery", "window")
)
"""Topics. `window` is true while the plan is flown: not during the approach, and not after the flight has ended."""

PERIOD = 0.1
"""Longest time that a message waits for the disk [s]."""

STALLED = 5.0
"""Time without a successful write after which the disk counts as full [s]."""

_STAMP = "builtin_interfaces/Time stamp\nstring frame_id\n"

_TIME = "int32 sec\nuint32 nanosec\n"

_XYZ = "float64 x\nfloat64 y\nfloat64 z\n"


def _definition(text: str, **parts: str) -> str:
    """A message definition followed by those that it needs, joined as in ROS 2."""
    bar = "=" * 80
    return text + "".join(f"{bar}\nMSG: {name.replace('__', '/')}\n{part}" for name, part in parts.items())


_HEADER = {"std_msgs__Header": _STAMP, "builtin_interfaces__Time": _TIME}

_TWIST = _definition(
    "std_msgs/Header header\ngeometry_msgs/Twist twist\n",
    **_HEADER,
    geometry_msgs__Twist="geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    geometry_msgs__Vector3=_XYZ,
)

_POSE = _definition(
    "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    **_HEADER,
    geometry_msgs__Pose="geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    geometry_msgs__Point=_XYZ,
    geometry_msgs__Quaternion=_XYZ + "float64 w\n",
)

_TOPICS = {
    COMMAND: ("geometry_msgs/msg/TwistStamped", _TWIST),
    POSE: ("geometry_msgs/msg/PoseStamped", _POSE),
    VELOCITY: ("geometry_msgs/msg/TwistStamped", _TWIST),
    BATTERY: ("std_msgs/msg/Float64", "float64 data\n"),
    WINDOW: ("std_msgs/msg/Bool", "bool data\n"),
    EVENTS: ("std_msgs/msg/String", "string data\n"),
}

_CDR = b"\0\1\0\0"

_TWIST_LAYOUT = struct.Struct(
    "<4siII8s4x6d"
)  # encapsulation header, stamp, "heading" with its length, six numbers aligned to 8 bytes

_POSE_LAYOUT = struct.Struct("<4siII6s6x7d")

_NUMBER, _FLAG, _LENGTH = struct.Struct("<4sd"), struct.Struct("<4s?"), struct.Struct("<4sI")


class _Queue:
    """The stream that the MCAP writer writes to; its parts wait for the thread that writes them to the disk.

    A deque, because two threads can use its two ends without a lock.
    """

    def __init__(self) -> None:
        self._parts: deque[bytes] = deque()
        self._size = 0

    def write(self, part: bytes) -> int:
        self._parts.append(part)
        self._size += len(part)
        return len(part)

    def tell(self) -> int:
        return self._size

    def taken(self) -> bytes:
        """Removes and returns all waiting parts."""
        return b"".join([self._parts.popleft() for _ in range(len(self._parts))])


class Recorder:
    """Records what is sent, received and decided, without waiting for the disk.

    Attributes:
        path: Path of the file.
        fault: Why the file no longer grows; empty while it does. What was written stays readable.
        commands: Number of commands recorded.
        poses: Number of poses recorded.
    """

    def __init__(self, file: BinaryIO, path: Path, attached: Mapping[str, str], beside: Beside | None = None) -> None:
        from mcap.writer import Writer

        self._beside = beside
        self.path, self.fault = path, ""
        self.commands = self.poses = 0
        self._file, self._queue = file, _Queue()
        self._writer: Any = Writer(cast("Any", self._queue), use_chunking=False)
        self._writer.start(profile="ros2", library=f"rotorfit {__version__}")
        self.attach({**attached, "rotorfit": __version__})
        self._channel: dict[str, int] = {}
        self._closing = threading.Event()
        self._written = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="rotorfit-recorder", daemon=True)
        self._thread.start()

    def attach(self, texts: Mapping[str, str]) -> None:
        """Writes texts that a reader gets with the streams; those of the same name before count no more."""
        self._writer.add_metadata(ATTACHED, dict(texts))

    def command(self, stamp: int, command: Sequence[float]) -> None:
        """Records a command that was sent at `stamp` by the link's clock [ns]."""
        self.commands += 1
        self._add(COMMAND, stamp, _twist(stamp, command))
        if self._beside:
            self._beside.take(Sample("command", stamp, stamp, tuple(command)))
            for text in self._beside.news():
                self.event(stamp, text)

    def sample(self, sample: Sample) -> None:
        """Records a sample as it was received."""
        if sample.stream == "pose":
            self.poses += 1
            x, y, z, qw, qx, qy, qz = sample.values
            seconds, rest = divmod(sample.stamp, 1_000_000_000)
            data = _POSE_LAYOUT.pack(_CDR, seconds, rest, 6, b"world", x, y, z, qx, qy, qz, qw)
            self._add(POSE, sample.received, data)
            if self._beside:
                self._beside.take(sample)
        elif sample.stream == "velocity":
            self._add(VELOCITY, sample.received, _twist(sample.stamp, sample.values))
        elif sample.stream == "command":
            self.commands += 1
            self._add(COMMAND, sample.received, _twist(sample.stamp, sample.values))
            if self._beside:
                self._beside.take(sample)
        elif sample.stream == "obeys":
            self.window(sample.received, bool(sample.values[0]))
        elif sample.stream == "said":
            self.event(sample.received, sample.text)
        else:
            self._add(BATTERY, sample.received, _NUMBER.pack(_CDR, sample.values[0]))

    def window(self, stamp: int, flown: bool) -> None:
        """Records whether the plan is flown from `stamp` [ns] on."""
        self._add(WINDOW, stamp, _FLAG.pack(_CDR, flown))
        if self._beside:
            self._beside.take(Sample("obeys", stamp, stamp, (float(flown),)))

    def event(self, stamp: int, text: str) -> None:
        """Records an event at `stamp` [ns]."""
        data = text.encode() + b"\0"
        self._add(EVENTS, stamp, _LENGTH.pack(_CDR, len(data)) + data)

    def json_message(self, topic: str, stamp: int, mapping: Mapping[str, Any]) -> None:
        """Records plain types as a JSON message on a topic at `stamp` [ns].

        Raises:
            ValueError: A number is not finite.
        """
        if topic not in self._channel:
            schema = self._writer.register_schema(
                topic.strip("/").replace("/", "."), "jsonschema", b'{"type": "object"}'
            )
            self._channel[topic] = self._writer.register_channel(topic, "json", schema)
        data = json.dumps(mapping, allow_nan=False).encode()
        self._writer.add_message(self._channel[topic], stamp, data, stamp)

    def stalled(self) -> bool:
        """Whether the disk has taken nothing for `STALLED` seconds."""
        return time.monotonic() - self._written > STALLED

    def close(self) -> None:
        """Writes what waits, the summary and the end of the file; does nothing if called again."""
        if self._closing.is_set():
            return
        self._writer.finish()
        self._closing.set()
        self._thread.join(STALLED)
        if self._thread.is_alive():
            self.fault = self.fault or _stalled(self.path)

    def _add(self, topic: str, stamp: int, data: bytes) -> None:
        if topic not in self._channel:  # a stream that never comes is not declared
            name, definition = _TOPICS[topic]
            schema = self._writer.register_schema(name, "ros2msg", definition.encode())
            self._channel[topic] = self._writer.register_channel(topic, "cdr", schema)
        self._writer.add_message(self._channel[topic], stamp, data, stamp)

    def _run(self) -> None:
        """Body of the thread: writes until the end, or until the disk fails, which sets `fault`."""
        try:
            with self._file:
                last = False
                while not last:
                    last = self._closing.wait(PERIOD)
                    left = memoryview(self._queue.taken())
                    while left:
                        left = left[self._file.write(left) :]
                    self._written = time.monotonic()
        except OSError as error:
            self.fault = (
                f"{self.path}: {error.strerror or error}; free some room on the disk; what was written is readable"
            )


def record(path: str | Path, attached: Mapping[str, str], beside: Beside | None = None) -> Recorder:
    """Begins a recording.

    Args:
        path: Path of a file that does not exist yet.
        attached: Texts that are written first: `plan` and `card` (TOML), `link`.
        beside: A tracker that is fed what is recorded; its alarms become events.

    Raises:
        LogError: The file exists, or cannot be created.
    """
    path = Path(path)
    try:
        file = path.open("xb", buffering=0)
    except FileExistsError:
        raise LogError(f"{path}: exists, and a recording is never overwritten; choose another name") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be written ({error.strerror}); check the folder and its permissions") from error
    return Recorder(cast("BinaryIO", file), path, attached, beside)  # unbuffered: each write reaches the system at once


def was_ended(path: str | Path) -> bool:
    """Whether a recording has its end: a disk that failed, or a kill, leaves one without."""
    with Path(path).open("rb") as file:
        file.seek(max(file.seek(0, os.SEEK_END) - len(MAGIC), 0))
        return file.read() == MAGIC


def card_as_recorded(
    raw: Mapping[str, Any],
    pose_clock: str = "header.stamp",
    command_clock: str = "log_time",
    pose_error: float = 0.0,
    command_error: float = 0.0,
) -> dict[str, Any]:
    """A raw card with the columns of a recording, and the meanings, limits and priors of the given card.

    Args:
        raw: Raw card of the commands that are flown.
        pose_clock: `header.stamp`, the sender's clock, or `log_time`, the time of arrival.
        command_clock: Likewise; of the commands that `fly` sends, `log_time` is when they were sent.
        pose_error: Half the 95 % interval of what all stamps of the poses may be off by [s].
        command_error: Likewise, of the commands.
    """
    parts = {"x": "linear.x", "y": "linear.y", "z": "linear.z", "yaw": "angular.z"}
    kept = {axis: raw["command"][axis] for axis in AXES if axis in raw["command"]}
    told = {
        axis: {
            key: channel[key] for key in ("meaning", "full_scale") if isinstance(channel, Mapping) and key in channel
        }
        for axis, channel in kept.items()
    }
    hold = {"hold": raw["command"]["hold"]} if "hold" in raw["command"] else {}
    command = {axis: {"from": f"{COMMAND}:twist.{parts[axis]}", **told[axis]} for axis in kept}

    def time(clock: str, error: float) -> Any:
        return {"from": clock, "error": error} if error else clock

    position = {axis: f"{POSE}:pose.position.{axis}" for axis in ("x", "y", "z")}
    return {
        "name": raw.get("name", "rotorfit fly"),
        "frame": "ENU",
        "command": {"frame": "heading", "time": time(f"{COMMAND}:{command_clock}", command_error), **hold, **command},
        "pose": {
            "time": time(f"{POSE}:{pose_clock}", pose_error),
            **position,
            "quaternion": f"{POSE}:pose.orientation",
        },
        "window": {"when": f"{WINDOW}:data"},
        **{key: raw[key] for key in ("limits", "prior") if key in raw},
    }


def _twist(stamp: int, values: Sequence[float]) -> bytes:
    seconds, rest = divmod(stamp, 1_000_000_000)
    return _TWIST_LAYOUT.pack(_CDR, seconds, rest, 8, b"heading", *values[:3], 0.0, 0.0, values[3])


def _stalled(path: Path) -> str:
    return f"{path}: the disk has taken nothing for {STALLED:g} s; record to another one; what was written is readable"
