"""Shared by all bags: messages, added one after the other, become tables with `log_time`."""

from collections.abc import Collection, Mapping, Sized
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column, Event, Table
from rotorfit.files.logs.batches import Messages, gathered, integers, join_messages, messages_of
from rotorfit.files.logs.compression import ZSTD_MAGIC, unpacked
from rotorfit.files.logs.content import LIMIT, Content, DamageError, listed, one_line
from rotorfit.files.logs.damage import Losses
from rotorfit.files.logs.ros_messages import BULK_TYPES, Topic, Types, decoded, has_numbers, types_of

_BATCH = 4096  # messages decoded at once, or

_BATCH_BYTES = 1 << 22

_LATEST = (1 << 63) - 1

_MOST_TOPICS, _MOST_TEXT = 1 << 14, 1 << 25  # connections, and characters of their definitions together

_MOST_PARSED = 1 << 21  # characters of definitions that are parsed: a few seconds

_MOST_NOTES, _MOST_EVENTS = 100, 10_000


@dataclass
class _Stream:
    """Messages of one topic, collected for a table.

    Attributes:
        topic: As first seen.
        types: Its definitions; None where it is not decoded.
        reason: Why it is not decoded.
        count: Number of messages.
        lost: Number of messages that could not be decoded.
        fault: Why the first of them could not.
        foreign: Number of messages of another type.
        times: Recording times of the messages added singly [ns].
        messages: Those messages.
        blocks: Times and messages added in blocks, before those.
        rows: Number of messages that wait to be decoded.
        waiting: Their length [byte].
        columns: Name to decoded values, with spare room at the end.
        filled: Number of rows decoded.
        uneven: Names of columns that differ in shape between messages.
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
    blocks: list[tuple[npt.NDArray[np.int64], Messages]] = field(default_factory=list)
    rows: int = 0
    waiting: int = 0
    columns: dict[str, Column] = field(default_factory=dict)
    filled: int = 0
    uneven: set[str] = field(default_factory=set)


class Collector:
    """Collects the messages of a bag in the order of the file and converts them to the content.

    Only messages of requested topics are kept, and only until a batch of them is decoded.

    Attributes:
        path: Path of the file.
        losses: Holes in the file between messages.
    """

    def __init__(self, path: Path, tables: Collection[str] | None) -> None:
        self.path = path
        self._wanted = tables
        self._streams: dict[str, _Stream] = {}
        self._of_topic: dict[Topic, _Stream] = {}
        self._notes: list[str] = []
        self._more_notes = 0
        self._damage: list[str] = []
        self.losses = Losses()
        self._bytes = 0
        self._text = self._parsed = 0
        self._types: dict[tuple[str, str, str, str], Types] = {}
        self._attached: dict[str, str] = {}
        self._events: list[Event] = []

    def note(self, text: str) -> None:
        """Adds a note on what was lost or recovered."""
        if len(self._notes) < _MOST_NOTES:
            self._notes.append(one_line(text))
        else:
            self._more_notes += 1

    def damaged(self, text: str) -> None:
        """Records what is lost because the file is damaged or cut short."""
        if len(self._damage) < _MOST_NOTES:
            self._damage.append(one_line(text))

    def attach(self, texts: Mapping[str, str]) -> None:
        """Adds texts that were written beside the messages.

        Raises:
            DamageError: There is more text than any recorder writes.
        """
        self._text += sum(map(len, texts.values()))
        if self._text > _MOST_TEXT:
            raise DamageError(f"more than {_MOST_TEXT >> 20} MiB of text")
        self._attached |= texts

    def happened(self, event: Event) -> None:
        """Adds an event.

        Raises:
            DamageError: There are more events than any flight produces.
        """
        if len(self._events) == _MOST_EVENTS:
            raise DamageError(f"more than {_MOST_EVENTS} events")
        self._events.append(event)

    def declare(self, topic: Topic) -> None:
        """Registers a topic, even if it turns out to have no message.

        Raises:
            DamageError: There are more topics, or longer definitions, than any recorder writes.
        """
        self._text += len(topic.definition)
        if len(self._of_topic) == _MOST_TOPICS or self._text > _MOST_TEXT:
            raise DamageError(f"more than {_MOST_TOPICS} topics, or {_MOST_TEXT >> 20} MiB of definitions")
        if topic.name not in self._streams:
            self._streams[topic.name] = self._stream(topic)
        self._of_topic[topic] = self._streams[topic.name]

    def wants(self, topic: Topic) -> bool:
        """Whether the messages of a topic are decoded."""
        return self._of_topic[topic].types is not None

    def pass_over(self, topic: Topic, count: int) -> None:
        """Counts messages of a topic that is not requested."""
        self._of_topic[topic].count += count

    def passed_over(self, topics: Mapping[int, Topic], index: Mapping[int, Sized]) -> bool:
        """Only counts a chunk's messages if its index names known topics and none that is requested.

        Args:
            topics: Known topics by number.
            index: Topic number to the offsets of its messages in the chunk.

        Returns:
            Whether the chunk can be skipped.
        """
        if not index or not all(number in topics and not self.wants(topics[number]) for number in index):
            return False
        for number, places in index.items():
            self.pass_over(topics[number], len(places))
        return True

    def add(self, topic: Topic, time: int, data: bytes) -> None:
        """Adds one message, recorded at `time` [ns].

        Raises:
            LogError: The numbers of this log would exceed `LIMIT`.
        """
        stream = self._of_topic[topic]
        stream.count += 1
        self.losses.seen(time, time)
        if stream.types is None or self._is_foreign(stream, topic, 1):
            return
        if not 0 <= time <= _LATEST:
            stream.lost, stream.fault = stream.lost + 1, stream.fault or "a time of recording that is none"
            return
        if topic.encoding == "cdr" and data.startswith(ZSTD_MAGIC):
            try:
                data = unpacked(data, "zstd")
            except DamageError as error:
                stream.lost, stream.fault = stream.lost + 1, stream.fault or str(error)
                return
        stream.times.append(time)
        stream.messages.append(data)
        self._count(stream, 1, len(data))

    def add_block(self, topic: Topic, times: npt.NDArray[np.int64], messages: Messages) -> None:
        """Adds many messages of one topic; their block may be freed afterwards.

        Args:
            topic: Topic of all of them.
            times: Recording times [ns], shape (N,).
            messages: N messages, in order.

        Raises:
            LogError: As `add`.
        """
        stream = self._of_topic[topic]
        if stream.types is None or self._is_foreign(stream, topic, len(messages)):
            stream.count += len(messages)
            return
        if times.min(initial=0) < 0 or _any_packed(topic, messages):
            for row, time in enumerate(times.tolist()):
                self.add(topic, time, messages.one(row))
            return
        stream.count += len(messages)
        ends, start = np.cumsum(messages.lengths), 0
        while start < len(messages):
            fitting = int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _BATCH_BYTES)) + 1
            stop = min(start + _BATCH - stream.rows, fitting)
            part = slice(start, stop)
            _close(stream)
            stream.blocks.append((times[part], gathered(messages[part])))
            start = min(stop, len(messages))
            self._count(stream, len(stream.blocks[-1][0]), len(stream.blocks[-1][1].data))

    def add_mixed(
        self,
        topics: Mapping[int, Topic],
        numbers: npt.NDArray[np.int64],
        times: npt.NDArray[np.int64],
        messages: Messages,
    ) -> bool:
        """Adds many messages of several topics.

        Args:
            topics: Number to topic, as in the file.
            numbers: Topic number of each message, shape (N,); messages with a negative number are skipped.
            times: Recording times [ns], shape (N,).
            messages: N messages, in order.

        Returns:
            Whether all numbers are known; if not, nothing is added.

        Raises:
            LogError: As `add`.
        """
        rows = np.flatnonzero(numbers >= 0)
        rows = rows[_stable_order(numbers[rows])]
        ends = np.append(np.flatnonzero(np.diff(numbers[rows])) + 1, len(rows))
        of_number = {int(numbers[part[0]]): part for part in np.split(rows, ends[:-1]) if len(part)}
        if not all(number in topics for number in of_number):
            return False
        if len(rows):
            self.losses.seen(int(times[rows].min()), int(times[rows].max()))
        same: dict[tuple[str, str, str], list[int]] = {}  # several may publish on a topic: their order is kept
        for number in of_number:
            topic = topics[number]
            same.setdefault((topic.name, topic.msgtype, topic.encoding), []).append(number)
        for members in same.values():
            topic, parts = topics[members[0]], [of_number[number] for number in members]
            if self.wants(topic):
                which = np.sort(np.concatenate(parts)) if len(parts) > 1 else parts[0]
                self.add_block(topic, times[which], messages[which])
            else:
                self.pass_over(topic, sum(map(len, parts)))
        return True

    def content(self) -> Content:
        """The tables of all messages.

        Raises:
            LogError: There was no message at all, or its numbers exceed `LIMIT`.
        """
        damage = (*self._damage, *self.losses.texts())
        for stream in self._streams.values():
            self._decode(stream)
        if not any(stream.count for stream in self._streams.values()):
            said = [*damage, *self._notes]
            why = f" ({said[0]})" if said else "; check that the topics were published"
            raise LogError(f"{self.path}: the bag holds no messages{why}")
        tables: dict[str, Table] = {}
        skipped: dict[str, str] = {}
        for name, stream in self._streams.items():
            columns = {name: values[: stream.filled] for name, values in stream.columns.items()}
            columns = {name: values for name, values in columns.items() if name not in stream.uneven}
            if len(columns) > 1:
                tables[name] = Table(name, columns)
                for text in _notes(stream):
                    self.note(text)
            else:
                reason = stream.reason or stream.fault or "no numbers of the same length in all messages"
                skipped[name] = one_line(f"{reason} ({stream.topic.msgtype}, {stream.count} messages)")
        if self._more_notes:
            self._notes.append(f"and {self._more_notes} more such notes")
        return Content(tables, skipped, tuple(self._notes), self._attached, tuple(self._events), damage)

    def _stream(self, topic: Topic) -> _Stream:
        """Decides whether a topic is decoded."""
        if self._wanted is not None and topic.name not in self._wanted:
            return _Stream(topic, None, "not asked for")
        if self._wanted is None and topic.msgtype in BULK_TYPES:
            return _Stream(topic, None, "not a table of numbers")
        try:
            types = self._types_of(topic)
        except DamageError as error:
            return _Stream(topic, None, str(error))
        if topic.msgtype.endswith("/TFMessage"):
            return _Stream(
                topic, None, "lists of transforms; record the vehicle's pose as PoseStamped or TransformStamped"
            )
        if not has_numbers(types, topic.msgtype):
            return _Stream(topic, None, "holds no numbers outside of lists of other types")
        return _Stream(topic, types, "")

    def _types_of(self, topic: Topic) -> Types:
        """The definitions of a topic's type, parsed once for all topics of that type."""
        key = (topic.msgtype, topic.encoding, topic.definition, topic.language)
        if key not in self._types:
            self._parsed += len(topic.definition)
            if self._parsed > _MOST_PARSED:
                raise DamageError(f"the definitions of the topics before it fill {_MOST_PARSED >> 20} MiB")
            self._types[key] = types_of(topic)
        return self._types[key]

    def _is_foreign(self, stream: _Stream, topic: Topic, count: int) -> bool:
        """Whether messages are of another type than the first on their topic; if so, they are counted."""
        if (topic.msgtype, topic.encoding) == (stream.topic.msgtype, stream.topic.encoding):
            return False
        stream.foreign += count
        return True

    def _count(self, stream: _Stream, rows: int, size: int) -> None:
        """Counts waiting messages, and decodes them once there are enough."""
        stream.rows += rows
        stream.waiting += size
        if stream.rows >= _BATCH or stream.waiting >= _BATCH_BYTES:
            self._decode(stream)

    def _decode(self, stream: _Stream) -> None:
        """Decodes the waiting messages."""
        _close(stream)
        if stream.types is None or not stream.blocks:
            return
        messages = join_messages([part for _, part in stream.blocks])
        times = np.concatenate([part for part, _ in stream.blocks])
        stream.blocks, stream.rows, stream.waiting = [], 0, 0
        batch = decoded(stream.topic, stream.types, messages)
        stream.lost += len(messages) - len(batch.rows)
        stream.fault = stream.fault or batch.fault
        stream.uneven |= batch.uneven
        if len(batch.rows):
            _append(stream, {"log_time": times[batch.rows]} | batch.columns)
            self._bytes += sum(values.nbytes for values in batch.columns.values()) + 8 * len(batch.rows)
        if self._bytes > LIMIT:
            raise LogError(f"{self.path}: more than {LIMIT >> 20} MiB of numbers; read only the topics that you need")


