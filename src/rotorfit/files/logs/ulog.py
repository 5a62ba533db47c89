"""PX4 logs (ULog): each topic of the autopilot is a table; instance 1 of a topic is the table `topic_1`.

The file is a chain of records. Where it is broken (a full card, an empty battery, a bad sector), it resumes at the
next plausible record. pyulog is not used because its version 1.3 resumes only at the next synchronisation mark, up to
half a second later, and fails with a KeyError on some damaged definitions; a test compares this reader with pyulog on
whole files.

Source: https://docs.px4.io/main/en/dev_log/ulog_file_format
"""

import re
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from rotorfit.core.errors import LogError
from rotorfit.core.log import Table
from rotorfit.files.logs.autopilot_records import BOOL, Damage, Leaf, RecordLayout, Rows, walk
from rotorfit.files.logs.content import LIMIT, WIDEST, Content, DamageError, listed, one_line, size_of

_MAGIC = b"ULog\x01\x12\x35"

_HEADER = 16

_HEAD = struct.Struct("<HBH")  # size and kind of a record, then the topic number in a data record

_FLAGS = struct.Struct("<8s8s3Q")

_SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"

_DATA, _SUBSCRIPTION = ord("D"), ord("A")

_KINDS = re.compile(rb"[ABCDFILMOPQRS]")

_NUMBERS = {f"{sign}int{8 * size}_t": f"<{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)} | {
    "float": "<f4",
    "double": "<f8",
    "bool": BOOL,
}

_FIELD = re.compile(r"(?P<type>[\w/-]+)(\[(?P<count>\d{1,5})\])? +(?P<name>\w+)")

_DEFINITION, _KEY = re.compile(rb"[\w/-]+:"), re.compile(rb"[\w\[\]]+ [ -~]+")

_LONGEST_TEXT = 1 << 13

_WIDEST_RECORD, _DEEPEST, _MOST_COLUMNS, _MOST_OF_ALL = 1 << 16, 16, 1 << 12, 1 << 16


@dataclass
class _Topic:
    """An instance of a topic, collected for a table; `layout` is None where it is not decoded, `reason` says why."""

    layout: RecordLayout | None
    reason: str
    count: int = 0
    rows: Rows = field(default_factory=Rows)


