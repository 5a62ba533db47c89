"""Gaussian priors on the coefficients (maximum a posteriori).

The prior is added to the objective, never to the reported log-likelihood. Input and delay have normal priors; damping
has a log-normal one, since its logarithm is estimated: mean log(mean), standard deviation sd / mean.

The default laws have a prior of their own, on the lag, that the card does not give. Between command and acceleration is
the attitude loop, which in multirotors responds within hundredths to tenths of a second, and in gusts its lag cannot be
separated from the delay. A log-normal prior, wide enough to have no effect on a calm flight, keeps the input finite.

Source: S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory (1993), section 11.5.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Prior
from rotorfit.core.frames import Array
from rotorfit.core.laws import LAG, Structure
from rotorfit.estimation.likelihood.likelihood import LikelihoodScore
from rotorfit.estimation.likelihood.parameters import Point

_NAMES = ("input", "damping", "delay")

LAG_MEDIAN = 0.1
"""Median of the prior of the lag [s]: attitude loops of the recorded and the simulated vehicles, 0.03 to 0.3 s."""

LAG_SPREAD = 1.0
"""Standard deviation of the logarithm of the lag: 95 % of the prior is from 0.014 to 0.71 s."""


@dataclass(frozen=True)
class GaussianPrior:
    """Prior of K axes over the first coordinates of `Point.flat`: g, log b, tau, further parameters.

    Attributes:
        mean: Shape (3 K,), or (3 K + E K,) if a further parameter has a prior.
        precision: Inverse variance, 0 where there is no prior, of the same shape.
    """

    mean: Array
    precision: Array

    def exponent(self, point: Point) -> float:
        """Logarithm of the density at a point, less that at the mean."""
        off = point.flat()[: self.mean.size] - self.mean
        return -0.5 * float(self.precision @ off**2)


def gaussian_prior(priors: Mapping[str, Mapping[str, Prior]], axes: Sequence[str]) -> GaussianPrior | None:
    """The prior of these axes from a card's priors by axis and coefficient; None where the card has none for them."""
    mean, precision = np.zeros((3, len(axes))), np.zeros((3, len(axes)))
    for k, axis in enumerate(axes):
        for i, name in enumerate(_NAMES):
            if one := priors.get(axis, {}).get(name):
                logarithmic = name == "damping"
                mean[i, k] = np.log(one.mean) if logarithmic else one.mean
                precision[i, k] = (one.sd / one.mean if logarithmic else one.sd) ** -2
    return GaussianPrior(mean.ravel(), precision.ravel()) if precision.any() else None


def lag_prior(structures: Sequence[Structure], known: GaussianPrior | None = None) -> GaussianPrior | None:
    """The prior of the lag of every axis whose law has one, combined with a prior of the coefficients.

    Args:
        structures: Structures of the K axes.
        known: Prior of their coefficients.

    Returns:
        The combined prior; `known` if no law has a lag.
    """
    K, E = len(structures), max(len(structure.extras) for structure in structures)
    lags = [(3 + e) * K + k for k, law in enumerate(structures) for e, one in enumerate(law.extras) if one.place == LAG]
    if not lags:
        return known
    mean, precision = np.zeros((3 + E) * K), np.zeros((3 + E) * K)
    if known is not None:
        mean[: 3 * K], precision[: 3 * K] = known.mean, known.precision
    mean[lags], precision[lags] = np.log(LAG_MEDIAN), LAG_SPREAD**-2
    return GaussianPrior(mean, precision)


def prior_of_law(prior: GaussianPrior | None, axes: int) -> GaussianPrior | None:
    """The part of a prior that belongs to the laws of this many axes, that of the lag; None if there is none.

    A part of the data estimated apart keeps it, as it would alone; the card's prior would make all parts agree.
    """
    if prior is None or not prior.precision[3 * axes :].any():
        return None
    return replace(prior, precision=np.concatenate([np.zeros(3 * axes), prior.precision[3 * axes :]]))


def with_prior(likelihood: LikelihoodScore, point: Point, prior: GaussianPrior | None) -> LikelihoodScore:
    """The score with the prior included in objective, gradient and information."""
    if prior is None:
        return likelihood
    at = np.arange(prior.mean.size)
    off = point.flat()[at] - prior.mean
    gradient, information = likelihood.gradient.copy(), likelihood.information.copy()
    gradient[at] -= prior.precision * off
    information[at, at] += prior.precision
    adjustment = likelihood.adjustment + prior.exponent(point)
    return replace(likelihood, adjustment=adjustment, gradient=gradient, information=information)


def redrawn(prior: GaussianPrior, rng: np.random.Generator) -> GaussianPrior:
    """The prior with its mean drawn at random from the prior itself, for the parametric bootstrap."""
    known = prior.precision > 0
    error = np.where(known, np.where(known, prior.precision, 1.0) ** -0.5, 0.0)
    return replace(prior, mean=prior.mean + error * rng.standard_normal(error.size))
