"""ROS 1 bags (format 2.0), read from front to back, so that a bag cut short or without index yields what it has.

The index after each chunk only speeds this up: chunks without a requested topic are not decompressed, and messages are
located all at once instead of one after the other.

Source: http://wiki.ros.org/Bags/Format/2.0
"""

import struct
from collections.abc import Collection
from dataclasses import dataclass, field
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from rotorfit.core.errors import LogError
from rotorfit.files.logs.batches import Fault, Messages, Places, integers, stretches
from rotorfit.files.logs.compression import unpacked
from rotorfit.files.logs.content import BLOCK_LIMIT, Content, DamageError, TornError
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
        topics: dict[int, Topic] = {}
        walk: _Walk | None = _Walk(path, file, path.stat().st_size, len(_VERSION))
        while walk is not None:
            walk = _walked(walk, topics, collector)
    return collector.content()


@dataclass
class _Chunk:
    """A chunk that waits until the index after it is known.

    Attributes:
        header: Header of its record.
        place: Offset of the record in the file.
        start: Offset of its data in the file.
        length: Length of the data, as far as present [byte].
        torn: Whether damage follows directly, so that its last record may be torn.
        index: Connection to the offsets of its messages in the decompressed chunk.
    """

    header: Header
    place: int
    start: int
    length: int
    torn: bool = False
    index: dict[int, Places] = field(default_factory=dict)


@dataclass
class _Walk:
    """A walk from record to record, with what is still pending.

    Attributes:
        path: Path of the file.
        file: The file that is read.
        size: Its size [byte].
        place: Offset of the current record.
        chunk: Chunk that waits until the index after it is known.
        message: Message outside of chunks, with its offset: it waits until a record follows, as it may be torn.
    """

    path: Path
    file: BinaryIO
    size: int
    place: int
    chunk: _Chunk | None = None
    message: tuple[int, Header, bytes] | None = None


def _walked(walk: _Walk, topics: dict[int, Topic], collector: Collector) -> _Walk | None:
    """Walks to the end, or to damage; in the latter case returns a walk that resumes behind it, if possible."""
    try:
        while walk.place < walk.size:
            header, start, length = _head(walk)
            _pass(walk, header, start, length, topics, collector)
            walk.place = start + length
        _settle(walk, topics, collector)
        return None
    except DamageError as error:
        if isinstance(error, TornError) and walk.message:
            walk.place, walk.message = walk.message[0], None
        place = walk.place
        if walk.chunk and isinstance(error, TornError):
            walk.chunk.torn = place == walk.chunk.start + walk.chunk.length
        _settle(walk, topics, collector)
        behind = None if collector.losses.many else _behind(walk, place + 1, topics)
        collector.losses.found(place, walk.size, (behind or walk.size) - place, str(error))
        return None if behind is None else _Walk(walk.path, walk.file, walk.size, behind)


def _pass(walk: _Walk, header: Header, start: int, length: int, topics: dict[int, Topic], collector: Collector) -> None:
    """Handles one record, and what waited for it."""
    kind = header.get(b"op")
    if kind == INDEX:
        if walk.chunk is not None:
            _keep_index(walk.file, walk.chunk, header, start, length)
        return
    if kind == MESSAGE and (
        number_of(header, b"conn", U32) not in topics or len(header.get(b"time", b"")) != TIME.size
    ):
        raise TornError("a message without its connection or time")
    _settle(walk, topics, collector)
    if kind == BAG_HEADER:
        _check_bag_header(walk.path, header, walk.size, collector)
    elif kind == CHUNK:
        walk.chunk = _Chunk(header, walk.place, start, min(length, walk.size - start))
        if length > walk.size - start:
            behind = None if collector.losses.many else _behind(walk, start, topics, in_chunk=False)
            walk.place = walk.size if behind is None else behind
            walk.chunk.length = walk.place - start
            raise DamageError("the chunk before it is cut short")
    elif kind == MESSAGE:
        walk.message = walk.place, header, _bytes(walk.file, start, length)
    else:
        _record(header, _bytes(walk.file, start, length), topics, collector)


def _settle(walk: _Walk, topics: dict[int, Topic], collector: Collector) -> None:
    """Handles what is pending."""
    chunk, message, walk.chunk, walk.message = walk.chunk, walk.message, None, None
    if chunk is not None:
        _take(walk, chunk, topics, collector)
    if message is not None:
        _record(message[1], message[2], topics, collector)


def _behind(walk: _Walk, start: int, topics: dict[int, Topic], in_chunk: bool = True) -> int | None:
    """Where records resume."""
    with mmap(walk.file.fileno(), 0, access=ACCESS_READ) as data:
        return next_record(data, start, topics, in_chunk)


def _check_bag_header(path: Path, header: Header, size: int, collector: Collector) -> None:
    """Reports whether the bag was closed and is whole; raises `LogError` on an encrypted one."""
    if header.get(b"encryptor"):
        raise LogError(f"{path}: an encrypted bag; decrypt it with `rosbag decrypt`")
    index = number_of(header, b"index_pos", U64)
    if index == 0:
        collector.damaged("the bag was never closed and has no index: what was recorded behind its end is lost")
    elif index > size:
        collector.damaged(f"the bag is cut short: {size} bytes, its index would begin at {index}")


