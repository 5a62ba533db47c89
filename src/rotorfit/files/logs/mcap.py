"""MCAP files with ROS messages (encodings cdr and ros1).

With the index after each chunk, chunks without a requested topic are not decompressed, and messages are located all at
once instead of one after the other.

Source: https://mcap.dev/spec
"""

import struct
from binascii import crc32
from collections.abc import Collection, Iterator
from contextlib import suppress
from mmap import mmap
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.log import Event
from rotorfit.files.logs.batches import Fault, Messages, Places, RecordRun, Resume, integers, stretches
from rotorfit.files.logs.chunked import Chunk, ChunkedFile
from rotorfit.files.logs.compression import unpacked
from rotorfit.files.logs.content import BLOCK_LIMIT, Content, DamageError, TornError, one_line
from rotorfit.files.logs.damage import Block
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


def collect(path: Path, collector: Collector) -> None:
    """Passes all messages of a file to a collector."""
    with path.open("rb") as file:
        _Mcap(file, path.stat().st_size, len(MAGIC), collector).walk()


class _Mcap(ChunkedFile[int]):
    """An MCAP file.

    Attributes:
        schemas: Number to name, language and text.
        text: Total length of the schema texts [byte].
    """

    never_closed = "the file was never closed: what was recorded behind its end is lost"

    def __init__(self, file: BinaryIO, size: int, place: int, collector: Collector) -> None:
        super().__init__(file, size, place, collector)
        self.schemas: dict[int, tuple[str, str, bytes]] = {}
        self.text = 0

    def _head(self) -> tuple[int, int, int]:
        """Kind, start and length of the data of the current record; only a chunk may be cut short."""
        self.file.seek(self.place)
        prefix = self.file.read(PREFIX.size)
        if len(prefix) < PREFIX.size:
            raise DamageError("the last record is cut short")
        kind, length = PREFIX.unpack(prefix)
        start = self.place + PREFIX.size
        if kind == 0 or length > max(BLOCK_LIMIT, self.size):
            raise TornError("bytes that are no record")
        if length > self.size - start and kind != CHUNK:
            raise DamageError("a record is cut short")
        return kind, start, length

    def _pass(self, kind: int, start: int, length: int) -> bool:
        """Handles one record, and what waited for it; False where the data end."""
        if kind == INDEX:
            if self.chunk is not None:
                self._keep_index(self.chunk, start, length)
            return True
        data = self._data(start, length) if kind in (MESSAGE, SCHEMA, CHANNEL, METADATA) else b""
        if kind == MESSAGE and (len(data) < MESSAGE_HEAD.size or small_at(data, 0)[0] not in self.topics):
            raise TornError("a message without its channel")
        self._settle()
        if kind == MESSAGE:
            self.message = self.place, kind, data
        elif kind == CHUNK:
            self._begin(kind, start, length)
        elif kind in (SCHEMA, CHANNEL, METADATA):
            self._record(kind, data)
        return kind not in (DATA_END, FOOTER)

    def _wanted(self, chunk: Chunk[int]) -> bool:
        eventful = any(number in self.topics and _tells_events(self.topics[number]) for number in chunk.index)
        return eventful or super()._wanted(chunk)

    def _learn(self, data: mmap) -> None:
        with suppress(DamageError):
            for kind, record in summary_channels(data):
                self._record(kind, record)

    def _next(self, data: Block, start: int, in_chunk: bool = True) -> int | None:
        return next_record(data, start, self.topics, self.collector.losses.until, in_chunk)

    def _keep_index(self, chunk: Chunk[int], start: int, length: int) -> None:
        """Stores the offsets of one channel's messages in the chunk; the index is discarded if it is implausible."""
        try:
            if length > _MOST_INDEXED * _ENTRY.itemsize or len(chunk.index) == _MOST_CHANNELS:
                raise DamageError("more than fits in a chunk")
            data = self._data(start, length)
            number, start = small_at(data, 0)
            entries, _ = bytes_at(data, start)
            chunk.index[number] = np.frombuffer(entries[: len(entries) // 16 * 16], _ENTRY)["place"].astype(np.int64)
            if sum(map(len, chunk.index.values())) > _MOST_INDEXED:
                raise DamageError("more than fits in a chunk")
        except DamageError:
            chunk.index.clear()

    def _plain(self, chunk: Chunk[int]) -> tuple[bytes, int]:
        """A decompressed chunk, and the size that it claims."""
        data = self._data(chunk.start, chunk.length)
        if len(data) < CHUNK_HEAD.size:
            raise DamageError("its head is cut short")
        _, _, size, checksum = CHUNK_HEAD.unpack_from(data)
        method, start = text_at(data, CHUNK_HEAD.size)
        plain = unpacked(memoryview(data)[start + 8 :], method, size)
        if len(plain) == size and checksum and crc32(plain) != checksum:
            raise DamageError("its checksum is wrong, so none of it is used")
        return plain, size

    def _runs(self, plain: bytes, hints: Places, resume: Resume) -> Iterator[RecordRun]:
        return stretches(plain, hints, _ends, _starts, resume)

    def _messages(self, plain: bytes, starts: Places) -> None:
        """Takes records of a decompressed chunk, all messages at once where their channels are known."""
        bodies = starts + PREFIX.size
        found = Messages(plain, bodies, integers(plain, bodies - 8, "<u8"))
        kinds = integers(plain, starts, "u1")
        is_message = kinds == MESSAGE
        if not self._at_once(found, kinds, is_message):
            for row, kind in enumerate(kinds.tolist()):
                self._record(kind, found.one(row))

    def _at_once(self, found: Messages, kinds: Places, is_message: npt.NDArray[np.bool_]) -> bool:
        """Takes all messages at once; returns False, with none taken, if one is cut short or has no channel."""
        try:
            for row in np.flatnonzero(~is_message).tolist():
                self._record(int(kinds[row]), found.one(row))
        except DamageError:
            return False
        messages = found[is_message]
        if messages.lengths.min(initial=MESSAGE_HEAD.size) < MESSAGE_HEAD.size:
            return False
        numbers, times = (integers(messages.data, messages.starts + at, form) for at, form in ((0, "<u2"), (6, "<u8")))
        inner = Messages(messages.data, messages.starts + MESSAGE_HEAD.size, messages.lengths - MESSAGE_HEAD.size)
        telling = np.isin(numbers, [number for number, topic in self.topics.items() if _tells_events(topic)])
        if not self.collector.add_mixed(self.topics, np.where(telling, -1, numbers), times, inner):
            return False
        for row in np.flatnonzero(telling).tolist():
            _event(int(times[row]), inner.one(row), self.collector)
        return True

    def _record(self, kind: int, data: bytes) -> None:
        """Handles a message, a channel, a schema or metadata; other records are ignored."""
        schemas, topics = self.schemas, self.topics
        if kind == MESSAGE:
            if len(data) < MESSAGE_HEAD.size:
                raise DamageError("a message is cut short")
            number, _, time, _ = MESSAGE_HEAD.unpack_from(data)
            if number not in topics:
                raise DamageError("a message without its channel")
            if _tells_events(topics[number]):
                _event(time, data[MESSAGE_HEAD.size :], self.collector)
            else:
                self.collector.add(topics[number], time, data[MESSAGE_HEAD.size :])
        elif kind == METADATA:
            _attached(data, self.collector)
        elif kind == SCHEMA:
            number, start = small_at(data, 0)
            name, start = text_at(data, start)
            language, start = text_at(data, start)
            definition, start = bytes_at(data, start)
            self.text += len(definition) - len(schemas.get(number, ("", "", b""))[2])
            schemas[number] = (name, language, definition)
            if self.text > _MOST_TEXT:
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
                    self.collector.declare(topics[number])


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
