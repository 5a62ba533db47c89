"""What the names of a log say of its commands and pose, and the text of a card from that."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rotorfit.card import Channel
from rotorfit.columns import shape_text, source_of
from rotorfit.frames import AXES
from rotorfit.log import Log
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


@dataclass(frozen=True)
class Found:
    """What a draft is made of.

    Attributes:
        commands: By their names, later with axes and signs by the motion.
        pose: By its names.
        velocity: The vehicle's own, by its names.
        frame: Of the commands: `heading` or `world`.
        velocity_frame: Likewise.
        pose_frame: `ENU` or `NED`.
        pose_said: Why it is that, behind its line.
        remarks: What to say behind other lines of the pose, by quantity.
    """

    commands: Recognised
    pose: Recognised
    velocity: Recognised
    frame: str
    velocity_frame: str
    pose_frame: str
    pose_said: str
    remarks: Mapping[str, str] = field(default_factory=dict)

    @property
    def alone(self) -> list[str]:
        """Axes of which there is only a velocity."""
        return [axis for axis in "xyz" if axis in self.velocity.channels and axis not in self.pose.channels]


def found_in(log: Log) -> Found:
    """What the names say."""
    commands, pose = commands_in(log), pose_in(log)
    velocity = velocity_in(log, commands, pose)
    if is_of_tello(log, velocity):
        dm = {axis: replace(channel, scale=10.0, unit="cm/s") for axis, channel in velocity.channels.items()}
        velocity = replace(velocity, channels=dm)
    of_velocity = "heading" if is_of_the_body(velocity) else "world"
    return Found(commands, pose, velocity, "heading", of_velocity, *_pose_frame(log, velocity))


def text_of(log: Log, found: Found, said: Mapping[str, str], checked: str = "") -> str:
    """The draft."""
    commands, pose = found.commands, found.pose
    columns = [(table, name) for table in log.tables.values() for name in table.columns]
    reference = reference_in(log, commands)
    body = [
        f"name = {_quoted(log.path.stem)}",
        f'frame = "{found.pose_frame}"  # {found.pose_said}',
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
        *(
            _line(axis, pose.channels.get(axis), found.remarks.get(axis, ""))
            for axis in "xyz"
            if axis not in found.alone
        ),
        *([f"# {', '.join(found.alone)}: only the velocity, below"] if found.alone else []),
        _quaternion_line(pose)
        if _is_whole(pose)
        else _line("yaw", pose.channels.get("yaw"), found.remarks.get("yaw", "")),
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


def _velocity_lines(found: Found) -> list[str]:
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


def _pose_frame(log: Log, velocity: Recognised) -> tuple[str, str]:
    """The frame of the pose by the format, and what to say of it."""
    if is_of_tello(log, velocity):
        return "NED", "as the Tello has it: y to the right, z down, yaw clockwise"
    if log.format in NED_FORMATS:
        return "NED", 'as autopilots have it; "ENU" where z points up'
    return "ENU", 'of the pose; "NED" where z points down'


def _window_lines(source: str, says: str) -> list[str]:
    return ["[[window]]  # commands count while this holds", f"when = {_quoted(source)}", *says.splitlines(), ""]


def _heading(log: Log, found: Found) -> list[str]:
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
