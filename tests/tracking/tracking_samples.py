"""A recorded flight as the samples of a link."""

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.log import Sample

LAST = 13.5
"""So much of the flight is given to trackers here [s]."""


def samples_of(flight: Flight, end: float = LAST) -> list[Sample]:
    """Poses and commands in the order of their stamps, up to an end [s]."""
    out = []
    for t, position, yaw in zip(flight.pose_time, flight.position, flight.yaw, strict=True):
        quaternion = (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2)))
        out.append(Sample("pose", round(1e9 * t), round(1e9 * t), (*position.tolist(), *quaternion)))
    for t, command in zip(flight.command_time, flight.command, strict=True):
        out.append(Sample("command", round(1e9 * t), round(1e9 * t), tuple(command.tolist())))
    return sorted((one for one in out if one.stamp < end * 1e9), key=lambda one: one.stamp)
