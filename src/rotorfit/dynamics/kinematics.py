"""Position -> velocity and acceleration: a polynomial fitted by least squares around every stamp.

The stamps are used as they are: irregular, jittered, with gaps where stale poses were dropped. Nothing is resampled.

Also the measurements of a segment on one clock, with the reference velocity, for the prediction protocol.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.flight_data import LONGEST_GAP, Flight
from rotorfit.core.frames import AXES, Array, Indices, Mask, heading_from_world
from rotorfit.core.results import Motion

NANOSECOND = 1e-9
"""Tolerance at the edge of a window [s]: stamps are whole nanoseconds, and the rounding of their difference must not
decide whether a sample on the edge belongs to the window."""


@dataclass(frozen=True)
class Derivatives:
    """Local polynomials at M stamps, for K columns; without a result all values are NaN and `centred` is False.

    Attributes:
        value: The polynomial's own value, shape (M, K), in the unit of the data.
        velocity: First time derivative, shape (M, K) [unit/s].
        acceleration: Second time derivative, shape (M, K) [unit/s^2].
        half_width: Half width of the window used, after widening, shape (M,) [s].
        count: Number of samples in it, shape (M,); 0 without a result.
        centred: Whether the data reach both edges of the window, shape (M,). Where they do not (near the ends of the
            data and of gaps longer than `max_gap`) the fit is one-sided and its derivatives are much noisier.
    """

    value: Array
    velocity: Array
    acceleration: Array
    half_width: Array
    count: Indices
    centred: Mask


def local_polynomial(
    time: Array,
    value: Array,
    at: Array,
    half_width: float,
    degree: int,
    *,
    least: int | None = None,
    max_gap: float = 1.0,
) -> Derivatives:
    """Fits an unweighted polynomial to the samples within `half_width` of each stamp in `at`, and differentiates it.

    A window with fewer than `least` samples is widened, symmetrically in time, until it holds them. A gap longer than
    `max_gap` between two samples splits the data into runs, and no window crosses it. There is no result (NaN) at a
    stamp inside such a gap, before the first or after the last sample, or in a run of fewer than `least` samples. A NaN
    sample makes the windows that contain it NaN.

    Each fit projects on polynomials that are orthogonal on the stamps of its own window (Forsythe's recurrence, time in
    units of the window), so no normal equations are formed; it is exact for polynomials up to `degree`.

    Args:
        time: Strictly increasing stamps, shape (N,) [s].
        value: Samples, shape (N, K); angles unwrapped.
        at: Stamps at which to differentiate, in any order, shape (M,) [s].
        half_width: Half width of the window [s].
        degree: Degree of the polynomial, at least 2.
        least: Least number of samples in a window, more than `degree`; None for `degree` + 2.
        max_gap: Longest gap between two samples that a window may cross [s].

    Returns:
        Value, velocity and acceleration at the M stamps, with the properties of each window.

    Raises:
        ValueError: Inconsistent shapes, stamps that are not finite and increasing, or invalid parameters.

    Source: G. E. Forsythe, Generation and use of orthogonal polynomials for data-fitting with a digital computer,
    J. SIAM 5 (1957), pp. 74-88. The paper (section 5) says "differentiating ... through polynomial approximation".
    """
    least = degree + 2 if least is None else least
    if value.ndim != 2 or time.shape != (value.shape[0],) or at.ndim != 1:
        raise ValueError(f"shapes (N,), (N, K), (M,) are needed, not {time.shape}, {value.shape}, {at.shape}")
    if degree < 2 or least <= degree or not half_width > 0 or not max_gap > 0:
        raise ValueError(f"degree {degree}, least {least}, half_width {half_width}, max_gap {max_gap} cannot be meant")
    if not (np.all(np.isfinite(time)) and np.all(np.isfinite(at)) and np.all(np.diff(time) > 0)):
        raise ValueError("stamps must be finite, and those of the samples must increase strictly")
    # Copies, so that read-only or strided input does not make numba compile the kernels once more.
    time, at = np.array(time, dtype=np.float64), np.array(at, dtype=np.float64)
    start, stop = _runs(time, max_gap)
    before = np.searchsorted(time, at + NANOSECOND, side="right") - 1
    reach = [at - half_width - NANOSECOND, at + half_width + NANOSECOND]
    low, high = np.searchsorted(time, reach[0]), np.searchsorted(time, reach[1], side="right")
    first, last = np.zeros((2, at.size), np.int64)
    width, centred = np.full(at.size, np.nan), np.zeros(at.size, np.bool_)
    _windows(time, at, half_width, least, start, stop, before, low, high, first, last, width, centred)
    columns = np.array(value.T, dtype=np.float64, order="C")
    result = np.empty((3, at.size, len(columns)))
    longest = int((last - first).max(initial=1))
    _project(time, columns, at, first, last, width, degree, np.empty((3, longest)), np.empty((2, 3)), result)
    return Derivatives(result[0], result[1], result[2], half_width=width, count=last - first, centred=centred)


def _runs(time: Array, max_gap: float) -> tuple[Indices, Indices]:
    """First sample of each sample's run, and one past its last: two arrays of shape (N,)."""
    cuts = np.flatnonzero(np.diff(time) > max_gap) + 1
    edges = np.concatenate([[0], cuts, [len(time)]]).astype(np.int64)
    length = np.diff(edges)
    return np.repeat(edges[:-1], length), np.repeat(edges[1:], length)


