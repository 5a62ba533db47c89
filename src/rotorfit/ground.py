"""Commands that a vehicle on the ground does not answer: told to climb and not off it yet, or told to sink and down."""

import numpy as np

from rotorfit.card import Card
from rotorfit.clock import Mask, Stamps
from rotorfit.frames import Array, Indices
from rotorfit.stream import Stream, closed, kept

LEAST = 1.0
"""Time for which a command must go unanswered [s]: delays of velocity-commanded vehicles are below half of it."""

ASKED = 0.3
"""Way up or down that is asked for in that time [m]."""

STILL = 0.05
"""Change of height in that time that is no answer [m]: a loop with a time constant of 1 s moves by twice as much."""

LEVEL = 0.15
"""Change of height that still counts as standing [m]: onboard heights drift by a tenth of a metre in some seconds."""

LOW = 0.25
"""Share of the flight's range of heights, from the lowest on, in which the ground may lie: over a minute onboard
heights drift by more than half a metre."""


def airborne(commands: Stream, poses: Stream, card: Card) -> Stream:
    """The commands without those that `standing` finds; all of them where the card does not give the climb in m/s."""
    factor = _climb(card)
    if factor is None:
        return commands
    ground = standing(commands.stamps, factor * commands.values[:, 2], poses.stamps, poses.values[:, 2])
    commands = closed(commands, commands.stamps[ground])
    return kept(commands, ~ground, "commands_on_ground", "ask to climb or sink of a vehicle on the ground: dropped")


def _climb(card: Card) -> float | None:
    """What a vertical command of 1 asks for [m/s]; None where the card does not say."""
    channel = card.command.get("z")
    if channel is None or channel.meaning not in ("velocity", "vertical_speed"):
        return None
    return 1.0 if channel.full_scale is None else card.limits.get(channel.full_scale)


def standing(command_time: Stamps, climb: Array, pose_time: Stamps, height: Array) -> Mask:
    """Which commands lie before the take-off or after the landing, shape (M,).

    Before: from the first command on the height stays within `LEVEL`, low, and leaves upwards, and at some time in it
    the commands ask for `ASKED` metres of climb in `LEAST` seconds and the height stands still. After: the same from
    the end backwards, with commands that ask to sink. A vehicle in the air would have moved.

    Args:
        command_time: Increasing, shape (M,) [ns].
        climb: Vertical command, up positive, shape (M,) [m/s].
        pose_time: Increasing, shape (N,) [ns].
        height: Shape (N,) [m].
    """
    ground = np.zeros(len(command_time), dtype=np.bool_)
    seen = (pose_time >= command_time[0]) & (pose_time <= command_time[-1])
    if np.sum(seen) < 2:
        return ground
    time, level = pose_time[seen], height[seen]
    for sign in (1, -1):
        index = np.arange(len(time))[::sign]
        stays = _stay(level[index])
        low = level[index[0]] <= np.min(level) + max(LEVEL, LOW * float(np.ptp(level)))
        if stays == len(time) or not low or level[index[stays]] < level[index[0]]:
            continue
        edge = time[index[stays]]
        part = command_time < edge if sign == 1 else command_time > edge
        stood = index[:stays][::sign]
        if _unanswered(command_time[part], sign * climb[part], time[stood], level[stood]):
            ground |= part
    return ground


def _unanswered(command_time: Stamps, climb: Array, time: Stamps, level: Array) -> bool:
    """Whether commands that ask for `ASKED` metres in `LEAST` seconds left the height where it was."""
    ends = np.searchsorted(command_time, command_time + round(LEAST * 1e9))
    steps = np.diff(command_time, append=command_time[-1:]) / 1e9
    way = np.concatenate([[0.0], np.cumsum(climb * steps)])
    for first, last in enumerate(ends.tolist()):
        if last == len(command_time):
            return False
        if way[last] - way[first] >= ASKED:
            during = level[(time >= command_time[first]) & (time <= command_time[last])]
            if during.size > 1 and np.ptp(during) < STILL:
                return True
    return False


def _stay(level: Array) -> int:
    """How many heights from the first one on keep within `LEVEL` of each other."""
    spread = np.maximum.accumulate(level) - np.minimum.accumulate(level)
    left: Indices = np.flatnonzero(spread > LEVEL)
    return int(left[0]) if left.size else len(level)
