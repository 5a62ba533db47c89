"""MCAP files with ROS messages (encodings cdr and ros1), read from front to back.

The index after each chunk only speeds this up: chunks without a requested topic are not decompressed, and messages are
located all at once instead of one after the other.

Source: https://mcap.dev/spec
"""

import struct
from binascii import crc32
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.log import Event
from rotorfit.files.logs.batches import Fault, Messages, Places, integers, stretches
from rotorfit.files.logs.compression import unpacked
from rotorfit.files.logs.content import BLOCK_LIMIT, Content, DamageError, TornError, one_line
from rotorfit.files.logs.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    FOOTER,
    INDEX,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
    PREFIX,
    SCHEMA,
    bytes_at,
    next_record,
    small_at,
    summary_channels,
    text_at,
)
from rotorfit.files.logs.ros_messages import Topic, normal_type
from rotorfit.files.logs.topics import Collector

ATTACHED, EVENTS = "rotorfit", "/rotorfit/event"
"""Name of the Metadata record, and the std_msgs/msg/String topic, in which `rotorfit fly` records what it did."""

_ENTRY = np.dtype([("time", "<u8"), ("place", "<u8")])  # the offset in the decompressed chunk

_MOST_INDEXED, _MOST_CHANNELS = BLOCK_LIMIT // PREFIX.size, 1 << 12  # messages, channels in the index of a chunk

_MOST_TEXT = 1 << 25  # characters of definitions

