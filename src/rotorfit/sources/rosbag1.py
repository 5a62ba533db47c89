"""ROS 1 bags (format 2.0), read from front to back, so that a bag cut short or without index gives what it has.

The index behind each chunk only makes this faster: chunks without a wanted topic are not unpacked, messages are
found at once and not one after the other.

Source: http://wiki.ros.org/Bags/Format/2.0
"""

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from rotorfit.errors import LogError
from rotorfit.sources.block import Messages, Places, integers, record_starts
from rotorfit.sources.collector import Collector
from rotorfit.sources.compression import unpacked
from rotorfit.sources.content import BLOCK_LIMIT, Content, DamageError
from rotorfit.sources.messages import Topic, normal_type

_MAGIC, _VERSION = b"#ROSBAG V", b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CONNECTION = b"\x02", b"\x03", b"\x04", b"\x05", b"\x07"
_U32, _U64, _TIME = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")
_INDEX_ENTRY = np.dtype([("time", "<u8"), ("place", "<u4")])  # the place in the unpacked chunk
_LEAST_RECORD = 8  # bytes
_MOST_INDEXED = 1 << 12  # connections in a chunk
_LONGEST_HEADER = 1 << 20
_MOST_LAYOUTS = 8  # of message headers in a chunk; a writer has one

_Header = dict[bytes, bytes]


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins as a ROS 1 bag does."""
    return head.startswith(_MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the wanted topics; see `sources.read`.

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
        _walk(path, file, path.stat().st_size, collector)
    return collector.content()


@dataclass
class _Chunk:
    """A chunk that waits until the index behind it is known.

    Attributes:
        header: Of its record.
        start: Of its bytes in the file.
        length: Of them, as far as they are there.
        index: Connection to the places of its messages in the unpacked chunk.
    """

    header: _Header
    start: int
    length: int
    index: dict[int, Places] = field(default_factory=dict)


def _walk(path: Path, file: BinaryIO, size: int, collector: Collector) -> None:
    """Walks the records of the file: chunks of messages, connections, index."""
    topics: dict[int, Topic] = {}
    chunk: _Chunk | None = None
    try:
        for header, start, length in _records(file, size):
            kind = header.get(b"op")
            if kind == _INDEX:
                if chunk is not None:
                    _keep_index(file, chunk, header, start, length)
                continue
            _take(file, chunk, topics, collector)
            chunk = None
            if kind == _BAG_HEADER:
                _check_bag_header(path, header, size, collector)
            elif kind == _CHUNK:
                chunk = _Chunk(header, start, length)
            else:
                _record(header, _bytes(file, start, length), topics, collector)
        _take(file, chunk, topics, collector)
    except DamageError as error:
        place = file.tell()
        _take(file, chunk, topics, collector)
        collector.note(f"damaged after byte {place} of {size} ({error}); read up to there")


def _check_bag_header(path: Path, header: _Header, size: int, collector: Collector) -> None:
    """Says whether the bag was closed and is whole; an encrypted one cannot be read."""
    if header.get(b"encryptor"):
        raise LogError(f"{path}: an encrypted bag; decrypt it with `rosbag decrypt`")
    index = _number(header, b"index_pos", _U64)
    if index == 0:
        collector.note("the bag was never closed and has no index; read from front to back")
    elif index > size:
        collector.note(f"the bag is cut short: {size} bytes, its index would begin at {index}")


def _keep_index(file: BinaryIO, chunk: _Chunk, header: _Header, start: int, length: int) -> None:
    """Keeps where the messages of one connection are said to lie in the chunk; one that cannot be is forgotten."""
    try:
        number, claim = _number(header, b"conn", _U32), _number(chunk.header, b"size", _U32)
        room = claim // _LEAST_RECORD - sum(map(len, chunk.index.values()))
        if length > room * _INDEX_ENTRY.itemsize or length % _INDEX_ENTRY.itemsize or len(chunk.index) == _MOST_INDEXED:
            raise DamageError("more than fits in the chunk")
        chunk.index[number] = np.frombuffer(_bytes(file, start, length), _INDEX_ENTRY)["place"].astype(np.int64)
    except DamageError:
        chunk.index.clear()


def _take(file: BinaryIO, chunk: _Chunk | None, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes the messages of a chunk; damage inside costs the rest of this chunk only."""
    if chunk is None or collector.passed_over(topics, chunk.index):
        return
    try:
        size = _number(chunk.header, b"size", _U32)
        packed = _bytes(file, chunk.start, chunk.length)
        plain = unpacked(packed, chunk.header.get(b"compression", b"").decode("latin-1"), size)
        del packed  # a chunk may be large: one copy of it is enough
        _messages(plain, np.concatenate([*chunk.index.values(), np.zeros(0, np.int64)]), topics, collector)
        if len(plain) < size:
            raise DamageError(f"{len(plain)} of {size} bytes")
    except DamageError as error:
        end = chunk.start + chunk.length
        collector.note(f"the chunk that ends at byte {end} is damaged ({error}); read up to the damage")


