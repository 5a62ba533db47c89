"""How hard was the push? The posterior distribution of the acceleration with which a payload or a weak rotor begins.

An autopilot learns a new weight or torque: its push a exp(-t / T) fades, with a time constant T that nobody tells. With
the push at an instant of `since`, the whitened innovations of z or yaw are

    y = X b + a h(T) + noise

where X has the sensitivities of all rows to what the regime leaves unknown, b, with a flat prior, and h(T) is the
whitened position after such a push. For each instant and T the posterior of a is normal, and the evidence weighs it;
the interval is that of the mixture. So where a second of poses hardly tells T, the interval allows for it.

h(T) follows from the matched filter of the jolts, which has T = `FADES`: whitening is linear and stays the same from
second to second, so h' + h / T, the answer to a sudden velocity, is the same for every T, and

    h(T) = h(F) + (1 / F - 1 / T) (exp(-t / T) * h(F)),    F = `FADES`, * the convolution.

Source: the conjugate normal posterior, and its mixture over a grid of nuisance parameters, as in A. Gelman et al.,
Bayesian Data Analysis, 3rd ed. (2013), sections 2.5 and 3.1.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter
from scipy.special import ndtr

from rotorfit.core.frames import Array
from rotorfit.tracking.instant import FLAT, SPACING, jolt_shape, now_of
from rotorfit.tracking.scores import EXPECTED, FADES, Scores

LEARNS = np.geomspace(0.05, 4.0, 20)
"""Time constants with which an autopilot may learn a push [s], all equally likely by their logarithm: from a thrust
estimate that follows the acceleration to the slow pole of a climb loop with an integrator, 1.7 s, and beyond."""

LARGE = 10.0
"""Standard deviation of a push beforehand, in units of `EXPECTED`: half of the weight."""

SHAPE = 0.2
"""Relative standard deviation of a push because it does not fade exactly as exp(-t / T)."""

ENDS = 0.025, 0.975
"""Quantiles at the ends of an interval."""


def push_interval(scores: Scores, since: tuple[float, float]) -> tuple[float, float]:
    """The 95 % interval of the first acceleration of a push [m/s^2, rad/s^2].

    Args:
        scores: Those of z or of yaw.
        since: The interval of its instant [s].
    """
    now = now_of(scores)
    end = min(since[1], float(now.time[-1]) - SPACING)
    first = np.searchsorted(now.time, np.arange(min(since[0], end), end + 0.5 * SPACING, SPACING))
    shapes = _shapes(now)
    product, power = np.array([_told(now, shapes, int(at)) for at in np.unique(first)]).transpose(1, 0, 2)
    noise = 1.0
    for _ in range(2):
        precision = power / noise + LARGE**-2
        mean = product / noise / precision
        log = 0.5 * mean**2 * precision - 0.5 * np.log(precision)
        best = np.unravel_index(int(np.argmax(log)), log.shape)
        noise = _mean_square(now, shapes[:, best[1]], int(np.unique(first)[best[0]]), float(mean[best]))
    weight = np.exp(log - log.max())
    return _quantiles(weight / weight.sum(), mean, np.sqrt(1 / precision + (SHAPE * mean) ** 2))


def _shapes(scores: Scores) -> Array:
    """The whitened position after a push, from its instant on, for each of `LEARNS`, shape (n, T)."""
    shape = jolt_shape(scores)
    step = float(np.median(np.diff(scores.time)))
    out = []
    for learns in LEARNS:
        kept = np.exp(-step / learns)  # the convolution, exact for a shape that is linear between two rows
        late = learns**2 * (1 - kept) / step
        faded = lfilter([learns - late, late - learns * kept], [1.0, -kept], shape)
        out.append(shape + (1 / FADES - 1 / learns) * faded)
    return np.transpose(out)


def _told(scores: Scores, shapes: Array, at: int) -> tuple[Array, Array]:
    """Inner products of pushes at a row with the innovations, and with themselves, less what X explains, shape (T,)."""
    late = scores.rows[at : at + len(shapes)]
    pushed = shapes[: len(late)]
    normal, right = scores.products[1:, 1:], scores.products[1:, 0]
    ridge = FLAT * float(normal.diagonal().max()) + np.finfo(float).tiny
    across = late[:, 1:].T @ pushed
    explained = np.linalg.solve(normal + ridge * np.eye(len(normal)), np.column_stack([right, across]))
    product = late[:, 0] @ pushed - across.T @ explained[:, 0]
    return product, np.maximum((pushed**2).sum(axis=0) - (across * explained[:, 1:]).sum(axis=0), 0.0)


def _mean_square(scores: Scores, shape: Array, at: int, push: float) -> float:
    """Mean square of the innovations from a row on, less a push there; at least 1, and that before the row."""
    late = scores.innovation[at : at + shape.size]
    left = late - push * shape[: late.size]
    return max(1.0, *(float(np.mean(part**2)) for part in (scores.innovation[:at], left) if part.size > 1))


def _quantiles(weight: Array, mean: Array, error: Array) -> tuple[float, float]:
    """The 95 % interval of a mixture of normal distributions, in natural units."""
    least, most = float((mean - 6 * error).min()), float((mean + 6 * error).max())
    low, high = (
        float(brentq(lambda a, end=end: float((weight * ndtr((a - mean) / error)).sum()) - end, least, most))
        for end in ENDS
    )
    return EXPECTED["trim"] * low, EXPECTED["trim"] * high
