"""Survey: what is in a log, which card fits, what the flight excites; and the draft of a card."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np

from rotorfit.card import Card, Channel, card_that_fits, column, fitting_cards
from rotorfit.clock import (
    ClockDrift,
    ClockRelation,
    Rate,
    degrees_for_radians,
    drift,
    increasing,
    rate,
    relation,
    stamps_of,
)
from rotorfit.errors import CardError, FlightError
from rotorfit.flight import Flight, Note, flight_from_log
from rotorfit.frames import AXES, Array
from rotorfit.log import Column, Log, Table


@dataclass(frozen=True)
class TableSurvey:
    """One table of a log.

    Attributes:
        name: As in the log.
        columns: Names, with the shape behind matrices: `SS (6 x 19780)`.
        count: Samples.
        time: Column taken for its clock; None where nothing looks like one.
        rate: Of that clock.
    """

    name: str
    columns: tuple[str, ...]
    count: int
    time: str | None
    rate: Rate | None


@dataclass(frozen=True)
class Excitation:
    """How one command moves, weighted by how long each value is held, in the unit that the card leaves it in.

    Attributes:
        axis: One of `AXES`.
        nonzero_share: Share of time in which it is not 0.
        rms: Root mean square.
        low: Smallest value.
        high: Largest value.
        levels: Distinct values.
        extreme_share: Share of time at the smallest or the largest value: saturation, where there are many levels.
        bandwidth: Frequency below which 95 % of its power about the mean lies [Hz]; None for a constant.
    """

    axis: str
    nonzero_share: float
    rms: float
    low: float
    high: float
    levels: int
    extreme_share: float
    bandwidth: float | None


@dataclass(frozen=True)
class FlightSurvey:
    """What a card makes of a log.

    Attributes:
        duration: Length of the segments together [s].
        segments: Start and end of each [s].
        command: Rate of the commands as recorded.
        pose: Rate of the poses as recorded.
        fresh: Rate of the fresh poses in the flight.
        stale_share: Share of the recorded poses that repeat the one before.
        clocks: The poses' clock against the commands'.
        recorder: `command` and `pose` to the recorder's `log_time` against the `header.stamp`, where both exist.
        axes: Excitation of each commanded axis.
        notes: Repairs.
    """

    duration: float
    segments: tuple[tuple[float, float], ...]
    command: Rate
    pose: Rate
    fresh: Rate
    stale_share: float
    clocks: ClockRelation
    recorder: Mapping[str, ClockDrift]
    axes: tuple[Excitation, ...]
    notes: tuple[Note, ...]


@dataclass(frozen=True)
class Survey:
    """What is in a log.

    Attributes:
        path: As given.
        format: Name of the format.
        tables: In the order of the log.
        skipped: Tables that were not decoded, with the reason.
        notes: What was lost or recovered on reading.
        fitting: Names of the built-in cards whose columns are all there.
        card: What the card that was applied calls itself; None where none was given and not exactly one fits.
        flight: What it makes of the log; None where no card fits or there is no usable flight.
        problem: Why there is no card or no flight, one line.
    """

    path: str
    format: str
    tables: tuple[TableSurvey, ...]
    skipped: Mapping[str, str]
    notes: tuple[str, ...]
    fitting: tuple[str, ...]
    card: str | None
    flight: FlightSurvey | None
    problem: str | None


def survey(log: Log, card: Card | None = None) -> Survey:
    """Looks through a log.

    Args:
        log: As recorded.
        card: To apply; None for the built-in card that fits, if there is one.

    Raises:
        CardError: The card that was given does not fit.
    """
    flight, problem = None, None
    try:
        card = card or card_that_fits(log)
    except CardError as err:
        problem = str(err)
    if card is not None:
        try:
            flight = _flight_survey(log, card, flight_from_log(log, card))
        except FlightError as err:
            problem = str(err)
    return Survey(
        path=str(log.path),
        format=log.format,
        tables=tuple(_table_survey(log, table, card) for table in log.tables.values()),
        skipped=log.skipped,
        notes=log.notes,
        fitting=tuple(fitting_cards(log)),
        card=None if card is None else card.name,
        flight=flight,
        problem=problem,
    )


def excitation(flight: Flight) -> tuple[Excitation, ...]:
    """How each commanded axis of a flight is excited."""
    starts, ends = (np.array([getattr(part, end) for part in flight.segments]) for end in ("start", "end"))
    time = flight.command_time
    until = np.minimum(np.append(time[1:], np.inf), ends[np.searchsorted(starts, time, side="right") - 1])
    columns = {axis: flight.command[:, AXES.index(axis)] for axis in flight.axes}
    return tuple(_excitation(axis, values, until - time, time) for axis, values in columns.items())


def _excitation(axis: str, values: Array, weight: Array, time: Array) -> Excitation:
    low, high = float(np.min(values)), float(np.max(values))
    at_end = ((values == low) | (values == high)) & (low < high)
    return Excitation(
        axis=axis,
        nonzero_share=float(np.sum(weight[values != 0]) / np.sum(weight)),
        rms=float(np.sqrt(np.sum(weight * values**2) / np.sum(weight))),
        low=low,
        high=high,
        levels=len(np.unique(values)),
        extreme_share=float(np.sum(weight[at_end]) / np.sum(weight)),
        bandwidth=_bandwidth(time, values),
    )


def _bandwidth(time: Array, values: Array) -> float | None:
    """Frequency below which 95 % of the power of held values lies [Hz]."""
    if len(time) < 8 or np.ptp(values) == 0:
        return None
    period = float(np.median(np.diff(time)))
    grid = np.arange(time[0], time[-1], period)
    held = values[np.searchsorted(time, grid + 1e-9, side="right") - 1]
    power = np.cumsum(np.abs(np.fft.rfft(held - np.mean(held))) ** 2)
    if power[-1] == 0:
        return None
    return float(np.fft.rfftfreq(len(grid), period)[np.searchsorted(power, 0.95 * power[-1])])


def _flight_survey(log: Log, card: Card, flight: Flight) -> FlightSurvey:
    command, pose = stamps_of(log, card.command_time), stamps_of(log, card.pose_time)
    stale = sum(note.count for note in flight.notes if note.code == "stale_poses")
    recorder = {"command": _recorder(log, card.command_time), "pose": _recorder(log, card.pose_time)}
    return FlightSurvey(
        duration=flight.duration,
        segments=tuple((part.start, part.end) for part in flight.segments),
        command=rate(command),
        pose=rate(pose),
        fresh=rate(np.round(flight.pose_time * 1e9).astype(np.int64)),
        stale_share=stale / len(pose),
        clocks=relation(command[increasing(command)], pose[increasing(pose)]),
        recorder={name: value for name, value in recorder.items() if value is not None},
        axes=excitation(flight),
        notes=flight.notes,
    )


def _recorder(log: Log, time: Channel) -> ClockDrift | None:
    """Recorder's time against the header's, in the table of a message's stamp."""
    table, _, _ = str(time.source).rpartition(":")
    if table not in log.tables or not {"header.stamp", "log_time"} <= log.tables[table].columns.keys():
        return None
    header, recorded = (stamps_of(log, Channel(f"{table}:{name}")) for name in ("header.stamp", "log_time"))
    return drift(header, recorded)


