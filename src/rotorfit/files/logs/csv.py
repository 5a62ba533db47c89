"""CSV: one header row of names, then rows of numbers between commas, semicolons or tabs.

Decimal commas (`0,5`) with semicolons as separators are understood. Lines with a wrong number of cells (a cut last
line, a line torn by a full disk) are left out with a note. Dates, of ISO 8601 or dotted with the day first, become
nanoseconds since 1970, times of day since midnight; stamps in two columns of seconds and nanoseconds get an additional
combined column. A row of units below the names states the units of the columns.
"""

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from rotorfit.core.display import counted
from rotorfit.core.errors import LogError
from rotorfit.core.frames import UNIT_SCALE
from rotorfit.core.log import Column, Table
from rotorfit.files.logs.content import Content, check_width, listed, one_line

if TYPE_CHECKING:
    import polars as pl

_SEPARATORS = ",;\t"

NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)

_BLOCK = 1 << 20

_LARGEST = 1 << 28  # bytes of a text, which takes four times as much while it is parsed: three hours of 20 columns

_MOST_CELLS = 1 << 25

_SAMPLE = 100

_SPOILT = 0.05  # share of the cells of a column that may hold text among numbers

_EXACT = 1 << 53  # up to here float64 holds every whole number

_EMPTY = ("", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None")

_UNITS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "\N{MICRO SIGN}s", "\N{GREEK SMALL LETTER MU}s", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("degree", "degrees", "\N{DEGREE SIGN}"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
}
"""Other spellings of the units of a card."""

_COMMENTS = (b"#", b"%")

_DAY_FIRST = r"\d\d\.\d\d\.\d{4}"

_DATE = rf"^(?:(\d{{4}}[-/]\d\d[-/]\d\d|{_DAY_FIRST})[T ])?(\d\d:\d\d:\d\d(?:[.,]\d{{1,9}})?)(Z|[+-]\d\d:?\d\d)?$"

_OTHER_DATE = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}\b.*\d:\d\d")

_MOST_BLANK = 1000
"""Number of rows in which the first cell of a column that is not blank is looked for."""

_STAMP_PARTS = (("secs", "nsecs"), ("sec", "nsec"), ("sec", "nanosec"))

_JSON = re.compile(r"\s*(\{|\[\s*[\[{])")

UTF8_MARK = b"\xef\xbb\xbf"

