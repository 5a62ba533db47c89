"""MAT files of version 5 (MATLAB 5 to 7.2, Octave, scipy), one variable at a time.

What cannot be read (MATLAB objects, function handles) or is cut off costs that variable only.

Source: MAT-File Format (MathWorks, R2023b), Level 5.
"""

import warnings
import zlib
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.errors import LogError
from rotorfit.log import Column, Table
from rotorfit.sources.content import LIMIT, Content, DamageError, column_from, listed, one_line

_HEADER = 128
_BYTE_ORDERS = {b"IM": "little", b"MI": "big"}
_MATRIX, _COMPRESSED = 14, 15
_DEEPEST = 16


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the header says version 5 and a byte order."""
    order = _BYTE_ORDERS.get(head[126:128])
    return order is not None and int.from_bytes(head[124:126], order) == 0x0100  # type: ignore[arg-type]


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - a MAT file is one table
    """Reads the one table, named after the file: arrays of numbers; fields of structures are dotted.

    Raises:
        LogError: No array of numbers in it.
    """
    columns: dict[str, Column] = {}
    notes: list[str] = []
    others: list[str] = []
    try:
        for element in _elements(path):
            for name, value in _variables(element, notes):
                if name in columns:
                    notes.append(f"{name} is there more than once; the last one is used")
                _gather(name, value, columns, others, 0)
    except DamageError as error:
        notes.append(f"the file is damaged ({error}); read up to there")
    if others:
        notes.append(f"variables left out because they are not arrays of numbers: {listed(others)}")
    if not columns:
        why = f" ({notes[0]})" if notes else ""
        raise LogError(f"{path}: no array of numbers in the file{why}; save the signals as plain arrays")
    return Content({path.stem: Table(path.stem, columns)}, {}, tuple(notes))


def _elements(path: Path) -> Iterator[bytes]:
    """Each variable as the bytes of a small MAT file of its own, unpacked."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_HEADER)
        order: Any = _BYTE_ORDERS[header[126:128]]
        left = size - _HEADER
        while left > 0:
            tag = file.read(8)
            kind, length = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            left -= 8
            if left < 0 or length > left:
                raise DamageError(f"cut short inside the variable at byte {size - left}")
            content = file.read(length)
            left -= length
            if kind == _COMPRESSED:
                yield header + _inflated(content)
            elif kind == _MATRIX:
                yield header + tag + content
            else:
                raise DamageError(f"an element of unknown kind {kind} before byte {size - left}")


def _inflated(content: bytes) -> bytes:
    """A compressed variable unpacked."""
    inflater = zlib.decompressobj()
    try:
        plain = inflater.decompress(content, LIMIT)
    except zlib.error as error:
        raise DamageError(f"a variable does not unpack: {one_line(error)}") from error
    if inflater.unconsumed_tail:
        raise DamageError(f"a variable unpacks to more than {LIMIT >> 20} MiB")
    return plain


def _variables(element: bytes, notes: list[str]) -> list[tuple[str, Any]]:
    """Name and value of a variable; nothing, and a note, where scipy cannot read it."""
    import scipy.io

    faults = (ValueError, TypeError, KeyError, IndexError, OSError, EOFError, NotImplementedError, MemoryError)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about what it leaves out; we look at what it returns
            found = scipy.io.loadmat(BytesIO(element), mat_dtype=True)
    except faults as error:
        notes.append(f"a variable left out because it cannot be read ({one_line(error)})")
        return []
    return [(_name(name, value), value) for name, value in found.items() if not name.startswith("__")]


def _name(name: str, value: Any) -> str:
    """Name of a variable; of an object scipy gives it in the value."""
    fields = getattr(value, "dtype", np.dtype(float)).names or ()
    if name == "None" and "s0" in fields and value.size:
        inner = value.reshape(-1)[0]["s0"]
        return inner.decode("latin-1") if isinstance(inner, bytes) else str(inner)
    return name


def _gather(name: str, value: Any, columns: dict[str, Column], others: list[str], depth: int) -> None:
    """Puts an array, or the arrays in a structure, into the columns."""
    if not isinstance(value, np.ndarray) or depth > _DEEPEST:
        others.append(name)
    elif value.dtype.names is not None and value.size == 1 and type(value) is np.ndarray:
        for label in value.dtype.names:
            _gather(f"{name}.{label}", value.reshape(-1)[0][label], columns, others, depth + 1)
    elif value.dtype.kind in "biuf" and np.squeeze(value).ndim <= 2:
        columns[name] = column_from(value)
    else:
        others.append(name)