def _table_survey(log: Log, table: Table, card: Card | None) -> TableSurvey:
    time = _clock(log, table, _count(table))
    for own in (card.command_time, card.pose_time) if card is not None else ():
        if len(log.tables) == 1 or str(own.source).startswith(f"{table.name}:"):
            time = own
    stamps = stamps_of(log, time) if time is not None else None
    return TableSurvey(
        name=table.name,
        columns=tuple(name + _shape(values) for name, values in table.columns.items()),
        count=_count(table) if stamps is None else len(stamps),
        time=None if time is None else str(time.source).removeprefix(f"{table.name}:"),
        rate=None if stamps is None else rate(stamps),
    )


def _count(table: Table) -> int:
    return max((max(values.shape, default=1) for values in table.columns.values()), default=0)


def _shape(values: Column) -> str:
    return "" if values.ndim == 1 or 1 in values.shape else f" ({' x '.join(str(n) for n in values.shape)})"


_COMMAND_FAMILIES = (
    ("(?:cmd_vel|cmd|command)", "(?:v_?)?"),
    ("(?:u|input|ctrl|control)", "(?:v_?)?"),
    ("(?:ref|setpoint|sp|des|desired|target)", "(?:vel_?|v_?)"),  # without a v it is a position that was asked for
)
_TURN_RATE = "yaw|yaw_?rate|psi|psi_?dot|r|w|wz|ang_?z|angular_z"
_FORWARD, _LEFT, _UP = (
    "lin_?x|linear_x|vf|pitch|theta|forward",
    "lin_?y|linear_y|vl|roll|phi|left",
    "lin_?z|linear_z|ve|climb|up",
)
_PLACE = "(?:(?:pose|transform|position|pos|translation|p|mocap|vicon|optitrack|opt|state|odom|drone|body)_?)*"
_POSE = {axis: f"{_PLACE}{axis}|{axis}_?(?:pos|position|opt|mocap|u)" for axis in "xyz"}
_POSE |= {"yaw": f"{_PLACE}(?:yaw|psi|heading)|(?:yaw|psi)_?(?:pos|opt|mocap)"}
_POSE |= {f"q{part}": f"{_PLACE}(?:orientation|rotation|quaternion|quat|q)_?{part}" for part in "wxyz"}
_CLOCKS = ("header_stamp", "log_time", "time", "t", "timestamp", "stamp", "seconds", "secs", "elapsed")
_UNIT_SUFFIX = re.compile(r"_(deg|rad|mm|cm|m|ms|us|ns|s)$")


