"""What all bags share: messages, one after the other, become tables with `log_time`."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rotorfit.errors import LogError
from rotorfit.log import Column, Event, Table
from rotorfit.sources.compression import ZSTD_MAGIC, unpacked
from rotorfit.sources.content import LIMIT, Content, DamageError, listed, one_line
from rotorfit.sources.messages import BULK_TYPES, Topic, Types, decoded, has_numbers, types_of

_BATCH = 4096  # messages decoded at once, or
_BATCH_BYTES = 1 << 23
_LATEST = (1 << 63) - 1


@dataclass
class _Stream:
    """Messages of one topic on their way to a table.

    Attributes:
        topic: As first seen.
        types: Its definitions; None where it is not decoded.
        reason: Why it is not decoded.
        count: Messages seen.
    """

    topic: Topic
    types: Types | None
    reason: str
    count: int = 0
    lost: int = 0
    fault: str = ""
    foreign: int = 0
    times: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    waiting: int = 0
    batches: list[dict[str, Column]] = field(default_factory=list)
    uneven: set[str] = field(default_factory=set)


class Collector:
    """Takes the messages of a bag in the order of the file and gives the content.

    Only messages of wanted topics are kept, and those only until a batch of them is decoded.
    """

    def __init__(self, path: Path, tables: Collection[str] | None) -> None:
        self._path = path
        self._wanted = tables
        self._streams: dict[str, _Stream] = {}
        self._of_topic: dict[Topic, _Stream] = {}
        self._notes: list[str] = []
        self._bytes = 0
        self._attached: dict[str, str] = {}
        self._events: list[Event] = []

    def note(self, text: str) -> None:
        """Says what was lost or recovered."""
        self._notes.append(one_line(text))

    def attach(self, texts: Mapping[str, str]) -> None:
        """Takes what was written beside the messages."""
        self._attached |= texts

    def happened(self, event: Event) -> None:
        """Takes an event."""
        self._events.append(event)

    def declare(self, topic: Topic) -> None:
        """Makes a topic known, also one that may turn out to have no message."""
        if topic.name not in self._streams:
            self._streams[topic.name] = self._stream(topic)
        self._of_topic[topic] = self._streams[topic.name]

    def add(self, topic: Topic, time: int, data: bytes | memoryview) -> None:
        """Takes one message, recorded at `time` [ns].

        Raises:
            LogError: The numbers of this log would take more memory than `LIMIT`.
        """
        stream = self._of_topic[topic]
        stream.count += 1
        if stream.types is None:
            return
        if (topic.msgtype, topic.encoding) != (stream.topic.msgtype, stream.topic.encoding):
            stream.foreign += 1
            return
        if not 0 <= time <= _LATEST:
            stream.lost, stream.fault = stream.lost + 1, stream.fault or "a time of recording that is none"
            return
        stream.times.append(time)
        stream.messages.append(bytes(data))
        stream.waiting += len(data)
        if len(stream.messages) >= _BATCH or stream.waiting >= _BATCH_BYTES:
            self._decode(stream)

    def content(self) -> Content:
        """The tables of all messages.

        Raises:
            LogError: There was no message at all.
        """
        for stream in self._streams.values():
            self._decode(stream)
        if not any(stream.count for stream in self._streams.values()):
            why = f" ({self._notes[0]})" if self._notes else "; check that the topics were published"
            raise LogError(f"{self._path}: the bag holds no messages{why}")
        tables: dict[str, Table] = {}
        skipped: dict[str, str] = {}
        for name, stream in self._streams.items():
            columns = _columns(stream)
            if len(columns) > 1:
                tables[name] = Table(name, columns)
                for text in _notes(stream):
                    self.note(text)
            else:
                reason = stream.reason or stream.fault or "no numbers of the same length in all messages"
                skipped[name] = one_line(f"{reason} ({stream.topic.msgtype}, {stream.count} messages)")
        return Content(tables, skipped, tuple(self._notes), self._attached, tuple(self._events))

    def _stream(self, topic: Topic) -> _Stream:
        """Decides whether a topic is decoded."""
        if self._wanted is not None and topic.name not in self._wanted:
            return _Stream(topic, None, "not asked for")
        if self._wanted is None and topic.msgtype in BULK_TYPES:
            return _Stream(topic, None, "not a table of numbers")
        try:
            types = types_of(topic)
        except DamageError as error:
            return _Stream(topic, None, str(error))
        if not has_numbers(types, topic.msgtype):
            return _Stream(topic, None, "holds no numbers outside of lists of other types")
        return _Stream(topic, types, "")

    def _decode(self, stream: _Stream) -> None:
        """Decodes the messages that wait."""
        if stream.types is None or not stream.messages:
            return
        messages, fault = _plain(stream)
        batch = decoded(stream.topic, stream.types, messages)
        stream.lost += len(messages) - len(batch.rows)
        stream.fault = stream.fault or batch.fault or fault
        stream.uneven |= batch.uneven
        times = np.array(stream.times, dtype=np.int64)[batch.rows]
        if len(times):
            stream.batches.append(batch.columns | {"log_time": times})
            self._bytes += sum(values.nbytes for values in stream.batches[-1].values())
        stream.times, stream.messages, stream.waiting = [], [], 0
        if self._bytes > LIMIT:
            raise LogError(f"{self._path}: more than {LIMIT >> 20} MiB of numbers; read only the topics that you need")


def _plain(stream: _Stream) -> tuple[list[bytes], str]:
    """Messages that were packed one by one (`--compression-mode message`) unpacked; CDR never begins as zstd does."""
    if stream.topic.encoding != "cdr" or not any(message.startswith(ZSTD_MAGIC) for message in stream.messages):
        return stream.messages, ""
    plain, fault = [], ""
    for message in stream.messages:
        try:
            plain.append(unpacked(message, "zstd") if message.startswith(ZSTD_MAGIC) else message)
        except DamageError as error:
            plain.append(b"")
            fault = fault or str(error)
    return plain, fault


def _columns(stream: _Stream) -> dict[str, Column]:
    """Batches end to end, `log_time` first; columns that are not alike in all batches are left out."""
    if not stream.batches:
        return {}
    first, *others = stream.batches
    columns: dict[str, Column] = {}
    for name in ("log_time", *(name for name in first if name != "log_time")):
        if name in stream.uneven or any(
            name not in batch or batch[name].shape[1:] != first[name].shape[1:] for batch in others
        ):
            stream.uneven.add(name)
        else:
            columns[name] = np.concatenate([batch[name] for batch in stream.batches])
    return columns


def _notes(stream: _Stream) -> list[str]:
    """What was lost of a topic that became a table."""
    name, notes = stream.topic.name, []
    if stream.lost:
        notes.append(f"{name}: {stream.lost} of {stream.count} messages could not be decoded ({stream.fault})")
    if stream.foreign:
        notes.append(f"{name}: {stream.foreign} messages of another type than {stream.topic.msgtype} left out")
    if stream.uneven:
        notes.append(f"{name}: left out, of varying length: {listed(sorted(stream.uneven))}")
    return notes