@kernel()
def _windows(
    time: Array,
    at: Array,
    half_width: float,
    least: int,
    start: Indices,
    stop: Indices,
    before: Indices,
    low: Indices,
    high: Indices,
    first: Indices,
    last: Indices,
    width: Array,
    centred: Mask,
) -> None:
    """Fills first sample, one past the last, half width used, and `centred` of each window, each of shape (M,).

    `before` is the last sample up to each stamp, `low` the first and `high` one past the last within the half width.
    The outputs must be initialised: zeros, and NaN for the width.
    """
    for i in range(at.size):
        t = at[i]
        if before[i] < 0:
            continue
        lower, upper = start[before[i]], stop[before[i]]
        if upper - lower < least or t > time[upper - 1] + NANOSECOND:
            continue
        w = half_width
        lo, hi = max(lower, low[i]), min(upper, high[i])
        while hi - lo < least:
            to_left = t - time[lo - 1] if lo > lower else np.inf
            to_right = time[hi] - t if hi < upper else np.inf
            w = min(to_left, to_right)
            while lo > lower and t - time[lo - 1] <= w + NANOSECOND:
                lo -= 1
            while hi < upper and time[hi] - t <= w + NANOSECOND:
                hi += 1
        first[i], last[i], width[i] = lo, hi, w
        centred[i] = time[lower] <= t - w + NANOSECOND and time[upper - 1] >= t + w - NANOSECOND


