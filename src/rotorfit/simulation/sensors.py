"""Sensors and radio: what is measured or sent when, with which errors, and when it arrives.

All randomness is drawn by the index of a frame, in blocks, from a separate generator: how often samples are read does
not change it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.compiled import kernel
from rotorfit.core.frames import Array
from rotorfit.simulation.rigid_body import CHARGE
from rotorfit.simulation.vehicle import Odometry, Radio

Three = tuple[float, float, float]

Integers = npt.NDArray[np.int64]

BATTERY_RATE = 1.0  # samples a second


@dataclass(frozen=True)
class Swap:
    """Swapped markers: for a while the body appears rotated and displaced.

    Attributes:
        start: Start, since the start of the flight [s].
        end: End [s].
        turn: Added to the heading [rad].
        offset: Added to the position, world [m].
    """

    start: float
    end: float
    turn: float = 0.0
    offset: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Turn:
    """Permanent rotation of the mocap's frame, as by a new calibration: positions and headings turn about the vertical.

    Attributes:
        start: Since the start of the flight [s].
        angle: Rotation of the poses, counter-clockwise about the world's origin [rad].
    """

    start: float
    angle: float


@dataclass(frozen=True)
class Mocap:
    """Motion capture, as it reaches the user.

    Attributes:
        rate: Frame rate [Hz].
        noise: Standard deviation of the white error of x, y, z each [m].
        turn_noise: Standard deviation of the white error of the attitude about each axis [rad].
        latency: Least time from the exposure to the arrival of a frame [s].
        jitter: Mean of an additional, exponentially distributed time [s]; frames stay in order.
        stale: Share of frames that repeat the previous frame with a fresh stamp, drawn independently.
        lost: Share of frames that never arrive, drawn independently.
        drop_outs: Intervals (start, end) without frames, since the start of the flight [s].
        swaps: Intervals with swapped markers.
        frozen: Intervals (start, end) in which every frame repeats the last one before, under fresh stamps [s].
        turns: Rotations of the frame; they add up.

    Raises:
        ValueError: A negative or impossible value.
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
    frozen: tuple[tuple[float, float], ...] = ()
    turns: tuple[Turn, ...] = ()

    def __post_init__(self) -> None:
        shares = (self.stale, self.lost)
        if self.rate <= 0 or min(self.noise, self.turn_noise, self.latency, self.jitter) < 0:
            raise ValueError("mocap: rate must be positive, noise, latency and jitter must not be negative")
        if not all(0 <= share < 1 for share in shares):
            raise ValueError("mocap: shares of stale and lost frames must be in [0, 1)")


@dataclass(frozen=True)
class SenderClock:
    """A sender's clock: it shows offset + (1 + drift) t.

    Attributes:
        offset: Offset [s].
        drift: Drift [s/s].
    """

    offset: float = 0.0
    drift: float = 0.0

    def shows(self, instant: Integers) -> Integers:
        """Readings of the clock at true instants [ns]."""
        shift = np.round(self.offset * 1e9 + instant * self.drift).astype(np.int64)
        return np.asarray(instant + shift)


@dataclass(frozen=True)
class Frames:
    """Frames of one stream drawn so far, in order; N frames.

    Attributes:
        instant: When each is taken [ns].
        arrival: When each arrives, increasing [ns].
        stamp: Reading of the sender's clock when it is taken [ns].
        shown: Index of the frame whose content it carries, shape (N,): its own, or an older one if it is stale.
        kept: Whether it arrives at all.
        error: Drawn errors: for poses x, y, z [m], three rotations [rad]; for velocities x, y, z [m/s], yaw rate
            [rad/s].
        shift: For poses: x, y, z [m] and rotation [rad] of swapped markers, rotation of the frame [rad], shape (N, 5).
    """

    instant: Integers
    arrival: Integers
    stamp: Integers
    shown: Integers
    kept: npt.NDArray[np.bool_]
    error: Array
    shift: Array


