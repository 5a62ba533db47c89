"""Card: what each command channel means, its limits, and which column is what (TOML)."""

import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from rotorfit.errors import CardError
from rotorfit.frames import AXES, UNIT_SCALE, Array
from rotorfit.log import Column, Log, Table

Choice = TypeVar("Choice", bound=str | bool)


@dataclass(frozen=True)
class Channel:
    """Where one quantity comes from: (raw * scale + offset), then the unit.

    Attributes:
        source: `TABLE:COLUMN`, `COLUMN`, `COLUMN[i]`, or a constant number.
        scale: Factor on the raw value.
        offset: Added after the factor.
        unit: One of the names in `frames.UNIT_SCALE`, or None where the value is SI or a fraction.
        meaning: For commands: `tilt`, `velocity`, `vertical_speed` or `yaw_rate`; None where the card does not say.
        full_scale: For commands: the limit (a key of `Card.limits`) that the value is a fraction of.
        others: What stands in its place in other versions of the same format, in the order of asking; the first of
            all of them that a log holds is read: `card_for`.
    """

    source: str | float
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    meaning: str | None = None
    full_scale: str | None = None
    others: tuple["Channel", ...] = ()


@dataclass(frozen=True)
class Condition:
    """One thing that must hold while commands count.

    Attributes:
        channel: The column that tells.
        equals: It holds while the column is one of these; empty with all else empty: while it is not 0.
        above: It holds while the column is more than this; None where that is not asked.
        opens: For events: it holds from an event of one of these numbers,
        closes: until one of these.
        optional: Whether logs without the column are taken without the condition.
    """

    channel: Channel
    equals: tuple[float, ...] = ()
    above: float | None = None
    opens: tuple[float, ...] = ()
    closes: tuple[float, ...] = ()
    optional: bool = False