@kernel(fastmath={"reassoc", "contract", "nsz"})
def _project(
    time: Array,
    columns: Array,
    at: Array,
    first: Indices,
    last: Indices,
    width: Array,
    degree: int,
    work: Array,
    at_zero: Array,
    result: Array,
) -> None:
    """Fills value and two derivatives at each stamp by projection on orthogonal polynomials, shape (3, M, K).

    The recurrence p[k+1] = (s - a) p[k] - b p[k-1] runs on the samples and, with its derivatives, at the stamp (s = 0).
    The work space, as long as the longest window, holds s, p[k] and p[k-1]; `at_zero` (2, 3) the latter two at 0.
    """
    k_columns = columns.shape[0]
    for i in range(at.size):
        lo, n = first[i], last[i] - first[i]
        if n == 0:
            for k_column in range(k_columns):
                for d in range(3):
                    result[d, i, k_column] = np.nan
            continue
        scale = 1.0 / width[i]
        for j in range(n):
            work[0, j] = (time[lo + j] - at[i]) * scale
            work[1, j] = 1.0
            work[2, j] = 0.0
        for d in range(3):
            at_zero[0, d] = 1.0 if d == 0 else 0.0
            at_zero[1, d] = 0.0
        norm_old = 1.0
        # Subtracting one sample keeps a flight far from the origin as accurate as one at the origin.
        middle = lo + n // 2
        for k_column in range(k_columns):
            result[0, i, k_column] = columns[k_column, middle]
            result[1, i, k_column] = result[2, i, k_column] = 0.0
        for k in range(degree + 1):
            norm, moment = 0.0, 0.0
            for j in range(n):
                square = work[1, j] * work[1, j]
                norm += square
                moment += work[0, j] * square
            for k_column in range(k_columns):
                y0, total = columns[k_column, middle], 0.0
                for j in range(n):
                    total += work[1, j] * (columns[k_column, lo + j] - y0)
                for d in range(3):
                    result[d, i, k_column] += total / norm * at_zero[0, d]
            a, b = moment / norm, norm / norm_old if k else 0.0
            for j in range(n):
                p_next = (work[0, j] - a) * work[1, j] - b * work[2, j]
                work[2, j] = work[1, j]
                work[1, j] = p_next
            for d in range(2, -1, -1):
                following = -a * at_zero[0, d] - b * at_zero[1, d] + (d * at_zero[0, d - 1] if d else 0.0)
                at_zero[1, d] = at_zero[0, d]
                at_zero[0, d] = following
            norm_old = norm
        for k_column in range(k_columns):
            result[1, i, k_column] *= scale
            result[2, i, k_column] *= scale * scale


DEGREE = 5
"""Degree of the differentiating polynomial."""

HALF_WIDTH = 0.25
"""Half width of the differentiating window [s].

Chosen on simulated flights, set B of the published coefficients. White noise of 0.5 mm at 120 Hz becomes 1.9 mm/s of
velocity and 24 mm/s^2 of acceleration, and 99.2 % of an acceleration at 1 Hz passes; a cubic of the same noise
(+-0.15 s) passes 93.5 %. Without wind, delay and hold, the RMS error of the eight coefficients from this noise is
0.08 % with the paper's inputs and 0.20 % with multisines up to 0.9 Hz. For +-0.2 s it is 0.15 % and 0.18 %, for
+-0.3 s 0.05 % and 0.41 %, for a cubic over +-0.2 s 0.44 % and 4.5 %.
"""

LEAST = 11
"""Least number of poses in a window, so that slow recordings get a wider one.

Chosen on simulated flights. At 10 Hz and 5 mm, with the paper's inputs on z, noise biases the damping by -63 % with
7 poses, -37 % with 9, -25 % with 11, -14 % with 15; but 15 poses bias the gain of multisines up to 0.9 Hz by up to
-15 %.
"""


def motion_from_flight(
    flight: Flight, half_width: float = HALF_WIDTH, degree: int = DEGREE, least: int = LEAST
) -> Motion:
    """Differentiates the poses of a flight, with the command held at the stamp of each pose.

    Poses outside the segments are ignored: the commands there are unknown. Stamps whose window leaves the segment, or
    contains a gap longer than half of itself, are left out, because one-sided fits are noisy (the acceleration at the
    very end of a run has 100 times the noise of one in its middle).

    Args:
        flight: The flight.
        half_width: Half width of the window [s].
        degree: Degree of the polynomial.
        least: Least number of poses in a window.

    Returns:
        Commands, velocities and accelerations, possibly of length 0.
    """
    period = float(np.median(np.diff(flight.pose_time))) if len(flight.pose_time) > 1 else 0.0
    longest_hole = max(half_width, 0.5 * least * period)
    pose = np.column_stack([flight.position, flight.yaw])
    kept, velocities, accelerations = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 4))], [np.zeros((0, 4))]
    for segment in flight.segments:
        inside = np.flatnonzero((flight.pose_time >= segment.start) & (flight.pose_time <= segment.end))
        time = flight.pose_time[inside]
        fit = local_polynomial(time, pose[inside], time, half_width, degree, least=least, max_gap=longest_hole)
        kept.append(inside[fit.centred])
        velocities.append(fit.velocity[fit.centred])
        accelerations.append(fit.acceleration[fit.centred])
    index, velocity = np.concatenate(kept), np.concatenate(velocities)
    time, yaw = flight.pose_time[index], flight.yaw[index]
    velocity[:, :2] = heading_from_world(velocity[:, :2], yaw)
    held = np.searchsorted(flight.command_time, time, side="right") - 1
    return Motion(time, yaw, flight.command[held], velocity, np.concatenate(accelerations))


