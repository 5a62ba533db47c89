"""Messages in a block of bytes: located, checked and extracted many at once."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Bytes = bytes | npt.NDArray[np.uint8]

Places = npt.NDArray[np.int64]
"""Offsets of bytes in a block, shape (N,)."""


@dataclass(frozen=True)
class Messages:
    """Messages in a block of bytes.

    Attributes:
        data: The block.
        starts: Offset of the first byte of each, shape (N,).
        lengths: Length of each in bytes, shape (N,).
    """

    data: Bytes
    starts: Places
    lengths: Places

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, which: slice | npt.NDArray[np.bool_] | Places) -> "Messages":
        return Messages(self.data, self.starts[which], self.lengths[which])

    def one(self, row: int) -> bytes:
        """The bytes of one message."""
        start = int(self.starts[row])
        return bytes(self.data[start : start + int(self.lengths[row])])


def messages_of(messages: Sequence[bytes]) -> Messages:
    """Concatenates messages into one block."""
    lengths = np.fromiter(map(len, messages), np.int64, len(messages))
    return Messages(b"".join(messages), np.cumsum(lengths) - lengths, lengths)


def gathered(messages: Messages) -> Messages:
    """A copy without the bytes between the messages, so that their block can be freed."""
    size = int(messages.lengths[0]) if len(messages) else 0
    if size and (messages.lengths == size).all():
        data = byte_rows(messages.data, messages.starts, size).reshape(-1)
        return Messages(data, np.arange(len(messages), dtype=np.int64) * size, messages.lengths)
    return messages_of([messages.one(row) for row in range(len(messages))])


def join_messages(parts: Sequence[Messages]) -> Messages:
    """Concatenates messages from several blocks; every part must be `gathered`."""
    if len(parts) == 1:
        return parts[0]
    lengths = np.concatenate([part.lengths for part in parts])
    data = np.concatenate([np.frombuffer(part.data, np.uint8) for part in parts])
    return Messages(data, np.cumsum(lengths) - lengths, lengths)


def byte_rows(data: Bytes, starts: Places, size: int) -> npt.NDArray[np.uint8]:
    """`size` bytes from each start, shape (N, size); all must lie inside the block."""
    if size == 0 or len(starts) == 0:
        return np.zeros((len(starts), size), np.uint8)
    # Overlapping records, one for every byte: indexing copies each selected record at once.
    windows = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return windows[starts].view(np.uint8).reshape(len(starts), size)


def integers(data: Bytes, places: Places, form: str) -> npt.NDArray[np.int64]:
    """Integers of a numpy format at unaligned offsets, as int64; all must lie inside the block."""
    if len(places) == 0:
        return np.zeros(0, np.int64)
    number = np.dtype(form)
    windows = np.ndarray((len(data) - number.itemsize + 1,), number, data, strides=(1,))
    return windows[places].astype(np.int64, copy=False)


@dataclass(frozen=True)
class Fault:
    """What interrupted a walk from record to record.

    Attributes:
        place: Where the next record should begin.
        why: What is wrong there.
        torn: Whether the bytes there cannot be a record: then the one before may be torn as well.
    """

    place: int
    why: str
    torn: bool


@dataclass(frozen=True)
class RecordRun:
    """Records that follow each other, up to damage or the end of their block.

    Attributes:
        starts: Offsets of the records, ascending, shape (N,).
        lost: Bytes after them that belong to no record.
        why: What is wrong there, or "".
    """

    starts: Places
    lost: int = 0
    why: str = ""


Ends = Callable[[bytes, Places], Places | None]

Walk = Callable[[bytes, int, int], tuple[list[int], Fault | None]]

Resume = Callable[[bytes, int], int | None]


def stretches(data: bytes, hints: Places, ends_of: Ends, walk: Walk, resume: Resume) -> Iterator[RecordRun]:
    """Yields the records of a block in runs.

    Each record states its length, so records can only be found one after the other. An index lists them, but is not
    trusted: it is used only if its records, and those found by walking the gaps between them, account for every byte;
    then they are exactly those that the walk would have found.

    Args:
        data: The block.
        hints: Starts of records from the index, in any order, shape (N,); empty without an index.
        ends_of: Returns the ends of the records that begin at the starts; None if any exceeds the block.
        walk: Returns the starts of the records between two offsets, and the fault that interrupted the walk.
        resume: Returns the next offset from which records follow each other; None if there is none. Called after the
            run before has been consumed, so that it can use the definitions in it.
    """
    found = _by_index(data, hints, ends_of, walk)
    if found is not None:
        yield RecordRun(found)
        return
    place: int | None = 0
    while place is not None:
        starts, fault = walk(data, place, len(data))
        if fault is None:
            yield RecordRun(np.array(starts, dtype=np.int64))
            return
        end = starts.pop() if fault.torn and starts else fault.place
        yield RecordRun(np.array(starts, dtype=np.int64))
        place = resume(data, end + 1)
        yield RecordRun(np.zeros(0, np.int64), (len(data) if place is None else place) - end, fault.why)


def _by_index(data: bytes, hints: Places, ends_of: Ends, walk: Walk) -> Places | None:
    """Starts of all records, if the index and the walk through its gaps account for every byte; else None."""
    if len(hints) == 0:
        return None
    starts = np.sort(hints)
    ends = ends_of(data, starts)
    if ends is None:
        return None
    begins, finishes = np.append(0, ends), np.append(starts, len(data))
    if (begins > finishes).any():
        return None
    others: list[int] = []
    for gap in np.flatnonzero(begins < finishes).tolist():
        between, fault = walk(data, int(begins[gap]), int(finishes[gap]))
        if fault:
            return None
        others += between
    return np.sort(np.append(starts, np.array(others, dtype=np.int64))) if others else starts
