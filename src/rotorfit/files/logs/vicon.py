"""Vicon CSV from Tracker (objects) and Nexus (trajectories, segments, joints, devices): each section is a table.

A section has its name, its rate [Hz], names above their columns, the axes, the units, then one row for each frame up to
a blank line. It has no clock but its frame numbers: `time` is the frame divided by the rate.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column, Table
from rotorfit.files.logs.content import Content, listed, one_line
from rotorfit.files.logs.csv import NUMBER, UTF8_MARK, cells, columns_below, separator_of, text_of

_BLANK_LINE = re.compile(rb"\n[,;\t \r\"]*(?=\n|\Z)")

_FILLED = re.compile(rb"[^\s,;\"]")

_MOST_SECTIONS, _FASTEST = 32, 1e6

_GLOBAL = re.compile(r"Global Angle( \([^)]*\))? +")

_LENGTH = re.compile(r".*position\.[xyz] (?:m|cm|mm)")
"""Column and unit of a length whose unit is taken from the export."""

_KINDS = {"T": "position", "R": "rotation"}


@dataclass(frozen=True)
class _Section:
    """A section of the file.

    Attributes:
        name: Such as `Objects` or `Trajectories`.
        rate: Row rate [Hz]; 0 where none is given.
        names: Names of the columns.
        units: Units of the columns.
        helical: Objects whose rotation is three numbers.
        separator: Separator of the cells.
        part: Start and end of its rows.
    """

    name: str
    rate: float
    names: list[str]
    units: list[str]
    helical: list[str]
    separator: str
    part: tuple[int, int]


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the head has a name, a rate, names, then a row that begins with `Frame` and `Sub Frame`."""
    lines = head.removeprefix(UTF8_MARK).decode("utf-8", errors="replace").split("\n")[:5]
    return len(lines) == 5 and _axes(lines[3]) is not None


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested sections; columns are `NAME.position.x`, `NAME.rotation.w` and the like.

    Raises:
        LogError: Not UTF-8, no valid section, no frames in any.
    """
    data = text_of(path)
    found: dict[str, Table] = {}
    skipped: dict[str, str] = {}
    notes: list[str] = []
    units: dict[tuple[str, str], str] = {}
    for section in _sections(data, notes):
        if section.name in found or section.name in skipped:
            skipped[f"{section.name} at byte {section.part[0]}"] = "an earlier section has its name"
        elif tables is not None and section.name not in tables:
            skipped[section.name] = "not asked for"
        elif not data[section.part[0] : section.part[1]].strip():
            skipped[section.name] = "holds no frames"
        else:
            found[section.name] = Table(section.name, _columns(path, data, section, notes))
            named = zip(section.names, section.units, strict=False)
            units |= {(section.name, name): unit for name, unit in named if _LENGTH.fullmatch(f"{name} {unit}")}
    if not found and not skipped:
        raise LogError(f"{path}: no section of the Vicon export can be understood; export it again as CSV")
    if not found and tables is None:
        raise LogError(
            f"{path}: {listed(list(skipped))} of the Vicon export holds no frames; check that it was recorded"
        )
    return Content(found, skipped, tuple(notes), units=units)


def _sections(data: bytes, notes: list[str]) -> list[_Section]:
    """The sections of the text, in order."""
    sections: list[_Section] = []
    place = _filled(data, 0)
    while place < len(data):
        lines, start = _lines(data, place)
        axes = _axes(lines[3]) if len(lines) == 5 else None
        if axes is None or len(sections) == _MOST_SECTIONS:
            notes.append(f"{len(data) - place} bytes from byte {place} on are no section of a Vicon export: left out")
            break
        end = _end(data, start)
        sections.append(_section(lines, axes, (start, end)))
        place = _filled(data, end)
    return sections


def _filled(data: bytes, place: int) -> int:
    """Offset of the next non-blank character, from `place` on."""
    found = _FILLED.search(data, place)
    return found.start() if found else len(data)


def _end(data: bytes, start: int) -> int:
    """End of a section's rows: a blank line, unless rows continue after it because damage made it."""
    for blank in _BLANK_LINE.finditer(data, start - 1):
        filled = _filled(data, blank.end())
        line = data[filled : filled + 64].partition(b"\n")[0].decode(errors="replace")
        if not NUMBER.fullmatch(re.split("[,;\t]", line)[0].strip()) or _begins(data, blank.end()):
            return blank.start() + 1
    return len(data)


def _begins(data: bytes, place: int) -> bool:
    """Whether a section begins after a blank line."""
    lines, _ = _lines(data, _filled(data, place))
    return len(lines) >= 4 and _axes(lines[3]) is not None


