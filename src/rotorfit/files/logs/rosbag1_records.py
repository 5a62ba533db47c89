"""Headers of the records of a ROS 1 bag: their fields, and whether bytes can be such a record.

Source: http://wiki.ros.org/Bags/Format/2.0
"""

import re
import struct
from collections.abc import Collection, Iterator

import numpy as np

from rotorfit.files.logs.content import BLOCK_LIMIT, DamageError
from rotorfit.files.logs.damage import Block, matches, resumed

MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = (bytes([kind]) for kind in range(2, 8))

U32, U64, TIME = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")

INDEX_ENTRY = np.dtype([("time", "<u8"), ("place", "<u4")])  # the offset in the decompressed chunk

LONGEST_HEADER = 1 << 20

_ANY, _NO_MESSAGES = re.compile(rb"\x04\0\0\0op=[\x02-\x07]"), re.compile(rb"\x04\0\0\0op=[\x04-\x06]")

_BEFORE, _LONGEST_BEHIND = 64, 1 << 12  # most bytes of a header before its field `op`; of a header after damage

_NEEDED = {
    MESSAGE: {b"conn": U32.size, b"time": TIME.size},
    BAG_HEADER: {b"index_pos": U64.size},
    INDEX: {b"conn": U32.size, b"count": U32.size},
    CHUNK: {b"size": U32.size},
    CHUNK_INFO: {b"chunk_pos": U64.size, b"count": U32.size},
    CONNECTION: {b"conn": U32.size},
}

Header = dict[bytes, bytes]


def next_record(data: Block, start: int, connections: Collection[int], in_chunk: bool = True) -> int | None:
    """Finds where records resume after damage; None where they do not.

    Args:
        data: A chunk, or the file.
        start: Offset at which the search begins.
        connections: Connection numbers that a message may have.
        in_chunk: False to skip records inside chunks.
    """
    places = _places(data, start, _ANY if in_chunk else _NO_MESSAGES)
    return resumed(data, places, lambda block, place: _after(block, place, connections))


def _places(data: Block, start: int, pattern: re.Pattern[bytes]) -> Iterator[int]:
    """Offsets at which a header with the field `op` may begin."""
    for found in matches(pattern, data, start):
        for place in range(max(start, found - 4 - _BEFORE), found - 3):
            if found + 8 - place - 4 <= int.from_bytes(data[place : place + 4], "little") <= _LONGEST_BEHIND:
                yield place


def _after(data: Block, place: int, connections: Collection[int]) -> int | None:
    """End of the record at an offset; None if there can be none."""
    start = place + 4
    body = start + int.from_bytes(data[place:start], "little") + 4
    if not start < body - 4 <= start + _LONGEST_BEHIND or body > len(data):
        return None
    try:
        header = fields_of(data[start : body - 4])
    except DamageError:
        return None
    length = int.from_bytes(data[body - 4 : body], "little")
    needed = _NEEDED.get(header.get(b"op", b""))
    if needed is None or length > min(BLOCK_LIMIT, len(data) - body):
        return None
    if any(len(header.get(name, b"")) != size for name, size in needed.items()):
        return None
    if header[b"op"] == MESSAGE and U32.unpack(header[b"conn"])[0] not in connections:
        return None
    return body + length


def fields_of(header: bytes) -> Header:
    """Fields of a header: name to value."""
    return {name: header[start:end] for name, (start, end) in spans_of(header).items()}


def spans_of(header: bytes) -> dict[bytes, tuple[int, int]]:
    """Start and end of each value in a header; its fields are `name=value`, each with a length prefix."""
    spans: dict[bytes, tuple[int, int]] = {}
    position, size = 0, len(header)
    while position < size:
        end = position + 4 + int.from_bytes(header[position : position + 4], "little")
        sign = header.find(b"=", position + 4, end)
        if end > size or sign < 0:
            raise DamageError("a record's header cannot be understood")
        spans[header[position + 4 : sign]] = sign + 1, end
        position = end
    return spans


def number_of(header: Header, name: bytes, form: struct.Struct) -> int:
    """A number in a header."""
    value = header.get(name, b"")
    if len(value) != form.size:
        raise DamageError(f"a record without {name.decode()}")
    return int(form.unpack(value)[0])
