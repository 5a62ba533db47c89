"""MCAP files with ROS messages (encodings cdr and ros1), read from front to back.

The index behind each chunk only makes this faster: chunks without a wanted topic are not unpacked, messages are
found at once and not one after the other.

Source: https://mcap.dev/spec
"""

import struct
from binascii import crc32
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from rotorfit.log import Event
from rotorfit.sources.block import Messages, Places, integers, record_starts
from rotorfit.sources.collector import Collector
from rotorfit.sources.compression import unpacked
from rotorfit.sources.content import BLOCK_LIMIT, Content, DamageError, one_line
from rotorfit.sources.messages import Topic, normal_type

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07
_METADATA, _DATA_END = 0x0C, 0x0F
ATTACHED, EVENTS = "rotorfit", "/rotorfit/event"
"""Name of the Metadata record, and the topic of std_msgs/msg/String, in which `rotorfit fly` writes what it did."""

_PREFIX, _MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQI")
_INDEX_ENTRY = np.dtype([("time", "<u8"), ("place", "<u8")])  # the place in the unpacked chunk
_MOST_INDEXED, _MOST_CHANNELS = BLOCK_LIMIT // _PREFIX.size, 1 << 12  # messages, channels in the index of a chunk
_MOST_TEXT = 1 << 25  # characters of definitions
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


@dataclass
class _Known:
    """What earlier records of the file have said.

    Attributes:
        schemas: Number to name, language and text.
        topics: Number of the channel to topic.
        text: Bytes of all those texts.
    """

    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    topics: dict[int, Topic] = field(default_factory=dict)
    text: int = 0


@dataclass
class _Chunk:
    """A chunk that waits until the index behind it is known.

    Attributes:
        start: Of its record's data in the file.
        length: Of them, as far as they are there.
        index: Channel to the places of its messages in the unpacked chunk.
    """

    start: int
    length: int
    index: dict[int, Places] = field(default_factory=dict)


def collect(path: Path, collector: Collector) -> None:
    """Gives all messages of a file to a collector."""
    size = path.stat().st_size
    known = _Known()
    chunk: _Chunk | None = None
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        try:
            for kind, start, length in _records(file, size):
                if kind == _INDEX:
                    if chunk is not None:
                        _keep_index(file, chunk, start, length)
                    continue
                _take(file, chunk, known, collector)
                chunk = None
                if kind in (_DATA_END, _FOOTER):
                    return
                if kind == _CHUNK:
                    chunk = _Chunk(start, length)
                elif kind in (_MESSAGE, _SCHEMA, _CHANNEL, _METADATA):
                    _record(kind, _data(file, start, length), known, collector)
            _take(file, chunk, known, collector)
            collector.note("the file was never closed; read from front to back")
        except DamageError as error:
            place = file.tell()
            _take(file, chunk, known, collector)
            collector.note(f"damaged after byte {place} of {size} ({error}); read up to there")