_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True)
class _Sheet:
    """A parsed text: names, and the lines below them with one cell for each name.

    Attributes:
        names: Names of the columns, in order; may repeat, may be empty.
        separator: Separator of the cells.
        quoted: Whether quotation marks enclose cells.
        rows: The lines, including line ends.
    """

    names: list[str]
    separator: str
    quoted: bool
    rows: bytes


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the text begins like a CSV: a row of names (or numbers), and below it cells with a number among them."""
    if head.startswith(_UTF16_MARKS):
        return True
    head = _with_line_ends(head.removeprefix(UTF8_MARK))
    start, end = _header(head)
    lines = [head[start:end], *(line for line in head[end:].split(b"\n")[:100] if line.strip())][:3]
    text = [line.decode("utf-8", errors="replace") for line in lines if line.strip()]
    if not text or _JSON.match(text[0]):
        return False
    if not all(char.isprintable() or char in "\t\r" for line in text[:2] for char in line):
        return False
    names, *rows = (cells(line, separator_of(text[0])) for line in text)
    first = rows[1:] if len(rows) > 1 and _are_units(rows[0], names) else rows[:1]
    return len(names) > 1 and all(len(row) > 1 and any(map(_is_value, row)) for row in first)


def _with_line_ends(data: bytes) -> bytes:
    """A text whose lines end with a line feed, those of old spreadsheets end with a carriage return."""
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def _are_units(row: list[str], names: list[str]) -> bool:
    """Whether the row below the names has units: as many cells, and no number but 1, the unit of what has none."""
    if len(row) != len(names) or not any(row) or any(_is_value(cell) for cell in row if cell != "1"):
        return False
    return "1" not in row or any(map(_unit, row))


def _is_value(cell: str) -> bool:
    """Whether a cell is a number or a date."""
    return NUMBER.fullmatch(cell) is not None or re.match(_DATE, cell) is not None


def _header(data: bytes) -> tuple[int, int]:
    """Start and end of the row of names: below the comments, or the last comment where numbers follow at once."""
    last, end = (0, 0), -1
    while True:
        start = end + 1
        while data[start : start + 1].isspace():
            start += 1
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        if re.fullmatch(rb"sep=.\s*", data[start:end]):  # a spreadsheet's
            continue
        if not data[start:end].startswith(_COMMENTS):
            break
        while data[start : start + 1] in _COMMENTS or data[start : start + 1] == b" ":
            start += 1
        last = start, end
    first, names = (data[low:high].decode(errors="replace") for low, high in ((start, end), last))
    row = cells(first, separator_of(first))
    named = last[1] and len(row) == len(cells(names, separator_of(names))) and any(map(NUMBER.fullmatch, row))
    return last if named else (start, end)


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - a CSV is one table
    """Reads the one table, named after the file.

    Raises:
        LogError: Not UTF-8, no header, no rows, no column of numbers.
    """
    notes: list[str] = []
    data = text_of(path)
    start, end = _header(data)
    header = data[start:end].decode()
    separator = separator_of(header)
    names = cells(header, separator)
    if len(names) < 2:
        raise LogError(f"{path}: the header row cannot be understood; check its separators and quotation marks")
    if all(NUMBER.fullmatch(name) for name in names):
        raise LogError(f"{path}: the first line holds numbers where the columns' names belong; add a header row")
    units: dict[str, str] = {}
    below, below_end = _cells_at(data, end + 1, separator)
    if below_end > 0 and _are_units(below, names):
        end = below_end
        told = [(name, cell) for name, cell in zip(names, below, strict=True) if cell.strip("[]()- ")]
        dates = _dated(data, end + 1, separator, names)  # become ns
        units = {name: unit for name, cell in told if name not in dates and (unit := _unit(cell))}
        rest = [cell for name, cell in told if name not in units]
        stated = listed([f"{name} {unit}" for name, unit in units.items()]) or "none"
        unused = f"; not used: {listed(rest)}" if rest else ""
        notes.append(f"units by the row below the names: {stated}{unused}")
    part = (end + 1, len(data))
    columns = with_stamps(columns_below(path, data, part, names, separator, notes, data[:end]))
    known = {(path.stem, name): unit for name, unit in units.items() if name in columns}
    return Content({path.stem: Table(path.stem, columns)}, {}, tuple(notes), units=known)


def _dated(data: bytes, start: int, separator: str, names: Sequence[str]) -> set[str]:
    """The columns that hold dates, by the first cell of each that is not blank, among the first rows."""
    blank, dates = set(names), set[str]()
    for _ in range(_MOST_BLANK):
        row, end = _cells_at(data, start, separator)
        if end <= start or not blank:
            break
        told = {name: cell for name, cell in zip(names, row, strict=False) if name in blank and cell.strip()}
        dates |= {name for name, cell in told.items() if re.match(_DATE, cell)}
        blank, start = blank - told.keys(), end + 1
    return dates


def _cells_at(data: bytes, start: int, separator: str) -> tuple[list[str], int]:
    """Cells of the line that begins there, and the place of its line end; negative where it has none."""
    end = data.find(b"\n", start)
    return cells(data[start:end].decode(), separator), end


def _unit(cell: str) -> str | None:
    """The unit that a cell names, as a card names it; None where a card has none of that name."""
    parts = cell.strip("[]() ").lower().split("/")
    unit = "/".join(_UNITS.get(part, part) for part in parts)
    return unit if unit in UNIT_SCALE else None


def with_stamps(columns: dict[str, Column]) -> dict[str, Column]:
    """Adds combined stamps where they are in two columns (`header.stamp.secs`, `header.stamp.nsecs`)."""
    stamps: dict[str, Column] = {}
    for whole, rest in _STAMP_PARTS:
        for name, seconds in columns.items():
            stem = name.removesuffix(whole)
            part = columns.get(stem + rest)
            if part is None or not name.endswith((f".{whole}", f"_{whole}")) or stem[:-1] in {"", *columns}:
                continue
            if _whole(seconds) and _whole(part):
                stamps[stem[:-1]] = seconds * 1_000_000_000 + part  # of float64 where cells are blank: within 256 ns
    return stamps | columns


def _whole(values: Column) -> bool:
    """Whether a column holds whole numbers, or none in some cells."""
    if values.dtype != np.float64:
        return bool(values.dtype == np.int64)
    there = values[np.isfinite(values)]
    return bool(there.size and np.all(there == np.round(there)))


def check_cells(path: Path, count: int) -> None:
    """Raises `LogError` if a sheet has more cells than are parsed."""
    if count > _MOST_CELLS:
        raise LogError(f"{path}: more than {_MOST_CELLS >> 20} million cells; cut the log to the flight that you need")


def text_of(path: Path) -> bytes:
    """The text of a file without the UTF-8 byte order mark.

    Raises:
        LogError: Too large, or not UTF-8.
    """
    if path.stat().st_size > _LARGEST:
        raise LogError(
            f"{path}: more than {_LARGEST >> 20} MiB of text; cut the log to the flight that you need, or give Parquet"
        )
    data = _with_line_ends(path.read_bytes().removeprefix(UTF8_MARK))
    _check_text(path, data)
    return data


def columns_below(
    path: Path,
    data: bytes,
    part: tuple[int, int],
    names: list[str],
    separator: str,
    notes: list[str],
    header: bytes = b"",
) -> dict[str, Column]:
    """Columns of numbers in the rows of a part of a text.

    Args:
        path: For error messages.
        data: The text.
        part: Start of the rows, after the header, and their end.
        names: Names of the columns, in order; may repeat, may be empty.
        separator: Separator of the cells.
        notes: Extended by what was left out.
        header: The lines above the rows, which a logger that appends repeats among them.

    Raises:
        LogError: Too many columns or cells, no rows, rows that do not match the names, or no column of numbers.
    """
    check_width(path, len(names))
    sheet = _sheet(path, data, part, names, separator, notes, header)
    columns = _columns(_frame(path, sheet), sheet.names, notes)
    if not columns:
        raise LogError(f"{path}: no column of numbers; check the separator and the decimal sign")
    return columns


def _sheet(
    path: Path,
    data: bytes,
    part: tuple[int, int],
    names: list[str],
    separator: str,
    notes: list[str],
    header: bytes,
) -> _Sheet:
    """Splits the rows and leaves out torn lines and repeated headers."""
    body = data[part[0] : part[1]]
    if not body.strip():
        raise LogError(f"{path}: a header row and no rows below it; check that the recording ran")
    check_cells(path, body.count(separator.encode()) + body.count(b"\n"))
    lines = _Lines(body, separator)
    first = body[lines.starts[lines.filled][0] :][: lines.lengths[lines.filled][0]].strip(b"\r\n")
    if lines.cells[lines.filled][0] == len(names) + 1 and first.endswith(separator.encode()):
        names = [*names, ""]  # loggers that end every row, but not the header, with a separator
    again = np.zeros(len(lines.starts), np.bool_)
    for repeated in header.splitlines():
        again |= lines.equal_to(body, repeated.strip())
    if again.any():
        notes.append(f"the header is repeated among the rows, in {counted(int(again.sum()), 'line')}: left out")
        lines.filled &= ~again
    whole = lines.filled & (lines.cells == len(names)) & ~lines.zeros
    if not whole.any():
        width = int(lines.cells[lines.filled][0])
        raise LogError(f"{path}: {len(names)} names but {width} cells in a row; check header and separator")
    _drop_cut_value(body, lines, whole, separator, notes)
    torn = np.flatnonzero(lines.filled & ~whole)
    if len(torn):
        line = data.count(b"\n", 0, part[0] + int(lines.starts[torn[0]])) + 1
        notes.append(f"{len(torn)} torn lines left out, the first is line {line} of the file")
    rows = (
        body
        if not len(torn) and not again.any()
        else np.frombuffer(body, np.uint8)[np.repeat(whole, lines.lengths)].tobytes()
    )
    return _Sheet(names, separator, lines.quoted, _with_points(rows, separator))


class _Lines:
    """Lines of a text: where they begin, their lengths, and their numbers of cells.

    Attributes:
        quoted: Whether quotation marks enclose cells (they come in pairs).
        starts: Offset of each line, shape (N,).
        lengths: Length of each line including its end [byte], shape (N,).
        cells: Number of cells in each line, shape (N,).
        filled: Lines that are not blank, shape (N,).
        zeros: Lines with null bytes, as left by a power cut, shape (N,).
    """

    def __init__(self, text: bytes, separator: str) -> None:
        self.quoted = b'"' in text and text.count(b'"') % 2 == 0
        after = _places(text, "\n", self.quoted) + 1
        if not len(after) or after[-1] < len(text):
            after = np.append(after, np.int32(len(text)))
        self.starts = np.append(np.int32(0), after[:-1])
        self.lengths = after - self.starts
        self.cells = _counts(_places(text, separator, self.quoted), after) + 1
        self.zeros = _counts(_places(text, "\0", False), after) > 0
        self.filled = np.ones(len(after), bool)
        for row in np.flatnonzero((self.cells == 1) & ~self.zeros):
            self.filled[row] = bool(text[self.starts[row] : after[row]].strip())

    def equal_to(self, text: bytes, line: bytes) -> npt.NDArray[np.bool_]:
        """Lines that hold just this one, shape (N,)."""
        found = np.zeros(len(self.starts), bool)
        place = text.find(line) if line else -1
        while place >= 0:
            row = int(np.searchsorted(self.starts, place, side="right")) - 1
            start = int(self.starts[row])
            found[row] = text[start : start + int(self.lengths[row])].strip() == line
            place = text.find(line, place + len(line))
        return found


def _places(text: bytes, mark: str, quoted: bool) -> npt.NDArray[np.int32]:
    """Offsets of a character, outside quotation marks if `quoted`; in blocks, to save memory."""
    places, parity = [np.zeros(0, np.int32)], np.uint8(0)
    for start in range(0, len(text), _BLOCK):
        block = np.frombuffer(text, np.uint8, min(_BLOCK, len(text) - start), start)
        found = block == ord(mark)
        if quoted:
            inside = (np.cumsum(block == ord('"'), dtype=np.uint8) + parity) & np.uint8(1)
            found &= inside == 0
            parity = inside[-1]
        places.append((np.flatnonzero(found) + start).astype(np.int32))
    return np.concatenate(places)


def _counts(places: npt.NDArray[np.int32], after: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Number of the places in each line."""
    return np.diff(np.searchsorted(places, after), prepend=0)


