"""Sensors: motion capture, onboard velocity, battery; what is measured when, what goes wrong, when it arrives.

Everything random is drawn by the index of a frame, in blocks, from a generator of its own: how often somebody looks
does not change it.
"""

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from rotorfit.frames import Array
from rotorfit.vehicle import Odometry

Three = tuple[float, float, float]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Swap:
    """Markers taken for others: for a while the body is seen turned and displaced.

    Attributes:
        start: Since the start of the flight [s].
        end: [s].
        turn: Added to the heading [rad].
        offset: Added to the position, world [m].
    """

    start: float
    end: float
    turn: float = 0.0
    offset: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Mocap:
    """Motion capture, as it reaches the user.

    Attributes:
        rate: Frames a second.
        noise: Standard deviation of the white error of x, y, z each [m].
        turn_noise: Standard deviation of the white error of the attitude about each axis [rad].
        latency: Least time from the exposure until a frame arrives [s].
        jitter: Mean of the exponentially distributed time on top [s]; frames stay in order.
        stale: Share of frames that repeat the frame before with a fresh stamp, each drawn alone.
        lost: Share of frames that never arrive, each drawn alone.
        drop_outs: Intervals (start, end) without frames, since the start of the flight [s].
        swaps: See `Swap`.
    """

    rate: float = 120.0
    noise: float = 0.0005
    turn_noise: float = 0.002
    latency: float = 0.008
    jitter: float = 0.001
    stale: float = 0.0
    lost: float = 0.0
    drop_outs: tuple[tuple[float, float], ...] = ()
    swaps: tuple[Swap, ...] = ()

    def __post_init__(self) -> None:
        shares = (self.stale, self.lost)
        if self.rate <= 0 or min(self.noise, self.turn_noise, self.latency, self.jitter) < 0:
            raise ValueError("mocap: rate must be positive, noise, latency and jitter must not be negative")
        if not all(0 <= share < 1 for share in shares):
            raise ValueError("mocap: shares of stale and lost frames must be in [0, 1)")


@dataclass(frozen=True)
class Clock:
    """A sender's clock: it shows offset + (1 + drift) t.

    Attributes:
        offset: [s].
        drift: Seconds a second.
    """

    offset: float = 0.0
    drift: float = 0.0

    def shows(self, instant: Integers) -> Integers:
        """What it shows at true instants [ns]."""
        shift = np.round(self.offset * 1e9 + instant * self.drift).astype(np.int64)
        return np.asarray(instant + shift)


@dataclass(frozen=True)
class Frames:
    """Frames of one stream, in order, as far as they have been drawn. N frames.

    Attributes:
        instant: When each is taken [ns].
        arrival: When each arrives, increasing [ns].
        stamp: What its sender's clock shows when it is taken [ns].
        shown: Index of the frame whose content it carries, shape (N,): its own, or an older one where it is stale.
        kept: Whether it arrives at all.
        error: Drawn errors: of pose x, y, z [m], three turns [rad]; of velocity x, y, z [m/s], yaw rate [rad/s].
        shift: For poses: x, y, z [m] and turn [rad] of swapped markers, shape (N, 4).
    """

    instant: Integers
    arrival: Integers
    stamp: Integers
    shown: Integers
    kept: npt.NDArray[np.bool_]
    error: Array
    shift: Array


def mocap_frames(
    mocap: Mocap, clock: Clock, first: int, count: int, before: tuple[int, int], rng: np.random.Generator
) -> Frames:
    """Frames `first` to `first` + `count`.

    Args:
        mocap: The system.
        clock: Its clock.
        first: Index of the first frame.
        count: Number of frames.
        before: What the frame before showed (its `shown`; -1 where there is none), and when it arrived [ns].
        rng: Of these frames alone.
    """
    instant = np.round((first + np.arange(count)) / mocap.rate * 1e9).astype(np.int64)
    error = rng.standard_normal((count, 6)) * np.repeat([mocap.noise, mocap.turn_noise], 3)
    drawn, late = rng.random((count, 2)), rng.standard_exponential(count)
    time = instant * 1e-9
    kept = drawn[:, 0] >= mocap.lost
    for start, end in mocap.drop_outs:
        kept &= (time < start) | (time >= end)
    shift = np.zeros((count, 4))
    for swap in mocap.swaps:
        shift[(time >= swap.start) & (time < swap.end)] += (*swap.offset, swap.turn)
    fresh = kept & (drawn[:, 1] >= mocap.stale)
    fresh[0] |= before[0] < 0  # the very first frame has none to repeat
    shown = np.maximum.accumulate(np.where(fresh, first + np.arange(count), before[0]))
    arrival = in_order(instant, mocap.latency, mocap.jitter * late, before[1])
    return Frames(instant, arrival, clock.shows(instant), shown, kept, error, shift)