def _lines(data: bytes, start: int) -> tuple[list[str], int]:
    """The five lines of a section's head, and the offset of the next line."""
    lines: list[str] = []
    while len(lines) < 5 and start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        lines.append(data[start:end].decode())
        start = end + 1
    return lines, min(start, len(data))


def _axes(line: str) -> list[str] | None:
    """Cells of the row of axes; None if it is not one."""
    row = cells(line, separator_of(line))
    return row if [cell.lower() for cell in row[:2]] == ["frame", "sub frame"] else None


def _section(lines: list[str], axes: list[str], part: tuple[int, int]) -> _Section:
    """Builds a section from the five lines of its head."""
    separator = separator_of(lines[3])
    title, rate, names, _, units = ([*cells(line, separator), *[""] * len(axes)][: len(axes)] for line in lines)
    rates = [float(cell.replace(",", ".")) for cell in rate if NUMBER.fullmatch(cell)]
    owner, columns, parts = "", ["frame", "sub_frame"], dict[str, list[str]]()
    for name, axis in list(zip(names, axes, strict=True))[2:]:
        owner = _owner(name) or owner
        columns.append(_column(owner, axis, title[0]) if axis else "")
        parts.setdefault(owner, []).append(axis)
    helical = [name for name, found in parts.items() if {"RX", "RY", "RZ", "TX"} <= set(found) and "RW" not in found]
    return _Section(
        title[0],
        rates[0] if rates and 0 < rates[0] < _FASTEST else 0.0,
        columns,
        units[: len(axes)],
        helical,
        separator,
        part,
    )


def _owner(name: str) -> str:
    """Owner named above columns: `Global Angle (Quaternion) drone:drone` is the object `drone`."""
    bare = _GLOBAL.sub("", name)
    first, colon, second = bare.partition(":")
    return first if colon and first == second else bare


def _column(owner: str, axis: str, section: str) -> str:
    """Name of a column: rotations and positions as in other formats, others unchanged."""
    if re.fullmatch(r"[RT][XYZW]", axis):
        return f"{owner}.{_KINDS[axis[0]]}.{axis[1].lower()}"
    if section == "Trajectories" and re.fullmatch(r"[XYZ]", axis):
        return f"{owner}.position.{axis.lower()}"
    return f"{owner}.{axis}" if owner else axis


def _columns(path: Path, data: bytes, section: _Section, notes: list[str]) -> dict[str, Column]:
    """Columns of a section, `time` first."""
    said: list[str] = []
    columns = columns_below(path, data, section.part, section.names, section.separator, said)
    units = sorted({unit for unit in section.units if unit})
    about = f"{section.rate:g} Hz" if section.rate else "without a rate"
    notes.append(one_line(f"{section.name}: {about}, units {listed(units) or 'not said'}"))
    notes += [f"{section.name}: {text}" for text in said]
    if section.rate and "frame" in columns:
        columns = {"time": _time(columns, section.rate)} | columns
    if section.name == "Objects":  # the segments and joints of Nexus have other angles
        turned = [name for name in section.helical if _add_quaternion(columns, name, _unit(section, name))]
        if turned:
            notes.append(
                f"{section.name}: three angles of {listed(turned)} taken as helical (axis times angle): "
                "NAME.quaternion was computed from them"
            )
    return columns


def _time(columns: dict[str, Column], rate: float) -> Column:
    """Time of each row [s]: its frame and sub frame, at the rate of the rows."""
    frame = columns["frame"].astype(np.float64)
    part = columns["sub_frame"].astype(np.float64) if "sub_frame" in columns else np.zeros_like(frame)
    parts = np.nanmax(part, initial=0.0) + 1  # a device is sampled several times per frame
    return np.asarray((frame * parts + part) / rate)


def _unit(section: _Section, name: str) -> str:
    """Unit of an object's rotation."""
    return section.units[section.names.index(f"{name}.rotation.x")]


def _add_quaternion(columns: dict[str, Column], name: str, unit: str) -> bool:
    """Adds the quaternion of a rotation vector, in radians unless the unit is degrees; False if a column is missing."""
    labels = [f"{name}.rotation.{axis}" for axis in "xyz"]
    if not all(label in columns for label in labels):
        return False
    vector = np.stack([columns[label].astype(np.float64) for label in labels])
    vector = np.radians(vector) if unit.lower().startswith("deg") else vector
    angle = np.sqrt(np.sum(vector**2, axis=0))
    parts = vector * 0.5 * np.sinc(angle / (2 * np.pi))
    columns[f"{name}.quaternion.w"] = np.asarray(np.cos(angle / 2))
    for axis, part in zip("xyz", parts, strict=True):
        columns[f"{name}.quaternion.{axis}"] = np.asarray(part)
    return True
