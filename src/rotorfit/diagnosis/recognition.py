"""Recognition of a log's columns by their names."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import UNITS_OF_POSE, UNITS_OF_VELOCITY, Channel
from rotorfit.core.frames import AXES, UNIT_SCALE
from rotorfit.core.log import Log, Table
from rotorfit.diagnosis.globe import is_latitude, is_longitude, metres_per_degree, scale_and_offset
from rotorfit.diagnosis.pose_names import (
    NamedPose,
    bodies_named,
    completeness,
    fixes_named,
    headings_named,
    named_alike,
    poses_named,
)
from rotorfit.files.logs.several import format_of
from rotorfit.flights.columns import (
    clock_of,
    clocks,
    column,
    name_without_unit,
    plain_name,
    sample_count,
    series_of,
    source_of,
    stated_unit,
    unit_of_name,
)
from rotorfit.flights.stamps import degrees_for_radians, increasing, stamps_of

_GOAL = "(?:ref|reference|goal|des|desired|dem|demand|(?:ctrl)?target|setpoint|set|sp)"

_COMMAND_FAMILIES = (
    ("(?:(?:.*_)?cmd_vel(?:_twist)?|p?cmd|command(?:ed)?)", "(?:v_?)?"),
    ("(?:u|input|ctrl|control)", "(?:v_?)?"),
    (_GOAL, "(?:vel_?|v_?)"),  # without a v it is a position setpoint
    ("(?:pct|percent|stick)", "(?:v_?)?"),
)

_ASKED = "cmd|command|setpoint|target|goal|desired"

_DEMAND = {axis: f"(?:d|t|des)_?v(?:el)?_?{axis}" for axis in "xyz"}  # DVelX, TVX of autopilots

_SETPOINT = {axis: f"v_?{axis}|(?:velocity|vel|twist|linear)_{axis}|velocity_{i}" for i, axis in enumerate("xyz")}

_SETPOINT |= {"yaw": "yaw_?speed|yaw_?rate|r"}

_YAW_RATE = "(?:(?:yaw|turn)_?(?:rate|speed)|psi_?dot)(?:_c?cw)?"

_TURN = f"(?:yaw|turn|rot|rud(?:der)?|psi)(?:_c?cw)?|c?cw|{_YAW_RATE}"

_TURN_RATE = f"{_TURN}|r|w|wz|ang_?z|angular_z|omega_?z"

_FORWARD, _LEFT, _UP = (
    "lin_?x|linear_x|vf|pitch|theta|forward|fwd|ele(?:vator)?",
    "lin_?y|linear_y|vl|roll|phi|left|right|ail(?:eron)?",
    "lin_?z|linear_z|ve|climb|up|down|throttle|thrust|thr|gaz",
)

_WORLD_UP = "climb(?:_?rate)?|(?:v_?|vel_)?(?:up|down)|v_?[ud]"
"""Up or down beside commands to the north and east."""

_STICKS = {
    "x": "(?:rc_)?fb|forward_backward(?:_velocity)?",
    "y": "(?:rc_)?lr|left_right(?:_velocity)?",
    "z": "(?:rc_)?ud|up_down(?:_velocity)?",
    "yaw": "(?:rc_)?yv|rc_yaw|yaw_velocity",  # which alone may be measured
}

_CHANNEL = r"(?:rc_?|ch(?:an(?:nel)?)?_?\d_)"

_WORDS = (
    {"x": "forward|fwd", "y": "left|right", "z": "up|down|climb", "yaw": "turn|rotate|c?cw|yaw_rate"},
    {
        "x": f"{_CHANNEL}?(?:pitch|ele(?:vator)?)",
        "y": f"{_CHANNEL}?(?:roll|ail(?:eron)?)",
        "z": f"{_CHANNEL}?(?:throttle|thr)",
        "yaw": f"{_CHANNEL}?rud(?:der)?|{_CHANNEL}yaw",  # a yaw alone may be the heading
    },
    {"x": "rc_?b", "y": "rc_?a", "z": "rc_?c", "yaw": "rc_?d"},  # a Tello's `rc a b c d`
)
"""Names of sticks without a word that means command: taken only where all four are there."""

_PARROT = ({"x": "pitch", "y": "roll", "z": "gaz"}, {"x": "theta", "y": "phi", "z": "gaz"})
"""Names of commands in Parrot's SDKs: of ARSDK 3 (Bebop) and of the AR.Drone. Without gaz they are an attitude."""