_LANGUAGES: dict[str, Literal["msg", "idl"]] = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins with MCAP's magic."""
    return head.startswith(MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested topics; see `files.logs.read`.

    Raises:
        LogError: No message before the damage.
    """
    collector = Collector(path, tables)
    collect(path, collector)
    return collector.content()


@dataclass
class _Known:
    """Definitions read so far.

    Attributes:
        schemas: Number to name, language and text.
        topics: Channel number to topic.
        text: Total length of the schema texts [byte].
    """

    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    topics: dict[int, Topic] = field(default_factory=dict)
    text: int = 0


@dataclass
class _Chunk:
    """A chunk that waits until the index after it is known.

    Attributes:
        start: Offset of its record's data in the file.
        length: Length of the data, as far as present [byte].
        torn: Whether damage follows directly, so that its last record may be torn.
        index: Channel to the offsets of its messages in the decompressed chunk.
    """

    start: int
    length: int
    torn: bool = False
    index: dict[int, Places] = field(default_factory=dict)


def collect(path: Path, collector: Collector) -> None:
    """Passes all messages of a file to a collector."""
    size = path.stat().st_size
    known = _Known()
    with path.open("rb") as file:
        walk: _Walk | None = _Walk(file, size, len(MAGIC))
        while walk is not None:
            walk = _walked(walk, known, collector)


@dataclass
class _Walk:
    """A walk from record to record, with what is still pending.

    Attributes:
        file: The file that is read.
        size: Its size [byte].
        place: Offset of the current record.
        chunk: Chunk that waits until the index after it is known.
        message: Message outside of chunks, with its offset: it waits until a record follows, as it may be torn.
    """

    file: BinaryIO
    size: int
    place: int
    chunk: _Chunk | None = None
    message: tuple[int, bytes] | None = None


def _walked(walk: _Walk, known: _Known, collector: Collector) -> _Walk | None:
    """Walks to the end, or to damage; in the latter case returns a walk that resumes behind it, if possible."""
    try:
        while walk.place < walk.size:
            kind, start, length = _head(walk)
            if not _pass(walk, kind, start, length, known, collector):
                return None
            walk.place = start + length
        _settle(walk, known, collector)
        collector.damaged("the file was never closed: what was recorded behind its end is lost")
        return None
    except DamageError as error:
        if isinstance(error, TornError) and walk.message:
            walk.place, walk.message = walk.message[0], None
        place = walk.place
        if walk.chunk and isinstance(error, TornError):
            walk.chunk.torn = place == walk.chunk.start + walk.chunk.length
        _settle(walk, known, collector)
        behind = _behind(walk, place + 1, known, collector)
        collector.losses.found(place, walk.size, (behind or walk.size) - place, str(error))
        return None if behind is None else _Walk(walk.file, walk.size, behind)


def _pass(walk: _Walk, kind: int, start: int, length: int, known: _Known, collector: Collector) -> bool:
    """Handles one record, and what waited for it; False where the data end."""
    if kind == INDEX:
        if walk.chunk is not None:
            _keep_index(walk.file, walk.chunk, start, length)
        return True
    data = _data(walk.file, start, length) if kind in (MESSAGE, SCHEMA, CHANNEL, METADATA) else b""
    if kind == MESSAGE and (len(data) < MESSAGE_HEAD.size or small_at(data, 0)[0] not in known.topics):
        raise TornError("a message without its channel")
    _settle(walk, known, collector)
    if kind == MESSAGE:
        walk.message = walk.place, data
    elif kind == CHUNK:
        walk.chunk = _Chunk(start, min(length, walk.size - start))
        if length > walk.size - start:
            behind = _behind(walk, start, known, collector, in_chunk=False)
            walk.place = walk.size if behind is None else behind
            walk.chunk.length = walk.place - start
            raise DamageError("the chunk before it is cut short")
    elif kind in (SCHEMA, CHANNEL, METADATA):
        _record(kind, data, known, collector)
    return kind not in (DATA_END, FOOTER)


def _settle(walk: _Walk, known: _Known, collector: Collector) -> None:
    """Handles what is pending."""
    chunk, message, walk.chunk, walk.message = walk.chunk, walk.message, None, None
    if chunk is not None:
        _take(walk, chunk, known, collector)
    if message is not None:
        _record(MESSAGE, message[1], known, collector)


def _behind(walk: _Walk, start: int, known: _Known, collector: Collector, in_chunk: bool = True) -> int | None:
    """Where records resume; the channels listed in the summary are known from then on."""
    if collector.losses.many:
        return None
    with mmap(walk.file.fileno(), 0, access=ACCESS_READ) as data:
        with suppress(DamageError):
            for kind, record in summary_channels(data):
                _record(kind, record, known, collector)
        return next_record(data, start, known.topics, collector.losses.until, in_chunk)


def _keep_index(file: BinaryIO, chunk: _Chunk, start: int, length: int) -> None:
    """Stores the offsets of one channel's messages in the chunk; the index is discarded if it is implausible."""
    try:
        if length > _MOST_INDEXED * _ENTRY.itemsize or len(chunk.index) == _MOST_CHANNELS:
            raise DamageError("more than fits in a chunk")
        data = _data(file, start, length)
        number, start = small_at(data, 0)
        entries, _ = bytes_at(data, start)
        chunk.index[number] = np.frombuffer(entries[: len(entries) // 16 * 16], _ENTRY)["place"].astype(np.int64)
        if sum(map(len, chunk.index.values())) > _MOST_INDEXED:
            raise DamageError("more than fits in a chunk")
    except DamageError:
        chunk.index.clear()


def _take(walk: _Walk, chunk: _Chunk, known: _Known, collector: Collector) -> None:
    """Takes the messages of a chunk; damage loses the messages it hits, in a compressed chunk also all after it."""
    eventful = any(number in known.topics and _tells_events(known.topics[number]) for number in chunk.index)
    if not eventful and collector.passed_over(known.topics, chunk.index):
        return
    place, left = chunk.start - PREFIX.size, chunk.length

    def resume(data: bytes, start: int) -> int | None:
        return None if collector.losses.many else next_record(data, start, known.topics, collector.losses.until)

    try:
        plain, claim = _plain(_data(walk.file, chunk.start, chunk.length))
        plain = plain[:-1] if chunk.torn else plain  # makes the last record incomplete
        hints = np.concatenate([*chunk.index.values(), np.zeros(0, np.int64)])
        for part in stretches(plain, hints, _ends, _starts, resume):
            left = len(plain) - int(part.starts[0]) if len(part.starts) else 0
            _messages(plain, part.starts, known, collector)
            if part.lost:
                collector.losses.found(place, walk.size, part.lost, f"in a chunk, {part.why}")
        left = claim - len(plain)
        if left > 0:
            raise DamageError(f"{len(plain)} of {claim} bytes")
    except DamageError as error:
        collector.losses.found(place, walk.size, left, f"in a chunk, {error}")


def _plain(data: bytes) -> tuple[bytes, int]:
    """A decompressed chunk, and the size that it claims."""
    if len(data) < CHUNK_HEAD.size:
        raise DamageError("its head is cut short")
    _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
    method, start = text_at(data, CHUNK_HEAD.size)
    plain = unpacked(memoryview(data)[start + 8 :], method, size)
    if len(plain) == size and checksum and crc32(plain) != checksum:
        raise DamageError("its checksum is wrong, so none of it is used")
    return plain, size


def _messages(plain: bytes, starts: Places, known: _Known, collector: Collector) -> None:
    """Takes records of a decompressed chunk, all messages at once where their channels are known."""
    bodies = starts + PREFIX.size
    found = Messages(plain, bodies, integers(plain, bodies - 8, "<u8"))
    kinds = integers(plain, starts, "u1")
    is_message = kinds == MESSAGE
    if not _at_once(found, kinds, is_message, known, collector):
        for row, kind in enumerate(kinds.tolist()):
            _record(kind, found.one(row), known, collector)


def _at_once(
    found: Messages, kinds: Places, is_message: npt.NDArray[np.bool_], known: _Known, collector: Collector
) -> bool:
    """Takes all messages at once; returns False, with none taken, if one is cut short or has no channel."""
    try:
        for row in np.flatnonzero(~is_message).tolist():
            _record(int(kinds[row]), found.one(row), known, collector)
    except DamageError:
        return False
    messages = found[is_message]
    if messages.lengths.min(initial=MESSAGE_HEAD.size) < MESSAGE_HEAD.size:
        return False
    numbers, times = (integers(messages.data, messages.starts + at, form) for at, form in ((0, "<u2"), (6, "<u8")))
    inner = Messages(messages.data, messages.starts + MESSAGE_HEAD.size, messages.lengths - MESSAGE_HEAD.size)
    telling = np.isin(numbers, [number for number, topic in known.topics.items() if _tells_events(topic)])
    if not collector.add_mixed(known.topics, np.where(telling, -1, numbers), times, inner):
        return False
    for row in np.flatnonzero(telling).tolist():
        _event(int(times[row]), inner.one(row), collector)
    return True


def _ends(data: bytes, starts: Places) -> Places | None:
    """Ends of the records with these starts; None if one exceeds the data or is invalid."""
    if len(data) < PREFIX.size or starts.min() < 0 or starts.max() > len(data) - PREFIX.size:
        return None
    lengths = integers(data, starts + 1, "<u8")
    if lengths.min() < 0 or lengths.max() > len(data) or integers(data, starts, "u1").min() == 0:
        return None
    ends = starts + PREFIX.size + lengths
    return None if ends.max() > len(data) else ends


def _starts(data: bytes, start: int, end: int) -> tuple[list[int], Fault | None]:
    """Walks records from one offset to another: their starts, and the fault after the last whole one."""
    starts: list[int] = []
    prefix = PREFIX.unpack_from
    try:
        while start < end:
            kind, length = prefix(data, start)
            after = start + PREFIX.size + length
            if kind == 0 or after > end:
                torn = kind == 0 or length > BLOCK_LIMIT
                return starts, Fault(start, "bytes that are no record" if torn else "a record is cut short", torn)
            starts.append(start)
            start = after
    except struct.error:
        return starts, Fault(start, "a record is cut short", torn=False)
    return starts, None


def _record(kind: int, data: bytes, known: _Known, collector: Collector) -> None:
    """Handles a message, a channel, a schema or metadata; other records are ignored."""
    schemas, topics = known.schemas, known.topics
    if kind == MESSAGE:
        if len(data) < MESSAGE_HEAD.size:
            raise DamageError("a message is cut short")
        number, _, time, _ = MESSAGE_HEAD.unpack_from(data)
        if number not in topics:
            raise DamageError("a message without its channel")
        if _tells_events(topics[number]):
            _event(time, data[MESSAGE_HEAD.size :], collector)
        else:
            collector.add(topics[number], time, data[MESSAGE_HEAD.size :])
    elif kind == METADATA:
        _attached(data, collector)
    elif kind == SCHEMA:
        number, start = small_at(data, 0)
        name, start = text_at(data, start)
        language, start = text_at(data, start)
        definition, start = bytes_at(data, start)
        known.text += len(definition) - len(schemas.get(number, ("", "", b""))[2])
        schemas[number] = (name, language, definition)
        if known.text > _MOST_TEXT:
            raise DamageError(f"more than {_MOST_TEXT >> 20} MiB of definitions")
    elif kind == CHANNEL:
        number, start = small_at(data, 0)
        schema, start = small_at(data, start)
        name, start = text_at(data, start)
        encoding, start = text_at(data, start)
        msgtype, language, definition = schemas.get(schema, ("", "", b""))
        if number not in topics:
            text = definition.decode(errors="replace") if language in _LANGUAGES else ""
            topics[number] = Topic(name, normal_type(msgtype), encoding, text, _LANGUAGES.get(language, "msg"))
            if not _tells_events(topics[number]):
                collector.declare(topics[number])


def _tells_events(topic: Topic) -> bool:
    return topic.name == EVENTS and topic.msgtype == "std_msgs/msg/String" and topic.encoding == "cdr"


def _event(time: int, data: bytes, to: Collector) -> None:
    """Takes an event; a damaged one is left out with a note."""
    try:
        value, _ = text_at(data, 4)  # behind the head of CDR
        to.happened(Event(time, one_line(value.rstrip("\0"))))
    except DamageError as error:
        to.note(f"an event is damaged ({error}); left out")


def _attached(data: bytes, to: Collector) -> None:
    """Takes the Metadata record of `rotorfit fly`: a name, then a map of texts; a damaged one is left out."""
    try:
        name, start = text_at(data, 0)
        if name != ATTACHED:
            return
        pairs, texts, start = bytes_at(data, start)[0], {}, 0
        while start < len(pairs):
            key, start = text_at(pairs, start)
            texts[key], start = text_at(pairs, start)
        to.attach(texts)
    except DamageError as error:
        to.note(f"what is attached is damaged ({error}); left out")


def _head(walk: _Walk) -> tuple[int, int, int]:
    """Kind, start and length of the data of the current record; only a chunk may be cut short."""
    walk.file.seek(walk.place)
    prefix = walk.file.read(PREFIX.size)
    if len(prefix) < PREFIX.size:
        raise DamageError("the last record is cut short")
    kind, length = PREFIX.unpack(prefix)
    start = walk.place + PREFIX.size
    if kind == 0 or length > max(BLOCK_LIMIT, walk.size):
        raise TornError("bytes that are no record")
    if length > walk.size - start and kind != CHUNK:
        raise DamageError("a record is cut short")
    return kind, start, length


def _data(file: BinaryIO, start: int, length: int) -> bytes:
    """The data of a record."""
    if length > BLOCK_LIMIT:
        raise DamageError(f"a record of {length} bytes")
    file.seek(start)
    return file.read(length)
