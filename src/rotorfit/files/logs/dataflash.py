"""ArduPilot logs (DataFlash, .bin): each type of message is a table; instance 1 of `NAME` is `NAME_1`.

The file is a self-describing chain of records: an FMT message defines the layout of another type.
Where the chain is broken (a full card, an empty battery, pages of an earlier flight), it resumes at the next plausible
record. Old logs have messages without a time: their `log_time` is interpolated from their position in the file.

Source: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html, and ArduPilot's
libraries/AP_Logger/LogStructure.h that it refers to.
"""

import math
import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rotorfit.core.card import KINDS
from rotorfit.core.errors import LogError
from rotorfit.core.frames import UNIT_SCALE
from rotorfit.core.log import Column, Table
from rotorfit.files.logs.autopilot_records import Damage, Leaf, RecordLayout, Rows, columns_of, gathered, walk
from rotorfit.files.logs.content import LIMIT, Content, listed, one_line, size_of

_MAGIC = b"\xa3\x95"

_HEAD = struct.Struct("<HB")

_MARK = int.from_bytes(_MAGIC, "little")

_FMT_TYPE, _FMT = 128, struct.Struct("<BB4s16s64s")

_FMTU = struct.Struct("<QB16s16s")

_UNIT, _MULT = struct.Struct("<Qb64s"), struct.Struct("<Qbd")

_SAME = {"degheading": "deg"}
"""ArduPilot's names of units that differ from those in `frames.UNIT_SCALE`."""

_SILENT = b"-?"
"""Multipliers without meaning."""

_FORMATS = {
    "a": ("<i2", 32, 1.0), "b": ("i1", None, 1.0), "B": ("u1", None, 1.0), "h": ("<i2", None, 1.0),
    "H": ("<u2", None, 1.0), "i": ("<i4", None, 1.0), "I": ("<u4", None, 1.0), "f": ("<f4", None, 1.0),
    "g": ("<f2", None, 1.0), "d": ("<f8", None, 1.0), "M": ("u1", None, 1.0), "q": ("<i8", None, 1.0),
    "Q": ("<u8", None, 1.0), "c": ("<i2", None, 100.0), "C": ("<u2", None, 100.0), "e": ("<i4", None, 100.0),
    "E": ("<u4", None, 100.0), "L": ("<i4", None, 1e7),
}  # fmt: skip
"""Character to numpy format, length of an array, and the factor by which the value was multiplied to be an integer."""

_TEXTS = {"n": 4, "N": 16, "Z": 64}

ABOUT = ("FMT", "FMTU", "UNIT", "MULT", "PARM")
"""Messages that describe the log and the settings rather than the flight."""

Anchors = tuple[Column, Column]
"""Positions in a file and the times there [ns]."""

_MOST_INSTANCES = 256

_SPACING = 256
"""Bytes between the anchors that date a position in the file: a few milliseconds of flight."""


@dataclass(frozen=True)
class TimeColumn:
    """A column with the time, the nanoseconds per count, and whether it is satellite time."""

    leaf: Leaf
    nanoseconds: int
    satellites: bool = False


@dataclass
class Message:
    """Messages of one type, collected for a table.

    Attributes:
        name: Name in its definition.
        length: Length of a record including its head [byte].
        layout: Layout of its numbers; None where it is not decoded.
        reason: Why it is not decoded; empty where it is.
        labels: Names of all columns, including texts.
        clock: Column with the time; None where there is none.
        instance: Column that distinguishes sensors or cores of the same kind; empty where there is none.
        marks: Units and multipliers, one character for each column; empty where the log does not give them.
        count: Number of records.
        rows: The records.
        places: Positions of the records, kept for messages without a clock.
    """

    name: str
    length: int
    layout: RecordLayout | None
    reason: str
    labels: list[str]
    clock: TimeColumn | None
    instance: str = ""
    marks: tuple[bytes, bytes] = (b"", b"")
    count: int = 0
    rows: Rows = field(default_factory=Rows)
    places: list[Column] = field(default_factory=list)


@dataclass
class Units:
    """Meaning of the columns' marks: names of units, and multipliers."""

    names: dict[int, str] = field(default_factory=dict)
    multipliers: dict[int, float] = field(default_factory=dict)


