"""Factors on standard errors for innovations that are coloured or have unequal variances.

An estimate is a weighted sum of innovations, theta - theta_0 = sum_t w_t e_t. If they are white and of unit variance,
its variance is sum w_t^2, and the information is right. If they are coloured, the variance depends on their spectrum at
the frequencies of the weights,

    V = sum_f |W(f)|^2 I(f) / N,   I(f) the periodogram of e,

and if their variance changes, on its value at the times of the weights. Both are ratios of the observed variance to
that expected of white innovations, less the part that the fit absorbed. As means over few frequencies or times they are
noisy: |W|^2 is smoothed, the remaining scatter is known, and only the excess over it counts (a positive-part shrinkage
towards 1). So the intervals of a flight that the model describes change by about a per cent.

Source: L. Ljung, System Identification, 2nd ed. (1999), eqs. (9.63), (13.56) (variance in frequencies); M. S. Bartlett,
J. R. Statist. Soc. 8 (1946); H. White, Econometrica 48 (1980), pp. 817-838 (unequal variances); W. James, C. Stein,
Proc. 4th Berkeley Symp. (1961), pp. 361-379.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.estimand import Estimand
from rotorfit.estimation.likelihood.likelihood import inverted, segments, whiten

BANDWIDTH = 0.1
"""Half width of the smoothing in frequency [Hz]: as wide as the peak of a wobble, with many frequencies inside."""

LEAST_BINS = 6
"""Smallest half width of the smoothing in frequency, in bins of the flight's spectrum."""

TIME_WINDOW = 5.0
"""Half width of the smoothing in time [s]: the duration of gusts."""

INDEPENDENT = 1e-6
"""Share of the largest singular value below which a direction depends on the others."""

SHRINKAGE = 2.0
"""Number of its own variances that is subtracted from a squared excess."""


@dataclass(frozen=True)
class Weighted:
    """The innovations of one flight and their weights in Q estimates. B blocks, K axes of the likelihood.

    Attributes:
        time: Shape (B,) [s].
        innovation: Innovations, of unit variance under the model, shape (B, K); of one of several flights, less what
            its own coefficients would explain.
        weight: Shape (B, K, Q), each on the scale of its estimate.
        span: Whitened sensitivities of all fitted parameters, shape (B, K, P): the directions that the fit absorbed.
        own: Step from the parameters of all flights to those of this one, shape (P,); 0 of a single flight.
    """

    time: Array
    innovation: Array
    weight: Array
    span: Array
    own: Array


def weighted_innovations(estimate: Estimate, wanted: Sequence[Estimand], own: Sequence[Array] = ()) -> list[Weighted]:
    """Innovations of each flight of an estimate, and their weights in the wanted quantities.

    From those of several flights, what coefficients of the flight's own would explain is removed, to first order and as
    if all segments began alike: how much flights differ is judged by `random_effects`, and is neither colour of the
    innovations nor an error of the law.

    Args:
        estimate: Of one flight or several.
        wanted: Q quantities.
        own: Step to the parameters of each flight under other levels, (P,) each; found here where it is not given.
    """
    optimum, point = estimate.optimum, estimate.optimum.point
    n, K, F = point.n, point.gain.size, len(estimate.records)
    covariance = inverted(optimum.score.information[:n, :n], optimum.free[:n])
    along = covariance @ np.array([one.slope for one in wanted]).T
    first = point.coefficients
    out = []
    for j, (rec, at) in enumerate(zip(estimate.records, segments(estimate.records), strict=True)):
        _, sensitivity = response(rec, point, j, point.start[at])
        rows, _ = whiten(rec, sensitivity, point.levels)
        segment = rec.segment
        shared = np.r_[:first, first + j * K : first + (j + 1) * K]
        weight = np.einsum("bck,cq->bkq", rows[:, : first + K], along[shared])
        starts = first + F * K + (at.start + segment)[:, None] * K + np.arange(K)
        weight += np.einsum("bck,bcq->bkq", rows[:, first + K :], along[starts])
        span = rows.transpose(0, 2, 1)[:, :, np.flatnonzero(np.r_[optimum.free[shared], [True] * K])]
        innovation = optimum.score.innovations[j]
        step = np.zeros(span.shape[-1]) if F == 1 else own[j] if own else _step(innovation, span)
        out.append(Weighted(rec.block_time, innovation - span @ step, weight, span, step))
    return out