def _keep_index(file: BinaryIO, chunk: _Chunk, header: Header, start: int, length: int) -> None:
    """Stores the offsets of one connection's messages in the chunk; the index is discarded if it is implausible."""
    try:
        number, claim = number_of(header, b"conn", U32), number_of(chunk.header, b"size", U32)
        room = claim // _LEAST_RECORD - sum(map(len, chunk.index.values()))
        if length > room * INDEX_ENTRY.itemsize or length % INDEX_ENTRY.itemsize or len(chunk.index) == _MOST_INDEXED:
            raise DamageError("more than fits in the chunk")
        chunk.index[number] = np.frombuffer(_bytes(file, start, length), INDEX_ENTRY)["place"].astype(np.int64)
    except DamageError:
        chunk.index.clear()


def _take(walk: _Walk, chunk: _Chunk, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes the messages of a chunk; damage loses the messages it hits, in a compressed chunk also all after it."""
    if collector.passed_over(topics, chunk.index):
        return
    left = chunk.length

    def resume(data: bytes, start: int) -> int | None:
        return None if collector.losses.many else next_record(data, start, topics)

    try:
        claim = number_of(chunk.header, b"size", U32)
        packed = _bytes(walk.file, chunk.start, chunk.length)
        plain = unpacked(packed, chunk.header.get(b"compression", b"").decode("latin-1"), claim)
        del packed  # a chunk may be large: one copy is enough
        plain = plain[:-1] if chunk.torn else plain  # makes the last record incomplete
        hints = np.concatenate([*chunk.index.values(), np.zeros(0, np.int64)])
        for part in stretches(plain, hints, _ends, _starts, resume):
            left = len(plain) - int(part.starts[0]) if len(part.starts) else 0
            _messages(plain, part.starts, topics, collector)
            if part.lost:
                collector.losses.found(chunk.place, walk.size, part.lost, f"in a chunk, {part.why}")
        left = claim - len(plain)
        if left > 0:
            raise DamageError(f"{len(plain)} of {claim} bytes")
    except DamageError as error:
        collector.losses.found(chunk.place, walk.size, left, f"in a chunk, {error}")


def _messages(plain: bytes, starts: Places, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes records of a decompressed chunk, all at once where their headers are uniform."""
    heads = integers(plain, starts, "<u4")
    bodies = starts + 8 + heads
    found = Messages(plain, bodies, integers(plain, bodies - 4, "<u4"))
    headers = Messages(plain, starts + 4, heads)
    if not _at_once(headers, found, topics, collector):
        for row in range(len(found)):
            _record(fields_of(headers.one(row)), found.one(row), topics, collector)


def _at_once(headers: Messages, found: Messages, topics: dict[int, Topic], collector: Collector) -> bool:
    """Takes messages with headers of a few layouts at once; returns False, with none taken, otherwise."""
    numbers, times = np.full(len(found), -1), np.zeros(len(found), np.int64)
    left, layouts = np.arange(len(found)), 0
    try:
        while len(left):
            row = int(left[0])
            header = fields_of(headers.one(row))
            if header.get(b"op") != MESSAGE:
                _record(header, found.one(row), topics, collector)
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
    return collector.add_mixed(topics, numbers, times, found)


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


def _record(header: Header, data: bytes, topics: dict[int, Topic], collector: Collector) -> None:
    """Handles a message or a connection."""
    kind = header.get(b"op")
    if kind == MESSAGE:
        topic = topics.get(number_of(header, b"conn", U32))
        if topic is None:
            raise DamageError("a message without its connection")
        if len(time := header.get(b"time", b"")) != TIME.size:
            raise DamageError("a message without time")
        seconds, nanoseconds = TIME.unpack(time)
        collector.add(topic, seconds * 1_000_000_000 + nanoseconds, data)
    elif kind == CONNECTION:
        number = number_of(header, b"conn", U32)
        if number not in topics:  # the index at the end names them again
            topics[number] = _topic(header, fields_of(data))
            collector.declare(topics[number])


def _topic(header: Header, details: Header) -> Topic:
    """The topic of a connection."""
    try:
        name = header[b"topic"].decode()
        msgtype = normal_type(details[b"type"].decode())
        return Topic(name, msgtype, "ros1", details.get(b"message_definition", b"").decode(errors="replace"))
    except (KeyError, UnicodeDecodeError) as error:
        raise DamageError("a connection without topic or type") from error


def _head(walk: _Walk) -> tuple[Header, int, int]:
    """Header, start and length of the data of the current record; only a chunk may be cut short."""
    walk.file.seek(walk.place)
    header = fields_of(_block(walk.file, walk.size - walk.place))
    start = walk.file.tell() + 4
    length = _length(walk.file, walk.size - start + 4)
    if length > walk.size - start and header.get(b"op") != CHUNK:
        raise DamageError("a record is cut short")
    return header, start, length


def _bytes(file: BinaryIO, start: int, length: int) -> bytes:
    """The data of a record."""
    if length > BLOCK_LIMIT:
        raise DamageError(f"a record of {length} bytes")
    file.seek(start)
    return file.read(length)


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
