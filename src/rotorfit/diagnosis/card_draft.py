"""Drafts of cards, from the names, values and motion of a log; or the text of a built-in card.

The names in a log suggest its commands and pose; the motion corrects axes, signs, frames and units.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import CardError, FlightError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Log
from rotorfit.core.plain import line_of, plain_toml, toml_text, visible
from rotorfit.core.results import Motion
from rotorfit.core.writing import check_folder, write_whole
from rotorfit.diagnosis.card_choice import proposal
from rotorfit.diagnosis.command_response import BETTER, QUICKEST, SHARED, Answers, CommandResponse, Frame, answers_of
from rotorfit.diagnosis.draft_contents import (
    ORDER_GUESSED,
    DraftContents,
    found_in,
    in_degrees,
    in_frames,
    is_whole,
    quarter_turns,
    readings,
    turned,
    with_pose,
)
from rotorfit.diagnosis.frame_checks import (
    height_sign,
    is_held_in_degrees,
    other_orders,
    overturned,
    strays_from_its_names,
    turned_by_yaw,
    upright_order,
)
from rotorfit.diagnosis.pose_checks import degrees_turned, position_unit
from rotorfit.diagnosis.recognition import (
    Recognised,
    is_directed,
    is_east_and_north,
    is_of_the_world,
    is_stated,
    is_turned_up,
    is_up,
    is_worded,
    poses_in,
    reference_in,
    windows_in,
    z_up,
)
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.files.cards import builtin_card_text, card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import shape_text, source_of
from rotorfit.flights.several_files import bound


def text_of(log: Log, found: DraftContents, said: Mapping[str, str], checked: str = "") -> str:
    """The text of a draft."""
    commands, pose = found.commands, found.pose
    columns = [(table, name) for table in log.tables.values() for name in table.columns]
    reference = reference_in(log, commands)
    body = [
        f"name = {_quoted(log.path.stem)}",
        f'frame = "{found.pose_frame}"  # {found.pose_remark}',
        "",
        "[command]",
        *(
            ["# EDIT: nothing else looks like commands, but by their names they may be the vehicle's own velocity"]
            * found.doubted
        ),
        f'frame = "{found.frame}"  # "world" where x and y do not turn with the vehicle',
        "# hold = 0.3  # s that a command acts without a successor; default: three median periods",
        _line(log, "time", commands.time),
        *(_line(log, axis, commands.channels.get(axis), said.get(axis, "")) for axis in AXES),
        '# x = { from = "...", scale = -1, meaning = "tilt", full_scale = "tilt" }  # all that a command can say;',
        "# meaning: tilt, velocity, vertical_speed or yaw_rate; full_scale: the limit that a command of 1 asks for",
        "",
        "[pose]",
        *(["# Motive has y up: the axes are permuted cyclically"] * is_turned_up(log, pose)),
        *([f"# EDIT if one of these is right: {', '.join(map(visible, pose.others))}"] * bool(pose.others)),
        _line(log, "time", pose.time),
        *(
            _line(log, axis, pose.channels.get(axis), found.remarks.get(axis, ""))
            for axis in "xyz"
            if axis not in found.alone
        ),
        *([f"# {', '.join(found.alone)}: only the velocity, below"] if found.alone else []),
        _quaternion_line(pose, found.remarks.get("qw", ""))
        if is_whole(pose)
        else _line(log, "yaw", pose.channels.get("yaw"), found.remarks.get("yaw", "")),
        "",
        *_velocity_lines(log, found),
        *(
            ["[reference]", *(_line(log, axis, channel) for axis, channel in reference.items()), ""]
            if reference
            else []
        ),
        *(line for source, says in windows_in(log) for line in _window_lines(source, says)),
        "# [limits]  # of the vehicle's settings during the flight",
        '# tilt = { value = 10, unit = "deg" }',
        '# vertical_speed = { value = 1, unit = "m/s" }',
        '# yaw_rate = { value = 100, unit = "deg/s" }',
        "",
        f"# All columns of {visible(log.path.name)}; a row of a matrix is NAME[0], NAME[1] and so on:",
        *(f"#   {visible(source_of(log, table, name))}{shape_text(table.columns[name])}" for table, name in columns),
    ]
    return "\n".join([*_heading(log, found), *([f"# {checked}"] if checked else []), *body]) + "\n"


def _velocity_lines(log: Log, found: DraftContents) -> list[str]:
    """Lines of the onboard velocity: in place of a position, or beside it and unused unless the card says otherwise."""
    velocity = found.velocity
    if not velocity.channels:
        return []
    use = "in place of a position" if found.alone else "not used beside a position unless it is independent of that"
    return [
        f"[velocity]  # {use}",
        *([] if found.alone else ["# independent = true  # only where neither was made from the other"]),
        f'frame = "{found.velocity_frame}"  # "world", or "heading" where x and y are forward and left: check',
        _line(log, "time", velocity.time),
        *(
            _line(log, axis, velocity.channels[axis], found.remarks.get("velocity", ""))
            for axis in "xyz"
            if axis in velocity.channels
        ),
        "",
    ]


def _window_lines(source: str, says: str) -> list[str]:
    return ["[[window]]  # commands count while this holds", f"when = {_quoted(source)}", *says.splitlines(), ""]


NO_COMMAND = "[command] x, y, z or yaw"
"""What a draft lacks that names no command: without one nothing can be fitted."""

_INCOMPLETE = "# INCOMPLETE: nothing was recognised for "

_UNCOMMANDED = "# No command was recognised for "
"""Before the axes that get no model, unless their commands are named; the draft is complete without them."""


def _heading(log: Log, found: DraftContents) -> list[str]:
    """The head of the draft: what to check, and what is missing."""
    pose = found.pose
    there = {
        "[command] time": found.commands.time is not None,
        NO_COMMAND: bool(found.commands.channels),
        "[pose] time": pose.time is not None,
        **{f"[pose] {axis}": axis in pose.channels or axis in found.alone for axis in "xyz"},
        "[pose] yaw or quaternion": is_whole(pose) or "yaw" in pose.channels,
    }
    missing = [what for what, is_there in there.items() if not is_there]
    without = [axis for axis in AXES if axis not in found.commands.channels] if found.commands.channels else []
    return [
        f"# Drafted from the names in {visible(log.path.name)}. Check every line, the signs of the commands above all:",
        "# after scale, + must mean forward, left, up, and counter-clockwise seen from above.",
        *([f"{_INCOMPLETE}{'; '.join(missing)}. Fill in the lines marked EDIT."] * bool(missing)),
        *([f"{_UNCOMMANDED}{', '.join(without)}. Name what the log has, or they get no model."] * bool(without)),
    ]


def _quoted(text: object) -> str:
    return toml_text(str(text))


def _line(log: Log, key: str, channel: Channel | None, said: str = "") -> str:
    if channel is None:
        return f'# {key} = "TABLE:COLUMN"  # EDIT: nothing was recognised'
    parts = [f"from = {_quoted(channel.source)}"]
    parts += [f"scale = {channel.scale:g}"] * (channel.scale != 1)
    parts += [f"offset = {channel.offset:.9g}"] * (channel.offset != 0)
    parts += [f'unit = "{channel.unit}"'] * bool(channel.unit)
    origin = f"unit {'as the file states it' if is_stated(log, channel) else 'guessed'}"
    remarks = [origin] * bool(channel.unit) + [said] * bool(said)
    value = f"{{ {', '.join(parts)} }}" if len(parts) > 1 else _quoted(channel.source)
    return f"{key} = {value}" + (f"  # {'; '.join(remarks)}" if remarks else "")


def _quaternion_line(pose: Recognised, said: str) -> str:
    names = [str(pose.channels[f"q{part}"].source) for part in "wxyz"]
    prefix = names[0].removesuffix(".w")
    if names == [f"{prefix}.{part}" for part in "wxyz"]:
        return f"quaternion = {_quoted(prefix)}"
    return f"quaternion = [{', '.join(_quoted(name) for name in names)}]  # w, x, y, z" + f"; {said}" * bool(said)


CLEARER = 0.7
"""Largest share of the residual variance that another reading of the pose may leave to be preferred."""

_PERHAPS_A_HEIGHT = "EDIT: named unlike x and y; a height instead of a velocity? "

MIRRORED = "; or the pose is mirrored, which a flight that hardly turns does not tell: then turn this axis there"

UNLIKE = ", though its name says the other way"

_DIRECTIONS = {
    "heading": {"x": "forward", "y": "left", "z": "up", "yaw": "counter-clockwise"},
    "world": {"x": "along x (east)", "y": "along y (north)", "z": "up", "yaw": "counter-clockwise"},
}


def draft_card(log: Log, fresh: bool = False) -> str:
    """The TOML text of a card for a log, guessed from names, values and motion, for the user to correct.

    If a built-in card fits, the text is that card. Else the draft loads as a card if all essentials were found, and
    lists missing ones at its top. Where the motion reveals the direction of a command, its line says so, with axis and
    sign corrected.

    Args:
        log: As recorded.
        fresh: Whether to draft from names and motion even if a built-in card fits.

    Returns:
        Text of the card, with comments on what to check; the names of all columns are at its end.
    """
    name = None if fresh else _builtin(log)
    if name:
        text = builtin_card_text(name)
        return f"# A copy of the built-in card {name}, whose columns are all in {visible(log.path.name)}.\n{text}"
    asked = _doubting_radians(log, _commanded(log, _answering(log)))
    found, told = asked.found, asked.answers
    if told is None:
        why = f"The motion could not be used: {line_of(asked.why)}." if asked.why else ""
        return _for_the_next_files(log, text_of(log, found, {}, why))
    found = replace(found, pose_remark=_frame_remark(found, told, asked.height))
    if turned_by_yaw(told) and found.remarks.get("qw") == ORDER_GUESSED:
        found = replace(found, remarks={**found.remarks, "qw": ""})
    frame = told.frame or _frame_by_names(found)
    moved, said = _by_motion(found.commands, told, frame)
    found = _in_metres(log, replace(found, commands=moved, frame=frame), asked.motion)
    sure = all(answer.axis for answer in told.of.values())
    checked = f"Signs were checked against the motion{'' if sure else ', which does not tell those marked EDIT'}."
    open_ = "" if told.frame else " The flight turns too little to tell the heading frame from the world."
    return _for_the_next_files(log, text_of(log, found, said, f"{checked}{open_}"))


def _frame_by_names(found: DraftContents) -> Frame:
    """The frame of the commands where the motion does not tell it."""
    return "world" if is_of_the_world(found.commands) else "heading"


def _frame_remark(found: DraftContents, told: Answers, height: int) -> str:
    """The remark on the frame of the pose, where the direction of z is in question."""
    if together := ", ".join(overturned(told.of, height)):
        why = "by the names" if is_directed(found.pose) else "as z is above 0"
        return f"{why}; {together} are turned together: forward, right, down?"
    if height < 0 and found.pose_frame == "ENU" and not is_up(found.pose):
        rest = "scale = -1 for z, in [command], too" if is_east_and_north(found.pose) else _AS_NED
        return f"EDIT: z is below 0; if it points down: {rest}"
    return found.pose_remark


_AS_NED = '"NED", and scale = -1 for y, z, yaw'


def _for_the_next_files(log: Log, text: str) -> str:
    """A draft for several files that does not need their names: those of the next flight are called otherwise.

    A section without a table finds the one that holds its columns. Where two do, a table is named by a pattern, with a
    star for the numbers in the file's name. Either is taken only if it reads the same columns.
    """
    read = _columns_read(log, text)
    for table, file in log.file_of.items() if read else ():
        stem = Path(file).stem
        if table == stem or table.startswith(f"{stem}/"):
            pattern = re.sub(r"\d+(?:[-_.]\d+)*", "*", table)
            others = (text.replace(_opened(f"{table}:"), _opened(name)) for name in ("", f"{pattern}:"))
            text = next((other for other in others if _columns_read(log, other) == read), text)
    return text


def _opened(text: str) -> str:
    """How a quoted text begins."""
    return _quoted(text)[:-1]


def _columns_read(log: Log, text: str) -> Card | None:
    """The card of a draft with the columns as it finds them in a log; None where it is incomplete."""
    try:
        card = card_from_mapping(plain_toml(text), "drafted")
    except (CardError, ValueError):
        return None
    return replace(bound(card, log), raw={})


def _builtin(log: Log) -> str | None:
    """Name of the built-in card with which the log would be read; None if there is none."""
    try:
        return proposal(log).name
    except CardError:
        return None


@dataclass(frozen=True)
class _Asked:
    """A draft checked against the motion.

    Attributes:
        found: Its contents.
        answers: Responses to the commands; None where the motion shows none.
        why: Why there are none; empty for an incomplete draft.
        motion: Motion of the flight.
        height: From `height_sign`.
    """

    found: DraftContents
    answers: Answers | None
    why: str = ""
    motion: Motion | None = None
    height: int = 0


def _answering(log: Log) -> _Asked:
    """The draft with the pose that answers most commands, the likeliest by name where several do; the rest is named."""
    likeliest, *others = poses_in(log)
    best = _as_it_moves(log, _asked(log, found_in(log, likeliest)))
    for pose in others:
        if best.answers and not _unlike(best.answers):
            break
        best = max(best, _as_it_moves(log, _asked(log, found_in(log, pose))), key=_obedience)
    known = _places(best.found.pose)
    rest = [min(places) for pose in (likeliest, *others) if (places := _places(pose)) and places != known]
    pose = replace(best.found.pose, others=tuple(dict.fromkeys((*best.found.pose.others, *rest))))
    return replace(best, found=replace(best.found, pose=pose))


def _obedience(asked: _Asked) -> tuple[int, int]:
    """How many commands move the vehicle, and how few of them otherwise than their names say."""
    told = asked.answers
    return (sum(1 for answer in told.of.values() if answer.axis), -_odd(told)) if told else (0, 0)


def _places(pose: Recognised) -> frozenset[str]:
    return frozenset(str(channel.source) for axis, channel in pose.channels.items() if axis in "xyz")


def _as_it_moves(log: Log, asked: _Asked) -> _Asked:
    """A draft with the pose read as the motion supports."""
    asked = _held_in_degrees(log, _in_degrees(log, asked))
    asked = _upright(log, _in_the_better_order(log, asked))
    return _better_read(log, _in_the_better_frame(log, asked))


def _asked(log: Log, found: DraftContents) -> _Asked:
    """Determines from the motion what the commands of a draft do."""
    try:
        card = card_from_mapping(plain_toml(text_of(log, found, {})), "drafted")
    except (CardError, ValueError):
        return _Asked(found, None)  # incomplete, which the draft states; or more columns than a card can list
    try:
        flight = flight_from_log(log, card)
    except (CardError, FlightError) as error:
        return _Asked(found, None, str(error))
    motion = motion_from_flight(flight)
    told = answers_of(flight, motion, _frame_by_names(found))
    if told.of:
        return _Asked(found, told, "", motion, height_sign(flight))
    if not np.any(np.ptp(flight.command, axis=0)):
        return _Asked(found, None, "no command moves")
    pieces = len(flight.segments)
    return _Asked(found, None, f"{flight.duration:.1f} s of commands in {pieces} pieces are too few to decide")


def _in_degrees(log: Log, asked: _Asked) -> _Asked:
    """The draft with a heading in degrees if no vehicle can have turned so fast in radians."""
    yaw, rate = asked.found.pose.channels.get("yaw"), degrees_turned(asked.motion) if asked.motion else None
    if yaw is None or yaw.unit or is_stated(log, yaw) or rate is None:
        return asked
    why = f"yaw is in degrees by the motion: in radians it turns with {rate:.2g} rad/s (RMS), too much for any vehicle"
    return _asked(log, with_pose(asked.found, why, yaw=in_degrees(yaw)))


def _held_in_degrees(log: Log, asked: _Asked) -> _Asked:
    """The draft with a heading in degrees that was held, where in radians it would swing with no command to turn it.

    In radians the commands are the world's, then, or do not move the vehicle as their names say.
    """
    yaw, told, motion = asked.found.pose.channels.get("yaw"), asked.answers, asked.motion
    if yaw is None or yaw.unit or is_stated(log, yaw) or told is None or motion is None:
        return asked
    if turned_by_yaw(told) or not is_held_in_degrees(motion) or (told.frame != "world" and not _unlike(told)):
        return asked
    why = 'EDIT: degrees, or radians and frame = "world" in [command]: the motion does not tell the two apart'
    other = _asked(log, with_pose(asked.found, why, yaw=in_degrees(yaw)))
    if other.answers is None or CLEARER * other.answers.left > told.left:
        return asked
    fewer = _unlike(told) - _unlike(other.answers)
    return other if fewer > 0 or (fewer == 0 and told.frame == "world") else asked


def _doubting_radians(log: Log, asked: _Asked) -> _Asked:
    """The draft with a remark where commands are the world's, unless the heading is in degrees and hardly turns."""
    yaw, told, motion = asked.found.pose.channels.get("yaw"), asked.answers, asked.motion
    if yaw is None or yaw.unit or is_stated(log, yaw) or told is None or motion is None:
        return asked
    if told.frame != "world" or "yaw" in asked.found.remarks:
        return asked
    if not turned_by_yaw(told) or not is_held_in_degrees(motion):
        return asked
    why = 'EDIT: radians, or degrees and frame = "heading" in [command]: the motion does not tell the two apart'
    return replace(asked, found=with_pose(asked.found, why, yaw=yaw))