def _stable_order(numbers: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Indices that sort non-negative numbers stably; small ones as uint16, for which numpy uses a faster sort."""
    small = numbers.max(initial=0) < 1 << 16
    return np.argsort(numbers.astype(np.uint16) if small else numbers, kind="stable")


def _close(stream: _Stream) -> None:
    """Moves the messages added singly into a block."""
    if stream.messages:
        stream.blocks.append((np.array(stream.times, dtype=np.int64), messages_of(stream.messages)))
        stream.times, stream.messages = [], []


def _any_packed(topic: Topic, messages: Messages) -> bool:
    """Whether single messages are compressed (`--compression-mode message`); CDR never begins like zstd."""
    if topic.encoding != "cdr":
        return False
    heads = integers(messages.data, messages.starts[messages.lengths >= len(ZSTD_MAGIC)], "<u4")
    return bool((heads == int.from_bytes(ZSTD_MAGIC, "little")).any())


def _append(stream: _Stream, batch: dict[str, Column]) -> None:
    """Appends a batch to the decoded columns; columns that differ in shape or type are left out."""
    start, stop = stream.filled, stream.filled + len(batch["log_time"])
    if start == 0:
        stream.columns = {name: np.array(values, order="C") for name, values in batch.items()}  # its own: it will grow
    else:
        alike = {name for name, values in stream.columns.items() if name in batch and _are_alike(values, batch[name])}
        stream.uneven |= (stream.columns.keys() | batch.keys()) - alike
        stream.columns = {name: values for name, values in stream.columns.items() if name in alike}
        for name, values in stream.columns.items():
            if len(values) < stop:  # in place: large arrays are remapped without a copy
                values.resize((stop + stop // 8, *values.shape[1:]), refcheck=False)
            values[start:stop] = batch[name]
    stream.filled = stop


def _are_alike(one: Column, other: Column) -> bool:
    return one.shape[1:] == other.shape[1:] and one.dtype == other.dtype


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