@dataclass(frozen=True)
class _Stream:
    """What was recognised of the commands or of the pose: quantity to channel, and its clock."""

    channels: Mapping[str, Channel]
    time: Channel | None


def draft_card(log: Log) -> str:
    """The TOML text of a card for a log, guessed from names and values, for the user to correct.

    Where a built-in card fits, it is that card. Else the draft loads as a card if all the essentials were found, and
    says on top which were not.

    Args:
        log: As recorded.

    Returns:
        Text of the card, with what to check in comments; the names of all columns stand at its end.
    """
    for name in fitting_cards(log):
        text = resources.files("rotorfit").joinpath("cards", f"{name}.toml").read_text(encoding="utf-8")
        return f"# A copy of the built-in card {name}, whose columns are all in {log.path.name}.\n{text}"
    commands, pose = _recognised(log, _commands_in), _recognised(log, _pose_in)
    whole = {"qw", "qx", "qy", "qz"} <= pose.channels.keys()
    columns = [(table, name) for table in log.tables.values() for name in table.columns]
    body = [
        f"name = {_quoted(log.path.stem)}",
        'frame = "ENU"  # of the pose; "NED" where z points down',
        "",
        "[command]",
        'frame = "heading"  # "world" where x and y do not turn with the vehicle',
        "# hold = 0.3  # s that a command acts without a successor; default: three median periods",
        _line("time", commands.time),
        *(_line(axis, commands.channels.get(axis)) for axis in AXES),
        '# x = { from = "...", scale = -1, meaning = "tilt", full_scale = "tilt" }  # all that a command can say;',
        "# meaning: tilt, velocity, vertical_speed or yaw_rate; full_scale: the limit that a command of 1 asks for",
        "",
        "[pose]",
        _line("time", pose.time),
        *(_line(axis, pose.channels.get(axis)) for axis in "xyz"),
        _quaternion_line(pose) if whole else _line("yaw", pose.channels.get("yaw")),
        "",
        "# [limits]  # of the vehicle's settings during the flight",
        '# tilt = { value = 10, unit = "deg" }',
        '# vertical_speed = { value = 1, unit = "m/s" }',
        '# yaw_rate = { value = 100, unit = "deg/s" }',
        "",
        f"# All columns of {log.path.name}; a row of a matrix is NAME[0], NAME[1] and so on:",
        *(f"#   {_source(log, table, name)}{_shape(table.columns[name])}" for table, name in columns),
    ]
    return "\n".join([*_heading(log, commands, pose, whole), *body]) + "\n"