def _in_the_better_order(log: Log, asked: _Asked) -> _Asked:
    """The draft with the parts of the quaternion in the order in which the vehicle is upright and obeys.

    In the wrong order a heading that hardly changes is half a turn off: both horizontal commands are reversed, and
    unless it is near 0 neither moves the vehicle clearly along its axis. Named parts are believed as far as possible.
    """
    found, told = asked.found, asked.answers
    if told is None or not is_whole(found.pose):
        return asked
    doubted = "yaw" not in told.of and strays_from_its_names(told)
    if doubted and (upright := upright_order(log, found.pose.channels)):
        why = "by the pose: in the order of the names the vehicle lies on its side; EDIT if that is not so"
        return _asked(log, with_pose(found, why, **upright))
    if "yaw" in told.of:
        why, obeys = "in the order of the names no command turns the vehicle", turned_by_yaw
    elif found.remarks.get("qw") == ORDER_GUESSED:
        why, obeys = "in the order of the numbers x and y do not move the vehicle as named", _as_named
    else:
        why, obeys = "in the order of the names x and y are both reversed", _ahead
    if obeys(told):
        return asked
    why = f"by the motion: {why}; EDIT if that is not so"
    others = (_asked(log, with_pose(found, why, **parts)) for parts in other_orders(found.pose.channels))
    return next((other for other in others if other.answers and obeys(other.answers)), asked)


