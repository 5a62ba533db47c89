"""ArduPilot logs as text (.log), as written by ground stations: `ATT, 312991, 0.00, 0.44, ...`, with FMT lines.

The numbers are already divided according to their format; everything else is as in `dataflash`.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column
from rotorfit.files.logs.content import LIMIT, Content
from rotorfit.files.logs.csv import columns_below
from rotorfit.files.logs.dataflash import Anchors, Message, Units, content_of, message_of, without_time

_FIRST = re.compile(rb"^FMT, ?128, ?\d+, ?FMT,", re.MULTILINE)

_LONGEST_RECORD = 255

_FOREIGN = frozenset(b'"\0')

_LATEST = 1 << 62

_SPACING = 8  # lines between the anchors that tell the time of a place in the file


@dataclass
class _Log:
    """What was found in a file so far.

    Attributes:
        messages: Message by its name.
        types: The same by the number of their type.
        texts: Name of a message to its cells, one line per message.
        numbers: Name of a message without a time to its line numbers.
        anchors: Line numbers of messages with a clock and its time [ns]: the autopilot's, and the satellites'.
        torn: Number of lines left out.
        units: Meaning of the columns' marks.
    """

    messages: dict[bytes, Message] = field(default_factory=dict)
    types: dict[int, Message] = field(default_factory=dict)
    texts: dict[bytes, bytearray] = field(default_factory=dict)
    numbers: dict[bytes, list[int]] = field(default_factory=dict)
    anchors: tuple[list[tuple[int, float]], list[tuple[int, float]]] = field(default_factory=lambda: ([], []))
    torn: int = 0
    units: Units = field(default_factory=Units)


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether a line defines the FMT message itself."""
    return _FIRST.search(head) is not None


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested messages; see `files.logs.read`.

    Raises:
        LogError: Too large, or no message besides definitions.
    """
    if path.stat().st_size > LIMIT:
        raise LogError(f"{path}: more than {LIMIT >> 20} MiB of text; cut the log to the flight that you need")
    log, end = _Log(), b"\n"
    with path.open("rb") as file:
        for number, line in enumerate(file):
            end = line[-1:]
            if end == b"\n":
                _take(log, tables, number, line.rstrip())
    for name, message in log.messages.items():
        message.places = [np.array(log.numbers.get(name, []), dtype=np.int64)]
    notes = [f"{log.torn} torn lines left out"] if log.torn else []
    notes += ["the last line has no line end: left out"] if end != b"\n" else []

    def columns(message: Message) -> dict[str, Column]:
        return _columns(path, message, bytes(log.texts.get(message.name.encode(), b"")), notes)

    return content_of(path, tables, log.messages.values(), columns, _timeline(log), notes, (), log.units)


def _take(log: _Log, wanted: Collection[str] | None, number: int, line: bytes) -> None:
    """Takes one line: a definition or a message."""
    name, comma, rest = line.partition(b",")
    if name == b"FMT":
        _define(log, wanted, [cell.strip() for cell in rest.decode("ascii", errors="replace").split(",")])
        return
    message = log.messages.get(name)
    if message is None:
        log.torn += bool(comma)  # the lines above the log have none
        return
    # A text may contain commas; a complete line of numbers has as many cells as names.
    if message.reason or (rest.count(b",") == len(message.labels) - 1 and rest.isascii() and not set(rest) & _FOREIGN):
        message.count += 1
        if message.name == "FMTU":
            _units(log, [cell.strip() for cell in rest.decode("ascii", errors="replace").split(",")])
        if message.name in ("UNIT", "MULT"):
            _take_unit(log.units, message.name, rest.decode("ascii", errors="replace").split(","))
        if not message.reason:
            log.texts.setdefault(name, bytearray()).extend(rest.replace(b" ", b"") + b"\n")
            if without_time(message):
                log.numbers.setdefault(name, []).append(number)
        _anchor(log, message, number, rest)
    else:
        log.torn += 1


def _define(log: _Log, wanted: Collection[str] | None, cells: list[str]) -> None:
    """Takes a definition: type, length, name, format, names of columns. The first one of a type counts."""
    kind = int(cells[0]) if cells[0].isdecimal() and len(cells[0]) < 4 else -1
    if len(cells) < 5 or not 0 <= kind < 256:
        log.torn += 1
    elif kind not in log.types and cells[2] != "FMT":
        message = message_of(wanted, cells[2], _LONGEST_RECORD, cells[3], cells[4:])
        log.types[kind] = log.messages.setdefault(cells[2].encode(), message)


def _units(log: _Log, cells: list[str]) -> None:
    """Takes from FMTU the marks of columns, and the column that distinguishes instances: its unit is `#`."""
    message = log.types.get(int(cells[1])) if len(cells) > 2 and cells[1].isdecimal() and len(cells[1]) < 4 else None
    mark = cells[2].find("#") if message else -1
    if message is not None and len(cells) > 3:
        message.marks = cells[2].encode(), cells[3].encode()
    if message is not None and 0 <= mark < len(message.labels):
        message.instance = message.labels[mark]


def _take_unit(units: Units, name: str, cells: list[str]) -> None:
    """Takes from UNIT or MULT the meaning of a mark in FMTU."""
    _, mark, text = (cell.strip() for cell in (*cells, "", "")[:3])
    if not (mark.isdecimal() and len(mark) < 4):
        return
    if name == "UNIT":
        units.names[int(mark)] = text
    elif re.fullmatch(r"[0-9.]{1,20}(e-?\d{1,2})?", text):
        units.multipliers[int(mark)] = float(text)


def _anchor(log: _Log, message: Message, number: int, rest: bytes) -> None:
    """Keeps an anchor that dates a line of the file, every few lines."""
    if message.clock is None:
        return
    anchors = log.anchors[message.clock.satellites]
    if not anchors or number >= anchors[-1][0] + _SPACING:
        cell = b"".join(rest.split(b",")[message.labels.index(message.clock.leaf.name) :][:1]).strip()
        if cell.isdigit() and len(cell) < 19 and int(cell) < _LATEST // message.clock.nanoseconds:
            anchors.append((number, int(cell) * message.clock.nanoseconds))


def _timeline(log: _Log) -> Anchors | None:
    """Anchors of the whole file: from the autopilot's clock or, where none is logged, the satellites'; else None."""
    anchors = log.anchors[0] or log.anchors[1]
    return (np.array([place for place, _ in anchors]), np.array([time for _, time in anchors])) if anchors else None


def _columns(path: Path, message: Message, text: bytes, notes: list[str]) -> dict[str, Column]:
    """Columns of a message; empty where it holds no number."""
    said: list[str] = []
    try:
        columns = columns_below(path, text, (0, len(text)), message.labels, ",", said)
    except LogError:
        message.reason = "holds no numbers"
        return {}
    notes += [f"{message.name}: {note}" for note in said]
    # Only columns as long as the text, so that positions and instances match the rows.
    return columns if len({len(values) for values in columns.values()} | {message.count}) == 1 else {}
