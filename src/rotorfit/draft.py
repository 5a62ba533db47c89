"""Texts of cards: of a built-in one, and the draft that names, values and the motion of a log give."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rotorfit.answers import BETTER, Answer, Answers, answers_of
from rotorfit.card import Channel
from rotorfit.card_file import builtin_card_text, card_from_mapping
from rotorfit.columns import shape_text, source_of
from rotorfit.errors import CardError, FlightError
from rotorfit.flight import flight_from_log
from rotorfit.frames import AXES
from rotorfit.log import Log
from rotorfit.proposal import proposal
from rotorfit.recognition import (
    Recognised,
    commands_in,
    is_of_tello,
    is_of_the_body,
    pose_in,
    reference_in,
    velocity_in,
    windows_in,
)

NED_FORMATS = ("ulog", "dataflash", "dataflash_text")
"""Logs of autopilots, whose world is north, east, down."""

_LEADS = {
    "heading": {"x": "forward", "y": "left", "z": "up", "yaw": "counter-clockwise"},
    "world": {"x": "along x (east)", "y": "along y (north)", "z": "up", "yaw": "counter-clockwise"},
}


def draft_card(log: Log) -> str:
    """The TOML text of a card for a log, guessed from names, values and the motion, for the user to correct.

    Where a built-in card fits, it is that card. Else the draft loads as a card if all the essentials were found, and
    says on top which were not. Where the motion tells which way a command leads, the line says so, with axis and sign
    corrected.

    Args:
        log: As recorded.

    Returns:
        Text of the card, with what to check in comments; the names of all columns stand at its end.
    """
    try:
        proposed = proposal(log)
    except CardError:
        proposed = None
    if proposed and proposed.name:
        text = builtin_card_text(proposed.name)
        return f"# A copy of the built-in card {proposed.name}, whose columns are all in {log.path.name}.\n{text}"
    found, told, why = _in_the_better_frame(log, _found(log))
    if told is None:
        return _text(log, found, {}, f"The motion was not asked: {why}." if why else "")
    moved, said = _by_motion(found.commands, told)
    turned = "" if told.frame else " The flight turns too little to tell the heading frame from the world."
    found = replace(found, commands=moved, frame=told.frame or "heading")
    return _text(log, found, said, f"Signs were checked against the motion.{turned}")


@dataclass(frozen=True)
class _Found:
    """What a draft is made of.

    Attributes:
        commands: By their names, later with axes and signs by the motion.
        pose: By its names.
        velocity: The vehicle's own, by its names.
        frame: Of the commands: `heading` or `world`.
        velocity_frame: Likewise.
    """

    commands: Recognised
    pose: Recognised
    velocity: Recognised
    frame: str
    velocity_frame: str

    @property
    def alone(self) -> list[str]:
        """Axes of which there is only a velocity."""
        return [axis for axis in "xyz" if axis in self.velocity.channels and axis not in self.pose.channels]


def _found(log: Log) -> _Found:
    """What the names say."""
    commands, pose = commands_in(log), pose_in(log)
    velocity = velocity_in(log, commands, pose)
    if is_of_tello(log, velocity):
        dm = {axis: replace(channel, scale=10.0, unit="cm/s") for axis, channel in velocity.channels.items()}
        velocity = replace(velocity, channels=dm)
    return _Found(commands, pose, velocity, "heading", "heading" if is_of_the_body(velocity) else "world")


def _in_the_better_frame(log: Log, found: _Found) -> tuple[_Found, Answers | None, str]:
    """What was found, and what the motion says; a velocity without a position in the frame that explains it better.

    Where commands and velocity are in one frame, the motion does not tell which: then it is the heading frame, as
    commands almost always are. The coefficients are the same.
    """
    told, why = _told(log, _text(log, found, {}))
    if told is None or told.frame is None or "x" not in found.alone:
        return found, told, why
    other = replace(found, velocity_frame="world" if found.velocity_frame == "heading" else "heading")
    turned, _ = _told(log, _text(log, other, {}))
    if turned is None:
        return found, told, ""
    allowed = BETTER if told.frame == "heading" else 1 / BETTER
    return (other, turned, "") if _left(turned) < allowed * _left(told) else (found, told, "")


def _left(told: Answers) -> float:
    """What commands leave of the horizontal velocity, as shares of its variance."""
    return sum(1 - answer.explained for name, answer in told.of.items() if name in ("x", "y"))


def _told(log: Log, text: str) -> tuple[Answers | None, str]:
    """What the motion says of the commands of a draft, or why it cannot be asked."""
    try:
        card = card_from_mapping(tomllib.loads(text), "drafted")
    except CardError:
        return None, ""  # incomplete: said on top
    try:
        flight = flight_from_log(log, card)
    except (CardError, FlightError) as error:
        return None, str(error)
    told = answers_of(flight)
    if told.of:
        return told, ""
    if not np.any(np.ptp(flight.command, axis=0)):
        return None, "no command moves"
    return None, f"{flight.duration:.1f} s of commands in {len(flight.segments)} pieces are too few to tell"


def _by_motion(commands: Recognised, told: Answers) -> tuple[Recognised, dict[str, str]]:
    """Commands by the axes and with the signs that the motion tells, and what to say behind each."""
    sure = {name: answer for name, answer in told.of.items() if answer.axis}
    wanted = {name: answer.axis or name for name, answer in sure.items()}
    moved = {name: wanted.get(name, name) for name in commands.channels}
    if len(set(moved.values())) < len(moved):  # two commands on one axis: names decide
        moved = {name: name for name in moved}
    channels, said = {}, {}
    for name, channel in commands.channels.items():
        axis, answer = moved[name], told.of.get(name)
        turned = answer is not None and name in sure and answer.sign < 0 and answer.axis == axis
        channels[axis] = replace(channel, scale=-channel.scale) if turned else channel
        said[axis] = _remark(name, axis, answer, told.frame or "heading")
    return replace(commands, channels=channels), said


def _remark(name: str, axis: str, answer: Answer | None, frame: str) -> str:
    """What the motion says of one command."""
    if answer is None:
        return "does not move in this log: EDIT, sign unknown"
    figures = (
        f"{answer.certainty:.0f} standard errors, {100 * answer.explained:.0f} % explained, {answer.lag:.1f} s late"
    )
    if answer.axis is None:
        return f"EDIT: the motion does not tell the sign ({figures})"
    if answer.axis != axis:
        return f"EDIT: the motion follows it along {answer.axis} ({figures})"
    renamed = f", though it looks like {name}" if name != axis else ""
    return f"+ leads {_LEADS[frame][axis]} by the motion{renamed}: {figures}"


def _text(log: Log, found: _Found, said: Mapping[str, str], checked: str = "") -> str:
    """The draft."""
    commands, pose = found.commands, found.pose
    columns = [(table, name) for table in log.tables.values() for name in table.columns]
    reference = reference_in(log, commands)
    body = [
        f"name = {_quoted(log.path.stem)}",
        _frame_line(log, found.velocity),
        "",
        "[command]",
        f'frame = "{found.frame}"  # "world" where x and y do not turn with the vehicle',
        "# hold = 0.3  # s that a command acts without a successor; default: three median periods",
        _line("time", commands.time),
        *(_line(axis, commands.channels.get(axis), said.get(axis, "")) for axis in AXES),
        '# x = { from = "...", scale = -1, meaning = "tilt", full_scale = "tilt" }  # all that a command can say;',
        "# meaning: tilt, velocity, vertical_speed or yaw_rate; full_scale: the limit that a command of 1 asks for",
        "",
        "[pose]",
        *(["# Motive has y up: the axes are turned in a ring"] * (log.format == "motive")),
        _line("time", pose.time),
        *(_line(axis, pose.channels.get(axis)) for axis in "xyz" if axis not in found.alone),
        *([f"# {', '.join(found.alone)}: only the velocity, below"] if found.alone else []),
        _quaternion_line(pose) if _is_whole(pose) else _line("yaw", pose.channels.get("yaw")),
        "",
        *_velocity_lines(found),
        *(["[reference]", *(_line(axis, channel) for axis, channel in reference.items()), ""] if reference else []),
        *(line for source, says in windows_in(log) for line in _window_lines(source, says)),
        "# [limits]  # of the vehicle's settings during the flight",
        '# tilt = { value = 10, unit = "deg" }',
        '# vertical_speed = { value = 1, unit = "m/s" }',
        '# yaw_rate = { value = 100, unit = "deg/s" }',
        "",
        f"# All columns of {log.path.name}; a row of a matrix is NAME[0], NAME[1] and so on:",
        *(f"#   {source_of(log, table, name)}{shape_text(table.columns[name])}" for table, name in columns),
    ]
    return "\n".join([*_heading(log, found), *([f"# {checked}"] if checked else []), *body]) + "\n"


def _velocity_lines(found: _Found) -> list[str]:
    """The vehicle's own velocity: in place of a position, or beside it and not used unless the card says so."""
    velocity = found.velocity
    if not velocity.channels:
        return []
    use = "in place of a position" if found.alone else "not used beside a position unless it is independent of that"
    return [
        f"[velocity]  # {use}",
        *([] if found.alone else ["# independent = true  # only where neither was made from the other"]),
        f'frame = "{found.velocity_frame}"  # "world", or "heading" where x and y are forward and left: check',
        _line("time", velocity.time),
        *(_line(axis, velocity.channels[axis]) for axis in "xyz" if axis in velocity.channels),
        "",
    ]


