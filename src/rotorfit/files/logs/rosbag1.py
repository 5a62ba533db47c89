"""ROS 1 bags (format 2.0); a bag cut short or without index yields what it has.

With the index after each chunk, chunks without a requested topic are not decompressed, and messages are located all at
once instead of one after the other.

Source: http://wiki.ros.org/Bags/Format/2.0
"""

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from rotorfit.core.errors import LogError
from rotorfit.files.logs.batches import Fault, Messages, Places, RecordRun, Resume, integers, stretches
from rotorfit.files.logs.chunked import Chunk, ChunkedFile
from rotorfit.files.logs.compression import unpacked
from rotorfit.files.logs.content import Content, DamageError, TornError
from rotorfit.files.logs.damage import Block
from rotorfit.files.logs.ros_messages import Topic, normal_type
from rotorfit.files.logs.rosbag1_records import (
    BAG_HEADER,
    CHUNK,
    CONNECTION,
    INDEX,
    INDEX_ENTRY,
    LONGEST_HEADER,
    MESSAGE,
    TIME,
    U32,
    U64,
    Header,
    fields_of,
    next_record,
    number_of,
    spans_of,
)
from rotorfit.files.logs.topics import Collector

_MAGIC, _VERSION = b"#ROSBAG V", b"#ROSBAG V2.0\n"

_LEAST_RECORD = 8  # bytes

_MOST_INDEXED = 1 << 12  # connections in a chunk

_MOST_LAYOUTS = 8  # layouts of message headers in a chunk; one writer uses a single one


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins with the magic of a ROS bag."""
    return head.startswith(_MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested topics; see `files.logs.read`.

    Raises:
        LogError: Another version, encrypted, or no message before the damage.
    """
    collector = Collector(path, tables)
    with path.open("rb") as file:
        version = file.readline(64)
        if version != _VERSION:
            raise LogError(
                f"{path}: a ROS bag of version {version[9:-1].decode('latin-1')!r}, only 2.0 is read; "
                "convert it with `rosbag migrate`"
            )
        _Bag(file, path.stat().st_size, len(_VERSION), collector).walk()
    return collector.content()


class _Bag(ChunkedFile[Header]):
    """A ROS 1 bag."""

    def _head(self) -> tuple[Header, int, int]:
        """Header, start and length of the data of the current record; only a chunk may be cut short."""
        self.file.seek(self.place)
        header = fields_of(_block(self.file, self.size - self.place))
        start = self.file.tell() + 4
        length = _length(self.file, self.size - start + 4)
        if length > self.size - start and header.get(b"op") != CHUNK:
            raise DamageError("a record is cut short")
        return header, start, length

    def _pass(self, header: Header, start: int, length: int) -> bool:
        """Handles one record, and what waited for it."""
        kind = header.get(b"op")
        if kind == INDEX:
            if self.chunk is not None:
                self._keep_index(self.chunk, header, start, length)
            return True
        if kind == MESSAGE and (
            number_of(header, b"conn", U32) not in self.topics or len(header.get(b"time", b"")) != TIME.size
        ):
            raise TornError("a message without its connection or time")
        self._settle()
        if kind == BAG_HEADER:
            self._check_bag_header(header)
        elif kind == CHUNK:
            self._begin(header, start, length)
        elif kind == MESSAGE:
            self.message = self.place, header, self._data(start, length)
        else:
            self._record(header, self._data(start, length))
        return True

    def _check_bag_header(self, header: Header) -> None:
        """Reports whether the bag was closed and is whole; raises `LogError` on an encrypted one."""
        if header.get(b"encryptor"):
            raise LogError(f"{self.collector.path}: an encrypted bag; decrypt it with `rosbag decrypt`")
        index = number_of(header, b"index_pos", U64)
        if index == 0:
            self.collector.damaged(
                "the bag was never closed and has no index: what was recorded behind its end is lost"
            )
        elif index > self.size:
            self.collector.damaged(f"the bag is cut short: {self.size} bytes, its index would begin at {index}")

    def _next(self, data: Block, start: int, in_chunk: bool = True) -> int | None:
        return next_record(data, start, self.topics, in_chunk)

    def _keep_index(self, chunk: Chunk[Header], header: Header, start: int, length: int) -> None:
        """Stores the offsets of one connection's messages in the chunk; the index is discarded if it is implausible."""
        try:
            number, claim = number_of(header, b"conn", U32), number_of(chunk.head, b"size", U32)
            room = claim // _LEAST_RECORD - sum(map(len, chunk.index.values()))
            if (
                length > room * INDEX_ENTRY.itemsize
                or length % INDEX_ENTRY.itemsize
                or len(chunk.index) == _MOST_INDEXED
            ):
                raise DamageError("more than fits in the chunk")
            chunk.index[number] = np.frombuffer(self._data(start, length), INDEX_ENTRY)["place"].astype(np.int64)
        except DamageError:
            chunk.index.clear()

    def _plain(self, chunk: Chunk[Header]) -> tuple[bytes, int]:
        claim, method = number_of(chunk.head, b"size", U32), chunk.head.get(b"compression", b"").decode("latin-1")
        return unpacked(self._data(chunk.start, chunk.length), method, claim), claim

    def _runs(self, plain: bytes, hints: Places, resume: Resume) -> Iterator[RecordRun]:
        return stretches(plain, hints, _ends, _starts, resume)

    def _messages(self, plain: bytes, starts: Places) -> None:
        """Takes records of a decompressed chunk, all at once where their headers are uniform."""
        heads = integers(plain, starts, "<u4")
        bodies = starts + 8 + heads
        found = Messages(plain, bodies, integers(plain, bodies - 4, "<u4"))
        headers = Messages(plain, starts + 4, heads)
        if not self._at_once(headers, found):
            for row in range(len(found)):
                self._record(fields_of(headers.one(row)), found.one(row))

    def _at_once(self, headers: Messages, found: Messages) -> bool:
        """Takes messages with headers of a few layouts at once; returns False, with none taken, otherwise."""
        numbers, times = np.full(len(found), -1), np.zeros(len(found), np.int64)
        left, layouts = np.arange(len(found)), 0
        try:
            while len(left):
                row = int(left[0])
                header = fields_of(headers.one(row))
                if header.get(b"op") != MESSAGE:
                    self._record(header, found.one(row))
                    left = left[1:]
                elif layouts == _MOST_LAYOUTS:
                    return False
                else:
                    layouts += 1
                    alike = _alike(headers, left)
                    numbers[alike.rows], times[alike.rows] = alike.numbers, alike.times
                    left = left[numbers[left] < 0]
        except DamageError:
            return False
        return self.collector.add_mixed(self.topics, numbers, times, found)

    def _record(self, header: Header, data: bytes) -> None:
        """Handles a message or a connection."""
        kind = header.get(b"op")
        if kind == MESSAGE:
            topic = self.topics.get(number_of(header, b"conn", U32))
            if topic is None:
                raise DamageError("a message without its connection")
            if len(time := header.get(b"time", b"")) != TIME.size:
                raise DamageError("a message without time")
            seconds, nanoseconds = TIME.unpack(time)
            self.collector.add(topic, seconds * 1_000_000_000 + nanoseconds, data)
        elif kind == CONNECTION:
            number = number_of(header, b"conn", U32)
            if number not in self.topics:  # the index at the end names them again
                self.topics[number] = _topic(header, fields_of(data))
                self.collector.declare(self.topics[number])


