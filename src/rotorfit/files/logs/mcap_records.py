"""Single records of MCAP: their heads, the numbers and texts in them, and whether bytes can be a record.

Source: https://mcap.dev/spec
"""

import re
import struct
from collections.abc import Collection, Iterator

from rotorfit.files.logs.content import BLOCK_LIMIT, DamageError
from rotorfit.files.logs.damage import Block, matches, resumed

MAGIC = b"\x89MCAP0\r\n"

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07

METADATA, DATA_END = 0x0C, 0x0F

PREFIX, MESSAGE_HEAD, CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQI")

FOOTER_SIZE = 20

_ANY = re.compile(rb"[\x03-\x07\x0f](?=[\s\S]{4}\0{4})")

_NO_MESSAGES = re.compile(rb"[\x06\x07\x0f](?=[\s\S]{4}\0{4})")

_METHODS = ("", "none", "lz4", "zstd", "bz2")

_DAY = 86_400_000_000_000


def next_record(
    data: Block, start: int, channels: Collection[int], until: int | None, in_chunk: bool = True
) -> int | None:
    """Finds where records resume after damage; None where they do not.

    Args:
        data: A chunk, or the file.
        start: Offset at which the search begins.
        channels: Channel numbers that a message may have.
        until: When the last message was recorded [ns]; plausible ones are within a day of it.
        in_chunk: False to skip records inside chunks.
    """
    places = matches(_ANY if in_chunk else _NO_MESSAGES, data, start)
    return resumed(data, places, lambda block, place: _after(block, place, channels, until))


def _after(data: Block, place: int, channels: Collection[int], until: int | None) -> int | None:
    """End of the record at an offset; None if there can be none."""
    start = place + PREFIX.size
    if start > len(data):
        return None
    kind, length = PREFIX.unpack_from(data, place)
    if length > min(BLOCK_LIMIT, len(data) - start):
        return None
    end = start + length
    if kind == FOOTER:  # only the magic follows it
        return len(data) if length == FOOTER_SIZE and data[end:] == MAGIC else None
    return end if _plausible(kind, data[start : min(end, start + 64)], length, channels, until) else None


def _plausible(kind: int, head: bytes, length: int, channels: Collection[int], until: int | None) -> bool:
    """Whether a record can begin with these bytes, at most its first 64."""
    if kind == MESSAGE:
        if length < MESSAGE_HEAD.size:
            return False
        number, _, time, _ = MESSAGE_HEAD.unpack_from(head)
        return number in channels and (until is None or abs(time - until) < _DAY)
    if kind == CHUNK:
        try:
            method, start = text_at(head, CHUNK_HEAD.size)
        except DamageError:
            return False
        return method in _METHODS and int.from_bytes(head[start : start + 8], "little") == length - start - 8
    if kind == INDEX:
        return length >= 6 and int.from_bytes(head[2:6], "little") == length - 6
    if kind in (SCHEMA, CHANNEL):
        name = 2 if kind == SCHEMA else 4
        return length > name + 8 and int.from_bytes(head[name : name + 4], "little") <= length - name - 8
    return length == 4 if kind == DATA_END else FOOTER < kind < DATA_END


def summary_channels(data: Block) -> Iterator[tuple[int, bytes]]:
    """The schemas and channels repeated in the summary at the end of a file: kind and data."""
    footer = len(data) - len(MAGIC) - FOOTER_SIZE - PREFIX.size
    if data[-len(MAGIC) :] != MAGIC or data[footer : footer + PREFIX.size] != PREFIX.pack(FOOTER, FOOTER_SIZE):
        return
    place = int.from_bytes(data[footer + PREFIX.size : footer + PREFIX.size + 8], "little")
    while max(0, footer - BLOCK_LIMIT) < place < footer:
        kind, length = PREFIX.unpack_from(data, place)
        if kind == 0:
            return
        place += PREFIX.size
        if kind in (SCHEMA, CHANNEL) and length <= footer - place:
            yield kind, data[place : place + length]
        place += length


def small_at(data: bytes, start: int) -> tuple[int, int]:
    """A two-byte number, and its end."""
    if start + 2 > len(data):
        raise DamageError("a record is cut short")
    return int.from_bytes(data[start : start + 2], "little"), start + 2


def bytes_at(data: bytes, start: int) -> tuple[bytes, int]:
    """Bytes with a length prefix, and their end."""
    end = start + 4 + int.from_bytes(data[start : start + 4], "little")
    if start + 4 > len(data) or end > len(data):
        raise DamageError("a record is cut short")
    return data[start + 4 : end], end


def text_at(data: bytes, start: int) -> tuple[str, int]:
    """Text with a length prefix, and its end."""
    value, end = bytes_at(data, start)
    return value.decode(errors="replace"), end
