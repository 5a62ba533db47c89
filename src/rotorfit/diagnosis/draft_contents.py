"""What a draft of a card says of a log: by the names of its columns, and the other readings of its pose."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from rotorfit.core.card import Channel
from rotorfit.core.log import Log
from rotorfit.diagnosis.recognition import (
    Recognised,
    climb_of_tello,
    commands_in,
    is_ahead_and_left,
    is_compass,
    is_down,
    is_east_and_north,
    is_of_tello,
    is_of_the_body,
    is_on_the_globe,
    is_stated,
    velocities_as_commands,
    velocity_in,
)
from rotorfit.files.logs.formats import FORMATS
from rotorfit.files.logs.several import format_of
from rotorfit.flights.columns import name_without_unit

ORDER_GUESSED = "EDIT: this order is a guess, for numbers do not tell which is w"
"""Remark on numbered parts of a quaternion."""


@dataclass(frozen=True)
class DraftContents:
    """Contents of a draft.

    Attributes:
        commands: Recognised by name, later with axes and signs from the motion.
        pose: Recognised by name.
        velocity: Onboard velocity, recognised by name.
        frame: Frame of the commands: `heading` or `world`.
        velocity_frame: Frame of the velocity, likewise.
        pose_frame: `ENU` or `NED`.
        pose_remark: Reason for the frame, appended to its line.
        remarks: Remarks appended to other lines of the pose, by quantity.
        doubted: Whether the commands may be the vehicle's own velocity, judging by their names.
    """

    commands: Recognised
    pose: Recognised
    velocity: Recognised
    frame: str
    velocity_frame: str
    pose_frame: str
    pose_remark: str
    remarks: Mapping[str, str] = field(default_factory=dict)
    doubted: bool = False

    @property
    def alone(self) -> list[str]:
        """Axes with a velocity but no position."""
        return [axis for axis in "xyz" if axis in self.velocity.channels and axis not in self.pose.channels]


def found_in(log: Log, pose: Recognised, guess: bool = True) -> DraftContents:
    """Contents of a draft according to the names in a log.

    Args:
        log: As recorded.
        pose: One of its poses.
        guess: Whether columns named like velocities may be commands where nothing else is.
    """
    commands, doubted = commands_in(log), False
    if guess and not commands.channels and (named := velocities_as_commands(log, pose)).channels:
        commands, doubted = named, True
    velocity = velocity_in(log, commands, pose)
    rise = climb_of_tello(log, velocity) if is_of_tello(log, velocity) else None
    frame, remark = _pose_frame(log, velocity, pose, rise)
    said = dict.fromkeys(pose.strays, "EDIT: named unlike the others, and perhaps of another sensor")
    if is_of_tello(log, velocity) and not any(is_stated(log, channel) for channel in velocity.channels.values()):
        scale = 10.0 if rise is None or abs(rise) > math.sqrt(10.0) else 1.0
        read = {axis: replace(channel, scale=scale, unit="cm/s") for axis, channel in velocity.channels.items()}
        velocity = replace(velocity, channels=read)
        said["velocity"] = "dm/s, as a Tello has them: EDIT if they are cm/s" if rise is None else "by the height"
    of_velocity = "heading" if is_of_the_body(velocity) else "world"
    if is_whole(pose) and re.search(r"\d\]?$", str(pose.channels["qw"].source)):
        said["qw"] = ORDER_GUESSED
    if "yaw" not in commands.channels and _is_beside_gaz(commands, pose):
        said["yaw"] = "EDIT: beside gaz it may be a command; then the heading is missing"
    if frame == "ENU" and is_east_and_north(pose) and is_compass(pose):
        pose = replace(pose, channels={**pose.channels, "yaw": from_y(pose.channels["yaw"])})
        said["yaw"] = "clockwise from north, by its name"
    if is_on_the_globe(pose):
        metres = "m" if pose.channels["x"].scale != 1 else "EDIT: these are no degrees; m"
        said |= {"x": f"longitude in {metres} to the east of the first fix", "y": "latitude, likewise to the north"}
    found = DraftContents(commands, pose, velocity, "heading", "world", frame, remark, said, doubted)
    return in_frames(found, velocity_frame=of_velocity)


def in_frames(found: DraftContents, **frames: str) -> DraftContents:
    """The same draft with `pose_frame` or `velocity_frame` changed.

    A card in NED turns the velocities of the world, but never those of the body: forward, right and down are turned
    here, unless their names say forward and left.
    """
    other = replace(found, **frames)  # type: ignore[arg-type]
    if _is_turned_here(other) == _is_turned_here(found):
        return other
    across = {axis: turned(channel) for axis, channel in found.velocity.channels.items() if axis in ("y", "z")}
    return replace(other, velocity=replace(found.velocity, channels={**found.velocity.channels, **across}))


def _is_turned_here(found: DraftContents) -> bool:
    in_heading = found.pose_frame == "NED" and found.velocity_frame == "heading"
    return in_heading and not is_ahead_and_left(found.velocity)


def _is_beside_gaz(commands: Recognised, pose: Recognised) -> bool:
    """Whether a heading stands beside commands named as in Parrot's SDKs, among which it may be."""
    climb = commands.channels.get("z")
    named = climb is not None and name_without_unit(str(climb.source).rpartition(":")[2]) == "gaz"
    return named and "yaw" in pose.channels and pose.table == commands.table