@dataclass
class _Log:
    """What was found in a file so far.

    Attributes:
        wanted: Names of the tables to decode; None for all.
        messages: Message by the number of its type.
        lengths: Length of the records of each type [byte]; 0 where it is not defined.
        anchors: Positions of messages with a clock and its time [ns]: the autopilot's, and the satellites'.
        redefined: Names of types with a second, different definition, which was ignored.
        units: Meaning of the columns' marks.
        damage: Breaks in the chain.
    """

    wanted: Collection[str] | None
    messages: dict[int, Message] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=lambda: [0] * 256)
    anchors: tuple[list[Anchors], list[Anchors]] = field(default_factory=lambda: ([], []))
    redefined: set[str] = field(default_factory=set)
    units: Units = field(default_factory=Units)
    damage: Damage = field(default_factory=Damage)


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins with the definition of a message, as all logs do."""
    return head.startswith(_MAGIC + bytes([_FMT_TYPE]))


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested messages; see `files.logs.read`.

    Raises:
        LogError: No message besides definitions, or too many numbers.
    """
    size = size_of(path)
    log = _Log(tables)
    log.lengths[_FMT_TYPE] = _HEAD.size + _FMT.size

    def step(data: bytes, offset: int, last: bool) -> int:
        stopped = _step(log, data, offset, last)
        if sum(message.rows.nbytes for message in log.messages.values()) > LIMIT:
            raise LogError(f"{path}: more than {LIMIT >> 20} MiB of numbers; read only the messages that you need")
        return stopped

    with path.open("rb") as file:
        log.damage.left = walk(file, 0, size, step)
    return _content(path, log, size)


def _step(log: _Log, data: bytes, offset: int, last: bool) -> int:
    """Takes the records of a block, and definitions as they occur; returns where the next block must begin.

    A record is accepted only if another record follows: the one before a break may be torn itself.
    """
    places: list[list[int]] = [[] for _ in range(256)]
    known: dict[bytes, tuple[list[int], int]] = {}  # heads seen in this block: their list of positions, their length
    position, end, lengths = 0, len(data), log.lengths
    latest: list[int] = []  # list that holds the previous record; empty where there is none
    while position + _HEAD.size <= end:
        if record := known.get(data[position : position + _HEAD.size]):
            found, length = record
            if position + length > end:
                break
            latest = found
            found.append(position)
            position += length
            continue
        mark, kind = _HEAD.unpack_from(data, position)
        after = position + lengths[kind]
        if mark != _MARK or not lengths[kind]:
            if latest:
                latest.pop()
            latest, after = [], _next(lengths, data, position + 1)
            log.damage.found(offset + position, after - position)
        elif kind != _FMT_TYPE:
            known[data[position : position + _HEAD.size]] = places[kind], lengths[kind]
            continue
        elif after > end:
            break
        else:
            latest = places[kind]
            latest.append(position)
            _define(log, data[position + _HEAD.size : after])
        position = after
    if not last and latest:  # the next block shows whether a record follows
        position = latest.pop()
    _gather(log, data, offset, places)
    return min(position, end)


def _next(lengths: list[int], data: bytes, position: int) -> int:
    """Start of the next plausible record; near the end of the block if there is none."""
    while (position := data.find(_MAGIC, position)) >= 0 and position + 2 < len(data):
        if lengths[data[position + 2]]:
            return position
        position += 1
    return max(0, len(data) - _HEAD.size + 1)


def _define(log: _Log, content: bytes) -> None:
    """Takes the definition of a type. The first one counts: no autopilot changes it within a log."""
    kind, length, *texts = _FMT.unpack(content)
    name, format_, labels = (text.partition(b"\0")[0].decode("ascii", errors="replace") for text in texts)
    names = [label.strip() for label in labels.split(",")]
    if kind == _FMT_TYPE or length < _HEAD.size:
        return
    message = message_of(log.wanted, name, length, format_, names)
    known = log.messages.setdefault(kind, message)
    log.lengths[kind] = known.length
    if (known.name, known.length) != (name, length):
        log.redefined.add(known.name)


def message_of(wanted: Collection[str] | None, name: str, length: int, format_: str, labels: list[str]) -> Message:
    """A message type from its definition: format characters and as many names."""
    leaves: dict[str, Leaf] = {}
    place = 0
    for character, label in zip(format_, labels, strict=False):
        if character in _FORMATS:
            number, count, divisor = _FORMATS[character]
            leaves.setdefault(label, Leaf(label, number, place, count, divisor))
            place += int(number[-1]) * (count or 1)
        else:
            place += _TEXTS.get(character, length)  # an unknown length: place it beyond the record
    fits = place + _HEAD.size <= length and len(format_) == len(labels) * bool(format_)
    asked = wanted is None or any(name in (table, table.rpartition("_")[0]) for table in wanted)
    reason = ""
    if name in ABOUT:
        reason = "describes the log"
    elif not asked:
        reason = "not asked for"
    elif not fits:
        reason = "its definition cannot be understood"
    elif not leaves:
        reason = "holds no numbers"
    layout = None if reason else RecordLayout(tuple(leaves.values()), _HEAD.size, place)
    return Message(name, length, layout, reason, labels, _clock(name, leaves) if fits else None)