def mocap_frames(
    mocap: Mocap, clock: SenderClock, rng: np.random.Generator, first: int, count: int, before: tuple[int, int]
) -> Frames:
    """Draws frames `first` to `first` + `count`.

    Args:
        mocap: The system.
        clock: Its clock.
        rng: Generator for these frames alone.
        first: Index of the first frame.
        count: Number of frames.
        before: `shown` of the previous frame (-1 if there is none), and its arrival [ns].
    """
    index = first + np.arange(count)
    instant = np.round(index / mocap.rate * 1e9).astype(np.int64)
    error = rng.standard_normal((count, 6)) * np.repeat([mocap.noise, mocap.turn_noise], 3)
    drawn, late = rng.random((count, 2)), rng.standard_exponential(count)
    time = instant * 1e-9
    kept = drawn[:, 0] >= mocap.lost
    for start, end in mocap.drop_outs:
        kept &= (time < start) | (time >= end)
    shift = np.zeros((count, 5))
    for swap in mocap.swaps:
        shift[(time >= swap.start) & (time < swap.end), :4] += (*swap.offset, swap.turn)
    for turn in mocap.turns:
        shift[time >= turn.start, 4] += turn.angle
    fresh = kept & (drawn[:, 1] >= mocap.stale)
    for start, end in mocap.frozen:
        fresh &= (time < start) | (time >= end)
    fresh[0] |= before[0] < 0  # the very first frame has none to repeat
    shown = np.maximum.accumulate(np.where(fresh, index, before[0]))
    arrival = _in_order(instant, mocap.latency, mocap.jitter * late, before[1])
    return Frames(instant, arrival, clock.shows(instant), shown, kept, error, shift)


def velocity_frames(
    odometry: Odometry,
    clock: SenderClock,
    bias: Array,
    rng: np.random.Generator,
    first: int,
    count: int,
    before: tuple[int, int],  # noqa: ARG001 no frame depends on another; all streams are drawn alike
) -> Frames:
    """Onboard velocities with the flight's bias, shape (3,) [m/s]; the other arguments as for `mocap_frames`."""
    error = rng.standard_normal((count, 4)) * np.array([odometry.noise] * 3 + [odometry.yaw_noise])
    error[:, :3] += bias
    return _plain_frames(odometry.rate, odometry.latency, clock, first, error)


def battery_frames(
    latency: float,
    clock: SenderClock,
    first: int,
    count: int,
    before: tuple[int, int],  # noqa: ARG001 as above
) -> Frames:
    """Frames of the battery's charge; the arguments as for `mocap_frames`."""
    return _plain_frames(BATTERY_RATE, latency, clock, first, np.zeros((count, 1)))


def _plain_frames(rate: float, latency: float, clock: SenderClock, first: int, error: Array) -> Frames:
    """Frames that all arrive, each with its own content, after the same latency."""
    index = first + np.arange(len(error))
    instant = np.round(index / rate * 1e9).astype(np.int64)
    arrival, kept = instant + round(latency * 1e9), np.ones(len(error), np.bool_)
    return Frames(instant, arrival, clock.shows(instant), index, kept, error, np.zeros((len(error), 5)))


def _in_order(instant: Integers, latency: float, late: Array, before: int) -> Integers:
    """Arrivals that never overtake each other [ns]."""
    arrival = instant + np.round((latency + late) * 1e9).astype(np.int64)
    return np.asarray(np.maximum.accumulate(np.maximum(arrival, before)))


class FrameStream:
    """Frames of one sensor: drawn in blocks, each returned once, after it has arrived.

    Attributes:
        name: Stream name of a `Sample`.
        frames: All frames drawn.
        row: Index of the shot at which each is taken, shape (N,).
    """

    def __init__(
        self,
        name: Literal["pose", "velocity", "battery"],
        rate: float,
        draw: Callable[[int, int, tuple[int, int]], Frames],
        read: Callable[[Array, Integers, Frames, Integers], Array],
    ) -> None:
        """Starts without a frame.

        Args:
            name: Stream name of a `Sample`.
            rate: Frame rate [Hz].
            draw: Draws frames from their first index, their number, and `shown` and arrival of the previous frame.
            read: Returns the sensor's values from the states at the shots, the rows, the frames, and the indices of the
                requested frames.
        """
        whole, real = np.empty(0, np.int64), np.empty((0, 0))
        self.name = name
        self.frames = Frames(whole, whole, whole, whole, np.empty(0, np.bool_), real, real)
        self.row = whole
        self._rate, self._draw, self._read = rate, draw, read
        self._given = 0
        self._arrivals: list[int] = []

    def draw(self, end: float) -> Integers:
        """Draws the frames taken before `end` [s]; returns the instants of the new ones [ns]."""
        old = self.frames
        first = old.instant.size
        before = (int(old.shown[-1]), int(old.arrival[-1])) if first else (-1, 0)
        new = self._draw(first, int(np.ceil(end * self._rate - 1e-6)) - first, before)
        parts = (np.concatenate([getattr(old, name), getattr(new, name)]) for name in vars(new)) if first else ()
        self.frames = Frames(*parts) if first else new
        self._arrivals += new.arrival.tolist()
        return new.instant

    def place(self, row: Integers) -> None:
        """Sets the shots at which the new frames are taken."""
        self.row = np.concatenate([self.row, row])

    def arrived(self, until: int) -> Integers:
        """Indices of the frames that have arrived since the last call, without lost ones."""
        first = self._given
        while self._given < len(self._arrivals) and self._arrivals[self._given] <= until:
            self._given += 1
        index = np.arange(first, self._given)
        return index[self.frames.kept[first : self._given]]

    def values(self, seen: Array, index: Integers) -> Array:
        """Values of frames, given the states at the shots."""
        return self._read(seen, self.row, self.frames, index)