def _messages(plain: bytes, hints: Places, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes the records of an unpacked chunk, all at once where they are as writers make them."""
    starts, fault = record_starts(plain, hints, _ends, _starts)
    heads = integers(plain, starts, "<u4")
    bodies = starts + 8 + heads
    found = Messages(plain, bodies, integers(plain, bodies - 4, "<u4"))
    headers = Messages(plain, starts + 4, heads)
    if not _at_once(headers, found, topics, collector):
        for row in range(len(found)):
            _record(_fields(headers.one(row)), found.one(row), topics, collector)
    if fault:
        raise DamageError(fault)


def _at_once(headers: Messages, found: Messages, topics: dict[int, Topic], collector: Collector) -> bool:
    """Takes messages with headers of a few layouts at once; False, with none taken, where they are otherwise."""
    numbers, times = np.full(len(found), -1), np.zeros(len(found), np.int64)
    left, layouts = np.arange(len(found)), 0
    try:
        while len(left):
            row = int(left[0])
            header = _fields(headers.one(row))
            if header.get(b"op") != _MESSAGE:
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
    """Messages whose headers differ in connection and time only.

    Attributes:
        rows: Which of the records, shape (N,).
        numbers: Connections, shape (N,).
        times: Of recording [ns], shape (N,).
    """

    rows: Places
    numbers: npt.NDArray[np.int64]
    times: npt.NDArray[np.int64]


def _alike(headers: Messages, left: Places) -> _Alike:
    """Of the records `left`, those with a header like that of the first, which is a message's."""
    header = headers.one(int(left[0]))
    spans = _spans(header)
    number, time = _place(spans, b"conn", _U32), _place(spans, b"time", _TIME)
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
    """Where a value of a header begins."""
    start, end = spans.get(name, (0, 0))
    if end - start != form.size:
        raise DamageError(f"a message without {name.decode()}")
    return start


def _ends(data: bytes, starts: Places) -> Places | None:
    """Ends of the records at these starts; None where one does not fit."""
    if len(data) < 8 or starts.min() < 0 or starts.max() > len(data) - 8:
        return None
    bodies = starts + 8 + integers(data, starts, "<u4")
    if bodies.max() > len(data):
        return None
    ends = bodies + integers(data, bodies - 4, "<u4")
    return None if ends.max() > len(data) else ends


def _starts(data: bytes, start: int, end: int) -> tuple[list[int], str]:
    """Walks records from one place to another: their starts, and what is wrong behind the last that is whole."""
    starts: list[int] = []
    length_at = _U32.unpack_from
    try:
        while start < end:
            body = start + 8 + length_at(data, start)[0]
            after = body + length_at(data, body - 4)[0]
            if after > end:
                return starts, "the last record is cut short"
            starts.append(start)
            start = after
    except struct.error:
        return starts, "a record is cut short"
    return starts, ""


def _record(header: _Header, data: bytes, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes a message or a connection."""
    kind = header.get(b"op")
    if kind == _MESSAGE:
        topic = topics.get(_number(header, b"conn", _U32))
        if topic is None:
            raise DamageError("a message without its connection")
        if len(time := header.get(b"time", b"")) != _TIME.size:
            raise DamageError("a message without time")
        seconds, nanoseconds = _TIME.unpack(time)
        collector.add(topic, seconds * 1_000_000_000 + nanoseconds, data)
    elif kind == _CONNECTION:
        number = _number(header, b"conn", _U32)
        if number not in topics:  # the index at the end names them again
            topics[number] = _topic(header, _fields(data))
            collector.declare(topics[number])


def _topic(header: _Header, details: _Header) -> Topic:
    """The topic of a connection."""
    try:
        name = header[b"topic"].decode()
        msgtype = normal_type(details[b"type"].decode())
        return Topic(name, msgtype, "ros1", details.get(b"message_definition", b"").decode(errors="replace"))
    except (KeyError, UnicodeDecodeError) as error:
        raise DamageError("a connection without topic or type") from error


def _records(file: BinaryIO, size: int) -> Iterator[tuple[_Header, int, int]]:
    """Header, place and length of the data of each record; of a chunk cut short, its part before the damage."""
    position = file.tell()
    while position < size:
        file.seek(position)
        header = _fields(_block(file, size - position))
        start = file.tell()
        length = _length(file, size - start)
        start += 4
        if length > size - start and header.get(b"op") != _CHUNK:
            raise DamageError("the last record is cut short")
        yield header, start, min(length, size - start)
        if length > size - start:
            file.seek(size)
            raise DamageError("the last chunk is cut short")
        position = start + length


def _bytes(file: BinaryIO, start: int, length: int) -> bytes:
    """The data of a record."""
    if length > BLOCK_LIMIT:
        raise DamageError(f"a record of {length} bytes")
    file.seek(start)
    return file.read(length)


def _block(file: BinaryIO, left: int) -> bytes:
    """Bytes with their length before them."""
    length = _length(file, left)
    if length > left - 4:
        raise DamageError("a record's header is cut short")
    if length > _LONGEST_HEADER:
        raise DamageError(f"a record's header of {length} bytes")
    return file.read(length)


def _length(file: BinaryIO, left: int) -> int:
    """The length that stands before a block."""
    if left < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(file.read(4), "little")


def _fields(header: bytes) -> _Header:
    """Fields of a header: name to value."""
    return {name: header[start:end] for name, (start, end) in _spans(header).items()}


def _spans(header: bytes) -> dict[bytes, tuple[int, int]]:
    """Where the values of a header lie; its fields are `name=value`, each with its length before it."""
    spans: dict[bytes, tuple[int, int]] = {}
    position, size = 0, len(header)
    while position < size:
        end = position + 4 + int.from_bytes(header[position : position + 4], "little")
        sign = header.find(b"=", position + 4, end)
        if end > size or sign < 0:
            raise DamageError("a record's header cannot be understood")
        spans[header[position + 4 : sign]] = sign + 1, end
        position = end
    return spans


def _number(header: _Header, name: bytes, form: struct.Struct) -> int:
    """A number in a header."""
    value = header.get(name, b"")
    if len(value) != form.size:
        raise DamageError(f"a record without {name.decode()}")
    return int(form.unpack(value)[0])