_PARROT_TURNED = "(?:^|_)(?:roll|phi|yaw|theta)(?:_|$)"
"""Of these those that are to the right, clockwise or, theta, backward where positive.

Source: ARCommands (piloting, PCMD); AR.Drone SDK 2.0.1, ardrone_tool_set_progressive_cmd.
"""

_Y_UP = {"x": "z", "y": "x", "z": "y", "qw": "qw", "qx": "qz", "qy": "qx", "qz": "qy"}

_STATE = "(?:(?:twist|state|estimate|odom|drone|body|world|local|onboard|mocap|vicon|optitrack|velocity)_?)*"

_IN_FRAME = "(?:_(?:body|world))?"

_VELOCITIES = (
    {
        axis: f"{_STATE}(?:v_?g?_?({axis})|(?:vel|velocity|speed|linear|lin)_?({axis})|(?:vel|velocity)_({i}))"
        + _IN_FRAME
        for i, axis in enumerate("xyz")
    },
    {"x": "v_?(n)|vel_?(north)", "y": "v_?(e)|vel_?(east)", "z": "v_?(d)|vel_?(down)"},
    {"x": "v(f)", "y": "v(l)", "z": "v(e|u)"},  # forward, left, up
)

_AHEAD_AND_LEFT = "(?:^|_)(?:twist_twist|lin_?x|vf)"

_OF_THE_BODY = f"body|{_AHEAD_AND_LEFT}"

_REFERENCE = {axis: f"{_GOAL}_?{axis}|{axis}_?{_GOAL}" for axis in AXES}

_WINDOWS = (
    ("vehicle_control_mode:flag_control_velocity_enabled", ""),
    ("vehicle_land_detected:landed", "equals = 0"),
    ("EV:Id", "opens = 28\ncloses = [11, 17, 18]"),
    ("/mavros/state:armed", ""),
    ("/mavros/extended_state:landed_state", "equals = 2"),
    ("/ardrone/navdata:state", "equals = [3, 4, 7]"),
    ("/dji_sdk/flight_status:data", "equals = [2, 3]"),
)

_EAST, _NORTH = "east|lon|lng|long|longitude", "north|lat|latitude"

_FLYING = "(?:is_?)?(?:armed|flying|in_?air|airborne|offboard|in_velocity_mode|control_(?:on|active|enabled))"


@dataclass(frozen=True)
class Recognised:
    """Commands, pose or velocity recognised in a log.

    Attributes:
        channels: Quantity to channel.
        time: Its clock; None where none was found.
        table: Its table; None where nothing was recognised.
        strays: Axes whose columns are named unlike the others: of a pose perhaps of another sensor, of commands
            perhaps a setpoint of a height.
        others: Columns of its table that may be a position or a heading, too; the first of each family of names.
    """

    channels: Mapping[str, Channel]
    time: Channel | None
    table: str | None = None
    strays: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


def commands_in(log: Log) -> Recognised:
    """Axis to column of the commands, by name; z is a stray where x and y are named velocities, and it is not.

    Beside `gaz` they have the signs of Parrot's SDKs; those named `right`, `down` and `cw` are turned.
    """
    found = _recognised(log, _commands)
    names = {axis: plain_name(str(channel.source).rpartition(":")[2]) for axis, channel in found.channels.items()}
    if re.search(r"(?:^|_)gaz(?:_|$)", names.get("z", "")):
        turned = {
            axis: replace(found.channels[axis], scale=-1) for axis in names if re.search(_PARROT_TURNED, names[axis])
        }
        return replace(found, channels={**found.channels, **turned})
    backward = {"y": "right", "z": "v_?d|down" if is_of_the_world(found) else "down", "yaw": "cw"}
    turned = {
        axis: replace(found.channels[axis], scale=-1)
        for axis, word in backward.items()
        if re.search(rf"(?:^|_)(?:{word})(?:_|$)", names.get(axis, "")) and not re.search("left|up|ccw", names[axis])
    }
    found = replace(found, channels={**found.channels, **turned})
    if "z" in turned and is_of_the_world(found):
        return found
    fast = {axis for axis, name in names.items() if re.search(rf"v(?:el)?_?{axis}(?:_|$)", name)}
    height = {"x", "y"} <= fast and "z" not in fast and re.search(r"(?:^|_)z(?:_|$)", names.get("z", ""))
    return replace(found, strays=("z",)) if height else found


