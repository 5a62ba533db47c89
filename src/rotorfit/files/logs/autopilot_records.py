"""Shared by binary autopilot logs: records of known size, located one by one, become columns at once."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Protocol

import numpy as np

from rotorfit.core.log import Column

_BLOCK = 1 << 22

BOOL = "?1"
"""Format of booleans: read as bytes, because in an untrusted file they may be neither 0 nor 1."""


@dataclass(frozen=True)
class Leaf:
    """One column in a record.

    Attributes:
        name: Name of the column.
        format: Numpy format, such as `<f4`, or `BOOL`.
        offset: Offset in the record's data [byte].
        count: Length of an array, which becomes a matrix; None for a single number.
        divisor: Factor by which the number was multiplied to be stored as an integer.
    """

    name: str
    format: str
    offset: int
    count: int | None = None
    divisor: float = 1.0


@dataclass(frozen=True)
class RecordLayout:
    """Layout of the records of a table.

    Attributes:
        leaves: Columns.
        start: Length of the record's head [byte].
        size: Length of the data behind the head [byte].
    """

    leaves: tuple[Leaf, ...]
    start: int
    size: int


@dataclass
class Rows:
    """Records of one table, collected block by block.

    Attributes:
        batches: Their data behind the head, each of shape (N,).
        nbytes: Total size.
    """

    batches: list[Column] = field(default_factory=list)
    nbytes: int = 0

    def gather(self, data: bytes, places: Sequence[int], layout: RecordLayout) -> None:
        """Collects the records that begin at `places` in a block."""
        self.batches.append(gathered(data, places, layout))
        self.nbytes += self.batches[-1].nbytes

    def columns(self, layout: RecordLayout) -> dict[str, Column]:
        """All records as columns, in the order of the file; the collected records are released."""
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
        left: Bytes of an incomplete last record.
    """

    places: int = 0
    first: int = 0
    skipped: int = 0
    left: int = 0

    def found(self, offset: int, skipped: int) -> None:
        """Records a break in the chain of records."""
        self.first = self.first if self.places else offset
        self.places += 1
        self.skipped += skipped

    def texts(self, size: int) -> tuple[str, ...]:
        """Summary in sentences; empty if the file is whole."""
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
    """Follows the chain of records through a block."""

    def __call__(self, data: bytes, offset: int, last: bool) -> int:
        """Takes the whole records of a block that begins at `offset` in the file; returns its position in the block."""


def walk(file: BinaryIO, start: int, end: int, step: Walker) -> int:
    """Runs a walker over a part of a file, block by block; returns the number of bytes after the last whole record."""
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
    """Data behind the heads of the records at `places`, shape (N,)."""
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
    """Values of a column, in native byte order and contiguous."""
    if leaf.format == BOOL:
        return np.asarray(values != 0)
    if leaf.divisor != 1.0:
        return np.asarray(values.astype(np.float64) / leaf.divisor)
    return np.asarray(values.astype(values.dtype.newbyteorder("="), order="C"))
