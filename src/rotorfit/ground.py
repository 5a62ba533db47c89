"""Commands that a vehicle on the ground does not answer: told to climb and not off it yet, or told to sink and down."""

import numpy as np

from rotorfit.clock import Mask, Stamps
from rotorfit.frames import Array, Indices
from rotorfit.stream import Stream, closed, kept

LEAST = 1.0
"""Time for which a command must go unanswered [s]: delays of velocity-commanded vehicles are below half of it."""

LEVEL = 0.15
"""Change of height that still counts as standing [m]: onboard heights drift by a tenth of a metre in some seconds."""

LOW = 0.25
"""Share of the flight's range of heights, from the lowest on, in which the ground may lie: over a minute onboard
heights drift by more than half a metre."""

PUSH = 0.7
"""Mean command over `LEAST` seconds, against the root mean square of the flight's, that moves a vehicle in the air."""

STILL = 0.05
"""Change of height in that time that is none [m]."""


def airborne(commands: Stream, poses: Stream) -> Stream:
    """The commands without those that `standing` finds, and a note."""
    ground = standing(commands.stamps, commands.values[:, 2], poses.stamps, poses.values[:, 2])
    commands = closed(commands, commands.stamps[ground])
    return kept(commands, ~ground, "commands_on_ground", "ask to climb or sink of a vehicle on the ground: dropped")


def standing(command_time: Stamps, climb: Array, pose_time: Stamps, height: Array) -> Mask:
    """Which commands lie before the take-off or after the landing, shape (M,).

    Before: from the first command on the height stays within `LEVEL`, low, and leaves upwards, and at some time in it
    the commands ask for a climb for `LEAST` seconds and the height stands still. After: the same from the end
    backwards, with commands that ask to sink. A vehicle in the air would have moved.

    Args:
        command_time: Increasing, shape (M,) [ns].
        climb: Vertical command, up positive, shape (M,).
        pose_time: Increasing, shape (N,) [ns].
        height: Shape (N,) [m].
    """
    ground = np.zeros(len(command_time), dtype=np.bool_)
    largest = float(np.max(np.abs(climb)))
    rms = largest * float(np.sqrt(np.mean((climb / largest) ** 2))) if largest else 0.0
    seen = (pose_time >= command_time[0]) & (pose_time <= command_time[-1])
    if rms == 0 or np.sum(seen) < 2:
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
        kept = index[:stays]
        if _unanswered(command_time[part], sign * climb[part], time[kept][::sign], level[kept][::sign], PUSH * rms):
            ground |= part
    return ground


def _unanswered(command_time: Stamps, climb: Array, time: Stamps, level: Array, push: float) -> bool:
    """Whether commands of at least `push` over `LEAST` seconds left the height where it was."""
    ends = np.searchsorted(command_time, command_time + round(LEAST * 1e9))
    total = np.concatenate([[0.0], np.cumsum(climb)])
    for first, last in enumerate(ends.tolist()):
        if last == len(command_time):
            return False
        if total[last] - total[first] >= push * (last - first):
            during = level[(time >= command_time[first]) & (time <= command_time[last])]
            if during.size > 1 and np.ptp(during) < STILL:
                return True
    return False


def _stay(level: Array) -> int:
    """How many heights from the first one on keep within `LEVEL` of each other."""
    spread = np.maximum.accumulate(level) - np.minimum.accumulate(level)
    left: Indices = np.flatnonzero(spread > LEVEL)
    return int(left[0]) if left.size else len(level)