def _as_named(told: Answers) -> bool:
    """Whether x and y clearly move the vehicle as named."""
    return all(told.of[name].axis == name and told.of[name].sign > 0 for name in "xy" if name in told.of)


def _ahead_and_left(told: Answers) -> bool:
    """Whether x and y, commands of the vehicle, both clearly move it as named."""
    return told.frame != "world" and {"x", "y"} <= told.of.keys() and _as_named(told)


def _ahead(told: Answers) -> bool:
    """Whether x and y do not both move the vehicle backwards."""
    return not all(name in told.of and told.of[name].axis == name and told.of[name].sign < 0 for name in "xy")


def _upright(log: Log, asked: _Asked) -> _Asked:
    """The draft with the pose's axes permuted if the vertical command moves its y, as where motion capture has y up."""
    climbs = asked.answers.of.get("z") if asked.answers else None
    if climbs is None or climbs.axis != "y" or asked.found.alone or asked.found.pose_frame == "NED":
        return asked
    why = "y points up by the motion, so the axes are permuted cyclically"
    pose = z_up(asked.found.pose)
    other = _asked(log, replace(asked.found, pose=pose, remarks={**asked.found.remarks, "x": why}))
    right = other.answers.of.get("z") if other.answers else None
    return other if right and right.axis == "z" and right.sign > 0 else asked


