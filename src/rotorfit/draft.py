"""Texts of cards: of a built-in one, and the draft that the names and values of a log give."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib import resources
from pathlib import Path

import numpy as np

from rotorfit.card import Channel, builtin_cards, column, fitting_cards
from rotorfit.clock import degrees_for_radians, increasing, stamps_of
from rotorfit.columns import (
    clock_of,
    clocks_of,
    is_series,
    name_without_unit,
    sample_count,
    shape_text,
    source_of,
    unit_of_name,
)
from rotorfit.errors import CardError
from rotorfit.frames import AXES
from rotorfit.log import Log, Table

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


@dataclass(frozen=True)
class _Stream:
    """What was recognised of the commands or of the pose: quantity to channel, and its clock."""

    channels: Mapping[str, Channel]
    time: Channel | None


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
        text = builtin_card_text(name)
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
        *(f"#   {source_of(log, table, name)}{shape_text(table.columns[name])}" for table, name in columns),
    ]
    return "\n".join([*_heading(log, commands, pose, whole), *body]) + "\n"


def write_draft(log: Log, path: Path) -> None:
    """Writes the draft of a card to a new file.

    Raises:
        CardError: The file exists already: it may be a card that somebody has edited.
    """
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(draft_card(log))
    except FileExistsError:
        raise CardError(f"{path}: exists already and is not overwritten; choose another name or remove it") from None


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
        return _Stream({}, clock_of(log, only[0], sample_count(only[0])) if only else None)
    table, names, count = best
    time = clock_of(log, table, count)
    channels = {what: Channel(source_of(log, table, name), unit=unit_of_name(name)) for what, name in names.items()}
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
    series = [name for name, values in table.columns.items() if is_series(values)]
    for name in sorted(series, key=lambda name: (not clocks_of(table, table.columns[name].size), len(name))):
        plain = name_without_unit(name)
        for quantity, pattern in patterns.items():
            if quantity not in found and re.fullmatch(pattern, plain):
                found[quantity] = name
    return found


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