def velocities_as_commands(log: Log, pose: Recognised) -> Recognised:
    """Commands named like velocities (vx, vy, yawrate) beside the position, as scripts for a Crazyflie log them.

    By their names they may as well be the vehicle's own velocity.
    """

    def names_in(_: Log, table: Table) -> dict[str, str]:
        found = _named(table, _SETPOINT) if table.name == pose.table else {}
        return found if {"x", "y", "yaw"} <= found.keys() and {"x", "y", "z"} <= pose.channels.keys() else {}

    return _recognised(log, names_in)


def poses_in(log: Log) -> list[Recognised]:
    """Poses by name, the likeliest first: those with the most of x, y, z and a heading, then with most samples.

    At least one, which may be empty. With several tables its heading may come from another one. Latitude and longitude
    are taken where nothing else is a position. Each body of an export
    of Motive is there twice: with its y up, as by default, and with its z up.
    """
    if bodies := _fullest(log, _bodies):
        of_motive = [is_of_motive(log, body) for body in bodies]
        upright = [z_up(body) if turned else body for body, turned in zip(bodies, of_motive, strict=True)]
        return upright + [body for body, turned in zip(bodies, of_motive, strict=True) if turned]
    heading = _with_unit_of_yaw(log, _in_units(_recognised(log, _attitude), UNITS_OF_POSE))
    named = _fullest(log, _poses)
    if not any({"x", "y"} <= pose.channels.keys() for pose in named):
        named = [_in_metres(log, pose) for pose in _fullest(log, _fixes)] or named
    poses = [_with_unit_of_yaw(log, pose) for pose in named] or [heading]
    return [_with_heading(pose, heading) for pose in poses]


def pose_in(log: Log) -> Recognised:
    """The likeliest pose by name."""
    return poses_in(log)[0]


def _with_heading(pose: Recognised, heading: Recognised) -> Recognised:
    known = pose.channels.keys() & {"yaw", "qw"}
    return pose if known else replace(pose, channels={**pose.channels, **heading.channels})


def _fullest(log: Log, poses_of: Callable[[Log, Table], list[NamedPose]]) -> list[Recognised]:
    """The poses with the most of x, y, z and a heading, those with most samples first."""
    named = [(table, pose) for table in log.tables.values() for pose in poses_of(log, table)]
    most = max((completeness(pose) for _, pose in named), default=0)
    full = [(table, pose) for table, pose in named if completeness(pose) == most]
    full.sort(key=lambda one: (len(one[1].names), _samples(one[0], one[1].names)), reverse=True)
    return [_named_stream(log, table, pose) for table, pose in full]


def _named_stream(log: Log, table: Table, pose: NamedPose) -> Recognised:
    others = tuple(source_of(log, table, name) for name in pose.unused)
    return replace(_in_units(_stream(log, table, pose.names), UNITS_OF_POSE), strays=pose.strays, others=others)


def _in_units(found: Recognised, units: Mapping[str, tuple[str, ...]]) -> Recognised:
    """The quantities without the units that are of another kind, such as m/s of a position."""
    channels = {
        what: one if one.unit in units.get(what, ()) else replace(one, unit=None)
        for what, one in found.channels.items()
    }
    return replace(found, channels=channels)


def is_of_motive(log: Log, pose: Recognised) -> bool:
    """Whether a pose is from an export of Motive, whose y is up by default."""
    return pose.table is not None and format_of(log, pose.table) == "motive"


def is_turned_up(log: Log, pose: Recognised) -> bool:
    """Whether a pose is from an export of Motive and read with y up."""
    return is_of_motive(log, pose) and "z" in pose.channels and str(pose.channels["z"].source).endswith(".y")