def _heading(log: Log, commands: _Stream, pose: _Stream, whole: bool) -> list[str]:
    """What a reader of the draft must know first."""
    found = {
        "[command] time": commands.time is not None,
        "[command] x, y, z or yaw": bool(commands.channels),
        "[pose] time": pose.time is not None,
        **{f"[pose] {axis}": axis in pose.channels for axis in "xyz"},
        "[pose] yaw or quaternion": whole or "yaw" in pose.channels,
    }
    missing = [what for what, there in found.items() if not there]
    return [
        f"# Drafted from the names in {log.path.name}. Check every line, the signs of the commands above all:",
        "# after scale, + must mean forward, left, up, and counter-clockwise seen from above.",
        *(
            [f"# INCOMPLETE: nothing was recognised for {'; '.join(missing)}. Fill in the lines marked EDIT."]
            * bool(missing)
        ),
    ]


def _recognised(log: Log, names_in: Callable[[Log, Table], dict[str, str]]) -> _Stream:
    """The stream of the table in which most is recognised; between equals, of the one with more samples."""
    best: tuple[Table, dict[str, str], int] | None = None
    for table in log.tables.values():
        names = names_in(log, table)
        count = table.columns[next(iter(names.values()))].size if names else 0
        if names and (best is None or (len(names), count) > (len(best[1]), best[2])):
            best = table, names, count
    if best is None:  # a file of matrices: at least its clock
        only = list(log.tables.values())[:1] if len(log.tables) == 1 else []
        return _Stream({}, _clock(log, only[0], _count(only[0])) if only else None)
    table, names, count = best
    time = _clock(log, table, count)
    channels = {what: Channel(_source(log, table, name), unit=_unit(name)) for what, name in names.items()}
    if time is not None and "yaw" in channels and names_in is _pose_in and channels["yaw"].unit is None:
        stamps, yaw = stamps_of(log, time), column(log, channels["yaw"])
        clean = increasing(stamps)[: len(yaw)] & np.isfinite(yaw[: len(stamps)])
        if degrees_for_radians(stamps[: len(yaw)][clean], yaw[: len(stamps)][clean]):
            channels["yaw"] = replace(channels["yaw"], unit="deg")
    return _Stream(channels, time)


def _commands_in(log: Log, table: Table) -> dict[str, str]:
    """Axis to column of the family of names (cmd_x, ux, vx_ref ...) that covers most axes, or of a Twist."""
    twist = {"x": "(?:twist_)?linear_x", "y": "(?:twist_)?linear_y", "z": "(?:twist_)?linear_z"}
    twist |= {"yaw": "(?:twist_)?angular_z"}
    families = [_named(table, _family(word, speed)) for word, speed in _COMMAND_FAMILIES]
    if len(log.tables) > 1 and not _named(table, _POSE).keys() & {"x", "y", "z"}:
        families.append(_named(table, twist))
    return max(families, key=len)


def _family(word: str, speed: str) -> dict[str, str]:
    """Patterns of the axes' names before or after a word that says command."""
    axes = {"x": f"{speed}x|{_FORWARD}", "y": f"{speed}y|{_LEFT}", "z": f"{speed}z|{_UP}", "yaw": _TURN_RATE}
    return {axis: f"{word}_?(?:{names})|(?:{names})_?{word}" for axis, names in axes.items()}