def _in_the_better_frame(log: Log, asked: _Asked) -> _Asked:
    """The draft with a velocity without position in the frame that explains it better.

    Where commands and velocity share a frame, the motion does not reveal which: then it is the heading frame, as it
    almost always is for commands. The coefficients are the same. A turned velocity has the same sum of squares, so the
    residuals of the two frames compare.
    """
    found, told = asked.found, asked.answers
    if told is None or told.frame is None or "x" not in found.alone:
        return asked
    other = _asked(log, in_frames(found, velocity_frame="world" if found.velocity_frame == "heading" else "heading"))
    if other.answers is None:
        return asked
    allowed = BETTER if told.frame == "heading" else 1 / BETTER
    return other if other.answers.left < allowed * told.left else asked


def _better_read(log: Log, asked: _Asked) -> _Asked:
    """The draft with the pose read in the way that the motion supports.

    That is the other frame if it alone reverses several commands back, since both explain the same; else, among
    readings that explain the motion clearly better, the one with the fewest commands that contradict their names; else
    a heading that is zero along another axis, if that alone moves the vehicle as commands that say forward and left.
    """
    found, told = asked.found, asked.answers
    if told is None or (told.frame != "world" and not _odd(told)):
        return asked
    together = overturned(told.of, asked.height)
    if together and asked.height <= 0 and not is_directed(found.pose):
        here, other = found.pose_frame, "ENU" if found.pose_frame == "NED" else "NED"
        said = (
            f"by the motion: in {here}, {', '.join(together)} would be turned; if it is {here}, give scale = -1 there"
        )
        return _asked(log, replace(in_frames(found, pose_frame=other), pose_remark=said))
    if found.alone:
        return asked
    others = [_asked(log, one) for one in readings(found)]
    better = [one for one in others if one.answers and one.answers.left < CLEARER * told.left]
    least = min((one.answers.left for one in better if one.answers), default=0.0)
    sound = [(_odd(one.answers), one) for one in better if one.answers and CLEARER * one.answers.left <= least]
    if sound:
        return min(sound, key=lambda pair: pair[0])[1]
    worded = is_worded(found.commands) and "yaw" in found.pose.channels
    for turned_ in (_asked(log, one) for one in quarter_turns(found)) if worded else ():
        if turned_.answers and _ahead_and_left(turned_.answers) and BETTER * turned_.answers.left < told.left:
            return turned_
    return asked