def _drop_cut_value(text: bytes, lines: _Lines, whole: npt.NDArray[np.bool_], separator: str, notes: list[str]) -> None:
    """Marks the last line as torn if it has no line end and only its last cell, unlike that above, is no number."""
    if text.endswith(b"\n") or not whole[-1]:
        return
    ends = [
        cells(text[lines.starts[row] :][: lines.lengths[row]].decode(), separator)[-1:]
        for row in np.flatnonzero(whole)[-2:]
    ]
    is_number = [all(map(NUMBER.fullmatch, cell)) for cell in ends]
    if is_number == [True, False]:
        whole[-1] = False
    else:
        notes.append("the last line has no line end: its last value may be cut")


def _check_text(path: Path, data: bytes) -> None:
    """Raises `LogError` if the text is not UTF-8."""
    if data.startswith(_UTF16_MARKS):
        raise LogError(f"{path}: UTF-16 text; save it in UTF-8")
    try:
        data.isascii() or data.decode()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise LogError(
            f"{path}: line {line} is not UTF-8 (byte 0x{data[error.start]:02x}); save it as UTF-8"
        ) from error


def separator_of(header: str) -> str:
    """The most frequent separator in the header outside quotation marks; a comma if there is none."""
    bare = re.sub(r'"[^"]*"', "", header)
    return max(_SEPARATORS, key=bare.count)


