"""ROS 1 bags (format 2.0), read from front to back, so that a bag cut short or without index gives what it has.

Source: http://wiki.ros.org/Bags/Format/2.0
"""

import struct
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from rotorfit.errors import LogError
from rotorfit.sources.collector import Collector
from rotorfit.sources.compression import unpacked
from rotorfit.sources.content import LIMIT, Content, DamageError
from rotorfit.sources.messages import Topic, normal_type

_MAGIC, _VERSION = b"#ROSBAG V", b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _CHUNK, _CONNECTION = b"\x02", b"\x03", b"\x05", b"\x07"
_U32, _U64, _TIME = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")

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


def _walk(path: Path, file: BinaryIO, size: int, collector: Collector) -> None:
    """Walks the records of the file: chunks of messages, connections, index."""
    topics: dict[int, Topic] = {}
    try:
        for header, data in _records(file, size):
            kind = header.get(b"op")
            if kind == _BAG_HEADER:
                _check_bag_header(path, header, size, collector)
            elif kind == _CHUNK:
                _chunk(file.tell(), header, data, topics, collector)
            else:
                _record(header, data, topics, collector)
    except DamageError as error:
        collector.note(f"damaged after byte {file.tell()} of {size} ({error}); read up to there")


def _check_bag_header(path: Path, header: _Header, size: int, collector: Collector) -> None:
    """Says whether the bag was closed and is whole; an encrypted one cannot be read."""
    if header.get(b"encryptor"):
        raise LogError(f"{path}: an encrypted bag; decrypt it with `rosbag decrypt`")
    index = _number(header, b"index_pos", _U64)
    if index == 0:
        collector.note("the bag was never closed and has no index; read from front to back")
    elif index > size:
        collector.note(f"the bag is cut short: {size} bytes, its index would begin at {index}")


def _chunk(position: int, header: _Header, data: bytes, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes the messages of a chunk; damage inside costs the rest of this chunk only."""
    try:
        size = _number(header, b"size", _U32)
        plain = unpacked(data, header.get(b"compression", b"").decode("latin-1"), size)
        for inner, content in _records(BytesIO(plain), len(plain)):
            _record(inner, content, topics, collector)
        if len(plain) < size:
            raise DamageError(f"{len(plain)} of {size} bytes")
    except DamageError as error:
        collector.note(f"the chunk that ends at byte {position} is damaged ({error}); read up to the damage")


def _record(header: _Header, data: bytes, topics: dict[int, Topic], collector: Collector) -> None:
    """Takes a message or a connection."""
    kind = header.get(b"op")
    if kind == _MESSAGE:
        topic = topics.get(_number(header, b"conn", _U32))
        if topic is None:
            raise DamageError("a message without its connection")
        if len(time := header.get(b"time", b"")) != _TIME.size:
            raise DamageError("a message without a time")
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


def _records(file: BinaryIO, size: int) -> Iterator[tuple[_Header, bytes]]:
    """Records up to `size`; of a record cut short, a chunk's part is given before the damage is raised."""
    left = size - file.tell()
    while left > 0:
        header = _fields(_block(file, left))
        left = size - file.tell()
        length = _length(file, left)
        left -= 4
        if length > left and header.get(b"op") != _CHUNK:
            raise DamageError("the last record is cut short")
        if length > LIMIT:
            raise DamageError(f"a record of {length} bytes")
        yield header, file.read(min(length, left))
        if length > left:
            raise DamageError("the last chunk is cut short")
        left -= length


def _block(file: BinaryIO, left: int) -> bytes:
    """Bytes with their length before them."""
    length = _length(file, left)
    if length > left - 4:
        raise DamageError("a record's header is cut short")
    return file.read(length)


def _length(file: BinaryIO, left: int) -> int:
    """The length that stands before a block."""
    if left < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(file.read(4), "little")


def _fields(header: bytes) -> _Header:
    """Fields of a header: `name=value`, each with its length before it."""
    fields: _Header = {}
    position, size = 0, len(header)
    while position < size:
        end = position + 4 + int.from_bytes(header[position : position + 4], "little")
        name, sign, value = header[position + 4 : end].partition(b"=")
        if end > size or not sign:
            raise DamageError("a record's header cannot be understood")
        fields[name] = value
        position = end
    return fields


def _number(header: _Header, name: bytes, form: struct.Struct) -> int:
    """A number in a header."""
    value = header.get(name, b"")
    if len(value) != form.size:
        raise DamageError(f"a record without {name.decode()}")
    return int(form.unpack(value)[0])