def velocity_in(log: Log, commands: Recognised, pose: Recognised) -> Recognised:
    """Axis to column of the onboard velocity, by name; preferably from the pose's table."""
    taken = {channel.source for channel in commands.channels.values()}

    def names_in(log: Log, table: Table) -> dict[str, str]:
        known = () if _asked(log, table) or _is_twist_of(commands, table) else _VELOCITIES
        found = max((named_alike(table, family) for family in known), key=len, default={})
        free = {axis: name for axis, name in found.items() if source_of(log, table, name) not in taken}
        return free if {"x", "y"} <= free.keys() or "z" in free else {}

    beside = log.tables.get(pose.table or "")
    if beside is not None and {"x", "y"} <= names_in(log, beside).keys():
        found = _recognised(log, lambda log, table: names_in(log, table) if table is beside else {})
    else:
        found = _recognised(log, names_in)
    return _in_units(found, UNITS_OF_VELOCITY) if found.channels else Recognised({}, None)


def is_of_the_body(velocity: Recognised) -> bool:
    """Whether the names indicate that a velocity is along the body: an odometry's is in the frame of the child.

    Source: nav_msgs/Odometry.msg.
    """
    return _is_named(velocity, _OF_THE_BODY)


def is_ahead_and_left(velocity: Recognised) -> bool:
    """Whether the names say that a velocity of the body is forward, left and up, as in ROS."""
    return _is_named(velocity, _AHEAD_AND_LEFT)


def _is_named(velocity: Recognised, pattern: str) -> bool:
    names = (velocity.table or "", *(str(channel.source) for channel in velocity.channels.values()))
    return any(re.search(pattern, plain_name(name.rpartition(":")[2])) for name in names)


def is_of_tello(log: Log, velocity: Recognised) -> bool:
    """Whether velocities are named as in the state packets of a Tello, whose z is down.

    Source: the names of its SDK.
    """
    table = log.tables.get(velocity.table or "")
    named = any(re.search(r"\bvg[xyz]$", str(channel.source)) for channel in velocity.channels.values())
    return named or (table is not None and "tof" in table.columns)


def climb_of_tello(log: Log, velocity: Recognised) -> float | None:
    """Rise of the height, which a Tello's state packets have in cm, over the integral of the vertical velocity.

    Near -10 where this is down and in dm/s, as flights show, -1 where it is in cm/s; None where they do not tell.
    """
    table = log.tables.get(velocity.table or "")
    height = next((name for name in ("h", "tof") if table is not None and name in table.columns), None)
    if table is None or height is None or velocity.time is None or "z" not in velocity.channels:
        return None
    stamps, speed = stamps_of(log, velocity.time), column(log, velocity.channels["z"])
    rise = column(log, Channel(source_of(log, table, height)))
    if not stamps.size == speed.size == rise.size:
        return None
    there = np.isfinite(speed) & np.isfinite(rise)
    there[there] = increasing(stamps[there])
    time, speed, rise = stamps[there] / 1e9, speed[there], rise[there]
    if time.size < 2 or not np.ptp(rise) or not np.ptp(speed):
        return None
    summed = np.concatenate([[0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)])
    known = np.column_stack([summed, time - time[0], np.ones(time.size)])  # a bias of the velocity drifts
    (slope, *_), left, rank, _ = np.linalg.lstsq(known, rise, rcond=None)
    explained = 1 - float(left[0]) / float(np.sum((rise - rise.mean()) ** 2)) if rank == 3 and left.size else 0.0
    return float(slope) if explained > 0.5 else None


def is_of_the_world(commands: Recognised) -> bool:
    """Whether the names of the horizontal commands say east and north."""
    names = [plain_name(str(commands.channels[axis].source)) for axis in "xy" if axis in commands.channels]
    said = (r"(?:^|_)(?:v_?e|east)(?:_|$)", r"(?:^|_)(?:v_?n|north)(?:_|$)")
    return len(names) == 2 and all(re.search(word, name) for word, name in zip(said, names, strict=True))


def is_worded(commands: Recognised) -> bool:
    """Whether the names of the horizontal commands say forward and left or right."""
    names = [plain_name(str(commands.channels[axis].source)) for axis in "xy" if axis in commands.channels]
    said = ("forward|fwd|ahead", "left|right")
    return len(names) == 2 and all(re.search(word, name) for word, name in zip(said, names, strict=True))


def reference_in(log: Log, commands: Recognised) -> dict[str, Channel]:
    """Setpoint of a position controller: columns named so in the table of the commands."""
    table = log.tables.get(commands.table or "")
    if table is None:
        return {}
    named = _named(table, {axis: axis for axis in AXES} if _asked(log, table) else _REFERENCE)
    taken = {channel.source for channel in commands.channels.values()}
    sources = {axis: source_of(log, table, name) for axis, name in named.items()}
    return {axis: Channel(source) for axis, source in sources.items() if source not in taken}