def cells(line: str, separator: str) -> list[str]:
    """Cells of one line, without quotation marks and surrounding blanks; empty if the quotation marks do not pair."""
    try:
        cells = next(csv.reader([line.strip("\r\n")], delimiter=separator, skipinitialspace=separator != "\t"), [])
    except csv.Error:
        return []
    return [cell.strip() for cell in cells]


def _frame(path: Path, sheet: _Sheet) -> "pl.DataFrame":
    """Parses the rows; columns that are not plain numbers are returned as text."""
    import polars as pl

    parse = partial(
        pl.read_csv,
        sheet.rows,
        has_header=False,
        new_columns=[str(index) for index in range(len(sheet.names))],
        separator=sheet.separator,
        quote_char='"' if sheet.quoted else None,
        null_values=list(_EMPTY),
    )
    fault: Exception | None = None
    # Types from the first rows (five times faster); else from all rows; else, for a number that fits no type, text.
    for types in ({"infer_schema_length": 1000}, {"infer_schema_length": None}, {"infer_schema": False}):
        try:
            return parse(**types)
        except (pl.exceptions.PolarsError, ValueError) as error:
            fault = error
    assert fault is not None
    raise LogError(f"{path}: cannot be parsed as CSV ({one_line(fault)}); look at it in an editor") from fault


