"""What binary logs of autopilots share: records of known size, found one after the other, become columns at once."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Protocol

import numpy as np

from rotorfit.core.log import Column

_BLOCK = 1 << 22

BOOL = "?1"
"""Format of truth values: read as bytes, because a stranger's may be neither 0 nor 1."""


@dataclass(frozen=True)
class Leaf:
    """One column in a record.

    Attributes:
        name: Of the column.
        format: Numpy's, such as `<f4`, or `BOOL`.
        offset: Bytes before it.
        count: Length of an array, which becomes a matrix; None for a single number.
        divisor: What the number was multiplied by to be written as a whole one.
    """

    name: str
    format: str
    offset: int
    count: int | None = None
    divisor: float = 1.0


@dataclass(frozen=True)
class RecordLayout:
    """Where the numbers lie in the records of a table.

    Attributes:
        leaves: Columns.
        start: Bytes of the record's head.
        size: Bytes behind the head that hold the columns.
    """

    leaves: tuple[Leaf, ...]
    start: int
    size: int


@dataclass
class Rows:
    """Records of one table as they are gathered, block by block.

    Attributes:
        batches: Their bytes behind the head, each of shape (N,).
        nbytes: Size of all of them.
    """

    batches: list[Column] = field(default_factory=list)
    nbytes: int = 0

    def gather(self, data: bytes, places: Sequence[int], layout: RecordLayout) -> None:
        """Takes the records that begin at `places` in a block."""
        self.batches.append(gathered(data, places, layout))
        self.nbytes += self.batches[-1].nbytes

    def columns(self, layout: RecordLayout) -> dict[str, Column]:
        """All records as columns, in the order of the file; the records are given up."""
        records = np.concatenate(self.batches)
        self.batches = []
        return columns_of(records, layout)


@dataclass
class Damage:
    """What had to be left out of a file.

    Attributes:
        places: How often the chain of records was broken.
        first: Offset of the first break.
        skipped: Bytes that belong to no record.
        left: Bytes of a last record that is cut short.
    """

    places: int = 0
    first: int = 0
    skipped: int = 0
    left: int = 0

    def found(self, offset: int, skipped: int) -> None:
        """Takes down a break in the chain of records."""
        self.first = self.first if self.places else offset
        self.places += 1
        self.skipped += skipped

    def texts(self, size: int) -> tuple[str, ...]:
        """What is said of it; nothing where the file is whole."""
        texts = []
        if self.places:
            where = "" if self.places == 1 else f"in {self.places} places, first "
            texts.append(f"damaged {where}at byte {self.first} of {size}: {self.skipped} bytes left out")
        if self.left:
            texts.append(
                f"the file ends in the middle of a record, of which it holds {self.left} bytes: what came after is lost"
            )
        return tuple(texts)


class Walker(Protocol):
    """What follows the chain of records through a block."""

    def __call__(self, data: bytes, offset: int, last: bool) -> int:
        """Takes the whole records of a block that begins at `offset` in the file; returns where it stopped."""


def walk(file: BinaryIO, start: int, end: int, step: Walker) -> int:
    """Leads a walker over a part of a file, block by block; returns the bytes left behind the last whole record."""
    file.seek(start)
    data, offset = b"", start
    while True:
        more = file.read(min(_BLOCK, end - offset - len(data)))
        data += more
        last = not more or offset + len(data) >= end
        stopped = step(data, offset, last)
        data, offset = data[stopped:], offset + stopped
        if last:
            return len(data)


def gathered(data: bytes, places: Sequence[int] | Column, layout: RecordLayout) -> Column:
    """Bytes behind the heads of the records at `places`, shape (N,)."""
    windows = np.ndarray((len(data) - layout.size + 1,), f"V{layout.size}", data, 0, (1,))
    return windows[np.array(places, dtype=np.int64) + layout.start]


def columns_of(records: Column, layout: RecordLayout) -> dict[str, Column]:
    """Columns of gathered records: shape (N,), or (N, M) for arrays."""
    views = records.view(
        {
            "names": [str(index) for index in range(len(layout.leaves))],
            "formats": [_format(leaf) for leaf in layout.leaves],
            "offsets": [leaf.offset for leaf in layout.leaves],
            "itemsize": layout.size,
        }
    )
    return {leaf.name: _column(views[str(index)], leaf) for index, leaf in enumerate(layout.leaves)}


def _format(leaf: Leaf) -> object:
    number = "u1" if leaf.format == BOOL else leaf.format
    return number if leaf.count is None else (number, (leaf.count,))


def _column(values: Column, leaf: Leaf) -> Column:
    """Numbers of a column, of native byte order and in one piece."""
    if leaf.format == BOOL:
        return np.asarray(values != 0)
    if leaf.divisor != 1.0:
        return np.asarray(values.astype(np.float64) / leaf.divisor)
    return np.asarray(values.astype(values.dtype.newbyteorder("="), order="C"))
