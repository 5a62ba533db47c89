"""Rows of the table `messages` of a ROS 2 bag, many at once, straight from the pages of the SQLite file.

SQLite passes rows to Python one by one, and none behind a missing page. Here the leaf pages of the table are found
from its root, or by their appearance where interior pages are missing, and rows with the same layout (same lengths of
all columns) are extracted together. Only pages exactly as rosbag2 writes them are used; for everything else the reader
of the bag queries SQLite.

Source: https://sqlite.org/fileformat2.html, sections 1.6 (b-tree pages), 2.1 (record format)
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BufferedReader
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from rotorfit.files.logs.batches import Messages, Places, byte_rows, integers
from rotorfit.files.logs.content import BLOCK_LIMIT, DamageError

_INTERIOR, _LEAF = 5, 13

_LEAF_HEAD, _INTERIOR_HEAD = 8, 12

_BLOCK = 1 << 22  # bytes of leaves, or of messages beyond them, processed at once

_PREFIX = 48  # most bytes of a row taken by its lengths, rowid, topic and time

_DEEPEST, _MOST_LAYOUTS = 20, 64

_INTEGER_SIZES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Serial type to length in bytes; types 8 and 9 are the numbers 0 and 1 themselves."""


@dataclass(frozen=True)
class LeafRows:
    """Rows of some leaves.

    Attributes:
        rowids: Shape (N,).
        numbers: Topic numbers, shape (N,).
        times: Recording times [ns], shape (N,).
        messages: N messages.
        here: Bytes of each message inside the block, shape (N,): only messages entirely inside may be used.
    """

    rowids: Places
    numbers: Places
    times: Places
    messages: Messages
    here: Places

    @property
    def whole(self) -> npt.NDArray[np.bool_]:
        """Which messages are entirely inside the block, shape (N,)."""
        return np.asarray(self.here == self.messages.lengths)

    def __getitem__(self, which: slice | npt.NDArray[np.bool_] | Places) -> "LeafRows":
        return LeafRows(
            self.rowids[which], self.numbers[which], self.times[which], self.messages[which], self.here[which]
        )


@dataclass
class _Pages:
    """The pages of a file: page size, used bytes of each, page count, and overflow pages read so far."""

    file: BufferedReader
    size: int
    used: int
    count: int
    spent: int = 0


@dataclass(frozen=True)
class _Layout:
    """Layout of rows with the same lengths; offsets count from the first byte of the row.

    Attributes:
        mask: Bits of the prefix that are equal in all such rows, shape (_PREFIX,).
        rowid: Start and end of the rowid.
        topic: Offset and serial type of the topic number.
        time: Offset and serial type of the time.
        data: Offset of the message.
        length: Length of the message [byte].
        here: Bytes of the message in the page.
        end: End of the part of the row in the page.
    """

    mask: npt.NDArray[np.uint8]
    rowid: tuple[int, int]
    topic: tuple[int, int]
    time: tuple[int, int]
    data: int
    length: int
    here: int
    end: int