@dataclass
class _Log:
    """What was found in a file so far.

    wanted: Names of the tables to decode; None for all.
    formats: Name of a type to its fields, as text.
    topics: Name of a table to its topic.
    numbers: Topic number in data records to topic, and the least and largest size of such a record [byte].
    instances: Type and instance to name of the table.
    layouts: Type to its columns, its size, and its size without trailing padding [byte].
    columns: Number of columns in all definitions.
    omitted: Columns left out.
    dropouts: Durations in which the logger could not write [ms].
    damage: Breaks in the chain.
    """

    wanted: Collection[str] | None
    formats: dict[str, str] = field(default_factory=dict)
    topics: dict[str, _Topic] = field(default_factory=dict)
    numbers: dict[int, tuple[_Topic, int, int]] = field(default_factory=dict)
    instances: dict[tuple[str, int], str] = field(default_factory=dict)
    layouts: dict[str, tuple[tuple[Leaf, ...], int, int]] = field(default_factory=dict)
    columns: int = 0
    omitted: list[str] = field(default_factory=list)
    dropouts: list[int] = field(default_factory=list)
    damage: Damage = field(default_factory=Damage)


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins with ULog's magic."""
    return head.startswith(_MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested topics; see `files.logs.read`.

    Raises:
        LogError: Unsupported features of a later version, no message before the damage, or too many numbers.
    """
    size = size_of(path)
    log = _Log(tables)
    with path.open("rb") as file:
        bounds = _bounds(path, file.read(_HEADER + 3 + _FLAGS.size)[_HEADER:], size)
        for start, end in pairwise(bounds):

            def step(data: bytes, offset: int, last: bool) -> int:
                stopped = _step(log, data, offset, last)
                if sum(topic.rows.nbytes for topic in log.topics.values()) > LIMIT:
                    raise LogError(f"{path}: more than {LIMIT >> 20} MiB of numbers; read only the topics needed")
                return stopped

            left = walk(file, start, end, step)
    log.damage.left = left
    return _content(path, log, size)


def _bounds(path: Path, first: bytes, size: int) -> list[int]:
    """Boundaries of the parts of the file: data recovered from a crash are appended after an incomplete record."""
    if len(first) < 3 + _FLAGS.size or first[2:3] != b"B":
        return [_HEADER, max(size, _HEADER)]
    _, incompatible, *offsets = _FLAGS.unpack_from(first, 3)
    if incompatible[0] & 0xFE or any(incompatible[1:]):
        raise LogError(f"{path}: written by a later version of ULog, which cannot be read; convert it with pyulog")
    appended = sorted({offset for offset in offsets if _HEADER < offset < size}) if incompatible[0] else []
    return [_HEADER, *appended, size]


def _step(log: _Log, data: bytes, offset: int, last: bool) -> int:
    """Takes the records of a block, and definitions as they occur; returns where the next block must begin.

    A record is accepted only if another record follows: the one before a break may be torn itself.
    """
    places: dict[int, list[int]] = {number: [] for number in log.numbers}
    known: dict[bytes, tuple[list[int], int]] = {}  # data heads in this block: positions, length
    position, end = 0, len(data)
    before, latest = 0, None  # the previous record, and the list that holds it
    while position + _HEAD.size <= end:
        if record := known.get(data[position : position + _HEAD.size]):
            found, length = record
            if position + length > end:
                break
            before, latest = position, found
            found.append(position)
            position += length
            continue
        length, kind, number = _HEAD.unpack_from(data, position)
        after = position + 3 + length
        if not _plausible(log, data, position):
            if latest:
                latest.pop()
            latest, after = None, _next(log, data, position + 1)
            log.damage.found(offset + position, after - position)
        elif kind == _DATA:
            known[data[position : position + _HEAD.size]] = places[number], 3 + length
            continue
        elif after > end:
            break
        else:
            before, latest = position, None
            if kind == _SUBSCRIPTION:  # the number may have belonged to another topic
                number = int.from_bytes(data[position + 4 : position + 6], "little")
                _gather(log, data, {number: places.pop(number, [])})
                places[number] = []
                known.clear()
            _define(log, kind, data[position + 3 : after])
        position = after
    if not last and latest:  # the next block shows whether a record follows
        latest.pop()
        position = before
    _gather(log, data, places)
    return min(position, end)


def _gather(log: _Log, data: bytes, places: Mapping[int, list[int]]) -> None:
    """Assigns records to their topics by number."""
    for number, found in places.items():
        if found:
            topic = log.numbers[number][0]
            topic.count += len(found)
            if topic.layout is not None:
                topic.rows.gather(data, found, topic.layout)


def _next(log: _Log, data: bytes, position: int) -> int:
    """Start of the next plausible record that is followed by another; near the end of the block if there is none."""
    for match in _KINDS.finditer(data, position + 2):
        start = match.start() - 2
        if _plausible(log, data, start):
            after = start + 3 + int.from_bytes(data[start : start + 2], "little")
            if _plausible(log, data, after) or (match[0] == b"D" and after + _HEAD.size > len(data)):
                return start
    return max(position, len(data) - _HEAD.size + 1)


def _plausible(log: _Log, data: bytes, position: int) -> bool:
    """Whether a record can begin here."""
    if position + _HEAD.size > len(data):
        return False
    length, kind, number = map(int, _HEAD.unpack_from(data, position))
    content = data[position + 3 : position + 3 + min(length, 300)]
    match chr(kind):
        case "D":
            return number in log.numbers and log.numbers[number][1] <= length <= log.numbers[number][2]
        case "S":
            return length == len(_SYNC) and content == _SYNC[: len(content)]
        case "O" | "R":
            return length == 2
        case "A":
            return 3 < length < 300 and content[3:].isascii()
        case "F":
            return _DEFINITION.match(content) is not None
        case "I" | "P":
            return length > 3 and _is_key(content[1 : 1 + content[0]], content[0])
        case "M" | "Q":  # what a crash left behind may be long
            return length > 4 and _is_key(content[2 : 2 + content[1]], content[1])
        case "L" | "C":
            return 8 < length < _LONGEST_TEXT and chr(content[0]) in "01234567"
        case "B":
            return _FLAGS.size <= length < 300
    return False


def _is_key(text: bytes, length: int) -> bool:
    """Whether the key of an information record is valid: a type and a name."""
    return len(text) == length and _KEY.fullmatch(text) is not None


def _define(log: _Log, kind: int, content: bytes) -> None:
    """Handles a record other than data."""
    match chr(kind):
        case "F":
            name, _, fields = content.decode("utf-8", errors="replace").partition(":")
            log.formats.setdefault(name, fields)
        case "A":
            instance, number = content[0], int.from_bytes(content[1:3], "little")
            _subscribe(log, number, content[3:].decode("ascii", errors="replace"), instance)
        case "O":
            log.dropouts.append(int.from_bytes(content, "little"))


def _subscribe(log: _Log, number: int, name: str, instance: int) -> None:
    """Registers a topic under the number in its records."""
    table = log.instances.get((name, instance))
    if table is None:
        table = f"{name}_{instance}" if instance else name
        if table in log.topics:  # `a_1` may be instance 1 of `a`, or a topic of this name
            table = f"{name}[{instance}]"
        log.instances[name, instance] = table
    try:
        leaves, size, least = log.layouts[name] = log.layouts.get(name) or _layout(log, name)
    except DamageError as error:
        log.numbers[number] = (log.topics.setdefault(table, _Topic(None, str(error))), 2, _WIDEST_RECORD)
        return
    if table not in log.topics:
        asked = log.wanted is None or table in log.wanted
        reason = "" if asked and leaves else "holds no numbers" if asked else "not asked for"
        log.topics[table] = _Topic(None if reason else RecordLayout(leaves, _HEAD.size, least), reason)
    log.numbers[number] = (log.topics[table], least + 2, size + 2)


def _layout(log: _Log, name: str) -> tuple[tuple[Leaf, ...], int, int]:
    """Columns of a type, its size, and its size without trailing padding, which is not always written [byte].

    Raises:
        DamageError: A definition is missing, invalid or does not fit in a record.
    """
    leaves: list[Leaf] = []
    omitted: list[str] = []
    size, least = _fields(log, name, "", 0, leaves, omitted, 0)
    log.omitted += [f"{name}:{column}" for column in omitted]
    return tuple(leaves), size, least


def _fields(
    log: _Log, kind: str, prefix: str, start: int, leaves: list[Leaf], omitted: list[str], depth: int
) -> tuple[int, int]:
    """Appends the columns of a type that begins at `start`; returns its end, and its end without padding.

    Raises:
        DamageError: As `_layout`.
    """
    if kind not in log.formats:
        raise DamageError(f"the definition of {one_line(kind)} is not in the log")
    if depth > _DEEPEST:
        raise DamageError("its definition nests too deeply")
    place = filled = start
    for text in filter(None, map(str.strip, log.formats[kind].split(";"))):
        found = _FIELD.fullmatch(text)
        if not found:
            raise DamageError(f"its definition cannot be understood ({one_line(text)})")
        name, count = f"{prefix}{found['name']}", int(found["count"] or 1)
        if found["type"] in _NUMBERS or found["type"] == "char":
            format_ = _NUMBERS.get(found["type"], "")
            width = int(format_[2:]) if format_ not in ("", BOOL) else 1
            if not found["name"].startswith("_padding"):
                if format_ and count <= WIDEST:
                    leaves.append(Leaf(name, format_, place, int(found["count"]) if found["count"] else None))
                else:
                    omitted.append(name)
            place += width * count
            log.columns += 1
        else:
            for index in range(count):
                inside = f"{name}[{index}]." if found["count"] else f"{name}."
                begin, (place, _) = place, _fields(log, found["type"], inside, place, leaves, omitted, depth + 1)
                if place == begin:  # an empty type could be repeated without limit
                    raise DamageError(f"its definition holds the empty type {found['type']}")
        if place > _WIDEST_RECORD or len(leaves) + len(omitted) > _MOST_COLUMNS or log.columns > _MOST_OF_ALL:
            raise DamageError("its definition is larger than a record can be, or the log has too many columns")
        if not found["name"].startswith("_padding"):
            filled = place
    return place, filled


def _content(path: Path, log: _Log, size: int) -> Content:
    """Tables of the collected topics."""
    damage, notes = log.damage.texts(size), list[str]()
    if not any(topic.count for topic in log.topics.values()):
        why = f" ({damage[0]})" if damage else f" ({len(log.topics)} topics announced)"
        raise LogError(f"{path}: no message in the log{why}; check that the vehicle was armed while it was recorded")
    if log.dropouts:
        seconds = sum(log.dropouts) / 1000
        notes.append(f"{len(log.dropouts)} dropouts of the logger, {seconds:.3g} s in all: messages are missing there")
    if log.omitted:
        notes.append(f"columns left out because they hold text or more than {WIDEST} numbers: {listed(log.omitted)}")
    tables: dict[str, Table] = {}
    skipped: dict[str, str] = {}
    for name, topic in log.topics.items():
        if topic.count and topic.layout is not None:
            tables[name] = Table(name, topic.rows.columns(topic.layout))
        else:
            skipped[name] = one_line(f"{topic.reason or 'no message'} ({topic.count} messages)")
    return Content(tables, skipped, tuple(notes), damage=damage)