def windows_in(log: Log) -> list[tuple[str, str]]:
    """Columns that tell when commands count, with the further keys that a card needs for them."""
    known = [(source, says) for source, says in _WINDOWS if _has(log, source)]
    if known:
        return known
    found = [
        source_of(log, table, name)
        for table in log.tables.values()
        for name, values in table.columns.items()
        if values.ndim == 1 and re.fullmatch(_FLYING, name_without_unit(name)) and values.dtype.kind in "biuf"
        if 0 < np.mean(np.nan_to_num(values.astype(np.float64)) != 0) < 1
    ]
    return [(source, "") for source in found[:1]]


def is_down(pose: Recognised) -> bool:
    """Whether the name of the vertical position says that it points down."""
    return _points(pose, "z", "d", "down")


def is_up(pose: Recognised) -> bool:
    """Whether the name of the vertical position says that it points up."""
    return _points(pose, "z", "u", "up|alt|altitude")


def is_east_and_north(pose: Recognised) -> bool:
    """Whether the names of the horizontal position say east and north, in whichever order."""
    return any(_points(pose, x, "e", _EAST) and _points(pose, y, "n", _NORTH) for x, y in ("xy", "yx"))


def is_directed(pose: Recognised) -> bool:
    """Whether the names of a position say where its axes point, so that none of them is turned."""
    return is_east_and_north(pose) or is_up(pose) or is_down(pose)


def _points(pose: Recognised, axis: str, letter: str, words: str) -> bool:
    said = rf"(?:^|_)(?:(?:p|pos(?:ition)?_?|pose_){letter}|{letter}_?pos(?:ition)?|{words})$"
    return axis in pose.channels and bool(re.search(said, name_without_unit(str(pose.channels[axis].source))))


def is_compass(pose: Recognised) -> bool:
    """Whether the name of the heading is that of a compass, which counts clockwise from north."""
    yaw = pose.channels.get("yaw")
    return bool(yaw and re.search("(?:^|_)(?:heading|hdg|compass)$", name_without_unit(str(yaw.source))))


def lacking(log: Log) -> str:
    """What a log without a card lacks for a fit, judging by its names, as a clause; empty where nothing is missing."""
    commands, pose = commands_in(log), pose_in(log)
    there = [axis for axis in "xyz" if axis in pose.channels]
    if not commands.channels and there:
        return "it holds poses but nothing that looks like commands: the log of the commands is needed, too"
    if commands.channels and velocity_in(log, commands, pose).channels and not {"x", "y"} <= pose.channels.keys():
        return "it holds commands and velocities but no position: it can be fitted in its velocities"
    if commands.channels and not there:
        return "it holds commands but nothing that looks like a position x, y, z or a velocity"
    return ""


def _has(log: Log, source: str) -> bool:
    table, _, name = source.partition(":")
    return table in log.tables and name in log.tables[table].columns


def _recognised(log: Log, names_in: Callable[[Log, Table], dict[str, str]]) -> Recognised:
    """The stream of the table that is named as a command, has most quantities recognised, and has most samples.

    Only commands are searched in tables with such names, because a Twist may also be a measurement of motion capture.
    """
    found = [(table, names) for table in log.tables.values() if (names := names_in(log, table))]
    if not found:  # a file of matrices: at least its clock
        only = list(log.tables.values())[:1] if len(log.tables) == 1 else []
        return Recognised({}, clock_of(log, only[0], sample_count(only[0])) if only else None)
    best = max(found, key=lambda one: (_asked(log, one[0]), len(one[1]), _samples(*one)))
    return _stream(log, *best)


def _samples(table: Table, names: Mapping[str, str]) -> int:
    return series_of(table)[next(iter(names.values()))]


def _stream(log: Log, table: Table, names: Mapping[str, str]) -> Recognised:
    channels = {
        what: Channel(source_of(log, table, name), unit=_unit(log, table, name)) for what, name in names.items()
    }
    time = clock_of(log, table, _samples(table, names), next(iter(names.values())))
    return Recognised(channels, time, table.name)


