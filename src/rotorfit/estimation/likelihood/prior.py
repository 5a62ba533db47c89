"""What was believed before the flight: a Gaussian term on the coefficients (maximum a posteriori).

It is added to what is maximised, never to the log-likelihood that is reported. Input and delay as they are; damping in
its logarithm, where its estimate lives and a prior of positive damping is natural: log(mean), with the share sd / mean.

Source: S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory (1993), section 11.5.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Prior
from rotorfit.core.frames import Array
from rotorfit.estimation.likelihood.likelihood import LikelihoodScore
from rotorfit.estimation.likelihood.parameters import Point

_NAMES = ("input", "damping", "delay")


@dataclass(frozen=True)
class GaussianPrior:
    """The term of K axes, over their g, log b, tau in the order of `Point.flat`.

    Attributes:
        mean: Shape (3 K,).
        precision: One over the variance, 0 where nothing is believed, shape (3 K,).
    """

    mean: Array
    precision: Array


def gaussian_prior(priors: Mapping[str, Mapping[str, Prior]], axes: Sequence[str]) -> GaussianPrior | None:
    """The term of these axes from a card's priors; None where it says nothing of them."""
    mean, precision = np.zeros((3, len(axes))), np.zeros((3, len(axes)))
    for k, axis in enumerate(axes):
        for i, name in enumerate(_NAMES):
            if one := priors.get(axis, {}).get(name):
                logarithmic = name == "damping"
                mean[i, k] = np.log(one.mean) if logarithmic else one.mean
                precision[i, k] = (one.sd / one.mean if logarithmic else one.sd) ** -2
    return GaussianPrior(mean.ravel(), precision.ravel()) if precision.any() else None


def with_prior(likelihood: LikelihoodScore, point: Point, prior: GaussianPrior | None) -> LikelihoodScore:
    """The score of likelihood and prior together."""
    if prior is None:
        return likelihood
    at = np.arange(prior.mean.size)
    off = point.flat()[at] - prior.mean
    gradient, information = likelihood.gradient.copy(), likelihood.information.copy()
    gradient[at] -= prior.precision * off
    information[at, at] += prior.precision
    adjustment = likelihood.adjustment - 0.5 * float(prior.precision @ off**2)
    return replace(likelihood, adjustment=adjustment, gradient=gradient, information=information)


def redrawn(prior: GaussianPrior, rng: np.random.Generator) -> GaussianPrior:
    """A prior that could have been held as well: its mean drawn from itself."""
    known = prior.precision > 0
    error = np.where(known, np.where(known, prior.precision, 1.0) ** -0.5, 0.0)
    return replace(prior, mean=prior.mean + error * rng.standard_normal(error.size))
