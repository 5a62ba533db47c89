"""Rows of the table `messages` of a ROS 2 bag, many at once, straight from the pages of the SQLite file.

SQLite gives one row after the other to Python. Here the leaf pages of the table are found from its root, and the rows
that are written alike (same lengths of all columns) are taken together. Only what is exactly as rosbag2 writes it is
taken; of everything else, and of all damage, the reader of the bag asks SQLite itself.

Source: https://sqlite.org/fileformat2.html, sections 1.6 (b-tree pages), 2.1 (record format)
"""

from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from rotorfit.sources.block import Messages, Places, byte_rows, integers
from rotorfit.sources.content import DamageError

_INTERIOR, _LEAF = 5, 13
_LEAF_HEAD, _INTERIOR_HEAD = 8, 12
_BLOCK = 1 << 23  # bytes of leaves taken at once
_PREFIX = 48  # bytes of a row that its lengths, its rowid, its topic and its time never exceed
_DEEPEST, _MOST_LAYOUTS = 20, 64
_INTEGER_SIZES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Serial type to bytes; types 8 and 9 are the numbers 0 and 1 themselves."""


@dataclass(frozen=True)
class Rows:
    """Rows of some leaves, in their order.

    Attributes:
        first: Rowid of the first.
        last: Rowid of the last.
        numbers: Of the topics, shape (N,); empty where the rows are of too many shapes to be taken together.
        times: Of recording [ns], shape (N,).
        messages: N of them.
        whole: Which messages lie in their page as a whole, shape (N,): only those may be used.
    """

    first: int
    last: int
    numbers: Places
    times: Places
    messages: Messages
    whole: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class _Pages:
    """The pages of a file: how large, how much of each is used, and how many."""

    file: BufferedReader
    size: int
    used: int
    count: int


@dataclass(frozen=True)
class _Layout:
    """How rows of the same lengths are written: places count from the first byte of the row.

    Attributes:
        mask: Bits of the prefix that are the same in all of them, shape (_PREFIX,).
        topic: Place and serial type of the topic's number.
        time: Place and serial type of the time.
        data: Place of the message.
        length: Bytes of the message.
        end: Place behind the row.
        whole: Whether all of it lies in the page.
    """

    mask: npt.NDArray[np.uint8]
    topic: tuple[int, int]
    time: tuple[int, int]
    data: int
    length: int
    end: int
    whole: bool


def rows_of_messages(path: Path, root: int) -> Iterator[Rows]:
    """Rows of a table with the columns id, topic_id, timestamp, data, of which id is the rowid.

    Args:
        path: The file, of whole pages.
        root: The table's root page.

    Raises:
        DamageError: The rest is not as expected; what was given before is right.
    """
    with path.open("rb") as file:
        head = file.read(100)
        size = int.from_bytes(head[16:18], "big")
        size = 65536 if size == 1 else size
        if size < 512 or size & (size - 1) or len(head) < 100:
            raise DamageError("a page size that is none")
        pages = _Pages(file, size, size - head[20], path.stat().st_size // size)
        leaves, is_whole = _leaves(pages, root)
        step = max(1, _BLOCK // size)
        for start in range(0, len(leaves), step):
            yield from _rows(pages, leaves[start : start + step])
        if not is_whole:
            raise DamageError("pages are missing")


def _leaves(pages: _Pages, root: int) -> tuple[Places, bool]:
    """Numbers of the leaf pages in the order of the rows, and whether they are all."""
    level, is_whole = np.array([root]), True
    for _ in range(_DEEPEST):
        missing = np.flatnonzero((level < 2) | (level > pages.count))
        if len(missing):
            level, is_whole = level[: missing[0]], False
        if len(level) == 0 or len(level) > pages.count or len(np.unique(level)) < len(level):
            raise DamageError("a table without pages, or a page that is there twice")
        first = _page(pages, int(level[0]))
        if first[0] == _LEAF:
            return level, is_whole
        level = np.concatenate([_children(pages, number) for number in level.tolist()])
    raise DamageError("a table that is too deep")


def _page(pages: _Pages, number: int) -> bytes:
    """One page; page 1 is the first."""
    pages.file.seek((number - 1) * pages.size)
    return pages.file.read(pages.size)


def _children(pages: _Pages, number: int) -> Places:
    """Numbers of the pages below an interior page, in their order."""
    page = _page(pages, number)
    count = int.from_bytes(page[3:5], "big")
    if page[0] != _INTERIOR or _INTERIOR_HEAD + 2 * count > pages.used:
        raise DamageError("a page that is no interior page of a table")
    cells = np.frombuffer(page, ">u2", count, _INTERIOR_HEAD).astype(np.int64)
    if cells.max(initial=0) > pages.used - 4:
        raise DamageError("a row outside of its page")
    return np.append(integers(page, cells, ">u4"), int.from_bytes(page[8:12], "big"))


def _rows(pages: _Pages, leaves: Places) -> Iterator[Rows]:
    """The rows of some leaves; nothing where they have none."""
    data = _read(pages, leaves)
    bases = np.arange(len(leaves)) * pages.size
    counts = integers(data, bases + 3, ">u2")
    if (data[bases] != _LEAF).any() or (_LEAF_HEAD + 2 * counts > pages.used).any():
        raise DamageError("a page that is no leaf of a table")
    if counts.sum() == 0:
        return
    page_of = np.repeat(np.arange(len(leaves)), counts)
    rank = np.arange(len(page_of)) - np.repeat(np.cumsum(counts) - counts, counts)
    base = bases[page_of]
    inside = integers(data, base + _LEAF_HEAD + 2 * rank, ">u2")
    if inside.max() > pages.used or (inside < _LEAF_HEAD + 2 * counts[page_of]).any():
        raise DamageError("a row outside of its page")
    yield _taken(data, base + inside, base + pages.used, pages.used)


def _read(pages: _Pages, leaves: Places) -> npt.NDArray[np.uint8]:
    """Pages end to end, those that follow each other in the file at once, and room for a prefix behind them."""
    data = bytearray(len(leaves) * pages.size + _PREFIX)
    view = memoryview(data)
    edges = [0, *(np.flatnonzero(np.diff(leaves) != 1) + 1).tolist(), len(leaves)]
    for start, stop in pairwise(edges):
        part = view[start * pages.size : stop * pages.size]
        pages.file.seek((int(leaves[start]) - 1) * pages.size)
        if pages.file.readinto(part) < len(part):
            raise DamageError("a page is cut short")
    return np.frombuffer(data, np.uint8)


def _taken(data: npt.NDArray[np.uint8], starts: Places, limits: Places, used: int) -> Rows:
    """The columns of the rows that begin at `starts` and must end before `limits`."""
    prefix = byte_rows(data, starts, _PREFIX)
    first, last = (_rowid(prefix[row].tobytes()) for row in (0, -1))
    numbers, times, places, lengths = (np.zeros(len(starts), np.int64) for _ in range(4))
    whole = np.zeros(len(starts), bool)
    left = np.arange(len(starts))
    for _ in range(_MOST_LAYOUTS):
        pattern = prefix[left[0]]
        layout = _layout(pattern.tobytes(), used)
        same = ((prefix[left] & layout.mask) == (pattern & layout.mask)).all(axis=1)
        rows, left = left[same], left[~same]
        if (starts[rows] + layout.end > limits[rows]).any():
            raise DamageError("a row outside of its page")
        numbers[rows] = _integer(prefix, rows, *layout.topic)
        times[rows] = _integer(prefix, rows, *layout.time)
        places[rows], lengths[rows], whole[rows] = starts[rows] + layout.data, layout.length, layout.whole
        if len(left) == 0:
            return Rows(first, last, numbers, times, Messages(data, places, lengths), whole)
    nothing = np.zeros(0, np.int64)
    return Rows(first, last, nothing, nothing, Messages(b"", nothing, nothing), np.zeros(0, bool))


def _layout(row: bytes, used: int) -> _Layout:
    """How a row is written, from its first bytes."""
    payload, after_payload = _varint(row, 0)
    _, body = _varint(row, after_payload)
    head, at = _varint(row, body)
    kinds = []
    for _ in range(4):
        kind, at = _varint(row, at)
        kinds.append(kind)
    identity, topic, time, blob = kinds
    numbers = topic in _INTEGER_SIZES and time in _INTEGER_SIZES
    if at != body + head or identity != 0 or not numbers or blob < 12 or blob % 2:
        raise DamageError("a row that is no message")
    length = (blob - 12) // 2
    time_at = at + _INTEGER_SIZES[topic]
    data = time_at + _INTEGER_SIZES[time]
    if data > _PREFIX or data + length != body + payload:
        raise DamageError("a row whose lengths do not add up")
    mask = np.zeros(_PREFIX, np.uint8)
    mask[:at] = 0xFF
    mask[after_payload:body] = 0x80  # of a rowid only its length
    whole = payload <= used - 35
    return _Layout(mask, (at, topic), (time_at, time), data, length, body + payload if whole else data, whole)


def _rowid(row: bytes) -> int:
    """The rowid of a row, from its first bytes."""
    value, _ = _varint(row, _varint(row, 0)[1])
    return value - (1 << 64) if value >> 63 else value


def _varint(data: bytes, start: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where it ends."""
    value = 0
    for place in range(start, start + 8):
        value = value << 7 | data[place] & 0x7F
        if data[place] < 0x80:
            return value, place + 1
    return value << 8 | data[start + 8], start + 9


def _integer(prefix: npt.NDArray[np.uint8], rows: Places, place: int, kind: int) -> Places:
    """A signed number, most significant byte first, of each row."""
    values = np.full(len(rows), kind - 8 if kind in (8, 9) else 0, dtype=np.int64)
    for byte in range(_INTEGER_SIZES[kind]):
        column = prefix[rows, place + byte]
        values = values * 256 + column if byte else column.astype(np.int8).astype(np.int64)
    return values
