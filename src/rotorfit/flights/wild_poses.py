"""Wild poses: single ones, or up to three in a row, that lie away from all around them, where no vehicle can have been.

Markers that are taken for each other, reflections and flips of a tag make them. One of them tells the likelihood more
than a second of flight, and a heading that flips by half a turn makes the unwrapped heading lose a whole one.
"""

from itertools import combinations, pairwise

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask

BESIDE = 3
"""Largest number of poses on either side whose median a pose is compared with: as many in a row can be wild."""

NEXT = (5, 7)
"""Numbers of poses through which lines are drawn towards one beside a gap or at an end: fewer bound it more closely,
more bear that the next two are wild, too."""

GAP = 5.0
"""Period, over the usual one, across which poses are not compared."""

FLOOR = np.array([0.1, 0.2])
"""Distance from the poses around that is never wild, of position [m] and heading [rad]."""

SUDDEN = np.array([30.0, 20.0])
"""Largest acceleration of a vehicle [m/s^2, rad/s^2]: about the vertical only the drag of its rotors turns it."""

SWING = (0.5, 0.25, 2 / 9)
"""Largest distance from the median of three, five and seven poses of a vehicle that turns back with an acceleration of
1, at whatever speed, over the square of the time to the outermost."""

SIGMAS = 10.0
"""Robust standard deviations within which a pose is noisy, not wild."""

SPINNING = np.pi / 4
"""Turn from pose to pose [rad] above which the median heading of seven is none."""

FLIP, BACK = np.radians(150.0), 1.0
"""Least step of a heading that flips by half a turn [rad], and the longest time until it flips back [s]."""

RARE = 0.1
"""Largest share of the poses that can be wild: where more are, the unit is wrong, or the sensor is noisy in bursts."""


def wild(time: Array, pose: Array) -> Mask:
    """Which poses are wild.

    Motion at a steady speed leaves the median of the poses around on the pose, and one that turns back as hard as a
    vehicle can no further than its acceleration allows. The pose beside a gap is compared with a line through those on
    its other side. Both are repeated without the poses that were found, which may have hidden others.

    Args:
        time: Stamps, ascending, shape (N,) [s].
        pose: x, y, z [m] and heading, wrapped or not [rad], shape (N, 4).

    Returns:
        Shape (N,), rare or not: see `RARE`.
    """
    left = np.arange(len(time))
    for _ in range(BESIDE):
        away = _away(time[left], pose[left])
        left = left[~away]
        if not np.any(away):
            break
    return np.isin(np.arange(len(time)), left, invert=True)


def _away(time: Array, pose: Array) -> Mask:
    """Which poses are away from the median of those around, or, beside a gap, from the line through the next ones."""
    away = np.zeros(len(time), bool)
    if len(time) < 2 * BESIDE + 1:
        return away
    step = np.diff(time)
    apart = np.concatenate([[True], step > GAP * np.median(step), [True]])  # before each pose, and after the last
    piece = np.cumsum(apart[:-1])
    steps = np.pad(np.abs(_turn(np.diff(pose[:, 3]))), BESIDE, mode="edge")
    six = np.lib.stride_tricks.sliding_window_view(steps, 2 * BESIDE)
    turning = np.partition(six, 2, axis=1)[:, 2]  # the third smallest: two steps around a wild heading are its own
    noise = np.zeros(2)
    for beside in range(1, BESIDE + 1):
        around = np.lib.stride_tricks.sliding_window_view(np.arange(len(time)), 2 * beside + 1)
        own = around[:, beside]
        place = [one[own] - np.median(one[around], axis=1) for one in pose[:, :3].T]
        off = np.column_stack([np.linalg.norm(place, axis=0), np.abs(_median_turn(pose[around, 3], pose[own, 3]))])
        off[:, 1] *= turning[own] < SPINNING
        noise = SIGMAS * 1.4826 * np.median(off, axis=0)
        reach = np.maximum(time[around[:, -1]] - time[own], time[own] - time[around[:, 0]])
        beyond = np.any(off > FLOOR + noise + SWING[beside - 1] * SUDDEN * reach[:, None] ** 2, axis=1)
        away[own] |= beyond & (piece[around[:, 0]] == piece[around[:, -1]])
    for count in NEXT:
        away[_off_the_line(time, pose, apart, noise, count)] = True
    return away


def _off_the_line(time: Array, pose: Array, apart: Mask, noise: Array, count: int) -> Indices:
    """Which poses beside a gap, or at an end, are off the line through so many next ones, or last ones before it."""
    edge = np.flatnonzero(apart)
    at, way = np.concatenate([edge[:-1], edge[1:] - 1]), np.repeat([1, -1], edge.size - 1)
    places = np.arange(1, count + 1)
    beyond = at[:, None] + way[:, None] * places
    crossed = apart[np.clip(np.where(way[:, None] > 0, beyond, beyond + 1), 0, len(time))]
    known = np.all((beyond >= 0) & (beyond < len(time)) & ~crossed, axis=1)
    at, beyond = at[known], beyond[known]
    since = time[beyond] - time[at, None]
    off = pose[beyond] - pose[at, None]
    middle = _median_turn(pose[beyond, 3], pose[at, 3])
    off[:, :, 3] = middle[:, None] + _turn(off[:, :, 3] - middle[:, None])
    slopes = [(off[:, j] - off[:, i]) / (since[:, j] - since[:, i])[:, None] for i, j in combinations(range(count), 2)]
    speed = np.median(slopes, axis=0)
    by = np.median(off - since[:, :, None] * speed[:, None], axis=1)  # of the line, where the pose beside the gap is
    away = np.column_stack([np.linalg.norm(by[:, :3], axis=1), np.abs(_turn(by[:, 3]))])
    swing = abs(np.median(places**2 / 2 - np.mean(places) * places)) / count**2  # of that line, at an acceleration of 1
    return at[np.any(away > FLOOR + noise + swing * SUDDEN * since[:, -1:] ** 2, axis=1)]


def unwrapped(time: Array, heading: Array) -> Array:
    """The heading without jumps by a whole turn [rad].

    One that flips by half a turn and back, as that of a tag seen at a slant, comes back to where it was: from pose to
    pose alone it would end a whole turn further where it turns meanwhile.

    Args:
        time: Stamps, shape (N,) [s].
        heading: Shape (N,) [rad].
    """
    out = np.unwrap(heading)
    step = np.diff(out)
    flips = np.flatnonzero(np.abs(step) > FLIP)
    last: int = -1
    for first, second in pairwise(flips):
        if first == last or time[second + 1] - time[first] > BACK:
            continue
        last = int(second)
        turns = np.round((step[first] + step[second]) / (2 * np.pi))
        out[second + 1 :] -= 2 * np.pi * turns
    return np.asarray(out)


def _median_turn(around: Array, own: Array) -> Array:
    """Median of headings (N, K) around others (N,), from these on [rad]; half a turn has no sign, so by its sine."""
    by = around - own[:, None]
    return np.asarray(np.arctan2(np.median(np.sin(by), axis=1), np.median(np.cos(by), axis=1)))


def _turn(angle: Array) -> Array:
    """The angle in [-pi, pi) [rad]."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