def _with_points(rows: bytes, separator: str) -> bytes:
    """Replaces decimal commas by points, if numbers in the first rows have commas, and none has a point."""
    sample = rows[:_BLOCK]
    if separator == "," or b"," not in sample:
        return rows
    commas, points = (
        re.search(
            rf'(?:\A|[{separator}\n])[" ]*[+-]?\d*{sign}\d+(?:[eE][+-]?\d+)?[" ]*[{separator}\r\n]'.encode(), sample
        )
        for sign in (",", r"\.")
    )
    return rows.replace(b",", b".") if commas and not points else rows


def _columns(frame: "pl.DataFrame", names: list[str], notes: list[str]) -> dict[str, Column]:
    """Columns of numbers by name; the others, and cells of text among numbers, are listed in notes.

    Text among nanoseconds since 1970 costs the row: with a blank they would become float64, and be rounded to 256 ns.
    """
    import polars as pl

    columns: dict[str, Column] = {}
    lost = np.zeros(len(frame), np.bool_)
    text, dates, again, unnamed = list[str](), list[str](), list[str](), 0
    for name, series in zip(names, frame.iter_columns(), strict=True):
        cells = _blanked(series) if series.dtype == pl.String else series
        parsed = _parsed(cells) if series.dtype == pl.String else series
        values = None if parsed is None else _numbers(parsed)
        if not name:
            unnamed += values is not None and not np.isnan(values.astype(np.float64)).all()
        elif name in columns:
            again.append(name)
        elif parsed is None or values is None:
            first = cells.drop_nulls().head(1).to_list()
            (dates if first and _OTHER_DATE.match(str(first[0])) else text).append(name)
        else:
            columns[name] = values
            if spoilt := parsed.null_count() - cells.null_count():
                first = cells.filter(parsed.is_null() & cells.is_not_null())[0]
                cost = "blank"
                if parsed.dtype == pl.Int64 and not cells.null_count() and np.nanmax(np.abs(values)) > _EXACT:
                    columns[name], cost = parsed.fill_null(0).to_numpy(writable=True), "their rows are left out"
                    lost |= parsed.is_null().to_numpy()
                notes.append(
                    f"{spoilt} of {len(cells)} cells of {listed([name])} hold text, as {one_line(first)!r}: {cost}"
                )
    if text:
        notes.append(f"columns left out because they hold text: {listed(text)}")
    if dates:
        notes.append(f"columns left out because their dates are not as 2024-05-01 12:00:00.050: {listed(dates)}")
    if again:
        notes.append(f"columns left out because an earlier one has their name: {listed(again)}")
    if unnamed:
        notes.append(f"columns left out because they have no name: {unnamed}")
    return {name: values[~lost] for name, values in columns.items()} if lost.any() else columns