def _pose_in(log: Log, table: Table) -> dict[str, str]:
    """Quantity to column of a pose; none from a topic that is named as a command or a set-point."""
    asked = len(log.tables) > 1 and re.search("cmd|command|setpoint|target|goal|desired", table.name.lower())
    return {} if asked else _named(table, _POSE)


def _named(table: Table, patterns: Mapping[str, str]) -> dict[str, str]:
    """Quantity to the shortest name that fits its pattern; columns as long as a clock go before others."""
    found: dict[str, str] = {}
    series = [name for name, values in table.columns.items() if _is_series(values)]
    for name in sorted(series, key=lambda name: (not _clocks_of(table, table.columns[name].size), len(name))):
        plain = _UNIT_SUFFIX.sub("", _plain(name))
        for quantity, pattern in patterns.items():
            if quantity not in found and re.fullmatch(pattern, plain):
                found[quantity] = name
    return found


def _clock(log: Log, table: Table, count: int) -> Channel | None:
    """The column that looks like the clock of `count` samples; its unit from its name or its steps."""
    names = _clocks_of(table, count)
    if not names:
        return None
    time = Channel(_source(log, table, names[0]), unit=_unit(names[0]))
    if time.unit is not None or _plain(names[0]) in _CLOCKS[:2]:
        return time
    steps = np.diff(table.columns[names[0]].astype(np.float64).ravel())
    step = float(np.median(steps[steps > 0]))  # between 1 kHz and 1 Hz in whatever unit
    return replace(time, unit="ns" if step > 1e6 else "us" if step > 1e3 else "ms" if step > 1.5 else None)


def _clocks_of(table: Table, count: int) -> list[str]:
    """Columns that are named as clocks, advance, and go with `count` samples; the likeliest first."""
    names = {_UNIT_SUFFIX.sub("", _plain(name)): name for name, values in table.columns.items() if _is_series(values)}
    likely = [names[clock] for clock in _CLOCKS if clock in names]
    fitting = [name for name in likely if abs(table.columns[name].size - count) <= 1]
    return [name for name in fitting if np.any(np.diff(table.columns[name].ravel().astype(np.float64)) > 0)]


def _is_series(values: Column) -> bool:
    return values.dtype.kind in "iuf" and values.size > 1 and values.size == max(values.shape)


def _plain(name: str) -> str:
    """Lower case with underscores: `cmdVel.linear.x` becomes `cmd_vel_linear_x`."""
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()).strip("_")


def _unit(name: str) -> str | None:
    """A unit that a name ends in, where it is not the default of its kind."""
    match = _UNIT_SUFFIX.search(_plain(name))
    return match[1] if match and match[1] not in ("m", "rad", "s") else None


def _source(log: Log, table: Table, name: str) -> str:
    return name if len(log.tables) == 1 else f"{table.name}:{name}"


def _quoted(text: object) -> str:
    return json.dumps(str(text), ensure_ascii=False)


def _line(key: str, channel: Channel | None) -> str:
    if channel is None:
        return f'# {key} = "TABLE:COLUMN"  # EDIT: nothing was recognised'
    if channel.unit is None:
        return f"{key} = {_quoted(channel.source)}"
    return f'{key} = {{ from = {_quoted(channel.source)}, unit = "{channel.unit}" }}  # unit guessed'


def _quaternion_line(pose: _Stream) -> str:
    names = [str(pose.channels[f"q{part}"].source) for part in "wxyz"]
    prefix = names[0].removesuffix(".w")
    if names == [f"{prefix}.{part}" for part in "wxyz"]:
        return f"quaternion = {_quoted(prefix)}"
    return f"quaternion = [{', '.join(_quoted(name) for name in names)}]  # w, x, y, z"
