"""Is the difference real? Two predictors on the same starts of the same flights, compared with a standard error.

Predictions start 0.5 s apart and reach up to 5 s, so neighbours share data, and the wind's memory is longer than both.
The variance of a mean is therefore taken from the lowest frequencies of its series, which gives a Student t with as
many degrees of freedom as frequencies were used: few on a short flight, as they should be.

Source: F. X. Diebold, R. S. Mariano, J. Bus. Econ. Stat. 13 (1995), pp. 253-263, for the test; D. Harvey, S. Leybourne,
P. Newbold, Int. J. Forecasting 13 (1997), pp. 281-291, for Student's t; `long_run` for the variance.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import AXES, Array
from rotorfit.core.results import Difference, FlightScores, Paired, PairedTest, Quantity, StartErrors, Verdict
from rotorfit.dynamics.long_run import frequencies, two_sided, variance_of_mean
from rotorfit.dynamics.protocol import LEAST_SCORES, START_EVERY

QUANTITIES: tuple[Quantity, Quantity] = ("velocity", "position")

Errors = Sequence[Mapping[str, StartErrors]]
"""Errors of one predictor: for each flight a mapping, from a horizon [s] as `%g` to its errors."""

LEVEL = 0.05
"""A difference is called real below this p-value."""

LEAST_FREEDOM = 1
"""Degrees of freedom of a flight below which it has no standard error, and takes none from flights that have one."""

AGREEMENT_FREEDOM = 2
"""Degrees of freedom that a flight needs for the test of whether the flights agree."""

SAME = 1e-4
"""Relative difference of the mean squares below which two predictors are the same: searches that end at one maximum
leave as much, and no figure shows it."""

LESS = np.array([1.0, -1.0])
"""The first minus the second."""


@dataclass(frozen=True)
class _Loss:
    """Mean squares of two predictors on one flight (2,), their covariance (2, 2), its freedom, weight and pairs."""

    mean: Array
    covariance: Array
    freedom: int
    weight: float
    n: int


def paired_test(
    names: tuple[str, str],
    first: Errors,
    second: Errors,
    counted: Sequence[Collection[str]],
    unlike: Sequence[Collection[str]] | None = None,
) -> PairedTest:
    """Tests on every axis and at every horizon whether two predictors differ, for each flight and pooled.

    Args:
        names: Names of the two.
        first: Errors of the one that is judged.
        second: Errors of the other, on the same flights.
        counted: The axes of each flight that are pooled: those that it commands and to which no model was fitted.
        unlike: The axes of each flight whose errors cannot be compared (`FlightScores.unlike`); by default none.
    """
    apart = unlike if unlike is not None else [()] * len(first)
    horizons = first[0].keys() & second[0].keys() if first else ()
    return PairedTest(
        *names,
        {
            axis: {
                key: {what: _compared(first, second, counted, apart, axis, key, what) for what in QUANTITIES}
                for key in sorted(horizons, key=float)
            }
            for axis in AXES
        },
    )


def paired_scores(
    names: tuple[str, str],
    first: tuple[Sequence[FlightScores], Errors],
    second: tuple[Sequence[FlightScores], Errors],
) -> PairedTest:
    """`paired_test` of two predictors by the scores of the flights that go with their errors.

    Args:
        names: As for `paired_test`.
        first: Scores and errors of the one that is judged, one of each per flight.
        second: The same of the other, on the same flights.
    """
    pairs = list(zip(first[0], second[0], strict=True))
    counted = [() if one.fitted or other.fitted else one.moved for one, other in pairs]
    return paired_test(names, first[1], second[1], counted, [one.unlike(other) for one, other in pairs])


def _compared(
    first: Errors,
    second: Errors,
    counted: Sequence[Collection[str]],
    unlike: Sequence[Collection[str]],
    axis: str,
    key: str,
    what: Quantity,
) -> Paired:
    k, horizon = AXES.index(axis), float(key)
    losses = [
        None if axis in axes else _loss(a[key], b[key], k, what, horizon)
        for a, b, axes in zip(first, second, unlike, strict=True)
    ]
    pairs = zip(losses, counted, strict=True)
    pool = {place: loss for place, (loss, axes) in enumerate(pairs) if loss is not None and axis in axes}
    known = {place: loss for place, loss in pool.items() if loss.freedom >= LEAST_FREEDOM} or pool
    return Paired(
        tuple(None if loss is None else _difference([loss]) for loss in losses),
        _difference([*known.values()]) if known else None,
        _agreement([loss for loss in pool.values() if loss.freedom >= AGREEMENT_FREEDOM]),
        len(pool) - len(known),
        tuple(known),
    )


def _loss(a: StartErrors, b: StartErrors, k: int, what: Quantity, horizon: float) -> _Loss | None:
    """Result of one flight on the starts that both have; None for fewer than five."""
    _, at_a, at_b = np.intersect1d(np.round(a.start, 6), np.round(b.start, 6), return_indices=True)
    ones = np.ones((at_a.size, 4))
    pairs = [(e.velocity[at], e.steps[at]) if what == "velocity" else (e.position[at], ones)
             for e, at in ((a, at_a), (b, at_b))]  # fmt: skip
    sums, counts = (np.stack([pair[i][:, k] for pair in pairs], axis=1) for i in (0, 1))
    if at_a.size < LEAST_SCORES or not np.isfinite(sums).all() or not counts.any(axis=0).all():
        return None
    mean = sums.sum(axis=0) / counts.sum(axis=0)
    influence = (sums - mean * counts) / counts.mean(axis=0)
    count = independent_frequencies(at_a.size, horizon)
    covariance = variance_of_mean(influence, max(count, 1))
    return _Loss(mean, covariance, count - 1, float(counts[:, 0].sum()), int(at_a.size))


def independent_frequencies(n: int, horizon: float) -> int:
    """How many low frequencies of n starts can be used for the variance.

    At most one for every two horizons that fit into the flight: above that frequency the overlap of the predictions
    smooths the series, and the variance would be too small.
    """
    overlap = max(1.0, horizon / START_EVERY)
    return min(frequencies(n), int(n / (2 * overlap) + 1e-9))


def _difference(losses: Sequence[_Loss]) -> Difference:
    """First minus second over one or several flights.

    The standard error is that of these flights under different wind; it does not include how other kinds of flight
    would differ. A flight has one degree of freedom less than frequencies: the error of a root mean square grows with
    it, which makes the plain t-ratio reject too often; with one less the size is right, as measured in the tests.

    Source: degrees of freedom of a sum of variances: F. E. Satterthwaite, Biometrics Bulletin 2 (1946), pp. 110-114.
    """
    weight = np.array([loss.weight for loss in losses])
    weight /= weight.sum()
    n, mean = sum(loss.n for loss in losses), weight @ np.array([loss.mean for loss in losses])
    mse, rmse = float(mean @ LESS), float(np.sqrt(mean) @ LESS)
    slope = _slope(mean)
    parts = weight**2 * [_along(loss, slope) for loss in losses]
    variance, mse_variance = float(parts.sum()), float(weight**2 @ [_along(loss, LESS) for loss in losses])
    each = np.array([loss.freedom for loss in losses], float)
    freedom = variance**2 / float(np.sum(parts**2 / np.maximum(each, 1))) if variance > 0 else float(each.sum())
    if each.min() < LEAST_FREEDOM:
        return Difference(n, rmse, None, None, None, mse, None, "too_short")
    p = 1.0
    if abs(mse) > SAME * float(mean.max()) and variance > 0:
        p = two_sided(rmse / variance**0.5, freedom)
    verdict: Verdict = "no_difference_shown" if p >= LEVEL else "better" if rmse < 0 else "worse"
    return Difference(n, rmse, variance**0.5, freedom, p, mse, mse_variance**0.5, verdict)


def _slope(mean: Array) -> Array:
    """Derivative of the difference of the roots with respect to the mean squares, shape (2,)."""
    return LESS * np.divide(0.5, np.sqrt(mean), out=np.zeros(2), where=mean > 0)


def _along(loss: _Loss, direction: Array) -> float:
    """Variance of a combination; for two equal predictors rounding could make it negative, so it is at least zero."""
    return max(0.0, float(direction @ loss.covariance @ direction))


def _agreement(losses: Sequence[_Loss]) -> float | None:
    """p-value for equal differences of the RMSE on several flights.

    Source: B. L. Welch, Biometrika 38 (1951), pp. 330-336.
    """
    from scipy.special import fdtrc

    F = len(losses)
    variances = np.array([_along(loss, _slope(loss.mean)) for loss in losses])
    if F < 2 or variances.min() <= 0:
        return None
    differences = np.array([np.sqrt(loss.mean) @ LESS for loss in losses])
    w, freedom = 1 / variances, np.array([loss.freedom for loss in losses])
    spread = float(w @ (differences - w @ differences / w.sum()) ** 2) / (F - 1)
    loose = float(np.sum((1 - w / w.sum()) ** 2 / freedom))
    return float(fdtrc(F - 1, (F**2 - 1) / (3 * loose), spread / (1 + 2 * (F - 2) / (F**2 - 1) * loose)))
