"""When did it change? The sum of squares of one likelihood, profiled over the instant of a change.

For every instant t, the rows before and after it have coefficients, trims and start velocities of their own; on z and
yaw a push begins at t that fades as the autopilot learns it. The instants whose sum of squares exceeds the least one by
no more than the 95 % quantile of its F distribution make the interval. A window that begins before the change mixes two
vehicles, and one that begins after it leaves the push to the vehicle before: both fit worse.

Source: D. V. Hinkley, J. Am. Statist. Assoc. 66 (1971), pp. 736-743 (likelihood of a change point).
"""

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.tracking.scores import LASTS, Scores

SPACING = 0.05
"""Grid spacing of the instants [s]."""

DROP = 7.35
"""Excess of the sum of squares, over the mean square after the change, that bounds the interval."""

SLACK = 0.1
"""By how much the interval is widened at both ends [s]: a rotor and a radio take as long to pass a change on."""


def changed_when(scores: Scores, low: float) -> tuple[float, tuple[float, float]]:
    """The likeliest instant of a change, and its 95 % interval [s].

    Args:
        scores: Those of the likelihood that shows the change.
        low: Earliest instant that is considered [s].
    """
    rows = (scores, *scores.under_gusts)[scores.gusts].rows
    time = scores.time
    instants = np.arange(low, time[-1], SPACING)
    first = np.searchsorted(time, instants)
    after = np.array([_with_push(scores, rows, at) for at in first])
    before = rows.T @ rows - after[:, : rows.shape[1], : rows.shape[1]]
    left = np.array([_unexplained(before), _unexplained(after)])
    best = int(np.argmin(left.sum(axis=0)))
    freedom = np.array([first[best], time.size - first[best]]) - rows.shape[1]
    usual = np.max(left[:, best] / np.maximum(freedom, 1), initial=1.0, where=freedom > 0)
    near = instants[left.sum(axis=0) <= left[:, best].sum() + DROP * usual]
    return float(instants[best]), (float(near[0]) - SLACK, min(float(near[-1]) + SLACK, float(time[-1])))


def _with_push(scores: Scores, rows: Array, at: int) -> Array:
    """Products of the rows from `at` on, with a push that begins there as the last column."""
    later = rows[at:]
    if scores.jolts.size:
        shape = scores.jolts[int(np.searchsorted(scores.time, scores.time[-1] - LASTS)) :, 0]
        push = np.zeros(len(later))
        push[: shape.size] = shape[: push.size]
        later = np.column_stack([later, push])
    return np.asarray(later.T @ later)


def _unexplained(products: Array) -> Array:
    """Sums of squares of the first column that the others leave, from products of shape (W, n, n), shape (W,)."""
    scale = np.sqrt(np.maximum(np.diagonal(products, axis1=1, axis2=2)[:, 1:], 0.0))
    scale[scale == 0] = 1.0
    value, vector = np.linalg.eigh(products[:, 1:, 1:] / (scale[:, :, None] * scale[:, None, :]))
    along = np.einsum("wik,wi->wk", vector, products[:, 0, 1:] / scale)
    keep = value > 1e-9 * value[:, -1:]
    return np.asarray(products[:, 0, 0] - np.where(keep, along**2 / np.where(keep, value, 1.0), 0.0).sum(axis=1))
