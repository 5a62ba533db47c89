"""Wild poses: single ones, or up to three in a row, that lie away from all around them, where no vehicle can have been.

Markers that are taken for each other, reflections and flips of a tag make them. One of them tells the likelihood more
than a second of flight, and a heading that flips by half a turn makes the unwrapped heading lose a whole one.
"""

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask

BESIDE = 3
"""Number of poses on either side whose median a pose is compared with: as many in a row can be wild."""

GAP = 5.0
"""Period, over the usual one, across which poses are not compared."""

FLOOR = np.array([0.1, 0.2])
"""Distance from the poses around that is never wild, of position [m] and heading [rad]."""

SUDDEN = np.array([60.0, 20.0])
"""Largest acceleration of a vehicle [m/s^2, rad/s^2]: about the vertical only the drag of its rotors turns it."""

SIGMAS = 10.0
"""Robust standard deviations within which a pose is noisy, not wild."""

RARE = 0.05
"""Largest share of the poses that can be wild: where more are, the unit is wrong, or the sensor is noisy in bursts."""


def wild(time: Array, pose: Array) -> Mask:
    """Which poses are wild.

    Motion at a steady speed leaves the median of the poses around on the pose, and one that turns back as hard as a
    vehicle can no further than its acceleration allows within their time. The pose beside a gap is compared with the
    line through those on its other side.

    Args:
        time: Stamps, ascending, shape (N,) [s].
        pose: x, y, z [m] and heading, wrapped or not [rad], shape (N, 4).

    Returns:
        Shape (N,); none where they would not be rare.
    """
    if len(time) < 2 * BESIDE + 1:
        return np.zeros(len(time), bool)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(np.arange(len(time)), BESIDE, mode="edge"), 2 * BESIDE + 1)
    place = np.linalg.norm([one - np.median(one[around], axis=1) for one in pose[:, :3].T], axis=0)
    by = pose[around, 3] - pose[:, 3, None]
    turn = np.abs(np.arctan2(np.median(np.sin(by), axis=1), np.median(np.cos(by), axis=1)))  # half a turn has no sign
    off = np.column_stack([place, turn])
    noise = SIGMAS * 1.4826 * np.median(off, axis=0)
    reach = np.maximum(time[around[:, -1]] - time, time - time[around[:, 0]])
    away = np.any(off > FLOOR + noise + SUDDEN * reach[:, None] ** 2 / 2, axis=1)
    sound = np.flatnonzero(~away)
    away[sound[_astray_beside_gaps(time[sound], pose[sound], noise)]] = True
    return np.asarray(away & (np.mean(away) <= RARE))


def _astray_beside_gaps(time: Array, pose: Array, noise: Array) -> Indices:
    """Which poses beside a gap, or at an end, are off the line through the next ones, or the last ones before it."""
    step = np.diff(time)
    apart = np.concatenate([[True], step > GAP * np.median(step), [True]])  # before each pose, and after the last
    found = []
    for edge in np.flatnonzero(apart):
        for at, way in ((edge - 1, -1), (edge, 1)):
            beyond = at + way * np.arange(1, BESIDE + 1)
            inner = apart[min(at, beyond[-1]) + 1 : max(at, beyond[-1]) + 1]
            if not (0 <= at < len(time) and 0 <= beyond[-1] < len(time)) or np.any(inner):
                continue
            since = time[beyond] - time[at]
            heading = np.unwrap(pose[beyond, 3])
            line = np.polynomial.polynomial.polyfit(since, np.column_stack([pose[beyond, :3], heading]), 1)[0]
            by = pose[at] - line
            turn = abs((by[3] + np.pi) % (2 * np.pi) - np.pi)
            off = np.array([np.linalg.norm(by[:3]), turn])
            if np.any(off > FLOOR + 2 * noise + SUDDEN * since[-1] ** 2 / 2):  # the line errs by more than a median
                found.append(at)
    return np.array(found, dtype=np.int64)
