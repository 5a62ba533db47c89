"""Shared by MCAP and ROS 1 bags: records, some of them compressed chunks of records, read from front to back.

The index after each chunk only speeds this up. Behind damage, reading resumes where records follow each other again.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from mmap import ACCESS_READ, mmap
from typing import BinaryIO, ClassVar, Generic, TypeVar

import numpy as np

from rotorfit.files.logs.batches import Places, RecordRun
from rotorfit.files.logs.content import BLOCK_LIMIT, DamageError, TornError
from rotorfit.files.logs.damage import Block
from rotorfit.files.logs.ros_messages import Topic
from rotorfit.files.logs.topics import Collector

Head = TypeVar("Head")
"""What a record begins with: the number of its kind in MCAP, the fields of its header in a ROS 1 bag."""


@dataclass
class Chunk(Generic[Head]):
    """A chunk that waits until the index after it is known.

    Attributes:
        head: Head of its record.
        place: Offset of the record in the file.
        start: Offset of its data in the file.
        length: Length of the data, as far as present [byte].
        torn: Whether damage follows directly, so that its last record may be torn.
        index: Channel or connection to the offsets of its messages in the decompressed chunk.
    """

    head: Head
    place: int
    start: int
    length: int
    torn: bool = False
    index: dict[int, Places] = field(default_factory=dict)


class ChunkedFile(ABC, Generic[Head]):
    """A file that is walked from record to record, with what is still pending.

    Attributes:
        never_closed: Damage that is reported where the records end without an end of the data; empty for none.
        file: The file.
        size: Its size [byte].
        collector: Takes the messages.
        place: Offset of the current record.
        topics: Channel or connection to topic, as far as known.
        chunk: Chunk that waits until the index after it is known.
        message: Message outside of chunks, with its offset: it waits until a record follows, as it may be torn.
    """

    never_closed: ClassVar[str] = ""

    def __init__(self, file: BinaryIO, size: int, place: int, collector: Collector) -> None:
        self.file, self.size, self.place, self.collector = file, size, place, collector
        self.topics: dict[int, Topic] = {}
        self.chunk: Chunk[Head] | None = None
        self.message: tuple[int, Head, bytes] | None = None

    @abstractmethod
    def _head(self) -> tuple[Head, int, int]:
        """Head, start and length of the data of the current record; only a chunk may be cut short."""

    @abstractmethod
    def _pass(self, head: Head, start: int, length: int) -> bool:
        """Handles one record, and what waited for it; False where the data end."""

    @abstractmethod
    def _record(self, head: Head, data: bytes) -> None:
        """Handles a message or a definition; other records are ignored."""

    @abstractmethod
    def _next(self, data: Block, start: int, in_chunk: bool = True) -> int | None:
        """Where records resume in a file or chunk; None where they do not."""

    @abstractmethod
    def _plain(self, chunk: Chunk[Head]) -> tuple[bytes, int]:
        """A chunk, decompressed as far as possible, and the size that it claims."""

    @abstractmethod
    def _runs(self, plain: bytes, hints: Places, resume: Callable[[bytes, int], int | None]) -> Iterator[RecordRun]:
        """The records of a decompressed chunk, by `batches.stretches`."""

    @abstractmethod
    def _messages(self, plain: bytes, starts: Places) -> None:
        """Takes records of a decompressed chunk, as many at once as possible."""

    def walk(self) -> None:
        """Passes all messages to the collector."""
        place: int | None = self.place
        while place is not None:
            self.place = place
            place = self._walked()

    def _walked(self) -> int | None:
        """Walks to the end, or to damage; in the latter case returns where to resume behind it, if possible."""
        try:
            while self.place < self.size:
                head, start, length = self._head()
                if not self._pass(head, start, length):
                    return None
                self.place = start + length
            self._settle()
            if self.never_closed:
                self.collector.damaged(self.never_closed)
            return None
        except DamageError as error:
            if isinstance(error, TornError) and self.message:
                self.place, self.message = self.message[0], None
            place = self.place
            if self.chunk and isinstance(error, TornError):
                self.chunk.torn = place == self.chunk.start + self.chunk.length
            self._settle()
            behind = self._behind(place + 1)
            self.collector.losses.found(place, self.size, (behind or self.size) - place, str(error))
            return behind

    def _begin(self, head: Head, start: int, length: int) -> None:
        """Lets a chunk wait for its index; raises `DamageError` if it is cut short."""
        self.chunk = Chunk(head, self.place, start, min(length, self.size - start))
        if length > self.size - start:
            behind = self._behind(start, in_chunk=False)
            self.place = self.size if behind is None else behind
            self.chunk.length = self.place - start
            raise DamageError("the chunk before it is cut short")

    def _settle(self) -> None:
        """Handles what is pending."""
        chunk, message, self.chunk, self.message = self.chunk, self.message, None, None
        if chunk is not None and self._wanted(chunk):
            self._take(chunk)
        if message is not None:
            self._record(message[1], message[2])

    def _wanted(self, chunk: Chunk[Head]) -> bool:
        """Whether a chunk may have messages of a requested topic."""
        return not self.collector.passed_over(self.topics, chunk.index)

    def _behind(self, start: int, in_chunk: bool = True) -> int | None:
        """Where records of the file resume."""
        if self.collector.losses.many:
            return None
        with mmap(self.file.fileno(), 0, access=ACCESS_READ) as data:
            self._learn(data)
            return self._next(data, start, in_chunk)

    def _learn(self, data: mmap) -> None:
        """Takes definitions from behind the damage, where the format has them there."""

    def _take(self, chunk: Chunk[Head]) -> None:
        """Takes the messages of a chunk; damage loses the messages it hits, in a compressed chunk also all after it."""
        left, losses = chunk.length, self.collector.losses

        def resume(data: bytes, start: int) -> int | None:
            return None if losses.many else self._next(data, start)

        try:
            plain, claim = self._plain(chunk)
            plain = plain[:-1] if chunk.torn else plain  # makes the last record incomplete
            hints = np.concatenate([*chunk.index.values(), np.zeros(0, np.int64)])
            for part in self._runs(plain, hints, resume):
                left = len(plain) - int(part.starts[0]) if len(part.starts) else 0
                self._messages(plain, part.starts)
                if part.lost:
                    losses.found(chunk.place, self.size, part.lost, f"in a chunk, {part.why}")
            left = claim - len(plain)
            if left > 0:
                raise DamageError(f"{len(plain)} of {claim} bytes")
        except DamageError as error:
            losses.found(chunk.place, self.size, left, f"in a chunk, {error}")

    def _data(self, start: int, length: int) -> bytes:
        """The data of a record."""
        if length > BLOCK_LIMIT:
            raise DamageError(f"a record of {length} bytes")
        self.file.seek(start)
        return self.file.read(length)