def _is_whole(pose: Recognised) -> bool:
    return {"qw", "qx", "qy", "qz"} <= pose.channels.keys()


def _frame_line(log: Log, velocity: Recognised) -> str:
    """The frame of the pose, by the format."""
    if is_of_tello(log, velocity):
        return 'frame = "NED"  # as the Tello has it: y to the right, z down, yaw clockwise'
    if log.format in NED_FORMATS:
        return 'frame = "NED"  # as autopilots have it; "ENU" where z points up'
    return 'frame = "ENU"  # of the pose; "NED" where z points down'


def _window_lines(source: str, says: str) -> list[str]:
    return ["[[window]]  # commands count while this holds", f"when = {_quoted(source)}", *says.splitlines(), ""]


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


def _heading(log: Log, found: _Found) -> list[str]:
    """What a reader of the draft must know first."""
    pose = found.pose
    there = {
        "[command] time": found.commands.time is not None,
        "[command] x, y, z or yaw": bool(found.commands.channels),
        "[pose] time": pose.time is not None,
        **{f"[pose] {axis}": axis in pose.channels or axis in found.alone for axis in "xyz"},
        "[pose] yaw or quaternion": _is_whole(pose) or "yaw" in pose.channels,
    }
    missing = [what for what, is_there in there.items() if not is_there]
    return [
        f"# Drafted from the names in {log.path.name}. Check every line, the signs of the commands above all:",
        "# after scale, + must mean forward, left, up, and counter-clockwise seen from above.",
        *(
            [f"# INCOMPLETE: nothing was recognised for {'; '.join(missing)}. Fill in the lines marked EDIT."]
            * bool(missing)
        ),
    ]


def _quoted(text: object) -> str:
    return json.dumps(str(text), ensure_ascii=False)


def _line(key: str, channel: Channel | None, said: str = "") -> str:
    if channel is None:
        return f'# {key} = "TABLE:COLUMN"  # EDIT: nothing was recognised'
    parts = [f"from = {_quoted(channel.source)}"]
    parts += [f"scale = {channel.scale:g}"] * (channel.scale != 1) + [f'unit = "{channel.unit}"'] * bool(channel.unit)
    remarks = ["unit guessed"] * bool(channel.unit) + [said] * bool(said)
    value = f"{{ {', '.join(parts)} }}" if len(parts) > 1 else _quoted(channel.source)
    return f"{key} = {value}" + (f"  # {'; '.join(remarks)}" if remarks else "")


def _quaternion_line(pose: Recognised) -> str:
    names = [str(pose.channels[f"q{part}"].source) for part in "wxyz"]
    prefix = names[0].removesuffix(".w")
    if names == [f"{prefix}.{part}" for part in "wxyz"]:
        return f"quaternion = {_quoted(prefix)}"
    return f"quaternion = [{', '.join(_quoted(name) for name in names)}]  # w, x, y, z"
