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
    edge = np.flatnonzero(apart)
    at, way = np.concatenate([edge[:-1], edge[1:] - 1]), np.repeat([1, -1], edge.size - 1)
    beyond = at[:, None] + way[:, None] * np.arange(1, BESIDE + 1)
    inside = (beyond >= 0) & (beyond < len(time))
    crossed = apart[np.clip(np.where(way[:, None] > 0, beyond, beyond + 1), 0, len(time))]
    known = np.all(inside & ~crossed, axis=1)
    at, beyond = at[known], beyond[known]
    since = time[beyond] - time[at, None]
    middle = since - since.mean(axis=1, keepdims=True)
    share = 1 / BESIDE - since.mean(axis=1, keepdims=True) * middle / np.sum(middle**2, axis=1, keepdims=True)
    off = pose[beyond] - pose[at, None]
    off[:, :, 3] = _turn(off[:, :, 3] - off[:, :1, 3]) + _turn(off[:, :1, 3])
    by = np.einsum("ij,ijk->ik", share, off)  # of the line, where the pose beside the gap is
    away = np.column_stack([np.linalg.norm(by[:, :3], axis=1), np.abs(_turn(by[:, 3]))])
    bound = FLOOR + 2 * noise + SUDDEN * since[:, -1:] ** 2 / 2  # a line errs by more than a median
    return at[np.any(away > bound, axis=1)]


def _turn(angle: Array) -> Array:
    """The angle in [-pi, pi) [rad]."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
