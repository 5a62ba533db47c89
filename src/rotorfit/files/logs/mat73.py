"""MAT files of version 7.3, which are HDF5; needs h5py.

HDF5 stores MATLAB's column-major arrays by rows: they arrive transposed and are transposed back.
"""

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from itertools import count
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column, Table
from rotorfit.files.logs.content import (
    BLOCK_LIMIT,
    LIMIT,
    Content,
    check_size,
    check_width,
    column_from,
    listed,
    one_line,
)

_MAGIC = b"\x89HDF\r\n\x1a\n"

_USER_BLOCK = 512  # where MATLAB writes its own header

_CLASSES = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)} | {"double", "single", "logical", ""}

_DEEPEST = 16

DESCRIPTIONS = 1 << 28
"""Memory that the descriptions of one group may take [bytes]."""


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether HDF5 begins, at the start or after MATLAB's header."""
    return head.startswith((_MAGIC, b"MATLAB 7.3 MAT-file")) or head[_USER_BLOCK:].startswith(_MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - a MAT file is one table
    """Reads the one table, named after the file: numeric arrays; names of structure fields are dotted.

    Raises:
        LogError: h5py is not installed, the HDF5 is damaged, or it contains no numeric array.
    """
    try:
        import h5py
    except ImportError as error:
        raise LogError(f"{path}: MAT 7.3 needs h5py; pip install 'rotorfit[mat73]', or save with -v7") from error
    _check_driver(path)
    columns: dict[str, Column] = {}
    others: list[str] = []
    try:
        with _bounded():
            opened = h5py.File(path, "r")
        with opened as file:
            _gather(file, "", columns, others, 0, count(1))
    except (OSError, RuntimeError, ValueError, KeyError, TypeError, MemoryError) as error:
        raise LogError(f"{path}: damaged HDF5 ({one_line(error)}); copy the file again") from error
    if not columns:
        raise LogError(f"{path}: no array of numbers in the file; save the signals as plain arrays")
    notes = [f"variables left out because they are not arrays of numbers: {listed(others)}"] if others else []
    return Content({path.stem: Table(path.stem, columns)}, {}, tuple(notes))


def _check_driver(path: Path) -> None:
    """Refuses driver information: MATLAB writes none, and HDF5 would load as many bytes of it as the file claims.

    Source: HDF5 file format specification 3.0, II.A, "Superblock", versions 0 and 1; it begins at 0, 512, 1024, 2048...

    Raises:
        LogError: There is driver information.
    """
    with path.open("rb") as file:
        place, end = 0, file.seek(0, os.SEEK_END)
        while place < end:
            file.seek(place)
            block = file.read(96).ljust(96, b"\xff")  # what is cut off is as good as undefined
            if block.startswith(_MAGIC):
                break
            place = max(2 * place, _USER_BLOCK)
        else:
            return
    version, size = block[8], block[13]
    first = 24 + 4 * version + 3 * size  # the fourth of the addresses
    if version < 2 and block[first : first + size].strip(b"\xff"):
        raise LogError(f"{path}: damaged HDF5 (it needs a driver of HDF5, as no MAT file does); copy the file again")


def _gather(
    group: Any, prefix: str, columns: dict[str, Column], others: list[str], depth: int, seen: Iterator[int]
) -> None:
    """Adds the arrays of a group and its structures to the columns; an array may be linked many times."""
    import h5py

    with _bounded():
        members = list(_members(group, seen))
    for label, item, numeric in members:
        name = f"{prefix}{label}"
        if isinstance(item, h5py.Group) and depth < _DEEPEST:
            _gather(item, f"{name}.", columns, others, depth + 1, seen)
        elif numeric:
            columns[name] = _array(item)
            check_size(Path(item.file.filename), columns.values())
        else:
            others.append(name)


def _members(group: Any, seen: Iterator[int]) -> Iterator[tuple[str, Any, bool]]:
    """Name, item and whether it is a numeric array of each member; no item for a link.

    Links to other files or places are not followed: a log must not read files beside it.
    """
    import h5py

    for label in group:
        check_width(Path(group.file.filename), next(seen))
        if not label.startswith("#"):  # MATLAB's own store of cells and objects
            plain = isinstance(group.get(label, getlink=True), h5py.HardLink)
            item = group[label] if plain else None
            yield label, item, isinstance(item, h5py.Dataset) and _is_numeric(item)


@contextmanager
def _bounded() -> Iterator[None]:
    """Bounds what HDF5 may allocate for descriptions: it takes what a damaged file claims, of one of 24 kB all memory.

    On Linux only, where the size of the process is known. The bound is the process's, for the milliseconds of a group.
    """
    sizes = Path("/proc/self/statm")
    if not sizes.exists():
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    most = int(sizes.read_text().split()[0]) * resource.getpagesize() + DESCRIPTIONS
    if before[0] != resource.RLIM_INFINITY:
        most = min(most, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _is_numeric(item: Any) -> bool:
    """Whether a dataset is a numeric array stored in this file and within the limits."""
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    inside = not item.external and not item.is_virtual
    small = item.dtype.kind in "biuf" and item.size is not None and item.size * item.dtype.itemsize <= LIMIT
    small = small and prod(item.chunks or (0,)) * item.dtype.itemsize <= BLOCK_LIMIT  # one is unpacked as a whole
    return kind in _CLASSES and inside and small and sum(length != 1 for length in item.shape) <= 2


def _array(item: Any) -> Column:
    """Values as in MATLAB; an empty array stores its sizes in place of values."""
    if item.attrs.get("MATLAB_empty", 0):
        return np.zeros(0, item.dtype)
    return column_from(np.asarray(item[()]).T)