def _numbers(series: "pl.Series") -> Column | None:
    """Values of a parsed column: integers as int64, booleans as bool, empty cells as NaN; None for other types."""
    import polars as pl

    if series.dtype in (pl.Int64, pl.Boolean) and not series.null_count():
        return series.to_numpy(writable=True)
    if series.dtype.is_numeric() or series.dtype == pl.Boolean:
        return series.cast(pl.Float64).fill_null(float("nan")).to_numpy(writable=True)
    return None


def _blanked(text: "pl.Series") -> "pl.Series":
    """Cells without the blanks around them, null where they are empty."""
    text = text.str.strip_chars()
    return text.set(text.is_in(_EMPTY).fill_null(False), None)


def _parsed(text: "pl.Series", spoilt: float = _SPOILT) -> "pl.Series | None":
    """A column of text as numbers, null where a cell is empty or, in a share of them, text; None if more are text."""
    import polars as pl

    if len(text) > _SAMPLE and _parsed(text.head(_SAMPLE), 0.5) is None:  # spares copies of long texts
        return None
    empty = text.null_count()
    folded = text.str.to_lowercase()
    if folded.is_in(["true", "false"]).all() and not empty:
        return folded == "true"
    if (whole := text.cast(pl.Int64, strict=False)).null_count() == empty:
        return whole
    few = empty + spoilt * (len(text) - empty)
    if (numbers := text.cast(pl.Float64, strict=False)).null_count() <= few:
        return whole if whole.null_count() == numbers.null_count() else numbers
    return dates if (dates := _dates(text)).null_count() <= few else None


def _dates(text: "pl.Series") -> "pl.Series":
    """Dates as nanoseconds since 1970, times of day as nanoseconds since midnight; null for other text."""
    import polars as pl

    days, clock, zone = (text.str.extract(_DATE, group) for group in (1, 2, 3))
    if days.null_count() not in (clock.null_count(), len(days)):  # some with a day, some without
        return pl.Series([None] * len(text), dtype=pl.Int64)
    days = days.str.replace_all("/", "-").str.replace(r"^(\d\d)\.(\d\d)\.(\d{4})$", "$3-$2-$1")
    joined = days.fill_null("1970-01-01") + "T" + clock.str.replace(",", ".", literal=True)
    stamps = joined.str.to_datetime("%Y-%m-%dT%H:%M:%S%.f", time_unit="ns", strict=False).to_physical()
    digits = zone.str.replace(":", "").str.extract(r"^[+-](\d{4})$", 1).cast(pl.Int64).fill_null(0)
    ahead = (digits // 100 * 3600 + digits % 100 * 60) * (
        1 - 2 * zone.str.starts_with("-").fill_null(False).cast(pl.Int64)
    )
    return stamps - ahead * 1_000_000_000
