"""Position -> velocity and acceleration: a polynomial fitted by least squares around every stamp.

The stamps are taken as they are: irregular, jittered, with holes where stale poses were dropped. Nothing is resampled.
"""

from dataclasses import dataclass

import numba
import numpy as np

from rotorfit.frames import Array, Indices, Mask

NANOSECOND = 1e-9
"""Grace at the edge of a window [s]: stamps are whole nanoseconds, and the rounding of their difference must not decide
whether a sample on the edge belongs."""


@dataclass(frozen=True)
class Derivatives:
    """Local polynomials at M stamps, of K columns; where there is no result all is NaN and `centred` is False.

    Attributes:
        value: The polynomial's own value, shape (M, K), in the unit of the data.
        velocity: First time derivative, shape (M, K) [unit/s].
        acceleration: Second time derivative, shape (M, K) [unit/s^2].
        half_width: Half the width of the window that was used, after widening, shape (M,) [s].
        count: Number of samples in it, shape (M,); 0 where there is no result.
        centred: Whether the data reach both edges of the window, shape (M,). Where they do not (next to the ends of
            the data and of holes longer than `max_gap`) the fit is one-sided and its derivatives are much noisier.
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
    """Fits an unweighted polynomial to the samples within `at` +- `half_width`, for each stamp of `at`; differentiates.

    A window that holds fewer than `least` samples is widened, symmetrically in time, until it holds them. A hole
    between two samples longer than `max_gap` cuts the data into runs, and no window reaches over it. There is no result
    (NaN) at a stamp inside such a hole, before the first or after the last sample, or in a run of fewer than `least`
    samples. A NaN among the samples makes the windows that hold it NaN.

    Each fit projects on polynomials that are orthogonal on the stamps of its own window (Forsythe's recurrence, time in
    units of the window), so no normal equations are formed; it is exact for polynomials up to `degree`.

    Args:
        time: Strictly increasing stamps, shape (N,) [s].
        value: Samples, shape (N, K); angles unwrapped.
        at: Stamps to differentiate at, in any order, shape (M,) [s].
        half_width: Half the width of the window [s].
        degree: Of the polynomial, at least 2.
        least: Smallest number of samples in a window, more than `degree`; None for `degree` + 2.
        max_gap: Longest hole between two samples that a window may reach over [s].

    Returns:
        Value, velocity and acceleration at the M stamps, and how each window came out.

    Raises:
        ValueError: For shapes, stamps or numbers that cannot be meant.

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
    first, last, width, centred = _windows(time, at, half_width, least, start, stop)
    columns = np.array(value.T, dtype=np.float64, order="C")
    result = _project(time, columns, at, first, last, width, degree)
    return Derivatives(result[0], result[1], result[2], half_width=width, count=last - first, centred=centred)


def _runs(time: Array, max_gap: float) -> tuple[Indices, Indices]:
    """First sample of the run that each sample lies in, and one past its last: two arrays of shape (N,)."""
    cuts = np.flatnonzero(np.diff(time) > max_gap) + 1
    edges = np.concatenate([[0], cuts, [len(time)]]).astype(np.int64)
    length = np.diff(edges)
    return np.repeat(edges[:-1], length), np.repeat(edges[1:], length)


@numba.njit(cache=True)
def _windows(
    time: Array, at: Array, half_width: float, least: int, start: Indices, stop: Indices
) -> tuple[Indices, Indices, Array, Mask]:
    """First sample, one past the last, half-width used, and `centred` of each window, each of shape (M,)."""
    m = at.size
    first, last = np.zeros(m, np.int64), np.zeros(m, np.int64)
    width, centred = np.full(m, np.nan), np.zeros(m, np.bool_)
    for i in range(m):
        t = at[i]
        before = np.searchsorted(time, t + NANOSECOND, side="right") - 1
        if before < 0:
            continue
        lower, upper = start[before], stop[before]
        if upper - lower < least or t > time[upper - 1] + NANOSECOND:
            continue
        w = half_width
        lo = max(lower, np.searchsorted(time, t - w - NANOSECOND))
        hi = min(upper, np.searchsorted(time, t + w + NANOSECOND, side="right"))
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
    return first, last, width, centred


@numba.njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _project(time: Array, columns: Array, at: Array, first: Indices, last: Indices, width: Array, degree: int) -> Array:
    """Value and two derivatives at each stamp by projection on orthogonal polynomials, shape (3, M, K).

    The recurrence p[k+1] = (s - a) p[k] - b p[k-1] runs on the samples and, with its derivatives, at the stamp (s = 0).
    """
    m, k_columns = at.size, columns.shape[0]
    result = np.full((3, m, k_columns), np.nan)
    longest = max(1, np.max(last - first)) if m else 1
    s, p, p_old = np.empty(longest), np.empty(longest), np.empty(longest)
    for i in range(m):
        lo, n = first[i], last[i] - first[i]
        if n == 0:
            continue
        scale = 1.0 / width[i]
        for j in range(n):
            s[j] = (time[lo + j] - at[i]) * scale
            p[j] = 1.0
            p_old[j] = 0.0
        at_zero, at_zero_old = np.array([1.0, 0.0, 0.0]), np.zeros(3)
        norm_old = 1.0
        # Taking one sample off keeps a flight far from the origin as accurate as one at it.
        origin = columns[:, lo + n // 2]
        for k_column in range(k_columns):
            result[0, i, k_column] = origin[k_column]
            result[1:, i, k_column] = 0.0
        for k in range(degree + 1):
            norm, moment = 0.0, 0.0
            for j in range(n):
                square = p[j] * p[j]
                norm += square
                moment += s[j] * square
            for k_column in range(k_columns):
                y, y0, total = columns[k_column, lo : lo + n], origin[k_column], 0.0
                for j in range(n):
                    total += p[j] * (y[j] - y0)
                for d in range(3):
                    result[d, i, k_column] += total / norm * at_zero[d]
            a, b = moment / norm, norm / norm_old if k else 0.0
            for j in range(n):
                p_next = (s[j] - a) * p[j] - b * p_old[j]
                p_old[j] = p[j]
                p[j] = p_next
            at_zero_next = -a * at_zero - b * at_zero_old
            at_zero_next[1] += at_zero[0]
            at_zero_next[2] += 2.0 * at_zero[1]
            at_zero_old, at_zero, norm_old = at_zero, at_zero_next, norm
        for k_column in range(k_columns):
            result[1, i, k_column] *= scale
            result[2, i, k_column] *= scale * scale
    return result
