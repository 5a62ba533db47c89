"""JSON Lines: one JSON object a line, as Python scripts and web tools log.

The objects become the rows of a CSV, whose reader tells numbers, dates, blank cells and text apart. Keys of nested
objects are dotted (`pose.x`), elements of lists are numbered (`q[0]`). A key that a line lacks is a blank cell.

Source: https://jsonlines.org
"""

import csv
import json
from collections.abc import Collection, Iterator
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

from rotorfit.core.errors import LogError
from rotorfit.core.log import Table
from rotorfit.core.plain import DEEPEST, LONGEST_NAME, visible
from rotorfit.files.kinds import text_kind
from rotorfit.files.logs.content import WIDEST, Content, check_width, listed
from rotorfit.files.logs.csv import UTF8_MARK, check_cells, columns_below, text_of, with_stamps

_ASKED = 20  # lines at the start, of which one must have a number


class _Number(str):
    """A number as it stands in the line: of any length, and not rounded before its column is known."""

    __slots__ = ()


class _BeyondError(Exception):
    """A line that no log contains."""


class _Rows:
    """Rows of a CSV that learns its columns as it goes.

    Attributes:
        names: The columns so far, in the order of their first appearance.
        count: Rows so far.
    """

    def __init__(self, path: Path) -> None:
        self.names: dict[str, None] = {}
        self.count = 0
        self._path = path
        self._parts: list[tuple[int, StringIO]] = []  # rows with the same number of cells, and that number

    def add(self, row: dict[str, str]) -> None:
        """Adds a row; the cells of columns that it lacks are blank."""
        for name in row:
            if name not in self.names:
                self.names[name] = None
                check_width(self._path, len(self.names))
        self.count += 1
        check_cells(self._path, self.count * len(self.names))
        if not self._parts or self._parts[-1][0] < len(self.names):
            self._parts.append((len(self.names), StringIO()))
        csv.writer(self._parts[-1][1], lineterminator="\n").writerow([row.get(name, "") for name in self.names])

    def text(self) -> bytes:
        """The rows, all of them with a cell for each column."""
        parts = (text.getvalue().replace("\n", "," * (len(self.names) - width) + "\n") for width, text in self._parts)
        return "".join(parts).encode()


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the first line is a whole JSON object, one of the first has a number, and it is not a file of ours."""
    lines = head.removeprefix(UTF8_MARK).lstrip().split(b"\n")[:_ASKED]
    if not lines[0].startswith(b"{") or text_kind(head):
        return False
    found = [_object(line) for line in lines]
    return found[0] is not None and any(found)


def _object(line: bytes) -> bool | None:
    """Whether a line is an object with a number in it; None where it is no whole object."""
    try:
        found = _parsed(line)
        return any(isinstance(cell, _Number) for _, cell in _cells(found)) if isinstance(found, tuple) else None
    except (ValueError, _BeyondError):
        return None


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - a file is one table
    """Reads the one table, named after the file.

    Raises:
        LogError: Too large, not UTF-8, a line that no log contains, or no column of numbers.
    """
    rows, notes = _Rows(path), list[str]()
    long, again, torn = dict[str, None](), dict[str, None](), list[int]()
    for number, line in enumerate(BytesIO(text_of(path)), 1):
        if not line.strip():
            continue
        try:
            found = _parsed(line)
            if not isinstance(found, tuple):
                raise ValueError("no object")
            row: dict[str, str] = {}
            for name, cell in _cells(found):
                if cell is None:
                    long[name] = None
                elif name in row:
                    again[name] = None
                else:
                    row[name] = cell
        except ValueError:
            torn.append(number)
        except _BeyondError as error:
            raise LogError(f"{path}: line {number} has {error}; look at it in an editor") from None
        else:
            rows.add(row)
    if torn:
        notes.append(f"{len(torn)} torn lines left out, the first is line {torn[0]} of the file")
    if long:
        notes.append(f"columns left out because they hold lists of more than {WIDEST}: {listed(list(long))}")
    if again:
        notes.append(f"cells left out because an earlier one in the line has their name: {listed(list(again))}")
    text = rows.text()
    columns = columns_below(path, text, (0, len(text)), [visible(name) for name in rows.names], ",", notes)
    return Content({path.stem: Table(path.stem, with_stamps(columns))}, {}, tuple(notes))


def _parsed(line: bytes) -> Any:
    """A line of JSON: objects as tuples of pairs, which keep keys that come twice, and numbers as they stand there.

    Raises:
        ValueError: Not JSON.
        _BeyondError: Nested too deeply for the parser.
    """
    try:
        return json.loads(
            line.decode(), parse_int=_Number, parse_float=_Number, parse_constant=_Number, object_pairs_hook=tuple
        )
    except RecursionError:
        raise _BeyondError(_TOO_DEEP) from None


_TOO_DEEP = f"more than {DEEPEST} levels of nesting"


def _cells(value: Any, name: str = "", depth: int = 0) -> Iterator[tuple[str, str | None]]:
    """Names and cells of a parsed line; None for a list that is too long.

    Raises:
        _BeyondError: Nested too deeply, or a name too long.
    """
    if depth > DEEPEST:
        raise _BeyondError(_TOO_DEEP)
    if len(name) > LONGEST_NAME:
        raise _BeyondError(f"a name of more than {LONGEST_NAME} characters")
    if isinstance(value, tuple):
        for key, part in value:
            yield from _cells(part, f"{name}.{key}" if name else key, depth + 1)
    elif isinstance(value, list) and len(value) > WIDEST:
        yield name, None
    elif isinstance(value, list):
        for place, part in enumerate(value):
            yield from _cells(part, f"{name}[{place}]", depth + 1)
    elif isinstance(value, _Number):
        yield name, value
    else:
        yield name, "" if value is None else visible(str(value))