def is_whole(pose: Recognised) -> bool:
    """Whether a pose has a whole quaternion."""
    return {"qw", "qx", "qy", "qz"} <= pose.channels.keys()


def _pose_frame(log: Log, velocity: Recognised, pose: Recognised, rise: float | None) -> tuple[str, str]:
    """The frame of the pose according to names and format, and its remark; `rise` from `climb_of_tello`."""
    if is_down(pose):
        return "NED", 'of the pose, by its names; "ENU" where z points up'
    if is_of_tello(log, velocity) and (rise is None or rise < 0):
        return "NED", "as the Tello has it: y to the right, z down, yaw clockwise"
    if is_on_the_globe(pose):
        return "ENU", "longitude is to the east"
    table = pose.table or velocity.table
    kind = FORMATS.get(format_of(log, table) if table else log.format)
    if kind and kind.ned:
        return "NED", 'as autopilots have it; "ENU" where z points up'
    return "ENU", 'of the pose; "NED" where z points down'


def readings(found: DraftContents) -> Iterator[DraftContents]:
    """Alternative readings of the pose that a card can express.

    A position and a heading that are mirrored against each other fit the motion with either turned. The names say which
    it is: east and north are not mirrored, and a compass may be.
    """
    pose, asks = found.pose.channels, "by the motion: EDIT if that is not so"
    fixed = is_east_and_north(found.pose)
    if "yaw" in pose:
        yield from _headings(found, asks)
        if pose["yaw"].unit is None:
            yield with_pose(found, f"yaw is in degrees {asks}", yaw=in_degrees(pose["yaw"]))
    if {"x", "y"} <= pose.keys() and not fixed and not is_compass(found.pose):
        yield with_pose(found, f"y turned, for the pose is mirrored {asks}", y=turned(pose["y"]))
        yield with_pose(found, f"x and y exchanged, for the pose is mirrored {asks}", y=pose["x"], x=pose["y"])
    if fixed and "z" in pose and is_whole(found.pose):
        frame = "ENU" if found.pose_frame == "NED" else "NED"
        why = f"x and y exchanged and z turned, as the quaternion is of {frame} {asks}"
        other = with_pose(found, why, x=pose["y"], y=pose["x"], z=turned(pose["z"]))
        yield replace(other, pose_frame=frame, pose_remark="of the quaternion, by the motion")


def _headings(found: DraftContents, asks: str) -> Iterator[DraftContents]:
    """The other two of the headings from x, from x the other way round, and the latter from y."""
    yaw, ned = found.pose.channels["yaw"], found.pose_frame == "NED"
    unlike = " though named like a compass," if is_compass(found.pose) else ""
    own, other = ("clockwise", "counter-clockwise") if ned else ("counter-clockwise", "clockwise")
    of_x, of_y = ("north", "east") if ned else ("east", "north")
    plain = replace(yaw, scale=abs(yaw.scale), offset=0.0)
    readings = {
        f"yaw grows {own} from {of_x}, where x points,{unlike if not ned else ''} {asks}": plain,
        f"yaw grows {other} {asks}": turned(plain),
        f"yaw grows {other} from {of_y}, where y points,{unlike if ned else ''} {asks}": from_y(plain),
    }
    for why, reading in readings.items():
        if reading != yaw:
            yield with_pose(found, why, yaw=reading)


def quarter_turns(found: DraftContents) -> Iterator[DraftContents]:
    """The draft with a heading that is zero along another axis than x."""
    yaw = found.pose.channels["yaw"]
    for turn, where in ((90, "y"), (-90, "-y"), (180, "-x")):
        more = float(turn) if yaw.unit == "deg" else round(math.radians(turn), 6)
        why = f"0 along {where} by the motion and the names of the commands: EDIT if these or x and y are wrong"
        yield with_pose(found, why, yaw=replace(yaw, offset=yaw.offset + more))


def with_pose(found: DraftContents, why: str, **channels: Channel) -> DraftContents:
    """The same draft with channels of the pose changed, and the reason at the first of them."""
    pose = replace(found.pose, channels={**found.pose.channels, **channels})
    return replace(found, pose=pose, remarks={**found.remarks, next(iter(channels)): why})


def turned(channel: Channel) -> Channel:
    """The channel with its sign changed."""
    return replace(channel, scale=-channel.scale)


def from_y(yaw: Channel) -> Channel:
    """A heading that grows the other way round, from the y axis, in place of one from the x axis."""
    return replace(turned(yaw), offset=90.0 if yaw.unit == "deg" else round(math.pi / 2, 6))


def in_degrees(yaw: Channel) -> Channel:
    """A heading taken in radians until now, in degrees."""
    return replace(yaw, unit="deg", offset=float(round(math.degrees(yaw.offset))))