REFERENCE_HALF_WIDTH = 0.125
"""Half width of the local cubic for the reference velocity [s]; widened until it holds `REFERENCE_LEAST` samples."""

REFERENCE_LEAST = 7


@dataclass(frozen=True)
class MeasuredSegment:
    """One segment on the clock of the poses, and of the velocities for axes without poses; N stamps.

    Attributes:
        time: Shape (N,) [s].
        pose: Measured x, y, z, yaw, shape (N, 4) [m, rad]; interpolated where only the velocity has a stamp.
        reference: Velocity that predictions are compared with, shape (N, 4), NaN where there is none.
        alone: Axes that are tracked by their velocity.
        velocity: World, shape (N, 4), NaN where there is none; None where every axis has poses.
        tracked: Whether the measurement that tracks each axis exists at a stamp, shape (N, 4); None likewise.
        rounding: Variance added by the rounding of the velocity of axes without poses, shape (4,).
    """

    time: Array
    pose: Array
    reference: Array
    alone: tuple[str, ...] = ()
    velocity: Array | None = None
    tracked: Mask | None = None
    rounding: Array = field(default_factory=lambda: np.zeros(len(AXES)))

    def velocity_of(self, pair: Sequence[int]) -> tuple[Array, Mask, Mask]:
        """Inputs of `Forecast` for two axes: velocities, what was measured when, and which have velocities only."""
        if self.velocity is None or self.tracked is None:
            return np.empty((0, 2)), np.ones((self.time.size, 2), bool), np.zeros(2, bool)
        alone = np.array([AXES[i] in self.alone for i in pair])
        values = np.nan_to_num(self.velocity[:, pair])  # untracked values are unused, but 0 times NaN is NaN
        return np.ascontiguousarray(values), np.ascontiguousarray(self.tracked[:, pair]), alone


def seen_in(flight: Flight, low: float, high: float) -> MeasuredSegment:
    """What a flight measured between two times, both included [s]."""
    inside = (flight.pose_time >= low) & (flight.pose_time <= high)
    t, pose = flight.pose_time[inside], np.column_stack([flight.position, flight.yaw])[inside]
    if flight.velocity is None or not flight.velocity_only or not t.size:
        return MeasuredSegment(t, pose, smoothed(t, pose, t).velocity.copy())  # the other derivatives can go
    own = flight.velocity.between(float(t[0]), high)
    time = np.union1d(t, own.time)
    velocity = np.full((time.size, len(AXES)), np.nan)
    velocity[np.searchsorted(time, own.time)] = own.value
    alone = np.isin(AXES, flight.velocity_only)
    reference = smoothed(t, pose, time).velocity
    for k in np.flatnonzero(alone):  # the same cubic smooths what needs no derivative
        reference[:, k] = smoothed(own.time, own.value[:, k : k + 1], time).value[:, 0]
    return MeasuredSegment(
        time=time,
        pose=np.column_stack([np.interp(time, t, column) for column in pose.T]),
        reference=reference,
        alone=flight.velocity_only,
        velocity=velocity,
        tracked=np.where(alone, np.isfinite(velocity), np.isin(time, t)[:, None]),
        rounding=np.where(alone, flight.velocity.rounding, 0.0),
    )


def smoothed(time: Array, values: Array, at: Array) -> Derivatives:
    """Values (N, K) by the local cubic of the reference velocity."""
    return local_polynomial(time, values, at, REFERENCE_HALF_WIDTH, 3, least=REFERENCE_LEAST, max_gap=LONGEST_GAP)