def poses(seen: Array, row: Integers, frames: Frames, index: Integers) -> Array:
    """Measured x, y, z [m] and quaternion w, x, y, z of frames, shape (N, 7)."""
    out = np.empty((index.size, 7))
    _see_poses(seen, row, frames.shown[index], frames.error, frames.shift, out)
    return out


def velocities(seen: Array, row: Integers, frames: Frames, index: Integers) -> Array:
    """Measured velocity forward, left, up [m/s] and yaw rate [rad/s] of frames, heading frame, shape (N, 4)."""
    out = np.empty((index.size, 4))
    _see_velocities(seen, row, index, frames.error, out)
    return out


def charges(seen: Array, row: Integers, frames: Frames, index: Integers) -> Array:  # noqa: ARG001 all streams are read alike
    """Remaining charge of the battery, 0 to 1, shape (N, 1)."""
    return seen[row[index], CHARGE : CHARGE + 1]


@kernel()
def _see_poses(seen, row, shown, error, shift, out):  # type: ignore[no-untyped-def]
    """Fills measured poses of frames that carry the content of the frames `shown`; x, y, z, quaternion w, x, y, z.

    Args:
        seen: States at the shots, shape (., SEEN).
        row: Index of the shot of each frame of the stream.
        shown: Indices of the frames whose content is used, shape (N,).
        error: Errors of each frame of the stream, shape (., 6).
        shift: Shifts of each frame of the stream, shape (., 5).
        out: Filled, shape (N, 7).
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
        if shift[k, 4] != 0.0:
            p, q = np.cos(shift[k, 4]), np.sin(shift[k, 4])
            out[n, 0], out[n, 1] = p * out[n, 0] - q * out[n, 1], p * out[n, 1] + q * out[n, 0]
        turn = shift[k, 3] + shift[k, 4]
        if turn != 0.0:  # about the world's vertical
            p, q = np.cos(turn / 2), np.sin(turn / 2)
            w, x, y, z = p * w - q * z, p * x - q * y, p * y + q * x, p * z + q * w
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        out[n, 3], out[n, 4], out[n, 5], out[n, 6] = w / norm, x / norm, y / norm, z / norm


@kernel()
def _see_velocities(seen, row, shown, error, out):  # type: ignore[no-untyped-def]
    """Measured velocities, heading frame: forward, left, up [m/s], yaw rate [rad/s]; arguments as for `_see_poses`."""
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


class RadioSource:
    """Arrival of commands, drawn by the index of the command."""

    def __init__(self, radio: Radio, seed: np.random.SeedSequence) -> None:
        """Starts with no command in transit."""
        self._radio, self._last = radio, 0
        self._late, self._lost = (np.random.default_rng(one) for one in seed.spawn(2))

    def arrivals(self, sent: Integers, slower: Array) -> tuple[Integers, npt.NDArray[np.bool_]]:
        """Arrival of each command [ns], and whether it arrives at all.

        Args:
            sent: Shape (N,) [ns].
            slower: Additional latency due to changes of the radio, shape (N,) [s].
        """
        late = slower + self._radio.jitter * self._late.standard_exponential(sent.size)
        arrival = _in_order(sent, self._radio.latency, late, self._last)
        self._last = int(arrival[-1]) if sent.size else self._last
        return arrival, self._lost.random(sent.size) >= self._radio.loss

    def arrival_of_request(self, now: int, slower: float) -> int:
        """Arrival of a take-off or landing request: never lost, not before earlier commands [ns]."""
        self._last = max(self._last, now + round((self._radio.latency + slower) * 1e9))
        return self._last