def _with_unit_of_yaw(log: Log, pose: Recognised) -> Recognised:
    """The pose with a yaw in degrees where its values are none in radians.

    A compass in radians begins within one turn, even if it counts them.
    """
    yaw = pose.channels.get("yaw")
    if pose.time is None or yaw is None or yaw.unit is not None or is_stated(log, yaw):
        return pose
    stamps, values = stamps_of(log, pose.time), column(log, yaw)
    there = np.isfinite(values[: len(stamps)])  # rows of commands may share the stamps of those of poses
    stamps, values = stamps[: len(values)][there], values[: len(stamps)][there]
    clean = increasing(stamps)
    beyond = is_compass(pose) and values.size > 0 and abs(values[0]) > 2 * np.pi
    if not beyond and not degrees_for_radians(stamps[clean], values[clean]):
        return pose
    return replace(pose, channels={**pose.channels, "yaw": replace(yaw, unit="deg")})


def is_stated(log: Log, channel: Channel) -> bool:
    """Whether the log itself states the unit in which a channel is read."""
    said = stated_unit(log, channel)
    return said is not None and (said == channel.unit if channel.unit else UNIT_SCALE[said] == 1)


def _unit(log: Log, table: Table, name: str) -> str | None:
    """The unit that the log or a name states, or that of the message: NTUN of ArduPilot is in cm.

    Source: its Log.cpp up to 3.6.
    """
    if stated := log.units.get((table.name, name)):
        return None if UNIT_SCALE[stated] == 1 else stated
    if format_of(log, table.name).startswith("dataflash") and table.name == "NTUN":
        return "cm" if name.startswith("Pos") else "cm/s" if "Vel" in name else None
    return unit_of_name(name)


def _commands(log: Log, table: Table) -> dict[str, str]:
    """Axis to column of the family of names (cmd_x, ux, vx_ref ...) that covers most axes, or of a Twist."""
    twist = {axis: f"(?:field_)?(?:twist_)?linear_{axis}" for axis in "xyz"}  # field: as rostopic echo -p has it
    twist |= {"yaw": "(?:field_)?(?:twist_)?angular_z"}
    families = [_family(table, word, speed) for word, speed in _COMMAND_FAMILIES]
    families.append(_named(table, {axis: f"(?:cmd|command)_?(?:vel_)?{i}" for i, axis in enumerate(AXES)}))
    sticks = _named(table, _STICKS)
    families += [sticks if {"x", "y"} <= sticks.keys() else {}, _named(table, _DEMAND)]
    if format_of(log, table.name).startswith("dataflash"):
        families = families[-1:]  # its DesRoll, DesPitch, DesYaw are setpoints of the inner angle loops
    if _asked(log, table):
        families.append(_named(table, _SETPOINT))
    if (len(log.tables) > 1 or _asked(log, table)) and not poses_named(table):
        families.append(_named(table, twist))
    if not any({"x", "y"} <= family.keys() for family in families):
        families.append(_of_parrot(table))
        families += [found for words in _WORDS if len(found := _named(table, words)) == len(AXES)]
    found = max(families, key=len)
    return _named(table, {"z": "throttle", "yaw": "rudder"}) | found if {"x", "y"} <= found.keys() else found


def _of_parrot(table: Table) -> dict[str, str]:
    """Axis to column of the commands of a Parrot: pitch, roll and gaz, and a yaw that is no heading."""
    sticks = next((named for names in _PARROT if len(named := _named(table, names)) == len(names)), {})
    turn = _named(table, {"yaw": "yaw_?(?:rate|speed)"}) or _named(table, {"yaw": "yaw"})
    headings = {name for family in headings_named(table) for name in family.names.values()}
    return sticks | {axis: name for axis, name in turn.items() if sticks and name not in headings}


def _family(table: Table, word: str, speed: str) -> dict[str, str]:
    """Axis to column with a word that means command before or after the axis.

    Names that say velocity or rate come first: beside `cmd_vx` and `cmd_yaw_rate`, `cmd_x` and `cmd_yaw` are setpoints
    of a position controller. So do words for a turn: beside `sp_yaw`, `sp_r` may be to the right. Beside `cmd_vn`,
    `cmd_ve` is to the east, not up.
    """
    axes = {"x": f"{speed}x|{_FORWARD}", "y": f"{speed}y|{_LEFT}", "z": f"{speed}z|{_UP}", "yaw": _TURN_RATE}
    fast = _named(table, _with(word, {axis: f"v(?:el)?_?{axis}" for axis in "xyz"}))
    turn = _named(table, _with(word, {"yaw": _TURN}))
    rate = _named(table, _with(word, {"yaw": _YAW_RATE}))
    across = _named(table, _with(word, {"x": f"v_?e|{speed}east|vel_east", "y": f"v_?n|{speed}north|vel_north"}))
    if {"x", "y"} <= across.keys():
        return across | _named(table, _with(word, {"z": f"{_WORLD_UP}|v_?z"})) | turn | rate
    return _named(table, _with(word, axes)) | (fast if {"x", "y"} <= fast.keys() else {}) | turn | rate