def _commanded(log: Log, asked: _Asked) -> _Asked:
    """The draft without doubtful commands if the vehicle follows them at once: then they are its own velocity."""
    found, told = asked.found, asked.answers
    if told is None or not found.doubted or any(told.of[axis].lag > QUICKEST for axis in told.of.keys() & {"x", "y"}):
        return asked
    return _Asked(found_in(log, found.pose, guess=False), None)


def _odd(told: Answers) -> int:
    """Number of commands whose response contradicts their name."""
    return sum(1 for name, answer in told.of.items() if answer.axis and (answer.axis != name or answer.sign < 0))


def _unlike(told: Answers) -> int:
    """Number of commands whose response is not clearly as their name says."""
    return sum(1 for name, answer in told.of.items() if answer.axis != name or answer.sign < 0)


def _in_metres(log: Log, found: DraftContents, motion: Motion | None) -> DraftContents:
    """The same draft with a unit for the position if no vehicle can have flown it in metres, and none is stated."""
    known = {axis: channel for axis, channel in found.pose.channels.items() if axis in "xyz"}
    unit = position_unit(motion) if motion and not found.alone else None
    if unit is None or any(channel.unit or is_stated(log, channel) for channel in known.values()):
        return found
    name, speed = unit
    read = with_pose(found, "", **{axis: replace(channel, unit=name) for axis, channel in known.items()})
    why = f'by the motion, too fast in metres for any vehicle: {speed:.2g} m/s (RMS) with this unit; EDIT: "cm" or "mm"'
    return replace(read, remarks={**found.remarks, "x": "; ".join(filter(None, (found.remarks.get("x"), why)))})