def _keep_index(file: BinaryIO, chunk: _Chunk, start: int, length: int) -> None:
    """Keeps where the messages of one channel are said to lie in the chunk; one that cannot be is forgotten."""
    try:
        if length > _MOST_INDEXED * _INDEX_ENTRY.itemsize or len(chunk.index) == _MOST_CHANNELS:
            raise DamageError("more than fits in a chunk")
        data = _data(file, start, length)
        number, start = _small(data, 0)
        entries, _ = _bytes(data, start)
        chunk.index[number] = np.frombuffer(entries[: len(entries) // 16 * 16], _INDEX_ENTRY)["place"].astype(np.int64)
        if sum(map(len, chunk.index.values())) > _MOST_INDEXED:
            raise DamageError("more than fits in a chunk")
    except DamageError:
        chunk.index.clear()


def _take(file: BinaryIO, chunk: _Chunk | None, known: _Known, collector: Collector) -> None:
    """Takes the messages of a chunk; damage inside costs the rest of this chunk only."""
    if chunk is None:
        return
    eventful = any(number in known.topics and _tells_events(known.topics[number]) for number in chunk.index)
    if not eventful and collector.passed_over(known.topics, chunk.index):
        return
    try:
        plain, size = _plain(_data(file, chunk.start, chunk.length))
        _messages(plain, np.concatenate([*chunk.index.values(), np.zeros(0, np.int64)]), known, collector)
        if len(plain) < size:
            raise DamageError(f"{len(plain)} of {size} bytes")
    except DamageError as error:
        end = chunk.start + chunk.length
        collector.note(f"the chunk that ends at byte {end} is damaged ({error}); read up to the damage")


def _plain(data: bytes) -> tuple[bytes, int]:
    """A chunk unpacked, and how many bytes it says it is."""
    if len(data) < _CHUNK_HEAD.size:
        raise DamageError("its head is cut short")
    _, _, size, checksum = _CHUNK_HEAD.unpack_from(data)
    method, start = _text(data, _CHUNK_HEAD.size)
    plain = unpacked(memoryview(data)[start + 8 :], method, size)
    if len(plain) == size and checksum and crc32(plain) != checksum:
        raise DamageError("its checksum is wrong, so none of it is used")
    return plain, size


def _messages(plain: bytes, hints: Places, known: _Known, collector: Collector) -> None:
    """Takes the records of an unpacked chunk, all messages at once where their channels are known."""
    starts, fault = record_starts(plain, hints, _ends, _starts)
    bodies = starts + _PREFIX.size
    found = Messages(plain, bodies, integers(plain, bodies - 8, "<u8"))
    kinds = integers(plain, starts, "u1")
    is_message = kinds == _MESSAGE
    if not _at_once(found, kinds, is_message, known, collector):
        for row, kind in enumerate(kinds.tolist()):
            _record(kind, found.one(row), known, collector)
    if fault:
        raise DamageError(fault)


def _at_once(
    found: Messages, kinds: Places, is_message: npt.NDArray[np.bool_], known: _Known, collector: Collector
) -> bool:
    """Takes all messages at once; False, with none taken, where one is cut short or of no channel."""
    try:
        for row in np.flatnonzero(~is_message).tolist():
            _record(int(kinds[row]), found.one(row), known, collector)
    except DamageError:
        return False
    messages = found[is_message]
    if messages.lengths.min(initial=_MESSAGE_HEAD.size) < _MESSAGE_HEAD.size:
        return False
    numbers, times = (integers(messages.data, messages.starts + at, form) for at, form in ((0, "<u2"), (6, "<u8")))
    inner = Messages(messages.data, messages.starts + _MESSAGE_HEAD.size, messages.lengths - _MESSAGE_HEAD.size)
    telling = np.isin(numbers, [number for number, topic in known.topics.items() if _tells_events(topic)])
    if not collector.add_mixed(known.topics, np.where(telling, -1, numbers), times, inner):
        return False
    for row in np.flatnonzero(telling).tolist():
        _event(int(times[row]), inner.one(row), collector)
    return True


def _ends(data: bytes, starts: Places) -> Places | None:
    """Ends of the records at these starts; None where one does not fit."""
    if len(data) < _PREFIX.size or starts.min() < 0 or starts.max() > len(data) - _PREFIX.size:
        return None
    lengths = integers(data, starts + 1, "<u8")
    if lengths.min() < 0 or lengths.max() > len(data):
        return None
    ends = starts + _PREFIX.size + lengths
    return None if ends.max() > len(data) else ends


def _starts(data: bytes, start: int, end: int) -> tuple[list[int], str]:
    """Walks records from one place to another: their starts, and what is wrong behind the last that is whole."""
    starts: list[int] = []
    prefix = _PREFIX.unpack_from
    try:
        while start < end:
            after = start + _PREFIX.size + prefix(data, start)[1]
            if after > end:
                return starts, "the last record is cut short"
            starts.append(start)
            start = after
    except struct.error:
        return starts, "a record is cut short"
    return starts, ""


def _record(kind: int, data: bytes, known: _Known, collector: Collector) -> None:
    """Takes a message, a channel, a schema or what is attached; other records hold nothing for us."""
    schemas, topics = known.schemas, known.topics
    if kind == _MESSAGE:
        if len(data) < _MESSAGE_HEAD.size:
            raise DamageError("a message is cut short")
        number, _, time, _ = _MESSAGE_HEAD.unpack_from(data)
        if number not in topics:
            raise DamageError("a message without its channel")
        if _tells_events(topics[number]):
            _event(time, data[_MESSAGE_HEAD.size :], collector)
        else:
            collector.add(topics[number], time, data[_MESSAGE_HEAD.size :])
    elif kind == _METADATA:
        _attached(data, collector)
    elif kind == _SCHEMA:
        number, start = _small(data, 0)
        name, start = _text(data, start)
        language, start = _text(data, start)
        definition, start = _bytes(data, start)
        known.text += len(definition) - len(schemas.get(number, ("", "", b""))[2])
        schemas[number] = (name, language, definition)
        if known.text > _MOST_TEXT:
            raise DamageError(f"more than {_MOST_TEXT >> 20} MiB of definitions")
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
                collector.declare(topics[number])


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


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Kind, place and length of the data of each record; of a chunk cut short, its part before the damage."""
    position = file.tell()
    while position < size:
        file.seek(position)
        prefix = file.read(_PREFIX.size)
        if len(prefix) < _PREFIX.size:
            raise DamageError("a record is cut short")
        kind, length = _PREFIX.unpack(prefix)
        start = position + _PREFIX.size
        if length > size - start and kind != _CHUNK:
            raise DamageError("the last record is cut short")
        yield kind, start, min(length, size - start)
        if length > size - start:
            file.seek(size)
            raise DamageError("the last chunk is cut short")
        position = start + length


def _data(file: BinaryIO, start: int, length: int) -> bytes:
    """The data of a record."""
    if length > BLOCK_LIMIT:
        raise DamageError(f"a record of {length} bytes")
    file.seek(start)
    return file.read(length)


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