def rows_of_table(path: Path, root: int, wanted: list[int]) -> Iterator[LeafRows]:
    """Rows, in order, of a table with the columns id, topic_id, timestamp, data, where id is the rowid.

    Args:
        path: The file, of whole pages.
        root: The table's root page.
        wanted: Numbers of the topics whose messages are returned in full.

    Raises:
        DamageError: The rest is not as expected; the rows yielded before are right.
    """
    with path.open("rb") as file:
        pages = _pages(file, path.stat().st_size)
        leaves, are_all = _leaves(pages, root)
        step = max(1, _BLOCK // pages.size)
        for start in range(0, len(leaves), step):
            for rows in _filled(pages, _rows(pages, leaves[start : start + step]), wanted):
                if not rows.whole[np.isin(rows.numbers, wanted)].all():
                    raise DamageError("a message whose pages are missing")
                yield rows
        if not are_all:
            raise DamageError("pages are missing")


def rows_left(path: Path, after: int, wanted: list[int]) -> Iterator[LeafRows]:
    """Rows of that table after the rowid `after`, from every page of the file that looks like a leaf of it.

    Args:
        path: The file, of whole pages, some of the table's missing.
        after: Last rowid that is known.
        wanted: As for `rows_of_table`; incomplete messages are left out.
    """
    with path.open("rb") as file:
        pages = _pages(file, path.stat().st_size)
        leaves = _scattered(pages)
        step = max(1, _BLOCK // pages.size)
        for start in range(0, len(leaves), step):
            for found in _rows_that_are_right(pages, leaves[start : start + step]):
                ascending = found[np.unique(found.rowids, return_index=True)[1]]
                for rows in _filled(pages, ascending[ascending.rowids > after], wanted):
                    yield rows[rows.whole | ~np.isin(rows.numbers, wanted)]
                after = int(found.rowids.max(initial=after))


def _rows_that_are_right(pages: _Pages, leaves: Places) -> Iterator[LeafRows]:
    """The rows of some leaves, without damaged leaves."""
    try:
        yield _rows(pages, leaves)
    except DamageError:
        if len(leaves) > 1:
            half = len(leaves) // 2
            yield from _rows_that_are_right(pages, leaves[:half])
            yield from _rows_that_are_right(pages, leaves[half:])


def _pages(file: BufferedReader, size: int) -> _Pages:
    """The pages according to the header of the file."""
    head = file.read(100)
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    if len(head) < 100 or page < 512 or page & (page - 1) or head[20] > 32:
        raise DamageError("an invalid page size")
    return _Pages(file, page, page - head[20], size // page)


def _leaves(pages: _Pages, root: int) -> tuple[Places, bool]:
    """Numbers of the leaf pages in the order of the rows, up to the first missing one, and whether these are all."""
    level, are_all = np.array([root]), True
    for _ in range(_DEEPEST):
        missing = np.flatnonzero((level < 2) | (level > pages.count))
        if len(missing):
            level, are_all = level[: missing[0]], False
        if len(level) == 0 or len(np.unique(level)) < len(level):
            raise DamageError("a table without pages, or a page that is there twice")
        if _page(pages, int(level[0]))[0] == _LEAF:
            return level, are_all
        level = np.concatenate([_children(pages, number) for number in level.tolist()])
    raise DamageError("a table that is too deep")


def _scattered(pages: _Pages) -> Places:
    """Numbers of the pages that look like leaves with messages, ordered by the rowid of their first row."""
    found: list[tuple[int, int]] = []
    for number in range(2, pages.count + 1):
        page = _page(pages, number)
        start = int.from_bytes(page[_LEAF_HEAD : _LEAF_HEAD + 2], "big")
        if page[0] == _LEAF and page[3:5] != b"\0\0" and start <= pages.used:
            row = page[start : start + _PREFIX].ljust(_PREFIX, b"\0")
            try:
                _layout(row, pages.used)
            except DamageError:
                continue
            found.append((_rowid(row), number))
    return np.array([number for _, number in sorted(found)], dtype=np.int64)


def _page(pages: _Pages, number: int) -> bytes:
    """One page; numbers start at 1."""
    pages.file.seek((number - 1) * pages.size)
    return pages.file.read(pages.size)


def _children(pages: _Pages, number: int) -> Places:
    """Numbers of the pages below an interior page, in order."""
    page = _page(pages, number)
    count = int.from_bytes(page[3:5], "big")
    if page[0] != _INTERIOR or _INTERIOR_HEAD + 2 * count > pages.used:
        raise DamageError("a page that is no interior page of a table")
    cells = np.frombuffer(page, ">u2", count, _INTERIOR_HEAD).astype(np.int64)
    if cells.max(initial=0) > pages.used - 4:
        raise DamageError("a row outside of its page")
    return np.append(integers(page, cells, ">u4"), int.from_bytes(page[8:12], "big"))


def _rows(pages: _Pages, leaves: Places) -> LeafRows:
    """The rows of some leaves."""
    data = _read(pages, leaves)
    bases = np.arange(len(leaves)) * pages.size
    counts = integers(data, bases + 3, ">u2")
    if (data[bases] != _LEAF).any() or (_LEAF_HEAD + 2 * counts > pages.used).any():
        raise DamageError("a page that is no leaf of a table")
    page_of = np.repeat(np.arange(len(leaves)), counts)
    rank = np.arange(len(page_of)) - np.repeat(np.cumsum(counts) - counts, counts)
    base = bases[page_of]
    inside = integers(data, base + _LEAF_HEAD + 2 * rank, ">u2")
    if inside.max(initial=0) > pages.used or (inside < _LEAF_HEAD + 2 * counts[page_of]).any():
        raise DamageError("a row outside of its page")
    return _taken(data, base + inside, base + pages.used, pages.used)


def _read(pages: _Pages, leaves: Places) -> npt.NDArray[np.uint8]:
    """Concatenates pages, reading consecutive ones at once, with room for a prefix after them."""
    data = bytearray(len(leaves) * pages.size + _PREFIX)
    view = memoryview(data)
    edges = [0, *(np.flatnonzero(np.diff(leaves) != 1) + 1).tolist(), len(leaves)]
    for start, stop in pairwise(edges):
        part = view[start * pages.size : stop * pages.size]
        pages.file.seek((int(leaves[start]) - 1) * pages.size)
        if pages.file.readinto(part) < len(part):
            raise DamageError("a page is cut short")
    return np.frombuffer(data, np.uint8)


def _taken(data: npt.NDArray[np.uint8], starts: Places, limits: Places, used: int) -> LeafRows:
    """The columns of the rows that begin at `starts` and must end before `limits`."""
    prefix = byte_rows(data, starts, _PREFIX)
    words = prefix.view(np.uint64)
    rowids, numbers, times, places, lengths, here = (np.zeros(len(starts), np.int64) for _ in range(6))
    left, layouts = np.arange(len(starts)), 0
    while len(left):
        layout = _layout(prefix[left[0]].tobytes(), used)
        same = np.ones(len(left), bool)
        for word in np.flatnonzero(mask := layout.mask.view(np.uint64)).tolist():  # eight bytes at once
            same &= (words[left, word] ^ words[left[0], word]) & mask[word] == 0
        layouts += 1
        if layouts > _MOST_LAYOUTS:  # too many layouts: searching for equal rows would take too long
            same = np.arange(len(left)) == 0
        rows, left = left[same], left[~same]
        if (starts[rows] + layout.end > limits[rows]).any():
            raise DamageError("a row outside of its page")
        for place in range(*layout.rowid):
            rowids[rows] = rowids[rows] << 7 | prefix[rows, place] & 0x7F
        numbers[rows] = _integers(data, starts[rows] + layout.topic[0], layout.topic[1])
        times[rows] = _integers(data, starts[rows] + layout.time[0], layout.time[1])
        places[rows], lengths[rows], here[rows] = starts[rows] + layout.data, layout.length, layout.here
    return LeafRows(rowids, numbers, times, Messages(data, places, lengths), here)


def _layout(row: bytes, used: int) -> _Layout:
    """Layout of a row, from its first bytes."""
    payload, rowid = _varint(row, 0)
    _, body = _varint(row, rowid)
    head, at = _varint(row, body)
    kinds = []
    for _ in range(4):
        kind, at = _varint(row, at)
        kinds.append(kind)
    identity, topic, time, blob = kinds
    numbers = topic in _INTEGER_SIZES and time in _INTEGER_SIZES
    if at != body + head or identity != 0 or not numbers or blob < 12 or blob % 2 or body - rowid > 8:
        raise DamageError("a row that is no message")
    time_at = at + _INTEGER_SIZES[topic]
    data = time_at + _INTEGER_SIZES[time]
    length = (blob - 12) // 2
    if data > _PREFIX or data + length != body + payload:
        raise DamageError("a row whose lengths do not add up")
    mask = np.zeros(_PREFIX, np.uint8)
    mask[:at] = 0xFF
    mask[rowid:body] = 0x80  # only the length of a rowid
    local = _local(payload, used)
    end = body + local + (4 if local < payload else 0)
    return _Layout(mask, (rowid, body), (at, topic), (time_at, time), data, length, body + local - data, end)


def _local(payload: int, used: int) -> int:
    """Bytes of a row that are in its leaf; the number of the overflow page follows them."""
    if payload <= used - 35:
        return payload
    least = (used - 12) * 32 // 255 - 23
    fitting = least + (payload - least) % (used - 4)
    return fitting if fitting <= used - 35 else least


def _rowid(row: bytes) -> int:
    """The rowid of a row, from its first bytes."""
    return _varint(row, _varint(row, 0)[1])[0]


def _varint(data: bytes, start: int) -> tuple[int, int]:
    """A number of one to nine bytes, and its end."""
    value = 0
    for place in range(start, start + 8):
        value = value << 7 | data[place] & 0x7F
        if data[place] < 0x80:
            return value, place + 1
    return value << 8 | data[start + 8], start + 9


def _integers(data: npt.NDArray[np.uint8], places: Places, kind: int) -> Places:
    """Signed numbers of a serial type, most significant byte first."""
    if kind in (8, 9):
        return np.full(len(places), kind - 8)
    size = _INTEGER_SIZES[kind]
    if size in (3, 6):  # combines a signed high part and an unsigned low part of twice its size
        high, low = integers(data, places, f">i{size // 3}"), integers(data, places + size // 3, f">u{size // 3 * 2}")
        return high << 8 * (size // 3 * 2) | low
    return integers(data, places, f">i{size}")


def _filled(pages: _Pages, rows: LeafRows, wanted: list[int]) -> Iterator[LeafRows]:
    """The same rows, in portions, with the messages of requested topics fetched from overflow pages."""
    beyond = np.flatnonzero(~rows.whole & np.isin(rows.numbers, wanted))
    sizes = np.cumsum(rows.messages.lengths[beyond]) // _BLOCK
    edges = [0, *beyond[np.flatnonzero(np.diff(sizes)) + 1].tolist(), len(rows.rowids)]
    for start, stop in pairwise(edges):
        part = rows[start:stop]
        yield _fetched(pages, part, (beyond[(beyond >= start) & (beyond < stop)] - start).tolist())


def _fetched(pages: _Pages, rows: LeafRows, beyond: list[int]) -> LeafRows:
    """Rows with messages assembled from overflow pages, unless one of those is missing."""
    if not beyond:
        return rows
    starts, here = rows.messages.starts.copy(), rows.here.copy()
    parts = [bytes(rows.messages.data)]
    end = len(parts[0])
    for row in beyond:
        length = int(rows.messages.lengths[row])
        message = _message(pages, parts[0], int(starts[row]), int(here[row]), length)
        if len(message) == length:
            starts[row], here[row] = end, length
            parts.append(message)
            end += length
    return replace(rows, messages=Messages(b"".join(parts), starts, rows.messages.lengths), here=here)


def _message(pages: _Pages, block: bytes, start: int, here: int, length: int) -> bytes:
    """A message that continues in a chain of overflow pages, as far as these are present."""
    parts, missing = [block[start : start + here]], length - here
    following = block[start + here : start + here + 4]
    while missing > 0 and length <= BLOCK_LIMIT:
        number = int.from_bytes(following, "big")
        pages.spent += 1
        if pages.spent > pages.count:
            raise DamageError("pages that belong to several messages")
        if not 2 <= number <= pages.count:
            break
        page = _page(pages, number)
        following = page[:4]
        parts.append(page[4 : min(pages.used, 4 + missing)])
        missing -= len(parts[-1])
    return b"".join(parts)