def _with(word: str, axes: Mapping[str, str]) -> dict[str, str]:
    return {axis: f"{word}_?(?:{names})|(?:{names})_?{word}" for axis, names in axes.items()}


def _bodies(log: Log, table: Table) -> list[NamedPose]:
    return bodies_named(table) if format_of(log, table.name) in ("motive", "vicon") else []


def _poses(log: Log, table: Table) -> list[NamedPose]:
    """Poses of a table that is not named as a command or a setpoint."""
    return [] if _asked(log, table) else poses_named(table)


def _fixes(log: Log, table: Table) -> list[NamedPose]:
    """The same by latitude and longitude."""
    return [] if _asked(log, table) else fixes_named(table)


def is_on_the_globe(pose: Recognised) -> bool:
    """Whether a horizontal position is a longitude and a latitude."""
    known = pose.channels
    return {"x", "y"} <= known.keys() and is_longitude(known["x"].source) and is_latitude(known["y"].source)


def _in_metres(log: Log, pose: Recognised) -> Recognised:
    """A pose by longitude and latitude in metres from its first fix; unchanged where these are no degrees.

    Whole numbers may be 1e-7 degrees, as in MAVLink.
    """
    known = [column(log, replace(pose.channels[axis], unit=None)) for axis in "xy"]
    count = min(values.size for values in known)
    fixes = np.column_stack([values[:count] for values in known])
    fixes = fixes[np.all(np.isfinite(fixes), axis=1) & np.any(fixes != 0, axis=1)]
    if not len(fixes):
        return pose
    size = 1e-7 if np.max(np.abs(fixes)) > 360 else 1.0
    if np.any(np.max(np.abs(fixes), axis=0) * size > (360, 90)):
        return pose
    scale = metres_per_degree(float(fixes[0, 1]) * size)
    read = {
        axis: Channel(pose.channels[axis].source, *scale_and_offset(size * scale[k], float(fixes[0, k])))
        for k, axis in enumerate("xy")
    }
    return replace(pose, channels={**pose.channels, **read})


def _attitude(log: Log, table: Table) -> dict[str, str]:
    """A heading alone, from a table that is no setpoint: the quaternion if it is complete, else yaw."""
    found = [] if _asked(log, table) else headings_named(table)
    return dict(found[0].names) if found else {}


def _is_twist_of(commands: Recognised, table: Table) -> bool:
    """Whether the commands are a Twist in this table, which then holds no velocity."""
    return commands.table == table.name and any("linear" in str(one.source) for one in commands.channels.values())


def _asked(log: Log, table: Table) -> bool:
    """Whether a table in a log of several, or a topic, is named as a command or a setpoint."""
    return (len(log.tables) > 1 or table.name.startswith("/")) and re.search(_ASKED, table.name.lower()) is not None


def z_up(body: Recognised) -> Recognised:
    """A pose of Motive, which has y up: the three axes are permuted cyclically, so no sign changes."""
    return replace(body, channels={axis: body.channels[own] for axis, own in _Y_UP.items() if own in body.channels})


def _named(table: Table, patterns: Mapping[str, str]) -> dict[str, str]:
    """Quantity to the shortest name that matches its pattern; columns as long as a clock take precedence."""
    found: dict[str, str] = {}
    series, lengths = series_of(table), set(clocks(table).values())
    timed = {name for name, count in series.items() if lengths & {count - 1, count, count + 1}}
    for name in sorted(series, key=lambda name: (name not in timed, len(name))):
        plain = name_without_unit(name)
        for quantity, pattern in patterns.items():
            if quantity not in found and re.fullmatch(pattern, plain):
                found[quantity] = name
    return found
