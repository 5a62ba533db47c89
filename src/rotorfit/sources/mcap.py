"""MCAP files with ROS messages (encodings cdr and ros1), read from front to back without their index.

Source: https://mcap.dev/spec
"""

import struct
from binascii import crc32
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Literal

from rotorfit.log import Event
from rotorfit.sources.collector import Collector
from rotorfit.sources.compression import unpacked
from rotorfit.sources.content import LIMIT, Content, DamageError, one_line
from rotorfit.sources.messages import Topic, normal_type

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0C, 0x0F
ATTACHED, EVENTS = "rotorfit", "/rotorfit/event"
"""Name of the Metadata record, and the topic of std_msgs/msg/String, in which `rotorfit fly` writes what it did."""

_PREFIX, _MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQI")
_LANGUAGES: dict[str, Literal["msg", "idl"]] = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins as MCAP does."""
    return head.startswith(MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the wanted topics; see `sources.read`.

    Raises:
        LogError: No message before the damage.
    """
    collector = Collector(path, tables)
    collect(path, collector)
    return collector.content()


def collect(path: Path, collector: Collector) -> None:
    """Gives all messages of a file to a collector."""
    size = path.stat().st_size
    schemas: dict[int, tuple[str, str, bytes]] = {}
    topics: dict[int, Topic] = {}
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        try:
            for kind, data in _records(file, size):
                if kind in (_DATA_END, _FOOTER):
                    return
                if kind == _CHUNK:
                    _chunk(file.tell(), data, schemas, topics, collector)
                else:
                    _record(kind, data, schemas, topics, collector)
            collector.note("the file was never closed; read from front to back")
        except DamageError as error:
            collector.note(f"damaged after byte {file.tell()} of {size} ({error}); read up to there")


def _chunk(
    position: int, data: bytes, schemas: dict[int, tuple[str, str, bytes]], topics: dict[int, Topic], to: Collector
) -> None:
    """Takes the messages of a chunk; damage inside costs the rest of this chunk only."""
    try:
        if len(data) < _CHUNK_HEAD.size:
            raise DamageError("its head is cut short")
        _, _, size, checksum = _CHUNK_HEAD.unpack_from(data)
        method, start = _text(data, _CHUNK_HEAD.size)
        plain = unpacked(memoryview(data)[start + 8 :], method, size)
        if len(plain) == size and checksum and crc32(plain) != checksum:
            raise DamageError("its checksum is wrong, so none of it is used")
        for kind, record in _records(BytesIO(plain), len(plain)):
            _record(kind, record, schemas, topics, to)
        if len(plain) < size:
            raise DamageError(f"{len(plain)} of {size} bytes")
    except DamageError as error:
        to.note(f"the chunk that ends at byte {position} is damaged ({error}); read up to the damage")


def _record(
    kind: int, data: bytes, schemas: dict[int, tuple[str, str, bytes]], topics: dict[int, Topic], to: Collector
) -> None:
    """Takes a message, a channel, a schema or what is attached; other records hold nothing for us."""
    if kind == _MESSAGE:
        if len(data) < _MESSAGE_HEAD.size:
            raise DamageError("a message is cut short")
        number, _, time, _ = _MESSAGE_HEAD.unpack_from(data)
        if number not in topics:
            raise DamageError("a message without its channel")
        if _tells_events(topics[number]):
            _event(time, data[_MESSAGE_HEAD.size :], to)
        else:
            to.add(topics[number], time, memoryview(data)[_MESSAGE_HEAD.size :])
    elif kind == _METADATA:
        _attached(data, to)
    elif kind == _SCHEMA:
        number, start = _small(data, 0)
        name, start = _text(data, start)
        language, start = _text(data, start)
        definition, start = _bytes(data, start)
        schemas[number] = (name, language, definition)
    elif kind == _CHANNEL:
        number, start = _small(data, 0)
        schema, start = _small(data, start)
        name, start = _text(data, start)
        encoding, start = _text(data, start)
        msgtype, language, definition = schemas.get(schema, ("", "", b""))
        if number not in topics:
            text = definition.decode(errors="replace") if language in _LANGUAGES else ""
            topics[number] = Topic(name, normal_type(msgtype), encoding, text, _LANGUAGES.get(language, "msg"))
            if not _tells_events(topics[number]):
                to.declare(topics[number])


def _tells_events(topic: Topic) -> bool:
    return topic.name == EVENTS and topic.msgtype == "std_msgs/msg/String" and topic.encoding == "cdr"


def _event(time: int, data: bytes, to: Collector) -> None:
    """Takes an event; a damaged one costs itself only."""
    try:
        value, _ = _text(data, 4)  # behind the head of CDR
        to.happened(Event(time, one_line(value.rstrip("\0"))))
    except DamageError as error:
        to.note(f"an event is damaged ({error}); left out")


def _attached(data: bytes, to: Collector) -> None:
    """Takes the Metadata record of `rotorfit fly`: a name, then a map of texts. A damaged one costs itself only."""
    try:
        name, start = _text(data, 0)
        if name != ATTACHED:
            return
        pairs, texts, start = _bytes(data, start)[0], {}, 0
        while start < len(pairs):
            key, start = _text(pairs, start)
            texts[key], start = _text(pairs, start)
        to.attach(texts)
    except DamageError as error:
        to.note(f"what is attached is damaged ({error}); left out")


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Records up to `size`; of a record cut short, a chunk's part is given before the damage is raised."""
    left = size - file.tell()
    while left > 0:
        prefix = file.read(_PREFIX.size)
        if len(prefix) < _PREFIX.size:
            raise DamageError("a record is cut short")
        kind, length = _PREFIX.unpack(prefix)
        left -= _PREFIX.size
        if length > left and kind != _CHUNK:
            raise DamageError("the last record is cut short")
        if length > LIMIT:
            raise DamageError(f"a record of {length} bytes")
        yield kind, file.read(min(length, left))
        if length > left:
            raise DamageError("the last chunk is cut short")
        left -= length


def _small(data: bytes, start: int) -> tuple[int, int]:
    """A two-byte number, and where it ends."""
    if start + 2 > len(data):
        raise DamageError("a record is cut short")
    return int.from_bytes(data[start : start + 2], "little"), start + 2


def _bytes(data: bytes, start: int) -> tuple[bytes, int]:
    """Bytes with their length before them, and where they end."""
    end = start + 4 + int.from_bytes(data[start : start + 4], "little")
    if start + 4 > len(data) or end > len(data):
        raise DamageError("a record is cut short")
    return data[start + 4 : end], end


def _text(data: bytes, start: int) -> tuple[str, int]:
    """Text with its length before it, and where it ends."""
    value, end = _bytes(data, start)
    return value.decode(errors="replace"), end
