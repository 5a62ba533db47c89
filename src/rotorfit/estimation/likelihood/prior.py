"""What was believed before the flight: a Gaussian term on the coefficients (maximum a posteriori).

It is added to what is maximised, never to the log-likelihood that is reported. Input and delay as they are; damping in
its logarithm, where its estimate lives and a prior of positive damping is natural: log(mean), with the share sd / mean.

The default laws have one prior that no card need give: of the lag. Between command and acceleration stands an attitude
loop; of multirotors it answers within hundredths to tenths of a second, and a flight in gusts cannot tell its lag from
the delay. A logarithmic normal, wide enough that a calm flight does not notice it, keeps such a flight's input finite.

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
"""Standard deviation of its logarithm: 95 % lie from 0.014 to 0.71 s."""


@dataclass(frozen=True)
class GaussianPrior:
    """The term of K axes, over their first coordinates in the order of `Point.flat`: g, log b, tau, further ones.

    Attributes:
        mean: Shape (3 K,), or (3 K + E K,) where something is believed of a further parameter.
        precision: One over the variance, 0 where nothing is believed, of the same shape.
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


def lag_prior(structures: Sequence[Structure], known: GaussianPrior | None = None) -> GaussianPrior | None:
    """The prior of the lag of every axis whose law has one, beside what is believed of the coefficients.

    Args:
        structures: Of the K axes.
        known: Of their coefficients.
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