def _step(innovation: Array, span: Array) -> Array:
    """Step (P,) of the parameters that explains most of the innovations (B, K) by their sensitivities (B, K, P)."""
    columns = span.reshape(-1, span.shape[-1])
    size = np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300)
    return np.asarray(np.linalg.lstsq(columns / size, innovation.reshape(-1), INDEPENDENT)[0] / size)


@dataclass(frozen=True)
class Ratio:
    """Ratio of a variance to the expected one.

    Attributes:
        value: The observed ratio.
        variance: Variance of the ratio if the innovations are white and of unit variance.
    """

    value: float
    variance: float

    @property
    def beyond_chance(self) -> float:
        """The ratio shrunk towards 1; at least 1."""
        excess = self.value - 1
        if excess <= 0:
            return 1.0
        return 1 + excess * max(0.0, 1 - SHRINKAGE * self.variance / excess**2)


def widening(weighted: Sequence[Weighted], names: Sequence[str]) -> Mapping[str, float]:
    """Factor on the standard error of each estimate, at least 1, by name; `names` in the order of the weights."""
    spectral, temporal = (
        _ratios([part for one in weighted for part in parts(one)], len(names)) for parts in (_spectral, _temporal)
    )
    return {
        name: float(np.sqrt(colour.beyond_chance * size.beyond_chance))
        for name, colour, size in zip(names, spectral, temporal, strict=True)
    }


@dataclass(frozen=True)
class _Power:
    """Power of innovations and weights at N frequencies or times of one axis.

    Attributes:
        found: Power of the innovations, shape (N,).
        weight: Smoothed power of the weights, shape (N, Q).
        left: Expected power of white innovations after the fit, relative to that before it, shape (N,).
        spread: Variance of `found` over its squared mean.
    """

    found: Array
    weight: Array
    left: Array
    spread: float


def _ratios(parts: Sequence[_Power], count: int) -> list[Ratio]:
    out = []
    for q in range(count):
        found = sum(float(part.weight[:, q] @ part.found) for part in parts)
        expected = sum(float(part.weight[:, q] @ part.left) for part in parts)
        variance = sum(part.spread * float(part.weight[:, q] ** 2 @ part.left) for part in parts)
        out.append(Ratio(found / expected, variance / expected**2) if expected > 0 else Ratio(1.0, 0.0))
    return out


def _spectral(one: Weighted) -> list[_Power]:
    """Power over the frequencies of a flight, axis by axis."""
    B, duration = len(one.time), float(np.ptp(one.time)) + 1e-9
    reach = max(LEAST_BINS, round(BANDWIDTH * duration))
    out = []
    for k in range(one.innovation.shape[1]):
        found = np.abs(np.fft.rfft(one.innovation[:, k])) ** 2 / B
        weight = _smoothed(np.abs(np.fft.rfft(one.weight[:, k], axis=0)) ** 2 / B, reach)
        basis = orthonormal(one.span[:, k])
        left = 1 - np.sum(np.abs(np.fft.rfft(basis, axis=0)) ** 2, axis=1) / B
        counted = np.full(len(found), 2.0)  # a frequency above 0 represents its negative, too
        counted[0] = 1.0
        out.append(_Power(found, counted[:, None] * weight, np.clip(left, 0.05, 1.0), 1.0))
    return out


def _temporal(one: Weighted) -> list[_Power]:
    """Power over the blocks of a flight, axis by axis, divided by its mean so that colour is not counted twice."""
    step = float(np.median(one.time[2:] - one.time[:-2])) / 2  # a position and a velocity may be of one moment
    reach, out = max(1, round(TIME_WINDOW / step)), []
    for k in range(one.innovation.shape[1]):
        square = one.innovation[:, k] ** 2
        mean = float(square.mean())
        kurtosis = float(np.mean(square**2)) / mean**2 - 1
        out.append(
            _Power(square / mean, _smoothed(one.weight[:, k] ** 2, reach), np.ones(len(square)), max(kurtosis, 2.0))
        )
    return out


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of the span of the columns; dependent columns and columns of zeros are dropped."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    left, singular, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(left[:, singular > INDEPENDENT * singular[:1].max(initial=1e-300)])


def _smoothed(power: Array, reach: int) -> Array:
    """Running mean over +-reach rows, the series reflected at its ends, shape (N, Q)."""
    reach = min(reach, len(power) - 1)
    padded = np.concatenate([power[reach:0:-1], power, power[-2 : -reach - 2 : -1]])
    total = np.concatenate([np.zeros((1, power.shape[1])), np.cumsum(padded, axis=0)])
    return np.asarray((total[2 * reach + 1 :] - total[: -2 * reach - 1]) / (2 * reach + 1))
