"""MAT files of version 5 (MATLAB 5 to 7.2, Octave, scipy), read one variable at a time.

A variable that is not a numeric array (MATLAB objects, cells, text), is damaged or cut off is left out; the others are
read. scipy's reader is not used because it crashes the whole process (segmentation fault, scipy 1.17) on files with a
few wrong bytes; a test compares this reader with scipy's on whole files.

Source: MAT-File Format (MathWorks), Level 5.
"""

import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Literal

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column, Table
from rotorfit.files.logs.content import (
    LIMIT,
    Content,
    DamageError,
    check_width,
    column_from,
    listed,
    one_line,
    too_wide,
)

_Order = Literal["little", "big"]

_HEADER = 128

_BYTE_ORDERS: dict[bytes, _Order] = {b"IM": "little", b"MI": "big"}

_MATRIX, _COMPRESSED = 14, 15

_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type of an element to the numpy format of its numbers."""

_CLASSES = dict(zip(range(6, 16), ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), strict=True))
"""Class of a matrix to its numpy format in MATLAB; a double may be stored as a byte where that is exact."""

_STRUCT, _OPAQUE = 2, 17  # the second is undocumented: an object, which has a name but no sizes

_LOGICAL, _COMPLEX = 0x0200, 0x0800

_DEEPEST = 16

_PIECE = 1 << 20  # bytes that are inflated at once


@dataclass(frozen=True)
class _Matrix:
    """A variable or a field: class, flags and sizes, then elements that depend on the class."""

    kind: int
    flags: int
    sizes: tuple[int, ...]
    name: str
    elements: Iterator[tuple[int, memoryview]]


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the header states version 5 and a byte order."""
    order = _BYTE_ORDERS.get(head[126:128])
    return order is not None and int.from_bytes(head[124:126], order) == 0x0100


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - a MAT file is one table
    """Reads the one table, named after the file: numeric arrays; names of structure fields are dotted.

    Raises:
        LogError: The file contains no numeric array.
    """
    columns: dict[str, Column] = {}
    others: list[str] = []
    notes: list[str] = []
    damage: list[str] = []
    count = 0
    with path.open("rb") as file:
        order = _BYTE_ORDERS[file.read(_HEADER)[126:128]]
        left = path.stat().st_size - _HEADER
        while left > 0:
            check_width(path, count := count + 1)
            tag = file.read(8)
            kind, length = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            left -= 8 + length
            if left < 0:
                damage.append("the file is cut short inside its last variable, which is left out")
                break
            try:
                _take(kind, file.read(length), order, columns, others, notes)
            except DamageError as error:
                damage.append(f"a variable left out because it is damaged or too large: {error}")
    if others:
        notes.append(f"variables left out because they are not arrays of numbers: {listed(others)}")
    if not columns:
        why = f" ({[*damage, *notes][0]})" if damage or notes else ""
        raise LogError(f"{path}: no array of numbers in the file{why}; save the signals as plain arrays")
    return Content({path.stem: Table(path.stem, columns)}, {}, tuple(notes), damage=tuple(damage))


def _take(
    kind: int, content: bytes, order: _Order, columns: dict[str, Column], others: list[str], notes: list[str]
) -> None:
    """Adds one variable of the file to the columns.

    Raises:
        DamageError: It is damaged or too large.
    """
    room = LIMIT - _size(columns)
    if kind == _COMPRESSED:
        kind, inner = next(_elements(memoryview(_inflated(content, order, room)), order), (0, memoryview(b"")))
    else:
        inner = memoryview(content)
    if kind != _MATRIX:
        raise DamageError(f"it is of kind {kind}")
    matrix = _matrix(inner, order)
    if not matrix.name:  # MATLAB's own store behind objects
        return
    found: dict[str, Column] = {}
    _gather(matrix, matrix.name, order, found, others, room, 0)
    notes += [f"{name} is there more than once; the last one is used" for name in found if name in columns]
    columns |= found


def _size(columns: dict[str, Column]) -> int:
    return sum(values.nbytes for values in columns.values())


def _inflated(content: bytes, order: _Order, room: int) -> bytearray:
    """Inflates a compressed variable; the length in its head is checked before anything is inflated."""
    inflater = zlib.decompressobj()
    plain, filled = bytearray(8), 0
    try:
        for start in range(0, len(content), _PIECE):
            rest = content[start : start + _PIECE]
            while rest:
                part = inflater.decompress(rest, _PIECE if filled else 8)
                rest = inflater.unconsumed_tail
                end = min(filled + len(part), len(plain))
                plain[filled:end] = part[: end - filled]
                if filled == 0 and end == 8:
                    size = 8 + int.from_bytes(plain[4:], order)
                    if size > room:
                        raise DamageError(f"with it the file unpacks to more than {LIMIT >> 20} MiB")
                    plain = bytearray(size)  # untouched pages take no memory
                    plain[:8] = part
                filled = end
                if not part:
                    break
    except zlib.error as error:
        raise DamageError(f"it does not unpack ({one_line(error)})") from error
    if not inflater.eof:
        raise DamageError("it ends before its checksum")
    return plain