@dataclass(frozen=True)
class Prior:
    """What is believed of a coefficient before a flight: its mean and standard deviation, SI per command of 1."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Card:
    """A vehicle and its set-up.

    Attributes:
        name: For people.
        frame: Of the pose: `ENU` (z up) or `NED`.
        command_frame: `heading` or `world`.
        hold: Longest time that a command acts without a successor [s]; None for three median periods.
        command_time: Stamp of the commands.
        command: Axis name to channel, for the commanded axes only.
        pose_time: Stamp of the poses.
        pose: `x`, `y`, `z`, and `yaw` or the four of `qw`, `qx`, `qy`, `qz`. x and y together, or z, are left out where
            there is only their velocity.
        velocity: Optional onboard velocity, `x`, `y`, `z`, `yaw` to channel; with `velocity_frame`.
        velocity_time: Its stamp; None for that of the table it stands in.
        velocity_independent: Whether the velocity is a measurement of its own, beside the pose: neither came from the
            other.
        attitude: Optional onboard heading: `yaw`, or the four of `qw`, `qx`, `qy`, `qz`.
        attitude_time: Its stamp; None likewise.
        clock: Of a flight in several files: `own`, each file has its own, or `one`, all have the same.
        reference: Optional: what a position controller was told.
        window: Optional conditions (armed, in the air, under velocity control): commands count while all hold.
        resets: Optional counters that move where an estimator steps its own pose: the flight is split there.
        limits: `tilt` [rad], `vertical_speed` [m/s], `yaw_rate` [rad/s], `speed` [m/s], as far as known.
        prior: Axis to coefficient (`input`, `damping`, `delay`) to what is believed of it; used only where asked for.
        raw: The whole card as parsed from TOML: what the model file stores.
        fail_safe: What the vehicle does by itself when commands stop, for people; empty where the card does not say.
        over: Built-in cards that are not proposed where this one makes a flight of the log, too.
    """

    name: str
    frame: Literal["ENU", "NED"]
    command_frame: Literal["heading", "world"]
    hold: float | None
    command_time: Channel
    command: Mapping[str, Channel]
    pose_time: Channel
    pose: Mapping[str, Channel]
    velocity: Mapping[str, Channel] = field(default_factory=dict)
    velocity_frame: Literal["heading", "world"] = "world"
    velocity_independent: bool = False
    reference: Mapping[str, Channel] = field(default_factory=dict)
    window: tuple[Condition, ...] = ()
    resets: tuple[Channel, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    prior: Mapping[str, Mapping[str, Prior]] = field(default_factory=dict)
    raw: Mapping[str, Any] = field(default_factory=dict)
    velocity_time: Channel | None = None
    attitude: Mapping[str, Channel] = field(default_factory=dict)
    attitude_time: Channel | None = None
    clock: Literal["own", "one"] = "own"
    fail_safe: str = ""
    over: tuple[str, ...] = ()

    @property
    def velocity_only(self) -> tuple[str, ...]:
        """The axes of which there is a velocity and no pose, in the order of `AXES`."""
        return tuple(axis for axis in ("x", "y", "z") if axis not in self.pose)


_MEANINGS = ("tilt", "velocity", "vertical_speed", "yaw_rate")
_LENGTH, _SPEED, _ANGLE, _RATE = ("m", "cm", "mm"), ("m/s", "cm/s"), ("rad", "deg"), ("rad/s", "deg/s")
_STAMP, _ANY = ("s", "ms", "us", "ns"), tuple(UNIT_SCALE)
LIMIT_UNITS = {"tilt": _ANGLE, "vertical_speed": _SPEED, "yaw_rate": _RATE, "speed": _SPEED}
"""Limit to the units that it may be given in, SI first."""

_LIMITS = tuple(LIMIT_UNITS)
_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "command": ("frame", "hold", "time", *AXES),
    "pose": ("time", *AXES, "quaternion", "resets"),
    "velocity": ("frame", "time", "independent", *AXES),
    "attitude": ("time", "yaw", "quaternion"),
    "reference": AXES,
    "window": ("when", "equals", "above", "opens", "closes", "optional"),
    "limits": _LIMITS,
    "prior": AXES,
}
_POSE_UNITS = {"x": _LENGTH, "y": _LENGTH, "z": _LENGTH, "yaw": _ANGLE}
_VELOCITY_UNITS = {"x": _SPEED, "y": _SPEED, "z": _SPEED, "yaw": _RATE}


def load_card(name_or_path: str) -> Card:
    """Loads a built-in card by its name, or a card from a TOML file.

    Args:
        name_or_path: Name as `builtin_cards` lists them, or path of a TOML file.

    Returns:
        The card, checked.

    Raises:
        CardError: Neither a name nor a file; not TOML; or what `card_from_mapping` refuses.
    """
    built_in = builtin_cards()
    if name_or_path in built_in:
        return built_in[name_or_path]
    path = Path(name_or_path)
    if not path.is_file():
        raise CardError(
            f"no card {name_or_path!r}: neither a file nor a built-in name{_nearest(name_or_path, built_in)} "
            "(`rotorfit cards` lists them)"
        )
    try:
        return card_from_mapping(tomllib.loads(path.read_text(encoding="utf-8")), name_or_path)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise CardError(f"card {name_or_path}: not readable as TOML: {' '.join(str(err).split())}") from err


def builtin_cards() -> dict[str, Card]:
    """All cards that ship with rotorfit, by name, sorted."""
    files = (entry for entry in resources.files("rotorfit").joinpath("cards").iterdir() if entry.name.endswith(".toml"))
    texts = {entry.name.removesuffix(".toml"): entry.read_text(encoding="utf-8") for entry in files}
    return {name: card_from_mapping(tomllib.loads(texts[name]), name) for name in sorted(texts)}


def builtin_card_text(name: str) -> str:
    """The TOML text of a built-in card.

    Raises:
        CardError: There is none of that name; the nearest is named.
    """
    known = builtin_cards()
    if name not in known:
        nearest = get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise CardError(f"no built-in card {name!r}; nearest: {nearest!r} (`rotorfit cards` lists them)")
    return resources.files("rotorfit").joinpath("cards", f"{name}.toml").read_text(encoding="utf-8")


def card_from_mapping(raw: Mapping[str, Any], where: str) -> Card:
    """Checks a card as parsed from TOML or as stored in a model file.

    Args:
        raw: The sections and keys of a card.
        where: File or name, for the error's text.

    Returns:
        The card; its `raw` is the argument.

    Raises:
        CardError: A key that nobody knows (the nearest is named), a wrong type, an unknown unit or meaning, or one of
            `[command]`, `[pose]` and their essential keys is missing.
    """
    place = f"card {where}"
    _check_keys(raw, ("name", "frame", "clock", "fail_safe", "over", *_SECTIONS), place)
    sections = {key: _section(raw, key, place) for key in _SECTIONS if key != "window"}
    missing = [key for key in ("command", "pose") if key not in raw]
    if missing:
        raise CardError(f"{place}: section [{missing[0]}] is missing")
    command, pose, velocity, attitude = (sections[key] for key in ("command", "pose", "velocity", "attitude"))
    in_command, in_pose = f"{place}, [command]", f"{place}, [pose]"
    commands = {axis: _channel(command[axis], f"{in_command} {axis}", _ANY, True) for axis in AXES if axis in command}
    if not commands:
        raise CardError(f"{in_command}: no axis is commanded; name a column for at least one of x, y, z, yaw")
    return Card(
        name=_text(raw.get("name", where), f"{place}, name"),
        frame=_choice(raw.get("frame", "ENU"), ("ENU", "NED"), f"{place}, frame"),
        command_frame=_choice(command.get("frame", "heading"), ("heading", "world"), f"{in_command} frame"),
        hold=_positive(command["hold"], f"{in_command} hold") if "hold" in command else None,
        command_time=_recorded(command, "time", _STAMP, in_command),
        command=commands,
        pose_time=_recorded(pose, "time", _STAMP, in_pose),
        pose=_pose(pose, velocity, in_pose),
        velocity=_channels(velocity, _VELOCITY_UNITS, f"{place}, [velocity]"),
        velocity_frame=_choice(velocity.get("frame", "world"), ("heading", "world"), f"{place}, [velocity] frame"),
        velocity_independent=_yes_or_no(velocity.get("independent", False), f"{place}, [velocity] independent"),
        reference=_channels(sections["reference"], dict.fromkeys(AXES, _ANY), f"{place}, [reference]"),
        window=_window(raw.get("window", []), place),
        resets=_resets(pose.get("resets", []), in_pose),
        limits={key: _limit(key, value, f"{place}, [limits] {key}") for key, value in sections["limits"].items()},
        prior={axis: _priors(value, f"{place}, [prior] {axis}") for axis, value in sections["prior"].items()},
        raw=raw,
        velocity_time=_recorded(velocity, "time", _STAMP, f"{place}, [velocity]") if "time" in velocity else None,
        attitude=_heading(attitude, f"{place}, [attitude]") if attitude else {},
        attitude_time=_recorded(attitude, "time", _STAMP, f"{place}, [attitude]") if "time" in attitude else None,
        clock=_choice(raw.get("clock", "own"), ("own", "one"), f"{place}, clock"),
        fail_safe=_text(raw["fail_safe"], f"{place}, fail_safe") if "fail_safe" in raw else "",
        over=tuple(_text(name, f"{place}, over") for name in raw.get("over", [])),
    )


def tables_of(card: Card) -> frozenset[str] | None:
    """Names of the tables that a card reads; None where it names columns of whichever table a log has."""
    parts = (card.command, card.pose, card.velocity, card.attitude, card.reference)
    channels = [card.command_time, card.pose_time, *(channel for part in parts for channel in part.values())]
    channels += [each for each in (card.velocity_time, card.attitude_time) if each]
    channels += [*(part.channel for part in card.window), *card.resets]
    channels += [other for channel in channels for other in channel.others]
    tables = {split_source(channel.source)[0] for channel in channels if isinstance(channel.source, str)}
    return None if any(not table or "*" in table for table in tables) else frozenset(tables)


def fitting_cards(log: Log) -> dict[str, Card]:
    """The built-in cards, by name, whose columns are all in the log."""
    return {name: card for name, card in builtin_cards().items() if fits(log, card)}


def card_for(log: Log, card: Card) -> Card:
    """The card with each column by the name that it has in this log, and without optional conditions that it lacks.

    Args:
        log: Where the columns are.
        card: What may name alternatives (`yaw = ["new:name", "old:name"]`), and tables by a pattern (`/vicon/*/*`),
            which stands for the one table that it describes.
    """
    log_tables = (*log.tables, *log.skipped)

    def bare(channel: Channel) -> Channel:
        table, name = split_source(channel.source)
        there = [one for one in log_tables if fnmatchcase(one, table)] if "*" in table else []
        return replace(channel, source=f"{there[0]}:{name}", others=()) if len(there) == 1 else channel

    def named(channel: Channel) -> Channel:
        if not channel.others:
            return bare(channel)
        known = (one for one in map(bare, (channel, *channel.others)) if _holds(log, one.source))
        return replace(next(known, channel), others=())

    def all_named(channels: Mapping[str, Channel]) -> dict[str, Channel]:
        return {key: named(channel) for key, channel in channels.items()}

    window = [replace(part, channel=named(part.channel)) for part in card.window]
    return replace(
        card,
        command_time=named(card.command_time),
        command=all_named(card.command),
        pose_time=named(card.pose_time),
        pose=all_named(card.pose),
        velocity=all_named(card.velocity),
        velocity_time=named(card.velocity_time) if card.velocity_time else None,
        attitude=all_named(card.attitude),
        attitude_time=named(card.attitude_time) if card.attitude_time else None,
        reference=all_named(card.reference),
        window=tuple(part for part in window if not part.optional or _holds(log, part.channel.source)),
        resets=tuple(named(channel) for channel in card.resets),
    )


def _holds(log: Log, source: str | float) -> bool:
    """Whether a log has a column of numbers of that name; constants are always there."""
    if not isinstance(source, str):
        return True
    try:
        raw_column(log, source)
    except CardError:
        return False
    return True


def fits(log: Log, card: Card) -> bool:
    """Whether all columns of a card are in a log."""
    card = card_for(log, card)
    others = [*card.velocity.values(), *card.attitude.values(), *card.reference.values()]
    others += [*(part.channel for part in card.window), *card.resets]
    others += [one for one in (card.velocity_time, card.attitude_time) if one]
    try:
        for time, channels in ((card.command_time, card.command), (card.pose_time, card.pose)):
            table, count = split_source(time.source)[0], len(raw_column(log, time.source)[1])
            for channel in channels.values():
                beside = split_source(channel.source)[0] == table
                column(log, channel, count if beside or not isinstance(channel.source, str) else None)
        for channel in others:
            column(log, channel)
    except CardError:
        return False
    return True


def column(log: Log, channel: Channel, count: int | None = None) -> Array:
    """Values of a channel: (raw * scale + offset), then the unit to SI.

    Args:
        log: Where the columns are.
        channel: Which one, and how to read it.
        count: Number of stamps that go with it; tells the time axis of a matrix (for `NAME[i]`) and the length of a
            constant. None takes the longer axis, and one sample.

    Returns:
        Shape (N,), float64, SI or the fraction that the card says. N may differ from `count`.

    Raises:
        CardError: Table, column or row is not there (the nearest is named), or it holds no numbers.
    """
    if isinstance(channel.source, str):
        raw = raw_column(log, channel.source, count)[1].astype(np.float64)
    else:
        raw = np.full(1 if count is None else count, float(channel.source))
    factor = 1.0 if channel.unit is None else UNIT_SCALE[channel.unit]
    if (channel.scale, channel.offset, factor) == (1.0, 0.0, 1.0):
        return raw
    return (raw * channel.scale + channel.offset) * factor


def raw_column(log: Log, source: str | float, count: int | None = None) -> tuple[str, Column]:
    """A column as it was recorded.

    Args:
        log: Where the columns are.
        source: `TABLE:COLUMN`, `COLUMN` where the log has one table, or a row `NAME[i]`.
        count: As in `column`.

    Returns:
        The column's name without its table, and its values, shape (N,), of any real type.

    Raises:
        CardError: As `column`.
    """
    if not isinstance(source, str):
        raise CardError(f"{log.path}: a constant ({source:g}) stands where a column is needed")
    table, name = table_of(log, source)
    row = re.fullmatch(r"(.+)\[(\d+)\]", name)
    if name in table.columns:
        values = _vector(table.columns[name], f"{log.path}: {source}")
    elif row and row[1] in table.columns:
        values = _row(table.columns[row[1]], int(row[2]), count, f"{log.path}: {source}")
    else:
        raise CardError(f"{log.path}: no column {name!r} in {table.name!r}{_nearest(name, table.columns)}")
    if values.dtype.kind not in "biuf":
        raise CardError(f"{log.path}: {source} holds no numbers (type {values.dtype})")
    return name, values


def split_source(source: str | float) -> tuple[str, str]:
    """Table and column of `TABLE:COLUMN`, split at the first colon; no table, "", where there is none."""
    table, colon, name = str(source).partition(":")
    return (table, name) if colon else ("", table)


def table_of(log: Log, source: str) -> tuple[Table, str]:
    """The table that a source names, and the column's name in it.

    Raises:
        CardError: There is no such table (the nearest is named), or none is named and there are several.
    """
    only = next(iter(log.tables.values())) if len(log.tables) == 1 else None
    head, tail = split_source(source)
    if only is not None and (not head or source in only.columns):
        return only, source
    if head in log.tables:
        return log.tables[head], tail
    if head in log.skipped:
        raise CardError(f"{log.path}: table {head!r} was not decoded: {log.skipped[head]}")
    if head:
        raise CardError(
            f"{log.path}: no table {head!r}{_nearest(head, [*log.tables, *log.skipped])} (`rotorfit info` lists them)"
        )
    holders = [table.name for table in log.tables.values() if source in table.columns] or list(log.tables) or ["TABLE"]
    raise CardError(f"{log.path}: {source!r} names no table of the {len(log.tables)}; write '{holders[0]}:{source}'")


def _vector(values: Column, what: str) -> Column:
    """A column that is one series, shape (N,)."""
    if values.ndim == 1 or (values.ndim == 2 and 1 in values.shape):
        return values.ravel()
    raise CardError(f"{what} has the shape {values.shape}, not one series; name a row, as in NAME[0]")


def _row(values: Column, row: int, count: int | None, what: str) -> Column:
    """Row `row` of a matrix whose time axis is the one as long as its clock, give or take one sample."""
    matrix = values[np.newaxis] if values.ndim == 1 else values
    if matrix.ndim != 2:
        raise CardError(f"{what}: shape {values.shape} is not a matrix")
    surplus = [abs(n - (max(matrix.shape) if count is None else count)) for n in matrix.shape]
    if min(surplus) > 1:
        raise CardError(f"{what}: no axis of {matrix.shape} is as long as its time ({count})")
    by_row: Column = matrix if surplus[1] <= surplus[0] else matrix.T
    if row >= len(by_row):
        raise CardError(f"{what}: row {row} of {len(by_row)} (rows count from 0)")
    series: Column = by_row[row]
    return series


def _nearest(name: str, known: Iterable[str]) -> str:
    """` (nearest: 'this')`, or nothing where nothing is known."""
    by_lower = {option.lower(): option for option in known}
    match = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.0)
    return f"; nearest: {by_lower[match[0]]!r}" if match else ""


def _check_keys(raw: Mapping[str, Any], known: Iterable[str], place: str) -> None:
    for key in raw:
        if key not in known:
            raise CardError(f"{place}: unknown key {key!r}{_nearest(key, known)}")


def _section(raw: Mapping[str, Any], key: str, place: str) -> Mapping[str, Any]:
    return _checked(raw.get(key, {}), key, place)


def _checked(section: Any, key: str, place: str) -> Mapping[str, Any]:
    if not isinstance(section, Mapping):
        raise CardError(f"{place}, {key}: must be a section [{key}], not {section!r}")
    _check_keys(section, _SECTIONS[key], f"{place}, [{key}]")
    return section


def _text(value: Any, place: str) -> str:
    if not isinstance(value, str) or not value:
        raise CardError(f"{place}: must be a text, not {value!r}")
    return value


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CardError(f"{place}: must be a finite number, not {value!r}")
    return float(value)


def _positive(value: Any, place: str) -> float:
    if _number(value, place) <= 0:
        raise CardError(f"{place}: must be positive, not {value!r}")
    return float(value)


def _yes_or_no(value: Any, place: str) -> bool:
    if not isinstance(value, bool):
        raise CardError(f"{place}: must be true or false, not {value!r}")
    return value


def _choice(value: Any, known: tuple[Choice, ...], place: str) -> Choice:
    for option in known:
        if value == option:
            return option
    nearest = _nearest(value, [str(option) for option in known]) if isinstance(value, str) else ""
    raise CardError(f"{place}: {value!r} is not one of {', '.join(str(option) for option in known)}{nearest}")


def _channel(value: Any, place: str, units: tuple[str, ...], command: bool = False) -> Channel:
    """A channel from a string, a number, `{ from, scale, offset, unit }`, or a list; commands also have a meaning."""
    if isinstance(value, list):  # what it is called in different versions of a format
        if not value:
            raise CardError(f"{place}: an empty list names no column")
        first, *others = (_channel(one, place, units, command) for one in value)
        return replace(first, others=tuple(others))
    if not isinstance(value, Mapping):
        return Channel(_source(value, place))
    _check_keys(value, ("from", "scale", "offset", "unit", *(("meaning", "full_scale") if command else ())), place)
    if "from" not in value:
        raise CardError(f"{place}: from is missing: which column?")
    return Channel(
        source=_source(value["from"], f"{place}.from"),
        scale=_number(value.get("scale", 1.0), f"{place}.scale"),
        offset=_number(value.get("offset", 0.0), f"{place}.offset"),
        unit=_choice(value["unit"], units, f"{place}.unit") if "unit" in value else None,
        meaning=_choice(value["meaning"], _MEANINGS, f"{place}.meaning") if "meaning" in value else None,
        full_scale=_choice(value["full_scale"], _LIMITS, f"{place}.full_scale") if "full_scale" in value else None,
    )


def _source(value: Any, place: str) -> str | float:
    if isinstance(value, str) and value:
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CardError(f"{place}: must be a column's name or a number, not {value!r}")
    return _number(value, place)


def _channels(raw: Mapping[str, Any], units: Mapping[str, tuple[str, ...]], place: str) -> dict[str, Channel]:
    return {axis: _channel(raw[axis], f"{place} {axis}", units[axis]) for axis in AXES if axis in raw}


def _recorded(section: Mapping[str, Any], key: str, units: tuple[str, ...], place: str) -> Channel:
    """A channel that must be there and cannot be a constant: a clock, the window."""
    if key not in section:
        raise CardError(f"{place}: {key} is missing: which column?")
    channel = _channel(section[key], f"{place} {key}", units)
    if not isinstance(channel.source, str):
        raise CardError(f"{place} {key}: must be a column, not the constant {channel.source:g}")
    return channel


def _window(value: Any, place: str) -> tuple[Condition, ...]:
    """The conditions of `[window]`, or of several `[[window]]`."""
    parts = value if isinstance(value, list) else [value]
    return tuple(_condition(_checked(part, "window", place), f"{place}, [window]") for part in parts)


def _condition(section: Mapping[str, Any], place: str) -> Condition:
    condition = Condition(
        channel=_recorded(section, "when", _ANY, place),
        equals=_numbers(section.get("equals", []), f"{place} equals"),
        above=_number(section["above"], f"{place} above") if "above" in section else None,
        opens=_numbers(section.get("opens", []), f"{place} opens"),
        closes=_numbers(section.get("closes", []), f"{place} closes"),
        optional=_choice(section.get("optional", False), (True, False), f"{place} optional"),
    )
    asked = (bool(condition.equals), condition.above is not None, bool(condition.opens or condition.closes))
    if sum(asked) > 1:
        raise CardError(f"{place}: give one of equals, above, and opens with closes; write a [[window]] for each")
    if bool(condition.opens) != bool(condition.closes):
        raise CardError(f"{place}: opens and closes go together: which events begin the flight, and which end it?")
    return condition


def _numbers(value: Any, place: str) -> tuple[float, ...]:
    return tuple(_number(one, place) for one in (value if isinstance(value, list) else [value]))


def _resets(value: Any, place: str) -> tuple[Channel, ...]:
    names = value if isinstance(value, list) else [value]
    return tuple(_recorded({"resets": name}, "resets", (), place) for name in names)


def _pose(section: Mapping[str, Any], velocity: Mapping[str, Any], place: str) -> dict[str, Channel]:
    """x, y, z, and yaw or qw, qx, qy, qz; x with y, or z, may be missing where there is their velocity."""
    heading = _heading(section, place)
    missing = [axis for axis in ("x", "y", "z") if axis not in section]
    unknown = [axis for axis in missing if axis not in velocity]
    if unknown:
        raise CardError(
            f"{place}: {unknown[0]} is missing; name its column, or a constant where it was not measured, or its "
            "velocity in [velocity]"
        )
    if ("x" in section) != ("y" in section):
        raise CardError(f"{place}: {missing[0]} is missing; x and y go together: name both, or neither")
    return _channels(section, _POSE_UNITS, place) | heading


def _heading(section: Mapping[str, Any], place: str) -> dict[str, Channel]:
    """yaw, or qw, qx, qy, qz."""
    if ("yaw" in section) == ("quaternion" in section):
        raise CardError(f"{place}: name either yaw or quaternion, and not both")
    if "yaw" in section:
        return {"yaw": _channel(section["yaw"], f"{place} yaw", _ANGLE)}
    value = section["quaternion"]
    names = [f"{value}.{part}" for part in "wxyz"] if isinstance(value, str) else value
    if not isinstance(names, list) or len(names) != 4:
        raise CardError(f"{place} quaternion: must be a prefix or four names in the order w, x, y, z, not {value!r}")
    parts = zip("wxyz", names, strict=True)
    return {f"q{part}": Channel(_text(name, f"{place} quaternion")) for part, name in parts}


def _limit(key: str, value: Any, place: str) -> float:
    """A limit in SI, from a number or `{ value, unit }`."""
    limit = _limit_in_si(key, value, place)
    if key == "tilt" and limit >= math.pi / 2:
        raise CardError(f"{place}: {value!r} is no tilt below 90 deg; a number alone is rad, unit = 'deg' says degrees")
    return limit


def _limit_in_si(key: str, value: Any, place: str) -> float:
    if not isinstance(value, Mapping):
        return _positive(value, place)
    _check_keys(value, ("value", "unit"), place)
    if "value" not in value:
        raise CardError(f"{place}: key 'value' is missing")
    unit = _choice(value.get("unit", LIMIT_UNITS[key][0]), LIMIT_UNITS[key], f"{place}.unit")
    return _positive(value["value"], f"{place}.value") * UNIT_SCALE[unit]


def _priors(value: Any, place: str) -> dict[str, Prior]:
    """What is believed of one axis."""
    if not isinstance(value, Mapping):
        raise CardError(f"{place}: must be coefficients, as in {{ input = {{ mean = 4.0, sd = 0.5 }} }}, not {value!r}")
    _check_keys(value, ("input", "damping", "delay"), place)
    return {name: _prior(name, one, f"{place}.{name}") for name, one in value.items()}


def _prior(name: str, value: Any, place: str) -> Prior:
    if not isinstance(value, Mapping):
        raise CardError(f"{place}: must be {{ mean = ..., sd = ... }}, not {value!r}")
    _check_keys(value, ("mean", "sd"), place)
    missing = [key for key in ("mean", "sd") if key not in value]
    if missing:
        raise CardError(f"{place}: key {missing[0]!r} is missing")
    number = _positive if name == "damping" else _number
    return Prior(number(value["mean"], f"{place}.mean"), _positive(value["sd"], f"{place}.sd"))
