"""OptiTrack Motive CSV (format 1.2 and later): header rows, then one row for each frame.

Source: https://docs.optitrack.com/motive/data-export/data-export-csv
"""

import re
from collections.abc import Collection
from pathlib import Path

from rotorfit.core.errors import LogError
from rotorfit.core.log import Table
from rotorfit.files.logs.content import Content, one_line
from rotorfit.files.logs.csv import UTF8_MARK, cells, columns_below, separator_of, text_of

_KEY = b"Format Version"

_MOST_HEADER_LINES = 12

_KINDS = {"error per marker": "mean_marker_error"}  # its name before Motive 2

_LENGTHS = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}

_CONSTRAINT = "rigid body marker"  # where a marker should be by the body's pose; the marker itself has the same name


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the first cell is that of Motive's header."""
    return head.removeprefix(UTF8_MARK).lstrip(b'"').startswith(_KEY)


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - an export is one table
    """Reads the one table, named after the file; its columns are `NAME.position.x`, `NAME.rotation.w` and the like.

    Raises:
        LogError: Not UTF-8, no valid header, no frames.
    """
    data = text_of(path)
    header, start = _header(data)
    separator = separator_of(header[0]) if header else ","
    rows = [cells(line, separator) for line in header]
    if len(rows) < 3 or rows[-1][:1] != ["Frame"]:
        raise LogError(
            f"{path}: the header of the Motive export cannot be understood; export it again, header included"
        )
    labels = {row[1].lower(): row for row in rows[:-2] if len(row) > 1 and not row[0]}
    if "name" not in labels:
        raise LogError(f"{path}: the header of the Motive export has no names; export it again, header included")
    width = len(rows[-1])
    types, names, kinds = ((row + [""] * width)[:width] for row in (labels.get("type", []), labels["name"], rows[-2]))
    columns = ["frame", "time"]
    columns += [_column(*parts) for parts in list(zip(types, names, kinds, rows[-1], strict=True))[2:]]
    notes = [_about(rows[0])]
    unit = _LENGTHS.get(_said(rows[0]).get("Length Units", "").lower())
    part = (start, len(data))
    return Content(
        {path.stem: Table(path.stem, columns_below(path, data, part, columns, separator, notes, data[:start]))},
        {},
        tuple(notes),
        units={(path.stem, name): unit for name in columns if unit and re.search(r"position\.[xyz]$", name)},
    )


def _header(data: bytes) -> tuple[list[str], int]:
    """Lines up to the one that begins with `Frame`, without blank ones, and the offset of the next line."""
    lines: list[str] = []
    start = 0
    for _ in range(_MOST_HEADER_LINES):
        end = data.find(b"\n", start)
        if end < 0:
            break
        line, start = data[start:end].decode().strip("\r"), end + 1
        lines += [line] if line.strip(" ,;\t") else []
        if line.lstrip('"').startswith("Frame"):
            return lines, start
    return lines, start


def _column(type_: str, name: str, kind: str, axis: str) -> str:
    """Name of a column; empty where the header gives none."""
    word = _KINDS.get(kind.lower(), kind.lower().replace(" ", "_"))
    if type_.lower() == _CONSTRAINT and word == "position":
        word = "expected_position"
    return ".".join(filter(None, (name, word, axis.lower()))) if name else ""


def _said(first: list[str]) -> dict[str, str]:
    """The keys of the first line and their values."""
    return dict(zip(first[::2], first[1::2], strict=False))


def _about(first: list[str]) -> str:
    """What the first line states about the export; the axes are not in it."""
    said = _said(first)
    parts = {
        "captured": said.get("Capture Start Time", ""),
        "rotation": said.get("Rotation Type", ""),
        "lengths in": said.get("Length Units", ""),
        "coordinates": said.get("Coordinate Space", ""),
        "frames per second": said.get("Export Frame Rate", ""),
    }
    text = ", ".join(f"{what} {value}" for what, value in parts.items() if value)
    return one_line(f"Motive {text}; axes as exported (Y is up unless the export said otherwise)")
