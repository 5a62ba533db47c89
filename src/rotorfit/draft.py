"""Texts of cards: of a built-in one, and the draft that names, values and the motion of a log give."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rotorfit.answers import BETTER, Answer, Answers, answers_of
from rotorfit.card import Channel
from rotorfit.card_file import builtin_card_text, card_from_mapping
from rotorfit.draft_text import Found, found_in, text_of
from rotorfit.errors import CardError, FlightError
from rotorfit.flight import flight_from_log
from rotorfit.log import Log
from rotorfit.pose_checks import position_unit
from rotorfit.proposal import proposal
from rotorfit.recognition import Recognised
from rotorfit.regression import Motion, motion_from_flight
from rotorfit.sign_checks import height_sign, overturned

CLEARER = 0.7
"""Share of the residual variance that another way to read the pose must leave at most to be taken."""

MIRRORED = "; or the pose is mirrored, which a flight that hardly turns does not tell: then turn this axis there"

_LEADS = {
    "heading": {"x": "forward", "y": "left", "z": "up", "yaw": "counter-clockwise"},
    "world": {"x": "along x (east)", "y": "along y (north)", "z": "up", "yaw": "counter-clockwise"},
}


def draft_card(log: Log, fresh: bool = False) -> str:
    """The TOML text of a card for a log, guessed from names, values and the motion, for the user to correct.

    Where a built-in card fits, it is that card. Else the draft loads as a card if all the essentials were found, and
    says on top which were not. Where the motion tells which way a command leads, the line says so, with axis and sign
    corrected.

    Args:
        log: As recorded.
        fresh: Draft from names and motion also where a built-in card fits.

    Returns:
        Text of the card, with what to check in comments; the names of all columns stand at its end.
    """
    name = None if fresh else _builtin(log)
    if name:
        text = builtin_card_text(name)
        return f"# A copy of the built-in card {name}, whose columns are all in {log.path.name}.\n{text}"
    asked = _better_read(log, _in_the_better_frame(log, _asked(log, found_in(log))))
    found, told = asked.found, asked.told
    if told is None:
        return text_of(log, found, {}, f"The motion was not asked: {asked.why}." if asked.why else "")
    if turned := ", ".join(overturned(told.of, asked.height)):
        found = replace(found, pose_said=f"as z is above 0; {turned} are turned together: forward, right, down?")
    moved, said = _by_motion(found.commands, told)
    found = _in_metres(replace(found, commands=moved, frame=told.frame or "heading"), asked.motion)
    sure = all(answer.axis for answer in told.of.values())
    checked = f"Signs were checked against the motion{'' if sure else ', which does not tell those marked EDIT'}."
    frame = "" if told.frame else " The flight turns too little to tell the heading frame from the world."
    return text_of(log, found, said, f"{checked}{frame}")


def _builtin(log: Log) -> str | None:
    """Name of the built-in card that the log would be read with."""
    try:
        return proposal(log).name
    except CardError:
        return None


@dataclass(frozen=True)
class _Asked:
    """A draft of which the motion was asked.

    Attributes:
        found: What it is made of.
        told: What the motion says; None where it says nothing.
        why: Why not.
        motion: Of the flight.
        height: As of `height_sign`.
    """

    found: Found
    told: Answers | None
    why: str = ""
    motion: Motion | None = None
    height: int = 0


def _asked(log: Log, found: Found) -> _Asked:
    """Asks the motion what the commands of a draft do."""
    try:
        card = card_from_mapping(tomllib.loads(text_of(log, found, {})), "drafted")
    except CardError:
        return _Asked(found, None)  # incomplete: said on top
    try:
        flight = flight_from_log(log, card)
    except (CardError, FlightError) as error:
        return _Asked(found, None, str(error))
    motion = motion_from_flight(flight)
    told = answers_of(flight, motion)
    if told.of:
        return _Asked(found, told, "", motion, height_sign(flight))
    if not np.any(np.ptp(flight.command, axis=0)):
        return _Asked(found, None, "no command moves")
    pieces = len(flight.segments)
    return _Asked(found, None, f"{flight.duration:.1f} s of commands in {pieces} pieces are too few to tell")


def _in_the_better_frame(log: Log, asked: _Asked) -> _Asked:
    """The draft with a velocity that has no position beside it in the frame that explains it better.

    Where commands and velocity are in one frame, the motion does not tell which: then it is the heading frame, as
    commands almost always are. The coefficients are the same.
    """
    found, told = asked.found, asked.told
    if told is None or told.frame is None or "x" not in found.alone:
        return asked
    other = _asked(log, replace(found, velocity_frame="world" if found.velocity_frame == "heading" else "heading"))
    if other.told is None:
        return asked
    allowed = BETTER if told.frame == "heading" else 1 / BETTER
    return other if _left(other.told) < allowed * _left(told) else asked


def _left(told: Answers) -> float:
    """What commands leave of the horizontal velocity, as shares of its variance."""
    return sum(1 - answer.explained for name, answer in told.of.items() if name in ("x", "y"))


def _better_read(log: Log, asked: _Asked) -> _Asked:
    """The draft with the pose read as the motion bears out.

    That is another frame where it alone turns several commands back, for both explain as much; else, of what explains
    the motion clearly better, what leaves the fewest commands that do not do what they are called.
    """
    found, told = asked.found, asked.told
    if told is None or (told.frame != "world" and not _odd(told)):
        return asked
    turned = overturned(told.of, asked.height)
    if turned and asked.height <= 0:
        here, other = found.pose_frame, "ENU" if found.pose_frame == "NED" else "NED"
        said = f"by the motion: in {here}, {', '.join(turned)} would be turned; if it is {here}, give scale = -1 there"
        return _asked(log, replace(found, pose_frame=other, pose_said=said))
    if told.frame is None or found.alone:
        return asked
    others = [_asked(log, one) for one in _readings(found)]
    better = [one for one in others if one.told and one.told.left < CLEARER * told.left]
    least = min((one.told.left for one in better if one.told), default=0.0)
    sound = [(_odd(one.told), one) for one in better if one.told and CLEARER * one.told.left <= least]
    return min(sound, key=lambda pair: pair[0])[1] if sound else asked


def _odd(told: Answers) -> int:
    """How many commands do not do what they are called."""
    return sum(1 for name, answer in told.of.items() if answer.axis and (answer.axis != name or answer.sign < 0))


def _readings(found: Found) -> Iterator[Found]:
    """Other ways to read the pose that a card can say."""
    pose, asks = found.pose.channels, "by the motion: EDIT if that is not so"
    if {"x", "y"} <= pose.keys():
        yield _read(found, f"y turned, for the pose is mirrored {asks}", y=_turned(pose["y"]))
        yield _read(found, f"x and y exchanged, for the pose is mirrored {asks}", y=pose["x"], x=pose["y"])
    if "yaw" in pose:
        yield _read(found, f"yaw grows clockwise {asks}", yaw=_turned(pose["yaw"]))
        if pose["yaw"].unit is None:
            yield _read(found, f"yaw is in degrees {asks}", yaw=replace(pose["yaw"], unit="deg"))


def _read(found: Found, why: str, **channels: Channel) -> Found:
    """The same with channels of the pose changed."""
    pose = replace(found.pose, channels={**found.pose.channels, **channels})
    return replace(found, pose=pose, remarks={next(iter(channels)): why})


def _turned(channel: Channel) -> Channel:
    return replace(channel, scale=-channel.scale)


def _in_metres(found: Found, motion: Motion | None) -> Found:
    """The same with the unit of a position that no vehicle can have flown in metres."""
    known = {axis: channel for axis, channel in found.pose.channels.items() if axis in "xyz"}
    unit = position_unit(motion) if motion and not found.alone else None
    if unit is None or any(channel.unit for channel in known.values()):
        return found
    name, speed = unit
    read = _read(found, "", **{axis: replace(channel, unit=name) for axis, channel in known.items()})
    why = f'by the motion: its speed is {speed:.2g} m/s (RMS), in metres too much for any; EDIT: "cm" or "mm"'
    return replace(read, remarks={**found.remarks, "x": "; ".join(filter(None, (found.remarks.get("x"), why)))})


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
        channels[axis] = _turned(channel) if turned else channel
        mirrored = turned and told.frame is None and axis in ("x", "y")
        said[axis] = _remark(name, axis, answer, told.frame or "heading") + MIRRORED * mirrored
    return replace(commands, channels=channels), said


def _remark(name: str, axis: str, answer: Answer | None, frame: str) -> str:
    """What the motion says of one command."""
    if answer is None:
        return "does not move in this log: EDIT, sign unknown"
    sure, explained = f"{answer.certainty:.0f} standard errors", f"{100 * answer.explained:.0f} % explained"
    figures = f"{sure}, {explained}, delay and time constant together {answer.lag:.1f} s"
    if answer.axis is None:
        return f"EDIT: the motion does not tell the sign ({figures})"
    if answer.axis != axis:
        return f"EDIT: the motion follows it along {answer.axis} ({figures})"
    renamed = f", though it looks like {name}" if name != axis else ""
    return f"+ leads {_LEADS[frame][axis]} by the motion{renamed}: {figures}"


def write_draft(log: Log, path: Path, fresh: bool = False) -> None:
    """Writes the draft of a card to a new file; the arguments are those of `draft_card`.

    Raises:
        CardError: The file exists already: it may be a card that somebody has edited.
    """
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(draft_card(log, fresh))
    except FileExistsError:
        raise CardError(f"{path}: exists already and is not overwritten; choose another name or remove it") from None