def _elements(content: memoryview, order: _Order) -> Iterator[tuple[int, memoryview]]:
    """Type and content of the elements; those of at most four bytes share eight with their tag."""
    position = 0
    while position + 8 <= len(content):
        word = int.from_bytes(content[position : position + 4], order)
        kind, size, start = word & 0xFFFF, word >> 16, position + 4
        if not size:
            kind, size, start = word, int.from_bytes(content[position + 4 : position + 8], order), position + 8
        if size > len(content) - start:
            raise DamageError("it is shorter than it says")
        yield kind, content[start : start + size]
        position = start + size + -(start + size) % 8


def _matrix(content: memoryview, order: _Order) -> _Matrix:
    """The head of a matrix."""
    elements = _elements(content, order)
    try:
        _, flags = next(elements)
        word = int.from_bytes(flags[:4], order)
        kind = word & 0xFF
        sizes: tuple[int, ...] = ()
        if kind != _OPAQUE:
            _, dimensions = next(elements)
            sizes = tuple(int(size) for size in _numbers(5, dimensions, order))
        _, name = next(elements)
    except StopIteration:
        raise DamageError("its head is cut short") from None
    return _Matrix(kind, word, sizes, bytes(name).decode("utf-8", errors="replace"), elements)


def _gather(
    matrix: _Matrix, name: str, order: _Order, columns: dict[str, Column], others: list[str], room: int, depth: int
) -> None:
    """Adds an array, or the arrays in a structure, to the columns."""
    if matrix.kind == _STRUCT and prod(matrix.sizes) == 1 and depth < _DEEPEST:
        for label, content in _fields(matrix, order):
            if len(content):  # MATLAB writes an empty field without a head
                _gather(_matrix(content, order), f"{name}.{label}", order, columns, others, room, depth + 1)
    elif told := too_wide(len(columns) + 1):
        raise DamageError(told)
    elif matrix.kind in _CLASSES and not matrix.flags & _COMPLEX and sum(size != 1 for size in matrix.sizes) <= 2:
        columns[name] = _array(matrix, order, room - _size(columns))
    else:
        others.append(name)


def _fields(matrix: _Matrix, order: _Order) -> Iterator[tuple[str, memoryview]]:
    """Names and contents of the fields of a structure."""
    _, length = next(matrix.elements, (0, memoryview(b"")))
    _, text = next(matrix.elements, (0, memoryview(b"")))
    width = int.from_bytes(length, order)
    if not width or len(text) % width:
        raise DamageError("its fields have no names")
    for start in range(0, len(text), width):
        kind, content = next(matrix.elements, (0, memoryview(b"")))
        if kind != _MATRIX:
            raise DamageError("a field is missing")
        yield bytes(text[start : start + width]).partition(b"\0")[0].decode("utf-8", errors="replace"), content


def _array(matrix: _Matrix, order: _Order, room: int) -> Column:
    """Numbers of a matrix, in MATLAB's type and column-major order."""
    kind, content = next(matrix.elements, (0, memoryview(b"")))
    number = bool if matrix.flags & _LOGICAL else _CLASSES[matrix.kind]
    if prod(matrix.sizes) * np.dtype(number).itemsize > room:
        raise DamageError(f"with it there are more than {LIMIT >> 20} MiB of numbers")
    stored = _numbers(kind, content, order) if prod(matrix.sizes) else np.zeros(0)
    if len(stored) != prod(matrix.sizes) or any(size < 0 for size in matrix.sizes):
        raise DamageError(f"{len(stored)} numbers for sizes {matrix.sizes}")
    values = stored.reshape(matrix.sizes, order="F")
    with np.errstate(invalid="ignore"):  # damaged numbers may be out of range
        return column_from(values.astype(number, copy=False))


def _numbers(kind: int, content: memoryview, order: _Order) -> Column:
    """Numbers in their stored format."""
    if kind not in _STORED:
        raise DamageError(f"numbers of unknown kind {kind}")
    stored = np.dtype(_STORED[kind]).newbyteorder("<" if order == "little" else ">")
    if len(content) % stored.itemsize:
        raise DamageError("it ends inside a number")
    return np.frombuffer(content, stored)