@dataclass(frozen=True)
class _Alike:
    """Messages whose headers differ only in connection and time.

    Attributes:
        rows: Indices of the records, shape (N,).
        numbers: Connections, shape (N,).
        times: Recording times [ns], shape (N,).
    """

    rows: Places
    numbers: npt.NDArray[np.int64]
    times: npt.NDArray[np.int64]


def _alike(headers: Messages, left: Places) -> _Alike:
    """Among the records `left`, those with a header like that of the first, which must be a message's."""
    header = headers.one(int(left[0]))
    spans = spans_of(header)
    number, time = _place(spans, b"conn", U32), _place(spans, b"time", TIME)
    left = left[headers.lengths[left] == len(header)]
    varying = bytearray(len(header))
    varying[number : number + 4], varying[time : time + 8] = b"\xff" * 4, b"\xff" * 8
    starts = headers.starts[left]
    same = np.ones(len(left), bool)
    for at in (*range(0, len(header) - 8, 8), len(header) - 8):  # eight bytes at once, the last ones overlap
        word, mask = (int.from_bytes(part[at : at + 8], "little", signed=True) for part in (header, varying))
        same &= (integers(headers.data, starts + at, "<i8") ^ word) & ~mask == 0
    left, starts = left[same], starts[same]
    seconds, nanoseconds = (integers(headers.data, starts + time + part, "<u4") for part in (0, 4))
    return _Alike(left, integers(headers.data, starts + number, "<u4"), seconds * 1_000_000_000 + nanoseconds)


def _place(spans: dict[bytes, tuple[int, int]], name: bytes, form: struct.Struct) -> int:
    """Offset of a value in a header."""
    start, end = spans.get(name, (0, 0))
    if end - start != form.size:
        raise DamageError(f"a message without {name.decode()}")
    return start


def _ends(data: bytes, starts: Places) -> Places | None:
    """Ends of the records with these starts; None if one exceeds the data or is invalid."""
    if len(data) < 8 or starts.min() < 0 or starts.max() > len(data) - 8:
        return None
    heads = integers(data, starts, "<u4")
    bodies = starts + 8 + heads
    if bodies.max() > len(data) or heads.min() == 0:
        return None
    ends = bodies + integers(data, bodies - 4, "<u4")
    return None if ends.max() > len(data) else ends


def _starts(data: bytes, start: int, end: int) -> tuple[list[int], Fault | None]:
    """Walks records from one offset to another: their starts, and the fault after the last whole one."""
    starts: list[int] = []
    length_at = U32.unpack_from
    try:
        while start < end:
            head = length_at(data, start)[0]
            if head == 0 or head > LONGEST_HEADER:
                return starts, Fault(start, "bytes that are no record", torn=True)
            body = start + 8 + head
            after = body + length_at(data, body - 4)[0]
            if after > end:
                return starts, Fault(start, "a record is cut short", torn=False)
            starts.append(start)
            start = after
    except struct.error:
        return starts, Fault(start, "a record is cut short", torn=False)
    return starts, None


def _topic(header: Header, details: Header) -> Topic:
    """The topic of a connection."""
    try:
        name = header[b"topic"].decode()
        msgtype = normal_type(details[b"type"].decode())
        return Topic(name, msgtype, "ros1", details.get(b"message_definition", b"").decode(errors="replace"))
    except (KeyError, UnicodeDecodeError) as error:
        raise DamageError("a connection without topic or type") from error


def _block(file: BinaryIO, left: int) -> bytes:
    """Bytes with a length prefix."""
    length = _length(file, left)
    if not 0 < length <= LONGEST_HEADER:
        raise TornError("bytes that are no record")
    if length > left - 4:
        raise DamageError("a record's header is cut short")
    return file.read(length)


def _length(file: BinaryIO, left: int) -> int:
    """The length prefix of a block."""
    if left < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(file.read(4), "little")