def velocity_frames(
    odometry: Odometry, clock: Clock, first: int, count: int, bias: Array, rng: np.random.Generator
) -> Frames:
    """Onboard velocities `first` to `first` + `count`, with the flight's bias, shape (3,) [m/s]."""
    index = first + np.arange(count)
    instant = np.round(index / odometry.rate * 1e9).astype(np.int64)
    error = rng.standard_normal((count, 4)) * np.array([odometry.noise] * 3 + [odometry.yaw_noise])
    error[:, :3] += bias
    arrival = instant + round(odometry.latency * 1e9)
    return Frames(instant, arrival, clock.shows(instant), index, np.ones(count, bool), error, np.zeros((count, 4)))


def in_order(instant: Integers, latency: float, late: Array, before: int) -> Integers:
    """Arrivals that never overtake each other [ns]."""
    arrival = instant + np.round((latency + late) * 1e9).astype(np.int64)
    return np.asarray(np.maximum.accumulate(np.maximum(arrival, before)))


@numba.njit(cache=True)
def see_poses(seen, row, shown, error, shift, out):  # type: ignore[no-untyped-def]
    """Measured poses of frames whose contents are the frames `shown`; x, y, z, quaternion w, x, y, z.

    Args:
        seen: States at the shots, shape (., STATES).
        row: The shot of each frame of the stream.
        shown: Which frames' contents are wanted, shape (N,).
        error: Of each frame of the stream, shape (., 6).
        shift: Of each frame of the stream, shape (., 4).
        out: Shape (N, 7), filled.
    """
    for n in range(shown.size):
        k = shown[n]
        s = seen[row[k]]
        for j in range(3):
            out[n, j] = s[j] + error[k, j] + shift[k, j]
        w, x, y, z = s[6], s[7], s[8], s[9]
        a, b, c = error[k, 3] / 2, error[k, 4] / 2, error[k, 5] / 2  # a small turn seen from the body
        w, x, y, z = (
            w - x * a - y * b - z * c,
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
        )
        if shift[k, 3] != 0.0:  # a turn about the world's vertical
            p, q = np.cos(shift[k, 3] / 2), np.sin(shift[k, 3] / 2)
            w, x, y, z = p * w - q * z, p * x - q * y, p * y + q * x, p * z + q * w
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        out[n, 3], out[n, 4], out[n, 5], out[n, 6] = w / norm, x / norm, y / norm, z / norm


@numba.njit(cache=True)
def see_velocities(seen, row, shown, error, out):  # type: ignore[no-untyped-def]
    """Measured velocities, heading frame: forward, left, up [m/s], yaw rate [rad/s]; arguments as for `see_poses`."""
    for n in range(shown.size):
        k = shown[n]
        s = seen[row[k]]
        w, x, y, z = s[6], s[7], s[8], s[9]
        hx, hy = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z)
        level = 1 / np.sqrt(hx * hx + hy * hy)
        hx, hy = hx * level, hy * level
        r32, r33 = 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        out[n, 0] = hx * s[3] + hy * s[4] + error[k, 0]
        out[n, 1] = hx * s[4] - hy * s[3] + error[k, 1]
        out[n, 2] = s[5] + error[k, 2]
        out[n, 3] = (s[11] * r32 + s[12] * r33) / (r32 * r32 + r33 * r33) + error[k, 3]
