"""Commands that a vehicle on the ground does not answer: told to climb and not off it yet, or told to sink and down."""

import numpy as np

from rotorfit.clock import Mask, Stamps
from rotorfit.frames import Array, Indices
from rotorfit.stream import Stream, closed, kept

LEAST = 1.0
"""Time for which the vehicle must stand [s]: delays of velocity-commanded vehicles are below half of it."""

LEVEL = 0.15
"""Height that still counts as the ground, above the lowest there [m]: onboard heights drift by a tenth of a metre."""

PUSH = 0.3
"""Least mean command, against the root mean square of the flight's, that would have moved a vehicle in the air."""


def airborne(commands: Stream, poses: Stream) -> Stream:
    """The commands without those that `standing` finds, and a note."""
    ground = standing(commands.stamps, commands.values[:, 2], poses.stamps, poses.values[:, 2])
    commands = closed(commands, commands.stamps[ground])
    return kept(commands, ~ground, "commands_on_ground", "ask to climb or sink of a vehicle on the ground: dropped")


def standing(command_time: Stamps, climb: Array, pose_time: Stamps, height: Array) -> Mask:
    """Which commands lie before the take-off or after the landing, shape (M,).

    Before: from the first command on the height stays, the lowest of the flight, within `LEVEL`, for `LEAST` seconds
    at least, while the commands ask for a climb. After: the same from the end, while they ask to sink. A vehicle in the
    air cannot do this: it would move, or have been lower before.

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
        if stays == len(time) or level[index[0]] > np.min(level) + LEVEL:
            continue
        edge = time[index[stays]]
        part = command_time < edge if sign == 1 else command_time > edge
        if abs(edge - time[index[0]]) >= LEAST * 1e9 and np.any(part) and sign * np.mean(climb[part]) > PUSH * rms:
            ground |= part
    return ground


def _stay(level: Array) -> int:
    """How many heights from the first one on keep within `LEVEL` of each other."""
    spread = np.maximum.accumulate(level) - np.minimum.accumulate(level)
    left: Indices = np.flatnonzero(spread > LEVEL)
    return int(left[0]) if left.size else len(level)
