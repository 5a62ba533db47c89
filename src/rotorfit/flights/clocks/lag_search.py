"""Exhaustive search for the lags at which a series on one clock follows a motion on another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Mask

GRID = 0.05
"""Step of the search [s]: a multirotor under velocity commands needs about 0.2 s to change its velocity."""

LEAST_OVERLAP = 8.0
"""Shortest common time that counts [s]: about 16 independent values of a velocity."""

LEAST_SHARE = 0.25
"""The common time must be at least this share of the shorter of the two records."""

MEMORY = 0.5
"""Correlation time of a velocity [s]: T seconds hold T / MEMORY independent values."""

APART = 1.0
"""Lags closer than this belong to one peak [s]."""

MOST = 40
"""Largest number of lags returned."""


@dataclass(frozen=True)
class Witness:
    """A series on the first clock that follows the motion.

    Attributes:
        name: For people.
        time: Increasing, shape (N,) [s].
        value: Shape (N,).
        columns: Columns of the motion that it is a linear combination of.
        by_rate: Whether the search compares time derivatives: for a series that wanders without forgetting.
        instead: Alternative sets of columns, any of which may replace `columns`.
        sensor: Witnesses of one sensor share a latency; those of another may be later.
    """

    name: str
    time: Array
    value: Array
    columns: tuple[int, ...]
    by_rate: bool = False
    instead: tuple[tuple[int, ...], ...] = ()
    sensor: str = ""


@dataclass(frozen=True)
class GriddedMotion:
    """The motion observed by the second clock, on a regular grid.

    Attributes:
        start: Time of the first row [s].
        step: Step of the grid [s].
        value: Shape (M, C); 0 where unknown.
        slope: Time derivative of `value`, from a wider window that reduces noise, shape (M, C); 0 where unknown.
        valid: Where the motion is known, shape (M,).
    """

    start: float
    step: float
    value: Array
    slope: Array
    valid: Mask

    def knows(self, at: Array) -> Mask:
        """At which times, shape (N,) [s], the motion is known, with a margin of one row on either side."""
        row = np.floor((at - self.start) / self.step).astype(np.int64)
        there = (row >= 1) & (row < self.valid.size - 2)
        row = np.clip(row, 1, max(self.valid.size - 3, 1))
        return np.asarray(there & self.valid[row - 1] & self.valid[row] & self.valid[row + 1] & self.valid[row + 2])


@dataclass(frozen=True)
class Place:
    """A lag [s] that is a local maximum of the witnesses' evidence, with that evidence [nats]."""

    lag: float
    evidence: float


def best_lags(witnesses: Sequence[Witness], seen: GriddedMotion) -> list[Place]:
    """The lags, to be added to the stamps of the witnesses, with the most evidence; the best first.

    Args:
        witnesses: Series on the first clock.
        seen: The motion on the second clock.

    Returns:
        At most `MOST` lags; empty where the overlap is too short at every lag.
    """
    from scipy.signal import find_peaks

    if seen.valid.size < 8:
        return []
    index = np.round(np.arange(0, seen.valid.size - 0.5, GRID / seen.step)).astype(np.int64)
    index = np.minimum(index, seen.valid.size - 1)
    known = seen.valid[index].astype(np.float64)
    origin = min(float(w.time[0]) for w in witnesses)
    length = int((max(float(w.time[-1]) for w in witnesses) - origin) / GRID) + 2
    evidence, overlap = np.zeros(length + known.size - 1), np.zeros(length + known.size - 1)
    for witness in witnesses:
        y, there = _on_grid(witness, origin, length)
        motion = (seen.slope if witness.by_rate else seen.value)[index]
        told = [_evidence(y, there, motion[:, columns], known) for columns in (witness.columns, *witness.instead)]
        evidence += np.max([gain for gain, _ in told], axis=0)
        overlap = np.maximum(overlap, told[0][1])
    shorter = min(float(np.sum(known)), float(np.max(overlap)))
    evidence[overlap < max(LEAST_OVERLAP / GRID, LEAST_SHARE * shorter)] = 0.0
    lags = seen.start - origin + GRID * (np.arange(evidence.size) - (length - 1))
    tops, _ = find_peaks(np.concatenate([[0.0], evidence, [0.0]]), distance=round(0.3 / GRID))
    tops = tops[np.argsort(-evidence[tops - 1])][:MOST] - 1
    return [Place(float(lags[i]), float(evidence[i])) for i in tops if evidence[i] > 0]


def _on_grid(witness: Witness, origin: float, length: int) -> tuple[Array, Array]:
    """A witness on the grid of the search, and 1 where it is known, both of shape (length,)."""
    grid = origin + GRID * np.arange(length)
    before = np.clip(np.searchsorted(witness.time, grid, side="right") - 1, 0, witness.time.size - 2)
    steps = np.diff(witness.time)
    there = (grid >= witness.time[0]) & (grid <= witness.time[-1])
    there &= steps[before] <= max(4 * float(np.median(steps)), 2 * GRID)
    values = np.interp(grid, witness.time, witness.value)
    if witness.by_rate:
        values = np.gradient(values, GRID)
    return values, there.astype(np.float64)


def _evidence(y: Array, there: Array, motion: Array, known: Array) -> tuple[Array, Array]:
    """Gain in log-likelihood from the motion at every lag, and the number of overlapping grid rows there.

    Computes the regressions at all lags at once: sums over the overlap by FFT, with masks for unknown values.
    Source: D. Padfield, IEEE Trans. Image Process. 21 (2012), pp. 2706-2718.
    """
    from scipy.signal import fftconvolve

    def summed(a: Array, b: Array) -> Array:
        """Sum over k of a[k] b[k + lag], for lags from -(len(a) - 1) on."""
        return np.asarray(fftconvolve(b, a[::-1]))

    K = motion.shape[1]
    y = (y - np.sum(y * there) / max(np.sum(there), 1)) * there
    motion = (motion - np.sum(motion * known[:, None], axis=0) / max(np.sum(known), 1)) * known[:, None]
    count = np.maximum(np.round(summed(there, known)), 0)
    n = np.maximum(count, 1)
    total_y, total = summed(y, known), [summed(there, column) for column in motion.T]
    yy = summed(y * y, known) - total_y**2 / n
    ym = np.stack([summed(y, motion[:, j]) - total_y * total[j] / n for j in range(K)], axis=-1)
    mm = np.empty((n.size, K, K))
    for i in range(K):
        for j in range(K):
            mm[:, i, j] = summed(there, motion[:, i] * motion[:, j]) - total[i] * total[j] / n
    ridge = 1e-9 * float(np.max(np.abs(mm))) + 1e-300
    explained = np.sum(ym * np.linalg.solve(mm + ridge * np.eye(K), ym[..., None])[..., 0], axis=-1)
    share = explained / np.maximum(yy, 1e-6 * float(np.max(yy)) + 1e-300)
    return -0.5 * count * GRID / MEMORY * np.log1p(-np.clip(share, 0.0, 1 - 1e-6)), count