def _clock(name: str, leaves: dict[str, Leaf]) -> TimeColumn | None:
    """The column with the time. TimeMS and Time of GPS are satellite time; T beside them is the autopilot's."""
    of_gps = name.startswith("GPS")
    names = {"TimeUS": 1000, "T": 10**6} if of_gps else {"TimeUS": 1000, "TimeMS": 10**6}
    for label, factor in {**names, **({"TimeMS": 10**6, "Time": 10**6} if of_gps else {})}.items():
        if label in leaves and leaves[label].format[-2] in "iu" and leaves[label].count is None:
            return TimeColumn(leaves[label], factor, label not in names)
    return None


def without_time(message: Message) -> bool:
    """Whether no column of a message holds the autopilot's time."""
    return message.clock is None or message.clock.satellites


def _gather(log: _Log, data: bytes, offset: int, places: list[list[int]]) -> None:
    """Assigns the records of a block to their types, and keeps the anchors that date positions in the file."""
    untimed = any(message.layout is not None and without_time(message) for message in log.messages.values())
    found_anchors: tuple[list[Anchors], list[Anchors]] = ([], [])
    for kind, found in enumerate(places):
        if not found or kind not in log.messages:
            continue
        message = log.messages[kind]
        message.count += len(found)
        if message.layout is not None:
            message.rows.gather(data, found, message.layout)
            if without_time(message):
                message.places.append(np.array(found) + offset)
        if message.name == "FMTU" and message.length == _HEAD.size + _FMTU.size:
            _units(log, data, found)
        _take_units(log.units, message, data, found)
        if untimed and message.clock is not None:
            found_anchors[message.clock.satellites].append(_anchors(data, found, message.clock))
    for anchors, parts in zip(log.anchors, found_anchors, strict=True):
        if parts:
            starts, times = (np.concatenate(part) for part in zip(*parts, strict=True))
            order = np.argsort(starts)
            order = order[np.unique(starts[order] // _SPACING, return_index=True)[1]]
            anchors.append((starts[order] + offset, times[order]))


def _anchors(data: bytes, found: list[int], clock: TimeColumn) -> Anchors:
    """Positions of messages with a clock, and its time [ns]."""
    starts = np.array(found)
    layout = RecordLayout((clock.leaf,), _HEAD.size, clock.leaf.offset + int(clock.leaf.format[-1]))
    values = columns_of(gathered(data, starts, layout), layout)[clock.leaf.name]
    sane = (values >= 0) & (values < (1 << 62) // clock.nanoseconds)
    return starts[sane], values[sane].astype(np.int64) * clock.nanoseconds


def _timeline(log: _Log) -> Anchors | None:
    """Anchors of the whole file: from the autopilot's clock or, where none is logged, the satellites'; else None."""
    for anchors in log.anchors:
        if anchors:
            starts, times = (np.concatenate(part) for part in zip(*anchors, strict=True))
            if len(starts):
                return starts, times
    return None


def _instances(message: Message, columns: dict[str, Column]) -> dict[str, dict[str, Column]]:
    """Tables of a message, one for each sensor or core: `NAME` is number 0, `NAME_1` the next."""
    numbers = columns.get(message.instance, np.zeros(0))
    apart = np.unique(numbers) if numbers.dtype.kind in "iu" else np.zeros(0)
    if not 0 < len(apart) <= _MOST_INSTANCES:
        return {message.name: columns}
    parts = {int(number): numbers == number for number in apart}
    return {
        f"{message.name}_{number}" if number else message.name: {name: column[rows] for name, column in columns.items()}
        for number, rows in parts.items()
    }


def _units(log: _Log, data: bytes, found: list[int]) -> None:
    """Takes from FMTU the marks of columns, and the column that distinguishes instances: its unit is `#`."""
    for position in found:
        _, kind, units, multipliers = _FMTU.unpack_from(data, position + _HEAD.size)
        message = log.messages.get(kind)
        if message is None:
            continue
        message.marks = units, multipliers
        mark = units.find(b"#")
        if message.layout is not None and 0 <= mark < len(message.labels):
            numbers = [leaf.name for leaf in message.layout.leaves if leaf.format == "u1" and leaf.count is None]
            if message.labels[mark] in numbers:
                message.instance = message.labels[mark]


def _take_units(units: Units, message: Message, data: bytes, found: list[int]) -> None:
    """Takes from UNIT and MULT the meaning of the marks in FMTU."""
    for position in found:
        if message.name == "UNIT" and message.length == _HEAD.size + _UNIT.size:
            _, mark, name = _UNIT.unpack_from(data, position + _HEAD.size)
            units.names[mark] = name.partition(b"\0")[0].decode("ascii", errors="replace")
        elif message.name == "MULT" and message.length == _HEAD.size + _MULT.size:
            _, mark, units.multipliers[mark] = _MULT.unpack_from(data, position + _HEAD.size)


def _units_of(message: Message, units: Units) -> Iterator[tuple[str, str]]:
    """The columns of a message whose unit the log states, with that unit.

    A value stored as an integer was already divided according to its format, so its multiplier is 1.
    """
    if message.layout is None:
        return
    leaves = {leaf.name: leaf for leaf in message.layout.leaves}
    for label, unit, multiplier in zip(message.labels, *message.marks, strict=False):
        name = units.names.get(unit, "")
        kind = next((kind for kind in KINDS if _SAME.get(name, name) in kind), ())
        if label not in leaves or multiplier in _SILENT:
            continue
        factor = 1.0 if leaves[label].divisor != 1.0 else units.multipliers.get(multiplier, 0.0)
        size = factor * UNIT_SCALE[_SAME.get(name, name)] if kind else 0.0
        yield from ((label, one) for one in kind if math.isclose(size, UNIT_SCALE[one], rel_tol=1e-6))


def _content(path: Path, log: _Log, size: int) -> Content:
    """Tables of the collected messages."""
    notes: list[str] = []
    if log.redefined:
        notes.append(f"later definitions of {listed(sorted(log.redefined))} differ: the first one is used")

    def columns(message: Message) -> dict[str, Column]:
        return message.rows.columns(message.layout) if message.layout is not None else {}

    damage = log.damage.texts(size)
    return content_of(path, log.wanted, log.messages.values(), columns, _timeline(log), notes, damage, log.units)


def content_of(
    path: Path,
    wanted: Collection[str] | None,
    messages: Collection[Message],
    columns_of_message: Callable[[Message], dict[str, Column]],
    timeline: Anchors | None,
    notes: list[str],
    damage: tuple[str, ...],
    units: Units,
) -> Content:
    """Tables of messages; those without a time get `log_time` from their positions.

    Args:
        path: For error messages.
        wanted: Names of the tables to return; None for all.
        messages: All that are defined.
        columns_of_message: Returns the columns of a message.
        timeline: Positions in the file and the times there [ns]; None where the log has no time.
        notes: What was left out so far; extended.
        damage: See `Content.damage`.
        units: Meaning of the columns' marks.

    Raises:
        LogError: No message besides definitions.
    """
    if not any(message.count for message in messages if message.name not in ABOUT):
        why = f" ({[*damage, *notes][0]})" if damage or notes else ""
        raise LogError(
            f"{path}: the log defines {len(messages)} messages and holds none of them{why}; "
            "download it from the autopilot again"
        )
    tables: dict[str, Table] = {}
    skipped: dict[str, str] = {}
    told: dict[tuple[str, str], str] = {}
    placed: list[str] = []
    for message in messages:
        columns = columns_of_message(message) if message.count and message.layout is not None else {}
        if not columns:
            if message.count or message.name in (wanted or ()):  # a log defines many messages that it never contains
                reason = one_line(f"{message.reason or 'no message'} ({message.count} messages)")
                skipped.setdefault(message.name, reason)
            continue
        if without_time(message) and timeline is not None:
            columns = {"log_time": np.interp(np.concatenate(message.places), *timeline).astype(np.int64)} | columns
            placed.append(message.name)
        for name, part in _instances(message, columns).items():
            if wanted is None or name in wanted:
                tables[name] = Table(name, part)
                told |= {(name, label): unit for label, unit in _units_of(message, units)}
            else:
                skipped[name] = "not asked for"
    if placed:
        notes.append(f"no time in {listed(placed)}: their log_time is interpolated between messages that have one")
    return Content(tables, skipped, tuple(notes), damage=damage, units=told)