def _by_motion(commands: Recognised, told: Answers, frame: Frame) -> tuple[Recognised, dict[str, str]]:
    """Commands with the axes and signs inferred from the motion, and the remark for each."""
    sure = {name: answer for name, answer in told.of.items() if answer.axis}
    wanted = {name: answer.axis or name for name, answer in sure.items()}
    moved = {name: wanted.get(name, name) for name in commands.channels}
    if len(set(moved.values())) < len(moved):  # two commands on one axis: keep the names
        moved = {name: name for name in moved}
    channels, said = {}, {}
    for name, channel in commands.channels.items():
        axis, answer = moved[name], told.of.get(name)
        backwards = answer is not None and name in sure and answer.sign < 0 and answer.axis == axis
        channels[axis] = turned(channel) if backwards else channel
        mirrored = backwards and told.frame is None and axis in ("x", "y")
        stray = _PERHAPS_A_HEIGHT * (name in commands.strays)
        unlike = UNLIKE * (backwards and channel.scale < 0)
        said[axis] = stray + _remark(name, axis, answer, frame) + unlike + MIRRORED * mirrored
    return replace(commands, channels=channels), said


def _remark(name: str, axis: str, answer: CommandResponse | None, frame: Frame) -> str:
    """Result of the motion for one command."""
    if answer is None:
        return "does not move in this log: EDIT, sign unknown"
    sure, explained = f"{answer.certainty:.0f} standard errors", f"{100 * answer.explained:.0f} % explained"
    figures = f"{sure}, {explained}, delay and time constant together {answer.lag:.1f} s"
    if answer.axis is None:
        shared = f": {100 * answer.shared:.0f} % of this command is in the others"
        return f"EDIT: the motion does not tell the sign{shared if answer.shared > SHARED else f' ({figures})'}"
    if answer.axis != axis:
        return f"EDIT: the motion follows it along {answer.axis} ({figures})"
    renamed = f", though named like {name}" if name != axis else ""
    return f"+ {'turns' if axis == 'yaw' else 'moves'} the vehicle {_DIRECTIONS[frame][axis]}{renamed}: {figures}"


def write_draft(log: Log, path: Path, fresh: bool = False) -> tuple[str, ...]:
    """Writes the draft of a card to a new file; see `draft_card` for the arguments.

    Returns:
        The essentials that it lacks, as its head lists them; last, the axes without a command, if others have one.

    Raises:
        CardError: The file already exists: it may be a card that somebody has edited.
        LogError: Its folder is missing.
        OSError: The file cannot be written.
    """
    check_folder(path)
    if path.exists():
        raise CardError(f"{path}: exists already and is not overwritten; choose another name or remove it")
    text = draft_card(log, fresh)
    write_whole(path, text, keep=False)
    missing = text.partition(_INCOMPLETE)[2].partition(".")[0]
    without = text.partition(_UNCOMMANDED)[2].partition(".")[0]
    return (*filter(None, missing.split("; ")), *([f"[command] {without} (if the log has them)"] * bool(without)))
